"""Exact modes against closed roots, hand-written cycle maps and the engine's own records."""

import math

import numpy as np
import pytest
from loops import I_YY, pitch_matrix, two_loops

from hybrid import theory
from hybrid.checks import check
from hybrid.coupling import exact_modes, ideal_modes, modes
from hybrid.cycle_map import cycle_maps
from hybrid.errors import RunError
from hybrid.largest_cycle import STEP, largest_cycle_s
from hybrid.linearity import NotLinear, linear_program
from hybrid.patchfile import parse_patch
from hybrid.prediction import closed_form_case, predict
from hybrid.together import only

EPS = np.finfo(float).eps
OMEGA_P = 10.0
NAMES = {0.0: "pitch_loop", 1.5: "pitch_loop_lead"}


def nearest(found, wanted):
    return found[np.argmin(np.abs(found - wanted))]


def damping(s):
    return -s.real / abs(s)


def log_of_roots(coefficients, period_s):
    """Modes s of a characteristic polynomial in z."""
    roots = np.roots(coefficients).astype(complex)
    return np.log(roots[np.abs(roots) > 1e-9]) / period_s


# --- closed roots --------------------------------------------------------------------------------


@pytest.mark.parametrize("lead", NAMES)
@pytest.mark.parametrize("cycles", [0, 1, 2, 3])
@pytest.mark.parametrize("w", [1e-4, 1e-3, 1e-2, 0.1, 0.5])
def test_pitch_loop_has_the_exact_root(w, cycles, lead, shipped, compiled):
    period_s = w / OMEGA_P
    parameters = {"cycle": period_s, "compute_time": cycles * period_s}
    found = exact_modes(compiled(shipped(NAMES[lead]), parameters))
    mode = theory.exact_lead(OMEGA_P, period_s, lead, compute_cycles=cycles)
    s = nearest(found, complex(-mode.zeta * mode.omega, mode.omega_damped))
    # The map is kept as a difference from the identity, of entries near W: hence epsilon times W,
    # where the eigenvalues of the plain map would be good to epsilon / W.
    assert damping(s) == pytest.approx(mode.zeta, rel=0, abs=8 * EPS * w)
    assert abs(s) == pytest.approx(mode.omega, rel=8 * EPS, abs=0)
    assert abs(s.imag) == pytest.approx(mode.omega_damped, rel=8 * EPS, abs=0)


@pytest.mark.parametrize("lead", NAMES)
@pytest.mark.parametrize("cycles", [0, 1, 2, 3, 7])
@pytest.mark.parametrize("w", [1e-3, 1e-2, 0.1, 0.5])
def test_pitch_loop_has_every_root_and_no_other(w, cycles, lead, shipped, compiled):
    # z^c (z-1)^2 + W^2 [(z+1)/2 + lead (z-1)] = 0, the polynomial of `theory.exact_lead`.
    period_s = w / OMEGA_P
    machine = compiled(shipped(NAMES[lead]), {"cycle": period_s, "compute_time": cycles * period_s})
    coefficients = np.concatenate([[1.0, -2.0, 1.0], np.zeros(cycles)])
    coefficients[-2:] += w**2 * np.array([0.5 + lead, 0.5 - lead])
    found = np.exp(period_s * exact_modes(machine))
    assert len(found) == cycles + 2
    # Each is a root: the polynomial there is small beside its terms.
    terms = np.abs(coefficients) @ np.abs(found)[None, :] ** np.arange(cycles + 2, -1, -1)[:, None]
    assert np.all(np.abs(np.polyval(coefficients, found)) < 1e-9 * terms)
    assert np.abs(np.prod(found)) == pytest.approx(
        abs(coefficients[-1] / coefficients[0]), rel=1e-9
    )


@pytest.mark.parametrize("w", [1e-2, 0.1, 0.5])
@pytest.mark.parametrize("cycles", [0, 1, 2, 3, 7])
def test_lags_add_at_most_one_mode_to_a_slow_cycle(w, cycles, shipped, compiled):
    # After 1000 lags of 1 us or more all that they still know is what was held: one figure.
    period_s = w / OMEGA_P
    parameters = {"cycle": period_s, "compute_time": cycles * period_s}
    ideal = np.exp(period_s * exact_modes(compiled(shipped("pitch_loop"), parameters)))
    lagged = np.exp(period_s * exact_modes(compiled(shipped("pitch_loop"), parameters, "lags")))
    assert len(ideal) <= len(lagged) <= len(ideal) + 1
    for z in ideal[np.abs(ideal) > 0.01]:
        assert abs(nearest(lagged, z) - z) < 5e-2 * abs(z)


def test_figures_of_the_paper(shipped, compiled):
    mode = modes(compiled(shipped("pitch_loop")))[0]
    assert mode.zeta == pytest.approx(-0.00749925, abs=2e-10)
    assert mode.omega == pytest.approx(9.99941678, abs=5e-9)
    assert (mode.omega_ideal, mode.zeta_ideal) == (pytest.approx(10, rel=1e-15), 0.0)
    assert mode.s == pytest.approx(complex(-mode.zeta * mode.omega, mode.omega_damped))


@pytest.mark.parametrize(
    ("omega_p", "tau_s"), [(10.0, 1e-6), (2000.0, 2e-6), (10.0, 1e-3), (1.0, 0.1)]
)
def test_all_analog_loop_has_the_exact_root(omega_p, tau_s, shipped, compiled):
    machine = compiled(shipped("pitch_loop_analog"), {"omega_p": omega_p, "tau": tau_s})
    found = exact_modes(machine)
    mode = theory.exact_all_analog(omega_p, [tau_s] * 5)
    s = nearest(found, complex(-mode.zeta * mode.omega, mode.omega_damped))
    # s = 10 beside lags of 1e6: the polish leaves epsilon of the mode's own size.
    assert damping(s) == pytest.approx(mode.zeta, rel=0, abs=4 * EPS)
    assert abs(s) == pytest.approx(mode.omega, rel=8 * EPS)
    assert len(found) == 7


