"""Noise while the machine is in IC, OP and HOLD, and where an overload stops or holds it."""

import math

import numpy as np
import pytest

from hybrid import parse_patch, run
from hybrid.compiler import compile_patch
from hybrid.engine.windows import CircuitPlayer
from hybrid.record import pens_for
from hybrid.timeline import build_timeline

SIGMAS = 4.5
RMS, TAU_S, RATE = 1e-3, 1e-6, 100.0

RAMP = """
title: Ramp of a noisy constant
parameters: {until: 12 ms}
machine: {preset: ideal, tau: 1 us, noise: 1e-3}
analog:
  one: {constant: 0.5, full_scale: 1}
  x: {integrate: {one: 100 1/s}, initial: 0.1, full_scale: 1, tau: 0, noise: 0}
  shown: {sum: {x: 1}, full_scale: 1}
modes: {reset: 1 ms, operate: 3 ms, hold: 2 ms}
run: {until: until, every: 0.5 ms}
"""


def column(result, name):
    return result.rows[:, [pen.name for pen in result.pens].index(name)]


def test_hold_and_ic_keep_the_state_to_the_last_bit_while_the_input_is_noisy():
    result = run(parse_patch(RAMP), seed=4)
    assert (result.status, result.status_note) == ("complete", "")
    x, mode, shown = (column(result, name) for name in ("x", "mode", "shown"))
    assert np.all(x[mode == 0] == 0.1)
    for begin in (8, 20):  # rows of the two HOLDs, the first of each after 3 ms of OP
        assert np.all(mode[begin : begin + 4] == 2.0)
        assert np.all(x[begin : begin + 4] == x[begin])
        assert 0.0 < abs(x[begin] - 0.25) < 1e-4
    assert x[8] != x[20]
    assert np.all(np.diff(column(result, "one")[1:]) != 0.0)
    assert np.all(shown[1:] != x[1:])  # its own lag and noise know no modes


def test_each_operation_integrates_its_noise_and_that_only():
    """Variance of the integral of a Gauss process over 3 ms: 2 tau (t - tau), times (rate rms)^2."""
    operations, t_s = 500, 3e-3
    result = run(parse_patch(RAMP), {"until": operations * 6e-3}, seed=1)
    held = column(result, "x")[8::12][:operations]
    variance = (RATE * RMS) ** 2 * 2 * TAU_S * (t_s - TAU_S)
    assert len(held) == operations
    spread = math.sqrt(variance)
    assert np.mean(held) == pytest.approx(0.25, abs=SIGMAS * spread / math.sqrt(operations))
    assert np.var(held) / variance == pytest.approx(1, abs=SIGMAS * math.sqrt(2 / operations))
    neighbours = np.corrcoef(held[1:], held[:-1])[0, 1]
    assert abs(neighbours) < SIGMAS / math.sqrt(operations)


def test_repetitive_operation_with_noise_is_the_seeds_however_it_is_cut():
    patch = parse_patch(RAMP)
    one, again, other = (run(patch, seed=seed).rows for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.all(column(run(patch, seed=1), "x")[8:12] != column(run(patch, seed=2), "x")[8:12])
    assert not np.array_equal(one, other)
    machine = compile_patch(patch)
    stepped = CircuitPlayer(machine, build_timeline(machine), pens_for(machine), 1)
    while stepped.outcome == 1:
        stepped.play_cues(1)
    np.testing.assert_array_equal(one, stepped.record)


BY_SIGNAL = """
title: Held and reset by comparators
machine: {preset: ideal, tau: 1 us, noise: 1e-3}
analog:
  one: {constant: 1, full_scale: 1}
  x: {integrate: {one: 100 1/s}, initial: 0, full_scale: 1, tau: 0, noise: 0}
  y: {integrate: {one: 100 1/s}, initial: one, reset_when: full, full_scale: 2, tau: 0, noise: 0}
  z: {integrate: {one: 100 1/s}, initial: 0, hold_when: full, full_scale: 1, tau: 0, noise: 0}
  full: {compare: {x: 1, one: -0.5}, high: 1, full_scale: 1, tau: 0, noise: 0}
run: {until: 10 ms, every: 0.5 ms}
"""


def test_a_comparator_resets_and_holds_the_true_states():
    """x rises as 100 t and meets 0.5 +- 1e-3 at 5 ms; from then on z stands and y follows `one`."""
    result = run(parse_patch(BY_SIGNAL), seed=2)
    x, y, z, one = (column(result, name) for name in ("x", "y", "z", "one"))
    np.testing.assert_array_equal(z[:10], x[:10])
    assert np.all(z[11:] == z[11])
    assert z[11] == pytest.approx(0.5, abs=SIGMAS * 2 * RMS)
    np.testing.assert_allclose(y[11:], one[11:], rtol=0, atol=1e-12)
    assert np.ptp(one[11:]) > RMS  # it is followed with its noise


OVERLOADED = """
title: Ramp beyond full scale
machine: {preset: ideal, tau: 1 us, noise: 1e-3}
analog:
  half: {constant: 0.5, full_scale: 1}
  x: {integrate: {half: 200 1/s}, initial: 0, full_scale: 1, tau: 0, noise: 0}
run: {until: 20 ms, every: 1 ms, on_overload: hold}
"""


@pytest.mark.parametrize("what", ["hold", "stop"])
def test_an_overload_with_noise_holds_or_stops_near_its_instant(what):
    """x = 100 t, and an integral of noise of 2.8e-5 in 10 ms (rms), so beyond 1 at 10 ms +- 3e-7 s."""
    patch = parse_patch(OVERLOADED.replace("hold", what))
    result = run(compile_patch(patch, as_circuit=True), seed=3)
    first = next(o for o in result.overloads if o["signal"] == "x")
    spread = 200 * RMS * math.sqrt(2 * TAU_S * 10e-3) / 100
    assert first["time_s"] == pytest.approx(10e-3, abs=SIGMAS * spread)
    if what == "stop":
        assert result.status == "stopped" and "x is beyond its full scale" in result.status_note
        return
    assert (
        "in HOLD since 0.01" in result.status_note or "in HOLD since 0.0099" in result.status_note
    )
    x = column(result, "x")[11:]
    assert np.all(x == x[0]) and x[0] == pytest.approx(1, abs=1e-9 + SIGMAS * 100 * spread)
