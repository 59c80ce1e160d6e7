"""How much of an analog machine a patch takes, as an operator counts it.

Stage 6, for `checks`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from hybrid.components import CATALOG
from hybrid.machine import Machine

# Parts that take an amplifier of the machine's pool; multipliers and the like have their own.
AMPLIFIERS = ("integrator", "summer", "inverter", "lag", "open amplifier")


class Setting(Protocol):
    """One coefficient: whose, its potentiometer setting (0 to 1) and the gain of the input."""

    @property
    def component(self) -> str: ...  # noqa: D102

    @property
    def setting(self) -> float: ...  # noqa: D102

    @property
    def gain(self) -> int: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Part:
    """How many of one kind of part a patch takes."""

    part: str
    count: int


def count_parts(machine: Machine, settings: Sequence[Setting]) -> tuple[Part, ...]:
    """The parts that the patch takes, with its `settings`.

    Components are counted by what they are drawn as. A setting of exactly 1 is a plain cord. A signal
    that anything takes with a negative coefficient needs one inverter (real summers and integrators
    invert besides; this machine's do not), and a `coefficient` above 1 an amplifier besides its
    potentiometer. What is above 1 of a multiplier's factor is the gain of an input that reads it.
    """
    patch = machine.patch
    found = Counter(CATALOG[c.kind].symbol for c in patch.components)
    coefficients = {c.name for c in patch.components if c.kind == "coefficient"}
    del found["potentiometer"]
    found["summer"] += len(
        {s.component for s in settings if s.component in coefficients and s.gain > 1}
    )
    found["inverter"] += len(_inverted(machine))
    found["potentiometer"] = sum(not is_cord(s.setting) for s in settings)
    found["ADC"], found["DAC"] = len(patch.adcs), len(patch.dacs)
    found["amplifier"] = sum(found[part] for part in AMPLIFIERS)
    first, last = ("amplifier", *AMPLIFIERS), ("ADC", "DAC")
    order = [*first, *sorted(set(found) - {*first, *last}), *last]
    return tuple(Part(part, found[part]) for part in order if found[part])


def is_cord(setting: float) -> bool:
    """Whether a setting takes no potentiometer: 1 is a plain cord, 0 none."""
    return setting in (0.0, 1.0)


def _inverted(machine: Machine) -> set[str]:
    """Signals that some component, other than an inverter, takes with a negative coefficient."""
    return {
        signal
        for component in machine.patch.components
        if component.kind != "invert"
        for signal, gain in component.terms
        if gain.number(machine.parameters) < 0.0
    }
