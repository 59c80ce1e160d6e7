"""Exact propagation of a linear stretch: x(h) = x + F [x; u] + noise, for one interval h.

Stage 4. Two choices matter for lags of 1 us inside cycles of 1 ms to 10 ms:

* F = exp(M h) - I is squared as F <- 2 F + F^2. Squaring exp(M h) itself would round the slow
  modes against the identity at every one of the 14 or so squarings; the shifted form keeps their
  small figures, so the rounding error in F stays near machine epsilon times the number of squarings.
* The noise covariance is doubled, Q(2h) = Q(h) + exp(A h) Q(h) exp(A h)^T. Van Loan's block matrix
  (IEEE Trans. Automatic Control AC-23, 1978) gives the same integral but holds exp(-A h), which
  overflows as soon as h is a few hundred lags.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

from hybrid.machine import Analog, Floats

# With |M h / 2^s| <= 1/2 the remainder of this many Taylor terms is below 2^-53 relative.
TAYLOR_TERMS = 18
SMALL_NORM = 0.5


@dataclass(frozen=True, eq=False)
class Propagator:
    """x(h) = x + change @ [x; u] + spread @ (independent unit normal draws)."""

    change: Floats  # (n, n + m)
    spread: Floats  # (n, r)


# A prediction and a run of one machine share their interval; large machines must not pile up.
@functools.lru_cache(maxsize=8)
def propagator(analog: Analog, interval_s: float) -> Propagator:
    """Exact propagator of the analog side over `interval_s` seconds with its inputs held."""
    n, m = analog.b.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n] = analog.a
    block[:n, n:] = analog.b
    # Where the patch runs away within the interval the figures overflow; the kernel stops on them.
    with np.errstate(over="ignore", invalid="ignore"):
        change = exponential_minus_one(block * interval_s)[:n]
        covariance = noise_covariance(analog.a, analog.noise @ analog.noise.T, interval_s)
    return Propagator(change, square_root(covariance))


def exponential_minus_one(matrix: Floats) -> Floats:
    """exp(matrix) - I for a square matrix, by scaling, Taylor series and shifted squaring."""
    squarings = _squarings(matrix)
    small = matrix / 2.0**squarings
    term, result = small, small.copy()
    for k in range(2, TAYLOR_TERMS + 1):
        term = term @ small / k
        if k % 4 == 0 and not term.any():  # integrators alone: the series ends
            break
        result += term
    for _ in range(squarings):
        result = 2.0 * result + result @ result
    return result


def noise_covariance(a: Floats, intensity: Floats, interval_s: float) -> Floats:
    """Integral of exp(A s) intensity exp(A s)^T over 0 <= s <= interval_s; shape of `a`."""
    if not np.any(intensity):
        return np.zeros_like(a)
    squarings = _squarings(a * interval_s)
    step = interval_s / 2.0**squarings
    term = intensity * step
    covariance = term.copy()
    for k in range(2, 2 * TAYLOR_TERMS):
        product = a @ term
        term = (product + product.T) * (step / k)
        covariance += term
    change = exponential_minus_one(a * step)
    for _ in range(squarings):
        carried = change @ covariance
        # Twice the symmetric part: an asymmetry left by rounding would double at every squaring.
        half = covariance + carried
        covariance = half + half.T + carried @ change.T
        change = 2.0 * change + change @ change
    return covariance


def square_root(covariance: Floats) -> Floats:
    """S with S S^T = covariance, (n, rank); scaled first, since variances differ by many decades."""
    if not covariance.any():
        return np.zeros((len(covariance), 0))
    if not np.all(np.isfinite(covariance)):
        return np.full((len(covariance), 1), math.nan)
    deviation = np.sqrt(np.diag(covariance))
    scale = np.where(deviation > 0, deviation, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    # Directions this far below the largest are rounding; at most 1e-7 of one signal's deviation.
    kept = values > 1e-14 * max(float(values[-1]), 0.0) if len(values) else values > 0
    root: Floats = scale[:, None] * vectors[:, kept] * np.sqrt(values[kept])
    return root


def _squarings(matrix: Floats) -> int:
    norm = float(np.max(np.sum(np.abs(matrix), axis=1), initial=0.0))
    return max(0, math.ceil(math.log2(norm / SMALL_NORM))) if norm > SMALL_NORM else 0
