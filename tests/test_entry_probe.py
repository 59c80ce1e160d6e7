"""The entry probe on three machines, beside its equations written out and integrated tightly."""

from __future__ import annotations

import importlib
import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import hybrid
from hybrid.shipped import shipped_patches

ROWS = 20  # of the end of a flight, two seconds
DIGITAL = {"compute_time": 0.0}


@pytest.fixture
def bench(monkeypatch):
    """The module benches/three_ways.py, for its equations."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "benches"))
    return importlib.import_module("three_ways")


@cache
def flown(on: str | None, machine: str, formula: str = "ab2", **given: float):
    """The record of a flight of 15 s."""
    file = shipped_patches()["entry_probe"]
    text = file.read_text(encoding="utf-8").replace("integration: ab2", f"integration: {formula}")
    result = hybrid.run(hybrid.parse_patch(text, str(file), on), given, machine=machine)
    assert result.status == "complete" and not result.overloads
    return result.record


def errors(record, bench) -> tuple[float, float]:
    """Largest error of pitch (rad) and of height (m) in the last two seconds."""
    time = record["time"].values[-ROWS:]
    _, _, height, _, theta, _ = bench.exact()(time)
    pitch = record["rotation.theta"].values[-ROWS:] - theta
    return (
        float(np.abs(pitch).max()),
        float(np.abs(1e3 * record["translation.height"].values[-ROWS:] - height).max()),
    )


def test_the_header_tells_of_the_flight(bench) -> None:
    """From 45 km to 16 km, 4 to 27 rad/s; the amplitude falls as the root of the frequency."""
    time = np.linspace(0.0, bench.UNTIL_S, 3001)
    speed, path, height, density, theta, _ = bench.exact()(time)
    omega = np.sqrt(bench.stiffness(density, speed))
    assert height[-1] / 1e3 == pytest.approx(16.0, abs=0.5)
    assert (omega[0], omega.max()) == (pytest.approx(4.0, abs=0.2), pytest.approx(27.0, abs=0.5))
    swing = np.abs(theta - path)
    tops = [i for i in range(1, len(swing) - 1) if swing[i - 1] < swing[i] > swing[i + 1]]
    kept = swing[tops] * np.sqrt(omega[tops])
    # Damping takes off exp(-integral(zeta omega)), zeta omega = S rho V (l^2 CQ/8I + CL/4m) each.
    flow = density[tops] * speed[tops] * 0.5
    gone = np.concatenate([[0.0], np.cumsum(np.diff(time[tops]) * (flow[1:] + flow[:-1]) / 2)])
    left = kept[0] * np.exp(-gone * (0.2 / 8 / 100 + 2.0 / 4 / 500))
    # What the next order of the slow change leaves, (omega'/omega^2)^2 at the start: 0.15/4 of it.
    np.testing.assert_allclose(kept[3:], left[3:], rtol=0.05)
    assert left[-1] < 0.9 * kept[0]  # so damping is seen


@pytest.mark.parametrize(("formula", "cycle", "order"), [("ab2", 1e-3, 2), ("rk4", 10e-3, 4)])
def test_all_digital_it_errs_as_its_formula_does(bench, formula, cycle, order) -> None:
    pitch = [
        errors(flown("digital", "ideal", formula, **DIGITAL, cycle=c), bench)[0]
        for c in (2 * cycle, cycle)
    ]
    # The next term is smaller by omega T, 0.27 of it with 10 ms; the mean of two sizes, three halves.
    assert math.log2(pitch[0] / pitch[1]) == pytest.approx(order, abs=0.4)


@pytest.mark.parametrize(("given", "order"), [({}, 2), ({"lead": 0.0}, 1)])
def test_hybrid_it_errs_by_the_square_of_the_cycle_where_its_dacs_lead(bench, given, order) -> None:
    """Without a lead all that crosses is late by the compute time and half a cycle: first order."""
    pitch = [errors(flown(None, "ideal", cycle=c, **given), bench)[0] for c in (10e-3, 5e-3)]
    assert math.log2(pitch[0] / pitch[1]) == pytest.approx(order, abs=0.4)


def test_all_analog_it_is_its_equations(bench) -> None:
    """Signals are resolved to 1e-9 of full scale in a window, some thousands of windows."""
    record = flown("analog", "ideal")
    pitch, height = errors(record, bench)
    assert pitch < 1e-5 and height < 1e-5 * 50e3


def test_all_analog_lags_feed_the_swing_as_theory_says(bench) -> None:
    """zeta = -omega sum(tau)/2: the swing is exp(integral(omega^2) sum(tau)/2) times too large.

    Four lags of 1 us in the loop, at 100 times real time.
    """
    record = flown("analog", "lags", speed=100.0)
    time = record["time"].values[-ROWS:]
    theta = record["rotation.theta"].values[-ROWS:]
    right, omega, until = bench.last_swings()
    grown = 0.5 * 4e-6 * 100.0 * until
    swing = right[4] - right[1]
    # In phase with the swing. The lags of the path's own elements delay it by 100 us or so, which turns
    # the phase (27 rad/s of that) and changes the size in the second order.
    added = float(np.sum((theta - right[4]) * swing) / np.sum(swing**2))
    assert len(time) == len(omega)
    assert math.log1p(added) == pytest.approx(float(np.mean(grown)), rel=0.05)
