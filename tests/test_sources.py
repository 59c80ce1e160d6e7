"""Sources that step: exact instants, first values, and no drift over many periods."""

import math

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

import hybrid
from hybrid.compiler import compile_patch
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch
from hybrid.runs import run
from hybrid.timeline import Happening, build_timeline

EPS = np.finfo(float).eps


def patch(*components, run="until: 2 s, every: 0.1 s", machine="ideal", rest=""):
    lines = "\n".join(f"  {line}" for line in components)
    return f"title: Test\nmachine: {machine}\nanalog:\n{lines}\n{rest}run: {{{run}}}\n"


@pytest.fixture(params=[False, True], ids=["exact", "circuit"])
def columns(request):
    """Play a patch on either engine; time in s and columns by name."""

    def played(text):
        machine = compile_patch(parse_patch(text), as_circuit=request.param)
        assert bool(machine.elements) == request.param
        result = run(machine)
        every = machine.timing.every * 1e-15
        found = {pen.name: result.rows[:, i] for i, pen in enumerate(result.pens)}
        return np.arange(len(result.rows)) * every, found

    return played


@pytest.mark.parametrize("until_s", [None, 1.55])
@pytest.mark.parametrize("at_s", [0.0, 0.3, 0.7512345])
def test_ramp(at_s, until_s, columns):
    until = "" if until_s is None else f"until: {until_s} s, "
    t, found = columns(
        patch(
            f"r: {{ramp: 0.8 V/s, at: {at_s} s, {until}before: -0.5 V, full_scale: 2 V}}",
            "area: {integrate: {r: 1 1/s}, initial: 0 V, full_scale: 2 V}",
        )
    )
    end = math.inf if until_s is None else until_s
    # The integral of clip(s, 0, length) from 0 to s: s^2 / 2, then length s - length^2 / 2.
    up = np.clip(t - at_s, 0, end - at_s)
    np.testing.assert_allclose(found["r"], -0.5 + 0.8 * up, rtol=0, atol=4e-15)
    area = up**2 / 2 + up * np.maximum(t - end, 0)
    np.testing.assert_allclose(found["area"], -0.5 * t + 0.8 * area, rtol=0, atol=4e-15)


def test_ramp_behind_a_lag_and_with_the_errors_of_its_stage(columns):
    t, found = columns(
        patch("r: {ramp: 1, at: 0.5 s, before: 0.5, full_scale: 2, tau: 0.2 s, offset: 0.01}")
    )
    s = np.maximum(t - 0.5, 0)  # a ramp through a lag: s - tau (1 - exp(-s / tau))
    np.testing.assert_allclose(found["r"], 0.52 + s + 0.2 * np.expm1(-s / 0.2), rtol=0, atol=2e-12)


def test_a_ramp_is_no_mode_of_the_patch():
    loop = (
        "v: {integrate: {x: -9, v: -0.6, push: 1}, initial: 0, full_scale: 3}",
        "x: {integrate: {v: 1}, initial: 0.1, full_scale: 1}",
    )
    sources = (
        "ramp: 0.1",
        "pulse: 0.1, at: 1 s, width: 10 ms, period: 0.1 s",
        "square: 0.1, period: 1 s",
    )
    for source in sources:
        found = hybrid.predict(parse_patch(patch(*loop, f"push: {{{source}, full_scale: 1}}")))
        (mode,) = found.modes
        # s^2 + 0.6 s + 9.
        assert (mode.omega, mode.zeta) == pytest.approx((3.0, 0.1), rel=1e-13)


@pytest.mark.parametrize("period", ["", "period: 0.5 s, "])
def test_pulse(period, columns):
    t, found = columns(
        patch(
            f"p: {{pulse: 1.5, at: 0.2 s, width: 0.12 s, {period}before: -0.25, full_scale: 2}}",
            "area: {integrate: {p: 1}, initial: 0, full_scale: 2}",
        )
    )
    begins = 0.2 + 0.5 * np.arange(4 if period else 1)
    inside = np.zeros(len(t))
    on = np.zeros(len(t), dtype=bool)
    for begin in begins:
        inside += np.clip(t - begin, 0, 0.12)
        on |= (np.round(t, 9) >= round(begin, 9)) & (t < begin + 0.12 - 1e-9)
    assert found["p"].tolist() == np.where(on, 1.5, -0.25).tolist()
    np.testing.assert_allclose(found["area"], 1.75 * inside - 0.25 * t, rtol=0, atol=4e-15)


