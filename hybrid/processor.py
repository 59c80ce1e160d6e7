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
from functools import partial

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
    """What became of a cycle of a task: finished after `response` ticks, or not begun in time (None)."""

    tick: int
    task: int
    response: int | None


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


def _never_late() -> int:
    return 0


# What events do is said by bound methods and partials, so that a copy of the processor has its own.


def _do(then: Callable[[], None], _: simpy.Event) -> None:
    then()


def _nothing() -> None:
    """What the end of a compute time does is told to the event itself."""


class Processor:
    """The digital machine from t = 0 on, as far as it has been run; `log` and `notes` grow with it."""

    def __init__(self, duty: Duty, late: Sequence[Lateness] = ()) -> None:
        """Nothing has happened yet. `late`: of each task, where clocks are late by chance."""
        self.duty = duty
        self.late = tuple(late) or (_never_late,) * len(duty.tasks)
        self.log: list[Event] = []
        self.notes: list[Note] = []
        self.stopped: Note | None = None  # the overrun that ends the run
        self._clock = simpy.Environment(initial_time=0)
        self._desks = tuple(_Desk() for _ in duty.tasks)
        self._ready: list[_Cycle] = []
        self._running: _Cycle | None = None
        self._since = 0  # when it took the processor
        self._end: simpy.Event | None = None  # of the cycle that is running
        self._choosing = False
        for number, task in enumerate(duty.tasks):
            if task.period:
                self._at(task.phase + self.late[number](), Turn.TICK, partial(self._tick, number))

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
        self._at(at - self.now, Turn.TICK, partial(self._due, number, at))

    def copy(self) -> Processor:
        """Another one in the same state, with random streams of its own in the same state."""
        return copy.deepcopy(self, {id(self.duty): self.duty})

    def state(self) -> tuple[object, ...]:
        """All that the future depends on, seen from now: equal states have equal futures."""
        now = self.now
        desks = []
        for task, desk in zip(self.duty.tasks, self._desks, strict=True):
            cycle, about = desk.cycle, None
            if cycle:
                left = cycle.left - (now - self._since) * (cycle is self._running)
                about = (cycle.due - now, cycle.begun - now, left, cycle.started)
            due = task.phase + desk.ticks * task.period - now
            desks.append((about, tuple(tick - now for tick in desk.waiting), due))
        running = self._running.task if self._running else None
        return (running, *desks)

    def _at(self, delay: int, turn: Turn, then: Callable[[], None]) -> simpy.Event:
        """Do something so many ticks from now, in its turn."""
        event = simpy.Event(self._clock)
        event._ok, event._value = True, None  # as simpy.Timeout does, which knows no turns
        event.callbacks.append(partial(_do, then))
        self._clock.schedule(event, EventPriority(int(turn)), delay)
        return event

    def _tick(self, number: int) -> None:
        """The clock of a task ticks."""
        task, desk = self.duty.tasks[number], self._desks[number]
        due = task.phase + desk.ticks * task.period
        desk.ticks += 1
        wait = due + task.period + self.late[number]() - self.now
        self._at(wait, Turn.TICK, partial(self._tick, number))
        self._due(number, due)

    def _due(self, number: int, due: int) -> None:
        """A cycle is due: begin it, or see to the overrun."""
        task, desk = self.duty.tasks[number], self._desks[number]
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
            self._at(delay, Turn.SAMPLE, partial(self._sample, cycle, index, conversion))
        if not task.channels:
            self._queue_up(cycle)

    def _sample(self, cycle: _Cycle, index: int, conversion: int) -> None:
        self.log.append((self.now, Happening.SAMPLE, index))
        self._at(conversion, Turn.CONVERT, partial(self._converted, cycle, index))

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
            self._at(0, Turn.CHOOSE, self._choose)

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
        self._end = self._at(first.left, Turn.COMPUTED, _nothing)
        self._end.callbacks.append(self._computed)

    def _computed(self, event: simpy.Event) -> None:
        """The cycle that is running has its results, unless the processor was taken away since."""
        if event is not self._end or self._running is None:
            return
        cycle, task = self._running, self.duty.tasks[self._running.task]
        self.log.append((self.now, Happening.END, cycle.task))
        self.log.extend((self.now, Happening.LATCH, dac) for dac in task.dacs)
        self.notes.append(Note(self.now, cycle.task, self.now - cycle.due))
        desk = self._desks[cycle.task]
        self._running = self._end = desk.cycle = None
        if desk.waiting:
            self._begin(cycle.task, desk.waiting.popleft())
        self._look()
