"""Charts drawn from synthetic records and sweeps: what is drawn, where, and how it is labelled."""

import json
import math
import subprocess
import sys

import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from PIL import Image

from hybrid.charts import coupling_chart, save, strip_chart, style
from hybrid.charts.lanes import lane_limits
from hybrid.charts.plotter import xy_plot
from hybrid.charts.readings import readings_chart, sweep_charts
from hybrid.charts.readout_table import mode_rows
from hybrid.charts.strip import MAX_LANES
from hybrid.charts.style import broken, duration, envelope, number, round_up, unit_text
from hybrid.errors import RunError

NAN = math.nan
MAXIMUM = {"kind": "maximum", "signal": "x"}


def make_record(rows=201, signals=None, **attributes):
    """Build a record of a decaying oscillation, one row each ms."""
    time_s = np.arange(rows) * 1e-3
    theta = np.exp(-2 * time_s) * np.cos(40 * time_s)
    if signals is None:
        signals = {
            "theta": (theta, "rad", 1.0, "analog"),
            "theta_sample": (np.round(theta, 1), "rad", 1.0, "adc"),
            "moment": (-0.1 * theta, "rad/s^2", 20.0, "dac"),
            "moment_word": (-0.1 * theta, "rad/s^2", NAN, "word"),
        }
    variables = {
        name: ("time", values, {"units": units, "full_scale": full_scale, "kind": kind})
        for name, (values, units, full_scale, kind) in signals.items()
    }
    about = {
        "title": "Pitch loop",
        "patch": "some/folder/pitch_loop.yaml",
        "machine": "nominal",
        "seed": 7,
        "cycles": rows - 1,
        "cycle_s": 1e-3,
        "status": "complete",
        "status_note": "",
        "overloads": "[]",
        "parameters": json.dumps({"omega_p": "40 rad/s", "inertia": "3 kg*m^2"}),
        "rows_note": "",
    }
    coordinates = {"time": ("time", time_s, {"units": "s"})}
    return xr.Dataset(variables, coordinates, {**about, **attributes})


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.texts]


def trace(axes, name):
    return next(line for line in axes.lines if line.get_label() == name)


def levels(axes, label):
    return sorted(line.get_ydata()[0] for line in axes.lines if line.get_label() == label)


class TestLanes:
    def test_one_lane_per_signal_over_one_time_axis(self):
        figure = strip_chart(make_record())
        names = ["theta", "theta_sample", "moment", "moment_word"]
        assert [axes.get_label() for axes in figure.axes] == names
        assert {axes.get_xlim() for axes in figure.axes} == {(0.0, 0.2)}
        assert [axes.get_xlabel() for axes in figure.axes] == ["", "", "", "time, ms"]
        tops = [axes.get_position().y1 for axes in figure.axes]
        assert tops == sorted(tops, reverse=True)

    def test_ticks_stand_at_the_instants_they_name(self):
        bottom = strip_chart(make_record()).axes[-1]
        at = {label.get_text(): tick for tick, label in zip(*_ticks(bottom), strict=True)}
        assert at["20"] == pytest.approx(0.02) and at["200"] == pytest.approx(0.2)

    def test_name_unit_and_kind_stand_beside_the_lane(self):
        shown = texts(strip_chart(make_record()))
        assert {"theta", "theta_sample", "moment", "moment_word"} <= set(shown)
        for about in ("rad,  analog", "rad,  ADC", "rad/s²,  DAC", "rad/s²,  word"):
            assert about in shown

    def test_analog_is_a_line_and_the_rest_are_steps(self):
        figure = strip_chart(make_record())
        drawn = [trace(axes, axes.get_label()).get_drawstyle() for axes in figure.axes]
        assert drawn == ["default", "steps-post", "steps-post", "steps-post"]

    def test_trace_is_the_record(self):
        record = make_record()
        drawn = trace(strip_chart(record).axes[0], "theta")
        np.testing.assert_array_equal(drawn.get_xdata(), record["time"].values)
        np.testing.assert_array_equal(drawn.get_ydata(), record["theta"].values)

    def test_full_scale_is_marked_where_it_is_in_the_lane(self):
        figure = strip_chart(make_record())
        theta, _, moment, word = figure.axes
        assert levels(theta, "full scale") == [-1.0, 1.0]
        assert levels(moment, "full scale") == levels(word, "full scale") == []
        assert "full scale ±20" in texts(figure)

    def test_a_lane_with_a_scale_of_its_own_says_so(self):
        # The moment stays within 0.1 of a full scale of 20: the lane shows +-0.1, half a per cent.
        figure = strip_chart(make_record(), signals=["moment"])
        assert "lane shows 0.5 % of it" in texts(figure)
        low, high = figure.axes[0].get_ylim()
        assert low < -0.1 and 0.1 < high < 0.15

    def test_a_lane_away_from_zero_says_how_wide_it_is(self):
        # From 0.9999 to 1 of a full scale of 1: no part of the range around 0.
        record = make_record()
        record["theta"] = record["theta"].copy(data=np.linspace(0.9999, 1.0, record.sizes["time"]))
        told = [text for text in texts(strip_chart(record, signals=["theta"])) if "of it" in text]
        assert told == ["lane 0.005 % of it wide"]

    def test_one_row_has_the_axis_of_the_run(self):
        record = make_record().isel(time=[0])
        record.attrs["until_s"] = 0.02
        assert strip_chart(record).axes[-1].get_xlim() == (0.0, 0.02)

    def test_extremes_are_told(self):
        assert {"max 1", "full scale ±1"} <= set(texts(strip_chart(make_record())))

    def test_chosen_signals_in_the_order_given(self):
        figure = strip_chart(make_record(), signals=["moment", "theta"])
        assert [axes.get_label() for axes in figure.axes] == ["moment", "theta"]

    def test_unknown_signal_names_the_nearest(self):
        with pytest.raises(RunError, match=r"no signal 'thetta'.*did you mean 'theta'"):
            strip_chart(make_record(), signals=["thetta"])

    def test_record_without_time_is_refused(self):
        with pytest.raises(ValueError, match="coordinate 'time'"):
            strip_chart(xr.Dataset({"theta": ("row", [1.0])}))

    def test_many_signals_are_cut_with_a_note(self):
        wave = np.sin(np.arange(50) / 5)
        record = make_record(50, {f"x{k}": (wave, "V", 1.0, "analog") for k in range(17)})
        figure = strip_chart(record)
        assert [axes.get_label() for axes in figure.axes] == [f"x{k}" for k in range(MAX_LANES)]
        assert "12 of 17 signals are drawn." in texts(figure)