def test_lags_add_to_the_damping_error_one_by_one(shipped, compiled):
    # Different lags at different places: only their values count, in s^2 prod(1 + tau s) + w^2.
    text = shipped("pitch_loop_analog")
    for number, name in enumerate(("M_a", "theta_ddot", "theta_dot", "theta", "alpha")):
        line = next(line for line in text.split("\n") if f"  {name}:" in line)
        start = text.index(line)
        text = text[:start] + text[start:].replace("tau: tau", f"tau: {number}*tau", 1)
    found = exact_modes(compiled(text, {"tau": 1e-4}))
    mode = theory.exact_all_analog(10.0, [1e-4, 2e-4, 3e-4, 4e-4])
    s = nearest(found, complex(-mode.zeta * mode.omega, mode.omega_damped))
    assert damping(s) == pytest.approx(mode.zeta, abs=4 * EPS)


# --- hand-written cycle maps ---------------------------------------------------------------------


def step_map(a, b, interval_s, exact_change):
    """x(h) = E x + g u."""
    block = np.zeros((len(a) + 1, len(a) + 1))
    block[:-1, :-1], block[:-1, -1] = a, b
    change = exact_change(block * interval_s)[:-1]
    return np.eye(len(a)) + change[:, :-1], change[:, -1]


def slow_mode(cycle, period_s, scale):
    """The oscillating mode nearest z = 1; `scale` makes the entries of the state alike in size."""
    z = np.linalg.eigvals(cycle * scale[None, :] / scale[:, None])
    s = np.log(z[np.abs(z) > 1e-6].astype(complex)) / period_s
    return nearest(s, 1j * OMEGA_P)


def test_five_lags_against_a_map_by_hand(shipped, compiled, exact_change):
    period_s, tau_s = 1e-3, 1e-6
    transfer, drive = step_map(*pitch_matrix(tau_s), period_s, exact_change)
    # State [x, M_a held] just after nT: the sample of alpha at nT is held from (n+1)T on.
    cycle = np.zeros((8, 8))
    cycle[:7, :7], cycle[:7, 7] = transfer, drive
    cycle[7, 6] = -I_YY * OMEGA_P**2
    expected = slow_mode(cycle, period_s, np.array([1e5, 100, 10, 10, 1, 1, 1, 1e5]))
    found = nearest(exact_modes(compiled(shipped("pitch_loop"), preset="lags")), expected)
    assert damping(found) == pytest.approx(damping(expected), rel=0, abs=1e-12)
    assert found.imag == pytest.approx(expected.imag, rel=1e-12)
    # Five lags of 1 us add omega_p * 5 us / 2 = 2.5e-5 to the growth, to first order.
    ideal = theory.exact_uncompensated(OMEGA_P, period_s)
    assert damping(found) - ideal.zeta == pytest.approx(-2.5e-5, rel=2e-3)
    assert abs(damping(found) - ideal.zeta + 2.5e-5) > 1e-9  # and what is left is resolved


def test_skew_conversion_and_part_of_a_cycle_against_a_map_by_hand(shipped, compiled, exact_change):
    # Sampled at 0.3 T, converted in 0.1 T, computed in 0.4 T: the answer is shown at 0.8 T.
    text = shipped(
        "pitch_loop",
        ("{adc: alpha,", "{adc: alpha, channel: 3, conversion_time: 0.1*cycle,"),
        ("  period: cycle", "  period: cycle\n  skew: 0.1*cycle"),
    )
    period_s = 0.02
    machine = compiled(text, {"cycle": period_s, "compute_time": 0.4 * period_s})
    a, b = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([1 / I_YY, 0.0])
    x, u, word = np.eye(2, 4), np.eye(4)[2], np.eye(4)[3]  # forms over [theta_dot, theta, M_a, -]
    for share, event in ((0.3, "sample"), (0.5, "latch"), (0.2, "")):
        transfer, drive = step_map(a, b, share * period_s, exact_change)
        x = transfer @ x + np.outer(drive, u)
        if event == "sample":
            word = x[1]
        elif event == "latch":
            u = -I_YY * OMEGA_P**2 * word
    cycle = np.array([*x, u])[:, :3]
    expected = slow_mode(cycle, period_s, np.array([10.0, 1.0, 1e5]))
    found = nearest(exact_modes(machine), expected)
    assert found == pytest.approx(expected, rel=1e-13)
    # All delays add: the sample waits 0.5 T to be shown, then T/2 in the hold.
    assert damping(found) == pytest.approx(-0.5 * 0.2 * (0.5 + 0.5), rel=0.02)


FILTERED = (
    ("program:\n", "remember: {smooth: 0}\n  program:\n    smooth: SMOOTH\n"),
    ("omega_p**2 * alpha_sample", "omega_p**2 * smooth"),
)


def with_memory(shipped, expression):
    changes = [(old, new.replace("SMOOTH", expression)) for old, new in FILTERED]
    return shipped("pitch_loop", *changes)


