"""The compiled kernel: advances the analog state from instant to instant and does what happens then.

Stage 4. Compiled once and cached on disk; every patch, period and parameter is data. It allocates
nothing, draws nothing (normal draws come in a buffer) and never looks at a clock: an instant says by
index which propagator leads to it.
"""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hybrid.engine import helper_functions, lanes
from hybrid.engine.arithmetic import KEEPS, LENGTH, SOURCE_OF, remember
from hybrid.engine.bursts import MULTIPLY_ADD, multiply_add, run_bursts
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.lookup import note_missed

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


class Score(NamedTuple):
    """The cues of one segment, a row each: what to do, to which, and the number of its instant.

    ADVANCE: the propagator that leads to the next instant; SAMPLE, CONVERT: the ADC, TAKE: both at once;
    START, END: a program; LATCH: the DAC; SOURCE: the step source; RECORD: a row of the record. LOOK
    follows what makes signals jump.
    """

    cues: npt.NDArray[np.int32]  # (cues, 3)


class Plant(NamedTuple):
    """Analog side, for v = [padding, k sums, n states, m held inputs, r normal draws].

    Every signal is an entry of v; a sum is a signal without lag, a combination of states and inputs.
    `change` gives the sums (new values) and the states (their changes), in blocks of eight rows that
    lie side by side in memory, as vector instructions take them; the padding fills the first block.
    """

    change: Floats  # (intervals, blocks, n + m + r, 8)
    kept: Floats  # (8 * blocks,): 1 for states, to which changes are added, else 0
    draws: Ints  # (intervals,): normal draws each propagator consumes
    signal: Ints  # (signals,): place in v
    reach: Floats  # (m, k): what a unit change of each input does to the sums at once


class Coupling(NamedTuple):
    """Converters: rows of (place in v or word, register or place in v) and their figures."""

    adc: Ints  # (adcs, 2): place of the signal, register
    adc_figures: Floats  # (adcs, 4): SI per machine unit, range, step or 0, clips
    dac: Ints  # (dacs, 2): word, input (counted among the m)
    dac_figures: Floats  # (dacs, 3): machine units per SI, step or 0, clips
    steps: Ints  # (steps,): input
    step_values: Floats


class Deck(NamedTuple):
    """The programs, one after the other; a row of `starts` has the first of each and of the next.

    Where words round, `code` is the tape as it was written; where all are doubles, `bursts`, `steps` and
    `asks` are the tight one. The other is empty.
    """

    code: npt.NDArray[np.int32]  # (operations, 4)
    bursts: npt.NDArray[np.int32]  # (bursts, 3), see `TightTape`
    steps: npt.NDArray[np.uint32]  # (steps, 4)
    asks: npt.NDArray[np.int32]  # (asks, 3)
    words: npt.NDArray[np.uint32]
    memory: npt.NDArray[np.int32]
    figures: Floats  # of its tables, see `lookup`
    axes: Ints  # (searches, columns)
    tables: Ints  # (tables, columns)
    length_of: npt.NDArray[np.int32]  # (operations,): row of `lengths`; () where all are doubles
    lengths: Floats
    owner: npt.NDArray[np.int32]  # (operations,): the word each helps to compute
    shared: npt.NDArray[np.int32]  # words of other programs: register, word
    starts: Ints  # (programs + 1, 5): rows of code or bursts, words, memory, shared, asks


class Pens(NamedTuple):
    """What a row of the record holds: (0 signal | 1 ADC word | 2 word, index), times a factor."""

    source: Ints  # (pens, 2)
    factor: Floats


