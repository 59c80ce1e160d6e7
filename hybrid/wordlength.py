"""Word lengths of the digital machine: how it rounds what it computes.

Stage 0. Floating point of n significant bits, rounded to nearest (ties to even) or cut (towards zero),
with the exponents of a double; `float32` with its own. Fixed point of n bits, sign included: codes
-2^(n-1) to 2^(n-1) - 1 of full_scale/2^(n-1) each, rounded to nearest (ties to even) or cut (towards
minus infinity, as bits dropped in two's complement do).

A constant of a fixed-point program has a scale of its own, as its programmer gives it: n - 1 significant
bits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum


class Kind(IntEnum):
    """How words are stored."""

    DOUBLE = 0
    BITS = 1
    SINGLE = 2
    FIXED = 3


class Overflow(IntEnum):
    """What a fixed-point word does beyond its range."""

    SATURATE = 0
    WRAP = 1
    STOP = 2


# Significant bits: a double has 53, and three more are needed to round what it computes only once.
FEWEST_BITS, MOST_BITS = 2, 50
# Codes are computed in doubles, exactly up to this many bits.
MOST_FIXED_BITS = 40
SINGLE_BITS = 24
LARGEST_SINGLE = (2.0 - 2.0**-23) * 2.0**127


@dataclass(frozen=True, slots=True)
class WordLength:
    """One word length, in numbers."""

    kind: Kind = Kind.DOUBLE
    bits: int = 53
    cuts: bool = False  # rather than rounding to nearest
    full_scale: float = 1.0  # SI, of fixed point
    overflow: Overflow = Overflow.STOP

    @property
    def row(self) -> tuple[float, ...]:
        """The figures for the kernel, see `Figures`."""
        step = self.full_scale / 2.0 ** (self.bits - 1) if self.kind is Kind.FIXED else 0.0
        return (float(self.kind), float(self.bits), float(self.cuts), step, float(self.overflow))

    @property
    def text(self) -> str:
        """In words, for people: 'float32'."""
        if self.kind is Kind.BITS:
            return f"{self.bits} bit mantissa"
        return {Kind.DOUBLE: "float64", Kind.SINGLE: "float32"}.get(
            self.kind, f"{self.bits} bit fixed"
        )

    def constant(self, value: float) -> float:
        """A constant as the program holds it."""
        if self.kind is Kind.DOUBLE:
            return value
        return self._significant(value, self.bits - (self.kind is Kind.FIXED))

    def stored(self, value: float) -> float:
        """A word's value as the program holds it; raises OverflowError beyond the range."""
        if self.kind is not Kind.FIXED:
            return self.constant(value)
        step = self.full_scale / 2.0 ** (self.bits - 1)
        code = math.floor(value / step) if self.cuts else round(value / step)
        if not -(2 ** (self.bits - 1)) <= code < 2 ** (self.bits - 1):
            raise OverflowError(f"beyond {self.full_scale:g}")
        return code * step

    def _significant(self, value: float, bits: int) -> float:
        if value == 0.0:
            return value
        mantissa, exponent = math.frexp(value)
        if self.kind is Kind.SINGLE:
            bits -= max(0, -125 - exponent)  # below 2^-126 a float32 has fewer
        scaled = math.ldexp(mantissa, bits)
        rounded = math.ldexp(
            float(math.trunc(scaled) if self.cuts else round(scaled)), exponent - bits
        )
        beyond = self.kind is Kind.SINGLE and abs(rounded) > LARGEST_SINGLE
        return math.copysign(math.inf, rounded) if beyond else rounded


class Figures(IntEnum):
    """Columns of a table of word lengths."""

    KIND = 0
    BITS = 1
    CUTS = 2
    STEP = 3
    OVERFLOW = 4


FLOAT64 = WordLength()
FLOAT32 = WordLength(Kind.SINGLE, SINGLE_BITS)
