"""Tables whose points lie anywhere, read: the simplex around a place, or the nearest place that has one.

Stage 4. What is read depends on the place only, not on where was looked before. Where several simplices
meet, the first is taken; all agree there.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hybrid.engine.compiling import strictly_alike
from hybrid.meshes import (
    ACTION,
    CELLS,
    FACE_COUNT,
    FACES,
    FLAT,
    LISTS,
    LOW,
    PLANE_COUNT,
    PLANES,
    SIMPLICES,
    SPAN,
)
from hybrid.tables import CONTINUES, MOST_VARIABLES

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Columns of `places` in the rooms of the variables: the place asked for, and the one that is looked up.
ASKED, FOUND = 0, 1
# Of the range of the points: what is farther has no square that is a number, and no answer.
FARTHEST = 1e150


@strictly_alike
def _weight(f: Floats, simplex: int, n: int, corner: int, p: Floats, column: int) -> float:
    """The weight of a corner but the last."""
    room, weight = p.shape[0] - MOST_VARIABLES, 0.0
    for i in range(n):
        weight += f[simplex + corner * n + i] * (p[room + i, column] - f[simplex + n * n + i])
    return weight


@strictly_alike
def _least(f: Floats, simplex: int, n: int, p: Floats, least: float) -> float:
    """The least weight that any corner has at the place FOUND: not below 0 within the simplex.

    least: below this any may stand for it.
    """
    last, found = 1.0, math.inf
    for corner in range(n):
        weight = _weight(f, simplex, n, corner, p, FOUND)
        last -= weight
        found = min(found, weight)
        if found < least:
            return found
    return min(found, last)


@strictly_alike
def _simplex(f: Floats, at: int, n: int, p: Floats) -> tuple[int, bool]:
    """Where the figures of the simplex around the place FOUND are, or of that which misses it least;
    whether it is within."""
    room, cells, cell = p.shape[0] - MOST_VARIABLES, int(f[at + CELLS]), 0
    for i in range(n):
        x = min(max(p[room + i, FOUND], 0.0), 1.0)
        cell = cell * cells + min(int(x * cells), cells - 1)
    lists, first = at + int(f[at + LISTS]), at + int(f[at + SIMPLICES])
    best, highest = first, -math.inf
    for k in range(int(f[lists + cell]), int(f[lists + cell + 1])):
        simplex = first + int(f[lists + k]) * (n * n + 2 * n + 1)
        least = _least(f, simplex, n, p, highest)
        if least > highest:
            best, highest = simplex, least
        if least >= 0.0:
            break
    return best, highest >= 0.0


@strictly_alike
def _is_beyond(f: Floats, at: int, n: int, p: Floats) -> bool:
    """Whether the place ASKED is outside of all points."""
    room, planes = p.shape[0] - MOST_VARIABLES, at + int(f[at + PLANES])
    for k in range(int(f[at + PLANE_COUNT])):
        plane = planes + k * (n + 1)
        height = f[plane + n]
        for i in range(n):
            height += f[plane + i] * p[room + i, ASKED]
        if height > FLAT:
            return True
    return False


@strictly_alike
def _row(f: Floats, row: int, n: int, p: Floats) -> float:
    """A row of a face's figures at the place ASKED."""
    room, value = p.shape[0] - MOST_VARIABLES, float(f[row + n])
    for i in range(n):
        value += f[row + i] * p[room + i, ASKED]
    return value


@strictly_alike
def _to_nearest(f: Floats, at: int, n: int, p: Floats) -> float:
    """Put the place among the points that is nearest to ASKED into FOUND; how far it is away."""
    room, faces = p.shape[0] - MOST_VARIABLES, at + int(f[at + FACES])
    nearest, best = math.inf, faces
    for k in range(int(f[at + FACE_COUNT])):
        face = faces + k * 2 * n * (n + 1)
        within = True
        for corner in range(n):
            within = within and _row(f, face + corner * (n + 1), n, p) >= -FLAT
        if within:
            square = 0.0
            for i in range(n):
                foot = _row(f, face + (n + i) * (n + 1), n, p)
                square += (foot - p[room + i, ASKED]) ** 2
            if square < nearest:
                nearest, best = square, face
    for i in range(n):
        p[room + i, FOUND] = _row(f, best + (n + i) * (n + 1), n, p)
    return math.sqrt(nearest)


@strictly_alike
def _value(f: Floats, simplex: int, n: int, p: Floats, column: int) -> float:
    """The straight function of a simplex."""
    last, value, values = 1.0, 0.0, simplex + n * n + n
    for corner in range(n):
        weight = _weight(f, simplex, n, corner, p, column)
        last -= weight
        value += weight * f[values + corner]
    return value + last * float(f[values + n])


@strictly_alike
def _onwards(f: Floats, simplex: int, n: int, p: Floats) -> float:
    """The same at the place ASKED beyond the points, from its value at FOUND on: where all values are
    equal no distance makes anything else of them."""
    value, values = _value(f, simplex, n, p, FOUND), simplex + n * n + n
    for corner in range(n):
        way = _weight(f, simplex, n, corner, p, ASKED) - _weight(f, simplex, n, corner, p, FOUND)
        value += way * (f[values + corner] - f[values + n])
    return value


@strictly_alike
def read_scattered(f: Floats, at: int, n: int, p: Floats) -> tuple[float, float]:
    """The table at the place ASKED, in the units of its variables; how far that is beyond its points, in
    parts of their range."""
    room = p.shape[0] - MOST_VARIABLES
    for i in range(n):
        x = (p[room + i, ASKED] - f[at + LOW + i]) / f[at + SPAN + i]
        if not abs(x) < FARTHEST:
            return math.nan, 0.0
        p[room + i, ASKED], p[room + i, FOUND] = x, x
    simplex, is_within = _simplex(f, at, n, p)
    if is_within or not _is_beyond(f, at, n, p):
        return _value(f, simplex, n, p, ASKED), 0.0
    beyond = _to_nearest(f, at, n, p)
    simplex, _ = _simplex(f, at, n, p)
    if f[at + ACTION] == CONTINUES:
        return _onwards(f, simplex, n, p), beyond
    return _value(f, simplex, n, p, FOUND), beyond