@pytest.mark.parametrize(
    ("expression", "keep", "take"),
    [
        ("previous(smooth) + 0.25*(alpha_sample - previous(smooth))", 0.75, 0.25),
        ("0.9*alpha_sample - 0.1*previous(smooth)", -0.1, 0.9),
        ("previous(smooth) + 0.4*alpha_sample", 1.0, 0.4),  # an integrator
    ],
)
def test_program_with_memory_against_a_map_by_hand(
    expression, keep, take, shipped, compiled, exact_change
):
    period_s = 0.01
    machine = compiled(with_memory(shipped, expression), {"cycle": period_s})
    a, b = np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([1 / I_YY, 0.0])
    transfer, drive = step_map(a, b, period_s, exact_change)
    # [theta_dot, theta, M_a, smooth of the cycle before] just after nT.
    cycle = np.zeros((4, 4))
    cycle[:2, :2], cycle[:2, 2] = transfer, drive
    cycle[3, 1], cycle[3, 3] = take, keep
    cycle[2] = -I_YY * OMEGA_P**2 * cycle[3]
    scale = np.array([10.0, 1.0, 1e5, 1.0])
    expected = np.linalg.eigvals(cycle * scale[None, :] / scale[:, None])
    expected = expected[np.abs(expected) > 1e-9]  # 0: M_a repeats what smooth says
    found = np.exp(period_s * exact_modes(machine))
    np.testing.assert_allclose(
        np.sort_complex(found), np.sort_complex(expected), rtol=0, atol=1e-12
    )


def test_filter_in_the_program_counts_as_a_delay_of_the_ideal_loop(shipped, compiled):
    # A gain of 1 for what stays: the ideal loop is the pitch loop, the filter's lag a coupling error.
    text = with_memory(shipped, "previous(smooth) + 0.25*(alpha_sample - previous(smooth))")
    mode = next(m for m in modes(compiled(text)) if m.omega_ideal > 0)
    assert (mode.omega_ideal, mode.zeta_ideal) == (pytest.approx(10.0, rel=1e-14), 0.0)
    # It delays by 0.75/0.25 = 3 cycles beside the 1.5 of the loop: zeta = -W/2 * 4.5.
    assert mode.zeta == pytest.approx(-0.0225, rel=0.01)


def test_program_that_integrates_has_modes_but_no_ideal(shipped, compiled):
    text = with_memory(shipped, "previous(smooth) + 0.4*alpha_sample")
    machine = compiled(text, {"cycle": 0.01})
    with pytest.raises(NotLinear, match="integrates, so it has no steady answer"):
        ideal_modes(machine.patch, machine.overrides)
    found = modes(machine)
    assert len(found) == sum(s.imag >= 0 for s in exact_modes(machine))
    assert all(math.isnan(m.omega_ideal) and math.isnan(m.zeta_ideal) for m in found)
    assert closed_form_case(machine) is None


# --- the engine's own records --------------------------------------------------------------------


def test_modes_are_those_of_the_map_that_the_engine_plays(shipped, play, compiled):
    # One cycle from each unit state [theta_dot, theta, M_a held] gives a column of the map.
    scale, columns = np.array([10.0, 1.0, 1e5]), []
    for unit in np.eye(3):
        rate, angle, moment = (0.5 * unit * scale).tolist()
        text = shipped(
            "pitch_loop",
            ("initial: 0 rad/s", f"initial: {rate} rad/s"),
            ("initial: 0.1 rad", f"initial: {angle} rad"),
            ("initial: 0 N*m", f"initial: {moment} N*m"),
            ("until: 10 s", "until: cycle"),
        )
        played = play(text, {"cycle": 0.02})
        ends = [played[name][1] for name in ("theta_dot", "theta", "M_a")]
        columns.append(np.array(ends) / scale / 0.5)
    z = np.linalg.eigvals(np.array(columns).T).astype(complex)
    found = np.exp(0.02 * exact_modes(compiled(shipped("pitch_loop"), {"cycle": 0.02})))
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(z), rtol=0, atol=1e-14)


@pytest.mark.parametrize("cycles", [0, 0.4, 1, 2.5, 4])
@pytest.mark.parametrize("tau_s", [0.0, 1e-6, 2e-3])
def test_records_are_sums_of_the_predicted_modes(tau_s, cycles, play):
    played = play(two_loops("20 ms", "until: 4.2 s"), {"tau": tau_s, "compute_time": 0.02 * cycles})
    z = np.exp(0.02 * exact_modes(played.machine))
    # The first results come after a few cycles; from then on every row is one cycle of the map.
    rows = slice(8, 208)
    powers = z[None, :] ** np.arange(200)[:, None]
    for name in ("a", "b", "va", "vb", "mix", "s_a", "fb"):
        signal = played[name][rows].astype(complex)
        amplitudes = np.linalg.lstsq(powers, signal, rcond=None)[0]
        misfit = np.max(np.abs(powers @ amplitudes - signal))
        # A mode wrong by 1e-12 would miss the last of 200 rows by 2e-10.
        assert misfit < 1e-12 * np.max(np.abs(signal)), name
    moved = z[np.argmax(np.abs(z))]
    off = np.where(z == moved, z * (1 + 1e-9), z)[None, :] ** np.arange(200)[:, None]
    signal = played["a"][rows].astype(complex)
    wrong = off @ np.linalg.lstsq(off, signal, rcond=None)[0]
    assert np.max(np.abs(wrong - signal)) > 1e-10 * np.max(np.abs(signal))


def test_map_follows_the_cycle_whatever_is_recorded(shipped, compiled):
    one = compiled(shipped("pitch_loop"))
    other = compiled(shipped("pitch_loop", ("until: 10 s", "until: 1 s, every: 0.35 ms")))
    assert np.array_equal(exact_modes(one), exact_modes(other))
    assert only(cycle_maps([one]))[1] == 10**12