class State(NamedTuple):
    """All that changes during a run; owned by the run."""

    v: Floats  # (8 * blocks + m + r,)
    next_v: Floats  # (8 * blocks,)
    sample: Floats  # (adcs,): held by sample and hold
    registers: Floats
    ring: Floats  # (depth, words): results on their way
    slots: Ints  # (programs, 2): rows of the ring, of the next results to be and of the oldest
    words: Floats  # (words,): results that can be read
    counts: Ints  # see the constants below
    overload: Ints  # (signals + adcs + dacs + words, 6): see the constants below
    beyond: Floats  # (signals + adcs + dacs + words, 2): first and worst value
    outside: Floats  # (sites of the tape + 1, 6): see `helper_functions`
    places: Floats  # (searches + 4, 4): where arguments of tables lie, see `lookup`
    intervals: Ints  # (searches, 2)


# What a cue asks for.
ADVANCE, SAMPLE, CONVERT, TAKE, START, END, LATCH, SOURCE, LOOK, RECORD = range(10)

# Indices into State.counts: rows to skip, rows written, draws used, place in the
# segment; whether an overload ends the run: NEVER, the next one, or one that is there already; whether
# the cycle of limited word length that is to begin has been computed.
SKIP, ROWS, DRAWS, REPEAT, CUE, STOPS, COMPUTED = range(7)
NEVER, NEXT, AT_ONCE = range(3)
# Indices into a row of State.overload: how many instants beyond range, the first (repeat, instant), the
# worst, and a number for the last instant noted, so that x- and x+ count as one.
TIMES, FIRST_REPEAT, FIRST_INSTANT, WORST_REPEAT, WORST_INSTANT, LAST = range(6)

# Why the kernel came back.
# OVERFLOWED: a word of the program that is to stop the run.
# WAITING: no propagators, so the caller must advance the analog side or let it follow a jump.
# OUTSIDE: a function of the program was asked beyond its range and is to stop the run there.
# CALLED: a comparator has switched that starts a task; what is due next must be laid out anew.
# COMPUTES: a program of limited word length, for which the caller must compute a cycle.
# GATHERS: a comparator switches at ever shorter intervals, which add up to a finite time.
DONE, PAUSED, RUNAWAY, NOT_FINITE, WAITING, CHATTERS, NOT_RESOLVED, OVERLOADED = range(8)
OUTSIDE, OVERFLOWED, CALLED, GATHERS, COMPUTES = 8, 9, 10, 11, 12

# Beyond this many machine units a run means nothing any more and soon overflows.
RUNAWAY_MU = 1e12


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
) -> bool:
    """Note every analog signal that is beyond full scale; whether one of v has run away."""
    for s in range(signal.shape[0]):
        if abs(v[signal[s]]) > 1.0:
            note_overload(notes, values, s, v[signal[s]], repeat, at, last)
    lost = False
    for x in v:
        lost |= not abs(x) <= RUNAWAY_MU
    return lost


