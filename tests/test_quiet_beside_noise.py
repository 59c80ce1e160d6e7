"""Parts that no noise reaches keep their accuracy where other parts of the same machine are loud.

With noise, windows are resolved to a thousandth of the largest one only; what that leaves inside of them
must not add up at their ends, nor move the instants at which quiet parts switch.
"""

import numpy as np
import pytest

import hybrid

OMEGA, LENGTH_S = 1000.0, 0.1
BESIDE = """
title: A quiet oscillator, a comparator on it and a loud integrator
machine: ideal
parameters: {loud: 0.1}
analog:
  p: {integrate: {q: 1000}, initial: 0, full_scale: 1.5}
  q: {integrate: {p: -1000}, initial: 1, full_scale: 1.5}
  up: {compare: {p: 1}, high: 1, low: -1, full_scale: 1}
  way: {integrate: {up: 1000}, initial: 0, full_scale: 5}
  square: {multiply: [p, p], full_scale: 2}
  noisy: {integrate: {square: 1}, initial: 0, full_scale: 1, tau: 1 us, noise: loud}
run: {until: 100 ms, every: 0.1 ms}
record: [p, q, way, noisy]
"""


@pytest.mark.parametrize("loud", [1e-4, 0.1])
def test_quiet_parts_stay_as_exact_as_without_noise(loud):
    """sin, cos, and the integral of the sign of the sine, a triangle from 0 to pi and back: each window
    is resolved to 1e-4 of full scale beside noise of 0.1, its end by the square of that or better; to
    1e-7 of full scale, as the engine promises, over 1,000 windows and 31 switchings."""
    record = hybrid.run(hybrid.parse_patch(BESIDE), {"loud": loud}).record
    phase = OMEGA * record["time"].values
    fold = np.mod(phase, 2 * np.pi)
    triangle = np.where(fold < np.pi, fold, 2 * np.pi - fold)
    assert abs(record["p"].values - np.sin(phase)).max() < 1.5e-7
    assert abs(record["q"].values - np.cos(phase)).max() < 1.5e-7
    assert abs(record["way"].values - triangle).max() < 5e-7
    assert np.std(record["noisy"].values - phase / 2e3 + np.sin(2 * phase) / 4e3) > 0.5 * loud
