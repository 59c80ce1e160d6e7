"""Nonlinear components: function generators, limiters, comparators, switches.

Each gives an `Element` in problem units (SI); the compiler scales it to machine units and adds what all
components share.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

from hybrid import elements
from hybrid.components.base import Core, Given, Kind, Step
from hybrid.components.sources import BIAS, PERIOD, PHASE, place_at_start, too_short
from hybrid.elements import Element
from hybrid.keys import Bound, Holds, Key, Unit
from hybrid.language import LEAK, LEAK_LIMIT
from hybrid.units import PURE, Dimension

GAIN = Key("gain", Holds.QUANTITY, "factor of the result", Unit.ANY, default="1")
CONTROL = Key(
    "control",
    Holds.SIGNAL,
    "a comparator, a DAC or a step, pulse or square source (high above half scale), or operating, "
    "resetting, holding: the machine's mode",
    required=True,
)
LOW = Key("low", Holds.QUANTITY, "lower limit", Unit.OWN, required=True)
HIGH = Key("high", Holds.QUANTITY, "upper limit", Unit.OWN, required=True)


class Nonlinear(Kind):
    """A kind with an element instead of a linear core; its main key names one signal or several."""

    is_linear = False
    passes_jumps = True
    symbol = "function"
    inputs = 1

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """None but the steps of a source."""
        return Core()


class SameUnit(Nonlinear):
    """A kind whose output is in the unit of the signal that it reads, or of both."""

    takes_alike = True

    def result(self, inputs: tuple[Dimension, ...]) -> Dimension:
        """Dimension of the signal."""
        return inputs[0]


class SinOf(Nonlinear):
    """Sine of an angle: half of a resolver."""

    key, symbol = "sin", "resolver"
    doc = "amplitude times the sine of a signal, an angle in rad"
    main = Key("sin", Holds.SIGNAL, "the angle", required=True)
    keys = (Key("amplitude", Holds.QUANTITY, "factor of the sine", Unit.OWN, default="1"),)
    function = elements.SIN
    factor, takes_angle = "amplitude", True

    def element(self, given: Given) -> Element:
        """w = amplitude * sin(a)."""
        (a,) = given.signals
        wave = Element(self.function, {a: 1.0})
        return elements.amplified(wave, given.values.get("amplitude", 1.0))

    def result(self, inputs: tuple[Dimension, ...]) -> Dimension:
        """A sine is a pure number."""
        return PURE


class CosOf(SinOf):
    """Cosine of an angle: the other half of a resolver."""

    key = "cos"
    doc = "amplitude times the cosine of a signal, an angle in rad"
    main = Key("cos", Holds.SIGNAL, "the angle", required=True)
    function = elements.COS


class AngleOf(Nonlinear):
    """The angle of a direction: a resolver that turns until it finds it."""

    key, symbol, inputs = "atan2", "resolver", 2
    doc = (
        "angle of the direction that has the first signal across and the second ahead, in rad; it jumps "
        "at half a turn"
    )
    main = Key("atan2", Holds.SIGNALS, "across and ahead", required=True)
    keys = (GAIN,)
    factor, takes_alike = GAIN.name, True

    def element(self, given: Given) -> Element:
        """w = gain * atan2(a, b)."""
        (a, b), gain = given.signals, given.values.get("gain", 1.0)
        return elements.amplified(Element(elements.ANGLE, {a: 1.0}, second={b: 1.0}), gain)

    def result(self, inputs: tuple[Dimension, ...]) -> Dimension:
        """An angle is a pure number."""
        return PURE


class FunctionGenerator(Nonlinear):
    """A function through points, by straight lines: a diode function generator."""

    key, symbol = "function", "function generator"
    doc = "function of a signal through given points, by straight lines, the outer ones prolonged"
    main = Key("function", Holds.SIGNAL, "the signal", required=True)
    keys = (
        Key("points", Holds.POINTS, "input: output, two points or more", required=True),
        Key(
            "rounding",
            Holds.QUANTITY,
            "width over which each corner is rounded, in units of the input, as diodes round it",
            Unit.ANY,
            Bound.NOT_NEGATIVE,
            default="0",
        ),
    )

    def element(self, given: Given) -> Element:
        """w = table(a); the outer lines are prolonged."""
        (a,) = given.signals
        x, y = zip(*given.points, strict=True)
        rounding = given.values.get("rounding", 0.0)
        return Element(elements.PIECES, {a: 1.0}, pieces=elements.table_pieces(x, y, rounding))

    def unsuitable(self, given: Given) -> str:
        """Points must ascend, further apart than the rounding is wide."""
        x = [point[0] for point in given.points]
        gaps = [b - a for a, b in itertools.pairwise(x)]
        if len(x) < 2:
            return "needs two points or more"
        if min(gaps) <= 0.0:
            return "has two points at one input"
        if given.values.get("rounding", 0.0) >= min(gaps):
            return f"has points {min(gaps):g} apart, so rounding must be less than that"
        return ""


class Absolute(SameUnit):
    """The size of a signal."""

    key, symbol = "absolute", "absolute value"
    doc = "absolute value of a signal"
    main = Key("absolute", Holds.SIGNAL, "the signal", required=True)

    def element(self, given: Given) -> Element:
        """w = |a|."""
        (a,) = given.signals
        return Element(elements.PIECES, {a: 1.0}, pieces=elements.abs_pieces())


class Limit(SameUnit):
    """A signal kept between two limits."""

    key, symbol = "limit", "limiter"
    doc = "a signal, limited"
    main = Key("limit", Holds.SIGNAL, "the signal", required=True)
    keys = (LOW, HIGH)

    def element(self, given: Given) -> Element:
        """w = min(max(a, low), high)."""
        (a,) = given.signals
        pieces = elements.limit_pieces(given.values["low"], given.values["high"])
        return Element(elements.PIECES, {a: 1.0}, pieces=pieces, initial_piece=1)

    def settings(self, given: Given) -> Mapping[str, float]:
        """Both limits."""
        return {f"({key})": given.values[key] / given.full_scale for key in ("low", "high")}

    def unsuitable(self, given: Given) -> str:
        """The limits must leave something between them."""
        low, high = given.values["low"], given.values["high"]
        return "" if low < high else f"has low {low:g} not below high {high:g}"


class DeadZone(Limit):
    """Zero while a signal stays within a band, the distance from the band outside."""

    key, symbol = "dead_zone", "dead zone"
    doc = "0 from low to high, the distance beyond them outside"
    main = Key("dead_zone", Holds.SIGNAL, "the signal", required=True)

    def element(self, given: Given) -> Element:
        """w = a - high above, a - low below, 0 between."""
        (a,) = given.signals
        pieces = elements.dead_zone_pieces(given.values["low"], given.values["high"])
        return Element(elements.PIECES, {a: 1.0}, pieces=pieces, initial_piece=1)


class Compare(Nonlinear):
    """A comparator with hysteresis: one of two values, by the sign of a sum."""

    key, symbol, inputs = "compare", "comparator", 0
    jumps = True
    doc = "high while the sum of its inputs is positive, else low"
    main = Key("compare", Holds.TERMS, "signal: coefficient", required=True)
    keys = (
        Key("high", Holds.QUANTITY, "output while the sum is positive", Unit.OWN, required=True),
        Key("low", Holds.QUANTITY, "output while it is negative", Unit.OWN, default="0"),
        Key(
            "hysteresis",
            Holds.QUANTITY,
            "the sum must pass zero by half of this to switch; in units of the sum",
            Unit.ANY,
            Bound.NOT_NEGATIVE,
            default="0",
        ),
        Key("threshold", Holds.QUANTITY, "what the sum is compared with", Unit.ANY, default="0"),
    )

    def element(self, given: Given) -> Element:
        """Rises at threshold + hysteresis / 2, falls at threshold - hysteresis / 2."""
        values = given.values
        half, at = values.get("hysteresis", 0.0) / 2, values.get("threshold", 0.0)
        pieces = elements.comparator_pieces(
            values.get("low", 0.0), values["high"], at - half, at + half
        )
        return Element(elements.PIECES, given.gains, pieces=pieces)

    def settings(self, given: Given) -> Mapping[str, float]:
        """Inputs, threshold and hysteresis as parts of the input that counts most; both levels."""
        weights = {signal: gain * given.scales[signal] for signal, gain in given.gains.items()}
        whole = max(map(abs, weights.values()), default=0.0) or 1.0
        compared = {f"({key})": given.values.get(key, 0.0) for key in ("threshold", "hysteresis")}
        levels = {f"({k})": given.values.get(k, 0.0) / given.full_scale for k in ("low", "high")}
        return {k: v / whole for k, v in {**weights, **compared}.items()} | levels


class Switch(SameUnit):
    """A relay: one of two signals, as a comparator or a DAC says."""

    key, symbol, inputs = "switch", "switch", 2
    doc = "the first signal while the control is high, else the second"
    main = Key("switch", Holds.SIGNALS, "signal while high, signal while low", required=True)
    keys = (CONTROL,)

    def element(self, given: Given) -> Element:
        """w = a while control is high, else b."""
        a, b = given.signals
        return Element(elements.SWITCH, {a: 1.0}, second={b: 1.0}, control=given.control)


class Track(SameUnit):
    """Track-store: follows a signal while told to, else holds its last value, which may droop."""

    key, symbol = "track", "track-store"
    doc = "follows a signal while the control is high, else holds"
    main = Key("track", Holds.SIGNAL, "the signal", required=True)
    keys = (
        CONTROL,
        Key("initial", Holds.QUANTITY, "held before the first time", Unit.OWN, default="0"),
        LEAK,
        LEAK_LIMIT,
    )

    def element(self, given: Given) -> Element:
        """w = a while control is high, then w' = -leak w."""
        (a,), values = given.signals, given.values
        return Element(
            elements.TRACK,
            {a: 1.0},
            control=given.control,
            initial=values.get("initial", 0.0),
            figures=(values.get("leak", 0.0),),
        )


