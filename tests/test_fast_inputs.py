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


@pytest.mark.parametrize(
    ("fast", "until", "every"), [("60 MHz", "100 us", "10 us"), ("10 GHz", "1 us", "0.1 us")]
)
def test_a_sine_of_many_turns_is_found_again(fast, until, every):
    """The last digit of its angle, 4e-12 and 8e-12 rad, is more than a corner is located to."""
    text = DRIVEN.replace("0.1 ms, every: 10 us", f"{until}, every: {every}")
    run = hybrid.run(hybrid.parse_patch(text), {"fast": fast}, machine="ideal")
    assert (run.status, run.status_note) == ("complete", "")
    t = run.record["time"].values
    assert run.record["x"].values == pytest.approx(2000 / math.pi * t, abs=1e-8)
    assert abs(run.record["y"].values).max() < 1e-8


FORCED = """
title: A pulse-width modulator in a loop
machine: lags
parameters: {fast: 10 MHz, wanted: 0.3}
analog:
  carrier: {sine: 1, frequency: fast, full_scale: 1, tau: 0}
  demand: {constant: wanted, full_scale: 1}
  x: {integrate: {demand: 5000 1/s, u: -5000 1/s}, initial: 0, full_scale: 1}
  gap: {sum: {x: 1, carrier: -1}, full_scale: 2, tau: TAU}
  u: {compare: {gap: 1}, high: 1, low: -1, full_scale: 1}
run: {until: 200 us, every: 50 us}
"""


@pytest.mark.parametrize("tau", ["0", "0.1 us"])
def test_a_relay_in_a_loop_that_is_forced_does_not_chatter(tau):
    """20 changes in each lag of 1 us, and the loop goes on where its carrier alone would go.

    The relay is high for 1/2 + asin(x / A) / pi of a period, A = 1 / |1 + j omega tau|, so its mean is
    m = 2 asin(x / A) / pi, and x' = 5000 (wanted - m) 1/s. Lags of 2 us at most delay x by
    5000 * 0.3 * 2e-6, and its ripple is below 5000 / 10e6.
    """
    run = hybrid.run(hybrid.parse_patch(FORCED.replace("TAU", tau)))
    assert (run.status, run.status_note) == ("complete", "")
    size = 1.0 / math.hypot(1.0, 2 * math.pi * 10e6 * (0.0 if tau == "0" else 0.1e-6))
    x, steps = [0.0], 1000
    for _ in range(4 * steps):
        mean = 2 * math.asin(min(x[-1] / size, 1.0)) / math.pi
        x.append(x[-1] + 50e-6 / steps * 5000 * (0.3 - mean))
    assert run.record["x"].values == pytest.approx(x[::steps], abs=5e-3)


def test_a_forced_relay_does_not_chatter_in_the_reference_either():
    """The same a thousand times as slow; 80 changes of the relay, 10 in each of its lags."""
    text = FORCED.replace("TAU", "0.1 ms").replace("200 us, every: 50 us", "8 ms, every: 4 ms")
    text = text.replace("machine: lags", "machine: {preset: ideal, tau: 1 ms}")
    text = text.replace("5000", "5").replace("10 MHz", "5 kHz")
    run = hybrid.run(hybrid.parse_patch(text), engine="reference")
    assert (run.status, run.status_note) == ("complete", "")


SLIDING = """
title: A relay that slides, beside what goes to and fro outside
machine: lags
analog:
  aside: {sine: 0.01, frequency: FAST, full_scale: 1}
  x: {integrate: {u: 50 1/s, aside: 10 1/s}, initial: 0, full_scale: 1}
  u: {compare: {x: -1}, high: 1, low: -1, full_scale: 1}
run: {until: 2 ms, every: 1 ms}
"""


@pytest.mark.parametrize("fast", ["1 kHz", "30 kHz", "120 kHz"])
def test_what_is_not_forced_chatters_whatever_goes_on_outside(fast):
    """Two lags swing at 1 / tau, 159 kHz, as they do alone: the sine is too weak to lead."""
    run = hybrid.run(hybrid.parse_patch(SLIDING.replace("FAST", fast)))
    said = re.match(r"u chatters from \S+ s on, (\d+) changes as fast as", run.status_note)
    assert said is not None, run.status_note
    assert 64 < int(said[1]) < 2e-3 * 2 * 159e3 * 1.1


TURNING = """
title: An angle that its loop holds where it jumps
machine: MACHINE
analog:
  y: {integrate: {way: RATE}, initial: 0.1, full_scale: 1}
  back: {constant: BACK, full_scale: 1}
  across: {sum: {y: BACK}, full_scale: 1}
  way: {atan2: [across, back], full_scale: 4}
run: {until: 4 ms, every: 1 ms}
"""


def test_advice_for_an_angle_that_jumps_where_its_loop_holds_it():
    """At half a turn the loop slides; with both inputs inverted it rests at angle 0, and stays there."""
    text = TURNING.replace("RATE", "100 1/s").replace("BACK", "-1")
    cure = "its angle jumps at half a turn, where the loop holds it; invert both its inputs"
    note = hybrid.run(hybrid.parse_patch(text.replace("MACHINE", "lags"))).status_note
    assert note.startswith("way chatters from ") and cure in note and "hysteresis" not in note
    stopped = hybrid.run(hybrid.parse_patch(text.replace("MACHINE", "ideal")))
    assert stopped.status == "stopped"
    assert stopped.status_note.endswith(
        f"way chatters: {cure}, which makes that angle 0, or give what it drives a lag"
    )
    turned = TURNING.replace("RATE", "-100 1/s").replace("BACK", "1").replace("MACHINE", "lags")
    assert hybrid.run(hybrid.parse_patch(turned)).status_note == ""


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
