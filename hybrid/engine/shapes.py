"""What an element puts into a circuit: its figures, and a shape that many share.

Stage 4, for `wiring`. The runs of a batch differ in a few elements, and most of those in figures alone.
So what an element puts in is kept for the element itself, which `circuits` hands over again while
nothing in it changes. Of equal shapes and rates there is one object: to compare them is to compare where
they are.
"""

from __future__ import annotations

import functools
import math
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hybrid.elements import (
    ANGLE,
    INTEGRATE,
    PIECES,
    PRODUCT,
    SUM,
    Element,
    angle_pieces,
    limit_pieces,
)
from hybrid.engine.circuit import OF_ANGLE, OF_INTEGRATOR, OF_OUTPUT, OF_SUM
from hybrid.engine.order import rank
from hybrid.memo import KeptByObject

# Elements of which what they put into a circuit is kept.
MOST_ELEMENTS = 4096
# What a corner guards, its pieces, and the piece it begins in.
Corner = tuple[int, Sequence[tuple[float, ...]], int]


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """What decides where the figures of an element stand; see `shape_of`."""

    kind: int
    first: tuple[str, ...]
    second: tuple[str, ...]
    control: str | None
    reset: str | None
    hold: str | None
    rank: int  # see `order`
    lagged: bool
    noisy: bool
    loud: bool
    corners: tuple[tuple[int, int, int], ...]  # what is guarded, how many pieces, the first one

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the signals that such an element needs at the same instant."""
        return (*self.first, *self.second, *(c for c in (self.control, self.reset, self.hold) if c))


@dataclass(frozen=True, slots=True, eq=False)
class Rates:
    """How quickly an element forgets, of which operators are made; see `_rates_of`."""

    decay: float  # 1/s, of an integrator without its inputs
    lag_s: float
    noise: float


# One of a kind. What goes first of very many is made anew when it comes again, and then so are frames.
_shape_of = functools.lru_cache(maxsize=4096)(Shape)
_rates_of = functools.lru_cache(maxsize=4096)(Rates)


class Part(NamedTuple):
    """What an element puts into a circuit; the last three are rows of floats."""

    shape: Shape
    rates: Rates
    own: bytes  # its figures, and then what it begins with
    gain: bytes
    pieces: bytes


def _made(e: Element) -> Part:
    corners = _corners(e)
    shape = _shape_of(
        e.kind,
        tuple(e.first),
        tuple(e.second),
        e.control,
        e.reset,
        e.hold,
        rank(e),
        e.lag_s > 0.0,
        e.noise > 0.0,
        e.loud,
        tuple([(role, len(pieces), first) for role, pieces, first in corners]),
    )
    # A difference: 0 has no sign, so that the rates of a circuit do not depend on which came first.
    decay = 0.0 - e.figures[0] if e.kind == INTEGRATE and e.figures else 0.0
    return Part(
        shape,
        _rates_of(decay, e.lag_s, e.noise),
        _packed((*_figures(e), e.initial, e.initial_output)),
        _packed(_gains(e)),
        _packed([x for _, pieces, _ in corners for piece in pieces for x in piece]),
    )


part_of = KeptByObject(_made, MOST_ELEMENTS)


def _packed(figures: Sequence[float]) -> bytes:
    return array("d", figures).tobytes() if figures else b""


def _figures(e: Element) -> tuple[float, ...]:
    """A row of `Circuit.figures`. The gain of sums and products is in those of their terms."""
    constant, gain, offset = e.constant, e.gain, e.offset
    if e.kind in (SUM, PRODUCT):
        constant, gain = constant * gain, 1.0
    if e.kind == SUM:
        constant, offset = constant + offset, 0.0
    return (constant, e.second_constant, gain, offset, *e.figures, 0.0, 0.0, 0.0)[:7]


def _gains(e: Element) -> list[float]:
    """The gains of its terms, of the first sum and then of the second."""
    factor = e.gain if e.kind in (SUM, PRODUCT) else 1.0
    return [*[factor * gain for gain in e.first.values()], *e.second.values()]


def _corners(e: Element) -> list[Corner]:
    """What each corner guards, its pieces, and the piece it begins in."""
    found: list[Corner] = []
    if e.kind == INTEGRATE:
        limits = _integrator_limits(e)
        if limits is not None:
            found.append((OF_INTEGRATOR, _integrator_pieces(*limits), 1))
    elif e.kind == PIECES:
        found.append((OF_SUM, e.pieces, e.initial_piece))
    elif e.kind == ANGLE:
        found.append((OF_ANGLE, angle_pieces(), 1))
    if math.isfinite(e.saturation) and e.kind != INTEGRATE:
        found.append((OF_OUTPUT, limit_pieces(-e.saturation, e.saturation), 1))
    return found


def _integrator_limits(element: Element) -> tuple[float, float] | None:
    """Bounds of the state: its own, or those at which the output saturates."""
    if element.limits is not None or not math.isfinite(element.saturation):
        return element.limits
    ends = [(s * element.saturation - element.offset) / element.gain for s in (-1.0, 1.0)]
    return min(ends), max(ends)


def _integrator_pieces(low: float, high: float) -> list[tuple[float, ...]]:
    """At its lower limit and free to leave once driven up, between the limits, at its upper limit."""
    return [
        (-math.inf, 0.0, 0.0, low, 0.0, 0.0),
        (low, high, 0.0, 0.0, 1.0, 0.0),
        (0.0, math.inf, 0.0, high, 0.0, 0.0),
    ]