def test_quantisation_noise_and_sources_move_no_mode(shipped, compiled):
    lags = compiled(shipped("pitch_loop"), preset="lags")
    changes = (
        ("machine: ideal", "machine: {preset: nominal, tolerance: 0}"),
        ("gamma: {constant: 0 rad,", "gamma: {sine: 0.1 rad, omega: 3 rad/s,"),
        ("M_c: {constant: 0 N*m,", "M_c: {step: 1 N*m, at: 3 ms, tau: 0 s, noise: 0,"),
    )
    nominal = compiled(shipped("pitch_loop", *changes))
    found = exact_modes(nominal)
    for s in exact_modes(lags):
        if abs(s) < 20:
            assert abs(nearest(found, s) - s) < 1e-13 * abs(s)


# --- gain errors ---------------------------------------------------------------------------------


@pytest.mark.parametrize("serial", [1, 2, 9])
def test_gain_errors_scale_the_loop(serial, shipped, compiled):
    machine = compiled(
        shipped("pitch_loop", ("machine: ideal", "machine: {preset: ideal, tolerance: 0.01}")),
        serial=serial,
    )
    names = ("M_a", "theta_ddot", "theta_dot", "theta", "alpha")
    loop = math.prod(machine.stages[name].gain for name in names)
    assert loop != 1.0
    mode = theory.exact_uncompensated(OMEGA_P * math.sqrt(loop), 1e-3)
    s = nearest(exact_modes(machine), complex(-mode.zeta * mode.omega, mode.omega_damped))
    assert damping(s) == pytest.approx(mode.zeta, rel=1e-13)
    assert abs(s) == pytest.approx(mode.omega, rel=1e-14)
    assert modes(machine)[0].omega_ideal == pytest.approx(10.0, rel=1e-15)


# --- pairing -------------------------------------------------------------------------------------

DECOUPLED = """
title: Two loops, an integrator, a real pole and a source
machine: PRESET
parameters: {T: 2 ms}
analog:
  v1: {integrate: {x1: -4}, initial: 0, full_scale: 2}
  x1: {integrate: {v1: 1}, initial: 1, full_scale: 1}
  v2: {integrate: {f: 1}, initial: 0, full_scale: 10}
  x2: {integrate: {v2: 1}, initial: 1, full_scale: 1}
  alone: {integrate: {x1: 0.1}, initial: 0, full_scale: 1}
  slow: {lag: {x1: 1}, time_constant: 4 s, full_scale: 1}
  wave: {sine: 0.1, omega: 7 rad/s, full_scale: 1}
interface:
  s: {adc: x2}
  f: {dac: w, full_scale: 100, initial: 0}
digital: {period: T, program: {w: -81*s}}
run: {until: 1 s}
"""


@pytest.mark.parametrize("preset", ["ideal", "lags", "nominal"])
def test_each_mode_is_paired_with_its_ideal(preset, compiled):
    found = modes(compiled(DECOUPLED.replace("PRESET", preset)))
    assert [m.omega_ideal for m in found] == pytest.approx([0, 0.25, 2, 9], rel=1e-12)
    assert [m.zeta_ideal for m in found] == pytest.approx([math.nan, 1, 0, 0], nan_ok=True)
    still, slow, analog, sampled = found
    assert still.omega == 0 and math.isnan(still.zeta)
    tolerance = 3e-4 if preset == "nominal" else 1e-12
    assert slow.omega == pytest.approx(0.25, rel=tolerance) and slow.zeta == pytest.approx(1)
    assert slow.omega_damped == 0
    # The analog loop has lags alone; the sampled one also the delay of 1.5 T.
    lags = 0 if preset == "ideal" else 1e-6
    assert analog.zeta == pytest.approx(-0.5 * 2 * 2 * lags, abs=2e-10)
    exact = theory.exact_uncompensated(9.0, 2e-3).zeta
    assert sampled.zeta == pytest.approx(exact - 0.5 * 9 * 3 * lags, abs=2e-6 if lags else 1e-13)


@pytest.mark.parametrize("zeta", [0.3, 0.999999, 2.0])
def test_damped_and_overdamped_loops(zeta, compiled):
    text = f"""
title: Damped
machine: ideal
parameters: {{T: 1 ms}}
analog:
  v: {{integrate: {{f: 1, v: -{2 * zeta * 10}}}, initial: 0, full_scale: 10}}
  x: {{integrate: {{v: 1}}, initial: 1, full_scale: 1}}
interface: {{s: {{adc: x}}, f: {{dac: w, full_scale: 100, initial: 0}}}}
digital: {{period: T, program: {{w: -100*s}}}}
run: {{until: 1 s}}
"""
    found = modes(compiled(text))
    if zeta < 1:
        (mode,) = found
        assert (mode.omega_ideal, mode.zeta_ideal) == pytest.approx((10, zeta), rel=1e-9)
        # The delayed moment turns by 1.5 W cos(phase): -3/4 W sqrt and more, small all the same.
        assert mode.zeta == pytest.approx(zeta, abs=0.04)
    else:
        ideal = [10 * (zeta - math.sqrt(zeta**2 - 1)), 10 * (zeta + math.sqrt(zeta**2 - 1))]
        assert [m.omega_ideal for m in found] == pytest.approx(ideal, rel=1e-12)
        assert [m.zeta_ideal for m in found] == pytest.approx([1, 1])
        assert [m.zeta for m in found] == pytest.approx([1, 1])
        assert [m.omega_damped for m in found] == [0, 0]
        assert [m.omega for m in found] == pytest.approx(ideal, rel=0.1)


