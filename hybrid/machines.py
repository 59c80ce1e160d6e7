"""Whole machines by name: what every component has unless the patch says otherwise.

Stage 0. `nominal` and `howe_1964` are the machine of R. M. Howe, "Computers for Simulation of Space
Vehicle Systems", 1964: lags "the order of magnitude of 1 microsecond", precision "of the order of
0.01 percent of full scale". The precision sets the gain tolerance and the noise. `nominal` stops
there and so leaves linear patches linear. `howe_1964` goes on: multipliers of "approximately 0.05
percent" (the paper, section 3), offsets up to 2e-6 (not stated, but the 200 ft to which its orbits
close allow no more; chopper-stabilised amplifiers), and amplifiers that saturate at 1.1 (our
estimate).

`analog_thing` is THE ANALOG THING of anabrid, from what it is made of: the parts list of
github.com/anabrid/the-analog-thing (ANATHING_OSH, 2021), the questions and answers of
github.com/anabrid/the-analog-thing-docs, and the data sheets AD633 (Analog Devices) and SLOS080T
(Texas Instruments, TL074H).

- Machine unit 10 V, amplifiers on 12 V that overload above about 11.5 V: saturation 1.15
  (documentation).
- Summers and inverters: resistors of 0.1 %, so a ratio within 0.2 %; integrators and lags:
  capacitors of 2 % besides, 2.1 % (parts list). Coefficients are set by hand against its meter, to
  0.1 % (the documentation's "about three positions"; our reading).
- Multipliers AD633J: 2 % in all, 1 MHz, which is 0.16 us, and below 100 uV rms in 10 kHz, which
  over 1 MHz makes 1.25e-4 (data sheet; white noise is our assumption). Divider and square root are
  multipliers in a loop (documentation) and are given the same figures.
- Offset of a TL074H typically 1 mV (data sheet), doubled by an amplifier of gain 1: up to 2e-4.
- Leak of integrators: their capacitors, Panasonic ECHU(X) of PPS film (parts list), have an
  insulation resistance of 3000 Mohm at least (data sheet: 20 C, after 60 s). It stands beside an
  input of 1 Mohm (parts list), so an integrator of 1/s loses up to 1/3000 a second, whatever its
  capacitance. Its integrators serve as track-stores, so these lose as much. The finite gain of the
  amplifiers is left out. For `howe_1964` we found no figure that could be verified.
- Our estimates: a lag of 1 us, 1 Mohm (parts list) times 1 pF of stray capacitance; noise 1e-5, the
  thermal noise of two such resistors over that bandwidth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Preset:
    """Figures of one make of machine; fractions are of full scale."""

    name: str
    doc: str
    tau: float  # s, lag of every component
    tolerance: float  # limit of the gain error
    offset_limit: float
    noise: float  # rms
    converters_exact: bool  # no quantisation and no clipping in ADC and DAC
    saturation: float = math.inf  # full scales
    leak_limit: float = 0.0  # 1/s, of integrators and track-stores
    kinds: Mapping[str, Mapping[str, float]] = field(
        default_factory=dict
    )  # what some kinds differ in

    def figure(self, key: str, kind: str = "") -> float:
        """An error of a component by name, for a kind of component."""
        figures = {
            "tau": self.tau,
            "tolerance": self.tolerance,
            "offset": 0.0,
            "offset_limit": self.offset_limit,
            "noise": self.noise,
            "saturation": self.saturation,
        }
        return self.kinds.get(kind, {}).get(key, figures[key])


def _alike(kinds: tuple[str, ...], **figures: float) -> dict[str, Mapping[str, float]]:
    """The same figures for several kinds of component."""
    return dict.fromkeys(kinds, MappingProxyType(figures))


# Made of multipliers.
_MULTIPLIERS = ("multiply", "divide", "square_root")

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
            Preset(
                "howe_1964",
                "the paper's machine with its multipliers, offsets and overload",
                tau=1e-6,
                tolerance=1e-4,
                offset_limit=2e-6,
                noise=1e-4,
                converters_exact=False,
                saturation=1.1,
                kinds=_alike(_MULTIPLIERS, tolerance=5e-4),
            ),
            Preset(
                "analog_thing",
                "THE ANALOG THING, a table-top machine of today",
                tau=1e-6,
                tolerance=2e-3,
                offset_limit=2e-4,
                noise=1e-5,
                converters_exact=False,
                saturation=1.15,
                leak_limit=3.3e-4,
                kinds={
                    **_alike(("integrate", "lag"), tolerance=2.1e-2),
                    **_alike(("coefficient",), tolerance=1e-3),
                    **_alike(_MULTIPLIERS, tolerance=2e-2, tau=0.16e-6, noise=1.25e-4),
                },
            ),
        )
    }
)
