"""What a part with corners makes of noise that reaches over them.

Stage 4. In a window much longer than the noise lasts signals are known by their averages alone, and the
average of f(u) is not f of the average of u. With n a normal figure, what a part adds up to is

    f~(m, s) = E f(m + s n),

m what the window resolves of its input and s the deviation of what it does not resolve (Booton,
Nonlinear control systems with random inputs, IRE Trans. Circuit Theory CT-1, 1954). Its slope is the
part's gain for what is resolved, so that means and gains are right to first order. Pieces are parabolas,
so that f~ is a sum of normal distributions and densities. At the end of a window nothing is unresolved,
and f~ is f; in one that is short beside the memory of the noise (FINE_LAGS) that is so throughout.

Within a window m is the polynomial of degree q - 2 that has the moments of the input (`projection`): its
value at the end is no part of it, for that is not an average.
"""

from __future__ import annotations

import itertools
import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from hybrid.elements import INTEGRATE
from hybrid.engine.arrays import Floats, Ints
from hybrid.engine.circuit import (
    AT,
    C0,
    C1,
    C2,
    CORNER,
    END,
    FIRST,
    FIRST_PIECE,
    HIGH,
    KIND,
    LOW,
    OF_ANGLE,
    OF_INTEGRATOR,
    STOP,
    TAIL_LAGS,
    Circuit,
)
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.lanes import between, combine
from hybrid.engine.nodes import Nodes

# Corners so many deviations away are not reached: a normal figure is further out once in 3.5 million.
REACH = 5.0
# Windows of so many lags of the fastest noise resolve it. Of its mean square they leave out 2 * 0.018 *
# FINE_LAGS = 0.9 % (`circuit.LOUD_LAGS`), of a mean |n| half of that; ends are exact.
FINE_LAGS = 0.25
# Before an instant there are so many of them at most, where some noise is much slower than other.
MOST_FINE = 400
# Shares that a window leaves unresolved are kept for so many lengths, evenly spaced by their logarithm.
SHARES, SHORTEST, LONGEST = 200, 1e-3, 1e5


class Blur(NamedTuple):
    """Noise at the guards of corners; owned by the run. A deviation of 0: nothing to be blurred."""

    deviation: Floats  # (corners,): of the noise at the guard, machine units
    most: Floats  # (corners,): a bound of it, whatever the signals are
    rate: Floats  # (corners,): at which it forgets, 1/s
    shares: Floats  # (SHARES,): of variance that windows leave unresolved
    times_s: Floats  # (2,): length of windows that resolve noise; before an instant, all are such
    blurred_s: Floats  # (corners,): for how long the noise reached over the corner unresolved
    rough: Ints  # (1,): whether it does anywhere in this window


@compiled
def mean_in_noise(pieces: Floats, first: int, end: int, m: float, s: float) -> float:
    """E f(m + s n) of pieces first to end, n a normal figure; f(m) where s is 0."""
    total = 0.0
    for p in range(first, end):
        low, high = pieces[p, LOW], pieces[p, HIGH]
        if s <= 0.0:
            if m <= high or p == end - 1:
                x = m - pieces[p, AT]
                return float((pieces[p, C2] * x + pieces[p, C1]) * x + pieces[p, C0])
            continue
        a, b = (low - m) / s, (high - m) / s
        if a > 9.0 or b < -9.0:
            continue
        mass = _below(b) - _below(a)
        slope, square = _density(a) - _density(b), mass
        if abs(a) < 40.0:
            square += a * _density(a)
        if abs(b) < 40.0:
            square -= b * _density(b)
        x = m - pieces[p, AT]
        total += ((pieces[p, C2] * x + pieces[p, C1]) * x + pieces[p, C0]) * mass
        total += s * (
            (2.0 * pieces[p, C2] * x + pieces[p, C1]) * slope + s * pieces[p, C2] * square
        )
    return total


@inlined
def _below(x: float) -> float:
    """Chance of a normal figure below x."""
    return 0.5 * math.erfc(-x * math.sqrt(0.5))


@inlined
def _density(x: float) -> float:
    """Density of a normal figure at x."""
    return math.exp(-0.5 * x * x) / math.sqrt(2.0 * math.pi)


@compiled
def answer(pieces: Floats, first: int, end: int, s: float, scratch: Floats, grid: Nodes) -> None:
    """f~ of scratch row 0, in its place; row 1 is used up."""
    last = len(grid.marks) - 1
    at_end = mean_in_noise(pieces, first, end, scratch[0, last], 0.0)
    combine(scratch, 1, scratch, 0, 0.0, grid.averages, 0, 0.0, scratch, 0)
    for i in range(scratch.shape[1]):
        scratch[1, i] = mean_in_noise(pieces, first, end, scratch[1, i], s)
    combine(scratch, 0, grid.peak, 0, at_end, grid.rejoined, 0, 0.0, scratch, 1)


