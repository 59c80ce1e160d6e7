"""Coefficients as they are set: a potentiometer from 0 to 1 and an amplifier input with a gain.

Stage 2. The gains are 1, 10, 100 ...; a dial shows so many digits and no more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from hybrid.components import Core

# A setting this near to a step of the dial is on it; the difference is rounding.
ON_THE_DIAL = 1e-12


def setting_of(coefficient: float) -> tuple[float, int]:
    """Setting (0 to 1) and amplifier gain of a coefficient in machine units, its sign left out."""
    size = abs(coefficient)
    power = max(0, math.ceil(math.log10(size) - 1e-12)) if size > 0 else 0
    gain: int = 10**power
    return size / gain, gain


def dialled(coefficient: float, resolution: float) -> float:
    """The coefficient (machine units) with its setting at the nearest step of the dial; 0: as it is."""
    if not resolution:
        return coefficient
    setting, gain = setting_of(coefficient)
    steps = round(setting / resolution)
    if abs(steps * resolution - setting) <= ON_THE_DIAL:
        return coefficient
    return math.copysign(steps * resolution * gain, coefficient)


def dialled_core(core: Core, name: str, full_scale: Mapping[str, float], resolution: float) -> Core:
    """The core of component `name` with every coefficient as its potentiometer is set.

    full_scale: by signal, SI. Coefficients of inputs, the feedback, the initial value and the
    references of constants and of sources that step have potentiometers.
    """
    if not resolution:
        return core
    own = full_scale[name]

    def dial(figure: float, unit: float) -> float:
        set_to = dialled(figure / unit, resolution)
        return figure if set_to == figure / unit else set_to * unit

    gains = {s: dial(gain, own / full_scale[s]) for s, gain in core.gains.items()}
    constant = core.constant if core.oscillation else dial(core.constant, own)

    def level(value: float) -> float:
        """The stepped part such that all of the source, or its rate, is what a dial shows."""
        if core.integrated:
            return dial(value, own)
        return dial(core.constant + value, own) - constant

    steps = tuple(replace(step, value=level(step.value)) for step in core.steps)
    initial = None if core.initial is None else dial(core.initial, own)
    feedback = dial(core.feedback, 1.0)
    return replace(
        core,
        gains=gains,
        constant=constant,
        feedback=feedback,
        initial=initial,
        steps=steps,
        held=level(core.held) if core.steps else core.held,
    )
