"""The digital machine's clockwork: a SimPy model of cycles, conversions and computing, played once
for a stretch that repeats, and laid out as segments of events in exact integer time.

Stage 3, and the only module that imports simpy. The order of coincident events is written here and
nowhere else. With x- the analog state just before an instant and x+ just after:

    SAMPLE   ADCs sample; they see x-, outputs of the DACs as they were held until now
    CONVERT  conversions that end: words become readable
    START    programs whose conversions are complete read their words and compute
    END      programs whose compute time ends: their results become readable
    LATCH    DACs take those results: from here on it is x+
    SOURCE   step sources change
    RECORD   a row of the record is taken; it shows x+
    REST     nothing; the analog side runs on to the end of the stretch

Ties within one kind go by name. An event has an offset within its segment; a segment is repeated
`repeats` times, its length in ticks apart.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import simpy

from hybrid.errors import PatchError
from hybrid.machine import Machine
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
    steps = [(s.at_ticks, int(Happening.SOURCE), i) for i, s in enumerate(machine.steps)]
    steps = [s for s in steps if s[0] <= timing.until]
    warm_up = -(-(machine.latency_ticks + 1) // stretch)
    if timing.until < (warm_up + 2) * stretch:
        segments = _flat(machine, steps)
    else:
        segments = _tiled(machine, stretch, warm_up, steps)
    _refuse_many_intervals(machine, segments)
    return Timeline(
        tuple(segments),
        timing.until,
        timing.until // timing.period if timing.period else 0,
        timing.until // timing.every + 1,
    )


def _refuse_too_many(machine: Machine, until: int) -> None:
    """Laying out events one by one is for short stretches only."""
    timing = machine.timing
    per_cycle = 3 + 2 * len(machine.samplers) + len(machine.holders)
    count = until // timing.every
    if timing.period:
        count += per_cycle * (until // timing.period)
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


def _flat(machine: Machine, steps: list[Event]) -> list[Segment]:
    until = machine.timing.until
    _refuse_too_many(machine, until)
    return [_segment(0, until, 1, sorted([*_play_clockwork(_clockwork(machine), until), *steps]))]


def _tiled(machine: Machine, stretch: int, warm_up: int, steps: list[Event]) -> list[Segment]:
    """Warm-up, then one stretch repeated, broken where a step source changes, then the rest."""
    until = machine.timing.until
    _refuse_too_many(machine, (warm_up + 1) * stretch)
    events = sorted(_play_clockwork(_clockwork(machine), (warm_up + 1) * stretch))
    first = warm_up * stretch
    pattern = [(t - first, k, i) for t, k, i in events if first <= t < first + stretch]
    whole = until // stretch
    broken = {tick // stretch for tick, _, _ in steps if first <= tick < whole * stretch}
    head = [e for e in events if e[0] < first] + [s for s in steps if s[0] < first]
    segments = [_segment(0, first, 1, sorted(head))]
    at = warm_up
    for number in sorted(broken):
        if number > at:
            segments.append(_segment(at * stretch, stretch, number - at, pattern))
        inside = [(t - number * stretch, k, i) for t, k, i in steps if t // stretch == number]
        segments.append(_segment(number * stretch, stretch, 1, sorted(pattern + inside)))
        at = number + 1
    if whole > at:
        segments.append(_segment(at * stretch, stretch, whole - at, pattern))
    tail = [e for e in pattern if e[0] <= until - whole * stretch]
    tail += [(t - whole * stretch, k, i) for t, k, i in steps if t >= whole * stretch]
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
