"""The x-y plotter, on records made by hand and from the command line."""

import json

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread

from hybrid.charts.plotter import Pair, check_pairs, parse_pair, with_pens, xy_plot
from hybrid.cli import main
from hybrid.errors import HybridError, RunError
from hybrid.patchfile import parse_patch

NAN = float("nan")
CIRCLE = """
title: Circle
machine: ideal
analog:
  x: {integrate: {y: 1 rad/s}, initial: 0, full_scale: 1}
  y: {integrate: {x: -1 rad/s}, initial: 0.9, full_scale: 1}
run: {until: 7 s, every: 10 ms}
record: [x]
"""


def make_record(signals=None, rows=629, **attributes):
    """One turn of a circle, x in rad, y in rad, from 0 to 6.28 s."""
    time_s = np.arange(rows) * 0.01
    if signals is None:
        signals = {
            "x": (0.8 * np.cos(time_s), "rad", 1.0, "analog"),
            "y": (0.8 * np.sin(time_s), "rad", 1.0, "analog"),
        }
    variables = {
        name: ("time", values, {"units": units, "full_scale": scale, "kind": kind})
        for name, (values, units, scale, kind) in signals.items()
    }
    about = {"title": "Circle $1", "patch": "some/circle.yaml", "machine": "lags", "seed": 3}
    return xr.Dataset(variables, {"time": ("time", time_s)}, {**about, **attributes})


def one(figure):
    (axes,) = figure.axes
    return axes


def pen(figure):
    return next(line for line in one(figure).lines if line.get_label() == "pen")


def told(figure):
    return " ".join(text.get_text() for text in figure.texts)


