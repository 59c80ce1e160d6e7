"""Overloads of linear patches between the instants at which they are sampled, latched and recorded."""

import logging
import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

import hybrid
from hybrid.engine import exact
from hybrid.engine.ladder import (
    bounds_of_changes,
    bounds_of_rates,
    ladder_of,
    rungs_for,
    shortest_s,
)

SWING = """
title: Swing
machine: ideal
parameters: {{every: 31.4 ms}}
analog:
  v: {{integrate: {{x: -200}}, initial: 1.5, full_scale: 2}}
  x: {{integrate: {{v: 200}}, initial: 0, full_scale: {scale}}}
run: {{until: 31.4 ms, every: every{more}}}
"""


@pytest.mark.parametrize("every", ["31.4 ms", "10.3 ms", "0.1 ms", "3 us"])
def test_first_worst_and_duration_do_not_depend_on_the_instants(every):
    """x = 1.5 sin(200 t): beyond from asin(2/3)/200 on, for (pi - 2 asin(2/3))/200 in each half."""
    patch = hybrid.parse_patch(SWING.format(scale=1, more=""))
    (found,) = hybrid.run(patch, {"every": every}).overloads
    enters_s = math.asin(2 / 3) / 200
    # Everything but rounding is exact, but for where it turns: there it is as flat as WORST_WITHIN lets.
    assert found["time_s"] == pytest.approx(enters_s, rel=1e-12)
    assert found["value"] == pytest.approx(1.0, rel=1e-11)
    assert abs(found["worst_value"]) == pytest.approx(1.5, abs=1.1e-9)
    tops_s = np.array([0.5, 1.5]) * math.pi / 200
    flat_s = math.sqrt(2 * 1.1e-9 / 1.5) / 200
    assert np.min(np.abs(found["worst_time_s"] - tops_s)) < flat_s
    duration_s = 2 * (math.pi - 2 * math.asin(2 / 3)) / 200
    assert found["duration_s"] == pytest.approx(duration_s, rel=1e-11)


def test_a_signal_that_stays_within_is_none():
    """1.5 of 1.5000001: near full scale, and never beyond."""
    patch = hybrid.parse_patch(SWING.format(scale=1.5000001, more=""))
    assert not hybrid.run(patch).overloads


def test_to_look_between_changes_no_bit_of_the_run():
    """Full scales twice as large make machine units exactly half as large, and nothing is looked at."""
    patch = hybrid.parse_patch(PLANT)
    near, far = (hybrid.run(patch, {"scale": scale}, seed=3) for scale in ("1", "4"))
    assert near.overloads and not far.overloads
    np.testing.assert_array_equal(near.rows, far.rows)


PLANT = """
title: A loop over the converters, with everything that the exact engine plays
machine: {preset: lags, noise: 1e-4/scale}
parameters: {scale: 1, T: 5 ms, every: 20 ms, tau: 1 us}
analog:
  push: {step: 0.7, at: 33 ms, full_scale: scale}
  y: {integrate: {v: 1}, initial: 0.3, full_scale: scale}
  v: {integrate: {answer: 900, y: -900, push: 900}, initial: 0, full_scale: 10*scale}
  both: {sum: {y: 0.5, answer: 0.5}, full_scale: scale}
interface:
  s: {adc: y}
  answer: {dac: word, full_scale: scale, initial: 0}
digital:
  period: T
  compute_time: T
  program: {word: 0.3*s}
run: {until: 0.4, every: every}
record: [y, v, both, word]
"""


