"""How much noise there is at what corners guard: its deviation, and how soon it forgets.

Stage 4. Within a few lags integrators hardly move, so what is noisy are the outputs of lags alone. Made
linear about the signals at an instant they are y' = A y + white noise, of which the stationary
covariance P solves A P + P A^T + Q = 0, Q = 2 rms^2 / lag on the diagonal. By Cayley's transform
D = (I - c A)^-1 (I + c A) it is the sum of D^k R D^k^T, R = 2 c (I - c A)^-1 Q (I - c A)^-T, added up by
doubling (R. A. Smith, SIAM J. Applied Mathematics 16, 1968). A guard g = w y has the variance w P w^T,
and remembers for the integral of its correlation, w (-A)^-1 P w^T over that.

Noise that every window resolves (`circuit.LOUD_LAGS`), and what lags much slower than the noise make of
it, is no part of this: windows begin at it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hybrid.elements import (
    ANGLE,
    COS,
    INTEGRATE,
    PIECES,
    POWER,
    PRODUCT,
    QUOTIENT,
    SIN,
    SQRT,
    SUM,
    SWITCH,
    TRACK,
)
from hybrid.engine.arrays import Floats, Ints
from hybrid.engine.blur import REACH, Blur, blurs, mean_in_noise
from hybrid.engine.circuit import (
    AT,
    C1,
    C2,
    CONSTANT,
    CONTROL,
    CORNER,
    END,
    END_PIECE,
    EXPONENT,
    FIRST,
    FIRST_PIECE,
    GAIN,
    HIGH,
    KIND,
    LAG,
    LOW,
    OWNER,
    SECOND,
    SECOND_CONSTANT,
    STOP,
    Circuit,
)
from hybrid.engine.compiling import allocating
from hybrid.engine.sweep import State, is_high

# Lags slower than the noise by this make nothing of it within a window that integrators would not.
SLOWEST = 1e-3
# A covariance that doubling does not end by then has no end: the loop of lags is unstable.
MOST_DOUBLINGS = 40
# A mean square over a normal distribution takes so many points on either side, up to 4 deviations.
POINTS = 16
# Where a function has no finite slope at 0, its argument is taken for no less: noise is about so large.
NO_LESS = 1e-3


class Chain(NamedTuple):
    """Elements on the way from noise to corners that it may blur, in computing order."""

    elements: Ints  # (chain,)
    place: Ints  # (n,): place in `elements`, or -1
    lag: Ints  # (n,): number of the noisy lag, or -1
    driven: Floats  # (lags,): Q's diagonal
    blurs: Ints  # (corners,): 1 where noise can
    live: Ints  # (1,): whether gains on the way change with the signals


def new_chain(circuit: Circuit) -> Chain:
    """What of a circuit lies between noise and corners."""
    rows, n = circuit.rows, len(circuit.rows)
    can = np.array([blurs(circuit, c) for c in range(len(circuit.corners))], dtype=np.int64)
    fast = np.zeros(n, dtype=bool)
    resolved = 1.0 / 16.0 / circuit.longest_s
    least = max(resolved, SLOWEST * float(circuit.noise_rates.max(initial=0.0)))
    lagged = np.flatnonzero(rows[:, LAG] >= 0)
    fast[lagged] = circuit.laws[rows[lagged, LAG], 0] > least
    ends = [int(c[OWNER]) for c, able in zip(circuit.corners, can, strict=True) if able]
    before, waiting = set(ends), list(ends)
    strictly: set[int] = set()
    while waiting:
        e = waiting.pop()
        if rows[e, KIND] == INTEGRATE and e not in ends:
            continue
        for i in circuit.signal[rows[e, FIRST] : rows[e, END]].tolist():
            slow = rows[i, LAG] >= 0 and not fast[i]
            if not slow:
                strictly.add(i)
            if i not in before and not slow:
                before.add(i)
                waiting.append(i)
    elements = np.array(sorted(before), dtype=np.int64)
    place, lag = np.full(n, -1), np.full(n, -1)
    place[elements] = np.arange(len(elements))
    states = [e for e in sorted(strictly) if fast[e]]
    lag[states] = np.arange(len(states))
    driven = np.zeros(len(states))
    for (e, rate), rms in zip(circuit.noisy.tolist(), circuit.noise.tolist(), strict=True):
        if lag[e] >= 0:
            driven[lag[e]] = 2.0 * circuit.noise_rates[rate] * rms * rms
    if not driven.any():
        can[:] = 0
    curved = [e for e in strictly if rows[e, KIND] not in (SUM, INTEGRATE) and place[e] >= 0]
    both = [e for e in ends if rows[e, CORNER] >= 0 and rows[e, STOP] >= 0]
    curved += [e for e in ends if rows[e, STOP] >= 0 and rows[e, KIND] not in (SUM, INTEGRATE)]
    live = any(rows[e, CORNER] >= 0 or rows[e, KIND] >= SWITCH for e in curved) or bool(both)
    return Chain(elements, place, lag, driven, can, np.array([live], dtype=np.int64))


@allocating
def noise_at_guards(
    circuit: Circuit,
    at: Floats,
    state: State,
    chain: Chain,
    blur: Blur,
    out: Floats,
    bound: bool,
) -> None:
    """Fill `out` (corners,) with deviations about the signals `at` (n,), and `blur.rate`.

    bound: what they may at most be; factors are full scale then, and slopes the steepest.
    """
    lags = chain.driven.shape[0]
    made = np.zeros((chain.elements.shape[0], lags))  # each signal, of the noisy lags
    guards = np.zeros((circuit.corners.shape[0], lags))
    a = np.zeros((lags, lags))
    for c in range(chain.elements.shape[0]):
        lag = chain.lag[chain.elements[c]]
        if lag >= 0:
            made[c, lag] = 1.0
    for c in range(chain.elements.shape[0]):
        e = chain.elements[c]
        v = _of_lags(circuit, at, state, chain, blur, made, guards, e, bound)
        lag = chain.lag[e]
        if lag < 0:
            made[c] = v
            continue
        rate = circuit.laws[circuit.rows[e, LAG], 0]
        for k in range(lags):
            a[lag, k] = rate * v[k]
        a[lag, lag] -= rate
    p = _stationary(a, chain.driven)
    memory = _times(_inverse(a), p)
    for corner in range(circuit.corners.shape[0]):
        variance, area = 0.0, 0.0
        if chain.blurs[corner] > 0:
            for j in range(lags):
                for k in range(lags):
                    both = guards[corner, j] * guards[corner, k]
                    variance += both * p[j, k]
                    area -= both * memory[j, k]
        out[corner] = math.sqrt(variance) if variance > 0.0 else 0.0
        if variance > 0.0 and area > 0.0:
            blur.rate[corner] = variance / area


@allocating
def _of_lags(
    circuit: Circuit,
    at: Floats,
    state: State,
    chain: Chain,
    blur: Blur,
    made: Floats,
    guards: Floats,
    e: int,
    bound: bool,
) -> Floats:
    """What element e is before its lag, of the noisy lags, and its guards."""
    rows, figures = circuit.rows, circuit.figures
    kind, corner, stop = rows[e, KIND], rows[e, CORNER], rows[e, STOP]
    first, second = np.zeros(made.shape[1]), np.zeros(made.shape[1])
    x, y = figures[e, CONSTANT], figures[e, SECOND_CONSTANT]
    for t in range(rows[e, FIRST], rows[e, END]):
        i, gain = circuit.signal[t], circuit.gain[t]
        one = first if t < rows[e, SECOND] else second
        if chain.place[i] >= 0:
            size = abs(gain) if bound else gain
            for k in range(one.shape[0]):
                one[k] += size * made[chain.place[i], k]
        if t < rows[e, SECOND]:
            x += gain * at[i]
        else:
            y += gain * at[i]
    if corner >= 0:
        guards[corner] = first
    by_x, by_y = _slopes(kind, x, y, figures[e, EXPONENT])
    if kind == PIECES:
        by_x = _slope_of(circuit, state, blur, corner, x, bound)
    elif kind in (SWITCH, TRACK):
        high = is_high(rows, state.piece, state.memory, rows[e, CONTROL])
        by_x, by_y = (1.0, 0.0) if high else (0.0, 1.0 if kind == SWITCH else 0.0)
    if bound and kind == PRODUCT:
        by_x, by_y = max(1.0, abs(y)), max(1.0, abs(x))
    elif bound and kind == SWITCH:
        by_x, by_y = 1.0, 1.0
    elif bound:
        by_x, by_y = abs(by_x), abs(by_y)
    factor = abs(figures[e, GAIN]) if bound else figures[e, GAIN]
    for k in range(first.shape[0]):
        first[k] = factor * (by_x * first[k] + by_y * second[k])
    if stop >= 0:
        guards[stop] = first
        slope = _slope_of(circuit, state, blur, stop, state.guard_start[stop], bound)
        for k in range(first.shape[0]):
            first[k] *= slope
    return first


@allocating
def _slopes(kind: int, x: float, y: float, exponent: float) -> tuple[float, float]:
    """Slopes of an element's function by its two sums; 0 of what remembers or has no input."""
    if kind == SUM:
        return 1.0, 0.0
    if kind == PRODUCT:
        return y, x
    if kind == QUOTIENT:
        y = math.copysign(max(abs(y), NO_LESS), y)
        return 1.0 / y, -x / (y * y)
    if kind == SQRT:
        return (0.5 / math.sqrt(max(x, NO_LESS)) if x > 0.0 else 0.0), 0.0
    if kind == SIN:
        return math.cos(x), 0.0
    if kind == COS:
        return -math.sin(x), 0.0
    if kind == POWER:
        return exponent * max(abs(x), NO_LESS) ** (exponent - 1.0), 0.0
    if kind == ANGLE:
        square = max(x * x + y * y, NO_LESS * NO_LESS)
        return y / square, -x / square
    return 0.0, 0.0


