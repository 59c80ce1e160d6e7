"""The delay against the Pade transfer function, which it is, and the true delay, which it is near."""

import math
from fractions import Fraction

import numpy as np
import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.components.delay import good_to, pade_all_pass, phase_error
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch
from hybrid.runs import run


def patch(*components, run="until: 2 s, every: 0.1 s", machine="ideal", rest=""):
    lines = "\n".join(f"  {line}" for line in components)
    return f"title: Test\nmachine: {machine}\nanalog:\n{lines}\n{rest}run: {{{run}}}\n"


def exact_response(n, x):
    """N / D at j x in fractions, as the sums of high orders lose all digits otherwise."""
    re = im = Fraction(0)
    for k in range(n + 1):
        over = math.factorial(2 * n) * math.factorial(k) * math.factorial(n - k)
        term = Fraction(math.factorial(2 * n - k) * math.factorial(n), over) * Fraction(x) ** k
        re += (term, 0, -term, 0)[k % 4]
        im += (0, term, 0, -term)[k % 4]
    size = re * re + im * im
    return complex(float((re * re - im * im) / size), float(-2 * re * im / size))


def denominator(n, z):
    """Of the Pade approximant [n/n] of exp(-z), 1 at z = 0; the numerator is that of -z."""
    total = 0
    for k in range(n + 1):
        over = math.factorial(2 * n) * math.factorial(k) * math.factorial(n - k)
        total += math.factorial(2 * n - k) * math.factorial(n) / over * z**k
    return total


def response(block, s):
    """c (s - a)^-1 b + d."""
    a, b, c = np.array(block.a), np.array(block.b), np.array(block.c)
    return c @ np.linalg.solve(s * np.eye(len(b)) - a, b) + block.d


@pytest.mark.parametrize("n", range(1, 31))
def test_the_circuit_is_the_pade_all_pass(n):
    T = 0.3
    block = pade_all_pass(n, T)
    for x in (0.01, 0.3, 1, 2.5, 6, 15, 60):
        z, exact = 1j * x, exact_response(n, x)
        # The condition of the solution is about x + n^2; the sums have some ten terms of size 2.
        assert abs(response(block, z / T) - exact) < 1e-16 * 40 * (x + n * n + 10)
    # At rest it passes its input on, all of it in the first state.
    rest = np.array(block.rest)
    np.testing.assert_allclose(np.array(block.a) @ rest + np.array(block.b), 0, atol=1e-12 / T)
    assert np.array(block.c) @ rest + block.d == 1.0
    assert block.a[0][0] < 0.0


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 8, 10])
@pytest.mark.parametrize("circuit", [False, True])
def test_a_sine_comes_later_within_the_bound_of_pade_theory(n, circuit):
    """|D exp(-jx) - N| <= x^(2n+1) n!^2 / ((2n)! (2n+1)!), the remainder integral of the approximant."""
    T, omega = 0.1, 12.0
    x = omega * T
    text = patch(
        "s: {sine: 1, omega: 12 rad/s, full_scale: 1}",
        f"y: {{delay: {{s: 1}}, time: {T} s, order: {n}, full_scale: 1.5}}",
        run="until: 6 s, every: 10 ms",
    )
    result = run(compile_patch(parse_patch(text), as_circuit=circuit))
    found = {pen.name: result.rows[:, i] for i, pen in enumerate(result.pens)}
    t = np.arange(len(result.rows)) * 0.01
    late = t > 4.0  # the slowest pole of order 1 to 10 is below -2 / T: exp(-80)
    gain = denominator(n, -1j * x) / denominator(n, 1j * x)
    steady = np.imag(gain * np.exp(1j * omega * t))
    error = 1e-9 if circuit else 1e-13
    np.testing.assert_allclose(found["y"][late], steady[late], rtol=0, atol=error)
    bound = x ** (2 * n + 1) * math.factorial(n) ** 2
    bound /= math.factorial(2 * n) * math.factorial(2 * n + 1) * abs(denominator(n, 1j * x))
    true = np.sin(omega * (t - T))
    assert np.max(np.abs(found["y"] - true)[late]) <= bound + error


@pytest.mark.parametrize("n", [3, 4])
def test_both_engines_agree_with_all_errors_and_a_settled_start(n):
    text = patch(
        "p: {pulse: 0.5, at: 20 ms, width: 33 ms, before: 0.2, full_scale: 1}",
        "c: {constant: 0.3, full_scale: 2}",
        f"y: {{delay: {{p: 1.5, c: -1}}, time: 15 ms, order: {n}, full_scale: 2}}",
        "z: {integrate: {y: 20, z: -5}, initial: 0.1, full_scale: 2}",
        run="until: 0.2 s, every: 1 ms",
        machine="{preset: nominal, noise: 0, offset: 1e-3}",
    )
    exact = run(compile_patch(parse_patch(text)))
    circuit = run(compile_patch(parse_patch(text), as_circuit=True))
    scale = np.array([pen.factor for pen in exact.pens])
    np.testing.assert_allclose(circuit.rows / scale, exact.rows / scale, rtol=0, atol=1e-9)
    y = exact.rows[:, [pen.name for pen in exact.pens].index("y")]
    np.testing.assert_allclose(y[:20], y[0], rtol=0, atol=1e-13)  # at rest until the pulse
    checked = {row.signal: row.value for row in hybrid.check(parse_patch(text)).scaling}
    assert checked["y"] == pytest.approx(y[0], rel=1e-13)


