"""What an operator learns before the first run: trial run, full scales, parts, rate test; by hand."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

import hybrid
from hybrid import trial
from hybrid.cli import main
from hybrid.compiler import compile_patch
from hybrid.trial import round_above

# The sine's top, 3 V, falls on the row at 25 ms.
SCALES = """
title: Full scales, good and bad
machine: ideal
analog:
  wave: {sine: 3 V, frequency: 10 Hz, full_scale: 2 V}
  faint: {sum: {wave: 0.01}, full_scale: 1 V}
  good: {coefficient: {wave: -0.6}, full_scale: 2 V}
  none: {constant: 0 V, full_scale: 1 V}
  push: {constant: 0.5 V, full_scale: 1 V}
  ramp: {integrate: {push: 4 1/s}, initial: -0.2 V, full_scale: 2 V}
run: {until: 1 s, every: 1 ms}
"""


def checked(text, **order):
    found = hybrid.check(hybrid.parse_patch(text), **order)
    return found, {row.signal: row for row in found.scaling}


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (1.0, 1.2),  # a round figure is not its own full scale
        (0.03, 0.04),
        (2.0142, 2.5),
        (7.6, 8.0),
        (7.7, 10.0),  # 5 % above it is 8.085
        (950.0, 1000.0),
        (999.0, 1200.0),
        (1000.0, 1200.0),
        (1.3e-9, 1.5e-9),
        (7e20, 8e20),
    ],
)
def test_full_scales_are_round_figures_with_five_per_cent_of_headroom(value, expected):
    assert round_above(value) == expected
    assert round_above(value) >= 1.05 * value


@pytest.mark.parametrize("value", [d * 10.0**p for d in trial.ROUND[:-1] for p in (-7, 0, 12)])
def test_no_round_figure_is_its_own_full_scale(value):
    assert round_above(value) > value * 1.04
    assert round_above(value, 0.0) == pytest.approx(value, rel=1e-15)  # a comparator's level is


@pytest.mark.parametrize(("value", "expected"), [(1.0 + 1e-12, 1.0), (1.0000001, 1.2)])
def test_rounding_takes_no_level_to_the_next_round_figure(value, expected):
    assert round_above(value, 0.0) == expected


def test_full_scales_by_hand():
    found, rows = checked(SCALES)
    assert (found.trial.status, found.trial.played_s, found.trial.note) == ("complete", 1.0, "")
    expected = {  # largest, share of full scale, proposed, remark
        "wave": (3.0, 1.5, 4.0, "beyond its range"),
        "faint": (0.03, 0.03, 0.04, "below 10 %"),
        "good": (1.8, 0.9, 2.0, ""),
        "none": (0.0, 0.0, None, "stays at zero"),
        "push": (0.5, 0.5, 0.6, ""),
        "ramp": (1.8, 0.9, 2.0, ""),  # -0.2 + 4 * 0.5 * 1 s
    }
    for name, (largest, used, proposed, remark) in expected.items():
        row = rows[name]
        assert row.largest == pytest.approx(largest, abs=1e-12), name
        assert row.used == pytest.approx(used, abs=1e-12), name
        assert (row.proposed, row.remark) == (proposed, remark), name


def test_a_check_without_a_trial_run():
    found, rows = checked(SCALES, trial=False)
    assert found.trial is None
    assert rows["wave"].largest is rows["wave"].proposed is None
    assert [r.first_mu for r in found.rates] == [None]
    assert found.to_dict()["trial"] is None


def test_a_long_trial_run_is_cut(monkeypatch):
    monkeypatch.setattr(trial, "LONGEST_WALL_S", 0.05)
    found, rows = checked(SCALES.replace("until: 1 s", "until: 1000000 s"))
    assert found.trial.status == "cut"
    assert 0.0 < found.trial.played_s < 1e6
    assert found.trial.note.startswith(f"cut at {found.trial.played_s:.6g} s, after 0.05 s")
    assert rows["wave"].remark == "beyond its range"


RUNAWAY = """
title: Runs away
machine: ideal
analog:
  x: {integrate: {x: 100 1/s}, initial: 1 V, full_scale: 10 V}
