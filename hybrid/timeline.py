"""The digital machine's clockwork: a SimPy model of cycles, conversions and computing, played once
for a stretch that repeats, and laid out as segments of events in exact integer time.

Stage 3, and the only module that imports simpy. The order of coincident events is written here and
nowhere else. With x- the analog state just before an instant and x+ just after:

    SAMPLE   ADCs sample; they see x-, outputs of the DACs as they were held until now
    CONVERT  conversions that end: words become readable
    START    programs whose conversions are complete read their words and compute
    END      programs whose compute time ends: their results become readable
    LATCH    DACs take those results: from here on it is x+
    SOURCE   sources step, and so does the mode of a machine that time sets
    RECORD   a row of the record is taken; it shows x+
    REST     nothing; the analog side runs on to the end of the stretch

Ties within one kind go by name. An event has an offset within its segment; a segment is repeated
`repeats` times, its length in ticks apart.
"""

from __future__ import annotations

import bisect
import functools
import itertools
import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NoReturn

import simpy

from hybrid.errors import PatchError
from hybrid.machine import Machine, StepEvent
from hybrid.modes import TIMED_MODE
from hybrid.scale import to_seconds

# Periods without a usable common multiple are laid out event by event, up to this many events.
MOST_FLAT_EVENTS = 300_000
# Different intervals between events, and the numbers in all their propagators (1 GB).
MOST_INTERVALS = 20_000
MOST_PROPAGATED = 10**8


class Happening(IntEnum):
    """Kinds of events in the order in which coincident ones are played."""

    SAMPLE = 0
    CONVERT = 1
    START = 2
    END = 3
    LATCH = 4
    SOURCE = 5
    RECORD = 6
    REST = 7


Event = tuple[int, int, int]  # tick, Happening, index of the ADC, DAC or step


@dataclass(frozen=True, slots=True)
class Segment:
    """Events of one stretch: (offset in ticks, kind, index), played `repeats` times."""

    start: int
    length: int
    repeats: int
    events: tuple[Event, ...]


@dataclass(frozen=True, slots=True)
class Timeline:
    """The whole run as segments, back to back."""

    segments: tuple[Segment, ...]
    until: int
    cycles: int  # whole digital cycles
    rows: int  # record events

    def __iter__(self) -> Iterator[Event]:
        """Every event in order, in absolute ticks (for reading and for tests)."""
        for segment in self.segments:
            for repeat in range(segment.repeats):
                base = segment.start + repeat * segment.length
                for offset, kind, index in segment.events:
                    yield base + offset, kind, index


