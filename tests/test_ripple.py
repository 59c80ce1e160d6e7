"""Transients of rows between the cycles of tasks: their stated errors beside the exact modes, and what
is said where there is no such error."""

import math

import pytest

import hybrid
from hybrid.patchfile import parse_patch

# Tasks of 12 and 2 ms: they are where they were every 12 ms.
SLOW = {"attitude_loop.period": "12 ms"}


def two_rates(every, machine="ideal"):
    """The shipped attitude loop with rows so far apart."""
    text = hybrid.read_patch("rate_groups").text
    assert "every: outer" in text
    return parse_patch(text.replace("every: outer", f"every: {every}"), "rate_groups.yaml")


@pytest.mark.parametrize("machine", ["ideal", "nominal"])
@pytest.mark.parametrize("every", ["20 ms", "2 ms", "5 ms"])
def test_the_ripple_of_the_slow_rates_is_in_the_stated_error(every, machine):
    patch = two_rates(every)
    found = hybrid.run(patch, SLOW, machine=machine, seed=3).readouts["pitch_mode"]
    (exact,) = hybrid.predict(patch, SLOW, machine=machine).modes
    for name in ("omega", "omega_damped", "zeta"):
        assert abs(found[name] - getattr(exact, name)) < 3 * found[f"{name}_error"]


def test_what_dies_at_the_start_is_in_the_stated_error_beside_noise():
    """It is below what noise lets a fit resolve, and moves omega by four of its deviations."""
    patch, squares, runs = hybrid.read_patch("rate_groups"), {"omega": 0.0, "omega_damped": 0.0}, 12
    (exact,) = hybrid.predict(patch, machine="nominal").modes
    for seed in range(runs):
        found = hybrid.run(patch, machine="nominal", seed=seed).readouts["pitch_mode"]
        for name in squares:
            off = found[name] - getattr(exact, name)
            squares[name] += (off / found[f"{name}_error"]) ** 2
    # The mean of 12 squares of deviations exceeds 2.5 once in 600 where the error is right.
    assert all(sum_of / runs < 2.5 for sum_of in squares.values())


def test_rows_that_show_ripple_are_told_and_others_are_not():
    told = hybrid.run(two_rates("20 ms"), SLOW).readouts["pitch_mode"]
    assert "0.02 s apart" in told["note"]
    assert "every: 0.012 s" in told["note"]
    for every in ("12 ms", "60 ms"):
        found = hybrid.run(two_rates(every), SLOW).readouts["pitch_mode"]
        assert found["note"] == ""
        assert found["omega_error"] < 1e-12 * found["omega"]


def test_a_sweep_has_the_ripple_in_its_errors_and_its_notes():
    points = hybrid.sweep(two_rates("20 ms"), "attitude_loop.period", ["10 ms", "12 ms"])
    whole, beside = points.points
    assert whole.remarks == ""
    assert "every: 0.012 s" in beside.remarks
    errors = points.dataset["measured_omega_error"].values[:, 0]
    assert errors[0] < 1e-9 < 1e-2 < errors[1]


def test_rows_too_far_apart_to_tell_say_that_the_error_leaves_the_ripple_out():
    patch = two_rates("70 ms")  # come together with 12 ms after 0.42 s, half a period of the mode
    found = hybrid.run(patch, SLOW | {"inner_time": "0.4 ms"}).readouts["pitch_mode"]
    assert math.isfinite(found["omega"])
    assert "not in the +-" in found["note"]


def test_a_program_of_one_rate_has_the_ripple_between_its_cycles_in_its_error():
    text = hybrid.read_patch("pitch_loop").text.replace(
        "until: 10 s", "until: 3 s, every: 0.7*cycle"
    )
    patch = parse_patch(text, "pitch_loop.yaml")
    found = hybrid.run(patch, {"cycle": "50 ms"}, machine="ideal").readouts["pitch_mode"]
    exact = min(
        hybrid.predict(patch, {"cycle": "50 ms"}, machine="ideal").modes,
        key=lambda m: abs(m.omega - 10),
    )
    assert abs(found["omega"] - exact.omega) < 3 * found["omega_error"]
    assert abs(found["zeta"] - exact.zeta) < 3 * found["zeta_error"]


JITTER = """
title: A loop whose clock is late by chance
machine: ideal
parameters: {late: 1 ms, omega: 10 rad/s}
analog:
  v: {integrate: {a: 1}, initial: 0 rad/s, full_scale: 8 rad/s}
  x: {integrate: {v: 1}, initial: 0.1 rad, full_scale: 0.8 rad}
interface:
  xs: {adc: x}
  a: {dac: acc, full_scale: 80 rad/s^2, initial: 0 rad/s^2}
digital:
  tasks:
    loop: {period: 5 ms, compute_time: 0.1 ms, jitter: late, program: {acc: -omega**2 * xs}}
run: {until: 2 s, every: 5 ms}
readouts: {mode: {transient: x}}
"""


def test_a_clock_that_jitters_is_told_beside_a_transient():
    patch = parse_patch(JITTER, "jitter.yaml")
    note = hybrid.run(patch).readouts["mode"]["note"]
    assert "clock of loop jitters" in note
    assert "leaves out" in note
    assert hybrid.run(patch, {"late": 0}).readouts["mode"]["note"] == ""
