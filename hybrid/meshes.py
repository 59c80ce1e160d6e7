"""Tables whose points lie anywhere: a mesh of simplices between them, linear within each.

Stage 0. The mesh is Delaunay's, in coordinates that are parts of each variable's range, so that no unit
changes it; nor does the order of the points. Its figures are laid out for the engine's `scattered`.
AIAA S-119 leaves it to the reader what is between the points of an ungridded table
(daveml.org/DTDs/2p0/Ref/ungriddedTableDef_overview.html); DST's Janus takes Delaunay's simplices, too.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from hybrid.tables import MOST_VARIABLES, Axis, Floats, Table, TableError

Ints = npt.NDArray[np.int64]

POINTS = "points"  # stands for the arguments where they are beyond all of these
MOST_POINTS = 20_000
MOST_ENTRIES = 4_000_000  # of simplices in the cells that they may reach into
# Of the range of the points: what is flatter is no simplex, and what is nearer is no distance.
FLAT = 1e-9
# The head of a mesh's figures: what is done beyond the points; cells along each variable; where the
# lists of the cells, the simplices, the planes around all points and their faces begin; how many of the
# last two; then the lowest value and the range of each variable.
ACTION, CELLS, LISTS, SIMPLICES, PLANES, PLANE_COUNT, FACES, FACE_COUNT, LOW = range(9)
SPAN = LOW + MOST_VARIABLES
HEAD = SPAN + MOST_VARIABLES


def scattered_table(table: Table, points: Floats, values: Floats, action: int) -> Table:
    """The table of `values`, (m,), at `points`, (m, variables), both in SI units.

    table: its axes have the ranges; action: beyond the points. One variable makes a plain linear table.
    Raises TableError where there is no mesh between the points.
    """
    order = np.lexsort(points.T[::-1])
    points, values = points[order], values[order]
    if points.shape[1] == 1:
        (axis,) = table.axes
        low, high = max(axis.range[0], points[0, 0]), min(axis.range[1], points[-1, 0])
        axis = replace(axis, points=points[:, 0], range=(low, high))
        return Table(table.name, (axis,), values, "linear", table.dimension)
    mesh = _figures(points, values, action)
    return Table(table.name, table.axes, values, "simplices", table.dimension, mesh)


def twice(points: Floats) -> int | None:
    """Which point stands at the place of an earlier one; None where all differ."""
    seen: set[tuple[float, ...]] = set()
    for number, point in enumerate(map(tuple, points.tolist())):
        if point in seen:
            return number
        seen.add(point)
    return None


def check_spread(points: Floats) -> None:
    """Refuse too few or too many points, and those between which there is no room."""
    count, variables = points.shape
    if not variables < count <= MOST_POINTS:
        raise TableError(
            f"it has {count} points; {variables + 1} to {MOST_POINTS} are possible of {variables} inputs"
        )
    with np.errstate(over="ignore"):
        span = np.ptp(points, axis=0)
    if not np.all(span < np.inf):
        raise TableError("its points lie too far apart for their distance to be a number")
    parts = (points - points.min(axis=0)) / np.where(span > 0.0, span, 1.0)
    spread = np.linalg.svd(parts - parts.mean(axis=0), compute_uv=False)
    if spread[-1] <= FLAT * spread[0] or span.min() == 0.0:
        what = {1: "at one value", 2: "on a line", 3: "in a plane"}.get(variables, "in a space")
        raise TableError(f"all its points lie {what}; give some beside it")


def _figures(points: Floats, values: Floats, action: int) -> Floats:
    """The mesh as the engine reads it, in parts of the variables' ranges."""
    from scipy.spatial import ConvexHull, Delaunay, QhullError

    low, span = points.min(axis=0), np.ptp(points, axis=0)
    parts = (points - low) / span
    try:
        mesh, hull = Delaunay(parts), ConvexHull(parts)
    except QhullError as error:
        reason = str(error).partition("\n")[0]
        raise TableError(f"there is no mesh between its points: {reason}") from None
    if len(mesh.coplanar):
        first = points[mesh.coplanar[0, 0]]
        raise TableError(f"the point {first.tolist()} (SI) is too near to another; leave one out")
    corners = mesh.simplices[_is_thick(parts[mesh.simplices])]
    simplices = _simplices(parts[corners], values[corners])
    cells, lists = _cells(parts[corners])
    planes = np.unique(hull.equations, axis=0)
    faces = np.array(list(_faces(parts, hull.simplices.tolist())))
    blocks = [lists, simplices.ravel(), planes.ravel(), faces.ravel()]
    starts = HEAD + np.cumsum([0, *map(len, blocks)])
    head = np.zeros(HEAD)
    head[:LOW] = (action, cells, *starts[:3], len(planes), starts[3], len(faces))
    head[LOW : LOW + len(low)], head[SPAN : SPAN + len(span)] = low, span
    return np.concatenate([head, *blocks])


