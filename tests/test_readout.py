"""The readouts of a record, and above all the measurement of a transient against exact poles."""

import cmath
import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid._modal_fit import condense, fit_weights, row_residuals
from hybrid.readout import READOUTS, measure_transient

OMEGA = 10.0


# --- exact records ---------------------------------------------------------------------------


def loop_root(w):
    """e = z - 1 of the growing root of z (z - 1)^2 + (w^2 / 2)(z + 1) = 0, upper half-plane.

    Solved for e: e^3 + e^2 + (w^2 / 2)(e + 2) = 0 has no cancellation, as its terms are alike.
    """
    e = complex(0.0, w)
    for _ in range(60):
        e -= (e**3 + e**2 + 0.5 * w * w * (e + 2.0)) / (3.0 * e**2 + 2.0 * e + 0.5 * w * w)
    return e


def loop_mode(w, interval_s):
    """omega, zeta and omega_damped of the sampled pitch loop, from s = ln(1 + e) / T."""
    e = loop_root(w)
    real = 0.5 * math.log1p(2.0 * e.real + abs(e) ** 2)
    s = complex(real, math.atan2(e.imag, 1.0 + e.real)) / interval_s
    return abs(s), -s.real / abs(s), s.imag


def loop_record(interval_s, rows, omega_p=OMEGA):
    """theta at the sampling instants: ADC, one cycle to compute, zero-order hold."""
    theta, rate, moment = 0.1, 0.0, 0.0
    record = np.empty(rows)
    for n in range(rows):
        record[n] = theta
        sampled = theta
        theta += interval_s * rate + 0.5 * interval_s**2 * moment
        rate += interval_s * moment
        moment = -(omega_p**2) * sampled
    return record


def free_response(omega, zeta, t, x0=1.0, v0=0.0):
    """Solution of x'' + 2 zeta omega x' + omega^2 x = 0 in closed form."""
    t = np.asarray(t)
    if abs(zeta) < 1.0:
        damped = omega * math.sqrt((1.0 - zeta) * (1.0 + zeta))
        wave = x0 * np.cos(damped * t) + (v0 + zeta * omega * x0) / damped * np.sin(damped * t)
        return np.exp(-zeta * omega * t) * wave
    if zeta == 1.0:
        return np.exp(-omega * t) * (x0 + (v0 + omega * x0) * t)
    fast = -math.copysign(
        omega * (abs(zeta) + math.sqrt((abs(zeta) - 1.0) * (abs(zeta) + 1.0))), zeta
    )
    slow = omega**2 / fast
    c = (v0 - slow * x0) / (fast - slow)
    return (x0 - c) * np.exp(slow * t) + c * np.exp(fast * t)


def assert_measures(record, interval_s, omega, zeta, tolerance):
    found = measure_transient(record, interval_s)
    assert found.reason == "", found
    assert found.omega == pytest.approx(omega, rel=tolerance, abs=0.0)
    assert found.zeta == pytest.approx(zeta, abs=tolerance, rel=0.0)
    return found


# --- clean records -----------------------------------------------------------------------------


@pytest.mark.parametrize("w", [1e-4, 1e-2, 0.3])
def test_reference_root_is_exact_to_rounding(w):
    """One Newton step in exact arithmetic moves the reference by less than 4 ulp."""
    e = loop_root(w)
    a, b, half = Fraction(e.real), Fraction(e.imag), Fraction(w) ** 2 / 2
    square = (a * a - b * b, 2 * a * b)
    cube = (square[0] * a - square[1] * b, square[0] * b + square[1] * a)
    value = complex(
        float(cube[0] + square[0] + half * (a + 2)), float(cube[1] + square[1] + half * b)
    )
    slope = 3.0 * e**2 + 2.0 * e + 0.5 * w * w
    assert abs(value / slope) < 4.0 * np.finfo(float).eps * abs(e)
    s = cmath.log(1.0 + e)  # and it is the right root: series of the paper's Eq. 2.1
    assert abs(s) / w == pytest.approx(1.0 - 7.0 / 12.0 * w**2 + 177.0 / 160.0 * w**4, abs=3 * w**6)
    assert -s.real / abs(s) == pytest.approx(-0.75 * w + 0.75 * w**3, abs=2 * w**5 + 1e-12)


