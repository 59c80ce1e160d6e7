"""Each kind of component against its exact response, with each of its errors alone."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.components import CATALOG
from hybrid.errors import PatchError
from hybrid.streams import unit_errors

EPS = np.finfo(float).eps


def patch(*components, run="until: 2 s, every: 0.1 s", machine="ideal"):
    lines = "\n".join(f"  {line}" for line in components)
    return f"title: Test\nmachine: {machine}\nanalog:\n{lines}\nrun: {{{run}}}\n"


ONE = "one: {constant: 1, full_scale: 2}"


def test_catalogue_is_covered():
    linear = {
        "sum",
        "coefficient",
        "invert",
        "integrate",
        "lag",
        "delay",
        "amplify",
        "noise_source",
    }
    linear |= {"constant", "step", "ramp", "pulse", "sine", "square"}
    assert {key for key, kind in CATALOG.items() if kind.is_linear} == linear


# --- exact responses -----------------------------------------------------------------------------


def test_static_kinds(play):
    played = play(
        patch(
            "two: {constant: 2, full_scale: 4}",
            "three: {constant: -3, full_scale: 4}",
            "sum: {sum: {two: 1.5, three: -2}, full_scale: 16}",
            "pot: {coefficient: {three: 0.25}, full_scale: 1}",
            "inverter: {invert: sum, full_scale: 16}",
        )
    )
    for name, value in {"two": 2, "three": -3, "sum": 9, "pot": -0.75, "inverter": -9}.items():
        assert played[name].tolist() == [value] * 21


@pytest.mark.parametrize("leak", [0.0, 1e-9, 0.3, 25.0])
@pytest.mark.parametrize("tau", [0.0, 1e-6, 0.05])
def test_integrator(tau, leak, play):
    played = play(
        patch(
            ONE,
            f"x: {{integrate: {{one: 0.8}}, initial: -0.5, leak: {leak} 1/s, full_scale: 4, "
            f"tau: {tau} s}}",
        )
    )
    t = played.time_s
    # w' = 0.8 - leak w, w(0) = -1/2, then y' = (w - y) / tau, y(0) = w(0).
    if leak == 0.0:
        expected = -0.5 + 0.8 * (t + (tau * np.expm1(-t / tau) if tau else 0.0))
    else:
        end, start = 0.8 / leak, -0.5 - 0.8 / leak
        decay = np.exp(-leak * t)
        if tau:
            slow = 1 / (1 - leak * tau)
            decay = slow * decay + (1 - slow) * np.exp(-t / tau)
        expected = end + start * decay
    # 0.8 / leak is a large figure taken off again where the leak is small.
    np.testing.assert_allclose(
        played["x"], expected, rtol=0, atol=1e-14 + EPS * (leak and 4 / leak)
    )


@pytest.mark.parametrize("initial", [None, -0.4])
@pytest.mark.parametrize("tau", [0.0, 1e-6, 0.02])
def test_lag_of_the_problem_with_and_without_a_lag_of_its_own(tau, initial, play):
    start = "" if initial is None else f"initial: {initial}, "
    played = play(
        patch(
            "source: {step: 1.5, at: 0 s, before: 0.5, full_scale: 2}",
            f"y: {{lag: {{source: 2}}, time_constant: 0.4 s, {start}full_scale: 4, tau: {tau} s}}",
        )
    )
    # Settled to 2 * 0.5 without an initial value; both lags start there.
    t, begin = played.time_s, 1.0 if initial is None else initial
    decay = (0.4 * np.exp(-t / 0.4) - (tau * np.exp(-t / tau) if tau else 0)) / (0.4 - tau)
    np.testing.assert_allclose(played["y"], 3.0 + (begin - 3.0) * decay, rtol=0, atol=2e-15)
    assert played["y"][0] == begin


@pytest.mark.parametrize("at_ms", [0, 300, 1000, 1234.5678901, 2000])
def test_step_source(at_ms, play):
    played = play(
        patch(
            f"s: {{step: 1.25, at: {at_ms} ms, before: -0.5, full_scale: 2}}",
            "area: {integrate: {s: 1}, initial: 0, full_scale: 4}",
        )
    )
    t, at = played.time_s, at_ms * 1e-3
    # The record shows the value after the step at that very instant.
    assert played["s"].tolist() == [1.25 if time >= at else -0.5 for time in t]
    expected = -0.5 * np.minimum(t, at) + 1.25 * np.maximum(t - at, 0)
    np.testing.assert_allclose(played["area"], expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("rate", ["omega: 37.7 rad/s", "frequency: 6.0001 Hz"])
def test_sine_keeps_amplitude_and_phase_over_1e5_rows(rate, play):
    text = patch(
        f"s: {{sine: 1.5, {rate}, phase: 0.7, bias: -0.25, full_scale: 2}}",
        run="until: 1000 s, every: 10 ms",
    )
    played = play(text)
    omega = 37.7 if "omega" in rate else 2 * math.pi * 6.0001
    phase = (omega * played.time_s + 0.7) % (2 * math.pi)
    wave = played["s"] + 0.25
    assert len(wave) == 100_001
    # One rounding of each of the two states a row, all the same way at worst: 1e5 eps = 2.2e-11.
    # The reference itself rounds omega t, up to 3.8e4 rad, to 7e-12 rad.
    assert np.max(np.abs(wave - 1.5 * np.sin(phase))) < 1.5 * (1e5 * EPS + 1e-11)
    last = slice(-1000, None)
    both = np.column_stack([np.sin(phase[last]), np.cos(phase[last])])
    sine, cosine = np.linalg.lstsq(both, wave[last], rcond=None)[0]
    assert math.hypot(sine, cosine) / 1.5 - 1 == pytest.approx(0, abs=1e5 * EPS)
    assert math.atan2(cosine, sine) == pytest.approx(0, abs=1e5 * EPS + 1e-11)


def test_sine_through_an_integrator_and_a_lag(play):
    played = play(
        patch(
            "s: {sine: 1, omega: 3 rad/s, full_scale: 1}",
            "x: {integrate: {s: 3}, initial: -1, full_scale: 2}",
            "y: {lag: {s: 1}, time_constant: 0.5 s, initial: 0, full_scale: 1}",
        )
    )
    t = played.time_s
    np.testing.assert_allclose(played["x"], -np.cos(3 * t), rtol=0, atol=4e-15)
    # y' = 2 (sin 3t - y): (4 sin 3t - 6 cos 3t + 6 exp(-2t)) / 13.
    expected = (4 * np.sin(3 * t) - 6 * np.cos(3 * t) + 6 * np.exp(-2 * t)) / 13
    np.testing.assert_allclose(played["y"], expected, rtol=0, atol=4e-15)


# --- errors, one at a time -----------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["sum: {s: 1}", "coefficient: {s: 1}", "invert: s"])
def test_own_lag(kind, play):
    played = play(
        patch(
            "s: {step: 1, at: 0.5 s, full_scale: 1}",
            f"y: {{{kind}, full_scale: 1, tau: 0.1 s}}",
        )
    )
    late = np.maximum(played.time_s - 0.5, 0)
    sign = -1 if "invert" in kind else 1
    np.testing.assert_allclose(played["y"], -sign * np.expm1(-late / 0.1), rtol=0, atol=1e-15)


def test_own_lag_of_sources_and_dac(play):
    text = patch(
        "s: {step: 1, at: 0 s, full_scale: 1, tau: 0.1 s}",
        "wave: {sine: 1, omega: 5 rad/s, phase: 0.3, full_scale: 1, tau: 0.1 s}",
        run="until: 2 s, every: 0.1 s",
    )
    text += """
