"""Runs that are alike are played in one go, and each gives to the last bit what it gives alone."""

from __future__ import annotations

import numpy as np
import pytest

import hybrid
from hybrid import alike, runs
from hybrid.arguments import patch_of
from hybrid.compiler import compile_patch
from hybrid.engine import series
from hybrid.errors import HybridError

# A relay servo whose stage saturates; a bound that some runs come to, and others do not.
SERVO = """
title: Servo
machine: {preset: lags, saturation: 1.05}
parameters: {gain: 1000 1/s, start: 0.5, high: 0.8}
analog:
  x: {integrate: {v: gain}, initial: start, full_scale: 1}
  v: {integrate: {relay: gain, v: -200 1/s}, initial: 0, full_scale: 1}
  relay: {compare: {x: -1}, hysteresis: 0.1, high: high, low: -0.7, full_scale: 1}
run: {until: 30 ms, every: 0.1 ms}
readouts: {top: {maximum: x}, last: {final: v}}
"""
# A program beside it, with converters that some runs overload before and after the warm-up.
LOOP = """
title: Loop
machine: {preset: lags}
parameters: {gain: 400 1/s, start: 0.5, cycle: 1 ms}
analog:
  x: {integrate: {push: gain, bent: -gain}, initial: start, full_scale: 1}
  bent: {multiply: [x, x], full_scale: 1}
interface:
  s: {adc: x, range: 0.6}
  push: {dac: u, full_scale: 1, initial: 0}
digital: {period: cycle, compute_time: 0.3*cycle, program: {u: 0.5 - 0.9*s}}
run: {until: 40.5 ms, every: 0.5 ms}
readouts: {top: {maximum: x}, word: {final: u}, mean: {mean: s, from: 5 ms}}
"""


def compiled(text: str, given: list[dict[str, float]], machine: str | None = None, serials=None):
    patch = hybrid.parse_patch(text)
    serials = serials or [None] * len(given)
    return [compile_patch(patch, g, machine, s) for g, s in zip(given, serials, strict=True)]


def together(machines, seeds=None, monkeypatch=None):
    """Results by number, and how many runs were played in a series."""
    played = []
    whole = series.Series.players

    def players(self):
        for run, player in whole(self):
            played.append(run)
            yield run, player

    monkeypatch.setattr(series.Series, "players", players)
    seeds = seeds or list(range(len(machines)))
    return dict(alike.run_each(machines, seeds)), len(played)


def alone(machine, seed):
    try:
        return hybrid.run(machine, seed=seed, readouts_only=True)
    except HybridError as error:
        return error


def assert_alike(found, expected):
    assert type(found) is type(expected)
    if isinstance(found, HybridError):
        assert str(found) == str(expected)
        return
    assert np.array_equal(found.rows, expected.rows, equal_nan=True)
    facts = "seed status status_note readouts overloads operations engine engine_error coarse_by"
    for fact in (*facts.split(), "outside", "done_ticks", "keep_every", "pens", "cycles"):
        assert getattr(found, fact) == getattr(expected, fact), fact


def check(machines, monkeypatch, in_series, seeds=None):
    results, played = together(machines, seeds, monkeypatch)
    assert played == in_series
    assert sorted(results) == list(range(len(machines)))
    seeds = seeds or range(len(machines))
    expected = [alone(m, seed) for m, seed in zip(machines, seeds, strict=True)]
    for number, one in enumerate(expected):
        assert_alike(results[number], one)
    return expected


def test_events_saturation_and_overloads(monkeypatch):
    given = [{"start": s, "gain": g} for s in (-0.9, 0.2, 0.7) for g in (300.0, 900.0)]
    found = check(compiled(SERVO, given), monkeypatch, len(given))
    assert len({len(run.overloads) for run in found}) > 1  # some have overloads, some have none


def test_what_begins_beyond_full_scale_is_told_as_alone(monkeypatch):
    text = SERVO.replace("  v: {int", "  twice: {sum: {x: 2}, full_scale: 1}\n  v: {int")
    given = [{"start": s} for s in (0.2, 0.45, 0.6, 0.3)]
    found = check(compiled(text, given), monkeypatch, 3)
    assert [any(o["time_s"] == 0.0 for o in run.overloads) for run in found] == [0, 0, 1, 0]


@pytest.mark.parametrize("reaction", ["stop", "hold"])
def test_what_an_overload_does(monkeypatch, reaction):
    text = SERVO.replace("every: 0.1 ms", f"every: 0.1 ms, on_overload: {reaction}")
    given = [{"start": s, "gain": g} for s in (-0.9, 0.2) for g in (200.0, 900.0)]
    found = check(compiled(text, given), monkeypatch, len(given))
    assert len({run.status for run in found} | {run.status_note for run in found}) > 1


