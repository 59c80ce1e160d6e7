"""The plan of one part: places of boxes, corners of cords, and where the lines of a net part."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence

from hybrid.charts.layered.layers import Layers, Space
from hybrid.charts.layered.plan import Cord, Net, Plan, Point, Route
from hybrid.charts.layered.spacing import MARGIN, PITCH


def drawn(layers: Layers, tracks: Sequence[dict[Net, int]]) -> Plan:
    """The plan, columns and tracks side by side."""
    x = 0.0
    track_x: list[dict[Net, float]] = []
    column_x: list[tuple[float, float]] = []
    for place in range(layers.count + 1):
        its = tracks[place]
        count = 1 + max(its.values(), default=-1)
        at = {net: x + MARGIN + PITCH * track for net, track in its.items()}
        track_x.append(defaultdict(lambda x=x: x + MARGIN, at))  # type: ignore[misc]
        room = 2 * MARGIN + PITCH * max(count - 1, 0) if count else MARGIN
        outside = place in (0, layers.count)
        x += (MARGIN + PITCH * count if count else 0.0) if outside else room
        if place < layers.count:
            boxes = [item.box for item in layers.items[place] if item.box]
            width = max((box.width for box in boxes), default=0.0)
            column_x.append((x, x + width))
            x += width
    places: dict[str, Point] = {}
    for name, item in layers.of_box.items():
        left, right = column_x[layers.column[name]]
        places[name] = (round((left + right - layers.boxes[name].width) / 2), item.y)
    routes = [_route(layers, cord, places, track_x) for cord in layers.cords]
    height = max(item.y + item.height for items in layers.items for item in items)
    near: Counter[tuple[Net, Net]] = Counter()
    for space, beside in zip(layers.spaces, [*layers.spaces[1:], Space()], strict=True):
        near.update(itertools.combinations(space.nets, 2))
        near.update(itertools.combinations(sorted({*space.nets, *beside.nets}), 2))
    return Plan(x, height, places, tuple(routes), _dots(layers, track_x), near)


def _route(
    layers: Layers,
    cord: Cord,
    places: Mapping[str, Point],
    track_x: Sequence[Mapping[Net, float]],
) -> Route:
    net, start = cord.net, layers.column[cord.source]
    target, end = layers.column[cord.target], layers.end[cord]
    box = layers.boxes[cord.source]
    y = layers.of_box[cord.source].y + box.outs[cord.port]
    points = [(places[cord.source][0] + box.width, y)]
    if target > start:
        passed = [(c, layers.passing["forward", net, c].y) for c in range(start + 1, target)]
        spaces = [c for c, _ in passed] + [target]
    else:
        passed = [(c, layers.passing["back", net, c].y) for c in range(start, target - 1, -1)]
        spaces = [c + 1 for c, _ in passed] + [target]
    for space, next_y in zip(spaces, [*(y for _, y in passed), end.y], strict=True):
        points += [(track_x[space][net], y), (track_x[space][net], next_y)]
        y = next_y
    points.append((places[cord.target][0], y))
    place = layers.boxes[cord.target].ins.index(end.offset)
    return Route(cord, _straightened(points), place)


def _dots(layers: Layers, track_x: Sequence[Mapping[Net, float]]) -> tuple[tuple[Net, Point], ...]:
    """Where three or more lines of a net meet."""
    dots = []
    for place, space in enumerate(layers.spaces):
        for net in space.nets:
            sides = [(e.y, 0) for e in space.left.get(net, ())]
            sides += [(e.y, 1) for e in space.right.get(net, ())]
            heights = sorted({y for y, _ in sides})
            for y in heights:
                arms = len({side for at, side in sides if at == y})
                arms += (y > heights[0]) + (y < heights[-1])
                if arms > 2:
                    dots.append((net, (track_x[place][net], y)))
    return tuple(dots)


def _straightened(points: Sequence[Point]) -> tuple[Point, ...]:
    """Corners only: repeated points and points on a straight line are left out."""
    kept: list[Point] = []
    for point in points:
        if kept and point == kept[-1]:
            continue
        if len(kept) > 1:
            (ax, ay), (bx, by) = kept[-2:]
            if (ax == bx == point[0]) or (ay == by == point[1]):
                kept[-1] = point
                continue
        kept.append(point)
    return tuple(kept)