def test_a_sampled_loop_tells_the_same_as_with_rows_in_between():
    """The loop does not know of the record; rows every 10 us show the same as the cycles alone."""
    patch = hybrid.parse_patch(PLANT)
    seldom, often = (
        hybrid.run(patch, {"every": every}, machine="lags") for every in ("20 ms", "10 us")
    )
    assert [o["signal"] for o in seldom.overloads] == [o["signal"] for o in often.overloads]
    assert {o["signal"] for o in seldom.overloads} >= {"y", "v"}
    for one, other in zip(seldom.overloads, often.overloads, strict=True):
        assert one["time_s"] == pytest.approx(other["time_s"], abs=1e-12)
        assert one["worst_value"] == pytest.approx(other["worst_value"], rel=1.1e-9)
        if one["signal"] != "s":  # a converter looks at instants alone
            assert one["duration_s"] == pytest.approx(other["duration_s"], abs=1e-11)
        assert one["instants"] <= other["instants"]


def test_it_agrees_with_the_nonlinear_engine():
    """Whose windows are resolved to some 1e-8 of full scale."""
    patch = hybrid.parse_patch(PLANT)
    exact, windows = (
        hybrid.run(patch, machine="lags", engine=engine) for engine in ("exact", "nonlinear")
    )
    for one, other in zip(exact.overloads, windows.overloads, strict=True):
        assert one["signal"] == other["signal"]
        # y passes at more than 1 a second, v at more than 30 a second.
        assert one["time_s"] == pytest.approx(other["time_s"], abs=4e-8)
        assert one["worst_value"] == pytest.approx(other["worst_value"], rel=2e-8)
        assert one["duration_s"] == pytest.approx(other["duration_s"], abs=4e-7)


def test_an_overshoot_within_microseconds_of_a_step_is_seen():
    """Two lags of 1 us, fed back: s^2 + 2 s + 1 + g in 1/us overshoots within microseconds of the step.

    zeta = 1/sqrt(1 + g), damped frequency sqrt(g)/us: the first top is at pi/sqrt(g) us, by
    exp(-pi/sqrt(g)) of the final value g/(1 + g), and every instant is milliseconds away.
    """
    patch = hybrid.parse_patch(
        """
title: A fast loop
machine: ideal
analog:
  jump: {step: 0.9, at: 1 ms, full_scale: 1}
  first: {lag: {jump: 9, second: -9}, time_constant: 1 us, full_scale: 10}
  second: {lag: {first: 1}, time_constant: 1 us, full_scale: 1}
run: {until: 10 ms, every: 2 ms}
"""
    )
    (found,) = hybrid.run(patch).overloads
    final = 0.9 * 0.9
    assert found["signal"] == "second" and found["instants"] == 0
    assert found["worst_value"] == pytest.approx(final * (1 + math.exp(-math.pi / 3)), abs=1.1e-9)
    assert found["worst_time_s"] - 1e-3 == pytest.approx(math.pi / 3 * 1e-6, abs=1e-10)


def test_on_overload_stop_ends_at_the_first_of_them():
    """The run ends before the instant that follows; what is told is when the signal passed."""
    patch = hybrid.parse_patch(SWING.format(scale=1, more=", on_overload: stop"))
    result = hybrid.run(patch, {"every": "3 ms"})
    (found,) = result.overloads
    enters_s = math.asin(2 / 3) / 200  # 3.65 ms
    assert result.status == "stopped" and f"{enters_s:.9g} s" in result.status_note
    assert found["time_s"] == pytest.approx(enters_s, rel=1e-12)
    assert result.time_s[-1] == pytest.approx(3e-3)


@pytest.mark.parametrize("every", ["30 ms", "1 ms", "10 us"])
def test_nothing_is_told_of_what_would_have_been_after_the_stop(every):
    """x goes on to 1.5, and a lag behind it beyond full scale, before the next row of the first two."""
    text = SWING.format(scale=1, more=", on_overload: stop")
    text = text.replace("run:", "  y: {lag: {x: 1}, time_constant: 0.1 ms, full_scale: 1}\nrun:")
    result = hybrid.run(hybrid.parse_patch(text), {"every": every})
    (found,) = result.overloads
    assert found["signal"] == "x" and found["time_s"] == pytest.approx(math.asin(2 / 3) / 200)
    assert (found["worst_value"], found["duration_s"]) == (pytest.approx(1.0, rel=1e-11), 0.0)


