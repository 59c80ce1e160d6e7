"""Leaks that a machine's serial number draws: as an error of integrators, not as the patch's own."""

import math

import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.machines import PRESETS

PATCH = """
title: Two integrators
machine: {preset: ideal, leak_limit: 40 1/s, saturation: SATURATION}
analog:
  x: {integrate: {one: 0 1/s}, initial: 0.9, full_scale: 1}
  y: {integrate: {x: 2 1/s}, initial: 0.2, leak: 5 1/s, leak_limit: 0 1/s, full_scale: 1}
  one: {constant: 1, full_scale: 1}
run: {until: 50 ms, every: 5 ms}
"""
LINEAR, SATURATING = PATCH.replace(", saturation: SATURATION", ""), PATCH.replace("SATURATION", "2")


@pytest.mark.parametrize("text", [LINEAR, SATURATING], ids=["exact", "nonlinear"])
def test_a_drawn_leak_is_that_of_the_serial_number(text):
    """x falls as exp(-l t), l drawn up to 40; y' = 2 x - 5 y, its own limit being 0:
    y = 0.2 e^(-5 t) + 1.8 (e^(-l t) - e^(-5 t)) / (5 - l)."""
    patch = hybrid.parse_patch(text)
    for serial in (1, 2):
        leak = compile_patch(patch, serial=serial).stages["x"].leak
        record = hybrid.run(patch, serial=serial).record
        t = record["time"].values
        assert 0.0 < leak < 40.0
        for i in range(len(t)):
            fall, own = math.exp(-leak * t[i]), math.exp(-5.0 * t[i])
            assert record["x"].values[i] == pytest.approx(0.9 * fall, abs=1e-9)
            y = 0.2 * own + 1.8 * (fall - own) / (5.0 - leak)
            assert record["y"].values[i] == pytest.approx(y, abs=1e-9)


def test_leaks_fill_their_limit():
    """Uniform from 0 on: the mean of 120 draws is 1/2 within 4 standard errors, 4 / sqrt(12 * 120), and
    the largest passes 0.9 with probability 1 - 0.9^120 = 1 - 3e-6."""
    patch = hybrid.parse_patch(LINEAR.replace("ideal, leak_limit: 40 1/s", "analog_thing"))
    limit = PRESETS["analog_thing"].leak_limit
    stages = [compile_patch(patch, serial=serial).stages for serial in range(120)]
    drawn = [found["x"].leak / limit for found in stages]
    assert 0.9 < max(drawn) <= 1.0 and min(drawn) >= 0.0
    assert sum(drawn) / len(drawn) == pytest.approx(0.5, abs=4 / math.sqrt(12 * 120))
    assert {found[name].leak for found in stages for name in ("y", "one")} == {0.0}


def test_the_table_top_machine_leaks_by_its_capacitors():
    """The insulation of 3000 Mohm beside an input of 1 Mohm."""
    assert PRESETS["analog_thing"].leak_limit == pytest.approx(1e6 / 3000e6, rel=0.02)


def test_the_prediction_tells_the_leak_from_the_ideal():
    """Of x' = -l x the exact pole is -l, the ideal one 0."""
    patch = hybrid.parse_patch(LINEAR)
    leak = compile_patch(patch, serial=3).stages["x"].leak
    rates = sorted(mode.s.real for mode in hybrid.predict(patch, serial=3).modes)
    assert rates == pytest.approx(sorted([-leak, -5.0]), rel=1e-12)


@pytest.mark.parametrize("text", [LINEAR, SATURATING], ids=["exact", "nonlinear"])
def test_the_rate_test_allows_for_it(text):
    """By hand x stands; with its leak, up to 40 * 0.9 a second are explained, and l * 0.9 is shown. The
    mean over an interval of h = 1e-4 / 36 s or less bends by l h, which carrying it back leaves out."""
    patch = hybrid.parse_patch(text)
    leak = compile_patch(patch, serial=1).stages["x"].leak
    rows = {row.integrator: row for row in hybrid.check(patch, serial=1, trial=False).rates}
    assert rows["x"].expected_mu == 0.0
    assert rows["x"].rate_mu == pytest.approx(-0.9 * leak, rel=1e-12)
    assert rows["x"].shown_mu == pytest.approx(-0.9 * leak, rel=1e-5)
    assert rows["x"].allowed_mu == pytest.approx(36.0, rel=1e-3)
    assert not rows["x"].fails


def test_what_has_no_capacitor_has_no_leak():
    with pytest.raises(hybrid.PatchError, match="leak_limit"):
        hybrid.parse_patch(LINEAR.replace("{constant: 1,", "{constant: 1, leak_limit: 1 1/s,"))
    with pytest.raises(hybrid.PatchError, match="leak_limit"):
        hybrid.parse_patch(LINEAR.replace("leak_limit: 40 1/s", "leak_limit: -1 1/s")).bind()
