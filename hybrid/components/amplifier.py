"""The open amplifier, for equations that say what must be zero instead of what a signal is.

    x' = w (sum of inputs) - (w / A) x

with w the product of its gain A and bandwidth. Patched so that the sum contains x with a negative sign,
it drives the sum to x / A, so nearly to zero, as exp(-w g t), g the gain of the loop but for itself.
"""

from __future__ import annotations

from collections.abc import Mapping

from hybrid.components.base import Core, Kind
from hybrid.keys import Bound, Holds, Key, Unit


class Amplify(Kind):
    """A high-gain amplifier with nothing in its feedback but what is patched there."""

    key, symbol = "amplify", "open amplifier"
    doc = "open amplifier: drives the sum of its inputs to zero through what is patched around it"
    main = Key("amplify", Holds.TERMS, "signal: coefficient", required=True)
    keys = (
        Key(
            "open_gain",
            Holds.QUANTITY,
            "its gain at rest, in machine units",
            Unit.PURE,
            Bound.POSITIVE,
            default="1e5",
        ),
        Key(
            "bandwidth",
            Holds.QUANTITY,
            "where its gain has fallen to 1, in rad/s; low, so that a loop of several lagged parts "
            "is stable",
            Unit.RATE,
            Bound.POSITIVE,
            default="1e5 rad/s",
        ),
        Key("initial", Holds.QUANTITY, "output at t = 0", Unit.OWN, default="0"),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w' = bandwidth * sum(coefficient * input) - bandwidth / open_gain * w, w(0) = initial."""
        rate = values.get("bandwidth", 1e5)
        return Core(
            {signal: gain * rate for signal, gain in gains.items()},
            dynamic=True,
            feedback=-rate / values.get("open_gain", 1e5),
            initial=values.get("initial", 0.0),
            loop_rate=rate,
        )
