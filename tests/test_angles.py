"""atan2 at its cut: it jumps by a turn there, and is nowhere else than from -pi to pi."""

import numpy as np
import pytest

import hybrid

TURNING = """
title: Turning
machine: MACHINE
analog:
  y: {sine: 0.5, omega: 10 rad/s, phase: 0.3, full_scale: 1}
  x: {sine: 0.5, omega: 10 rad/s, phase: 0.3 + pi/2, full_scale: 1}
  angle: {atan2: [y, x], full_scale: 3.3}
  double: {sum: {angle: 1}, full_scale: 3.3}
run: {until: 0.4 s, every: 1 ms}
"""


def played(text, machine, **options):
    return hybrid.run(hybrid.parse_patch(text.replace("MACHINE", machine)), **options)


@pytest.mark.parametrize(
    ("machine", "lags", "engine", "turn"),
    [
        ("ideal", 0, "nonlinear", 1),
        ("ideal", 0, "nonlinear", -1),
        ("ideal", 0, "reference", -1),
        ("lags", 2, "nonlinear", 1),
        ("lags", 2, "nonlinear", -1),
        ("lags", 2, "reference", 1),
    ],
)
def test_an_angle_that_turns_through_its_cut_jumps(machine, lags, turn, engine):
    """angle = 10 t + 0.3, less 10 tau for each lag on the way: of x and y one, both alike, and its own.

    Rows lie 1e-4 s and more from the jump, a hundred lags.
    """
    text = TURNING.replace(
        "sine: 0.5, omega: 10 rad/s, phase: 0.3,",
        f"sine: {0.5 * turn}, omega: 10 rad/s, phase: 0.3,",
    )
    found = played(text, machine, engine=engine)
    assert (found.status, found.status_note, found.overloads) == ("complete", "", ())
    for name, more in (("angle", 0), ("double", lags // 2)):
        late_s = (lags + more) * 1e-6
        expected = turn * np.angle(np.exp(1j * (10 * (found.time_s - late_s) + 0.3)))
        off = np.abs(found.record[name].values - expected)[1:]  # lags begin settled
        assert np.max(off) < 2e-9, name
    assert np.ptp(found.record["angle"].values) > 5.0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "y", ["constant: 0", "sine: 0.001, omega: 100 rad/s", "step: -0.1, before: 0.1, at: 10 ms"]
)
def test_noise_at_the_cut_overloads_nothing(y, seed):
    """Noise of 1e-4 at a distance of 0.5 turns the angle by 3e-4 rad: 3.142 of 3.2 at most."""
    text = TURNING.replace("sine: 0.5, omega: 10 rad/s, phase: 0.3,", y + ",", 1)
    text = text.replace("sine: 0.5, omega: 10 rad/s, phase: 0.3 + pi/2", "constant: -0.5")
    text = text.replace("3.3", "3.2").replace("0.4 s", "50 ms")
    found = played(text, "nominal", seed=seed)
    assert (found.status, found.overloads) == ("complete", ())
    size = np.abs(found.record["angle"].values)
    assert np.max(np.abs(size - np.pi)) < (4e-3 if "constant" in y or "sine" in y else 0.3)


def test_an_angle_about_zero_is_smooth():
    """From -0.9 to 0.9 rad and back."""
    text = """
title: Swinging
machine: ideal
analog:
  y: {sine: 1, omega: 10 rad/s, full_scale: 2}
  x: {constant: 0.8, full_scale: 1}
  angle: {atan2: [y, x], full_scale: 1}
run: {until: 2 s, every: 10 ms}
"""
    found = played(text, "ideal")
    expected = np.arctan2(np.sin(10 * found.time_s), 0.8)
    assert np.max(np.abs(found.record["angle"].values - expected)) < 1e-9
    assert found.overloads == ()


JUMPING = """
title: What jumps
machine: MACHINE
analog:
  wave: {sine: 0.9, omega: 1000 rad/s, full_scale: 1}
  side: {compare: {wave: 1}, low: -0.99, high: 0.99, full_scale: 1}
  most: {constant: 0.99, full_scale: 1}
  least: {constant: -0.99, full_scale: 1}
  chosen: {switch: [most, least], control: side, full_scale: 1}
  turned: {invert: chosen, full_scale: 1}
run: {until: 50 ms, every: 1 ms}
"""


@pytest.mark.parametrize("machine", ["ideal", "lags", "nominal"])
def test_what_jumps_between_two_levels_is_never_beyond_them(machine):
    """Noise and offsets of 1e-4 leave 0.99 a hundred deviations of room."""
    found = played(JUMPING, machine)
    assert (found.status, found.overloads) == ("complete", ())