def test_programs_whose_converters_are_overloaded_in_some_segments(monkeypatch):
    given = [{"start": s, "gain": g} for s in (0.3, 0.5, 0.7) for g in (-80.0, 100.0, 400.0)]
    found = check(compiled(LOOP, given), monkeypatch, len(given))
    assert len(found[0].timeline.segments) > 1
    assert 0 < sum(any("s" in o["signal"] for o in run.overloads) for run in found) < len(given)


def test_other_cycle_times_are_other_series(monkeypatch):
    given = [{"start": s, "cycle": t} for t in (1e-3, 2e-3, 0.7e-3) for s in (0.3, 0.5)]
    check(compiled(LOOP, given), monkeypatch, len(given))
    check(compiled(LOOP, given[::2]), monkeypatch, 0)  # each alone of its kind


def test_a_run_that_runs_away_or_has_no_figure_harms_no_other(monkeypatch):
    text = SERVO.replace("saturation: 1.05", "offset: 0").replace(
        "v: -200 1/s}", "v: 2*gain, odd: 1 1/s}"
    )
    text = text.replace(
        "run:",
        "  odd: {divide: [v, level], full_scale: 1}\n  level: {sum: {x: 1}, full_scale: 1}\nrun:",
    )
    given = [{"start": s, "gain": g} for s in (0.5, 0.0, -0.5) for g in (5.0, 4000.0)]
    found = check(compiled(text, given), monkeypatch, 4)
    assert [isinstance(run, HybridError) for run in found] == [0, 0, 1, 1, 0, 0]
    assert {run.status for run in found if not isinstance(run, HybridError)} == {
        "complete",
        "stopped",
    }


@pytest.mark.parametrize("preset", ["nominal", "analog_thing"])
def test_noise_is_that_of_each_run_alone(monkeypatch, preset):
    count = 5
    machines = compiled(LOOP, [{}] * count, preset, [3] * count)
    found = check(machines, monkeypatch, count, seeds=[0, 1, 7, 1, 2])
    assert found[1].readouts == found[3].readouts != found[2].readouts


def test_serial_numbers(monkeypatch):
    text = LOOP.replace("preset: lags", "preset: lags, tolerance: 1e-3, offset_limit: 1e-3")
    found = check(compiled(text, [{}] * 4, None, [0, 1, 2, 3]), monkeypatch, 4)
    assert len({run.readouts["mean"]["value"] for run in found}) == 4


def test_other_leaks_are_other_laws(monkeypatch):
    text = LOOP.replace("preset: lags", "preset: lags, leak_limit: 1 1/s")
    serials = [0, 1, 0, 1, 2]
    found = check(
        compiled(text, [{"gain": g} for g in (100.0, 200.0) * 2] + [{}], None, serials),
        monkeypatch,
        4,
    )
    assert len({run.readouts["mean"]["value"] for run in found}) == 3


# Whatever of a hybrid patch is a figure: levels of sources, converters, constants of the program.
FIGURES = """
title: Figures
machine: {preset: lags, leak_limit: 0}
parameters:
  {k: 0.5, level: 0.3, at: 5 ms, range: 0.6, scale: 1, first: 0, tau: 1e-6, noise: 0, slow: 10 ms}
analog:
  x: {integrate: {push: 400 1/s, bent: -400 1/s, jump: 100 1/s}, initial: 0.2, full_scale: 1, tau: tau}
  bent: {multiply: [x, x], full_scale: 1, noise: noise}
  jump: {step: level, at: at, full_scale: 1}
  late: {lag: {bent: 1}, time_constant: slow, full_scale: 1}
interface:
  s: {adc: x, range: range}
  push: {dac: u, full_scale: scale, initial: first}
digital: {period: 1 ms, program: {u: k - 0.9*s}}
run: {until: 20.5 ms, every: 0.5 ms}
readouts: {top: {maximum: x}, word: {final: u}, mean: {mean: late}}
"""


@pytest.mark.parametrize(
    ("parameter", "values"),
    [
        ("k", np.linspace(0.3, 0.6, 21)),
        ("level", np.linspace(-0.3, 0.3, 21)),
        ("range", np.linspace(0.1, 0.3, 21)),
        ("scale", np.linspace(0.4, 1.0, 21)),
        ("first", np.linspace(-0.5, 0.5, 21)),
    ],
)
def test_figures_of_converters_sources_and_programs(monkeypatch, parameter, values):
    """More of them than any cache keeps."""
    clips = "nominal" if parameter == "range" else None
    machines = compiled(FIGURES, [{parameter: value} for value in values], clips)
    found = check(machines, monkeypatch, len(values), seeds=[1] * len(values))
    assert len({run.readouts["mean"]["value"] for run in found}) > len(values) // 2


