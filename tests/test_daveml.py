"""DAVE-ML models in patches: published check shots, arithmetic, and files that are wrong or hostile."""

import csv
import itertools
import json
import math
import re

import numpy as np
import pytest

from hybrid import daveml
from hybrid.checks import check
from hybrid.cli import main
from hybrid.compiler import compile_patch
from hybrid.daveml import read_model
from hybrid.errors import PatchError
from hybrid.expressions import evaluate
from hybrid.mathml import read_math
from hybrid.patchfile import parse_patch, read_patch
from hybrid.runs import run
from hybrid.s119 import unit_text
from hybrid.tape import Op
from hybrid.units import unit_of
from hybrid.xmltree import read_xml

EPS = np.finfo(float).eps
UNITS = {"trueAirspeed": "ft/s", "powerLeverAngle": "percent", "altitudeMSL": "ft", "mach": ""}
UNITS |= {f"bodyAngularRate_{axis}": "rad/s" for axis in ("Roll", "Pitch", "Yaw")}
LBF, FT = 4.4482216152605, 0.3048


def shots(file):
    with file.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def shot_patch(model, row):
    """A patch that puts a shot's inputs to the model and reads all outputs the shot tells."""
    given = {name[3:]: row[name] for name in row if name.startswith("in_")}
    outputs = [name[4:] for name in row if name.startswith("out_")]
    parameters = "".join(f"  in_{n}: {v} {UNITS.get(n, 'deg')}\n" for n, v in given.items())
    inputs = ", ".join(f"{name}: in_{name}" for name in given)
    program = "".join(f"    out_{name}: model.{name}\n" for name in outputs)
    text = f"""
title: {row["shot"]!r}
parameters:
{parameters}models:
  model: {{file: {model}, inputs: {{{inputs}}}}}
digital:
  period: 1 s
  program:
{program}run: {{until: 1 s}}
"""
    return parse_patch(text), outputs


# Published: 1e-6 (aerodynamics) and 1e-5 (propulsion); beside them half of the last digit printed.
@pytest.mark.parametrize(("name", "tolerance", "count"), [("aero", 1e-6, 8), ("prop", 1e-5, 5)])
def test_the_published_check_shots_of_the_f16(reference, name, tolerance, count):
    table = shots(reference(f"f16_table_shots/F16_{name}_shots.csv"))
    assert len(table) == count
    for row in table:
        found = fly_shot(reference(f"models/F16_{name}.dml"), row)
        for output, value in found.items():
            printed = row[f"out_{output}"]
            allowed = tolerance + half_a_digit(printed)
            if printed == BY_HAND[0]:
                # A number in single precision, to all its digits; so are those it was computed from.
                printed_single = np.float32(printed)
                assert f"{printed_single:.4f}" == printed
                allowed += float(np.spacing(printed_single))
            assert abs(value - float(printed)) <= allowed, (row["shot"], output)


# 42.3 % of power at 23507 ft and Mach 0.625, between 20000 and 30000 ft, 0.6 and 0.8: idle thrust is
# -72.045 and -930.7129 lbf at that height, -179.3784875 at the Mach number; dry thrust 6237.799 and
# 6897.799, 6320.299. The power is 0.846 of the way from the one to the other.
BY_HAND = ("5319.3491", -179.3784875 + 42.3 * (6320.299 + 179.3784875) / 50.0)


def test_the_shot_between_breakpoints_is_what_its_tables_give_by_hand(reference):
    rows = shots(reference("f16_table_shots/F16_prop_shots.csv"))
    (row,) = [row for row in rows if row["out_thrustBodyForce_X"] == BY_HAND[0]]
    found = fly_shot(reference("models/F16_prop.dml"), row)["thrustBodyForce_X"]
    assert found == pytest.approx(BY_HAND[1], rel=20 * EPS)
    assert BY_HAND[1] == pytest.approx(5319.348667, abs=5e-7)


def half_a_digit(printed):
    """Half a unit of the last digit of a printed number."""
    return 0.5 * 10.0 ** -len(printed.partition(".")[2])


def fly_shot(model, row):
    """The outputs that a shot tells, by name, in the units of the file."""
    patch, outputs = shot_patch(model, row)
    record = run(patch).record
    units = {"referenceWingChord": FT, "referenceWingSpan": FT, "referenceWingArea": FT**2}
    units |= {name: LBF for name in outputs if name.startswith("thrustBodyForce")}
    units |= {name: LBF * FT for name in outputs if name.startswith("thrustBodyMoment")}
    return {n: float(record[f"out_{n}"].values[-1]) / units.get(n, 1.0) for n in outputs}


def test_each_table_of_a_model_is_asked_once_a_cycle(reference):
    table = shots(reference("f16_table_shots/F16_aero_shots.csv"))
    patch, _ = shot_patch(reference("models/F16_aero.dml"), table[0])
    tape = compile_patch(patch).tape
    asked = [site.word for site in tape.sites]
    # The file has 18 functions; the six coefficients need all of them. The airspeed has a minValue.
    assert len(asked) == len(set(asked)) == 18 + 1
    assert sum(tape.code[:, 0] == Op.LOOK_UP) == 18 + 1


def test_every_reference_model_is_read(reference):
    for file in sorted(reference("models").glob("*.dml")):
        model = read_model(file.read_text(encoding="utf-8"), file.name, "m")
        assert model.outputs
        for variable in model.variables.values():
            if variable.is_output and "kgm" not in variable.units:
                assert unit_text(variable.units) is not None, (file.name, variable)


# --- a model of our own ---------------------------------------------------------------------------

