"""Boxes in columns and cords at right angles: a layered layout after Sugiyama, with nets.

1. Loops are broken where cutting costs least (`Box.cut`), by a greedy order improved by moving one
   box at a time; the columns follow, each box as near to its neighbours as they allow.
2. All cords from one port are a net. In every column it passes, a net holds one place, whether it
   runs forward or back, so that no cord ever passes under a box.
3. The order within the columns starts from barycentres and is then improved by exchanges; what is
   counted are the crossings that the routed cords will really have.
4. Heights within the columns make the uprights as short as the order and the distances allow, by a
   linear program: at its corners most cords run straight. Solved again with more weight on the short
   ones, it leaves few bends.
5. Between two columns each net has at most one upright; uprights are ordered for few crossings and
   share a track where they do not meet. Two nets never run along one line.

The result depends on names and sizes only, not on the order in which anything is given.
"""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.sparse import csr_array

Point: TypeAlias = tuple[float, float]
Net: TypeAlias = tuple[str, str]  # box and port

PITCH = 11.0  # between two uprights, and between two nets that pass a column
MARGIN = 16.0  # from a box to the first upright
BOX_GAP = 22.0  # between two boxes of a column
PASS_GAP = 14.0  # between a box and a net that passes it
PART_GAP = 44.0  # between parts of the diagram that no cord joins
NEAR = 7.0  # two nets closer than this would be taken for one line
SHORT = 24.0  # an upright shorter than this is a kink rather than a way
LARGE = 400  # boxes; beyond this the order is improved less
EFFORT = 30_000_000  # pairs of nets that are looked at for exchanges of neighbours, some seconds


@dataclass(frozen=True)
class Box:
    """Something to place: its size and where its cords end, from its top."""

    name: str
    width: float
    height: float
    ins: tuple[float, ...] = ()
    outs: Mapping[str, float] = field(default_factory=dict)
    any_order: bool = False  # its cords may be exchanged among its ins
    cut: float = 1.0  # what it costs to turn one of its outgoing cords back
    fixed_ins: int = 0  # so many, the first, keep their cords all the same


@dataclass(frozen=True)
class Cord:
    """From a box's port to one of another's ins; `place` is which, where that is not free."""

    source: str
    port: str
    target: str
    place: int

    @property
    def net(self) -> Net:
        """All cords of one port."""
        return self.source, self.port


@dataclass(frozen=True)
class Route:
    """A cord as routed: its corners from end to end, and the in it came to."""

    cord: Cord
    points: tuple[Point, ...]
    place: int


@dataclass(frozen=True)
class Plan:
    """Where everything lies: top left corners of boxes, cords, and where cords of a net part."""

    width: float
    height: float
    places: dict[str, Point]
    routes: tuple[Route, ...]
    dots: tuple[tuple[Net, Point], ...]
    near_nets: Counter[tuple[Net, Net]]  # how often two are in one space, or in two that adjoin


def lay_out(boxes: Iterable[Box], cords: Iterable[Cord]) -> Plan:
    """Place the boxes and route the cords; parts that no cord joins stand below each other."""
    by_name = {box.name: box for box in sorted(boxes, key=lambda box: box.name)}
    ordered = sorted(cords, key=lambda c: (c.target, c.place, c.source, c.port))
    plans = []
    for part in _parts(by_name, ordered):
        within = [cord for cord in ordered if cord.target in part]
        plans.append(_Layering([by_name[name] for name in sorted(part)], within).plan())
    return _stack(plans)


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


# -- columns ---------------------------------------------------------------------------------------


def _flow_order(boxes: Sequence[Box], cords: Sequence[Cord]) -> list[str]:
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


def _columns(order: Sequence[str], cords: Sequence[Cord]) -> dict[str, int]:
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


# -- one part of the diagram -----------------------------------------------------------------------


@dataclass
class _Item:
    """What takes up room in a column: a box, or a net passing it."""

    key: tuple[str, ...]
    height: float
    box: Box | None
    y: float = 0.0  # its top


@dataclass
class _End:
    """Where a net meets a column: an item and the distance from its top."""

    item: _Item
    offset: float

    @property
    def y(self) -> float:
        return self.item.y + self.offset