def test_results_passing_through_are_no_modes(shipped, compiled):
    # Without compute time the lagged loop remembers theta, theta_dot and, through the lags, M_a.
    found = exact_modes(compiled(shipped("pitch_loop"), {"compute_time": 0.0}, "lags"))
    assert len(found) <= 3


@pytest.mark.parametrize("cycles", [1, 2, 5])
def test_the_map_holds_what_lasts_and_nothing_else(cycles, shipped, compiled):
    # theta, theta_dot and the results on their way; samples and words are overwritten unread.
    machine = compiled(shipped("pitch_loop"), {"compute_time": cycles * 1e-3})
    change, _ = only(cycle_maps([machine]))
    assert change.shape == (2 + cycles, 2 + cycles)
    assert len(exact_modes(machine)) == 2 + cycles


# --- programs that are not linear ----------------------------------------------------------------


@pytest.mark.parametrize(
    "expression",
    [
        "abs(alpha_sample)",
        "alpha_sample*alpha_sample",
        "1/alpha_sample",
        "alpha_sample**3",
        "max(alpha_sample, 0)",
        "sin(alpha_sample)",
        "alpha_sample*previous(smooth)",
        "atan2(alpha_sample, 1)",
    ],
)
def test_not_linear_names_the_word(expression, shipped, compiled):
    machine = compiled(with_memory(shipped, expression))
    with pytest.raises(NotLinear, match="word 'smooth' is not linear"):
        exact_modes(machine)
    with pytest.raises(NotLinear, match="'smooth'"):
        predict(machine.patch)
    assert "'smooth'" in check(machine.patch).prediction


@pytest.mark.parametrize(
    ("expression", "gain"),
    [
        ("alpha_sample/4 - -alpha_sample", 1.25),
        ("(2*3)*alpha_sample*cos(pi)", -6.0),
        ("alpha_sample**1 + 7", 1.0),
        ("alpha_sample - 0.5*alpha_sample + sqrt(2)", 0.5),
    ],
)
def test_linear_and_affine_programs(expression, gain, shipped, compiled):
    tape = compiled(with_memory(shipped, expression)).tape
    program = linear_program(tape, 1)
    row = tape.words.index("smooth")
    assert program.rows[row, 0] == pytest.approx(gain, rel=1e-15)
    assert not np.any(program.rows[:, 1:-1])


# --- predictions ---------------------------------------------------------------------------------


def test_closed_forms_by_structure(shipped, compiled):
    cases = {
        "2.1": compiled(shipped("pitch_loop")),
        "2.2": compiled(shipped("pitch_loop_lead")),
        "2.3": compiled(shipped("pitch_loop_analog")),
    }
    for equation, machine in cases.items():
        assert closed_form_case(machine).equation == equation
    assert closed_form_case(compiled(shipped("pitch_loop_lead"), {"lead": 1.4})) is None
    assert closed_form_case(compiled(shipped("pitch_loop"), {"compute_time": 2e-3})) is None
    skewed = shipped("pitch_loop", ("{adc: alpha,", "{adc: alpha, conversion_time: 1 us,"))
    assert closed_form_case(compiled(skewed)) is None


OSCILLATOR = """  extra_dot: {integrate: {extra: -SQUARE, SOURCE}, initial: 0 1/s, full_scale: 100 1/s}
  extra: {integrate: {extra_dot: 1}, initial: 0.1, full_scale: 1}
"""


def with_oscillator(text, omega, source="theta: 0"):
    added = OSCILLATOR.replace("SQUARE", f"{omega**2!r} 1/s^2").replace("SOURCE", source)
    return text.replace("analog:\n", "analog:\n" + added, 1)


def ring(*kinds):
    """One loop of elements: a number of 1/s integrates, a lag is in s, anything else only weighs."""
    parts = []
    for i, kind in enumerate(kinds):
        name, source = f"e{i}", f"e{i - 1 if i else len(kinds) - 1}"
        forms = {
            "lag": f"lag: {{{source}: 1}}, time_constant: 0.1 s, initial: 0",
            "invert": f"invert: {source}",
        }
        made = f"integrate: {{{source}: {kind} 1/s}}, initial: 0.1"
        parts.append(f"  {name}: {{{forms.get(kind, made)}, full_scale: 1}}")
    lines = "\n".join(parts)
    return f"title: Ring\nmachine: lags\nanalog:\n{lines}\nrun: {{until: 1 s, every: 1 ms}}\n"


def forms(machine):
    return [
        (mode["omega_ideal"], mode["closed_form"] and mode["closed_form"]["equation"])
        for mode in predict(machine).to_dicts()
    ]


def test_only_a_ring_of_two_integrators_that_oscillates_has_a_closed_form(compiled):
    for own in (ring("-10", "10"), ring("10", "invert", "10"), ring("-20", "5")):
        assert forms(compiled(own)) == [(pytest.approx(10.0), "2.3")]
    for other in (
        ring("10", "10", "10", "10"),  # s^4 = 1e4: +-10 and +-10j
        ring("-10", "10", "10", "10"),
        ring("-10", "10", "10"),
        ring("10", "10"),
        ring("-10", "10", "lag"),
        ring("-10", "lag"),
    ):
        machine = compiled(other)
        assert closed_form_case(machine) is None
        assert not any(form for _, form in forms(machine))


