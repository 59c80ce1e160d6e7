"""What a key of the patch language is: what it holds, in which unit, within which bounds.

Stage 0. `language` and `digital_keys` have the keys themselves, components those of their kinds.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Holds(Enum):
    """What the value of a key may be."""

    QUANTITY = "quantity"  # number, "1 ms" or arithmetic over parameters
    EITHER = "quantity or signal"
    INTEGER = "integer"
    TEXT = "text"
    CHOICE = "word"
    SIGNAL = "signal"  # the name of one signal
    TERMS = "terms"  # {signal: coefficient, ...}
    SIGNALS = "signals"  # [name, ...]
    POINTS = "points"  # {input: output, ...}
    GRID = "grid"  # {input: output, ...} or {input: {input: output, ...}, ...} and so on


class Unit(Enum):
    """Which physical dimension a quantity must have."""

    OWN = "that of full_scale"
    OWN_RATE = "that of full_scale, per time"
    PURE = "none"
    TIME = "time, such as 1 ms"
    RATE = "1/time, such as 3 1/s or 10 rad/s"
    ANY = "any"


class Bound(Enum):
    """Which values a quantity may take."""

    ANY = "any finite value"
    POSITIVE = "greater than zero"
    NOT_NEGATIVE = "zero or greater"


@dataclass(frozen=True, slots=True)
class Key:
    """One word of the language."""

    name: str
    holds: Holds
    doc: str
    unit: Unit = Unit.PURE
    bound: Bound = Bound.ANY
    required: bool = False
    default: str = ""  # in words, for the reference; '' = none
    choices: tuple[str, ...] = ()  # of a CHOICE