@allocating
def _slope_of(
    circuit: Circuit, state: State, blur: Blur, corner: int, g: float, bound: bool
) -> float:
    """Slope of the piece that holds; the steepest, for a bound.

    Where noise reaches over a corner, the one that gives what leaves the part its deviation.
    """
    pieces, first = circuit.pieces, circuit.corners[corner, FIRST_PIECE]
    s, end = blur.deviation[corner], circuit.corners[corner, END_PIECE]
    if bound:
        steepest = 0.0
        for p in range(first, end):
            steepest = max(steepest, abs(pieces[p, C1]))
        return steepest
    p = first + state.piece[corner]
    reach = REACH * s
    if s > 0.0 and not pieces[p, LOW] + reach < g < pieces[p, HIGH] - reach:
        weights = mean = square = 0.0
        for k in range(-POINTS, POINTS + 1):
            n = 4.0 * k / POINTS
            weight, y = math.exp(-0.5 * n * n), mean_in_noise(pieces, first, end, g + s * n, 0.0)
            weights, mean, square = weights + weight, mean + weight * y, square + weight * y * y
        mean /= weights
        steeper = mean_in_noise(pieces, first, end, g + s, s)
        size = math.sqrt(max(square / weights - mean * mean, 0.0)) / s
        return float(size if steeper >= mean_in_noise(pieces, first, end, g - s, s) else -size)
    return float(2.0 * pieces[p, C2] * (g - pieces[p, AT]) + pieces[p, C1])