def _ticks(axes):
    return axes.get_xticks(), axes.get_xticklabels()


@pytest.mark.parametrize(
    ("values", "full_scale", "limits"),
    [
        ([-0.9, 0.5], 1.0, (-1.0, 1.0)),
        ([-0.25, 0.1], 1.0, (-1.0, 1.0)),  # a quarter of full scale is not far less
        ([-0.24, 0.1], 1.0, (-0.25, 0.25)),
        ([-1.2, 1.0], 1.0, (-1.5, 1.5)),  # beyond full scale
        ([-7.0, 7.0], NAN, (-8.0, 8.0)),  # a word without a full scale
        ([3.0, 3.0], 10.0, (-10.0, 10.0)),  # a constant
        ([0.0, 0.0], 5.0, (-5.0, 5.0)),
        ([0.0, 0.0], NAN, (-1.0, 1.0)),
        ([NAN, NAN], 2.0, (-2.0, 2.0)),
        ([], NAN, (-1.0, 1.0)),
        ([100.0, 104.0], 200.0, (100.0, 104.0)),  # a small change far from zero
        ([5e-324, 0.0], NAN, (-1.0, 1.0)),
    ],
)
def test_lane_limits(values, full_scale, limits):
    assert lane_limits(np.array(values), full_scale) == pytest.approx(limits)


class TestEnvelope:
    def test_a_one_row_spike_in_a_million_rows_is_drawn(self):
        rows, at = 1_000_000, 437_211
        values = np.sin(np.arange(rows) / 1e4)
        values[at], values[at + 1] = 1.75, -1.5
        figure = strip_chart(make_record(rows, {"x": (values, "V", 2.0, "analog")}))
        drawn = trace(figure.axes[0], "x")
        assert len(drawn.get_xdata()) <= 8000
        spike = int(np.argmax(drawn.get_ydata()))
        assert drawn.get_ydata()[spike] == 1.75 and drawn.get_xdata()[spike] == at * 1e-3
        assert drawn.get_ydata().min() == -1.5

    def test_every_column_keeps_its_extremes_and_its_ends(self):
        rng = np.random.default_rng(1)
        time, values = np.arange(60_000.0), rng.standard_normal(60_000)
        times, kept = envelope(time, values, columns=100)
        assert len(kept) <= 400
        # 60,000 rows over 59,999 s: column k begins with row ceil(599.99 k).
        starts = np.ceil(np.arange(101) * 599.99).astype(int)
        for first, last in zip(starts[:-1], [*starts[1:-1], 60_000], strict=True):
            inside = kept[(times >= first) & (times < last)]
            column = values[first:last]
            assert (inside.min(), inside.max()) == (column.min(), column.max())
            assert (inside[0], inside[-1]) == (column[0], column[-1])

    def test_rows_kept_are_rows_of_the_record(self):
        time = np.cumsum(np.random.default_rng(2).exponential(size=20_000))  # uneven
        times, kept = envelope(time, np.sin(time), columns=50)
        np.testing.assert_array_equal(kept, np.sin(times))
        assert (np.diff(times) > 0).all() and (times[0], times[-1]) == (time[0], time[-1])

    def test_short_trace_is_returned_whole(self):
        time, values = np.arange(400.0), np.ones(400)
        times, kept = envelope(time, values, columns=100)
        assert times is time and kept is values

    def test_gaps_stay_gaps(self):
        values = np.ones(50_000)
        values[20_000:30_000] = NAN
        times, kept = envelope(np.arange(50_000.0), values, columns=100)
        gap = (times > 20_500) & (times < 29_500)
        assert gap.any() and np.isnan(kept[gap]).all() and np.isfinite(kept[~gap]).any()


