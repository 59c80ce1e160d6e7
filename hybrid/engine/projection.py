"""Windows of time for rough signals: operators that keep ends and averages exactly.

Stage 4. Noise is too rough for a polynomial through its values: at the nodes of a window of many lags
they say nothing of its integral. So where there is noise, the polynomial of degree q - 1 that stands for
a signal y over a window (x from 0 to 1) has y's value at the end and the same moments

    Y_m = integral of P_m(2 x - 1) y(x), m = 0 ... q - 2,  P_m the Legendre polynomials:

the end is what the rest of the machine sees, the moments are what any smooth weight makes of it, be it
an integrator, a chain of them, or a product with a smooth signal. The start is not used: from one window
to the next the polynomials jump.

Integrators and lags keep to this. With z = rate H, their law is y' = a v - z y in x, whose moments obey

    z Y_m = a V_m - y(1) + (-1)^m y(0) + integral of P_m' y,  P_m' = sum of 2 (2 k + 1) P_k,

k = m - 1, m - 3, ...: that is used where z is large, a Gauss rule where it is not. Noise itself, an
Ornstein-Uhlenbeck process, is the lag's answer to white noise, a V_m being normal and independent.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from hybrid.engine.arrays import Floats
from hybrid.engine.compiling import allocating, compiled
from hybrid.engine.nodes import FEW_CONSTANTS, GAUSS_POINTS, nodes


class Projection(NamedTuple):
    """Fixed tables for one q; G = GAUSS_POINTS, and row G of `times` is the end."""

    times: Floats  # (G + 1,): instants in the window
    abscissae: Floats  # (G,)
    answers: Floats  # (G + 1, G, q): weight * l_k(t_g (1 - s_i)), l_k the Lagrange polynomials
    legendre: Floats  # (q, q): [m, k], P_m at node k
    shares: Floats  # (G,): weights of the Gauss rule
    moments: Floats  # (q, q): [m, k], moments from the values at the nodes
    values: Floats  # (q, q): [j, m], values at the nodes from moments 0 ... q - 2 and the end
    gathered: Floats  # (q, G + 1): values at the nodes from those at `times`


@cache
def projection(q: int) -> Projection:
    """Tables for the q nodes of `nodes.nodes`."""
    marks = nodes(q).marks
    gauss, weights = legendre.leggauss(GAUSS_POINTS)
    abscissae, weights = (gauss + 1) / 2, weights / 2
    times = np.append(abscissae, 1.0)
    at_nodes: Floats = np.asarray(legendre.legvander(2 * marks - 1, q - 1))
    series = np.linalg.inv(at_nodes)
    at = times[:, None] * (1 - abscissae)
    answers = legendre.legvander(2 * at - 1, q - 1) @ series * weights[:, None]
    odd = 2 * np.arange(q) + 1.0
    values = np.empty((q, q))
    values[:, : q - 1] = odd[: q - 1] * (at_nodes[:, : q - 1] - at_nodes[:, q - 1 :])
    values[:, q - 1] = at_nodes[:, q - 1]
    gathered = np.empty((q, GAUSS_POINTS + 1))
    at_gauss = legendre.legvander(gauss, q - 2)
    gathered[:, :GAUSS_POINTS] = values[:, : q - 1] @ at_gauss.T * weights
    gathered[:, GAUSS_POINTS] = values[:, q - 1]
    return Projection(
        times,
        abscissae,
        answers,
        at_nodes.T.copy(),
        weights,
        series / odd[:, None],
        values,
        gathered,
    )


@allocating
def projected_law(
    table: Projection, rate: float, drive: float, length_s: float, weights: Floats, decay: Floats
) -> None:
    """Like `nodes.law_weights`, for the polynomials of this module: `weights` (1 + LANES, LANES).

    The weights of the start are zero.
    """
    q, z = table.moments.shape[0], rate * length_s
    rows = np.empty((q, q + 1))
    if z <= FEW_CONSTANTS:
        at_times = np.empty((table.times.shape[0], q + 1))
        _answers(table, z, drive * length_s, at_times)
        _multiply(table.gathered, at_times, rows)
    else:
        ends, y = np.empty(q), np.empty((q, q + 1))
        _end_weights(z, ends)
        for m in range(q - 1):
            y[m, 0] = 1.0 if m % 2 == 0 else -1.0
        y[q - 1, 0] = math.exp(-z)
        for k in range(q):
            y[q - 1, k + 1] = 0.0
            for m in range(q):
                moment = drive * length_s * table.moments[m, k]
                y[q - 1, k + 1] += (2 * m + 1) * moment * ends[m]
                if m < q - 1:
                    y[m, k + 1] = moment
        for k in range(q + 1):
            _solve_moments(z, y[:, k])
        _multiply(table.values, y, rows)
    for i in range(decay.shape[0]):
        j = min(i, q - 1)
        decay[i] = rows[j, 0] if rate != 0.0 else 1.0  # what is held keeps its bits
        weights[0, i] = 0.0
        for k in range(q):
            weights[k + 1, i] = rows[j, k + 1]


@allocating
def noise_spread(table: Projection, z: float, spread: Floats) -> None:
    """Fill `spread` (q, nodes stored): nodes of fresh noise of rms 1 from q unit normal draws.

    Fresh is what a window of z lags adds to the noise of the past, which the lag itself lets decay.
    """
    q = table.moments.shape[0]
    y = np.zeros((q, q))
    if z <= FEW_CONSTANTS:
        at_times = np.empty((table.times.shape[0], q + 1))
        _answers(table, z, 1.0, at_times)
        weights = np.empty((q, table.shares.shape[0]))
        for g in range(table.shares.shape[0]):
            size = math.sqrt(2.0 * z * table.shares[g])
            for m in range(q - 1):
                answer = 0.0
                for k in range(q):
                    answer += at_times[g, k + 1] * table.legendre[m, k]
                weights[m, g] = size * answer if m % 2 == 0 else -size * answer
            weights[q - 1, g] = size * at_times[g, 0]
        covariance = np.empty((q, q))
        _multiply(weights, weights.T, covariance)
        _root(covariance, y)
    else:
        ends = np.empty(q)
        _end_weights(z, ends)
        rest = 1.0 - math.exp(-2.0 * z)
        for m in range(q - 1):
            size = math.sqrt(2.0 * z / (2 * m + 1))
            y[m, m] = size
            y[q - 1, m] = (2 * m + 1) * ends[m] * size
            rest -= y[q - 1, m] ** 2
        y[q - 1, q - 1] = math.sqrt(rest)
        for k in range(q):
            _solve_moments(z, y[:, k])
    rows = np.empty((q, q))
    _multiply(table.values, y, rows)
    for k in range(q):
        for i in range(spread.shape[1]):
            spread[k, i] = rows[min(i, q - 1), k]


@compiled
def _answers(table: Projection, z: float, drive: float, out: Floats) -> None:
    """Fill `out` (G + 1, q + 1): y at `times` that comes of y(0) = 1, and of v = 1 at each node."""
    out[:, :] = 0.0
    for g in range(table.times.shape[0]):
        t = table.times[g]
        out[g, 0] = math.exp(-z * t)
        for i in range(table.abscissae.shape[0]):
            factor = drive * t * math.exp(-z * t * table.abscissae[i])
            for k in range(table.moments.shape[0]):
                out[g, k + 1] += factor * table.answers[g, i, k]


@compiled
def _end_weights(z: float, out: Floats) -> None:
    """Integral of P_m exp(-z (1 - x)), m = 0 ... q - 1, by parts: for z above FEW_CONSTANTS."""
    for m in range(out.shape[0]):
        slope, at_end, at_start = 1.0 / z, 0.0, 0.0  # derivative j of P_m at 1, over z^(j + 1)
        for j in range(m + 1):
            at_end += slope if j % 2 == 0 else -slope
            at_start += slope
            slope *= (m - j) * (m + j + 1) / ((j + 1) * z)
        past = math.exp(-z) * at_start
        out[m] = at_end - past if m % 2 == 0 else at_end + past


@compiled
def _solve_moments(z: float, y: Floats) -> None:
    """From y[m] = a V_m + (-1)^m y(0) and the end y[q - 1], in place: the moments."""
    last = y.shape[0] - 1
    for m in range(last):
        total = y[m] - y[last]
        for k in range(m - 1, -1, -2):
            total += 2 * (2 * k + 1) * y[k]
        y[m] = total / z


@compiled
def _multiply(a: Floats, b: Floats, out: Floats) -> None:
    """Product of two matrices; numba's own needs SciPy's BLAS, which takes long to load."""
    for i in range(a.shape[0]):
        for k in range(b.shape[1]):
            total = 0.0
            for j in range(a.shape[1]):
                total += a[i, j] * b[j, k]
            out[i, k] = total


@compiled
def _root(covariance: Floats, out: Floats) -> None:
    """Lower triangle L with L L^T = `covariance` (Cholesky), in `out`, which is zero before."""
    for i in range(covariance.shape[0]):
        for j in range(i + 1):
            total = covariance[i, j]
            for k in range(j):
                total -= out[i, k] * out[j, k]
            if i == j:
                out[i, i] = math.sqrt(max(total, 0.0))
            elif out[j, j] > 0.0:
                out[i, j] = total / out[j, j]
