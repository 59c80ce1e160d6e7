"""A machine and its timeline as the arrays that the kernel plays.

Stage 4. Each function makes one of the kernel's tuples; what the runs of a sweep share is made once.
"""

from __future__ import annotations

import functools

import numpy as np

from hybrid.clockwork import Happening
from hybrid.engine import kernel
from hybrid.engine.arrays import (
    ADC,
    DAC,
    PEN,
    PROGRAM,
    REMEMBERED,
    SHARED,
    SLOTS,
    SOURCE_STEP,
    Coupling,
    Deck,
    Pens,
    Plant,
    State,
    Structs,
    lined_up,
)
from hybrid.engine.helper_functions import PER_SITE
from hybrid.engine.lookup import new_places, pack
from hybrid.engine.propagator import propagators
from hybrid.machine import Analog, Floats, Holder, Machine, Pen, Sampler, StepEvent
from hybrid.meshes import searches
from hybrid.scale import to_seconds
from hybrid.tables import Axis, Table
from hybrid.tape import Tape
from hybrid.tightening import tighten
from hybrid.timeline import Segment

# The cue of each kind of event; nothing is done at the end of a stretch.
_CUES = {
    Happening.SAMPLE: kernel.SAMPLE,
    Happening.CONVERT: kernel.CONVERT,
    Happening.START: kernel.START,
    Happening.END: kernel.END,
    Happening.LATCH: kernel.LATCH,
    Happening.SOURCE: kernel.SOURCE,
    Happening.RECORD: kernel.RECORD,
}
Cue = tuple[int, int, int]  # what, which, instant
_JUMPS = (Happening.LATCH, Happening.SOURCE)


def cues_of(segment: Segment, numbers: dict[int, int], looks: bool) -> tuple[list[Cue], list[int]]:
    """The cues of a segment, and the offsets of its instants in ticks.

    numbers: of the intervals met so far, which this adds to; looks: whether signals can jump.
    """
    cues: list[Cue] = []
    offsets = [0]
    jumped = False
    for offset, kind, index in segment.events:
        now, instant = offsets[-1], len(offsets) - 1
        if jumped and (offset > now or kind not in _JUMPS):
            cues.append((kernel.LOOK, 0, instant))
            jumped = False
        if offset > now:
            interval = numbers.setdefault(offset - now, len(numbers))
            instant += 1
            cues.append((kernel.ADVANCE, interval, instant))
            offsets.append(offset)
        if kind != Happening.REST:
            cues.append((_CUES[Happening(kind)], index, instant))
            jumped = looks and kind in _JUMPS
    if not cues:  # a stretch of no length in which nothing happens
        cues.append((kernel.LOOK, 0, 0))
    return _at_once(cues), offsets


def _at_once(cues: list[Cue]) -> list[Cue]:
    """A sample that is converted at the same instant is taken by one cue."""
    converted = {cue[1:] for cue in cues if cue[0] == kernel.CONVERT}
    both = {cue[1:] for cue in cues if cue[0] == kernel.SAMPLE} & converted
    taken = [
        (kernel.TAKE, *cue[1:]) if cue[0] == kernel.SAMPLE and cue[1:] in both else cue
        for cue in cues
    ]
    return [cue for cue in taken if cue[0] != kernel.CONVERT or cue[1:] not in both]


def sums_of(machine: Machine) -> tuple[int, ...]:
    """Signals that are no states: combinations of states and inputs."""
    return () if machine.elements else _sums(machine.analog)


# The runs of a sweep of T share their analog side.
@functools.lru_cache(maxsize=16)
def _sums(analog: Analog) -> tuple[int, ...]:
    states = set(analog.states)
    return tuple(i for i, name in enumerate(analog.signals) if name not in states)


def _padding(rows: int) -> int:
    """Entries before the first of `rows`, so that they end with a block of eight."""
    return -rows % 8


def plant_of(machine: Machine, intervals: list[int]) -> Plant:
    """The analog side of a linear machine, ready to be advanced over these intervals (ticks)."""
    analog, sums = machine.analog, sums_of(machine)
    n, m, k = len(analog.states), len(analog.inputs), len(sums)
    all_of = propagators([(analog, to_seconds(t)) for t in intervals])
    rank = max((p.spread.shape[1] for p in all_of), default=0)
    first = _padding(k + n)
    rows = np.zeros((len(all_of), first + k + n, n + m + rank))
    sum_rows = analog.c[list(sums)]
    for q, p in enumerate(all_of):
        columns = np.hstack([p.change, p.spread])
        rows[q, first + k :, : columns.shape[1]] = columns
        with np.errstate(over="ignore", invalid="ignore"):  # of a patch that runs away at once
            rows[q, first : first + k, : columns.shape[1]] = sum_rows[:, :n] @ columns
            rows[q, first : first + k, : n + m] += sum_rows
    blocks = rows.reshape(len(all_of), -1, 8, n + m + rank).transpose(0, 1, 3, 2)
    change = lined_up(*blocks.shape)
    change[...] = blocks
    return Plant(
        change,
        (np.arange(first + k + n) >= first + k).astype(np.float64),
        np.array([p.spread.shape[1] for p in all_of], dtype=np.int64),
        np.array(_places(machine), dtype=np.uint32),
        np.ascontiguousarray(sum_rows[:, n:].T),
    )


def _places(machine: Machine) -> tuple[int, ...]:
    """Where each signal stands in the kernel's v."""
    if machine.elements:
        return tuple(range(len(machine.analog.signals) + 1))  # the last is the machine's mode
    return _linear_places(machine.analog)