@pytest.mark.parametrize(
    ("w", "seconds"),
    [
        *((1e-4, 1), (1e-3, 1), (1e-3, 10), (1e-2, 1), (1e-2, 10), (1e-2, 100), (0.03, 30)),
        *((0.1, 1), (0.1, 10), (0.1, 100), (0.2, 3), (0.3, 0.6), (0.3, 1), (0.3, 3), (0.3, 100)),
    ],
)
def test_sampled_pitch_loop(w, seconds):
    """Growth up to e^200, and a third root z near -w^2/2 in the first rows."""
    interval_s = w / OMEGA
    record = loop_record(interval_s, round(seconds / interval_s) + 1)
    omega, zeta, damped = loop_mode(w, interval_s)
    found = assert_measures(record, interval_s, omega, zeta, 1e-11)
    assert found.omega_damped == pytest.approx(damped, rel=1e-11)
    assert found.kind == "oscillatory"
    assert max(found.omega_error / omega, found.zeta_error) < 1e-11
    assert found.amplitude == pytest.approx(0.1, rel=w)


ZETAS = [0.0, 1e-6, -1e-3, 0.01, 0.3, -0.3, 0.7, 0.99, 0.9999]
CRITICAL = [1.0 - 1e-6, 1.0 - 1e-9, 1.0, 1.0 + 1e-9, 1.0001, 1.01, 1.5, -1.5, 3.0]


@pytest.mark.parametrize("rows", [60, 1000, 30001])
@pytest.mark.parametrize("cycles", [0.6, 1.0, 5.0])
@pytest.mark.parametrize("zeta", ZETAS + CRITICAL)
def test_free_response(zeta, cycles, rows):
    """From 0.6 cycle, at any damping, with an offset; overdamped: 0.6 slow time constants or more.

    Near critical damping with few rows in the signal the poles are ill-conditioned; 1e-9 holds
    there as elsewhere.
    """
    radians = 2.0 * math.pi * cycles if abs(zeta) <= 1.0 else 2.0 * abs(zeta) * cycles
    if zeta < 0.0:
        radians = min(radians, 7.0 / -zeta)
    interval_s = radians / OMEGA / (rows - 1)
    if abs(zeta) > 1.0 and 2.0 * abs(zeta) * OMEGA * interval_s > 2.0:
        pytest.skip("the fast pole decays within a row")
    record = 0.37 + free_response(OMEGA, zeta, np.arange(rows) * interval_s)
    found = assert_measures(record, interval_s, OMEGA, zeta, 1e-9)
    assert found.kind == ("oscillatory" if found.omega_damped > 0.0 else "overdamped")
    damped = OMEGA * math.sqrt(max(0.0, (1.0 - zeta) * (1.0 + zeta)))
    assert abs(found.omega_damped - damped) <= 1e-9 * OMEGA + 10.0 * found.omega_damped_error


def test_heavy_overdamping_resolves_a_pole_of_six_rows():
    """zeta = 20: the poles are 1,600 apart and the fast one holds 1/1600 of the amplitude."""
    interval_s = 4e-4
    record = free_response(OMEGA, 20.0, np.arange(10001) * interval_s)
    found = assert_measures(record, interval_s, OMEGA, 20.0, 1e-9)
    assert found.omega_damped == 0.0
    assert found.kind == "overdamped"


@pytest.mark.parametrize(("cycles", "rows"), [(50, 400), (3000, 10001), (30000, 100001)])
@pytest.mark.parametrize("zeta", [0.0, 1e-5, -1e-5])
def test_many_cycles(cycles, rows, zeta):
    interval_s = 2.0 * math.pi * cycles / OMEGA / (rows - 1)
    record = free_response(OMEGA, zeta, np.arange(rows) * interval_s) - 2.0
    assert_measures(record, interval_s, OMEGA, zeta, 1e-11)


@pytest.mark.parametrize("zeta", [0.02, 0.2, 1.0, 1.3])
@pytest.mark.parametrize("share", [0.1, 0.01])
@pytest.mark.parametrize("rows", [5000, 100000])
def test_decay_to_nothing(zeta, share, rows):
    """A time constant of 10 % or 1 % of the record; the rest is rounding of the offset."""
    interval_s = 1.0 / (zeta * OMEGA) * 1.0 / (share * rows)
    if OMEGA * interval_s > 2.0:
        pytest.skip("aliased")
    record = 0.37 + free_response(OMEGA, zeta, np.arange(rows) * interval_s)
    assert_measures(record, interval_s, OMEGA, zeta, 1e-11 if zeta != 1.0 else 1e-9)