CLOCK = """
interface: {seen: {adc: p}}
digital: {period: 0.1 s, program: {w: seen}}
"""


def test_a_sample_at_the_instant_of_an_edge_sees_the_value_before(columns):
    text = patch(
        "p: {pulse: 1, at: 0.2 s, width: 0.1 s, period: 0.5 s, full_scale: 2}", rest=CLOCK[1:]
    )
    t, found = columns(text)
    tenths = np.arange(len(t)) % 5
    assert found["p"].tolist() == (tenths == 2).astype(float).tolist()  # the row shows x+
    assert found["seen"].tolist() == (tenths == 3).astype(float).tolist()  # the sample saw x-


@pytest.mark.parametrize("degrees", [0, 30, 90, 180, 200, 270, 359, -45, 400])
def test_square_has_the_sign_of_the_sine(degrees, columns):
    text = patch(
        f"q: {{square: 2, period: 0.7 s, phase: {degrees} deg, bias: 0.5, full_scale: 4}}",
        f"s: {{sine: 1, frequency: {1 / 0.7} Hz, phase: {degrees} deg, full_scale: 1}}",
        run="until: 2.003 s, every: 1 ms",
    )
    _, found = columns(text)
    clear = np.abs(found["s"]) > 1e-9  # at an edge itself it shows the value after
    assert np.sum(~clear) <= 6
    np.testing.assert_array_equal(found["q"][clear], 0.5 + 2 * np.sign(found["s"][clear]))
    assert found["q"][0] == (-1.5 if 180 <= degrees % 360 < 360 else 2.5)


def test_waves_do_not_drift_over_1e5_periods():
    text = patch(
        "q: {square: 1, period: 1 ms, full_scale: 1}",
        "p: {pulse: 1, at: 0.2 ms, width: 0.3 ms, period: 1 ms, full_scale: 1}",
        "triangle: {integrate: {q: 4000}, initial: -1, full_scale: 1}",
        "net: {integrate: {p: 1000}, initial: 0, leak: 0 1/s, full_scale: 100000}",
        run="until: 100 s, every: 0.25 ms",
    )
    result = run(compile_patch(parse_patch(text)))
    found = {pen.name: result.rows[:, i] for i, pen in enumerate(result.pens)}
    k = np.arange(len(result.rows))
    assert np.array_equal(found["q"], np.where(k % 4 < 2, 1.0, -1.0))
    assert np.array_equal(found["p"], np.where(k % 4 == 1, 1.0, 0.0))
    # One rounding of half an ulp of 1 in each of seven intervals of a period, all the same way.
    expected = np.array([-1.0, 0.0, 1.0, 0.0])[k % 4]
    assert np.max(np.abs(found["triangle"] - expected)) < 1e5 * 7 * EPS / 2
    assert found["net"][-1] == pytest.approx(0.3 * 1e5, abs=1e5 * 7 * EPS / 2 * 1e5)


def test_edges_of_a_wave_are_whole_multiples_of_its_period():
    text = patch(
        "q: {square: 1, period: 0.3 ms, phase: 1 rad, full_scale: 1}",
        "p: {pulse: 1, at: 7.3 ms, width: 0.04 ms, period: 0.8 ms, full_scale: 1}",
        "r: {ramp: 1, at: 3.3 ms, until: 51 ms, full_scale: 1}",
        run="until: 60.05 ms, every: 0.2 ms",
    )
    machine = compile_patch(parse_patch(text))
    timeline = build_timeline(machine)
    assert any(segment.repeats > 1 for segment in timeline.segments)  # some of it is tiled
    found = sorted((t, i) for t, kind, i in timeline if kind == Happening.SOURCE)
    expected = []
    for i, step in enumerate(machine.steps):
        tick = step.at_ticks
        while tick <= timeline.until:
            expected.append((tick, i))
            tick += step.every_ticks or timeline.until
    assert found == sorted(expected)
    rows = [t for t, kind, _ in timeline if kind == Happening.RECORD]
    assert rows == [k * machine.timing.every for k in range(timeline.rows)]