run: {until: 1 s, every: 1 ms}
"""


def test_a_patch_that_runs_away_gets_no_full_scales():
    """exp(100 t) / 10 passes 1e12 at ln(1e13) / 100 = 0.2993 s."""
    found, rows = checked(RUNAWAY)
    assert found.trial.status == "stopped"
    assert found.trial.played_s == pytest.approx(math.log(1e13) / 100, abs=1.1e-3)
    assert "unstable" in found.trial.note
    assert (rows["x"].largest, rows["x"].proposed, rows["x"].remark) == (None, None, "")


def test_a_full_scale_that_is_far_off_is_put_right():
    """x' = 1e9 V/s for 1 s, where 10 V were thought enough; that is far, but no runaway."""
    text = RUNAWAY.replace("{x: 100 1/s}", "{one: 1e9 1/s}").replace("initial: 1 V", "initial: 0 V")
    _, rows = checked(text.replace("  x:", "  one: {constant: 1 V, full_scale: 1 V}\n  x:"))
    assert rows["x"].largest == pytest.approx(1e9, rel=1e-12)
    assert (rows["x"].proposed, rows["x"].remark) == (1.2e9, "beyond its range")
    assert (rows["one"].proposed, rows["one"].remark) == (1.2, "no headroom")


def test_a_comparators_levels_need_no_headroom():
    text = SCALES.replace(
        "run:", "  beyond: {compare: {wave: 1}, high: 1, low: -1, full_scale: 1}\nrun:"
    )
    _, rows = checked(text)
    assert (rows["beyond"].used, rows["beyond"].proposed, rows["beyond"].remark) == (1.0, 1.0, "")


def test_noise_takes_no_range():
    """Without noise what stays at zero does, and the first rate of a ramp is what it is by hand."""
    noisy, rows = checked(SCALES.replace("machine: ideal", "machine: nominal"), serial=2)
    assert rows["none"].remark == "stays at zero"
    error = noisy.rates[0].gain_error
    push = noisy.machine.stages["push"].gain
    late = 1e-6 / 1e-3  # its own lag, of the first interval
    rate = 4 * 0.5 / 2 * push * (1 + error)
    assert noisy.rates[0].first_mu == pytest.approx(rate * (1 - late), rel=1e-9)


HISS = """
title: Noise sources
machine: MACHINE
analog:
  hiss: {noise_source: 0.1 V, bandwidth: 1000 rad/s, full_scale: 1 V}
  slow: {lag: {hiss: 1}, time_constant: 20 ms, full_scale: 1 V}
  PART
run: {until: 1 s, every: 1 ms}
"""
SQUARED = "loud: {multiply: [hiss, hiss], full_scale: 1 V^2}"


@pytest.mark.parametrize("part", ["loud: {sum: {hiss: 1}, full_scale: 1 V}", SQUARED])
def test_the_trial_plays_noise_sources(part):
    """Rows that forget in 1 ms: the largest of some 500 independent ones is above 2.3 standard
    deviations but for (1 - 0.021)^500 = 2e-5, and below 5.5 but for 2e-5. On ideal parts it is the run
    of seed 0."""
    text = HISS.replace("PART", part)
    _, rows = checked(text.replace("MACHINE", "ideal"))
    assert 0.23 < rows["hiss"].largest < 0.55
    assert rows["hiss"].proposed == round_above(rows["hiss"].largest)
    assert rows["slow"].remark == "below 10 %"  # 0.1 sqrt(1 ms / 21 ms) = 0.022 rms
    record = hybrid.run(hybrid.parse_patch(text.replace("MACHINE", "ideal"))).record
    for name in ("hiss", "slow", "loud"):
        assert rows[name].largest == pytest.approx(abs(record[name].values).max(), rel=1e-9), name
    again = checked(text.replace("MACHINE", "ideal"))[1]
    assert again["hiss"].largest == rows["hiss"].largest
    # The components' own noise stays out, also of the noise source's output.
    loud = text.replace("MACHINE", "{preset: lags, noise: 0.3}")
    assert checked(loud)[1]["slow"].largest < 0.1


CLIPPED = """
title: What is held back
machine: {preset: nominal, noise: 0, tolerance: 0}
analog:
  big: {constant: 4 V, full_scale: 5 V}
  x: {integrate: {big: 1 1/s}, initial: 0 V, full_scale: 1 V, saturation: 1.1}
interface:
  seen: {adc: big, bits: 12}
  out: {dac: word, bits: 12, full_scale: 2 V, initial: 0 V}
digital:
  period: 10 ms
  program: {word: 2*seen}
run: {until: 1 s}
"""


