"""Several tasks on one processor: a SimPy model of clocks, converters and the processor they share.

Stage 3. A cycle of a task begins at a tick of the task's clock, or where something calls it: its ADCs
sample and convert by themselves, then it waits for the processor, computes for its compute time (with
interruptions where a task of higher priority takes the processor away) and ends. It reads its words when
it first has the processor and publishes its results when it ends. What happens at one instant is done in
the order of `Turn`; see `clockwork` for how that shows in the events.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import simpy
from simpy.events import EventPriority

from hybrid.clockwork import Event, Happening

# A task that is this many cycles behind never catches up within any use of the run.
MOST_BEHIND = 1000


class Turn(IntEnum):
    """What comes first at one instant; SimPy's own events, which end a stretch, come before all."""

    COMPUTED = 1  # a cycle that ends at the next tick of its clock has not overrun
    TICK = 2
    SAMPLE = 3
    CONVERT = 4
    CHOOSE = 5  # who has the processor


@dataclass(frozen=True, slots=True)
class TaskClock:
    """One task in ticks: its clock, its converters (index, delay, conversion time), its DACs."""

    period: int  # 0: it has no clock and is called
    phase: int
    compute: int
    rank: int  # 0 goes first
    overrun: str  # 'skip', 'queue' or 'stop'
    channels: tuple[tuple[int, int, int], ...] = ()
    dacs: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Duty:
    """The digital machine's tasks and how their processor is shared."""

    tasks: tuple[TaskClock, ...]
    preemptive: bool = True


@dataclass(frozen=True, slots=True)
class Note:
    """What became of a cycle of a task: finished after `response` ticks, or not begun in time (None); or
    that a comparator has called for one, whatever becomes of it."""

    tick: int
    task: int
    response: int | None
    called: bool = False


Lateness = Callable[[], int]  # how late the clock of a task ticks next, in ticks of time


class FallsBehind(Exception):
    """A task has more and more cycles waiting."""

    def __init__(self, task: int) -> None:
        """Args: the task's index."""
        self.task = task
        super().__init__()


@dataclass(slots=True, eq=False)
class _Cycle:
    """One cycle of a task, from the tick of its clock to its results."""

    task: int
    due: int  # when its clock ticked
    begun: int  # when its ADCs began; later where it had to wait for the cycle before it
    converting: int  # channels that are not done
    left: int  # ticks of computing to do
    started: bool = False


@dataclass(slots=True)
class _Desk:
    """What a task has to do: the cycle under way, the ticks of its clock that wait behind it."""

    cycle: _Cycle | None = None
    waiting: deque[int] = field(default_factory=deque)
    ticks: int = 0  # of its clock, so far


def never_late() -> int:
    """Of a clock that is never late."""
    return 0


class _Step(simpy.Event):
    """Something to do at an instant: a method of the processor, and what it is done to.

    So a copy of the processor has its own steps, of its own cycles.
    """

    def __init__(self, clock: simpy.Environment, do: Callable[..., None], of: tuple[object, ...]):
        """As simpy.Timeout does, which knows no turns."""
        super().__init__(clock)
        self._ok, self._value = True, None
        self.do, self.of = do, of


