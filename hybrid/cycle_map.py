"""The exact map of one repeated stretch of a machine's timeline.

Stage 6. The map takes everything the machine remembers (analog states, held outputs, words, results
on their way) over one stretch: a cycle, or what several tasks do until they are where they were, a
multi-rate loop; quantisation and clipping are left out, lags, gain errors, skew and compute time are in.

All figures are kept as differences from the identity: at T = 0.1 ms and 10 rad/s the damping sits
in the tenth digit of z.

The points of a sweep mostly do the same in the same order and differ in figures only. Their maps are
found together, with a leading axis of points.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hybrid.clockwork import Happening
from hybrid.engine.propagator import propagators
from hybrid.errors import HybridError, PatchError
from hybrid.linearity import LinearProgram, NotLinear, linear_program
from hybrid.machine import Floats, Machine
from hybrid.scale import to_seconds
from hybrid.stretches import never_repeats
from hybrid.tape import MEMORY, WORDS, Memory
from hybrid.timeline import Timeline, build_timeline
from hybrid.together import attempt, in_stacks, passed_on

# In how many stretches tasks must have settled; the layout of their events ends long before.
MOST_STRETCHES = 10**6
AT_ONCE = -1  # no interval passes before an event
NEVER_TOGETHER = "the periods of the tasks have no short common multiple, so there is no exact map"


class CycleMap(NamedTuple):
    """M - I of one repeated stretch, constants and sources left out, and its length."""

    change: Floats  # (figures, figures)
    ticks: int


def cycle_maps(machines: Sequence[Machine]) -> list[CycleMap | HybridError]:
    """The map of each machine, or why there is none; each as if it were alone, to the last bit."""
    loops = [attempt(_loop, machine) for machine in machines]
    return passed_on(loops, lambda found: in_stacks(found, _kind, _Loop.size, _maps_of_alike))


def _maps_of_alike(loops: list[_Loop]) -> list[CycleMap]:
    tracker = _Tracker(loops)
    with np.errstate(over="ignore", invalid="ignore"):  # `eigenvalues` refuses what overflows
        for which, kind, index in loops[0].events:
            tracker.play(which, Happening(kind), index)
    changes = tracker.changes()
    return [CycleMap(change, loop.ticks) for change, loop in zip(changes, loops, strict=True)]


def in_operation(machine: Machine) -> Machine:
    """The machine; of a linear patch with modes, it in OP."""
    if machine.operating is None:
        return machine
    return replace(machine, analog=machine.operating, elements=(), operating=None)


def stretch_s(machine: Machine) -> float:
    """What repeats takes so long: a cycle, or until all tasks are where they were."""
    segments = _repeating(in_operation(machine)).segments
    return to_seconds(next(s.length for s in segments if s.start > 0 and s.length > 0))


def _repeating(machine: Machine) -> Timeline:
    """A timeline whose second segment repeats; raises NotLinear where there is none."""
    try:
        timeline = build_timeline(_short(machine))
    except PatchError as error:
        if not machine.timing.tasks:
            raise
        raise NotLinear(NEVER_TOGETHER, machine.timing.tasks[0].place) from error
    if timeline.later and never_repeats(machine):
        raise NotLinear("the clock of a task jitters, so there is no exact map")
    if timeline.later:
        raise NotLinear(NEVER_TOGETHER, machine.timing.tasks[0].place)
    if len(timeline.segments) < 2:
        raise NotLinear("the tasks do not come back to where they were, so there is no exact map")
    return timeline


def _short(machine: Machine) -> Machine:
    """The same machine without steps, run just long enough for one stretch to repeat."""
    timing = machine.timing
    if _is_plain(machine):
        return machine
    # The record does not belong to the loop: let it follow the cycle.
    every, until = timing.period, 5 * timing.period + 2 * machine.latency_ticks
    tasks = tuple(
        replace(t, overrun="skip" if t.overrun == "stop" else t.overrun) for t in timing.tasks
    )
    if tasks:
        every = math.lcm(*(task.period for task in tasks))
        until = MOST_STRETCHES * every
    timing = replace(timing, every=every, until=until, tasks=tasks)
    return replace(machine, steps=(), operation=None, timing=timing)


def _is_plain(machine: Machine) -> bool:
    """Whether the run itself is a cycle, with a row, again and again: then it is laid out but once."""
    timing = machine.timing
    steady = not (machine.steps or machine.operation or timing.tasks)
    enough = timing.until >= 5 * timing.period + 2 * machine.latency_ticks
    return steady and enough and timing.every == timing.period


@dataclass(frozen=True, eq=False)
class _Loop:
    """What the map of a machine is made of.

    `events` of the stretch: (which of `intervals` passes before it or AT_ONCE, kind, index).
    """

    machine: Machine
    program: LinearProgram
    ticks: int
    in_flight: tuple[int, ...]  # results of each program on their way at the start
    events: tuple[tuple[int, int, int], ...]
    intervals: tuple[int, ...]  # ticks

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Figures that are followed, part by part, see `_Tracker`."""
        analog, tape = self.machine.analog, self.machine.tape
        adcs = len(self.machine.samplers)
        words = np.diff(tape.starts[:, WORDS]).tolist()
        most = _most_in_flight(self.events, self.in_flight)
        queues = [count * each for count, each in zip(most, words, strict=True)]
        fixed = (len(analog.states), len(analog.inputs), adcs, adcs, len(self.program.keep))
        return (*fixed, len(tape.words), *queues)

    def size(self) -> int:
        """Numbers that are followed."""
        return sum(self.sizes) ** 2


