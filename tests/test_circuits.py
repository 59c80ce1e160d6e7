"""Components that are circuits of several parts, against what the theory of each circuit says."""

import itertools
import math

import numpy as np
import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch
from hybrid.runs import run

RESOLVED = 1e-9  # of full scale, by the engine


def patch(*components, run="until: 2 s, every: 0.1 s", machine="ideal"):
    lines = "\n".join(f"  {line}" for line in components)
    return f"title: Test\nmachine: {machine}\nanalog:\n{lines}\nrun: {{{run}}}\n"


def columns(text, **options):
    result = run(compile_patch(parse_patch(text), **options))
    assert result.status == "complete", result.status_note
    return {pen.name: result.rows[:, i] for i, pen in enumerate(result.pens)}


def windows_of(text):
    """How many windows the engine needs."""
    from hybrid.engine.sweep import WINDOWS
    from hybrid.engine.windows import CircuitPlayer
    from hybrid.record import pens_for
    from hybrid.timeline import build_timeline

    machine = compile_patch(parse_patch(text))
    player = CircuitPlayer(machine, build_timeline(machine), pens_for(machine))
    for _ in player.play():
        pass
    return int(player.side.state.counts[WINDOWS])


# --- quarter-square multiplier -------------------------------------------------------------------

WAVES = (
    "a: {sine: 1, omega: 2 rad/s, phase: 0.3, full_scale: 1}",
    "b: {sine: 20, omega: 7.3 rad/s, phase: 1, full_scale: 20}",
)


@pytest.mark.parametrize("n", [1, 2, 5, 23])
def test_quarter_square_errs_by_its_segments_and_no_more(n):
    """Chords of u^2 over segments 1/n are 0 to 1/(4 n^2) too high; two squarers are subtracted."""
    found = columns(
        patch(
            *WAVES,
            f"p: {{multiply: [a, b], gain: -0.5, quarter_square: {n}, full_scale: 10}}",
            run="until: 10 s, every: 2 ms",
        )
    )
    error = (found["p"] + 0.5 * found["a"] * found["b"]) / 10
    bound = 1 / (4 * n * n)
    assert np.max(np.abs(error)) <= bound + RESOLVED
    assert np.max(error) > 0.9 * bound and np.min(error) < -0.9 * bound
    for signs in itertools.product((-1, 1), repeat=2):  # in all four quadrants
        inside = (np.sign(found["a"]) == signs[0]) & (np.sign(found["b"]) == signs[1])
        assert np.max(np.abs(error[inside])) > 0.5 * bound


def test_23_segments_are_of_the_class_of_0_05_percent():
    assert 1 / (4 * 23**2) <= 5e-4 < 1 / (4 * 22**2)


def test_quarter_square_of_a_signal_with_itself_and_with_zero():
    found = columns(
        patch(
            "a: {ramp: 1, before: -1, full_scale: 1}",
            "zero: {constant: 0, full_scale: 1}",
            "square: {multiply: [a, a], quarter_square: 4, full_scale: 1}",
            "none: {multiply: [a, zero], quarter_square: 4, full_scale: 1}",
            run="until: 2 s, every: 0.125 s",
        )
    )
    a = found["a"]
    np.testing.assert_allclose(found["none"], 0, atol=1e-15)
    # Exact where segments meet, 1/(4 n^2) above halfway between.
    expected = a**2 + np.where(np.round(a * 8) % 2 == 1, 1 / 64, 0)
    np.testing.assert_allclose(found["square"], expected, rtol=0, atol=1e-12)


# --- amplifiers with a multiplier in their feedback ----------------------------------------------