MODEL = """\
<?xml version="1.0"?>
<!DOCTYPE DAVEfunc PUBLIC "-//AIAA//DTD for Flight Dynamic Models - Functions 2.0//EN"
  "http://www.daveml.org/DTDs/2p0/DAVEfunc.dtd">
<DAVEfunc xmlns="http://daveml.org/2010/DAVEML">
  <fileHeader><creationDate date="2020-01-01"/></fileHeader>
  <variableDef name="angleOfAttack" varID="alpha" units="deg"><isInput/></variableDef>
  <variableDef name="speed" varID="v" units="ft_s" minValue="10"><isInput/></variableDef>
  <variableDef name="span" varID="b" units="ft" initialValue="30."><isOutput/></variableDef>
  <variableDef name="lift" varID="cl" units="nd"/>
  <variableDef name="twist" varID="twist" units="deg" maxValue="3">
    <calculation><math xmlns="http://www.w3.org/1998/Math/MathML">
      <apply><times/><cn>0.5</cn><ci>alpha</ci></apply>
    </math></calculation>
    <isOutput/>
  </variableDef>
  <variableDef name="force" varID="f" units="lbf">
    <calculation><math xmlns="http://www.w3.org/1998/Math/MathML">
      <apply><times/><ci> cl </ci><ci>v</ci><ci>b</ci></apply>
    </math></calculation>
    <isOutput/>
  </variableDef>
  <breakpointDef bpID="A" units="deg"><bpVals>-10, 0, <!-- a comment --> 20</bpVals></breakpointDef>
  <breakpointDef bpID="V"><bpVals>0 100</bpVals></breakpointDef>
  <function name="lift">
    <independentVarRef varID="v" extrapolate="max"/>
    <independentVarRef varID="alpha" min="-5" max="20" extrapolate="neither"/>
    <dependentVarRef varID="cl"/>
    <functionDefn>
      <griddedTableDef>
        <breakpointRefs><bpRef bpID="V"/><bpRef bpID="A"/></breakpointRefs>
        <dataTable>
          -1.0, 0.0, <!-- between the numbers --> 2.0,
          -2.0, 0.0, 4.0,
        </dataTable>
      </griddedTableDef>
    </functionDefn>
  </function>
</DAVEfunc>
"""

PATCH = """\
title: Model
parameters: {alpha: 5 deg, v: 50 ft/s}
models:
  wing:
    file: wing.dml
    inputs: {angleOfAttack: alpha * 1, v: v}
digital:
  period: 1 s
  program:
    force: wing.force
    twist: wing.twist + wing.alpha
    span: wing.span
    rate: wing.force / span
run: {until: 2 s}
"""


@pytest.fixture
def flown(tmp_path):
    """Run a patch with a model beside it."""

    def fly(model=MODEL, patch=PATCH, **parameters):
        (tmp_path / "wing.dml").write_text(model, encoding="utf-8")
        (tmp_path / "a.yaml").write_text(patch, encoding="utf-8")
        return run(read_patch(tmp_path / "a.yaml"), parameters)

    return fly


def test_a_model_computes_in_its_units_and_the_program_in_si(flown):
    made = flown()
    last = {name: made.record[name].values[-1] for name in ("force", "twist", "span", "rate")}
    # cl at 50 ft/s and 5 deg: half way between 0.5 and 1.0; f = cl v b lbf.
    assert last["force"] == pytest.approx(0.75 * 50 * 30 * LBF, rel=16 * EPS)
    assert last["twist"] == pytest.approx(math.radians(2.5 + 5.0), rel=16 * EPS)
    assert last["span"] == pytest.approx(30 * FT, rel=2 * EPS)
    assert last["rate"] == pytest.approx(0.75 * 50 * LBF / FT, rel=16 * EPS)
    assert set(made.record.data_vars) == {"force", "twist", "span", "rate"}
    assert made.outside == ()
    assert list(json.loads(made.record.attrs["file_hashes"])) == ["wing.dml"]


def test_limits_and_ranges_of_a_model(flown):
    made = flown(alpha=math.radians(-8.0), v=0.3 * FT)
    # v is kept at 10 ft/s by its minValue; alpha at -5 deg by the function's range.
    cl = -0.5 * (1.0 + 0.1)
    assert made.record["force"].values[-1] == pytest.approx(cl * 10 * 30 * LBF, rel=16 * EPS)
    kept, told = sorted(made.outside, key=lambda o: o["word"], reverse=True)
    assert (told["function"], told["argument"], told["action"]) == ("wing.lift", "alpha", "clamped")
    assert told["range"] == [-5.0, 20.0]
    assert told["value"] == pytest.approx(-8.0, rel=4 * EPS)
    assert (kept["function"], kept["argument"]) == ("wing.speed", "speed")
    assert kept["value"] == pytest.approx(0.3 * FT, rel=4 * EPS) and kept["times"] == 3
    assert "asked for speed = 0.3 ft/s, below 10 (3 times, first at 0 s; clamped)" in (
        made.status_note
    )
    made = flown(v=200 * FT)  # the table goes on beyond its highest speed
    assert made.record["force"].values[-1] == pytest.approx(1.5 * 200 * 30 * LBF, rel=16 * EPS)
    assert made.outside[0]["action"] == "continued"
    made = flown(alpha=math.radians(10.0))
    assert made.record["twist"].values[-1] == pytest.approx(math.radians(3.0 + 10.0), rel=16 * EPS)
    (held,) = made.outside  # a calculation beyond its maxValue is told of as an input is
    assert (held["function"], held["argument"], held["times"]) == ("wing.twist", "twist", 3)
    assert (held["value"], held["action"]) == (pytest.approx(5.0, rel=4 * EPS), "clamped")
    assert "wing.twist in word 'wing.twist' was asked for twist = 5, above 3" in made.status_note