def test_a_wave_that_never_falls_in_with_the_clock(columns):
    period = 1e-3 * math.pi
    t, found = columns(
        patch(
            f"q: {{square: 1, period: {period!r} s, full_scale: 1}}",
            run="until: 0.3 s, every: 1 ms",
        )
    )
    expected = np.where(np.floor(2 * t / period) % 2 == 0, 1.0, -1.0)
    assert np.array_equal(found["q"], expected)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("ramp: 1, at: 2 s, until: 1 s", "'x' has at 2 s not before until 1 s"),
        ("ramp: 1, at: 1 s, until: 1 s", "'x' has at 1 s not before until 1 s"),
        ("pulse: 1, at: 0 s, width: 2 s, period: 1 s", "has width 2 s, not below its period 1 s"),
        ("pulse: 1, at: 1 s, width: 1e-17 s", "has width 1e-17 s, below the resolution of time"),
        ("square: 1, period: 1e-17 s", "has period 1e-17 s, below the resolution of time"),
        ("sawtooth: 1, period: 1e-17 s", "has period 1e-17 s, below the resolution of time"),
        ("square: 1, period: 1e-12 s", r"'x' has a period of 1e-12 s, \S+ of them in \S+ s"),
        ("ramp: 1 V", "must be a rate"),
        ("pulse: 1 V, at: 0 s, width: 1 s", "pulse of component 'x' is '1 V'"),
        ("pulse: 1, at: -1 s, width: 1 s", "must be 0 or greater"),
        ("pulse: 1, at: 1 s", "give either width, such as 10 ms, or duty"),
        ("pulse: 1, at: 1 s, width: 1 s, duty: 0.5", "give either width, such as 10 ms, or duty"),
        ("pulse: 1, at: 1 s, duty: 0.5", "duty is a share of its period; give period"),
        ("pulse: 1, at: 1 s, duty: 1, period: 1 s", "has duty 1, which is not below 1"),
        ("square: 1, period: 1 s, duty: 120 %", "has duty 1.2, which is not below 1"),
        ("square: 1, period: 1 s, duty: 1e-17", "below the resolution of time"),
        ("square: 1, period: 1 s, duty: 1 ms", "duty of component 'x' is '1 ms'"),
        ("square: 1, period: 0 s", "must be greater than 0"),
        ("sawtooth: 1", "has no period; add period:"),
        ("ramp: 1e30", "a gain or rate of 1e[+]30"),
    ],
)
def test_wrong_figures_are_told(wrong, told):
    with pytest.raises(PatchError, match=told):
        build_timeline(compile_patch(parse_patch(patch(f"x: {{{wrong}, full_scale: 1}}"))))


@pytest.mark.parametrize("duty", [0.3, 0.72])
@pytest.mark.parametrize("turn", [0.0, 0.25, 0.5, -0.1])
def test_duty_of_a_square_wave(duty, turn, columns):
    """Plus from where its phase is a whole number of turns, for `duty` of the period; exact areas."""
    t, found = columns(
        patch(
            f"q: {{square: 2, period: 0.4 s, phase: {360 * turn} deg, duty: {duty}, bias: 0.5,"
            " full_scale: 3}",
            "area: {integrate: {q: 1}, initial: 0, full_scale: 2}",
            run="until: 2 s, every: 0.03 s",
        )
    )
    first = round(1000 * turn) % 1000
    at = 75 * np.arange(len(t)) + first  # thousandths of a period
    assert np.array_equal(found["q"], np.where(at % 1000 < 1000 * duty, 2.5, -1.5))
    plus = at // 1000 * duty + np.minimum(at % 1000 / 1000, duty) - min(first / 1000, duty)
    np.testing.assert_allclose(found["area"], 0.4 * 4 * plus - 1.5 * t, rtol=0, atol=1e-14)


def test_duty_of_a_pulse_is_its_width(columns):
    given = "period: 0.35 s, before: -1, full_scale: 2"
    _, found = columns(
        patch(
            f"p: {{pulse: 2, at: 0.1 s, duty: 20 %, {given}}}",
            f"q: {{pulse: 2, at: 0.1 s, width: 70 ms, {given}}}",
            "a: {integrate: {p: 1}, initial: 0, full_scale: 2}",
            "b: {integrate: {q: 1}, initial: 0, full_scale: 2}",
        )
    )
    assert np.array_equal(found["p"], found["q"])
    np.testing.assert_allclose(found["a"], found["b"], rtol=0, atol=4e-15)
    assert set(found["p"]) == {-1.0, 2.0}


def sawtooth_at(t, period):
    return 2 * (t / period % 1.0) - 1


