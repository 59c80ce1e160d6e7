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

What is known of q and r. Only what the model cannot take up tells of them: z = F^T y, with the columns
of F orthonormal and orthogonal to D, turned so that F^T C F is diagonal (lambda_i). The z_i are
independent and normal with variances r + q lambda_i, which is the restricted likelihood of Patterson and
Thompson (Biometrika 58 (1971) 545). If the noise is white, r is known from the many directions inside
blocks. If it is not, they tell of other frequencies, and r is what the many z_i of small lambda_i
hold, which lie about the mode's own frequency: an r that is held to what another frequency has would
leave the whole difference to q. Both are taken for equally likely beforehand, with dr / r over COLOURS
e-folds for the latter; but where neighbouring rows are correlated inside blocks, the noise is not white.

A walk that adds v times the fit's own variance of a pole adds only v / 4 times r to the variance of the
two most telling z_i, so it is hardly seen until it has doubled or trebled the error. No test can decide
then, and one that does leaves errors that are several times too small; what is stated is the mean of q
over its posterior,

    q = integral q L(q) p(q) dq / integral L(q) p(q) dq,    L = prod (r + q lambda_i)^-1/2
                                                     exp(-z_i^2 / (2 (r + q lambda_i))),

for which the prior, in u = q lambda_1 / r, is du / (u + HIDDEN) and a share PLAIN at u = 0. For a walk
far above the noise it is the prior dq / q of a scale, and the mean is sum (z_i^2 / lambda_i) / (n - 2)
of n numbers: the variance of Student's t, which is what makes the deviations from the truth, divided by
the stated errors, have unit variance however small n is (Box and Tiao, Bayesian Inference in
Statistical Analysis, 1973, chapters 2 and 5). With r unknown, too, the mean of r is A / (n - 2), and

    L = gamma(n / 2) (A / 2)^(-n / 2) prod v_i^-1/2,
    A = sum z_i^2 / v_i,    v_i = 1 + u lambda_i / lambda_1.

What that costs. No rule can be right both with and without a walk that it cannot see. A numerical search
for the prior with the smallest rms of deviation / stated error at the worst u, given the mean error at
u = 0, ends with a share at u = 0 and the rest where walks show; it reaches an rms of 1.5 where errors at
u = 0 are 1.5 times too large on the average, 1.3 where they are 1.7 times, 1.2 where 1.9 times. Here
errors of an undamped mode in white noise alone are too large by 1.8 on the average (1.5 in the median;
3 where the record has one and a half cycles, 1.1 where the mode dies in it), and errors with a walk of
u from 2 to 8 are too small by a third at most. In coloured noise alone errors are
too large by 2 to 3.5, as fewer numbers tell of r.

A second mode close to the first, exp(s2 t), beats with it. What the beat has of a constant and of a
trend goes into the fitted mode; only its bend is left over, less by the factor |s2 - s| times the length
of the record, and smoother than any walk, so neither r nor q tells how far the pole was moved. Therefore
the same likelihood is asked whether z is far better explained with b F^T g in it, g being the
coordinates of such a mode and s2 on a grid about s. If so, what it adds to the fitted pole, H g b, is
an error, in the mean square over the grid by likelihood. A bend beneath the noise does not show, nor
does what it moved.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from functools import cached_property

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
WHOLE_CYCLES = 12  # in so many, blocks have whole cycles, and do not see what changes slowly
WHITE = 5.0  # correlation of neighbours, in standard deviations, that is not chance
COLOURS = 14.0  # e-folds of the noise's variance near the mode, where it is not that elsewhere
BEATS_RAD = np.geomspace(0.1, 12.0, 20)  # |s2 - s| times the length of the record
BEAT_NUMBERS = 10  # z_i of the largest lambda_i, which hold all but a little of a beat
SERIES_TERMS = 12
BEAT_TURNS = 8  # directions of s2 - s
BEAT_FINENESS = 5  # steps of log u at once, where every s2 is tried
BEAT_PROOF = 10.0  # rise of the log likelihood that proves a second mode; chance is 5e-4


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


@dataclass(frozen=True)
class ModeNoise:
    """What moves the fitted poles, apart from noise of the rows with the variance `level`.

    level: variance of a row of white noise that has what the noise has at the mode's frequency.
    drift: covariance (2, 2) of sigma and a0, per row, from a walk of the amplitude and from a second
    mode that beats with the first.
    """

    level: float
    drift: Array


