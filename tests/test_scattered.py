"""Tables whose points lie anywhere: against SciPy, geometry by hand, whole runs, and every mistake."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator
from scipy.optimize import nnls

from hybrid.engine.helper_functions import PER_SITE
from hybrid.engine.lookup import look_up, new_places, pack
from hybrid.engine.scattered import ASKED, FOUND, read_scattered
from hybrid.errors import PatchError
from hybrid.meshes import FLAT, scattered_table, searches, twice
from hybrid.patchfile import parse_patch, read_patch
from hybrid.runs import run
from hybrid.tables import CLAMPS, CONTINUES, MOST_VARIABLES, STOPS, Axis, Table

EPS = np.finfo(float).eps


def table_of(points, values, action=CLAMPS, along=CONTINUES):
    """A table of scattered points, whose axes let every argument through."""
    axes = tuple(
        Axis(f"x{i}", np.array([p.min(), p.max()]), (p.min(), p.max()), along, along)
        for i, p in enumerate(points.T)
    )
    return scattered_table(Table("t", axes, values), points, values, action)


def asker(table):
    """The compiled look-up as a function of the arguments; notes of what was beyond."""
    finds = searches(table)
    packed = pack(finds, [(table, range(len(finds)))])
    places, notes = new_places(packed[1]), np.zeros((PER_SITE + 1, 6))

    def ask(*arguments):
        return look_up(np.array(arguments, dtype=float), 0, 0, *packed, *places, notes)

    return ask, notes


@pytest.mark.parametrize("variables", [2, 3, 4])
def test_between_the_points_it_is_scipys(variables):
    """Between points drawn at random Delaunay's mesh is the only one, whatever the units."""
    rng = np.random.default_rng(variables)
    units = 10.0 ** rng.uniform(-6, 6, variables)
    points, values = rng.uniform(size=(60, variables)) * units + 3 * units, rng.normal(size=60)
    expected = LinearNDInterpolator(points, values, rescale=True)
    ask, notes = asker(table_of(points, values, STOPS))
    inside = 0
    for _ in range(300):
        weights = rng.dirichlet(np.ones(6))
        place = weights @ points[rng.choice(60, 6, replace=False)]
        # The thinnest of these simplices loses some five digits.
        assert ask(*place) == pytest.approx(expected(place).item(), abs=1e-9)
        inside += 1
    for point, value in zip(points, values, strict=True):
        assert ask(*point) == pytest.approx(value, abs=1e-9)
    assert inside == 300 and not notes[:, 0].any()
    assert np.isnan(ask(*[np.nan] * variables))


@pytest.mark.parametrize("variables", [2, 3, 4])
def test_a_straight_function_is_met_everywhere_even_between_points_of_a_lattice(variables):
    """Lattice points lie on common spheres, where Delaunay's simplices are many or flat."""
    rng = np.random.default_rng(variables)
    points = np.array(list(itertools.product(*[[0.0, 1.0, 2.0, 3.0]] * variables)))
    slopes = rng.normal(size=variables)
    ask, notes = asker(table_of(points, 2.0 + points @ slopes, CONTINUES))
    for place in rng.uniform(0, 3, size=(200, variables)):
        assert ask(*place) == pytest.approx(2.0 + place @ slopes, abs=1e-12)
    for place in itertools.product(*[[0.0, 0.5, 1.0]] * variables):
        assert ask(*place) == pytest.approx(2.0 + np.array(place) @ slopes, abs=1e-12)
    assert not notes[:, 0].any()
    for place in rng.uniform(-5, 8, size=(100, variables)):
        assert ask(*place) == pytest.approx(2.0 + place @ slopes, abs=1e-11)