class Processor:
    """The digital machine from t = 0 on, as far as it has been run; `log` and `notes` grow with it."""

    def __init__(self, duty: Duty, late: Sequence[Lateness] = ()) -> None:
        """Nothing has happened yet. `late`: of each task, where clocks are late by chance."""
        self.duty = duty
        self.late = tuple(late) or (never_late,) * len(duty.tasks)
        self.log: list[Event] = []
        self.notes: list[Note] = []
        self.stopped: Note | None = None  # the overrun that ends the run
        self._clock = simpy.Environment(initial_time=0)
        self._desks = tuple(_Desk() for _ in duty.tasks)
        self._ready: list[_Cycle] = []
        self._running: _Cycle | None = None
        self._since = 0  # when it took the processor
        self._choosing = False
        for number, task in enumerate(duty.tasks):
            if task.period:
                self._at(task.phase + self.late[number](), Turn.TICK, Processor._tick, number)

    @property
    def now(self) -> int:
        """SimPy counts in what it is given; here that is whole ticks."""
        return int(self._clock.now)

    def run(self, until: int) -> None:
        """Go on to the instant `until`, of which nothing is done yet."""
        if until > self.now:
            self._clock.run(until=until)

    def finish(self, instant: int) -> None:
        """Go on until all that is due up to `instant`, this one included, is done."""
        while self._clock.peek() <= instant:
            self._clock.step()

    def call(self, number: int, at: int) -> None:
        """Let a task begin a cycle at an instant, now or later, as a tick of its clock would."""
        self._at(at - self.now, Turn.TICK, Processor._due, number, at)

    def copy(self) -> Processor:
        """Another one in the same state, with random streams of its own in the same state."""
        other = copy.copy(self)
        twins = {d.cycle: copy.copy(d.cycle) for d in self._desks if d.cycle}
        other.late = tuple(copy.deepcopy(late) for late in self.late)
        other.log, other.notes = list(self.log), list(self.notes)
        other._desks = tuple(
            _Desk(d.cycle and twins[d.cycle], deque(d.waiting), d.ticks) for d in self._desks
        )
        other._ready = [twins[cycle] for cycle in self._ready]
        other._running = self._running and twins[self._running]
        other._clock = simpy.Environment(initial_time=self.now)
        for at, turn, _, step in sorted(self._clock._queue):
            if isinstance(step, _Step):  # what SimPy schedules for itself, to stop, is done with
                of = (twins.get(o, o) if isinstance(o, _Cycle) else o for o in step.of)
                other._at(int(at) - self.now, turn, step.do, *of)
        return other

    def state(self, ages: bool = True) -> tuple[object, ...]:
        """All that the future depends on, seen from now: equal states have equal futures.

        ages: with since when cycles wait for the processor or have it, on which their response times
        depend but nothing that is done.
        """
        now = self.now
        desks = []
        for task, desk in zip(self.duty.tasks, self._desks, strict=True):
            cycle, about = desk.cycle, None
            if cycle:
                left = cycle.left - (now - self._since) * (cycle is self._running)
                aged = ages or cycle.converting > 0
                since = (cycle.due - now, cycle.begun - now) if aged else ()
                about = (since, left, cycle.started)
            due = task.phase + desk.ticks * task.period - now
            desks.append((about, tuple(tick - now for tick in desk.waiting), due))
        running = self._running.task if self._running else None
        return (running, *desks)

    def _at(self, delay: int, turn: int, do: Callable[..., None], *of: object) -> None:
        """Let a method of the processor do something so many ticks from now, in its turn."""
        step = _Step(self._clock, do, of)
        step.callbacks.append(self._take)
        self._clock.schedule(step, EventPriority(turn), delay)

    def _take(self, step: simpy.Event) -> None:
        assert isinstance(step, _Step)
        step.do(self, *step.of)

    def _tick(self, number: int) -> None:
        """The clock of a task ticks."""
        task, desk = self.duty.tasks[number], self._desks[number]
        due = task.phase + desk.ticks * task.period
        desk.ticks += 1
        wait = due + task.period + self.late[number]() - self.now
        self._at(wait, Turn.TICK, Processor._tick, number)
        self._due(number, due)

    def _due(self, number: int, due: int) -> None:
        """A cycle is due: begin it, or see to the overrun."""
        task, desk = self.duty.tasks[number], self._desks[number]
        if not task.period:
            self.notes.append(Note(self.now, number, None, called=True))
        if desk.cycle is None:
            self._begin(number, due)
            return
        self.notes.append(Note(self.now, number, None))
        if task.overrun == "stop" and self.stopped is None:
            self.stopped = self.notes[-1]
        if task.overrun == "queue":
            desk.waiting.append(due)
            if len(desk.waiting) > MOST_BEHIND:
                raise FallsBehind(number)

    def _begin(self, number: int, due: int) -> None:
        """A cycle begins: its ADCs go round their channels."""
        task = self.duty.tasks[number]
        cycle = _Cycle(number, due, self.now, len(task.channels), task.compute)
        self._desks[number].cycle = cycle
        for index, delay, conversion in task.channels:
            self._at(delay, Turn.SAMPLE, Processor._sample, cycle, index, conversion)
        if not task.channels:
            self._queue_up(cycle)

    def _sample(self, cycle: _Cycle, index: int, conversion: int) -> None:
        self.log.append((self.now, Happening.SAMPLE, index))
        self._at(conversion, Turn.CONVERT, Processor._converted, cycle, index)

    def _converted(self, cycle: _Cycle, index: int) -> None:
        self.log.append((self.now, Happening.CONVERT, index))
        cycle.converting -= 1
        if not cycle.converting:
            self._queue_up(cycle)

    def _queue_up(self, cycle: _Cycle) -> None:
        """The cycle waits for the processor."""
        self._ready.append(cycle)
        self._look()

    def _look(self) -> None:
        """Choose, once all else of this instant has been done."""
        if not self._choosing:
            self._choosing = True
            self._at(0, Turn.CHOOSE, Processor._choose)

    def _choose(self) -> None:
        """The processor goes to the first by rank; a cycle under way keeps it unless preempted."""
        self._choosing = False
        if not self._ready:
            return
        first = min(self._ready, key=lambda cycle: self.duty.tasks[cycle.task].rank)
        if self._running:
            ranks = [self.duty.tasks[cycle.task].rank for cycle in (first, self._running)]
            if not self.duty.preemptive or ranks[0] > ranks[1]:
                return
            self._running.left -= self.now - self._since
            self._ready.append(self._running)
        self._ready.remove(first)
        self._running, self._since = first, self.now
        if not first.started:
            first.started = True
            self.log.append((self.now, Happening.START, first.task))
        self._at(first.left, Turn.COMPUTED, Processor._computed, first)

    def _computed(self, cycle: _Cycle) -> None:
        """The cycle that is running has its results, unless the processor was taken away since."""
        if cycle is not self._running or self.now < self._since + cycle.left:
            return
        task = self.duty.tasks[cycle.task]
        self.log.append((self.now, Happening.END, cycle.task))
        self.log.extend((self.now, Happening.LATCH, dac) for dac in task.dacs)
        self.notes.append(Note(self.now, cycle.task, self.now - cycle.due))
        desk = self._desks[cycle.task]
        self._running = desk.cycle = None
        if desk.waiting:
            self._begin(cycle.task, desk.waiting.popleft())
        self._look()
