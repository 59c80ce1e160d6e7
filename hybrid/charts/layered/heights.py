"""Heights within the columns: uprights as short as the order and the distances allow.

A linear program: at its corners most cords run straight. Solved again with more weight on the short
uprights, it leaves few bends.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from scipy.optimize import linprog
from scipy.sparse import csr_array

from hybrid.charts.layered.layers import End, Layers, distance
from hybrid.charts.layered.order import exchange_ins
from hybrid.charts.layered.plan import Net
from hybrid.charts.layered.spacing import LARGE, SHORT


def settle(layers: Layers) -> None:
    """Heights that keep the order and the distances and make the uprights short in all."""
    for _ in range(3 if len(layers.boxes) <= LARGE else 1):
        _shorten(layers)
        for column in range(layers.count):
            exchange_ins(layers, column)
    for _ in range(4 if len(layers.boxes) <= LARGE else 1):
        _shorten(layers, few_bends=True)


@dataclass
class _Limits:
    """The rows of a linear program, each the difference of two variables."""

    entries: list[tuple[int, int, float]] = field(default_factory=list)  # row, variable, factor
    most: list[float] = field(default_factory=list)

    def at_most(self, first: int, second: int, limit: float) -> None:
        """Variable `first` - variable `second` <= limit."""
        self.entries.extend(((len(self.most), first, 1.0), (len(self.most), second, -1.0)))
        self.most.append(limit)


def _shorten(layers: Layers, few_bends: bool = False) -> None:
    """Solve for the heights: a linear program, whose corners are where cords run straight.

    `few_bends`: uprights that are short now weigh more, so that they vanish and long ones pay.
    """
    items = [item for column in layers.items for item in column]
    index = {id(item): i for i, item in enumerate(items)}
    costs, limits = [0.0] * len(items), _Limits()
    for column in layers.items:
        for above, below in itertools.pairwise(column):
            limits.at_most(index[id(above)], index[id(below)], -distance(above, below))
    for space in layers.spaces:
        for net in space.nets:
            ends = [*space.left.get(net, ()), *space.right.get(net, ())]
            if len(ends) < 2:
                continue
            weight = _weight(layers, net, ends, few_bends)
            low, high = len(costs), len(costs) + 1  # of the upright
            costs += [-weight, weight]
            for end in ends:
                i = index[id(end.item)]
                limits.at_most(low, i, end.offset)
                limits.at_most(i, high, -end.offset)
    if not limits.most:
        return
    for item, y in zip(items, _solved(costs, limits), strict=False):
        item.y = float(round(y))


def _weight(layers: Layers, net: Net, ends: Sequence[End], few_bends: bool) -> float:
    """What a unit of an upright's length costs."""
    # A bend in a cord that passes by is worse than one at a box.
    passing = sum(end.item.box is None for end in ends)
    weight = 1.0 + 2.0 * (passing == len(ends)) + 0.5 * (len(ends) == 2)
    # The way on is to be straight, rather than a source's cord or one coming back.
    if not layers.boxes[net[0]].ins or any(e.item.key[0] == "back" for e in ends):
        weight *= 0.6
    if few_bends:
        heights = [end.y for end in ends]
        weight *= SHORT / (SHORT / 4 + max(heights) - min(heights))
    return weight


def _solved(costs: Sequence[float], limits: _Limits) -> Sequence[float]:
    """The variables, none below 0, of the least cost; none where there is no solution."""
    rows, columns, factors = zip(*limits.entries, strict=True)
    matrix: Any = csr_array((factors, (rows, columns)), shape=(len(limits.most), len(costs)))
    bounds = [(0.0, None)] * len(costs)
    solved = linprog(costs, matrix, limits.most, bounds=bounds, method="highs-ds")
    # None was never seen: the order alone can always be kept.
    return () if solved.x is None else solved.x.tolist()
