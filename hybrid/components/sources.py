"""Sources: constant, step, sine."""

from __future__ import annotations

import math
from collections.abc import Mapping

from hybrid.components.base import Core, Kind, Oscillation, Step
from hybrid.language import Bound, Holds, Key, Unit


class Constant(Kind):
    """A reference voltage through a potentiometer."""

    key, symbol = "constant", "source"
    doc = "a constant"
    main = Key("constant", Holds.QUANTITY, "its value", Unit.OWN, required=True)

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = value."""
        return Core(constant=values["constant"])


class StepSource(Kind):
    """Changes value once; a sample taken at that instant still sees the value before."""

    key, symbol = "step", "source"
    doc = "changes once from one value to another"
    main = Key("step", Holds.QUANTITY, "value after the step", Unit.OWN, required=True)
    keys = (
        Key("at", Holds.QUANTITY, "time of the step", Unit.TIME, Bound.NOT_NEGATIVE, required=True),
        Key("before", Holds.QUANTITY, "value before the step", Unit.OWN, default="0"),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = before, then `step` from time `at` on."""
        before = values.get("before", 0.0)
        return Core(constant=before, step=Step(values["step"] - before, values["at"]))


class Sine(Kind):
    """bias + amplitude * sin(omega t + phase)."""

    key, symbol = "sine", "source"
    doc = "a sine wave"
    main = Key("sine", Holds.QUANTITY, "amplitude", Unit.OWN, required=True)
    keys = (
        Key("omega", Holds.QUANTITY, "angular frequency in rad/s", Unit.RATE, Bound.POSITIVE),
        Key(
            "frequency",
            Holds.QUANTITY,
            "frequency in Hz, instead of omega",
            Unit.RATE,
            Bound.POSITIVE,
        ),
        Key("phase", Holds.QUANTITY, "phase at t = 0", Unit.PURE, default="0 rad"),
        Key("bias", Holds.QUANTITY, "mean value", Unit.OWN, default="0"),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w = bias + amplitude sin(omega t + phase)."""
        omega = values["omega"] if "omega" in values else 2 * math.pi * values["frequency"]
        wave = Oscillation(values["sine"], omega, values.get("phase", 0.0))
        return Core(constant=values.get("bias", 0.0), oscillation=wave)

    def complaint(self, values: Mapping[str, object]) -> str:
        """Exactly one of omega and frequency."""
        if ("omega" in values) == ("frequency" in values):
            return "give either omega (rad/s) or frequency (Hz)"
        return ""
