"""The closed forms against the exact roots, and the exact roots against the loop's definition."""

import ast
import math
import re
import sys
from decimal import Decimal, localcontext
from pathlib import Path

import numpy as np
import pytest

from hybrid import theory

OMEGA_P = 10.0
SAMPLED = [  # compute cycles, lead
    (1, 0.0),
    (1, 1.5),
    (1, 0.7),
    (1, 2.25),
    (0, 0.0),
    (0, 0.5),
    (2, 0.0),
    (2, 2.5),
    (3, 1.0),
]


def sampled(w, cycles=1, lead=0.0):
    return theory.exact_lead(OMEGA_P, w / OMEGA_P, lead, compute_cycles=cycles)


def root(mode):
    return complex(-mode.zeta * mode.omega, mode.omega_damped)


def observed_order(error, w):
    """Order of error(w) in w from one halving."""
    return math.log2(error(w) / error(w / 2))


# --- figures of the literature ---------------------------------------------------------------


def test_paper_example_uncompensated():
    # W = 0.01: zeta = -3/4 W + 3/4 W^3 = -0.00749925, omega = 10 (1 - 7/12e-4 + 177/160e-8).
    mode = theory.exact_uncompensated(10.0, 1e-3)
    form = theory.uncompensated(10.0, 1e-3)
    assert form.zeta == pytest.approx(-0.0075, rel=1e-15)
    assert form.omega == pytest.approx(9.9994166667, rel=1e-11)
    assert form.omega_damped == pytest.approx(9.9991354167, rel=1e-11)
    assert mode.zeta == pytest.approx(-0.00749925, rel=1e-7)  # the W^5 term is a few 1e-8 of it
    assert mode.omega == pytest.approx(9.99941678, abs=5e-9)
    assert theory.largest_period_s(10.0, 0.0075) == pytest.approx(1e-3, rel=1e-15)


def test_paper_example_with_lead():
    mode = theory.exact_lead(10.0, 1e-3)
    assert mode.zeta == pytest.approx(-5.0007e-7, abs=5e-12)
    assert theory.lead_compensated(10.0, 1e-3).zeta == pytest.approx(-5e-7, rel=1e-15)
    # What is fourth order is the growth per digital cycle: |z| - 1 = W^4/2.
    growth = math.expm1(-mode.zeta * mode.omega * 1e-3)
    assert growth == pytest.approx(0.5e-8, rel=1e-3)


@pytest.mark.parametrize(
    ("omega_p", "lags_s", "zeta"),
    [(2000.0, [1e-5], -0.0100), (2000.0, [1e-6] * 10, -0.0100), (10.0, [1e-6] * 5, -2.5e-5)],
)
def test_paper_examples_all_analog(omega_p, lags_s, zeta):
    # The next term of zeta is third order: at most 4e-4 of the first at omega_p sum(tau) = 0.02.
    assert theory.all_analog(omega_p, lags_s).zeta == pytest.approx(zeta, rel=1e-14)
    assert theory.exact_all_analog(omega_p, lags_s).zeta == pytest.approx(zeta, rel=1e-3)


# --- series against exact roots ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "lead", "orders"),
    [  # order of the first term left out of omega, omega_damped, zeta
        (lambda w: theory.uncompensated(OMEGA_P, w / OMEGA_P), 0.0, (4, 4, 3)),
        (
            lambda w: theory.uncompensated(OMEGA_P, w / OMEGA_P, higher_order=True),
            0.0,
            (6, 6, 5),
        ),
        (lambda w: theory.lead_compensated(OMEGA_P, w / OMEGA_P), 1.5, (4, 4, 5)),
    ],
)
def test_sampled_series_leave_out_what_they_say(form, lead, orders):
    for name, order in zip(("omega", "omega_damped", "zeta"), orders, strict=True):

        def error(w, name=name):
            return abs(getattr(form(w), name) - getattr(sampled(w, lead=lead), name))

        assert observed_order(error, 0.04) == pytest.approx(order, abs=0.05), name


@pytest.mark.parametrize("shares", [[1.0], [0.2] * 5, [0.5, 0.3, 0.15, 0.05]])
def test_all_analog_series_leaves_out_what_it_says(shares):
    def lags(w):
        return [w / OMEGA_P * share for share in shares]

    for name, order in {"omega": 4, "omega_damped": 4, "zeta": 3}.items():

        def error(w, name=name):
            form, mode = theory.all_analog(OMEGA_P, lags(w)), theory.exact_all_analog(10.0, lags(w))
            return abs(getattr(form, name) - getattr(mode, name))

        assert observed_order(error, 0.02) == pytest.approx(order, abs=0.05), name


