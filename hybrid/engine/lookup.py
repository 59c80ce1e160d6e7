"""Table look-up: linear, monotone cubic or between scattered points, in one to four variables, compiled.

Stage 4. An argument is first sought among breakpoints, then tables are read where it lies; so tables
with breakpoints and arguments in common share the search. Each search remembers the interval it ended
in last, where the next begins: no answer depends on it, only how soon it is found.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from hybrid.engine.compiling import strictly_alike
from hybrid.engine.helper_functions import ABOVE as ABOVE_IT
from hybrid.engine.helper_functions import note_outside
from hybrid.engine.scattered import ASKED, read_scattered
from hybrid.meshes import ACTION
from hybrid.tables import CONTINUES, METHODS, MOST_VARIABLES, Axis, Table

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Columns of `axes`, a row for each search: where its breakpoints are among the figures, with the lowest
# and highest argument before them; how many breakpoints; what is done below and above.
POINTS, COUNT, BELOW, ABOVE = range(4)
# Columns of `tables`: the number of axes, the method, where the values begin; then for each axis its
# search, and how far apart its values are; after them, of scattered points, what lies beyond these.
AXES, METHOD, VALUES, FIRST_AXIS = range(4)
FIND, STRIDE, PER_AXIS = range(3)
COLUMNS = FIRST_AXIS + (MOST_VARIABLES + 1) * PER_AXIS
CUBIC, SIMPLICES, LIMITS = (METHODS.index(name) for name in ("cubic", "simplices", "limits"))
# What a search leaves behind. Floats: the argument within range, which part of the interval lies below
# it, the argument as it was when it was out of range; in further rows, one for each axis of a table that
# is being read, what was found at four neighbours. Ints: the interval; 0, or 1 more than what is done
# with an argument out of range, and ABOVE_IT where that is above.
X, PART, BEYOND = range(3)
INTERVAL, MISSED = range(2)


def pack(
    finds: Iterable[Axis], looks: Iterable[tuple[Table, Sequence[int]] | None]
) -> tuple[Floats, Ints, Ints]:
    """Figures, `axes` and `tables` for these searches and these tables with their searches."""
    figures: list[Floats] = [np.zeros(1)]
    starts: dict[int, int] = {}

    def start(key: object, *parts: Floats) -> int:
        """Where these figures are; of each key once."""
        if id(key) not in starts:
            starts[id(key)] = sum(map(len, figures))
            figures.extend(parts)
        return starts[id(key)]

    axes = [
        (
            start(axis, np.array(axis.range), axis.points) + 2,
            len(axis.points),
            axis.below,
            axis.above,
        )
        for axis in finds
    ]
    tables = np.zeros((len(looks := list(looks)), COLUMNS), dtype=np.int64)
    for row, look in enumerate(looks):
        if look is None:
            continue
        table, found = look
        values = table.values.ravel() if table.mesh is None else table.mesh
        values_at = start(table, values)
        tables[row, :FIRST_AXIS] = len(table.axes), METHODS.index(table.method), values_at
        for i, find in enumerate(found):
            first = FIRST_AXIS + i * PER_AXIS
            stride = int(np.prod(table.values.shape[i + 1 :], dtype=np.int64))
            tables[row, first : first + PER_AXIS] = find, stride
    return np.concatenate(figures), np.array(axes, dtype=np.int64).reshape(-1, 4), tables


def new_places(axes: Ints) -> tuple[Floats, Ints]:
    """What searches leave behind, before the first."""
    rows = len(axes) + MOST_VARIABLES
    return np.zeros((rows, 4)), np.zeros((len(axes), 2), dtype=np.int64)


@strictly_alike
def _find(figures: Floats, points: int, count: int, x: float, start: int) -> int:
    """The interval of x: points[i] <= x < points[i + 1]; the first and the last one have no end."""
    last = count - 2
    low, high = 0, last
    if x >= figures[points + start]:
        if start == last or x < figures[points + start + 1]:
            return start
        if start + 1 == last or x < figures[points + start + 2]:
            return start + 1
        low = start + 2
    else:
        if start <= 1 or x >= figures[points + start - 1]:
            return max(start - 1, 0)
        high = start - 2
    while low < high:
        middle = (low + high + 1) // 2
        if x >= figures[points + middle]:
            low = middle
        else:
            high = middle - 1
    return low


@strictly_alike
def _mix(near: float, far: float, t: float) -> float:
    """Straight from near, t = 0, to far, t = 1, both met exactly, and on beyond them.

    Beyond, from the nearer end on: where both are equal no distance makes anything else of them.
    """
    if t < 0.0:
        return near + t * (far - near)
    if t > 1.0:
        return far + (t - 1.0) * (far - near)
    return (1.0 - t) * near + t * far


@strictly_alike
def _straight(v: Floats, at: int, stride: int, t: float) -> float:
    """Between two neighbouring values."""
    return _mix(float(v[at]), float(v[at + stride]), t)


@strictly_alike
def _edge_slope(h: float, next_h: float, m: float, next_m: float) -> float:
    """Slope at an end of a monotone cubic: of three points, kept from overshooting."""
    slope = ((2.0 * h + next_h) * m - h * next_m) / (h + next_h)
    if slope * m <= 0.0:
        return 0.0
    if m * next_m < 0.0 and abs(slope) > 3.0 * abs(m):
        return 3.0 * m
    return slope


@strictly_alike
def _inner_slope(h: float, next_h: float, m: float, next_m: float) -> float:
    """Slope at an inner point: weighted harmonic mean, and none where the data turn."""
    if m * next_m <= 0.0:
        return 0.0
    w, next_w = 2.0 * next_h + h, next_h + 2.0 * h
    return (w + next_w) / (w / m + next_w / next_m)


@strictly_alike
def _cubic(
    p: Floats,
    points: int,
    count: int,
    i: int,
    x: float,
    before: float,
    left: float,
    right: float,
    after: float,
) -> float:
    """The monotone cubic between points i and i + 1 of values left and right; tangents beyond the ends.

    F. N. Fritsch and R. E. Carlson, SIAM J. Numer. Anal. 17 (1980) 238, with the slopes of Fritsch and
    Butland, SIAM J. Sci. Stat. Comput. 5 (1984) 300, as in SciPy's PchipInterpolator.
    """
    x0, x1 = float(p[points + i]), float(p[points + i + 1])
    h, m = x1 - x0, (right - left) / (x1 - x0)
    slope0, slope1 = m, m
    if count > 2:
        before_h, before_m, after_h, after_m = 0.0, 0.0, 0.0, 0.0
        if i > 0:
            before_h = x0 - p[points + i - 1]
            before_m = (left - before) / before_h
        if i < count - 2:
            after_h = p[points + i + 2] - x1
            after_m = (after - right) / after_h
        slope0 = (
            _inner_slope(before_h, h, before_m, m) if i > 0 else _edge_slope(h, after_h, m, after_m)
        )
        slope1 = (
            _inner_slope(h, after_h, m, after_m)
            if i < count - 2
            else _edge_slope(h, before_h, m, before_m)
        )
    t: float = (x - x0) / h
    if t < 0.0:
        return left + slope0 * h * t
    s = 1.0 - t
    if s < 0.0:
        return right - slope1 * h * s
    ends = s * s * (1.0 + 2.0 * t) * left + t * t * (1.0 + 2.0 * s) * right
    return ends + h * s * t * (s * slope0 - t * slope1)


@strictly_alike
def seek(
    find: int, asked: float, figures: Floats, axes: Ints, places: Floats, intervals: Ints
) -> bool:
    """Seek an argument among breakpoints; whether it is out of range. NaN lies anywhere."""
    points, x, missed = axes[find, POINTS], asked, False
    low, high = figures[points - 2], figures[points - 1]
    if x < low or x > high:
        missed = True
        action = axes[find, BELOW] if x < low else axes[find, ABOVE]
        intervals[find, MISSED] = 1 + action + (ABOVE_IT if x > high else 0)
        places[find, BEYOND] = x
        if action != CONTINUES:
            x = min(max(x, low), high)
    k = _find(figures, points, axes[find, COUNT], x, intervals[find, INTERVAL])
    intervals[find, INTERVAL] = k
    low, high = figures[points + k], figures[points + k + 1]
    places[find, X] = x
    places[find, PART] = (x - low) / (high - low)
    return missed


@strictly_alike
def note_missed(
    asks: npt.NDArray[np.int32],
    first: int,
    end: int,
    places: Floats,
    intervals: Ints,
    notes: Floats,
) -> None:
    """Remember which of the tables a program asks were out of range, in its order; see `TightTape`."""
    lost = False
    for k in range(first, end):
        find, site, axis = asks[k, 0], asks[k, 1], asks[k, 2]
        lost = lost and axis > 0  # what is no number has no answer, whatever comes after it
        if intervals[find, MISSED] > 0 and not lost:
            note_outside(notes, site, axis, places[find, BEYOND], intervals[find, MISSED] - 1)
        lost = lost or places[find, X] != places[find, X]
    for find in range(intervals.shape[0]):
        intervals[find, MISSED] = 0


@strictly_alike
def _cubics(
    f: Floats, axes: Ints, tables: Ints, row: int, count: int, at: int, r: Floats, i: Ints
) -> float:
    """Along the last axis, then of the results along the one before it, and so on.

    That is done for the four neighbours along every axis but the last, by turns as digits count.
    """
    value, last = 0.0, count - 1
    rooms = r.shape[0] - MOST_VARIABLES
    for neighbours in range(1 << 2 * last):
        here, rest, missing = at, neighbours, False
        for back in range(last):
            first = FIRST_AXIS + (last - 1 - back) * PER_AXIS
            find = tables[row, first + FIND]
            k = i[find, INTERVAL] + (rest & 3) - 1
            missing |= k < 0 or k >= axes[find, COUNT]
            here += k * tables[row, first + STRIDE]
            rest >>= 2
        axis, rest = last, neighbours
        while True:
            find = tables[row, FIRST_AXIS + axis * PER_AXIS + FIND]
            points, k, n, x = axes[find, POINTS], i[find, INTERVAL], axes[find, COUNT], r[find, X]
            if axis < last:
                room = rooms + axis
                before, left, right, after = r[room, 0], r[room, 1], r[room, 2], r[room, 3]
            elif not missing:
                before = f[here + k - 1] if k > 0 else 0.0
                after = f[here + k + 2] if k < n - 2 else 0.0
                left, right = f[here + k], f[here + k + 1]
            else:
                before, left, right, after = 0.0, 0.0, 0.0, 0.0
            value = _cubic(f, points, n, k, x, before, left, right, after)
            axis -= 1
            if axis < 0:
                break
            r[rooms + axis, rest & 3] = value
            if rest & 3 < 3:
                break
            rest >>= 2
    return value


@strictly_alike
def _among_points(
    row: int, figures: Floats, tables: Ints, places: Floats, intervals: Ints
) -> float:
    """A table of scattered points; beyond them is told where no argument was out of its range."""
    count, values = tables[row, AXES], tables[row, VALUES]
    rooms, told = places.shape[0] - MOST_VARIABLES, False
    for axis in range(count):
        find = tables[row, FIRST_AXIS + axis * PER_AXIS + FIND]
        places[rooms + axis, ASKED] = places[find, X]
        told |= intervals[find, MISSED] > 0
    value, beyond = read_scattered(figures, values, count, places)
    if beyond > 0.0 and not told:
        find = tables[row, FIRST_AXIS + count * PER_AXIS + FIND]
        intervals[find, MISSED] = 1 + int(figures[values + ACTION]) + ABOVE_IT
        places[find, BEYOND] = beyond
    return value


@strictly_alike
def is_beyond(row: int, tables: Ints, intervals: Ints) -> bool:
    """Whether a table that was read was asked beyond its scattered points."""
    if tables[row, METHOD] != SIMPLICES:
        return False
    find = tables[row, FIRST_AXIS + tables[row, AXES] * PER_AXIS + FIND]
    return bool(intervals[find, MISSED] > 0)


@strictly_alike
def read(
    row: int, figures: Floats, axes: Ints, tables: Ints, places: Floats, intervals: Ints
) -> float:
    """A table at arguments that have been sought."""
    count, values = tables[row, AXES], tables[row, VALUES]
    if tables[row, METHOD] == SIMPLICES:
        return _among_points(row, figures, tables, places, intervals)
    if tables[row, METHOD] == CUBIC:
        return _cubics(figures, axes, tables, row, count, values, places, intervals)
    if tables[row, METHOD] == LIMITS:
        return float(places[tables[row, FIRST_AXIS + FIND], X])
    return _linear(figures, tables, row, count, values, places, intervals)


@strictly_alike
def look_up(
    r: Floats,
    at: int,
    row: int,
    figures: Floats,
    axes: Ints,
    tables: Ints,
    places: Floats,
    intervals: Ints,
    notes: Floats,
) -> float:
    """The table of a place in the program at the arguments in registers from `at` on; NaN for NaN."""
    for axis in range(tables[row, AXES]):
        find, asked = tables[row, FIRST_AXIS + axis * PER_AXIS + FIND], float(r[at + axis])
        if asked != asked:
            return asked
        intervals[find, MISSED] = 0
        if seek(find, asked, figures, axes, places, intervals):
            note_outside(notes, row, axis, asked, intervals[find, MISSED] - 1)
    value = read(row, figures, axes, tables, places, intervals)
    if is_beyond(row, tables, intervals):
        count = tables[row, AXES]
        find = tables[row, FIRST_AXIS + count * PER_AXIS + FIND]
        note_outside(notes, row, count, places[find, BEYOND], intervals[find, MISSED] - 1)
        intervals[find, MISSED] = 0
    return value


@strictly_alike
def line(f: Floats, at: int, k: int, t: float) -> float:
    """A linear table of one variable, whose values begin at `at`."""
    return _straight(f, at + k, 1, t)


@strictly_alike
def plane(f: Floats, at: int, stride: int, t: float, last: float) -> float:
    """Between four values, the first of which is at `at`; `last`: along the last variable."""
    return _mix(_straight(f, at, 1, last), _straight(f, at + stride, 1, last), t)


@strictly_alike
def _linear(f: Floats, tables: Ints, row: int, axes: int, at: int, r: Floats, i: Ints) -> float:
    """Multilinear, or on along the last straight line beyond the ends."""
    t0, t1, t2, t3, s0, s1, s2 = 0.0, 0.0, 0.0, 0.0, 0, 0, 0
    for axis in range(axes):
        first = FIRST_AXIS + axis * PER_AXIS
        find, stride = tables[row, first + FIND], tables[row, first + STRIDE]
        at += i[find, INTERVAL] * stride
        # The last axis is always the fourth: those before it shift up.
        t0, t1, t2, t3 = t1, t2, t3, r[find, PART]
        if axis < axes - 1:
            s0, s1, s2 = s1, s2, stride
    if axes == 1:
        return _straight(f, at, 1, t3)
    near = plane(f, at, s2, t2, t3)
    if axes == 2:
        return near
    far = plane(f, at + s1, s2, t2, t3)
    near = _mix(near, far, t1)
    if axes == 3:
        return near
    at += s0
    other, far = plane(f, at, s2, t2, t3), plane(f, at + s1, s2, t2, t3)
    return _mix(near, _mix(other, far, t1), t0)