def test_an_oscillator_beside_the_loop_gets_no_closed_form_of_the_loop(shipped, compiled):
    # Of the same frequency: which mode is whose cannot be told from the ideal.
    for source in ("theta: 0 1/s^2", "theta: 1 1/s^2"):
        for name in ("pitch_loop", "pitch_loop_lead"):
            beside = forms(compiled(with_oscillator(shipped(name), 10.0, source)))
            assert len(beside) == 2
            assert not any(form for _, form in beside)
    # Far from the loop's it takes nothing away; and the form stays with the loop.
    beside = forms(compiled(with_oscillator(shipped("pitch_loop"), 37.0, "theta: 1 1/s^2")))
    assert beside == [(pytest.approx(10.0), "2.1"), (pytest.approx(37.0), None)]
    # So near that the loop's exact mode is beyond it: the modes may have changed places.
    near = with_oscillator(shipped("pitch_loop"), 10.01, "theta: 0 1/s^2")
    for mode in predict(compiled(near, {"cycle": 1e-2})).to_dicts():
        assert mode["closed_form"] is None or mode["zeta"] < -0.05
    # A damped one of the same |s| is another mode.
    damped = with_oscillator(shipped("pitch_loop"), 10.0, "extra_dot: -12 1/s")
    for mode in predict(compiled(damped)).to_dicts():
        assert (mode["closed_form"] is None) == (mode["zeta"] > 0.1)
    # In an all-analog patch it is a second loop.
    assert closed_form_case(compiled(with_oscillator(shipped("pitch_loop_analog"), 37.0))) is None


def test_prediction_puts_the_closed_form_beside_the_exact_mode(shipped):
    found = predict(parse_patch(shipped("pitch_loop"))).to_dicts()[0]
    assert found["closed_form"]["zeta"] == -0.0075
    assert found["zeta"] == pytest.approx(-0.00749925, abs=2e-10)
    lead = predict(parse_patch(shipped("pitch_loop_lead"))).to_dicts()[0]
    assert lead["zeta"] == pytest.approx(-5.0007e-7, abs=5e-12)
    analog = predict(
        parse_patch(shipped("pitch_loop_analog")), {"omega_p": 2000.0, "tau": 2e-6}
    ).to_dicts()[0]
    assert analog["closed_form"]["zeta"] == pytest.approx(-0.01, rel=1e-12)
    assert analog["zeta"] == pytest.approx(-0.0100, abs=5e-5)


@pytest.mark.parametrize("error", [1e-4, 0.01, 0.05])
def test_largest_cycle_solves_the_exact_equation(error, shipped, compiled):
    longest = largest_cycle_s(compiled(shipped("pitch_loop")), error)
    zeta = theory.exact_uncompensated(OMEGA_P, longest).zeta
    assert zeta == pytest.approx(-error, rel=3e-12)
    assert longest == pytest.approx(theory.largest_period_s(OMEGA_P, error), rel=2 * error)


@pytest.mark.parametrize("name", NAMES.values())
def test_largest_cycle_keeps_what_it_promises(name, shipped, compiled):
    # Kept at the T found and at every step down to a thousandth of it, exceeded just above.
    text = shipped(name)

    def error(period_s):
        found = compiled(text, {"cycle": period_s}, "lags")
        return max(abs(m.zeta - m.zeta_ideal) for m in modes(found) if m.omega_ideal > 0)

    longest = largest_cycle_s(compiled(text, preset="lags"), 0.01)
    assert error(longest) <= 0.01 < error(longest * (1 + 1e-9))
    for k in range(1, 39):
        assert error(longest / STEP**k) <= 0.01


def test_largest_cycle_with_lead_and_with_lags(shipped, compiled):
    longest = largest_cycle_s(compiled(shipped("pitch_loop_lead")), 0.01)
    assert theory.exact_lead(OMEGA_P, longest).zeta == pytest.approx(-0.01, rel=1e-11)
    # Lags take 2.5e-5 of the allowance, so T is shorter by 2.5e-5 / (3/4 * 10).
    ideal = largest_cycle_s(compiled(shipped("pitch_loop")), 0.01)
    lagged = largest_cycle_s(compiled(shipped("pitch_loop"), preset="lags"), 0.01)
    assert ideal - lagged == pytest.approx(2.5e-5 / 7.5, rel=0.01)


@pytest.mark.parametrize("time_constant", ["10 us", "1 ms", "100 ms", "20 s"])
def test_largest_cycle_does_not_depend_on_a_filter_outside_the_loop(
    time_constant, shipped, compiled
):
    text = shipped(
        "pitch_loop",
        (
            "interface:",
            f"  s: {{lag: {{theta: 1}}, time_constant: {time_constant}, full_scale: 2}}\n\ninterface:",
        ),
    )
    longest = largest_cycle_s(compiled(text), 0.1)  # 14 ms
    assert theory.exact_uncompensated(OMEGA_P, longest).zeta == pytest.approx(-0.1, rel=1e-10)


@pytest.mark.parametrize("time_constant_s", [1e-4, 1e-3])
def test_largest_cycle_with_a_fast_sensor_in_the_loop(time_constant_s, shipped, compiled):
    """The sensor's own pole is over between two samples at the T found, far beyond its pi samples."""
    text = shipped(
        "pitch_loop",
        (
            "interface:",
            f"  s: {{lag: {{alpha: 1}}, time_constant: {time_constant_s} s, full_scale: 2}}\n"
            "\ninterface:",
        ),
        ("{adc: alpha,", "{adc: s,"),
    )
    longest = largest_cycle_s(compiled(text), 0.1)
    pitch = min(modes(compiled(text, {"cycle": longest})), key=lambda m: abs(m.omega - OMEGA_P))
    assert pitch.zeta == pytest.approx(-0.1 + pitch.zeta_ideal, rel=1e-9)
    assert longest > math.pi * time_constant_s


