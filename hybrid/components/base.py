"""The contract of a component kind.

1. A kind has a `key` (its first word in a patch), a one-line `doc`, the `main` key that holds its
   inputs or value, further `keys`, and a `symbol` for diagrams.
2. `core(values, gains)` gives the linear core in problem units (SI): static `w = sum(gain * input) +
   constant`, or dynamic `w' = sum(gain * input) + feedback * w + constant`.
3. The compiler adds what every component shares: scaling to machine units, gain tolerance, offset,
   the output lag and noise. A kind never deals with those, nor with time or state storage.
4. `per_second` says that a gain has the extra unit 1/s (an integrator's input).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from hybrid.language import Key


@dataclass(frozen=True, slots=True)
class Oscillation:
    """amplitude * sin(omega t + phase), produced by an exact two-state oscillator."""

    amplitude: float
    omega: float  # rad/s
    phase: float  # rad


@dataclass(frozen=True, slots=True)
class Step:
    """Added to the core from time `at_s` on."""

    height: float
    at_s: float


@dataclass(frozen=True, slots=True)
class Core:
    """What a component does before its output stage, in SI problem units."""

    gains: Mapping[str, float] = field(default_factory=dict)
    constant: float = 0.0
    dynamic: bool = False
    feedback: float = 0.0  # 1/s, dynamic cores only
    initial: float | None = None  # dynamic cores; None: settled before the run
    oscillation: Oscillation | None = None
    step: Step | None = None


class Kind:
    """A kind of component; see the module's contract."""

    key: ClassVar[str]
    doc: ClassVar[str]
    symbol: ClassVar[str]
    main: ClassVar[Key]
    keys: ClassVar[tuple[Key, ...]] = ()
    per_second: ClassVar[bool] = False
    single_input: ClassVar[bool] = False

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """Linear core for the bound quantities `values` (by key) and input `gains` (by signal)."""
        raise NotImplementedError

    def complaint(self, values: Mapping[str, object]) -> str:
        """What is wrong with this combination of keys, or ''."""
        return ""
