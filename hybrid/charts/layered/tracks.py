"""Uprights: between two columns each net has at most one, on a track that it may share.

Uprights are ordered for few crossings and share a track where they do not meet. Two nets never run along
one line.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid.charts.layered.crossings import best_order, pair_costs, spans_of
from hybrid.charts.layered.layers import Item, Layers, Space, distance
from hybrid.charts.layered.plan import Net
from hybrid.charts.layered.spacing import NEAR


def tracks(layers: Layers, place: int) -> dict[Net, int]:
    """Net -> track of its upright, counted from the left of the space."""
    space = layers.spaces[place]
    nets = space.nets
    if not nets:
        return {}
    order, _ = _upright_order(layers, place)
    low, high = spans_of(space)
    index = {net: i for i, net in enumerate(nets)}
    track: dict[Net, int] = {}
    for net in order:
        i = index[net]
        if high[i] - low[i] < 0.5:
            continue
        found = 0
        for other, its in track.items():
            j = index[other]
            if low[i] - NEAR < high[j] and low[j] - NEAR < high[i]:
                found = max(found, its + 1)
        track[net] = found
    return track


def separate(layers: Layers) -> None:
    """Move ends that no order of the uprights can keep from running along each other."""
    for _ in range(6):
        moved = False
        for place in range(layers.count + 1):
            _, wrong = _upright_order(layers, place)
            moved |= bool(wrong.any()) and _nudge(layers, place, wrong)
        if not moved:
            break
    for place in range(1, layers.count):
        _, wrong = _upright_order(layers, place)
        shift, least = 0.0, int(wrong.sum())
        for step in (4, -4, 8, -8, 12, -12, 16, -16, 20, -20) if least else ():
            # All that lies to the right, so that no other space changes.
            _lower(layers, place, step)
            left = int(_upright_order(layers, place)[1].sum())
            _lower(layers, place, -step)
            if left < least:
                shift, least = float(step), left
        _lower(layers, place, shift)
    top = min(item.y for items in layers.items for item in items)
    _lower(layers, 0, -top)


def _lower(layers: Layers, column: int, step: float) -> None:
    for items in layers.items[column:]:
        for item in items:
            item.y += step


def _upright_order(layers: Layers, place: int) -> tuple[list[Net], NDArray[np.bool_]]:
    """Nets from left to right, with few crossings; [a, b]: a stands left of b against the rule."""
    nets = layers.spaces[place].nets
    costs = _ordering_costs(layers, layers.spaces[place], nets)
    order = best_order(costs)
    rank = np.empty(len(order), dtype=int)
    rank[order] = np.arange(len(order))
    return [nets[i] for i in order], (costs >= 1000) & (rank[:, None] < rank[None, :])


def _ordering_costs(layers: Layers, space: Space, nets: Sequence[Net]) -> NDArray[np.float64]:
    """[a, b]: what it costs if a stands left of b."""
    if not nets:
        return np.zeros((0, 0))
    costs, _ = pair_costs(space)
    index = {net: i for i, net in enumerate(nets)}
    lefts = [(end.y, index[net]) for net, ends in space.left.items() for end in ends]
    heights = np.array([y for y, _ in lefts])
    for net, ends in space.right.items():
        for end in ends:
            for found in np.flatnonzero(np.abs(heights - end.y) < NEAR).tolist():
                if lefts[found][1] != index[net]:
                    costs[index[net], lefts[found][1]] += 1000.0
    return costs


def _nudge(layers: Layers, place: int, wrong: NDArray[np.bool_]) -> bool:
    """Move one of two ends that collide, if there is room for it in its column."""
    space, nets = layers.spaces[place], layers.spaces[place].nets
    for a, b in np.argwhere(wrong).tolist():
        for right in space.right.get(nets[a], ()):
            for left in space.left.get(nets[b], ()):
                if abs(right.y - left.y) >= NEAR:
                    continue
                for end, other in ((right, left), (left, right)):
                    column = place if end is right else place - 1
                    for step in (NEAR + 1, -NEAR - 1):
                        move = other.y + step - end.y
                        if _has_room(layers, column, end.item, move):
                            end.item.y += move
                            return True
    return False


def _has_room(layers: Layers, column: int, item: Item, move: float) -> bool:
    items = layers.items[column]
    at = items.index(item)
    if at and item.y + move < items[at - 1].y + distance(items[at - 1], item):
        return False
    below = items[at + 1] if at + 1 < len(items) else None
    return below is None or below.y >= item.y + move + distance(item, below)
