"""Before the first result: a state stands at its initial value, other words show nothing."""

import math

import numpy as np
import pytest

import hybrid
from hybrid.charts.strip import strip_chart
from hybrid.errors import PatchError

PATCH = """\
title: Falling
digital:
  period: 10 ms
  compute_time: LATE
  states: {height: {integrate: -speed, initial: 9 km}}
  program: {speed: 3 m/s, half: height/2}
run: {until: 0.1 s}
readouts: {lowest: {minimum: half}, start: {maximum: height}, slow: {minimum: speed}}
"""


def played(late, **changes):
    text = PATCH.replace("LATE", late)
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    return hybrid.run(hybrid.parse_patch(text), machine="ideal")


@pytest.mark.parametrize(("late", "first"), [("0", 0), ("4 ms", 1), ("10 ms", 1), ("25 ms", 3)])
def test_readouts_begin_with_the_first_result(late, first):
    made = played(late)
    record, readouts = made.record, made.readouts
    # The first result is of the state as it begins, and every later one of less.
    assert record["height"].values[: first + 1].tolist() == [9000.0] * (first + 1)
    assert readouts["start"]["value"] == 9000.0 and readouts["start"]["time_s"] == 0.0
    assert readouts["slow"]["value"] == 3.0
    shown = 10 - math.ceil(float(late.split()[0]) / 10)  # cycles whose result is in the last row
    assert readouts["lowest"]["value"] == pytest.approx((9000.0 - 0.03 * shown) / 2, rel=1e-15)
    assert record["half"].attrs["first_result_s"] == float(late.split()[0]) / 1000
    assert "first_result_s" not in record["height"].attrs
    assert record["half"].values[:first].tolist() == [0.0] * first
    assert np.isfinite(record["half"].values).all()


def test_a_chart_draws_nothing_before_the_first_result():
    record = played("25 ms").record
    figure = strip_chart(record)
    lanes = {axes.get_label(): axes for axes in figure.axes}
    drawn = {name: lanes[name].lines for name in ("half", "height")}
    pen = {
        name: max(lines, key=lambda line: len(line.get_xdata())) for name, lines in drawn.items()
    }
    assert np.isnan(pen["half"].get_ydata()).tolist() == [True] * 3 + [False] * 8
    assert np.isfinite(pen["height"].get_ydata()).all()


def test_a_run_without_a_result_says_so():
    made = played("10 ms", end=("until: 0.1 s", "until: 9 ms, every: 1 ms"))
    assert (
        made.readouts["slow"]["reason"]
        == "speed has no result before the end of the record at 0.009 s"
    )
    assert made.readouts["start"]["value"] == 9000.0


TASKS = """\
title: Tasks
digital:
  tasks:
    fast: {period: 10 ms, compute_time: 2 ms, program: {a: 1}JITTER}
    slow: {period: 40 ms, phase: 20 ms, compute_time: 20 ms, program: {b: 2}}
run: {until: 0.2 s, every: 1 ms}
readouts: {a: {minimum: a}, b: {minimum: b}}
"""


@pytest.mark.parametrize("jitter", ["", ", jitter: 0.5 ms"])
def test_every_task_begins_with_its_own_first_result(jitter):
    made = hybrid.run(hybrid.parse_patch(TASKS.replace("JITTER", jitter)), machine="ideal", seed=3)
    assert (made.readouts["a"]["value"], made.readouts["b"]["value"]) == (1.0, 2.0)
    first = {name: made.record[name].attrs["first_result_s"] for name in "ab"}
    for name in "ab":
        shown = made.record["time"].values[made.record[name].values != 0.0][0]
        assert 0.0 <= shown - first[name] < 1e-3 - 1e-12
    if not jitter:
        # From 20 ms on the slow one has the processor but for 2 ms in every 10.
        assert first == {"a": 2e-3, "b": pytest.approx(20e-3 + 20e-3 + 3 * 2e-3, abs=1e-15)}


