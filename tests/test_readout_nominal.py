"""Stated errors of a transient against the engine's own noisy records, whose modes are known exactly."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hybrid
from hybrid.arguments import machine_of
from hybrid.readout import measure_transient

SEEDS = 150
SERIAL = 1
# A standard deviation of SEEDS normal deviates is uncertain by this share; 3 of them are allowed.
SAMPLING = 3.0 / math.sqrt(2.0 * SEEDS)
SMALLEST, LARGEST = 0.7, 1.3  # standard deviation of (measured - exact) / stated error
BEYOND_3 = 0.03  # share beyond three stated errors


@pytest.mark.parametrize(
    ("patch", "parameters"),
    [
        # A walk of the amplitude that doubles the error but cannot be told from noise; one that is
        # seen in every second record; one of three cycles; one that cannot be missed.
        ("pitch_loop_analog", {}),
        ("pitch_loop_analog", {"omega_p": 100.0}),
        ("pitch_loop", {"omega_p": 2.0}),
        ("pitch_loop_lead", {"cycle": "5 ms"}),
    ],
)
def test_deviations_from_the_exact_mode_are_as_large_as_stated(
    patch: str, parameters: dict[str, float | str]
) -> None:
    machine = machine_of(patch, parameters, "nominal", SERIAL)
    (exact,) = hybrid.predict(machine).modes
    found = [
        hybrid.run(machine, seed=seed, readouts_only=True).readouts["pitch_mode"]
        for seed in range(SEEDS)
    ]
    for quantity in ("zeta", "omega"):
        off = np.array(
            [(f[quantity] - getattr(exact, quantity)) / f[f"{quantity}_error"] for f in found]
        )
        assert SMALLEST * (1.0 - SAMPLING) < off.std(ddof=1) < LARGEST * (1.0 + SAMPLING), quantity
        most = SEEDS * BEYOND_3 + 3.0 * math.sqrt(SEEDS * BEYOND_3)
        assert np.count_nonzero(np.abs(off) > 3.0) <= most, quantity


def white_noise_factor(zeta: float, omega: float, rows: int) -> float:
    """Mean stated error of zeta for noise of the rows alone, relative to the scatter."""
    rng = np.random.default_rng(5)
    t = np.arange(rows)
    clean = np.exp(-zeta * omega * t) * np.cos(omega * math.sqrt(1.0 - zeta * zeta) * t)
    found = [measure_transient(clean + 1e-3 * rng.standard_normal(rows), 1.0) for _ in range(SEEDS)]
    scatter = float(np.std([f.zeta for f in found], ddof=1))
    return float(np.mean([f.zeta_error for f in found])) / scatter


@pytest.mark.parametrize("cycles", [3.2, 16.0, 100.0])
def test_doubt_whether_there_is_a_walk_costs_less_than_a_factor_of_two(cycles: float) -> None:
    # The scatter is uncertain by 6 %, the mean of errors that vary by 0.7 of their mean likewise.
    factor = white_noise_factor(0.0, 2.0 * math.pi * cycles / 2000, 2000)
    assert 1.2 < factor < 2.0 * 1.2