class Sawtooth(Nonlinear):
    """A sawtooth wave: rises evenly through every period and falls at once at its end.

    A triangle of twice the period, the integral of a square wave, times that square wave: what is
    integrated comes back to where it was, so that nothing grows with time.
    """

    key, symbol, inputs = "sawtooth", "source", 0
    passes_jumps = False
    doc = "a sawtooth wave that rises from minus to plus its amplitude in every period"
    main = Key("sawtooth", Holds.QUANTITY, "amplitude", Unit.OWN, required=True)
    keys = (PERIOD, PHASE, BIAS)

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """The square wave, of one full scale."""
        period, first = values["period"], 1.0 - place_at_start(values)  # when it falls first
        steps = (
            Step(-1.0, first * period, 2 * period),
            Step(1.0, (first + 1.0) * period, 2 * period),
        )
        return Core(steps=steps, held=1.0)

    def inner(self, given: Given) -> Mapping[str, Element]:
        """The triangle, from -1 to 1 and back, and its product with the square wave."""
        rate, begins = 2.0 / given.values["period"], 2.0 * place_at_start(given.values) - 1.0
        return {
            ":triangle": Element(elements.INTEGRATE, {":source": rate}, initial=begins),
            ":wave": Element(elements.PRODUCT, {":source": 1.0}, second={":triangle": 1.0}),
        }

    def element(self, given: Given) -> Element:
        """w = bias + amplitude * triangle * square."""
        amplitude, bias = given.values["sawtooth"], given.values.get("bias", 0.0)
        return Element(elements.SUM, {":wave": amplitude}, bias)

    def unsuitable(self, given: Given) -> str:
        """A period must be some time."""
        return too_short(given.values["period"])
