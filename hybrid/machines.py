"""Whole machines by name: what every component has unless the patch says otherwise.

Stage 0. Source of the nominal figures: R. M. Howe, "Computers for Simulation of Space Vehicle
Systems": lags "the order of magnitude of 1 microsecond", precision "of the order of 0.01 percent of
full scale". The precision sets the gain tolerance and the noise; offset is zero because a
chopper-stabilised amplifier's was far below it (the paper's 200 ft orbits need 2e-6 or better).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Preset:
    """Figures of one make of machine; fractions are of full scale."""

    name: str
    doc: str
    tau: float  # s, lag of every component
    tolerance: float  # limit of the gain error
    offset: float
    noise: float  # rms
    converters_exact: bool  # no quantisation and no clipping in ADC and DAC
    saturation: float = math.inf  # full scales

    def figure(self, key: str) -> float:
        """One of tau, tolerance, offset, noise, saturation by name."""
        return {
            "tau": self.tau,
            "tolerance": self.tolerance,
            "offset": self.offset,
            "noise": self.noise,
            "saturation": self.saturation,
        }[key]


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        preset.name: preset
        for preset in (
            Preset("ideal", "no lag, no errors, no quantisation", 0.0, 0.0, 0.0, 0.0, True),
            Preset(
                "lags", "1 us lags alone: no errors, no quantisation", 1e-6, 0.0, 0.0, 0.0, True
            ),
            Preset(
                "nominal", "the paper's machine: 1 us lags, 0.01 %", 1e-6, 1e-4, 0.0, 1e-4, False
            ),
        )
    }
)
