"""The digital machine's arithmetic: plays a program's tape on its registers.

Stage 4, compiled into the kernel.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hybrid.engine.compiling import compiled, inlined
from hybrid.tape import FIRST_WIDE, Op

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Operations of the tape, as plain numbers for the compiler.
COPY, ADD, SUB, MUL, DIV, POW, NEG = (
    int(op) for op in (Op.COPY, Op.ADD, Op.SUB, Op.MUL, Op.DIV, Op.POW, Op.NEG)
)
MIN, MAX, ABS, SQRT, SIN, COS, TAN = (
    int(op) for op in (Op.MIN, Op.MAX, Op.ABS, Op.SQRT, Op.SIN, Op.COS, Op.TAN)
)
ASIN, ACOS, ATAN, ATAN2, EXP, LOG = (
    int(op) for op in (Op.ASIN, Op.ACOS, Op.ATAN, Op.ATAN2, Op.EXP, Op.LOG)
)
SINH, COSH, TANH, ASINH, ACOSH, ATANH, LOG10, HYPOT = range(int(Op.SINH), int(Op.HYPOT) + 1)
SIGN, FLOOR, CEIL, ROUND, MOD = (int(op) for op in (Op.SIGN, Op.FLOOR, Op.CEIL, Op.ROUND, Op.MOD))
NOT, AND, OR, LT, LE, GT, GE, EQ, NE = range(int(Op.NOT), int(Op.NE) + 1)
SKIP, SELECT, LIMIT = int(Op.SKIP), int(Op.SELECT), int(Op.LIMIT)
WIDE, LOOK_UP = int(FIRST_WIDE), int(Op.LOOK_UP)


@compiled
def compute_function(op: int, held: float, a: float, b: float) -> float:
    """An operation of the tape that is more than arithmetic; `held`: what its target holds before."""
    if op >= NOT:
        logical: float = compute_logic(op, held, a, b)
        return logical
    if op in (MIN, MAX):
        chosen: float = lesser_or_greater(op, a, b)
        return chosen
    if op == ABS:
        return math.fabs(a)
    if op == SQRT:
        return math.sqrt(a) if a >= 0.0 else math.nan
    if op == SIN:
        return math.sin(a)
    if op == COS:
        return math.cos(a)
    if op == TAN:
        return math.tan(a)
    if op == ASIN:
        return math.asin(a) if abs(a) <= 1.0 else math.nan
    if op == ACOS:
        return math.acos(a) if abs(a) <= 1.0 else math.nan
    if op == ATAN:
        return math.atan(a)
    if op == ATAN2:
        return math.atan2(a, b)
    if op == EXP:
        return math.exp(a)
    if op == LOG:
        return math.log(a) if a > 0.0 else math.nan
    if op == SIGN:
        return float(np.sign(a))
    rare: float = compute_rare(op, a, b)
    return rare


@compiled
def lesser_or_greater(op: int, a: float, b: float) -> float:
    """The smaller or the larger of two. Of what is no number it is none, on either side: a comparison
    with that is false, which by itself would let the other one win."""
    if math.isnan(a) or math.isnan(b):
        return math.nan
    return min(a, b) if op == MIN else max(a, b)


@compiled
def compute_rare(op: int, a: float, b: float) -> float:
    """A function that programs seldom need."""
    if op == SINH:
        return math.sinh(a)
    if op == COSH:
        return math.cosh(a)
    if op == TANH:
        return math.tanh(a)
    if op == ASINH:
        return math.asinh(a)
    if op == ACOSH:
        return math.acosh(a) if a >= 1.0 else math.nan
    if op == ATANH:
        return math.atanh(a) if abs(a) < 1.0 else math.nan
    if op == LOG10:
        return math.log10(a) if a > 0.0 else math.nan
    if op == HYPOT:
        return math.hypot(a, b)
    if op == FLOOR:
        return float(np.floor(a))
    if op == CEIL:
        return float(np.ceil(a))
    if op == ROUND:
        return float(np.rint(a))
    return a % b if b != 0.0 else math.nan  # MOD


@compiled
def compute_logic(op: int, held: float, a: float, b: float) -> float:
    """A comparison or a choice. One of what is no number is none, so that no mistake gets lost."""
    if op == SELECT:
        return math.nan if math.isnan(held) else (a if held != 0.0 else b)
    if op >= LIMIT:
        if math.isnan(held) or not a <= b:
            return math.nan
        limited = min(max(held, a), b)
        return limited if op == LIMIT else held - limited
    if math.isnan(a) or (op != NOT and math.isnan(b)):  # the b of `not` is anything
        return math.nan
    return 1.0 if is_true(op, a, b) else 0.0


@compiled
def is_true(op: int, a: float, b: float) -> bool:
    """A comparison or a condition of two numbers."""
    if op == NOT:
        return a == 0.0
    if op == AND:
        return a != 0.0 and b != 0.0
    if op == OR:
        return a != 0.0 or b != 0.0
    if op == LT:
        return a < b
    if op == LE:
        return a <= b
    if op == GT:
        return a > b
    if op == GE:
        return a >= b
    return a == b if op == EQ else a != b


@inlined
def operate(op: int, held: float, a: float, b: float) -> float:
    """Any operation of two operands but SKIP; arithmetic first, as there is most of it."""
    if op == COPY:
        result = a
    elif op == ADD:
        result = a + b
    elif op == SUB:
        result = a - b
    elif op == MUL:
        result = a * b
    elif op == DIV:
        result = a / b
    elif op == NEG:
        result = -a
    elif op == POW:
        result = a**b
    else:
        result = compute_function(op, held, a, b)
    return result


@compiled
def remember(memory: Any, r: Floats) -> None:
    """End a cycle: the register of an earlier value takes over the present one.

    Of a value several cycles old: it takes over the oldest of its ring, whose place the present takes.
    """
    if memory.length == 0:
        r[memory.keeps] = r[memory.source]
        return
    ring = np.int64(memory.ring)
    oldest = int(r[ring])
    r[memory.keeps] = r[ring + 1 + oldest]
    r[ring + 1 + oldest] = r[memory.source]
    r[ring] = oldest + 1 if oldest + 1 < np.int64(memory.length) else 0
