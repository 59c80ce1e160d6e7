"""The nonlinear engine against exact solutions and against SciPy with every lag resolved."""

import math

import numpy as np
import pytest
from builder import Builder
from scipy.optimize import brentq

from hybrid.elements import (
    SIN,
    abs_pieces,
    comparator_pieces,
    dead_zone_pieces,
    limit_pieces,
    table_pieces,
)
from hybrid.engine.corners import new_log
from hybrid.engine.nodes import new_shelf, nodes
from hybrid.engine.propagator import exponential_minus_one
from hybrid.engine.reference import Reference
from hybrid.engine.relaxation import CHATTER, DONE, PAUSED, RUNAWAY, Pen, advance, no_pen
from hybrid.engine.sweep import (
    EVENTS,
    LAST_WINDOW,
    NEXT,
    REJECTED,
    SWEEPS,
    WINDOWS,
    new_state,
)


class Run:
    def __init__(self, builder, q=8, rtol=1e-9):
        self.circuit, self.place = builder.build()
        self.state, self.grid = new_state(self.circuit, q), nodes(q)
        self.shelf, self.log = new_shelf(len(self.circuit.laws)), new_log()
        self.rtol, self.t_s = rtol, 0.0

    def play(self, duration_s, held=None, pen=None):
        if held is not None:
            self.state.held[:] = held
        outcome, reached = advance(
            self.circuit,
            self.state,
            self.shelf,
            self.grid,
            self.t_s,
            duration_s,
            self.rtol,
            self.log,
            no_pen() if pen is None else pen,
            None,
        )
        self.t_s += reached
        return outcome

    def record(self, duration_s, instants_s, names):
        values = np.full((len(instants_s), len(names)), np.nan)
        signals = np.array([self.place[n] for n in names])
        assert self.play(duration_s, pen=Pen(np.asarray(instants_s), signals, values)) == DONE
        return values

    def __getitem__(self, name):
        return self.state.start[self.place[name]]

    def events(self):
        count = int(self.state.counts[EVENTS])
        return self.log.times_s[:count], self.log.rows[:count]

    def cost(self):
        return int(self.state.counts[SWEEPS])


def oscillator(rate, lag_s, forced=False):
    """x'' = -rate^2 x (+ rate^2 u) by two integrators and three inverters, each with a lag."""
    b = Builder()
    drive = {"inverted": rate}
    if forced:
        b.input("u")
        drive["u"] = rate
    b.integrate("v", drive, lag_s=lag_s)
    b.sum("minus_v", {"v": -1.0}, lag_s=lag_s)
    b.sum("plus_v", {"minus_v": -1.0}, lag_s=lag_s)
    b.integrate("x", {"plus_v": rate}, initial=0.5, lag_s=lag_s)
    b.sum("inverted", {"x": -1.0}, lag_s=lag_s)
    return b


def oscillator_matrix(rate, lag_s):
    """States: v before and after its lag, minus_v, plus_v, x before and after, inverted; then u."""
    a = np.zeros((8, 8))
    a[0, 6], a[0, 7], a[4, 3] = rate, rate, rate
    for i, (source, gain) in {1: (0, 1), 2: (1, -1), 3: (2, -1), 5: (4, 1), 6: (5, -1)}.items():
        a[i, source] += gain / lag_s
        a[i, i] -= 1 / lag_s
    return a


OSCILLATOR = {"v": 1, "minus_v": 2, "plus_v": 3, "x": 5, "inverted": 6}


@pytest.mark.parametrize("rate", [10.0, 1000.0])
@pytest.mark.parametrize("lag_s", [1e-6, 1e-9])
def test_an_oscillator_with_five_lags_against_the_matrix_exponential(rate, lag_s):
    run = Run(oscillator(rate, lag_s))
    assert run.play(0.1) == DONE
    z = np.array([0, 0, 0, 0, 0.5, 0.5, -0.5, 0.0])
    z += exponential_minus_one(oscillator_matrix(rate, lag_s) * 0.1) @ z
    for name, i in OSCILLATOR.items():
        assert run[name] == pytest.approx(z[i], abs=1e-11)


@pytest.mark.parametrize("rate", [10.0, 1000.0])
def test_steps_of_a_held_input_against_the_matrix_exponential(rate):
    lag_s, cycle_s = 1e-6, 1e-3
    run = Run(oscillator(rate, lag_s, forced=True))
    change = exponential_minus_one(oscillator_matrix(rate, lag_s) * cycle_s)
    z = np.array([0, 0, 0, 0, 0.5, 0.5, -0.5, 0.0])
    for k in range(50):
        z[7] = 0.3 * math.sin(0.7 * k)
        assert run.play(cycle_s, held=z[7]) == DONE
        z += change @ z
        for name, i in OSCILLATOR.items():
            assert run[name] == pytest.approx(z[i], abs=1e-11)