@compiled
def any_noted(notes: Ints) -> bool:
    """Whether anything has been beyond its range."""
    noted = False
    for row in range(notes.shape[0]):
        noted |= notes[row, TIMES] > 0
    return noted


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
    keep_every: int,
    stop_repeat: int,
    stop_cue: int,
) -> int:
    """Play the segment's cues from (counts[REPEAT], counts[CUE]) up to (stop_repeat, stop_cue).

    Returns why it ended: PAUSED, RUNAWAY, NOT_FINITE, OVERLOADED where counts[STOPS] asks for it, or
    WAITING at every ADVANCE and LOOK where there are no propagators, or COMPUTES at every START where
    word lengths are limited; the cue that ended it is not done.
    `normals` must hold enough draws for that, from counts[DRAWS] on; every `keep_every`-th row of the
    record is kept, in `rows`.
    """
    # Plain names: each array is looked up once, and not at every use.
    cues = score.cues
    change, kept, draws, signal, reach = plant
    adc, adc_figures, dac, dac_figures, stepped, step_values = coupling
    _, bursts, steps, asks, word_registers, memory, figures, axes, tables = deck[:9]
    limited = deck.length_of.shape[0] > 0  # the word length
    shared, starts = deck.shared, deck.starts
    source, factor = pens
    v, next_v, sample, registers, ring, slots, words, count, notes, values, outside = state[:11]
    places, intervals, clock = state.places, state.intervals, outside.shape[0] - 1
    signals, adcs, depth = signal.shape[0], adc.shape[0], ring.shape[0]
    blocks, columns = change.shape[1], change.shape[2]
    inputs, sums, inputs_at = reach.shape[0], reach.shape[1], kept.shape[0]
    draws_at, column_at = inputs_at + inputs, v.shape[0] - columns
    sums_at = column_at - sums
    skip, row, drawn = count[SKIP], count[ROWS], count[DRAWS]
    repeat, at, last = count[REPEAT], count[CUE], cues[cues.shape[0] - 1, 2]
    stops = count[STOPS]
    outcome, circuit = PAUSED, change.shape[0] == 0
    while outcome == PAUSED and (repeat < stop_repeat or (repeat == stop_repeat and at < stop_cue)):
        end = cues.shape[0] if repeat < stop_repeat else stop_cue
        while at < end:
            i = cues[at, 1]
            cue = cues[at, 0]
            if circuit and cue in (ADVANCE, LOOK):
                outcome = WAITING
                break
            if cue == ADVANCE:
                if stops == AT_ONCE:
                    outcome = OVERLOADED
                    break
                for j in range(draws[i]):
                    v[draws_at + j] = normals[drawn + j]
                drawn += draws[i]
                for block in range(blocks):
                    lanes.weigh(
                        next_v, block, change, (i * blocks + block) * columns, v, column_at, columns
                    )
                beyond = False
                for block in range(blocks):
                    beyond |= not lanes.change(v, block, kept, next_v)
                if beyond and watch(signal, v, notes, values, repeat, cues[at, 2], last):
                    outcome = RUNAWAY
                    break
                if beyond and stops != NEVER and any_noted(notes):
                    outcome = OVERLOADED
                    break
            elif cue == SAMPLE:
                sample[i] = v[adc[i, 0]]
            elif cue in (TAKE, CONVERT):
                if cue == TAKE:
                    sample[i] = v[adc[i, 0]]
                value, limit = sample[i], adc_figures[i, 1]
                if abs(value) > limit:
                    note_overload(notes, values, signals + i, value, repeat, cues[at, 2], last)
                word = convert(value, limit, adc_figures[i, 2], adc_figures[i, 3])
                registers[adc[i, 1]] = word * adc_figures[i, 0]
                if abs(value) > limit and stops != NEVER:
                    outcome = OVERLOADED
                    break
            elif cue == START:
                if not limited or count[COMPUTED] == 0:
                    for k in range(starts[i, 3], starts[i + 1, 3]):
                        registers[shared[k, 0]] = words[shared[k, 1]]
                burst, stop = starts[i, 0], starts[i + 1, 0]
                # Small programs are nothing but products and sums, and need none of the rest.
                while burst < stop and not limited and bursts[burst, 0] == MULTIPLY_ADD:
                    multiply_add(steps, bursts[burst, 1], bursts[burst, 2], registers)
                    burst += 1
                if limited:
                    if count[COMPUTED] == 0:
                        outcome = COMPUTES
                    elif stops != NEVER and any_noted(notes):
                        outcome = OVERLOADED
                    else:
                        count[COMPUTED] = 0
                elif burst < stop:
                    outside[clock, helper_functions.REPEAT] = repeat
                    outside[clock, helper_functions.INSTANT] = cues[at, 2]
                    if run_bursts(
                        bursts,
                        burst,
                        stop,
                        steps,
                        registers,
                        figures,
                        axes,
                        tables,
                        places,
                        intervals,
                        outside,
                    ):
                        first, stop = starts[i, 4], starts[i + 1, 4]
                        note_missed(asks, first, stop, places, intervals, outside)
                if outcome == PAUSED and outside[clock, helper_functions.TIMES] > 0.0:
                    outcome = OUTSIDE
                if outcome != PAUSED:
                    break
                slot = slots[i, 0]
                for w in range(starts[i, 1], starts[i + 1, 1]):
                    ring[slot, w] = registers[word_registers[w]]
                for m in range(starts[i, 2], starts[i + 1, 2]):
                    if memory[m, LENGTH] == 0:
                        registers[memory[m, KEEPS]] = registers[memory[m, SOURCE_OF]]
                    else:
                        remember(memory, registers, m)
                slots[i, 0] = slot + 1 if slot + 1 < depth else 0
            elif cue == END:
                slot = slots[i, 1]
                lost = False
                for w in range(starts[i, 1], starts[i + 1, 1]):
                    words[w] = ring[slot, w]
                    lost |= not abs(words[w]) < math.inf
                if lost:
                    outcome = NOT_FINITE
                    break
                slots[i, 1] = slot + 1 if slot + 1 < depth else 0
            elif cue in (LATCH, SOURCE):
                if cue == LATCH:
                    held = dac[i, 1]
                    value = words[dac[i, 0]] * dac_figures[i, 0]
                    if not abs(value) <= RUNAWAY_MU:
                        outcome = RUNAWAY
                    if abs(value) > 1.0:
                        row_of = signals + adcs + i
                        note_overload(notes, values, row_of, value, repeat, cues[at, 2], last)
                        if stops != NEVER and outcome == PAUSED:
                            outcome = OVERLOADED
                    value = convert(value, 1.0, dac_figures[i, 1], dac_figures[i, 2])
                else:
                    held = stepped[i]
                    value = step_values[i]
                for s in range(sums):
                    v[sums_at + s] += reach[held, s] * (value - v[inputs_at + held])
                v[inputs_at + held] = value
                if outcome != PAUSED:
                    break
            elif cue == LOOK:
                beyond = False
                for s in range(sums_at, column_at):
                    beyond |= abs(v[s]) > 1.0
                if beyond:
                    watch(signal, v, notes, values, repeat, cues[at, 2], last)
                    if stops != NEVER and any_noted(notes):
                        outcome = OVERLOADED
                        break
            else:
                if skip == 0:
                    for p in range(source.shape[0]):
                        which = source[p, 1]
                        if source[p, 0] == 0:
                            value = v[which]
                        elif source[p, 0] == 1:
                            value = registers[which]
                        else:
                            value = words[which]
                        rows[row, p] = value * factor[p]
                    row += 1
                    skip = keep_every
                skip -= 1
            at += 1
        if outcome == PAUSED and at == cues.shape[0]:
            at = 0
            repeat += 1
    count[SKIP], count[ROWS], count[DRAWS], count[REPEAT], count[CUE] = skip, row, drawn, repeat, at
    return outcome