def mode_noise(mode: Mode) -> ModeNoise | None:
    """Noise near the mode's frequency and in the mode itself.

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
    turned = axes.T @ beside.T
    telling = _Telling(
        turned @ seen / math.sqrt(noise),
        np.maximum(scales, 0.0) / scales[-1],
        _neighbours_differ(rows - seen[:-1].reshape(-1, 2) @ blocks.basis.T),
    )
    moves: Array = np.asarray(np.linalg.pinv(design)[3:], dtype=float)  # of s
    second = _second_mode(blocks, telling, turned, moves, abs(amplitude) / math.sqrt(noise))
    level, strength, square = second or (*telling.means(), np.zeros((2, 2)))
    drift = strength / float(scales[-1]) * (moves @ walk @ moves.T) + square
    turn = np.array([[1.0, 0.0], [2.0 * sigma, 2.0 * damped]])
    return ModeNoise(level * noise, noise * (turn @ drift @ turn.T))


@dataclass(frozen=True)
class _Telling:
    """The z_i of the module's text, in deviations of the noise elsewhere, and lambda_i / lambda_1.

    white: whether the noise may be white.
    """

    z: Array
    shares: Array
    white: bool

    @cached_property
    def u(self) -> Array:
        """The grid of u: 0 and e-folds."""
        highest = math.log(1e4 * (1.0 + float(self.z @ self.z)))
        return np.append(0.0, np.exp(np.arange(math.log(1e-3 * HIDDEN), highest, FINENESS)))

    @cached_property
    def variances(self) -> Array:
        """1 + u lambda_i / lambda_1, (len(u), n)."""
        return np.asarray(1.0 + self.u[:, None] * self.shares)

    @cached_property
    def prior(self) -> Array:
        """Logarithm of what is known of u beforehand and of the factor of the likelihood without z."""
        prior = np.append(PLAIN, FINENESS * self.u[1:] / (self.u[1:] + HIDDEN))
        return np.asarray(np.log(prior) - 0.5 * np.sum(np.log(self.variances), axis=1))

    @cached_property
    def misfits(self) -> Array:
        """A of the module's text, for every u."""
        return np.asarray(np.sum(self.z**2 / self.variances, axis=1))

    def likelihoods(self, misfits: Array) -> Array:
        """Logarithms (2, ...) of the likelihood of white and of coloured noise with `misfits` A."""
        half = 0.5 * len(self.z)
        coloured = math.lgamma(half) - half * np.log(0.5 * misfits) - math.log(COLOURS)
        white = -0.5 * misfits if self.white else np.full_like(coloured, -np.inf)
        return np.stack([white, coloured])

    def means(self) -> tuple[float, float]:
        """Means of r and of q lambda_1 over their posterior."""
        return self.means_with(self.misfits, self.u, self.prior)

    def means_with(self, misfits: Array, u: Array, prior: Array) -> tuple[float, float]:
        """The same where something else explains a part of z."""
        likelihoods = self.likelihoods(misfits) + prior
        weights = np.exp(likelihoods - likelihoods.max())
        weights /= weights.sum()
        weights[1] *= misfits / (len(self.z) - 2.0)
        return float(weights.sum()), float((weights @ u).sum())


