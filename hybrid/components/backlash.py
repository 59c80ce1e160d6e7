"""Backlash, the play of gears: an analog computer's circuit for it, an integrator behind a dead zone.

    y' = rate * (what x - y exceeds the play by)

With `rate` without bound this is the play operator, which keeps y within half the play of x and moves
it no more than that needs. With y within half the play of x at the start, the circuit stays within
max |x'| / rate of the play operator p: behind x it is late by no more than that, since the excess e
obeys e' = x' - rate e; y rises only where y <= x - h <= p, h half the play, so y - p can only grow as p
falls with p = x + h, and there y <= x + h + max |x'| / rate; and so with signs reversed.
"""

from __future__ import annotations

from collections.abc import Mapping

from hybrid import elements
from hybrid.components.base import Core, Given
from hybrid.components.nonlinear import SameUnit
from hybrid.elements import Element
from hybrid.keys import Bound, Holds, Key, Unit

RATE_1_S = 1e6


class Backlash(SameUnit):
    """Follows a signal with play."""

    key, symbol = "backlash", "backlash"
    doc = "follows a signal with play, as the far side of a gear does"
    main = Key("backlash", Holds.SIGNAL, "the signal", required=True)
    keys = (
        Key(
            "width",
            Holds.QUANTITY,
            "the whole play: so far the signal moves back before the output follows",
            Unit.OWN,
            Bound.POSITIVE,
            required=True,
        ),
        Key(
            "rate",
            Holds.QUANTITY,
            "rate of the circuit; the output is late by the speed of the signal over this",
            Unit.RATE,
            Bound.POSITIVE,
            default="1e6 1/s",
        ),
        Key(
            "initial",
            Holds.QUANTITY,
            "where it stands before t = 0; if the signal leaves that no room, as near as it does",
            Unit.OWN,
            default="0",
        ),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """The circuit keeps its output, so a loop through it needs no lag."""
        return Core(dynamic=True, initial=values.get("initial"))

    def inner(self, given: Given) -> Mapping[str, Element]:
        """All from the initial position, in full scales; in contact the integrator is a lag of the edge.

        As a lag that is held while the gap is within the play it keeps its figure to the last bit, and
        windows need not be as short as 1 / rate.
        """
        (signal,), own = given.signals, given.full_scale
        half, initial = given.values["width"] / 2 / own, given.values.get("initial", 0.0) / own
        position, beyond = {signal: 1.0 / own}, elements.comparator_pieces(0.0, 1.0, half, half)
        back = {signal: -1.0 / own, ":play": 1.0}
        either = elements.comparator_pieces(0.0, 1.0, 0.5, 0.5)
        return {
            ":above": Element(
                elements.PIECES, {**position, ":play": -1.0}, -initial, pieces=beyond
            ),
            ":below": Element(elements.PIECES, back, initial, pieces=beyond),
            ":contact": Element(elements.PIECES, {":above": 1.0, ":below": 1.0}, pieces=either),
            ":edge": Element(
                elements.SWITCH,
                position,
                -half - initial,
                position,
                half - initial,
                control=":above",
            ),
            ":play": Element(
                elements.TRACK,
                {":edge": 1.0},
                control=":contact",
                lag_s=1.0 / given.values.get("rate", RATE_1_S),
            ),
        }

    def element(self, given: Given) -> Element:
        """The position."""
        initial = given.values.get("initial", 0.0) / given.full_scale
        return Element(elements.SUM, {":play": 1.0}, initial, gain=given.full_scale)
