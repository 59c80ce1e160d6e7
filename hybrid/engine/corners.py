"""Pieces of what is not smooth: which one holds at an instant, and when a window leaves it.

Stage 4. Inside a window pieces do not change. Where a guarded quantity leaves the bounds of its piece
the window is cut, the neighbouring piece takes over and integration starts anew: every signal, piece and
mode is settled as it is right after the jump.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hybrid.elements import (
    ANGLE,
    INPUT,
    INTEGRATE,
    MODE,
    NUMBER,
    PIECES,
    SINE,
    SUM,
    SWITCH,
    TRACK,
)
from hybrid.engine.arrays import Floats, Ints
from hybrid.engine.circuit import (
    AMPLITUDE,
    C0,
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
    HIGH,
    HOLD_BY,
    KIND,
    LAG,
    LOW,
    OF_INTEGRATOR,
    OFFSET,
    OMEGA,
    OWNER,
    PHASE,
    RESET,
    ROLE,
    SECOND,
    SECOND_CONSTANT,
    STOP,
    TEAR,
    WHICH,
    Circuit,
)
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.lanes import between, combine
from hybrid.engine.nodes import Nodes
from hybrid.engine.sweep import (
    AS,
    BEFORE,
    CALLED,
    DRIVE,
    EVENTS,
    FALLS,
    FROZEN,
    HAPPENED,
    RISES,
    STARTED,
    WANTED,
    State,
    X,
    angle_in,
    function_of,
    is_high,
    piece_of,
    room_of,
)
from hybrid.modes import HOLD, IC, OP

# A quantity counts as outside a piece once it is this far out, in machine units: more than rounding
# leaves at an instant that was located, less than anybody measures. The first is for the instant after
# a jump or an event, the second for nodes of a window.
SLACK_AT_REST = 1e-11
SLACK = 1e-13


class Log(NamedTuple):
    """Events in order; State.counts tells how many there were, which may be more than fit."""

    times_s: Floats  # (most,): since the start of the call
    rows: Ints  # (most, 2): element, new piece


def new_log(most: int = 1000) -> Log:
    """An empty log."""
    return Log(np.zeros(most), np.zeros((most, 2), dtype=np.int64))


@compiled
def change_piece(
    circuit: Circuit, state: State, corner: int, by: int, t_s: float, log: Log
) -> None:
    """Go to the next piece up or down and log it."""
    state.piece[corner] += by
    e = circuit.corners[corner, OWNER]
    if circuit.corners[corner, ROLE] == OF_INTEGRATOR and state.piece[corner] != 1:
        state.memory[e, X] = circuit.pieces[
            circuit.corners[corner, FIRST_PIECE] + state.piece[corner], C0
        ]
    switched = RISES if state.piece[corner] > 0 else FALLS
    if corner == circuit.rows[e, CORNER] and state.calls[e, WANTED] & switched:
        state.calls[e, HAPPENED] |= switched
        state.counts[CALLED] = 1
    number = state.counts[EVENTS]
    if number < log.times_s.shape[0]:
        log.times_s[number] = t_s
        log.rows[number, 0], log.rows[number, 1] = e, state.piece[corner]
    state.counts[EVENTS] += 1


@inlined
def _right_piece(
    circuit: Circuit, state: State, corner: int, g: float, t_s: float, log: Log
) -> float:
    """Move to the piece that holds g; the piece's value there."""
    slack = SLACK_AT_REST * max(1.0, abs(g))
    first, end = circuit.corners[corner, FIRST_PIECE], circuit.corners[corner, END_PIECE]
    while True:
        p = first + state.piece[corner]
        if g > circuit.pieces[p, HIGH] + slack and p + 1 < end:
            change_piece(circuit, state, corner, 1, t_s, log)
        elif g < circuit.pieces[p, LOW] - slack and p > first:
            change_piece(circuit, state, corner, -1, t_s, log)
        else:
            return float(piece_of(circuit.pieces, p, g))


@compiled
def _right_side(
    circuit: Circuit, state: State, corner: int, angle: float, t_s: float, log: Log
) -> float:
    """Move to the piece that holds an angle from -pi to pi; the angle as that piece has it."""
    room = room_of(state.piece[corner], angle_in(state.piece[corner], angle))
    if state.piece[corner] > 0 and room < -SLACK_AT_REST:
        change_piece(circuit, state, corner, -1, t_s, log)
    elif state.piece[corner] == 0 and room > SLACK_AT_REST:
        change_piece(circuit, state, corner, 1, t_s, log)
    angle = angle_in(state.piece[corner], angle)
    state.guard_start[corner] = room_of(state.piece[corner], angle)
    return angle