class TestOverloadsAndStatus:
    EVENTS = json.dumps(
        [
            {"signal": "theta", "time_s": 0.0413, "value": 1.3, "instants": 310}
            | {"duration_s": 0.0314},
            {"signal": "moment (DAC)", "time_s": 0.15, "value": 22.0, "instants": 1},
            {"signal": "theta_ddot", "time_s": 0.09, "value": 5.0, "instants": 2},
        ]
    )

    def test_marks_stand_at_the_instants(self):
        theta, sample, moment, _ = strip_chart(make_record(overloads=self.EVENTS)).axes
        assert list(trace(theta, "overload").get_xdata()) == [0.0413]
        assert list(trace(moment, "overload").get_xdata()) == [0.15]
        assert theta.texts[0].get_text() == "overload from 41.3 ms, for 31.4 ms in all"
        assert moment.texts[0].get_text() == "overload at 150 ms"
        assert not sample.texts and "overload" not in [x.get_label() for x in sample.lines]

    def test_overload_of_a_signal_without_a_lane_is_named(self):
        shown = texts(strip_chart(make_record(overloads=self.EVENTS)))
        assert "Signals not drawn: theta_ddot overload from 90 ms, 2 instants" in shown

    @pytest.mark.parametrize(
        ("status", "note", "told"),
        [
            ("interrupted", "interrupted at 0.2 s", "Interrupted at 0.2 s"),
            ("interrupted", "", "Interrupted"),
            ("stopped", "theta ran away", "Stopped: theta ran away"),
        ],
    )
    def test_a_run_that_was_broken_off_says_so_and_shows_its_end(self, status, note, told):
        figure = strip_chart(make_record(status=status, status_note=note))
        assert told in texts(figure)
        for axes in figure.axes:
            assert 0.2 in [line.get_xdata()[0] for line in axes.lines]
            assert axes.get_xlim()[1] > 0.2

    def test_heading(self):
        shown = texts(strip_chart(make_record(rows_note="every 10th row kept")))
        assert shown[0] == "Pitch loop"
        facts = "pitch_loop.yaml  ·  machine nominal  ·  seed 7  ·  T = 1 ms  ·  200 cycles"
        assert shown[1] == f"{facts}  ·  200 ms recorded  ·  every 10th row kept"
        assert shown[2] == "with  omega_p = 40 rad/s,  inertia = 3 kg·m²"

    def test_every_task_tells_its_period_or_what_starts_it(self):
        rows = [
            {"task": "catch", "period_s": None, "when": "beyond rises"},
            {"task": "inner", "period_s": 2e-3, "when": None},
            {"task": "outer", "period_s": 0.02, "when": None},
        ]
        shown = texts(strip_chart(make_record(tasks=json.dumps(rows))))
        assert "T: catch when beyond rises, inner 2 ms, outer 20 ms" in shown[1].split("  ·  ")
        one = [{"task": "program", "period_s": 2e-3, "when": None}]
        assert "T = 1 ms" in texts(strip_chart(make_record(tasks=json.dumps(one))))[1]

    def test_many_tasks_stay_on_the_paper(self):
        rows = [{"task": f"task_{i:02}_of_many", "period_s": 1e-3, "when": None} for i in range(9)]
        record = make_record(tasks=json.dumps(rows), on='{"body": "digital"}')
        shown = texts(strip_chart(record))
        assert "4 more" in " ".join(shown) and all(len(line) <= 165 for line in shown)
        assert shown[2].startswith("T: task_00_of_many 1 ms")  # a line ends between two facts

    def test_what_runs_on_the_other_machine_is_named(self):
        on = {"body": "digital", "air": "analog", "drag": "digital", "orbit": "digital"}
        record = make_record(on=json.dumps(on))
        told = "air on analog, body on digital, 2 more elsewhere"
        assert told in texts(strip_chart(record))[1].split("  ·  ")
        assert told in texts(xy_plot(record, "theta", "moment"))[1].split("  ·  ")
        assert " on " not in texts(strip_chart(make_record(on="{}")))[1]


