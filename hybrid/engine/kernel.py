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

from hybrid.engine import helper_functions, lanes
from hybrid.engine.arithmetic import remember
from hybrid.engine.arrays import (
    Coupling,
    Deck,
    Floats,
    Numbers,
    Pens,
    Plant,
    Score,
    State,
)
from hybrid.engine.beyond import FULL_SCALE
from hybrid.engine.bursts import MULTIPLY_ADD, multiply_add
from hybrid.engine.compiling import compiled, inlined

# What a cue asks for.
ADVANCE, SAMPLE, CONVERT, TAKE, START, END, LATCH, SOURCE, LOOK, RECORD = range(10)

# Indices into State.counts: rows to skip, rows written, draws used, place in the
# segment; whether an overload ends the run: NEVER, the next one, or one that is there already; whether
# the caller has computed the cycle that is to begin.
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
# COMPUTES: a program of which the caller must compute the cycle, or what the kernel leaves of it.
# GATHERS: a comparator switches at ever shorter intervals, which add up to a finite time.
DONE, PAUSED, RUNAWAY, NOT_FINITE, WAITING, CHATTERS, NOT_RESOLVED, OVERLOADED = range(8)
OUTSIDE, OVERFLOWED, CALLED, GATHERS, COMPUTES = 8, 9, 10, 11, 12

ONE = np.uint64(1)

# Beyond this many machine units a run means nothing any more and soon overflows.
RUNAWAY_MU = 1e12


@inlined
def convert(value: float, limit: float, step: float, clips: float) -> float:
    """A converter: clip to +-limit and round to whole steps (0: no rounding); zero stays zero."""
    if clips != 0.0:
        value = min(max(value, -limit), limit)
    for _ in range(step > 0.0):
        value = np.rint(value / step) * step
    return value


class Moment(NamedTuple):
    """Where in the segment it is."""

    repeat: int
    instant: int
    last: int  # the last instant of a repeat


@compiled
def note_overload(state: State, row: int, value: float, now: Moment) -> None:
    """Remember that `row` of the state's notes went beyond its range now."""
    notes, values = state.overload, state.beyond
    if notes[row, TIMES] == 0:
        notes[row, FIRST_REPEAT] = now.repeat
        notes[row, FIRST_INSTANT] = now.instant
        values[row, 0] = value
    # The last instant of a repeat is the first of the next, seen from before.
    number = now.repeat * now.last + now.instant + 1
    if now.instant == now.last:
        number = (now.repeat + 1) * now.last + 1
    if notes[row, LAST] != number:
        notes[row, TIMES] += 1
        notes[row, LAST] = number
    if abs(value) > abs(values[row, 1]):
        values[row, 1] = value
        notes[row, WORST_REPEAT] = now.repeat
        notes[row, WORST_INSTANT] = now.instant


@compiled
def _watch(signal: Numbers, state: State, now: Moment) -> int:
    """Note every analog signal that is beyond full scale; whether the run may go on."""
    v = state.v
    for s in range(signal.shape[0]):
        if abs(v[signal[s]]) > FULL_SCALE:
            note_overload(state, s, v[signal[s]], now)
    for x in v:
        if not abs(x) <= RUNAWAY_MU:
            return RUNAWAY
    outcome: int = _unless_overloaded(state)
    return outcome


@compiled
def _unless_overloaded(state: State) -> int:
    """Whether the run may go on: not where what has been beyond its range is to end it."""
    if state.counts[STOPS] != NEVER:
        for row in range(state.overload.shape[0]):
            if state.overload[row, TIMES] > 0:
                return OVERLOADED
    return PAUSED


