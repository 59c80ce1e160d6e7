"""The order within the columns: from barycentres, then improved by exchanges.

What is counted are the crossings that the routed cords will really have.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

import numpy as np

from hybrid.charts.layered.crossings import pair_costs
from hybrid.charts.layered.layers import Item, Layers, pile
from hybrid.charts.layered.plan import Cord
from hybrid.charts.layered.spacing import LARGE

EFFORT = 30_000_000  # pairs of nets that are looked at for exchanges of neighbours, some seconds


def put_in_order(layers: Layers) -> None:
    """Barycentre sweeps, then exchanges of neighbours; the best order found is kept."""
    for items in layers.items:
        items.sort(key=lambda item: item.key)
        pile(items)
    best, kept = _crossings(layers), _snapshot(layers)
    for sweep in range(24 if len(layers.boxes) <= LARGE else 6):
        columns = range(layers.count) if sweep % 2 == 0 else range(layers.count - 1, -1, -1)
        for column in columns:
            ahead = sweep % 2 == 0
            spaces = (column, column + 1) if sweep % 3 == 2 else (column + (not ahead),)
            _sort(layers, column, spaces)
            exchange_ins(layers, column)
        now = _crossings(layers)
        if now < best - 1e-9:
            best, kept = now, _snapshot(layers)
    _restore(layers, kept)
    for _ in range(8 if len(layers.boxes) <= LARGE / 4 else 2 if len(layers.boxes) <= LARGE else 1):
        before = best
        for column in range(layers.count):
            best = _exchange_neighbours(layers, column, best)
            exchange_ins(layers, column)
        best = _crossings(layers)
        if best >= before - 1e-9:
            break


def _sort(layers: Layers, column: int, spaces: Iterable[int]) -> None:
    pulls: dict[int, list[float]] = defaultdict(list)
    for place in spaces:
        space = layers.spaces[place]
        for net in space.nets:
            ends = [*space.left.get(net, ()), *space.right.get(net, ())]
            for end in ends:
                others = [o.y for o in ends if o is not end]
                if others:
                    pulls[id(end.item)].append(sum(others) / len(others) - end.offset)
    items = layers.items[column]
    wanted = {
        id(item): (
            sum(pulls[id(item)]) / len(pulls[id(item)]) + item.height / 2
            if id(item) in pulls
            else item.y + item.height / 2
        )
        for item in items
    }
    items.sort(key=lambda item: (round(wanted[id(item)], 6), item.key))
    pile(items)


def exchange_ins(layers: Layers, column: int) -> None:
    """Where a box does not mind, its cords come to its ins in the order they come from."""
    space = layers.spaces[column]
    for item in layers.items[column]:
        if item.box is None or not item.box.any_order:
            continue
        fixed = item.box.fixed_ins
        cords = [c for c in layers.cords if c.target == item.box.name and c.place >= fixed]
        if len(cords) < 2:
            continue
        came = {}
        for cord in cords:
            mine = layers.end[cord]
            ends = [*space.left.get(cord.net, ()), *space.right.get(cord.net, ())]
            others = [e.y for e in ends if e is not mine and e.item is not mine.item]
            came[cord] = sum(others) / len(others) if others else mine.y
        ordered = sorted(cords, key=lambda c: (round(came[c], 6), c.source, c.port, c.place))
        for cord, offset in zip(ordered, sorted(item.box.ins[fixed:]), strict=True):
            layers.end[cord].offset = offset


def _exchange_neighbours(layers: Layers, column: int, best: float) -> float:
    items = layers.items[column]
    near = (column, column + 1)
    before = sum(_cost(layers, space) for space in near)
    pairs = sum(len(layers.spaces[space].nets) ** 2 for space in near)
    for place in range(len(items) - 1):
        layers.effort += pairs
        if layers.effort > EFFORT:
            break
        items[place], items[place + 1] = items[place + 1], items[place]
        heights = [item.y for item in items]
        pile(items)
        after = sum(_cost(layers, space) for space in near)
        if after < before - 1e-9:
            best, before = best + after - before, after
        else:
            items[place], items[place + 1] = items[place + 1], items[place]
            for item, y in zip(
                items,
                [*heights[:place], heights[place + 1], heights[place], *heights[place + 2 :]],
                strict=True,
            ):
                item.y = y
    return best


def _snapshot(layers: Layers) -> tuple[list[list[tuple[Item, float]]], dict[Cord, float]]:
    order = [[(item, item.y) for item in items] for items in layers.items]
    return order, {cord: end.offset for cord, end in layers.end.items()}


def _restore(
    layers: Layers, kept: tuple[list[list[tuple[Item, float]]], dict[Cord, float]]
) -> None:
    for column, items in enumerate(kept[0]):
        layers.items[column] = [item for item, _ in items]
        for item, y in items:
            item.y = y
    for cord, offset in kept[1].items():
        layers.end[cord].offset = offset


def _crossings(layers: Layers) -> float:
    return sum(_cost(layers, place) for place in range(layers.count + 1))


def _cost(layers: Layers, place: int) -> float:
    """Crossings in a space, uprights being ordered at best, and a little for their length."""
    space = layers.spaces[place]
    if not space.nets:
        return 0.0
    before, spans = pair_costs(space)
    return float(np.minimum(before, before.T).sum()) / 2 + 2e-3 * float(spans.sum())
