"""Messages for mistakes that readers made, and what they advise."""

import pytest

import hybrid
from hybrid.errors import PatchError, Place
from hybrid.linearity import NotLinear, brief
from hybrid.patchfile import parse_patch

PATCH = """
title: A mistake
machine: ideal
parameters: {k: 4 1/s^2, rate: 2 deg/s}
analog:
  v: {integrate: {a: 1}, initial: 1 m/s, full_scale: 3 m/s}
  x: {integrate: {v: 1}, initial: 0 m, full_scale: 1 m}
  turning: {constant: 1 deg/s, full_scale: rate}
interface:
  xs: {adc: x}
  a: {dac: acc, full_scale: 2 m/s^2, initial: 0 m/s^2}
digital:
  period: 10 ms
  program: {acc: "FORMULA"}
  units: {acc: UNIT}
run: {until: 2 s}
"""


def patch_of(formula="-k*xs", unit="m/s^2"):
    return parse_patch(PATCH.replace("FORMULA", formula).replace("UNIT", unit), "mistake.yaml")


@pytest.mark.parametrize(
    ("formula", "remedy"),
    [
        ("limit(-k*xs, -1, 1)", "a parameter here, such as level: -1 m/s^2"),
        ("select(xs > 1, k*xs, 0)", "a parameter here, such as level: 1 m"),
        ("min(1, k*xs)", "a parameter here, such as level: 1 m/s^2"),
        ("-k*xs + 1 m", "1 m: a number with a unit must stand alone, so make it a parameter"),
    ],
)
def test_a_number_beside_what_has_a_unit_is_made_a_parameter(formula, remedy):
    with pytest.raises(PatchError) as told:
        patch_of(formula)
    assert remedy in str(told.value)
    assert str(told.value).startswith("mistake.yaml:")


def test_no_remedy_where_both_sides_have_a_unit():
    with pytest.raises(PatchError) as told:
        patch_of("k*xs + xs")
    assert "parameter" not in str(told.value)


def test_the_unit_of_something_else_and_one_that_is_unknown():
    with pytest.raises(PatchError, match=r"'furlong' \[m\]; it must be that of what is in m/s\^2"):
        patch_of(unit="furlong")
    with pytest.raises(PatchError, match="unknown unit 'furlnog'"):
        patch_of(unit="furlnog")


def test_a_signal_is_shown_in_the_unit_of_the_parameter_that_is_its_full_scale():
    record = hybrid.run(patch_of(), until=0.1).record
    assert record["turning"].attrs["units"] == "deg/s"
    assert record["turning"].attrs["full_scale"] == pytest.approx(2.0, rel=1e-15)
    assert record["turning"].values == pytest.approx(1.0, rel=1e-12)
    rows = {row.signal: row for row in hybrid.check("entry_probe", trial=False).scaling}
    assert rows["rotation.rate"].units == "rad/s"


def test_a_remark_names_files_without_their_folders():
    used = Place("/a/very/long/folder/two.yaml", 64)
    place = Place("/a/very/long/folder/two.yaml", 42, "alone", used)
    assert brief(NotLinear("it is so", place)) == "two.yaml:42 (part alone of line 64): it is so"
    other = Place("/a/very/long/folder/parts/one.yaml", 42, "alone", used)
    assert brief(NotLinear("so", other)) == "one.yaml:42 (part alone of two.yaml:64): so"
    assert brief(NotLinear("a clock jitters")) == "a clock jitters"


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ('"0,5",1', "x: '0,5' has a comma; write numbers with a point, such as 0.5"),
        ("0", "1 cell, but 2 headings"),
        ("0,1,2", "3 cells, but 2 headings"),
    ],
)
def test_rows_of_a_csv_file(tmp_path, rows, told):
    (tmp_path / "points.csv").write_text(f"x,v\n0,1\n{rows}\n")
    text = PATCH.replace("FORMULA", "-k*xs*t(xs)").replace("UNIT", "m/s^2")
    file = tmp_path / "mistake.yaml"
    file.write_text(text + "tables: {t: {inputs: {x: m}, file: points.csv, output: v}}\n")
    with pytest.raises(PatchError) as caught:
        hybrid.read_patch(file)
    assert told in str(caught.value)
