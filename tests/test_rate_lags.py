"""What lags make of the rate test: loops in order pass, and a fault of 3 % in them is found."""

import math
from dataclasses import replace

import numpy as np
import pytest

import hybrid
from hybrid import ratetest
from hybrid.compiler import compile_patch

LOOPS = {
    "one": "  x: {integrate: {x: -rate}, initial: 0.5, full_scale: 1}",
    "growing": "  x: {integrate: {x: rate}, initial: 0.5, full_scale: 1}",
    "two": """
  x: {integrate: {y: rate}, initial: 0.5, full_scale: 1}
  y: {integrate: {x: -rate, y: -rate}, initial: 0.2, full_scale: 1}""",
    "summer": """
  x: {integrate: {s: -rate}, initial: 0.5, full_scale: 1}
  s: {sum: {x: 1}, tau: 3 us, full_scale: 1}""",
    "late_on_one_way": """
  x: {integrate: {s: rate, y: -0.9 * rate}, initial: 0.5, full_scale: 1}
  y: {integrate: {x: rate}, initial: 0.5, full_scale: 1}
  s: {sum: {x: 1}, tau: 3 us, full_scale: 1}""",
    "again": """
  x: {integrate: {s: -rate}, initial: 0.5, full_scale: 1}
  s: {sum: {x: 0.3, s: 0.7}, full_scale: 1}""",
    "square": """
  x: {integrate: {s: -rate}, initial: 0.8, full_scale: 1}
  s: {multiply: [x, x], full_scale: 1}""",
    "quotient": """
  one: {constant: 0.1, full_scale: 1}
  x: {integrate: {s: -rate}, initial: 0.8, full_scale: 1}
  s: {divide: [one, x], full_scale: 1}""",
}


def machine_of(loop, preset, rate, as_circuit=False):
    text = f"""
title: A loop of lagged parts
parameters: {{rate: {rate} 1/s}}
analog:
{LOOPS[loop].lstrip(chr(10))}
run: {{until: 50 ms, every: 1 ms}}
"""
    return compile_patch(hybrid.parse_patch(text), machine=preset, as_circuit=as_circuit)


def rows_of(machine):
    rates = ratetest.static_check(machine)[1]
    return {row.integrator: row for row in ratetest.rate_test(machine, rates, None)}


@pytest.mark.parametrize("rate", [1, 10, 100, 1000])
@pytest.mark.parametrize("preset", ["lags", "nominal"])
@pytest.mark.parametrize("loop", LOOPS)
def test_a_loop_in_order_passes_and_a_fault_in_it_is_found(loop, preset, rate):
    """Lags of up to 5 us around a loop of 1000/s make 1 %, so the fault is 3 % of one gain. (An error in
    the loop `again` counts 1 / 0.3 times.)"""
    machine = machine_of(loop, preset, rate)
    assert [name for name, row in rows_of(machine).items() if row.fails] == []
    name = "s" if "s" in machine.stages else "x"
    fault = replace(machine.stages[name], gain=1.03)
    faulty = ratetest._with_stages(machine, {**machine.stages, name: fault})
    assert rows_of(faulty)["x"].fails


@pytest.mark.parametrize("rate", [10, 100, 1000])
@pytest.mark.parametrize("as_circuit", [False, True])
def test_an_integrator_with_feedback_shows_what_its_slow_pole_does(as_circuit, rate):
    """s (1 + tau s) + r = 0 from rest: -r x0 / sqrt(1 - 4 r tau). Read are means over 20 lags, from 20
    lags on, of which the cubic misses r^4 / 24 times the distances of 1 to 5 intervals, below 120."""
    machine = machine_of("one", "lags", rate, as_circuit)
    (row,) = rows_of(machine).values()
    late = rate * machine.stages["x"].tau
    shown = -0.5 * rate / math.sqrt(1.0 - 4.0 * late)
    digits = 2e-11 / (20.0 * machine.stages["x"].tau) * 28.0
    missed = 5.0 * 0.5 * rate * (20.0 * late) ** 4
    assert row.shown_mu == pytest.approx(shown, abs=missed + digits)
    assert row.allowed_mu == pytest.approx(rate * late, rel=0.02, abs=2.0 * digits)
    assert not row.fails


@pytest.mark.parametrize("loop", ["one", "two", "summer", "again"])
def test_both_ways_to_play_a_loop_allow_the_same(loop):
    plain, circuit = (rows_of(machine_of(loop, "lags", 100, which)) for which in (False, True))
    for name, row in plain.items():
        assert circuit[name].shown_mu == pytest.approx(row.shown_mu, abs=3e-5)
        assert circuit[name].allowed_mu == pytest.approx(row.allowed_mu, abs=6e-5)


def test_the_reference_starts_with_loops_of_lags_at_rest():
    """s = 0.3 x + 0.7 s rests at x; passes through the loop leave 0.7 of the rest each."""
    machine = machine_of("again", "lags", 100, as_circuit=True)
    moments = [ratetest._first_moments(machine, np.array([50.0]), way)[0] for way in (False, True)]
    compiled, plain = (start.rates_mu for start in moments)
    np.testing.assert_allclose(plain, compiled, rtol=0, atol=4.0 * ratetest.EXACT_MU / 20e-6)
