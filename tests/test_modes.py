"""IC, OP and HOLD: of the machine by time and by signals, of single integrators, from run to run.

Every figure expected here follows from the equations by hand; the machine's integrals are exact too.
"""

import math

import numpy as np
import pytest

import hybrid
from hybrid import parse_patch, run
from hybrid.charts.oscilloscope import sweeps_of
from hybrid.charts.shading import mode_spans
from hybrid.charts.strip import strip_chart
from hybrid.cli import main
from hybrid.errors import PatchError

EXACT = 1e-13  # a few roundings of figures near 1


def play(text, machine="ideal", status="complete", **parameters):
    result = run(parse_patch(text), parameters or None, machine=machine)
    assert result.status == status, result.status_note
    return result


def column(result, name):
    names = [pen.name for pen in result.pens]
    return result.rows[:, names.index(name)]


# -- the whole machine by time

RAMP = """
title: Ramp
parameters: {rest: 1 ms, count: 1}
analog:
  one: {constant: 1, full_scale: 1}
  x: {integrate: {one: 100 1/s}, initial: 0.2, full_scale: 1}
modes: {reset: 1 ms, operate: 4 ms, hold: rest}
run: {until: 20 ms, every: 0.5 ms}
"""


def test_repetitive_operation_of_an_integrator_is_a_sawtooth():
    """0.2 for 1 ms, then 100/s for 4 ms, then 0.6 for 1 ms; a row shows what holds from it on."""
    result = play(RAMP)
    phase = np.arange(41) % 12 * 0.5e-3
    expected = 0.2 + 100 * np.clip(phase - 1e-3, 0.0, 4e-3)
    np.testing.assert_allclose(column(result, "x"), expected, rtol=0, atol=EXACT)
    mode = np.where(phase < 1e-3, 0.0, np.where(phase < 5e-3, 1.0, 2.0))
    np.testing.assert_array_equal(column(result, "mode"), mode)
    assert result.operations == 3


HELD_FOR_GOOD = """
title: Held for good
analog:
  one: {ramp: 100 1/s, full_scale: FULL}
  x: {integrate: {one: 1 1/s}, initial: 0, full_scale: 100}
modes: {reset: 1 ms, operate: 20 ms, hold: 5 ms}
run: {until: 60 ms, every: 0.5 ms, on_overload: hold}
"""


@pytest.mark.parametrize(("full_scale", "whole"), [(1.5, 0), (2.3, 1), (4, 1), (5, 2)])
def test_operations_of_a_machine_held_for_good_are_those_before(full_scale, whole):
    """The ramp is beyond its full scale at 15, 23, 40 and 50 ms; OP ends at 21, 47 and 73 ms."""
    result = play(HELD_FOR_GOOD.replace("FULL", str(full_scale)))
    assert f"in HOLD since {full_scale / 100:g} s" in result.status_note
    assert result.operations == whole
    assert f"{whole} operations" in strip_chart(result.record).texts[1].get_text()
    sweeps = sweeps_of(result.record, "x")  # an operation that the overload ends has begun
    assert len(sweeps) == {1.5: 1, 2.3: 1, 4: 2, 5: 2}[full_scale]


def test_without_hold_the_next_operation_follows_at_once():
    result = play(RAMP, rest=0.0)
    phase = np.arange(41) % 10 * 0.5e-3
    expected = 0.2 + 100 * np.clip(phase - 1e-3, 0.0, None)
    np.testing.assert_allclose(column(result, "x"), expected, rtol=0, atol=EXACT)
    assert set(column(result, "mode")) == {0.0, 1.0}
    assert result.operations == 4  # the last ends with the run


@pytest.mark.parametrize("hold", ["1 ms", "0 s"])
def test_after_the_last_operation_the_machine_holds(hold):
    text = RAMP.replace("hold: rest", f"hold: {hold}, operations: 2")
    result = play(text)
    assert result.operations == 2
    late = result.time_s > (11 if hold == "1 ms" else 10) * 1e-3 - 1e-9
    assert np.all(column(result, "mode")[late] == 2.0)
    last = column(result, "x")[late]
    assert last[0] == pytest.approx(0.6, abs=EXACT)
    assert np.all(last == last[0])  # to the last bit


OSCILLATOR = """
title: Circle
parameters: {omega: 1000 rad/s}
analog:
  x: {integrate: {y: omega}, initial: 0.5, full_scale: 1}
  y: {integrate: {x: -omega}, initial: 0.1, full_scale: 1}
modes: {reset: 1 ms, operate: 7 ms, hold: 2 ms}
run: {until: 100 ms, every: EVERY}
"""


