"""Multiplier, divider and square root: ideal, or as the circuits that they are.

A quarter-square multiplier forms a b = ((a + b) / 2)^2 - ((a - b) / 2)^2 by two diode squarers of
straight segments. A divider and a square root are a high-gain amplifier that drives its output until a
multiplier in its feedback gives the input back. With w the product of its gain A and bandwidth, and n,
d, q numerator, denominator and output in machine units (k makes q = k n / d of the figures wanted):

    q' = w (k n - d q) - (w / A) q,    q within its limits

so that q settles at k n / (d + 1 / A), as exp(-w (d + 1 / A) t). The square root has q for d.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from hybrid import elements
from hybrid.components.base import Core, Given
from hybrid.components.nonlinear import GAIN, Nonlinear
from hybrid.elements import Element
from hybrid.keys import Bound, Holds, Key, Unit
from hybrid.units import Dimension

# Where an amplifier in a feedback circuit stops, in full scales, if it has no `saturation`.
AMPLIFIER_STOPS = 1.5
OPEN_GAIN, BANDWIDTH_RAD_S = 1e5, 1e6
# What rounding makes of a factor of 1.
ROUNDED = 1e-14

FEEDBACK_KEYS = (
    Key(
        "circuit",
        Holds.CHOICE,
        "how it is made: as its figures say, or as an amplifier with a multiplier in its feedback",
        default="ideal",
        choices=("ideal", "feedback"),
    ),
    Key(
        "open_gain",
        Holds.QUANTITY,
        "of circuit: feedback, gain of the amplifier at rest",
        Unit.PURE,
        Bound.POSITIVE,
        default="1e5",
    ),
    Key(
        "bandwidth",
        Holds.QUANTITY,
        "of circuit: feedback, where the gain of the amplifier has fallen to 1, in rad/s",
        Unit.RATE,
        Bound.POSITIVE,
        default="1e6 rad/s",
    ),
)


class Multiply(Nonlinear):
    """The product of two signals."""

    key, symbol, inputs = "multiply", "multiplier", 2
    doc = "product of two signals"
    main = Key("multiply", Holds.SIGNALS, "the two signals", required=True)
    factor = GAIN.name
    keys = (
        GAIN,
        Key(
            "quarter_square",
            Holds.INTEGER,
            "straight segments from zero to full scale of each of the two diode squarers that make the "
            "product; n of them err by at most 1/(4 n^2), 23 by 0.05 %, of gain times the full scales "
            "of the two signals",
            default="an ideal product",
        ),
    )

    def element(self, given: Given) -> Element:
        """w = gain * a * b."""
        (a, b), gain = given.signals, given.values.get("gain", 1.0)
        if "quarter_square" not in given.values:
            return Element(elements.PRODUCT, {a: gain}, second={b: 1.0})
        whole = gain * given.scales[a] * given.scales[b]
        return Element(elements.SUM, {":plus": 1.0, ":minus": -1.0}, gain=whole)

    def inner(self, given: Given) -> Mapping[str, Element]:
        """The squarers, each a chord of the parabola in every segment: 0 to 1/(4 n^2) too high."""
        if "quarter_square" not in given.values:
            return {}
        n = int(given.values["quarter_square"])
        x = [k / n for k in range(-n, n + 1)]
        pieces = elements.table_pieces(x, [value * value for value in x])
        return {
            name: Element(elements.PIECES, _half_sum(given, sign), pieces=pieces, initial_piece=n)
            for name, sign in ((":plus", 1.0), (":minus", -1.0))
        }

    def settings(self, given: Given) -> Mapping[str, float]:
        """The factor of the product of machine units, which is what a multiplier gives."""
        a, b = given.signals
        return gain_setting(given, given.scales[a] * given.scales[b])

    def result(self, inputs: tuple[Dimension, ...]) -> Dimension:
        """Dimension of the product."""
        return inputs[0] * inputs[1]


def gain_setting(given: Given, natural: float) -> dict[str, float]:
    """What a result, `natural` at full scale of its inputs, is still multiplied by where not by 1."""
    factor = given.values.get("gain", 1.0) * natural / given.full_scale
    return {} if math.isclose(factor, 1.0, rel_tol=ROUNDED) else {"(gain)": factor}


def _half_sum(given: Given, sign: float) -> dict[str, float]:
    """(a + sign b) / 2 in full scales of each; both may be one signal."""
    a, b = given.signals
    halves = {a: 0.5 / given.scales[a]}
    halves[b] = halves.get(b, 0.0) + sign * 0.5 / given.scales[b]
    return halves


class InFeedback(Nonlinear):
    """What may be an amplifier with a multiplier in its feedback."""

    def in_feedback(self, given: Given) -> bool:
        """Whether it is."""
        return given.values.get("circuit") == 1.0

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """The amplifier keeps its output, so a loop through it needs no lag."""
        return Core(dynamic=values.get("circuit") == 1.0)

    def unsuitable(self, given: Given) -> str:
        """Figures of the amplifier need the amplifier."""
        found = [key for key in ("open_gain", "bandwidth") if key in given.values]
        if found and not self.in_feedback(given):
            return f"has {found[0]}, which is of the amplifier; add circuit: feedback"
        return ""

    def amplifier(
        self, given: Given, drive: Mapping[str, float], weight: float, low: float
    ) -> Element:
        """x' = w (drive - :product) - (w / A) x from `low` full scales up, `weight` w its lag's rate.

        It is written as a lag of x + (what drives it) / rate: windows need not be as short as 1 / w.
        """
        rate = weight * given.values.get("bandwidth", BANDWIDTH_RAD_S)
        keeps = 1.0 - 1.0 / (weight * given.values.get("open_gain", OPEN_GAIN))
        stops = given.saturation if math.isfinite(given.saturation) else AMPLIFIER_STOPS
        gains = {signal: gain / weight for signal, gain in drive.items()}
        return Element(
            elements.PIECES,
            {**gains, ":product": -1.0 / weight, ":amplifier": keeps},
            pieces=elements.limit_pieces(low * stops, stops),
            initial_piece=1,
            lag_s=1.0 / rate,
        )


class Divide(InFeedback):
    """One signal divided by another."""

    key, symbol, inputs = "divide", "divider", 2
    doc = "the first signal divided by the second; circuit: feedback needs a positive denominator"
    main = Key("divide", Holds.SIGNALS, "numerator and denominator", required=True)
    keys = (GAIN, *FEEDBACK_KEYS)
    factor = GAIN.name

    def element(self, given: Given) -> Element:
        """w = gain * a / b."""
        a, b = given.signals
        if self.in_feedback(given):
            return Element(elements.SUM, {":amplifier": 1.0}, gain=given.full_scale)
        return Element(elements.QUOTIENT, {a: given.values.get("gain", 1.0)}, second={b: 1.0})

    def inner(self, given: Given) -> Mapping[str, Element]:
        """Amplifier and multiplier; the loop is stable, with rate w d, while d is positive."""
        if not self.in_feedback(given):
            return {}
        a, b = given.signals
        wanted = given.values.get("gain", 1.0) / (given.scales[b] * given.full_scale)
        denominator = {b: 1.0 / given.scales[b]}
        product = Element(elements.PRODUCT, denominator, second={":amplifier": 1.0})
        return {":product": product, ":amplifier": self.amplifier(given, {a: wanted}, 1.0, -1.0)}

    def settings(self, given: Given) -> Mapping[str, float]:
        """The factor of the quotient of machine units."""
        a, b = given.signals
        return gain_setting(given, given.scales[a] / given.scales[b])

    def result(self, inputs: tuple[Dimension, ...]) -> Dimension:
        """Dimension of the quotient."""
        return inputs[0] / inputs[1]


class SquareRoot(InFeedback):
    """The square root of a signal; 0 below 0."""

    key, symbol = "square_root", "square root"
    doc = "square root of a signal, 0 where it is negative"
    main = Key("square_root", Holds.SIGNAL, "the signal", required=True)
    keys = (GAIN, *FEEDBACK_KEYS)
    factor = GAIN.name

    def element(self, given: Given) -> Element:
        """w = gain * sqrt(a)."""
        (a,), gain = given.signals, given.values.get("gain", 1.0)
        if self.in_feedback(given):
            size = math.copysign(given.full_scale, gain)
            return Element(elements.SUM, {":amplifier": 1.0}, gain=size)
        return elements.amplified(Element(elements.SQRT, {a: 1.0}), gain)

    def inner(self, given: Given) -> Mapping[str, Element]:
        """Amplifier, multiplier, and a diode that keeps the output from turning negative."""
        if not self.in_feedback(given):
            return {}
        wanted = (given.values.get("gain", 1.0) / given.full_scale) ** 2
        square = Element(elements.PRODUCT, {":amplifier": 1.0}, second={":amplifier": 1.0})
        drive = {given.signals[0]: wanted}
        return {":product": square, ":amplifier": self.amplifier(given, drive, 2.0, 0.0)}

    def settings(self, given: Given) -> Mapping[str, float]:
        """The factor of the root of machine units."""
        return gain_setting(given, math.sqrt(given.scales[given.signals[0]]))

    def result(self, inputs: tuple[Dimension, ...]) -> Dimension:
        """Dimension of the root."""
        return inputs[0] ** 0.5
