"""Stated errors of a transient near critical damping."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hybrid.readout import measure_transient


def response(zeta: float, omega: float, t: np.ndarray) -> np.ndarray:
    """x(0) = 1, x'(0) = 0."""
    root = np.emath.sqrt(zeta * zeta - 1.0) * omega or 1e-9
    wave = np.cosh(root * t) + zeta * omega * np.sinh(root * t) / root
    return np.exp(-zeta * omega * t) * wave.real


@pytest.mark.parametrize(
    ("zeta", "noise"),
    [(0.97, 1e-3), (0.999, 1e-3), (0.999, 1e-5), (1.0, 1e-5), (1.0, 1e-3), (1.001, 1e-3)],
)
def test_damped_frequency_near_critical_damping(zeta: float, noise: float) -> None:
    """omega_d^2 = omega^2 (1 - zeta^2) has a normal error; of its root, and of a root cut off at 0, no
    more than chance may lie beyond two stated errors: 4.6 % of 100, and three times the root of that.
    """
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, 1.5, 1000)
    clean = response(zeta, 10.0, t)
    found = [
        measure_transient(clean + noise * rng.standard_normal(len(t)), t[1]) for _ in range(100)
    ]
    assert not any(f.reason for f in found)
    truth = 10.0 * math.sqrt(max(0.0, 1.0 - zeta * zeta))
    off = np.array([(f.omega_damped - truth) / f.omega_damped_error for f in found])
    assert np.sqrt(np.mean(off**2)) < 1.2
    assert np.count_nonzero(np.abs(off) > 2.0) <= 4.6 + 3.0 * math.sqrt(4.6)
    errors = np.array([f.omega_damped_error for f in found])
    square_error = 200.0 * np.median([f.zeta_error for f in found])
    if abs(1.0 - zeta * zeta) * 100.0 < square_error:  # it may be 0: there is no sure digit
        assert errors.min() > 0.2 * math.sqrt(square_error)
    if zeta < 1.0 and off.std() > 0.5 and truth > 20.0 * errors.mean():  # far away: to first order
        assert np.median(errors) == pytest.approx(
            np.std([f.omega_damped for f in found]), rel=4.0 / math.sqrt(200.0)
        )
