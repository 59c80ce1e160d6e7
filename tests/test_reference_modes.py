"""IC, OP and HOLD on the reference, and the nonlinear engine beside it.

The reference resolves every lag by SciPy, at 1e-10 in each step, and settles what jumps by itself. The
nonlinear engine promises 1e-7 of full scale on nonlinear patches.
"""

import numpy as np
import pytest
from test_modes import NEWTON, OPENED

from hybrid import parse_patch, run

BOUND = 1e-7
ENGINES = ("nonlinear", "reference")
MACHINES = ("ideal", "lags")


def compare(text, machine):
    """The columns of the reference, in full scales, which those of the nonlinear engine agree with."""
    patch = parse_patch(text)
    played, reference = (run(patch, machine=machine, engine=engine) for engine in ENGINES)
    assert (played.status, reference.status) == ("complete", "complete")
    assert played.operations == reference.operations
    scale = [1.0 if pen.kind == "word" else abs(pen.factor) for pen in played.pens]
    off = np.max(np.abs(played.rows - reference.rows) / scale, axis=0)
    names = [pen.name for pen in played.pens]
    assert np.all(off < BOUND), dict(zip(names, off.tolist(), strict=True))
    return dict(zip(names, (reference.rows / scale).T, strict=True))


# -- the whole machine by time

VAN_DER_POL = """
title: Van der Pol's oscillator, again and again
analog:
  x: {integrate: {y: 1000 1/s}, initial: 0.5, full_scale: 2.5}
  y: {integrate: {x: -1000 1/s, damped: 1000 1/s}, initial: begins, full_scale: 3}
  square: {multiply: [x, x], full_scale: 6.25}
  open: {sum: {square: -1, one: 1}, full_scale: 5.25}
  damped: {multiply: [open, y], full_scale: 5}
  begins: {multiply: [clock, clock], gain: 0.5, full_scale: 1}
  clock: {sine: 1, frequency: 150 Hz, phase: 40 deg, full_scale: 1}
  one: {constant: 1, full_scale: 1}
modes: {reset: 0.3 ms, operate: 0.6 ms, hold: 0.2 ms}
run: {until: 2.1 ms, every: 0.1 ms}
"""


@pytest.mark.parametrize("machine", MACHINES)
def test_operations_of_a_nonlinear_oscillator_that_each_begin_elsewhere(machine):
    found = compare(VAN_DER_POL, machine)
    np.testing.assert_array_equal(found["mode"], ([0.0] * 3 + [1.0] * 6 + [2.0] * 2) * 2)
    first, second = found["y"][3], found["y"][14]  # where OP begins, of a full scale of 3
    for row, begun in ((3, first), (14, second)):
        wave = np.sin(2 * np.pi * 150 * row * 1e-4 + np.radians(40))
        assert begun == pytest.approx(0.5 * wave**2 / 3, abs=1e-2 if machine == "lags" else 1e-8)
    assert abs(first - second) > 0.01


LIMITED = """
title: An integrator with limits that follows a wave in IC
analog:
  wave: {sine: 1, frequency: 400 Hz, full_scale: 1}
  x: {integrate: {wave: 3000 1/s}, initial: wave, low: -0.3, high: 0.4, full_scale: 1}
  free: {integrate: {x: 500 1/s}, initial: 0.2, offset: 0.01, leak: 50 1/s, full_scale: 1}
  settled: {lag: {x: 1}, time_constant: 0.2 ms, full_scale: 1}
  begun: {lag: {x: 1}, time_constant: 0.2 ms, initial: 0.5, full_scale: 1}
  chosen: {switch: [wave, x], control: operating, full_scale: 1}
  kept: {track: x, control: resetting, leak: 100 1/s, full_scale: 1}
modes: {reset: 1 ms, operate: 0.6 ms, hold: 0.4 ms}
run: {until: 2 ms, every: 0.1 ms}
"""