@pytest.mark.parametrize(("open_gain", "numerator"), [(50, 0.4), (1e3, -0.4), (1e5, 0.4)])
def test_divider_in_feedback_errs_by_its_gain(open_gain, numerator):
    """q (d + 1 / A) = k n, here n = N / 2, d = D / 4, q = Q / 5, k = gain 2 / (4 * 5)."""
    text = patch(
        f"N: {{constant: {numerator}, full_scale: 2}}",
        "D: {ramp: 1.5, before: 1, full_scale: 4}",
        f"Q: {{divide: [N, D], gain: 3, circuit: feedback, open_gain: {open_gain}, full_scale: 5}}",
    )
    found = columns(text)
    q = 3 * 2 / (4 * 5) * numerator / 2 / (found["D"] / 4 + 1 / open_gain)
    # The output follows 1 / d with w d of lag: late by |q'| / (w d) < 0.2 / (1e6 * 0.25) full scales.
    np.testing.assert_allclose(found["Q"] / 5, q, rtol=0, atol=1e-6)
    checked = {row.signal: row.value_mu for row in hybrid.check(parse_patch(text)).scaling}
    assert checked["Q"] == pytest.approx(q[0], abs=1e-13)
    assert found["Q"][0] == pytest.approx(3 * numerator / (1 + 4 / open_gain), abs=1e-12)


@pytest.mark.parametrize("d", [0.1, 0.5, 1.0])
def test_divider_in_feedback_is_as_fast_as_its_loop(d):
    """A step of n: q goes as 1 - exp(-w (d + 1 / A) t)."""
    found = columns(
        patch(
            "n: {step: 0.05, at: 1 ms, full_scale: 1}",
            f"d: {{constant: {d}, full_scale: 1}}",
            "q: {divide: [n, d], circuit: feedback, bandwidth: 2e4 rad/s, open_gain: 200, "
            "full_scale: 1}",
            run="until: 3 ms, every: 20 us",
        )
    )
    t = np.arange(151) * 20e-6
    loop = d + 1 / 200
    expected = np.where(t >= 1e-3, -np.expm1(-2e4 * loop * (t - 1e-3)), 0) * 0.05 / loop
    np.testing.assert_allclose(found["q"], expected, rtol=0, atol=RESOLVED)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("saturation", [None, 1.2])
def test_divider_in_feedback_goes_to_its_limit_where_the_denominator_is_negative(sign, saturation):
    level = "" if saturation is None else f", saturation: {saturation}"
    result = run(
        compile_patch(
            parse_patch(
                patch(
                    f"n: {{constant: {sign * 0.2}, full_scale: 1}}",
                    "d: {step: -0.5, before: 0.5, at: 1 s, full_scale: 1}",
                    f"q: {{divide: [n, d], circuit: feedback, full_scale: 1{level}}}",
                )
            )
        )
    )
    q = result.rows[:, [pen.name for pen in result.pens].index("q")]
    np.testing.assert_allclose(q[:10], sign * 0.2 / (0.5 + 1e-5), atol=1e-12)
    np.testing.assert_allclose(q[11:], sign * (saturation or 1.5), rtol=1e-9)
    assert [o["signal"] for o in result.overloads] == ["q"]


@pytest.mark.parametrize("gain", [1.5, -1.5])
def test_square_root_in_feedback(gain):
    """x^2 + x / A = k n with k = (gain^2 / full_scale^2) full scale of n; 0 below 0, as of a diode."""
    open_gain, k = 200.0, 1.5**2 / 2**2 * 3
    text = patch(
        "n: {ramp: -3, before: 3, full_scale: 3}",
        f"r: {{square_root: n, gain: {gain}, circuit: feedback, open_gain: {open_gain}, full_scale: 2}}",
        run="until: 1.5 s, every: 50 ms",
    )
    found = columns(text)
    n = np.maximum(found["n"] / 3, 0)
    x = -0.5 / open_gain + np.sqrt(0.25 / open_gain**2 + k * n)
    # Late by |x'| / (w (2 x + 1 / A)), x' = -k / (2 x + 1 / A) a second: below 2 k A^2 / w, at zero.
    np.testing.assert_allclose(
        found["r"] / 2, math.copysign(1, gain) * x, rtol=0, atol=2 * k * open_gain**2 / 1e6
    )
    fast = found["n"] > 0.3
    np.testing.assert_allclose(
        found["r"][fast] / 2, math.copysign(1, gain) * x[fast], rtol=0, atol=1e-5
    )
    np.testing.assert_allclose(found["r"][found["n"] < -0.1], 0, atol=1e-9)


