"""What crosses in a space between two columns, and the order of its uprights with few crossings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.charts.layered.layers import Space


def spans_of(space: Space) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest end of each net."""
    low, high = np.full(len(space.nets), np.inf), np.full(len(space.nets), -np.inf)
    for ends, present, starts in space.sides:
        if ends:
            y = np.array([end.item.y + end.offset for end in ends])
            low[present] = np.minimum(low[present], np.minimum.reduceat(y, starts))
            high[present] = np.maximum(high[present], np.maximum.reduceat(y, starts))
    return low, high


def pair_costs(space: Space) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """[a, b]: crossings of nets a and b if the upright of a stands left of that of b; the spans."""
    low, high = spans_of(space)
    count = len(space.nets)
    within = []  # [a, b]: how many of a's ends on this side lie between the ends of b's upright
    for ends, present, starts in space.sides:
        counts = np.zeros((count, count))
        if ends:
            y = np.array([end.item.y + end.offset for end in ends])[:, None]
            between = ((y > low) & (y < high)).astype(np.float64)
            counts[present] = np.add.reduceat(between, starts, axis=0)
        within.append(counts)
    # The upright on the left is crossed by the other's ends on the left, and the reverse.
    costs = within[1] + within[0].T
    np.fill_diagonal(costs, 0.0)
    return costs, high - low


def best_order(costs: NDArray[np.float64]) -> list[int]:
    """An order of small total cost, `costs[a, b]` being due if a comes before b."""
    gain = costs.sum(axis=1) - costs.sum(axis=0)
    order = sorted(range(len(costs)), key=lambda i: (gain[i], i))
    for _ in range(10):
        before = list(order)
        for name in range(len(costs)):
            at = order.index(name)
            order.pop(at)
            steps = costs[order, name] - costs[name, order]
            found = costs[name, order].sum() + np.concatenate([[0.0], np.cumsum(steps)])
            best = found.min()
            if found[at] > best + 1e-9:
                at = int(np.argmax(found <= best + 1e-9))
            order.insert(at, name)
        if order == before:
            break
    return order