class TestTable:
    MODE = {  # noqa: RUF012
        "omega": 9.9994169,
        "omega_damped": 9.9991357,
        "zeta": -0.00749925,
        "omega_ideal": 10.0,
        "zeta_ideal": 0.0,
        "closed_form": {"equation": "2.1", "omega": 9.99941667, "zeta": -0.0075},
    }

    def test_measured_beside_prediction_and_closed_form_to_the_digits_of_the_error(self):
        measured = {"omega": 9.99931, "omega_error": 0.00021, "zeta": -0.007502, "reason": ""}
        shown = texts(strip_chart(make_record(), {"pitch": measured}, [self.MODE]))
        for label in ("measured, pitch", "exact prediction", "closed form, Eq. 2.1", "ideal"):
            assert label in shown
        omega = ["9.99931", " ± 0.00021", "9.99942", "10.00000"]  # two digits of the error
        zeta = ["−0.00750200", "−0.00749925", "−0.00750000", "0.00000000"]  # six digits
        assert set(omega + zeta) <= set(shown)
        assert "damped frequency, rad/s" in shown

    def test_error_below_the_digits_shown_is_not_shown_as_zero(self):
        measured = {"omega": 10.0, "omega_error": 2.4e-15, "zeta": 0.0}
        shown = texts(strip_chart(make_record(), {"pitch": measured}))
        assert " ± 2.4×10⁻¹⁵" in shown

    def test_reason_and_note_are_told(self):
        readouts = {
            "a": {"omega": None, "zeta": None, "reason": "the record is constant", "note": ""},
            "b": {"omega": 4.0, "zeta": 0.1, "reason": "", "note": "read up to the overload"},
        }
        shown = texts(strip_chart(make_record(), readouts))
        assert {"the record is constant", "read up to the overload"} <= set(shown)

    def test_other_readouts_are_told_in_words(self):
        shown = texts(strip_chart(make_record(), {"height": {"minimum": -1.5, "maximum": 12.25}}))
        assert "minimum −1.5,  maximum 12.25" in shown

    def test_times_of_readouts_are_in_the_unit_of_the_time_axis(self):
        """0.0857 s of a record of 200 ms are 85.7 ms, of one of 2 s 0.0857 s."""
        top = {"top": {"value": -0.0, "time_s": 0.0857} | MAXIMUM}
        for rows, told in ((200, "at 85.7 ms"), (2001, "at 0.0857 s")):
            shown = texts(strip_chart(make_record(rows), top))
            assert f"maximum of x = 0,  {told}" in shown

    def test_readouts_without_modes_do_not_stand_under_headings_of_modes(self):
        """Only transients and modes stand between the headings and the other readouts."""
        readouts = {
            "top": {"value": 2.5, "time_s": 0.0857, "units": "rad/s"} | MAXIMUM,
            "pitch": {"omega": 9.9, "omega_error": 0.1, "zeta": 0.1},
        }
        figure = strip_chart(make_record(), readouts, [self.MODE])
        height = {text.get_text(): text.get_position()[1] for text in figure.texts}
        order = ["damping ratio ζ", "measured, pitch", "ideal", "measured, top"]
        assert sorted(order, key=height.__getitem__, reverse=True) == order
        assert height["maximum of x = 2.5 rad/s,  at 85.7 ms"] == height["measured, top"]
        alone = texts(strip_chart(make_record(), {"top": readouts["top"]}))
        assert "damping ratio ζ" not in alone and "measured, top" in alone

    def test_many_modes_are_cut_with_a_note(self):
        shown = texts(strip_chart(make_record(), prediction=[self.MODE] * 5))
        assert "exact prediction, mode 3" in shown and "and 6 more lines" in shown


