"""The loop's equations as matrices: theta'' = held answer, with or without five lags.

The answer to the sample of alpha at nT, -omega_p^2 alpha, is held from (n+1)T to (n+2)T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

Floats = npt.NDArray[np.float64]

# Slow against the cycle, so that a growing oscillation stays within full scale for a long run.
OMEGA_P, PERIOD_S, THETA_0 = 1.0, 1e-3, 0.1
LAG_S, NOISE, BITS = 1e-6, 1e-4, 14  # of the nominal machine
STEP = 1.0 / (2 ** (BITS - 1) - 1)


@dataclass(frozen=True)
class Plant:
    """x' = A x + b held + diag(noise) * unit white noise; theta is x[0], alpha is x[alpha]."""

    a: Floats
    b: Floats
    start: Floats
    noise: Floats
    alpha: int


def plant(lagged: bool) -> Plant:
    """The analog side: two integrators, or all five elements with a lag each."""
    if not lagged:
        a = np.array([[0.0, 1.0], [0.0, 0.0]])
        return Plant(a, np.array([0.0, 1.0]), np.array([THETA_0, 0.0]), np.zeros(2), 0)
    theta, dac, theta_ddot, rate_core, rate, theta_core, alpha = range(7)
    a, b, start, noise = np.zeros((7, 7)), np.zeros(7), np.zeros(7), np.zeros(7)
    a[rate_core, theta_ddot] = a[theta_core, rate] = 1.0
    for output, source in (
        (theta_ddot, dac),
        (rate, rate_core),
        (theta, theta_core),
        (alpha, theta),
    ):
        a[output, source] = 1.0 / LAG_S
    outputs = [dac, theta_ddot, rate, theta, alpha]
    a[outputs, outputs] = -1.0 / LAG_S
    b[dac] = 1.0 / LAG_S
    start[[theta, theta_core, alpha]] = THETA_0
    noise[outputs] = NOISE * np.sqrt(2.0 / LAG_S)
    return Plant(a, b, start, noise, alpha)


def propagator(loop: Plant, period_s: float) -> tuple[Floats, Floats]:
    """Exact Phi and gamma of one cycle: x(next) = Phi x + gamma held."""
    n = len(loop.a)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = loop.a, loop.b
    both = expm(block * period_s)
    return both[:n, :n].copy(), both[:n, n].copy()


def noise_spread(loop: Plant, period_s: float) -> Floats:
    """A root of the covariance that the white noise leaves after a cycle.

    Van Loan's block exponential over T / 2^10, about one lag, then doubled: over the whole cycle it
    would overflow.
    """
    a, n, doublings = loop.a, len(loop.a), 10
    block = np.block([[-a, np.diag(loop.noise**2)], [np.zeros((n, n)), a.T]])
    both = expm(block * period_s / 2**doublings)
    step = both[n:, n:].T
    covariance = step @ both[:n, n:]
    for _ in range(doublings):
        covariance, step = covariance + step @ covariance @ step.T, step @ step
    variances, axes = np.linalg.eigh(covariance)
    return axes * np.sqrt(np.maximum(variances, 0.0))