interface: {shown: {dac: w, full_scale: 1, initial: -0.5, tau: 0.1 s}}
digital: {period: 0.5 s, compute_time: 0 s, program: {w: 0.5}}
"""
    played = play(text)
    t, decay = played.time_s, np.exp(-played.time_s / 0.1)
    np.testing.assert_allclose(played["s"], 1 - decay, rtol=0, atol=1e-15)
    np.testing.assert_allclose(played["shown"], 0.5 - decay, rtol=0, atol=1e-15)
    # (sin u - 0.5 cos u) / 1.25 with u = 5t + 0.3, and what is needed to start at sin 0.3.
    u = 5 * t + 0.3
    steady = (np.sin(u) - 0.5 * np.cos(u)) / 1.25
    start = (math.sin(0.3) - steady[0]) * decay
    np.testing.assert_allclose(played["wave"], steady + start, rtol=0, atol=4e-15)


GAINS = (
    "c: {constant: 1, full_scale: 2}",
    "st: {step: 1, at: 0.5 s, before: 0.25, full_scale: 2}",
    "si: {sine: 1, omega: 1 rad/s, bias: 0.5, full_scale: 2}",
    "su: {sum: {exact: 1}, full_scale: 2}",
    "pot: {coefficient: {exact: 0.5}, full_scale: 2}",
    "inv: {invert: exact, full_scale: 2}",
    "int: {integrate: {exact: 1}, initial: 0.5, leak: 0.5 1/s, full_scale: 4}",
    "lag: {lag: {exact: 1}, time_constant: 1 s, initial: 0.5, full_scale: 2}",
    "exact: {constant: 1, full_scale: 2, tolerance: 0}",
)
CONVERTER = """
interface: {dac: {dac: w, full_scale: 2, initial: 0}}
digital: {period: 0.1 s, compute_time: 0 s, program: {w: 1}}
"""


def without_errors(t):
    """(gained part, the rest) of every signal of GAINS and CONVERTER."""
    lag, leak = np.exp(-t), np.exp(-t / 2)
    return {
        "c": (np.ones_like(t), 0),
        "st": (np.where(t < 0.5, 0.25, 1), 0),
        "si": (np.sin(t) + 0.5, 0),
        "su": (np.ones_like(t), 0),
        "pot": (np.full_like(t, 0.5), 0),
        "inv": (-np.ones_like(t), 0),
        "int": (2 * (1 - leak), 0.5 * leak),
        "lag": (1 - lag, 0.5 * lag),
        "dac": (np.ones_like(t), 0),
    }


@pytest.mark.parametrize("serial", [1, 2, 77])
def test_gain_error_comes_from_the_serial_number(serial, play):
    machine = f"{{preset: ideal, tolerance: 0.02, serial: {serial}}}"
    played = play(patch(*GAINS, machine=machine) + CONVERTER)
    gains = {}
    for name, (gained, rest) in without_errors(played.time_s).items():
        gains[name] = 1 + 0.02 * unit_errors(serial, (name,), "gain")[0]
        np.testing.assert_allclose(played[name], gains[name] * gained + rest, rtol=0, atol=4e-15)
    assert len(set(gains.values())) == len(gains)
    assert np.all(played["exact"] == 1.0)


def test_gain_errors_fill_their_tolerance_evenly():
    errors = np.array([unit_errors(serial, ("theta",), "gain")[0] for serial in range(4000)])
    assert np.all(np.abs(errors) <= 1)
    # Uniform in [-1, 1): mean 0 and mean square 1/3, here within 4.5 of their deviations.
    assert abs(np.mean(errors)) < 4.5 / math.sqrt(3 * 4000)
    assert abs(np.mean(errors**2) - 1 / 3) < 4.5 * math.sqrt(4 / 45 / 4000)
    assert unit_errors(5, ("theta",), "gain")[0] != unit_errors(5, ("alpha",), "gain")[0]


def test_offset_is_a_fraction_of_full_scale_and_drifts_in_an_integrator(play):
    machine = "{preset: ideal, offset: 0.01}"
    played = play(
        patch(*GAINS, machine=machine).replace("exact: {", "exact: {offset: 0, ") + CONVERTER
    )
    t = played.time_s
    offsets = dict.fromkeys(without_errors(t), np.full_like(t, 0.02))
    # Full scale 4: 0.04 per second at the integrator's input, with the leak 0.5 1/s it has.
    offsets["int"] = 0.04 * 2 * (1 - np.exp(-t / 2))
    # A lag's offset is one of its output; it takes the lag's time to show, as `initial` is given.
    offsets["lag"] = 0.02 * (1 - np.exp(-t))
    # Before the first word the DAC's offset is there all the same.
    for name, (gained, rest) in without_errors(t).items():
        np.testing.assert_allclose(played[name], gained + rest + offsets[name], rtol=0, atol=4e-15)


@pytest.mark.parametrize("leak", [0.0, 1e-9, 1e-3])
def test_drift_of_an_integrator_does_not_jump_with_its_leak(leak, play):
    played = play(
        patch(
            "zero: {constant: 0, full_scale: 1}",
            f"x: {{integrate: {{zero: 1}}, initial: 0, leak: {leak} 1/s, full_scale: 5, offset: 0.01}}",
        )
    )
    t = played.time_s
    expected = 0.05 * (-np.expm1(-leak * t) / leak if leak else t)
    np.testing.assert_allclose(played["x"], expected, rtol=1e-14)


def test_settled_lag_carries_its_offset_and_gain_from_the_start(play):
    machine = "{preset: ideal, offset: 0.01, tolerance: 0.02, serial: 4}"
    played = play(
        patch(
            "exact: {constant: 1, full_scale: 2, tolerance: 0, offset: 0}",
            "y: {lag: {exact: 1.5}, time_constant: 0.1 s, full_scale: 4, tau: 1 ms}",
            machine=machine,
        )
    )
    expected = 1.5 * (1 + 0.02 * unit_errors(4, ("y",), "gain")[0]) + 0.04
    np.testing.assert_allclose(played["y"], expected, rtol=1e-15)


@pytest.mark.parametrize("preset", ["ideal", "lags"])
def test_static_check(preset, compiled):
    machine = compiled(
        patch(
            "a: {constant: 3, full_scale: 4}",
            "x: {integrate: {a: 1}, initial: -2, full_scale: 8}",
            "s: {sine: 2, omega: 1 rad/s, phase: 0.5, bias: 1, full_scale: 4}",
            "y: {lag: {x: 0.5, s: 1}, time_constant: 3 s, full_scale: 16}",
            "st: {step: 3, at: 0 s, before: 1, full_scale: 4}",
            "z: {sum: {y: 2, a: -1, st: 1, d: 1}, full_scale: 16}",
            machine=preset,
        )
        + "interface: {d: {dac: w, full_scale: 8, initial: 5}}\n"
        + "digital: {period: 1 s, program: {w: 1}}\n"
    )
    analog = machine.analog
    found = dict(zip(analog.signals, analog.static_value * analog.full_scale, strict=True))
    s = 1 + 2 * math.sin(0.5)
    expected = {"a": 3, "x": -2, "s": s, "y": s - 1, "st": 1, "d": 5, "z": 2 * (s - 1) - 3 + 1 + 5}
    assert found == pytest.approx(expected, rel=1e-14)


# --- scaling -------------------------------------------------------------------------------------

SCALED = """
title: Scaled
machine: MACHINE
parameters: {A: 1, B: 1, C: 1, D: 1, E: 1}
analog:
  x: {integrate: {v: 1}, initial: 0.5, full_scale: A}
  v: {integrate: {f: 1, v: -0.2, kick: 1}, initial: 0, full_scale: B}
  f: {sum: {x: -4, y: 0.3, u: 1}, full_scale: C}
  y: {lag: {x: 1}, time_constant: 0.3 s, full_scale: D}
  kick: {sine: 0.1, omega: 2.1 rad/s, full_scale: B}
