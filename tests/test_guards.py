"""What a part with corners compares is in machine units: a patch in nm, m or 100 km switches alike."""

import math
import re

import numpy as np
import pytest

import hybrid

SCALES = ["1e-9", "1", "1e5"]


def played(text, scale, **options):
    return hybrid.run(hybrid.parse_patch(text.replace("UNIT", scale)), **options)


BOUNCING = """
title: A constant force towards zero
machine: ideal
analog:
  x: {integrate: {v: 1000*UNIT}, initial: 0.2*UNIT, full_scale: UNIT}
  v: {integrate: {side: -1000}, initial: 0, full_scale: 1}
  side: {compare: {x: 1}, low: -0.5, high: 0.5, full_scale: 1}
run: {until: 51 ms, every: 0.25 ms}
"""


@pytest.mark.parametrize("engine", ["nonlinear", "reference"])
@pytest.mark.parametrize("scale", SCALES)
def test_a_relay_switches_at_the_same_times_in_any_unit(scale, engine):
    """x'' = -a sgn x, a = 5e5 full scales a second squared, from 0.2: v is a triangle of slope a / 1000
    with quarters of sqrt(2 0.2 / a) = 0.89 ms, 28 switchings in all.

    Where one is seen e = 1e-12 of full scale late, the energy a |x| + x'^2 / 2 = 0.2 a changes by 2 a e
    at most, a share of 10 e, and each half period of 1.8 ms after it by 5 e of it: 28^2 / 2 times 1.8 ms
    times 5 e are 3.5e-12 s, in which v changes by 1.8e-9. The reference is beyond by 2e-11 at worst, and
    its tolerance of 1e-10 of full scale in each of some 10 steps between switchings changes the energy
    by 1e-9 or 5e-9 of it: 28^2 / 2 times 1.8 ms times 2.5e-9 are 1.8e-9 s or 9e-7.
    """
    result = played(BOUNCING, scale, engine=engine)
    quarter_s, slope = math.sqrt(0.4 / 5e5), 500.0
    assert (result.status, result.status_note) == ("complete", "")
    at = (result.record["time"].values / quarter_s + 1.0) % 4.0
    triangle = quarter_s * slope * np.where(at < 2.0, 1.0 - at, at - 3.0)
    bound = 1.8e-9 if engine == "nonlinear" else 9e-7
    assert np.max(np.abs(result.record["v"].values - triangle)) < bound


ROUNDING = """
title: A difference that is nothing but rounding
machine: ideal
analog:
  s: {sine: 0.9*UNIT, omega: 1000, full_scale: UNIT}
  one: {coefficient: {s: 0.1}, full_scale: UNIT}
  two: {coefficient: {s: 0.2}, full_scale: UNIT}
  level: {compare: {one: 1, two: 1, s: -0.3}, low: -1, high: 1, full_scale: 1}
  y: {integrate: {level: 100}, initial: 0, full_scale: 10}
run: {until: 30 ms, every: 1 ms}
"""


@pytest.mark.parametrize("engine", ["nonlinear", "reference"])
@pytest.mark.parametrize("scale", SCALES)
def test_rounding_switches_nothing_in_any_unit(scale, engine):
    """0.1 s + 0.2 s - 0.3 s is 0: the comparator stays where it begins, and y falls by 100 a second."""
    result = played(ROUNDING, scale, engine=engine)
    expected = -100.0 * result.record["time"].values
    assert np.max(np.abs(result.record["y"].values - expected)) < 1e-12


SLIDING = """
title: A relay that slides
machine: MACHINE
analog:
  x: {integrate: {u: 1000}, initial: 0.05*UNIT, full_scale: UNIT}
  u: {compare: {x: -1}, high: 0.05*UNIT, low: -0.05*UNIT, full_scale: 0.05*UNIT}
run: {until: 3 ms, every: 1 ms}
"""


@pytest.mark.parametrize("scale", SCALES)
def test_what_chatters_does_so_in_any_unit(scale):
    """x reaches 0 at 1 ms. Without lags the run ends there. With two of 1 us it goes on and is told: the
    relay changes every pi us (harmonic balance, see test_windows) for 2 ms, within a quarter."""
    ended = played(SLIDING.replace("MACHINE", "ideal"), scale)
    assert ended.status == "stopped"
    assert ended.status_note == (
        "stopped at 0.001 s: u chatters: give it hysteresis, or what it drives a lag"
    )
    told = played(SLIDING.replace("MACHINE", "lags"), scale)
    found = re.fullmatch(r"u chatters from (\S+) s on, (\d+) changes as .*", told.status_note)
    assert float(found[1]) == pytest.approx(1e-3, abs=1e-5)
    assert int(found[2]) == pytest.approx(2e-3 / (math.pi * 1e-6), rel=0.25)


PARTS = """
title: Every part with corners
machine: MACHINE
analog:
  x: {sine: 0.9*UNIT, omega: 300, full_scale: UNIT}
  absolute: {absolute: x, full_scale: UNIT}
  limited: {limit: x, low: -0.3*UNIT, high: 0.5*UNIT, full_scale: UNIT}
  dead: {dead_zone: x, low: -0.2*UNIT, high: 0.4*UNIT, full_scale: UNIT}
  bent:
    function: x
    points: {-0.5*UNIT: 0.2*UNIT, 0*UNIT: -0.4*UNIT, 0.5*UNIT: 0.3*UNIT}
    rounding: 0.2*UNIT
    full_scale: UNIT
  gear: {backlash: x, width: 0.2*UNIT, full_scale: UNIT}
  side: {compare: {x: 1, dead: 0.5}, threshold: 0.1*UNIT, hysteresis: 0.2*UNIT, high: 1, full_scale: 1}
  either: {switch: [bent, gear], control: side, full_scale: UNIT}
  area: {integrate: {either: 100}, initial: 0, full_scale: UNIT}
run: {until: 50 ms, every: 0.4 ms}
"""


@pytest.mark.parametrize("machine", ["ideal", "lags"])
@pytest.mark.parametrize("scale", ["1e-9", "1e5"])
def test_parts_with_corners_do_the_same_in_any_unit(scale, machine):
    """Both runs are the truth but for what the engine says it may err by (windows are known to 1e-8)."""
    text = PARTS.replace("MACHINE", machine)
    one, other = played(text, "1"), played(text, scale)
    bound = 1e-8 + one.engine_error + other.engine_error
    for name in one.record.data_vars:
        unit = 1.0 if name == "side" else float(scale)
        change = other.record[name].values / unit - one.record[name].values
        assert np.max(np.abs(change)) < bound, name