@pytest.mark.parametrize("every", ["7.3 ms", "10 ms", "1 ms"])
def test_what_rests_at_full_scale_or_touches_it_is_none(every):
    """By rounding it stands a spacing of floats above."""
    patch = hybrid.parse_patch(
        f"""
title: At rest
machine: lags
analog:
  one: {{constant: 1, full_scale: 1}}
  rests: {{lag: {{one: 1}}, time_constant: 1 ms, initial: 0, full_scale: 1}}
  sq: {{square: 1, period: 0.2 s, full_scale: 1, tau: 0}}
  touches: {{integrate: {{sq: 20}}, initial: -1, full_scale: 1, tau: 0}}
run: {{until: 1 s, every: {every}, on_overload: stop}}
"""
    )
    result = hybrid.run(patch)
    assert result.status == "complete" and not result.overloads


def test_long_runs_are_looked_at_in_pieces():
    """12,800 intervals: some 3 pieces; every turn of the circle is as long beyond as the others."""
    patch = hybrid.parse_patch(SWING.format(scale=1, more=""))
    turns = 40
    until = f"{turns}*2*pi/200"
    text = SWING.format(scale=1, more="").replace("until: 31.4 ms", f"until: {until}")
    patch = hybrid.parse_patch(text)
    (found,) = hybrid.run(patch, {"every": f"{math.pi / 100 / 320} s"}).overloads
    each_s = 2 * (math.pi - 2 * math.asin(2 / 3)) / 200
    assert found["duration_s"] == pytest.approx(turns * each_s, rel=1e-9)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), lags=st.booleans(), share=st.floats(1e-3, 1.0))
def test_no_signal_leaves_its_chord_by_more_than_the_bounds(seed, lags, share):
    """Against matrix exponentials at points packed where lags act, and evenly."""
    draw = np.random.default_rng(seed)
    n, m, k = 4, 2, 3
    a, b, c = (draw.normal(size=shape) for shape in ((n, n), (n, m), (k, n + m)))
    if lags:
        a[2:], b[2:] = a[2:] * 1e3, b[2:] * 1e3
        a[2, 2], a[3, 3] = -2e3, -3e3
    whole_s = share * 1.5
    analog = SimpleNamespace(a=a, b=b, c=c)
    ladder = ladder_of(analog, shortest_s(analog, whole_s), rungs_for(analog, whole_s))
    of_rates, of_changes = (
        bounds(analog, ladder, np.array([whole_s]))[0]
        for bounds in (bounds_of_rates, bounds_of_changes)
    )
    block = np.vstack([np.hstack([a, b]), np.zeros((m, n + m))])
    z = draw.normal(size=n + m)
    times_s = np.concatenate(
        [np.geomspace(1e-6 * whole_s, whole_s, 60), whole_s * np.arange(0, 1, 0.03)]
    )
    y = np.array([c @ expm(block * t) @ z for t in times_s])
    end = expm(block * whole_s) @ z
    chord = c @ z + np.outer(times_s / whole_s, c @ (end - z))
    apart = np.max(np.abs(y - chord), axis=0)
    rounding = 1e-11 * np.max(np.abs(y))
    assert np.all(apart <= of_rates @ np.abs(ladder.rate @ z) + rounding)
    assert np.all(apart <= of_changes @ np.abs(end - z)[:n] + rounding)


def test_what_is_compiled_on_the_way_is_told_once(monkeypatch, caplog):
    monkeypatch.setattr(exact.kernel, "is_compiled", lambda *_: False)
    monkeypatch.setattr(logging.getLogger("hybrid"), "propagate", True)
    exact._tell_of_compiling.cache_clear()
    patch = hybrid.parse_patch(SWING.format(scale=1, more=""))
    with caplog.at_level(logging.INFO, logger="hybrid"):
        hybrid.run(patch)
        assert caplog.records[0].getMessage().startswith("compiling what looks between")
        caplog.clear()
        hybrid.run(patch)
        assert not caplog.records
