"""Errors of a transient whose noise enters the mode itself, against the scatter of an ensemble."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.readout import measure_transient

RUNS = 120


def kicked_mode(
    rng: np.random.Generator, omega: float, zeta: float, rows: int, kick: float, noise: float
) -> np.ndarray:
    """A mode sampled every 1 s whose complex amplitude is kicked at every row, with row noise."""
    s = complex(-zeta * omega, omega * np.sqrt(1.0 - zeta * zeta))
    amplitude = np.empty(rows, dtype=complex)
    kicks = kick * (rng.standard_normal(rows) + 1j * rng.standard_normal(rows))
    amplitude[0] = 1.0
    step = np.exp(s)
    for k in range(1, rows):
        amplitude[k] = step * amplitude[k - 1] + kicks[k]
    return amplitude.real + noise * rng.standard_normal(rows)


@pytest.mark.parametrize("zeta", [0.0, 0.002, -0.002])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_stated_error_matches_the_scatter(zeta: float, noise: float) -> None:
    # 64 cycles of 31 rows; the walk changes the amplitude by 1e-4 sqrt(2000) = 0.4 %.
    omega, rows, kick = 0.2, 2000, 1e-4
    rng = np.random.default_rng(7)
    found = [
        measure_transient(kicked_mode(rng, omega, zeta, rows, kick, noise), 1.0)
        for _ in range(RUNS)
    ]
    assert all(not f.reason for f in found)
    for quantity, truth in (("omega", omega), ("zeta", zeta)):
        values = np.array([getattr(f, quantity) for f in found])
        errors = np.array([getattr(f, quantity + "_error") for f in found])
        scatter = values.std(ddof=1)
        assert abs(values.mean() - truth) < 4.0 * scatter / np.sqrt(RUNS)
        # The strength of a walk comes from some forty numbers: 11 % of its error, run by run; the
        # scatter itself is good to 6 %.
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(scatter, rel=0.35)


def test_independent_rows_would_understate_it() -> None:
    # With rows of 2e-3 noise and no walk the omega error is sqrt(24) * 2e-3 / rows^1.5; the kicks
    # make the scatter several times that, and the stated error must follow.
    rng = np.random.default_rng(3)
    white = np.sqrt(24.0) * 2e-3 / 2000**1.5
    errors = [
        measure_transient(kicked_mode(rng, 0.2, 0.0, 2000, 2e-4, 2e-3), 1.0).omega_error
        for _ in range(20)
    ]
    # Slope of a walk: variance (6/5) kick^2 / rows.
    walk = np.sqrt(1.2 * 2e-4**2 / 2000)
    assert walk > 2.0 * white
    assert float(np.median(errors)) == pytest.approx(walk, rel=0.5)
