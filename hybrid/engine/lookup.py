"""Table look-up: linear and monotone cubic in one to four variables, compiled.

Stage 4. Tables are packed into one array of figures; a row of `layout` tells where those of one place
in the program are. Each place remembers the intervals it was in last, where the next search begins: no
answer depends on it, only how soon it is found.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hybrid.engine.compiling import compiled_alike
from hybrid.engine.helper_functions import note_outside
from hybrid.tables import CONTINUES, METHODS, Table

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Columns of a row of the layout: the number of axes, the method, where the values begin; then for each
# axis, where its lowest and highest argument and then its breakpoints are, how many breakpoints, how far
# apart its values, what is done below and above.
AXES, METHOD, VALUES, FIRST_AXIS = range(4)
POINTS, COUNT, STRIDE, BELOW, ABOVE, PER_AXIS = range(6)
COLUMNS = FIRST_AXIS + 4 * PER_AXIS
CUBIC = METHODS.index("cubic")


def pack(tables: list[Table | None]) -> tuple[Floats, Ints]:
    """Figures and layout, a row for each place in the program; None where it asks no table."""
    figures: list[Floats] = [np.zeros(1)]
    at, starts = 1, dict[int, list[int]]()
    layout = np.zeros((len(tables), COLUMNS), dtype=np.int64)
    for row, table in enumerate(tables):
        if table is None:
            continue
        if id(table) not in starts:
            parts = [np.array([*axis.range, *axis.points]) for axis in table.axes]
            parts.append(table.values.ravel())
            starts[id(table)] = (at + np.cumsum([0, *map(len, parts)])).tolist()
            at = starts[id(table)][-1]
            figures += parts
        *axes_at, values_at, _ = starts[id(table)]
        layout[row, :FIRST_AXIS] = len(axes_at), METHODS.index(table.method), values_at
        for i, axis in enumerate(table.axes):
            stride = int(np.prod(table.values.shape[i + 1 :], dtype=np.int64))
            first = FIRST_AXIS + i * PER_AXIS
            column = (axes_at[i] + 2, len(axis.points), stride, axis.below, axis.above)
            layout[row, first : first + PER_AXIS] = column
    return np.concatenate(figures), layout


@compiled_alike
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


@compiled_alike
def _straight(v: Floats, at: int, stride: int, t: float) -> float:
    """Between two neighbouring values; both ends are met exactly."""
    between: float = (1.0 - t) * v[at] + t * v[at + stride]
    return between


@compiled_alike
def _edge_slope(h: float, next_h: float, m: float, next_m: float) -> float:
    """Slope at an end of a monotone cubic: of three points, kept from overshooting."""
    slope = ((2.0 * h + next_h) * m - h * next_m) / (h + next_h)
    if slope * m <= 0.0:
        return 0.0
    if m * next_m < 0.0 and abs(slope) > 3.0 * abs(m):
        return 3.0 * m
    return slope


@compiled_alike
def _inner_slope(h: float, next_h: float, m: float, next_m: float) -> float:
    """Slope at an inner point: weighted harmonic mean, and none where the data turn."""
    if m * next_m <= 0.0:
        return 0.0
    w, next_w = 2.0 * next_h + h, next_h + 2.0 * h
    return (w + next_w) / (w / m + next_w / next_m)


@compiled_alike
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


@compiled_alike
def _cubic_1(f: Floats, lay: Ints, row: int, axis: int, at: int, r: Floats, i: Ints) -> float:
    """Along the last axis, from the value at `at` on; arguments in r[0:], intervals in i."""
    first = FIRST_AXIS + axis * PER_AXIS
    k, count = i[row, axis], lay[row, first + COUNT]
    before = f[at + k - 1] if k > 0 else 0.0
    after = f[at + k + 2] if k < count - 2 else 0.0
    x = r[row, axis]
    return _cubic(f, lay[row, first], count, k, x, before, f[at + k], f[at + k + 1], after)


@compiled_alike
def _cubic_2(f: Floats, lay: Ints, row: int, axis: int, at: int, r: Floats, i: Ints) -> float:
    """Along two axes: the results of the second one along the first."""
    first = FIRST_AXIS + axis * PER_AXIS
    k, count, stride = i[row, axis], lay[row, first + COUNT], lay[row, first + STRIDE]
    here, below = at + k * stride, axis + 1
    before = _cubic_1(f, lay, row, below, here - stride, r, i) if k > 0 else 0.0
    left = _cubic_1(f, lay, row, below, here, r, i)
    right = _cubic_1(f, lay, row, below, here + stride, r, i)
    after = _cubic_1(f, lay, row, below, here + 2 * stride, r, i) if k < count - 2 else 0.0
    return _cubic(f, lay[row, first], count, k, r[row, axis], before, left, right, after)


@compiled_alike
def _cubic_3(f: Floats, lay: Ints, row: int, axis: int, at: int, r: Floats, i: Ints) -> float:
    """Along three axes."""
    first = FIRST_AXIS + axis * PER_AXIS
    k, count, stride = i[row, axis], lay[row, first + COUNT], lay[row, first + STRIDE]
    here, below = at + k * stride, axis + 1
    before = _cubic_2(f, lay, row, below, here - stride, r, i) if k > 0 else 0.0
    left = _cubic_2(f, lay, row, below, here, r, i)
    right = _cubic_2(f, lay, row, below, here + stride, r, i)
    after = _cubic_2(f, lay, row, below, here + 2 * stride, r, i) if k < count - 2 else 0.0
    return _cubic(f, lay[row, first], count, k, r[row, axis], before, left, right, after)


@compiled_alike
def _cubic_4(f: Floats, lay: Ints, row: int, axis: int, at: int, r: Floats, i: Ints) -> float:
    """Along four axes."""
    first = FIRST_AXIS + axis * PER_AXIS
    k, count, stride = i[row, axis], lay[row, first + COUNT], lay[row, first + STRIDE]
    here, below = at + k * stride, axis + 1
    before = _cubic_3(f, lay, row, below, here - stride, r, i) if k > 0 else 0.0
    left = _cubic_3(f, lay, row, below, here, r, i)
    right = _cubic_3(f, lay, row, below, here + stride, r, i)
    after = _cubic_3(f, lay, row, below, here + 2 * stride, r, i) if k < count - 2 else 0.0
    return _cubic(f, lay[row, first], count, k, r[row, axis], before, left, right, after)


@compiled_alike
def look_up(
    r: Floats,
    at: int,
    row: int,
    figures: Floats,
    layout: Ints,
    asked: Floats,
    intervals: Ints,
    notes: Floats,
) -> float:
    """The table of a place in the program at the arguments in registers from `at` on; NaN for NaN.

    asked, intervals: (places, 4), the arguments within range and their intervals, for the next time.
    """
    axes, values = layout[row, AXES], layout[row, VALUES]
    for axis in range(axes):
        first = FIRST_AXIS + axis * PER_AXIS
        points, x = layout[row, first + POINTS], float(r[at + axis])
        if x != x:
            return x
        low, high = figures[points - 2], figures[points - 1]
        if x < low or x > high:
            action = layout[row, first + BELOW] if x < low else layout[row, first + ABOVE]
            note_outside(notes, row, axis, x, action)
            if action != CONTINUES:
                x = min(max(x, low), high)
        asked[row, axis] = x
        intervals[row, axis] = _find(
            figures, points, layout[row, first + COUNT], x, intervals[row, axis]
        )
    if layout[row, METHOD] == CUBIC:
        if axes == 1:
            return _cubic_1(figures, layout, row, 0, values, asked, intervals)
        if axes == 2:
            return _cubic_2(figures, layout, row, 0, values, asked, intervals)
        if axes == 3:
            return _cubic_3(figures, layout, row, 0, values, asked, intervals)
        return _cubic_4(figures, layout, row, 0, values, asked, intervals)
    return _linear(figures, layout, row, axes, values, asked, intervals)


@compiled_alike
def _linear(f: Floats, lay: Ints, row: int, axes: int, at: int, r: Floats, i: Ints) -> float:
    """Multilinear, or on along the last straight line beyond the ends."""
    t0, t1, t2, t3, s0, s1, s2 = 0.0, 0.0, 0.0, 0.0, 0, 0, 0
    for axis in range(axes):
        first = FIRST_AXIS + axis * PER_AXIS
        k, x = i[row, axis], r[row, axis]
        low = f[lay[row, first] + k]
        t = (x - low) / (f[lay[row, first] + k + 1] - low)
        stride = lay[row, first + STRIDE]
        at += k * stride
        # The last axis is always the fourth: those before it shift up.
        t0, t1, t2, t3 = t1, t2, t3, t
        if axis < axes - 1:
            s0, s1, s2 = s1, s2, stride
    if axes == 1:
        return _straight(f, at, 1, t3)
    near = (1.0 - t2) * _straight(f, at, 1, t3) + t2 * _straight(f, at + s2, 1, t3)
    if axes == 2:
        return near
    at += s1
    far = (1.0 - t2) * _straight(f, at, 1, t3) + t2 * _straight(f, at + s2, 1, t3)
    near = (1.0 - t1) * near + t1 * far
    if axes == 3:
        return near
    at += s0
    far = (1.0 - t2) * _straight(f, at, 1, t3) + t2 * _straight(f, at + s2, 1, t3)
    at -= s1
    other = (1.0 - t2) * _straight(f, at, 1, t3) + t2 * _straight(f, at + s2, 1, t3)
    return (1.0 - t0) * near + t0 * ((1.0 - t1) * other + t1 * far)
