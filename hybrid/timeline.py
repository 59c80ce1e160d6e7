"""The timeline of a run: the clockwork's events for a stretch that repeats, as segments of events in
exact integer time.

Stage 3. `clockwork` says what happens when, and in which order what coincides is played. An event has
an offset within its segment; a segment is repeated `repeats` times, its length in ticks apart.
"""

from __future__ import annotations

import bisect
import collections
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NoReturn

from hybrid.clockwork import Event, Happening, cycle_events, in_order
from hybrid.errors import PatchError
from hybrid.machine import Machine, StepEvent, Timing
from hybrid.memo import KeptBySize
from hybrid.modes import TIMED_MODE
from hybrid.processor import Note
from hybrid.rota import Rota, TaskReport, cycles_of, overrun_text, reports, rota_until, settled
from hybrid.scale import to_seconds
from hybrid.stretches import CLOCKS, Stretches, never_repeats

# Periods without a usable common multiple are laid out event by event, up to this many events.
MOST_FLAT_EVENTS = 300_000
# Events of the timelines that are kept (25 MB), and what each timeline takes beside them.
MOST_KEPT, KEPT_BESIDE = 200_000, 100
# Different intervals between events, and the numbers in all their propagators (1 GB).
MOST_INTERVALS = 20_000
MOST_PROPAGATED = 10**8


@dataclass(frozen=True, slots=True)
class Segment:
    """Events of one stretch: (offset in ticks, kind, index), played `repeats` times."""

    start: int
    length: int
    repeats: int
    events: tuple[Event, ...]
    notes: tuple[Note, ...] = ()  # of the cycles of tasks that end in it, for each repeat


@dataclass(frozen=True, slots=True)
class Timeline:
    """The whole run as segments, back to back."""

    segments: tuple[Segment, ...]
    until: int
    cycles: int  # whole digital cycles
    rows: int  # record events
    stopped: str = ""  # why the run ends before its time: a task has overrun
    later: Stretches | None = None  # where nothing repeats: what follows the segments

    def further(self) -> Iterator[Segment]:
        """The segments that follow, each laid out when it is asked for."""
        if self.later:
            edges = edges_of(self.later.machine.steps)
            for start, first, end, events in self.later:
                last = self.later.stopped or end == self.until
                stepped = edges.within(first, end + bool(last))
                events += [(tick + first - start, kind, i) for tick, kind, i in stepped]
                yield _segment(start, end - start, 1, in_order(events), ())

    @property
    def why_stopped(self) -> str:
        """Why the run has ended before its time, as far as it is laid out; '' where it has not."""
        return self.later.why_stopped if self.later else self.stopped

    def __iter__(self) -> Iterator[Event]:
        """Every event in order, in absolute ticks (for reading and for tests)."""
        for segment in itertools.chain(self.segments, self.further()):
            for repeat in range(segment.repeats):
                base = segment.start + repeat * segment.length
                for offset, kind, index in segment.events:
                    yield base + offset, kind, index

    def reports(self, machine: Machine, until: int | None = None) -> tuple[TaskReport, ...]:
        """What the cycles of every task come to, in the whole run or up to an instant."""
        if self.later:
            return self.later.reports(until)
        counted = []
        for segment in self.segments:
            repeats, rest = segment.repeats, 0
            if until is not None and until < segment.start + repeats * segment.length:
                repeats, rest = divmod(max(until - segment.start, 0), max(segment.length, 1))
            for note in segment.notes:
                times = repeats + (note.tick - segment.start <= rest and repeats < segment.repeats)
                counted.append((note, times))
        played = self.until if until is None else until
        return reports(machine, [(note, times) for note, times in counted if times], played)


def build_timeline(machine: Machine, seed: int = 0) -> Timeline:
    """Lay out the events of the machine's whole run; `seed` draws how late clocks are.

    What comes together too seldom, of tasks, of a program and of the record, is laid out as what never
    does: stretch by stretch, with the same events. Raises PatchError where the periods of sources and of
    the record have no common multiple and the run is too long to be laid out event by event.
    """
    if never_repeats(machine):
        return _piecemeal(machine, seed)
    if not (machine.timing.tasks or machine.timing.period):
        return _kept.of([_clocks(machine)], lambda _: [_laid_out(machine)])[0]
    at_once = _kept.of([_clocks(machine)], lambda _: [_if_not_too_much(machine)])[0]
    return at_once if at_once.segments else _piecemeal(machine, seed)


def _if_not_too_much(machine: Machine) -> Timeline:
    """The timeline, or one of no segments: that it is too much is worth keeping as well."""
    try:
        return _laid_out(machine)
    except _TooMuch:
        return Timeline((), machine.timing.until, 0, 0)


