"""Operators that keep ends and moments, and the joint law of noise in a window, against quadrature."""

import itertools
import math

import numpy as np
import pytest
from numpy.polynomial import legendre

from hybrid.engine.circuit import TAIL_LAGS
from hybrid.engine.nodes import nodes
from hybrid.engine.projection import noise_spread, projected_law, projection
from hybrid.engine.propagator import noise_covariance

Q = 8
TABLE = projection(Q)
MARKS = nodes(Q).marks
# Both ways of making them, on either side of where one takes over from the other.
LAGS_PER_WINDOW = (1e-3, 0.3, 4.0, 19.99, 20.01, 150.0, 1e5)


def law(rate, drive, length_s):
    """(decay (q,), weights (q, q)): nodes of y from its start and from the nodes of v."""
    weights, decay = np.full((Q + 1, Q), np.nan), np.full(8, np.nan)
    projected_law(TABLE, rate, drive, length_s, weights, decay)
    rows = weights.T
    assert not np.any(rows[:, 0])  # nothing is made of v at the start
    return decay, rows[:, 1:]


def spread(z):
    out = np.full((Q, 8), np.nan)
    noise_spread(TABLE, z, out)
    return out.T


def facts(values):
    """Moments 0 ... q - 2 and the end of the polynomial through these nodes, by its own quadrature."""
    x, w = legendre.leggauss(Q)
    series = legendre.legfit(2 * MARKS - 1, values, Q - 1)
    moments = [
        w @ (legendre.legval(x, series) * legendre.legval(x, np.eye(Q)[m])) / 2
        for m in range(Q - 1)
    ]
    return np.array([*moments, values[-1]])


def panels(left, right, per_s):
    """Gauss points and weights from left to right, finer towards both ends, down to 1/per_s."""
    half, cuts = (right - left) / 2, [0.0]
    step = min(0.25 / per_s, half)
    while step < half:
        cuts.append(step)
        step *= 2
    edges = np.array(cuts + [half] + [2 * half - c for c in reversed(cuts)]) + left
    x, w = legendre.leggauss(16)
    pairs = [((b - a) / 2 * (x + 1) + a, (b - a) / 2 * w) for a, b in itertools.pairwise(edges)]
    return np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])


def moments_of(function, per_s):
    t, w = panels(0.0, 1.0, per_s)
    return np.array(
        [w @ (legendre.legval(2 * t - 1, np.eye(Q)[m]) * function(t)) for m in range(7)]
    )


@pytest.mark.parametrize("z", LAGS_PER_WINDOW)
def test_a_lag_keeps_the_moments_and_the_end_of_what_it_makes(z):
    """y' = z (v - y): from y(0) = 1 and v = 0, exp(-z x); from 0 and v = x, x - (1 - exp(-z x)) / z."""
    decay, weights = law(z / 0.25, z / 0.25, 0.25)
    faded = np.append(moments_of(lambda x: np.exp(-z * x), max(z, 1)), math.exp(-z))
    np.testing.assert_allclose(facts(decay), faded, atol=2e-14)

    def ramp(x):
        return x + np.expm1(-z * x) / z

    followed = np.append(moments_of(ramp, max(z, 1)), ramp(1.0))
    # 1/z is lost where the formula above cancels.
    np.testing.assert_allclose(facts(weights @ MARKS), followed, atol=2e-14 + 2e-16 / z)


def test_an_integrator_keeps_the_moments_of_the_integral():
    decay, weights = law(0.0, 1.0, 0.5)
    np.testing.assert_allclose(decay, 1.0, atol=1e-14)
    for k in range(Q):
        end = np.append(moments_of(lambda x, k=k: 0.5 * x ** (k + 1) / (k + 1), 1), 0.5 / (k + 1))
        np.testing.assert_allclose(facts(weights @ MARKS**k), end, atol=1e-15)