def test_square_root_in_feedback_is_as_fast_as_its_loop():
    """x' = w (n - x^2 - x / A), a Riccati equation: with m the middle and a half the distance of its
    roots, x = m + a tanh(w a t + atanh((x(0) - m) / a))."""
    w, open_gain, n = 2e4, 100.0, 0.81
    text = patch(
        f"n: {{step: {n}, before: 0.09, at: 1 ms, full_scale: 1}}",
        f"r: {{square_root: n, circuit: feedback, open_gain: {open_gain}, bandwidth: {w} rad/s, "
        "full_scale: 1}",
        run="until: 2 ms, every: 20 us",
    )
    r = columns(text)["r"]
    m = -0.5 / open_gain
    a, first = math.sqrt(m * m + n), m + math.sqrt(m * m + 0.09)
    t = np.maximum(np.arange(101) * 20e-6 - 1e-3, 0)
    expected = m + a * np.tanh(w * a * t + math.atanh((first - m) / a))
    np.testing.assert_allclose(r, expected, rtol=0, atol=RESOLVED)


@pytest.mark.parametrize("tau", ["0 s", "1 us"])
@pytest.mark.parametrize(
    "circuit",
    [
        "divide: [n, d], circuit: feedback, ",
        "square_root: d, circuit: feedback, ",
        "backlash: n, width: 0.1, rate",
    ],
)
def test_cost_does_not_grow_with_the_bandwidth(circuit, tau):
    key = "" if circuit.endswith("rate") else "bandwidth"
    counts = [
        windows_of(
            patch(
                "n: {sine: 0.4, omega: 10 rad/s, full_scale: 1}",
                "d: {sine: 0.2, omega: 3 rad/s, bias: 0.7, full_scale: 1}",
                f"q: {{{circuit}{key}: {rate} rad/s, full_scale: 1}}",
                machine=f"{{preset: lags, tau: {tau}}}",
            )
        )
        for rate in ("1e5", "1e9")
    ]
    assert counts[1] < 1.5 * counts[0] + 100


# --- backlash ------------------------------------------------------------------------------------


def play_operator(x, half, first):
    """The play operator on a finely sampled signal."""
    found, p = [], first
    for value in x.tolist():
        p = min(max(p, value - half), value + half)
        found.append(p)
    return np.array(found)


@pytest.mark.parametrize(("rate", "initial"), [(1e3, 0.0), (1e6, 0.35), (1e8, -2.0)])
def test_backlash_stays_within_its_bound_of_the_play_operator(rate, initial):
    text = patch(
        "fast: {sine: 0.8, omega: 30 rad/s, phase: 0.5, full_scale: 4}",
        "x: {sum: {fast: 1, slow: 1}, full_scale: 4}",
        "slow: {sine: 1.5, omega: 4 rad/s, bias: 0.2, full_scale: 4}",
        f"y: {{backlash: x, width: 0.5, rate: {rate} 1/s, initial: {initial}, full_scale: 4}}",
        run="until: 3 s, every: 1 ms",
    )
    found = columns(text)
    dense = 100  # samples for each row; the play operator misses x'' dt^2 / 8 of a turn
    t = np.arange(3000 * dense + 1) * 1e-3 / dense
    x = 0.8 * np.sin(30 * t + 0.5) + 1.5 * np.sin(4 * t) + 0.2
    p = play_operator(x, 0.25, initial)[::dense]
    speed, sampling = 0.8 * 30 + 1.5 * 4, (0.8 * 900 + 1.5 * 16) * (1e-3 / dense) ** 2 / 8
    assert np.max(np.abs(found["y"] - p)) <= speed / rate + sampling + 4 * RESOLVED
    assert found["y"][0] == pytest.approx(p[0], abs=1e-14)
    assert np.max(found["y"]) - np.min(found["y"]) > 3.0
    checked = {row.signal: row.value for row in hybrid.check(parse_patch(text)).scaling}
    assert checked["y"] == pytest.approx(p[0], abs=1e-14)


