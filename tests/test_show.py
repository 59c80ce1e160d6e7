"""Tables in the terminal: nothing cut, nothing garbled, at 80 columns and at any other width."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace

import pytest
from rich.console import Console

import hybrid
from hybrid.prediction import predict
from hybrid.show import show_list, show_prediction, show_run, show_sweep, some_rows
from hybrid.show_check import show_check

PITCH_LOOPS = ("pitch_loop", "pitch_loop_analog", "pitch_loop_lead")
LONG = "a_name_that_is_as_long_as_names_may_be_or_nearly_so"


def printed(show: Callable[..., None], *facts: object, width: int = 80) -> list[str]:
    console = Console(file=io.StringIO(), width=width, highlight=False, color_system=None)
    show(console, *facts)
    assert isinstance(console.file, io.StringIO)
    return [line.rstrip() for line in console.file.getvalue().splitlines()]


@pytest.fixture(scope="module")
def patches() -> list[hybrid.patch.Patch]:
    shipped = hybrid.shipped_patches()
    return [hybrid.read_patch(shipped[name]) for name in PITCH_LOOPS]


def test_checks_of_all_shipped_patches_fit_in_80_columns() -> None:
    for file in hybrid.shipped_patches().values():
        lines = printed(show_check, hybrid.check(hybrid.read_patch(file)))
        assert not any("…" in line for line in lines)


def test_the_shipped_patches_fit_in_80_columns(patches) -> None:
    for patch in patches:
        for machine in ("ideal", "nominal"):
            if patch.program is None and machine == "nominal":
                continue
            order = {"machine": machine}
            checked = hybrid.check(patch, **order)
            lines = printed(show_check, checked)
            lines += printed(show_run, hybrid.run(patch, **order), predict(patch, **order), [])
            lines += printed(show_prediction, predict(patch, **order))
            assert max(map(len, lines)) <= 80, max(lines, key=len)
            assert not any("…" in line for line in lines)
            for row in checked.scaling:
                assert any(line.split()[:2] == [row.signal, row.kind] for line in lines)
            for pot in checked.pots:
                assert any(line.split()[:2] == [pot.component, pot.input] for line in lines)


def test_a_run_shows_whole_figures(patches) -> None:
    result, prediction = hybrid.run(patches[0]), predict(patches[0])
    lines = printed(show_run, result, prediction, ["out/a.nc"])
    zeta = next(line for line in lines if line.startswith("zeta")).split()
    assert float(zeta[1]) == pytest.approx(result.readouts["pitch_mode"]["zeta"], rel=1e-8)
    assert float(zeta[3]) == pytest.approx(prediction.modes[0].zeta, rel=1e-8)
    assert lines[-1] == "wrote out/a.nc"


@pytest.mark.parametrize("width", [20, 80, 130])
def test_no_table_is_cut(patches, width: int) -> None:
    text = patches[0].text.replace("theta_ddot", LONG)
    patch = hybrid.parse_patch(text)
    lines = printed(show_check, hybrid.check(patch), width=width)
    assert not any("…" in line for line in lines)
    row = next(line for line in lines if line.startswith(f"{LONG}  sum"))
    assert row.split() == [LONG, "sum", "100", "rad/s^2", "0", "0", "-"]


OVERDAMPED = """
title: Overdamped
machine: lags
analog:
  v: {integrate: {v: -5, x: -4}, initial: -0.0, full_scale: 10}
  x: {integrate: {v: 1}, initial: 1, full_scale: 10}
run: {until: 5 s, every: 10 ms}
readouts:
  pair: {transient: x}
  first: {final: v, until: 1 ms}
  before: {mean: x}
