"""Each analog patch that ships, run and compared with theory that knows nothing of the engine.

Pointwise: integration of the equations written out by hand, every lag a state. Beyond that: closed
forms, published figures, conserved quantities; of chaos only invariants.
"""

import math
import re
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from lagged_models import BALL, LINEAR_LAGGED, MODELS, SERVO, SWITCHED, TAU_S, jerk, van_der_pol
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.special import lambertw, mathieu_a, mathieu_b

from hybrid import elements as kinds
from hybrid import parse_patch, run
from hybrid.shipped import shipped_patches

LINEAR = ("harmonic_oscillator", "damped_oscillator")
SMOOTH = ("van_der_pol", "lorenz", "roessler", "mathieu", "predator_prey", "jerk")
JUMPY = ("bouncing_ball", "relay_servo")
ITERATED = ("shooting",)  # see test_shooting, too
POINTWISE = 1e-7  # of full scale


def read(name, until=None, every=None, machine=None, **initial):
    """A shipped patch that records everything; run length, rows, machine and initial values replaced."""
    text = shipped_patches()[name].read_text(encoding="utf-8")
    text, found = re.subn(r"^record:.*\n", "", text, flags=re.M)
    assert found == 1
    if until is not None:
        text, found = re.subn(
            r"^run: .*$", f"run: {{until: {until!r}, every: {every!r}}}", text, flags=re.M
        )
        text = re.sub(r"^readouts:\n( .*\n)*", "", text, flags=re.M)
        assert found == 1
    if machine is not None:
        text = re.sub(r"^machine: .*$", f"machine: {machine}", text, flags=re.M)
    for signal, value in initial.items():
        text, found = re.subn(
            rf"(?m)^(  {signal}: .*initial: )[^,]*", rf"\g<1>{float(value)!r}", text
        )
        assert found == 1
    return parse_patch(text)


def play(name, until=None, every=None, machine="lags", parameters=None, **initial):
    patch = read(name, until, every, **initial)
    result = run(patch, parameters, machine=machine)
    assert result.status == "complete"
    return Columns(result)


class Columns:
    """Columns of a record by name, in machine units with `mu`."""

    def __init__(self, result):
        self.result, self.time_s = result, result.time_s
        self.names = [pen.name for pen in result.pens]

    def __getitem__(self, name):
        return self.result.record[name].values

    def full_scale(self, name):
        return self.result.record[name].attrs["full_scale"]

    def mu(self, name):
        return self[name] / self.full_scale(name)


@cache
def whole(name, machine):
    """The patch as it ships."""
    return play(name, machine=machine)


@pytest.mark.parametrize("machine", ["lags", "ideal"])
@pytest.mark.parametrize("name", LINEAR + SMOOTH + JUMPY + ITERATED)
def test_every_signal_uses_its_full_scale_and_no_more(name, machine):
    played = whole(name, machine)
    assert played.result.overloads == ()
    idle = ("still",)  # a reference of zero
    for signal in sorted(set(played.names) - {"mode"}):
        largest = np.max(np.abs(played.mu(signal)))
        assert largest <= 1.0 + 1e-12, signal  # a lag that settles there may be above by rounding
        assert largest >= 0.1 or signal in idle, signal


def test_a_relay_at_full_scale_is_no_overload():
    patch = parse_patch("""
title: Relay
machine: lags
analog:
  x: {sine: 0.9, frequency: 1000 Hz, full_scale: 1}
  c: {compare: {x: 1}, high: 1, low: -1, full_scale: 1}
run: {until: 5 ms, every: 0.01 ms}
""")
    assert run(patch).overloads == ()


# Pointwise: the equations by hand, every lag a state.


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_patch_follows_its_equations_with_every_lag(name):
    model = MODELS[name]
    parameters = {"rate": 1000.0} if name in ("roessler", "jerk") else None  # faster than they ship
    played = play(name, model.until, model.until / 40, parameters=parameters)
    found = solve_ivp(
        model.rhs,
        (0.0, played.time_s[-1]),
        np.array(model.initial, dtype=float),
        method="DOP853",
        t_eval=played.time_s,
        rtol=1e-11,
        atol=1e-12,
    )
    for i, signal in enumerate(model.names):
        scale = played.full_scale(signal)
        assert np.max(np.abs(played[signal] - found.y[i])) < POINTWISE * scale, signal


# Linear ones: roots of the characteristic polynomial with its lags.


def roots_of_lagged(terms):
    """Roots of a sum of coefficient * s^power * (1 + TAU_S s)^lags: the one near the imaginary axis."""
    total = np.poly1d([0.0])
    for coefficient, power, lags in terms:
        total = (
            total + coefficient * np.poly1d([1.0] + [0.0] * power) * np.poly1d([TAU_S, 1.0]) ** lags
        )
    roots = [r for r in total.roots if r.imag > 0]
    return min(roots, key=abs)


