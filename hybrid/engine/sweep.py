"""One window of a circuit: every element evaluated at the nodes, in order, until the loops agree.

Stage 4. Static functions are taken node by node; integrators and lags are applied as the fixed operators
of `nodes`. A signal read before it is computed starts from a guess; each sweep through the elements of
loops brings it closer, by a factor of about (rate * window)^k / k! in sweep k.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from hybrid.elements import (
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
    EXPONENT,
    FEEDBACK,
    FIRST,
    FIRST_PIECE,
    GAIN,
    KEEPS,
    KIND,
    LAG,
    LAW,
    NOISE,
    OFFSET,
    OMEGA,
    PHASE,
    SECOND,
    SECOND_CONSTANT,
    STOP,
    TEAR,
    Circuit,
)
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.kernel import RUNAWAY_MU, Floats, Ints
from hybrid.engine.nodes import Nodes, Shelf, padded, shelved
from hybrid.modes import HOLD, IC, OP

# Four nodes that lie side by side become one vector instruction only by this pass of LLVM, which numba
# leaves off unless told: 1.5 times the speed.
numba.config.SLP_VECTORIZE = 1  # type: ignore[attr-defined]


class State(NamedTuple):
    """All that changes during a run of n elements; owned by the run. P = padded(q) nodes."""

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
    row: Floats  # (2, P): scratch
    guess: Floats  # (P, q + 1): from the last window's points to this one's nodes
    guess_for: (
        Floats  # (3,): place, length and degree it was made for, in lengths of the last window
    )
    overload: Floats  # (n, 6): see the columns below
    fresh: Floats  # (noisy, P): noise that came up in the window, at its nodes
    clock: Floats  # see the constants below
    counts: Ints  # see the constants below
    watched: Ints  # (n,): 1 where an overload may stop the run or hold the machine


# Columns of State.memory, each at the start of the window and at its end: the state of an integrator,
# what it integrates, the output before the lag, which is also what a store keeps. The mode of an
# integrator does not change within a window.
X, X_END, DRIVE, DRIVE_END, BEFORE, BEFORE_END, AS = range(7)
# Columns of State.overload, of a signal beyond full scale: when first and its value then, the worst
# value and when, how long altogether, in how many windows.
FIRST_S, FIRST_VALUE, WORST_VALUE, WORST_S, BEYOND_S, TIMES = range(6)
# Indices into State.clock: time since the last jump, working length, length of the last window, share of
# the shortest lag that the first window after a jump takes; largest error estimate of a window, and
# their sum for the ends of the windows; when an overload stopped the run or held the machine.
AGE, CRUISE, LENGTH, FIRST_SHARE, WORST, SUM_OF_ERRORS, OVERLOAD_S = range(7)
# Indices into State.counts: started, last window's points can be used for a guess, windows accepted and
# rejected, sweeps, events, record rows, windows to wait before the length may grow; what an overload
# does, whether the machine is in HOLD because of one.
STARTED, KNOWN, WINDOWS, REJECTED, SWEEPS, EVENTS, ROWS, WAIT, ON_OVERLOAD, FROZEN = range(10)

# Sweeps after which a window is given up as too long.
MOST_SWEEPS = 40


def new_state(circuit: Circuit, q: int = 8) -> State:
    """State of a run that has not started."""
    n, m, p = len(circuit.rows), len(circuit.corners), padded(q)
    inputs = int(np.sum(circuit.rows[:, KIND] == INPUT))
    memory = np.zeros((n, 7))
    memory[:, AS] = OP
    memory[:, [X, X_END, BEFORE, BEFORE_END]] = circuit.initial[:, :1]
    return State(
        np.zeros(inputs),
        np.full(inputs, np.nan),
        np.nan_to_num(circuit.initial[:, 1]),
        np.zeros((n, p)),
        np.zeros(n),
        np.zeros((n, p)),
        memory,
        circuit.initial_piece.copy(),
        np.zeros(m),
        np.zeros((m, p)),
        np.zeros((2, p)),
        np.zeros((p, q + 1)),
        np.full(3, np.nan),
        np.zeros((n, 6)),
        np.zeros((len(circuit.noisy), p)),
        np.array([0.0, math.inf, 0.0, 1.0, 0.0, 0.0, math.nan]),
        np.zeros(10, dtype=np.int64),
        np.zeros(n, dtype=np.int64),
    )


@inlined
def gather(
    nodes: Floats, i: int, signal: Ints, gain: Floats, constant: float, first: int, end: int
) -> Any:
    """Four neighbouring nodes, from i on, of a sum, its terms first to end."""
    a = constant
    b, c, d = a, a, a
    for t in range(first, end):
        s, g = signal[t], gain[t]
        a += g * nodes[s, i]
        b += g * nodes[s, i + 1]
        c += g * nodes[s, i + 2]
        d += g * nodes[s, i + 3]
    return a, b, c, d


@inlined
def apply_law(
    weights: Floats,
    decay: Floats,
    slot: int,
    law: int,
    block: int,
    y: float,
    v: float,
    scratch: Floats,
    r: int,
    q: int,
) -> Any:
    """Four neighbouring nodes of what a law makes of row r of `scratch`, from y and v at the start."""
    i = 4 * block
    a = decay[slot, law, i] * y + weights[slot, law, block, 0, 0] * v
    b = decay[slot, law, i + 1] * y + weights[slot, law, block, 0, 1] * v
    c = decay[slot, law, i + 2] * y + weights[slot, law, block, 0, 2] * v
    d = decay[slot, law, i + 3] * y + weights[slot, law, block, 0, 3] * v
    for k in range(q):
        x = scratch[r, k]
        a += weights[slot, law, block, k + 1, 0] * x
        b += weights[slot, law, block, k + 1, 1] * x
        c += weights[slot, law, block, k + 1, 2] * x
        d += weights[slot, law, block, k + 1, 3] * x
    return a, b, c, d


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
    return math.copysign(abs(u) ** exponent, u)


@inlined
def piece_of(pieces: Floats, p: int, g: float) -> float:
    """Piece number p at g."""
    x = g - pieces[p, AT]
    return float((pieces[p, C2] * x + pieces[p, C1]) * x + pieces[p, C0])


@inlined
def is_high(rows: Ints, piece: Ints, memory: Floats, by: int) -> bool:
    """Whether element `by` is high: what it controls does not wait for its lag."""
    if rows[by, KIND] == PIECES:
        return bool(piece[rows[by, CORNER]] > 0)
    return bool(memory[by, BEFORE] > 0.5)


@compiled
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
    # Plain names, and no calls with arrays: both would count references.
    rows, figures, signal, gain = circuit.rows, circuit.figures, circuit.signal, circuit.gain
    corners, pieces, marks = circuit.corners, circuit.pieces, grid.points
    held, start, nodes, memory = state.held, state.start, state.nodes, state.memory
    piece, guard, scratch = state.piece, state.guard, state.row
    weights, decay, fresh = shelf.weights, shelf.decay, state.fresh
    q = len(grid.marks)
    blocks = (q + 3) // 4
    change = 0.0
    for e in range(first, last):
        kind, corner, stop, lag = rows[e, KIND], rows[e, CORNER], rows[e, STOP], rows[e, LAG]
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
        for block in range(blocks):
            i = 4 * block
            a, b, c, d = gather(nodes, i, signal, gain, constant, terms, middle)
            if kind == PIECES:
                guard[corner, i], guard[corner, i + 1] = a, b
                guard[corner, i + 2], guard[corner, i + 3] = c, d
                a, b = piece_of(pieces, p, a), piece_of(pieces, p, b)
                c, d = piece_of(pieces, p, c), piece_of(pieces, p, d)
            elif kind == PRODUCT:
                w, x, y, z = gather(
                    nodes, i, signal, gain, figures[e, SECOND_CONSTANT], middle, end
                )
                a, b, c, d = a * w, b * x, c * y, d * z
            elif kind != SUM and kind != INTEGRATE:
                w, x, y, z = gather(
                    nodes, i, signal, gain, figures[e, SECOND_CONSTANT], middle, end
                )
                if kind == SWITCH:
                    if not is_high(rows, piece, memory, rows[e, CONTROL]):
                        a, b, c, d = w, x, y, z
                elif kind == TRACK:
                    if stores:
                        a = memory[e, BEFORE]
                        b, c, d = a, a, a
                elif kind == MODE:
                    a = memory[e, BEFORE]
                    b, c, d = a, a, a
                elif kind == INPUT:
                    a = held[rows[e, CONTROL]]
                    b, c, d = a, a, a
                elif kind == SINE:
                    rate, phase = figures[e, OMEGA], figures[e, OMEGA] * t_s + figures[e, PHASE]
                    a = figures[e, AMPLITUDE] * math.sin(
                        rate * length_s * marks[min(i + 1, q)] + phase
                    )
                    b = figures[e, AMPLITUDE] * math.sin(
                        rate * length_s * marks[min(i + 2, q)] + phase
                    )
                    c = figures[e, AMPLITUDE] * math.sin(
                        rate * length_s * marks[min(i + 3, q)] + phase
                    )
                    d = figures[e, AMPLITUDE] * math.sin(
                        rate * length_s * marks[min(i + 4, q)] + phase
                    )
                else:
                    exponent = figures[e, EXPONENT]
                    a, b = function_of(kind, a, w, exponent), function_of(kind, b, x, exponent)
                    c, d = function_of(kind, c, y, exponent), function_of(kind, d, z, exponent)
            scratch[0, i], scratch[0, i + 1], scratch[0, i + 2], scratch[0, i + 3] = a, b, c, d
        r = 0
        kept = mode == HOLD and figures[e, KEEPS] != 0.0
        if kept:
            for i in range(4 * blocks):
                scratch[0, i] = memory[e, X]
        if kept or (kind == INTEGRATE and mode == IC):
            if corner >= 0:
                for i in range(4 * blocks):
                    guard[corner, i] = scratch[0, i]
                    if piece[corner] != 1:
                        guard[corner, i] -= pieces[p, C0]
                        scratch[0, i] = pieces[p, C0]
            memory[e, X_END] = scratch[0, q - 1]
        elif kind == INTEGRATE:
            r = 1
            memory[e, DRIVE_END] = scratch[0, q - 1]
            x, v, law = memory[e, X], memory[e, DRIVE], rows[e, LAW]
            for block in range(blocks):
                i = 4 * block
                a, b, c, d = apply_law(weights, decay, slot, law, block, x, v, scratch, 0, q)
                scratch[1, i], scratch[1, i + 1], scratch[1, i + 2], scratch[1, i + 3] = a, b, c, d
            if corner >= 0:
                limit = pieces[p, C0]
                for i in range(4 * blocks):
                    if piece[corner] == 1:
                        guard[corner, i] = scratch[1, i]
                    else:
                        guard[corner, i] = scratch[0, i] + figures[e, FEEDBACK] * limit
                        scratch[1, i] = limit
            memory[e, X_END] = scratch[1, q - 1]
        if factor != 1.0 or offset != 0.0:
            for i in range(4 * blocks):
                scratch[r, i] = factor * scratch[r, i] + offset
        if stop >= 0:
            p = corners[stop, FIRST_PIECE] + piece[stop]
            for i in range(4 * blocks):
                guard[stop, i] = scratch[r, i]
                scratch[r, i] = piece_of(pieces, p, scratch[r, i])
        memory[e, BEFORE_END] = scratch[r, q - 1]
        tear, noisy = rows[e, TEAR] != 0, rows[e, NOISE]
        y, v = start[e], memory[e, BEFORE]
        if noisy >= 0:  # apart from the loop below, which is one of vector instructions
            for i in range(4 * blocks):
                nodes[e, i] -= fresh[noisy, i]
        for block in range(blocks):
            i = 4 * block
            if lag >= 0:
                a, b, c, d = apply_law(weights, decay, slot, lag, block, y, v, scratch, r, q)
            else:
                a, b, c, d = scratch[r, i], scratch[r, i + 1], scratch[r, i + 2], scratch[r, i + 3]
            if tear:
                moved = max(
                    max(abs(a - nodes[e, i]), abs(b - nodes[e, i + 1])),
                    max(abs(c - nodes[e, i + 2]), abs(d - nodes[e, i + 3])),
                ) / max(1.0, abs(a))
                if not moved <= change:  # also where it is no number
                    change = moved
            nodes[e, i], nodes[e, i + 1], nodes[e, i + 2], nodes[e, i + 3] = a, b, c, d
        if noisy >= 0:
            for i in range(4 * blocks):
                nodes[e, i] += fresh[noisy, i]
    return change


@compiled
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
                first, last = cores, n
            elif turn == MOST_SWEEPS or not change < RUNAWAY_MU or (turn >= 6 and ratio > 0.9):
                return False
            turn += 1
            before = change


@inlined
def agree(turn: int, change: float, ratio: float, tolerance: float) -> bool:
    """Whether what sweeps still change is below `tolerance`, or is rounding."""
    if change <= tolerance:
        return True
    if turn > 0 and ratio < 0.3 and change * ratio <= tolerance / 2:
        return True
    return turn > 3 and ratio > 0.8 and change < 100 * tolerance