def test_beyond_a_triangle_it_is_the_nearest_place_or_goes_on():
    """f = x + 2y on (0,0), (1,0), (0,1): from (1,1) the nearest place is (1/2,1/2), sqrt(1/2) away."""
    points, values = np.array([[0.0, 0], [1, 0], [0, 1]]), np.array([0.0, 1, 2])
    near = {(1, 1): (0.5, 0.5), (-1, 0.25): (0, 0.25), (-1, -2): (0, 0), (3, 0): (1, 0)}
    clamped, notes = asker(table_of(points, values, CLAMPS, CLAMPS))
    assert clamped(1, 1) == pytest.approx(1.5, abs=1e-15) and notes[5, 0] == 1
    assert notes[5, 4] == pytest.approx(np.sqrt(0.5))  # beyond the points, after two arguments
    through, _ = asker(table_of(points, values, CLAMPS))
    on, _ = asker(table_of(points, values, CONTINUES))
    for place, found in near.items():
        assert through(*place) == pytest.approx(found[0] + 2 * found[1], abs=1e-15)
        assert on(*place) == pytest.approx(place[0] + 2 * place[1], abs=1e-14)


@pytest.mark.parametrize("variables", [2, 3, 4])
def test_the_nearest_place_is_nearest(variables):
    """Against a least-squares solution over all mixtures of the points, and as a grid clamps."""
    rng = np.random.default_rng(variables)
    points = rng.normal(size=(30, variables))
    mesh = table_of(points, np.zeros(30)).mesh
    low, span = points.min(axis=0), np.ptp(points, axis=0)
    parts, heavy = (points - low) / span, 1e5
    for place in rng.normal(scale=1.2, size=(100, variables)):
        places = np.zeros((MOST_VARIABLES, 4))
        places[:variables, ASKED] = place
        _, beyond = read_scattered(mesh, 0, variables, places)
        aim = np.append((place - low) / span, heavy)
        mixture, _ = nnls(np.vstack([parts.T, heavy * np.ones(30)]), aim)
        nearest = mixture @ parts / mixture.sum()
        distance = np.linalg.norm((place - low) / span - nearest)
        assert beyond == pytest.approx(distance, abs=1e-6)
        np.testing.assert_allclose(places[:variables, FOUND], nearest, atol=1e-4)
    corners = np.array(list(itertools.product(*[[0.0, 1.0]] * variables)))
    bent = corners.prod(axis=1)
    ask, _ = asker(table_of(corners, bent))
    for place in rng.uniform(-2, 3, size=(60, variables)):
        assert ask(*place) == pytest.approx(ask(*np.clip(place, 0, 1)), abs=1e-12)


def test_it_goes_over_the_edge_without_a_jump_and_the_order_of_points_is_nothing():
    rng = np.random.default_rng(5)
    points, values = rng.normal(size=(40, 3)), rng.normal(size=40)
    for action in (CLAMPS, CONTINUES):
        ask, _ = asker(table_of(points, values, action))
        order = rng.permutation(40)
        other, _ = asker(table_of(points[order], values[order], action))
        way = np.linspace(0, 4, 400)[:, None] * np.array([1.0, -0.7, 0.4])
        found = np.array([ask(*place) for place in way])
        assert found.tolist() == [other(*place) for place in way]
        if action == CLAMPS:  # else each face goes on by itself behind the edge
            assert np.abs(np.diff(found)).max() < 0.2
        assert found.tolist()[::-1] == [ask(*place) for place in way[::-1]]
    hull = points.mean(axis=0)
    outwards = points[0] - hull
    for far in (1 - 1e-7, 1 + 1e-7):
        assert ask(*(hull + far * outwards)) == pytest.approx(ask(*points[0]), abs=1e-3)


@pytest.mark.parametrize("variables", [2, 3, 4])
def test_far_beyond_the_points(variables):
    """Of equal values nothing else is made; a place whose square is no number has no answer."""
    points = np.random.default_rng(variables).uniform(size=(20, variables))
    for action in (CLAMPS, CONTINUES):
        ask, _ = asker(table_of(points, np.full(20, 7.0), action))
        for far in (1e6, -1e12, 1e17, -1e149):
            assert ask(*[far] * variables) == pytest.approx(7.0, rel=8 * EPS)
        for far in (1e160, -np.inf, np.inf, np.nan):
            assert np.isnan(ask(*[0.5] * (variables - 1), far))
            assert np.isnan(ask(far, *[0.5] * (variables - 1)))