def test_sawtooth():
    text = patch(
        "w: {sawtooth: 3, period: 0.4 s, bias: 0.5, full_scale: 4}",
        run="until: 2 s, every: 0.05 s",
        rest="interface: {seen: {adc: w}}\ndigital: {period: 0.05 s, program: {z: seen}}\n",
    )
    result = run(compile_patch(parse_patch(text)))
    found = {pen.name: result.rows[:, i] for i, pen in enumerate(result.pens)}
    k = np.arange(len(result.rows))
    np.testing.assert_allclose(found["w"], 0.5 + 3 * (k % 8 / 4 - 1), rtol=0, atol=1e-13)
    before = np.where((k % 8 == 0) & (k > 0), 3.5, found["w"])  # at the edge: the top
    np.testing.assert_allclose(found["seen"], before, rtol=0, atol=1e-13)


@pytest.mark.parametrize("turn", [0.25, 0.5, -0.1])
def test_phase_of_a_sawtooth(turn):
    text = patch(
        f"w: {{sawtooth: 3, period: 0.4 s, phase: {360 * turn} deg, bias: 0.5, full_scale: 4}}",
        run="until: 2 s, every: 0.03 s",
    )
    result = run(compile_patch(parse_patch(text)))
    at = 75 * np.arange(len(result.rows)) + round(1000 * turn)  # thousandths of a period
    expected = 0.5 + 3 * sawtooth_at(at % 1000 / 1000, 1.0)
    np.testing.assert_allclose(result.rows[:, 0], expected, rtol=0, atol=1e-13)