def servo_with_play(steps_per_row, rows, every_s):
    """x'' = -100 y - 10 x' with y the play operator of x, by Heun's method in small steps."""
    dt, x, v = every_s / steps_per_row, 1.0, 0.0
    y, found = 0.8, [1.0]
    for step in range(rows * steps_per_row):
        ahead = x + dt * v
        then = min(max(y, ahead - 0.2), ahead + 0.2)
        first, second = -100 * y - 10 * v, -100 * then - 10 * (v + dt * (-100 * y - 10 * v))
        x, v = x + dt * v + dt * dt / 2 * first, v + dt / 2 * (first + second)
        y = min(max(y, x - 0.2), x + 0.2)
        if (step + 1) % steps_per_row == 0:
            found.append(x)
    return np.array(found)


def test_backlash_in_the_loop_of_a_servo():
    """No part of the loop has a lag but the circuit itself; it ends by hunting within the play."""
    text = patch(
        "v: {integrate: {y: -100, v: -10}, initial: 0, full_scale: 20}",
        "x: {integrate: {v: 1}, initial: 1, full_scale: 2}",
        "y: {backlash: x, width: 0.4, rate: 1e7 1/s, full_scale: 2}",
        run="until: 2 s, every: 5 ms",
    )
    x = columns(text)["x"]
    coarse, fine = (servo_with_play(steps, 400, 5e-3) for steps in (100, 200))
    # At least of first order in its step; the circuit is late by 1e-7 s, at 20 full scales a second.
    bound = 2 * np.max(np.abs(fine - coarse)) + 1e-5
    assert bound < 1e-3
    assert np.max(np.abs(x - fine)) < bound
    straight = columns(text.replace("width: 0.4", "width: 1e-6"))["x"]
    assert np.max(np.abs(straight[350:])) < 1e-3 < 0.1 < np.max(np.abs(x[350:]))


# --- the open amplifier --------------------------------------------------------------------------


@pytest.mark.parametrize("circuit", [False, True])
@pytest.mark.parametrize("tau", ["0 s", "0.1 us"])
def test_an_implicit_equation_that_is_linear(circuit, tau):
    """2 x = y made by x' = w (y - 2 x) - (w / A) x: x = y / (2 + 1 / A), late by y' / (4 w)."""
    text = patch(
        "y: {sine: 1, omega: 100 rad/s, full_scale: 1, tau: 0 s}",
        "x: {amplify: {y: 1, x: -2}, open_gain: 500, bandwidth: 1e5 rad/s, full_scale: 1}",
        run="until: 0.2 s, every: 1 ms",
        machine=f"{{preset: ideal, tau: {tau}}}",
    )
    found = columns(text, as_circuit=circuit)
    loop = 2 + 1 / 500
    response = 1 / (loop + 1j * 100 / 1e5)  # where the output has no lag of its own
    t = np.arange(201) * 1e-3
    steady = np.imag(response * np.exp(1j * 100 * t))
    late = t > 1e-3
    tolerance = 100 * 1e-7 if tau != "0 s" else RESOLVED
    np.testing.assert_allclose(found["x"][late], steady[late], rtol=0, atol=tolerance)


def test_both_engines_agree_on_the_open_amplifier():
    text = patch(
        "y: {step: 0.7, at: 20 us, full_scale: 1}",
        "x: {amplify: {y: 1, back: -1}, initial: 0.1, full_scale: 2}",
        "back: {sum: {x: 1.5}, full_scale: 2}",
        run="until: 0.2 ms, every: 2 us",
        machine="{preset: nominal, noise: 0, offset: 1e-3}",
    )
    exact, circuit = columns(text), columns(text, as_circuit=True)
    for name in exact:
        np.testing.assert_allclose(circuit[name] / 2, exact[name] / 2, rtol=0, atol=RESOLVED)
    # At rest 1.5 x (1 + errors) = y + offset 2e-3 at the summing point, to 1 / A and the tolerances.
    assert exact["x"][-1] == pytest.approx((0.7 + 1e-3 + 2e-3 - 2e-3) / 1.5, abs=1e-3)