@inlined
def sum_at(
    start: Floats, signal: Ints, gain: Floats, constant: float, first: int, end: int
) -> float:
    """A sum at an instant, its terms first to end."""
    total = constant
    for t in range(first, end):
        total += gain[t] * start[signal[t]]
    return total


@inlined
def moves(rows: Ints, laws: Floats, e: int, moving_s: float) -> bool:
    """Whether element e has a lag shorter than moving_s."""
    return bool(rows[e, LAG] >= 0 and laws[rows[e, LAG], 0] * moving_s > 1.0)


@compiled
def _stop_integrator(circuit: Circuit, state: State, e: int, t_s: float, log: Log) -> None:
    """Hold a limited integrator that is driven beyond its limit; free one that is driven back."""
    corner = circuit.rows[e, CORNER]
    first = circuit.corners[corner, FIRST_PIECE]
    low, high = circuit.pieces[first + 1, LOW], circuit.pieces[first + 1, HIGH]
    if state.piece[corner] == 1:
        state.memory[e, X] = min(max(state.memory[e, X], low), high)
    drive = state.memory[e, DRIVE] + circuit.figures[e, FEEDBACK] * state.memory[e, X]
    slack = SLACK_AT_REST * max(1.0, abs(drive))
    if state.piece[corner] == 1:
        if state.memory[e, X] >= high and drive > slack:
            change_piece(circuit, state, corner, 1, t_s, log)
        elif state.memory[e, X] <= low and drive < -slack:
            change_piece(circuit, state, corner, -1, t_s, log)
    elif (state.piece[corner] == 2 and drive < -slack) or (
        state.piece[corner] == 0 and drive > slack
    ):
        change_piece(circuit, state, corner, 1 - state.piece[corner], t_s, log)
    state.guard_start[corner] = state.memory[e, X] if state.piece[corner] == 1 else drive


@inlined
def _mode_of(circuit: Circuit, lead: State, e: int) -> int:
    """The mode of an integrator or of the machine: what gives its number, what resets, what holds."""
    rows, mode = circuit.rows, OP
    if lead.counts[FROZEN] > 0:
        return HOLD
    if rows[e, CONTROL] >= 0:
        mode = int(lead.memory[rows[e, CONTROL], BEFORE])
    by = rows[e, RESET]
    if mode == IC or (by >= 0 and is_high(rows, lead.piece, lead.memory, by)):
        return IC
    by = rows[e, HOLD_BY]
    if by >= 0 and is_high(rows, lead.piece, lead.memory, by):
        return HOLD
    return mode


@inlined
def _set_integrator(
    circuit: Circuit, state: State, e: int, mode: int, u: float, t_s: float, log: Log, first: bool
) -> bool:
    """Put it into its mode, in IC or at first at its initial value; whether that moved it."""
    rows, before, corner = circuit.rows, state.memory[e, X], circuit.rows[e, CORNER]
    state.memory[e, AS] = mode
    state.memory[e, DRIVE] = circuit.figures[e, CONSTANT] if mode == HOLD else u
    if mode == IC or (first and rows[e, END] > rows[e, SECOND]):
        constant = circuit.figures[e, SECOND_CONSTANT]
        w = sum_at(
            state.start, circuit.signal, circuit.gain, constant, rows[e, SECOND], rows[e, END]
        )
        state.memory[e, X] = w
        if corner >= 0:
            piece = circuit.corners[corner, FIRST_PIECE] + 1
            low, high = circuit.pieces[piece, LOW], circuit.pieces[piece, HIGH]
            slack = SLACK_AT_REST * max(1.0, abs(w))
            # On a bound it stays in the piece that it is in.
            least = 2 if w > high + slack else 1 if w > low + slack else 0
            most = 0 if w < low - slack else 1 if w < high - slack else 2
            wanted = min(max(state.piece[corner], least), most)
            while state.piece[corner] != wanted:
                by = 1 if wanted > state.piece[corner] else -1
                change_piece(circuit, state, corner, by, t_s, log)
            state.memory[e, X] = min(max(w, low), high)
            state.guard_start[corner] = w if wanted == 1 else w - state.memory[e, X]
    if mode != IC and corner >= 0:
        _stop_integrator(circuit, state, e, t_s, log)
    return bool(state.memory[e, X] != before)