def test_a_sample_shows_when_its_conversion_ends():
    text = """\
title: Sample
analog: {level: {constant: 0.5, full_scale: 1}}
interface: {seen: {adc: level, conversion_time: 3 ms}}
digital: {period: 10 ms, program: {word: seen}}
run: {until: 20 ms, every: 1 ms}
readouts: {seen: {minimum: seen}}
"""
    made = hybrid.run(hybrid.parse_patch(text), machine="ideal")
    assert made.record["seen"].attrs["first_result_s"] == 3e-3
    assert made.readouts["seen"]["value"] == 0.5 and made.readouts["seen"]["time_s"] == 3e-3


# -- what a program may come to ---------------------------------------------------------------------

SPRING = """\
title: Spring
digital:
  period: 10 ms
  compute_time: 0
  integration: euler
  states: {x: {integrate: v, initial: 1}, v: {integrate: -stiff*x, initial: 0}}
  program: {y: 0.5*x}
parameters: {stiff: 100 1/s^2}
run: {until: 5 s}
"""


def test_a_program_that_runs_away_is_told():
    # Euler's formula multiplies the amplitude by sqrt(1 + stiff T^2) a cycle: 1.005 for 100 / s^2, or
    # 1.005^250 = 3.5 in half the run; 3.3 for 1e5 / s^2, or 1e130.
    patch = hybrid.parse_patch(SPRING)
    calm = hybrid.run(patch, machine="ideal")
    assert (calm.status, calm.status_note) == ("complete", "")
    wild = hybrid.run(patch, {"stiff": 1e5}, machine="ideal")
    assert wild.status == "complete"
    assert "the program runs away: v, x, y grew more than 1e+12 times" in wild.status_note


def test_a_readout_that_looks_beyond_the_end_is_told():
    text = """
title: A decay of 1 s
machine: ideal
analog: {x: {integrate: {x: -1}, initial: 1, full_scale: 1}}
run: {until: 1 s, every: 0.1 s}
readouts: {late: {final: x, until: 2 s}, whole: {final: x, until: 1 s}}
"""
    note = hybrid.run(hybrid.parse_patch(text)).status_note
    assert note == "readouts see the run's 1 s only, not all until late 2 s"


def test_what_a_short_word_loses_is_told():
    text = SPRING.replace(
        "  period", "  words: {y: {fixed: 8, full_scale: 100}}\n  period"
    ).replace("0.5*x", "0.001")
    patch = hybrid.parse_patch(text.replace("stiff*x", "100*x"), "spring.yaml")
    told = "spring.yaml:8: the value of 'y' is 0.001, which its word holds as 0"
    assert told in hybrid.run(patch, machine="ideal").status_note
    assert told in hybrid.check(patch, machine="ideal", trial=False).warnings
    # 100 steps of 1.5625 are 0.4 % off: that is what short words are for.
    held = hybrid.parse_patch(text.replace("0.001", "50.2").replace("stiff*x", "100*x"))
    assert hybrid.check(held, machine="ideal", trial=False).warnings == ()


def test_the_largest_float32_is_named():
    text = SPRING.replace("0.5*x", "1e30*exp(50*x)").replace("stiff*x", "0*x")
    patch = hybrid.parse_patch(text.replace("  period", "  word: float32\n  period"))
    made = hybrid.run(patch, machine="ideal")
    assert (
        made.status == "stopped"
        and "a number beyond 3.4e+38, the largest float32" in made.status_note
    )
    assert "1.8e308" not in made.status_note


def test_a_value_just_beyond_a_range_is_told_in_enough_digits():
    text = """\
title: Beyond
tables: {t: {inputs: {x: 1}, values: {0: 0, 2: 1}, outside: clamp}}
digital: {period: 1 ms, program: {x: 2.00000001, y: t(x)}}
run: {until: 2 ms}
"""
    made = hybrid.run(hybrid.parse_patch(text), machine="ideal")
    assert "asked for x = 2.00000001, outside 0 to 2" in made.status_note


def test_every_method_is_named():
    with pytest.raises(PatchError, match="method is 'spline'; valid: linear, cubic"):
        hybrid.parse_patch(
            "title: a\ntables: {t: {inputs: {x: 1}, values: {0: 0, 2: 1}, method: spline}}\n"
            "digital: {period: 1 ms, program: {y: t(1)}}\nrun: {until: 1 s}\n"
        )
