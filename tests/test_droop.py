"""A track-store that leaks lets what it holds fall as exp(-leak t), in every engine."""

import math

import numpy as np
import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.machines import PRESETS
from hybrid.stepwise import stepwise_signals

LEAK = 40.0
STORES = """
title: Stores that droop
machine: {preset: ideal}
parameters: {leak: 40 1/s, lag: 0 s}
analog:
  v: {sine: 0.8 V, omega: 100 rad/s, full_scale: 1 V}
  gate: {pulse: 1, at: 10 ms, width: 5 ms, period: 25 ms, full_scale: 1}
  late: {compare: {gate: 1}, threshold: 0.5, high: 1 V, full_scale: 1 V}
  by_source: {track: v, control: gate, leak: leak, initial: 0.5 V, full_scale: 2 V, tau: lag}
  by_comparator: {track: v, control: late, leak: leak, initial: 0.5 V, full_scale: 2 V, tau: lag}
  tight: {track: v, control: gate, full_scale: 2 V}
run: {until: 50 ms, every: 1 ms}
"""


def expected(t, leak):
    """0.5 V from 0 on, the sine in the gate, then what it was at the gate's end."""
    in_gate = [(0.010, 0.015), (0.035, 0.040)]
    if any(a <= t < b for a, b in in_gate):
        return 0.8 * math.sin(100 * t)
    ends = [b for _, b in in_gate if b <= t]
    since = ends[-1] if ends else 0.0
    first = 0.8 * math.sin(100 * since) if ends else 0.5
    return first * math.exp(-leak * (t - since))


@pytest.mark.parametrize(("engine", "bound"), [("nonlinear", 1e-9), ("reference", 1e-8)])
@pytest.mark.parametrize("lag_s", [0.0, 1e-6])
def test_a_store_droops_as_theory_says(engine, bound, lag_s):
    """Behind a lag an exponential is 1 / (1 - leak tau) times as large once the lag has settled."""
    record = hybrid.run(hybrid.parse_patch(STORES), {"lag": lag_s}, engine=engine).record
    t = record["time"].values
    # At an edge and in the gate a lag shows its own error, here without interest.
    holds = [i for i in range(1, 51) if i % 25 not in (10, 11, 12, 13, 14, 15)]
    larger = 1.0 / (1.0 - LEAK * lag_s)
    for name in ("by_source", "by_comparator"):
        values = record[name].values
        for i in holds:
            assert values[i] == pytest.approx(larger * expected(t[i], LEAK), abs=bound), (name, i)
    tight = record["tight"].values
    assert np.ptp(tight[15:35]) < 1e-12
    assert tight[20] == pytest.approx(0.8 * math.sin(1.5), abs=1e-9)


def test_what_droops_is_not_drawn_as_steps():
    machine = compile_patch(hybrid.parse_patch(STORES.replace("track: v", "track: late")))
    assert {"tight"} == stepwise_signals(machine) & {"tight", "by_source", "by_comparator"}


def test_a_machine_may_leak_through_all_of_its_stores():
    """The serial number draws a leak of up to 30 1/s beside the one that is given."""
    text = STORES.replace("{preset: ideal}", "{preset: ideal, leak_limit: 30 1/s}")
    patch = hybrid.parse_patch(text)
    stages = compile_patch(patch, serial=2).stages
    assert 0.0 < stages["tight"].leak < 30.0 and stages["tight"].leak != stages["by_source"].leak
    record = hybrid.run(patch, serial=2).record
    fall = record["tight"].values[30] / record["tight"].values[16]
    assert fall == pytest.approx(math.exp(-stages["tight"].leak * 14e-3), abs=1e-9)
    own = record["by_source"].values[30] / record["by_source"].values[16]
    assert own == pytest.approx(math.exp(-(LEAK + stages["by_source"].leak) * 14e-3), abs=1e-9)
    limit = PRESETS["analog_thing"].leak_limit
    table_top = STORES.replace("{preset: ideal}", "analog_thing").replace("lag: 0 s", "lag: 1 us")
    stage = compile_patch(hybrid.parse_patch(table_top), serial=2).stages["tight"]
    assert stage.leak_limit == limit and 0.0 < stage.leak < limit


def test_a_store_droops_with_noise_in_it():
    """The mean over 40 runs, of noise of 1e-3 of 2 V each: 6 standard errors, 2e-3."""
    text = STORES.replace("{preset: ideal}", "{preset: nominal, tolerance: 0, noise: 1e-3}")
    text = text.replace("tau: lag}", "tau: 1 us}")
    rows = [
        hybrid.run(hybrid.parse_patch(text), seed=s).record["by_source"].values for s in range(40)
    ]
    mean = np.mean(rows, axis=0)
    for i in (20, 30, 45):
        assert mean[i] == pytest.approx(expected(i * 1e-3, LEAK), abs=2e-3)


def test_a_store_between_operations_droops_while_the_machine_resets():
    """Iterative operation: what OP leaves, 0.4 V, is kept over HOLD and IC, 2 ms, to the next OP."""
    text = """
title: Kept over a reset
machine: ideal
analog:
  one: {constant: 1 V, full_scale: 2 V}
  x: {integrate: {one: 100 1/s}, initial: 0 V, full_scale: 2 V}
  kept: {track: x, control: operating, leak: 50 1/s, full_scale: 2 V}
modes: {reset: 1 ms, operate: 4 ms, hold: 1 ms}
run: {until: 18 ms, every: 0.5 ms}
"""
    kept = hybrid.run(hybrid.parse_patch(text)).record["kept"].values
    for k in range(2):
        assert kept[12 * k + 13] == pytest.approx(0.4 * math.exp(-50 * 1.5e-3), abs=1e-9)


@pytest.mark.parametrize("wrong", ["leak: -1 1/s", "leak: 3 V", "leak_limit: -1 1/s"])
def test_a_leak_that_makes_no_sense_is_refused(wrong):
    text = STORES.replace("tight: {track: v,", f"tight: {{track: v, {wrong},")
    with pytest.raises(hybrid.PatchError, match="leak"):
        hybrid.run(hybrid.parse_patch(text))