def test_offset_a_thousand_times_the_mode():
    """Rounding of the offset is noise of 1e3 eps / sqrt(12) in the rows: 1e-13 of the mode."""
    interval_s = 1e-3
    record = 1000.0 + free_response(OMEGA, 0.1, np.arange(3000) * interval_s)
    found = assert_measures(record, interval_s, OMEGA, 0.1, 1e-12)
    assert found.offset == pytest.approx(1000.0, abs=1e-11)
    assert 1e-16 < found.zeta_error < 1e-13


def test_amplitude_offset_and_window():
    t = np.arange(4001) * 1e-3
    record = 3.0 + 2.0 * np.exp(-0.5 * t) * np.cos(OMEGA * t + 0.4)
    found = measure_transient(record, 1e-3, start_s=1.0)
    assert found.amplitude == pytest.approx(2.0 * math.exp(-0.5), rel=1e-12)
    assert found.offset == pytest.approx(3.0, abs=1e-13)
    assert found.rows_used == 3001
    assert found.omega == pytest.approx(math.hypot(OMEGA, 0.5), rel=1e-12)
    overdamped = measure_transient(free_response(OMEGA, 2.0, t, x0=0.0, v0=5.0), 1e-3)
    assert overdamped.amplitude == pytest.approx(0.5, rel=1e-11)  # x' / omega


def test_dead_time_is_left_out():
    """A step response that starts after 0.3 s of rest."""
    t = np.arange(3000) * 1e-3
    moving = np.maximum(t - 0.3, 0.0)
    record = 1.0 - np.where(t < 0.3, 1.0, free_response(OMEGA, 0.25, moving))
    found = assert_measures(record, 1e-3, OMEGA, 0.25, 1e-11)
    assert found.rows_used == pytest.approx(2700, abs=5)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    zeta=st.floats(-0.5, 2.0),
    cycles=st.floats(0.7, 20.0),
    phase=st.floats(0.0, 6.2),
    power=st.integers(-300, 300),
)
def test_scale_and_direction_of_time_do_not_matter(zeta, cycles, phase, power):
    """A power of two changes no digit; backwards, the same mode has the opposite damping."""
    radians = min(2.0 * math.pi * cycles, 12.0 / max(abs(zeta), 1e-9))
    interval_s = radians / OMEGA / 800.0
    t = np.arange(801) * interval_s
    record = free_response(OMEGA, zeta, t, math.cos(phase), OMEGA * math.sin(phase)) + 0.1
    found = measure_transient(record, interval_s)
    scaled = measure_transient(record * 2.0**power, interval_s)
    assert (scaled.omega, scaled.zeta, scaled.reason) == (found.omega, found.zeta, found.reason)
    if not found.reason:
        assert found.omega == pytest.approx(OMEGA, rel=1e-9)
        back = measure_transient(record[::-1], interval_s)
        assert back.zeta == pytest.approx(-found.zeta, abs=1e-9)


# --- noise -------------------------------------------------------------------------------------


def cramer_rao(omega, zeta, t, deviation):
    """Least standard deviations of omega and zeta: x0, v0 and offset are unknown as well."""

    def model(p):
        return p[4] + free_response(p[0], p[1], t, p[2], p[3])

    at = np.array([omega, zeta, 1.0, 0.0, 0.2])
    steps = 1e-5 * np.array([omega, 1.0, 1.0, omega, 1.0])
    slopes = np.array(
        [(model(at + step) - model(at - step)) / (2.0 * step.sum()) for step in np.diag(steps)]
    )
    return deviation * np.sqrt(np.diag(np.linalg.inv(slopes @ slopes.T)))[:2]


def ensemble(records, interval_s):
    found = [measure_transient(record, interval_s) for record in records]
    assert all(f.reason == "" for f in found)
    values = np.array([(f.omega, f.zeta) for f in found])
    errors = np.array([(f.omega_error, f.zeta_error) for f in found])
    return values, errors