@functools.lru_cache(maxsize=16)
def _linear_places(analog: Analog) -> tuple[int, ...]:
    sums = _sums(analog)
    first = _padding(len(sums) + len(analog.states))
    place = {analog.signals[s]: first + i for i, s in enumerate(sums)}
    place |= {name: first + len(sums) + i for i, name in enumerate(analog.states)}
    return tuple(place[s] for s in analog.signals)


def coupling_of(machine: Machine) -> Coupling:
    """Converters and steps."""
    places = _places(machine) if machine.samplers else ()
    return _coupled(places, machine.samplers, machine.holders, machine.steps)


# The runs of a sweep or batch mostly share converters and program.
@functools.lru_cache(maxsize=16)
def _coupled(
    places: tuple[int, ...],
    samplers: tuple[Sampler, ...],
    holders: tuple[Holder, ...],
    steps: tuple[StepEvent, ...],
) -> Coupling:
    adcs = [
        (places[s.signal], i, s.to_si, s.range_mu, s.step_mu, s.clips)
        for i, s in enumerate(samplers)
    ]
    dacs = [(h.word, h.input, h.to_mu, h.step_mu, h.clips) for h in holders]
    sources = [(s.input, s.value) for s in steps]
    return Coupling(
        np.array(adcs, dtype=ADC), np.array(dacs, dtype=DAC), np.array(sources, dtype=SOURCE_STEP)
    )


@functools.lru_cache(maxsize=16)
def deck_of(tape: Tape) -> tuple[Deck, Floats]:
    """The programs as the kernel plays them, and the first values of their registers."""
    if len(tape.length_of):
        return written_deck(tape), tape.registers
    tight = tighten(tape)
    deck = Deck(
        np.zeros((0, 4), dtype=np.int32),
        tight.bursts,
        tight.steps,
        tight.asks,
        tape.word_registers.astype(np.uint32),
        _structs(tape.memory, REMEMBERED),
        *pack(tight.finds, tight.looks),
        tape.length_of,
        tape.lengths,
        np.zeros(0, dtype=np.int32),
        _structs(tape.shared, SHARED),
        _structs(
            np.column_stack([tight.starts[:, 0], tape.starts[:, 1:], tight.starts[:, 1]]), PROGRAM
        ),
    )
    return deck, tight.registers


def _structs(columns: np.ndarray, kind: np.dtype[np.void]) -> Structs:
    """Rows of whole numbers as structs."""
    return np.ascontiguousarray(columns, dtype=np.uint32).view(kind).reshape(-1)


def written_deck(tape: Tape) -> Deck:
    """Programs whose words round, as they are written: every site has searches of its own."""
    finds, looks = list[Axis](), list[tuple[Table, range] | None]()
    for site in tape.sites:
        first = len(finds)
        finds += searches(site.table) if site.table else ()
        looks.append((site.table, range(first, len(finds))) if site.table else None)
    return Deck(
        tape.code,
        np.zeros((0, 3), dtype=np.int32),
        np.zeros((0, 4), dtype=np.uint32),
        np.zeros((0, 3), dtype=np.int32),
        tape.word_registers.astype(np.uint32),
        _structs(tape.memory, REMEMBERED),
        *pack(finds, looks),
        tape.length_of,
        tape.lengths,
        np.array(tape.owner, dtype=np.int32),
        _structs(tape.shared, SHARED),
        _structs(
            np.column_stack([tape.starts, np.zeros(len(tape.starts), dtype=np.int64)]), PROGRAM
        ),
    )


def pens_of(machine: Machine, pens: tuple[Pen, ...]) -> Pens:
    """Where the columns of the record come from."""
    source = {"analog": 0, "dac": 0, "mode": 0, "adc": 1, "word": 2}
    places = _places(machine)
    drawn = [
        (source[p.kind], p.index if source[p.kind] else places[p.index], p.factor) for p in pens
    ]
    return Pens(np.array(drawn, dtype=PEN))


def state_of(machine: Machine, plant: Plant) -> State:
    """What changes during the run, as it is at t = 0."""
    analog, timing = machine.analog, machine.timing
    latency = timing.compute // timing.period + 2 if timing.period and not timing.tasks else 2
    words = len(machine.tape.words)
    watched = len(analog.signals) + len(machine.samplers) + len(machine.holders) + words
    z = np.concatenate([analog.x0, analog.u0])
    sums = list(sums_of(machine))
    rank = plant.change.shape[2] - len(analog.x0) - len(analog.u0)
    padding = np.zeros(_padding(len(sums) + len(analog.x0)))
    deck, registers = deck_of(machine.tape)
    v = lined_up(len(padding) + len(sums) + len(z) + rank)
    v[: len(v) - rank] = np.concatenate([padding, analog.c[sums] @ z, z])
    return State(
        v,
        lined_up(len(padding) + len(sums) + len(analog.x0)),
        np.zeros(len(machine.samplers)),
        registers.copy(),
        np.zeros((latency, words)),
        np.zeros(max(len(timing.tasks), 1), dtype=SLOTS),
        machine.tape.registers[machine.tape.word_registers],
        np.zeros(7, dtype=np.int64),
        np.zeros((watched, 6), dtype=np.int64),
        np.zeros((watched, 2)),
        lined_up(2, len(v) - len(z) - rank + len(analog.x0)),
        np.zeros((len(machine.tape.sites) * PER_SITE + 1, 6)),
        *new_places(deck.axes),
    )


def draws_before(cues: np.ndarray, draws: np.ndarray) -> np.ndarray:
    """Cumulative draws before each cue of a repeat; the last entry is the whole repeat."""
    if not draws.any():
        return np.zeros(len(cues) + 1, dtype=np.int64)
    per_cue = np.zeros(len(cues), dtype=np.int64)
    advances = cues["what"] == kernel.ADVANCE
    per_cue[advances] = draws[cues["which"][advances]]
    return np.concatenate([[0], np.cumsum(per_cue)])