@pytest.mark.parametrize("z", LAGS_PER_WINDOW)
def test_fresh_noise_has_the_joint_covariance_of_an_ornstein_uhlenbeck_process(z):
    """From rest: E n(s) n(t) = exp(-z (t - s)) (1 - exp(-2 z s)) for s <= t."""
    t, w = panels(0.0, 1.0, max(z, 1))
    basis = legendre.legvander(2 * t - 1, Q - 2)
    expected = np.empty((Q, Q))
    past = np.empty((len(t), Q - 1))  # integral over s < t of the covariance with P_m(s)
    for i, at in enumerate([*t.tolist(), 1.0]):
        s, u = panels(0.0, at, max(z, 1))
        kernel = u * np.exp(-z * (at - s)) * -np.expm1(-2 * z * s)
        row = kernel @ legendre.legvander(2 * s - 1, Q - 2)
        if i < len(t):
            past[i] = row
        else:
            expected[: Q - 1, Q - 1] = expected[Q - 1, : Q - 1] = row
    half = (basis * w[:, None]).T @ past
    expected[: Q - 1, : Q - 1] = half + half.T
    expected[Q - 1, Q - 1] = -math.expm1(-2 * z)
    rows = np.array([facts(column) for column in spread(z).T]).T
    size = np.sqrt(np.diag(expected))
    np.testing.assert_allclose((rows @ rows.T - expected) / np.outer(size, size), 0.0, atol=1e-9)


def windows_against_exact(taus, lengths):
    """Errors of the covariance of noise (lag 1), of lags behind it and of an integral at the end.

    Both covariances are exact figures; the errors are in deviations of each signal.
    """
    n = len(taus) + 2
    a, intensity = np.diag([-1.0, *(-1 / tau for tau in taus), 0.0]), np.zeros((n, n))
    for i, tau in enumerate(taus):
        a[i + 1, i] = 1 / tau
    a[n - 1, n - 2], intensity[0, 0] = 1.0, 2.0
    found = np.zeros((n, n))
    for length in lengths:
        laws = [law(1 / tau, 1 / tau, length) for tau in (1.0, *taus)] + [law(0.0, 1.0, length)]
        signal, ends = np.zeros((Q, n + Q)), np.empty((n, n + Q))
        for i, (decay, weights) in enumerate(laws):
            signal = weights @ signal if i else np.hstack([np.zeros((Q, n)), spread(length)])
            signal[:, i] += decay
            ends[i] = signal[-1]
        found = ends[:, :n] @ found @ ends[:, :n].T + ends[:, n:] @ ends[:, n:].T
    exact = noise_covariance(a, intensity, sum(lengths))
    size = np.sqrt(np.diag(exact))
    return (found - exact) / np.outer(size, size)


@pytest.mark.parametrize(
    "lengths", [[300.0], [0.3] * 20, [2.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 900.0, 5.0]]
)
def test_noise_and_its_integral_are_exact_together(lengths):
    np.testing.assert_allclose(windows_against_exact([], lengths), 0.0, atol=1e-11)


@pytest.mark.parametrize(("depth", "bound"), [(1, 5e-4), (2, 1.5e-3), (4, 1.5e-3), (6, 1.2e-2)])
def test_what_lags_make_of_noise_is_right_behind_a_tail(depth, bound):
    for before in ([100.0] * 3, [40.0, TAIL_LAGS] * 3 + [40.0], [1000.0]):
        errors = windows_against_exact([1.0] * depth, [*before, TAIL_LAGS])
        assert np.max(np.abs(errors)) < bound
        assert abs(errors[-1, -1]) < 1e-5  # of the integral, also through long windows
    # So that it can fail: without a tail.
    assert np.max(np.abs(windows_against_exact([1.0] * depth, [100.0] * 4))) > 0.03


def test_a_much_shorter_lag_passes_noise_and_a_longer_one_averages_it():
    assert np.max(np.abs(windows_against_exact([0.01], [100.0, TAIL_LAGS]))) < 0.01
    assert np.max(np.abs(windows_against_exact([0.1], [100.0, TAIL_LAGS, 0.1 * TAIL_LAGS]))) < 1e-3
    assert np.max(np.abs(windows_against_exact([3000.0], [100.0, TAIL_LAGS]))) < 1e-6
