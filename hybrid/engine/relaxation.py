"""The nonlinear engine: advances a circuit window by window, as long as each is resolved.

Stage 4. A window is accepted when the Legendre coefficients of every signal have fallen below `rtol`
of full scale (of the signal, where that is larger): that bounds how well values inside it are known. Its
end is far better. Radau quadrature errs by about the square of what the polynomial leaves, and the
sweeps stop at a tolerance; the sum of both over all windows estimates what a run has gathered, as long
as the circuit itself does not magnify errors. With noise windows are as many as it asks for: what sweeps
left is measured, and of the true signals, where it has the signs of the draws, its squares are added up.

After a jump (start, change of a held input, event) lagged outputs relax as exp(-t / tau). Lags follow
any polynomial exactly, but what reads them takes their outputs for polynomials: so windows begin short
and grow until that layer has died out (`lengths`). Their number hardly depends on how short a lag is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hybrid.engine.arrays import Floats, Ints
from hybrid.engine.beyond import (
    FIRST_S,
    FIRST_VALUE,
    FULL_SCALE,
    TIMES,
    WORST_S,
    WORST_VALUE,
)
from hybrid.engine.circuit import FIRST_PIECE, HIGH, LOW, Circuit
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.corners import (
    SLACK_AT_REST,
    Log,
    change_piece,
    first_exit,
    leaves,
    locate,
    settle,
)
from hybrid.engine.handover import accept, guess
from hybrid.engine.kernel import RUNAWAY_MU
from hybrid.engine.lanes import dot
from hybrid.engine.lengths import adapt, begin_short, next_length, reject
from hybrid.engine.nodes import Nodes, Shelf, point_weights, slope_at
from hybrid.engine.noise import ROUNDING, Noise, bring_up, finest, jump, play_truth, show
from hybrid.engine.overloads import watch
from hybrid.engine.sweep import (
    AFTER_EVENT,
    AFTER_INPUT,
    CALLED,
    ENDED_BY,
    EVENTS,
    FROZEN,
    INTO_S,
    KNOWN,
    LAST_WINDOW,
    LENGTH,
    NEXT,
    ON_OVERLOAD,
    OVERLOAD_S,
    ROWS,
    STARTED,
    SWEPT,
    WINDOWS,
    State,
    solve,
    solve_again,
)
from hybrid.engine.switching import chatters, count_change, forced, gathers, watch_outside
from hybrid.modes import CONTINUE, STOP_RUN

# Why `advance` came back. SWITCHED: a comparator that starts a task. GATHERED: changes of a corner come
# at ever shorter intervals, and have come too close to each other to be told apart. PAUSED: to look at
# Ctrl-C after so many windows; the next call for the same interval goes on there, as if it had not.
DONE, RUNAWAY, CHATTER, UNRESOLVED, OVERLOADED, SWITCHED, GATHERED, PAUSED = range(8)

# How far from its bound a guard may be at an event, in the guard's unit: below `corners.SLACK_AT_REST`.
MOST_MISS = 1e-12
# No window is made shorter.
SHORTEST_S = 1e-15
# What rounding leaves of a time, as a share of it.
DIGITS = 4e-16


class Pen(NamedTuple):
    """What to record during a call: given signals at given instants after its start, ascending."""

    instants_s: Floats  # (rows,): > 0; the windows' polynomials are read there
    signals: Ints  # (columns,)
    values: Floats  # (rows, columns); State.counts tells how many rows are filled


def no_pen() -> Pen:
    """Nothing to record."""
    return Pen(np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros((0, 0)))


@compiled
def advance(
    circuit: Circuit,
    state: State,
    shelf: Shelf,
    grid: Nodes,
    t_s: float,
    duration_s: float,
    rtol: float,
    log: Log,
    pen: Pen,
    noise: Noise | None,
) -> tuple[int, float]:
    """Play `duration_s` seconds from the instant t_s on, State.held being constant; why it ended, when.

    The second figure counts from t_s. The log and the pen start anew at every call, but after a pause.
    With `noise`, `state` is the smooth run beside the true one, and what the pen writes.
    """
    # `noise` is looked at again and again, so that the compiler leaves out what has none.
    clock, counts, shown, taus_s = state.clock, state.counts, state, circuit.taus_s
    now, clock[INTO_S] = clock[INTO_S], 0.0
    if now == 0.0:
        counts[ROWS], counts[EVENTS] = 0, 0
        state.recent[:, :] = 0.0
    jumped = _begin(circuit, state, t_s, log)
    tolerance = min(max(1e-15, 1e-5 * rtol), 1e-12)
    if noise is not None:
        shown = noise.truth
        rtol, tolerance = finest(circuit, rtol, tolerance)
        if jumped:
            jump(circuit, state, noise, t_s, 0.0)
    while now < duration_s and counts[CALLED] == 0:
        if counts[WINDOWS] > counts[LAST_WINDOW] and now > 0.0:
            clock[INTO_S] = now
            return PAUSED, now
        if counts[ON_OVERLOAD] != CONTINUE:
            e = _beyond_now(state.watched, shown.start)
            if e >= 0:
                _note_if_first(state.clock, shown.overload[e], shown.start[e], t_s + now)
                if counts[ON_OVERLOAD] == STOP_RUN:
                    return OVERLOADED, now
                hold_for_good(circuit, state, t_s, now, log)
                if noise is not None:
                    jump(circuit, state, noise, t_s, now)
        length = next_length(min(clock[NEXT], circuit.longest_s), duration_s - now)
        _prepare_guess(circuit, state, shelf, grid, length)
        fits = solve(circuit, state, shelf, grid, t_s + now, length, tolerance)
        tail = _tail(state, grid) if fits else math.inf
        if not tail <= rtol:
            if length * 0.5 < SHORTEST_S:
                return _lost(state), now
            reject(state, taus_s, length, tail / rtol, len(grid.marks))
            continue
        corner, at, over, earlier, by, ends = -1, 1.0, -1, 1.0, 0, False
        # Time has no finer digits, so that nothing in so short a window says which comes first.
        if circuit.corners.shape[0] > 0 and length > max(SHORTEST_S, DIGITS * (t_s + now)):
            corner, at = first_exit(circuit, state, grid)
        if counts[ON_OVERLOAD] != CONTINUE:
            over, earlier = _first_overload(state, grid, at)
        if over >= 0:
            length = max(length * earlier, SHORTEST_S)
            guess(
                circuit, state, shelf, grid, 0.0, earlier, len(grid.marks), state.start, state.nodes
            )
            solve_again(circuit, state, shelf, grid, t_s + now, length, tolerance)
        elif corner >= 0:
            by = 1 if _guard_rises(circuit, state, grid, corner, at) else -1
            length = _cut(
                circuit, state, shelf, grid, t_s + now, at * length, length, corner, by, tolerance
            )
        if noise is not None:
            left_s = duration_s - now
            if not play_truth(circuit, state, noise, grid, t_s + now, length, left_s, tolerance):
                return _lost(noise.truth), now
        if by != 0:
            ends = gathers(circuit, state, grid, corner, by, t_s + now + length, length)
        if length > 0.0:
            whole = over < 0 and by == 0 and length == duration_s - now
            now = duration_s if whole else min(now + length, duration_s)
            _record(state, grid, pen, now, length)
            if noise is None:
                watch(state, grid, t_s + now - length, length)
            swept = tolerance if noise is None else clock[SWEPT] + ROUNDING
            accept(circuit, state, grid, length, tail, swept)
            watch_outside(circuit, state.ways, state.start)
        if over >= 0:
            _note_if_first(state.clock, shown.overload[over], state.start[over], t_s + now)
            if counts[ON_OVERLOAD] == STOP_RUN:
                return OVERLOADED, now
            hold_for_good(circuit, state, t_s, now, log)
        elif by == 0:
            adapt(state, taus_s, length, tail / rtol, len(grid.marks))
        else:
            change_piece(circuit, state, corner, by, now, log)
            settle(circuit, state, state, t_s, now, log, False, 0.0)
            begin_short(state, AFTER_EVENT)
            is_forced = forced(circuit, state.ways, corner, by)
            count_change(circuit, state.changes, corner, t_s + now, is_forced)
            chatter = chatters(circuit, state.recent, corner, now, is_forced)
            if ends or chatter:
                counts[ENDED_BY] = corner
                return GATHERED if ends else CHATTER, now
        if _lost(state) == RUNAWAY:
            return RUNAWAY, now
        if noise is not None:
            if _lost(noise.truth) == RUNAWAY:
                return RUNAWAY, now
            if over >= 0 or by != 0:
                jump(circuit, state, noise, t_s, now)
            elif bring_up(circuit, state, noise, t_s, now, log):
                begin_short(state, AFTER_EVENT)
                jump(circuit, state, noise, t_s, now)
    if noise is not None and duration_s > 0.0:
        show(circuit, state, noise, t_s, now)
    return SWITCHED if counts[CALLED] > 0 else DONE, now


@inlined
def _begin(circuit: Circuit, state: State, t_s: float, log: Log) -> bool:
    """Settle what follows at once, where something jumped or nothing has been played yet; whether so."""
    jumped = state.counts[STARTED] == 0
    for i in range(state.held.shape[0]):
        if state.held[i] != state.seen[i]:  # also the first time, when it is no number
            jumped = True
            state.seen[i] = state.held[i]
    if not jumped:
        return False
    settle(circuit, state, state, t_s, 0.0, log, state.counts[STARTED] == 0, 0.0)
    if state.counts[STARTED] == 0:  # pieces found for the first time are no events
        state.counts[EVENTS] = 0
    state.counts[STARTED] = 1
    begin_short(state, AFTER_INPUT)
    return True


@compiled
def _beyond_now(watched: Ints, start: Floats) -> int:
    """A watched signal that is beyond full scale at this instant, or -1."""
    for e in range(start.shape[0]):
        if watched[e] > 0 and abs(start[e]) > FULL_SCALE:
            return e
    return -1


@compiled
def _first_overload(state: State, grid: Nodes, before: float) -> tuple[int, float]:
    """The watched signal that first goes beyond full scale in this window, and at what fraction of it.

    (-1, 1) where none does before the fraction `before`. Looked for as corners are.
    """
    found, earliest = -1, 1.0
    for e in range(state.start.shape[0]):
        if state.watched[e] == 0:
            continue
        start, nodes = state.start[e], state.nodes[e]
        left, right = leaves(grid, start, nodes, -FULL_SCALE, FULL_SCALE)
        if right < left or left >= min(before, earliest):
            continue
        at = locate(grid, start, nodes, -FULL_SCALE, FULL_SCALE, left, right)
        if at < before and (found < 0 or at < earliest):
            found, earliest = e, at
    return found, earliest


@compiled
def _note_if_first(clock: Floats, overload: Floats, value: float, at_s: float) -> None:
    """Note an overload that the run answers, unless the window that led there has been noted."""
    clock[OVERLOAD_S] = at_s
    if overload[TIMES] == 0.0:
        overload[TIMES], overload[FIRST_S], overload[WORST_S] = 1.0, at_s, at_s
        overload[FIRST_VALUE], overload[WORST_VALUE] = value, value


@compiled
def hold_for_good(circuit: Circuit, state: State, t_s: float, now_s: float, log: Log) -> None:
    """Put the machine into HOLD, whatever its modes are meant to be from now on."""
    state.counts[FROZEN], state.counts[ON_OVERLOAD] = 1, CONTINUE
    settle(circuit, state, state, t_s, now_s, log, False, 0.0)
    begin_short(state, AFTER_EVENT)


@inlined
def _tail(state: State, grid: Nodes) -> float:
    """Largest of the last Legendre coefficients of any signal, of full scale or of the signal."""
    end, worst = len(grid.marks) - 1, 0.0
    start, nodes, tail, of_start = state.start, state.nodes, grid.tail, grid.tail_of_start
    for e in range(nodes.shape[0]):
        last = abs(of_start[0] * start[e] + dot(nodes, e, tail, 0))
        previous = abs(of_start[1] * start[e] + dot(nodes, e, tail, 1))
        # One coefficient may be zero by symmetry, two neighbours are not; each further degree brings
        # about one decade where windows are as long as they may.
        share = max(last, 0.1 * previous)
        if not share <= worst:  # most are far below, and need no division
            share /= max(1.0, abs(nodes[e, end]))
            if not share <= worst:
                worst = share
    return worst


@inlined
def _prepare_guess(
    circuit: Circuit, state: State, shelf: Shelf, grid: Nodes, length_s: float
) -> None:
    """Continue the last window's polynomials into this one; constants where they say nothing."""
    n = state.nodes.shape[0]
    ratio = length_s / state.clock[LENGTH] if state.counts[KNOWN] > 0 else math.inf
    if ratio > 4.0:
        for e in range(n):
            state.nodes[e, :] = state.start[e]
        return
    # Each degree brings about a decade; outside its window a series of Legendre polynomials grows by
    # x + sqrt(x^2 - 1) for each, which at x = 1 + 2 ratio is more than that from a ratio of 2 on.
    degree = len(grid.marks) if ratio < 2.0 else 4
    guess(circuit, state, shelf, grid, 1.0, ratio, degree, state.past, state.last)


