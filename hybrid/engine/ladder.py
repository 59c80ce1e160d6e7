"""How far a signal can leave the straight line between two of its values: bounds for the exact engine.

Stage 4. With inputs held, x' = A x + B u, and r = x' at the start of an interval of length h say all
that is to come: x(t) = x(0) + P(t) r with P(t) = integral of exp(A s) over 0 <= s <= t. The signal
y = C x + D u leaves its chord from y(0) to y(h) by

    C (P(t) - t/h P(h)) r.

Bounds of the size of that, for all t at once, are built from short intervals upwards: an interval is
parted at a half, a quarter, an eighth, ... of it, and the signal is at most as far off as one of these
points is, and what it leaves the chord between two of them by. They are taken
in coordinates in which slow motions and lags are apart (r = S rho, `_decoupled`), as lags that follow a
slow motion move far and yet hardly leave it.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import schur, solve_sylvester

from hybrid.engine.propagator import exponential_minus_one
from hybrid.machine import Analog, Floats

# The norm of A times the shortest interval: signals are then Taylor series of a few terms.
SHORT = 0.125
# Terms of the bound over the shortest interval; what is left out is below 1e-9 of it.
TERMS = 8
# Rates this far apart are slow motions and lags.
GAP = 10.0
# A ladder with more rungs than this is of a patch that runs away within an interval.
MOST_RUNGS = 64


class Ladder(NamedTuple):
    """Intervals of `shortest_s` times 1, 2, 4, ... for n states, m inputs and k signals."""

    shortest_s: float
    change: Floats  # (rungs, n, n + m): x(h) = x + change [x; u]
    apart: Floats  # (rungs, k, n): |y - chord| <= apart |rho|
    rate: Floats  # (n, n + m): rho = rate [x; u]
    back: Floats  # (n, n): S
    turn: Floats  # (rungs, n, n): rho at the end of the interval
    travelled: Floats  # (rungs, n, n): P(h) S


def rungs_for(analog: Analog, longest_s: float) -> int:
    """How many rungs a ladder needs to come as far as this interval."""
    steps = longest_s / shortest_s(analog, longest_s)
    return 1 + max(0, math.ceil(math.log2(steps))) if math.isfinite(steps) else MOST_RUNGS + 1


def shortest_s(analog: Analog, longest_s: float) -> float:
    """Length of the first rung, s: short against all that happens."""
    norm = float(np.max(np.sum(np.abs(analog.a), axis=1), initial=0.0))
    return SHORT / norm if norm > 0.0 else longest_s


def ladder_of(analog: Analog, first_s: float, rungs: int) -> Ladder:
    """The ladder of an analog side, from `first_s` up."""
    arrays = (np.ascontiguousarray(array).tobytes() for array in (analog.a, analog.b, analog.c))
    return _built(*arrays, *analog.b.shape, first_s, rungs)


# Runs one after the other mostly have the same analog side, and those of a sweep of T as many rungs.
@functools.lru_cache(maxsize=16)
def _built(
    a_bytes: bytes, b_bytes: bytes, c_bytes: bytes, n: int, m: int, first_s: float, rungs: int
) -> Ladder:
    a, b = np.frombuffer(a_bytes).reshape(n, n), np.frombuffer(b_bytes).reshape(n, m)
    c = np.frombuffer(c_bytes).reshape(-1, n + m)[:, :n]
    to_apart, from_apart = _decoupled(a, first_s * 2.0 ** (rungs - 1))
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a * first_s, b * first_s
    change = np.zeros((rungs, n + m, n + m))
    turn, travelled = np.zeros((rungs, n, n)), np.zeros((rungs, n, n))
    apart = np.zeros((rungs, len(c), n))
    with np.errstate(over="ignore", invalid="ignore"):
        change[0] = exponential_minus_one(block)
        travelled[0] = travel(a, np.array([first_s]))[0] @ from_apart
        apart[0] = _shortly_apart(a, c, from_apart, first_s)
        for k in range(rungs):
            f = change[k, :n, :n]
            turn[k] = np.eye(n) + to_apart @ f @ from_apart
            if k + 1 < rungs:
                change[k + 1] = 2.0 * change[k] + change[k] @ change[k]
                travelled[k + 1] = 2.0 * travelled[k] + f @ travelled[k]
        moved = c @ travelled
        within = apart[0]
        for k in range(1, rungs):
            within = np.maximum(within, apart[k - 1] @ np.abs(turn[k - 1]))
            shares = np.ldexp(1.0, np.arange(k) - k)[:, None, None]
            apart[k] = within + np.max(np.abs(moved[:k] - shares * moved[k]), axis=0)
    rate = to_apart @ np.hstack([a, b])
    return Ladder(
        first_s, np.ascontiguousarray(change[:, :n]), apart, rate, from_apart, turn, travelled
    )


def bounds_of_rates(analog: Analog, ladder: Ladder, intervals_s: Floats) -> Floats:
    """Bounds as `Ladder.apart`, of |rho|, for whole intervals: (intervals, k, n)."""
    with np.errstate(over="ignore", invalid="ignore"):
        whole = travel(analog.a, intervals_s) @ ladder.back
        unit = np.broadcast_to(np.eye(len(analog.a)), whole.shape)
        return _bounds(analog, ladder, intervals_s, whole, unit)


def bounds_of_changes(analog: Analog, ladder: Ladder, intervals_s: Floats) -> Floats:
    """The same of |x(h) - x(0)|, by which rho is known."""
    with np.errstate(over="ignore", invalid="ignore"):
        whole = travel(analog.a, intervals_s) @ ladder.back
        return _bounds(analog, ladder, intervals_s, whole, _inverse(whole))


def _bounds(
    analog: Analog, ladder: Ladder, intervals_s: Floats, whole: Floats, of: Floats
) -> Floats:
    """What signals leave their chords by at most, for rho = `of` @ anything; `whole`: P(h) S.

    An interval is taken in rungs, the longest first, and what is left, which is shorter than any.
    """
    c = analog.c[:, : len(analog.a)]
    steps = np.floor(intervals_s / ladder.shortest_s).astype(np.int64)
    end, turned, far = whole @ of, of.copy(), np.zeros(of.shape)
    at_s = np.zeros(len(intervals_s))
    within, off = np.zeros((len(of), *c.shape)), np.zeros((len(of), *c.shape))
    for k in reversed(range(len(ladder.apart))):
        has = steps & (1 << k) != 0
        if not has.any():
            continue
        within[has] = np.maximum(within[has], ladder.apart[k] @ np.abs(turned[has]))
        far[has] += ladder.travelled[k] @ turned[has]
        turned[has] = ladder.turn[k] @ turned[has]
        at_s[has] += ladder.shortest_s * 2.0**k
        share = (at_s / intervals_s)[has, None, None]
        off[has] = np.maximum(off[has], np.abs(c @ (far[has] - share * end[has])))
    bounds: Floats = np.maximum(within, ladder.apart[0] @ np.abs(turned)) + off
    return bounds


def _inverse(matrices: Floats) -> Floats:
    """The inverse of each; infinite where there is none, as for an interval of whole turns."""
    try:
        return np.asarray(np.linalg.inv(matrices), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full(matrices.shape, math.inf)


def travel(a: Floats, intervals_s: Floats) -> Floats:
    """P(h) of the head of this module, for each interval: (intervals, n, n)."""
    n = len(a)
    forced = np.zeros((len(intervals_s), 2 * n, 2 * n))
    forced[:, :n, :n] = a * intervals_s[:, None, None]
    forced[:, :n, n:] = np.eye(n) * intervals_s[:, None, None]
    return np.ascontiguousarray(exponential_minus_one(forced)[:, :n, n:])


def _shortly_apart(a: Floats, c: Floats, from_apart: Floats, interval_s: float) -> Floats:
    """The bound over the first rung, by the terms of P: C A^j (t^(j+1) - t h^j) / (j + 1)!."""
    term, bound = c, np.zeros(c.shape)
    for j in range(1, TERMS):
        term = term @ a * (interval_s / (j + 1))
        # The largest of x - x^(j+1) for 0 <= x <= 1.
        most = j / (j + 1.0) ** (1.0 + 1.0 / j)
        bound += np.abs(term @ from_apart) * (most * interval_s)
    return bound


def _decoupled(a: Floats, longest_s: float) -> tuple[Floats, Floats]:
    """S^-1 and S of coordinates in which slow motions and lags are apart, at the widest gap of rates.

    Any S would do: bounds are the tighter the less its parts move each other.
    """
    n = len(a)
    sizes = np.maximum(np.sort(np.abs(np.linalg.eigvals(a))), 1.0 / longest_s)
    gaps = sizes[1:] / sizes[:-1]
    if not np.any(gaps > GAP):
        return np.eye(n), np.eye(n)
    at = int(np.argmax(gaps))
    limit = math.sqrt(sizes[at] * sizes[at + 1])
    triangle, vectors, slow = schur(a, output="real", sort=lambda x, y: math.hypot(x, y) < limit)
    shift = solve_sylvester(
        triangle[:slow, :slow], -triangle[slow:, slow:], -triangle[:slow, slow:]
    )
    mix = np.eye(n)
    mix[:slow, slow:] = shift
    unmix = 2.0 * np.eye(n) - mix  # [1 X; 0 1] and [1 -X; 0 1]
    return unmix @ vectors.T, vectors @ mix