@pytest.mark.parametrize(("cycles", "lead"), [(0, 0.0), (1, 0.0), (1, 1.0), (3, 1.0), (1, 2.0)])
def test_delays_add(cycles, lead):
    def error(w):
        delay_s = (cycles + 0.5 - lead) * w / OMEGA_P
        return abs(theory.delay_sum(OMEGA_P, delay_s).zeta - sampled(w, cycles, lead).zeta)

    assert observed_order(error, 0.02) == pytest.approx(3, abs=0.1)


# --- exact roots against the loop's definition -------------------------------------------------


def one_cycle(omega_p, period_s, cycles, lead):
    """One-cycle matrix by playing the loop: state theta, theta', answers still being computed."""

    def play(state):
        theta, rate, answers = state[0], state[1], list(state[2:])
        answers.append(-(omega_p**2) * (theta + lead * period_s * rate))  # ADC at nT
        held = answers.pop(0)  # the DAC latches the oldest answer and holds it for one cycle
        theta, rate = theta + period_s * rate + period_s**2 / 2 * held, rate + period_s * held
        return [theta, rate, *answers]

    return np.array([play(unit) for unit in np.eye(2 + cycles)]).T


@pytest.mark.parametrize("w", [0.05, 0.3, 1.0])
@pytest.mark.parametrize(("cycles", "lead"), SAMPLED)
def test_sampled_root_is_an_eigenvalue_of_the_played_loop(w, cycles, lead):
    # omega_p = 1 keeps the matrix well scaled; its simple eigenvalues are good to a few eps/w.
    mode = theory.exact_lead(1.0, w, lead, compute_cycles=cycles)
    z = np.exp(root(mode) * w)
    assert np.abs(np.linalg.eigvals(one_cycle(1.0, w, cycles, lead)) - z).min() < 1e-13
    assert mode.omega_damped == pytest.approx(mode.omega * math.sqrt(1 - mode.zeta**2), rel=1e-14)


@pytest.mark.parametrize("lags", [[], [0.01], [0.01, 0.02, 0.05], [0.3, 0.7], [2.0]])
def test_analog_root_is_an_eigenvalue_of_the_lagged_loop(lags):
    # theta'' = last lag's output; lag i: tau y' = input - y; the first is fed -omega_p^2 theta.
    size = 2 + len(lags)
    a = np.zeros((size, size))
    a[0, 1] = 1.0
    for row, lag in enumerate(lags, start=2):
        a[row, row] = -1 / lag
        a[row, row - 1 if row > 2 else 0] = (1 if row > 2 else -1.0) / lag
    a[1, -1 if lags else 0] = 1.0 if lags else -1.0
    mode = theory.exact_all_analog(1.0, lags)
    assert np.abs(np.linalg.eigvals(a) - root(mode)).min() < 1e-12  # eps times 1/min(lag) = 100


@pytest.mark.parametrize("w", [1e-8, 0.1, 1.0])
def test_compute_time_zero_has_a_closed_solution(w):
    # With lead 1/2 the equation is (z-1)^2 + W^2 z = 0, whose roots have |z| = 1 exactly:
    # z = exp(j phi) with 2 sin(phi/2) = W. A frequency error, and no damping error at all.
    mode = sampled(w, 0, 0.5)
    assert abs(mode.zeta) < 1e-90
    assert mode.omega == pytest.approx(2 * math.asin(w / 2) / w * OMEGA_P, rel=4e-16)


# --- precision: one Newton step in 90 digits from the figures returned measures their error ------


def times(a, b):
    return a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]


def plus(*terms):
    return sum(t[0] for t in terms), sum(t[1] for t in terms)


def exponential(a):
    total = term = (Decimal(1), Decimal(0))
    for k in range(1, 80):
        term = tuple(part / k for part in times(term, a))
        total = plus(total, term)
    return total


def sampled_equation(z, w, cycles, lead):
    """z^c (z-1)^2 + W^2 [(z+1)/2 + lead (z-1)], as written in the literature."""
    z_minus_1, power = (z[0] - 1, z[1]), (Decimal(1), Decimal(0))
    for _ in range(cycles):
        power = times(power, z)
    half_sum = ((z[0] + 1) / 2, z[1] / 2)
    fed = plus(half_sum, times((Decimal(lead), Decimal(0)), z_minus_1))
    return plus(times(power, times(z_minus_1, z_minus_1)), times((w * w, Decimal(0)), fed))


def analog_equation(v, lags):
    """v^2 prod(1 + lag v) + 1 with v = s/omega_p."""
    value = times(v, v)
    for lag in lags:
        value = times(value, (1 + lag * v[0], lag * v[1]))
    return value[0] + 1, value[1]


def newton_correction(f, at):
    """f/f' at a point, the derivative by a difference of 1e-40: good to 40 digits."""
    h = Decimal("1e-40")
    value, beside = f(at), f((at[0] + h, at[1]))
    slope = ((beside[0] - value[0]) / h, (beside[1] - value[1]) / h)
    size = slope[0] ** 2 + slope[1] ** 2
    return tuple(part / size for part in times(value, (slope[0], -slope[1])))