class TestPaper:
    def test_axes_are_named_with_their_units(self):
        record = make_record()
        record["y"].attrs["units"] = "rad/s^2"
        axes = one(xy_plot(record, "x", "y"))
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("x, rad", "y, rad/s²")

    def test_the_frame_is_full_scale(self):
        figure = xy_plot(make_record(), "x", "y")
        axes = one(figure)
        assert axes.get_xlim() == (-1.0, 1.0) and axes.get_ylim() == (-1.0, 1.0)
        assert "of full scale" not in told(figure)

    def test_a_signal_beyond_full_scale_stays_on_the_paper(self):
        record = make_record()
        record["x"].attrs["full_scale"] = 0.5
        figure = xy_plot(record, "x", "y")
        axes = one(figure)
        assert axes.get_xlim() == (-0.8, 0.8) and "x: frame is 160 % of full scale" in told(figure)
        marks = [line.get_xdata()[0] for line in axes.lines if line.get_label() == "full scale"]
        assert {-0.5, 0.5} <= set(marks)

    def test_a_small_signal_gets_a_frame_of_its_own_and_says_so(self):
        record = make_record()
        record["y"].attrs["full_scale"] = 100.0
        figure = xy_plot(record, "x", "y")
        assert one(figure).get_ylim() == (-0.8, 0.8)
        assert "y: frame is 0.8 % of full scale" in told(figure)

    def test_one_unit_is_drawn_to_one_scale(self):
        record = make_record()
        record["y"].attrs["full_scale"] = 2.0
        figure = xy_plot(record, "x", "y")
        width, height = figure.get_size_inches()
        box = one(figure).get_position()
        assert box.height * height / (box.width * width) == pytest.approx(2.0)

    @pytest.mark.parametrize("sign", [1.0, -1.0])
    def test_a_signal_of_one_sign_has_paper_on_its_side_only(self, sign):
        """y from 0.1 to 1.9 of 2, x from -0.8 to 0.8 of 1: in one unit on a square of 2 by 2."""
        record = make_record()
        record["y"] = sign * (record["x"] / 0.8 * 0.9 + 1.0)
        record["y"].attrs |= {"units": "rad", "full_scale": 2.0, "kind": "analog"}
        figure = xy_plot(record, "x", "y")
        axes = one(figure)
        assert axes.get_xlim() == (-1.0, 1.0)
        assert axes.get_ylim() == ((0.0, 2.0) if sign > 0 else (-2.0, 0.0))
        width, height = axes.get_position().size * figure.get_size_inches()
        assert width == pytest.approx(height)
        marks = [line.get_ydata()[0] for line in axes.lines if line.get_label() == "full scale"]
        assert sign * 2.0 in marks and -sign * 2.0 not in marks
        assert "of full scale" not in told(figure)

    def test_noise_beyond_zero_asks_for_no_paper_of_its_own(self):
        record = make_record()
        record["x"] = record["x"] + 0.795  # from -0.005 on, half a hundredth of the frame
        record["x"].attrs |= {"units": "rad", "full_scale": 2.0, "kind": "analog"}
        assert one(xy_plot(record, "x", "y")).get_xlim() == (0.0, 2.0)
        record["x"] = record["x"] - 0.1
        record["x"].attrs |= {"units": "rad", "full_scale": 2.0, "kind": "analog"}
        assert one(xy_plot(record, "x", "y")).get_xlim() == (-2.0, 2.0)

    def test_title_and_provenance(self):
        text = told(xy_plot(make_record(), "x", "y"))
        assert "Circle $1" in text and "circle.yaml" in text and "some/" not in text
        assert "pen down 0 s to 6.28 s" in text

    def test_the_marks_have_a_key_and_the_parameters_a_line(self):
        figure = xy_plot(make_record(parameters='{"omega": "1 rad/s"}'), "x", "y")
        assert "○ where the pen comes down;  ● end;  red lines: full scale" in told(figure)
        assert "with  omega = 1 rad/s" in told(figure)
        small = make_record()
        small["x"].attrs["full_scale"] = small["y"].attrs["full_scale"] = 50.0  # off the paper
        assert "red lines" not in told(xy_plot(small, "x", "y"))

    def test_a_title_that_is_cut_says_so(self):
        title = xy_plot(make_record(title="A circle " * 20), "x", "y").texts[0].get_text()
        assert title.startswith("A circle A circle") and title.endswith(" …")
        assert len(title) <= 6.4 * 8.1

    def test_a_run_broken_off_says_so(self):
        record = make_record(status="stopped", status_note="x left 1e12 times full scale")
        assert "Stopped: x left 1e12" in told(xy_plot(record, "x", "y", pen_down_from_s=9.0))

    def test_equal_records_give_equal_pictures(self, tmp_path):
        from hybrid.charts import save

        pictures = [tmp_path / "a.png", tmp_path / "b.png"]
        for path in pictures:
            save(xy_plot(make_record(), "x", "y"), path)
        assert pictures[0].read_bytes() == pictures[1].read_bytes()