@compiled
def settle(
    circuit: Circuit,
    state: State,
    lead: State,
    call_s: float,
    t_s: float,
    log: Log,
    lags_too: bool,
    moving_s: float,
) -> None:
    """Signals and pieces right after a jump, t_s into a call that began at call_s.

    What remembers stays; the rest follows in order, and once more where an integrator or a store that
    its mode made to follow is read earlier in the order. `lags_too` lets lagged outputs follow as well;
    those whose lag is shorter than `moving_s` move by as much as their input, once: what has read such
    a one before follows it in another pass. Modes, and what stores do, are those of `lead`: the same
    state, unless another leads it.
    """
    rows, figures, memory, start = circuit.rows, circuit.figures, state.memory, state.start
    torn = circuit.torn
    for e in range(rows.shape[0]):
        if rows[e, KIND] != INTEGRATE:
            continue
        v, before = figures[e, GAIN] * memory[e, X] + figures[e, OFFSET], memory[e, BEFORE]
        if rows[e, LAG] < 0 or (lags_too and math.isnan(circuit.initial[e, 1])):
            start[e] = v
        elif moves(rows, circuit.laws, e, moving_s):
            memory[e, BEFORE] = v
            start[e] += v - before
    read_before = False
    for k in range(torn.shape[0]):
        read_before |= moves(rows, circuit.laws, torn[k], moving_s)
    for _ in range(rows.shape[0] + 2):
        if not _settle_in_order(circuit, state, lead, call_s, t_s, log, lags_too, moving_s):
            if not read_before:
                break
            read_before, moving_s = False, 0.0


@inlined
def _settle_in_order(
    circuit: Circuit,
    state: State,
    lead: State,
    call_s: float,
    t_s: float,
    log: Log,
    lags_too: bool,
    moving_s: float,
) -> bool:
    """One pass of `settle`; whether an integrator or a store moved that had been read before."""
    # Plain names: each array is looked up once, and not at every use.
    rows, figures, signal, gain = circuit.rows, circuit.figures, circuit.signal, circuit.gain
    laws, initial = circuit.laws, circuit.initial
    start, memory, piece = state.start, state.memory, state.piece
    moved = False
    for e in range(rows.shape[0]):
        kind, corner, stop = rows[e, KIND], rows[e, CORNER], rows[e, STOP]
        follows = rows[e, LAG] < 0 or (lags_too and math.isnan(initial[e, 1]))
        u = sum_at(start, signal, gain, figures[e, CONSTANT], rows[e, FIRST], rows[e, SECOND])
        v = u
        if kind == INTEGRATE:
            mode = _mode_of(circuit, lead, e)
            jumped = _set_integrator(circuit, state, e, mode, u, t_s, log, lags_too)
            moved |= jumped and follows and rows[e, TEAR] != 0
            v = memory[e, X]
        elif kind == PIECES:
            state.guard_start[corner] = u
            v = _right_piece(circuit, state, corner, u, t_s, log)
        elif kind == INPUT:
            v = state.held[rows[e, CONTROL]]
        elif kind == MODE:
            which, mode = figures[e, WHICH], _mode_of(circuit, lead, e)
            v = 1.0 if mode == which else 0.0
            if which == NUMBER:
                v = float(mode)
        elif kind == SINE:
            if state.counts[STARTED] > 0:
                # It does not jump: it is where the last window left it. After many turns the digits of
                # time are too few to find it there again.
                continue
            v = figures[e, AMPLITUDE] * math.sin(
                figures[e, OMEGA] * (call_s + t_s) + figures[e, PHASE]
            )
        elif kind == TRACK and not is_high(rows, lead.piece, lead.memory, rows[e, CONTROL]):
            if follows:
                start[e] = memory[e, BEFORE]
            continue
        elif kind != SUM and kind != TRACK:
            w = sum_at(
                start, signal, gain, figures[e, SECOND_CONSTANT], rows[e, SECOND], rows[e, END]
            )
            if kind == SWITCH:
                v = u if is_high(rows, piece, memory, rows[e, CONTROL]) else w
            else:
                v = function_of(kind, u, w, figures[e, EXPONENT])
                if kind == ANGLE:
                    v = _right_side(circuit, state, corner, v, t_s, log)
        v, before = figures[e, GAIN] * v + figures[e, OFFSET], memory[e, BEFORE]
        if stop >= 0:
            state.guard_start[stop] = v
            v = _right_piece(circuit, state, stop, v, t_s, log)
        memory[e, BEFORE] = v
        if follows:
            moved |= kind == TRACK and rows[e, TEAR] != 0 and start[e] != v
            start[e] = v
        elif moves(rows, laws, e, moving_s):
            start[e] += v - before
    return moved