@inlined
def advance(plant: Plant, state: State, normals: Floats, interval: int, now: Moment) -> int:
    """Bring the analog side to the next instant."""
    v, next_v, counts, change = state.v, state.next_v, state.counts, plant.change
    blocks, columns = change.shape[1], change.shape[2]
    draws_at = plant.kept.shape[0] + plant.reach.shape[0]
    outcome = PAUSED
    if counts[STOPS] == AT_ONCE:
        outcome = OVERLOADED
    else:
        drawn, draws = counts[DRAWS], plant.draws[interval]
        for j in range(draws):
            v[draws_at + j] = normals[drawn + j]
        counts[DRAWS] = drawn + draws
        first = np.int64(interval) * blocks * columns
        for block in range(blocks):
            at = first + block * columns
            lanes.weigh(next_v, block, change, at, v, v.shape[0] - columns, columns)
            lanes.larger(state.most, block, v, block)
            lanes.larger(state.most, blocks + block, next_v, block)
        beyond = False
        for block in range(blocks):
            beyond |= not lanes.change(v, block, plant.kept, next_v)
        if beyond:
            outcome = _watch(plant.signal, state, now)
    return outcome


@inlined
def look(plant: Plant, state: State, now: Moment) -> int:
    """Note what sums have jumped beyond their range."""
    end = state.v.shape[0] - plant.change.shape[2]
    beyond, outcome = False, PAUSED
    for s in range(end - plant.reach.shape[1], end):
        beyond |= abs(state.v[s]) > 1.0
    if beyond:
        _watch(plant.signal, state, now)
        outcome = _unless_overloaded(state)
    return outcome


@inlined
def _take(adc: Any, number: int, value: float, signals: int, state: State, now: Moment) -> int:
    """Convert what an ADC holds."""
    outcome, word = PAUSED, convert(value, adc.range_mu, adc.step_mu, adc.clips)
    state.registers[adc.register] = word * adc.to_si
    if abs(value) > adc.range_mu:
        note_overload(state, signals + number, value, now)
        outcome = _unless_overloaded(state)
    return outcome


@inlined
def _compute(deck: Deck, state: State, number: int) -> int:
    """Play a program on the words it reads; COMPUTES where the caller is to do so, or to go on."""
    program, following = deck.programs[number], deck.programs[number + ONE]
    registers, outside, outcome = state.registers, state.outside, PAUSED
    if state.counts[COMPUTED] > 0:
        outcome = _unless_overloaded(state)
        if outcome == PAUSED:
            state.counts[COMPUTED] = 0
    else:
        for k in range(np.uint64(program.shared), np.uint64(following.shared)):
            registers[deck.shared[k].register] = state.words[deck.shared[k].word]
        burst, end = np.int64(program.code), np.int64(following.code)
        limited = deck.length_of.shape[0] > 0
        # Small programs are nothing but products and sums, and need none of the rest.
        while not limited and burst < end and deck.bursts[burst, 0] == MULTIPLY_ADD:
            multiply_add(deck.steps, deck.bursts[burst, 1], deck.bursts[burst, 2], registers)
            burst += 1
        if burst < end:
            outcome = COMPUTES
    if outcome == PAUSED and outside[outside.shape[0] - 1, helper_functions.TIMES] > 0.0:
        outcome = OUTSIDE
    return outcome


@inlined
def _begin(deck: Deck, state: State, number: int) -> None:
    """What a program has computed is on its way, and what it remembers is of this cycle now."""
    program, following = deck.programs[number], deck.programs[number + ONE]
    registers, ring, slot = state.registers, state.ring, state.slots[number].next
    for w in range(np.uint64(program.words), np.uint64(following.words)):
        ring[np.uint64(slot), w] = registers[deck.words[w]]
    for m in range(np.uint64(program.memory), np.uint64(following.memory)):
        remember(deck.memory[m], registers)
    state.slots[number].next = slot + 1 if slot + 1 < ring.shape[0] else 0


@inlined
def _finish(deck: Deck, state: State, number: int) -> int:
    """The results of a program can be read."""
    program, following = deck.programs[number], deck.programs[number + ONE]
    words, ring, slot, lost = state.words, state.ring, state.slots[number].oldest, False
    for w in range(np.uint64(program.words), np.uint64(following.words)):
        words[w] = ring[np.uint64(slot), w]
        lost |= not abs(words[w]) < math.inf
    if not lost:
        state.slots[number].oldest = slot + 1 if slot + 1 < ring.shape[0] else 0
    return NOT_FINITE if lost else PAUSED