def test_one_variable_is_a_line_through_the_points_in_order():
    table = table_of(np.array([[2.0], [0.0], [1.0]]), np.array([4.0, 0.0, 1.0]))
    assert table.mesh is None and table.method == "linear"
    assert (table.axes[0].points.tolist(), table.values.tolist()) == ([0, 1, 2], [0, 1, 4])
    assert twice(np.array([[1.0, 2], [2, 1], [1, 2]])) == 2


# --- in a patch -----------------------------------------------------------------------------------

ROWS = """\
mach, height, thrust
0.1, 0, 1
0.9, 0, 9
0.5, 1000, 15
0.5, 200, 7
0.3, 400, 7
"""
PATCH = """\
title: Scattered
tables:
  thrust:
    inputs: {mach: 1, height: ft}
    unit: lbf
    file: points.csv
    method: simplices
    outside: OUTSIDE
analog: {up: {ramp: 100 1/s, full_scale: 2000}}
interface: {seen: {adc: up}}
digital:
  word: WORD
  period: 0.1 s
  compute_time: 0
  program: {h: seen*foot, force: "thrust(0.5, h)"}
  units: {force: lbf}
parameters: {foot: 1 ft}
machine: ideal
run: {until: 13 s}
"""
LBF = 4.4482216152605


@pytest.fixture
def flown(tmp_path: Path):
    def fly(outside="clamp", word="float64", rows=ROWS, **changes):
        (tmp_path / "points.csv").write_text(rows)
        text = PATCH.replace("OUTSIDE", outside).replace("WORD", word)
        for old, new in changes.items():
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "a.yaml").write_text(text)
        return run(read_patch(tmp_path / "a.yaml"))

    return fly


@pytest.mark.parametrize(("word", "rel"), [("float64", 1e-12), ("float32", 1e-6)])
@pytest.mark.parametrize("outside", ["clamp", "extrapolate"])
def test_a_table_of_points_in_a_run(flown, word, rel, outside):
    """All points lie on 10 mach + height/100 ft; at mach 0.5 they end at 1000 ft, after 10 s."""
    result = flown(outside, word)
    height = 10.0 * np.arange(131)
    if outside == "clamp":
        height = np.minimum(height, 1000)
    np.testing.assert_allclose(result.record["force"], 5 + height / 100, rtol=rel)
    (beyond,) = result.outside
    # At 10 s itself 1000 times a foot and 1000 ft are two roundings of one number.
    assert (beyond["times"], beyond["time_s"]) in ((30, 10.1), (31, 10.0))
    assert beyond["argument"] == "height"  # all that is beyond them is beyond their range
    assert beyond["action"] == {"clamp": "clamped", "extrapolate": "continued"}[outside]


@pytest.mark.parametrize("word", ["float64", "float32"])
def test_beyond_the_points_but_within_their_ranges(flown, word):
    """At mach 0.7 the edge from (0.9, 0) to (0.5, 1000 ft) is met at 500 ft."""
    result = flown("clamp", word, **{"thrust(0.5": "thrust(0.7"})
    beyond, above = result.outside
    assert (beyond["argument"], beyond["range"], beyond["units"]) == ("points", [0, 0], "")
    assert (above["argument"], above["times"], beyond["times"] + above["times"]) == (
        "height",
        31,
        80,
    )
    # In parts of the ranges the edge falls 2 a unit: 10 ft above it is 0.01/sqrt(5) away.
    assert beyond["value"] == pytest.approx(0.01 / np.sqrt(5), rel=1e-5)
    told = "was asked for a place beyond its points, by 0.00447 of their range (49 times, first at 5.1 s"
    assert result.status == "complete" and told in result.status_note
    stopped = flown("stop", word, **{"thrust(0.5": "thrust(0.7"})
    assert stopped.status == "stopped" and "at 5.1 s" in stopped.status_note