def test_circle_grows_as_the_lags_say():
    omega = 1000.0
    root = roots_of_lagged([(1.0, 2, 3), (omega**2, 0, 0)])
    zeta = -root.real / abs(root)
    found = whole("harmonic_oscillator", "lags").result.readouts["circle"]
    assert found["omega"] == pytest.approx(abs(root), rel=1e-10)
    assert found["zeta"] == pytest.approx(zeta, abs=1e-10)
    assert zeta == pytest.approx(-0.5 * omega * 3 * TAU_S, rel=10 * omega * TAU_S)  # Eq. 2.3
    last = whole("harmonic_oscillator", "lags").result.readouts["last"]
    turned = 0.8 * np.exp(root * last["time_s"])
    assert last["value"] == pytest.approx(turned.real, rel=1e-4)
    assert math.exp(root.real * 0.02 * math.pi) == pytest.approx(1.0988, abs=1e-4)  # the header


def test_circle_stays_without_lags():
    played = whole("harmonic_oscillator", "ideal")
    radius = np.hypot(played["x"], played["y"])
    assert np.max(np.abs(radius - 0.8)) < 1e-12
    angle = 1000.0 * played.time_s
    assert np.max(np.abs(played["x"] - 0.8 * np.cos(angle))) < 1e-12


@pytest.mark.parametrize("machine", ["ideal", "lags"])
def test_damped_oscillator_has_its_mode_and_its_overshoot(machine):
    played = whole("damped_oscillator", machine)
    m, k, c = 1.0, 1e6, 200.0
    lags = (3, 1) if machine == "lags" else (0, 0)
    root = roots_of_lagged([(m, 2, lags[0]), (c, 1, lags[1]), (k, 0, 0)])
    found = played.result.readouts["mode"]
    assert found["omega"] == pytest.approx(abs(root), rel=1e-9)
    assert found["zeta"] == pytest.approx(-root.real / abs(root), abs=1e-9)
    if machine == "ideal":
        zeta = c / (2 * math.sqrt(k * m))
        overshoot = 1.0 + math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
        assert played.result.readouts["overshoot"]["value"] == pytest.approx(overshoot, rel=3e-5)
        decay = np.exp(-zeta * 1000.0 * played.time_s)
        damped = 1000.0 * math.sqrt(1 - zeta**2) * played.time_s
        slope = zeta / math.sqrt(1 - zeta**2)
        exact = 1.0 - decay * (np.cos(damped) + slope * np.sin(damped))
        assert np.max(np.abs(played["x"] - exact)) < 1e-12  # in mm


@pytest.mark.parametrize("name", LINEAR)
def test_linear_patch_follows_its_equations_with_every_lag(name):
    names, matrix, constant, first = LINEAR_LAGGED[name]
    a = np.array(matrix(1 / TAU_S), dtype=float)
    n = len(a)
    full = np.zeros((n + 1, n + 1))
    full[:n, :n], full[:n, n] = a, constant
    played = play(name, 8e-3, 2e-4)
    step = expm(full * 2e-4)
    state, rows = np.array([*first, 1.0]), []
    for _ in played.time_s:
        rows.append(state)
        state = step @ state
    for i, signal in enumerate(names):
        error = np.abs(np.array(rows)[:, i] - played[signal])
        assert np.max(error) < POINTWISE * played.full_scale(signal), signal


# Oscillations: published figures and conserved quantities.


def crossings(time_s, values, slopes, level=0.0):
    """When a record rises through a level, by cubics through values and slopes."""
    spline = CubicHermiteSpline(time_s, values - level, slopes)
    rising = np.flatnonzero((values[:-1] < level) & (values[1:] >= level))
    return np.array([brentq(spline, time_s[i], time_s[i + 1], xtol=1e-16) for i in rising])


def maxima(time_s, values, slopes):
    """Local maxima of a record, by cubics through values and slopes."""
    spline = CubicHermiteSpline(time_s, values, slopes)
    turning = spline.derivative()
    peaks = np.flatnonzero((slopes[:-1] > 0) & (slopes[1:] <= 0))
    return spline([brentq(turning, time_s[i], time_s[i + 1], xtol=1e-16) for i in peaks])


def limit_cycle(mu, settle, turns, machine="ideal"):
    """Period and amplitude of Van der Pol's oscillator, in units of its time."""
    until = (settle + turns) * 1e-3
    played = play("van_der_pol", until, 1e-5, machine, {"mu": mu}, x=2.0)
    late = played.time_s > settle * 1e-3
    t, x, y = (v[late] for v in (played.time_s * 1e3, played["x"], played["y"]))
    return np.mean(np.diff(crossings(t, x, y))), np.mean(maxima(t, x, y))


