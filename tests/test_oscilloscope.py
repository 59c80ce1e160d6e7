"""The oscilloscope: triggers, scales, what is drawn and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import LineCollection

import hybrid
from hybrid.charts.oscilloscope import (
    ACROSS,
    UPWARD,
    nice_division,
    oscilloscope,
    sweeps_of,
    triggers,
)
from hybrid.cli import main
from hybrid.errors import RunError


def record(rows: int = 2001, omega: float = 10.0, until_s: float = 4.0) -> xr.Dataset:
    time_s = np.linspace(0.0, until_s, rows)
    wave = 0.7 * np.sin(omega * time_s) + 0.1
    about = {"units": "rad", "full_scale": 1.0, "kind": "analog"}
    return xr.Dataset(
        {"wave": ("time", wave, about), "word": ("time", np.ones(rows), {"units": ""})},
        {"time": ("time", time_s, {"units": "s"})},
        {"title": "Wave", "patch": "wave.yaml", "machine": "ideal", "seed": 0},
    )


def beams(figure) -> list[list[np.ndarray]]:
    """Paths of each signal's sweeps, without the graticule and the glow."""
    (axes,) = figure.axes
    found = [c for c in axes.collections if isinstance(c, LineCollection)][1:]
    return [lines.get_segments() for lines in found[1::2]]


@pytest.mark.parametrize(
    ("least", "expected"),
    [(0.0, 1.0), (1.0, 1.0), (1.01, 2.0), (0.021, 0.05), (0.06, 0.1), (300.0, 500.0)],
)
def test_divisions_are_those_of_an_instrument(least: float, expected: float) -> None:
    assert nice_division(least) == pytest.approx(expected, rel=1e-15)


def test_a_wave_triggers_where_it_rises_through_its_middle() -> None:
    data = record()
    time_s, wave = data["time"].values, data["wave"].values
    sweeps = triggers(time_s, wave)
    starts_s = np.array([start_s for start_s, _ in sweeps])
    # 0.7 sin(10 t) rises through 0 at t = 2 pi k / 10; a chord between rows h apart is off by
    # omega h / 8 of h at most, and the middle between the extreme rows by (omega h / 2)^2 / 2.
    step_s = float(time_s[1])
    exact = 2 * np.pi * np.round(starts_s * 10.0 / (2 * np.pi)) / 10.0
    assert np.all(np.diff(exact) > 0.6)
    assert np.max(np.abs(starts_s - exact)) < step_s * 10.0 * step_s
    lengths = {round(end_s - start_s, 9) for start_s, end_s in sweeps}
    # Two cycles are 1.2566 s: the next scale of ten divisions is 0.2 s each.
    assert lengths == {2.0}
    assert sweeps[-1][1] <= time_s[-1]


def test_what_never_rises_twice_is_one_sweep() -> None:
    time_s = np.linspace(0.0, 1.0, 11)
    assert triggers(time_s, np.exp(-time_s)) == [(0.0, 1.0)]
    assert triggers(time_s, np.ones(11)) == [(0.0, 1.0)]


def test_sweeps_lie_upon_each_other() -> None:
    data = record()
    period_s = 2 * np.pi / 10.0
    figure = oscilloscope(
        data, ["wave", "word"], [(k * period_s, (k + 1) * period_s) for k in range(6)]
    )
    wave, word = beams(figure)
    assert len(wave) == len(word) == 6
    for path in wave:  # in divisions: 0.1 s across, 0.2 rad upward
        x, y = path.T
        assert x.min() >= -1e-9
        assert x.max() <= period_s / 0.1 + 1e-9
        assert y == pytest.approx((0.7 * np.sin(x) + 0.1) / 0.2, abs=1e-9)
    axes = figure.axes[0]
    assert axes.get_xlim() == (0, ACROSS)
    assert axes.get_ylim() == (-UPWARD / 2, UPWARD / 2)
    said = [text.get_text() for text in figure.texts[2:]]
    assert said == ["wave: 0.2 rad a division", "word: 0.5 a division"]
    assert "6 sweeps" in figure.texts[1].get_text()


def test_older_sweeps_fade() -> None:
    sweeps = [(0.1 * k, 0.1 * k + 0.1) for k in range(40)]
    (axes,) = oscilloscope(record(), ["wave"], sweeps, persistence=4.0).axes
    beam = axes.collections[-1]
    bright = beam.get_colors()[:, 3]
    assert len(bright) == 40
    assert bright[-1] == 1.0
    assert bright[-5] == pytest.approx(np.exp(-1.0))
    assert np.all(np.diff(bright) >= 0.0)
    assert bright[0] > 0.0