def test_every_site_is_told_and_tables_share_their_searches(flown):
    both = {'force: "thrust(0.5, h)"': 'force: "thrust(0.7, h)", other: "2*thrust(0.7, h)"'}
    result = flown("clamp", **both)
    assert {(o["word"], o["times"]) for o in result.outside} == {
        (word, times) for word in ("force", "other") for times in (49, 31)
    }  # 5.1 s to 9.9 s beyond the points, then beyond their range too
    assert (2 * result.record["force"].values * LBF).tolist() == pytest.approx(
        result.record["other"].values.tolist()
    )


def test_values_in_the_patch_need_not_be_alike():
    text = """\
title: Inline
machine: ideal
tables:
  t:
    inputs: {x: 1, y: 1}
    method: simplices
    values: {0: {0: 0, 2: 2}, 1: {1: 4}, 2: {0: 6}}
digital: {period: 1 s, compute_time: 0, program: {a: "t(0.5, 1)", b: "t(1, 0)"}}
run: {until: 1 s}
"""
    record = run(parse_patch(text)).record
    # All on 3 x + y but for the middle: the mesh has the three triangles that meet there.
    assert record["a"].values[-1] == pytest.approx(2.5) and record["b"].values[-1] == 3.0


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ("{}", "it has 0 points"),
        ("{0: {}, 1: {}}", "it has 0 points"),
        ("{-1e308: {0: 1}, 1e308: {0: 2, 1: 3}}", "too far apart"),
    ],
)
def test_no_points_and_points_too_far_apart_are_told(values, says):
    text = f"""\
title: Inline
machine: ideal
tables:
  t:
    inputs: {{x: 1, y: 1}}
    method: simplices
    values: {values}
digital: {{period: 1 s, compute_time: 0, program: {{a: "t(0.5, 1)"}}}}
run: {{until: 1 s}}
"""
    with pytest.raises(PatchError, match=says):
        run(parse_patch(text))


BAD = [
    ({"rows": ROWS.replace("0.5, 200, 7", "0.1, 0, 7")}, "points.csv:5", "a point stands at"),
    ({"rows": "mach, height, thrust\n0, 0, 1\n1, 1, 2\n"}, "points.csv:2", "it has 2 points; 3 to"),
    (
        {"rows": "mach, height, thrust\n0, 0, 1\n1, 1, 2\n2, 2, 3\n3, 3, 0\n"},
        "points.csv:2",
        "all its points lie on a line; give some beside it",
    ),
    ({"rows": "mach, height, thrust\n1, 0, 1\n1, 1, 2\n1, 2, 3\n"}, "points.csv:2", "on a line"),
    ({"rows": ROWS.replace("15", "high")}, "points.csv:4", "'high lbf'"),
    ({"method: simplices": "method: simplex"}, "a.yaml:7", "valid: linear, cubic, simplices"),
    ({"method: simplices": "method: linear"}, "points.csv:4", "of mach must increase"),
]


@pytest.mark.parametrize("case", range(len(BAD)))
def test_what_makes_no_mesh(flown, case):
    changes, place, says = BAD[case]
    with pytest.raises(PatchError) as error:
        flown(**changes)
    assert place in str(error.value) and says in str(error.value), str(error.value)
    assert "\n" not in str(error.value)


def test_points_that_nearly_lie_on_a_line_are_no_mesh():
    rng = np.random.default_rng(1)
    x = rng.uniform(size=20)
    points = np.column_stack([x, x + 0.01 * FLAT * rng.normal(size=20)])
    from hybrid.meshes import check_spread
    from hybrid.tables import TableError

    with pytest.raises(TableError, match="on a line"):
        check_spread(points)
    check_spread(np.column_stack([x, x + 1e-3 * rng.normal(size=20)]))


# --- in a DAVE-ML file ------------------------------------------------------------------------------