class TestDegenerateRecords:
    @pytest.mark.parametrize("rows", [0, 1, 2])
    def test_constant_empty_and_non_finite(self, rows, tmp_path):
        values = (0.0, 3.7, NAN, math.inf, -1e305, 5e-324)
        signals = {f"x{value}": (np.full(rows, value), "V", 10.0, "analog") for value in values}
        signals |= {f"n{value}": (np.full(rows, value), "", NAN, "word") for value in values}
        figure = strip_chart(make_record(rows, signals))
        assert len(figure.axes) == 12
        for axes in figure.axes:
            (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
            assert math.isfinite(right - left) and right > left
            assert math.isfinite(high - low) and high > low
        save(figure, tmp_path / "chart.png")

    def test_a_lone_value_is_a_dot_and_missing_rows_are_counted(self):
        values = np.full(20, NAN)
        values[4] = 0.5
        figure = strip_chart(make_record(20, {"x": (values, "V", 1.0, "analog")}))
        assert trace(figure.axes[0], "x").get_marker() == "o"
        assert "19 rows have no value" in texts(figure)

    def test_rows_before_the_first_result_are_not_missing(self):
        """A row every millisecond: those at 0 and 1 ms are before a result at 2 ms."""
        record = make_record(20, {"w": (np.ones(20), "V", NAN, "word")})
        record["w"].attrs["first_result_s"] = 0.002
        shown = texts(strip_chart(record))
        assert "nothing before the" in shown and "first result, 2 ms" in shown
        assert not any("no value" in text for text in shown)

    def test_no_signals(self):
        figure = strip_chart(make_record(signals={}))
        assert not figure.axes and "No signals in this record." in texts(figure)


class TestWhatIsSaid:
    def test_where_rows_are_further_apart_than_cycles_the_steps_are_those_of_the_rows(self):
        """Rows 1 ms apart: at a cycle of 0.25 ms three words of four are not in the record."""
        said = "digital signals as they stand at the rows, 1 ms apart; a cycle takes 250 µs"
        assert any(said in text for text in texts(strip_chart(make_record(cycle_s=0.25e-3))))
        tasks = json.dumps([{"task": "a", "period_s": 1e-2}, {"task": "b", "period_s": 0.25e-3}])
        assert any(said in text for text in texts(strip_chart(make_record(tasks=tasks))))

    @pytest.mark.parametrize("cycle_s", [1e-3, 5e-3, NAN])
    def test_rows_that_show_every_cycle_need_no_remark(self, cycle_s):
        said = "\n".join(texts(strip_chart(make_record(cycle_s=cycle_s))))
        assert "as they stand at the rows" not in said

    def test_without_digital_signals_there_is_none(self):
        figure = strip_chart(make_record(cycle_s=1e-4), signals=["theta"])
        assert "as they stand at the rows" not in "\n".join(texts(figure))

    def test_what_follows_a_figure_is_explained_where_there_is_one(self):
        measured = {"omega": 9.9, "omega_damped": 9.8, "zeta": 0.1, "reason": "", "note": ""}
        plain = strip_chart(make_record(), {"mode": measured})
        with_error = strip_chart(make_record(), {"mode": measured | {"zeta_error": 1e-3}})
        assert not any(text.startswith("±") for text in texts(plain))
        assert sum("one standard deviation" in text for text in texts(with_error)) == 1


class TestSave:
    def test_png_shows_every_pen(self, tmp_path):
        path = save(strip_chart(make_record()), tmp_path / "chart.png")
        picture = imread(path)[..., :3]
        assert path.read_bytes().startswith(b"\x89PNG") and picture.shape[1] == 1320
        for pen in ("#0B62A4", "#B85C00", "#007A5A", "#8A4F9E"):
            color = np.array(matplotlib.colors.to_rgb(pen))
            near = np.abs(picture - color).max(axis=2) < 0.02
            # The lanes begin at pixel 237; text in the same colour stands left of them. A thin
            # sloping line is mostly blended with the paper: few of its pixels have its own colour.
            assert near[:, 300:].any(axis=0).sum() > 50

    def test_same_record_same_bytes(self, tmp_path):
        first = save(strip_chart(make_record()), tmp_path / "a.png").read_bytes()
        assert save(strip_chart(make_record()), tmp_path / "b.png").read_bytes() == first
        assert b"Software" not in first

    def test_the_file_holds_the_pixels_of_the_figure_and_its_size_in_inches(self, tmp_path):
        figure = strip_chart(make_record())
        dpi, inches = figure.dpi, figure.get_size_inches()
        path = save(figure, tmp_path / "chart.png")
        assert figure.dpi == dpi
        with Image.open(path) as picture:
            assert picture.mode == "RGB"
            assert picture.size == tuple((inches * 110).astype(int))
            assert picture.info["dpi"] == pytest.approx((110, 110), abs=0.0254)  # whole a metre
            stored = np.asarray(picture)
        figure.dpi = 110
        with style.chart_style():
            canvas = FigureCanvasAgg(figure)
            canvas.draw()
        np.testing.assert_array_equal(stored, np.asarray(canvas.buffer_rgba())[..., :3])

    def test_other_formats_are_refused(self, tmp_path):
        with pytest.raises(RunError, match=r"must end in \.png, not .*chart\.pdf"):
            save(Figure(), tmp_path / "chart.pdf")
        assert not list(tmp_path.iterdir())

    def test_settings_of_the_caller_stay(self):
        before = dict(matplotlib.rcParams)
        strip_chart(make_record())
        assert dict(matplotlib.rcParams) == before

    def test_import_brings_neither_pyplot_nor_xarray(self):
        code = (
            "import sys, hybrid.charts; print({'matplotlib.pyplot', 'xarray'} & set(sys.modules))"
        )
        told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        assert told.stdout.strip() == "set()", told.stderr


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (0.25, 4, "0.25"),
        (-12345.6, 4, "−12350"),
        (1e-5, 4, "10⁻⁵"),
        (-1e9, 4, "−10⁹"),
        (-1.5e-6, 4, "−1.5×10⁻⁶"),
        (NAN, 4, "none"),
    ],
)
def test_number(value, digits, text):
    assert number(value, digits) == text


