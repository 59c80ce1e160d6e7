"""The potentiometer sheet: every coefficient as an operator sets it.

Stage 6, for `checks`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from hybrid.components import CATALOG
from hybrid.components.base import Given
from hybrid.machine import Machine
from hybrid.patch import Component
from hybrid.potentiometers import dialled_core, setting_of


@dataclass(frozen=True, slots=True)
class PotRow:
    """One coefficient in machine units: sign, potentiometer setting (0 to 1) and amplifier gain."""

    component: str
    input: str
    coefficient_mu: float
    setting: float
    gain: int
    inverted: bool


def pot_rows(machine: Machine) -> tuple[PotRow, ...]:
    """Coefficients in machine units: gain times full scale in over full scale out."""
    scale = dict(zip(machine.analog.signals, machine.analog.full_scale.tolist(), strict=True))
    rows = []
    for component in sorted(machine.patch.components, key=lambda c: c.name):
        entries = _entries(machine, component, scale)
        # What is zero has no cord.
        rows += [_row(component.name, name, value) for name, value in entries.items() if value]
    return tuple(rows)


def _entries(
    machine: Machine, component: Component, scale: Mapping[str, float]
) -> Mapping[str, float]:
    """Coefficients of a component by input, in machine units."""
    values = {k: v.number(machine.parameters) for k, v in component.values.items()}
    gains = {s: v.number(machine.parameters) for s, v in component.terms}
    kind, own = CATALOG[component.kind], scale[component.name]
    if not kind.is_linear:
        return kind.settings(Given(values, gains, component.signals, full_scale=own, scales=scale))
    resolution = machine.stages[component.name].pot_resolution
    core = dialled_core(kind.core(values, gains), component.name, scale, resolution)
    entries = {s: g * scale[s] / own / (core.loop_rate or 1.0) for s, g in core.gains.items()}
    if core.feedback and not core.loop_rate:
        entries["(itself)"] = core.feedback
    if core.initial is not None and "initial" in values:
        entries["(initial)"] = core.initial / own
    if component.kind == "noise_source":
        entries = {"(reference)": core.noise / own}
    if component.kind == "constant" or core.steps:
        stepped = core.steps[0].value if core.steps else 0.0
        if component.kind == "square":  # its first edge may fall
            stepped = math.copysign(stepped, values["square"])
        entries["(reference)"] = (stepped if core.integrated else core.constant + stepped) / own
    return entries


def _row(component: str, name: str, value: float) -> PotRow:
    """A potentiometer goes from 0 to 1; an amplifier input with a gain of 10, 100 ... does the rest."""
    setting, gain = setting_of(value)
    return PotRow(component, name, value, setting, gain, value < 0)
