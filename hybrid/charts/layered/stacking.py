"""The whole layout: parts that no cord joins are laid out by themselves and stand on shelves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from hybrid.charts.layered.heights import settle
from hybrid.charts.layered.layers import Layers
from hybrid.charts.layered.order import put_in_order
from hybrid.charts.layered.plan import Box, Cord, Net, Plan, Point, Route
from hybrid.charts.layered.routes import drawn
from hybrid.charts.layered.spacing import PART_GAP
from hybrid.charts.layered.tracks import separate, tracks


def lay_out(boxes: Iterable[Box], cords: Iterable[Cord]) -> Plan:
    """Place the boxes and route the cords; parts that no cord joins stand below each other."""
    by_name = {box.name: box for box in sorted(boxes, key=lambda box: box.name)}
    ordered = sorted(cords, key=lambda c: (c.target, c.place, c.source, c.port))
    plans = []
    for part in _parts(by_name, ordered):
        within = [cord for cord in ordered if cord.target in part]
        plans.append(_plan(Layers([by_name[name] for name in sorted(part)], within)))
    return _stack(plans)


def _plan(layers: Layers) -> Plan:
    """Order, heights, tracks, routes."""
    put_in_order(layers)
    settle(layers)
    separate(layers)
    return drawn(layers, [tracks(layers, place) for place in range(layers.count + 1)])


def _parts(names: Mapping[str, Box], cords: Sequence[Cord]) -> list[set[str]]:
    """Sets of boxes that cords join, the largest first."""
    joined: dict[str, set[str]] = {name: {name} for name in names}
    for cord in cords:
        one, other = joined[cord.source], joined[cord.target]
        if one is not other:
            one |= other
            for name in other:
                joined[name] = one
    found = {min(part): part for part in joined.values()}
    return sorted(found.values(), key=lambda part: (-len(part), min(part)))


def _stack(plans: Sequence[Plan]) -> Plan:
    """Parts on shelves: small ones side by side as long as they are no wider than the widest."""
    widest = max((plan.width for plan in plans), default=0.0)
    widest = max(widest, 900.0 if len(plans) > 1 else 0.0)
    x = y = shelf = width = 0.0
    places: dict[str, Point] = {}
    routes: list[Route] = []
    dots: list[tuple[Net, Point]] = []
    near: Counter[tuple[Net, Net]] = Counter()
    for plan in plans:
        if x and x + plan.width > widest:
            x, y, shelf = 0.0, y + shelf + PART_GAP, 0.0
        places |= {name: (x + a, y + b) for name, (a, b) in plan.places.items()}
        for route in plan.routes:
            moved = tuple((x + a, y + b) for a, b in route.points)
            routes.append(Route(route.cord, moved, route.place))
        dots += [(net, (x + a, y + b)) for net, (a, b) in plan.dots]
        near += plan.near_nets
        shelf, width = max(shelf, plan.height), max(width, x + plan.width)
        x += plan.width + PART_GAP
    return Plan(width, y + shelf, places, tuple(routes), tuple(dots), near)