def test_the_prediction_sees_the_delay():
    """x' = -2 x(t - T) with order 2: s (s^2 T^2 + 6 s T + 12) + 2 (s^2 T^2 - 6 s T + 12) = 0."""
    T = 0.2
    text = patch(
        "y: {delay: {x: 1}, time: 0.2 s, order: 2, full_scale: 1}",
        "x: {integrate: {y: -2}, initial: 0.5, full_scale: 1}",
    )
    modes = hybrid.predict(parse_patch(text)).modes
    roots = np.roots([T * T, 6 * T + 2 * T * T, 12 - 12 * T, 24])
    found = sorted(mode.omega for mode in modes)
    expected = sorted({round(abs(root), 12) for root in roots})
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_a_lag_of_its_own_and_a_gain_error_come_after_it():
    text = patch(
        "s: {step: 1, at: 0.5 s, full_scale: 1}",
        "y: {delay: {s: 1}, time: 0.2 s, order: 1, full_scale: 1, tau: 0.05 s, offset: 0.01}",
    )
    result = run(compile_patch(parse_patch(text)))
    y = result.rows[:, [pen.name for pen in result.pens].index("y")]
    s = np.maximum(np.arange(21) * 0.1 - 0.5, 0)
    # 1 - 2 exp(-10 s) through a lag of 0.05 s, (exp(-10 s) - exp(-20 s)) / (1 - 10 / 20).
    expected = 0.01 + np.where(
        s > 0, 1 - np.exp(-20 * s) - 4 * (np.exp(-10 * s) - np.exp(-20 * s)), 0
    )
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("delay: {one: 1}", "has no time; add time:"),
        ("delay: {one: 1}, time: 0 s", "must be greater than 0"),
        (
            "delay: {one: 1}, time: 1 ms, order: 0",
            "order is '0'; it must be a whole number from 1 to 30",
        ),
        ("delay: {one: 1}, time: 1 ms, order: 31", "order is '31'"),
        ("delay: {one: 1}, time: 1 ms, order: 2.5", "order is '2.5'"),
        ("delay: {two: 1}, time: 1 ms", "unknown signal 'two'"),
        ("delay: {x: 0.5}, time: 1 ms", "algebraic loop through parts without lag: x -> x"),
        ("delay: {one: 1}, time: 1e-16 s", r"gain or rate of 6e\+16"),
    ],
)
def test_wrong_figures_are_told(wrong, told):
    text = patch("one: {constant: 1, full_scale: 1}", f"x: {{{wrong}, full_scale: 1}}")
    with pytest.raises(PatchError, match=told):
        compile_patch(parse_patch(text))


@pytest.mark.parametrize("n", [1, 2, 4, 10, 20, 30])
def test_the_phase_is_right_up_to_where_it_is_said_to_be(n):
    """The bound holds all the way, and gives away no more than a third of the frequency."""

    def off(x):
        return abs(exact_response(n, x) / complex(math.cos(x), -math.sin(x)) - 1.0)

    for error in (1e-4, 1e-3, 1e-2):
        last = good_to(n, 1.0, error)
        assert good_to(n, 0.2, error) == pytest.approx(5 * last, rel=1e-14)
        assert phase_error(n, last) == pytest.approx(error, rel=1e-9)
        # A chord of the circle is shorter than the angle by a share of angle^2 / 24.
        assert all(off(f * last) <= phase_error(n, f * last) + 1e-14 for f in (0.3, 0.6, 0.9, 1.0))
        assert off(1.35 * last) > error


def test_check_lists_delays_with_the_frequency_they_are_good_to():
    """Order 4: (1e-3 * 8! * 9! / 4!^2)^(1 / 9) = 3.086 over T."""
    text = patch(
        "s: {sine: 1, omega: 12 rad/s, full_scale: 1}",
        "y: {delay: {s: 1}, time: 0.1 s, full_scale: 1.5}",
    )
    found = hybrid.check(parse_patch(text), trial=False)
    (row,) = found.delays
    assert found.to_dict()["delays"][0].keys() == {"delay", "time_s", "order", "good_to"}
    assert (row.delay, row.time_s, row.order) == ("y", 0.1, 4)
    assert row.good_to == pytest.approx(30.86, abs=0.01)
