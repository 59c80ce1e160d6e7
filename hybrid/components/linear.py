"""Linear components: sum, coefficient, inverter, integrator, first-order lag."""

from __future__ import annotations

import math
from collections.abc import Mapping

from hybrid.components.base import Core, Given, Kind
from hybrid.keys import Bound, Holds, Key, Unit
from hybrid.language import LEAK, LEAK_LIMIT


class Sum(Kind):
    """Adds its inputs, each times its coefficient; it does not invert unless told to."""

    key, symbol = "sum", "summer"
    passes_jumps = True
    doc = "sum of inputs, each times its coefficient"
    main = Key("sum", Holds.TERMS, "signal: coefficient", required=True)

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = sum(coefficient * input)."""
        return Core(gains)


class Coefficient(Sum):
    """One input times a constant: a potentiometer, with the amplifier gain it needs."""

    key, symbol = "coefficient", "potentiometer"
    doc = "one input times a constant"
    main = Key("coefficient", Holds.TERMS, "one signal: its coefficient", required=True)
    single_input = True


class Invert(Sum):
    """The input with its sign reversed."""

    key, symbol = "invert", "inverter"
    doc = "the input with its sign reversed"
    main = Key("invert", Holds.SIGNAL, "the input", required=True)

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = -input."""
        return Core({signal: -gain for signal, gain in gains.items()})


class Integrate(Kind):
    """Integral of the sum of inputs, with an optional leak."""

    key, symbol = "integrate", "integrator"
    doc = "time integral of the sum of inputs"
    main = Key("integrate", Holds.TERMS, "signal: coefficient", required=True)
    keys = (
        Key(
            "initial",
            Holds.EITHER,
            "initial value, or the signal that the integrator follows in IC",
            Unit.OWN,
            required=True,
        ),
        Key("reset_when", Holds.SIGNAL, "a comparator or a DAC: it is in IC while this is high"),
        Key("hold_when", Holds.SIGNAL, "a comparator or a DAC: it is in HOLD while this is high"),
        LEAK,
        LEAK_LIMIT,
        Key("low", Holds.QUANTITY, "the integrator stops here, below", Unit.OWN),
        Key("high", Holds.QUANTITY, "the integrator stops here, above", Unit.OWN),
    )
    per_second = True
    piecewise_keys = frozenset({"low", "high"})

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w' = sum(coefficient * input) - leak * w, w(0) = initial (0 where a signal gives it)."""
        leak = values.get("leak", 0.0)
        return Core(gains, dynamic=True, feedback=-leak, initial=values.get("initial", 0.0))

    def limits(self, values: Mapping[str, float]) -> tuple[float, float] | None:
        """Where a feedback-limited integrator stops; None where it does not."""
        if not self.piecewise_keys & values.keys():
            return None
        return values.get("low", -math.inf), values.get("high", math.inf)

    def unsuitable(self, given: Given) -> str:
        """The limits must leave something between them, the initial value too."""
        low, high = self.limits(given.values) or (-math.inf, math.inf)
        if not low < high:
            return f"has low {low:g} not below high {high:g}"
        initial = given.values.get("initial")
        if initial is not None and not low <= initial <= high:
            return f"has initial {initial:g} outside its limits {low:g} to {high:g}"
        return ""


class Lag(Kind):
    """A first-order lag that the problem wants (not the component's own)."""

    key, symbol = "lag", "lag"
    doc = "sum of inputs through a first-order lag"
    main = Key("lag", Holds.TERMS, "signal: coefficient", required=True)
    keys = (
        Key(
            "time_constant",
            Holds.QUANTITY,
            "time constant of the lag",
            Unit.TIME,
            Bound.POSITIVE,
            required=True,
        ),
        Key(
            "initial",
            Holds.QUANTITY,
            "initial value",
            Unit.OWN,
            default="settled to the inputs at t = 0",
        ),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w' = (sum(coefficient * input) - w) / time_constant."""
        rate = 1.0 / values["time_constant"]
        scaled = {signal: gain * rate for signal, gain in gains.items()}
        return Core(scaled, dynamic=True, feedback=-rate, initial=values.get("initial"))
