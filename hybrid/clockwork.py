"""The digital machine's clockwork: SimPy models of cycles, conversions and computing in exact time.

Stage 3; with `processor`, the only module that imports simpy. The order of coincident events is written
here and nowhere else. With x- the analog state just before an instant and x+ just after:

    SAMPLE   ADCs sample; they see x-, outputs of the DACs as they were held until now
    CONVERT  conversions that end: words become readable
    START    programs whose conversions are complete read their words and compute
    END      programs whose compute time ends: their results become readable
    LATCH    DACs take those results: from here on it is x+
    SOURCE   sources step, and so does the mode of a machine that time sets
    RECORD   a row of the record is taken; it shows x+
    REST     nothing; the analog side runs on to the end of the stretch

Ties within one kind go by name. Several tasks on one processor START and END in the order in which
it does them, which at one instant is: the task whose compute time is over ENDs; then of those that are
ready the first by priority, then by name, has the processor: it STARTs, unless it goes on, and where its
compute time is 0 it ENDs before the next is chosen. So a task that takes over at an instant reads what
the one before has just published.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Generator, Iterable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import simpy


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


Event = tuple[int, int, int]  # tick, Happening, index of the ADC, task, DAC or step


def in_order(events: Iterable[Event]) -> list[Event]:
    """Events as they are played; STARTs and ENDs of one instant stay in the order given."""

    def place(event: Event) -> Event:
        tick, kind, index = event
        computes = kind in (Happening.START, Happening.END)
        return (tick, int(Happening.START), 0) if computes else (tick, kind, index)

    return sorted(events, key=place)


@dataclass(frozen=True, slots=True)
class Cycles:
    """All that the clock of one program depends on, in ticks; runs and predictions that share it play
    it once."""

    period: int
    compute: int
    every: int  # 0: no rows are taken
    channels: tuple[tuple[int, int], ...]  # of each ADC: multiplexer delay, conversion time
    dacs: int


def cycle_events(cycles: Cycles, until: int) -> list[Event]:
    """The events of one program and of the record up to `until` (included), in order.

    Times are told in their greatest common divisor, so that clocks of one proportion, such as those of
    a sweep of T, are one clockwork.
    """
    unit = math.gcd(cycles.period, cycles.compute, cycles.every, *sum(cycles.channels, ()))
    told = Cycles(
        cycles.period // unit,
        cycles.compute // unit,
        cycles.every // unit,
        tuple((delay // unit, conversion // unit) for delay, conversion in cycles.channels),
        cycles.dacs,
    )
    return sorted((at * unit, kind, index) for at, kind, index in _simulated(told, until // unit))


class CycleClock:
    """One program from t = 0 on, as far as it has been run; `log` grows with it, like a Processor's.

    Every cycle does what the first does, a period later; none overruns, so there is nothing to note.
    """

    stopped: None = None

    def __init__(self, cycles: Cycles) -> None:
        """Nothing has happened yet; rows are not its business."""
        self.log: list[Event] = []
        self.notes: list[Any] = []
        self._period, self._now = cycles.period, 0
        longest = cycles.compute + max(map(sum, cycles.channels), default=0)
        alone = replace(
            cycles, period=longest + 1, every=0
        )  # so late that one cycle is all there is
        self._pattern = cycle_events(alone, longest)

    def run(self, until: int) -> None:
        """Go on to the instant `until`, of which nothing is done yet."""
        period, found = self._period, []
        for offset, kind, index in self._pattern:
            first = max(-((offset - self._now) // period), 0)
            end = -((offset - until) // period)
            found += [(k * period + offset, kind, index) for k in range(first, end)]
        self.log += sorted(found)
        self._now = max(self._now, until)


@functools.lru_cache(maxsize=8)
def _simulated(cycles: Cycles, until: int) -> tuple[Event, ...]:
    """The same from the SimPy model."""
    log: list[Event] = []
    clock = simpy.Environment(initial_time=0)
    if cycles.period:
        clock.process(_cycle_clock(clock, cycles, log))
    if cycles.every:
        clock.process(_recorder(clock, cycles.every, log))
    clock.run(until=until + 1)
    return tuple(log)


def _cycle_clock(
    clock: simpy.Environment, cycles: Cycles, log: list[Event]
) -> Generator[simpy.Event, Any, None]:
    """Start a cycle every period; a cycle longer than the period overlaps the next (a pipeline)."""
    while True:
        clock.process(_cycle(clock, cycles, log))
        yield clock.timeout(cycles.period)


def _cycle(
    clock: simpy.Environment, cycles: Cycles, log: list[Event]
) -> Generator[simpy.Event, Any, None]:
    """One digital cycle: convert, compute, latch."""
    channels = enumerate(cycles.channels)
    yield clock.all_of([clock.process(_convert(clock, *c, i, log)) for i, c in channels])
    log.append((_now(clock), Happening.START, 0))
    yield clock.timeout(cycles.compute)
    log.append((_now(clock), Happening.END, 0))
    log.extend((_now(clock), Happening.LATCH, i) for i in range(cycles.dacs))


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
