"""A machine faster than real time: its own lags and times matter more, everything else is the same."""

from dataclasses import replace

import numpy as np
import pytest

import hybrid
from hybrid import parse_patch
from hybrid.errors import PatchError
from hybrid.shipped import shipped_patches


def with_scale(text, scale):
    return text.replace("\nparameters:", f"\ntime_scale: {scale}\nparameters:", 1)


def shipped(name):
    return shipped_patches()[name].read_text(encoding="utf-8")


SCALE = 8  # a power of two, so that the products are exact

HYBRID = """
title: Everything that takes the machine time
parameters: {tau: 1 us, conversion: 10 us, skew: 5 us, compute: 0.2 ms, speed: 1}
machine: {preset: lags, tau: tau}
time_scale: speed
analog:
  x: {integrate: {y: 10 1/s}, initial: 0.5, full_scale: 1}
  y: {integrate: {push: 10 1/s}, initial: 0, full_scale: 1}
interface:
  x_in: {adc: x, conversion_time: conversion}
  y_in: {adc: y, conversion_time: conversion, channel: 1}
  push: {dac: word, full_scale: 2, initial: 0}
digital: {period: 10 ms, compute_time: compute, skew: skew, program: {word: -x_in - 0.1 * y_in}}
run: {until: 1 s}
"""


@pytest.mark.parametrize("nonlinear", [False, True])
def test_a_scaled_machine_is_one_with_longer_times_to_the_last_bit(nonlinear):
    text = HYBRID
    if nonlinear:
        text = text.replace("interface:", "  size: {absolute: x, full_scale: 1}\ninterface:")
    patch, times = parse_patch(text), ("tau", "conversion", "skew", "compute")
    fast = hybrid.run(patch, {"speed": float(SCALE)})
    slow = {name: hybrid.run(patch).machine.parameters[name] * SCALE for name in times}
    long = hybrid.run(patch, slow)
    np.testing.assert_array_equal(fast.rows, long.rows)
    assert not np.array_equal(fast.rows, hybrid.run(patch).rows)
    if not nonlinear:
        found, expected = (
            hybrid.predict(patch, p).to_dicts() for p in ({"speed": float(SCALE)}, slow)
        )
        assert found == expected


def test_the_all_analog_loop_has_the_lags_of_the_scale():
    """Eq. 2.3: zeta = -1/2 omega_p sum(tau), so k times as much where the machine is k times as fast."""
    patch = parse_patch(with_scale(shipped("pitch_loop_analog"), SCALE))
    plain = parse_patch(shipped("pitch_loop_analog"))
    found = hybrid.predict(patch, machine="lags")
    (mode,), (form,) = found.modes, found.closed_forms
    expected = hybrid.predict(plain, {"tau": SCALE * 1e-6}).to_dicts()[0]
    assert mode.zeta == pytest.approx(expected["zeta"], rel=1e-12)
    lags = 1e-6 * SCALE * sum(1 for s in found.machine.stages.values() if s.tau > 0)
    first_order = -0.5 * found.machine.parameters["omega_p"] * lags
    # What the closed form leaves out is of the order of the lags once more.
    assert form.zeta == pytest.approx(first_order, rel=0.01)
    assert mode.zeta == pytest.approx(first_order, rel=0.01)


def test_the_scale_is_swept_and_said(capsys):
    patch = parse_patch(HYBRID)
    points = hybrid.sweep(patch, "speed", [1.0, 2.0, 4.0], jobs=1)
    assert all(point.status == "complete" for point in points.points)
    zeta = points.dataset["predicted_zeta"].values[:, 0]
    assert zeta[0] > zeta[1] > zeta[2]  # more lag, less damping
    assert "4 times real time" in hybrid.check(patch, {"speed": 4.0}).events
    assert hybrid.check(patch).to_dict()["time_scale"] == 1.0


def test_the_machine_option_keeps_the_scale():
    patch = parse_patch(HYBRID.replace("time_scale: speed", "time_scale: 4"))
    machine = hybrid.run(patch, machine="lags").machine
    assert machine.time_scale == 4.0
    assert machine.stages["x"].tau == 4e-6


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ("0", "must be greater than 0"),
        ("-1", "must be greater than 0"),
        ("1e12", "must be from 1e-09 to 1e\\+09"),
        ("2 s", "must be a pure number"),
        ("fast", "unknown parameter 'fast'"),
        ("1e-9", "below a femtosecond"),
    ],
)
def test_mistakes(wrong, says):
    text = HYBRID.replace("time_scale: speed", f"time_scale: {wrong}").replace(
        "tau: 1 us", "tau: 1 ns"
    )
    with pytest.raises(PatchError, match=says):
        hybrid.check(parse_patch(text))


def test_a_compute_time_that_is_not_given_stays_one_period():
    patch = parse_patch(HYBRID.replace("compute_time: compute, ", ""))
    machine = hybrid.run(patch, {"speed": 2.0}).machine
    assert machine.timing.compute == machine.timing.period
    assert replace(machine.timing, compute=0).period == 10**13
