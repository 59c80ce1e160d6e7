"""A program of limited word length, played: every operation rounds, as in the machine.

Stage 4, for `limited`. An operation is computed as a double, with the sign of what that leaves out, so
that the result is rounded once: where something was left out, the double is made odd in its last bit,
which no rounding to 50 bits or fewer can mistake for a tie or for an exact result ("round to odd":
Boldo, Melquiond, IEEE Trans. Computers 57, 2008). Functions are good to a double's ulp before they are
rounded.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hybrid.engine.arithmetic import (
    ADD,
    DIV,
    LOOK_UP,
    MUL,
    SKIP,
    SQRT,
    SUB,
    WIDE,
    operate,
)
from hybrid.engine.compiling import compiled, strictly
from hybrid.engine.helper_functions import compute_helper
from hybrid.engine.lookup import look_up
from hybrid.wordlength import Figures, Kind, Overflow

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

KIND, BITS, CUTS, STEP, OVERFLOW = (int(figure) for figure in Figures)
SINGLE, FIXED = int(Kind.SINGLE), int(Kind.FIXED)
WRAP, STOP = int(Overflow.WRAP), int(Overflow.STOP)
# Splits a double into halves whose products are exact (Dekker, Numer. Math. 18, 1971).
SPLITTER = 2.0**27 + 1.0


@strictly
def product_error(a: float, b: float, product: float) -> float:
    """a b - product, exactly, where nothing under- or overflows."""
    c = SPLITTER * a
    a_high = c - (c - a)
    c = SPLITTER * b
    b_high = c - (c - b)
    a_low, b_low = a - a_high, b - b_high
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@strictly
def left_out(op: int, a: float, b: float, result: float) -> float:
    """A number of the sign of the exact result less the one computed; 0 where there is none."""
    if op == SUB:
        b = -b
    if op in (ADD, SUB):
        part = result - a
        return (a - (result - part)) + (b - part)
    if op == MUL:
        below: float = product_error(a, b, result)
        return below
    if op == DIV:
        product = result * b
        error: float = product_error(result, b, product)
        rest = (a - product) - error
        return rest if b > 0.0 else -rest
    if op == SQRT:
        product = result * result
        over: float = product_error(result, result, product)
        return (a - product) - over
    return 0.0


@compiled
def odd(value: float, error: float) -> float:
    """The double next to `value` in the direction of `error` if its own last bit is even."""
    mantissa, exponent = math.frexp(value)
    whole = math.ldexp(mantissa, 53)
    if int(whole) % 2 == 0:
        whole += 1.0 if error > 0.0 else -1.0
    return math.ldexp(whole, exponent - 53)


@compiled
def rounded_float(value: float, length: Floats) -> float:
    """To so many significant bits; a float32 also to its range."""
    if length[KIND] == SINGLE:
        return float(np.float32(value))
    mantissa, exponent = math.frexp(value)
    bits = int(length[BITS])
    scaled = math.ldexp(mantissa, bits)
    whole = float(np.trunc(scaled) if length[CUTS] != 0.0 else np.rint(scaled))
    return math.ldexp(whole, exponent - bits)


@compiled
def code_of(value: float, length: Floats) -> float:
    """The code of a fixed-point word, in range or not."""
    scaled = value / length[STEP]
    nearest = np.rint(scaled)
    if length[CUTS] == 0.0:
        return float(nearest)
    # A step need not be a power of two: a product of it and a whole number is off by rounding.
    slack = math.ldexp(1.0, int(length[BITS]) - 50)
    return float(nearest if abs(scaled - nearest) <= slack else np.floor(scaled))


@compiled
def within(code: float, length: Floats) -> float:
    """What a fixed-point word makes of a code that may be out of range."""
    limit = math.ldexp(1.0, int(length[BITS]) - 1)
    if length[OVERFLOW] == WRAP:
        return float(code - 2.0 * limit * np.floor((code + limit) / (2.0 * limit)))
    return min(max(code, -limit), limit - 1.0)


@compiled
def compute(op: int, held: float, a: float, b: float) -> float:
    """Any operation of two operands but SKIP, as a double."""
    result: float = operate(op, held, a, b)
    return result


@compiled
def run_rounded(
    code: npt.NDArray[np.int32],
    length_of: npt.NDArray[np.int32],
    lengths: Floats,
    r: Floats,
    first: int,
    figures: Floats,
    axes: Ints,
    tables: Ints,
    outside: Floats,
    places: Floats,
    intervals: Ints,
) -> int:
    """Play the operations from `first` on up to one whose result overflows, and give its number.

    Where none does, that is the number of operations. The register of the one that does holds what did
    not fit.
    """
    k = first
    while k < code.shape[0]:
        op, target, a, b = code[k, 0], code[k, 1], r[code[k, 2]], r[code[k, 3]]
        at, site = code[k, 2], code[k, 3]  # of an operation with arguments side by side
        if op == SKIP:
            k += 1 + (int(b) if a == 0.0 else 0)
            continue
        if op == LOOK_UP:
            result = look_up(r, at, site, figures, axes, tables, places, intervals, outside)
        elif op >= WIDE:
            result = compute_helper(op, r, at, site, outside)
        else:
            result = compute(op, r[target], a, b)
        length = lengths[length_of[k]]
        if length[KIND] != 0.0 and math.isfinite(result) and result != 0.0:
            error = left_out(op, a, b, result)
            if error != 0.0 and math.isfinite(error):
                result = odd(result, error)
            if length[KIND] == FIXED:
                code_found = code_of(result, length)
                if within(code_found, length) != code_found:
                    r[target] = result
                    return k
                result = code_found * length[STEP]
            else:
                result = rounded_float(result, length)
        r[target] = result
        k += 1
    return k