def test_limits_hold_one_side_or_both_and_constants_too(flown):
    def twist(attributes, calculation="<apply><times/><cn>0.5</cn><ci>alpha</ci></apply>"):
        model = MODEL.replace('maxValue="3"', attributes)
        model = model.replace("<apply><times/><cn>0.5</cn><ci>alpha</ci></apply>", calculation)
        made = flown(model, alpha=math.radians(4.0))
        found = math.degrees(made.record["twist"].values[-1]) - 4.0
        ranges.extend(told["range"] for told in made.outside)
        return pytest.approx(found, rel=64 * EPS), [told["value"] for told in made.outside]

    ranges = []
    assert twist("") == (2.0, [])
    assert twist('minValue="2.5"') == (2.5, [pytest.approx(2.0)])
    assert ranges == [[2.5, None]]  # it has no other end
    assert twist('minValue="1" maxValue="1"') == (1.0, [pytest.approx(2.0)])  # no range at all
    assert twist('minValue="-1" maxValue="2.5"') == (2.0, [])
    assert twist('maxValue="2.5"', "<cn>7</cn>") == (2.5, [7.0])
    assert twist('maxValue="7"', "<cn>7</cn>") == (7.0, [])


def test_only_the_csymbol_atan2_is_read(flown):
    other = "<apply><csymbol definitionURL='x/atan2d'>atan2d</csymbol><cn>1</cn><cn>1</cn></apply>"
    model = MODEL.replace("<apply><times/><cn>0.5</cn><ci>alpha</ci></apply>", other)
    with pytest.raises(PatchError, match="atan2d' is no function that is read"):
        flown(model)


def test_what_is_no_number_passes_no_limit_and_no_comparison(flown):
    root = "<apply><root/><apply><minus/><ci>alpha</ci></apply></apply>"
    for calculation in (
        root,
        f"<apply><max/><cn>1</cn>{root}</apply>",
        f"<apply><min/>{root}<cn>1</cn></apply>",
    ):
        model = MODEL.replace("<apply><times/><cn>0.5</cn><ci>alpha</ci></apply>", calculation)
        made = flown(model.replace('maxValue="3"', 'minValue="0" maxValue="3"'))
        assert made.status == "stopped" and "no finite number for wing.twist" in made.status_note


@pytest.mark.parametrize(
    ("math_text", "expected"),
    [
        ("<apply><minus/><cn>3</cn></apply>", -3.0),
        ("<apply><minus/><ci>alpha</ci><cn>3</cn></apply>", 2.0),
        ("<apply><plus/><ci>alpha</ci><cn>1</cn><cn>1e1</cn></apply>", 16.0),
        ("<apply><divide/><ci>alpha</ci><cn>4</cn></apply>", 1.25),
        ("<apply><power/><ci>alpha</ci><cn>2</cn></apply>", 25.0),
        ("<apply><root/><apply><times/><ci>alpha</ci><ci>alpha</ci></apply></apply>", 5.0),
        ("<apply><root/><degree><cn>3</cn></degree><cn>8</cn></apply>", 2.0),
        ("<apply><abs/><apply><minus/><ci>alpha</ci></apply></apply>", 5.0),
        ("<apply><exp/><apply><ln/><ci>alpha</ci></apply></apply>", 5.0),
        ("<apply><log/><cn>1000</cn></apply>", 3.0),
        ("<apply><log/><logbase><cn>2</cn></logbase><cn>8</cn></apply>", 3.0),
        ("<apply><arctan/><cn>1</cn></apply>", math.pi / 4),
        ("<apply><sec/><cn>0</cn></apply>", 1.0),
        ("<apply><csymbol definitionURL='http://daveml.org/function_spaces.html#atan2'>atan2</csymbol>"
         "<cn>1</cn><cn>-1</cn></apply>", 0.75 * math.pi),
        ("<apply><max/><ci>alpha</ci><cn>9</cn><cn>7</cn></apply>", 9.0),
        ("<apply><floor/><cn>-1.5</cn></apply>", -2.0),
        ("<apply><and/><apply><gt/><ci>alpha</ci><cn>1</cn></apply><true/></apply>", 1.0),
        ("<apply><not/><apply><geq/><ci>alpha</ci><cn>5</cn></apply></apply>", 0.0),
        ("<apply><times/><pi/><cn>2</cn></apply>", 2 * math.pi),
        ("<piecewise><piece><cn>1</cn><apply><lt/><ci>alpha</ci><cn>2</cn></apply></piece>"
         "<piece><cn>2</cn><apply><lt/><ci>alpha</ci><cn>7</cn></apply></piece>"
         "<otherwise><cn>3</cn></otherwise></piecewise>", 2.0),
        ("<apply><piecewise><piece><cn>1</cn><apply><eq/><ci>alpha</ci><cn>2</cn></apply></piece>"
         "<otherwise><cn>4</cn></otherwise></piecewise></apply>", 4.0),
    ],
)  # fmt: skip
def test_mathml(flown, math_text, expected):
    old = "<apply><times/><ci> cl </ci><ci>v</ci><ci>b</ci></apply>"
    assert old in MODEL
    model = MODEL.replace(old, math_text)
    found = flown(model).record["force"].values[-1] / LBF
    assert found == pytest.approx(expected, rel=32 * EPS)


def test_the_short_form_of_a_function(flown):
    start, end = MODEL.index('  <function name="lift">'), MODEL.index("</DAVEfunc>")
    short = """  <function name="lift">
    <independentVarPts varID="alpha">-10, 0, 20</independentVarPts>
    <dependentVarPts varID="cl">-1, 0, 2</dependentVarPts>
  </function>
"""
    found = flown(MODEL[:start] + short + MODEL[end:]).record["force"].values[-1]
    assert found == pytest.approx(0.5 * 50 * 30 * LBF, rel=16 * EPS)


LAUGHS = '<!DOCTYPE DAVEfunc [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">]><DAVEfunc>&b;</DAVEfunc>'
READS = '<!DOCTYPE DAVEfunc [<!ENTITY x SYSTEM "file:///etc/passwd">]><DAVEfunc>&x;</DAVEfunc>'
PARAMETER = '<!DOCTYPE DAVEfunc [<!ENTITY % p SYSTEM "http://127.0.0.1/p.dtd"> %p;]><DAVEfunc/>'
DEFAULT = '<!DOCTYPE DAVEfunc [<!ATTLIST variableDef initialValue CDATA "7">]><DAVEfunc/>'
DEEP = "<DAVEfunc>" + "<a>" * 200 + "</a>" * 200 + "</DAVEfunc>"