"""


def test_an_overdamped_measurement_stands_beside_both_poles() -> None:
    patch = hybrid.parse_patch(OVERDAMPED)
    lines = printed(show_run, hybrid.run(patch), predict(patch), [])
    for name, ideal in {"omega rad/s": 2.0, "zeta": 1.25}.items():
        found = next(line for line in lines if line.startswith(name)).removeprefix(name).split()
        measured, _, exact, shown_ideal = (float(figure) for figure in found)
        assert measured == pytest.approx(exact, rel=1e-7)
        assert shown_ideal == ideal
    assert "ideal: the real poles s = -1 and -4 1/s as one mode" in lines
    # The contract lists each pole alone.
    assert [m["omega_ideal"] for m in predict(patch).to_dicts()] == pytest.approx([1.0, 4.0])


def test_readouts_keep_their_order_and_stand_together() -> None:
    result = hybrid.run(hybrid.parse_patch(OVERDAMPED))
    assert list(result.readouts) == ["pair", "first", "before"]
    lines = printed(show_run, result, "no prediction: none asked", [])
    place = lines.index("first: final value of v = 0, at 0 s")
    assert lines[place - 1] == ""
    assert lines[place + 1].startswith("before: mean of x = ")


def test_what_is_counted_as_modes_and_how_potentiometers_are_set() -> None:
    checked = hybrid.check(hybrid.parse_patch(OVERDAMPED))
    assert "(2 modes: 2 real poles)" in checked.prediction
    pots = {(p.component, p.input): p for p in checked.pots}
    assert (pots["v", "x"].setting, pots["v", "x"].gain, pots["v", "x"].inverted) == (0.4, 10, True)
    lines = [line.split() for line in printed(show_check, checked)]
    assert ["v", "x", "0.4000", "10", "inverted", "-4"] in lines
    pitch = hybrid.check("pitch_loop")
    assert "(1 mode: 1 oscillating pair)" in pitch.prediction


def test_check_warns_of_what_is_hardly_meant() -> None:
    text = OVERDAMPED.replace("until: 1 ms", "from: 6 s, until: 7 s")
    checked = hybrid.check(hybrid.parse_patch(text, "slow.yaml"))
    assert checked.warnings == (
        "slow.yaml:10: from of readout 'first' is 6 s, after the end of the run at 5 s: "
        "no row is read",
    )
    assert any(
        line.startswith("warning: slow.yaml:10: from") for line in printed(show_check, checked)
    )
    text = OVERDAMPED.replace("until: 1 ms", "until: 7 s")
    assert hybrid.check(hybrid.parse_patch(text)).warnings[0].endswith("5 s: it is read to there")
    rare = hybrid.check(hybrid.parse_patch(OVERDAMPED.replace("every: 10 ms", "every: 6 s")))
    assert [w.split(": ", 1)[1] for w in rare.warnings] == [
        "every is 6 s, longer than the run of 5 s: the record has one row"
    ]
    result = hybrid.run(hybrid.parse_patch(OVERDAMPED.replace("every: 10 ms", "every: 6 s")))
    assert result.status_note == "a row every 6 s in a run of 5 s: the record has one row, at 0 s"
    assert result.status_note in printed(show_run, result, "", [])
    assert hybrid.run(hybrid.parse_patch(OVERDAMPED)).status_note == ""
    slow = hybrid.check("pitch_loop", {"cycle": "20 s"})
    assert [w.split(": ", 1)[1] for w in slow.warnings] == [
        "the run of 10 s is shorter than one cycle of 20 s"
    ]
    assert hybrid.check("pitch_loop").warnings == ()
    few = OVERDAMPED.replace("every: 10 ms", "every: 10 ms, max_rows: 200")
    assert hybrid.check(hybrid.parse_patch(few)).events.endswith(
        "501 rows of the record, every 3rd row kept"
    )


def test_scalar_readouts_show_their_unit(patches) -> None:
    text = patches[0].text.replace("pitch_mode: {transient: theta}", "top: {maximum: theta_dot}")
    result = hybrid.run(hybrid.parse_patch(text))
    lines = printed(show_run, result, "no prediction: none asked", [])
    value = result.readouts["top"]["value"]
    assert any(
        line.startswith(f"top: maximum of theta_dot = {value:.9g} rad/s, at ") for line in lines
    )
    assert "no prediction: none asked" in lines


def test_a_sweep_shows_its_last_point_and_its_overloads(patches) -> None:
    values = [round(1.0 + 0.1 * i, 1) for i in range(30)]
    text = patches[0].text.replace("full_scale: 1 rad}", "full_scale: 0.11 rad}")
    patch = hybrid.parse_patch(text.replace("until: 10 s", "until: 1 s"))
    result = hybrid.sweep(patch, "cycle", [v * 1e-3 for v in values], jobs=1)
    lines = printed(show_sweep, result, [], width=200)
    table = [line for line in lines if line[:1].isdigit()]
    assert table[0].split()[0] == "1"
    assert table[-1].split()[0] == "3.9"
    assert f"the table has {len(table)} of 30 points; the file has all" in lines
    over = sum(p.overloads > 0 for p in result.points)
    assert (f"{over} with overloads" in " ".join(lines)) == (over > 0)
    assert any("overloads" in line.split()[-1:] for line in lines) == (over > 0)


def test_what_holds_of_all_points_of_a_sweep_is_said_once(patches) -> None:
    patch = hybrid.parse_patch(patches[0].text.replace("until: 10 s", "until: 1 s"))
    result = hybrid.sweep(patch, "cycle", [1e-3, 2e-3, 3e-3], jobs=1)
    own = ("", "it overflowed", "it stopped")
    notes = ["; ".join(filter(None, ("no prediction: y is bent", each))) for each in own]
    points = [replace(p, note=n) for p, n in zip(result.points, notes, strict=True)]
    lines = printed(show_sweep, replace(result, points=tuple(points)), [], width=200)
    assert lines.count("no prediction: y is bent") == 1
    assert "2 points with a note, the first: it overflowed" in lines
    points = [replace(p, note="no prediction: y is bent") for p in result.points]
    lines = printed(show_sweep, replace(result, points=tuple(points)), [], width=200)
    assert "no prediction: y is bent" in lines and "with a note" not in " ".join(lines)


@pytest.mark.parametrize("count", [0, 1, 2, 11, 12, 13, 14, 30, 1000])
def test_some_rows_have_both_ends(count: int) -> None:
    rows = some_rows(count, 12)
    assert len(rows) <= 13
    assert rows == sorted(set(rows))
    assert (rows[:1], rows[-1:]) == (([0], [count - 1]) if count else ([], []))


def test_the_list_is_whole() -> None:
    files = {name: (f"Title of {name}", f"/a/{'b' * 100}/{name}.yaml") for name in ("one", "two")}
    lines = printed(show_list, files)
    assert lines[-1].split("  ")[0] == "two"
    assert lines[-1].endswith("/two.yaml")


def test_the_limit_of_the_cycle_time(patches) -> None:
    found = predict(patches[0], max_damping_error=0.01)
    line = next(x for x in printed(show_prediction, found) if "T up to" in x)
    assert float(line.split()[-2]) == pytest.approx(found.max_cycle_s, rel=1e-8)


BARELY = """
title: Barely too much
machine: {preset: ideal, saturation: 1.1}
analog:
  x: {constant: 10.0013 V, full_scale: 10 V}
  y: {constant: 1.00000012 V, full_scale: 1 V}
  z: {constant: 30 V, full_scale: 10 V}
