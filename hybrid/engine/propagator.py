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

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hybrid.machine import Analog, Floats
from hybrid.memo import KeptBySize
from hybrid.together import in_stacks

# With |M h / 2^s| <= 1/2 the remainder of this many Taylor terms is below 2^-53 relative.
TAYLOR_TERMS = 18
SMALL_NORM = 0.5
# Numbers of the propagators that are kept (32 MB), and what each takes beside its analog side, which
# has as many.
MOST_KEPT, KEPT_BESIDE = 4 * 10**6, 500

Stretch = tuple[Analog, float]  # interval in s


@dataclass(frozen=True, eq=False)
class Propagator:
    """x(h) = x + change @ [x; u] + spread @ (independent unit normal draws)."""

    change: Floats  # (n, n + m)
    spread: Floats  # (n, r)


def propagator(analog: Analog, interval_s: float) -> Propagator:
    """Exact propagator of the analog side over `interval_s` seconds with its inputs held."""
    return propagators([(analog, interval_s)])[0]


def propagators(stretches: Sequence[Stretch]) -> list[Propagator]:
    """The exact propagator of each analog side over its interval, many of them at once."""
    return _kept.of(stretches, _propagators)


# A prediction and a run of one machine share their interval.
_kept: KeptBySize[Stretch, Propagator] = KeptBySize(
    MOST_KEPT, lambda p: 2 * p.change.size + p.spread.size + KEPT_BESIDE
)


def _propagators(stretches: Sequence[Stretch]) -> list[Propagator]:
    return in_stacks(stretches, lambda s: s[0].b.shape, lambda s: sum(s[0].b.shape) ** 2, _stacked)


def _stacked(stretches: Sequence[Stretch]) -> list[Propagator]:
    """Propagators of analog sides of one shape."""
    n, m = stretches[0][0].b.shape
    blocks = np.zeros((len(stretches), n + m, n + m))
    # Where the patch runs away within the interval the figures overflow; the kernel stops on them.
    with np.errstate(over="ignore", invalid="ignore"):
        for block, (analog, interval_s) in zip(blocks, stretches, strict=True):
            np.multiply(analog.a, interval_s, out=block[:n, :n])
            np.multiply(analog.b, interval_s, out=block[:n, n:])
        changes = exponential_minus_one(blocks)[:, :n]
        return [
            Propagator(change.copy(), _spread(analog, interval_s))
            for change, (analog, interval_s) in zip(changes, stretches, strict=True)
        ]


def _spread(analog: Analog, interval_s: float) -> Floats:
    if not analog.noise.any():
        return np.zeros((len(analog.a), 0))
    intensity = analog.noise @ analog.noise.T
    return square_root(noise_covariance(analog.a, intensity, interval_s))


def exponential_minus_one(matrices: Floats) -> Floats:
    """exp(matrix) - I of square matrices (..., n, n), by scaling, Taylor series and shifted squaring."""
    squarings = _squarings(matrices)
    small = np.ldexp(matrices, -squarings[..., None, None])
    term, result = small, small.copy()
    for k in range(2, TAYLOR_TERMS + 1):
        term = term @ small / k
        if k % 4 == 0 and not term.any():  # integrators alone: the series ends
            break
        result += term
    for done in range(int(squarings.max(initial=0))):
        these = squarings > done
        part = result[these]
        result[these] = 2.0 * part + part @ part
    return result


def noise_covariance(a: Floats, intensity: Floats, interval_s: float) -> Floats:
    """Integral of exp(A s) intensity exp(A s)^T over 0 <= s <= interval_s; shape of `a`."""
    if not np.any(intensity):
        return np.zeros_like(a)
    squarings = int(_squarings(a * interval_s))
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


def _squarings(matrices: Floats) -> npt.NDArray[np.int64]:
    """How often to halve each of the matrices (..., n, n) until its norm is small."""
    norms = np.max(np.sum(np.abs(matrices), axis=-1), axis=-1, initial=0.0)
    small = norms <= SMALL_NORM
    halvings = np.ceil(np.log2(np.where(small, 1.0, norms / SMALL_NORM)))
    return np.asarray(halvings, dtype=np.int64)