@pytest.mark.parametrize("machine", MACHINES)
def test_limits_leaks_lags_stores_and_switches_in_each_mode(machine):
    """In IC x is the wave within its limits: 0.4 at 1 ms, which `kept` loses at 100/s from then on."""
    found = compare(LIMITED, machine)
    if machine == "ideal":
        x = np.clip(np.sin(800 * np.pi * np.arange(10) * 1e-4), -0.3, 0.4)
        np.testing.assert_allclose(found["x"][:10], x, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(found["settled"][:10], found["x"][:10])
        kept = 0.4 * np.exp(-100 * np.arange(10) * 1e-4)
        np.testing.assert_allclose(found["kept"][10:20], kept, rtol=0, atol=1e-11)
    held = found["free"][17:20]  # x' = 0.01 - 50 x
    expected = 2e-4 + (held[0] - 2e-4) * np.exp(-50 * np.arange(3) * 1e-4)
    np.testing.assert_allclose(held, expected, rtol=0, atol=1e-9)


# -- by comparators

PENDULUM = """
title: A pendulum that is stopped where it passes -0.3
analog:
  x: {integrate: {v: 1000 1/s}, initial: 0.8, full_scale: 1}
  v: {integrate: {pull: 1000 1/s}, initial: 0, full_scale: 1}
  sine: {sin: x, full_scale: 1}
  pull: {sum: {sine: -1}, full_scale: 1}
  slow: {lag: {x: 1}, time_constant: 0.3 ms, full_scale: 1}
  there: {compare: {x: -1}, threshold: 0.3, high: 1, full_scale: 1}
modes: {hold_when: there}
run: {until: 3 ms, every: 0.2 ms}
"""


@pytest.mark.parametrize("machine", MACHINES)
def test_a_comparator_puts_the_machine_into_hold(machine):
    """There its speed is sqrt(2 (cos 0.3 - cos 0.8)), but for what lags of 1 us make of it in 2 ms."""
    found = compare(PENDULUM, machine)
    assert (found["mode"][0], found["mode"][-1]) == (1.0, 2.0)
    speed = -np.sqrt(2 * (np.cos(0.3) - np.cos(0.8)))
    assert found["v"][-1] == pytest.approx(speed, abs=1e-9 if machine == "ideal" else 1e-2)
    lagging = 0.0 if machine == "ideal" else 1e-3  # it moves on by speed times lag
    assert found["x"][-1] == pytest.approx(-0.3, abs=1e-9 + lagging)


SAWTOOTH = """
title: A sawtooth whose rate and foot change
analog:
  saw: {integrate: {rate: 1000 1/s}, initial: foot, reset_when: top, full_scale: 1}
  rate: {multiply: [wave, wave], full_scale: 2}
  wave: {sum: {turn: 0.3, one: 1}, full_scale: 1.4}
  one: {constant: 1, full_scale: 1}
  turn: {sine: 1, frequency: 900 Hz, full_scale: 1}
  foot: {coefficient: {turn: 0.1}, full_scale: 1}
  top: {compare: {saw: 1}, threshold: 0.4, HYSTERESIS high: 1, full_scale: 1}
  upper: {compare: {saw: 1}, threshold: 0.25, high: 1, full_scale: 1}
  held: {integrate: {wave: 500 1/s}, initial: 0.1, hold_when: upper, full_scale: 1}
  kept: {track: saw, control: upper, full_scale: 1}
run: {until: 0.9 ms, every: 0.1 ms}
"""


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("hysteresis", ["", "hysteresis: 0.2,"])
def test_a_comparator_resets_one_integrator(machine, hysteresis):
    """Without hysteresis it is high for no time where nothing lags, as the state is there at once.

    A lagged output passes 0.25 on its way back at 0.1 a lag, faster than time has digits to tell.
    """
    found = compare(SAWTOOTH.replace("HYSTERESIS", hysteresis), machine)
    assert "mode" not in found
    assert np.sum(np.diff(found["saw"]) < 0) >= 1  # it falls
    assert np.max(found["saw"]) < 0.55


# -- by the digital machine, and from operation to operation

WORD = """
title: A program holds and resets
analog:
  x: {integrate: {y: 1000 1/s}, initial: 0.7, full_scale: 1}
  y: {integrate: {cube: -1000 1/s}, initial: 0.2, full_scale: 1}
  square: {multiply: [x, x], full_scale: 1}
  cube: {multiply: [square, x], full_scale: 1}
interface:
  sensed: {adc: x}
  gate: {dac: wanted, full_scale: 1, initial: 0}
  back: {dac: again, full_scale: 1, initial: 0}
digital:
  period: 0.25 ms
  remember: {count: 0}
  program:
    count: previous(count) + 1
    wanted: min(1, max(0, count - 2))
    again: min(1, max(0, count - 4))
modes: {hold_when: gate, reset_when: back}
run: {until: 1.75 ms, every: 0.25 ms}
"""


@pytest.mark.parametrize("machine", MACHINES)
def test_words_set_the_mode(machine):
    """Counts 3 and 5 begin at 0.5 and 1 ms, their results are there a cycle later; IC before HOLD."""
    found = compare(WORD, machine)
    np.testing.assert_array_equal(found["mode"], [1.0] * 3 + [2.0] * 2 + [0.0] * 3)


@pytest.mark.parametrize("machine", MACHINES)
def test_stores_carry_a_value_from_operation_to_operation(machine):
    """a -> (a + 2 / a) / 2 from 2: 3/2, 17/12, 577/408, scaled by 2."""
    text = NEWTON.replace(": 1 ms", ": 0.1 ms").replace("record: [x]", "")
    text = text.replace("until: 18 ms, every: 0.1 ms", "until: 0.9 ms, every: 0.05 ms")
    found = compare(text, machine)
    roots = [3 / 4, 17 / 24, 577 / 816]
    np.testing.assert_allclose(found["x"][3::6], roots, rtol=0, atol=1e-12)


@pytest.mark.parametrize("machine", MACHINES)
def test_the_beginning_of_what_is_yet_to_settle(machine):
    np.testing.assert_allclose(compare(OPENED, machine)["kept"], 0.1, rtol=0, atol=1e-12)