@compiled
def _guard_rises(circuit: Circuit, state: State, grid: Nodes, corner: int, at: float) -> bool:
    """Whether the piece is left upward."""
    p = circuit.corners[corner, FIRST_PIECE] + state.piece[corner]
    low, high = circuit.pieces[p, LOW], circuit.pieces[p, HIGH]
    weights = state.point
    point_weights(grid, at, len(grid.marks), weights)
    g = weights[0] * state.guard_start[corner]
    for j in range(len(grid.marks)):
        g += weights[j + 1] * state.guard[corner, j]
    return bool(abs(g - high) < abs(g - low))


@compiled
def _cut(
    circuit: Circuit,
    state: State,
    shelf: Shelf,
    grid: Nodes,
    t_s: float,
    length_s: float,
    whole_s: float,
    corner: int,
    by: int,
    tolerance: float,
) -> float:
    """Solve again up to the event, and move its end until the guard is on its bound; the length."""
    p = circuit.corners[corner, FIRST_PIECE] + state.piece[corner]
    bound = circuit.pieces[p, HIGH] if by > 0 else circuit.pieces[p, LOW]
    q = len(grid.marks)
    # A fast guard that begins further from its bound must still come to it, however soon.
    missed = abs(state.guard_start[corner] - bound)
    if length_s < SHORTEST_S and missed <= SLACK_AT_REST * max(1.0, abs(bound)):
        return 0.0
    for _ in range(5):
        guess(circuit, state, shelf, grid, 0.0, length_s / whole_s, q, state.start, state.nodes)
        whole_s = length_s
        solve_again(circuit, state, shelf, grid, t_s, length_s, tolerance)
        miss = state.guard[corner, q - 1] - bound
        slope = slope_at(grid, state.guard_start[corner], state.guard[corner], q)
        step = -miss / slope if slope != 0.0 else math.inf
        if abs(miss) <= MOST_MISS * max(1.0, abs(bound)) or not abs(step) < 0.1:
            break
        if abs(step) < 1e-14:
            break
        length_s += step * length_s
    return whole_s


@compiled
def _record(state: State, grid: Nodes, pen: Pen, end_s: float, length_s: float) -> None:
    """Write the rows whose instants lie in the window that ends at end_s."""
    q, row = len(grid.marks), state.counts[ROWS]
    if row >= pen.instants_s.shape[0] or pen.instants_s[row] > end_s:
        return
    weights = state.point
    while row < pen.instants_s.shape[0] and pen.instants_s[row] <= end_s:
        at = 1.0 - (end_s - pen.instants_s[row]) / length_s
        point_weights(grid, min(max(at, 0.0), 1.0), q, weights)
        for column in range(pen.signals.shape[0]):
            e = pen.signals[column]
            value = weights[0] * state.start[e]
            for j in range(q):
                value += weights[j + 1] * state.nodes[e, j]
            pen.values[row, column] = value
        row += 1
    state.counts[ROWS] = row


@inlined
def _lost(state: State) -> int:
    """RUNAWAY if a signal is far beyond any scale or no number, else UNRESOLVED."""
    for e in range(state.start.shape[0]):
        if not abs(state.start[e]) <= RUNAWAY_MU:
            return RUNAWAY
    return UNRESOLVED