def _is_thick(corners: Floats) -> npt.NDArray[np.bool_]:
    """Which simplices, (s, n + 1, n), have room within."""
    edges = corners[:, :-1] - corners[:, -1:]
    spread = np.linalg.svd(edges, compute_uv=False)
    found: npt.NDArray[np.bool_] = spread[:, -1] > FLAT
    return found


def _simplices(corners: Floats, values: Floats) -> Floats:
    """Rows of figures: the weights of all corners but the last are matrix (x - last corner); its place;
    the values of all."""
    count, _, n = corners.shape
    edges = np.swapaxes(corners[:, :-1] - corners[:, -1:], 1, 2)
    inverse = np.linalg.inv(edges).reshape(count, n * n)
    return np.hstack([inverse, corners[:, -1], values])


def _cells(corners: Floats) -> tuple[int, Floats]:
    """How many cells there are along each variable, and for each which simplices may reach into it:
    where each list begins, where the last ends, then the lists."""
    count, _, n = corners.shape
    cells = max(1, min(64, round(count ** (1.0 / n))))
    while True:
        lowest, highest = (
            np.clip((x * cells).astype(np.int64), 0, cells - 1)
            for x in (corners.min(axis=1) - FLAT, corners.max(axis=1) + FLAT)
        )
        widths = highest - lowest + 1
        entries = widths.prod(axis=1)
        if entries.sum() <= MOST_ENTRIES or cells == 1:
            break
        cells = max(1, cells // 2)
    simplex = np.repeat(np.arange(count), entries)
    rest = np.arange(len(simplex)) - np.repeat(np.cumsum(entries) - entries, entries)
    cell = np.zeros(len(simplex), dtype=np.int64)
    for i in range(n):
        stride = widths[:, i + 1 :].prod(axis=1)[simplex]
        cell = cell * cells + lowest[simplex, i] + rest // stride
        rest = rest % stride
    lists = simplex[np.argsort(cell, kind="stable")]
    begins = np.searchsorted(np.sort(cell), np.arange(cells**n + 1)) + cells**n + 1
    return cells, np.concatenate([begins, lists]).astype(float)


def _faces(parts: Floats, hull: list[list[int]]) -> Iterator[Floats]:
    """Rows of figures for every corner, edge, ... of what is around the points: n weights of its corners
    at the foot of x, as matrix x + vector (those that it has not are 1), and that foot."""
    n = parts.shape[1]
    for size in range(1, n + 1):
        found = {face for facet in hull for face in itertools.combinations(sorted(facet), size)}
        for face in sorted(found):
            corners = parts[list(face)]
            edges = (corners[:-1] - corners[-1]).T  # (n, size - 1)
            if size > 1 and np.linalg.svd(edges, compute_uv=False)[-1] <= FLAT:
                continue
            weights = np.zeros((n, n + 1))
            weights[size:, n] = 1.0
            inverse = np.linalg.pinv(edges) if size > 1 else np.zeros((0, n))
            weights[: size - 1] = np.column_stack([inverse, -inverse @ corners[-1]])
            weights[size - 1] = -weights[: size - 1].sum(axis=0)
            weights[size - 1, n] += 1.0
            yield np.concatenate([weights.ravel(), (corners.T @ weights[:size]).ravel()])


def searches(table: Table) -> tuple[Axis, ...]:
    """What is sought to read a table: a place along each axis, and how far that is beyond its points."""
    if table.mesh is None:
        return table.axes
    action = int(table.mesh[ACTION])
    return (*table.axes, Axis(POINTS, np.array([0.0, 1.0]), (0.0, 0.0), action, action))