def test_van_der_pol_at_one_has_the_published_cycle():
    period, amplitude = limit_cycle(1.0, 60.0, 40.0)
    assert period == pytest.approx(6.66328685932, rel=1e-8)  # Amore 2021
    assert amplitude == pytest.approx(2.00861986087, rel=1e-8)


def test_van_der_pol_with_lags_has_the_cycle_of_its_lagged_equations():
    played = play("van_der_pol", 75e-3, 1e-5)
    late = played.time_s > 50e-3
    t, x, y = (v[late] for v in (played.time_s * 1e3, played["x"], played["y"]))
    period, amplitude = np.mean(np.diff(crossings(t, x, y))), np.mean(maxima(t, x, y))
    assert (period, amplitude) == pytest.approx((6.67848, 2.01422), abs=1e-5)  # the header
    state = [played[s][-1] for s in ("x", "y", "square", "damping", "x", "y")]
    state[4] += TAU_S * 1e3 * state[1]  # what the lags have not let out yet, to first order
    state[5] += TAU_S * 1e3 * (state[1] - state[0] - state[3])
    time_s = np.arange(0.0, 10e-3, 1e-5)
    rows = solve_ivp(
        van_der_pol, (0.0, 10e-3), state, method="DOP853", t_eval=time_s, rtol=1e-10, atol=1e-11
    ).y
    t, x, slopes = time_s * 1e3, rows[0], (rows[4] - rows[0]) / TAU_S * 1e-3
    found = np.concatenate([crossings(t, x, slopes), crossings(t, -x, -slopes)])
    assert np.min(np.abs(np.subtract.outer(found, found) - period)) < 3e-6
    assert maxima(t, x, slopes) == pytest.approx(amplitude, abs=3e-6)


@pytest.mark.parametrize("mu", [0.2, 0.4])
def test_van_der_pol_with_small_damping_follows_its_expansion(mu):
    """Andersen and Geer 1982; what is left out is of the next order."""
    period, amplitude = limit_cycle(mu, 25.0 / mu, 40.0)
    frequency = 1 - mu**2 / 16 + 17 * mu**4 / 3072 + 35 * mu**6 / 884736
    assert period == pytest.approx(2 * math.pi / frequency, abs=5e-3 * mu**8 + 1e-8)
    expected = 2 + mu**2 / 96 - 1033 * mu**4 / 552960 + 1019689 * mu**6 / 55738368000
    assert amplitude == pytest.approx(expected, abs=5e-3 * mu**8 + 1e-8)


def cosine_of_exponent(a, q, terms=200):
    """cos(pi nu) by Hill's determinant (Whittaker): x(pi) of the even solution with x(0) = 1."""
    n = np.arange(-terms, terms + 1)
    size = 2 * terms + 1
    matrix = np.eye(size)
    side = q / (4 * n**2 - a)  # rows of (4 n^2 - a) x_n + q (x_{n-1} + x_{n+1}) = 0
    matrix[np.arange(1, size), np.arange(size - 1)] = side[1:]
    matrix[np.arange(size - 1), np.arange(1, size)] = side[:-1]
    determinant = np.linalg.det(matrix)
    return 1 - determinant * (1 - math.cos(math.pi * math.sqrt(a)))


@pytest.mark.parametrize(("a", "start"), [(1.5, 0.5), (1.0, 0.02), (0.9, 0.02), (1.3, 0.5)])
def test_mathieu_repeats_by_its_exponent(a, start):
    """At every n pi the even solution is start * cos(n pi nu), nu complex inside the tongue."""
    q, turns = 0.2, 12
    rate = 1000.0
    played = play(
        "mathieu",
        turns * math.pi / rate,
        math.pi / rate,
        "ideal",
        {"a": a, "q": q, "start": start},
    )
    cosine = cosine_of_exponent(a, q)
    inside = mathieu_b(1, q) < a < mathieu_a(1, q)
    assert inside == (abs(cosine) > 1)
    expected = start * np.polynomial.chebyshev.chebval(cosine, np.eye(turns + 1))
    rows = len(played.time_s)  # instants are rounded to femtoseconds: the last may fall out
    assert rows >= turns
    assert np.max(np.abs(played["x"] - expected[:rows])) < 2e-8