@pytest.mark.parametrize("every", ["0.1 ms", "0.13 ms"])  # one tile repeated; event by event
@pytest.mark.parametrize("machine", ["ideal", "lags"])
def test_every_operation_repeats_the_one_before(machine, every):
    result = play(OSCILLATOR.replace("EVERY", every), machine)
    assert result.operations == 10
    for name in ("x", "y"):
        values, mode = column(result, name), column(result, "mode")
        held = values[mode == 2.0]
        edges = np.flatnonzero(np.diff(result.time_s[mode == 2.0]) > 1e-3) + 1
        kept = [group[-1] for group in np.split(held, edges)]  # all lags have settled
        assert len(kept) == 10
        # To the last bit where rows and windows are the same in each; lags lengthen windows by and by.
        if (every, machine) == ("0.1 ms", "ideal"):
            assert kept[1:] == kept[1:2] * 9
        assert kept == pytest.approx(kept[1:2] * 10, abs=1e-11)
    angle, steps = 7.0, (math.cos(7.0), math.sin(7.0))
    if machine == "ideal":
        x = 0.5 * steps[0] + 0.1 * steps[1]
        assert column(result, "x")[mode == 2.0][-1] == pytest.approx(x, abs=angle * 1e-11)


def test_rows_of_one_operation_are_those_of_the_next_to_the_last_bit():
    result = play(OSCILLATOR.replace("EVERY", "0.1 ms"))
    for name in ("x", "y"):
        operations = column(result, name)[:-1].reshape(10, 100)
        np.testing.assert_array_equal(operations[1:], np.tile(operations[1], (9, 1)))


def test_hold_keeps_every_value_to_the_last_bit_and_op_goes_on_from_it():
    """Two seconds of OP with a pause in between give what two seconds without give."""
    text = OSCILLATOR.replace("EVERY", "0.5 ms").replace(
        "modes: {reset: 1 ms, operate: 7 ms, hold: 2 ms}", "modes: {hold_when: pause}"
    )
    text = text.replace(
        "modes:",
        "  clock: {sine: 1, frequency: 100 Hz, phase: -90 deg, full_scale: 1}\n"
        "  pause: {compare: {clock: 1}, high: 1, full_scale: 1}\n"
        "modes:",
    )
    result = play(text)  # high from 2.5 to 7.5 ms of every 10 ms
    x, mode = column(result, "x"), column(result, "mode")
    turn = np.floor(result.time_s / 10e-3 + 1e-9)
    phase = result.time_s - 10e-3 * turn
    inside = (phase > 2.6e-3) & (phase < 7.4e-3)
    assert np.all(mode[inside] == 2.0)
    for k in range(10):
        held = x[inside & (turn == k)]
        assert len(held) == 9 and np.all(held == held[0])
    # Event times are known to 1e-12 s and better; the angle turned is omega times the time in OP.
    operated = (
        np.where(phase < 2.5e-3, phase, np.where(phase < 7.5e-3, 2.5e-3, phase - 5e-3))
        + 5e-3 * turn
    )
    outside = ~inside & (np.abs(phase - 2.5e-3) > 1e-9) & (np.abs(phase - 7.5e-3) > 1e-9)
    expected = 0.5 * np.cos(1000 * operated) + 0.1 * np.sin(1000 * operated)
    np.testing.assert_allclose(x[outside], expected[outside], rtol=0, atol=1e-9)


# -- lags in the modes


def test_after_release_a_lagged_output_follows_as_theory_says():
    """In IC for 100 lags; then x = 0.2 + r t behind a lag: y = x - r tau (1 - exp(-t/tau))."""
    tau, rate = 1e-6, 2e4
    text = f"""
title: Release
machine: {{preset: ideal}}
analog:
  one: {{constant: 1, full_scale: 1}}
  x: {{integrate: {{one: {rate} 1/s}}, initial: 0.2, full_scale: 1, tau: 1 us}}
modes: {{reset: 100 us, operate: 20 us, hold: 80 us}}
run: {{until: 400 us, every: 0.5 us}}
"""
    result = run(parse_patch(text))
    t = result.time_s % 200e-6 - 100e-6
    first = result.time_s < 200e-6 - 1e-9
    ramp = np.clip(t, 0.0, 20e-6)
    lag = rate * tau * (1 - np.exp(-ramp / tau))
    since = np.clip(t - 20e-6, 0.0, None)
    expected = 0.2 + rate * ramp - lag * np.exp(-since / tau)
    np.testing.assert_allclose(column(result, "x")[first], expected[first], rtol=0, atol=1e-9)
    # Back in IC from 0.6: the state jumps, the output follows.
    second = (result.time_s > 200e-6 - 1e-9) & (t < -1e-9)
    back = 0.2 + 0.4 * np.exp(-(t[second] + 100e-6) / tau)
    np.testing.assert_allclose(column(result, "x")[second], back, rtol=0, atol=1e-9)