class TestPen:
    def test_draws_the_rows(self):
        record = make_record()
        line = pen(xy_plot(record, "x", "y"))
        assert np.isin(line.get_xdata(), record["x"].values).all()
        assert np.hypot(line.get_xdata(), line.get_ydata()) == pytest.approx(0.8)
        assert (line.get_xdata()[-1], line.get_ydata()[-1]) == (record["x"][-1], record["y"][-1])

    def test_is_up_until_told(self):
        record = make_record()
        line = pen(xy_plot(record, "x", "y", pen_down_from_s=3.0))
        assert line.get_xdata()[0] == record["x"].sel(time=3.0, method="nearest")
        assert "pen down 3 s" in told(xy_plot(record, "x", "y", pen_down_from_s=3.0))

    def test_rests_are_left_out(self):
        still = np.minimum(np.arange(100_000) * 1e-4, 1.0)
        signals = dict.fromkeys("xy", (still, "", 1.0, "analog"))
        line = pen(xy_plot(make_record(signals, rows=100_000), "x", "y"))
        assert len(line.get_xdata()) < 20_000 and line.get_xdata()[-1] == 1.0

    def test_rows_without_a_value_lift_it(self):
        record = make_record()
        record["y"].values[100:200] = NAN
        assert np.isnan(pen(xy_plot(record, "x", "y")).get_ydata()).any()
        record["y"].values[:] = NAN
        assert [t.get_text() for t in one(xy_plot(record, "x", "y")).texts] == ["no values"]

    @pytest.mark.parametrize(
        ("kinds", "drawn"),
        [
            (("analog", "analog"), "default"),
            (("analog", "word"), "steps-post"),
            (("adc", "analog"), "steps-pre"),
        ],
    )
    def test_held_signals_are_steps(self, kinds, drawn):
        record = make_record()
        for name, kind in zip("xy", kinds, strict=True):
            record[name].attrs["kind"] = kind
        assert pen(xy_plot(record, "x", "y")).get_drawstyle() == drawn

    @pytest.mark.parametrize(
        ("x", "y", "down", "said"),
        [
            ("xx", "y", 0.0, "no signal 'xx' in the record; did you mean 'x'"),
            ("x", "theta", 0.0, "no signal 'theta' in the record; valid: x, y"),
            ("x", "y", 7.0, "after the record's end at 6.28 s"),
            ("x", "y", NAN, "finite time"),
        ],
    )
    def test_mistakes(self, x, y, down, said):
        with pytest.raises(RunError, match=said):
            xy_plot(make_record(), x, y, pen_down_from_s=down)

    def test_a_record_of_one_row_or_none(self):
        for rows in (0, 1):
            signals = dict.fromkeys("xy", (np.ones(rows), "", 1.0, "analog"))
            assert len(pen(xy_plot(make_record(signals, rows=rows), "x", "y")).get_xdata()) == rows


class TestOption:
    def test_reads_pairs(self):
        assert parse_pair("x:y", "xy") == Pair("x", "y")
        assert parse_pair(" x : y : 20 ms", "xy") == Pair("x", "y", 0.02)
        assert parse_pair("x:y:0s", "xy") == parse_pair("x:y:0", "xy") == Pair("x", "y")

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("x", "must be X:Y"),
            (":y", "must be X:Y"),
            ("x:y:", "must be X:Y"),
            ("x:yy", "did you mean 'y'"),
            ("x:y:3 m", "must be a time"),
            ("x:y:-1s", r"--xy 'x:y:-1s': TIME is -1 s; it must be 0 or greater"),
            ("x:y:1s:2", r"--xy 'x:y:1s:2': TIME cannot be '1s:2': cannot read the unit"),
        ],
    )
    def test_mistakes(self, text, said):
        with pytest.raises(HybridError, match=said):
            parse_pair(text, ["x", "y"])

    def test_a_pen_that_comes_down_too_late_is_told_before_the_run(self):
        check_pairs([Pair("x", "y", 1.0)], 1.0)
        with pytest.raises(
            RunError, match=r"for x:y would come down at 1\.5 s, after the run's end at 1 s"
        ):
            check_pairs([Pair("y", "x"), Pair("x", "y", 1.5)], 1.0)

    def test_what_is_plotted_is_recorded(self):
        patch, pairs = with_pens(parse_patch(CIRCLE), ["x:y"])
        assert patch.record == ("x", "y") and pairs == (Pair("x", "y"),)
        with pytest.raises(RunError, match="twice"):
            with_pens(patch, ["x:y", "x:y:1 s"])

    def test_run_writes_the_picture(self, tmp_path, capsys):
        source = tmp_path / "circle.yaml"
        source.write_text(CIRCLE, encoding="utf-8")
        arguments = ["run", str(source), "--xy", "x:y", "--out", str(tmp_path), "--json"]
        assert main(arguments) == 0
        file = str(tmp_path / "circle_y_against_x.png")
        assert file in json.loads(capsys.readouterr().out)["files"]
        assert imread(file).shape[2] >= 3

    def test_run_says_a_mistake_before_it_runs(self, tmp_path, capsys):
        source = tmp_path / "circle.yaml"
        source.write_text(CIRCLE, encoding="utf-8")
        assert main(["run", str(source), "--xy", "x:z", "--out", str(tmp_path / "out")]) == 2
        assert "no signal 'z'" in capsys.readouterr().err and not (tmp_path / "out").exists()
