"""The nonlinear engine inside a machine: converters, program, sources and record as in the exact one."""

import re

import numpy as np
import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.engine.windows import CircuitPlayer, settled
from hybrid.record import pens_for
from hybrid.runs import run
from hybrid.timeline import build_timeline

# Every linear kind, converters with skew and conversion time, a program with memory, a late step.
EVERYTHING = """
title: Every linear kind, with and without lags
parameters: {tau: 1 us}
machine: {preset: nominal, noise: 0, offset: 1e-3, tau: tau}
analog:
  wave: {sine: 0.3, omega: 40 rad/s, phase: 1, bias: 0.1, full_scale: 1}
  jump: {step: 0.4, at: 33 ms, before: -0.1, full_scale: 1}
  fixed: {constant: 0.25, full_scale: 1}
  mix: {sum: {wave: 0.5, jump: -1, answer: 0.3}, full_scale: 2}
  turned: {invert: mix, full_scale: 2}
  pot: {coefficient: {turned: 0.7}, full_scale: 2}
  slow: {lag: {pot: 1, fixed: 0.5}, time_constant: 20 ms, full_scale: 2}
  primed: {lag: {mix: 1}, time_constant: 5 ms, initial: 0.2, full_scale: 2}
  speed: {integrate: {place: -900, slow: 30}, initial: 0.3, leak: 2 1/s, full_scale: 30}
  place: {integrate: {speed: 1}, initial: -0.5, full_scale: 1}
interface:
  s_place: {adc: place, bits: 14, channel: 1, conversion_time: 0.2 ms}
  s_slow: {adc: slow, bits: 12, conversion_time: 0.1 ms}
  answer: {dac: word, bits: 12, full_scale: 2, initial: 0.1}
digital:
  period: 4 ms
  compute_time: 6 ms
  skew: 0.3 ms
  remember: {word: 0.05}
  program: {word: 0.4*previous(word) - 0.2*s_place + 0.1*s_slow}
run: {until: 120.5 ms, every: 1.3 ms}
"""


@pytest.mark.parametrize("tau", [0.0, 1e-9, 1e-6, 1e-3])
def test_it_agrees_with_the_exact_engine_on_a_linear_patch(tau):
    patch = hybrid.parse_patch(EVERYTHING)
    exact = run(compile_patch(patch, {"tau": tau}))
    windows = run(compile_patch(patch, {"tau": tau}, as_circuit=True))
    scale = np.array([p.factor if p.kind != "word" else 1.0 for p in exact.pens])
    assert [p.name for p in exact.pens] == [p.name for p in windows.pens]
    assert np.max(np.abs(exact.rows - windows.rows) / scale) < 1e-9


@pytest.mark.parametrize("name", ["pitch_loop", "pitch_loop_lead", "pitch_loop_analog"])
def test_it_agrees_with_the_exact_engine_on_the_shipped_patches(name):
    patch = hybrid.read_patch(hybrid.shipped_patches()[name])
    exact = run(compile_patch(patch, machine="lags"))
    windows = run(compile_patch(patch, machine="lags", as_circuit=True))
    scale = np.array([p.factor if p.kind != "word" else 1.0 for p in exact.pens])
    assert np.max(np.abs(exact.rows - windows.rows) / scale) < 1e-9


def test_cue_by_cue_gives_the_same_bits():
    machine = compile_patch(hybrid.parse_patch(EVERYTHING), as_circuit=True)
    timeline, pens = build_timeline(machine), pens_for(machine)
    at_once = CircuitPlayer(machine, timeline, pens)
    for _ in at_once.play():
        pass
    stepped = CircuitPlayer(machine, timeline, pens)
    while stepped.outcome == 1:
        stepped.play_cues(1)
    np.testing.assert_array_equal(at_once.record, stepped.record)


def test_the_static_check_is_that_of_the_exact_engine():
    patch = hybrid.parse_patch(EVERYTHING)
    values, rates = settled(compile_patch(patch, as_circuit=True))
    exact = hybrid.check(patch)
    np.testing.assert_allclose(values, [row.value_mu for row in exact.scaling], atol=1e-15)
    for row in exact.scaling:
        if row.rate_mu is not None and row.signal != "speed":  # the leak is no input
            assert rates[row.signal] == pytest.approx(row.rate_mu, abs=1e-12)