def build_timeline(machine: Machine) -> Timeline:
    """Lay out the events of the machine's whole run.

    Raises PatchError where the periods have no common multiple and the run is too long to be laid
    out event by event.
    """
    timing = machine.timing
    stretch = math.lcm(*(t for t in (timing.period, timing.every) if t))
    warm_up = -(-(machine.latency_ticks + 1) // stretch)
    waves = {period for _, period, _ in edges_of(machine.steps).waves}
    together = math.lcm(stretch, *waves)
    laid_out = _clock_events(machine, (warm_up + 1) * together)
    if timing.until >= (warm_up + 2) * together and (
        together == stretch or laid_out <= MOST_FLAT_EVENTS
    ):
        stretch, edges = together, edges_of(machine.steps)
    else:  # a wave that never falls in with the clock: one edge after the other
        edges = _one_by_one(machine)
    if timing.until < (warm_up + 2) * stretch:
        segments = _flat(machine, edges)
    else:
        segments = _tiled(machine, stretch, warm_up, edges)
    _refuse_many_intervals(machine, segments)
    return Timeline(
        tuple(segments),
        timing.until,
        timing.until // timing.period if timing.period else 0,
        timing.until // timing.every + 1,
    )


@dataclass(frozen=True, slots=True)
class Edges:
    """When sources step: once, in order of time, and waves as (first, period, index), all in ticks."""

    once: tuple[tuple[int, int], ...]  # tick, index
    waves: tuple[tuple[int, int, int], ...]

    def within(self, start: int, end: int) -> list[Event]:
        """The events from `start` until before `end`, counted from `start`."""
        low, high = (bisect.bisect_left(self.once, (tick, -1)) for tick in (start, end))
        found = [(tick - start, index) for tick, index in self.once[low:high]]
        for first, period, index in self.waves:
            begin = first + max(0, -(-(start - first) // period)) * period
            found += [(tick - start, index) for tick in range(begin, end, period)]
        return [(tick, int(Happening.SOURCE), index) for tick, index in found]

    def breaks(self) -> list[int]:
        """Ticks at which a stretch is not like the one before it."""
        return [tick for tick, _ in self.once] + [first for first, _, _ in self.waves]


def edges_of(steps: Sequence[StepEvent]) -> Edges:
    """The edges of all sources, endless waves as such."""
    once, waves = [], []
    for i, step in enumerate(steps):
        if step.every_ticks and step.times is None:
            waves.append((step.at_ticks, step.every_ticks, i))
        else:
            times = range(step.times or 1)
            once += [(step.at_ticks + k * step.every_ticks, i) for k in times]
    return Edges(tuple(sorted(once)), tuple(waves))


def _refuse_wave(machine: Machine, index: int, length: int) -> NoReturn:
    name, period = machine.steps[index].name, machine.steps[index].every_ticks
    if name == TIMED_MODE:
        assert machine.patch.modes is not None
        raise PatchError(
            f"the run has {length / period:.3g} operations of {to_seconds(period):.12g} s, which have "
            "no short common multiple with the period and the record interval (at most "
            f"{MOST_FLAT_EVENTS}); make every: a fraction of an operation",
            machine.patch.modes.place,
        )
    place = next(c.place for c in machine.patch.components if c.name == name)
    raise PatchError(
        f"component {name!r} has a period of {to_seconds(period):.12g} s, {length / period:.3g} of them "
        f"in {to_seconds(length):.6g} s that must be laid out edge by edge (at most "
        f"{MOST_FLAT_EVENTS}); make it, the record interval and the digital period small multiples of "
        "each other",
        place,
    )


def _one_by_one(machine: Machine) -> Edges:
    """The edges of all sources until the end of the run, each by itself."""
    until, edges = machine.timing.until, edges_of(machine.steps)
    for first, period, index in edges.waves:
        if (until - first) // period > MOST_FLAT_EVENTS:
            _refuse_wave(machine, index, until - first)
    events = edges.within(0, until + 1)
    return Edges(tuple(sorted((tick, index) for tick, _, index in events)), ())


def _clock_events(machine: Machine, until: int) -> int:
    """How many events of cycles and record there are, about."""
    timing = machine.timing
    per_cycle = 3 + 2 * len(machine.samplers) + len(machine.holders)
    cycles = until // timing.period if timing.period else 0
    return until // timing.every + per_cycle * cycles


def _refuse_too_many(machine: Machine, until: int, edges: Edges) -> None:
    """Laying out events one by one is for short stretches only."""
    for _, period, index in edges.waves:
        if until // period > MOST_FLAT_EVENTS:
            _refuse_wave(machine, index, until)
    timing, count = machine.timing, _clock_events(machine, until)
    if count > MOST_FLAT_EVENTS:
        raise PatchError(
            f"the period {to_seconds(timing.period):.12g} s and the record interval "
            f"{to_seconds(timing.every):.12g} s have no short common multiple, so {count:.3g} events "
            f"would have to be laid out one by one (at most {MOST_FLAT_EVENTS}); make one a small "
            "multiple of the other",
            machine.patch.run.until.place,
        )


def _refuse_many_intervals(machine: Machine, segments: list[Segment]) -> None:
    """Every interval between events has a propagator of its own, which costs time and memory."""
    analog = machine.analog
    size = (len(analog.states) + len(analog.inputs)) * (len(analog.states) + len(analog.signals))
    most = min(MOST_INTERVALS, MOST_PROPAGATED // max(size, 1))
    if machine.elements:  # no propagators
        most = 2 * MOST_FLAT_EVENTS
    intervals = {
        after[0] - before[0]
        for segment in segments
        for before, after in itertools.pairwise(((0, 0, 0), *segment.events))
    }
    if len(intervals) > most:
        raise PatchError(
            f"the run has {len(intervals)} different intervals between events (at most {most}); "
            "make the record interval and the period small multiples of each other",
            machine.patch.run.until.place,
        )


def _flat(machine: Machine, edges: Edges) -> list[Segment]:
    until = machine.timing.until
    _refuse_too_many(machine, until, edges)
    clock = _play_clockwork(_clockwork(machine), until)
    return [_segment(0, until, 1, sorted([*clock, *edges.within(0, until + 1)]))]


def _tiled(machine: Machine, stretch: int, warm_up: int, edges: Edges) -> list[Segment]:
    """Warm-up, then one stretch repeated, broken where a source steps or begins, then the rest."""
    until = machine.timing.until
    _refuse_too_many(machine, (warm_up + 1) * stretch, edges)
    events = sorted(_play_clockwork(_clockwork(machine), (warm_up + 1) * stretch))
    first = warm_up * stretch
    clock = [(t - first, k, i) for t, k, i in events if first <= t < first + stretch]

    def pattern(number: int) -> list[Event]:
        return sorted([*clock, *edges.within(number * stretch, (number + 1) * stretch)])

    whole = until // stretch
    broken = {tick // stretch for tick in edges.breaks() if first <= tick < whole * stretch}
    head = [e for e in events if e[0] < first] + edges.within(0, first)
    segments = [_segment(0, first, 1, sorted(head))]
    at = warm_up
    for number in (*sorted(broken), whole):
        if number > at:
            segments.append(_segment(at * stretch, stretch, number - at, pattern(at)))
        if number < whole:
            segments.append(_segment(number * stretch, stretch, 1, pattern(number)))
        at = number + 1
    tail = [e for e in clock if e[0] <= until - whole * stretch]
    tail += edges.within(whole * stretch, until + 1)
    segments.append(_segment(whole * stretch, until - whole * stretch, 1, sorted(tail)))
    return segments


def _segment(start: int, length: int, repeats: int, events: list[Event]) -> Segment:
    return Segment(start, length, repeats, (*events, (length, int(Happening.REST), 0)))


@dataclass(frozen=True, slots=True)
class _Clockwork:
    """All that the clock depends on, in ticks; runs and predictions that share it play it once."""

    period: int
    compute: int
    every: int
    channels: tuple[tuple[int, int], ...]  # of each ADC: multiplexer delay, conversion time
    dacs: int


def _clockwork(machine: Machine) -> _Clockwork:
    timing = machine.timing
    channels = tuple((s.delay_ticks, s.conversion_ticks) for s in machine.samplers)
    return _Clockwork(timing.period, timing.compute, timing.every, channels, len(machine.holders))


def _play_clockwork(clockwork: _Clockwork, until: int) -> list[Event]:
    """The events up to `until` (included), unsorted.

    Times are told in their greatest common divisor, so that clocks of one proportion, such as those of
    a sweep of T, are one clockwork.
    """
    every_time = (
        clockwork.period,
        clockwork.compute,
        clockwork.every,
        *sum(clockwork.channels, ()),
    )
    unit = math.gcd(*every_time)
    told = _Clockwork(
        clockwork.period // unit,
        clockwork.compute // unit,
        clockwork.every // unit,
        tuple((delay // unit, conversion // unit) for delay, conversion in clockwork.channels),
        clockwork.dacs,
    )
    return [(at * unit, kind, index) for at, kind, index in _simulated(told, until // unit)]


@functools.lru_cache(maxsize=8)
def _simulated(clockwork: _Clockwork, until: int) -> tuple[Event, ...]:
    """The same from the SimPy model."""
    log: list[Event] = []
    clock = simpy.Environment(initial_time=0)
    if clockwork.period:
        clock.process(_cycle_clock(clock, clockwork, log))
    clock.process(_recorder(clock, clockwork.every, log))
    clock.run(until=until + 1)
    return tuple(log)


def _cycle_clock(
    clock: simpy.Environment, clockwork: _Clockwork, log: list[Event]
) -> Generator[simpy.Event, Any, None]:
    """Start a cycle every period; a cycle longer than the period overlaps the next (a pipeline)."""
    while True:
        clock.process(_cycle(clock, clockwork, log))
        yield clock.timeout(clockwork.period)


def _cycle(
    clock: simpy.Environment, clockwork: _Clockwork, log: list[Event]
) -> Generator[simpy.Event, Any, None]:
    """One digital cycle: convert, compute, latch."""
    channels = enumerate(clockwork.channels)
    yield clock.all_of([clock.process(_convert(clock, *c, i, log)) for i, c in channels])
    log.append((_now(clock), Happening.START, 0))
    yield clock.timeout(clockwork.compute)
    log.append((_now(clock), Happening.END, 0))
    log.extend((_now(clock), Happening.LATCH, i) for i in range(clockwork.dacs))


def _convert(
    clock: simpy.Environment, delay: int, conversion: int, index: int, log: list[Event]
) -> Generator[simpy.Event, Any, None]:
    """One ADC channel: wait for the multiplexer, sample, convert."""
    yield clock.timeout(delay)
    log.append((_now(clock), Happening.SAMPLE, index))
    yield clock.timeout(conversion)
    log.append((_now(clock), Happening.CONVERT, index))


def _recorder(
    clock: simpy.Environment, every: int, log: list[Event]
) -> Generator[simpy.Event, Any, None]:
    """Ask for a row of the record every `every` ticks."""
    for _ in itertools.count():
        log.append((_now(clock), Happening.RECORD, 0))
        yield clock.timeout(every)


def _now(clock: simpy.Environment) -> int:
    """SimPy counts in what it is given; here that is whole ticks."""
    return int(clock.now)
