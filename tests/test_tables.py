"""Look-up tables: against SciPy, in whole runs, and every mistake in them."""

import hashlib
import json
import math

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

from hybrid.cli import main
from hybrid.engine.helper_functions import PER_SITE
from hybrid.engine.lookup import look_up, new_places, pack
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch, read_patch
from hybrid.runs import run
from hybrid.tables import CLAMPS, CONTINUES, METHODS, Axis, Table

GRIDDED = METHODS[:2]
EPS = np.finfo(float).eps


def asker(table):
    """The compiled look-up as a function of the arguments, with a memory of its own."""
    packed = pack(table.axes, [(table, range(len(table.axes)))])
    places, notes = new_places(packed[1]), np.zeros((PER_SITE + 1, 6))

    def ask(*arguments):
        held = np.array(arguments, dtype=float)
        return look_up(held, 0, 0, *packed, *places, notes)

    return ask


def random_table(rng, variables, method, fewest=4, outside=CLAMPS):
    counts = [int(rng.integers(fewest, 9)) for _ in range(variables)]
    grids = [np.cumsum(rng.uniform(0.1, 2.0, n)) - 3.0 for n in counts]
    values = rng.normal(size=counts)
    # Flat stretches and equal slopes, where monotone cubics have their special cases.
    values.flat[:: max(values.size // 7, 1)] = 0.5
    values.flat[1 :: max(values.size // 7, 1)] = 0.5
    axes = [Axis(f"x{i}", g, (g[0], g[-1]), outside, outside) for i, g in enumerate(grids)]
    return Table("t", tuple(axes), values, method), grids, values


@pytest.mark.parametrize("variables", [1, 2, 3, 4])
@pytest.mark.parametrize("method", GRIDDED)
def test_the_compiled_look_up_is_scipys(variables, method):
    rng = np.random.default_rng([variables, len(method)])
    for _ in range(12 if variables < 4 else 4):
        table, grids, values = random_table(rng, variables, method)
        scipys = {"linear": "linear", "cubic": "pchip"}[method]
        expected = RegularGridInterpolator(grids, values, method=scipys)
        ask = asker(table)
        for _ in range(60):
            point = [
                rng.choice(g) if rng.random() < 0.3 else rng.uniform(g[0], g[-1]) for g in grids
            ]
            # Some dozen roundings of numbers of the size of the largest value, along each variable.
            bound = 8 * variables * EPS * np.max(np.abs(values))
            assert abs(ask(*point) - expected(point).item()) <= bound


@pytest.mark.parametrize("count", [2, 3, 4, 30])
def test_cubics_of_few_points(count):
    rng = np.random.default_rng(count)
    for _ in range(20):
        x, y = np.cumsum(rng.uniform(0.1, 1.0, count)), np.cumsum(rng.normal(size=count))
        ask = asker(Table("t", (Axis("x", x, (x[0], x[-1])),), y, "cubic"))
        expected = PchipInterpolator(x, y)
        for asked in (*rng.uniform(x[0], x[-1], 40), *x):
            assert abs(ask(asked) - expected(asked)) <= 8 * EPS * np.max(np.abs(y))


def test_a_cubic_is_monotone_where_its_points_are():
    # Fritsch and Carlson's example, SIAM J. Numer. Anal. 17 (1980): RPN 14, which splines overshoot.
    x = np.array([7.99, 8.09, 8.19, 8.7, 9.2, 10, 12, 15, 20])
    y = np.array(
        [0, 2.76429e-5, 4.37498e-2, 0.169183, 0.469428, 0.943740, 0.998636, 0.999919, 0.999994]
    )
    ask = asker(Table("t", (Axis("x", x, (x[0], x[-1])),), y, "cubic"))
    found = [ask(a) for a in np.linspace(7.99, 20.0, 5000)]
    assert np.all(np.diff(found) >= -EPS)
    assert found[0] == 0.0
    assert found[-1] == 0.999994


def test_breakpoints_are_met_exactly_and_history_changes_nothing():
    rng = np.random.default_rng(8)
    for method in GRIDDED:
        table, (x,), y = random_table(rng, 1, method, fewest=8)
        ask = asker(table)
        forwards = [ask(a) for a in x]
        assert forwards == y.tolist()
        asked = rng.uniform(x[0], x[-1], 300)
        # From whatever interval the search begins, the answer is that of a fresh one.
        assert [ask(a) for a in asked] == [asker(table)(a) for a in asked]
    assert np.isnan(ask(np.nan))


def test_beyond_the_ends():
    x, y = np.array([0.0, 1.0, 3.0]), np.array([1.0, 2.0, 8.0])
    for method, slopes in (("linear", (1.0, 3.0)), ("cubic", None)):
        clamped = asker(Table("t", (Axis("x", x, (0.0, 3.0), CLAMPS, CLAMPS),), y, method))
        assert (clamped(-5.0), clamped(9.0), clamped(np.inf)) == (1.0, 8.0, 8.0)
        free = asker(Table("t", (Axis("x", x, (0.0, 3.0), CONTINUES, CONTINUES),), y, method))
        if slopes is None:
            slopes = PchipInterpolator(x, y).derivative()([0.0, 3.0])
        assert free(-2.0) == pytest.approx(1.0 - 2.0 * slopes[0], rel=1e-15)
        assert free(5.0) == pytest.approx(8.0 + 2.0 * slopes[1], rel=1e-15)
    rng = np.random.default_rng(3)
    table, grids, values = random_table(rng, 3, "linear", outside=CONTINUES)
    expected = RegularGridInterpolator(grids, values, bounds_error=False, fill_value=None)
    for _ in range(50):
        point = [rng.uniform(g[0] - 1.0, g[-1] + 1.0) for g in grids]
        assert asker(table)(*point) == pytest.approx(expected(point).item(), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("method", GRIDDED)
@pytest.mark.parametrize("variables", [1, 2, 3, 4])
def test_far_beyond_the_ends_it_goes_straight_on(method, variables):
    """Of equal values nothing else is ever made, and a straight function is met to rounding."""
    grid = np.array([0.0, 1.0, 3.0])
    axes = tuple(Axis(f"x{i}", grid, (0.0, 3.0), CONTINUES, CONTINUES) for i in range(variables))
    slopes = np.array([2.0, -3.0, 5.0, 7.0])[:variables]
    places = np.stack(np.meshgrid(*[grid] * variables, indexing="ij"), axis=-1)
    flat = asker(Table("t", axes, np.full([3] * variables, 7.0), method))
    sloping = asker(Table("t", axes, places @ slopes + 1.0, method))
    for far in (1e6, -1e6, 1e12, 1e17, -1e300):
        assert flat(*[far] * variables) == 7.0
        for i in range(variables):
            one = np.where(np.arange(variables) == i, far, 0.5)
            parts = one * slopes
            expected = parts.sum() + 1.0
            assert sloping(*one) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("method", GRIDDED)
@pytest.mark.parametrize("variables", [2, 3, 4])
def test_the_corners_and_one_number_that_is_none(method, variables):
    """Exactly at the edges, of two breakpoints each, and NaN in any one place."""
    grid = np.array([-1.0, 2.0])
    axes = tuple(Axis(f"x{i}", grid, (-1.0, 2.0)) for i in range(variables))
    values = np.random.default_rng(variables).normal(size=[2] * variables)
    ask = asker(Table("t", axes, values, method))
    for corner in np.ndindex(*values.shape):
        assert ask(*grid[list(corner)]) == values[corner]
        for i in range(variables):
            place = grid[list(corner)]
            place[i] = np.nan
            assert np.isnan(ask(*place))


# --- in a patch -----------------------------------------------------------------------------------

PATCH = """\
title: Tables
parameters: {step: 1000 ft}
tables:
  drag: {inputs: {mach: 1}, values: {0: 0.1, 0.8: 0.1, 1.2: 0.3}, outside: clamp}
  thrust:
    inputs: {mach: 1, height: ft}
    unit: lbf
    method: cubic
    outside: extrapolate
    values:
      0: {0: 1000, 10000: 600, 6 km: 1 kN}
      1: {0: 1200, 10000: 800, 6 km: 350}
digital:
  period: 1 s
  remember: {mach: 0, h: 0 ft}
  program:
    mach: previous(mach) + 0.125
    h: previous(h) + step
    cd: drag(mach)
    force: thrust(mach, h)
run: {until: 16 s}
readouts: {top: {maximum: force}}
"""

LBF, FT = 4.4482216152605, 0.3048


def test_a_run_asks_tables_in_their_units():
    found = run(parse_patch(PATCH)).record
    machs, heights = found["mach"].values, found["h"].values
    heights = heights * {"ft": FT, "m": 1.0}[found["h"].attrs["units"]]
    forces = found["force"].values * {"": 1.0, "kg*m/s^2": 1.0}[found["force"].attrs["units"]]
    lbf = np.array([[1000 * LBF, 600 * LBF, 1000.0], [1200 * LBF, 800 * LBF, 350 * LBF]])
    points = np.array([0.0, 10000 * FT, 6000.0])
    for row in range(1, 9):
        drag = np.interp(machs[row], [0, 0.8, 1.2], [0.1, 0.1, 0.3])
        assert found["cd"].values[row] == pytest.approx(drag, rel=4 * EPS)
        ends = PchipInterpolator(points, lbf, axis=1)(heights[row])
        force = ends[0] + machs[row] * (ends[1] - ends[0])
        assert forces[row] == pytest.approx(force, rel=16 * EPS)


def test_what_lay_outside_is_told(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.yaml").write_text(PATCH)
    assert main(["run", "a.yaml", "--json", "--no-chart"]) == 0
    found = json.loads(capsys.readouterr().out)
    told = {o["word"]: o for o in found["outside"]}
    # mach = (k + 1)/8 in the cycle at k s: beyond 1 from 8 s, beyond 1.2 from 9 s on, to 16 s.
    facts = ("function", "argument", "value", "time_s", "times", "action")
    assert [told["force"][k] for k in facts] == ["thrust", "mach", 1.125, 8.0, 9, "continued"]
    assert [told["cd"][k] for k in facts] == ["drag", "mach", 1.25, 9.0, 8, "clamped"]
    assert told["cd"]["range"] == [0.0, 1.2]
    assert (
        "drag in word 'cd' was asked for mach = 1.25, outside 0 to 1.2 (8 times"
        in (found["status_note"])
    )
    (tmp_path / "a.yaml").write_text(PATCH.replace(", outside: clamp", ""))
    assert main(["run", "a.yaml", "--json", "--no-chart"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["status"] == "stopped"
    assert found["status_note"] == (
        "stopped at 9 s: drag in word 'cd' was asked for mach = 1.25, outside 0 to 1.2, and is declared "
        "with outside: stop"
    )
    assert [o["action"] for o in found["outside"] if o["word"] == "cd"] == ["stopped"]
    assert main(["sweep", "a.yaml", "--over", "step=1 ft:2 ft:2", "--jobs", "1", "--json"]) == 0
    points = json.loads(capsys.readouterr().out)["points"]
    assert all("drag in word 'cd'" in point["note"] for point in points)


DEGREES = """
title: A table in degrees
parameters: {angle: 1 rad}
tables:
  lift: {inputs: {pitch: deg}, values: {-89: -1, 89: 1}, outside: clamp}
digital:
  period: 1 s
  compute_time: 0
  remember: {k: 0}
  program:
    k: previous(k) + 1
    cl: lift(k*angle)
run: {until: 1 s}
"""


@pytest.mark.parametrize(
    ("angle", "told"),
    [
        # The second angle is twice the first; 0.5 rad is within, 1 rad too.
        (math.radians(60), "pitch = 120 deg, outside -89 to 89 (once at 1 s; clamped)"),
        (
            math.radians(100),
            "pitch = 100 deg, outside -89 to 89 (2 times, first at 0 s; at worst 200 deg; clamped)",
        ),
        (
            -math.radians(44.50001),
            "pitch = -89.00002 deg, outside -89 to 89 (once at 1 s; clamped)",
        ),
        # A step of a double at 1.553 rad is 2.2e-16 rad, 1.3e-14 deg; twice it, as the half is doubled.
        (
            np.nextafter(math.radians(89) / 2, 1),
            "pitch = 89 deg, outside -89 to 89 by 1e-14 (once at 1 s; clamped)",
        ),
        (math.radians(89) / 2, None),
    ],
)
def test_what_lay_outside_is_told_in_the_unit_of_the_table(angle, told):
    result = run(parse_patch(DEGREES), {"angle": float(angle)})
    asked = "lift in word 'cl' was asked for "
    assert result.status_note == (asked + told if told else "")
    if told:
        (found,) = result.outside
        assert found["units"] == "" and found["range"] == [-math.radians(89), math.radians(89)]
        assert found["value"] == angle * (1 + ("once" in told))


BOTH_SIDES = """
title: A table asked beyond both of its ends, in turns
tables: {line: {inputs: {x: 1, y: 1}, values: {0: {0: 0, 1: 1}, 2: {0: 2, 1: 3}}, outside: clamp}}
digital:
  period: 1 s
  compute_time: 0
  word: WORD
  remember: {k: 0}
  program:
    k: previous(k) + 1
    x: select(mod(k, 2) == 0, k, -k)
    w: line(x, 2*k - 20)
run: {until: 9 s}
"""


@pytest.mark.parametrize("word", ["float64", "float32"])
def test_each_side_of_each_range_is_told_by_itself(word):
    """In cycle k from 1 to 10 x is -1, 2, -3, 4, ... and y from -18 to 0."""
    result = run(parse_patch(BOTH_SIDES.replace("WORD", word)))
    found = sorted(
        (o["argument"], o["value"], o["worst"], o["times"], o["time_s"]) for o in result.outside
    )
    assert found == [
        ("x", -1.0, -9.0, 5, 0.0),  # 1, 3, 5, 7, 9
        ("x", 4.0, 10.0, 4, 3.0),  # 4, 6, 8, 10
        ("y", -18.0, -18.0, 9, 0.0),  # all but 10
    ]
    assert (
        "x = 4, outside 0 to 2 (4 times, first at 3 s; at worst 10; clamped)" in result.status_note
    )
    assert "y = -18, outside 0 to 1 (9 times, first at 0 s; clamped)" in result.status_note


SHEET = """\
# wind tunnel
mach, alpha, cl, cm
0.2, 0, 0.1, -0.01
0.2, 5, 0.5, -0.02

0.2, 10, 0.8, -0.03
0.9, 0, 0.2, -0.04
0.9, 5, 0.6, -0.05
0.9, 10, 0.9, -0.06
"""

WITH_FILE = """\
title: Files
tables:
  lift: {inputs: {mach: 1, alpha: deg}, file: data/lift.csv, output: cl, outside: clamp}
digital:
  period: 1 s
  program: {lift_word: "lift(0.55, alpha)"}
parameters: {alpha: 7.5 deg}
run: {until: 2 s}
"""


@pytest.fixture
def beside(tmp_path):
    """Write patch and sheet, then read the patch."""

    def read(sheet=SHEET, patch=WITH_FILE):
        (tmp_path / "data").mkdir(exist_ok=True)
        (tmp_path / "data/lift.csv").write_text(sheet)
        (tmp_path / "a.yaml").write_text(patch)
        return read_patch(tmp_path / "a.yaml")

    return read


def test_a_table_from_a_file_beside_the_patch(beside, monkeypatch):
    made = run(beside())
    assert made.record["lift_word"].values[-1] == pytest.approx(0.7, rel=4 * EPS)
    hashes = json.loads(made.record.attrs["file_hashes"])
    assert hashes == {"data/lift.csv": hashlib.sha256(SHEET.encode()).hexdigest()}
    monkeypatch.setenv("TUNNEL", "data")
    for path in ("$TUNNEL/lift.csv", "${TUNNEL}/lift.csv", "${NOT_THERE_23:-data}/lift.csv"):
        patch = WITH_FILE.replace("data/lift.csv", f'"{path}"')
        assert run(beside(patch=patch)).record["lift_word"].values[-1] == pytest.approx(0.7)
    only = "\n".join(",".join(line.split(",")[:3]) for line in SHEET.splitlines())
    beside(only, WITH_FILE.replace(", output: cl", ""))


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("0.9, 5, 0.6, -0.05", "0.9, 5, 0.6", 8, "3 cells, but 4 headings"),
        ("0.9, 5, 0.6", "0.9, 5, six", 8, "cl: 'six' is not a quantity"),
        ("0.9, 5, 0.6", "0.9, 5, nan", 8, "is not a quantity"),
        ("0.9, 5, 0.6, -0.05\n", "", 8, "is not due here"),
        ("0.9, 10, 0.9, -0.06\n", "", 8, "the row of mach, alpha = 0.9, 0.174533 (SI) is missing"),
        ("0.9, 5, 0.6", "0.9, 0, 0.6", 8, "is not due here: one is missing, is given twice"),
        ("0.2, 5, 0.5", "0.2, -5, 0.5", 4, "breakpoints of alpha must increase"),
        ("mach, alpha, cl", "mach, beta, cl", 2, "no column is named 'alpha'; valid: "),
        ("cl, cm", "cl, cl", 2, "two columns are named 'cl'"),
        (SHEET, "mach, alpha, cl\n", 1, "no rows"),
        (SHEET, "", 1, "no rows"),
        (
            SHEET,
            "mach,alpha,cl\n0.1,0,1\n0.1,1,2\n",
            2,
            "mach has 1 breakpoint; a table needs 2",
        ),
        ("0.9, 5, 0.6", "0.9, 5 m, 0.6", 8, "'5 m' must be a pure number"),
        (
            "0.9, 5, 0.6, -0.05",
            "0.9; 5; 0.6; -0.05",
            8,
            "kept apart by semicolons; keep them apart by",
        ),
        (SHEET, "mach;alpha;cl\n0,1;0;1\n", 1, "kept apart by semicolons"),
        (SHEET, "mach\talpha\tcl\n0.1\t0\t1\n", 1, "kept apart by tabs"),
        (
            "0.9, 5, 0.6, -0.05",
            '0.9, 5, 0.6,"-0.05',
            8,
            "a quotation mark opens a cell that has no end",
        ),
        ("0.9, 10, 0.9, -0.06", '0.9, 10, 0.9,"-0.06', 9, "a quotation mark opens a cell"),
        ("0.9, 5, 0.6, -0.05", '0.9,"5\n",0.6,-0.05', 8, "a quotation mark opens a cell"),
        ("0.9, 5, 0.6, -0.05", '0.9,"5"0,0.6,-0.05', 8, "not a CSV file: ',' expected after '\"'"),
        ("0.9, 5, 0.6", "0.9, 5, 0\0.6", 8, "a NUL byte, which no text has; take it out"),
    ],
)
def test_what_is_wrong_in_a_file_is_told_with_its_line(beside, old, new, line, said):
    assert old in SHEET
    with pytest.raises(PatchError) as caught:
        beside(SHEET.replace(old, new, 1))
    message = str(caught.value)
    assert message.partition(": ")[0].endswith(f"data/lift.csv:{line}"), message
    assert said in message
    assert "\n" not in message


def test_files_that_cannot_be_read(beside, tmp_path):
    for path, said in (
        ("none.csv", "'none.csv' cannot be read: No such file or directory"),
        ("data", "'data' cannot be read: Is a directory"),
        ("$NOT_THERE_23/x.csv", "the environment has no variable NOT_THERE_23"),
    ):
        with pytest.raises(PatchError, match=r"a\.yaml:3: table 'lift': ") as caught:
            beside(patch=WITH_FILE.replace("data/lift.csv", path))
        assert said in str(caught.value)
    beside()
    (tmp_path / "data/lift.csv").write_bytes(b"mach, alpha, cl\n\xff\n")
    with pytest.raises(PatchError, match=r"lift\.csv:2: not a text in UTF-8"):
        read_patch(tmp_path / "a.yaml")


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        (
            "{0: 0.1, 0.8: 0.1, 1.2",
            "{0: 0.1, 0.8: 0.1, 0.4",
            4,
            "must increase, but 0.4 comes after 0.8",
        ),
        (
            "{0: 0.1, 0.8: 0.1, 1.2",
            "{0: 0.1, 0.8: 0.1, 0.80",
            4,
            "must increase, but 0.8 comes after 0.8",
        ),
        (
            "{0: 0.1, 0.8: 0.1, 1.2: 0.3}",
            "{0: 0.1}",
            4,
            "mach has 1 breakpoint; a table needs 2",
        ),
        ("{0: 0.1, 0.8: 0.1, 1.2: 0.3}", "{}", 4, "mach has 0 breakpoints"),
        ("1.2: 0.3}", "1.2: high}", 4, "table 'drag' at 1.2: 'high' is not a quantity"),
        ("1.2: 0.3}", "1.2: 3 m}", 4, "table 'drag' at 1.2: '3 m' must be a pure number"),
        ("1.2: 0.3}", "1.2: {0: 1}}", 4, "table 'drag' at 1.2 needs a number, not a mapping"),
        ("1.2: 0.3}", "1.2 m: 0.3}", 4, "breakpoints of mach: '1.2 m' must be a pure number"),
        (
            "1: {0: 1200, 10000: 800, 6 km: 350}",
            "1: {0: 1200, 6 km: 350}",
            12,
            "differ from those of the f",
        ),
        ("1: {0: 1200, 10000: 800, 6 km: 350}", "1: 7", 12, "must be a mapping"),
        (
            "outside: clamp",
            "outside: clip",
            4,
            "outside is 'clip'; valid: stop, clamp, extrapolate",
        ),
        ("method: cubic", "method: spline", 8, "method is 'spline'; valid: linear, cubic"),
        ("unit: lbf", "unit: pounds of force", 7, "unit of 'thrust': "),
        ("inputs: {mach: 1}", "inputs: {}", 4, "it has 0 inputs; 1 to 4 are possible"),
        (
            "inputs: {mach: 1}",
            "inputs: {a: 1, b: 1, c: 1, d: 1, e: 1}",
            4,
            "it has 5 inputs; 1 to 4",
        ),
        ("outside: clamp", "output: cd", 4, "output names a column of a file"),
        ("outside: clamp", "file: a.csv", 4, "both values and file"),
        (", values: {0: 0.1, 0.8: 0.1, 1.2: 0.3}", "", 4, "neither values nor file"),
        ("outside: clamp", "outsid: clamp", 4, "unknown key 'outsid'"),
        ("drag(mach)", "drag(mach, h)", 19, "the table drag takes 1 argument, mach, not 2"),
        ("0.8: 0.1", "1e-310: 0.1", 4, "breakpoints 0 and 1e-310 of mach are too near"),
        ("1.2: 0.3", "1.5e308: 0.3", 4, "breakpoints 0 and 1.5e+308 of mach are too far out"),
        ("0: 0.1, 0.8", "-9e307: 0.1, 0.8", 4, "-9e+307 and 1.2 of mach are too far out"),
        ("drag(mach)", "drag(h)", 19, "the mach, 'h' [m], must be a pure number"),
        ("drag(mach)", "drag", 19, "'drag' is a table; write drag(mach)"),
        ("drag(mach)", "drug(mach)", 19, "unknown function 'drug'; did you mean 'drag'"),
        ("drag(mach)", "drag(mach) + h", 19, "must have the same units"),
        (
            "parameters: {step: 1000 ft}",
            "parameters: {step: drag(1)}",
            2,
            "unknown function 'drag'",
        ),
        ("  drag: {inputs", "  sin: {inputs", 4, "'sin' cannot name a table"),
        (
            "    cd: drag(mach)",
            "    drag: drag(mach)",
            19,
            "'drag' is defined twice, first as the table",
        ),
    ],
)
def test_what_is_wrong_in_the_patch_is_told_with_its_line(old, new, line, said):
    assert old in PATCH
    with pytest.raises(PatchError) as caught:
        parse_patch(PATCH.replace(old, new, 1), "a.yaml")
    message = str(caught.value)
    assert message.startswith(f"a.yaml:{line}: "), message
    assert said in message
    assert "\n" not in message
