"""Time as an exact integer, at one place.

Stage 0. One tick is a femtosecond; event k of a periodic task is at k times its period in ticks, so
no instant is ever an accumulated float. A duration is rounded to 15 significant digits first: that
removes the last-digit noise of arithmetic such as 3 * (T / 3), which must equal T.
"""

from __future__ import annotations

import functools
import math
from decimal import ROUND_HALF_EVEN, Decimal

import numpy as np
import numpy.typing as npt

TICKS_PER_SECOND = 10**15


# The runs of a batch ask for the same few again and again.
@functools.lru_cache(maxsize=1024)
def to_ticks(duration_s: float) -> int:
    """Duration in s -> whole ticks (Python int, unbounded)."""
    exact = Decimal(f"{duration_s:.15g}") * TICKS_PER_SECOND
    return int(exact.to_integral_value(rounding=ROUND_HALF_EVEN))


def to_seconds(ticks: int) -> float:
    """Ticks -> the float nearest to the exact time in s."""
    return ticks / TICKS_PER_SECOND


def time_scale_text(time_scale: float) -> str:
    """How fast the machine computes, in words; '' where a machine second is a problem second."""
    return "" if time_scale == 1.0 else f"{time_scale:g} times real time"


def row_times_s(rows: int, every_ticks: int) -> npt.NDArray[np.float64]:
    """`to_seconds(k * every_ticks)` for k = 0, 1, ..., (rows,): each the float nearest to its time."""
    shared = math.gcd(every_ticks, TICKS_PER_SECOND)
    numerator, denominator = every_ticks // shared, TICKS_PER_SECOND // shared
    # Up to here both are exact as floats, so the quotient is rounded once.
    exact = min(rows, 2**53 // numerator)
    times_s = np.arange(float(rows)) * float(numerator) / denominator
    times_s[exact:] = [to_seconds(k * every_ticks) for k in range(exact, rows)]
    return times_s