PIECE = "<piece><cn>1</cn><true/></piece>"
OTHERWISE = "<otherwise><cn>2</cn></otherwise>"


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        (MODEL, LAUGHS, 1, "declares the entity 'a'"),
        (MODEL, READS, 1, "declares the entity 'x'"),
        (MODEL, PARAMETER, 1, "declares the entity 'p'"),
        (MODEL, DEEP, 1, "too large; at most 500000 elements, nested 100 deep"),
        (MODEL, "<DAVEfunc>&nbsp;</DAVEfunc>", 1, "not well-formed XML: undefined entity"),
        ("<fileHeader>", "<fileHeader>&alpha;", 5, "uses the entity 'alpha'"),
        ('minValue="10"', 'minValue="1&foo;0"', 7, "uses the entity 'foo'"),  # dropped by expat
        (MODEL, DEFAULT, 1, "declares what <variableDef> has for initialValue"),
        (MODEL, "", 1, "not well-formed XML: no element found"),
        (MODEL, "<html/>", 1, "<html> is no DAVE-ML"),
        (MODEL, "<DAVEfunc/>", 1, "no <variableDef>"),
        ("</fileHeader>", "</fileheader>", 5, "not well-formed XML: mismatched tag"),
        ("</DAVEfunc>\n", "", 38, "not well-formed XML: no element found"),
        ('varID="b"', 'varID="v"', 8, "the varID 'v' comes twice"),
        ('varID="b" ', "", 8, "<variableDef> has no varID"),
        ('minValue="10"', 'minValue="ten"', 7, "minValue holds 'ten', which is no number"),
        ('minValue="10"', 'minValue="10" maxValue="1"', 7, "minValue is above maxValue"),
        ('initialValue="30."', 'initialValue="nan"', 8, "initialValue holds 'nan'"),
        ('<bpRef bpID="A"/>', '<bpRef bpID="B"/>', 30, "nothing has the bpID 'B'; valid: A, V"),
        ('<bpRef bpID="A"/>', "", 24, "a table of 1 variable, but a function of 2"),
        ('<breakpointRefs><bpRef bpID="V"/><bpRef bpID="A"/></breakpointRefs>', "", 29, "has no <b"),
        ("0 100</bpVals>", "100 100</bpVals>", 25, "of v must increase, but 100 comes after 100"),
        ("0 100</bpVals>", "0</bpVals>", 25, "v has 1 breakpoint"),
        ("-2.0, 0.0, 4.0,", "-2.0, 0.0,", 31, "the table has 5 values; its breakpoints ask for 2 x 3"),
        ("-2.0, 0.0, 4.0,", "-2.0, 0.0, four", 31, "<dataTable> holds 'four', which is no number"),
        ("-2.0, 0.0, 4.0,", "-2.0, 0.0, inf", 31, "<dataTable> holds 'inf'"),
        ('max="20"', 'max="-7"', 26, "min and max leave no range"),
        ('extrapolate="max"', 'extrapolate="maximum"', 25, "is 'maximum'; did you mean 'max'"),
        ('extrapolate="max"', 'interpolate="cubicSpline"', 25, "interpolate is 'cubicSpline'"),
        ('<dependentVarRef varID="cl"/>', '<dependentVarRef varID="cd"/>', 27, "has the varID 'cd'"),
        ('<dependentVarRef varID="cl"/>', '<dependentVarRef varID="f"/>', 16, "both a calculation"),
        ("<ci>alpha</ci>", "<ci>alfa</ci>", 12, "'alfa'; did you mean 'alpha'"),
        ("<ci>alpha</ci>", "<ci>f</ci><ci>twist</ci>", 10, "each other: twist -> twist"),
        ("<cn>0.5</cn>", "<cn>half</cn>", 12, "<cn> holds 'half'; it must be a number"),
        ("<cn>0.5</cn>", '<cn type="e-notation">5<sep/>0.5</cn>', 12, "a whole exponent, such as"),
        ("<cn>0.5</cn>", '<cn type="e-notation">5</cn>', 12, "needs a number, <sep/> and"),
        ("<cn>0.5</cn>", '<cn type="e-notation">5e1<sep/>2</cn>', 12, "<cn> holds '5e1e2'"),
        ("<apply><times/><cn>0.5</cn>", "<apply><lt/>", 12, "<lt/> has 1 operand; it needs 2 or more"),
        ("<apply><times/><cn>0.5</cn>", "<apply><tims/><cn>0.5</cn>", 12, "read; did you mean 'times'"),
        ("<apply><times/><cn>0.5</cn>", "<apply><tims/>", 12, "<tims/> is no operation"),
        ("<apply><times/><cn>0.5</cn>", "<apply><divide/>", 12, "<divide/> has 1 operand; it needs 2"),
        ("<apply><times/><cn>0.5</cn>", "<vector/><apply><minus/>", 11, "must hold one expression"),
        ("<apply><times/><cn>0.5</cn>", "<piecewise/><apply><abs/>", 11, "must hold one expression"),
        ("<cn>0.5</cn>", "<piecewise/>", 12, "<piecewise> needs a <piece> or more, each of a value"),
        ("<cn>0.5</cn>", "<piecewise><piece><cn>1</cn></piece></piecewise>", 12,
         "<piece> has 1 element; it needs two, a value and its condition"),
        ("<cn>0.5</cn>", "<piecewise>\n<piece><cn>1</cn><true/></piece>\n<otherwise/></piecewise>", 14,
         "<otherwise> holds 0 values; it must hold one"),
        ("<cn>0.5</cn>", '<cn type="integer" base="8">17</cn>', 12, "<cn> is of base '8'; only 10"),
        ("<cn>0.5</cn>", '<cn type="rational">1<sep/>2</cn>', 12, "type 'rational'; the types read"),
        ("<cn>0.5</cn>", "<cn>1<sep/>2</cn>", 12, "<cn> holds <sep/>; it must hold a number and"),
        ("<cn>0.5</cn>", "<cn>1<foo/>2</cn>", 12, "<cn> holds <foo/>; it must hold a number and"),
        ("<cn>0.5</cn>", "<ci>v<sep/></ci>", 12, "<ci> holds <sep/>; it must hold a name and"),
        ("<apply><times/><cn>0.5</cn>", "<apply><root/><degree/>", 12, "<degree> holds 0 values; it"),
        ("<apply><times/><cn>0.5</cn>", "<apply><root/><degree><cn>3</cn><cn>2</cn></degree>", 12,
         "<degree> holds 2 values; it must hold one"),
        ("<apply><times/><cn>0.5</cn>", "<apply><root/><degree><cn>3</cn></degree>\n<degree><cn>2</cn>"
         "</degree>", 13, "a second <degree> of <root/>"),
        ("<apply><times/><cn>0.5</cn>", "<apply><log/><logbase/>", 12, "<logbase> holds 0 values"),
        ("<apply><times/><cn>0.5</cn>", "<apply><log/><logbase><cn>3</cn><cn>2</cn></logbase>", 12,
         "<logbase> holds 2 values; it must hold one"),
        ("<apply><times/><cn>0.5</cn>", "<apply><log/><degree><cn>2</cn></degree>", 12,
         "<log/> has no <degree>; that is for <root/>"),
        ("<cn>0.5</cn>", "<degree><cn>2</cn></degree>", 12, "<times/> has no <degree>"),
        ("<times/><cn>0.5</cn>", "<times/>2<cn>0.5</cn>", 12, "<apply> holds the text '2'; numbers"),
        ("<times/><cn>0.5</cn>", "<times><cn>2</cn></times><cn>1</cn>", 12, "<times> holds <cn/>; it"),
        ("<cn>0.5</cn>", f"<piecewise>{PIECE}{OTHERWISE}\n{OTHERWISE}</piecewise>", 13,
         "a second <otherwise>"),
        ("<cn>0.5</cn>", f"<piecewise>{PIECE}\n<foo/>{OTHERWISE}</piecewise>", 13,
         "<piecewise> holds <foo>; it must hold <piece>s"),
        ("<cn>0.5</cn>", f"<piecewise>{PIECE}<otherwise/></piecewise>", 12, "holds 0 values"),
        ("<cn>0.5</cn>", f"<piecewise>{OTHERWISE}</piecewise>", 12, "<piecewise> needs a <piece>"),
        ("<cn>0.5</cn>", f"<piecewise>{PIECE}\n<otherwise><cn>1</cn><cn>2</cn></otherwise></piecewise>",
         13, "<otherwise> holds 2 values; it must hold one"),
        ("-1.0, 0.0, <!--", "-1.0,, <!--", 31, "<dataTable> has an empty cell after '-1.0'; write"),
        ("-2.0, 0.0, 4.0,", "-2.0; ;4.0", 31, "an empty cell after '-2.0'"),
        ("-2.0, 0.0, 4.0,", "-2.0, 0.0, 4.0,\n,", 31, "an empty cell after '4.0'"),
        ("-1.0, 0.0, <!--", ", 0.0, <!--", 31, "<dataTable> has an empty cell at the beginning"),
        ("0 100</bpVals>", "0,,100</bpVals>", 23, "<bpVals> has an empty cell after '0'"),
        ('units="lbf"', 'units="pounds"', 16, "'force' is in unknown units 'pounds'; say in the patch"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_model_is_told_with_its_line(flown, old, new, line, said):
    assert old in MODEL
    with pytest.raises(PatchError) as caught:
        flown(MODEL.replace(old, new, 1))
    message = str(caught.value)
    assert said in message
    assert message.partition(": ")[0].endswith(f"wing.dml:{line}"), message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("file: wing.dml", "file: wings.dml", 5, "'wings.dml' cannot be read: No such file"),
        ("    file: wing.dml\n", "", 4, "model 'wing' has no file"),
        ("angleOfAttack: alpha * 1", "angleOfAtack: alpha", 6, "no variable 'angleOfAtack'"),
        ("angleOfAttack: alpha * 1", "span: 1 ft", 6, "'b' is no input of "),
        ("angleOfAttack: alpha * 1, v: v", "alpha: 1, angleOfAttack: 1, v: v", 6, "is given twice"),
        ("angleOfAttack: alpha * 1, ", "", 4, "needs its input 'angleOfAttack'"),
        ("v: v}\n", "v: alpha}\n", 6, "the speed, 'alpha' [1], must be in m/s"),
        ("alpha * 1,", "v,", 6, "input 'angleOfAttack' of model 'wing' is connected to what is in m/s"),
        ("v: v}\n", "v: w}\n", 6, "reads unknown 'w'"),
        ("v: v}\n", "v: v +}\n", 6, "not arithmetic"),
        ("v: v}\n", "v: wing}\n", 6, "'wing' is a model; read one of its outputs, such as wing.span"),
        ("force: wing.force\n", "force: wing.forces\n", 10, "'forces'; did you mean 'force'"),
        ("force: wing.force\n", "force: wings.force\n", 10, "reads unknown 'wings.force'"),
        ("force: wing.force\n", "force: wing.force + v\n", 10, "must have the same units"),
        ("force: wing.force\n", "force: wing.force(v)\n", 10, "is not arithmetic"),
        ("    span: wing.span\n", "    wing: 1\n    span: 1\n", 12, "'wing' is defined twice"),
        ("run:", "record: [wing.force]\nrun:", 14, "wing.force"),
        ("    inputs:", "    units: {f: pound of}\n    inputs:", 6, "unit of 'force': cannot read"),
        ("    inputs:", "    unit: {f: lbf}\n    inputs:", 6, "unknown key 'unit'"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_the_patch_is_told_with_its_line(flown, old, new, line, said):
    assert old in PATCH
    with pytest.raises(PatchError) as caught:
        flown(patch=PATCH.replace(old, new, 1))
    message = str(caught.value)
    assert said in message
    assert message.partition(": ")[0].endswith(f"a.yaml:{line}"), message
    assert "\n" not in message


@pytest.mark.parametrize("kind", ["isInput", "isControl", "isDisturbance", "isState"])
def test_what_is_given_from_outside_is_no_constant(flown, kind, tmp_path):
    """v is an input of any kind with an initial value, which it has where nothing is connected."""
    given = 'minValue="10"><isInput/>', f'minValue="10" initialValue="40"><{kind}/>'
    model, alone = (
        MODEL.replace(*given),
        PATCH.replace(", v: v}", "}").replace(", v: 50 ft/s}", "}"),
    )
    made = flown(model)
    assert made.record["force"].values[-1] == pytest.approx(0.75 * 50 * 30 * LBF, rel=16 * EPS)
    made = flown(model, alone)
    assert made.record["force"].values[-1] == pytest.approx(0.7 * 40 * 30 * LBF, rel=16 * EPS)
    warned = check(tmp_path / "a.yaml", trial=False).warnings
    assert [line for line in warned if "is not connected" in line] == [
        f"{tmp_path}/wing.dml:7: input 'wing.speed' is not connected; it has its initialValue, 40 ft_s"
    ]
    flown(model)
    assert not any("connected" in w for w in check(tmp_path / "a.yaml", trial=False).warnings)
    made = flown(model.replace('"40"', '"4"'), alone)  # the limit is for it, too
    assert made.record["force"].values[-1] == pytest.approx(0.55 * 10 * 30 * LBF, rel=16 * EPS)
    assert made.outside[0]["value"] == 4.0


def test_a_name_of_any_length_is_told_in_one_line(flown):
    long = "x" * 1_000_000
    model = MODEL.replace('name="speed"', f'name="{long}"').replace('name="span"', 'name="a&#10;b"')
    patch = PATCH.replace("v: v}", "w: v}")
    with pytest.raises(PatchError) as caught:
        flown(model, patch)
    assert len(str(caught.value)) < 400 and "\n" not in str(caught.value)
    assert "no variable 'w'; valid: " in str(caught.value) and "xxx..." in str(caught.value)


def test_units_given_in_the_patch_replace_those_of_the_file(flown):
    model = MODEL.replace('units="lbf"', 'units="pounds"')
    patch = PATCH.replace("    inputs:", "    units: {force: lbf}\n    inputs:")
    assert flown(model, patch).record["force"].values[-1] == pytest.approx(0.75 * 1500 * LBF)


def test_variables_of_one_name_are_told_apart_by_their_id(flown):
    model = MODEL.replace('name="span" varID="b"', 'name="lift" varID="b"')
    assert flown(model, PATCH.replace("wing.span", "wing.b")).record["span"].values[-1] == 30 * FT
    with pytest.raises(
        PatchError, match=r"a.yaml:10: .*2 variables of the model are named 'lift'; .* b or cl"
    ):
        flown(model, PATCH.replace("wing.span", "wing.b").replace("wing.force\n", "wing.lift\n", 1))
    with pytest.raises(PatchError, match=r"a.yaml:6: .*named 'lift'"):
        flown(model, PATCH.replace("{angleOfAttack: ", "{lift: 1, angleOfAttack: "))


def test_a_file_that_is_not_where_a_variable_of_the_environment_says(flown, monkeypatch):
    monkeypatch.delenv("MODELS_HERE", raising=False)
    for path, said in (
        ("$MODELS_HERE/wing.dml", "the environment has no variable MODELS_HERE; set it"),
        (
            "${MODELS_HERE:-away}/wing.dml",
            "paths are relative to the patch, unless MODELS_HERE says",
        ),
    ):
        with pytest.raises(PatchError, match=said.replace("$", ".")):
            flown(patch=PATCH.replace("file: wing.dml", f'file: "{path}"'))


def test_a_model_reads_another_and_bare_numbers_are_in_si(flown):
    patch = PATCH.replace(
        "digital:", "  tip: {file: wing.dml, inputs: {alpha: wing.twist, v: 15.24}}\ndigital:"
    ).replace("twist: wing.twist + wing.alpha", "twist: tip.force")
    found = flown(patch=patch).record["twist"].values[-1]
    assert found == pytest.approx(0.375 * 50 * 30 * LBF, rel=32 * EPS)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("nd", 1.0),
        ("pct", 0.01),
        ("ft_s", FT),
        ("ft_s2", FT),
        ("slugft2", 14.593902937206364 * FT**2),
        ("ftlbf", FT * LBF),
        ("lbf_ft2", LBF / FT**2),
        ("_deg", 180 / math.pi),
        ("deg_s", math.pi / 180),
        ("rad_s", 1.0),
        ("h_nmi", 3600 / 1852),
        ("kgm2", 1.0),
        ("psf", LBF / FT**2),
        ("deg_deg", 1.0),
    ],
)
def test_units_of_the_standard(text, expected):
    assert unit_of(f"1 {unit_text(text)}".strip())[1] == pytest.approx(expected, rel=4 * EPS)