def test_offset_and_leak_act_in_hold():
    """Inputs are off in HOLD; what the integrator itself adds and loses is not: x' = offset - leak x."""
    text = """
title: Drift
analog:
  one: {constant: 1, full_scale: 1}
  x: {integrate: {one: 100 1/s}, initial: 0.2, full_scale: 1, offset: 0.001, leak: 0 1/s}
  y: {integrate: {one: 100 1/s}, initial: 0.2, full_scale: 1, leak: 10 1/s}
modes: {reset: 1 ms, operate: 4 ms, hold: 995 ms}
run: {until: 0.9 s, every: 5 ms}
"""
    result = play(text)
    t = result.time_s[1:] - 5e-3
    x = 0.2 + (100 + 0.001) * 4e-3 + 0.001 * t
    np.testing.assert_allclose(column(result, "x")[1:], x, rtol=0, atol=1e-12)
    y5 = 10.0 + (0.2 - 10.0) * math.exp(-10 * 4e-3)
    np.testing.assert_allclose(column(result, "y")[1:], y5 * np.exp(-10 * t), rtol=0, atol=1e-11)


def test_a_wanted_lag_settles_in_ic_and_stays_in_hold():
    """In IC it stands at its inputs, or at its initial value; in OP it moves; HOLD keeps it."""
    text = """
title: Lags
analog:
  one: {constant: 1, full_scale: 1}
  ramp: {integrate: {one: 100 1/s}, initial: 0.2, full_scale: 1}
  settled: {lag: {ramp: 1}, time_constant: 2 ms, full_scale: 1}
  begun: {lag: {ramp: 1}, time_constant: 2 ms, initial: 0.5, full_scale: 1}
modes: {reset: 1 ms, operate: 4 ms, hold: 5 ms}
run: {until: 20 ms, every: 1 ms}
"""
    result = play(text)
    t = np.clip(result.time_s % 10e-3 - 1e-3, 0.0, 4e-3)
    for name, start in (("settled", 0.2), ("begun", 0.5)):
        expected = 100 * (t - 2e-3) + 0.2 + (start - 0.2 + 100 * 2e-3) * np.exp(-t / 2e-3)
        np.testing.assert_allclose(column(result, name), expected, rtol=0, atol=1e-9)


def test_in_ic_a_limited_integrator_follows_within_its_limits():
    """A wave of 400 Hz between -0.3 and 0.4: it comes to a limit and leaves it again."""
    text = """
title: Limits in IC
analog:
  one: {constant: 1, full_scale: 1}
  wave: {sine: 1, frequency: 400 Hz, full_scale: 1}
  x: {integrate: {one: 1 1/s}, initial: wave, low: -0.3, high: 0.4, full_scale: 1}
modes: {reset: 5 ms, operate: 1 ms}
run: {until: 4 ms, every: 0.1 ms}
"""
    result = play(text)
    x = np.clip(np.sin(800 * np.pi * result.time_s), -0.3, 0.4)
    np.testing.assert_allclose(column(result, "x"), x, rtol=0, atol=1e-12)


OPENED = """
title: A store whose comparator reads what is yet to settle
analog:
  late: {integrate: {kept: 1 1/s}, initial: low, full_scale: 1}
  low: {constant: -0.5, full_scale: 1}
  first: {track: late, control: always, full_scale: 1}
  always: {compare: {low: -1}, high: 1, full_scale: 1}
  above: {compare: {first: 1}, threshold: -0.3, high: 1, full_scale: 1}
  kept: {track: low, control: above, initial: 0.1, full_scale: 1}
run: {until: 0.1 ms, every: 0.05 ms}
"""


