"""The contract of a component kind.

1. A kind has a `key` (its first word in a patch), a one-line `doc`, the `main` key that holds its
   inputs or value, further `keys`, and a `symbol` for diagrams.
2. `core(values, gains)` gives the linear core in problem units (SI): static `w = sum(gain * input) +
   constant`, or dynamic `w' = sum(gain * input) + feedback * w + constant`. A core may also hold what a
   source steps through, a sine, noise of its own bandwidth, or a block of linear states (`Core`).
3. The compiler adds what every component shares: scaling to machine units, gain tolerance, offset,
   the output lag and noise. A kind never deals with those, nor with time or state storage.
4. `per_second` says that a gain has the extra unit 1/s (an integrator's input).
5. A kind that is not linear gives `element(given)` instead, in SI units too; so may one that is linear
   only as long as some of its keys are not used. Its hidden elements are in `inner(given)`, by names
   that begin with a colon; they read signals in SI and each other as they are, and are best within +-1.
   `:source` is what the steps of its core make, as they are.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from hybrid.elements import Element
from hybrid.keys import Key
from hybrid.units import Dimension


@dataclass(frozen=True, slots=True)
class Oscillation:
    """amplitude * sin(omega t + phase), produced by an exact two-state oscillator."""

    amplitude: float
    omega: float  # rad/s
    phase: float  # rad


@dataclass(frozen=True, slots=True)
class Step:
    """The stepped part of a core takes `value` at `at_s`, and again every `every_s` (0: once)."""

    value: float
    at_s: float
    every_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Block:
    """What the sum u of the inputs goes through: x' = a x + b u, w = c x + d u, with gain 1 at rest.

    At rest x is `rest` times u; a state that is not 0 then has a negative rate of its own.
    """

    a: tuple[tuple[float, ...], ...]  # 1/s
    b: tuple[float, ...]  # 1/s
    c: tuple[float, ...]
    d: float
    rest: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Core:
    """What a component does before its output stage, in SI problem units."""

    gains: Mapping[str, float] = field(default_factory=dict)
    constant: float = 0.0
    dynamic: bool = False
    feedback: float = 0.0  # 1/s, dynamic cores only
    initial: float | None = None  # dynamic cores; None: settled before the run
    noise: float = 0.0  # rms of the output, of a core that is white noise through its own feedback
    loop_rate: float = 0.0  # 1/s, rate of a loop around an open amplifier of gain 1 elsewhere
    block: Block | None = None
    oscillation: Oscillation | None = None
    steps: tuple[Step, ...] = ()
    held: float = 0.0  # the stepped part before its first step
    integrated: bool = False  # the stepped part is a rate: its integral from 0 is added


@dataclass(frozen=True, slots=True)
class Given:
    """What a patch gives a component, as numbers in SI units."""

    values: Mapping[str, float]  # by key
    gains: Mapping[str, float]  # by signal
    signals: tuple[str, ...] = ()  # in the order written
    control: str | None = None
    points: tuple[tuple[float, float], ...] = ()  # ascending
    full_scale: float = 1.0
    scales: Mapping[str, float] = field(default_factory=dict)  # full scales of the signals read
    saturation: float = math.inf  # of the output, in full scales


class Kind:
    """A kind of component; see the module's contract."""

    key: ClassVar[str]
    doc: ClassVar[str]
    symbol: ClassVar[str]
    main: ClassVar[Key]
    keys: ClassVar[tuple[Key, ...]] = ()
    per_second: ClassVar[bool] = False
    single_input: ClassVar[bool] = False
    is_linear: ClassVar[bool] = True
    jumps: ClassVar[bool] = False  # its output stands still but where it jumps, whatever it reads
    passes_jumps: ClassVar[bool] = False  # so does its output where that is true of all it reads
    inputs: ClassVar[int] = 0  # signals that the main key names, where it gives no coefficients
    piecewise_keys: ClassVar[frozenset[str]] = frozenset()  # with one of these it is not linear
    factor: ClassVar[str] = ""  # the key of what its result is multiplied by
    takes_angle: ClassVar[bool] = False  # what it reads is a pure number
    takes_alike: ClassVar[bool] = False  # the signals of its main key have one unit

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """Linear core for the bound quantities `values` (by key) and input `gains` (by signal)."""
        raise NotImplementedError

    def linear_with(self, keys: Collection[str]) -> bool:
        """Whether a component of this kind is linear where these keys are given."""
        return self.is_linear and not self.piecewise_keys & set(keys)

    def element(self, given: Given) -> Element:
        """The element of a kind that is not linear."""
        raise NotImplementedError

    def inner(self, given: Given) -> Mapping[str, Element]:
        """Hidden elements by name, which begins with a colon."""
        return {}

    def settings(self, given: Given) -> Mapping[str, float]:
        """What an operator sets on a part that is not linear, in machine units: by signal or (level)."""
        return {}

    def result(self, inputs: tuple[Dimension, ...]) -> Dimension | None:
        """Dimension of the output without its factor, or None where it may be any."""
        return None

    def unsuitable(self, given: Given) -> str:
        """What is wrong with these numbers, or ''."""
        return ""

    def complaint(self, values: Mapping[str, object]) -> str:
        """What is wrong with this combination of keys, or ''."""
        return ""