@pytest.mark.parametrize("text", ["", "_", "furlong", "ft__s", "ft_", "degC", "lb", "nim_h"])
def test_what_is_no_unit_of_the_standard(text):
    assert unit_text(text) is None


# --- what messages call a variable ----------------------------------------------------------------

LOOPED = """\
title: Model in a loop
parameters: {half: 0.5 deg, v: 50 ft/s}
models:
  wing:
    file: wing.dml
    inputs: {angleOfAttack: s * half, v: v}
analog: {x: {integrate: {u: 1 1/s}, initial: 0.1, full_scale: 1}}
interface:
  s: {adc: x}
  u: {dac: w, full_scale: 1000, initial: 0}
digital:
  period: 10 ms
  program: {w: -wing.twist}
run: {until: 1 s}
"""
HALF = "<times/><cn>0.5</cn><ci>alpha</ci>"


def told(tmp_path, capsys, *command, model=MODEL, patch=LOOPED):
    (tmp_path / "wing.dml").write_text(model, encoding="utf-8")
    (tmp_path / "a.yaml").write_text(patch, encoding="utf-8")
    verb, *options = command
    code = main([verb, str(tmp_path / "a.yaml"), *options])
    out, err = capsys.readouterr()
    assert "wing:" not in out + err
    return code, out, err


