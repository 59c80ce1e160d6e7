"""A timeline that never repeats, laid out stretch by stretch as the run comes to it.

Stage 3, for tasks whose clocks are late by chance: memory holds one stretch, however long the run is.
The lateness of every task is drawn from a random stream of its own by the run's seed, and does not
depend on anything that is played.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hybrid.clockwork import Event, Happening, in_order
from hybrid.machine import Machine
from hybrid.processor import Lateness, Note, Processor
from hybrid.rota import TaskReport, duty_of, fold, reports
from hybrid.streams import stream

# Lateness is drawn in so many equal steps: intervals between events repeat, and so do their propagators.
JITTER_STEPS = 64
# Ticks of the fastest clock in a stretch.
CLOCKS = 2000


def jitters(machine: Machine) -> bool:
    """Whether the clock of a task is late by chance."""
    return any(task.jitter for task in machine.timing.tasks)


def lateness(machine: Machine, seed: int) -> tuple[Lateness, ...]:
    """For each task a function that draws how late its clock ticks, in ticks of time."""
    made: list[Lateness] = []
    for task in machine.timing.tasks:
        random = stream(seed, "jitter", task.name)
        made.append(_drawn(random, task.jitter))
    return tuple(made)


def _drawn(random: np.random.Generator, jitter: int) -> Lateness:
    def draw() -> int:
        if not jitter:
            return 0
        return jitter * int(random.integers(0, JITTER_STEPS + 1)) // JITTER_STEPS

    return draw


class Stretches:
    """The events from t = 0 on, one stretch after the other; `notes` of them so far."""

    def __init__(self, machine: Machine, seed: int) -> None:
        """Nothing is laid out yet."""
        self.machine = machine
        self.stopped: Note | None = None
        self._processor = Processor(duty_of(machine), lateness(machine, seed))
        self._done: dict[Note, int] = {}  # of stretches that have been played
        self._notes: list[Note] = []  # of the last one

    def __iter__(self) -> Iterator[tuple[int, int, list[Event]]]:
        """Start, end and events (counted from the start) of each stretch, up to the end of the run."""
        timing, processor, start = self.machine.timing, self._processor, 0
        while self.stopped is None:
            end = min(start + CLOCKS * timing.period, timing.until)
            last = end == timing.until
            self._done = fold(self._done, self._notes)
            processor.log.clear()
            processor.notes.clear()
            processor.run(end + last)
            self.stopped = processor.stopped
            if self.stopped:
                end, last = self.stopped.tick, True
            self._notes = [note for note in processor.notes if note.tick <= end]
            first_row = -(-start // timing.every)
            rows = range(first_row * timing.every, end + last, timing.every)
            events = [e for e in processor.log if e[0] < end + last]
            events += [(tick, int(Happening.RECORD), 0) for tick in rows]
            yield start, end, [(t - start, kind, i) for t, kind, i in in_order(events)]
            start = end
            if last:
                return

    def reports(self, until: int | None) -> tuple[TaskReport, ...]:
        """What the cycles of every task have come to, up to an instant of the last stretch."""
        ended = [note for note in self._notes if until is None or note.tick <= until]
        return reports(self.machine, fold(self._done, ended).items())