@pytest.mark.parametrize("machine", ["ideal", "lags"])
def test_what_a_store_holds_at_first_outlasts_the_settling(machine):
    """`above` is low at t = 0, as `late` begins at -0.5: `kept` holds 0.1 and was never open."""
    result = play(OPENED, machine)
    np.testing.assert_allclose(column(result, "kept"), 0.1, rtol=0, atol=EXACT)
    rises = 0.1 * result.time_s - 0.5
    np.testing.assert_allclose(column(result, "first"), rises, rtol=0, atol=1e-6)


# -- by signals


def test_a_comparator_stops_a_ramp_at_its_threshold():
    """x = 100 t reaches 0.37 at 3.7 ms, between two rows; the machine holds it there."""
    text = """
title: Stopwatch
analog:
  one: {constant: 1, full_scale: 1}
  x: {integrate: {one: 100 1/s}, initial: 0, full_scale: 1}
  clock: {integrate: {one: 50 1/s}, initial: 0, full_scale: 1}
  there: {compare: {x: 1}, threshold: 0.37, high: 1, full_scale: 1}
modes: {hold_when: there}
run: {until: 10 ms, every: 1 ms}
"""
    result = play(text)
    assert column(result, "x")[-1] == pytest.approx(0.37, abs=EXACT)
    assert column(result, "clock")[-1] == pytest.approx(50 * 3.7e-3, abs=EXACT)
    np.testing.assert_array_equal(column(result, "mode"), [1.0] * 4 + [2.0] * 7)


