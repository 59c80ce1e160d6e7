"""A flat description of an analog circuit: one row for each element, in the order they are computed.

Stage 4. Every parameter is data, so the kernel is compiled once. Figures are in machine units (1 is full
scale) and seconds; `elements` says what an element computes, and `wiring` lays it out.

What is not smooth is cut into pieces. An element with a corner has a list of pieces, each a parabola in
the guarded quantity that is valid between two bounds; inside a window the piece is fixed, so everything
is smooth there. Bounds of neighbouring pieces overlap where there is hysteresis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hybrid.elements import (
    INPUT,
    INTEGRATE,
    MODE,
    SINE,
    SUM,
    SWITCH,
    TRACK,
)
from hybrid.engine.arrays import Floats, Ints

# Columns of Circuit.rows: kind; terms FIRST to SECOND make u, SECOND to END make w; the element that
# controls a switch or store, or whose value is a mode (of INPUT: its place in State.held); rows in laws
# of the integrator and of the lag; corners of the function and of the saturation; 1 where an element
# computed earlier reads this one; elements that reset and hold while they are high; row in noisy;
# the kind of a sum, product or integrator without corners. -1: none.
KIND, FIRST, SECOND, END, CONTROL, LAW, LAG, CORNER, STOP, TEAR, RESET, HOLD_BY, NOISE, PLAIN = (
    range(14)
)
# Columns of Circuit.figures; the last three depend on the kind.
CONSTANT, SECOND_CONSTANT, GAIN, OFFSET = 0, 1, 2, 3
AMPLITUDE, OMEGA, PHASE = 4, 5, 6  # of SINE
EXPONENT = 4  # of POWER
FEEDBACK, KEEPS = 4, 5  # of INTEGRATE; KEEPS: its feedback is an input, off in HOLD
WHICH = 4  # of MODE
LEAK = 4  # of TRACK: at which rate it loses what it keeps
# Columns of Circuit.corners: element, what is guarded, range of rows in pieces; 1 where the element
# reads itself by way of others.
OWNER, ROLE, FIRST_PIECE, END_PIECE, LOOPED = 0, 1, 2, 3, 4

# Columns of Circuit.pieces: valid from LOW to HIGH of the guarded quantity g, where the function is
# c0 + c1 (g - AT) + c2 (g - AT)^2.
LOW, HIGH, AT, C0, C1, C2 = range(6)

# Columns of Circuit.noisy: element, row in noise_rates.
SOURCE, RATE = 0, 1

# What a corner guards: the sum u, the figure before saturation, a limited integrator, or how far an
# angle is from where its piece ends.
OF_SUM, OF_OUTPUT, OF_INTEGRATOR, OF_ANGLE = 0, 1, 2, 3

# Before an instant at which signals are seen, noise is resolved by a window of so many lags. What up to
# four lags make of noise is then right to 1.5e-3 of its variance (tests/test_projection.py).
TAIL_LAGS = 11.0
# In relation to that of the noise.
LEAST_LAG = 0.01
# Windows of so many lags at most show loud noise. Of a Wiener process of variance 1 per window a
# polynomial of degree 6 leaves out sum(1 / (2 (2 m - 1) (2 m + 3)), m > 6) = 0.018 on the average, so of
# the mean square of the noise n less than 2 * LOUD_LAGS * 0.018 = 0.12 %. A corner is taken on the side
# of the start, where E[sign(n(0)) n(t)] falls as exp(-t / lag): LOUD_LAGS / 2 = 1.6 % of mean |n|.
LOUD_LAGS = 1 / 32
# Kinds that are linear in their inputs.
LINEAR = frozenset({INPUT, INTEGRATE, MODE, SINE, SUM, SWITCH, TRACK})


class Circuit(NamedTuple):
    """n elements in computing order; the signal of an element has its number.

    Elements [0, heads) depend on no signal of a loop, [heads, cores) are swept until they agree,
    [cores, n) drive nothing that is in a loop.
    """

    rows: Ints  # (n, 14): see the columns above
    figures: Floats  # (n, 7): see the columns above
    signal: npt.NDArray[np.uint64]  # (terms,); unsigned: a sign would be looked at each time
    gain: Floats  # (terms,)
    laws: Floats  # (laws, 2): y' = drive * v - rate * y as (rate, drive), 1/s
    taus_s: Floats  # distinct times of decay, ascending: the boundary layers after a jump
    corners: Ints  # (corners, 5): see the columns above
    pieces: Floats  # (pieces, 6): see the columns above
    ranges: Ints  # (2,): heads, cores
    torn: Ints  # elements that are read before they are computed
    initial: (
        Floats  # (n, 2): integrator's state or what a store holds; lagged output (nan: settled)
    )
    initial_piece: Ints  # (corners,)
    noisy: Ints  # (noisy, 2): see the columns above
    noise: Floats  # (noisy,): rms
    noise_rates: Floats  # distinct rates at which noise forgets, 1/s
    tails_s: Floats  # before an instant, no longer window ends within these; descending
    longest_s: float  # no window is longer
    grain: float  # largest rms of any noise
    outside: Ints  # (pairs, 2): a corner, and an element that drives its loops from outside
