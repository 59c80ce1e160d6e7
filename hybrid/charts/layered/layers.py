"""Columns of items and the spaces between them, joined by nets.

All cords from one port are a net. In every column it passes, a net holds one place, whether it runs
forward or back, so that no cord ever passes under a box.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from hybrid.charts.layered.columns import columns_of, flow_order
from hybrid.charts.layered.plan import Box, Cord, Net
from hybrid.charts.layered.spacing import BOX_GAP, PASS_GAP, PITCH


@dataclass
class Item:
    """What takes up room in a column: a box, or a net passing it."""

    key: tuple[str, ...]
    height: float
    box: Box | None
    y: float = 0.0  # its top


@dataclass
class End:
    """Where a net meets a column: an item and the distance from its top."""

    item: Item
    offset: float

    @property
    def y(self) -> float:
        """Its height on the plan."""
        return self.item.y + self.offset


@dataclass
class Space:
    """The room between two columns, with what each net joins there."""

    left: dict[Net, list[End]] = field(default_factory=lambda: defaultdict(list))
    right: dict[Net, list[End]] = field(default_factory=lambda: defaultdict(list))

    # What follows is asked only once all nets are threaded.

    @cached_property
    def nets(self) -> list[Net]:
        """Every net here, sorted."""
        return sorted({*self.left, *self.right})

    @cached_property
    def sides(self) -> tuple[tuple[list[End], list[int], list[int]], ...]:
        """Left and right: ends net by net, which nets have any, and where those begin."""
        found = []
        for side in (self.left, self.right):
            present = [place for place, net in enumerate(self.nets) if side.get(net)]
            groups = [side[self.nets[place]] for place in present]
            sizes = [len(group) for group in groups]
            starts = [0, *itertools.accumulate(sizes)][:-1]
            found.append(([end for group in groups for end in group], present, starts))
        return tuple(found)


class Layers:
    """Boxes in their columns, and the nets between them, of one part that cords join."""

    def __init__(self, boxes: Sequence[Box], cords: Sequence[Cord]) -> None:
        self.effort = 0  # pairs of nets that were looked at for exchanges of neighbours
        self.boxes, self.cords = {box.name: box for box in boxes}, cords
        self.column = columns_of(flow_order(boxes, cords), cords)
        self.count = 1 + max(self.column.values())
        self.items: list[list[Item]] = [[] for _ in range(self.count)]
        self.spaces = [Space() for _ in range(self.count + 1)]  # space c is left of column c
        self.of_box: dict[str, Item] = {}
        self.passing: dict[tuple[str, Net, int], End] = {}
        self.end: dict[Cord, End] = {}
        for box in boxes:
            item = Item(("", box.name), box.height, box)
            self.of_box[box.name] = item
            self.items[self.column[box.name]].append(item)
        self.nets: dict[Net, list[Cord]] = defaultdict(list)
        for cord in cords:
            self.nets[cord.net].append(cord)
        for net, its in sorted(self.nets.items()):
            self._thread(net, its)

    def _thread(self, net: Net, cords: Sequence[Cord]) -> None:
        """Give a net its places in the columns it passes, and join them in the spaces between."""
        source, port = net
        start = self.column[source]
        columns = [self.column[cord.target] for cord in cords]
        out = End(self.of_box[source], self.boxes[source].outs[port])
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
            end = End(self.of_box[cord.target], box.ins[cord.place])
            self.end[cord] = end
            self.spaces[self.column[cord.target]].right[net].append(end)

    def _pass(self, way: str, net: Net, column: int) -> End:
        item = Item((way, *net), 0.0, None)
        self.items[column].append(item)
        end = End(item, 0.0)
        self.passing[way, net, column] = end
        return end


def distance(above: Item, below: Item) -> float:
    """From the top of one item to the top of the next."""
    if above.box and below.box:
        return above.height + BOX_GAP
    return above.height + (PASS_GAP if above.box or below.box else PITCH)


def pile(items: Sequence[Item]) -> None:
    """Items one below the other, about the height 0."""
    y = 0.0
    for item, below in itertools.pairwise(items):
        item.y = y
        y += distance(item, below)
    if items:
        items[-1].y = y
        middle = (y + items[-1].height) / 2
        for item in items:
            item.y -= middle