def _most_in_flight(events: Sequence[tuple[int, int, int]], in_flight: Sequence[int]) -> list[int]:
    """How many results of each program are on their way at a time, at most."""
    now, most = list(in_flight), list(in_flight)
    for _, kind, index in events:
        if kind == Happening.START:
            now[index] += 1
            most[index] = max(most[index], now[index])
        elif kind == Happening.END:
            now[index] -= 1
    return most


def _kind(loop: _Loop) -> Hashable:
    """All but figures: what stands where, and what happens in which order."""
    machine, tape = loop.machine, loop.machine.tape
    return (
        machine.analog.sources,
        tuple((holder.word, holder.input) for holder in machine.holders),
        tape.starts[:, 1:].tobytes(),
        tape.memory[:, Memory.LENGTH].tobytes(),
        loop.program.shared.tobytes(),
        loop.sizes,
        loop.events,
    )


def _loop(machine: Machine) -> _Loop:
    """The repeated stretch of a machine; raises NotLinear or PatchError where there is none."""
    segments = _repeating(machine).segments
    stretch = next(s for s in segments if s.start > 0 and s.length > 0)
    before = [(kind, i) for tick, kind, i in segments[0].events if tick < stretch.start]
    in_flight = tuple(
        before.count((Happening.START, i)) - before.count((Happening.END, i))
        for i in range(len(machine.tape.starts) - 1)
    )
    events, intervals, now = [], dict[int, int](), 0
    for offset, kind, index in stretch.events:
        passed, now = offset - now, offset
        which = intervals.setdefault(passed, len(intervals)) if passed else AT_ONCE
        events.append((which, kind, index))
    program = linear_program(machine.tape, len(machine.samplers))
    return _Loop(machine, program, stretch.length, in_flight, tuple(events), tuple(intervals))


