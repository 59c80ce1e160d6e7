"""Inputs far faster than the machine: they are no chatter, and what they ask of the engine is said."""

import math
import re

import numpy as np
import pytest

import hybrid
from hybrid.arguments import machine_of
from hybrid.loudness import MOST_PLAYED, short_windows

DRIVEN = """
title: A sine faster than the lags
machine: lags
parameters: {fast: 1 MHz}
analog:
  wave: {sine: 1, frequency: fast, full_scale: 1}
  size: {absolute: wave, full_scale: 1}
  way: {compare: {wave: 1}, high: 1, low: -1, full_scale: 1}
  x: {integrate: {size: 1000 1/s}, initial: 0, full_scale: 1}
  y: {integrate: {way: 1000 1/s}, initial: 0, full_scale: 1}
run: {until: 0.1 ms, every: 10 us}
"""


def test_what_a_sine_drives_does_not_chatter():
    """200 changes of each, half a lag apart. The wave behind its lag of 1 us has the amplitude
    A = 1 / sqrt(1 + (2 pi)^2), its size the mean 2 A / pi, which x shows two lags late; y swings within
    half a period."""
    run = hybrid.run(hybrid.parse_patch(DRIVEN))
    assert (run.status, run.status_note) == ("complete", "")
    amplitude = 1.0 / math.hypot(1.0, 2.0 * math.pi)
    mean = 1000 * 2 * amplitude / math.pi
    x, t = run.record["x"].values, run.record["time"].values
    # A lag settles within some us, and a ripple of half a period at A is left.
    assert x[2:] == pytest.approx(mean * (t[2:] - 2e-6), abs=1000 * 1e-6)
    assert abs(run.record["y"].values).max() < 1000 * 2e-6


def test_crossings_at_the_very_instants_of_the_record():
    """At 40 MHz a time of 0.1 ms is known to some 3e-12 rad, and every row is at a crossing."""
    run = hybrid.run(hybrid.parse_patch(DRIVEN), {"fast": "40 MHz"}, machine="ideal")
    assert (run.status, run.status_note) == ("complete", "")
    t = run.record["time"].values
    assert run.record["x"].values == pytest.approx(2000 / math.pi * t, abs=1e-8)
    assert abs(run.record["y"].values).max() < 1e-8


def test_a_relay_in_a_loop_still_chatters():
    """The same comparator, fed by what it drives."""
    text = DRIVEN.replace("{compare: {wave: 1}", "{compare: {y: -1}").replace("0.1 ms", "1 ms")
    note = hybrid.run(hybrid.parse_patch(text)).status_note
    assert re.match(r"way chatters from \S+ s on, \d+ changes as fast as the lags allow", note), (
        note
    )


NOISY = """
title: Rectified noise
machine: ideal
parameters: {width: 1e6 rad/s}
analog:
  hiss: {noise_source: 0.1, bandwidth: width, full_scale: 1}
  size: {absolute: hiss, full_scale: 1}
  x: {integrate: {size: 100 1/s, x: -100 1/s}, initial: 0, full_scale: 1}
  square: {multiply: [x, x], full_scale: 1}
  z: {integrate: {square: 100 1/s, z: -100 1/s}, initial: 0, full_scale: 1}
run: {until: 10 ms, every: 1 ms}
"""


def test_short_windows_do_not_add_up_to_nonsense():
    """x settles to the mean size, 0.1 sqrt(2 / pi), as 1 - exp(-t / 10 ms); it scatters by that of
    a lag of 10 ms on noise that forgets in 1 us, 0.06 sqrt(1e-6 / 10e-3) = 6e-4, 1.6 % aside. In
    320,000 windows the engine's own error stays below that."""
    run = hybrid.run(hybrid.parse_patch(NOISY))
    mean = 0.1 * math.sqrt(2 / math.pi) * (1 - math.exp(-1.0))
    assert run.record["x"].values[-1] == pytest.approx(mean, abs=0.016 * mean + 5 * 6e-4)
    assert 0.0 < run.engine_error < 5e-4  # half a percent of the noise
    assert run.coarse_by == "hiss"


def test_what_would_run_for_hours_is_said_before():
    """32 windows in the time in which the noise forgets: 3.2e10 a second at 1e9 rad/s."""
    patch = hybrid.parse_patch(NOISY)
    assert short_windows(machine_of(patch, None, None, None)) == ""
    fast = machine_of(patch, {"width": 1e9}, None, None)
    said = re.search(
        r"noise source 'hiss' .* bandwidth of 1e\+09 rad/s asks for 3\.2e\+10 windows in a second of "
        r"the machine, 3\.2e\+08 in this run; with one of (\S+) rad/s it would take about a minute",
        short_windows(fast),
    )
    assert said is not None, short_windows(fast)
    slower = machine_of(patch, {"width": float(said[1])}, None, None)
    windows = 32 * float(said[1]) * 10e-3
    assert windows * len(slower.elements) == pytest.approx(MOST_PLAYED, rel=0.5)
    assert said[0][-20:] in hybrid.check(fast, trial=False).warnings[-1]


def test_noise_that_reaches_nothing_nonlinear_asks_for_nothing():
    text = NOISY.replace("absolute: hiss", "absolute: x").replace(
        "{size: 100 1/s,", "{hiss: 100 1/s,"
    )
    patch = hybrid.parse_patch(
        text.replace("absolute: x", "constant: 0.5").replace("[x, x]", "[size, size]")
    )
    assert short_windows(machine_of(patch, {"width": 1e9}, None, None)) == ""


FEEDBACK = """
title: Roots and quotients in feedback, beside corners, with noise
machine: nominal
analog:
  wave: {sine: 0.5, omega: 100 rad/s, full_scale: 1}
  square: {square: 0.5, period: 20 ms, full_scale: 1}
  base: {constant: 0.5, full_scale: 1}
  slow: {lag: {square: 1}, time_constant: 5 ms, full_scale: 1}
  level: {sum: {base: 1.5, slow: 0.3}, full_scale: 1}
  quiet: {square_root: level, full_scale: 1}
  root: {square_root: level, circuit: feedback, full_scale: 1}
  share: {divide: [wave, level], circuit: feedback, full_scale: 2}
  product: {multiply: [wave, slow], quarter_square: 23, full_scale: 1}
  stopped: {integrate: {wave: 100 1/s}, initial: 0, low: -0.3, high: 0.3, full_scale: 1}
  saw: {sawtooth: 0.5, period: 20 ms, full_scale: 1}
  curve: {function: wave, points: {-1: 0, 0: 0.5, 1: 0.2}, full_scale: 1}
  half: {amplify: {wave: 1, half: -1}, full_scale: 1}
  play: {backlash: wave, width: 0.3, full_scale: 1}
run: {until: 30 ms, every: 1 ms}
"""


@pytest.mark.parametrize("seed", range(4))
def test_circuits_in_feedback_bear_noise(seed):
    """Their products must follow their amplifiers where noise has moved these: else no window is short
    enough.

    Noise of 1e-4 in level, product and amplifier, tolerances of as much: two roots agree within 2e-3.
    """
    run = hybrid.run(hybrid.parse_patch(FEEDBACK), seed=seed)
    assert run.status == "complete", run.status_note
    assert np.abs(run.record["root"].values - run.record["quiet"].values)[1:].max() < 2e-3