@inlined
def first_exit(circuit: Circuit, state: State, grid: Nodes) -> tuple[int, float]:
    """Corner whose guard leaves its piece first, and at what fraction of the window; (-1, 1) if none.

    Guards are looked at in the nodes and midway between; an excursion that fits between two of these
    stays unseen.
    """
    found, at = -1, 1.0
    starts, guard, middle = state.guard_start, state.guard, state.row
    for corner in range(circuit.corners.shape[0]):
        p = circuit.corners[corner, FIRST_PIECE] + state.piece[corner]
        low, high = circuit.pieces[p, LOW], circuit.pieces[p, HIGH]
        combine(middle, 0, guard, corner, 0.0, grid.midway, 0, starts[corner], guard, corner)
        if between(guard, corner, low, high) and between(middle, 0, low, high):
            continue  # as nearly always
        before, after = leaves(grid, starts[corner], guard[corner], low, high)
        if after >= before and before < at:
            when = locate(grid, starts[corner], guard[corner], low, high, before, after)
            if found < 0 or when < at:
                found, at = corner, when
    return found, at


@compiled
def _beyond(g: float, low: float, high: float) -> float:
    """How far g is outside of [low, high]; negative inside."""
    return max(low - g, g - high)


@compiled
def leaves(
    grid: Nodes, start: float, guard: Floats, low: float, high: float
) -> tuple[float, float]:
    """Fractions between which the guard leaves; (1, 0) if it stays."""
    q = len(grid.marks)
    if low == -math.inf and high == math.inf:
        return 1.0, 0.0
    slack = SLACK
    if low > -math.inf:
        slack = max(slack, SLACK * abs(low))
    if high < math.inf:
        slack = max(slack, SLACK * abs(high))
    # Right after an event it may still be beyond by what locating left, and is on its way in.
    beyond = _beyond(start, low, high)
    if beyond < SLACK_AT_REST * max(1.0, abs(start)):
        slack = max(slack, beyond)
    before = 0.0
    for k in range(q):
        middle = grid.between[k, 0] * start
        for j in range(q):
            middle += grid.between[k, j + 1] * guard[j]
        at = 0.5 * (grid.points[k] + grid.points[k + 1])
        if _beyond(middle, low, high) > slack:
            return before, at
        before = at
        if _beyond(guard[k], low, high) > slack:
            return before, grid.points[k + 1]
        before = grid.points[k + 1]
    return 1.0, 0.0


@compiled
def locate(
    grid: Nodes, start: float, guard: Floats, low: float, high: float, before: float, after: float
) -> float:
    """Where the guard crosses its bound, by bisection with secant steps (Illinois variant)."""
    g_before, g_after = _guard_at(grid, start, guard, before), _guard_at(grid, start, guard, after)
    bound = high if g_after > high else low
    f, h = g_before - bound, g_after - bound
    if before == 0.0:
        f = start - bound
    if f * h > 0.0 or abs(f) <= SLACK * max(1.0, abs(bound)):  # on the bound from the beginning
        inside = _inside(grid, start, guard, bound, h, before, after)
        if inside == before:
            return before
        before, f = inside, _guard_at(grid, start, guard, inside) - bound
    side = 0
    for _ in range(80):
        at = after - h * (after - before) / (h - f)
        g = _guard_at(grid, start, guard, at) - bound
        if abs(g) < 1e-17 or after - before < 1e-16:
            return float(at)
        if g * h > 0.0:
            after, h = at, g
            if side == 1:
                f *= 0.5
            side = 1
        else:
            before, f = at, g
            if side == -1:
                h *= 0.5
            side = -1
    return after


@compiled
def _inside(
    grid: Nodes, start: float, guard: Floats, bound: float, h: float, before: float, after: float
) -> float:
    """Where a guard that begins on its bound is inside of it, before it leaves; `before` if nowhere.

    A jump may have turned it back; where windows are long it is out again at the first place looked at.
    """
    slack, width = SLACK * max(1.0, abs(bound)), after - before
    for _ in range(60):
        width *= 0.5
        g = _guard_at(grid, start, guard, before + width) - bound
        if g * h < 0.0 and abs(g) > slack:
            return before + width
    return before


@compiled
def _guard_at(grid: Nodes, start: float, guard: Floats, at: float) -> float:
    """The guard's polynomial at a fraction of the window, by its Legendre series."""
    q = len(grid.marks)
    x = 2.0 * at - 1.0
    total, before, now = 0.0, 0.0, 1.0
    for n in range(q + 1):
        coefficient = grid.series[n, 0] * start
        for j in range(q):
            coefficient += grid.series[n, j + 1] * guard[j]
        total += coefficient * now
        before, now = now, ((2 * n + 1) * x * now - n * before) / (n + 1)
    return total