def test_small_formats():
    assert [duration(t) for t in (2.5, 5e-4, 0.02, 0.0)] == ["2.5 s", "500 µs", "20 ms", "0 s"]
    assert [unit_text(u) for u in ("rad/s^2", "m**-1*s", "")] == ["rad/s²", "m⁻¹·s", ""]
    written_out = (
        "newton*meter/second^2",
        "kilogram",
        "meter**2",
        "parameter",
        "kilometer",
        "1/hour",
    )
    assert [unit_text(u) for u in written_out] == [
        "N·m/s²",
        "kg",
        "m²",
        "parameter",
        "kilometer",
        "1/h",
    ]
    assert broken("theta_dot") == "theta_dot"
    assert broken("second_integrator_output") == "second_\nintegrator_out…"
    assert [round_up(x) for x in (1.0, 1.1, 0.21, 99.0)] == [1.0, 1.5, 0.25, 100.0]


# -- coupling chart --------------------------------------------------------------------------------


def make_sweep(cycles_ms=(0.5, 1.0, 2.0, 5.0, 10.0), omega=10.0, **attributes):
    """Build a sweep of Eq. 2.1: zeta = -3/4 W, and measured figures that are off by a known bit."""
    cycle = np.array(cycles_ms)
    angle = omega * cycle * 1e-3

    def by_mode(values):
        return ("cycle", "mode"), np.broadcast_to(values, cycle.shape).copy()[:, None]

    def by_readout(values):
        return ("cycle", "readout"), np.broadcast_to(values, cycle.shape).copy()[:, None]

    variables = {
        "measured_zeta": by_readout(-0.75 * angle + 0.75 * angle**3 + 2e-5),
        "measured_zeta_error": by_readout(1e-5),
        "measured_omega": by_readout(omega * (1 - 7 / 12 * angle**2) - 3e-4),
        "measured_omega_error": by_readout(1e-4),
        "predicted_zeta": by_mode(-0.75 * angle + 0.75 * angle**3),
        "predicted_omega": by_mode(omega * (1 - 7 / 12 * angle**2)),
        "closed_form_zeta": by_mode(-0.75 * angle),
        "closed_form_omega": by_mode(omega * (1 - 0.6 * angle**2)),
        "zeta_ideal": by_mode(0.0),
        "omega_ideal": by_mode(omega),
    }
    coordinates = {"cycle": ("cycle", cycle, {"units": "ms"}), "readout": ["pitch"], "mode": [0]}
    about = {"title": "Pitch loop", "closed_form": "Eq. 2.1", "status": "complete"}
    return xr.Dataset(variables, coordinates, {**about, **attributes})


def line(axes, start):
    """Return the drawn curve, or the markers, whose legend text starts so."""
    handles, labels = axes.get_legend_handles_labels()
    handle = next(h for h, label in zip(handles, labels, strict=True) if label.startswith(start))
    return handle[0] if isinstance(handle, tuple) else handle


