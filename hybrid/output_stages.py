"""The errors of every component of one machine: those of its make, and what its serial number draws.

Stage 3, for `compiler`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from hybrid.errors import PatchError
from hybrid.machine import OutputStage
from hybrid.machines import PRESETS, Preset
from hybrid.memo import KeptByUse
from hybrid.patch import Component, Dac, Patch, Value
from hybrid.scale import TICKS_PER_SECOND
from hybrid.streams import unit_errors

# Saturation levels that make sense, in full scales, or the inverse of them.
LEAST_SATURATION = 1e-3
# Kinds whose capacitor may leak.
KEEPS_A_CHARGE = frozenset({"integrate", "track"})


@dataclass(frozen=True, eq=False)
class Make:
    """The machines of a make: what serial numbers have in common."""

    stages: dict[str, OutputStage]  # with nothing drawn
    saturates: bool
    drawn: dict[str, tuple[str, ...]]  # components by what is drawn of them


# Most parameters of a sweep change no error.
@KeptByUse
def make_of(
    scope: Mapping[str, float],
    patch: Patch,
    preset_name: str,
    given: bool,
    time_scale: float,
    resolution: float,
) -> Make:
    """The errors of every component; given: the preset replaces the patch's whole machine line."""
    common = {} if given else patch.machine.errors
    preset = PRESETS[preset_name]
    stages = {
        part.name: _output_stage(part, preset, common, scope, time_scale, resolution)
        for part in patch.analog_parts
    }
    drawn = {
        "gain": tuple(name for name, stage in stages.items() if stage.tolerance),
        "offset": tuple(name for name, stage in stages.items() if stage.offset_limit),
        "leak": tuple(name for name, stage in stages.items() if stage.leak_limit),
    }
    return Make(stages, any(stage.saturation < math.inf for stage in stages.values()), drawn)


@functools.lru_cache(maxsize=64)
def stages_of(make: Make, serial: int) -> dict[str, OutputStage]:
    """The errors of every component of one machine of the make."""
    gain, offset, leak = (
        dict(zip(names, unit_errors(serial, names, quantity), strict=True)) if names else {}
        for quantity, names in make.drawn.items()
    )
    return {
        name: replace(
            stage,
            gain=1.0 + stage.tolerance * gain.get(name, 0.0),
            offset=stage.offset + stage.offset_limit * offset.get(name, 0.0),
            leak=stage.leak_limit * abs(leak.get(name, 0.0)),
        )
        if name in gain or name in offset or name in leak
        else stage
        for name, stage in make.stages.items()
    }


def _output_stage(
    part: Component | Dac,
    preset: Preset,
    common: Mapping[str, Value],
    scope: Mapping[str, float],
    time_scale: float,
    resolution: float,
) -> OutputStage:
    """With nothing drawn: the offset is the one given."""
    kind = part.kind if isinstance(part, Component) else "dac"

    def figure(key: str) -> float:
        value = part.errors.get(key) or common.get(key)
        return _error_figure(key, value, scope) if value else preset.figure(key, kind)

    tau, noise = figure("tau") * time_scale, figure("noise")
    if 0.0 < tau < 1.0 / TICKS_PER_SECOND:
        raise PatchError(
            f"{part.name!r} has a lag of {tau:g} s in problem time, below a femtosecond, the resolution "
            "of time; raise time_scale or give its tau as 0",
            part.place,
        )
    if noise > 0 and tau == 0:
        raise PatchError(
            f"{part.name!r} has noise {noise:g} but no lag, and noise without a lag has no "
            "bandwidth; set its noise to 0 or its tau above 0",
            part.place,
        )
    tolerance, offset_limit = figure("tolerance"), figure("offset_limit")
    offset = figure("offset") + 0.0  # 0 without a sign, as after a draw
    if noise == 0 and isinstance(part, Component) and part.kind == "constant":
        tau = 0.0  # settled before the run and never moves again: its lag would cost and do nothing
    step = step_mu(part.bits, 1.0, preset) if isinstance(part, Dac) else 0.0
    leak_limit = 0.0
    if isinstance(part, Component) and kind in KEEPS_A_CHARGE:
        limit = part.values.get("leak_limit") or common.get("leak_limit")
        leak_limit = limit.number(scope) if limit else preset.leak_limit
    return OutputStage(
        tau,
        1.0,
        offset,
        noise,
        figure("saturation"),
        step,
        resolution,
        tolerance,
        offset_limit,
        0.0,
        leak_limit,
    )


def _error_figure(key: str, value: Value, scope: Mapping[str, float]) -> float:
    """An error of a component as given, within what makes sense."""
    found = value.number(scope)
    if key == "tau" and 0.0 < found < 1.0 / TICKS_PER_SECOND:
        raise PatchError(
            f"{value.what} is {found:g} s, below a femtosecond, the resolution of time; "
            "give 0 for no lag",
            value.place,
        )
    if key == "saturation":
        if not LEAST_SATURATION <= found <= 1.0 / LEAST_SATURATION:
            raise PatchError(
                f"{value.what} is {found:g} full scales; it must be from {LEAST_SATURATION:g} to "
                f"{1.0 / LEAST_SATURATION:g}",
                value.place,
            )
        return found
    if key != "tau" and abs(found) > 1.0:
        raise PatchError(
            f"{value.what} is {found:g}; it is a fraction of full scale, so at most 1 (0.01 % is 1e-4)",
            value.place,
        )
    return found


def step_mu(bits: int | None, range_mu: float, preset: Preset) -> float:
    """One code of a symmetric converter, codes -(2^(b-1) - 1) to 2^(b-1) - 1, so that zero is a code
    and every value within the range is converted to half a step."""
    if bits is None or preset.converters_exact:
        return 0.0
    return range_mu / ((1 << (bits - 1)) - 1)