@pytest.mark.parametrize(
    ("calculation", "says"),
    [
        (
            "<divide/><cn>0.5</cn><cn>0</cn>",
            "wing.dml:10: word 'wing.twist': '0.5/0' has no finite",
        ),
        ("<divide/><ci>alpha</ci><ci>cl</ci>", "wing.dml:9: word 'wing.lift' is not linear"),
    ],
)
def test_messages_name_a_variable_as_the_program_reads_it(tmp_path, capsys, calculation, says):
    """By its name in the file, not by what arithmetic calls it inside; with its line in the file."""
    model = MODEL.replace(HALF, calculation).replace(' minValue="10"', "")
    code, _, err = told(tmp_path, capsys, "predict", model=model)
    assert (code, err.count("\n")) == (2, 1) and says in err


def test_loops_runs_and_moves_name_variables_alike(tmp_path, capsys):
    _, out, _ = told(tmp_path, capsys, "check", "--no-trial")
    assert "s -> wing.angleOfAttack -> wing.twist -> w -> u -> x" in out
    code, _, err = told(tmp_path, capsys, "check", "--no-trial", "--on", "analog")
    assert code == 2 and "word 'wing.twist' is of a model, which has no analog form" in err
    code, _, err = told(tmp_path, capsys, "check", "--no-trial", "--on", "wing=analog")
    assert code == 2 and "no part, signal or word 'wing'; valid: w, wing.twist, x" in err
    fixed = LOOPED.replace("period: 10 ms", "period: 10 ms\n  word: {fixed: 16, full_scale: 10}")
    fixed = fixed.replace("{w: -wing.twist}", "{w: -wing.twist, force: wing.force}")
    folder = ["--no-chart", "--out", str(tmp_path)]
    code, out, _ = told(tmp_path, capsys, "run", *folder, patch=fixed)
    assert code == 1 and "wing.speed does not fit into its word" in out
    pole = MODEL.replace(
        HALF, "<divide/><cn>0.5</cn><apply><minus/><ci>alpha</ci><ci>alpha</ci></apply>"
    )
    pole = pole.replace(' maxValue="3"', "")  # which would hold what is infinite
    code, out, _ = told(tmp_path, capsys, "run", *folder, model=pole)
    assert code == 1 and "no finite number for wing.twist, w (" in " ".join(out.split())