def _second_mode(
    blocks: _Blocks, telling: _Telling, turned: Array, moves: Array, largest: float
) -> tuple[float, float, Array] | None:
    """r, q lambda_1 and the mean square (2, 2) by which a second mode moves s; None if there is none.

    turned: from coordinates to z. moves: from coordinates to Re s and Im s. largest: amplitude of the
    first mode, which that of the second does not reach. All this is to first order in their ratio; the
    second order may point anywhere.
    """
    level = telling.means()[0]
    if float(np.sum(telling.z[-BEAT_NUMBERS:] ** 2)) < 2.0 * BEAT_PROOF * level:
        return None
    turns = np.exp(2j * math.pi * np.arange(BEAT_TURNS) / BEAT_TURNS)
    apart: Complex = np.multiply.outer(BEATS_RAD, turns).ravel() / (blocks.count * blocks.length)
    columns = _waves(blocks, apart)
    g = columns @ turned.T  # (2, poles, n)
    u, prior = telling.u[::BEAT_FINENESS], telling.prior[::BEAT_FINENESS]
    weights = 1.0 / telling.variances[::BEAT_FINENESS].T
    (g0, g1), z = g, telling.z
    m00, m01, m11 = (g0 * g0) @ weights, (g0 * g1) @ weights, (g1 * g1) @ weights
    h0, h1 = (g0 * z) @ weights, (g1 * z) @ weights
    determinant = np.maximum(m00 * m11 - m01 * m01, 1e-12 * m00 * m11)
    b = np.stack([m11 * h0 - m01 * h1, m00 * h1 - m01 * h0]) / determinant
    before = telling.misfits[::BEAT_FINENESS]
    misfits = np.maximum(before - b[0] * h0 - b[1] * h1, 1e-12 * before)
    likelihoods = telling.likelihoods(misfits) + prior
    likelihoods[:, np.hypot(b[0], b[1]) > largest] = -np.inf
    alone = telling.likelihoods(before) + prior
    free = len(z) - 4.0
    best = float(likelihoods.max())
    if best - float(alone.max()) < BEAT_PROOF * (1.0 + 4.0 / free):
        return None
    _, pole, _ = np.unravel_index(int(np.argmax(likelihoods)), likelihoods.shape)
    level, strength = telling.means_with(misfits[pole], u, prior)
    shares = np.exp(likelihoods - best).sum(axis=0)
    shares /= shares.sum()
    moved = np.einsum("ipu,ipk->kpu", b, columns @ moves.T)
    square = np.einsum("kpu,lpu,pu->kl", moved, moved, shares)
    bent = float(np.sum(shares * np.sum(moved**2, axis=0) * np.sum(b**2, axis=0))) / largest**2
    return level, strength, square + bent * np.eye(2)


def _waves(blocks: _Blocks, apart: Complex) -> Array:
    """Coordinates (2, len(apart), 2 count + 1) of the real and imaginary parts of exp((s + apart) t).

    Inside a block exp(apart t) is summed as a series: it turns by 2 rad at most.
    """
    tau = np.arange(float(blocks.length)) / blocks.length
    terms = np.multiply.accumulate(np.broadcast_to(tau, (SERIES_TERMS, blocks.length)), axis=0)
    inside = blocks.wave * np.append(np.ones((1, blocks.length)), terms, axis=0)
    power = np.arange(SERIES_TERMS + 1)
    series = (apart[:, None] * blocks.length) ** power / [math.factorial(k) for k in power]
    kept = series @ (inside @ blocks.basis)
    front = np.exp((blocks.s + apart)[:, None] * blocks.start)
    waves = np.zeros((len(apart), 2 * blocks.count + 1), dtype=complex)
    waves[:, :-1] = (front[:, :, None] * kept[:, None, :]).reshape(len(apart), -1)
    if blocks.beside:
        outside = series @ inside.sum(axis=1) - kept @ blocks.basis.sum(axis=0)
        waves[:, -1] = outside * front.sum(axis=1) / blocks.beside
    return np.stack([waves.real, waves.imag])


def _noise(rows: Array, seen: Array) -> float:
    """Variance of a row, from what the coordinates do not show; above 0, as it divides."""
    energy = float(np.sum(rows * rows))
    inside = energy - float(seen @ seen)
    return max(inside / (rows.size - len(seen)), EPS * energy / rows.size, 1e-300)


def _neighbours_differ(rows: Array) -> bool:
    """Whether neighbours in what the basis leaves over of rows (count, length) pass for independent."""
    energy = float(np.sum(rows * rows)) + 1e-300
    correlation = abs(float(np.sum(rows[:, 1:] * rows[:, :-1]))) / energy
    return bool(correlation < WHITE / math.sqrt(rows.size) + 4.0 / rows.shape[1])


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
    if count < FEWEST_BLOCKS:
        return None
    length = rows // count
    if quarters >= 4 * WHOLE_CYCLES:
        period = 2.0 * math.pi / s.imag
        length = round(math.ceil(length / period - 0.05) * period)
        count = min(MOST_BLOCKS, rows // length)
    if abs(sigma) * length > STEEPEST:
        return None
    wave = np.exp(s * np.arange(float(length)))
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