@pytest.mark.parametrize("w", [1e-6, 1e-4, 1e-2, 0.5])
@pytest.mark.parametrize(("cycles", "lead"), [(1, 0.0), (1, 1.5), (1, 0.7), (2, 0.0), (2, 2.5)])
def test_sampled_roots_keep_their_relative_accuracy(w, cycles, lead):
    mode = theory.exact_lead(1.0, w, lead, compute_cycles=cycles)
    with localcontext(prec=90):
        exact_w = Decimal(w)
        at = (
            -Decimal(mode.zeta) * Decimal(mode.omega) * exact_w,
            Decimal(mode.omega_damped) * exact_w,
        )
        error = newton_correction(
            lambda s: sampled_equation(exponential(s), exact_w, cycles, lead), at
        )
        assert abs(error[0] / at[0]) < 1e-14
        assert abs(error[1] / at[1]) < 1e-15


@pytest.mark.parametrize("lags_s", [[1e-10], [1e-6] * 5, [1e-6, 2e-5, 3e-4], [0.1, 0.2]])
def test_analog_roots_keep_their_relative_accuracy(lags_s):
    mode = theory.exact_all_analog(1.0, lags_s)
    with localcontext(prec=90):
        lags = [Decimal(lag) for lag in lags_s]
        at = (-Decimal(mode.zeta) * Decimal(mode.omega), Decimal(mode.omega_damped))
        error = newton_correction(lambda v: analog_equation(v, lags), at)
        assert abs(error[0] / at[0]) < 1e-14
        assert abs(error[1] / at[1]) < 1e-15


def test_no_lags_are_an_ideal_loop():
    assert theory.exact_all_analog(10.0, []) == theory.Mode(10.0, 10.0, 0.0)
    assert theory.all_analog(10.0, [0.0]).omega == 10.0


# --- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: theory.uncompensated(10.0, 0.1), "0 < it < 1"),
        (lambda: theory.uncompensated(10.0, 0.0), "0 < it < 1"),
        (lambda: theory.lead_compensated(10.0, math.nan), "0 < it < 1"),
        (lambda: theory.all_analog(0.0, [1e-6]), "omega_p is 0.0; it must be finite and above 0"),
        (lambda: theory.all_analog(10.0, [1e-6, -1e-6]), "0 or more"),
        (lambda: theory.exact_all_analog(10.0, [math.inf]), "0 or more"),
        (lambda: theory.delay_sum(10.0, -0.2), "0 <= it < 1"),
        (lambda: theory.exact_uncompensated(10.0, -1e-3), "period_s is -0.001"),
        (lambda: theory.exact_lead(10.0, 1e-3, math.nan), "finite number of cycles"),
        (lambda: theory.exact_lead(10.0, 1e-3, compute_cycles=1.5), "whole number"),
        (lambda: theory.largest_period_s(10.0, 0.75), "0 < it < 0.75"),
        # (z-1)^2 + W^2 [(z+1)/2 + l (z-1)]: critical at (l + 1/2) W = 2, so at l = 3.5, W = 0.5.
        (lambda: theory.exact_lead(1.0, 0.51, 3.5, compute_cycles=0), "does not oscillate"),
        (lambda: theory.exact_lead(1.0, 0.3, 10.0), "does not oscillate"),
    ],
)
def test_refusals_say_what_would_be_valid(call, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        call()


def test_just_below_critical_damping_is_found():
    # (z-1)/W = v with v^2 + slope v + 1 = 0, slope = 4 * 0.499: Im v = sqrt(1 - 0.998^2).
    mode = theory.exact_lead(1.0, 0.499, 3.5, compute_cycles=0)
    z = np.exp(root(mode) * 0.499)
    assert z.imag / 0.499 == pytest.approx(math.sqrt(1 - 0.998**2), rel=1e-13)


def test_a_mode_far_beyond_the_series_is_followed():
    # One lag, omega_p tau = L large: L v^3 + v^2 + 1 = 0 tends to v = L^(-1/3) exp(j pi/3); the
    # next term moves v by -1/(3 L), which is 1/(3 L^(2/3)) = 3.3e-5 of it at L = 1e6.
    mode = theory.exact_all_analog(1.0, [1e6])
    assert abs(root(mode) / (0.01 * np.exp(1j * math.pi / 3)) - 1) < 4e-5


def test_theory_imports_the_standard_library_alone():
    tree = ast.parse(Path(theory.__file__).read_text(encoding="utf-8"))
    names = [a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names]
    names += [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert {name.split(".")[0] for name in names} <= sys.stdlib_module_names
