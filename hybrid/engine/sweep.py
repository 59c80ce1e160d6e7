"""One window of a circuit: every element evaluated at the nodes, in order, until the loops agree.

Stage 4. Static functions are taken node by node; integrators and lags are applied as the fixed operators
of `nodes`. A signal read before it is computed starts from a guess; each sweep through the elements of
loops brings it closer, by a factor of about (rate * window)^k / k! in sweep k.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hybrid.elements import (
    ANGLE,
    COS,
    INPUT,
    INTEGRATE,
    MODE,
    PIECES,
    PRODUCT,
    QUOTIENT,
    SIN,
    SINE,
    SQRT,
    SUM,
    SWITCH,
    TRACK,
)
from hybrid.engine.arrays import Floats, Ints, lined_up
from hybrid.engine.blur import answer
from hybrid.engine.circuit import (
    AMPLITUDE,
    AT,
    C0,
    C1,
    C2,
    CONSTANT,
    CONTROL,
    CORNER,
    END,
    END_PIECE,
    EXPONENT,
    FEEDBACK,
    FIRST,
    FIRST_PIECE,
    GAIN,
    KEEPS,
    KIND,
    LAG,
    LAW,
    LEAK,
    NOISE,
    OFFSET,
    OMEGA,
    PHASE,
    PLAIN,
    SECOND,
    SECOND_CONSTANT,
    STOP,
    TEAR,
    Circuit,
)
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.kernel import RUNAWAY_MU
from hybrid.engine.lanes import (
    LANES,
    add_scaled,
    combine,
    copy,
    farther,
    fill,
    gather,
    gather_product,
    largest,
    multiply,
    scale,
)
from hybrid.engine.nodes import Nodes, Shelf, shelved
from hybrid.modes import HOLD, IC, OP


class State(NamedTuple):
    """All that changes during a run of n elements; owned by the run. P = LANES."""

    held: Floats  # (inputs,): set by the caller
    seen: Floats  # (inputs,): as they were in the last window
    start: Floats  # (n,): every signal at the start of the window
    nodes: Floats  # (n, P): every signal at its nodes
    past: Floats  # (n,): every signal at the start of the last window
    last: Floats  # (n, P): every signal at the nodes of the last window
    memory: Floats  # (n, 7): see the columns below
    piece: Ints  # (corners,)
    guard_start: Floats  # (corners,): the quantity each corner guards
    guard: Floats  # (corners, P)
    row: Floats  # (3, P): scratch, see OLD and MOVED below
    point: Floats  # (1 + q,): scratch
    legendre: Floats  # (1 + P, P): scratch
    recent: Floats  # (corners, 2): since when each has switched often, and how often
    overload: Floats  # (n, 6): see the columns below
    fresh: Floats  # (noisy, P): noise that came up in the window, at its nodes
    clock: Floats  # see the constants below
    rungs: Floats  # (2, RUNGS): length of the windows after a jump, see below; 0: not learned
    counts: Ints  # see the constants below
    watched: Ints  # (n,): 1 where an overload may stop the run or hold the machine
    changes: Floats  # (corners, 17): see the columns below
    calls: Ints  # (n, 2): see the columns below
    ways: Floats  # (pairs of Circuit.outside, 6): see the columns below
    blur: Floats  # (corners,): deviation of noise unresolved that reaches over it; -1: none does
    rough: Ints  # (n,): 1 where such noise has made a signal, between the ends of the window


# Columns of State.memory, each at the start of the window and at its end: the state of an integrator,
# what it integrates, the output before the lag, which is also what a store keeps. The mode of an
# integrator does not change within a window.
X, X_END, DRIVE, DRIVE_END, BEFORE, BEFORE_END, AS = range(7)
# Columns of State.changes, of changes of piece: when the last one was; how many have followed each other
# within a few lags, since when; of those that were too many: from when on, how many at most. Of changes
# upward, and TURNS columns further of those downward: when the last one was, the interval before it, its
# share of the interval before that, how many such shares in a row were below 1, by how much the first of
# these was, and how far the guard swung then.
LAST_S, IN_A_ROW, SINCE_S, FROM_S, MOST = range(5)
TURNED_S, SPAN_S, RATIO, SHRUNK, GAP, SWUNG = range(5, 11)
TURNS = 6
# Indices into State.clock: time since the last jump, length of windows where no layer lasts, length of
# the last window; largest error estimate of a window, and their sum for the ends of the windows; when
# an overload stopped the run or held the machine; length that the last window suggests for the next;
# what it left of the series, in relation to its length (0: unknown); how far into the interval it
# paused (0: it did not); what the sweeps of the last window may have left.
AGE, CRUISE, LENGTH, WORST, SUM_OF_ERRORS, OVERLOAD_S, NEXT, LEFT, INTO_S, SWEPT = range(10)
# Rows of State.rungs: after a jump of a held input, and after an event. So many windows are learned.
AFTER_INPUT, AFTER_EVENT = range(2)
RUNGS = 8
# Indices into State.counts: started, last window's points can be used for a guess, windows accepted and
# rejected, sweeps, events, record rows, windows to wait before the length may grow; what an overload
# does, whether the machine is in HOLD because of one; what jumped last, AFTER_INPUT or AFTER_EVENT, and
# the number of the window since; whether a comparator has switched that starts a task; the corner that
# ended the run, or -1; the number of windows after which it pauses even within an interval.
STARTED, KNOWN, WINDOWS, REJECTED, SWEEPS, EVENTS, ROWS, WAIT = range(8)
ON_OVERLOAD, FROZEN, JUMPED, RUNG, CALLED, ENDED_BY, LAST_WINDOW = range(8, 15)
# Columns of State.calls, of a comparator that starts tasks: which ways of switching do, and which
# happened.
WANTED, HAPPENED = range(2)
RISES, FALLS = 1, 2
# Columns of State.ways, of what drives a loop from outside: its value where it last moved, and which
# way, 1 or -1 (0: not yet); of the last change of the corner up, which way it went then, and 1 where it
# has turned since; the same of the last change down.
STOOD, WAY, WAY_THEN, TURNED = range(4)
DOWN = 2

# Rows of State.row: what a torn signal was before this sweep; how far such signals have moved in it.
OLD, MOVED = 1, 2

# Sweeps after which a window is given up as too long.
MOST_SWEEPS = 40


def new_state(circuit: Circuit, q: int = 8) -> State:
    """State of a run that has not started."""
    n, m, p = len(circuit.rows), len(circuit.corners), LANES
    inputs = int(np.sum(circuit.rows[:, KIND] == INPUT))
    memory, start = np.zeros((n, 7)), np.zeros(n)
    memory[:, AS] = OP
    put_at_first(circuit.initial, memory, start)
    first_s = 2.0 * circuit.taus_s[0] if len(circuit.taus_s) else math.inf
    rungs, counts, changes = np.zeros((2, RUNGS)), np.zeros(15, dtype=np.int64), np.zeros((m, 17))
    rungs[:, 0], counts[ENDED_BY], counts[LAST_WINDOW] = first_s, -1, np.iinfo(np.int64).max
    changes[:, [LAST_S, TURNED_S, TURNED_S + TURNS]], changes[:, FROM_S] = -math.inf, math.nan
    return State(
        np.zeros(inputs),
        np.full(inputs, np.nan),
        start,
        lined_up(n, p),
        np.zeros(n),
        lined_up(n, p),
        memory,
        circuit.initial_piece.copy(),
        np.zeros(m),
        lined_up(m, p),
        lined_up(3, p),
        np.zeros(1 + q),
        lined_up(1 + p, p),
        np.zeros((m, 2)),
        np.zeros((n, 6)),
        lined_up(len(circuit.noisy), p),
        np.array([0.0, math.inf, 0.0, 0.0, 0.0, math.nan, first_s, 0.0, 0.0, 0.0]),
        rungs,
        counts,
        np.zeros(n, dtype=np.int64),
        changes,
        np.zeros((n, 2), dtype=np.int64),
        new_ways(circuit),
        np.full(m, -1.0),
        np.zeros(n, dtype=np.int64),
    )


def put_at_first(initial: Floats, memory: Floats, start: Floats) -> None:
    """Put what a circuit begins with, (..., n, 2), into memory and signals of one state or of many."""
    memory[..., [X, X_END, BEFORE, BEFORE_END]] = initial[..., :1]
    start[...] = np.where(np.isnan(initial[..., 1]), 0.0, initial[..., 1])


def new_ways(circuit: Circuit) -> Floats:
    """State.ways before anything has changed."""
    return np.zeros((len(circuit.outside), 6))


@compiled
def function_of(kind: int, u: float, w: float, exponent: float) -> float:
    """Smooth static functions."""
    if kind == PRODUCT:
        return u * w
    if kind == QUOTIENT:
        return u / w
    if kind == SQRT:
        return math.sqrt(max(u, 0.0))
    if kind == SIN:
        return math.sin(u)
    if kind == COS:
        return math.cos(u)
    if kind == ANGLE:
        return math.atan2(u, w)
    return math.copysign(abs(u) ** exponent, u)


@inlined
def piece_of(pieces: Floats, p: int, g: float) -> float:
    """Piece number p at g."""
    x = g - pieces[p, AT]
    return float((pieces[p, C2] * x + pieces[p, C1]) * x + pieces[p, C0])


@inlined
def angle_in(piece: int, angle: float) -> float:
    """An angle from -pi to pi as its piece has it, which is smooth through the cut at +-pi.

    Piece 1 (above) reaches from -pi/2 to 3 pi/2, piece 0 (below) from -3 pi/2 to pi/2.
    """
    if piece > 0 and angle < -0.5 * math.pi:
        return angle + 2.0 * math.pi
    if piece == 0 and angle > 0.5 * math.pi:
        return angle - 2.0 * math.pi
    return angle


@inlined
def room_of(piece: int, angle: float) -> float:
    """The guard of an angle: falls through 0 where piece 1, rises through 0 where piece 0 ends.

    Piece 1 ends at pi and at -1, piece 0 at -pi and at 1: angles about 0 change no piece.
    """
    if piece > 0:
        return (math.pi - angle) * (angle + 1.0)
    return (math.pi + angle) * (angle - 1.0)


@inlined
def is_high(rows: Ints, piece: Ints, memory: Floats, by: int) -> bool:
    """Whether element `by` is high: what it controls does not wait for its lag."""
    if rows[by, KIND] == PIECES:
        return bool(piece[rows[by, CORNER]] > 0)
    return bool(memory[by, BEFORE] > 0.5)


@inlined
def sweep(
    circuit: Circuit,
    state: State,
    shelf: Shelf,
    grid: Nodes,
    slot: int,
    first: int,
    last: int,
    t_s: float,
    length_s: float,
) -> float:
    """Evaluate elements first to last at the nodes; the largest change of a signal already read.

    Changes of signals beyond full scale count in relation to the signal.
    """
    rows, figures, signal, gain = circuit.rows, circuit.figures, circuit.signal, circuit.gain
    start, nodes, memory, scratch = state.start, state.nodes, state.memory, state.row
    weights, decay, fresh = shelf.weights, shelf.decay, state.fresh
    laws, end = slot * decay.shape[1], np.uint64(len(grid.marks) - 1)
    fill(scratch, MOVED, 0.0)
    for row in range(first, last):
        e = np.uint64(row)  # a sign would be looked at each time
        plain, terms, middle = rows[e, PLAIN], rows[e, FIRST], rows[e, SECOND]
        if plain == PRODUCT:
            one, other, last_term = figures[e, CONSTANT], figures[e, SECOND_CONSTANT], rows[e, END]
            offset = figures[e, OFFSET]
            gather_product(
                scratch, 0, offset, one, other, gain, nodes, signal, terms, middle, last_term
            )
        elif plain == SUM:
            gather(scratch, 0, figures[e, CONSTANT], gain, nodes, signal, terms, middle)
        elif plain == INTEGRATE and memory[e, AS] == OP:
            gather(scratch, 0, figures[e, CONSTANT], gain, nodes, signal, terms, middle)
            integrate(rows, memory, weights, decay, scratch, laws, row, end)
            if figures[e, GAIN] != 1.0 or figures[e, OFFSET] != 0.0:
                scale(scratch, 0, figures[e, GAIN], figures[e, OFFSET])
        else:
            special(circuit, state, shelf, grid, laws, row, t_s, length_s)
        memory[e, BEFORE_END] = scratch[0, end]
        if rows[e, TEAR] != 0:
            copy(scratch, OLD, nodes, row)
        lag = rows[e, LAG]
        if lag >= 0:
            law = laws + lag
            by = law * (1 + LANES)
            combine(nodes, row, decay, law, start[e], weights, by, memory[e, BEFORE], scratch, 0)
        else:
            copy(nodes, row, scratch, 0)
        if rows[e, NOISE] >= 0:
            add_scaled(nodes, row, 1.0, fresh, rows[e, NOISE])
        if rows[e, TEAR] != 0:
            size = abs(nodes[e, end])
            farther(scratch, MOVED, 1.0 if size <= 1.0 else 1.0 / size, nodes, row, scratch, OLD)
    return float(largest(scratch, MOVED))


@inlined
def integrate(
    rows: Ints,
    memory: Floats,
    weights: Floats,
    decay: Floats,
    scratch: Floats,
    laws: int,
    row: int,
    end: int,
) -> None:
    """What is in scratch row 0, integrated."""
    e = np.uint64(row)
    memory[e, DRIVE_END] = scratch[0, end]
    law = laws + rows[e, LAW]
    by = law * (1 + LANES)
    combine(scratch, 0, decay, law, memory[e, X], weights, by, memory[e, DRIVE], scratch, 0)
    memory[e, X_END] = scratch[0, end]


@inlined
def special(
    circuit: Circuit,
    state: State,
    shelf: Shelf,
    grid: Nodes,
    laws: int,
    e: int,
    t_s: float,
    length_s: float,
) -> None:
    """Any element up to its lag, into scratch row 0; `laws`: first row of the operators."""
    rows, figures, signal, gain = circuit.rows, circuit.figures, circuit.signal, circuit.gain
    corners, pieces, marks = circuit.corners, circuit.pieces, grid.points
    held, nodes, memory = state.held, state.nodes, state.memory
    piece, guard, scratch, q = state.piece, state.guard, state.row, len(grid.marks)
    kind, corner, stop = rows[e, KIND], rows[e, CORNER], rows[e, STOP]
    terms, middle, end = rows[e, FIRST], rows[e, SECOND], rows[e, END]
    p = corners[corner, FIRST_PIECE] + piece[corner] if corner >= 0 else 0
    constant, mode = figures[e, CONSTANT], memory[e, AS]
    factor, offset = figures[e, GAIN], figures[e, OFFSET]
    stores = kind == TRACK and not is_high(rows, piece, memory, rows[e, CONTROL])
    if stores:  # what it keeps has been through these
        factor, offset = 1.0, 0.0
    if mode == HOLD:
        middle = terms
    elif mode == IC:
        terms, middle, constant = middle, end, figures[e, SECOND_CONSTANT]
    gather(scratch, 0, constant, gain, nodes, signal, terms, middle)
    if kind == PIECES:
        if state.blur[corner] >= 0.0:
            copy(guard, corner, scratch, 0)
            blurred(circuit, state, grid, corner)
        else:
            for i in range(LANES):
                guard[corner, i] = scratch[0, i]
                scratch[0, i] = piece_of(pieces, p, scratch[0, i])
    elif kind != SUM and kind != INTEGRATE:
        gather(scratch, 1, figures[e, SECOND_CONSTANT], gain, nodes, signal, middle, end)
        if kind == PRODUCT:
            multiply(scratch, 0, scratch, 1)
        elif kind == SWITCH:
            if not is_high(rows, piece, memory, rows[e, CONTROL]):
                copy(scratch, 0, scratch, 1)
        elif kind == TRACK:
            if stores:
                fill(scratch, 0, memory[e, BEFORE])
                if figures[e, LEAK] > 0.0:
                    for i in range(LANES):
                        age = figures[e, LEAK] * length_s * marks[min(i + 1, q)]
                        scratch[0, i] *= math.exp(-age)
        elif kind == MODE:
            fill(scratch, 0, memory[e, BEFORE])
        elif kind == INPUT:
            fill(scratch, 0, held[rows[e, CONTROL]])
        elif kind == SINE:
            rate, turned = figures[e, OMEGA], figures[e, OMEGA] * t_s + figures[e, PHASE]
            # Within a turn: after many the last digit would be more than a corner is located to.
            phase = math.atan2(math.sin(turned), math.cos(turned))
            for i in range(LANES):
                angle = rate * length_s * marks[min(i + 1, q)] + phase
                scratch[0, i] = figures[e, AMPLITUDE] * math.sin(angle)
        else:
            for i in range(LANES):
                x, y = scratch[0, i], scratch[1, i]
                scratch[0, i] = function_of(kind, x, y, figures[e, EXPONENT])
            if kind == ANGLE and state.blur[corner] < 0.0:
                for i in range(LANES):
                    scratch[0, i] = angle_in(piece[corner], scratch[0, i])
                    guard[corner, i] = room_of(piece[corner], scratch[0, i])
    kept = mode == HOLD and figures[e, KEEPS] != 0.0
    if kept:
        fill(scratch, 0, memory[e, X])
    if kept or (kind == INTEGRATE and mode == IC):
        if corner >= 0:
            copy(guard, corner, scratch, 0)
            if piece[corner] != 1:
                scale(guard, corner, 1.0, -pieces[p, C0])
                fill(scratch, 0, pieces[p, C0])
        memory[e, X_END] = scratch[0, q - 1]
    elif kind == INTEGRATE:
        if corner >= 0 and piece[corner] != 1:
            memory[e, DRIVE_END] = scratch[0, q - 1]
            limit = pieces[p, C0]
            copy(guard, corner, scratch, 0)
            scale(guard, corner, 1.0, figures[e, FEEDBACK] * limit)
            fill(scratch, 0, limit)
            memory[e, X_END] = limit
        else:
            integrate(rows, memory, shelf.weights, shelf.decay, scratch, laws, e, q - 1)
            if corner >= 0:
                copy(guard, corner, scratch, 0)
    if factor != 1.0 or offset != 0.0:
        scale(scratch, 0, factor, offset)
    if stop >= 0 and state.blur[stop] >= 0.0:
        copy(guard, stop, scratch, 0)
        blurred(circuit, state, grid, stop)
    elif stop >= 0:
        p = corners[stop, FIRST_PIECE] + piece[stop]
        for i in range(LANES):
            guard[stop, i] = scratch[0, i]
            scratch[0, i] = piece_of(pieces, p, scratch[0, i])


@inlined
def blurred(circuit: Circuit, state: State, grid: Nodes, corner: int) -> None:
    """The pieces of a corner that noise reaches over, of scratch row 0, in its place."""
    first, end = circuit.corners[corner, FIRST_PIECE], circuit.corners[corner, END_PIECE]
    answer(circuit.pieces, first, end, state.blur[corner], state.row, grid)


@compiled
def solve_again(
    circuit: Circuit,
    state: State,
    shelf: Shelf,
    grid: Nodes,
    t_s: float,
    length_s: float,
    tolerance: float,
) -> bool:
    """`solve` for windows that are cut short, which are few: called, and not in line."""
    fits: bool = solve(circuit, state, shelf, grid, t_s, length_s, tolerance)
    return fits


@inlined
def solve(
    circuit: Circuit,
    state: State,
    shelf: Shelf,
    grid: Nodes,
    t_s: float,
    length_s: float,
    tolerance: float,
) -> bool:
    """Sweep until the loops agree to `tolerance`; false where they do not.

    What remains is judged from the rate at which the changes fell, so the last sweep need not prove
    that nothing moves any more.
    """
    slot = shelved(shelf, grid, circuit.laws, length_s)
    heads, cores, n = circuit.ranges[0], circuit.ranges[1], circuit.rows.shape[0]
    first, last = 0, heads if heads > 0 else cores
    turn, before = 0, math.inf
    state.clock[SWEPT] = 0.0
    while True:  # one call only: the compiler puts the sweep in line at each
        change = sweep(circuit, state, shelf, grid, slot, first, last, t_s, length_s)
        if first == 0 and heads > 0:
            first, last = heads, cores
        elif first == cores:
            return True
        else:
            state.counts[SWEEPS] += 1
            ratio = change / before
            if agree(turn, change, ratio, tolerance):
                state.clock[SWEPT] = left_open(turn, change, ratio, tolerance)
                first, last = cores, n
            elif turn == MOST_SWEEPS or not change < RUNAWAY_MU or (turn >= 6 and ratio > 0.9):
                return False
            turn += 1
            before = change


@inlined
def agree(turn: int, change: float, ratio: float, tolerance: float) -> bool:
    """Whether what sweeps still change is below `tolerance`, or is rounding.

    Where changes fall fast the next one need not be seen; what was computed before a torn signal's last
    change is off by that change, though, so it must be small itself.
    """
    if change <= tolerance:
        return True
    if turn > 0 and ratio < 0.3 and change * ratio <= tolerance / 2 and change <= 100 * tolerance:
        return True
    return turn > 3 and ratio > 0.8 and change < 100 * tolerance


@inlined
def left_open(turn: int, change: float, ratio: float, tolerance: float) -> float:
    """What sweeps may have left that agree, by the last one's change.

    What was computed before the torn signals is off by a part of it: in a loop of two integrators by as
    much as half a sweep brings.
    """
    share = math.sqrt(min(ratio, 1.0)) if turn > 0 else 1.0
    return min(change * share, tolerance)