@pytest.mark.parametrize(
    ("zeta", "cycles", "rows", "deviation"),
    [
        *((0.0, 1.0, 1000, 1e-2), (-0.0075, 16.0, 2000, 0.1), (0.3, 5.0, 500, 1e-3)),
        *((1.2, 2.0, 1000, 1e-3), (0.01, 200.0, 3000, 0.1), (0.2, 100.0, 3000, 1e-2)),
    ],
)
def test_white_noise_reaches_the_cramer_rao_bound(zeta, cycles, rows, deviation):
    """120 records: a scatter ratio of 1 is uncertain by 6.5 %, so 1.25 is 4 standard deviations.

    The errors may be larger, as they allow for a walk of the amplitude too small to be seen: by 1.8
    on the average (see `hybrid._modal_drift`), where the mode lasts for one and a half cycles or more.
    """
    rng = np.random.default_rng(20260101)
    interval_s = 2.0 * math.pi * cycles / OMEGA / (rows - 1)
    t = np.arange(rows) * interval_s
    clean = 0.2 + free_response(OMEGA, zeta, t)
    values, errors = ensemble(clean + deviation * rng.normal(size=(120, rows)), interval_s)
    bound = cramer_rao(OMEGA, zeta, t, deviation)
    off = values - (OMEGA, zeta)
    assert (np.sqrt(np.mean(off**2, axis=0)) < 1.25 * bound).all()
    assert (np.abs(off.mean(axis=0)) < 4.0 * bound / math.sqrt(120.0)).all()
    ratio = errors.mean(axis=0) / off.std(axis=0)
    assert (ratio > 0.75).all()
    assert (ratio < (1.8 * 1.25 if abs(zeta) * cycles < 1.0 < cycles else 1.3)).all()


@pytest.mark.parametrize(
    ("zeta", "cycles", "rows"),
    [(-0.0075, 16.0, 10001), (0.0, 3.3, 1000), (0.3, 5.0, 1000), (1.5, 2.0, 1000)],
)
def test_quantised_to_14_bits(zeta, cycles, rows):
    """As white noise of step / sqrt(12); its tail, where the last bit rests, is left out.

    Such noise repeats itself from cycle to cycle, and may pass for a walk of the amplitude.
    """
    rng = np.random.default_rng(7)
    interval_s = 2.0 * math.pi * cycles / OMEGA / (rows - 1)
    t = np.arange(rows) * interval_s
    step = 2.0**-13 * (7.0 if zeta < 0.0 else 1.0)  # full scale holds the growth
    clean = np.array([0.2 * rng.random() + free_response(OMEGA, zeta, t) for _ in range(60)])
    values, errors = ensemble(np.round(clean / step) * step, interval_s)
    bound = cramer_rao(OMEGA, zeta, t, step / math.sqrt(12.0))
    off = values - (OMEGA, zeta)
    assert (np.sqrt(np.mean(off**2, axis=0)) < 1.5 * bound).all()
    assert (np.abs(off.mean(axis=0)) < 4.0 * off.std(axis=0) / math.sqrt(60.0)).all()
    ratio = errors.mean(axis=0) / off.std(axis=0)
    assert (ratio > 0.7).all()
    assert (ratio < (1.5 if zeta > 0.0 else 2.7)).all()


# --- more than one mode ------------------------------------------------------------------------


@pytest.mark.parametrize("zeta", [-1.1, -1.5, -2.0, -3.0])
@pytest.mark.parametrize("until_s", [0.6, 1.0, 1.2, 1.4, 1.5, 1.56, 1.8, 2.0, 4.0])
def test_two_growing_poles_are_measured_or_refused(zeta, until_s):
    """The faster one hides the slower beneath the rounding of its last rows, 1e15 times as large as the
    first: the figures are within what is stated, or there are none."""
    time_s = np.arange(round(until_s / 0.01) + 1) * 0.01
    found = measure_transient(free_response(3.0, zeta, time_s, v0=0.2), 0.01)
    if found.reason:
        assert until_s * 3.0 * math.sqrt(zeta**2 - 1.0) > 16.0, (
            found
        )  # they differ by e^32 and more
        return
    assert abs(found.omega - 3.0) < 6.0 * found.omega_error < 1e-2
    assert abs(found.zeta - zeta) < 6.0 * found.zeta_error < 1e-2


@pytest.mark.parametrize("amplitude", [1e-3, 0.1])
def test_fast_transient_at_the_start_is_left_out(amplitude):
    """An extra pole at -40 omega is gone after 90 rows: the mode is exact without them."""
    t = np.arange(6001) * 1e-3
    record = free_response(OMEGA, 0.05, t) + amplitude * np.exp(-40.0 * OMEGA * t)
    found = assert_measures(record, 1e-3, OMEGA, 0.05, 1e-9)
    assert 5000 < found.rows_used < 6001


