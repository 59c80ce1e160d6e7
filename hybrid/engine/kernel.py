"""The compiled kernel: advances the analog state from instant to instant and does what happens then.

Stage 4. Compiled once and cached on disk; every patch, period and parameter is data. It allocates
nothing, draws nothing (normal draws come in a buffer) and never looks at a clock: an instant says by
index which propagator leads to it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Score(NamedTuple):
    """The instants of one segment, a row each: what happens then, in the order of the columns.

    Columns: the propagator that leads to the instant (-1: none), then half-open ranges of ADCs that
    sample and ADCs that convert, counts of programs that start and that end, ranges of DACs that latch
    and of step sources that change, and the number of record events.
    """

    instants: npt.NDArray[np.int32]  # (instants, 12)


class Plant(NamedTuple):
    """Analog side, for v = [k sums, n states, m held inputs, r normal draws].

    Every signal is an entry of v; a sum is a signal without lag, a combination of states and inputs.
    The rows of `change` are the k sums (new values) and the n states (their changes), in blocks of
    four that lie side by side in memory: that is what one vector instruction takes.
    """

    change: Floats  # (intervals, blocks, n + m + r, 4)
    draws: Ints  # (intervals,): normal draws each propagator consumes
    signal: Ints  # (signals,): place in v
    reach: Floats  # (m, k): what a unit change of each input does to the sums at once


class Coupling(NamedTuple):
    """Converters: rows of (signal or word, register or input) and their figures."""

    adc: Ints  # (adcs, 2): signal, register
    adc_figures: Floats  # (adcs, 4): SI per machine unit, range, step or 0, clips
    dac: Ints  # (dacs, 2): word, input (counted among the m)
    dac_figures: Floats  # (dacs, 3): machine units per SI, step or 0, clips
    steps: Ints  # (steps,): input
    step_values: Floats


class Deck(NamedTuple):
    """The program."""

    code: npt.NDArray[np.int32]
    words: npt.NDArray[np.int32]
    memory: npt.NDArray[np.int32]


class Pens(NamedTuple):
    """What a row of the record holds: (0 signal | 1 ADC word | 2 word, index), times a factor."""

    source: Ints  # (pens, 2)
    factor: Floats


class State(NamedTuple):
    """All that changes during a run; owned by the run."""

    v: Floats  # (k + n + m + r,)
    next_v: Floats  # (4 * blocks,)
    sample: Floats  # (adcs,): held by sample and hold
    registers: Floats
    ring: Floats  # (depth, words): results on their way
    words: Floats  # (words,): results that can be read
    counts: Ints  # see the constants below
    overload: Ints  # (signals + adcs + dacs, 6): see the constants below
    beyond: Floats  # (signals + adcs + dacs, 2): first and worst value


# Columns of Score.instants; a range takes two.
INTERVAL, SAMPLE, CONVERT, START, END, LATCH, SOURCE, RECORD = 0, 1, 3, 5, 6, 7, 9, 11

# Indices into State.counts: slots of the ring, rows to skip, rows written, draws used, place in the
# segment.
STARTED, ENDED, SKIP, ROWS, DRAWS, REPEAT, INSTANT = range(7)
# Indices into a row of State.overload: how many instants beyond range, the first (repeat, instant), the
# worst, and a number for the last instant noted, so that x- and x+ count as one.
TIMES, FIRST_REPEAT, FIRST_INSTANT, WORST_REPEAT, WORST_INSTANT, LAST = range(6)

# Why the kernel came back.
DONE, PAUSED, RUNAWAY, NOT_FINITE = range(4)

# Beyond this many machine units a run means nothing any more and soon overflows.
RUNAWAY_MU = 1e12


def compiled(function: Any) -> Any:
    """Compile at first call, keep on disk, release the interpreter lock, follow IEEE division."""
    return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})(function)


def inlined(function: Any) -> Any:
    """Compiled into its caller: a call would cost more than these few operations."""
    return numba.njit(
        cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, inline="always"
    )(function)


@compiled
def run_tape(code: npt.NDArray[np.int32], r: Floats) -> None:
    """Play the operations of one cycle on registers `r`."""
    for k in range(code.shape[0]):
        op, d, a, b = code[k, 0], code[k, 1], code[k, 2], code[k, 3]
        if op == 0:
            r[d] = r[a]
        elif op == 1:
            r[d] = r[a] + r[b]
        elif op == 2:
            r[d] = r[a] - r[b]
        elif op == 3:
            r[d] = r[a] * r[b]
        elif op == 4:
            r[d] = r[a] / r[b]
        elif op == 5:
            r[d] = r[a] ** r[b]
        elif op == 6:
            r[d] = -r[a]
        elif op == 7:
            r[d] = min(r[a], r[b])
        elif op == 8:
            r[d] = max(r[a], r[b])
        elif op == 9:
            r[d] = abs(r[a])
        else:
            r[d] = _function(op, r[a], r[b])


@compiled
def _function(op: int, a: float, b: float) -> float:
    if op == 10:
        return math.sqrt(a) if a >= 0.0 else math.nan
    if op == 11:
        return math.sin(a)
    if op == 12:
        return math.cos(a)
    if op == 13:
        return math.tan(a)
    if op == 14:
        return math.asin(a) if abs(a) <= 1.0 else math.nan
    if op == 15:
        return math.acos(a) if abs(a) <= 1.0 else math.nan
    if op == 16:
        return math.atan(a)
    if op == 17:
        return math.atan2(a, b)
    if op == 18:
        return math.exp(a)
    if op == 19:
        return math.log(a) if a > 0.0 else math.nan
    return float(np.sign(a))


@inlined
def convert(value: float, limit: float, step: float, clips: float) -> float:
    """A converter: clip to +-limit and round to whole steps (0: no rounding); zero stays zero."""
    if clips != 0.0:
        value = min(max(value, -limit), limit)
    if step > 0.0:
        value = np.rint(value / step) * step
    return value


@compiled
def note_overload(
    notes: Ints, values: Floats, row: int, value: float, repeat: int, at: int, last: int
) -> None:
    """Remember that `row` went beyond its range at (repeat, instant)."""
    if notes[row, TIMES] == 0:
        notes[row, FIRST_REPEAT] = repeat
        notes[row, FIRST_INSTANT] = at
        values[row, 0] = value
    # The last instant of a repeat is the first of the next, seen from before.
    number = (repeat + 1) * last + 1 if at == last else repeat * last + at + 1
    if notes[row, LAST] != number:
        notes[row, TIMES] += 1
        notes[row, LAST] = number
    if abs(value) > abs(values[row, 1]):
        values[row, 1] = value
        notes[row, WORST_REPEAT] = repeat
        notes[row, WORST_INSTANT] = at


@compiled
def watch(
    signal: Ints, v: Floats, notes: Ints, values: Floats, repeat: int, at: int, last: int
) -> None:
    """Note every analog signal that is beyond full scale."""
    for s in range(signal.shape[0]):
        if abs(v[signal[s]]) > 1.0:
            note_overload(notes, values, s, v[signal[s]], repeat, at, last)


@compiled
def play(
    score: Score,
    plant: Plant,
    coupling: Coupling,
    deck: Deck,
    pens: Pens,
    state: State,
    normals: Floats,
    rows: Floats,
    states: int,
    keep_every: int,
    last_repeat: int,
    most_instants: int,
) -> int:
    """Play the segment's instants from (counts[REPEAT], counts[INSTANT]) on.

    Stops before repeat `last_repeat`, or after `most_instants` instants; returns why (DONE, PAUSED,
    RUNAWAY, NOT_FINITE). `normals` must hold enough draws for that, from counts[DRAWS] on; every
    `keep_every`-th row of the record is kept, in `rows`.
    """
    # Plain names, and no calls with arrays on the common path: both would count references.
    instants = score.instants
    change, draws, signal, reach = plant
    adc, adc_figures, dac, dac_figures, steps, step_values = coupling
    code, word_registers, memory = deck
    source, factor = pens
    v, next_v, sample, registers, ring, words, count, notes, values = state
    signals, adcs, depth = signal.shape[0], adc.shape[0], ring.shape[0]
    columns, inputs, sums = change.shape[2], reach.shape[0], reach.shape[1]
    states_end = sums + states
    draws_at = states_end + inputs
    started, ended = count[STARTED], count[ENDED]
    skip, row, drawn = count[SKIP], count[ROWS], count[DRAWS]
    repeat, at, last = count[REPEAT], count[INSTANT], instants.shape[0] - 1
    outcome = PAUSED
    for _ in range(most_instants):
        if at == instants.shape[0]:
            at = 0
            repeat += 1
        if repeat >= last_repeat:
            break
        q = instants[at, INTERVAL]
        if q >= 0:
            for j in range(draws[q]):
                v[draws_at + j] = normals[drawn + j]
            drawn += draws[q]
            # next = change @ [states, inputs, draws], a block of four rows at a time.
            for block in range(change.shape[1]):
                a, b, c, d = 0.0, 0.0, 0.0, 0.0
                for j in range(columns):
                    x = v[sums + j]
                    a += change[q, block, j, 0] * x
                    b += change[q, block, j, 1] * x
                    c += change[q, block, j, 2] * x
                    d += change[q, block, j, 3] * x
                i = 4 * block
                next_v[i], next_v[i + 1], next_v[i + 2], next_v[i + 3] = a, b, c, d
            beyond, lost = 0, 0
            for i in range(sums):
                v[i] = next_v[i]
                beyond += abs(v[i]) > 1.0
                lost += not abs(v[i]) <= RUNAWAY_MU
            for i in range(sums, states_end):
                v[i] += next_v[i]
                beyond += abs(v[i]) > 1.0
                lost += not abs(v[i]) <= RUNAWAY_MU
            if beyond > 0:
                watch(signal, v, notes, values, repeat, at, last)
            if lost > 0:
                outcome = RUNAWAY
                break
        for i in range(instants[at, SAMPLE], instants[at, SAMPLE + 1]):
            sample[i] = v[signal[adc[i, 0]]]
        for i in range(instants[at, CONVERT], instants[at, CONVERT + 1]):
            value, limit = sample[i], adc_figures[i, 1]
            if abs(value) > limit:
                note_overload(notes, values, signals + i, value, repeat, at, last)
            word = convert(value, limit, adc_figures[i, 2], adc_figures[i, 3])
            registers[adc[i, 1]] = word * adc_figures[i, 0]
        for _start in range(instants[at, START]):
            run_tape(code, registers)
            for w in range(word_registers.shape[0]):
                ring[started, w] = registers[word_registers[w]]
            for m in range(memory.shape[0]):
                registers[memory[m, 0]] = registers[memory[m, 1]]
            started = started + 1 if started + 1 < depth else 0
        for _end in range(instants[at, END]):
            for w in range(words.shape[0]):
                words[w] = ring[ended, w]
                if not math.isfinite(words[w]):
                    outcome = NOT_FINITE
            ended = ended + 1 if ended + 1 < depth else 0
        for i in range(instants[at, LATCH], instants[at, LATCH + 1]):
            value = words[dac[i, 0]] * dac_figures[i, 0]
            if not abs(value) <= RUNAWAY_MU and outcome == PAUSED:
                outcome = RUNAWAY
            if abs(value) > 1.0:
                note_overload(notes, values, signals + adcs + i, value, repeat, at, last)
            held = dac[i, 1]
            value = convert(value, 1.0, dac_figures[i, 1], dac_figures[i, 2])
            for s in range(sums):
                v[s] += reach[held, s] * (value - v[states_end + held])
            v[states_end + held] = value
        if outcome != PAUSED:
            break
        for i in range(instants[at, SOURCE], instants[at, SOURCE + 1]):
            held = steps[i]
            for s in range(sums):
                v[s] += reach[held, s] * (step_values[i] - v[states_end + held])
            v[states_end + held] = step_values[i]
        jumped = instants[at, LATCH + 1] + instants[at, SOURCE + 1] > 0
        if jumped:
            beyond = 0
            for s in range(signals):
                beyond += abs(v[signal[s]]) > 1.0
            if beyond > 0:
                watch(signal, v, notes, values, repeat, at, last)
        for _record in range(instants[at, RECORD]):
            if skip == 0:
                for p in range(source.shape[0]):
                    which = source[p, 1]
                    if source[p, 0] == 0:
                        value = v[signal[which]]
                    elif source[p, 0] == 1:
                        value = registers[adc[which, 1]]
                    else:
                        value = words[which]
                    rows[row, p] = value * factor[p]
                row += 1
                skip = keep_every
            skip -= 1
        at += 1
    count[STARTED], count[ENDED], count[SKIP] = started, ended, skip
    count[ROWS], count[DRAWS], count[REPEAT], count[INSTANT] = row, drawn, repeat, at
    if outcome == PAUSED and repeat >= last_repeat:
        return DONE
    return outcome


def is_compiled() -> bool:
    """Whether a compiled kernel lies on disk, so that the first call only loads it."""
    return any(Path(play.stats.cache_path).glob("kernel.play-*.nbi"))