def growth_of(x):
    """How much the solution through x(0), x(pi), x(2 pi), ... grows in a unit of time.

    Two multipliers are left of all: x_(n+1) = s x_n - p x_(n-1), s their sum and p their product.
    """
    (total, product), *_ = np.linalg.lstsq(np.stack([x[1:-1], -x[:-2]], axis=1), x[2:], rcond=None)
    return math.log(np.max(np.abs(np.roots([1.0, -total, product])))) / math.pi


def growth_with_lags(a, q, tau):
    """The same by Floquet's theory: eigenvalues of what a period makes of every state, tau with it."""
    wave = 1.0 / (1.0 + 2j * tau)

    def rate(t, states):
        x_in, x, y_in, y, pump = states.reshape(5, 5)
        cosine = (wave * np.exp(2j * t)).real
        change = (
            y,
            (x_in - x) / tau,
            -a * x + 2 * q * pump,
            (y_in - y) / tau,
            (x * cosine - pump) / tau,
        )
        return np.concatenate(change)

    found = solve_ivp(
        rate, (0.0, math.pi), np.eye(5).ravel(), method="Radau", rtol=1e-9, atol=1e-12
    )
    return math.log(np.max(np.abs(np.linalg.eigvals(found.y[:, -1].reshape(5, 5))))) / math.pi


@pytest.mark.parametrize("machine", ["ideal", "lags"])
def test_mathieu_grows_in_the_tongue_as_the_header_says(machine):
    """The patch as it ships, set as the header says. Rows are known to 1e-8, and begin at 0.02."""
    a, q = 1.0, 0.2
    played = run("mathieu", {"a": a, "start": 0.02}, machine=machine)
    x = played.record["x"].values[::64]
    assert len(x) >= 12 and played.status == "complete"
    found = growth_of(x[1:])  # what begins with the lags is over by then
    if machine == "ideal":
        expected = math.acosh(abs(cosine_of_exponent(a, q))) / math.pi
        assert expected == pytest.approx(0.0995, abs=1e-4)
    else:
        expected = growth_with_lags(a, q, 1e-3)  # 1 us of the 1 ms that a unit of time takes
    assert found == pytest.approx(expected, abs=2e-6)


def invariant(hares, lynxes):
    return 0.024 * hares - 0.80 * np.log(hares) + 0.028 * lynxes - 0.55 * np.log(lynxes)


def test_predator_and_prey_keep_their_invariant():
    played = whole("predator_prey", "ideal")
    kept = invariant(played["hares"], played["lynxes"])
    assert np.max(np.abs(kept - kept[0])) < 1e-9


def cycle_of_predator_and_prey(hares, lynxes, alpha=0.55, beta=0.028, gamma=0.80, delta=0.024):
    """Period by quadrature on the closed curve; the trapezoidal rule converges faster than any power.

    In u = ln(delta hares / gamma), v = ln(beta lynxes / alpha) the curve is gamma g(u) + alpha g(v) = h,
    g(w) = e^w - w - 1 = rho(w)^2 / 2: an ellipse in the two rho, traversed at the angular velocity
    sqrt(alpha gamma) rho'(u) rho'(v).
    """
    u, v = math.log(delta * hares / gamma), math.log(beta * lynxes / alpha)
    h = gamma * (math.exp(u) - u - 1) + alpha * (math.exp(v) - v - 1)
    theta = (np.arange(256) + 0.5) * 2 * np.pi / 256

    def slope(rho):
        z = -np.exp(-1 - rho**2 / 2)
        branch = np.where(rho > 0, lambertw(z, -1).real, lambertw(z, 0).real)
        return -(branch + 1) / rho  # e^w = -W, so rho' = (e^w - 1) / rho

    speed = slope(math.sqrt(2 * h / gamma) * np.cos(theta)) * slope(
        math.sqrt(2 * h / alpha) * np.sin(theta)
    )
    return float(np.mean(2 * np.pi / (math.sqrt(alpha * gamma) * speed)))


def test_predator_and_prey_return_after_their_period():
    played = play("predator_prey", 50e-3, 0.02e-3, "ideal")
    years, hares, lynxes = played.time_s * 1e3, played["hares"], played["lynxes"]
    found = crossings(years, hares, 0.55 * hares - 0.028 * hares * lynxes, 34.0)
    assert np.ptp(np.diff(found)) < 1e-7
    assert np.mean(np.diff(found)) == pytest.approx(cycle_of_predator_and_prey(34.0, 6.0), rel=1e-8)


# What switches.


@pytest.mark.parametrize("lagged", [True, False])
@pytest.mark.parametrize("name", JUMPY)
def test_switching_patch_follows_its_exact_pieces(name, lagged):
    """The whole run; where an output jumps on the ideal machine, only what stays continuous."""
    exact, names = SWITCHED[name]
    played = whole(name, "lags" if lagged else "ideal")
    rows, switched = exact(played.time_s, lagged)
    assert len(switched) >= 12
    for i, signal in enumerate(names if lagged else names[:2]):
        error = np.max(np.abs(played[signal] - rows[:, i]))
        assert error < POINTWISE * played.full_scale(signal), signal