def _piecemeal(machine: Machine, seed: int) -> Timeline:
    """A timeline that is laid out as the run comes to it."""
    timing = machine.timing
    until, cycles = timing.until, timing.until // timing.period if timing.period else 0
    return Timeline((), until, cycles, until // timing.every + 1, later=stretches_of(machine, seed))


def stretches_of(machine: Machine, seed: int) -> Stretches:
    """The stretches of a run from its beginning, none of more events than half the intervals that the
    engine keeps."""
    clock = machine.timing.period or machine.timing.every
    events = max(_clock_events(machine, CLOCKS * clock) + len(machine.steps), 1)
    return Stretches(machine, seed, CLOCKS * most_intervals(machine) // (2 * events))


class _TooMuch(PatchError):
    """The clocks come together too seldom for the run to be laid out before it is played."""


@dataclass(frozen=True, slots=True)
class _Clocks:
    """All of a machine that its timeline depends on."""

    timing: Timing
    steps: tuple[tuple[int, int, int | None], ...]  # when, not to which value
    samplers: tuple[tuple[int, int, int], ...]  # delay and conversion in ticks, task
    holders: tuple[int, ...]  # task
    most_intervals: int


def _clocks(machine: Machine) -> _Clocks:
    samplers = tuple((s.delay_ticks, s.conversion_ticks, s.task) for s in machine.samplers)
    holders, most = tuple(h.task for h in machine.holders), most_intervals(machine)
    steps = tuple((s.at_ticks, s.every_ticks, s.times) for s in machine.steps)
    return _Clocks(machine.timing, steps, samplers, holders, most)


# The runs of a batch mostly share their clocks, and a prediction and a run of one machine often do.
_kept: KeptBySize[_Clocks, Timeline] = KeptBySize(
    MOST_KEPT, lambda timeline: sum(len(s.events) for s in timeline.segments) + KEPT_BESIDE
)


def _laid_out(machine: Machine) -> Timeline:
    machine, stopped = _until_stopped(machine)
    timing, edges = machine.timing, edges_of(machine.steps)
    cycles = timing.until // timing.period if timing.period else 0
    rows = timing.until // timing.every + 1
    machine, edges = _few_rows_alone(machine, edges)
    stretch, warm_up = _repetition(machine)
    together = math.lcm(stretch, *(period for _, period, _ in edges.waves))
    laid_out = _clock_events(machine, (warm_up + 1) * together)
    if timing.until >= (warm_up + 2) * together and (
        together == stretch or laid_out <= MOST_FLAT_EVENTS
    ):
        stretch = together
    else:  # a wave that never falls in with the clock: one edge after the other
        edges = _one_by_one(machine, edges.rows)
    if timing.until < (warm_up + 2) * stretch:
        segments = _flat(machine, edges)
    else:
        segments = _tiled(machine, stretch, warm_up, edges)
    _refuse_many_intervals(machine, segments)
    return Timeline(tuple(segments), timing.until, cycles, rows, stopped)


def _few_rows_alone(machine: Machine, edges: Edges) -> tuple[Machine, Edges]:
    """A machine whose clock takes no rows, and the rows among the edges, each by itself, where rows are
    so far apart that a stretch from one to the next is too much to lay out; else as they are.

    What repeats then is the clock alone, interrupted for every row.
    """
    timing = machine.timing
    stretch, warm_up = _repetition(machine)
    is_flat = timing.until < (warm_up + 2) * stretch
    laid_out = _clock_events(machine, timing.until if is_flat else (warm_up + 1) * stretch)
    if not timing.period or laid_out <= MOST_FLAT_EVENTS:
        return machine, edges
    rows = range(0, timing.until + 1, timing.every)  # there may be too many to list
    alone = replace(machine, timing=replace(timing, every=0))
    stretch = stretch_of(alone)
    if len(rows) * (_clock_events(alone, stretch) + 2) > MOST_FLAT_EVENTS:
        return machine, edges
    return alone, replace(edges, rows=tuple(rows))


def stretch_of(machine: Machine) -> int:
    """Ticks after which the clocks of the program or of all tasks, and of the record, come together."""
    timing = machine.timing
    periods = [task.period for task in timing.tasks] or [timing.period]
    return math.lcm(*(t for t in (*periods, timing.every) if t))


def _repetition(machine: Machine) -> tuple[int, int]:
    """Ticks of a stretch, and how many of them pass until each is like the one before; a stretch that
    is longer than the run where none is found."""
    stretch, timing = stretch_of(machine), machine.timing
    if not timing.tasks:
        return stretch, -(-(machine.latency_ticks + 1) // stretch)
    found = None
    if timing.until >= 3 * stretch and _clock_events(machine, stretch) <= MOST_FLAT_EVENTS:
        found = settled(machine, stretch, MOST_FLAT_EVENTS)
    if found is None:
        return max(stretch, timing.until + 1), 1
    after, again = found
    return again * stretch, after // again


def _until_stopped(machine: Machine) -> tuple[Machine, str]:
    """The machine with its run ending at the first overrun that stops it, and why; or as it is."""
    timing = machine.timing
    if not any(task.overrun == "stop" for task in timing.tasks):
        return machine, ""
    stretch, warm_up = _repetition(machine)
    until = min(timing.until + 1, (warm_up + 1) * stretch)
    note = _rota(machine, until).stopped
    if note is None:
        return machine, ""
    return replace(machine, timing=replace(timing, until=note.tick)), overrun_text(machine, note)


def _rota(machine: Machine, until: int) -> Rota:
    """What the tasks do before an instant, in order; refused where that is too much."""
    _refuse_too_many(machine, until, Edges((), ()))
    return rota_until(machine, until)


def _clock_log(machine: Machine, until: int) -> tuple[list[Event], tuple[Note, ...]]:
    """The events of program or tasks and of the record up to `until` (included), in order, and what
    became of the cycles of tasks."""
    timing = machine.timing
    if timing.tasks:
        rota = rota_until(machine, until + 1)
        taken = range(0, until + 1, timing.every) if timing.every else ()
        rows = [(tick, int(Happening.RECORD), 0) for tick in taken]
        return in_order([*rota.events, *rows]), rota.notes
    return cycle_events(cycles_of(machine), until), ()


@dataclass(frozen=True, slots=True)
class Edges:
    """When sources step: once, in order of time, and waves as (first, period, index), all in ticks."""

    once: tuple[tuple[int, int], ...]  # tick, index
    waves: tuple[tuple[int, int, int], ...]
    rows: tuple[int, ...] = ()  # of the record, where it has no part in what repeats

    def within(self, start: int, end: int) -> list[Event]:
        """The events from `start` until before `end`, counted from `start`."""
        low, high = (bisect.bisect_left(self.once, (tick, -1)) for tick in (start, end))
        found = [(tick - start, index) for tick, index in self.once[low:high]]
        for first, period, index in self.waves:
            begin = first + max(0, -(-(start - first) // period)) * period
            found += [(tick - start, index) for tick in range(begin, end, period)]
        low, high = (bisect.bisect_left(self.rows, tick) for tick in (start, end))
        rows = [(tick - start, int(Happening.RECORD), 0) for tick in self.rows[low:high]]
        return [*((tick, int(Happening.SOURCE), index) for tick, index in found), *rows]

    def breaks(self) -> list[int]:
        """Ticks at which a stretch is not like the one before it."""
        edges = [tick for tick, _ in self.once] + [first for first, _, _ in self.waves]
        return [*edges, *self.rows]


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
        raise _TooMuch(
            f"the run has {length / period:.3g} operations of {to_seconds(period):.12g} s, which have "
            "no short common multiple with the period and the record interval (at most "
            f"{MOST_FLAT_EVENTS}); make every: a fraction of an operation",
            machine.patch.modes.place,
        )
    place = next(c.place for c in machine.patch.components if c.name == name)
    raise _TooMuch(
        f"component {name!r} has a period of {to_seconds(period):.12g} s, {length / period:.3g} of them "
        f"in {to_seconds(length):.6g} s that must be laid out edge by edge (at most "
        f"{MOST_FLAT_EVENTS}); make it, the record interval and the digital period small multiples of "
        "each other",
        place,
    )


def _one_by_one(machine: Machine, rows: tuple[int, ...]) -> Edges:
    """The edges of all sources until the end of the run, each by itself."""
    until, edges = machine.timing.until, edges_of(machine.steps)
    for first, period, index in edges.waves:
        if (until - first) // period > MOST_FLAT_EVENTS:
            _refuse_wave(machine, index, until - first)
    events = edges.within(0, until + 1)
    return Edges(tuple(sorted((tick, index) for tick, _, index in events)), (), rows)


def _clock_events(machine: Machine, until: int) -> int:
    """How many events of cycles and record there are, about."""
    timing = machine.timing
    rows = until // timing.every if timing.every else 0
    if timing.tasks:
        served = collections.Counter(s.task for s in machine.samplers for _ in range(2))
        served.update(h.task for h in machine.holders)
        clocked = [(i, task.period) for i, task in enumerate(timing.tasks) if task.period]
        return rows + sum((2 + served[i]) * (until // period) for i, period in clocked)
    per_cycle = 3 + 2 * len(machine.samplers) + len(machine.holders)
    return rows + per_cycle * (until // timing.period if timing.period else 0)


def _refuse_too_many(machine: Machine, until: int, edges: Edges) -> None:
    """Laying out events one by one is for short stretches only."""
    for _, period, index in edges.waves:
        if until // period > MOST_FLAT_EVENTS:
            _refuse_wave(machine, index, until)
    timing, count = machine.timing, _clock_events(machine, until)
    if count > MOST_FLAT_EVENTS:
        periods = [task.period for task in timing.tasks] or [timing.period]
        told = ", ".join(f"{to_seconds(period):.12g} s" for period in sorted(periods))
        raise _TooMuch(
            f"{_never_together(machine, told)}, so {count:.3g} events would have to be laid out one by "
            f"one (at most {MOST_FLAT_EVENTS}); make one a small multiple of the other",
            machine.patch.run.until.place,
        )


def _never_together(machine: Machine, periods: str) -> str:
    """Which clocks have no short common multiple."""
    timing = machine.timing
    several = "s" * (len(timing.tasks) > 1)
    if not timing.every:
        return f"the period{several} {periods} have no short common multiple"
    every_s, stretch_s = to_seconds(timing.every), to_seconds(stretch_of(machine))
    return (
        f"the period{several} {periods} and the record interval {every_s:.12g} s come together only "
        f"every {stretch_s:.6g} s"
    )


def seldom_text(machine: Machine) -> str:
    """Which clocks hardly ever come together, and what that costs; '' where they do."""
    if never_repeats(machine) or machine.elements or build_timeline(machine).later is None:
        return ""
    periods = [task.period for task in machine.timing.tasks] or [machine.timing.period]
    told = ", ".join(f"{to_seconds(period):.12g} s" for period in sorted(periods))
    return (
        f"{_never_together(machine, told)}: hardly an interval between events comes again, and each is "
        "prepared by itself, which takes far longer; make one a small multiple of the other"
    )


def most_intervals(machine: Machine) -> int:
    """How many different intervals between events a run may have."""
    if machine.elements:  # no propagators
        return 2 * MOST_FLAT_EVENTS
    analog = machine.analog
    size = (len(analog.states) + len(analog.inputs)) * (len(analog.states) + len(analog.signals))
    return min(MOST_INTERVALS, MOST_PROPAGATED // max(size, 1))


def _refuse_many_intervals(machine: Machine, segments: list[Segment]) -> None:
    """Every interval between events has a propagator of its own, which costs time and memory."""
    most = most_intervals(machine)
    intervals = {
        after[0] - before[0]
        for segment in segments
        for before, after in itertools.pairwise(((0, 0, 0), *segment.events))
    }
    if len(intervals) > most:
        raise _TooMuch(
            f"the run has {len(intervals)} different intervals between events (at most {most}); "
            "make the record interval and the period small multiples of each other",
            machine.patch.run.until.place,
        )


def _flat(machine: Machine, edges: Edges) -> list[Segment]:
    until = machine.timing.until
    _refuse_too_many(machine, until, edges)
    clock, notes = _clock_log(machine, until)
    return [_segment(0, until, 1, in_order([*clock, *edges.within(0, until + 1)]), notes)]


def _tiled(machine: Machine, stretch: int, warm_up: int, edges: Edges) -> list[Segment]:
    """Warm-up, then one stretch repeated, broken where a source steps or begins, then the rest."""
    until = machine.timing.until
    _refuse_too_many(machine, (warm_up + 1) * stretch, edges)
    events, notes = _clock_log(machine, (warm_up + 1) * stretch)
    first = warm_up * stretch
    before = tuple(note for note in notes if note.tick < first)
    again = [n for n in notes if first <= n.tick < first + stretch]
    clock = [(t - first, k, i) for t, k, i in events if first <= t < first + stretch]

    def pattern(number: int) -> list[Event]:
        return in_order([*clock, *edges.within(number * stretch, (number + 1) * stretch)])

    def noted(number: int) -> tuple[Note, ...]:
        later = (number - warm_up) * stretch
        return tuple(replace(note, tick=note.tick + later) for note in again)

    whole = until // stretch
    broken = {tick // stretch for tick in edges.breaks() if first <= tick < whole * stretch}
    head = [e for e in events if e[0] < first] + edges.within(0, first)
    segments = [_segment(0, first, 1, in_order(head), before)]
    at = warm_up
    for number in (*sorted(broken), whole):
        if number > at:
            segments.append(_segment(at * stretch, stretch, number - at, pattern(at), noted(at)))
        if number < whole:
            segments.append(_segment(number * stretch, stretch, 1, pattern(number), noted(number)))
        at = number + 1
    tail = [e for e in clock if e[0] <= until - whole * stretch]
    tail += edges.within(whole * stretch, until + 1)
    ended = tuple(note for note in noted(whole) if note.tick <= until)
    segments.append(_segment(whole * stretch, until - whole * stretch, 1, in_order(tail), ended))
    return segments


def _segment(
    start: int, length: int, repeats: int, events: list[Event], notes: tuple[Note, ...]
) -> Segment:
    return Segment(start, length, repeats, (*events, (length, int(Happening.REST), 0)), notes)