@pytest.mark.parametrize("error", [0.02, 0.2])
def test_largest_cycle_passes_no_other_that_exceeds_the_error(error, shipped, compiled):
    """Against every hundredth of T from a thousandth on, of all modes that there are samples for."""
    text = shipped(
        "pitch_loop",
        ("interface:", "  s: {lag: {alpha: 1}, time_constant: 3 ms, full_scale: 2}\n\ninterface:"),
        ("{adc: alpha,", "{adc: s,"),
    )
    longest = largest_cycle_s(compiled(text), error)
    for period_s in longest * np.geomspace(1e-3, 1.0, 100):
        found = [m for m in modes(compiled(text, {"cycle": period_s})) if m.omega_ideal > 0]
        seen = [m for m in found if m.omega_ideal * period_s <= math.pi]
        assert max(abs(m.zeta - m.zeta_ideal) for m in seen) <= error * (1 + 1e-9)


@pytest.mark.parametrize("time_constant", ["1 us", "20 us"])
def test_what_is_over_within_a_cycle_is_paired_with_no_other_mode(time_constant, shipped, compiled):
    """exp(-50) of it is left: an exact mode beside it would be another, a root of the delay."""
    sensor = f"  s: {{lag: {{alpha: 1}}, time_constant: {time_constant}, full_scale: 2}}\n\n"
    machine = compiled(shipped("pitch_loop", ("interface:", sensor + "interface:")))
    assert [m.omega_ideal for m in modes(machine)] == pytest.approx([OMEGA_P])


RESONANT = (
    "  remember: {osc: 0}\n  program:\n"
    '    osc: "2*RADIUS*cos(0.0101)*previous(osc) - RADIUS**2*previous(osc, 2) + 1e-4*alpha_sample"\n'
)


def test_largest_cycle_takes_rounding_for_no_growth(shipped, compiled):
    text = shipped("pitch_loop", ("  program:\n", RESONANT.replace("RADIUS", "1")))
    longest = largest_cycle_s(compiled(text), 0.02)
    assert theory.exact_uncompensated(OMEGA_P, longest).zeta == pytest.approx(-0.02, rel=1e-10)


def test_largest_cycle_where_the_program_grows_by_itself(shipped, compiled):
    text = shipped("pitch_loop", ("  program:\n", RESONANT.replace("RADIUS", "1.01")))
    with pytest.raises(RunError, match="a mode grows that is not meant"):
        largest_cycle_s(compiled(text), 0.02)


def test_largest_cycle_where_the_period_is_a_plain_number(shipped, compiled):
    text = shipped(
        "pitch_loop", ("  period: cycle\n  compute_time: compute_time\n", "  period: 1 ms\n")
    )
    named = largest_cycle_s(compiled(shipped("pitch_loop")), 0.01)
    assert largest_cycle_s(compiled(text), 0.01) == pytest.approx(named, rel=1e-11)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("compute_time: cycle", "compute_time: 1 ms", ("the compute time stays 0.001 s",)),
        (
            "period: cycle",
            "period: 10 / (1000 * omega_p)",
            ("change it alone", "compute time stays"),
        ),
        ("period: cycle", "period: 1 ms", ("the period is 0.001 s, so", "compute time stays")),
        ("cycle: 1 ms", "cycle: 2 ms", ()),
    ],
)
def test_a_prediction_tells_what_does_not_follow_the_period(old, new, told, shipped):
    patch = parse_patch(shipped("pitch_loop", (old, new)))
    notes = predict(patch, max_damping_error=0.02).notes
    assert len(notes) == len(told)
    assert all(part in note for part, note in zip(told, notes, strict=True))
    of_expression = "omega_p" in new
    assert len(predict(patch).notes) == of_expression


def test_a_largest_cycle_that_another_mode_ends_says_so(shipped):
    patch = parse_patch(shipped("pitch_loop"))
    assert predict(patch, max_damping_error=0.1).notes == ()
    found = predict(patch, max_damping_error=5.0)
    assert any("a mode grows that is not meant" in note for note in found.notes)
    grows = predict(
        patch, {"cycle": found.max_cycle_s * 1.001, "compute_time": found.max_cycle_s * 1.001}
    )
    assert any(math.isnan(m.omega_ideal) and m.zeta < 0 for m in grows.modes)


def test_largest_cycle_says_why_there_is_none(shipped, compiled):
    with pytest.raises(RunError, match="no digital machine"):
        largest_cycle_s(compiled(shipped("pitch_loop_analog")), 0.01)
    with pytest.raises(RunError, match=r"lags, gain errors, and .* alone exceed it"):
        largest_cycle_s(compiled(shipped("pitch_loop"), preset="lags"), 1e-5)
    for error in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(RunError, match="must be above 0"):
            largest_cycle_s(compiled(shipped("pitch_loop")), error)


@pytest.mark.parametrize(
    ("old", "new", "expected_s"),
    [
        ("compute_time: cycle", "compute_time: 1 ms", 2e-3),  # 1 ms + T/2
        ("compute_time: cycle", "compute_time: 10 us", 3.98e-3),  # 10 us + T/2
        ("{adc: alpha,", "{adc: alpha, conversion_time: 10 us,", 1.3267e-3),  # 10 us + T + T/2
        ("{adc: alpha,", "{adc: alpha, conversion_time: 0.1*cycle,", 1.25e-3),
    ],
)
def test_largest_cycle_with_times_in_seconds(old, new, expected_s, shipped, compiled):
    # All delays add: zeta = -10 / 2 times their sum is -0.01 where they are 2 ms.
    longest = largest_cycle_s(compiled(shipped("pitch_loop", (old, new))), 0.01)
    assert longest == pytest.approx(expected_s, rel=2e-3)