def test_ball_leaves_the_floor_as_its_closed_form_says():
    """y = y_e + e^(-zeta w t) (...) about the rest position: time and velocity of leaving, by root."""
    g, w, zeta = BALL["g"], 100.0, 0.05
    damped, rest = w * math.sqrt(1 - zeta**2), BALL["g"] / 100.0**2
    speed_in, tops = math.sqrt(2 * g * 1.0), []
    for _ in range(5):
        b = (zeta * w * rest - speed_in) / damped

        def height(t, b=b):
            return -rest + math.exp(-zeta * w * t) * (
                rest * math.cos(damped * t) + b * math.sin(damped * t)
            )

        leaves = brentq(height, 1.0 / w, 1.15 * math.pi / damped, xtol=1e-16)
        decay, angle = math.exp(-zeta * w * leaves), damped * leaves
        speed_in = decay * (
            (b * damped - zeta * w * rest) * math.cos(angle)
            - (rest * damped + zeta * w * b) * math.sin(angle)
        )
        tops.append(speed_in**2 / (2 * g))
    assert tops[:2] == pytest.approx([0.723, 0.522], abs=5e-4)  # the header
    played = whole("bouncing_ball", "ideal")
    found = maxima(played.time_s * BALL["speed"], played["y"], played["v"])
    assert found[:5] == pytest.approx(tops, abs=1e-8)
    share = math.exp(-math.pi * zeta / math.sqrt(1 - zeta**2))
    assert math.sqrt(tops[0]) == pytest.approx(share, rel=0.01)


def test_headers_of_switching_patches_tell_what_lags_do():
    played = whole("bouncing_ball", "lags")
    tops = maxima(played.time_s, played["y"], 10.0 * played["v"])
    assert tops[:2] == pytest.approx([0.732, 0.536], abs=5e-4)
    played = play("relay_servo", 0.04, 5e-6)
    late = played.time_s > 0.02
    time_s, theta, speed = (v[late] for v in (played.time_s * 100, played["theta"], played["w"]))
    assert np.diff(crossings(time_s, theta, speed)) == pytest.approx(0.18986, abs=5e-6)
    assert maxima(time_s, theta, speed) == pytest.approx(0.0900, abs=5e-5)


def servo_cycle():
    """V, W, period and amplitude of the limit cycle: powered and coasting strokes joined."""
    K, T, band, hysteresis = (SERVO[key] for key in ("K", "T", "band", "hysteresis"))
    gain = 2 * band / T  # what coasting takes, power gives

    def excess(v):
        w = v + gain
        return K * T * math.log((K + v) / (K - w)) - (v + w) * T - hysteresis

    v = brentq(excess, 1e-9, K - gain - 1e-6, xtol=1e-15)
    w = v + gain
    period = 2 * T * math.log(w * (K + v) / (v * (K - w)))
    return v, w, period, band + hysteresis / 2 + v * T - K * T * math.log(1 + v / K)


def test_servo_hunts_with_its_exact_limit_cycle():
    v, w, period, amplitude = servo_cycle()
    assert (v, w, period, amplitude) == pytest.approx((2.038, 3.038, 0.18937, 0.08832), abs=5e-4)
    played = play("relay_servo", 0.04, 5e-6, "ideal")
    time_s, theta, speed = played.time_s * SERVO["speed"], played["theta"], played["w"]
    late = time_s > 2.0
    found = crossings(time_s[late], theta[late], speed[late])
    assert np.diff(found) == pytest.approx(period, rel=1e-7)
    assert maxima(time_s[late], theta[late], speed[late]) == pytest.approx(amplitude, abs=1e-8)
    fastest = np.max(np.abs(speed[late]))  # a corner, seen every 0.5 ms of the problem
    assert w - 5e-4 * SERVO["K"] / SERVO["T"] <= fastest <= w + 1e-9


# Chaos: invariants only, each within its own sampling error.


@dataclass(frozen=True)
class Strange:
    """How a chaotic patch is sampled, in units of the problem's time."""

    length: float
    every: float
    settle: float
    block: float  # much longer than anything is correlated
    jacobian: object  # of the equations without lags, from columns x, y, z
    exponent: float  # published
    error: float  # largest standard error expected of this length
    rate: float = 100.0


def matrices(rows, *entries):
    """Stacked 3 x 3 matrices from (row, column, values)."""
    found = np.zeros((rows, 3, 3))
    for i, j, values in entries:
        found[:, i, j] = values
    return found


