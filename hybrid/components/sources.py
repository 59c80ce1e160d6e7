"""Sources: constant, step, ramp, pulse, square wave, sine, noise.

What jumps does so at instants of exact integer time, like the events of the digital machine: a sample
taken at that instant still sees the value before, and edge k of a wave is at k periods, never at a sum.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from hybrid.components.base import Core, Given, Kind, Oscillation, Step
from hybrid.keys import Bound, Holds, Key, Unit
from hybrid.scale import to_ticks


class Constant(Kind):
    """A reference voltage through a potentiometer."""

    key, symbol = "constant", "source"
    jumps = True
    doc = "a constant"
    main = Key("constant", Holds.QUANTITY, "its value", Unit.OWN, required=True)

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = value."""
        return Core(constant=values["constant"])


class StepSource(Kind):
    """Changes value once; a sample taken at that instant still sees the value before."""

    key, symbol = "step", "source"
    jumps = True
    doc = "changes once from one value to another"
    main = Key("step", Holds.QUANTITY, "value after the step", Unit.OWN, required=True)
    keys = (
        Key("at", Holds.QUANTITY, "time of the step", Unit.TIME, Bound.NOT_NEGATIVE, required=True),
        Key("before", Holds.QUANTITY, "value before the step", Unit.OWN, default="0"),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = before, then `step` from time `at` on."""
        before = values.get("before", 0.0)
        return Core(constant=before, steps=(Step(values["step"] - before, values["at"]),))


class Ramp(Kind):
    """Rises evenly from one time to another: an integrator at a reference voltage that is switched."""

    key, symbol = "ramp", "source"
    doc = "changes at a constant rate from one time on, until another where that is given"
    main = Key("ramp", Holds.QUANTITY, "its rate", Unit.OWN_RATE, required=True)
    keys = (
        Key("at", Holds.QUANTITY, "when it begins", Unit.TIME, Bound.NOT_NEGATIVE, default="0 s"),
        Key("until", Holds.QUANTITY, "when it ends", Unit.TIME, Bound.POSITIVE, default="never"),
        Key("before", Holds.QUANTITY, "value before it begins", Unit.OWN, default="0"),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = before + ramp (t - at), from `at` to `until`."""
        begins = Step(values["ramp"], values.get("at", 0.0))
        ends = (Step(0.0, values["until"]),) if "until" in values else ()
        before = values.get("before", 0.0)
        return Core(constant=before, steps=(begins, *ends), integrated=True)

    def unsuitable(self, given: Given) -> str:
        """It must begin before it ends."""
        at, until = given.values.get("at", 0.0), given.values.get("until", math.inf)
        return "" if at < until else f"has at {at:g} s not before until {until:g} s"


PERIOD = Key("period", Holds.QUANTITY, "its period", Unit.TIME, Bound.POSITIVE, required=True)
PHASE = Key("phase", Holds.QUANTITY, "phase at t = 0", Unit.PURE, default="0 rad")
BIAS = Key("bias", Holds.QUANTITY, "mean value", Unit.OWN, default="0")


class Pulse(Kind):
    """Takes another value for some time, once or once in every period."""

    key, symbol = "pulse", "source"
    jumps = True
    doc = "takes a value for some time, once or in every period"
    main = Key("pulse", Holds.QUANTITY, "value during the pulse", Unit.OWN, required=True)
    keys = (
        Key("at", Holds.QUANTITY, "when it begins", Unit.TIME, Bound.NOT_NEGATIVE, required=True),
        Key("width", Holds.QUANTITY, "how long it lasts", Unit.TIME, Bound.POSITIVE),
        Key(
            "duty",
            Holds.QUANTITY,
            "share of its period for which it lasts, instead of width",
            Unit.PURE,
            Bound.POSITIVE,
        ),
        Key(
            "period",
            Holds.QUANTITY,
            "from the beginning of one pulse to that of the next",
            Unit.TIME,
            Bound.POSITIVE,
            default="one pulse only",
        ),
        Key("before", Holds.QUANTITY, "value before, between and after", Unit.OWN, default="0"),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = pulse for at + k period <= t < at + k period + width, else before."""
        before, at, period = values.get("before", 0.0), values["at"], values.get("period", 0.0)
        up = Step(values["pulse"] - before, at, period)
        return Core(constant=before, steps=(up, Step(0.0, at + self._width(values), period)))

    def complaint(self, values: Mapping[str, object]) -> str:
        """Exactly one of width and duty, and duty only of what comes again."""
        if ("width" in values) == ("duty" in values):
            return "give either width, such as 10 ms, or duty, such as 0.3 of its period"
        if "duty" in values and "period" not in values:
            return "duty is a share of its period; give period, or width in place of duty"
        return ""

    @staticmethod
    def _width(values: Mapping[str, float]) -> float:
        """How long it lasts."""
        return values["width"] if "width" in values else values["duty"] * values["period"]

    def unsuitable(self, given: Given) -> str:
        """A pulse must last, and end before the next."""
        width, period = self._width(given.values), given.values.get("period", math.inf)
        if given.values.get("duty", 0.0) >= 1.0:
            return f"has duty {given.values['duty']:g}, which is not below 1"
        if not to_ticks(given.values["at"] + width) > to_ticks(given.values["at"]):
            return f"has width {width:g} s, below the resolution of time"
        return "" if width < period else f"has width {width:g} s, not below its period {period:g} s"


class Square(Kind):
    """A square wave; the sine of the same phase has the same sign."""

    key, symbol = "square", "source"
    jumps = True
    doc = "a square wave between plus and minus its amplitude, plus first"
    main = Key("square", Holds.QUANTITY, "amplitude", Unit.OWN, required=True)
    keys = (
        PERIOD,
        PHASE,
        Key(
            "duty",
            Holds.QUANTITY,
            "share of the period for which it is plus",
            Unit.PURE,
            Bound.POSITIVE,
            default="0.5",
        ),
        Key("bias", Holds.QUANTITY, "what is midway between its two values", Unit.OWN, default="0"),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = bias + amplitude where (t / period + phase / 2 pi) mod 1 < duty, else bias - amplitude;
        the limit from above at t = 0."""
        height, period, duty = values["square"], values["period"], values.get("duty", 0.5)
        place = place_at_start(values)
        high = place < duty
        falls = duty + (0.0 if high else 1.0) - place
        steps = Step(-height, falls * period, period), Step(height, (1.0 - place) * period, period)
        return Core(constant=values.get("bias", 0.0), steps=steps, held=height if high else -height)

    def unsuitable(self, given: Given) -> str:
        """Half a period must be some time, and so must both of its parts."""
        period, duty = given.values["period"], given.values.get("duty", 0.5)
        if not duty < 1.0:
            return f"has duty {duty:g}, which is not below 1"
        return too_short(period) or too_short(2.0 * period * min(duty, 1.0 - duty))


def place_at_start(values: Mapping[str, float]) -> float:
    """Where t = 0 is within a period, from 0 to 1, by the phase of a wave."""
    return values.get("phase", 0.0) / (2 * math.pi) % 1.0


def too_short(period_s: float) -> str:
    """What is wrong with a period that cannot be halved, or ''."""
    if to_ticks(period_s / 2) > 0:
        return ""
    return f"has period {period_s:g} s, below the resolution of time"


class Sine(Kind):
    """bias + amplitude * sin(omega t + phase)."""

    key, symbol = "sine", "source"
    doc = "a sine wave"
    main = Key("sine", Holds.QUANTITY, "amplitude", Unit.OWN, required=True)
    keys = (
        Key(
            "omega",
            Holds.QUANTITY,
            "angular frequency, such as 10 rad/s",
            Unit.RATE,
            Bound.POSITIVE,
        ),
        Key(
            "frequency",
            Holds.QUANTITY,
            "frequency, such as 50 Hz, instead of omega",
            Unit.RATE,
            Bound.POSITIVE,
        ),
        PHASE,
        BIAS,
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = bias + amplitude sin(omega t + phase)."""
        omega = values["omega"] if "omega" in values else 2 * math.pi * values["frequency"]
        wave = Oscillation(values["sine"], omega, values.get("phase", 0.0))
        return Core(constant=values.get("bias", 0.0), oscillation=wave)

    def complaint(self, values: Mapping[str, object]) -> str:
        """Exactly one of omega and frequency."""
        if ("omega" in values) == ("frequency" in values):
            return "give either omega, such as 10 rad/s, or frequency, such as 50 Hz"
        return ""


class NoiseSource(Kind):
    """A noise generator: white noise through a first-order filter."""

    key, symbol = "noise_source", "source"
    doc = "noise of a given rms value, white noise through a first-order filter"
    main = Key(
        "noise_source", Holds.QUANTITY, "its rms value", Unit.OWN, Bound.NOT_NEGATIVE, required=True
    )
    keys = (
        Key(
            "bandwidth",
            Holds.QUANTITY,
            "where the power density has fallen to a half, in rad/s",
            Unit.RATE,
            Bound.POSITIVE,
            required=True,
        ),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w' = -bandwidth w + rms sqrt(2 bandwidth) white noise, from w(0) = 0.

        One-sided power density over f in Hz: 4 rms^2 / bandwidth / (1 + (2 pi f / bandwidth)^2).
        """
        rate = values["bandwidth"]
        return Core(dynamic=True, feedback=-rate, initial=0.0, noise=values["noise_source"])
