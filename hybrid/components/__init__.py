"""The catalogue of component kinds: one explicit table, by the key that patches use."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from hybrid.components.amplifier import Amplify
from hybrid.components.backlash import Backlash
from hybrid.components.base import Block, Core, Given, Kind, Oscillation, Step
from hybrid.components.delay import Delay
from hybrid.components.linear import Coefficient, Integrate, Invert, Lag, Sum
from hybrid.components.multipliers import Divide, Multiply, SquareRoot
from hybrid.components.nonlinear import (
    Absolute,
    AngleOf,
    Compare,
    CosOf,
    DeadZone,
    FunctionGenerator,
    Limit,
    Sawtooth,
    SinOf,
    Switch,
    Track,
)
from hybrid.components.sources import Constant, NoiseSource, Pulse, Ramp, Sine, Square, StepSource

CATALOG: Mapping[str, Kind] = MappingProxyType(
    {
        kind.key: kind
        for kind in (
            Constant(),
            StepSource(),
            Ramp(),
            Pulse(),
            Sine(),
            Square(),
            Sawtooth(),
            NoiseSource(),
            Sum(),
            Coefficient(),
            Invert(),
            Integrate(),
            Lag(),
            Delay(),
            Amplify(),
            Multiply(),
            Divide(),
            SquareRoot(),
            SinOf(),
            CosOf(),
            AngleOf(),
            FunctionGenerator(),
            Absolute(),
            Limit(),
            DeadZone(),
            Backlash(),
            Compare(),
            Switch(),
            Track(),
        )
    }
)

__all__ = ["CATALOG", "Block", "Core", "Given", "Kind", "Oscillation", "Step"]
