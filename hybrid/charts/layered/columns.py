"""A column for every box, so that cords run forward where they can.

Loops are broken where cutting costs least (`Box.cut`), by a greedy order improved by moving one box at a
time; the columns follow, each box as near to its neighbours as they allow.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

from hybrid.charts.layered.plan import Box, Cord
from hybrid.charts.layered.spacing import LARGE


def flow_order(boxes: Sequence[Box], cords: Sequence[Cord]) -> list[str]:
    """Names in an order in which the cords that run back cost little."""
    weights: dict[tuple[str, str], float] = defaultdict(float)
    cut = {box.name: box.cut for box in boxes}
    for cord in cords:
        if cord.source != cord.target:
            weights[cord.source, cord.target] += cut[cord.source]
    outs: dict[str, dict[str, float]] = {name: {} for name in cut}
    ins: dict[str, dict[str, float]] = {name: {} for name in cut}
    for (a, b), weight in weights.items():
        outs[a][b] = ins[b][a] = weight
    order = _greedy_order(outs, ins)
    for _ in range(12 if len(order) <= LARGE else 2):
        before = list(order)
        for name in sorted(order):
            _sift(name, order, outs[name], ins[name])
        if order == before:
            break
    return order


def _greedy_order(
    outs: Mapping[str, Mapping[str, float]], ins: Mapping[str, Mapping[str, float]]
) -> list[str]:
    """Eades, Lin and Smyth: sinks to the end, sources to the front, else the largest difference."""
    left = set(outs)
    give = {name: sum(outs[name].values()) for name in outs}
    take = {name: sum(ins[name].values()) for name in ins}
    front: list[str] = []
    back: list[str] = []
    while left:
        name = min(left, key=lambda n: (give[n] > 0, take[n] > 0, take[n] - give[n], n))
        (back if give[name] <= 1e-9 and take[name] > 0 else front).append(name)
        left.discard(name)
        for other, weight in outs[name].items():
            take[other] = take[other] - weight if take[other] - weight > 1e-9 else 0.0
        for other, weight in ins[name].items():
            give[other] = give[other] - weight if give[other] - weight > 1e-9 else 0.0
    return front + back[::-1]


def _sift(name: str, order: list[str], outs: Mapping[str, float], ins: Mapping[str, float]) -> None:
    """Move one name to where the least weight runs back."""
    at = order.index(name)
    order.pop(at)
    # At the front every in runs back; passing a name changes that by its weights.
    cost = sum(ins.values())
    costs = [cost]
    for other in order:
        cost += outs.get(other, 0.0) - ins.get(other, 0.0)
        costs.append(cost)
    best = min(costs)
    if costs[at] > best + 1e-9:
        at = min((abs(place - at), place) for place, c in enumerate(costs) if c <= best + 1e-9)[1]
    order.insert(at, name)


def columns_of(order: Sequence[str], cords: Sequence[Cord]) -> dict[str, int]:
    """A column for each name: after those before it, and no further from its neighbours than need be."""
    rank = {name: place for place, name in enumerate(order)}
    before: dict[str, list[str]] = {name: [] for name in order}
    after: dict[str, list[str]] = {name: [] for name in order}
    every: dict[str, list[str]] = {name: [] for name in order}
    for source, target in sorted({(c.source, c.target) for c in cords if c.source != c.target}):
        every[source].append(target)
        every[target].append(source)
        if rank[source] < rank[target]:
            after[source].append(target)
            before[target].append(source)
    column: dict[str, int] = {}
    for name in order:
        column[name] = max((column[other] + 1 for other in before[name]), default=0)
    last = max(column.values(), default=0)
    for _ in range(20):
        moved = False
        for name in (*reversed(order), *order):
            low = max((column[other] + 1 for other in before[name]), default=0)
            high = min((column[other] - 1 for other in after[name]), default=last)
            if not every[name]:
                continue
            best = min(
                range(low, high + 1),
                key=lambda c, n=name: (sum(abs(column[o] - c) for o in every[n]), c),  # type: ignore[misc]
            )
            moved |= best != column[name]
            column[name] = best
        if not moved:
            break
    used = {c: place for place, c in enumerate(sorted(set(column.values())))}
    return {name: used[c] for name, c in column.items()}