def test_one_integrator_held_and_one_reset_while_the_others_go_on():
    """`saw` is reset at 0.5 and so repeats every 4 ms from 0.1; `held` integrates while saw < 0.3."""
    text = """
title: Sawtooth
analog:
  one: {constant: 1, full_scale: 1}
  t: {integrate: {one: 50 1/s}, initial: 0, full_scale: 1}
  saw: {integrate: {one: 100 1/s}, initial: 0.1, reset_when: top, full_scale: 1}
  top: {compare: {saw: 1}, threshold: 0.4, hysteresis: 0.2, high: 1, full_scale: 1}
  upper: {compare: {saw: 1}, threshold: 0.3, high: 1, full_scale: 1}
  held: {integrate: {one: 50 1/s}, initial: 0, hold_when: upper, full_scale: 1}
run: {until: 18 ms, every: 0.25 ms}
"""
    result = play(text)
    at = np.abs(result.time_s / 4e-3 - np.round(result.time_s / 4e-3)) < 1e-9
    phase = result.time_s % 4e-3
    np.testing.assert_allclose(
        column(result, "saw")[~at], 0.1 + 100 * phase[~at], rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(column(result, "t"), 50 * result.time_s, rtol=0, atol=1e-12)
    operated = np.floor(result.time_s / 4e-3) * 2e-3 + np.clip(phase, 0.0, 2e-3)
    np.testing.assert_allclose(column(result, "held")[~at], 50 * operated[~at], rtol=0, atol=1e-12)
    assert "mode" not in [pen.name for pen in result.pens]


def test_the_digital_machine_holds_through_a_dac():
    """The program counts 10 cycles of 1 ms; its result reaches the DAC a cycle later, at 10 ms."""
    text = """
title: Gate
analog:
  one: {constant: 1, full_scale: 1}
  x: {integrate: {one: 50 1/s}, initial: 0, full_scale: 1}
interface:
  gate: {dac: wanted, full_scale: 1, initial: 0}
digital:
  period: 1 ms
  remember: {count: 0}
  program:
    count: previous(count) + 1
    wanted: min(1, max(0, count - 9))
modes: {hold_when: gate}
run: {until: 15 ms, every: 0.25 ms}
"""
    for machine in ("ideal", "lags"):  # the mode does not wait for the DAC's lag
        result = play(text, machine)
        x = 50 * np.clip(result.time_s, 0.0, 10e-3)
        if machine == "ideal":
            np.testing.assert_allclose(column(result, "x"), x, rtol=0, atol=EXACT)
        assert column(result, "x")[-1] == pytest.approx(0.5, abs=1e-12)


# -- from operation to operation

NEWTON = """
title: Newton's square root of 2, one step an operation
analog:
  half: {constant: 0.5, full_scale: 1}
  # (a + 2 / a) / 2 of the value kept from the last operation, scaled by 2
  inverse: {divide: [half, kept], full_scale: 1}
  better: {sum: {kept: 0.5, inverse: 0.5}, full_scale: 1}
  x: {integrate: {zero: 1 1/s}, initial: better, full_scale: 1}
  zero: {constant: 0, full_scale: 1}
  caught: {track: x, control: operating, initial: 1, full_scale: 1}
  kept: {track: caught, control: holding, initial: 1, full_scale: 1}
modes: {reset: 1 ms, operate: 1 ms, hold: 1 ms}
run: {until: 18 ms, every: 1 ms}
record: [x]
"""


def test_newton_iteration_from_operation_to_operation():
    """a -> (a + 2 / a) / 2 from 2, with a = 2 kept: 1.5, 17/12, 577/408, ... and then the root."""
    values = column(play(NEWTON), "x")[1::3]
    a, expected = 2.0, []
    for _ in values:
        a = (a + 2 / a) / 2
        expected.append(a / 2)
    np.testing.assert_allclose(values, expected, rtol=0, atol=EXACT)
    assert expected[-1] == pytest.approx(math.sqrt(0.5), abs=EXACT)


@pytest.mark.parametrize("machine", ["ideal", "lags"])
def test_a_pair_of_stores_sums_a_geometric_series(machine):
    """x starts where it ended, times 1/2, and gains 0.25 an operation: x_n = 0.5 (1 - 2^-n)."""
    text = """
title: Series
analog:
  one: {constant: 1, full_scale: 1}
  x: {integrate: {one: 25 1/s}, initial: halved, full_scale: 1}
  caught: {track: x, control: operating, full_scale: 1}
  kept: {track: caught, control: resetting, full_scale: 1}
  halved: {coefficient: {kept: 0.5}, full_scale: 1}
modes: {reset: 1 ms, operate: 10 ms, hold: 1 ms}
run: {until: 120 ms, every: 1 ms}
"""
    result = play(text, machine)
    ends = column(result, "x")[11:-1:12]
    # With lags x shows, and `caught` keeps, what the state was 1 us ago (the lag of a ramp).
    missing = 0.0 if machine == "ideal" else 25 * 1e-6
    x, expected = 0.0, []
    for _ in ends:
        x = 0.25 + 0.5 * (expected[-1] if expected else 0.0)
        expected.append(x - missing)
    np.testing.assert_allclose(ends, expected, rtol=0, atol=1e-9)
    if machine == "ideal":
        n = np.arange(1, len(ends) + 1)
        np.testing.assert_allclose(ends, 0.5 * (1 - 0.5**n), rtol=0, atol=EXACT)


def test_a_store_keeps_what_it_shows_whatever_its_full_scale():
    """Full scales of 4 and 10: x rises by 100/s from 1 to 1.4 V, stored in HOLD as 1.4 V."""
    text = """
title: Store
analog:
  one: {constant: 1 V, full_scale: 1 V}
  x: {integrate: {one: 100 1/s}, initial: 1 V, full_scale: 4 V}
  kept: {track: x, control: operating, initial: 3 V, full_scale: 10 V}
modes: {reset: 1 ms, operate: 4 ms, hold: 1 ms}
run: {until: 12 ms, every: 0.5 ms}
"""
    for machine in ("ideal", "lags"):
        result = play(text, machine)
        t = result.time_s
        kept = np.where(t < 1e-3 - 1e-9, 3.0, np.where(t % 6e-3 < 1e-3 - 1e-9, 1.4, np.nan))
        kept = np.where(t % 6e-3 > 5e-3 + 1e-9, 1.4, kept)
        known = np.isfinite(kept)
        # With lags it keeps what x showed a microsecond ago.
        late = 0.0 if machine == "ideal" else 100 * 1e-6
        expected = np.where(t < 1e-3 - 1e-9, kept, kept - late)
        found = column(result, "kept")
        np.testing.assert_allclose(found[known], expected[known], rtol=0, atol=1e-9)


# -- overload


def overloaded(what, machine="ideal", every="1 ms"):
    return f"""
title: Too far
machine: {machine}
analog:
  one: {{constant: 1, full_scale: 1}}
  x: {{integrate: {{one: 100 1/s}}, initial: 0, full_scale: 1}}
  y: {{integrate: {{x: 100 1/s}}, initial: 0.2, full_scale: 2}}
  bent: {{absolute: y, full_scale: 2}}
run: {{until: 20 ms, every: {every}, on_overload: {what}}}
"""


def test_a_run_stops_where_a_signal_goes_beyond_full_scale():
    """x = 100 t, at full scale at 10 ms; rows every 0.7 ms, so the instant is found between two."""
    result = play(overloaded("stop", every="0.7 ms"), status="stopped")
    assert "x is beyond its full scale" in result.status_note
    assert "stopped at 0.01 s" in result.status_note
    assert len(result.time_s) == 15
    assert result.overloads[0]["signal"] == "x"
    assert result.overloads[0]["time_s"] == pytest.approx(10e-3, abs=1e-12)


def test_the_machine_holds_where_a_signal_goes_beyond_full_scale():
    result = play(overloaded("hold", every="0.7 ms"))
    assert "in HOLD since 0.01 s: x went beyond" in result.status_note
    assert column(result, "x")[-1] == pytest.approx(1.0, abs=1e-11)
    assert column(result, "y")[-1] == pytest.approx(0.2 + 100 * 100 * 1e-4 / 2, abs=1e-11)
    np.testing.assert_array_equal(column(result, "mode"), [1.0] * 15 + [2.0] * 14)
    assert [o["signal"] for o in result.overloads] == ["x"]


def test_by_default_the_run_goes_on():
    result = play(overloaded("continue"))
    assert column(result, "x")[-1] == pytest.approx(2.0, abs=1e-12)


def test_a_linear_run_stops_where_full_scale_is_passed():
    """At 10 ms, between the rows of 9.8 and 10.5 ms."""
    text = overloaded("stop", every="0.7 ms").replace("  bent: {absolute: y, full_scale: 2}\n", "")
    result = play(text, status="stopped")
    assert "stopped at 0.01 s: x" in result.status_note
    assert len(result.time_s) == 15
    assert hybrid.predict(parse_patch(text)).modes


def test_a_linear_run_that_begins_beyond_full_scale_stops_with_its_first_row():
    text = overloaded("stop").replace("  bent: {absolute: y, full_scale: 2}\n", "")
    text = text.replace("one: {constant: 1,", "one: {constant: 1.5,")
    result = play(text, status="stopped")
    assert "stopped at 0 s: one" in result.status_note
    assert len(result.time_s) == 1


@pytest.mark.parametrize("what", ["hold", "stop"])
def test_a_converter_beyond_its_range_counts_too(what):
    """The program doubles its count: 1, 2, 4 at the DAC of full scale 3 at 1, 2, 3 ms."""
    text = f"""
title: Count
analog:
  one: {{constant: 1, full_scale: 1}}
  x: {{integrate: {{one: 20 1/s}}, initial: 0, full_scale: 1}}
interface: {{out: {{dac: word, full_scale: 3, initial: 0}}}}
digital: {{period: 1 ms, remember: {{word: 0.5}}, program: {{word: 2 * previous(word)}}}}
run: {{until: 6 ms, on_overload: {what}}}
"""
    result = run(parse_patch(text), machine="ideal")
    assert "out (DAC)" in {o["signal"] for o in result.overloads}
    assert result.overloads[0]["time_s"] == 3e-3
    if what == "stop":
        assert result.status == "stopped" and len(result.time_s) == 3
    else:
        assert "in HOLD since 0.003 s: out" in result.status_note
        assert column(result, "x")[-1] == pytest.approx(0.06, abs=EXACT)


# -- what is predicted and checked


def test_the_prediction_is_that_of_the_patch_in_op():
    with_modes = parse_patch(OSCILLATOR.replace("EVERY", "0.1 ms"))
    plain = parse_patch(
        OSCILLATOR.replace("EVERY", "0.1 ms").replace(
            "modes: {reset: 1 ms, operate: 7 ms, hold: 2 ms}\n", ""
        )
    )
    for machine in ("ideal", "lags"):
        found, expected = (
            hybrid.predict(p, machine=machine).to_dicts() for p in (with_modes, plain)
        )
        assert found == expected
        assert found[0]["omega"] == pytest.approx(1000.0, rel=1e-5)


def test_the_static_check_shows_what_ic_gives():
    found = {
        row.signal: row.value for row in hybrid.check(parse_patch(NEWTON), machine="ideal").scaling
    }
    assert found["x"] == pytest.approx(0.75, abs=EXACT)
    assert found["kept"] == 1.0


# -- mistakes

MISTAKES = [
    ("modes: {operate: 4 ms}", "no reset"),
    ("modes: {reset: 4 ms}", "no operate"),
    ("modes: {}", "modes is empty"),
    ("modes: {hold: 1 ms}", "hold needs operate"),
    ("modes: {operations: 3}", "operations needs operate"),
    ("modes: {reset: 0 s, operate: 4 ms}", "must be greater than 0"),
    ("modes: {reset: 1 ms, operate: 4 V}", "must be a time"),
    ("modes: {reset: 1 ms, operate: 4 ms, operations: 0}", "whole number from 1"),
    ("modes: {hold_when: x}", "a control is a comparator, a DAC, or a step"),
    ("modes: {hold_when: y}", "unknown signal 'y'"),
    ("modes: {hold_when: operating}", "cannot set itself"),
    ("modes: {stop_when: x}", "unknown key 'stop_when'"),
    ("modes: 5", "modes must be a mapping"),
]


@pytest.mark.parametrize(("wrong", "says"), MISTAKES, ids=[m[0] for m in MISTAKES])
def test_mistakes_in_modes(wrong, says):
    right = "modes: {reset: 1 ms, operate: 4 ms, hold: rest}"
    with pytest.raises(PatchError, match=says) as caught:
        parse_patch(RAMP.replace(right, wrong), "ramp.yaml")
    assert str(caught.value).startswith("ramp.yaml:7")


INTEGRATORS = [
    ("initial: 0.2", "initial: nothing", "nothing"),
    ("initial: 0.2", "initial: volts", "is the signal 'volts', which is in V"),
    ("initial: 0.2", "initial: 0.2, hold_when: one", "is held by 'one'; a control is"),
    ("initial: 0.2", "initial: 0.2, reset_when: no", "is reset by unknown signal 'no'"),
]


@pytest.mark.parametrize(("old", "new", "says"), INTEGRATORS, ids=[m[1] for m in INTEGRATORS])
def test_mistakes_in_the_modes_of_an_integrator(old, new, says):
    text = RAMP.replace("modes:", "  volts: {constant: 1 V, full_scale: 1 V}\nmodes:")
    with pytest.raises(PatchError, match=says) as caught:
        parse_patch(text.replace(old, new), "ramp.yaml")
    assert str(caught.value).startswith("ramp.yaml:6")


def test_the_mode_is_told_only_where_there_are_modes():
    text = RAMP.replace("modes: {reset: 1 ms, operate: 4 ms, hold: rest}\n", "")
    text = text.replace("run:", "  s: {track: x, control: operating, full_scale: 1}\nrun:")
    with pytest.raises(PatchError, match="the patch has no modes:"):
        parse_patch(text)


@pytest.mark.parametrize("name", ["mode", "operating", "holding", "resetting"])
def test_names_of_the_mode_are_taken(name):
    with pytest.raises(PatchError, match="tells the mode of the machine"):
        parse_patch(RAMP.replace("  x:", f"  {name}:"))


def test_a_loop_through_an_initial_value_needs_a_store_or_a_lag():
    text = RAMP.replace("initial: 0.2", "initial: twice").replace(
        "modes:", "  twice: {coefficient: {x: 0.5}, full_scale: 1}\nmodes:"
    )
    with pytest.raises(
        PatchError, match=r"algebraic loop .* in IC: twice -> x -> twice.*track-store"
    ):
        hybrid.check(parse_patch(text), machine="ideal")


def test_a_loop_through_stores_that_signals_control_says_that_these_are_not_looked_at():
    text = """
title: In anti-phase
analog:
  up: {square: 1, period: 10 ms, full_scale: 2}
  down: {compare: {up: -1}, high: 1, full_scale: 1}
  one: {constant: 0.1, full_scale: 1}
  a: {track: more, control: up, full_scale: 1}
  b: {track: a, control: down, full_scale: 1}
  more: {sum: {b: 1, one: 1}, full_scale: 1}
run: {until: 50 ms, every: 1 ms}
"""
    with pytest.raises(
        PatchError, match=r"a -> b -> more -> a; .* signals that control it are not"
    ):
        hybrid.check(parse_patch(text), machine="ideal")
    without = text.replace("{track: a, control: down,", "{coefficient: {a: 1},").replace(
        "{track: more, control: up,", "{coefficient: {more: 1},"
    )
    with pytest.raises(PatchError, match=r"; give one of them a tau above 0, [^;]*$"):
        hybrid.check(parse_patch(without), machine="ideal")


def test_a_mode_that_sets_itself_through_a_store_is_a_loop():
    text = RAMP.replace("hold: rest}", "hold_when: full}").replace(
        "modes:",
        "  stored: {track: one, control: operating, full_scale: 1}\n"
        "  full: {compare: {stored: 1}, threshold: 0.5, high: 1, full_scale: 1}\nmodes:",
    )
    with pytest.raises(PatchError, match="algebraic loop"):
        hybrid.check(parse_patch(text), machine="ideal")


def test_on_overload_names_its_choices():
    with pytest.raises(PatchError, match=r"on_overload is 'halt'.*hold"):
        parse_patch(RAMP.replace("every: 0.5 ms", "every: 0.5 ms, on_overload: halt"))


def test_the_exact_engine_plays_no_modes_but_stops():
    for text in (RAMP, overloaded("hold")):
        with pytest.raises(PatchError, match="take nonlinear"):
            run(parse_patch(text), machine="ideal", engine="exact")
    text = overloaded("stop").replace("  bent: {absolute: y, full_scale: 2}\n", "")
    assert run(parse_patch(text), engine="exact").status == "stopped"


@pytest.mark.parametrize("what", ["hold", "stop"])
def test_the_reference_refuses_what_an_overload_does(what):
    with pytest.raises(PatchError, match="knows no on_overload but continue; take nonlinear"):
        run(parse_patch(overloaded(what)), machine="ideal", engine="reference")


def test_the_trial_run_of_check_goes_on_beyond_an_overload():
    """x = 100 t for 20 ms: twice its full scale of 1, whatever the run does there."""
    for what in ("continue", "hold", "stop"):
        check = hybrid.check(parse_patch(overloaded(what)), machine="ideal")
        used = {row.signal: row.used for row in check.scaling}
        assert used["x"] == pytest.approx(2.0, abs=1e-12)


# -- what is shown


def test_ic_and_hold_are_shaded_on_the_strip_chart():
    """A row's mode holds to the next row: IC 0 to 1 ms and 6 to 7 ms, HOLD 5 to 6 ms, and so on."""
    result = play(RAMP)
    spans = mode_spans(result.time_s, column(result, "mode"))
    expected = [(0, 1, 0), (5, 6, 2), (6, 7, 0), (11, 12, 2), (12, 13, 0), (17, 18, 2), (18, 19, 0)]
    assert [s[2] for s in spans] == [e[2] for e in expected]
    for span, (start, end, _) in zip(spans, expected, strict=True):
        assert span[:2] == pytest.approx((start * 1e-3, end * 1e-3), abs=1e-12)
    figure = strip_chart(result.record)
    lanes = [axes for axes in figure.axes if axes.lines]
    assert len(lanes) == 2  # one and x; the mode has no lane
    for axes in lanes:
        assert len(axes.patches) == len(expected)
    texts = " ".join(text.get_text() for text in figure.texts)
    assert "3 operations" in texts and "HOLD shaded" in texts


def test_too_many_spans_are_not_drawn():
    mode = np.tile([0.0, 1.0], 5000)
    assert mode_spans(np.arange(10000) * 1e-3, mode) == []


def test_the_command_says_what_it_ran_and_that_an_overload_stopped_it(tmp_path, capsys):
    (tmp_path / "ramp.yaml").write_text("time_scale: 100\n" + RAMP.lstrip(), encoding="utf-8")
    given = ["--machine", "ideal", "--no-chart", "--out", str(tmp_path)]
    assert main(["run", str(tmp_path / "ramp.yaml"), *given]) == 0
    out = capsys.readouterr().out
    assert "3 operations of 0.004 s" in out and "100 times real time" in out
    by_signals = RAMP.replace("hold: rest}", "hold: rest, reset_when: over}")
    over = (
        "  over: {compare: {x: 1}, threshold: 0.5, hysteresis: 0.2, high: 1, full_scale: 1}\nmodes"
    )
    (tmp_path / "cut.yaml").write_text(by_signals.lstrip().replace("modes", over, 1))
    assert main(["run", str(tmp_path / "cut.yaml"), *given]) == 0
    assert "3 operations of 0.004 s by the clock" in capsys.readouterr().out
    (tmp_path / "far.yaml").write_text(overloaded("stop").lstrip(), encoding="utf-8")
    assert main(["run", str(tmp_path / "far.yaml"), *given]) == 1
    assert "x is beyond its full scale" in capsys.readouterr().out


def test_the_record_tells_what_its_numbers_of_the_mode_mean():
    about = play(RAMP).record["mode"].attrs
    assert about["flag_meanings"].split() == ["IC", "OP", "HOLD"]
    assert list(about["flag_values"]) == [0.0, 1.0, 2.0]