def test_an_overload_is_told_with_its_times_and_its_worst_value():
    """x = 1.5 sin(200 t): beyond from asin(2/3)/200 on, for (pi - 2 asin(2/3))/200 in each half."""
    patch = hybrid.parse_patch(
        """
title: An oscillator that is scaled too small
machine: ideal
analog:
  v: {integrate: {x: -200}, initial: 1.5, full_scale: 2}
  x: {integrate: {v: 200}, initial: 0, full_scale: 1}
  half: {limit: x, low: -0.5, high: 0.5, full_scale: 1}
run: {until: 31.4 ms, every: 31.4 ms}
"""
    )
    (found,) = run(patch).overloads
    enters = np.arcsin(2 / 3) / 200
    assert found["signal"] == "x" and found["value"] == pytest.approx(1.0, abs=1e-11)
    # Known to 1e-8 of full scale, which it passes at 1.5 * 200 sqrt(1 - (2/3)^2) = 224 a second.
    assert found["time_s"] == pytest.approx(enters, abs=1e-8 / 224)
    assert abs(found["worst_value"]) == pytest.approx(1.5, abs=1e-8)
    tops = np.array([0.5, 1.5]) * np.pi / 200  # where it is flat to 1e-8 for sqrt(2e-8 / 1.5) / 200
    assert np.min(np.abs(found["worst_time_s"] - tops)) < 1e-6
    duration = 2 * (np.pi - 2 * np.arcsin(2 / 3)) / 200
    assert found["duration_s"] == pytest.approx(duration, abs=4e-8 / 224)


@pytest.mark.parametrize("machine", ["ideal", "lags"])
def test_an_excursion_between_two_points_is_an_overload(machine):
    """1.0001 sin: beyond for 2 arccos(1 / 1.0001) of the 2 pi, 0.45 % of a period each time."""
    patch = hybrid.parse_patch(
        """
title: A sine that hardly goes beyond
machine: ideal
analog:
  x: {sine: 1.0001, omega: 1000, full_scale: 1}
  half: {limit: x, low: -0.5, high: 0.5, full_scale: 1}
run: {until: 30 ms, every: 30 ms}
"""
    )
    (found,) = run(patch, machine=machine).overloads
    # Lags of 1 us lower it by 1/2 (1000 * 1e-6)^2 and delay it by 1 us.
    tau = 0.0 if machine == "ideal" else 1e-6
    height = 1.0001 / np.hypot(1.0, 1000 * tau)
    each_s = 2 * np.arccos(1.0 / height) / 1000
    enters_s = np.arcsin(1.0 / height) / 1000 + np.arctan(1000 * tau) / 1000
    slope = height * 1000 * np.sin(500 * each_s)
    tops = 10  # one every pi ms, the last at 9.5 pi = 29.85
    assert found["time_s"] == pytest.approx(enters_s, abs=1e-8 / slope + 1e-12)
    assert found["duration_s"] == pytest.approx(tops * each_s, abs=20e-8 / slope)
    assert abs(found["worst_value"]) == pytest.approx(height, abs=1e-8)


def test_a_lagged_relay_that_chatters_is_told():
    """Two lags of 1 us swing at 1/tau: the relay changes some 3 us after each change, 5 ms long."""
    text = """
title: Sliding relay
machine: lags
analog:
  x: {integrate: {u: 1}, initial: 0.05, full_scale: 1}
  u: {compare: {x: -1}, high: 50 1/s, low: -50 1/s, full_scale: 50 1/s}
  half: {limit: x, low: -0.5, high: 0.5, full_scale: 1}
run: {until: 3 ms, every: 1 ms}
"""
    found = hybrid.run(hybrid.parse_patch(text))
    assert found.status == "complete"
    said = re.fullmatch(
        r"u chatters from (.*) s on, (\d+) changes as fast as the lags allow: give it hysteresis",
        found.status_note,
    )
    assert said is not None, found.status_note
    assert float(said[1]) == pytest.approx(1e-3, abs=1e-5)  # 0.05 / 50
    # Harmonic balance: the integrator turns by 90 degrees, each lag by 45 at omega tau = 1.
    assert int(said[2]) == pytest.approx(2e-3 / (np.pi * 1e-6), rel=0.25)
    calm = hybrid.run(
        hybrid.parse_patch(text.replace("low: -50 1/s,", "low: -50 1/s, hysteresis: 0.02,"))
    )
    assert calm.status_note == ""