def van_der_pol(lag_s, rate=1000.0):
    """x'' = rate (1 - x^2) x' - rate^2 x, scaled by 3, six parts with lags."""
    b = Builder()
    b.integrate("x", {"v": rate}, initial=0.2, lag_s=lag_s)
    b.integrate("v", {"damping": 4 * rate, "inverted": rate}, lag_s=lag_s)
    b.product("square", {"x": 1.0}, {"x": 1.0}, lag_s=lag_s)
    b.sum("bracket", {"square": -9.0 / 4}, constant=0.25, lag_s=lag_s)
    b.product("damping", {"bracket": 1.0}, {"v": 1.0}, lag_s=lag_s)
    b.sum("inverted", {"x": -1.0}, lag_s=lag_s)
    return b


def against_reference(builder, duration_s, tolerance, held=None, rtol=1e-9):
    run = Run(builder, rtol=rtol)
    assert run.play(duration_s, held=held) == DONE
    exact = Reference(run.circuit, np.atleast_1d(0.0 if held is None else held), 1e-12, 1e-14)
    exact.play(duration_s)
    np.testing.assert_allclose(run.state.start, exact.signals(), rtol=0, atol=tolerance)
    return run, exact


def test_van_der_pol_with_six_lags():
    against_reference(van_der_pol(1e-6), 5e-3, 1e-10)


def test_a_pause_within_an_interval_changes_no_bit():
    """A comparator switches on the way, so that corners, learned lengths and the log go on, too."""

    def begun():
        builder = van_der_pol(1e-6)
        builder.piecewise("side", {"x": 1.0}, comparator_pieces(-0.5, 0.5, 0.0, 0.1), lag_s=1e-6)
        return Run(builder)

    whole, cut, pauses = begun(), begun(), 0
    assert whole.play(5e-3) == DONE
    while True:
        cut.state.counts[LAST_WINDOW] = cut.state.counts[WINDOWS] + 5
        cut.t_s = 0.0  # the same interval again
        outcome = cut.play(5e-3)
        if outcome != PAUSED:
            break
        pauses += 1
    assert outcome == DONE and pauses > 10
    assert cut.state.counts[EVENTS] == whole.state.counts[EVENTS] > 0
    for name in ("start", "clock", "changes", "rungs", "overload"):
        np.testing.assert_array_equal(getattr(cut.state, name), getattr(whole.state, name))


def test_lorenz_scaled():
    """Divided by 50, slowed by 100: x' = 10 (y - x), y' = x (28 - 50 z) - y, z' = 50 x y - 8/3 z."""
    b = Builder()
    b.integrate("x", {"y": 1000.0}, feedback=-1000.0, initial=0.1)
    b.integrate("y", {"xz": -100.0, "x": 2800.0}, feedback=-100.0, initial=0.1, lag_s=1e-6)
    b.product("xz", {"x": 50.0}, {"z": 1.0}, lag_s=1e-6)
    b.integrate("z", {"xy": 100.0}, feedback=-800.0 / 3, initial=0.5)
    b.product("xy", {"x": 50.0}, {"y": 1.0}, lag_s=1e-6)
    against_reference(b, 5e-3, 1e-10)


def test_the_cost_does_not_grow_as_lags_shrink():
    cost = []
    for lag_s in (1e-6, 1e-7, 1e-8, 1e-9):
        run = Run(van_der_pol(lag_s))
        for _ in range(20):
            assert run.play(1e-3) == DONE
        cost.append(run.cost())
    assert max(cost[1:]) < 1.1 * cost[0]


@pytest.mark.parametrize("q", [4, 5])
def test_order_of_convergence(q):
    """Ends of windows of a smooth problem: order 2 q - 1."""
    lengths, errors = [2.0**-k for k in (9, 10, 11)], []
    b = Builder()
    b.integrate(
        "x", {"s": 1000.0}, initial=0.3
    )  # x' = rate sin x: tan(x/2) = tan(x0/2) exp(rate t)
    b.function("s", SIN, {"x": 1.0})
    exact = 2 * math.atan(math.tan(0.15) * math.exp(1000 * 2.0**-8))
    for length_s in lengths:
        run = Run(b, q=q, rtol=1.0)
        for _ in range(round(2.0**-8 / length_s)):
            run.state.clock[NEXT] = length_s
            assert run.play(length_s) == DONE
        errors.append(abs(run["x"] - exact))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] > 2 * q - 2, (errors, orders)