def jacobian_of_lorenz(x, y, z):
    return matrices(
        len(x),
        *((0, 0, -10.0), (0, 1, 10.0), (1, 0, 28.0 - z), (1, 1, -1.0), (1, 2, -x)),
        *((2, 0, y), (2, 1, x), (2, 2, -8 / 3)),
    )


def jacobian_of_roessler(x, y, z):
    return matrices(
        len(x),
        *((0, 1, -1.0), (0, 2, -1.0), (1, 0, 1.0), (1, 1, 0.2), (2, 0, z), (2, 2, x - 5.7)),
    )


def jacobian_of_jerk(x, v, a):
    return matrices(
        len(x),
        *((0, 1, 1.0), (1, 2, 1.0), (2, 0, np.sign(x)), (2, 1, -1.0), (2, 2, -0.6)),
    )


CHAOS = {
    "lorenz": Strange(600.0, 0.01, 20.0, 20.0, jacobian_of_lorenz, 0.906, 0.025),  # Sprott 2003
    "roessler": Strange(3000.0, 0.04, 100.0, 100.0, jacobian_of_roessler, 0.0714, 0.005),  # same
    "jerk": Strange(4000.0, 0.1, 100.0, 100.0, jacobian_of_jerk, 0.035, 0.006),  # Linz, Sprott 1999
}


@cache
def long_run(name, machine, rate=None):
    """A run of the length in CHAOS without its beginning: columns, and time in the problem's units."""
    how = CHAOS[name]
    rate = rate or how.rate
    played = play(name, how.length / rate, how.every / rate, machine, {"rate": rate})
    late = played.time_s * rate >= how.settle
    return {s: played[s][late] for s in played.names}, played.time_s[late] * rate


def blocks(values, block):
    """Mean and its standard error, from means of blocks that are as good as independent."""
    count = len(values) // block
    means = np.mean(values[: count * block].reshape(count, block), axis=1)
    return np.mean(means), np.std(means, ddof=1) / math.sqrt(count)