@inlined
def _latch(dac: Any, plant: Plant, state: State, row: int, now: Moment) -> int:
    """A DAC takes over its word."""
    value, outcome = state.words[dac.word] * dac.to_mu, PAUSED
    if abs(value) > FULL_SCALE:
        note_overload(state, row, value, now)
        outcome = _unless_overloaded(state)
    if not abs(value) <= RUNAWAY_MU:
        outcome = RUNAWAY
    _hold(plant, state, np.uint64(dac.input), convert(value, 1.0, dac.step_mu, dac.clips))
    return outcome


@inlined
def _hold(plant: Plant, state: State, held: int, value: float) -> None:
    """An input jumps, and with it the sums that follow it at once."""
    v, sums = state.v, plant.reach.shape[1]
    sums_at, place = v.shape[0] - plant.change.shape[2] - sums, plant.kept.shape[0] + np.int64(held)
    for s in range(sums):
        v[sums_at + s] += plant.reach[held, s] * (value - v[place])
    v[place] = value


@inlined
def _draw(pens: Pens, state: State, rows: Floats, keep_every: int) -> None:
    """Take a row of the record, unless it is to be skipped."""
    counts, drawn = state.counts, pens.drawn
    if counts[SKIP] == 0:
        row = np.uint64(counts[ROWS])
        for p in range(np.uint64(drawn.shape[0])):
            pen = drawn[p]
            if pen.source == 0:
                value = state.v[pen.index]
            elif pen.source == 1:
                value = state.registers[pen.index]
            else:
                value = state.words[pen.index]
            rows[row, p] = value * pen.factor
        counts[ROWS] += 1
        counts[SKIP] = keep_every
    counts[SKIP] -= 1


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
    WAITING at every ADVANCE and LOOK where there are no propagators (but where the one follows the
    other), or COMPUTES at a START of a program that it does not play alone; the cue that ended it is
    not done.
    `normals` must hold enough draws for that, from counts[DRAWS] on; every `keep_every`-th row of the
    record is kept, in `rows`.
    """
    cues, (adcs, dacs, sources) = score.cues, coupling
    signals, circuit = plant.signal.shape[0], plant.change.shape[0] == 0
    repeat, at = state.counts[REPEAT], state.counts[CUE]
    last, outcome = cues[cues.shape[0] - 1].instant, PAUSED
    while outcome == PAUSED and (repeat < stop_repeat or (repeat == stop_repeat and at < stop_cue)):
        end = cues.shape[0] if repeat < stop_repeat else stop_cue
        while at < end:
            cue = cues[np.uint64(at)]
            what, i = cue.what, np.uint64(cue.which)
            now = Moment(repeat, cue.instant, last)
            if what == ADVANCE:
                outcome = WAITING if circuit else advance(plant, state, normals, i, now)
            elif what == SAMPLE:
                state.sample[i] = state.v[adcs[i].place]
            elif what == TAKE:
                outcome = _take(adcs[i], i, state.v[adcs[i].place], signals, state, now)
            elif what == CONVERT:
                outcome = _take(adcs[i], i, state.sample[i], signals, state, now)
            elif what == START:
                outcome = _compute(deck, state, i)
                if outcome == PAUSED:
                    _begin(deck, state, i)
            elif what == END:
                outcome = _finish(deck, state, i)
            elif what == LATCH:
                row = signals + adcs.shape[0] + np.int64(i)
                outcome = _latch(dacs[i], plant, state, row, now)
            elif what == SOURCE:
                _hold(plant, state, sources[i].input, sources[i].value_mu)
            elif what == LOOK:
                if not circuit:
                    outcome = look(plant, state, now)
                elif at + 1 == end or cues[np.uint64(at + 1)].what != ADVANCE:
                    outcome = WAITING  # else the circuit follows the jump as it is advanced
            else:
                _draw(pens, state, rows, keep_every)
            if outcome != PAUSED:
                break
            at += 1
        if outcome == PAUSED and at == cues.shape[0]:
            at = 0
            repeat += 1
    state.counts[REPEAT], state.counts[CUE] = repeat, at
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
SOURCES = (
    "elements.py",
    "meshes.py",
    "modes.py",
    "numbering.py",
    "surroundings.py",
    "tables.py",
    "tape.py",
    "wordlength.py",
)


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