class _Tracker:
    """Follows every remembered figure as a linear form of its values at the start of the stretch, for
    loops of one kind.

    Layout of a form: n states, m inputs, ADC samples, ADC words, remembered values, visible words,
    then the queue of results of each program, oldest first.
    """

    def __init__(self, loops: list[_Loop]) -> None:
        first, machines = loops[0], [loop.machine for loop in loops]
        self.loops, self.machine, self.program = loops, first.machine, first.program
        self.in_flight = list(first.in_flight)
        edges = [0, *itertools.accumulate(first.sizes)]
        parts = [slice(a, b) for a, b in itertools.pairwise(edges)]
        self.x, self.u, self.sample, self.adc, self.memory, self.words = parts[:6]
        self.queues = parts[6:]
        self.start = np.eye(edges[-1])
        self.moved = np.zeros((len(loops), edges[-1], edges[-1]))  # now - start
        self.taken = [
            np.stack([m.analog.c[m.samplers[i].signal] * m.samplers[i].to_si for m in machines])
            for i in range(len(self.machine.samplers))
        ]
        self.rows = np.stack([loop.program.rows for loop in loops])
        self.keep = np.stack([loop.program.keep for loop in loops])

    def value(self, part: slice) -> Floats:
        """Forms of one part, now: (points, figures of the part, figures)."""
        now: Floats = self.start[part] + self.moved[:, part]
        return now

    def set(self, part: slice, forms: Floats) -> None:
        """Give one part new forms."""
        self.moved[:, part] = forms - self.start[part]

    def play(self, which: int, kind: Happening, index: int) -> None:
        """Advance to the event, then do to the forms what the kernel does to the figures."""
        analog = slice(self.x.start, self.u.stop)
        if which != AT_ONCE:
            self.moved[:, self.x] += self._change(which) @ self.value(analog)
        if kind is Happening.SAMPLE:
            self.set(_row(self.sample, index), self.taken[index][:, None] @ self.value(analog))
        elif kind is Happening.CONVERT:
            self.set(_row(self.adc, index), self.value(_row(self.sample, index)))
        elif kind is Happening.START:
            self._start_program(index)
        elif kind is Happening.END:
            self._end_program(index)
        elif kind is Happening.LATCH:
            to_mu = np.array([loop.machine.holders[index].to_mu for loop in self.loops])
            holder = self.machine.holders[index]
            shown = self.value(_row(self.words, holder.word))
            self.set(_row(self.u, holder.input), to_mu[:, None, None] * shown)

    def _change(self, which: int) -> Floats:
        over = [(loop.machine.analog, to_seconds(loop.intervals[which])) for loop in self.loops]
        return np.stack([propagator.change for propagator in propagators(over)])

    def _own(self, program: int, column: int) -> tuple[int, int]:
        """First and last row of what belongs to one program, among its words or its memory."""
        first, last = self.machine.tape.starts[program : program + 2, column].tolist()
        return first, last

    def _start_program(self, program: int) -> None:
        one, shared = self.value(self.u)[:, :1], self.value(self.words)[:, self.program.shared]
        inputs = np.concatenate(
            [self.value(self.adc), self.value(self.memory), shared, one], axis=1
        )
        first, last = self._own(program, WORDS)
        at = self.queues[program].start + self.in_flight[program] * (last - first)
        self.set(slice(at, at + last - first), self.rows[:, first:last] @ inputs)
        self.in_flight[program] += 1
        # Each delay has as many columns as cycles.
        lengths = self.machine.tape.memory[:, Memory.LENGTH] + 1
        first, last = (int(np.sum(lengths[:row])) for row in self._own(program, MEMORY))
        keep = slice(self.memory.start + first, self.memory.start + last)
        self.set(keep, self.keep[:, first:last] @ inputs)

    def _end_program(self, program: int) -> None:
        first, last = self._own(program, WORDS)
        words, queue = last - first, self.value(self.queues[program])
        self.set(slice(self.words.start + first, self.words.start + last), queue[:, :words])
        rest = np.zeros_like(queue)
        rest[:, : queue.shape[1] - words] = queue[:, words:]
        self.set(self.queues[program], rest)
        self.in_flight[program] -= 1

    def changes(self) -> list[Floats]:
        """M - I without the constant 1, the step inputs and the sine sources, which only drive."""
        driven = {self.u.start + holder.input for holder in self.machine.holders}
        drop = [self.x.start + i for i in self.machine.analog.sources]
        drop += [i for i in range(self.u.start, self.u.stop) if i not in driven]
        return _lasting(without(self.moved, drop))


def _row(part: slice, index: int) -> slice:
    """One figure of a part."""
    return slice(part.start + index, part.start + index + 1)


def _lasting(changes: Floats) -> list[Floats]:
    """M - I of each point without what is overwritten before anybody reads it: samples, words, what
    DACs held.

    Nothing depends on such a figure, so its column of M is zero, and so is its eigenvalue. Without it
    others may be such.
    """
    depends = changes + np.eye(changes.shape[1]) != 0.0
    read = np.ones(changes.shape[:2], dtype=bool)
    while True:
        still = read & (depends & read[:, :, None]).any(axis=1)
        if (still == read).all():
            break
        read = still
    return [change[kept][:, kept] for change, kept in zip(changes, read, strict=True)]


def without(matrices: Floats, dropped: Sequence[int]) -> Floats:
    """Square matrices (..., n, n) without these rows and columns."""
    keep = np.ones(matrices.shape[-1], dtype=bool)
    keep[list(dropped)] = False
    kept: Floats = matrices[..., keep, :][..., keep]
    return kept
