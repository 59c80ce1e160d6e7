"""Signals beyond full scale in a window: since when, how far and how long.

Stage 4. Everything is read from the signal's polynomial, so that it is as exact as the window.
"""

from __future__ import annotations

from hybrid.engine.arrays import Floats
from hybrid.engine.beyond import (
    BEYOND_S,
    FIRST_S,
    FIRST_VALUE,
    FULL_SCALE,
    HALVINGS,
    TIMES,
    WORST_S,
    WORST_VALUE,
)
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.lanes import between
from hybrid.engine.nodes import RESOLUTION, Nodes, slope_at
from hybrid.engine.sweep import State

# A resolved signal that is nowhere beyond this at the points stays below full scale between them: for a
# sine to rise by 3 % from a point to its peak, the window would be 2.5 rad long, of which 8 nodes leave
# 3e-6 and more.
NEAR = 0.97


@inlined
def watch(state: State, grid: Nodes, t_s: float, length_s: float) -> None:
    """Note every signal that is beyond full scale in the window that begins at t_s."""
    start, nodes, overload = state.start, state.nodes, state.overload
    for e in range(nodes.shape[0]):
        if abs(start[e]) > NEAR or not between(nodes, e, -NEAR, NEAR):
            if state.rough[e] > 0:
                _note_end(start[e], nodes[e, len(grid.marks) - 1], overload[e], t_s, length_s)
                continue
            _note(grid, start[e], nodes[e], overload[e], t_s, length_s)


@compiled
def _note_end(start: float, end: float, overload: Floats, t_s: float, length_s: float) -> None:
    """Look at the end alone: what lies before it is averages."""
    if not abs(end) > FULL_SCALE:
        return
    if overload[TIMES] == 0.0:
        overload[FIRST_S], overload[FIRST_VALUE] = t_s + length_s, end
    if abs(start) > FULL_SCALE:
        overload[BEYOND_S] += length_s
    if abs(end) > abs(overload[WORST_VALUE]):
        overload[WORST_VALUE], overload[WORST_S] = end, t_s + length_s
    overload[TIMES] += 1.0


@compiled
def _note(
    grid: Nodes, start: float, nodes: Floats, overload: Floats, t_s: float, length_s: float
) -> None:
    """Look at the signal between each two points, parted where it turns."""
    q, found = len(grid.marks), False
    before_at, before, slope_before = 0.0, start, slope_at(grid, start, nodes, 0)
    for k in range(q):
        end_at, end, slope_end = grid.points[k + 1], nodes[k], slope_at(grid, start, nodes, k + 1)
        turn_at, turn = before_at, 0.0
        rise = _tangents_meet(before, slope_before, end, slope_end, end_at - before_at)
        if slope_before * slope_end < 0.0 and abs(rise) > 1.0 + RESOLUTION:
            turn_at = _where(grid, start, nodes, 1, 0.0, before_at, end_at)
            turn = _read(grid, start, nodes, 0, turn_at)
        if abs(turn) > max(1.0 + RESOLUTION, abs(before), abs(end)):
            ways = ((before_at, before, turn_at, turn), (turn_at, turn, end_at, end))
        else:
            ways = ((before_at, before, end_at, end), (end_at, end, end_at, end))
        for way in ways:
            for sign in (1.0, -1.0):
                if max(sign * way[1], sign * way[3]) > FULL_SCALE:
                    first = overload[TIMES] == 0.0 and not found
                    _add(grid, start, nodes, overload, way, sign, first, t_s, length_s)
                    found = True
        before_at, before, slope_before = end_at, end, slope_end
    if found:
        overload[TIMES] += 1.0


@compiled
def _add(
    grid: Nodes,
    start: float,
    nodes: Floats,
    overload: Floats,
    way: tuple[float, float, float, float],
    sign: float,
    first: bool,
    t_s: float,
    length_s: float,
) -> None:
    """Add a stretch on which the signal rises or falls: (fraction, value) at either end."""
    begins_at, begins, ends_at, ends = way
    if not sign * begins > FULL_SCALE:
        begins_at = _where(grid, start, nodes, 0, sign * FULL_SCALE, begins_at, ends_at)
        begins = sign
    if not sign * ends > FULL_SCALE:
        ends_at = _where(grid, start, nodes, 0, sign * FULL_SCALE, begins_at, ends_at)
    if first:
        overload[FIRST_S], overload[FIRST_VALUE] = t_s + length_s * begins_at, begins
    overload[BEYOND_S] += length_s * (ends_at - begins_at)
    if sign * begins > abs(overload[WORST_VALUE]):
        overload[WORST_VALUE], overload[WORST_S] = begins, t_s + length_s * begins_at
    if sign * ends > abs(overload[WORST_VALUE]):
        overload[WORST_VALUE], overload[WORST_S] = ends, t_s + length_s * ends_at


@compiled
def _tangents_meet(
    before: float, slope_before: float, end: float, slope_end: float, width: float
) -> float:
    """Where the tangents at two points meet: further out than a signal that turns once in between.

    To find the turn itself costs as much as some sweeps, and few are near enough to matter.
    """
    if slope_before == slope_end:
        return before
    return before + slope_before * (end - before - slope_end * width) / (slope_before - slope_end)


@compiled
def _where(
    grid: Nodes, start: float, nodes: Floats, order: int, figure: float, low: float, high: float
) -> float:
    """Where the signal (order 0) or its slope (1) passes a figure, by bisection.

    At the fractions `low` and `high` of the window it is on different sides.
    """
    below = _read(grid, start, nodes, order, low) < figure
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if (_read(grid, start, nodes, order, middle) < figure) == below:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@compiled
def _read(grid: Nodes, start: float, nodes: Floats, order: int, at: float) -> float:
    """The signal (order 0) or its slope (1) at a fraction of the window, by its Legendre series."""
    q, x = len(grid.marks), 2.0 * at - 1.0
    total, before, now, slope_before, slope = 0.0, 0.0, 1.0, 0.0, 0.0
    for n in range(q + 1):
        coefficient = grid.series[n, 0] * start
        for j in range(q):
            coefficient += grid.series[n, j + 1] * nodes[j]
        total += coefficient * (2.0 * slope if order == 1 else now)
        # P'_(n+1) = P'_(n-1) + (2 n + 1) P_n
        slope_before, slope = slope, slope_before + (2 * n + 1) * now
        before, now = now, ((2 * n + 1) * x * now - n * before) / (n + 1)
    return total
