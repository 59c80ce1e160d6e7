"""A leak lets an integrator fall as exp(-leak t), on either engine, with and without lag."""

import math

import numpy as np
import pytest

import hybrid

LEAKY = """
title: A leaky integrator
machine: ideal
parameters: {leak: 40 1/s, push: 3 V, start: 0.9 V, lag: 0 s}
analog:
  one: {constant: push, full_scale: 5 V, tau: 0}
  x: {integrate: {one: 2 1/s}, leak: leak, initial: start, full_scale: 1 V, tau: lag}
  free: {integrate: {one: 0 1/s}, leak: leak, initial: start, full_scale: 1 V, tau: lag}
run: {until: 100 ms, every: 5 ms}
record: [x, free]
"""
LEAK, END, START = 40.0, 2.0 * 3.0 / 40.0, 0.9


@pytest.mark.parametrize("lag_s", [0.0, 1e-6])
@pytest.mark.parametrize(("engine", "bound"), [("exact", 1e-13), ("nonlinear", 1e-9)])
def test_a_leak_decays_as_theory_says(engine, bound, lag_s):
    """x = e + (s - e) exp(-leak t), e = 2 * 3 / leak; behind a lag the exponential is 1 / (1 - leak tau)
    times as large, but for what remains of exp(-t / tau). Exact: rounding; nonlinear: its bound."""
    record = hybrid.run(hybrid.parse_patch(LEAKY), {"lag": lag_s}, engine=engine).record
    t = record["time"].values
    late = t > 50 * lag_s
    decay = np.exp(-LEAK * t) / (1.0 - LEAK * lag_s)
    assert abs(record["x"].values - END - (START - END) * decay)[late].max() < bound
    assert abs(record["free"].values - START * decay)[late].max() < bound
    assert record["free"].values[0] == START
    # The rate itself, from the record, as it would be measured.
    free = record["free"].values[late]
    rate = math.log(free[0] / free[-1]) / (t[late][-1] - t[late][0])
    assert rate == pytest.approx(LEAK, rel=100 * bound)
