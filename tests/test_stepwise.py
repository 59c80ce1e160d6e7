"""Which analog signals stand still but where they jump, by kind and beside what a run records."""

import numpy as np
import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.patchfile import parse_patch
from hybrid.stepwise import stepwise_signals

TEXT = """
title: All that jumps, and what does not
machine: ideal
parameters: {slow: 0}
analog:
  fixed: {constant: 0.3, full_scale: 1}
  once: {step: 0.5, at: 0.203 s, full_scale: 1}
  again: {pulse: 0.5, at: 0.1 s, width: 0.05 s, period: 0.2 s, full_scale: 1}
  wave: {square: 0.5, period: 0.31 s, full_scale: 1}
  swing: {sine: 1, frequency: 3 Hz, full_scale: 1}
  rise: {ramp: 1 1/s, full_scale: 2}
  teeth: {sawtooth: 1, period: 0.23 s, full_scale: 1.1}
  high: {compare: {swing: 1}, high: 1, low: 0, full_scale: 1}
  late: {compare: {swing: 1}, high: 1, low: 0, full_scale: 1.01, tau: slow}
  flow: {sum: {high: 0.5, wave: 1}, full_scale: 2}
  mixed: {sum: {high: 0.5, rise: 0.1}, full_scale: 2}
  tenth: {coefficient: {flow: 0.1}, full_scale: 1}
  turned: {invert: tenth, full_scale: 1}
  both: {multiply: [flow, held], full_scale: 2}
  size: {absolute: both, full_scale: 2}
  relay: {switch: [once, again], control: high, full_scale: 1}
  blend: {switch: [once, swing], control: high, full_scale: 1}
  kept: {track: flow, control: high, full_scale: 2}
  caught: {track: swing, control: high, full_scale: 1}
  total: {integrate: {high: 1 1/s}, initial: 0, full_scale: 2}
  smooth: {lag: {high: 1}, time_constant: 1 ms, full_scale: 1}
  after: {coefficient: {late: 1}, full_scale: 1.01}
interface:
  held: {dac: word, full_scale: 2, initial: 0}
  seen: {adc: swing}
digital: {period: 50 ms, program: {word: 2*seen}}
run: {until: 1 s, every: 0.5 ms}
"""
JUMPING = {"fixed", "once", "again", "wave", "high", "late", "flow", "tenth", "turned", "both"}
JUMPING |= {"size", "relay", "kept", "after", "held"}


def test_the_kind_of_a_signal_tells():
    assert stepwise_signals(compile_patch(parse_patch(TEXT))) == JUMPING


def test_a_lag_that_rows_can_show_makes_no_steps():
    patch = parse_patch(TEXT)
    assert stepwise_signals(compile_patch(patch, {"slow": 0.4e-3})) == JUMPING
    assert stepwise_signals(compile_patch(patch, {"slow": 0.5e-3})) == JUMPING - {"late", "after"}


def test_a_loop_through_itself_may_be_anything():
    """x' = -x/tau: a sum of itself alone, which goes to zero smoothly."""
    text = """
title: A loop
machine: lags
analog:
  x: {sum: {x: 0.5, go: 1}, full_scale: 4}
  go: {step: 1, at: 0.1 s, full_scale: 1}
run: {until: 1 s, every: 1 ms}
"""
    assert stepwise_signals(compile_patch(parse_patch(text))) == {"go"}


@pytest.fixture(scope="module")
def record():
    return hybrid.run(parse_patch(TEXT)).record


def test_a_run_records_what_stands_still(record):
    """What jumps does so 42 times at most: comparators 6 times, wave 6, again 10, held 20. What moves
    does in half of the 2,000 rows or more, but `smooth`: 6 times until exp(-t/1 ms) is lost to
    rounding, 36 ms or 72 rows."""
    analog = {n for n in record.data_vars if record[n].attrs["kind"] in ("analog", "dac")}
    assert {n for n in analog if record[n].attrs["held"]} == JUMPING
    for name in analog:
        changes = int(np.count_nonzero(np.diff(record[name].values)))
        assert changes <= 42 if name in JUMPING else changes >= 400, (name, changes)
    assert record["seen"].attrs["held"] == record["word"].attrs["held"] == 1


def test_charts_draw_them_as_steps(record):
    from hybrid.charts import strip_chart
    from hybrid.charts.oscilloscope import oscilloscope
    from hybrid.charts.plotter import xy_plot

    names = ["high", "flow", "mixed", "swing", "held"]
    drawn = [
        next(line for line in axes.lines if line.get_label() == name).get_drawstyle()
        for name, axes in zip(names, strip_chart(record, signals=names).axes, strict=True)
    ]
    assert drawn == ["steps-post", "steps-post", "default", "default", "steps-post"]

    def pen(x, y):
        (axes,) = xy_plot(record, x, y).axes
        return next(line for line in axes.lines if line.get_label() == "pen").get_drawstyle()

    assert (pen("rise", "high"), pen("high", "rise")) == ("steps-post", "steps-pre")
    assert (pen("rise", "swing"), pen("high", "flow")) == ("default", "default")
    (axes,) = oscilloscope(record, ["high"], [(0.0, 0.5)]).axes
    for collection in axes.collections[1:]:
        for path in collection.get_paths():
            moved = np.diff(path.vertices, axis=0)
            assert len(moved) > 500 and np.all((moved[:, 0] == 0.0) | (moved[:, 1] == 0.0))