@dataclass
class _Space:
    """The room between two columns, with what each net joins there."""

    left: dict[Net, list[_End]] = field(default_factory=lambda: defaultdict(list))
    right: dict[Net, list[_End]] = field(default_factory=lambda: defaultdict(list))

    # What follows is asked only once all nets are threaded.

    @cached_property
    def nets(self) -> list[Net]:
        """Every net here, sorted."""
        return sorted({*self.left, *self.right})

    @cached_property
    def sides(self) -> tuple[tuple[list[_End], list[int], list[int]], ...]:
        """Left and right: ends net by net, which nets have any, and where those begin."""
        found = []
        for side in (self.left, self.right):
            present = [place for place, net in enumerate(self.nets) if side.get(net)]
            groups = [side[self.nets[place]] for place in present]
            sizes = [len(group) for group in groups]
            starts = [0, *itertools.accumulate(sizes)][:-1]
            found.append(([end for group in groups for end in group], present, starts))
        return tuple(found)


class _Layering:
    """The layout of one connected part."""

    def __init__(self, boxes: Sequence[Box], cords: Sequence[Cord]) -> None:
        self.boxes, self.cords = {box.name: box for box in boxes}, cords
        self.column = _columns(_flow_order(boxes, cords), cords)
        self.count = 1 + max(self.column.values())
        self.items: list[list[_Item]] = [[] for _ in range(self.count)]
        self.spaces = [_Space() for _ in range(self.count + 1)]  # space c is left of column c
        self.of_box: dict[str, _Item] = {}
        self.passing: dict[tuple[str, Net, int], _End] = {}
        self.end: dict[Cord, _End] = {}
        for box in boxes:
            item = _Item(("", box.name), box.height, box)
            self.of_box[box.name] = item
            self.items[self.column[box.name]].append(item)
        self.nets: dict[Net, list[Cord]] = defaultdict(list)
        for cord in cords:
            self.nets[cord.net].append(cord)
        for net, its in sorted(self.nets.items()):
            self._thread(net, its)

    def plan(self) -> Plan:
        """Order, heights, tracks, routes."""
        self._order()
        self._settle()
        self._separate()
        tracks = [self._tracks(place) for place in range(self.count + 1)]
        return self._draw(tracks)

    def _thread(self, net: Net, cords: Sequence[Cord]) -> None:
        """Give a net its places in the columns it passes, and join them in the spaces between."""
        source, port = net
        start = self.column[source]
        columns = [self.column[cord.target] for cord in cords]
        out = _End(self.of_box[source], self.boxes[source].outs[port])
        self.spaces[start + 1].left[net].append(out)
        for column in range(start + 1, max(columns)):
            end = self._pass("forward", net, column)
            self.spaces[column].right[net].append(end)
            self.spaces[column + 1].left[net].append(end)
        for column in range(start, min(columns) - 1, -1):
            end = self._pass("back", net, column)
            self.spaces[column + 1].left[net].append(end)
            self.spaces[column].right[net].append(end)
        for cord in cords:
            box = self.boxes[cord.target]
            end = _End(self.of_box[cord.target], box.ins[cord.place])
            self.end[cord] = end
            self.spaces[self.column[cord.target]].right[net].append(end)

    def _pass(self, way: str, net: Net, column: int) -> _End:
        item = _Item((way, *net), 0.0, None)
        self.items[column].append(item)
        end = _End(item, 0.0)
        self.passing[way, net, column] = end
        return end

    # -- order within the columns

    def _order(self) -> None:
        """Barycentre sweeps, then exchanges of neighbours; the best order found is kept."""
        for items in self.items:
            items.sort(key=lambda item: item.key)
            _pile(items)
        best, kept = self._crossings(), self._snapshot()
        for sweep in range(24 if len(self.boxes) <= LARGE else 6):
            columns = range(self.count) if sweep % 2 == 0 else range(self.count - 1, -1, -1)
            for column in columns:
                ahead = sweep % 2 == 0
                spaces = (column, column + 1) if sweep % 3 == 2 else (column + (not ahead),)
                self._sort(column, spaces)
                self._exchange_ins(column)
            now = self._crossings()
            if now < best - 1e-9:
                best, kept = now, self._snapshot()
        self._restore(kept)
        self.effort = 0
        for _ in range(8 if len(self.boxes) <= LARGE / 4 else 2 if len(self.boxes) <= LARGE else 1):
            before = best
            for column in range(self.count):
                best = self._exchange_neighbours(column, best)
                self._exchange_ins(column)
            best = self._crossings()
            if best >= before - 1e-9:
                break

    def _sort(self, column: int, spaces: Iterable[int]) -> None:
        pulls: dict[int, list[float]] = defaultdict(list)
        for place in spaces:
            space = self.spaces[place]
            for net in space.nets:
                ends = [*space.left.get(net, ()), *space.right.get(net, ())]
                for end in ends:
                    others = [o.y for o in ends if o is not end]
                    if others:
                        pulls[id(end.item)].append(sum(others) / len(others) - end.offset)
        items = self.items[column]
        wanted = {
            id(item): (
                sum(pulls[id(item)]) / len(pulls[id(item)]) + item.height / 2
                if id(item) in pulls
                else item.y + item.height / 2
            )
            for item in items
        }
        items.sort(key=lambda item: (round(wanted[id(item)], 6), item.key))
        _pile(items)

    def _exchange_ins(self, column: int) -> None:
        """Where a box does not mind, its cords come to its ins in the order they come from."""
        space = self.spaces[column]
        for item in self.items[column]:
            if item.box is None or not item.box.any_order:
                continue
            fixed = item.box.fixed_ins
            cords = [c for c in self.cords if c.target == item.box.name and c.place >= fixed]
            if len(cords) < 2:
                continue
            came = {}
            for cord in cords:
                mine = self.end[cord]
                ends = [*space.left.get(cord.net, ()), *space.right.get(cord.net, ())]
                others = [e.y for e in ends if e is not mine and e.item is not mine.item]
                came[cord] = sum(others) / len(others) if others else mine.y
            ordered = sorted(cords, key=lambda c: (round(came[c], 6), c.source, c.port, c.place))
            for cord, offset in zip(ordered, sorted(item.box.ins[fixed:]), strict=True):
                self.end[cord].offset = offset

    def _exchange_neighbours(self, column: int, best: float) -> float:
        items = self.items[column]
        near = (column, column + 1)
        before = sum(self._cost(space) for space in near)
        pairs = sum(len(self.spaces[space].nets) ** 2 for space in near)
        for place in range(len(items) - 1):
            self.effort += pairs
            if self.effort > EFFORT:
                break
            items[place], items[place + 1] = items[place + 1], items[place]
            heights = [item.y for item in items]
            _pile(items)
            after = sum(self._cost(space) for space in near)
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

    def _snapshot(self) -> tuple[list[list[tuple[_Item, float]]], dict[Cord, float]]:
        order = [[(item, item.y) for item in items] for items in self.items]
        return order, {cord: end.offset for cord, end in self.end.items()}

    def _restore(self, kept: tuple[list[list[tuple[_Item, float]]], dict[Cord, float]]) -> None:
        for column, items in enumerate(kept[0]):
            self.items[column] = [item for item, _ in items]
            for item, y in items:
                item.y = y
        for cord, offset in kept[1].items():
            self.end[cord].offset = offset

    def _crossings(self) -> float:
        return sum(self._cost(place) for place in range(self.count + 1))

    def _cost(self, place: int) -> float:
        """Crossings in a space, uprights being ordered at best, and a little for their length."""
        space = self.spaces[place]
        if not space.nets:
            return 0.0
        before, spans = _pair_costs(space)
        return float(np.minimum(before, before.T).sum()) / 2 + 2e-3 * float(spans.sum())

    # -- heights

    def _settle(self) -> None:
        """Heights that keep the order and the distances and make the uprights short in all."""
        for _ in range(3 if len(self.boxes) <= LARGE else 1):
            self._shorten()
            for column in range(self.count):
                self._exchange_ins(column)
        for _ in range(4 if len(self.boxes) <= LARGE else 1):
            self._shorten(few_bends=True)

    def _shorten(self, few_bends: bool = False) -> None:
        """Solve for the heights: a linear program, whose corners are where cords run straight.

        `few_bends`: uprights that are short now weigh more, so that they vanish and long ones pay.
        """
        items = [item for column in self.items for item in column]
        index = {id(item): i for i, item in enumerate(items)}
        costs = [0.0] * len(items)
        entries: list[tuple[int, int, float]] = []  # row, variable, factor
        limits: list[float] = []

        def at_most(first: int, second: int, limit: float) -> None:
            """Variable `first` - variable `second` <= limit."""
            entries.extend(((len(limits), first, 1.0), (len(limits), second, -1.0)))
            limits.append(limit)

        for column in self.items:
            for above, below in itertools.pairwise(column):
                at_most(index[id(above)], index[id(below)], -_distance(above, below))
        for space in self.spaces:
            for net in space.nets:
                ends = [*space.left.get(net, ()), *space.right.get(net, ())]
                if len(ends) < 2:
                    continue
                # A bend in a cord that passes by is worse than one at a box.
                passing = sum(end.item.box is None for end in ends)
                weight = 1.0 + 2.0 * (passing == len(ends)) + 0.5 * (len(ends) == 2)
                # The way on is to be straight, rather than a source's cord or one coming back.
                if not self.boxes[net[0]].ins or any(e.item.key[0] == "back" for e in ends):
                    weight *= 0.6
                if few_bends:
                    heights = [end.y for end in ends]
                    weight *= SHORT / (SHORT / 4 + max(heights) - min(heights))
                low, high = len(costs), len(costs) + 1
                costs += [-weight, weight]
                for end in ends:
                    i = index[id(end.item)]
                    at_most(low, i, end.offset)
                    at_most(i, high, -end.offset)
        if not limits:
            return
        rows, columns, factors = zip(*entries, strict=True)
        matrix: Any = csr_array((factors, (rows, columns)), shape=(len(limits), len(costs)))
        bounds = [(0.0, None)] * len(costs)
        solved = linprog(costs, matrix, limits, bounds=bounds, method="highs-ds")
        if solved.x is None:  # never seen: the order alone can always be kept
            return
        for item, y in zip(items, solved.x, strict=False):
            item.y = float(round(y))

    # -- tracks

    def _tracks(self, place: int) -> dict[Net, int]:
        """Net -> track of its upright, counted from the left of the space."""
        space = self.spaces[place]
        nets = space.nets
        if not nets:
            return {}
        order, _ = self._upright_order(place)
        low, high = _spans(space)
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

    def _separate(self) -> None:
        """Move ends that no order of the uprights can keep from running along each other."""
        for _ in range(6):
            moved = False
            for place in range(self.count + 1):
                _, wrong = self._upright_order(place)
                moved |= bool(wrong.any()) and self._nudge(place, wrong)
            if not moved:
                break
        for place in range(1, self.count):
            _, wrong = self._upright_order(place)
            shift, least = 0.0, int(wrong.sum())
            for step in (4, -4, 8, -8, 12, -12, 16, -16, 20, -20) if least else ():
                # All that lies to the right, so that no other space changes.
                self._lower(place, step)
                left = int(self._upright_order(place)[1].sum())
                self._lower(place, -step)
                if left < least:
                    shift, least = float(step), left
            self._lower(place, shift)
        top = min(item.y for items in self.items for item in items)
        self._lower(0, -top)

    def _lower(self, column: int, step: float) -> None:
        for items in self.items[column:]:
            for item in items:
                item.y += step

    def _upright_order(self, place: int) -> tuple[list[Net], NDArray[np.bool_]]:
        """Nets from left to right, with few crossings; [a, b]: a stands left of b against the rule."""
        nets = self.spaces[place].nets
        costs = self._ordering_costs(self.spaces[place], nets)
        order = _best_order(costs)
        rank = np.empty(len(order), dtype=int)
        rank[order] = np.arange(len(order))
        return [nets[i] for i in order], (costs >= 1000) & (rank[:, None] < rank[None, :])

    def _ordering_costs(self, space: _Space, nets: Sequence[Net]) -> NDArray[np.float64]:
        """[a, b]: what it costs if a stands left of b."""
        if not nets:
            return np.zeros((0, 0))
        costs, _ = _pair_costs(space)
        index = {net: i for i, net in enumerate(nets)}
        lefts = [(end.y, index[net]) for net, ends in space.left.items() for end in ends]
        heights = np.array([y for y, _ in lefts])
        for net, ends in space.right.items():
            for end in ends:
                for found in np.flatnonzero(np.abs(heights - end.y) < NEAR).tolist():
                    if lefts[found][1] != index[net]:
                        costs[index[net], lefts[found][1]] += 1000.0
        return costs

    def _nudge(self, place: int, wrong: NDArray[np.bool_]) -> bool:
        """Move one of two ends that collide, if there is room for it in its column."""
        space, nets = self.spaces[place], self.spaces[place].nets
        for a, b in np.argwhere(wrong).tolist():
            for right in space.right.get(nets[a], ()):
                for left in space.left.get(nets[b], ()):
                    if abs(right.y - left.y) >= NEAR:
                        continue
                    for end, other in ((right, left), (left, right)):
                        column = place if end is right else place - 1
                        for step in (NEAR + 1, -NEAR - 1):
                            move = other.y + step - end.y
                            if self._has_room(column, end.item, move):
                                end.item.y += move
                                return True
        return False

    def _has_room(self, column: int, item: _Item, move: float) -> bool:
        items = self.items[column]
        at = items.index(item)
        if at and item.y + move < items[at - 1].y + _distance(items[at - 1], item):
            return False
        below = items[at + 1] if at + 1 < len(items) else None
        return below is None or below.y >= item.y + move + _distance(item, below)

    # -- drawing

    def _draw(self, tracks: Sequence[dict[Net, int]]) -> Plan:
        x = 0.0
        track_x: list[dict[Net, float]] = []
        column_x: list[tuple[float, float]] = []
        for place in range(self.count + 1):
            its = tracks[place]
            count = 1 + max(its.values(), default=-1)
            at = {net: x + MARGIN + PITCH * track for net, track in its.items()}
            track_x.append(defaultdict(lambda x=x: x + MARGIN, at))  # type: ignore[misc]
            room = 2 * MARGIN + PITCH * max(count - 1, 0) if count else MARGIN
            outside = place in (0, self.count)
            x += (MARGIN + PITCH * count if count else 0.0) if outside else room
            if place < self.count:
                boxes = [item.box for item in self.items[place] if item.box]
                width = max((box.width for box in boxes), default=0.0)
                column_x.append((x, x + width))
                x += width
        places: dict[str, Point] = {}
        for name, item in self.of_box.items():
            left, right = column_x[self.column[name]]
            places[name] = (round((left + right - self.boxes[name].width) / 2), item.y)
        routes = [self._route(cord, places, track_x) for cord in self.cords]
        height = max(item.y + item.height for items in self.items for item in items)
        near: Counter[tuple[Net, Net]] = Counter()
        for space, beside in zip(self.spaces, [*self.spaces[1:], _Space()], strict=True):
            near.update(itertools.combinations(space.nets, 2))
            near.update(itertools.combinations(sorted({*space.nets, *beside.nets}), 2))
        return Plan(x, height, places, tuple(routes), self._dots(track_x), near)

    def _route(
        self,
        cord: Cord,
        places: Mapping[str, Point],
        track_x: Sequence[Mapping[Net, float]],
    ) -> Route:
        net, start = cord.net, self.column[cord.source]
        target, end = self.column[cord.target], self.end[cord]
        box = self.boxes[cord.source]
        y = self.of_box[cord.source].y + box.outs[cord.port]
        points = [(places[cord.source][0] + box.width, y)]
        if target > start:
            passed = [(c, self.passing["forward", net, c].y) for c in range(start + 1, target)]
            spaces = [c for c, _ in passed] + [target]
        else:
            passed = [(c, self.passing["back", net, c].y) for c in range(start, target - 1, -1)]
            spaces = [c + 1 for c, _ in passed] + [target]
        for space, next_y in zip(spaces, [*(y for _, y in passed), end.y], strict=True):
            points += [(track_x[space][net], y), (track_x[space][net], next_y)]
            y = next_y
        points.append((places[cord.target][0], y))
        place = self.boxes[cord.target].ins.index(end.offset)
        return Route(cord, _straightened(points), place)

    def _dots(self, track_x: Sequence[Mapping[Net, float]]) -> tuple[tuple[Net, Point], ...]:
        """Where three or more lines of a net meet."""
        dots = []
        for place, space in enumerate(self.spaces):
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


def _distance(above: _Item, below: _Item) -> float:
    """From the top of one item to the top of the next."""
    if above.box and below.box:
        return above.height + BOX_GAP
    return above.height + (PASS_GAP if above.box or below.box else PITCH)


def _pile(items: Sequence[_Item]) -> None:
    """Items one below the other, about the height 0."""
    y = 0.0
    for item, below in itertools.pairwise(items):
        item.y = y
        y += _distance(item, below)
    if items:
        items[-1].y = y
        middle = (y + items[-1].height) / 2
        for item in items:
            item.y -= middle


def _spans(space: _Space) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest end of each net."""
    low, high = np.full(len(space.nets), np.inf), np.full(len(space.nets), -np.inf)
    for ends, present, starts in space.sides:
        if ends:
            y = np.array([end.item.y + end.offset for end in ends])
            low[present] = np.minimum(low[present], np.minimum.reduceat(y, starts))
            high[present] = np.maximum(high[present], np.maximum.reduceat(y, starts))
    return low, high


def _pair_costs(space: _Space) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """[a, b]: crossings of nets a and b if the upright of a stands left of that of b; the spans."""
    low, high = _spans(space)
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


def _best_order(costs: NDArray[np.float64]) -> list[int]:
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
