"""Corners that switch too often: as fast as lags allow, without getting on, or ever faster to an end.

Stage 4. The last is what a ball without lags does that comes to rest: its jumps are infinitely many in
a finite time. They are followed to where two of them can hardly be told apart; the geometric series that
the intervals make gives the end.
"""

from __future__ import annotations

import math

from hybrid.engine.arrays import Floats
from hybrid.engine.circuit import (
    AT,
    C0,
    C1,
    C2,
    END_PIECE,
    FIRST_PIECE,
    GAIN,
    HIGH,
    LAG,
    LOOPED,
    LOW,
    OF_INTEGRATOR,
    OF_SUM,
    OWNER,
    ROLE,
    Circuit,
)
from hybrid.engine.compiling import compiled
from hybrid.engine.nodes import Nodes, slope_at
from hybrid.engine.sweep import (
    DOWN,
    FROM_S,
    GAP,
    IN_A_ROW,
    LAST_S,
    MOST,
    RATIO,
    SHRUNK,
    SINCE_S,
    SPAN_S,
    STOOD,
    SWUNG,
    TURNED,
    TURNED_S,
    TURNS,
    WAY,
    WAY_THEN,
    State,
)

# Neighbouring pieces that differ by more where one passes into the other make a jump.
JUMP_MU = 1e-9
# So many events of one corner within so many of the shortest lag are chatter.
CHATTER_EVENTS = 64
CHATTER_LAGS = 4.0
# A change that is forced takes so much off the count: some seem so that are not.
FORCED_SHARE = 0.125
# Changes that follow each other within so many lags of the part are as fast as loops of lags swing.
QUICK_LAGS = 16.0
CHATTER_S = 1e-12
# Intervals each shorter than this share of the one before, so many in a row, and by a share that stays
# within SAME_GAP, are taken to go on so. They are followed until the guard swings by so little between
# two changes, of its unit and of what it did when they began to shrink, and all that is left is well
# within the shortest lag.
SHRINKS = 0.9995
SHRINKING = 3
SAME_GAP = 0.1
LEAST_SWING = 1e-9
LEAST_SHARE = 1e-3
SHARE_OF_LAG = 0.1


@compiled
def watch_outside(circuit: Circuit, ways: Floats, signals: Floats) -> None:
    """Note which way what drives loops from outside has moved, at the end of a window; signals: (n,)."""
    for pair in range(ways.shape[0]):
        value = signals[circuit.outside[pair, 1]]
        moved = value - ways[pair, STOOD]
        if abs(moved) > JUMP_MU * max(1.0, abs(value)):
            way = math.copysign(1.0, moved)
            if way != ways[pair, WAY]:
                ways[pair, TURNED], ways[pair, TURNED + DOWN] = 1.0, 1.0
            ways[pair, STOOD], ways[pair, WAY] = value, way


@compiled
def forced(circuit: Circuit, ways: Floats, corner: int, by: int) -> bool:
    """Whether a change of a corner, up or down, comes of what drives its loops from outside.

    A relay that is forced comes back because the forcing has gone to and fro, and goes the same way as
    it did then. One that swings by the lags of its loop comes back without, or so by chance.
    """
    found, k = False, 0 if by > 0 else DOWN
    for pair in range(ways.shape[0]):
        if circuit.outside[pair, 0] == corner:
            alike = ways[pair, WAY] == ways[pair, WAY_THEN + k]
            found |= alike and ways[pair, TURNED + k] > 0.0
            ways[pair, WAY_THEN + k], ways[pair, TURNED + k] = ways[pair, WAY], 0.0
    return found


@compiled
def count_on(count: float, is_forced: bool) -> float:
    """A count of changes that may be chatter, after one more."""
    return max(count - FORCED_SHARE, 0.0) if is_forced else count + 1.0


@compiled
def chatters(circuit: Circuit, recent: Floats, corner: int, now_s: float, is_forced: bool) -> bool:
    """Whether a corner has had too many events without getting on; `recent`: since when, how many.

    What is driven to and fro from outside, however fast, gets on.
    """
    span = CHATTER_S
    if circuit.taus_s.shape[0] > 0 and drives_itself(circuit, corner):
        span = max(span, CHATTER_LAGS * circuit.taus_s[0])
    if now_s - recent[corner, 0] > span:
        recent[corner, 0], recent[corner, 1] = now_s, 0.0
    recent[corner, 1] = count_on(recent[corner, 1], is_forced)
    return bool(recent[corner, 1] > CHATTER_EVENTS)


@compiled
def drives_itself(circuit: Circuit, corner: int) -> bool:
    """Whether a change of this corner makes its element jump, and the jump comes back to it."""
    return bool(circuit.corners[corner, LOOPED] > 0 and jumps(circuit, corner))