@allocating
def _stationary(a: Floats, driven: Floats) -> Floats:
    """P of A P + P A^T + diag(driven) = 0."""
    n = a.shape[0]
    fastest, slowest = 0.0, math.inf
    for k in range(n):
        fastest, slowest = max(fastest, abs(a[k, k])), min(slowest, abs(a[k, k]))
    c = 1.0 / math.sqrt(fastest * max(slowest, 1e-6 * fastest))
    near, far = np.zeros((n, n)), np.zeros((n, n))
    for j in range(n):
        for k in range(n):
            unit = 1.0 if j == k else 0.0
            near[j, k], far[j, k] = unit - c * a[j, k], unit + c * a[j, k]
    solved = _inverse(near)
    step, p = _times(solved, far), np.zeros((n, n))
    for j in range(n):
        for k in range(n):
            for i in range(n):
                p[j, k] += 2.0 * c * solved[j, i] * driven[i] * solved[k, i]
    for _ in range(MOST_DOUBLINGS):
        more = _times(_times(step, p), step.T)
        grown, size = 0.0, 0.0
        for j in range(n):
            for k in range(n):
                p[j, k] += more[j, k]
            grown, size = max(grown, more[j, j]), max(size, p[j, j])
        if grown <= 1e-12 * size or not size < 1e12:
            break
        step = _times(step, step)
    return p


@allocating
def _times(a: Floats, b: Floats) -> Floats:
    """Product of two matrices; numba's own needs SciPy's BLAS, which takes long to load."""
    out = np.zeros((a.shape[0], b.shape[1]))
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            if a[i, j] != 0.0:
                for k in range(b.shape[1]):
                    out[i, k] += a[i, j] * b[j, k]
    return out


@allocating
def _inverse(a: Floats) -> Floats:
    """By elimination with the largest pivot of a column."""
    n = a.shape[0]
    rest, out = a.copy(), np.eye(n)
    for k in range(n):
        best = k
        for j in range(k + 1, n):
            if abs(rest[j, k]) > abs(rest[best, k]):
                best = j
        for i in range(n):
            rest[k, i], rest[best, i] = rest[best, i], rest[k, i]
            out[k, i], out[best, i] = out[best, i], out[k, i]
        pivot = 1.0 / rest[k, k]
        for i in range(n):
            rest[k, i] *= pivot
            out[k, i] *= pivot
        for j in range(n):
            factor = rest[j, k]
            if j != k and factor != 0.0:
                for i in range(n):
                    rest[j, i] -= factor * rest[k, i]
                    out[j, i] -= factor * out[k, i]
    return out
