"""A timeline that never repeats, laid out stretch by stretch as the run comes to it.

Stage 3, for tasks whose clocks are late by chance, for those that comparators start, and for all whose
clocks and rows come together too seldom: memory holds one stretch, however long the run is. Where no
comparator does, a stretch ends at an event, so that no interval between events is parted: the run has
the same bits however it is laid out. The lateness of every task is drawn from a random stream of its own
by the run's seed, and does not depend on anything that is played.

A comparator is located while the run plays. Then the processor goes back to where it was at the start of
the stretch, on to the last instant that has been played, takes the call, and a new stretch is laid out
from the instant at which the comparator switched. So every event is at its exact instant, and Python has
a say only where a comparator does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hybrid.clockwork import CycleClock, Event, Happening, in_order
from hybrid.machine import Machine
from hybrid.processor import MOST_BEHIND, FallsBehind, Lateness, Note, Processor, never_late
from hybrid.rota import TaskReport, cycles_of, duty_of, fold, overrun_text, reports
from hybrid.streams import stream

# Lateness is drawn in so many equal steps: intervals between events repeat, and so do their propagators.
JITTER_STEPS = 64
# Ticks of the fastest clock in a stretch; of the first where a comparator may switch soon. After it has,
# a stretch is a little longer than it took to do so.
CLOCKS = 2000
FEWEST_CLOCKS = 8
LONGER = 5, 4


def is_called(machine: Machine) -> bool:
    """Whether a comparator starts a task."""
    return any(task.when for task in machine.timing.tasks)


def never_repeats(machine: Machine) -> bool:
    """Whether the clock of a task is late by chance, or a comparator starts one."""
    return is_called(machine) or any(task.jitter for task in machine.timing.tasks)


@dataclass(slots=True)
class _Late:
    """Draws how late the clock of a task ticks, in ticks of time."""

    random: np.random.Generator
    jitter: int

    def __call__(self) -> int:
        return self.jitter * int(self.random.integers(0, JITTER_STEPS + 1)) // JITTER_STEPS


def lateness(machine: Machine, seed: int) -> tuple[Lateness, ...]:
    """For each task a function that draws how late its clock ticks."""
    return tuple(
        _Late(stream(seed, "jitter", task.name), task.jitter) if task.jitter else never_late
        for task in machine.timing.tasks
    )


class Stretches:
    """The events from t = 0 on, one stretch after the other; `notes` of them so far."""

    def __init__(self, machine: Machine, seed: int, most_clocks: int = CLOCKS) -> None:
        """Nothing is laid out yet. most_clocks: ticks of the fastest clock in a stretch, if fewer."""
        self.machine = machine
        self.stopped: Note | None = None
        self.behind = False  # whether it stopped because a task had too many cycles waiting
        tasks = machine.timing.tasks
        self._processor: Processor | CycleClock = (
            Processor(duty_of(machine), lateness(machine, seed))
            if tasks
            else CycleClock(cycles_of(machine))
        )
        self._called = is_called(machine)
        self._before = self._processor  # as it was at the start of the stretch
        self._clock = machine.timing.period or machine.timing.every
        self._most = self._clock * max(min(most_clocks, CLOCKS), 1)
        self._length = min(self._clock * FEWEST_CLOCKS, self._most) if self._called else self._most
        self._go_on: tuple[int, int] | None = None  # where a comparator wants the next stretch
        self._done: dict[Note, int] = {}  # of stretches that have been played
        self._notes: list[Note] = []  # of the last one

    def __iter__(self) -> Iterator[tuple[int, int, int, list[Event]]]:
        """Of each stretch, up to the end of the run: its start, the first instant that is still to be
        played, its end, and its events (counted from the start)."""
        until, start, first, called = self.machine.timing.until, 0, 0, 0
        while True:
            end = min(start + self._length, until)
            end, events = self._laid_out(start, first, end)
            yield start, first, end, events
            if self._go_on:
                (start, first), self._go_on = self._go_on, None
                length = (start - called) * LONGER[0] // LONGER[1]
                self._length = min(max(length, self._clock), self._most)
                called = start
            elif self.stopped or end == until:
                return
            else:
                start = first = end
                self._length = min(2 * self._length, self._most)

    def _laid_out(self, start: int, first: int, end: int) -> tuple[int, list[Event]]:
        """The events of a stretch, and its end, which is earlier where the run stops."""
        timing, processor = self.machine.timing, self._processor
        last = end == timing.until
        self._done = fold(self._done, self._notes)
        if self._called:
            processor.log.clear()
            processor.notes.clear()
            assert isinstance(processor, Processor)
            self._before = processor.copy()
        else:  # what it has done after the end of the last one is still to be played
            processor.log[:] = [event for event in processor.log if event[0] >= start]
            processor.notes[:] = [note for note in processor.notes if note.tick >= start]
        try:
            processor.run(end + last)
        except FallsBehind as error:
            assert isinstance(processor, Processor)
            processor.stopped = Note(processor.now, error.task, None)
            self.behind = True
        self.stopped = processor.stopped
        if self.stopped:
            end, last = self.stopped.tick, True
        if not (last or self._called):
            end = self._last_event(start, end)
        self._notes = [note for note in processor.notes if note.tick < end + last]
        first_row = -(-first // timing.every)
        rows = range(first_row * timing.every, end + last, timing.every)
        events = [e for e in processor.log if e[0] < end + last]
        events += [(tick, int(Happening.RECORD), 0) for tick in rows]
        return end, [(t - start, kind, i) for t, kind, i in in_order(events)]

    def _last_event(self, start: int, end: int) -> int:
        """The last instant of an event between start and end; the end where there is none."""
        every = self.machine.timing.every
        row = (end - 1) // every * every
        ticks = [row, *(tick for tick, _, _ in self._processor.log)]
        return max((tick for tick in ticks if start < tick < end), default=end)

    def call(self, task: int, done: int, at: int) -> None:
        """A comparator starts a task at the tick `at`; up to the instant `done` all has been played."""
        if self._go_on is None:
            assert isinstance(self._before, Processor)
            self._processor, self.stopped, self.behind = self._before, None, False
            self._processor.finish(done)
            self._done, self._notes = fold(self._done, self._processor.notes), []
        assert isinstance(self._processor, Processor)
        self._processor.call(task, at)
        self._go_on = at, done + 1

    @property
    def why_stopped(self) -> str:
        """Why the run ends before its time, as far as it is laid out; '' where it does not."""
        if self.stopped is None:
            return ""
        if self.behind:
            name = self.machine.timing.tasks[self.stopped.task].name
            return (
                f"task {name!r} has fallen more than {MOST_BEHIND} cycles behind (overrun: queue); "
                "shorten a compute_time, or leave cycles out with overrun: skip"
            )
        return overrun_text(self.machine, self.stopped)

    def reports(self, until: int | None) -> tuple[TaskReport, ...]:
        """What the cycles of every task have come to, up to an instant of the last stretch."""
        ended = [note for note in self._notes if until is None or note.tick <= until]
        played = self.machine.timing.until if until is None else until
        return reports(self.machine, fold(self._done, ended).items(), played)