def test_sawtooth_does_not_drift_over_1e5_periods():
    text = patch(
        "w: {sawtooth: 1, period: 1 ms, full_scale: 1}",
        run="until: 100.0003 s, every: 0.25 ms, max_rows: 1000",
    )
    result = run(compile_patch(parse_patch(text)))
    k = np.arange(len(result.rows)) * 401  # every n-th of 400002 rows
    assert len(result.rows) == -(-400002 // 401)
    # Two intervals of the triangle round by half an ulp of 1 in each quarter of a period.
    expected = k % 4 / 2 - 1
    assert np.max(np.abs(result.rows[:, 0] - expected)) < 4 * 2 * 1e5 * EPS / 2


@pytest.mark.parametrize("tau", ["0 s", "1 us", "20 us"])
def test_a_wave_controls_at_its_edges_whatever_its_lag(tau):
    text = patch(
        "gate: {pulse: 2, at: 1 ms, width: 1 ms, period: 4 ms, before: -2, full_scale: 2, tau: TAU}",
        "clock: {square: 1, period: 4 ms, bias: 1, full_scale: 2, tau: TAU}",  # 2, 2, 0, 0
        "x: {integrate: {one: 100}, initial: 0, full_scale: 1}",
        "one: {constant: 1, full_scale: 1}",
        "zero: {constant: 0, full_scale: 1}",
        "held: {track: x, control: gate, initial: -1, full_scale: 1}",
        "part: {switch: [one, zero], control: clock, full_scale: 1}",
        "area: {integrate: {part: 100}, initial: 0, full_scale: 1}",
        run="until: 8 ms, every: 0.5 ms",
    ).replace("TAU", tau)
    result = run(compile_patch(parse_patch(text)))
    found = {pen.name: result.rows[:, i] for i, pen in enumerate(result.pens)}
    held = [-1, -1, 0.1, 0.15] + [0.2] * 6 + [0.5, 0.55] + [0.6] * 5
    np.testing.assert_allclose(found["held"], held, rtol=0, atol=1e-12)
    k = np.arange(17)
    area = np.minimum(k % 8, 4) * 0.05 + k // 8 * 0.2
    np.testing.assert_allclose(found["area"], area, rtol=0, atol=1e-12)


# --- noise ---------------------------------------------------------------------------------------

SIGMAS = 4.5  # one false alarm in 150,000
NOISE = (
    "n: {noise_source: 3 V, bandwidth: 50 rad/s, full_scale: 10 V}",
    "y: {lag: {n: 1}, time_constant: 0.1 s, full_scale: 10 V}",
)


def test_noise_source_has_its_rms_and_its_spectrum(play):
    """A first-order Gauss process: exp(-bandwidth * interval) between rows, rms 3; behind a lag T its
    variance is divided by 1 + bandwidth T."""
    played = play(patch(*NOISE, run="until: 8000 s, every: 20 ms"), seed=3)
    n, y = played["n"][1000:], played["y"][1000:]
    rho, rows = math.exp(-50 * 0.02), len(n)
    power = np.mean(n**2)
    spread = math.sqrt(2 * (1 + rho**2) / (1 - rho**2) / rows)
    assert power == pytest.approx(9, rel=SIGMAS * spread)
    for lag in (1, 2, 3):  # Bartlett's formula
        own = rho ** (2 * lag)
        variance = ((1 + rho**2) * (1 - own) / (1 - rho**2) - 2 * lag * own) / rows
        found = np.mean(n[lag:] * n[:-lag]) / power
        assert found == pytest.approx(rho**lag, abs=SIGMAS * math.sqrt(variance))
    # The autocorrelation of y is that of two real poles, 10 and 50 rad/s.
    t = np.arange(-200, 201) * 0.02
    shape = (50 * np.exp(-10 * np.abs(t)) - 10 * np.exp(-50 * np.abs(t))) / 40
    spread = math.sqrt(2 * np.sum(shape**2) / rows)
    assert np.mean(y**2) == pytest.approx(9 / (1 + 50 * 0.1), rel=SIGMAS * spread)


def test_covariances_of_the_noise_source_are_exact():
    """Lyapunov's equation of n and y, from the machine's matrices: no sampling error."""
    for tau in ("0 s", "1 ms"):
        machine = compile_patch(
            parse_patch(patch(*NOISE, machine=f"{{preset: ideal, tau: {tau}}}"))
        )
        analog = machine.analog
        p = solve_continuous_lyapunov(analog.a, -analog.noise @ analog.noise.T)
        states = list(analog.states)
        core = states.index("n:core" if "n:core" in states else "n")
        held = states.index("y:core" if "y:core" in states else "y")
        assert p[core, core] == pytest.approx(0.09, rel=1e-12)
        filters = 1 / (1 + 50 * 0.1) if tau == "0 s" else None
        if filters:
            assert p[held, held] == pytest.approx(0.09 * filters, rel=1e-12)
        else:  # its own lag of 1 ms comes first: |1/(1+s/50)|^2 |1/(1+s T)|^2 |1/(1+s tau)|^2
            out = states.index("n")
            assert p[out, out] == pytest.approx(0.09 / (1 + 50 * 1e-3), rel=1e-12)


def test_noise_source_is_the_seeds_and_starts_at_zero(play):
    text = patch(*NOISE)
    one, again, other = (play(text, seed=seed)["n"] for seed in (1, 1, 2))
    assert np.array_equal(one, again) and not np.array_equal(one[1:], other[1:])
    assert one[0] == 0.0


def test_noise_source_is_no_mode_and_told_where_it_is_left_out():
    loop = (
        "v: {integrate: {x: -9, v: -0.6, n: 1}, initial: 0, full_scale: 3}",
        "x: {integrate: {v: 1}, initial: 0.1, full_scale: 1}",
        "n: {noise_source: 0.1, bandwidth: 5 rad/s, full_scale: 1}",
    )
    (mode,) = hybrid.predict(parse_patch(patch(*loop))).modes
    assert (mode.omega, mode.zeta) == pytest.approx((3.0, 0.1), rel=1e-13)
    told = run(parse_patch(patch(*loop)), engine="reference").status_note
    assert "the reference engine plays none (n)" in told
    assert run(compile_patch(parse_patch(patch(*loop)), as_circuit=True)).status_note == ""


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("noise_source: 1", "has no bandwidth; add bandwidth:"),
        ("noise_source: -1, bandwidth: 1 rad/s", "must be 0 or greater"),
        ("noise_source: 1, bandwidth: 1 kHz", "bandwidth is given in '1 kHz'; use rad/s"),
        ("noise_source: 1, bandwidth: 0 rad/s", "must be greater than 0"),
        ("noise_source: 1e30, bandwidth: 1 rad/s", r"gain or rate of 1e\+30"),
    ],
)
def test_wrong_noise_is_told(wrong, told):
    with pytest.raises(PatchError, match=told):
        compile_patch(parse_patch(patch(f"x: {{{wrong}, full_scale: 1}}")))


def test_a_common_multiple_that_is_too_long_is_not_needed():
    """2.46913 s and 0.1 ms meet every 24.6913 s, 246,913 rows; 648 edges are laid out one by one."""
    text = patch(
        "q: {square: 1, period: 2.46913 s, full_scale: 1}", run="until: 800 s, every: 0.1 ms"
    )
    timeline = build_timeline(compile_patch(parse_patch(text)))
    found, begin = [], 0
    for segment in timeline.segments:
        found += [
            begin + offset for offset, kind, _ in segment.events if kind == Happening.SOURCE
        ] * segment.repeats
        begin += segment.length * segment.repeats
    assert found == [k * 1234565 * 10**9 for k in range(1, 649)]
    assert begin == timeline.until