def is_compiled(function: Any = None, argument: str = "") -> bool:
    """Whether a kernel on disk is of this source, Python, numba and processor: numba loads no other.

    `argument`: only one for an argument whose type has this in its name.
    """
    try:
        asked = function or play
        cache, codegen = asked._cache, asked.targetctx.codegen()
        index = cache._cache_file._load_index()
        folder = Path(cache.cache_path)
        return any(
            key == cache._index_key(key[0], codegen)
            and argument in str(key[0])
            and (folder / data).exists()
            for key, data in index.items()
        )
    except AttributeError:  # another numba, or one told not to compile: better silent than wrong
        return True


# Modules outside this folder whose constants are compiled in.
SOURCES = ("tape.py", "numbering.py", "elements.py", "surroundings.py", "wordlength.py")


def forget_stale_kernels() -> None:
    """Remove compiled functions that are older than the newest source they may be made of.

    numba looks at the module of a function only, and would go on with what it called in another one.
    """
    here = Path(__file__).parent
    sources = [*here.glob("*.py"), *(here.parent / name for name in SOURCES)]
    newest = max(source.stat().st_mtime for source in sources)
    with contextlib.suppress(AttributeError, OSError):
        for index in Path(play._cache.cache_path).glob("*.nbi"):
            if index.stat().st_mtime < newest:
                index.unlink(missing_ok=True)


forget_stale_kernels()