def test_a_record_that_ends_early_shows_what_it_has() -> None:
    figure = oscilloscope(record(until_s=1.0), ["wave"], [(0.0, 0.8), (0.8, 1.6), (1.6, 2.4)])
    assert "2 sweeps of 3" in figure.texts[1].get_text()


@pytest.mark.parametrize(
    ("signals", "sweeps", "said"),
    [
        (["wav"], [(0.0, 1.0)], "did you mean 'wave'"),
        ([], [(0.0, 1.0)], "needs a signal"),
        (["wave"], [(5.0, 6.0)], "no sweep"),
        (["wave"], [], "no sweep"),
    ],
)
def test_what_cannot_be_shown_is_refused(signals, sweeps, said: str) -> None:
    with pytest.raises(RunError, match=said):
        oscilloscope(record(), signals, sweeps)


REP_OP = """
title: Ramp
machine: ideal
analog:
  one: {constant: 1 V, full_scale: 2 V}
  x: {integrate: {one: 100 1/s}, initial: 0 V, full_scale: 2 V}
modes: {reset: 1 ms, operate: 4 ms, hold: 2 ms}
run: {until: 20 ms, every: 0.3 ms}
record: [one]
"""


def test_each_operation_is_a_sweep() -> None:
    # Neither OP nor the whole operation is a whole number of rows.
    data = hybrid.run(hybrid.parse_patch(REP_OP.replace("record: [one]\n", ""))).record
    expected = [(1e-3 + k * 7e-3, 5e-3 + k * 7e-3) for k in range(3)]
    assert np.allclose(sweeps_of(data, "x"), expected, rtol=1e-12)
    (ramp,) = beams(oscilloscope(data, ["x"], sweeps_of(data, "x")))
    assert len(ramp) == 3
    for path in ramp:  # 0.1 V/ms in divisions of 0.5 ms and 0.1 V, whenever the rows are
        assert path[:, 1] == pytest.approx(path[:, 0] * 0.5, abs=1e-9)


def test_an_operation_that_the_run_cuts_short_is_told_from_whole_ones() -> None:
    """Of 3 operations of 7 ms the last is in OP from 15 ms on: the strip chart counts 2."""
    text = REP_OP.replace("until: 20 ms", "until: 17 ms")
    for each, whole, said in (
        (text, 2, "3 sweeps, the last cut short"),
        (REP_OP, 3, "3 sweeps, lat"),
    ):
        data = hybrid.run(hybrid.parse_patch(each)).record
        assert data.attrs["operations"] == whole
        figure = oscilloscope(data, ["one"], sweeps_of(data, "one"))
        assert said in figure.texts[1].get_text()


def test_operations_that_signals_set_are_read_from_the_rows() -> None:
    data = record(rows=11, until_s=1.0)
    modes = np.array([0, 1, 1, 1, 2, 2, 0, 1, 1, 2, 0], dtype=float)
    data["mode"] = ("time", modes, {"kind": "mode"})
    assert np.allclose(sweeps_of(data, "wave"), [(0.1, 0.3), (0.7, 0.8)])


def test_the_command(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ramp.yaml").write_text(REP_OP)
    assert main(["run", "ramp.yaml", "--scope", "x, one", "--no-chart"]) == 0
    assert (tmp_path / "out" / "ramp_scope_x_one.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(xr.open_dataset("out/ramp.nc").data_vars) == ["mode", "one", "x"]
    for wrong, said in (("y", "no signal 'y'"), ("x,x", "names a signal twice"), ("", "no signal")):
        assert main(["run", "ramp.yaml", "--scope", wrong]) == 2
        assert said in capsys.readouterr().err


def test_a_run_without_an_operation_is_refused_before_it_begins(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ramp.yaml").write_text(REP_OP)
    assert main(["run", "ramp.yaml", "--scope", "x", "--until", "0.9 ms"]) == 2
    assert "before the first operation begins at 0.001 s" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["ramp.yaml"]


def test_the_plotters_pen_is_up_in_ic_and_hold() -> None:
    from hybrid.charts import xy_plot

    data = hybrid.run(hybrid.parse_patch(REP_OP.replace("record: [one]\n", ""))).record
    figure = xy_plot(data, "one", "x")
    pen = next(line for line in figure.axes[0].lines if line.get_label() == "pen")
    drawn = np.isfinite(pen.get_ydata())
    assert drawn.any()
    assert not drawn.all()
    assert "pen up in IC and HOLD" in " ".join(text.get_text() for text in figure.texts)