def test_names_that_are_no_words_or_come_twice_are_read_by_their_id():
    """A name that two variables have stands for neither; nor does one of several words."""
    text = MODEL.replace('name="lift" varID', 'name="span" varID').replace(
        'name="twist" varID', 'name="a twist" varID'
    )
    model = read_model(text, "wing.dml", "w")
    assert dict(model.words) == {
        "alpha": "angleOfAttack",
        "v": "speed",
        "b": "b",
        "cl": "cl",
        "twist": "twist",
        "f": "force",
    }
    # An id that is the name of another is not that other: find() goes by names first.
    swapped = MODEL.replace('name="lift" varID="cl"', 'name="x y" varID="speed"').replace(
        "> cl <", ">speed<"
    )
    model = read_model(swapped.replace('varID="cl"', 'varID="speed"'), "wing.dml", "w")
    assert model.find("speed").id == "v" and len(set(model.words.values())) == len(model.words)
    assert model.words["v"] == "speed"


@pytest.mark.parametrize(
    ("a", "b", "quotient", "rem"),
    [(7, 3, 2, 1), (-7, 3, -2, -1), (7, -3, -2, 1), (-7, -3, 2, -1), (6, 3, 2, 0), (0, 3, 0, 0),
     (0.7, 0.1, 6, math.fmod(0.7, 0.1)), (1e15, 7, 142857142857142, math.fmod(1e15, 7))],
)  # fmt: skip
def test_quotient_and_remainder_of_mathml(a, b, quotient, rem):
    """MathML 2, 4.4.3.1 and 4.4.3.5: towards 0, and the remainder has the sign of a, as C's fmod has."""
    for tag, expected in (("quotient", quotient), ("rem", rem)):
        text = f"<math><apply><{tag}/><cn>{a}</cn><cn>{b}</cn></apply></math>"
        assert evaluate(read_math(read_xml(text, ""), lambda name, _: name), {}) == expected


def test_exclusive_or_of_mathml():
    """True where an odd number of its operands is; any number but 0 is true."""
    for values in itertools.product((0, 1, 2.5), repeat=3):
        for count in (1, 2, 3):
            operands = "".join(f"<cn>{value}</cn>" for value in values[:count])
            root = read_xml(f"<math><apply><xor/>{operands}</apply></math>", "")
            found = evaluate(read_math(root, lambda name, _: name), {})
            assert found == sum(map(bool, values[:count])) % 2


PIECES = (
    "<piecewise><piece><cn>1</cn><apply><lt/><ci>alpha</ci><cn>4</cn></apply></piece>"
    "<piece><cn>2</cn><apply><gt/><ci>alpha</ci><cn>LIMIT</cn></apply></piece></piecewise>"
)