MODEL = """\
<?xml version="1.0"?>
<DAVEfunc xmlns="http://daveml.org/2010/DAVEML">
  <variableDef name="mach" varID="mach" units="nd"/>
  <variableDef name="height" varID="h" units="ft"/>
  <variableDef name="thrust" varID="T" units="lbf"><isOutput/></variableDef>
  <ungriddedTableDef utID="points" units="lbf">
    <dataPoint>0.1, 0, 1</dataPoint>
    <dataPoint>0.9 0 9</dataPoint>
    <dataPoint>0.5, 1000, 15</dataPoint>
    <dataPoint>0.5, 200, 7</dataPoint>
  </ungriddedTableDef>
  <function name="engine">
    <independentVarRef varID="mach" extrapolate="neither"/>
    <independentVarRef varID="h" extrapolate="neither"/>
    <dependentVarRef varID="T"/>
    <functionDefn><ungriddedTableRef utID="points"/></functionDefn>
  </function>
</DAVEfunc>
"""
ENGINE = """\
title: An ungridded engine
machine: ideal
parameters: {mach: 0.7, foot: 1 ft}
models:
  engine: {file: engine.dml, inputs: {mach: mach, height: h}}
analog: {up: {ramp: 100 1/s, full_scale: 2000}}
interface: {seen: {adc: up}}
digital:
  period: 0.1 s
  compute_time: 0
  program: {h: seen*foot, force: engine.thrust}
  units: {force: lbf}
run: {until: 9 s}
"""


@pytest.fixture
def engine(tmp_path: Path):
    def fly(model=MODEL):
        (tmp_path / "engine.dml").write_text(model)
        (tmp_path / "a.yaml").write_text(ENGINE)
        return run(read_patch(tmp_path / "a.yaml"))

    return fly


def test_an_ungridded_table_of_a_model(engine):
    """Within, T = 10 mach + h/100 ft; beyond the edge it is that of the nearest place on it, and goes on
    only where every variable may on both sides."""
    inline = MODEL.replace(
        '<ungriddedTableRef utID="points"/>',
        MODEL[MODEL.index("<ungriddedTableDef") : MODEL.index("  <function")],
    )
    for model in (MODEL, inline):
        result = engine(model)
        n = np.arange(91)
        edge = np.stack([0.7 - 0.8 * 0.4 * (n - 50) / 100, 500 + 0.8 * 10 * (n - 50)])
        within = 7 + 10 * n / 100
        beyond = 10 * edge[0] + edge[1] / 100
        np.testing.assert_allclose(
            result.record["force"], np.where(n <= 50, within, beyond), rtol=1e-9
        )
        assert [o["times"] for o in result.outside] == [40]
        assert "engine.thrust in word 'engine.thrust' was asked" in result.status_note
    on = engine(MODEL.replace("neither", "both"))
    np.testing.assert_allclose(on.record["force"], 7 + 10 * np.arange(91) / 100, rtol=1e-9)
    half = engine(MODEL.replace("neither", "both", 1))
    assert half.record["force"].values.tolist() == result.record["force"].values.tolist()


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("0.9 0 9", "0.9 0", 8, "<dataPoint> has 2 numbers; a function of 2 variables needs 3"),
        ("0.9 0 9", "0.9 0 x", 8, "<dataPoint> holds 'x', which is no number"),
        ("0.9 0 9", "0.5 200 9", 10, "a point stands at the place of an earlier one"),
        ("0.5, 1000, 15", "0.2, 0, 15", 6, "all its points lie"),
        ('utID="points"/>', 'utID="point"/>', 16, "nothing has the utID 'point'; did you mean"),
        ("<ungriddedTableRef utID=\"points\"/>", "", 16, "has no table, gridded or ungridded"),
        ('varID="h" extra', 'varID="h" min="2000" extra', 14, "leave no range"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_an_ungridded_table(engine, old, new, line, said):
    model = MODEL.replace(old, new)
    if old == "0.5, 1000, 15":
        model = model.replace("0.5, 200, 7", "0.5, 0, 7")
    with pytest.raises(PatchError) as error:
        engine(model)
    assert f"engine.dml:{line}: " in str(error.value) and said in str(error.value), str(error.value)