class TestCouplingChart:
    def test_panels_and_labels(self):
        figure = coupling_chart(make_sweep())
        zeta, zeta_residual, omega, omega_residual = figure.axes
        assert zeta.get_ylabel() == "damping-ratio error |ζ − ζ ideal|"
        assert omega.get_ylabel() == "relative frequency error |ω / ω ideal − 1|"
        assert [axes.get_xlabel() for axes in figure.axes] == ["", "cycle, ms", "", "cycle, ms"]
        assert zeta_residual.get_ylabel() == omega_residual.get_ylabel() == "measured − exact"
        legend = [text.get_text() for text in figure.legends[0].get_texts()]
        assert legend == ["exact prediction", "closed form, Eq. 2.1", "measured, pitch"]

    def test_curves_are_the_errors(self):
        sweep = make_sweep()
        zeta, _, omega, _ = coupling_chart(sweep).axes
        angle = 10.0 * sweep["cycle"].values * 1e-3
        exact, form, marks = (line(zeta, s) for s in ("exact", "closed", "measured"))
        np.testing.assert_allclose(exact.get_ydata(), 0.75 * angle - 0.75 * angle**3, rtol=1e-12)
        np.testing.assert_allclose(form.get_ydata(), 0.75 * angle, rtol=1e-12)
        assert form.get_linestyle() == "--" and exact.get_linestyle() == "-"
        assert marks.get_linestyle() == "None" and marks.get_marker() == "o"
        np.testing.assert_allclose(exact.get_ydata() - marks.get_ydata(), 2e-5, rtol=1e-9)
        np.testing.assert_allclose(
            line(omega, "exact").get_ydata(), 7 / 12 * angle**2, rtol=0, atol=1e-15
        )

    def test_residual_is_measured_minus_exact(self):
        _, zeta, _, omega = coupling_chart(make_sweep()).axes
        np.testing.assert_allclose(line(zeta, "measured").get_ydata(), 2e-5, rtol=1e-9)
        np.testing.assert_allclose(line(omega, "measured").get_ydata(), -3e-5, rtol=1e-9)

    def test_wide_sweep_is_logarithmic_and_narrow_is_not(self):
        for axes in coupling_chart(make_sweep((1.0, 2.0, 8.0))).axes[::2]:
            assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
        for cycles in ((1.0, 2.0, 7.9), (0.0, 5.0, 10.0), (5.0,)):
            for axes in coupling_chart(make_sweep(cycles)).axes[::2]:
                assert (axes.get_xscale(), axes.get_yscale()) == ("linear", "linear")

    def test_swept_values_are_put_in_order(self):
        axes = coupling_chart(make_sweep((10.0, 1.0, 3.0))).axes[0]
        exact = line(axes, "exact")
        np.testing.assert_array_equal(exact.get_xdata(), [1.0, 3.0, 10.0])
        assert (np.diff(exact.get_ydata()) > 0).all()

    def test_a_readout_is_compared_with_the_mode_nearest_in_frequency(self):
        other = make_sweep(omega=35.0)
        both = xr.concat([other.drop_dims("readout"), make_sweep().drop_dims("readout")], "mode")
        sweep = make_sweep().drop_dims("mode").merge(both)
        _, residual, panel, _ = coupling_chart(sweep).axes
        np.testing.assert_allclose(line(residual, "measured").get_ydata(), 2e-5, rtol=1e-9)
        colors = [line(panel, s).get_color() for s in ("exact prediction, mode 2", "measured")]
        assert colors[0] == colors[1]

    @pytest.mark.parametrize("absent", ["predicted_", "measured_"])
    def test_without_measured_or_predicted_there_is_no_residual(self, absent):
        sweep = make_sweep()
        names = [name for name in sweep if str(name).startswith(absent)]
        for case in (sweep.drop_vars(names), sweep.assign({n: sweep[n] * NAN for n in names})):
            figure = coupling_chart(case)
            assert len(figure.axes) == 2
            legend = [text.get_text() for text in figure.legends[0].get_texts()]
            gone = {"predicted_": "exact prediction", "measured_": "measured, pitch"}[absent]
            assert gone not in legend and len(legend) == 2

    def test_without_ideal_the_values_are_drawn(self):
        sweep = make_sweep()
        sweep["zeta_ideal"] *= NAN
        sweep = sweep.drop_vars("omega_ideal")
        zeta, _, omega, _ = coupling_chart(sweep).axes
        assert zeta.get_ylabel() == "damping ratio ζ"
        assert omega.get_ylabel() == "undamped frequency ω = |s|, rad/s"
        for axes, name in ((zeta, "zeta"), (omega, "omega")):
            drawn = line(axes, "measured").get_ydata()
            np.testing.assert_array_equal(drawn, sweep[f"measured_{name}"].values[:, 0])
            assert axes.get_yscale() == "linear"

    def test_only_measured(self):
        figure = coupling_chart(make_sweep().drop_dims("mode"))
        assert [axes.get_ylabel() for axes in figure.axes] == [
            "damping ratio ζ",
            "undamped frequency ω = |s|, rad/s",
        ]
        assert np.isfinite(line(figure.axes[1], "measured").get_ydata()).all()

    def test_what_is_missing_is_told(self):
        sweep = make_sweep(status="interrupted")
        sweep["status"] = ("cycle", ["complete", "failed", "complete", "complete", "stopped"])
        sweep["note"] = ("cycle", ["", "T is too short", "", "", ""])
        sweep["overloads"] = ("cycle", [0, 0, 2, 0, 1])
        sweep["predicted_zeta"][0] = 0.0  # no error at all: not on a logarithmic axis
        shown = texts(coupling_chart(sweep))
        told = "2 of 5 runs did not complete, the first at cycle = 1 ms: T is too short"
        assert told in shown and "2 of 5 runs had overloads." in shown
        assert "1 figures below the damping-ratio error |ζ − ζ ideal| axis." in shown
        assert any(text.startswith("Interrupted") for text in shown)

    def test_png(self, tmp_path):
        picture = imread(save(coupling_chart(make_sweep()), tmp_path / "sweep.png"))
        assert picture.shape[1] == 1320 and (picture[..., :3] < 0.5).any(axis=2).sum() > 1000

    def test_empty_sweep(self, tmp_path):
        save(coupling_chart(make_sweep().isel(cycle=slice(0, 0))), tmp_path / "sweep.png")

    def test_wrong_dimensions_are_refused(self):
        with pytest.raises(ValueError, match=r"one swept dimension.*none"):
            coupling_chart(make_sweep().isel(cycle=0))
        with pytest.raises(ValueError, match=r"one swept dimension.*cycle, gain"):
            coupling_chart(make_sweep().expand_dims(gain=[1.0, 2.0]))
        with pytest.raises(ValueError, match="needs numbers"):
            coupling_chart(make_sweep().assign_coords(cycle=list("abcde")))


