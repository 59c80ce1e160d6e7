"""Coefficients as a dial sets them."""

import numpy as np
import pytest

import hybrid
from hybrid import parse_patch
from hybrid.errors import PatchError
from hybrid.potentiometers import dialled, setting_of


@pytest.mark.parametrize(
    ("coefficient", "setting", "gain", "to_four_digits"),
    [
        (0.123456, 0.123456, 1, 0.1235),
        (-0.123456, 0.123456, 1, -0.1235),
        (1.0, 1.0, 1, 1.0),
        (10.0, 1.0, 10, 10.0),
        (3.14159265, 0.314159265, 10, 3.142),
        (999.99, 0.99999, 1000, 1000.0),
        (4e-5, 4e-5, 1, 0.0),
        (0.0, 0.0, 1, 0.0),
    ],
)
def test_a_setting_and_its_dial(coefficient, setting, gain, to_four_digits):
    found, power = setting_of(coefficient)
    assert (found, power) == (pytest.approx(setting, rel=1e-15), gain)
    assert dialled(coefficient, 1e-4) == pytest.approx(to_four_digits, rel=1e-12)
    assert dialled(coefficient, 0.0) == coefficient


def test_a_setting_on_the_dial_is_left_as_it_is_to_the_last_bit():
    for steps in range(1, 10000, 7):
        coefficient = steps * 1e-4 * 100
        assert dialled(coefficient, 1e-4) == coefficient


TEXT = """
title: Dials
machine: {{preset: ideal, pot_resolution: {dial}}}
analog:
  r: {{constant: {r}, full_scale: 2}}
  s: {{step: {s}, before: {b}, at: 5 ms, full_scale: 2}}
  x: {{integrate: {{y: {xy}, r: {xr}, s: 1}}, initial: {x0}, full_scale: 4, leak: {leak}}}
  y: {{integrate: {{z: {yz}}}, initial: {y0}, full_scale: 3}}
  z: {{sum: {{x: {zx}, r: 0.25}}, full_scale: 5}}
{more}
run: {{until: 20 ms, every: 1 ms}}
"""
# In machine units: r 0.1234567, s 0.3333 and 0.0500, x: y * 3/4, r * 2/4, s * 2/4, x0 / 4, y: z * 5/3,
# y0 / 3, z: x * 4/5, r * 2/5 * 0.25 = 0.1.
GIVEN = {
    "r": 0.2469134,
    "s": 0.66666,
    "b": 0.1000123,
    "xy": 123.456789,  # 92.59259 -> 0.9259 x 100
    "xr": 33.3333333,  # 16.66667 -> 0.1667 x 100
    "x0": 1.2345678,  # 0.30864 -> 0.3086
    "leak": 7.77777,  # 0.777777 x 10 -> 0.7778 x 10
    "yz": -98.7654321,  # 164.60905 -> 0.1646 x 1000
    "y0": 1.0,  # 0.33333 -> 0.3333
    "zx": -0.54321,  # 0.434568 -> 0.4346
}
BY_HAND = {
    "r": 2 * 0.1235,
    "s": 2 * 0.3333,
    "b": 2 * 0.0500,
    "xy": 92.59 * 4 / 3,
    "xr": 16.67 * 4 / 2,
    "x0": 4 * 0.3086,
    "leak": 7.778,
    "yz": -164.6 * 3 / 5,
    "y0": 3 * 0.3333,
    "zx": -0.4346 * 5 / 4,
}


@pytest.mark.parametrize("more", ["", "  a: {absolute: x, full_scale: 4}"])
def test_a_machine_with_dials_is_the_patch_rounded_by_hand(more):
    def rows(dial, figures):
        return hybrid.run(parse_patch(TEXT.format(dial=dial, more=more, **figures))).rows

    found, expected = rows("1e-4", GIVEN), rows("0", BY_HAND)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 if not more else 1e-9)
    assert np.max(np.abs(found - rows("0", GIVEN))) > 1e-4


def test_the_sheet_shows_what_is_set():
    check = hybrid.check(parse_patch(TEXT.format(dial="1e-4", more="", **GIVEN)))
    settings = {(p.component, p.input): p.setting for p in check.pots}
    assert settings["x", "y"] == pytest.approx(0.9259, abs=1e-12)
    assert settings["x", "(itself)"] == pytest.approx(0.7778, abs=1e-12)
    assert settings["y", "(initial)"] == pytest.approx(0.3333, abs=1e-12)
    assert settings["z", "r"] == pytest.approx(0.1, abs=1e-12)


def test_another_machine_has_other_dials():
    patch = parse_patch(TEXT.format(dial="1e-4", more="", **GIVEN))
    plain = parse_patch(TEXT.format(dial="0", more="", **GIVEN))
    found, expected = (hybrid.run(p, machine="ideal").rows for p in (patch, plain))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [("-1e-4", "must be 0 or greater"), ("0.5", "at most 0.1"), ("1 ms", "must be a pure number")],
)
def test_mistakes(wrong, says):
    with pytest.raises(PatchError, match=says):
        hybrid.check(parse_patch(TEXT.format(dial=wrong, more="", **GIVEN)))


@pytest.mark.parametrize("phase", ["0 rad", "4 rad"])
def test_the_reference_of_a_square_wave_has_the_sign_of_its_amplitude(phase):
    """Whichever half comes first: 0.4 V of 1 V is 0.4, inverted only where the amplitude is."""
    for amplitude, inverted in (("0.4 V", False), ("-0.4 V", True)):
        source = f"{{square: {amplitude}, period: 1 s, phase: {phase}, full_scale: 1 V}}"
        text = f"title: a\nanalog: {{x: {source}}}\nrun: {{until: 1 s, every: 0.1 s}}\n"
        (pot,) = hybrid.check(hybrid.parse_patch(text), trial=False).pots
        assert (pot.input, pot.setting, pot.inverted) == ("(reference)", 0.4, inverted)
