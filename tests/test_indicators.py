"""Overload indicators: a signal and the converter that makes it are lit once, and what clips is told."""

import math

import pytest

import hybrid

# A word that rises by 0.1 V a cycle of 10 ms and is shown at once: 1.05 V is reached in cycle 10, beyond
# the DAC's 1 V; what the DAC shows is above that by its gain.
RISING = """
title: A word that rises
machine: {preset: nominal, noise: 0, tolerance: 0, tau: 1 us}
analog:
  slope: {constant: 1 V, full_scale: 2 V}
  x: {integrate: {slope: 5 1/s}, initial: 0.025 V, full_scale: 4 V}
  seen: {coefficient: {shown: 1}, full_scale: 4 V}
interface:
  s: {adc: x}
  shown: {dac: word, full_scale: 1 V, initial: 0 V}
digital: {period: 10 ms, compute_time: 0 s, program: {word: 2*s}}
run: {until: 300 ms, every: 1 ms}
"""


def overloads(text, **order):
    return {o["signal"]: o for o in hybrid.run(hybrid.parse_patch(text), **order).overloads}


@pytest.mark.parametrize("engine", ["exact", "nonlinear"])
@pytest.mark.parametrize("machine", [None, "ideal", "lags"])
def test_a_word_beyond_its_dac_is_one_overload(engine, machine):
    """Whether the DAC clips or hands all on, and whatever its output adds to the end of its range."""
    text = RISING.replace("full_scale: 1 V, initial", "full_scale: 1 V, offset: 1e-3, initial")
    found = overloads(text, machine=machine, engine=engine)
    assert set(found) == {"shown (DAC)"}
    assert found["shown (DAC)"]["time_s"] == pytest.approx(0.1, abs=1e-12)
    late = 1e-6 * 10.0  # the lag of x times its rate, V, where there is one
    assert found["shown (DAC)"]["worst_value"] == pytest.approx(3.05, abs=1.01 * late)


def test_the_output_of_a_dac_is_an_overload_of_its_own_where_it_was_first():
    """0.95 V with an offset of 0.1 V is beyond 1 V a cycle before the word is."""
    text = RISING.replace("full_scale: 1 V, initial", "full_scale: 1 V, offset: 0.1, initial")
    found = overloads(text)
    assert set(found) == {"shown", "shown (DAC)"}
    assert 0.09 <= found["shown"]["time_s"] < found["shown (DAC)"]["time_s"] == pytest.approx(0.1)
    steady = text.replace("5 1/s", "0 1/s").replace("initial: 0.025 V", "initial: 0.475 V")
    assert set(overloads(steady)) == {"shown"}  # the word is within


def test_a_dacs_overload_lasts_as_long_as_its_output_is_beyond():
    """An offset of 1e-3 lifts what is clipped at 1 V above it, to the end of the run."""
    text = RISING.replace("full_scale: 1 V, initial", "full_scale: 1 V, offset: 1e-3, initial")
    found = overloads(text, engine="nonlinear")["shown (DAC)"]
    assert found["duration_s"] == pytest.approx(0.2, abs=1e-4)


LOOP = """
title: A loop that grows
machine: {preset: nominal, noise: 0, tolerance: 0, tau: 0 s, saturation: LEVEL}
analog:
  v: {integrate: {x: -100 1/s^2, v: 0.5 1/s}, initial: 0 V/s, full_scale: 100 V/s}
  x: {integrate: {v: 1}, initial: 0.1 V, full_scale: 1 V}
run: {until: 20 s, every: 10 ms}
readouts: {mode: {transient: x}}
"""


def test_a_transient_is_read_up_to_where_an_analog_signal_saturates():
    """x grows as exp(0.25 t) to 1 V and on; at 1.1 V the integrator stops, and the loop is another. As
    where a converter clips, what is read is the loop before: omega 10 rad/s, zeta -0.025."""
    found = hybrid.run(hybrid.parse_patch(LOOP.replace("LEVEL", "1.1")))
    mode, (first, *_) = found.readouts["mode"], found.overloads
    assert first["signal"] == "x" and first["time_s"] == pytest.approx(4 * math.log(10), abs=0.7)
    assert mode["note"] == f"read up to the overload of x at {first['time_s']:.6g} s"
    assert mode["omega"] == pytest.approx(10.0, rel=1e-6)
    assert mode["zeta"] == pytest.approx(-0.025, abs=1e-6)


def test_a_signal_beyond_full_scale_that_saturates_further_up_is_read_on():
    """exp(0.25 * 20) 0.1 V = 14.8 V are beyond full scale and within the saturation."""
    found = hybrid.run(hybrid.parse_patch(LOOP.replace("LEVEL", "20")))
    assert {o["signal"] for o in found.overloads} == {"x", "v"}
    assert found.readouts["mode"]["note"] == ""


@pytest.mark.parametrize("where", ["digital", "analog"])
def test_on_either_machine_a_signal_is_one_overload_and_ranges_are_those_of_the_patch(where):
    """All digital a word has no range; all analog it is an amplifier with the DAC's full scale, and is
    one overload."""
    patch = hybrid.parse_patch(RISING, on=where)
    found = {o["signal"]: o for o in hybrid.run(patch).overloads}
    if where == "digital":
        assert found == {}
    else:
        assert set(found) == {"word"} and found["word"]["full_scale"] == 1.0
        assert found["word"]["worst_value"] == pytest.approx(3.05, rel=1e-4)