@pytest.mark.parametrize("zeta", [-0.05, 0.0, 0.05])
@pytest.mark.parametrize("z", [0.02, -0.1])
def test_mode_of_a_few_rows_is_left_out(zeta, z):
    """A third root near z = 0, as a delay brings about; whichever end is the stronger one."""
    n = np.arange(3000)
    record = 0.2 + free_response(OMEGA, zeta, n * 1e-3) + 1e-3 * z**n
    found = assert_measures(record, 1e-3, OMEGA, zeta, 1e-13)
    assert 2984 <= found.rows_used < 3000
    assert max(found.omega_error / OMEGA, found.zeta_error) < 1e-14


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize("rows", [40, 100, 1001, 20011])
def test_rows_left_out_of_a_condensed_record(rows, last):
    """The rest is condensed already: the same mode fits it to rounding, row by row."""
    sigma, omega = -1.0 / rows, 0.03
    values = 0.3 + np.exp(sigma * np.arange(rows)) * np.cos(omega * np.arange(rows))
    rest = condense(values, omega).without(7, last)
    assert sum(size * count for size, _, count in rest.groups) == rows - 7
    fit = fit_weights(rest, np.array([sigma, sigma**2 + omega**2]))
    assert fit.rss < 1e-26 * float(rest.data @ rest.data)
    kept = values[:-7] if last else values[7:]
    assert max(row_residuals(kept, rest, fit)) < 1e-12  # the sine of 600 rad


@pytest.mark.parametrize("ratio", [0.3, 0.7, 0.95, 0.97, 0.99, 1.01, 1.03, 1.05, 1.6, 5.0])
@pytest.mark.parametrize("amplitude", [1e-4, 0.03])
def test_small_second_oscillation_is_in_the_error(ratio, amplitude):
    t = np.arange(5001) * 1e-3
    record = free_response(OMEGA, 0.05, t) + amplitude * np.cos(ratio * OMEGA * t + 1.0)
    found = measure_transient(record, 1e-3)
    assert found.reason == ""
    assert abs(found.omega - OMEGA) < 4.0 * found.omega_error
    assert abs(found.zeta - 0.05) < 4.0 * found.zeta_error
    assert found.zeta_error > 1e-3 * amplitude


def test_two_equal_modes_have_no_answer():
    t = np.arange(5001) * 1e-3
    found = measure_transient(np.cos(OMEGA * t) + np.cos(1.5 * OMEGA * t), 1e-3)
    assert "several" in found.reason


# --- records without an answer -----------------------------------------------------------------


N = np.arange(2000.0)
NO_ANSWER = {
    "7 rows are too few": np.ones(7),
    "0 rows are too few": np.ones(0),
    "record is constant": np.full(500, 2.5),
    "row 3 is not a finite": np.where(N == 3, np.nan, np.cos(0.01 * N)),
    "row 1999 is not a finite": np.where(N == 1999, np.inf, np.cos(0.01 * N)),
    "a straight line": 0.1 + 0.3 * N,
    "straight line": np.round(0.37 * N),
    "too short": 1.0 + 1e-3 * N + 1e-8 * N**2,
    "one real pole, s = -2 1/s": 1.0 + 0.5 * np.exp(-0.002 * N),
    "one real pole, s = 3 1/s": 1.0 + 0.5 * np.exp(0.003 * N),
    "one real pole grows": np.exp(-0.003 * N) + 0.01 * np.exp(0.002 * N),
    "rows per cycle": np.cos(0.97 * math.pi * N),
    "within one row": np.exp(-0.002 * N) + np.exp(-5.0 * N),
    "constant or a straight line": np.where(N == 700, 1.0, 0.0),
}


@pytest.mark.parametrize("reason", NO_ANSWER)
def test_no_answer_is_given_with_its_reason(reason):
    found = measure_transient(NO_ANSWER[reason], 1e-3)
    assert reason in found.reason
    assert found.omega is found.zeta is found.omega_error is found.omega_damped is None
    assert (found.kind == "first-order") == ("1/s" in reason)
    assert str(found) == f"no transient measured: {found.reason}"


@pytest.mark.parametrize("rows", [20, 300, 20000])
@pytest.mark.parametrize("slope", [0.0, 1e-3])
def test_noise_alone_is_no_mode(rows, slope):
    rng = np.random.default_rng(3)
    for _ in range(100 if rows < 1000 else 20):
        record = rng.normal(size=rows) + slope * np.arange(rows)
        assert "straight line" in measure_transient(record, 1e-3).reason


def test_first_order_decay_in_noise_is_not_given_a_second_pole():
    rng = np.random.default_rng(4)
    kinds = [
        measure_transient(np.exp(-0.004 * N) + 1e-3 * rng.normal(size=2000), 1e-3).kind
        for _ in range(60)
    ]
    assert kinds == ["first-order"] * 60


