"""Look-up tables of one to four variables, as data.

Stage 0. Whoever reads a file builds a `Table` with `table`, which refuses what is no table; the engine's
`lookup` computes with it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from hybrid.errors import counted
from hybrid.units import PURE, Dimension

Floats: TypeAlias = npt.NDArray[np.float64]

# A range that goes so far has no end.
ENDLESS = 1e300
# Breakpoints that are nearer have no slope between them that is a number.
NEAREST = 1e-300
MOST_VARIABLES = 4
MOST_VALUES = 1_000_000
METHODS = ("linear", "cubic", "simplices", "limits")

# What a function does where it is asked beyond its range, and how a run says so.
CONTINUES, CLAMPS, STOPS = range(3)
OUTSIDE: Mapping[str, int] = {"extrapolate": CONTINUES, "clamp": CLAMPS, "stop": STOPS}
ACTIONS = ("continued", "clamped", "stopped")


class TableError(ValueError):
    """Numbers that make no table; the message is one line and says what would be valid."""


@dataclass(frozen=True, eq=False)
class Axis:
    """One variable: its breakpoints in SI units and what happens below and above its range."""

    name: str
    points: Floats  # (n,), n >= 2, strictly increasing
    range: tuple[float, float]
    below: int = STOPS
    above: int = STOPS
    dimension: Dimension = PURE
    unit: str | None = None  # in which people are told of it; None: SI
    factor: float = 1.0  # SI value of one `unit`

    @property
    def told_in(self) -> tuple[str, float]:
        """The unit in which people are told of it, and its SI value."""
        if self.unit is not None:
            return self.unit, self.factor
        return "" if self.dimension.is_pure else str(self.dimension), 1.0


@dataclass(frozen=True, eq=False)
class Table:
    """Values at every combination of breakpoints, in SI units, `values[i, j, ...]`.

    Linear along each variable (multilinear), or cubic: the monotone piecewise cubic of Fritsch and
    Carlson along the last variable, then of the results along the one before it, and so on. Values of
    simplices stand at points that lie anywhere, (points,), with a `mesh` between them. Limits are of one
    variable, and are its value, kept within its range: a limiter of which a run tells where it acts.
    """

    name: str
    axes: tuple[Axis, ...]
    values: Floats
    method: str = METHODS[0]
    dimension: Dimension = PURE
    mesh: Floats | None = None  # see `meshes`


def check_points(name: str, points: Sequence[float]) -> None:
    """Refuse breakpoints that do not increase, naming the two at fault.

    So are those too near to each other, or too far out, for what is between them to be a number.
    """
    if len(points) < 2:
        raise TableError(
            f"{name} has {counted(len(points), 'breakpoint')}; a table needs 2 or more"
        )
    for before, after in itertools.pairwise(points):
        if not after > before:
            raise TableError(
                f"breakpoints of {name} must increase, but {after:g} comes after {before:g}"
            )
        if after - before < NEAREST:
            raise TableError(
                f"breakpoints {before:g} and {after:g} of {name} are too near; leave one out"
            )
    if abs(points[0]) + abs(points[-1]) > ENDLESS:
        raise TableError(
            f"breakpoints {points[0]:g} and {points[-1]:g} of {name} are too far out; "
            f"up to {ENDLESS:g} is possible"
        )


def check_size(counts: Sequence[int]) -> None:
    """Refuse more variables or values than a table may have."""
    if not 1 <= len(counts) <= MOST_VARIABLES:
        raise TableError(f"it has {len(counts)} inputs; 1 to {MOST_VARIABLES} are possible")
    if math.prod(counts) > MOST_VALUES:
        raise TableError(f"it has {math.prod(counts)} values; at most {MOST_VALUES} are possible")


def limits(
    name: str,
    variable: str,
    between: tuple[float, float],
    dimension: Dimension = PURE,
    told_in: tuple[str | None, float] = (None, 1.0),
) -> Table | None:
    """What keeps a variable between two values in SI units, of which either may be infinite; None where
    both are. told_in: a unit and its SI value."""
    if between == (-math.inf, math.inf):
        return None
    low, high = (min(max(end, -ENDLESS), ENDLESS) for end in between)
    below, above = (CLAMPS if math.isfinite(end) else CONTINUES for end in between)
    points = np.array([low, high])
    axis = Axis(variable, points, (low, high), below, above, dimension, *told_in)
    return Table(name, (axis,), points, "limits", dimension)