def ramp(pieces, rate=100.0, start=-1.0, **errors):
    """y = f(x) and its integral z, x rising at a constant rate."""
    b = Builder()
    b.integrate("x", {}, constant=rate, initial=start)
    b.piecewise("y", {"x": 1.0}, pieces, **errors)
    b.integrate("z", {"y": rate})
    return b


@pytest.mark.parametrize(
    "pieces, area",
    [
        (abs_pieces(), 1.0),
        (limit_pieces(-0.3, 0.6), 0.6**2 / 2 + 0.6 * 0.4 - 0.3**2 / 2 - 0.3 * 0.7),
        (dead_zone_pieces(-0.3, 0.6), 0.4**2 / 2 - 0.7**2 / 2),
        (table_pieces([-1, -0.5, 0.1, 1], [1, 0, 0.6, -0.3]), 0.25 + 0.18 + 0.9 * 0.15),
    ],
)
def test_functions_in_pieces_integrated_exactly(pieces, area):
    run = Run(ramp(pieces))
    assert run.play(0.02) == DONE
    assert run["x"] == pytest.approx(1.0, abs=1e-14)
    assert run["z"] == pytest.approx(area, abs=1e-13)


def test_rounded_corners_add_what_the_parabola_does():
    """A corner of slopes s1, s2 rounded over w adds (s2 - s1) w^2 / 24 to the integral."""
    sharp, rounded = (
        Run(ramp(table_pieces([-1, 0, 1], [1, 0, 0.5], rounding))) for rounding in (0.0, 0.2)
    )
    assert sharp.play(0.02) == rounded.play(0.02) == DONE
    assert rounded["z"] - sharp["z"] == pytest.approx(1.5 * 0.04 / 24, abs=1e-13)


def test_event_times():
    """A sine crosses 0.3 at asin(0.3) / omega and pi - asin(0.3) / omega, each turn."""
    b, omega = Builder(), 2000.0
    b.integrate("c", {"s": -omega}, initial=1.0)
    b.integrate("s", {"c": omega})
    b.piecewise("y", {"s": 1.0}, comparator_pieces(-1.0, 1.0, 0.3, 0.3))
    run = Run(b)
    assert run.play(0.02) == DONE
    first, turns = math.asin(0.3), 2 * math.pi * np.arange(7)
    expected = np.sort(np.concatenate([first + turns, math.pi - first + turns])) / omega
    expected = expected[expected < 0.02]
    times, rows = run.events()
    np.testing.assert_allclose(times, expected, rtol=0, atol=1e-12)
    assert rows[:, 1].tolist() == ([1, 0] * 7)[: len(expected)]


def test_an_event_at_the_edge_of_a_call_is_found_once():
    run = Run(ramp(abs_pieces(), rate=128.0))
    assert run.play(1 / 128) == DONE
    first = run.state.counts[EVENTS]
    assert run.play(1 / 128) == DONE
    assert first + run.state.counts[EVENTS] == 1
    assert run["z"] == pytest.approx(1.0, abs=1e-13)


def test_two_events_at_one_instant():
    b = ramp(abs_pieces())
    b.piecewise("limited", {"x": -2.0}, limit_pieces(-9.0, 0.0))
    b.integrate("w", {"limited": 100.0})
    run = Run(b)
    assert run.play(0.02) == DONE
    times, _ = run.events()
    assert times == pytest.approx([0.01, 0.01], abs=1e-14)
    assert run["w"] == pytest.approx(-1.0, abs=1e-13)
    assert run["z"] == pytest.approx(1.0, abs=1e-13)


def relay(rate, band, lag_s):
    b = Builder()
    b.integrate("x", {"relay": rate}, initial=0.0)
    b.piecewise(
        "relay",
        {"x": -1.0},
        comparator_pieces(-1.0, 1.0, -band, band),
        initial_piece=1,
        lag_s=lag_s,
    )
    return b


def test_relay_with_hysteresis_oscillates_as_theory_says():
    """x' = +-rate between +-band: a triangle of period 4 band / rate."""
    run = Run(relay(1000.0, 0.1, 0.0))
    assert run.play(2e-3) == DONE
    times, _ = run.events()
    np.testing.assert_allclose(times, np.arange(1, 20, 2) * 1e-4, rtol=0, atol=1e-13)
    assert run["x"] == pytest.approx(0.0, abs=1e-12)