def test_a_quotient_without_a_value_at_the_start_is_named():
    text = """
title: 0/0
machine: ideal
analog:
  x: {integrate: {ratio: 100}, initial: 0, full_scale: 1}
  y: {integrate: {ratio: 100}, initial: 0, full_scale: 1}
  ratio: {divide: [x, y], full_scale: 1}
  twice: {sum: {ratio: 2}, full_scale: 2}
run: {until: 1 ms, every: 1 ms}
"""
    for machine in ("ideal", "lags"):
        for engine in ("auto", "reference"):
            with pytest.raises(
                hybrid.PatchError,
                match=r":7: component 'ratio' has no finite value at t = 0: its divisor is 0 there",
            ):
                run(hybrid.parse_patch(text), machine=machine, engine=engine)
    with pytest.raises(hybrid.PatchError, match="'ratio' has no finite value"):
        hybrid.check(hybrid.parse_patch(text))


def test_an_output_stays_within_its_saturation_and_an_integrator_does_not_wind_up():
    """x' = 100 to 1.2 full scales at 12 ms, then x' = -100 from 30 ms on: back at 0.2 at 40 ms."""
    patch = hybrid.parse_patch(
        """
title: An integrator driven into saturation and out again
machine: ideal
analog:
  drive: {step: -1, before: 1, at: 30 ms, full_scale: 1}
  x: {integrate: {drive: 100}, initial: 0, full_scale: 1, saturation: 1.2}
  twice: {sum: {x: 2}, full_scale: 1, saturation: 1.5}
run: {until: 40 ms, every: 10 ms}
"""
    )
    result = run(patch)
    columns = {pen.name: i for i, pen in enumerate(result.pens)}
    np.testing.assert_allclose(result.rows[:, columns["x"]], [0, 1, 1.2, 1.2, 0.2], atol=1e-12)
    np.testing.assert_allclose(
        result.rows[:, columns["twice"]], [0, 1.5, 1.5, 1.5, 0.4], atol=1e-12
    )
    worst = {o["signal"]: o["worst_value"] for o in result.overloads}
    assert worst == {"twice": pytest.approx(1.5), "x": pytest.approx(1.2)}


def test_an_unstable_patch_stops_with_its_overloads():
    patch = hybrid.parse_patch(
        """
title: A cubic that runs away
machine: lags
analog:
  x: {integrate: {cube: 100}, initial: 0.9, full_scale: 1}
  square: {multiply: [x, x], full_scale: 1}
  cube: {multiply: [square, x], full_scale: 1}
run: {until: 1 s, every: 1 ms}
"""
    )
    result = run(patch)
    assert result.status == "stopped"
    assert {o["signal"] for o in result.overloads} == {"x", "square", "cube"}
    assert np.all(np.isfinite(result.rows))


def test_a_comparator_that_chatters_is_reported():
    patch = hybrid.parse_patch(
        """
title: A relay without hysteresis around an integrator
machine: ideal
analog:
  x: {integrate: {relay: -100}, initial: 0.1, full_scale: 1}
  relay: {compare: {x: 1}, high: 1, low: -1, full_scale: 1}
run: {until: 1 s, every: 0.4 s}
"""
    )
    result = run(patch)
    # x falls from 0.1 at 100 a second.
    assert result.status == "stopped"
    assert result.status_note == (
        "stopped at 0.001 s: relay chatters: give it hysteresis, or what it drives a lag"
    )


def test_an_interrupt_is_heard_while_something_switches_all_the_time():
    text = """
title: Sliding relay
machine: lags
analog:
  x: {integrate: {u: 1}, initial: 0, full_scale: 1}
  u: {compare: {x: -1}, high: 1 1/s, low: -1 1/s, full_scale: 1 1/s}
run: {until: 2 s, every: 1 ms}
"""
    heard = []

    def progress(done: float) -> None:
        heard.append(done)
        if len(heard) == 3:
            raise KeyboardInterrupt

    result = hybrid.run(hybrid.parse_patch(text), progress=progress)
    assert result.status == "interrupted"
    # Two lags of 1 us switch every few us, so some 500 windows and more are played in a row's interval.
    assert 0 < len(result.time_s) < 1000