run: {until: 1 s, every: 0.1 s}
"""


def test_an_overload_shows_by_how_much() -> None:
    """Two digits of what is beyond: 1.3 mV of 10 V, 0.12 uV of 1 V; 11 V, where z saturates."""
    lines = printed(show_run, hybrid.run(hybrid.parse_patch(BARELY)), "", [])
    for name, worst, full_scale in (
        ("x", "10.0013", "10"),
        ("y", "1.00000012", "1"),
        ("z", "11", "10"),
    ):
        cells = next(line for line in lines if line.startswith(f"{name} ")).split()
        assert (cells[2], cells[-2]) == (worst, full_scale)
        assert float(cells[-1]) == pytest.approx(1.0)  # all the run long


def test_sentences_are_whole_where_no_terminal_is(monkeypatch) -> None:
    from io import StringIO

    from hybrid.terminal import console

    monkeypatch.setattr("sys.stdout", written := StringIO())
    sentence = "no prediction: " + "a word " * 40
    console().print(sentence)
    assert written.getvalue() == f"{sentence}\n"


def test_modes_of_a_sweep_have_headings_of_their_own() -> None:
    result = hybrid.sweep("pitch_loop", "cycle", ["100 ms", "300 ms"], machine="ideal", jobs=1)
    (head,) = (line for line in printed(show_sweep, result, [], width=200) if "predicted" in line)
    told = [f"predicted mode {k} {q}" for k in (1, 2) for q in ("zeta", "omega")]
    assert re.findall(r"predicted mode \d \w+", head) == told