def test_a_choice_that_no_piece_makes_ends_the_run(flown):
    """alpha is 5: with a piece for what is above 4.5 the force is 2 lbf, with one above 6 nothing is."""
    old = "<apply><times/><ci> cl </ci><ci>v</ci><ci>b</ci></apply>"
    made = flown(MODEL.replace(old, PIECES.replace("LIMIT", "4.5")))
    assert made.record["force"].values[-1] / LBF == pytest.approx(2, rel=4 * EPS)
    ended = flown(MODEL.replace(old, PIECES.replace("LIMIT", "6")))
    assert ended.status == "stopped" and "computed no finite number for" in ended.status_note
    told = "(a <piecewise> without <otherwise> of which no piece holds, in wing.force ("
    line = 1 + MODEL[: MODEL.index('varID="f"')].count("\n")
    assert told in ended.status_note and f"wing.dml:{line}), " in ended.status_note
    plain = flown(
        MODEL.replace(
            old, "<apply><divide/><cn>0</cn><apply><minus/><ci>v</ci><ci>v</ci></apply></apply>"
        )
    )
    assert plain.status == "stopped" and "piecewise" not in plain.status_note


@pytest.mark.parametrize("encoding", ["UTF-8", "utf-16", "ISO-8859-1", "us-ascii", "windows-1252"])
def test_a_model_is_read_by_the_encoding_that_it_declares(flown, tmp_path, encoding):
    """The same figures, and words in the letters of the file; the second byte of a letter in UTF-8 would
    be another letter in ISO-8859-1."""
    plain = float(flown(MODEL).record["force"][-1])
    letters = "" if encoding == "us-ascii" else "\u00c4\u00e9"
    body = MODEL.split("?>", 1)[-1]
    model = f'<?xml version="1.0" encoding="{encoding}"?>\n<!-- {letters} -->{body}'
    (tmp_path / "wing.dml").write_bytes(model.encode(encoding))
    assert float(run(read_patch(tmp_path / "a.yaml")).record["force"][-1]) == plain


@pytest.mark.parametrize(
    ("declared", "written", "says"),
    [
        ("UTF-8", "ISO-8859-1", "not a text in UTF-8; save it as UTF-8"),
        (
            "EBCDIC",
            "UTF-8",
            "declares the encoding 'EBCDIC'; those read are UTF-8, UTF-16, ISO-8859-1",
        ),
        ("UTF-16", "UTF-8", "declares the encoding UTF-16, but is not in UTF-16"),
        ("UTF-8", "UTF-16", "declares the encoding UTF-8, but is in UTF-16; declare what it is"),
        ("us-ascii", "UTF-8", "not a text in US-ASCII; save it as UTF-8"),
    ],
)
def test_a_model_in_another_encoding_than_declared_is_refused(
    flown, tmp_path, declared, written, says
):
    flown(MODEL)
    body = MODEL.split("?>", 1)[-1]
    model = f'<?xml version="1.0" encoding="{declared}"?><!-- \u00c4 -->{body}'
    (tmp_path / "wing.dml").write_bytes(model.encode(written))
    with pytest.raises(PatchError, match=r"wing.dml:1: " + re.escape(says)):
        read_patch(tmp_path / "a.yaml")


def test_numbers_in_e_notation():
    """MathML 2, 4.4.1.1: the mantissa, <sep/>, the power of ten."""
    for text, value in (("5<sep/>-1", 0.5), (" 1.25 <sep/> +3 ", 1250.0), ("-7<sep/>0", -7.0)):
        root = read_xml(f'<math><cn type="e-notation">{text}</cn></math>', "")
        assert evaluate(read_math(root, lambda name, _: name), {}) == value


@pytest.mark.parametrize(
    ("tag", "rising", "level", "falling"),
    [("lt", 1, 0, 0), ("leq", 1, 1, 0), ("gt", 0, 0, 1), ("geq", 0, 1, 1), ("eq", 0, 0, 0)],
)
def test_relations_of_three_operands_hold_from_each_to_the_next(tag, rising, level, falling):
    """MathML 2, 4.2.4: relations but neq are n-ary."""
    for values, expected in (((1, 2, 3), rising), ((1, 1, 2), 0), ((3, 2, 1), falling)):
        operands = "".join(f"<cn>{value}</cn>" for value in values)
        root = read_xml(f"<math><apply><{tag}/>{operands}</apply></math>", "")
        found = evaluate(read_math(root, lambda name, _: name), {})
        assert found == (expected if values != (1, 1, 2) else int(tag == "leq"))
    same = read_xml(f"<math><apply><{tag}/>{'<cn>2</cn>' * 4}</apply></math>", "")
    assert evaluate(read_math(same, lambda name, _: name), {}) == max(level, tag == "eq")


def test_a_long_chain_of_variables_is_gone_through_once(tmp_path, monkeypatch):
    """Each of 300 variables is read by the next one and by the program: each is looked at twice."""
    count, looks = 300, []
    chain = "".join(
        f'<variableDef name="x{i}" varID="x{i}" units="nd"><calculation><math><apply><plus/>'
        f"<ci>x{i - 1}</ci><cn>1</cn></apply></math></calculation></variableDef>"
        for i in range(1, count)
    )
    first = '<variableDef name="x0" varID="x0" units="nd"><isInput/></variableDef>'
    (tmp_path / "m.dml").write_text(f"<DAVEfunc>{first}{chain}</DAVEfunc>", encoding="utf-8")
    words = ", ".join(f"w{i}: m.x{i}" for i in range(1, count))
    (tmp_path / "a.yaml").write_text(
        "title: Chain\nmodels: {m: {file: m.dml, inputs: {x0: 1}}}\n"
        f"digital: {{period: 1 s, program: {{{words}}}}}\nrun: {{until: 1 s}}\n"
    )
    needs = daveml._needs
    monkeypatch.setattr(daveml, "_needs", lambda *given: looks.append(1) or needs(*given))
    patch = read_patch(tmp_path / "a.yaml")
    assert len(looks) == 2 * count  # in search of loops, and for the program
    assert run(patch).record[f"w{count - 1}"].values[-1] == count