@pytest.mark.parametrize("parameter", ["at", "tau", "noise", "slow"])
def test_times_and_noise_are_no_figures(monkeypatch, parameter):
    values = {"at": [3e-3, 7e-3], "tau": [1e-6, 2e-6], "noise": [1e-3, 2e-3], "slow": [5e-3, 1e-2]}
    machines = compiled(FIGURES, [{parameter: v} for v in values[parameter] * 2])
    found = check(machines, monkeypatch, 4, seeds=[0, 0, 0, 0])
    assert found[0].readouts != found[1].readouts and found[0].readouts == found[2].readouts


def test_noise_over_corners_is_measured_for_each(monkeypatch):
    text = SERVO.replace("saturation: 1.05", "noise: 3e-2, saturation: 1.05")
    machines = compiled(text.replace("30 ms", "3 ms"), [{"start": s} for s in (0.2, 0.5, 0.9)])
    check(machines, monkeypatch, 3)


@pytest.mark.parametrize("name", ["bouncing_ball", "shooting", "relay_servo", "jet_control"])
def test_shipped_patches(monkeypatch, name):
    patch = patch_of(name)
    varied = {
        "bouncing_ball": {"zeta": [0.02, 0.05, 0.1]},
        "shooting": {"gain": [0.3, 0.4, 0.5]},
        "relay_servo": {"T": [0.08, 0.1, 0.12]},
        "jet_control": {"roll_start": [0.005, 0.01, 0.012]},
    }[name]
    ((parameter, values),) = varied.items()
    machines = [compile_patch(patch, {parameter: value}) for value in values]
    check(machines, monkeypatch, 3)


def test_a_first_run_that_cannot_begin_stops_no_other(monkeypatch):
    text = SERVO.replace("run:", "  odd: {divide: [v, x], full_scale: 1}\nrun:")
    given = [{"start": s} for s in (0.0, 0.0, 0.5, 0.3, 0.0, 0.2)]
    found = check(compiled(text, given), monkeypatch, 3)
    assert [isinstance(run, HybridError) for run in found] == [1, 1, 0, 0, 1, 0]


MODES = """
title: Modes
machine: lags
parameters: {rate: 1000 1/s, level: 0.5, first: 0.1}
analog:
  x: {integrate: {one: rate}, initial: kept, full_scale: 2}
  one: {constant: 0.4, full_scale: 1}
  high: {compare: {x: 1}, threshold: level, high: 1, low: 0, full_scale: 1}
  store: {track: x, control: operating, initial: first, full_scale: 2}
  kept: {track: store, control: holding, initial: first, full_scale: 2}
modes: {reset: 0.1/rate, operate: 1/rate, hold: 0.1/rate, operations: 3, hold_when: high}
run: {until: 4/rate, every: 0.05/rate}
readouts: {last: {final: x}}
"""


def test_modes(monkeypatch):
    given = [{"level": level, "first": f} for level in (0.45, 0.9, 3.0) for f in (0.0, 0.2)]
    found = check(compiled(MODES, given), monkeypatch, len(given))
    assert len({run.readouts["last"]["value"] for run in found}) > 3


def test_what_is_done_rises_to_1_however_long_the_run(monkeypatch):
    text = SERVO.replace("gain: 1000 1/s", "gain: 1e-3 1/s").replace("-200 1/s", "-2e-4 1/s")
    text = text.replace("until: 30 ms, every: 0.1 ms", "until: 30000 s, every: 5 s")
    machines, seen = compiled(text, [{"start": s} for s in np.linspace(0.1, 0.9, 50)]), []
    results = dict(alike.run_each(machines, [0] * 50, seen.append))
    assert all(run.status == "complete" for run in results.values())
    assert seen == sorted(seen) and len(seen) > 3 and seen[0] > 0.0 and seen[-1] == 1.0


def test_an_interrupt_while_a_run_is_read_out_is_no_result_and_keeps_the_others(monkeypatch):
    machines = compiled(SERVO, [{"start": s} for s in np.linspace(0.1, 0.9, 6)])
    calls, whole = [], runs.read_out

    def read_out(result):
        calls.append(result)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return whole(result)

    monkeypatch.setattr(runs, "read_out", read_out)
    seen = []
    with pytest.raises(KeyboardInterrupt):
        for number, run in alike.run_each(machines, [0] * 6):
            seen.append(number)
            assert run.status == "complete"
    assert seen == [0, 1, 3, 4, 5]


def test_interrupted_series_gives_what_was_complete():
    machines = compiled(SERVO, [{"start": s} for s in np.linspace(0.1, 0.9, 6)], "nominal")
    seen = []

    def after_some(done):
        if done >= 0.6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        for number, run in alike.run_each(machines, list(range(6)), after_some):
            seen.append(number)
            assert_alike(run, alone(machines[number], number))
    assert seen == [0, 1, 2]