@compiled
def jumps(circuit: Circuit, corner: int) -> bool:
    """Whether neighbouring pieces of a corner differ where the first is left; an integrator's stop
    changes nothing at once."""
    corners, pieces = circuit.corners, circuit.pieces
    size = 1.0  # what a sum makes may be in SI units
    if corners[corner, ROLE] == OF_INTEGRATOR:
        return False
    if corners[corner, ROLE] == OF_SUM:
        size = abs(circuit.figures[corners[corner, OWNER], GAIN])
    for p in range(corners[corner, FIRST_PIECE], corners[corner, END_PIECE] - 1):
        x, y = pieces[p, HIGH] - pieces[p, AT], pieces[p, HIGH] - pieces[p + 1, AT]
        before = pieces[p, C0] + x * (pieces[p, C1] + x * pieces[p, C2])
        after = pieces[p + 1, C0] + y * (pieces[p + 1, C1] + y * pieces[p + 1, C2])
        if abs(after - before) * size > JUMP_MU:
            return True
    return False


@compiled
def count_change(
    circuit: Circuit, changes: Floats, corner: int, at_s: float, is_forced: bool
) -> None:
    """Count changes of piece as fast as the lags allow; they are the patch's doing, so all goes on."""
    lag = circuit.rows[circuit.corners[corner, OWNER], LAG]
    if lag < 0:
        return
    if not at_s - changes[corner, LAST_S] <= QUICK_LAGS / circuit.laws[lag, 0]:
        changes[corner, IN_A_ROW] = 0.0
    if changes[corner, IN_A_ROW] == 0.0:
        changes[corner, SINCE_S] = at_s
    changes[corner, LAST_S] = at_s
    changes[corner, IN_A_ROW] = count_on(changes[corner, IN_A_ROW], is_forced)
    if changes[corner, IN_A_ROW] > CHATTER_EVENTS:
        if changes[corner, MOST] == 0.0:
            changes[corner, FROM_S] = changes[corner, SINCE_S]
        changes[corner, MOST] = max(changes[corner, MOST], changes[corner, IN_A_ROW])


@compiled
def gathers(
    circuit: Circuit,
    state: State,
    grid: Nodes,
    corner: int,
    by: int,
    at_s: float,
    length_s: float,
) -> bool:
    """Count a change that a window is about to end with; whether such changes, up or down, are about to
    come to an end of their time.

    A guard that falls back as a ball does, at a constant rate, swings by slope * interval / 4.
    """
    swing, shortest_s = math.inf, 0.0
    if length_s > 0.0:  # a window of no length has no slope; the way back is looked at, too
        slope = slope_at(grid, state.guard_start[corner], state.guard[corner], len(grid.marks))
        swing = 0.25 * abs(slope) / length_s * since(state.changes, corner, by, at_s)
    if circuit.taus_s.shape[0] > 0:
        shortest_s = circuit.taus_s[0]
    p = circuit.corners[corner, FIRST_PIECE] + state.piece[corner]
    bound = circuit.pieces[p, HIGH] if by > 0 else circuit.pieces[p, LOW]
    return bool(closes_in(state.changes, corner, by, at_s, swing, bound, shortest_s))


@compiled
def since(changes: Floats, corner: int, by: int, at_s: float) -> float:
    """How long ago the last change the same way was."""
    return float(at_s - changes[corner, TURNED_S + (0 if by > 0 else TURNS)])


@compiled
def closes_in(
    changes: Floats,
    corner: int,
    by: int,
    at_s: float,
    swing: float,
    bound: float,
    shortest_s: float,
) -> bool:
    """Count a change, up or down, between which and the last the guard went as far as `swing`; whether
    such changes are about to come to an end of their time. shortest_s: the shortest lag, or 0."""
    k = 0 if by > 0 else TURNS
    span, before = since(changes, corner, by, at_s), changes[corner, SPAN_S + k]
    ratio = span / before if before > 0.0 else math.inf
    changes[corner, TURNED_S + k], changes[corner, SPAN_S + k] = at_s, span
    changes[corner, RATIO + k] = ratio
    if not 0.0 < ratio < SHRINKS:
        changes[corner, SHRUNK + k] = 0.0
        return False
    if changes[corner, SHRUNK + k] == 0.0 and swing == math.inf:  # it begins with what can be seen
        return False
    changes[corner, SHRUNK + k] += 1.0
    if changes[corner, SHRUNK + k] == 1.0:
        changes[corner, GAP + k], changes[corner, SWUNG + k] = 1.0 - ratio, swing
    left_s = span * ratio / (1.0 - ratio)
    if shortest_s > 0.0 and left_s > SHARE_OF_LAG * shortest_s:
        return False
    # What began to shrink within the last digits shrinks as they happen to fall.
    if not changes[corner, SWUNG + k] > LEAST_SWING * max(1.0, abs(bound)):
        return False
    # Intervals as 1, 1/2, 1/3, ... shrink as well, less and less, and come to no end.
    if abs(1.0 - ratio - changes[corner, GAP + k]) > SAME_GAP * changes[corner, GAP + k]:
        return False
    least = min(LEAST_SWING * max(1.0, abs(bound)), LEAST_SHARE * changes[corner, SWUNG + k])
    return bool(changes[corner, SHRUNK + k] >= SHRINKING and swing < least)
