"""Programs of doubles, played from their tight tape: one decision for every burst of equal operations.

Stage 4, compiled into the kernel.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hybrid.engine.arithmetic import DIV, LOOK_UP, SKIP, WIDE, operate
from hybrid.engine.compiling import strictly
from hybrid.engine.helper_functions import compute_helper, compute_jointly
from hybrid.engine.lookup import (
    FIND,
    FIRST_AXIS,
    INTERVAL,
    PART,
    PER_AXIS,
    STRIDE,
    VALUES,
    is_beyond,
    line,
    plane,
    read,
    seek,
)
from hybrid.numbering import Burst

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

SEEK, LINE, PLANE = (int(op) for op in (Burst.FIND, Burst.LINE, Burst.PLANE))
MULTIPLY_ADD, SIN_COS = int(Burst.MULTIPLY_ADD), int(Burst.SIN_COS)
SECOND = FIRST_AXIS + PER_AXIS  # of the columns of `lookup`'s tables


@strictly
def multiply_add(steps: npt.NDArray[np.uint32], first: int, end: int, r: Floats) -> None:
    """A burst of products and sums, most of every program; each is rounded by itself."""
    for k in range(np.uint64(first), np.uint64(end)):
        r[steps[k, 0]] = r[steps[k, 1]] * r[steps[k, 2]] + r[steps[k, 3]]


@strictly
def run_bursts(
    bursts: npt.NDArray[np.int32],
    first: int,
    end: int,
    steps: npt.NDArray[np.uint32],
    r: Floats,
    figures: Floats,
    axes: Ints,
    tables: Ints,
    places: Floats,
    intervals: Ints,
    outside: Floats,
) -> bool:
    """Play the bursts of one cycle on registers `r`; whether a table was asked out of its range.

    See `TightTape` for what is in a row of `steps`. All of that are whole numbers from 0 up, and typed
    so: numba looks for no negative index then.
    """
    missed = False
    burst = first
    while burst < end:
        op = bursts[burst, 0]
        rows = range(np.uint64(bursts[burst, 1]), np.uint64(bursts[burst, 2]))
        if op == MULTIPLY_ADD:
            multiply_add(steps, bursts[burst, 1], bursts[burst, 2], r)
        elif op == DIV:
            for k in rows:
                r[steps[k, 0]] = r[steps[k, 1]] / r[steps[k, 2]]
        elif op == SEEK:
            for k in rows:
                asked = r[steps[k, 1]]
                missed |= seek(steps[k, 0], asked, figures, axes, places, intervals)
        elif op == LINE:
            for k in rows:
                find, values = steps[k, 1], tables[steps[k, 2], VALUES]
                part = places[find, PART]
                r[steps[k, 0]] = line(figures, values, intervals[find, INTERVAL], part)
        elif op == PLANE:
            for k in rows:
                look = steps[k, 1]
                one, other = tables[look, FIRST_AXIS + FIND], tables[look, SECOND + FIND]
                stride = tables[look, FIRST_AXIS + STRIDE]
                at = tables[look, VALUES] + intervals[one, INTERVAL] * stride
                at += intervals[other, INTERVAL]
                part, last = places[one, PART], places[other, PART]
                r[steps[k, 0]] = plane(figures, at, stride, part, last)
        elif op == SIN_COS:
            for k in rows:
                a = r[steps[k, 0]]
                r[steps[k, 1]] = math.sin(a)
                r[steps[k, 2]] = math.cos(a)
        elif op == SKIP:
            if r[bursts[burst, 1]] == 0.0:
                burst += bursts[burst, 2]
        elif op == LOOK_UP:
            for k in rows:
                value = read(steps[k, 1], figures, axes, tables, places, intervals)
                r[steps[k, 0]] = value
                missed |= is_beyond(steps[k, 1], tables, intervals)
        elif op > SIN_COS:
            for k in rows:
                compute_jointly(op, r, steps[k, 0], steps[k, 1], steps[k, 2], steps[k, 3])
        elif op >= WIDE:
            for k in rows:
                r[steps[k, 0]] = compute_helper(op, r, steps[k, 1], steps[k, 2], outside)
        else:
            for k in rows:
                a, b, held = r[steps[k, 1]], r[steps[k, 2]], r[steps[k, 3]]
                r[steps[k, 0]] = operate(op, held, a, b)
        burst += 1
    return missed