def test_relay_with_lag_and_hysteresis_oscillates_as_theory_says():
    """Half a period T/2 after each switching the lagged output r starts from -A and goes to 1:
    r = 1 - (1 + A) e^(-t/tau), A = tanh(T / (4 tau)); x rises by rate * integral r = 2 band."""
    rate, band, tau = 1000.0, 0.01, 1e-5
    half = brentq(lambda t: rate * (t - 2 * tau * math.tanh(t / (2 * tau))) - 2 * band, 1e-6, 1e-3)
    run = Run(relay(rate, band, tau))
    assert run.play(3e-3) == DONE
    times, _ = run.events()
    np.testing.assert_allclose(np.diff(times)[-20:], half, rtol=0, atol=1e-12)


def test_a_limited_integrator_leaves_its_limit_at_once():
    """x' = omega cos(omega t) from 0, stopped at 0.5: leaves at omega t = pi/2, then sin - 0.5."""
    b, omega = Builder(), 1000.0
    b.sine("c", 1.0, omega, math.pi / 2)
    b.integrate("x", {"c": omega}, limits=(-0.9, 0.5))
    run = Run(b)
    assert run.play(2.2e-3) == DONE
    times, rows = run.events()
    expected = np.array([math.asin(0.5), math.pi / 2]) / omega
    np.testing.assert_allclose(times, expected, rtol=0, atol=1e-12)
    assert rows[:, 1].tolist() == [2, 1]
    assert run["x"] == pytest.approx(math.sin(2.2) - 0.5, abs=1e-12)


def test_saturation_switch_and_store_against_the_reference():
    b, omega = Builder(), 1000.0
    b.input("u", lag_s=1e-6)
    b.sine("s", 1.0, omega)
    b.sum("amplified", {"s": 2.0, "u": 1.0}, saturation=0.9, lag_s=1e-6)
    b.piecewise("sign", {"x": 1.0}, comparator_pieces(0.0, 1.0, 0.1, 0.2), lag_s=1e-6)
    b.switch("chosen", {"amplified": 1.0}, {"amplified": -0.5, "u": 0.2}, "sign", lag_s=1e-6)
    b.integrate("x", {"chosen": omega, "x": -0.3 * omega}, saturation=0.7, gain=1.01, lag_s=1e-6)
    b.track("stored", {"x": 1.0}, "sign", initial=0.05, gain=0.7, offset=0.01, lag_s=1e-6)
    run, exact = against_reference(b, 0.012, 1e-9, held=0.1)
    times, rows = run.events()
    assert len(times) == len(exact.events) > 8
    np.testing.assert_allclose(times, [e[0] for e in exact.events], rtol=0, atol=1e-11)
    assert rows.tolist() == [list(e[1:]) for e in exact.events]


def test_a_record_between_windows():
    run = Run(oscillator(1000.0, 1e-6))
    instants = np.arange(1, 5001) * 1e-6
    values = run.record(5e-3, instants, ["x", "v"])
    z0 = np.array([0, 0, 0, 0, 0.5, 0.5, -0.5, 0.0])
    change = exponential_minus_one(oscillator_matrix(1000.0, 1e-6) * 1e-6)
    z = z0.copy()
    for row in values:
        z += change @ z
        assert row == pytest.approx(z[[5, 1]], abs=1e-9)


def test_a_loop_of_lags_without_an_integrator():
    """y = lag(-0.5 y + 1): settles at 2/3 with tau / 1.5."""
    b = Builder()
    b.sum("y", {"y": -0.5}, constant=1.0, lag_s=1e-6, initial_output=0.0)
    run = Run(b)
    assert run.play(2e-6) == DONE
    assert run["y"] == pytest.approx(2 / 3 * (1 - math.exp(-3.0)), abs=1e-12)
    assert run.play(1e-3) == DONE
    assert run["y"] == pytest.approx(2 / 3, abs=1e-12)


def test_runaway_and_chatter_come_back_with_a_code():
    b = Builder()
    b.integrate("x", {"square": 100.0}, initial=1.0)
    b.product("square", {"x": 1.0}, {"x": 1.0})
    assert Run(b).play(1.0) == RUNAWAY
    assert Run(relay(1000.0, 0.0, 0.0)).play(1.0) == CHATTER


def test_a_loop_without_memory_is_refused():
    b = Builder()
    b.sum("a", {"b": 0.5})
    b.sum("b", {"a": 0.5})
    with pytest.raises(ValueError, match="without integrator or lag"):
        b.build()


def test_few_windows_are_wasted():
    run = Run(oscillator(1000.0, 1e-6, forced=True))
    for k in range(100):
        assert run.play(1e-3, held=0.1 * (-1) ** k) == DONE
    assert run.state.counts[REJECTED] < 0.05 * run.state.counts[WINDOWS]