@cache
def unresolved(q: int) -> Floats:
    """Share of the variance of an Ornstein-Uhlenbeck process that a window's moments leave open.

    For windows of SHORTEST ... LONGEST lags: 1 - sum over m <= q - 2 of (2 m + 1) E[Y_m^2], where
    E[Y_m^2] = 2 integral over 0 <= t <= 1 of exp(-z t) R_m(t), R_m(t) the integral of P_m(x) P_m(x + t).
    """
    marks, weights = legendre.leggauss(60)
    marks, weights = (marks + 1) / 2, weights / 2
    found = np.empty(SHARES)
    for k, z in enumerate(np.geomspace(SHORTEST, LONGEST, SHARES)):
        span = min(1.0, 40.0 / z)
        t = span * marks
        x = (1.0 - t)[:, None] * marks
        open_share = 1.0
        for m in range(q - 1):
            p = [0.0] * m + [1.0]
            both = legendre.legval(2 * x - 1, p) * legendre.legval(2 * (x + t[:, None]) - 1, p)
            along = (1.0 - t) * (both @ weights)
            open_share -= (2 * m + 1) * 2 * span * float(weights @ (np.exp(-z * t) * along))
        found[k] = max(open_share, 0.0)
    return found


@compiled
def share_left(shares: Floats, z: float) -> float:
    """Share of the variance that a window of z lags leaves unresolved."""
    steps = (shares.shape[0] - 1) / math.log(LONGEST / SHORTEST)
    place = math.log(max(z, SHORTEST) / SHORTEST) * steps
    k = int(min(place, shares.shape[0] - 1.0))
    if k == shares.shape[0] - 1:
        return 1.0
    into = place - k
    return float((1.0 - into) * shares[k] + into * shares[k + 1])


@inlined
def near(
    circuit: Circuit, corner: int, piece: int, starts: Floats, guard: Floats, other: float, s: float
) -> bool:
    """Whether noise of deviation s at a guard reaches over a bound of the piece within the window.

    other: another figure of the guard, which counts as well.
    """
    p = circuit.corners[corner, FIRST_PIECE] + piece
    low, high = circuit.pieces[p, LOW] + REACH * s, circuit.pieces[p, HIGH] - REACH * s
    inside = low < starts[corner] < high and low < other < high
    return not (inside and between(guard, corner, low, high))


@compiled
def spread_out(circuit: Circuit, blur: Floats, rough: Ints) -> None:
    """Mark parts with a blurred corner, and what follows them other than by integration.

    In a window longer than the noise lasts what lies between its ends is no value that these have.
    """
    rows = circuit.rows
    rough[:] = 0
    for _ in range(2):  # once more for what is read before it is computed
        for e in range(rows.shape[0]):
            corner, stop = rows[e, CORNER], rows[e, STOP]
            marked = (corner >= 0 and blur[corner] >= 0.0) or (stop >= 0 and blur[stop] >= 0.0)
            if rows[e, KIND] != INTEGRATE:
                for t in range(rows[e, FIRST], rows[e, END]):
                    marked = marked or rough[circuit.signal[t]] > 0
            rough[e] = 1 if marked else 0


@cache
def _no_jump(pieces: bytes) -> bool:
    """Whether pieces of a row (pieces, 6) follow each other without a jump or hysteresis."""
    rows = np.frombuffer(pieces).reshape(-1, 6)
    for before, after in itertools.pairwise(rows):
        x, y = before[HIGH] - before[AT], after[LOW] - after[AT]
        left = before[C0] + x * (before[C1] + x * before[C2])
        right = after[C0] + y * (after[C1] + y * after[C2])
        if before[HIGH] != after[LOW] or abs(left - right) > 1e-9:
            return False
    return True


def blurs(circuit: Circuit, corner: int) -> bool:
    """Whether a corner is one that noise can blur: not a jump, and not that of an integrator."""
    _, role, first, end, _ = circuit.corners[corner].tolist()
    if role in (OF_INTEGRATOR, OF_ANGLE):
        return False  # an angle's cut is a jump
    return _no_jump(circuit.pieces[first:end].tobytes())


def new_blur(circuit: Circuit, q: int) -> Blur:
    """Nothing blurred yet: `noise_at_guards` finds the deviations."""
    corners = len(circuit.corners)
    rates = circuit.noise_rates[circuit.noise_rates * circuit.longest_s > 1.0 / 16.0]
    fine_s = FINE_LAGS / float(rates.max()) if len(rates) else 0.0
    tail_s = min(TAIL_LAGS / float(rates.min()), MOST_FINE * fine_s) if len(rates) else 0.0
    return Blur(
        np.zeros(corners),
        np.zeros(corners),
        np.ones(corners),
        unresolved(q),
        np.array([fine_s, tail_s]),
        np.zeros(corners),
        np.zeros(1, dtype=np.int64),
    )