def test_what_clips_needs_more_than_it_shows():
    """x would reach 4 V and stops at 1.1; the DAC is given 2 * 4 V for its 2 V."""
    _, rows = checked(CLIPPED)
    assert rows["x"].used == pytest.approx(1.1, abs=1e-9)
    assert rows["out"].largest == pytest.approx(8.0, abs=5.0 / 2047)  # within the ADC's step, twice
    for name in ("x", "out"):
        assert (rows[name].proposed, rows[name].remark[:9]) == (None, "held back")
    assert rows["big"].remark == ""


@pytest.mark.parametrize("name", ["van_der_pol", "relay_servo", "bouncing_ball", "pitch_loop"])
def test_shipped_patches_are_well_scaled_by_their_own_headers(name):
    rows = hybrid.check(name).scaling
    assert all(row.used is not None and row.used <= 1.0 + 1e-6 for row in rows)
    levels = {row.signal for row in rows if row.kind == "compare"}
    for row in rows:
        room = 0.0 if row.signal in levels else 0.05
        assert row.proposed is None or row.proposed >= row.largest * (1 + room) * (1 - 1e-9)


PARTS = """
title: Parts
machine: ideal
analog:
  one: {constant: 1 V, full_scale: 1 V}
  x: {integrate: {y: -10 1/s, one: 0.3 1/s}, initial: 0.5 V, full_scale: 1 V}
  y: {sum: {x: 1, one: -0.2}, full_scale: 1 V}
  turned: {invert: x, full_scale: 1 V}
  pot: {coefficient: {x: 0.25}, full_scale: 1 V}
  loud: {coefficient: {x: 25}, full_scale: 1 V}
  slow: {lag: {x: 1}, time_constant: 1 s, full_scale: 1 V}
  square: {multiply: [x, x], gain: 1 1/V, full_scale: 1 V}
  size: {absolute: x, full_scale: 1 V}
run: {until: 10 ms, every: 1 ms}
"""


def test_parts_by_hand():
    """Inverters: `turned`, and one each for -y and -one. Potentiometers: 0.3 and the initial 0.5 of x,
    0.2 of y, 0.25, 25 = 0.25 x 100; -10 is a cord to an input of 10, and 1, the lag's rates included,
    a cord."""
    found, _ = checked(PARTS, trial=False)
    expected = {"integrator": 1, "summer": 2, "inverter": 3, "lag": 1, "amplifier": 7}
    expected |= {"multiplier": 1, "absolute value": 1, "source": 1, "potentiometer": 5}
    assert {p.part: p.count for p in found.parts} == expected
    assert found.parts[0].part == "amplifier"


LEVELS = """
title: What is set on parts that are not linear
machine: ideal
analog:
  c: {constant: 1, full_scale: 2}
  sq: {sine: 1, omega: 10 rad/s, full_scale: 4}
  relay: {compare: {c: 1, sq: 0.5}, threshold: 0.3, hysteresis: 0.1, high: 0.5, full_scale: 1}
  kept: {limit: sq, low: -0.5, high: 1, full_scale: 4}
  p: {multiply: [c, sq], quarter_square: 23, full_scale: 0.8}
  whole: {multiply: [c, sq], quarter_square: 23, full_scale: 8}
  share: {divide: [sq, c], gain: 0.1, full_scale: 4}
  root: {square_root: c, gain: -2, full_scale: 2}
run: {until: 10 ms, every: 1 ms}
"""


def test_levels_by_hand():
    """Both inputs of the relay are 2 at full scale, so 1 each, and its figures of 2; limits of 4.

    Results of machine units are multiplied by 2 * 4 / 0.8, by 1 (no row), by 0.1 * (4 / 2) / 4 and by
    -2 sqrt(2) / 2. One of 10 is an input of 10 of what reads it, and no potentiometer.
    """
    found, _ = checked(LEVELS, trial=False)
    shown = {(p.component, p.input): p.coefficient_mu for p in found.pots}
    expected = {("c", "(reference)"): 0.5}
    expected |= {("relay", "c"): 1.0, ("relay", "sq"): 1.0, ("relay", "(high)"): 0.5}
    expected |= {("relay", "(threshold)"): 0.15, ("relay", "(hysteresis)"): 0.05}
    expected |= {("kept", "(low)"): -0.125, ("kept", "(high)"): 0.25}
    expected |= {("p", "(gain)"): 10.0, ("share", "(gain)"): 0.05, ("root", "(gain)"): -(2**0.5)}
    assert shown == pytest.approx(expected)
    # c, the relay's three figures, both limits, share and root.
    assert {p.part: p.count for p in found.parts}["potentiometer"] == 8


