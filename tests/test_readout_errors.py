"""Stated errors of a transient beside a second mode, in coloured noise and near critical damping."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hybrid.readout import Transient, measure_transient

ROWS = 2000
N = np.arange(float(ROWS))
OMEGA = 2.0 * math.pi * 16.0 / ROWS  # 16 cycles


def deviations(found: list[Transient], zeta: float, omega: float) -> np.ndarray:
    """(2, records): those of zeta and of omega, in stated errors."""
    return np.array(
        [
            [(f.zeta - zeta) / f.zeta_error for f in found],
            [(f.omega - omega) / f.omega_error for f in found],
        ]
    )


# --- a second mode close by ------------------------------------------------------------------------


def beating(share: float, ratio: float, zeta: float, noise: float, records: int = 8) -> list:
    rng = np.random.default_rng(1)
    found = []
    for phase, other in rng.uniform(0.0, 2.0 * math.pi, (records, 2)):
        wave = np.cos(OMEGA * math.sqrt(1.0 - zeta * zeta) * N + phase)
        wave += share * np.cos(ratio * OMEGA * N + other)
        record = np.exp(-zeta * OMEGA * N) * wave + noise * rng.standard_normal(ROWS)
        found.append(measure_transient(record, 1.0))
    return found


@pytest.mark.parametrize("ratio", [0.95, 0.97, 1.002, 1.01, 1.02, 1.05])
@pytest.mark.parametrize(
    ("share", "zeta", "noise"), [(0.3, 0.0, 1e-5), (0.3, 0.01, 0.0), (0.03, 0.01, 1e-5)]
)
def test_second_mode_close_by_is_in_the_error_or_refused(
    share: float, zeta: float, noise: float, ratio: float
) -> None:
    """Where the beat lasts longer than the record, the fit takes its slope for a change of the pole: by
    share |ratio - 1| omega, to first order, of which the stated error must not be much less, nor
    many times more."""
    found = beating(share, ratio, zeta, noise)
    answered = [f for f in found if not f.reason]
    assert all("several" in f.reason for f in found if f.reason)
    if share < 0.3 or abs(ratio - 1.0) < 0.04:
        assert len(answered) > len(found) // 2
    if not answered:
        return
    off = deviations(answered, zeta, OMEGA)
    assert (np.sqrt(np.mean(off**2, axis=1)) < 1.6).all()
    assert np.abs(off).max() < 4.0
    if abs(ratio - 1.0) * 2.0 * math.pi * 16.0 < 2.0:
        errors = [math.hypot(f.zeta_error, f.omega_error / OMEGA) for f in answered]
        assert 0.5 < np.median(errors) / (share * abs(ratio - 1.0)) < 2.5


def test_beat_beneath_the_noise_is_no_reason_for_a_larger_error() -> None:
    """A second mode of a tenth of the noise moves the pole by less than noise does: nothing is added."""
    found = beating(1e-4, 1.02, 0.0, 1e-3, records=40)
    white = math.sqrt(24.0) * 1e-3 / ROWS**1.5 / OMEGA  # of zeta, from the slope of the amplitude
    assert 1.0 < np.median([f.zeta_error for f in found]) / white < 2.5
    assert np.sqrt(np.mean(deviations(found, 0.0, OMEGA) ** 2)) < 1.3


# --- coloured noise --------------------------------------------------------------------------------


def coloured(rng: np.random.Generator, memory: float, rows: int) -> np.ndarray:
    """Noise of variance 1 of which every row keeps `memory` of the last."""
    kicks = math.sqrt(1.0 - memory**2) * rng.standard_normal(rows)
    row = float(rng.standard_normal())
    noise = np.empty(rows)
    for k in range(rows):
        noise[k] = row = memory * row + kicks[k]
    return noise


@pytest.mark.parametrize(
    ("memory", "cycles", "decay"),
    [
        *((0.5, 16.0, 0.0), (0.8, 16.0, 0.0), (0.99, 16.0, 0.0), (-0.8, 16.0, 2.0)),
        *((0.9, 3.2, 0.0), (0.9, 100.0, 2.0)),
    ],
)
def test_coloured_noise_counts_by_what_it_has_at_the_frequency_of_the_mode(
    memory: float, cycles: float, decay: float
) -> None:
    """30 records: rms of deviation / stated error, which doubt of a walk may bring down to 0.3, and to
    less in few cycles of a mode that lies where the noise falls off.

    The error itself: a sinusoid sees noise of the density (1 - m^2) / |1 - m exp(-i omega)|^2 only.
    """
    rng = np.random.default_rng(2)
    damped = 2.0 * math.pi * cycles / ROWS
    sigma, size = -decay / ROWS, 3e-3
    omega = math.hypot(sigma, damped)
    found = [
        measure_transient(
            np.exp(sigma * N) * np.cos(damped * N + rng.uniform(0.0, 6.28))
            + size * coloured(rng, memory, ROWS),
            1.0,
        )
        for _ in range(30)
    ]
    assert not any(f.reason for f in found)
    off = np.sqrt(np.mean(deviations(found, -sigma / omega, omega) ** 2, axis=1))
    assert ((off > (0.2 if cycles < 10.0 else 0.28)) & (off < 1.3)).all(), off
    if decay == 0.0 and cycles > 10.0:
        density = (1.0 - memory**2) / abs(1.0 - memory * np.exp(-1j * omega)) ** 2
        least = math.sqrt(24.0 * density) * size / ROWS**1.5 / omega
        assert 0.8 < np.median([f.zeta_error for f in found]) / least < 4.0


# --- near critical damping -------------------------------------------------------------------------


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
