"""What is laid out, boxes and cords, and what comes of it: a plan of places and routes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

Point: TypeAlias = tuple[float, float]
Net: TypeAlias = tuple[str, str]  # box and port


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
