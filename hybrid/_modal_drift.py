"""Error of the fitted poles from noise that enters the mode itself, and not just its record.

In a loop with noisy parts, or with converters, every cycle kicks the mode a little: its complex
amplitude walks at random. The least-squares fit takes the trend of that walk for a change of the
pole. Neighbouring residuals hardly show it (the walk is far below the noise of a row), so a rule for
independent rows states errors that are too small.

What is looked at. As many rows as the mode lasts are cut into K blocks of a quarter of a cycle or
more. The rows of a block are projected on two orthonormal vectors that span Re exp(s t) and
Im exp(s t), which keeps what changes slowly beside the mode; one more vector holds what is left of a
constant. In these coordinates (2 K + 1) the model is linear: y = D p + e, p being the amplitude, the
constant and the change of the pole s. With noise of variance r in the rows, and complex kicks of
equal strength q at equal intervals,

    cov e = r I + q C,    C = Re sum u u^H,

u being the projections of exp(s (t - t')) from a kick at t' on. The fit's error of the pole is H e,
with H the last two rows of the pseudo-inverse of D: its covariance is r H H^T + q H C H^T. The first
term is the fit's own; the second is added here.

What is known of q. Only what the model cannot take up tells of it: z = F^T y, with the columns of F
orthonormal and orthogonal to D, turned so that F^T C F is diagonal (lambda_i). The z_i are independent
and normal with variances r + q lambda_i, which is the restricted likelihood of Patterson and Thompson
(Biometrika 58 (1971) 545). r is known from the many directions inside blocks. A walk that adds v times
the fit's own variance of a pole adds only v / 4 times r to the variance of the two most telling z_i, so
it is hardly seen until it has doubled or trebled the error. No test can decide then, and one that does
leaves errors that are several times too small; what is stated is the mean of q over its posterior,

    q = integral q L(q) p(q) dq / integral L(q) p(q) dq,    L = prod (r + q lambda_i)^-1/2
                                                     exp(-z_i^2 / (2 (r + q lambda_i))),

for which the prior, in u = q lambda_1 / r, is du / (u + HIDDEN) and a share PLAIN at u = 0. For a walk
far above the noise it is the prior dq / q of a scale, and the mean is sum (z_i^2 / lambda_i) / (n - 2)
of n numbers: the variance of Student's t, which is what makes the deviations from the truth, divided by
the stated errors, have unit variance however small n is (Box and Tiao, Bayesian Inference in
Statistical Analysis, 1973, chapters 2 and 5).

What that costs. No rule can be right both with and without a walk that it cannot see. A numerical search
for the prior with the smallest rms of deviation / stated error at the worst u, given the mean error at
u = 0, ends with a share at u = 0 and the rest where walks show; it reaches an rms of 1.5 where errors at
u = 0 are 1.5 times too large on the average, 1.3 where they are 1.7 times, 1.2 where 1.9 times. Here
errors of an undamped mode in white noise alone are too large by 1.8 on the average (1.5 in the median;
2.8 where the record has one and a half cycles, 1.1 where the mode dies in it), and errors with a walk of
u from 2 to 8 are too small by a quarter at most.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid._modal_fit import EPS
from hybrid._modal_search import Mode

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MOST_BLOCKS = 24
FEWEST_BLOCKS = 6  # of a quarter of a cycle or more
FEWEST_ROWS_IN_BLOCK = 4
KICKS_PER_BLOCK = 4
LASTING = 8.0  # decay times after which nothing of the mode matters to its poles
STEEPEST = 1.0  # decay times within a block; a slope inside it would be lost
PLAIN = 1.0  # share of the prior without a walk, beside that of an e-fold of walks that show
HIDDEN = 8.0  # u above which a walk shows
FINENESS = 0.2  # step of log u


@dataclass(frozen=True)
class _Blocks:
    """Equal blocks of rows in which a mode exp(s t) is looked at; time in rows from its strong end.

    wave: exp(s t) in the first block. basis: (length, 2), orthonormal. beside: norm, over all
    blocks, of what a constant has outside the basis.
    """

    s: complex
    count: int
    wave: Complex
    basis: Array
    beside: float

    @property
    def length(self) -> int:
        return len(self.wave)

    @property
    def start(self) -> Array:
        """First row of each block."""
        return np.arange(float(self.count)) * self.length

    def coordinates(self, rows: Array) -> Array:
        """Coordinates (2 count + 1,) of rows (count, length)."""
        inside = rows @ self.basis
        outside = float(rows.sum()) - float((inside @ self.basis.sum(axis=0)).sum())
        return np.append(inside, outside / self.beside if self.beside else 0.0)


def drift_covariance(mode: Mode) -> Array | None:
    """Covariance (2, 2) of sigma and a0, per row, from a walk of the amplitude.

    None where it cannot be told: real poles, less than one and a half cycles, too steep a decay.
    """
    blocks = _blocks(mode)
    if blocks is None:
        return None
    a, b, offset = mode.fit.weights
    sigma, damped = blocks.s.real, blocks.s.imag
    amplitude = complex(a, -b / damped)
    rows = mode.fitted_values()[: blocks.count * blocks.length].reshape(blocks.count, -1)
    front = amplitude * np.exp(blocks.s * blocks.start)
    # By an addition theorem: exp(s t) of a row is that of its block times that inside the block.
    rows = rows - np.stack([front.real, -front.imag], axis=1) @ np.stack(
        [blocks.wave.real, blocks.wave.imag]
    )
    rows -= offset
    seen = blocks.coordinates(rows)
    noise = _noise(rows, seen)
    design, walk = _design(blocks, amplitude), _walk_covariance(blocks)
    beside = np.linalg.qr(design, mode="complete")[0][:, design.shape[1] :]
    scales, axes = np.linalg.eigh(beside.T @ walk @ beside)
    powers = (axes.T @ (beside.T @ seen)) ** 2
    strength = _mean_strength(powers, noise, np.maximum(scales, 0.0))
    slope = np.array([[1.0, 0.0], [2.0 * sigma, 2.0 * damped]]) @ np.linalg.pinv(design)[3:]
    covariance: Array = strength * (slope @ walk @ slope.T)
    return covariance


def _noise(rows: Array, seen: Array) -> float:
    """Variance of a row, from what the coordinates do not show; above 0, as it divides."""
    energy = float(np.sum(rows * rows))
    inside = energy - float(seen @ seen)
    return max(inside / (rows.size - len(seen)), EPS * energy / rows.size, 1e-300)


def _blocks(mode: Mode) -> _Blocks | None:
    """Blocks for the rows in which the mode lasts; None where they are too few or too long."""
    sigma, a0 = mode.poles
    square = a0 - sigma * sigma
    if square <= 0.0:
        return None
    s = complex(sigma, math.sqrt(square))
    rows = int(min(float(mode.rows_used), LASTING / (abs(sigma) + EPS)))
    quarters = int(rows * s.imag / (0.5 * math.pi))
    count = min(MOST_BLOCKS, quarters, rows // FEWEST_ROWS_IN_BLOCK)
    if count < FEWEST_BLOCKS or abs(sigma) * (rows // count) > STEEPEST:
        return None
    wave = np.exp(s * np.arange(float(rows // count)))
    basis = np.linalg.qr(np.stack([wave.real, wave.imag], axis=1))[0]
    outside = len(wave) - float(np.sum(basis.sum(axis=0) ** 2))
    # Below this it is rounding: the constant is a mode's share in blocks of so few rows.
    beside = math.sqrt(count * outside) if outside > 1e-9 * len(wave) else 0.0
    return _Blocks(s, count, wave, basis, beside)


def _design(blocks: _Blocks, amplitude: complex) -> Array:
    """Coordinates (2 count + 1, 5) of the real and imaginary wave, 1, and the slopes with s."""
    basis, time = blocks.basis, np.arange(float(blocks.length))
    front = np.exp(blocks.s * blocks.start)[:, None]
    wave = front * (basis.T @ blocks.wave)
    slope = blocks.start[:, None] * wave + front * (basis.T @ (time * blocks.wave))
    ones = np.broadcast_to(basis.sum(axis=0), wave.shape)
    slope *= amplitude
    columns = np.zeros((2 * blocks.count + 1, 5))
    for column, part in enumerate((wave.real, wave.imag, ones, slope.real, -slope.imag)):
        columns[:-1, column] = part.ravel()
    columns[-1, 2] = blocks.beside
    return columns


def _walk_covariance(blocks: _Blocks) -> Array:
    """C of the module's text, for kicks whose strength sums to 1 in a row."""
    count, length, s = blocks.count, blocks.length, blocks.s
    kick = (np.arange(KICKS_PER_BLOCK) * length + length // 2) // KICKS_PER_BLOCK
    back = np.exp(-s * kick)
    products = blocks.basis.T * blocks.wave
    # Of its own block a kick has only the rows from its own on; it has all of the later ones.
    own = np.cumsum(products[:, ::-1], axis=1)[:, ::-1][:, kick] * back
    whole = products.sum(axis=1)[:, None] * back
    later = np.array([cmath.exp(s * length * n) for n in range(count)])
    u = np.zeros((count, 2, count, KICKS_PER_BLOCK), dtype=complex)
    for n in range(count):
        rows = np.arange(n, count)
        u[rows, :, rows - n, :] = own if n == 0 else later[n] * whole
    flat = u.reshape(2 * count, -1)
    covariance = np.zeros((2 * count + 1, 2 * count + 1))
    covariance[:-1, :-1] = (flat.real @ flat.real.T + flat.imag @ flat.imag.T) * (
        length / KICKS_PER_BLOCK
    )
    return covariance


def _mean_strength(powers: Array, noise: float, scales: Array) -> float:
    """Mean of q over its posterior; `powers` z_i^2 have the means noise + q scales_i (ascending)."""
    powers, shares = powers / noise, scales / scales[-1]
    highest = math.log(1e4 * (1.0 + float(powers.sum())))
    u = np.exp(np.arange(math.log(1e-3 * HIDDEN), highest, FINENESS))
    variances = 1.0 + np.append(0.0, u)[:, None] * shares
    likelihood = -0.5 * np.sum(np.log(variances) + powers / variances, axis=1)
    weights = np.exp(likelihood - likelihood.max())
    weights *= np.append(PLAIN, FINENESS * u / (u + HIDDEN))
    return float(weights[1:] @ u) / float(weights.sum()) * noise / float(scales[-1])
