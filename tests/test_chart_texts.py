"""What charts write: parameters that were set, figures that must differ, what was never played."""

import json

import numpy as np
import pytest
import xarray as xr

import hybrid
from hybrid.charts import style
from hybrid.charts.coupling import coupling_chart
from hybrid.charts.lanes import lane_limits
from hybrid.charts.readings import readings_chart
from hybrid.charts.strip import strip_chart


def texts(figure):
    figure.canvas.draw()
    found = [text.get_text() for text in figure.texts]
    for axes in figure.axes:
        found += [text.get_text() for text in axes.texts]
        found += [label.get_text() for label in (*axes.get_xticklabels(), *axes.get_yticklabels())]
    return found


def many_parameters(count=80):
    """More than two lines take; the last one was changed."""
    given = {f"parameter_{i:02}": f"{i} kg*m^2" for i in range(count)}
    return {"parameters": json.dumps(given), "changed": json.dumps([f"parameter_{count - 1:02}"])}


def test_what_was_set_stands_first_and_is_never_cut_off():
    first, *rest = style.parameter_lines(many_parameters(), 165)
    assert first == "set  parameter_79 = 79 kg·m²"
    assert len(rest) == 2
    assert rest[0].startswith("with  parameter_00 = 0 kg·m²")
    assert rest[1].endswith("…")


def test_nothing_is_called_set_where_nothing_was():
    about = many_parameters(3) | {"changed": "[]"}
    (line,) = style.parameter_lines(about, 165)
    assert line.startswith("with  parameter_00")


def test_runs_sweeps_and_batches_tell_what_was_set():
    patch, given = hybrid.read_patch("pitch_loop"), {"omega_p": 12.0, "cycle": 0.01}
    alone = hybrid.run(patch, given, until=0.2, machine="ideal").record
    assert json.loads(alone.attrs["changed"]) == ["cycle", "omega_p"]
    assert any(
        text.startswith("set  cycle = 10 ms,  omega_p = 12 rad/s")
        for text in texts(strip_chart(alone))
    )
    swept = hybrid.sweep(patch, "cycle", [0.01, 0.02], {"omega_p": 12.0}, machine="ideal").dataset
    assert json.loads(swept.attrs["changed"]) == ["omega_p"]
    assert any("set omega_p = 12 rad/s" in text for text in texts(coupling_chart(swept)))
    many = hybrid.batch(patch, {"cycle": [0.01, 0.02], "omega_p": 12.0}, machine="ideal").dataset
    assert json.loads(many.attrs["changed"]) == ["omega_p"]


def swept_readings(x, y, status="complete"):
    return xr.Dataset(
        {"value_r": (("p",), np.array(y), {"units": "g", "readout": "mean", "signal": "fuel"})},
        {"p": (("p",), np.array(x, dtype=float), {"units": "ms"})},
        {"title": "A", "parameter": "p", "status": status, "window": ""},
    )


def test_labels_of_an_axis_of_little_reach_differ():
    figure = readings_chart(swept_readings([1, 2, 3], [8.15087001, 8.15087012, 8.15087023]))
    figure.canvas.draw()
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    shown = [
        label.get_text()
        for place, label in zip(axes.get_yticks(), axes.get_yticklabels(), strict=True)
        if low <= place <= high
    ]
    assert len(set(shown)) == len(shown) >= 3


@pytest.mark.parametrize(
    ("low", "high", "digits"), [(3051.6, 3052.0, 6), (0.0, 1.0, 4), (-5, 5, 4)]
)
def test_digits_that_tell_extremes_apart(low, high, digits):
    assert style.digits_apart(low, high, 4) == digits
    assert style.number(low, digits) != style.number(high, digits)


def test_a_lane_and_the_heading_write_what_they_mean():
    time = np.array([0.0, 5000.0, 11657.0])
    record = xr.Dataset(
        {"x": ("time", np.array([3051.6, 3051.8, 3052.0]), {"units": "m", "kind": "word"})},
        {"time": time},
        {"title": "A"},
    )
    found = texts(strip_chart(record))
    assert "max 3052" in found
    assert "min 3051.6" in found
    assert any("11657 s recorded" in text for text in found)


def test_an_interrupted_sweep_is_not_joined():
    x, y = [1, 2, 8, 9], [1.0, 2.0, 3.0, 4.0]
    for status, style_of_line in (("complete", "-"), ("interrupted", "None")):
        (axes,) = readings_chart(swept_readings(x, y, status)).axes
        assert axes.lines[0].get_linestyle() == style_of_line
        assert len(axes.lines[0].get_xdata()) == 4


def test_a_point_without_a_figure_parts_the_curve():
    (axes,) = readings_chart(swept_readings([1, 2, 3], [1.0, np.nan, 3.0])).axes
    assert np.isnan(axes.lines[0].get_ydata()[1])


def test_a_label_keeps_a_number_and_its_unit_together():
    data = swept_readings([1, 2], [1.0, 2.0])
    name = "value_propellant_that_was_used_by_all"
    data = data.rename(value_r=name)
    data[name].attrs["window"] = "from 2 s until 100 s"
    (axes,) = readings_chart(data).axes
    for line in axes.get_ylabel().split("\n"):
        assert not line.startswith("s")
        assert not line.startswith("g")


@pytest.mark.parametrize(
    ("values", "full_scale", "limits"),
    [
        ([0.0, 3.9], np.nan, (0.0, 4.0)),
        ([-3.9, 0.0], np.nan, (-4.0, 0.0)),
        ([-3.9, 1.0], np.nan, (-4.0, 4.0)),
        ([0.0, 3.9], 4.0, (-4.0, 4.0)),
    ],
)
def test_a_word_of_one_sign_has_a_lane_from_zero(values, full_scale, limits):
    assert lane_limits(np.array(values), full_scale) == limits


def test_serial_numbers_of_a_machine_without_tolerances_are_said_to_be_alike():
    patch = hybrid.read_patch("pitch_loop")
    given = {"cycle": 0.1}
    alike = hybrid.batch(patch, given, machine="ideal", serial=[1, 2])
    assert "serial 1 to 2, all alike: 'ideal' has no tolerances" in alike.varied
    drawn = hybrid.batch(patch, given, machine="nominal", serial=[1, 2])
    assert "serial 1 to 2" in drawn.varied