def test_squarers_that_err_by_more_of_their_full_scale():
    """8 of 0.8 is ten times 1/(4 23^2) = 4.7e-4; with a full scale of 8 it is that itself."""
    found, _ = checked(LEVELS, trial=False)
    (one,) = [warning for warning in found.warnings if "errs by" in warning]
    assert "'p' errs by up to 0.0047 of its full scale" in one


RATES = """
title: Rate test
machine: {preset: nominal, noise: 0, tau: 0 s, offset: 1e-3}
analog:
  one: {constant: 1 V, full_scale: 2 V, tolerance: 0, offset: 0}
  x: {integrate: {one: 3 1/s}, initial: 0.5 V, leak: 4 1/s, full_scale: 1 V}
run: {until: 10 ms, every: 1 ms}
"""


@pytest.mark.parametrize("as_circuit", [False, True])
def test_the_rate_test_by_hand(as_circuit):
    """x' = (1 + e) 3 V/s + 1e-3 - 4 x: at t = 0, and its mean over 1 ms, that times (1 - exp(-4e-3)) /
    4e-3."""
    machine = compile_patch(hybrid.parse_patch(RATES), as_circuit=as_circuit)
    (row,) = hybrid.check(machine).rates
    error = machine.stages["x"].gain - 1.0
    assert 0.0 < abs(error) <= 1e-4
    rate = 3.0 * (1.0 + error) + 1e-3 - 4.0 * 0.5
    assert row.rate_mu == pytest.approx(rate, rel=1e-12)
    assert row.first_mu == pytest.approx(rate * -math.expm1(-4e-3) / 4e-3, rel=1e-6)
    assert (row.gain_error, row.drift_mu) == (error, 1e-3)


