"""Least-squares fit of one second-order mode and a constant to a uniformly sampled record.

The unit of time here is the row: `sigma` (1/row) and `a0` (1/row^2) are the coefficients of
s^2 - 2 sigma s + a0 = 0, whose roots are the poles. With d = sigma^2 - a0 the mode is a sum of

    f(t) = exp(sigma t) cosh(sqrt(d) t)    and    g(t) = exp(sigma t) sinh(sqrt(d) t) / sqrt(d),

which stay apart where the two poles meet (critical damping), unlike exp(s1 t) and exp(s2 t).

Long records are condensed before the fit. The rows are cut into blocks that lengthen in proportion
to their distance from the first row, and each block is replaced by its projections on a few
orthonormal vectors. That leaves the poles exact, because f and g obey addition theorems, and
leaves white noise white. The linear parameters are eliminated at every step (Golub and Pereyra,
SIAM J. Numer. Anal. 10 (1973) 413; Kaufman, BIT 15 (1975) 49).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

BLOCKS_PER_OCTAVE = 16
SINGLE_ROWS = 32  # at either end that are blocks of their own: two octaves, as it were
LONGEST_BLOCK = 1024
MEAN_ONLY_RAD = 0.3  # shorter blocks are replaced by their means, at a loss of 0.4 % of information
WAVE_GRID_RAD = 0.25  # step of the frequencies of waves, times the longest block
SERIES_BELOW = 0.25  # |d| t^2 below which the derivative of g is summed as a series
MAX_STEPS = 40
STRAIGHT = 1e-9  # share of the values by which a step may move them; its square is not seen
CONVERGED = 1e-3  # fall of the sum of squares, in variances, not worth another step
EPS = float(np.finfo(float).eps)
FLATTEST = 4.0 * EPS  # least curvature between tangents of unit norm that rounding leaves
BISECTORS = np.array([[1.0, 1.0], [-1.0, 1.0]]) / math.sqrt(2.0)
SMALLEST = 1e-150  # stands in for the norm of a row of zeros


def _norms(rows: Array) -> Array:
    norms: Array = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return np.maximum(norms, SMALLEST)


@dataclass(frozen=True)
class _Vectors:
    """Orthonormal vectors onto which blocks are projected; one column of `matrix` per vector.

    Blocks have powers of two of rows; column[k] is the first column for blocks of 2^k rows, which
    use the columns up to column[k + 1]. A vector shorter than the matrix is followed by zeros.
    sums, ramps: products of the vectors with ones and with 0, 1, 2... of_block[k]: the vectors for
    blocks of 2^k rows by themselves.
    """

    matrix: Array
    column: Index
    sums: Array
    ramps: Array
    of_block: tuple[Array, ...]


@dataclass(frozen=True)
class Condensed:
    """A record replaced by the projections of its blocks; one entry per projection.

    groups: runs of equal blocks, as (block length, first row, blocks). start: first row of each
    block. Entry i of data belongs to block[i] and to column inner[i] of `vectors`; lane[i] is 0 for
    a mean, 1 or 2 for a wave. ones: what a record of ones would give.
    """

    data: Array
    ones: Array
    groups: tuple[tuple[int, int, int], ...]
    start: Array
    block: Index
    inner: Index
    lane: Index
    vectors: _Vectors

    @property
    def longest(self) -> int:
        """Rows in the longest block."""
        return len(self.vectors.matrix)

    def without(self, rows: int, last: bool) -> Condensed:
        """The record without its first (or `last`) rows, SINGLE_ROWS at most; time from the rest.

        These rows are blocks of their own, so nothing is condensed again.
        """
        size, first, count = self.groups[-1 if last else 0]
        kept = (size, first if last else 0, count - rows)
        if last:
            entries, groups, shift = slice(len(self.data) - rows), (*self.groups[:-1], kept), 0
        else:
            later = ((size, first - rows, count) for size, first, count in self.groups[1:])
            entries, groups, shift = slice(rows, None), (kept, *later), rows
        return Condensed(
            self.data[entries],
            self.ones[entries],
            groups,
            self.start[: len(self.start) - rows] if last else self.start[rows:] - shift,
            self.block[entries] - shift,
            self.inner[entries],
            self.lane[entries],
            self.vectors,
        )


def _block_groups(rows: int) -> list[tuple[int, int, int]]:
    """Runs of equal blocks, as (block length, first row, blocks): powers of two of rows.

    Blocks lengthen in proportion to their distance from the first row, up to the last SINGLE_ROWS
    rows, which stay single like the first ones. What does not fill a long block is cut smaller.
    """
    body = rows - SINGLE_ROWS
    if body < SINGLE_ROWS:
        return [(1, 0, rows)]
    groups, row, size = [(1, 0, SINGLE_ROWS)], SINGLE_ROWS, 2
    while size < LONGEST_BLOCK and row + BLOCKS_PER_OCTAVE * size <= body:
        groups.append((size, row, BLOCKS_PER_OCTAVE))
        row += BLOCKS_PER_OCTAVE * size
        size *= 2
    while size > 1:
        count = (body - row) // size
        if count:
            groups.append((size, row, count))
            row += count * size
        size = max(1, size // 4)
    return [*groups, (1, row, rows - row)]


@lru_cache(maxsize=32)
def _vectors(longest: int, waves_from: int, omega: float) -> _Vectors:
    """Vectors for blocks of up to `longest` rows; of `waves_from` rows and more keep up to three."""
    phase = omega * (np.arange(longest) - 0.5 * (longest - 1))
    longest_wave = np.array([np.cos(phase), np.sin(phase)])
    powers = range(longest.bit_length())
    column = np.cumsum([0, *(min(2**k, 3) if 2**k >= waves_from else 1 for k in powers)])
    matrix = np.zeros((longest, column[-1]))
    for k in powers:
        size, own = 2**k, matrix[: 2**k, column[k] : column[k + 1]]
        own[:, 0] = size**-0.5
        if own.shape == (2, 2):
            own[:] = [[1.0, 0.0], [0.0, 1.0]]
        elif own.shape[1] == 3:
            # Cut from the middle of a longer wave; the cosine is even, so free of the sine.
            wave = longest_wave[:, (longest - size) // 2 : (longest + size) // 2].copy()
            wave[0] -= wave[0].sum() / size
            own[:, 1:] = (wave / _norms(wave)[:, None]).T
    tau = np.arange(float(longest))
    # Rows of the transpose, as numpy adds along contiguous rows in pairs, and so to the last digit.
    sums = np.ascontiguousarray(matrix.T).sum(axis=1)
    of_block = (matrix[: 2**k, column[k] : column[k + 1]] for k in powers)
    blocks = tuple(np.ascontiguousarray(vectors) for vectors in of_block)
    return _Vectors(matrix, column, sums, tau @ matrix, blocks)


def condense(values: Array, omega: float) -> Condensed:
    """Replace the blocks of `values` (rows,) by projections that keep waves near `omega`."""
    groups = _block_groups(len(values))
    longest = max(size for size, _, _ in groups)
    waves_from = 1
    while waves_from <= LONGEST_BLOCK and waves_from * omega < MEAN_ONLY_RAD:
        waves_from *= 2
    # Waves from a grid of frequencies, so that they are at hand for the next record of a sweep.
    grid = WAVE_GRID_RAD / longest
    vectors = _vectors(longest, min(waves_from, 2 * longest), round(omega / grid) * grid)
    power = [size.bit_length() - 1 for size, _, _ in groups]
    counts = [count for _, _, count in groups]
    widths: Index = np.diff(vectors.column)[power]
    size_of = np.repeat([float(size) for size, _, _ in groups], counts)
    width_of = np.repeat(widths, counts)
    block = np.repeat(np.arange(len(size_of)), width_of)
    lane = np.arange(len(block)) - (np.cumsum(width_of) - width_of)[block]
    inner = np.repeat(vectors.column[power], widths * counts) + lane
    data, entry = np.empty(len(block)), 0
    for (size, first, count), k in zip(groups, power, strict=True):
        rows = values[first : first + size * count].reshape(count, size)
        projections = rows @ vectors.of_block[k]
        data[entry : entry + projections.size] = projections.ravel()
        entry += projections.size
    ones = vectors.sums[inner]
    start = np.cumsum(size_of) - size_of
    return Condensed(data, ones, tuple(groups), start, block, inner, lane, vectors)


def mode_functions(t: Array, sigma: float, a0: float) -> tuple[Array, Array]:
    """f and g at the times `t` (rows)."""
    d = sigma * sigma - a0 or 1e-300
    root = abs(d) ** 0.5
    if d < 0.0:
        envelope = np.exp(sigma * t)
        return envelope * np.cos(root * t), envelope * np.sin(root * t) / root
    # The pole in front is the one that decays slowest, so that nothing cancels.
    slow = sigma + root if sigma > 0.0 else -a0 / (root - sigma)
    front = np.exp(slow * t)
    gap = np.expm1(-2.0 * root * t)
    return front * (1.0 + 0.5 * gap), front * gap / (-2.0 * root)


def discriminant_slope(t: Array, sigma: float, a0: float, f: Array, g: Array) -> Array:
    """h = dg/dd = (t f - g) / (2 d), by its series where the poles are close."""
    d = sigma * sigma - a0 or 1e-300
    h: Array = (t * f - g) / (2.0 * d)
    x = d * t * t
    small = np.abs(x) < SERIES_BELOW
    ts, xs = t[small], x[small]
    series = np.full(len(xs), 1.0 / 1037836800.0)
    for divisor in (7983360.0, 90720.0, 1680.0, 60.0, 6.0):  # (2k + 1)! / k
        series = series * xs + 1.0 / divisor
    h[small] = np.exp(sigma * ts) * ts**3 * series
    return h


def columns(record: Condensed, sigma: float, a0: float, slopes: bool = True) -> Array:
    """Projections of f, g and 1, and if `slopes` of df/dsigma, dg/dsigma and dg/dd.

    Shape (3 or 6, entries); df/dd = (dg/dsigma) / 2 needs no row of its own. By the addition
    theorems f(t + u) = f f + d g g and g(t + u) = g f + f g, and the derivatives of these.
    """
    blocks, d = len(record.start), sigma * sigma - a0
    t = np.concatenate([record.start, np.arange(float(record.longest))])
    every = np.empty((5 if slopes else 2, len(t)))
    every[0], every[1] = mode_functions(t, sigma, a0)
    if slopes:
        np.multiply(every[:2], t, out=every[2:4])
        every[4] = discriminant_slope(t, sigma, a0, every[0], every[1])
    inside = every[:, blocks:]
    inner = inside @ record.vectors.matrix
    fi, gi, *slopes_i = inner.take(record.inner, axis=1)
    fb, gb, *slopes_b = every.take(record.block, axis=1)
    out = np.empty((len(every) + 1, len(record.data)))
    out[0] = fb * fi + d * gb * gi
    out[1] = gb * fi + fb * gi
    out[2] = record.ones
    if slopes:
        (tfi, tgi, hi), (tfb, tgb, hb) = slopes_i, slopes_b
        out[3] = tfb * fi + fb * tfi + d * (tgb * gi + gb * tgi)
        out[4] = tgb * fi + gb * tfi + tfb * gi + fb * tgi
        out[5] = hb * fi + 0.5 * (gb * tgi + tgb * gi) + fb * hi
    return out


def straight_line_misfit(record: Condensed) -> float:
    """Sum of squares that the best straight line leaves over."""
    ones = record.ones / math.sqrt(float(record.ones @ record.ones))
    ramp = record.start.take(record.block) * record.ones + record.vectors.ramps.take(record.inner)
    ramp -= (ramp @ ones) * ones
    residual = record.data - (record.data @ ones) * ones
    residual -= (residual @ ramp) / float(ramp @ ramp) * ramp
    return float(residual @ residual)


def misfit(record: Condensed, sigma: float, a0: float) -> float:
    """Sum of squares that the best mode with these poles leaves over, to compare guesses."""
    with np.errstate(all="ignore"):
        design = columns(record, sigma, a0, slopes=False)
    if not np.isfinite(design).all():
        return np.inf
    design /= _norms(design)[:, None]
    normal, slope = design @ design.T, design @ record.data
    normal.flat[::4] += 1e-14
    return float(record.data @ record.data - slope @ np.linalg.solve(normal, slope))


@dataclass(frozen=True)
class Fit:
    """What is left over by given poles with the best weights, and how it would change with them.

    poles: (sigma, a0) of a mode, or (rate,) of a single pole. weights: of f and g (of f alone for a
    single pole) and of 1. tangents: (poles, entries), the derivatives of the model with respect to
    the poles, less what the weights can take up. weight_slopes: (poles, weights), the derivatives
    of the best weights. reach: norms of the tangents before anything is taken up; norms: after.
    curvature, axes: eigenvalues and vectors of the products of the tangents at unit norm.
    """

    poles: Array
    weights: Array
    residual: Array
    rss: float
    tangents: Array
    weight_slopes: Array
    reach: Array
    norms: Array
    curvature: Array
    axes: Array

    def along_tangents(self, change: Array) -> Fit:
        """The fit at poles so near by that the model does not bend on the way."""
        residual = self.residual - change @ self.tangents
        return replace(
            self,
            poles=self.poles + change,
            weights=self.weights + change @ self.weight_slopes,
            residual=residual,
            rss=float(residual @ residual),
        )

    def rounding(self, record: Condensed, mean: float = 0.0) -> Array:
        """Covariance (poles, poles) that rows bring about of which each is rounded by itself.

        Rows of a growing record are rounded in proportion to what they hold; one variance for all would
        be that of the many small ones. mean: what was subtracted once the rows had been rounded with it,
        to the nearest, so with a standard deviation of EPS / sqrt(12) of it at most.
        """
        own = np.abs(record.data) + abs(float(self.weights[-1])) * record.ones
        deviation = EPS * np.hypot(own, mean / math.sqrt(12.0))
        moved = self.covariance @ (self.tangents * deviation)
        return np.asarray(moved @ moved.T)

    @cached_property
    def covariance(self) -> Array:
        """Covariance (poles, poles) of the poles for rows of unit variance."""
        axes = self.axes / self.norms[:, None]
        return np.asarray((axes / np.maximum(self.curvature, FLATTEST)) @ axes.T)


def _orthonormal(design: Array) -> tuple[Array, Array]:
    """Orthonormal rows q that span the rows of `design`, and the matrix m with q = m design.

    By Gram and Schmidt, each row twice, which is enough (Giraud, Langou, Rozloznik and van den
    Eshof, Numer. Math. 101 (2005) 87). A row that depends on others is not blown up beyond 1e15.
    """
    count, entries = design.shape
    norms = _norms(design)
    both = np.zeros((count, entries + count))
    np.divide(design, norms[:, None], out=both[:, :entries])
    both[range(count), range(entries, entries + count)] = 1.0 / norms
    q, made_of = both[:, :entries], both[:, entries:]
    for row in range(1, count):
        for _ in range(2):
            both[row] -= (q[:row] @ q[row]) @ both[:row]
        norm = math.sqrt(float(q[row] @ q[row]))
        q[row] /= max(norm, SMALLEST)
        made_of[row] /= norm + 1e-15
    return q, made_of


def fit_weights(record: Condensed, poles: Array) -> Fit | None:
    """Best weights at the given poles; None where the exponentials overflow."""
    single = len(poles) == 1
    sigma = float(poles[0])
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        functions = columns(record, sigma, sigma * sigma if single else float(poles[1]))
    if not np.isfinite(functions).all():
        return None
    design, (tf, tg, h) = functions[0:3:2] if single else functions[:3], functions[3:]
    q, made_of = _orthonormal(design)
    weights = (q @ record.data) @ made_of
    # Once more on what is left, so that small rows are fitted to their own rounding.
    weights += (q @ (record.data - weights @ design)) @ made_of
    residual = record.data - weights @ design
    tangents = np.empty((len(poles), len(record.data)))
    tangents[0] = weights[0] * tf
    if not single:
        tangents[1] = -0.5 * weights[0] * tg - weights[1] * h
        tangents[0] += weights[1] * tg - 2.0 * sigma * tangents[1]
    reach = _norms(tangents)
    taken_up = tangents @ q.T
    tangents -= taken_up @ q
    slopes = -taken_up @ made_of
    norms = _norms(tangents)
    curvature, axes = np.ones(1), np.ones((1, 1))
    if not single:  # the axes of two unit vectors bisect the angles between them
        cosine = float((tangents[0] / norms[0]) @ (tangents[1] / norms[1]))
        curvature, axes = np.array([1.0 - cosine, 1.0 + cosine]), BISECTORS
    rss = float(residual @ residual)
    return Fit(poles, weights, residual, rss, tangents, slopes, reach, norms, curvature, axes)


def refine(record: Condensed, poles: Array, steps: int = MAX_STEPS) -> Fit | None:
    """Best poles, sought from `poles`; None if those overflow."""
    here = fit_weights(record, poles)
    return None if here is None else improve(record, here, steps)


def improve(record: Condensed, here: Fit, steps: int = MAX_STEPS) -> Fit:
    """Gauss-Newton iteration with Marquardt's damping from the fit `here`."""
    energy = float(record.data @ record.data)
    rounding = (8.0 * EPS) ** 2 * energy
    damping = 0.0
    powers = np.arange(1.0, len(here.poles) + 1.0) / len(here.poles)
    for _ in range(steps):
        slope, axes = here.tangents @ here.residual / here.norms, here.axes
        step = axes @ ((slope @ axes) / (np.maximum(here.curvature, FLATTEST) + damping))
        gain = float(step @ slope)
        change = step / here.norms
        reach = float(np.abs(change) @ here.reach)
        if reach**2 < STRAIGHT**2 * energy and here.curvature.min() > 0.1:
            straight = here.along_tangents(change)
            return straight if straight.rss < here.rss else here
        size = abs(float(here.poles[-1])) ** powers
        if gain <= 1e-4 * rounding or (np.abs(change) <= 4.0 * EPS * size).all():
            break
        there = fit_weights(record, here.poles + change)
        if there is not None and there.rss < here.rss:
            here = there
            damping = 0.1 * damping if damping > 1e-6 else 0.0
        else:
            damping = max(10.0 * damping, 1e-3)
            if gain <= rounding:
                break
        if gain <= CONVERGED * here.rss / len(record.data) or damping > 1e6:
            break
    return here


def row_residuals(values: Array, record: Condensed, fit: Fit) -> tuple[float, float]:
    """Root mean square and largest size of the rows less the fitted mode and constant."""
    sigma, a0 = fit.poles
    blocks = len(record.start)
    t = np.concatenate([record.start, np.arange(float(record.longest))])
    functions = np.ones((3, len(t)))
    functions[0], functions[1] = mode_functions(t, sigma, a0)
    a, b, offset = fit.weights
    turn = np.array([[a, b, 0.0], [b, a * (sigma * sigma - a0), 0.0], [0.0, 0.0, offset]])
    states, functions = functions[:, :blocks].T @ turn, functions[:, blocks:]
    left, block = np.empty(len(values)), 0
    for size, first, count in record.groups:
        part = left[first : first + size * count].reshape(count, size)
        np.matmul(states[block : block + count], functions[:, :size], out=part)
        block += count
    np.subtract(values, left, out=left)
    rms = math.sqrt(float(np.einsum("i,i->", left, left)) / len(left))
    return rms, max(float(left.max()), -float(left.min()))