interface:
  s: {adc: y}
  u: {dac: w, full_scale: E, initial: 0.1}
digital: {period: 50 ms, compute_time: 80 ms, program: {w: -0.7*s}}
run: {until: 5 s}
"""


@given(st.lists(st.floats(-3.0, 3.0), min_size=5, max_size=5))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_full_scales_change_nothing_in_problem_units(play, decades):
    # On a machine without lags and errors; a signal beyond full scale is flagged, never changed.
    scales = dict(zip("ABCDE", (10.0**d for d in decades), strict=True))
    text = SCALED.replace("MACHINE", "ideal")
    if scales["A"] < 0.5 or scales["E"] < 0.1:  # the initial values must lie within
        scales |= {"A": 0.5 + scales["A"], "E": 0.1 + scales["E"]}
    one, other = play(text), play(text, scales)
    for name in ("x", "v", "f", "y", "s", "u"):
        size = np.max(np.abs(one[name]))
        assert np.max(np.abs(one[name] - other[name])) < 1e-13 * size
        assert size > 0.01


def test_full_scales_change_nothing_behind_lags_either(play):
    text = SCALED.replace("MACHINE", "lags")
    one = play(text)
    other = play(text, {"A": 3.0, "B": 70.0, "C": 0.9, "D": 11.0, "E": 0.2})
    for name in ("x", "v", "f", "y", "s", "u"):
        assert np.max(np.abs(one[name] - other[name])) < 1e-13 * np.max(np.abs(one[name]))


# --- overloads of analog signals -----------------------------------------------------------------


def test_overload_is_noted_where_the_signal_passes_full_scale(play):
    played = play(
        patch(
            "one: {constant: 1, full_scale: 1}",
            "x: {integrate: {one: -1}, initial: 0, full_scale: 0.75}",
            "twice: {sum: {x: 2}, full_scale: 1}",
        )
    )
    found = {overload.signal: overload for overload in played.player.overloads()}
    assert set(found) == {"x", "twice"}
    assert found["x"].time_s == pytest.approx(0.75, rel=1e-11)
    assert found["twice"].time_s == pytest.approx(0.5, rel=1e-11)
    assert found["x"].duration_s == pytest.approx(1.25, rel=1e-11)
    assert found["x"].worst_mu == pytest.approx(-2 / 0.75) and found["x"].worst_time_s == 2.0
    assert found["x"].instants == 13


def test_overload_at_the_start_is_noted_at_the_start(play):
    played = play(patch("two: {constant: 2, full_scale: 1}"))
    assert [(o.signal, o.time_s) for o in played.player.overloads()] == [("two", 0.0)]


def test_overload_of_a_jump_is_noted_at_the_jump(play):
    played = play(patch("s: {step: 2, at: 0.75 s, full_scale: 1}"))
    assert [o.time_s for o in played.player.overloads()] == [0.75]


# --- what no machine can do ----------------------------------------------------------------------


def test_noise_needs_a_lag(compiled):
    with pytest.raises(PatchError, match=r"'y' has noise 0\.001 but no lag"):
        compiled(patch(ONE, "y: {sum: {one: 1}, full_scale: 2, noise: 1e-3}"))


def test_lagless_loop_is_refused_and_a_lag_breaks_it(compiled, play):
    loop = "a: {sum: {b: 0.5, one: 1}, full_scale: 4}", "b: {invert: a, full_scale: 4}"
    with pytest.raises(PatchError, match="algebraic loop through parts without lag: a -> b -> a"):
        compiled(patch(ONE, *loop))
    # a = 1 - a / 2 settles at 2/3 before the run.
    played = play(patch(ONE, *loop).replace("b: {", "b: {tau: 1 us, "))
    np.testing.assert_allclose(played["a"], 2 / 3, rtol=1e-15)


def test_initial_value_beyond_full_scale_is_refused(compiled):
    with pytest.raises(PatchError, match=r"initial value of 'x' is 2\.5 times its full_scale"):
        compiled(patch(ONE, "x: {integrate: {one: 1}, initial: -5, full_scale: 2}"))