def test_the_command_writes_no_files(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("scales.yaml").write_text(SCALES, encoding="utf-8")
    assert main(["check", "scales.yaml"]) == 0
    printed = capsys.readouterr().out
    line = next(line for line in printed.splitlines() if "beyond its range" in line)
    assert line.split() == ["wave", "beyond", "its", "range", "3", "V", "150", "%", "2", "4"]
    assert main(["check", "scales.yaml", "--no-trial"]) == 0
    assert "Trial run" not in capsys.readouterr().out
    assert main(["check", "scales.yaml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["trial"]["status"] == "complete"
    assert [p.name for p in tmp_path.iterdir()] == ["scales.yaml"]


@pytest.mark.parametrize(
    "source",
    [
        "{ramp: 1 V/s, full_scale: 1 V}",
        "{delay: {one: 1}, time: 1 ms, full_scale: 1 V}",
        "{sawtooth: 1 V, period: 1 ms, full_scale: 1 V}",
    ],
)
def test_hidden_integrators_are_no_rows_of_the_static_check(source: str) -> None:
    text = f"""
title: Hidden
machine: ideal
analog:
  one: {{constant: 0.5 V, full_scale: 1 V}}
  s: {source}
  p: {{multiply: [one, s], full_scale: 1 V^2, unit: V^2}}
run: {{until: 2 ms, every: 1 ms}}
"""
    found = hybrid.check(hybrid.parse_patch(text), trial=False)
    assert [row.signal for row in found.scaling] == ["one", "p", "s"]


@pytest.mark.parametrize("lag_us", [0, 1])
@pytest.mark.parametrize("as_circuit", [False, True])
def test_the_rate_test_compares_with_the_calculation_by_hand(as_circuit, lag_us):
    """By hand x' = 3 - 4 * 0.5. The gain may be off by 1e-4 of 3, the drift is 1e-3; the integrator's
    lag shows the rate of 1 us ago, of which x'' = -4 x' makes 4e-6. What is carried back is a slow
    exponential, so all that is lost are digits of the signals, 1e-11 at both ends of an interval of 20
    lags, or of 1e-4 of full scale, times the weights at the start of the cubic that has these means."""
    text = RATES.replace("tau: 0 s", f"tau: {lag_us} us")
    machine = compile_patch(hybrid.parse_patch(text), as_circuit=as_circuit)
    (row,) = hybrid.check(machine, trial=False).rates
    assert row.expected_mu == pytest.approx(1.0, rel=1e-12)
    lag = lag_us * 1e-6 * 4.0 * abs(row.rate_mu)
    step_s = 20e-6 if lag_us else 1e-4
    weights = sum((77, 137, 97, 25) if lag_us else (25, 23, 13, 3)) / 12
    exact = 2e-11 / step_s * weights
    bound = exact if as_circuit else 1e-4 * exact + 1e-8
    assert row.allowed_mu == pytest.approx((3e-4 + 1e-3) * (1 + 1e-4) + lag + exact, abs=bound)
    assert row.shown_mu == pytest.approx(row.rate_mu + lag, abs=bound)
    assert (row.fails, row.remark) == (False, "")


SATURATED = """
title: A sum that saturates at the start
machine: nominal
analog:
  one: {constant: 1 V, full_scale: 1 V}
  both: {sum: {one: 1.5}, saturation: 1.1, full_scale: 1 V}
  x: {integrate: {both: 10 1/s}, initial: 0 V, full_scale: 1 V}
run: {until: 10 ms, every: 1 ms}
"""


def test_the_rate_test_warns_of_a_rate_that_no_tolerance_explains():
    """15 a second by hand, 11 shown; allowed are 1e-4 of `one`, of `both` and of `x`: 3 * 1.5e-3."""
    found = hybrid.check(hybrid.parse_patch(SATURATED), trial=False)
    (row,) = found.rates
    assert row.expected_mu == pytest.approx(15.0, rel=1e-12)
    assert row.shown_mu == pytest.approx(11.0, rel=3e-4)
    assert row.allowed_mu == pytest.approx(4.5e-3, rel=1e-2)
    assert row.fails
    (warning,) = [w for w in found.warnings if w.startswith("rate test")]
    assert "x should begin with 15 machine units a second and shows 11" in warning


UNSTABLE = """
title: A loop of gain 2 around lagged parts
machine: lags
analog:
  one: {constant: 0.1 V, full_scale: 1 V}
  both: {sum: {one: 1, back: 2}, full_scale: 1 V}
  back: {coefficient: {both: 1}, full_scale: 1 V}
  x: {integrate: {both: 10 1/s}, initial: 0 V, full_scale: 1 V}
run: {until: 10 ms, every: 1 ms}
"""


def test_the_rate_test_warns_of_a_loop_that_does_not_rest():
    """both = 0.1 + 2 both has the solution -0.1, at which no machine stays: it runs away from rounding
    within the hundred lags that the test takes."""
    (row,) = hybrid.check(hybrid.parse_patch(UNSTABLE), trial=False).rates
    assert row.expected_mu == pytest.approx(-1.0, rel=1e-9)
    assert row.fails


CANCELLING = """
title: Inputs that cancel
machine: ideal
analog:
  one: {constant: 0.1 V, full_scale: 1 V}
  three: {constant: 0.3 V, full_scale: 1 V}
  rest: {integrate: {one: 3, three: -1}, initial: 0, full_scale: 1 V}
  slow: {integrate: {one: 1e-15}, initial: 0, full_scale: 1 V}
run: {until: 1 s, every: 0.1 s}
"""


@pytest.mark.parametrize("as_circuit", ["", ", saturation: 2"])
def test_what_rounding_leaves_of_a_rate_is_zero(as_circuit):
    """3*0.1 - 0.3 is 5.6e-17 in doubles, and 0 by hand; a rate of 1e-16 of nothing else is one."""
    found, rows = checked(
        CANCELLING.replace("full_scale", "full_scale", 1).replace(
            "initial: 0, full_scale: 1 V", f"initial: 0, full_scale: 1 V{as_circuit}"
        ),
        trial=False,
    )
    assert rows["rest"].rate_mu == 0.0
    assert rows["slow"].rate_mu == pytest.approx(1e-16)
    assert found.events == "11 rows of the record"


def test_a_word_that_divides_by_zero_in_every_cycle_is_a_warning():
    """Whatever its ADC sees, s - s is 0; s itself is so by chance only."""
    for divisor, warned in (("(s - s)", True), ("s", False)):
        found, _ = checked(
            "title: a\nanalog: {x: {constant: 1, full_scale: 1}}\ninterface: {s: {adc: x}}\n"
            f"digital: {{period: 1 s, program: {{w: 1/{divisor}}}}}\nrun: {{until: 2 s}}\n",
            trial=False,
        )
        told = [w for w in found.warnings if "word 'w' divides by 0 in every cycle" in w]
        assert bool(told) == warned


def test_integrators_that_stand_are_not_tested():
    """One at its limit, one that a comparator holds."""
    text = """
title: Standing
machine: nominal
analog:
  one: {constant: 1 V, full_scale: 1 V}
  high: {compare: {one: 1}, high: 1, full_scale: 1}
  full: {integrate: {one: 1 1/s}, initial: 1 V, low: -1 V, high: 1 V, full_scale: 1 V}
  kept: {integrate: {one: 1 1/s}, initial: 0 V, hold_when: high, full_scale: 1 V}
  free: {integrate: {one: 1 1/s}, initial: 0 V, full_scale: 1 V}
run: {until: 10 ms, every: 1 ms}
"""
    rows = {r.integrator: r for r in hybrid.check(hybrid.parse_patch(text), trial=False).rates}
    assert {name: row.remark for name, row in rows.items()} == {
        "free": "",
        "full": "at its limit",
        "kept": "in IC or HOLD",
    }
    assert rows["full"].shown_mu is None
    assert rows["free"].shown_mu == pytest.approx(1.0, abs=rows["free"].allowed_mu)


BENT = """
title: A corner soon after the start
machine: lags
analog:
  one: {constant: 1 V, full_scale: 1 V}
  x: {integrate: {one: 1000 1/s}, initial: 0 V, full_scale: 1 V}
  bend: {function: x, points: {-1 V: 0.5 V, AT: 0.5 V, 1 V: 1 V}, full_scale: 1 V}
  y: {integrate: {bend: 1000 1/s}, initial: 0 V, full_scale: 1 V}
run: {until: 1 ms, every: 0.1 ms}
"""


def test_the_rate_test_is_made_before_a_corner_where_there_is_time():
    """x passes a corner at 50 us, while rates are looked at from 20 to 100 us, or from 20 to 24: up to
    it y' = 500/s. At 10 us no time is left, and what passes it is told."""

    def tested(text):
        return {r.integrator: r for r in hybrid.check(hybrid.parse_patch(text), trial=False).rates}

    rows = tested(BENT.replace("AT", "50 mV"))
    assert [rows[n].remark for n in "xy"] == ["", ""]
    assert rows["y"].allowed_mu < 1.0
    assert rows["y"].shown_mu == pytest.approx(500.0, abs=rows["y"].allowed_mu)
    early = BENT.replace("AT", "10 mV")
    assert [row.remark for row in tested(early).values()] == ["bend passes a corner"] * 2
    high = "  high: {compare: {x: 1}, threshold: 5 mV, high: 1, full_scale: 1}\nrun"
    both = tested(early.replace("run", high))
    assert both["y"].remark == "a part switches or passes a corner"
    function = "bend: {function: x, points: {-1 V: 0.5 V, 10 mV: 0.5 V, 1 V: 1 V}"
    alone = tested(early.replace(function, "bend: {sum: {x: 1}").replace("run", high))
    assert alone["y"].remark == "high switches"


@pytest.mark.parametrize("machine", ["ideal", "lags", "nominal", "howe_1964", "analog_thing"])
@pytest.mark.parametrize(
    "name",
    ["pitch_loop_analog", "harmonic_oscillator", "van_der_pol", "lorenz", "relay_servo", "jerk"],
)
def test_the_rate_test_passes_machines_within_their_limits(name, machine):
    for serial in range(3):
        found = hybrid.check(name, machine=machine, serial=serial, trial=False)
        assert [row.integrator for row in found.rates if row.fails] == []


PLAYS_NOTHING = (
    """
import hybrid
from hybrid.engine import relaxation

text = """
    + repr(LEVELS)
    + """
found = hybrid.check(hybrid.parse_patch(text), trial=False)
print(found.scaling[0].value_mu, len(relaxation.advance.signatures))
"""
)


def test_values_at_the_start_do_not_take_the_engine():
    """Nothing integrates, so that no window is to be played, and what plays them is not compiled."""
    order = [sys.executable, "-c", PLAYS_NOTHING]
    done = subprocess.run(order, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0.5", "0"]