@pytest.mark.parametrize("machine", ["ideal", "lags"])
def test_an_implicit_equation_that_is_not_linear(machine):
    """x + x^3 = y, solved for x by an open amplifier; the sum is left at x / A."""
    text = patch(
        "y: {sine: 1.9, omega: 5 rad/s, full_scale: 2}",
        "x: {amplify: {y: 0.5, x: -0.5, cube: -0.5}, bandwidth: 2e5 rad/s, full_scale: 1}",
        "square: {multiply: [x, x], full_scale: 1}",
        "cube: {multiply: [square, x], full_scale: 1}",
        run="until: 1 s, every: 10 ms",
        machine=machine,
    )
    found = columns(text)
    x = found["x"][1:]
    residual = 0.5 * (found["y"][1:] - x - x**3)
    # x / A, the speed of x over w, and of each lag its own time: all below 9.5 a second.
    assert np.max(np.abs(residual)) < 1e-5 + 9.5 / 2e5 + (4 * 9.5e-6 if machine == "lags" else 0)
    assert np.max(np.abs(x)) > 0.95


def test_an_open_amplifier_saturates():
    found = columns(
        patch(
            "y: {sine: 0.1, omega: 100 rad/s, full_scale: 1}",
            "x: {amplify: {y: 1}, saturation: 1.1, full_scale: 1}",
            run="until: 0.1 s, every: 1 ms",
        )
    )
    # A comparator of sorts: after y changes sign it slews through 2.2 full scales, w 0.1 * 100 t a
    # second, so in sqrt(2 * 2.2 / 1e6) = 2.1 ms, in which the angle of y goes to 0.21.
    t = np.arange(101) * 1e-3
    clear = np.abs(np.sin(100 * t)) > 0.3
    np.testing.assert_allclose(found["x"][clear], 1.1 * np.sign(np.sin(100 * t))[clear], rtol=1e-9)


# --- mistakes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (
            "multiply: [one, one], quarter_square: 0",
            "quarter_square is '0'; it must be a whole number",
        ),
        ("multiply: [one, one], quarter_square: 201", "from 1 to 200"),
        ("divide: [one, one], circuit: feedbak", "circuit is 'feedbak'; valid: ideal, feedback"),
        (
            "divide: [one, one], open_gain: 100",
            "has open_gain, which is of the amplifier; add circuit",
        ),
        ("square_root: one, bandwidth: 1 rad/s", "has bandwidth, which is of the amplifier"),
        (
            "divide: [one, one], circuit: feedback, bandwidth: 1 MHz",
            "bandwidth is given in '1 MHz'; use rad/s",
        ),
        ("divide: [one, one], circuit: feedback, open_gain: 0", "must be greater than 0"),
        ("backlash: one", "has no width; add width:"),
        ("backlash: one, width: 0", "must be greater than 0"),
        ("backlash: one, width: 1, initial: 3", "initial value of 'x' is 3 times its full_scale"),
        ("amplify: {one: 1}, bandwidth: 1 kHz", "bandwidth is given in '1 kHz'; use rad/s"),
        ("amplify: one", "must be a mapping"),
    ],
)
def test_wrong_figures_are_told(wrong, told):
    text = patch("one: {constant: 1, full_scale: 1}", f"x: {{{wrong}, full_scale: 1}}")
    with pytest.raises(PatchError, match=told):
        compile_patch(parse_patch(text))


# --- the start -----------------------------------------------------------------------------------


@pytest.mark.parametrize("circuit", [False, True])
def test_a_loop_of_lagged_parts_begins_settled(circuit):
    """a = 1 - 0.9 a: at 1 / 1.9 before the run, on either engine."""
    text = patch(
        "one: {constant: 1, full_scale: 1}",
        "a: {sum: {b: 0.9, one: 1}, full_scale: 1}",
        "b: {invert: a, full_scale: 1}",
        machine="lags",
    )
    a = columns(text, as_circuit=circuit)["a"]
    assert a[0] == pytest.approx(1 / 1.9, rel=1e-13)
    np.testing.assert_allclose(a, 1 / 1.9, rtol=RESOLVED)