def test_misuse_raises():
    record = np.cos(0.05 * N)
    with pytest.raises(ValueError, match="one dimension, not 2"):
        measure_transient(record.reshape(2, -1), 1e-3)
    for interval_s in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="interval_s must be finite and positive"):
            measure_transient(record, interval_s)
    for start_s in (-1.0, math.nan):
        with pytest.raises(ValueError, match="start_s must be finite and not negative"):
            measure_transient(record, 1e-3, start_s=start_s)
    assert "too few" in measure_transient(record, 1e-3, start_s=1e9).reason


def test_text_of_a_measurement():
    text = str(measure_transient(free_response(OMEGA, 0.1, 1e-3 * N), 1e-3))
    assert text.startswith("oscillatory: omega = 10 +- ")
    assert "zeta = 0.1 +- " in text


# --- registry ----------------------------------------------------------------------------------


def test_simple_readouts():
    time_s = np.array([0.0, 0.5, 1.0, 1.5])
    values = np.array([1.0, -3.0, 4.0, 4.0])
    read = {name: READOUTS[name](time_s, values) for name in READOUTS if name != "transient"}
    assert read == {
        "final": {"value": 4.0, "time_s": 1.5},
        "maximum": {"value": 4.0, "time_s": 1.0},
        "minimum": {"value": -3.0, "time_s": 0.5},
        # By hand: half a second of (1 + 9)/2, (9 + 16)/2, 16; and of (1 - 3)/2, (-3 + 4)/2, 4.
        "rms": {"value": pytest.approx(math.sqrt(0.5 * (5.0 + 12.5 + 16.0) / 1.5), rel=1e-15)},
        "mean": {"value": pytest.approx(0.5 * (-1.0 + 0.5 + 4.0) / 1.5, rel=1e-15)},
    }


def test_means_are_taken_over_time():
    one, uneven = np.array([7.0]), np.array([0.0, 1.0, 10.0])
    assert READOUTS["mean"](one, np.array([-3.0])) == {"value": -3.0}
    assert READOUTS["rms"](one, np.array([-3.0])) == {"value": 3.0}
    # A ramp over rows that are not even has the mean of its ends.
    assert READOUTS["mean"](uneven, 2.0 * uneven)["value"] == pytest.approx(10.0, rel=1e-15)
    assert READOUTS["mean"](uneven, np.full(3, 0.1))["value"] == 0.1
    # One whole cycle, whose first row comes again as its last.
    cycle = np.cos(2.0 * math.pi * np.arange(101) / 100.0)
    assert READOUTS["mean"](np.arange(101) * 0.01, cycle)["value"] == pytest.approx(0.0, abs=1e-15)
    rms = READOUTS["rms"](np.arange(101) * 0.01, cycle)["value"]
    assert rms == pytest.approx(math.sqrt(0.5), rel=1e-15)


def test_rms_of_large_values_does_not_overflow():
    assert READOUTS["rms"](np.arange(2.0), np.array([1e300, -1e300]))["value"] == 1e300
    assert READOUTS["rms"](np.arange(2.0), np.zeros(2))["value"] == 0.0


def test_simple_readouts_refuse_what_has_no_value():
    for name in ("final", "maximum", "minimum", "rms", "mean"):
        with pytest.raises(ValueError, match="has no rows"):
            READOUTS[name](np.zeros(0), np.zeros(0))
        with pytest.raises(ValueError, match="equal length"):
            READOUTS[name](np.zeros(3), np.zeros(2))
        with pytest.raises(ValueError, match="row 1 of the record is nan"):
            READOUTS[name](np.zeros(2), np.array([0.0, math.nan]))


def test_transient_readout():
    time_s = 5.0 + np.arange(3000) * 1e-3
    read = READOUTS["transient"](time_s, 0.5 + free_response(OMEGA, 0.1, time_s - 5.0))
    assert list(read) == [
        *("omega", "omega_damped", "zeta", "omega_error", "omega_damped_error", "zeta_error"),
        *("amplitude", "offset", "reason"),
    ]
    assert read["omega"] == pytest.approx(OMEGA, rel=1e-11)
    assert read["offset"] == pytest.approx(0.5, abs=1e-12)
    assert read["reason"] == ""
    uneven = READOUTS["transient"](time_s**2, np.cos(time_s))
    assert uneven["omega"] is None
    assert "evenly spaced" in uneven["reason"]
    assert "too few" in READOUTS["transient"](time_s[:1], time_s[:1])["reason"]
