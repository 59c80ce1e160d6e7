"""The kernel and a circuit in turns: the circuit goes from instant to instant, where the kernel acts.

Stage 4. The kernel comes back wherever the analog side must be advanced, or must follow a jump.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hybrid.elements import TRACK
from hybrid.engine import kernel
from hybrid.engine.arrays import Coupling, Deck, Floats, Ints, Pens, Plant, Score, State
from hybrid.engine.circuit import KIND, Circuit
from hybrid.engine.compiling import allocating, compiled, inlined
from hybrid.engine.corners import Log, settle
from hybrid.engine.limited import compute
from hybrid.engine.lines import RUN, UNDER_WAY, Lines
from hybrid.engine.nodes import RESOLUTION, Nodes, Shelf
from hybrid.engine.noise import Noise, drawn_from, jump, take
from hybrid.engine.programs import compute_rest
from hybrid.engine.relaxation import (
    CHATTER,
    GATHERED,
    OVERLOADED,
    PAUSED,
    RUNAWAY,
    SWITCHED,
    advance,
    hold_for_good,
)
from hybrid.engine.relaxation import Pen as WindowPen
from hybrid.engine.sweep import BEFORE, FROZEN, LAST_WINDOW, ON_OVERLOAD, OVERLOAD_S, WINDOWS
from hybrid.engine.sweep import State as CircuitState
from hybrid.modes import OP, STOP_RUN

# Instants of a run between two looks at Ctrl-C.
CHUNK_ADVANCES = 2000
# Elements times windows between two looks at Ctrl-C, also within an interval, and of many runs together:
# some tenths of a second.
CHUNK_ELEMENTS = 600_000
# To let loops settle before a run.
MOST_PASSES = 1000


class Side(NamedTuple):
    """The analog side of one run: the circuit, its state and where its signals and inputs stand."""

    circuit: Circuit
    state: CircuitState
    shelf: Shelf
    grid: Nodes
    log: Log
    no_pen: WindowPen
    place: Ints  # (signals,): element of each signal
    held: Ints  # (inputs of the circuit,): which of the machine's held inputs
    mode: Ints  # (1,): the element that gives the machine's mode; -1: it is always in OP
    stopped_s: Floats  # (1,): when it could not go on; nan: it could
    called_s: Floats  # (1,): how far into an interval a task was called that a comparator starts


class Clock(NamedTuple):
    """Times of one segment, in s."""

    start_s: float
    length_s: float
    instants_s: Floats  # (instants,): offsets
    intervals_s: Floats  # (intervals,)


@inlined
def follow(
    side: Side, noise: Noise | None, plant: Plant, state: State, t_s: float, duration_s: float
) -> int:
    """Advance the circuit (by nothing: let it follow a jump) and show its signals; why it ended."""
    v, inputs_at = state.v, plant.kept.shape[0]
    for i in range(side.held.shape[0]):
        side.state.held[i] = v[inputs_at + side.held[i]]
    why, done_s = advance(
        side.circuit,
        side.state,
        side.shelf,
        side.grid,
        t_s,
        duration_s,
        RESOLUTION,
        side.log,
        side.no_pen,
        noise,
    )
    for s in range(side.place.shape[0]):
        if noise is None:
            v[s] = side.state.start[side.place[s]]
        else:
            v[s] = noise.truth.start[side.place[s]]
    v[side.place.shape[0]] = side.state.start[side.mode[0]] if side.mode[0] >= 0 else OP
    if why == 0 or (why == SWITCHED and duration_s == 0.0):  # of an instant, all is done first
        return kernel.WAITING
    if why == PAUSED:
        return kernel.PAUSED
    if why == SWITCHED:
        side.called_s[0] = done_s
        return kernel.CALLED
    side.stopped_s[0] = t_s + done_s
    if why == RUNAWAY:
        return kernel.RUNAWAY
    if why == OVERLOADED:
        return kernel.OVERLOADED
    if why == GATHERED:
        return kernel.GATHERS
    return kernel.CHATTERS if why == CHATTER else kernel.NOT_RESOLVED


@compiled
def _hold_now(score: Score, side: Side, noise: Noise | None, clock: Clock, state: State) -> None:
    """A converter is beyond its range: put the machine into HOLD at the cue that found it."""
    count = state.counts
    count[kernel.STOPS] = kernel.NEVER
    if side.state.counts[FROZEN] > 0:
        return
    now_s = clock.start_s + count[kernel.REPEAT] * clock.length_s
    now_s += clock.instants_s[score.cues[count[kernel.CUE]].instant]
    side.state.clock[OVERLOAD_S] = now_s
    hold_for_good(side.circuit, side.state, now_s, 0.0, side.log)
    if noise is not None:
        jump(side.circuit, side.state, noise, now_s, 0.0)


@compiled
def take_turns(
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
    side: Side,
    clock: Clock,
    noise: Noise | None,
) -> int:
    """Like `kernel.play`, with the circuit as the analog side; at most CHUNK_ADVANCES instants."""
    cues, count = score.cues, state.counts
    last = side.state.counts[WINDOWS] + CHUNK_ELEMENTS // side.place.shape[0]
    side.state.counts[LAST_WINDOW] = last
    for _ in range(CHUNK_ADVANCES):
        if side.state.counts[WINDOWS] > last:
            break
        outcome = kernel.play(
            score,
            plant,
            coupling,
            deck,
            pens,
            state,
            normals,
            rows,
            keep_every,
            stop_repeat,
            stop_cue,
        )
        if outcome == kernel.OVERLOADED and side.state.counts[ON_OVERLOAD] != STOP_RUN:
            _hold_now(score, side, noise, clock, state)
            continue
        if outcome == kernel.COMPUTES and deck.length_of.shape[0] == 0:
            compute_rest(score, deck, state)
            continue
        if outcome != kernel.WAITING:
            return int(outcome)
        cue = cues[count[kernel.CUE]]
        t_s, duration_s = clock.start_s + count[kernel.REPEAT] * clock.length_s, 0.0
        if cue.what == kernel.ADVANCE:
            duration_s = clock.intervals_s[cue.which]
            t_s += clock.instants_s[np.int64(cue.instant) - 1]
        else:
            t_s += clock.instants_s[cue.instant]
        outcome = follow(side, noise, plant, state, t_s, duration_s)
        if outcome != kernel.WAITING:
            return int(outcome)
        count[kernel.CUE] += 1
        if count[kernel.CUE] == cues.shape[0]:
            count[kernel.CUE], count[kernel.REPEAT] = 0, count[kernel.REPEAT] + 1
    return kernel.PAUSED


@allocating
def play_circuits(
    score: Score,
    plant: Plant,
    coupling: Coupling,
    deck: Deck,
    pens: Pens,
    state: State,
    normals: Floats,
    records: Floats,
    keep_every: int,
    stop_repeat: int,
    stop_cue: int,
    side: Side,
    noise: Noise | None,
    random: np.random.Generator | None,
    clock: Clock,
    runs: Lines,
) -> int:
    """`take_turns`, run after run, each from where its line has it up to (stop_repeat, stop_cue).

    records: (runs, rows, pens); random: of the noise of all these runs. Returns DONE when every run has
    come there or has ended before, as `runs.outcomes` says, or PAUSED for a look at Ctrl-C.
    """
    loud = None if noise is None else drawn_from(random, noise)
    spent, most = 0, CHUNK_ELEMENTS // side.place.shape[0]
    for run in range(runs.now[RUN], runs.lines.shape[0]):
        if runs.outcomes[run] != kernel.PAUSED:
            continue
        if spent > most:
            runs.now[RUN] = run
            return kernel.PAUSED
        if runs.now[UNDER_WAY] == 0:
            take(runs.line, runs.lines[run])
            runs.now[UNDER_WAY] = 1
        before = side.state.counts[WINDOWS]
        outcome = take_turns(
            score,
            plant,
            coupling,
            deck,
            pens,
            state,
            normals,
            records[run],
            keep_every,
            stop_repeat,
            stop_cue,
            side,
            clock,
            loud,
        )
        spent += 1 + side.state.counts[WINDOWS] - before
        repeat, cue = state.counts[kernel.REPEAT], state.counts[kernel.CUE]
        there = repeat > stop_repeat or (repeat == stop_repeat and cue >= stop_cue)
        if outcome == kernel.PAUSED and not there:
            runs.now[RUN] = run
            return kernel.PAUSED
        take(runs.lines[run], runs.line)
        runs.outcomes[run], runs.now[UNDER_WAY] = outcome, 0
    runs.now[RUN] = 0
    return kernel.DONE


@allocating
def play_limited_circuit(
    noise: Noise | None, random: np.random.Generator | None, *given: Any
) -> int:
    """`take_turns`, which takes `noise` as its last, for programs of limited word length: a cycle is
    computed between two calls."""
    loud = None if noise is None else drawn_from(random, noise)
    score, deck, state, side = given[0], given[3], given[5], given[11]
    last = side.state.counts[WINDOWS] + CHUNK_ELEMENTS // side.place.shape[0]
    for _ in range(CHUNK_ADVANCES):
        if side.state.counts[WINDOWS] > last:
            break
        outcome = take_turns(*given, loud)
        if outcome != kernel.COMPUTES:
            return int(outcome)
        if compute(score, deck, state):
            return int(kernel.OVERFLOWED)
    return kernel.PAUSED


@allocating
def begin(
    side: Side,
    noise: Noise | None,
    random: np.random.Generator | None,
    plant: Plant,
    state: State,
    runs: Lines,
) -> None:
    """Let loops of every run come to rest with what its inputs hold; every signal follows, at t = 0."""
    loud = None if noise is None else drawn_from(random, noise)
    inputs_at = plant.kept.shape[0]
    for run in range(runs.lines.shape[0]):
        take(runs.line, runs.lines[run])
        for i in range(side.held.shape[0]):
            side.state.held[i] = state.v[inputs_at + side.held[i]]
        settle_loops(side, side.state.held)
        follow(side, loud, plant, state, 0.0, 0.0)
        take(runs.lines[run], runs.line)


@allocating
def settle_loops(side: Side, held: Floats) -> None:
    """Let loops of lagged parts come to rest before the run, with these figures at the inputs.

    Each pass lets every output that follows at once or settles follow its inputs; in a loop of gain
    below 1 the passes converge. Where they do not, the run begins from a single pass, as a circuit does.
    Stores begin each pass with what they are to hold at first, as a comparator may open them on the way.
    """
    state, rows = side.state, side.circuit.rows
    state.held[:] = held
    start, memory, piece = state.start.copy(), state.memory.copy(), state.piece.copy()
    for _ in range(MOST_PASSES):
        before = state.start.copy()
        for e in range(rows.shape[0]):
            if rows[e, KIND] == TRACK:
                state.memory[e, BEFORE] = side.circuit.initial[e, 0]
        settle(side.circuit, state, state, 0.0, 0.0, side.log, True, 0.0)
        rests = True
        for e in range(before.shape[0]):  # never, where a quotient has no figure
            size = max(1.0, abs(before[e]))
            rests = rests and abs(state.start[e] - before[e]) <= 1e-15 * size
        if rests:
            return
    state.start[:], state.memory[:, :], state.piece[:] = start, memory, piece