def largest_exponent(jacobian, every, block, group=5):
    """Largest Lyapunov exponent along recorded rows, with its standard error; Runge-Kutta steps."""
    n = (len(jacobian) - 1) // 2 * 2
    first, middle, last = jacobian[0:n:2], jacobian[1:n:2], jacobian[2 : n + 1 : 2]
    step, one = 2 * every, np.eye(3)
    k1 = first
    k2 = middle @ (one + step / 2 * k1)
    k3 = middle @ (one + step / 2 * k2)
    k4 = last @ (one + step * k3)
    moves = one + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    moves = moves[: len(moves) // group * group].reshape(-1, group, 3, 3)
    joined = moves[:, 0]
    for i in range(1, group):
        joined = moves[:, i] @ joined
    vector, growth = np.ones(3), np.empty(len(joined))
    for i, move in enumerate(joined):
        vector = move @ vector
        size = math.sqrt(vector @ vector)
        vector /= size
        growth[i] = math.log(size)
    return blocks(growth / (step * group), round(block / (step * group)))


def exponent_of(name, machine, rate=None):
    how = CHAOS[name]
    columns, _ = long_run(name, machine, rate)
    states = ("x", "v", "a") if name == "jerk" else ("x", "y", "z")
    jacobian = how.jacobian(*(columns[s] for s in states))
    return largest_exponent(jacobian, how.every, how.block)


@pytest.mark.parametrize("machine", ["ideal", "lags"])
@pytest.mark.parametrize("name", CHAOS)
def test_chaos_has_the_published_exponent(name, machine):
    """At the rates that ship, lags shift an exponent by no more than this sampling error."""
    mean, error = exponent_of(name, machine)
    assert error < CHAOS[name].error
    assert abs(mean - CHAOS[name].exponent) < 4 * error


def test_lags_alone_end_the_chaos_of_a_fast_jerk_circuit():
    """At 1000 units of time a second five maxima repeat; so do those of the lagged equations."""
    rate, until = 1000.0, 0.6
    played = play("jerk", until, 5e-5, "lags", {"rate": rate})
    late = played.time_s > 0.5
    x, v = played["x"][late], played["v"][late]
    peaks = maxima(played.time_s[late] * rate, x, v)
    cycle = np.sort(peaks[-5:])
    assert np.min(np.diff(cycle)) > 0.1
    assert np.max(np.abs(peaks[5:] - peaks[:-5])) < 1e-4
    state = [played[s][-1] for s in ("x", "v", "a", "size", "x", "v", "a")]
    time_s = np.arange(0.0, 35e-3, 5e-5)
    rows = solve_ivp(
        jerk, (0.0, 35e-3), state, method="DOP853", t_eval=time_s, rtol=1e-8, atol=1e-9
    ).y
    slopes = (rows[4] - rows[0]) / TAU_S / rate
    slopes[0] = rows[1, 0]  # the lags have not settled yet
    found = np.sort(maxima(time_s * rate, rows[0], slopes)[:5])
    assert found == pytest.approx(cycle, abs=2e-3)


def test_lorenz_is_symmetric_and_balanced():
    columns, time = long_run("lorenz", "lags")
    x, z = columns["x"], columns["z"]
    block = round(20 / 0.01)
    for odd in (x, np.sign(x), x * z):
        mean, error = blocks(odd, block)
        assert abs(mean) < 4 * error
    mean, error = blocks(z, block)
    assert abs(mean - 23.55) < 4 * error + 0.005
    # What an integrator gathers is what its inputs bring, to the last unit of the record.
    length = time[-1] - time[0]
    for signal, drive in (("z", columns["xy"] - 8 / 3 * z), ("x", 10 * (columns["y"] - x))):
        gathered = np.sum((drive[1:] + drive[:-1]) / 2) * 0.01 / length
        moved = (columns[signal][-1] - columns[signal][0]) / length
        assert gathered == pytest.approx(moved, abs=2e-3)


def map_of_maxima(time, z, slopes):
    """Each maximum of z and the next."""
    peaks = maxima(time, z, slopes)
    return peaks[:-1], peaks[1:]


def test_lorenz_has_the_cusped_map_of_maxima():
    """Lorenz 1963, Fig. 4: one curve, two branches steeper than 1; here against integration.

    From several beginnings, so that the curve is known wherever a run may come.
    """
    begun = np.array([np.ones(8), np.linspace(1.0, 1.7, 8), np.full(8, 20.0)])

    def free(t, s):
        x, y, z = s.reshape(begun.shape)
        return np.concatenate([10 * (y - x), x * (28 - z) - y, x * y - 8 / 3 * z])

    time = np.arange(0, 150, 0.02)
    ways = solve_ivp(
        free, (0, 150), begun.ravel(), method="DOP853", t_eval=time, rtol=1e-8, atol=1e-8
    ).y.reshape(*begun.shape, -1)[:, :, 500:]
    maps = [map_of_maxima(time[500:], z, x * y - 8 / 3 * z) for x, y, z in ways.swapaxes(0, 1)]
    here, there = (np.concatenate(column) for column in zip(*maps, strict=True))
    order = np.argsort(here)
    here, there = here[order], there[order]
    columns, time = long_run("lorenz", "ideal")
    peaks, following = map_of_maxima(
        time, columns["z"], columns["x"] * columns["y"] - 8 / 3 * columns["z"]
    )
    cusp = here[np.argmax(there)]
    assert cusp == pytest.approx(38.5, abs=0.5)
    for low, high, sign in ((30.5, cusp - 0.5, 1), (cusp + 0.5, 43.0, -1)):
        chosen = (peaks > low) & (peaks < high)
        assert np.count_nonzero(chosen) > 100
        off = following[chosen] - np.interp(peaks[chosen], here, there)
        assert np.max(np.abs(off)) < 0.15  # of 20; the curve has a little thickness
        order = np.argsort(peaks[chosen])
        fit = np.polynomial.Polynomial.fit(peaks[chosen][order], following[chosen][order], 5)
        inner = np.linspace(low + 0.5, high - 0.5, 50)
        assert np.all(sign * fit.deriv()(inner) > 1.0)


def test_roessler_turns_as_its_header_says():
    columns, time = long_run("roessler", "lags")
    found = crossings(time, columns["x"], -columns["y"] - columns["z"])
    assert np.mean(np.diff(found)) == pytest.approx(5.86, abs=0.01)


def test_jerk_spends_its_time_about_one():
    """a' = -A a - v + |x| - 1 summed over a run leaves mean |x| = 1, but for the ends."""
    columns, time = long_run("jerk", "lags")
    length = time[-1] - time[0]
    size, x, v, a = (columns[s] for s in ("size", "x", "v", "a"))
    mean = np.mean((size[1:] + size[:-1]) / 2)
    ends = (a[-1] - a[0] + 0.6 * (v[-1] - v[0]) + x[-1] - x[0]) / length
    assert mean - 1 == pytest.approx(ends, abs=1e-4)


ROOT = math.sqrt(72.0)
MIDDLE = (5.7 - math.sqrt(5.7**2 - 0.16)) / 2
AT_REST = {
    "lorenz, right": ("lorenz", {"x": ROOT, "y": ROOT, "z": 27.0}),
    "lorenz, left": ("lorenz", {"x": -ROOT, "y": -ROOT, "z": 27.0}),
    "roessler": ("roessler", {"x": MIDDLE, "y": -MIDDLE / 0.2, "z": MIDDLE / 0.2}),
    "jerk, right": ("jerk", {"x": 1.0, "v": 0.0, "a": 0.0}),
    "jerk, left": ("jerk", {"x": -1.0, "v": 0.0, "a": 0.0}),
    "van_der_pol": ("van_der_pol", {"x": 0.0, "y": 0.0}),
    "predator_prey": ("predator_prey", {"hares": 0.80 / 0.024, "lynxes": 0.55 / 0.028}),
}


@pytest.mark.parametrize("case", AT_REST)
def test_fixed_points_stay(case):
    """All are unstable, or nearly: rounding grows for a few units of time at most."""
    name, initial = AT_REST[case]
    played = play(name, 0.01, 1e-4, "lags", **initial)
    for signal in initial:
        assert np.ptp(played.mu(signal)) < 1e-11, signal


# What lags do: first order in tau, and within a bound.


@pytest.mark.parametrize("name", LINEAR + SMOOTH + JUMPY)
def test_lags_shift_a_run_in_proportion(name):
    """Half the lags, half the difference from the ideal machine, at the end of a short run."""
    until, signal = {"bouncing_ball": (0.1, "y"), "relay_servo": (0.01, "theta")}.get(
        name, (0.005, {"predator_prey": "hares"}.get(name, "x"))
    )
    runs = []
    for tau in (0.0, 0.25e-6, 0.5e-6):
        patch = read(name, until, until / 20, f"{{preset: ideal, tau: {tau * 1e6} us}}")
        runs.append(Columns(run(patch))[signal])
    half, full = np.max(np.abs(runs[1] - runs[0])), np.max(np.abs(runs[2] - runs[0]))
    assert full / half == pytest.approx(2.0, rel=0.05)


def influence(element, sizes):
    """Largest change of an element's sum or function per unit of each signal within its size."""
    first = {s: abs(element.gain * g) for s, g in element.first.items()}
    if element.kind != kinds.PRODUCT:
        slope = max((abs(piece[4]) for piece in element.pieces), default=1.0)
        return {s: slope * g for s, g in first.items()}
    second = {s: abs(g) for s, g in element.second.items()}
    reach, other = (sum(g * sizes[s] for s, g in terms.items()) for terms in (first, second))
    found = {s: g * other for s, g in first.items()}
    for s, g in second.items():
        found[s] = found.get(s, 0.0) + g * reach
    return found


def bound_on_lags(machine, sizes, until):
    """Bound on |lagged - ideal| of every signal, in machine units, by components (Gronwall).

    A lagged output trails by tau times the largest rate of what it follows; a static element passes
    errors on by its largest slope, an integrator gathers them. Signals stay within `sizes`.
    """
    names = [n for n, _ in machine.elements]
    place, count = {n: i for i, n in enumerate(names)}, len(names)
    static, gathers, own = np.zeros((count, count)), np.zeros((count, count)), np.zeros(count)
    size = np.array([sizes.get(n, 1.0) for n in names])
    for name, element in machine.elements:
        target = gathers if element.kind == kinds.INTEGRATE else static
        for s, g in influence(element, sizes).items():
            target[place[name], place[s]] += g
        if element.kind == kinds.SINE:
            own[place[name]] = element.figures[0] * element.figures[1]
    through = np.linalg.inv(np.eye(count) - static)  # static elements form no loop
    trailing = TAU_S * through @ (gathers @ size + own)
    full = np.zeros((count + 1, count + 1))
    full[:count, :count] = gathers @ through
    full[:count, count] = gathers @ through @ trailing
    gathered = expm(full * until)[:count, count]
    return dict(zip(names, through @ (gathered + trailing), strict=True))


@pytest.mark.parametrize("name", SMOOTH)
def test_lags_stay_within_their_bound(name):
    """Over a third of the problem's unit of time; the bound grows as no real difference does."""
    until = (0.1 if name == "lorenz" else 0.3) / (100.0 if name in CHAOS else 1000.0)
    lagged, ideal = (play(name, until, until / 50, machine) for machine in ("lags", "ideal"))
    sizes = {s: 1.01 * max(np.max(np.abs(p.mu(s))) for p in (lagged, ideal)) for s in lagged.names}
    bound = bound_on_lags(lagged.result.machine, sizes, until)
    for signal in lagged.names:
        off = np.max(np.abs(lagged.mu(signal) - ideal.mu(signal)))
        assert off <= bound[signal] < 0.02, signal