def test_largest_cycle_where_the_compute_time_alone_is_too_long(shipped, compiled):
    machine = compiled(shipped("pitch_loop", ("compute_time: cycle", "compute_time: 5 ms")))
    with pytest.raises(RunError, match="compute and conversion times in seconds alone exceed it"):
        largest_cycle_s(machine, 0.01)


# --- modes that nobody meant -----------------------------------------------------------------------


def test_a_mode_that_grows_is_listed_although_nobody_meant_it(shipped, compiled):
    # drift(k + 1) = 1.05 drift(k) grows by itself: s = ln(1.05) / T = 48.79 1/s.
    text = shipped(
        "pitch_loop",
        ("  program:\n", "  remember: {drift: 0}\n  program:\n    drift: 1.05*previous(drift)\n"),
    )
    grows = [m for m in modes(compiled(text)) if math.isnan(m.omega_ideal)]
    assert [m.omega for m in grows] == pytest.approx([math.log(1.05) / 1e-3], rel=1e-9)
    assert [m.zeta for m in grows] == [-1.0]


RESONATOR = """
title: A resonator in the program
machine: ideal
parameters: {cycle: 10 ms, r: 0.99, turn: 0.2852}
analog: {y: {sum: {d: 1}, full_scale: 10 V}}
interface: {d: {dac: x, full_scale: 10 V, initial: 0 V}}
digital:
  period: cycle
  remember: {x: 1}
  program: {x: "2*r*cos(turn)*previous(x) - r**2*previous(x, 2)"}
run: {until: 5 s}
"""


@pytest.mark.parametrize(("r", "listed"), [(1.0, 1), (0.99, 1), (0.51, 1), (0.49, 0)])
def test_a_mode_of_the_program_alone_is_listed_if_it_lasts(r, listed, compiled):
    # z = r e^(+-i turn): s = (ln r +- i turn) / T; below r = 1/2 it is over within a few cycles.
    found = modes(compiled(RESONATOR, {"r": r}))
    s = complex(math.log(r), 0.2852) / 0.01
    assert [m.omega for m in found] == pytest.approx([abs(s)] * listed, rel=1e-9)
    assert [m.zeta for m in found] == pytest.approx([-s.real / abs(s)] * listed, abs=1e-9)
    assert all(math.isnan(m.omega_ideal) for m in found)


@pytest.mark.parametrize("inertia", [1e-3, 1.0, 1e5, 1e9])
@pytest.mark.parametrize("omega_p", [0.1, 10.0, 84.0, 500.0])
def test_units_of_the_words_do_not_matter(shipped, compiled, inertia, omega_p):
    parameters = {"I_yy": inertia, "omega_p": omega_p}
    found = modes(compiled(shipped("pitch_loop"), parameters))
    exact = theory.exact_uncompensated(omega_p, 1e-3)
    assert [m.zeta for m in found if m.omega_ideal > 0] == pytest.approx([exact.zeta], abs=1e-12)


SLOW_AND_FAST = """
title: Two loops of one state each on one processor
machine: ideal
parameters: {rate: 100 1/s}
analog:
  x: {integrate: {pull: 1}, initial: 1, full_scale: 2}
  y: {integrate: {push: 1}, initial: 1, full_scale: 2}
interface:
  xs: {adc: x}
  ys: {adc: y}
  pull: {dac: pw, full_scale: 200 1/s, initial: 0 1/s}
  push: {dac: qw, full_scale: 200 1/s, initial: 0 1/s}
digital:
  tasks:
    fast: {period: 1 ms, compute_time: 0, program: {pw: -rate*xs}}
    slow: {period: 500 ms, compute_time: 0, program: {qw: -0.5*ys}}
run: {until: 2 s}
"""


def test_a_mode_that_dies_within_a_long_stretch_of_tasks_is_told():
    # Of x 0.9 is left in 1 ms, so 0.9^500 = 1e-23 in the 0.5 s of the map; of y 0.75.
    found = predict(parse_patch(SLOW_AND_FAST))
    assert [m.omega for m in found.modes] == pytest.approx([-math.log(0.75) / 0.5], rel=1e-12)
    (note,) = found.notes
    assert note.startswith("1 mode of the ideal with omega 100 rad/s left out: less than 1e-09")
    assert "0.5 s after which all tasks are where they were" in note
    # At 30/s 0.97^500 = 2.4e-7 of it is left, and it is listed.
    found = predict(parse_patch(SLOW_AND_FAST), {"rate": 30.0})
    both = [-math.log(0.75) / 0.5, -math.log(0.97) / 1e-3]
    assert [m.omega for m in found.modes] == pytest.approx(both, rel=1e-9)
    assert found.notes == ()


def test_a_filter_beside_the_loop_leaves_it_the_papers(shipped, compiled):
    """And one in the loop does not."""
    seen = "  remember: {seen: 0}\n  program:\n    seen: 0.2*alpha_sample + 0.8*previous(seen)\n"
    beside = shipped("pitch_loop").replace("  program:\n", seen)
    plain = closed_form_case(compiled(shipped("pitch_loop")))
    assert plain.equation == "2.1" and closed_form_case(compiled(beside)) == plain
    forms = predict(parse_patch(beside)).closed_forms
    assert [form.equation for form in forms if form] == ["2.1"] and len(forms) == 2
    inside = beside.replace("omega_p**2 * alpha_sample", "omega_p**2 * seen")
    assert inside != beside and closed_form_case(compiled(inside)) is None
