"""The modes of an analog machine and of a single integrator: names and numbers.

Stage 0. In IC an integrator stands at its initial value, or follows the signal that gives it; in OP it
integrates; in HOLD its inputs are disconnected. Its output lag stays in all three.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

IC, OP, HOLD = 0, 1, 2
MODE_NAMES = ("IC", "OP", "HOLD")

# The record's variable that holds the machine's mode, and the logic signals that tell it to a patch.
MODE_VARIABLE = "mode"
LOGIC: Mapping[str, int] = MappingProxyType({"resetting": IC, "operating": OP, "holding": HOLD})
RESERVED_SIGNALS = frozenset({MODE_VARIABLE, *LOGIC})

# Hidden parts of a circuit: the machine's mode, and the held input by which time sets it.
MODE_ELEMENT, TIMED_MODE = ":mode", ":timed"

# What a run does where a signal first goes beyond full scale.
CONTINUE, STOP_RUN, HOLD_MACHINE = 0, 1, 2
ON_OVERLOAD: Mapping[str, int] = MappingProxyType(
    {"continue": CONTINUE, "hold": HOLD_MACHINE, "stop": STOP_RUN}
)