class TestReadingsChart:
    def make(self, cycles=(4.0, 1.0, 2.0, 16.0), fuel=(8.0, 2.0, 4.0, 64.0), **about):
        """A sweep with two readouts that are no transients, values out of order."""
        count = len(cycles)
        of = {"readout": "final", "signal": "fuel"}
        variables = {
            "value_fuel": ("cycle", list(fuel), {"units": "g", **of}),
            "value_swing": ("cycle", [-1.0, NAN, 0.0, 1.0][:count], {"units": "", **of}),
            "status": ("cycle", np.array(["complete"] * count, dtype=object)),
        }
        coordinates = {"cycle": ("cycle", list(cycles), {"units": "ms"})}
        about = {"title": "Jets", "parameter": "cycle", "status": "complete", **about}
        return xr.Dataset(variables, coordinates, about)

    def test_every_readout_is_a_curve_over_the_parameter_in_order(self):
        fuel, swing = readings_chart(self.make()).axes
        np.testing.assert_array_equal(fuel.lines[0].get_xdata(), [1.0, 2.0, 4.0, 16.0])
        np.testing.assert_array_equal(fuel.lines[0].get_ydata(), [2.0, 4.0, 8.0, 64.0])
        known = np.isfinite(swing.lines[0].get_ydata())
        np.testing.assert_array_equal(swing.lines[0].get_xdata()[known], [2.0, 4.0, 16.0])
        assert (fuel.get_xlabel(), fuel.get_ylabel()) == ("cycle, ms", "fuel (final fuel), g")
        assert (fuel.get_xscale(), fuel.get_yscale(), swing.get_yscale()) == (
            "log",
            "log",
            "linear",
        )

    def test_the_window_of_a_readout_is_told_and_long_labels_are_broken(self):
        sweep = self.make()
        sweep["value_fuel"].attrs["window"] = "until 100 s"
        long = "from 12.5*the_longest_of_parameters until 100*another_long_parameter"
        sweep["value_swing"].attrs |= {"window": long, "signal": "angles.roll"}
        figure = readings_chart(sweep)
        fuel, swing = figure.axes
        assert fuel.get_ylabel() == "fuel (final fuel until 100 s), g"
        assert swing.get_ylabel().replace("\n", " ") == f"swing (final angles.roll {long})"
        figure.draw_without_rendering()
        for axes in (fuel, swing):
            box = axes.yaxis.label.get_window_extent()
            lowest, highest = 0, figure.bbox.ymax
            left = 0 if axes is fuel else fuel.get_window_extent().x1
            assert box.x0 > left and box.y0 >= lowest and box.y1 <= highest

    def test_narrow_ranges_are_even(self):
        (fuel, _) = readings_chart(self.make((1.0, 2.0, 7.0), (1.0, 2.0, 7.0))).axes
        assert (fuel.get_xscale(), fuel.get_yscale()) == ("linear", "linear")

    def test_a_sweep_without_modes_has_this_chart_alone(self, tmp_path):
        file = tmp_path / "a.png"
        alone = self.make().assign_coords(mode=[], readout=[])
        assert list(sweep_charts(alone, file)) == [file]
        both = make_sweep(parameter="cycle")
        both["value_fuel"] = ("cycle", np.arange(5.0), {"readout": "final", "signal": "fuel"})
        assert list(sweep_charts(both, file)) == [file, tmp_path / "a_readouts.png"]
        assert list(sweep_charts(make_sweep(), file)) == [file]

    def test_what_is_missing_is_told(self):
        sweep = self.make(status="interrupted")
        sweep["status"][1] = "stopped"
        sweep["value_swing"] *= NAN
        shown = texts(readings_chart(sweep))
        assert "1 of 4 runs did not complete." in shown
        assert any(text.startswith("Interrupted") for text in shown)


def test_an_overdamped_measurement_has_both_poles_in_the_table():
    modes = [
        {"omega": p, "omega_damped": 0.0, "zeta": 1.0, "omega_ideal": p, "zeta_ideal": 1.0}
        for p in (1.0, 4.0)
    ]
    measured = {"omega": 2.0, "omega_damped": 0.0, "zeta": 1.25}
    names = [row.label for row in mode_rows({"x": measured, "y": measured}, modes)]
    assert names[-2:] == ["exact, real poles as one", "ideal, real poles as one"]
    assert names.count("exact, real poles as one") == 1
    row = next(r for r in mode_rows({"x": measured}, modes) if r.label == names[-2])
    assert (row.cells["omega"][0], row.cells["zeta"][0]) == (2.0, 1.25)
    alone = mode_rows({"x": {**measured, "omega_damped": 1.0}}, modes)
    assert not any("as one" in row.label for row in alone)
