"""Sub-patches: what is written out of them, by which names, and what is said of wrong ones."""

from __future__ import annotations

import json
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import xarray
import yaml

import hybrid
from hybrid.cli import main
from hybrid.errors import PatchError
from hybrid.expressions import Name, to_text
from hybrid.parsing import parse
from hybrid.patchfile import parse_patch, read_patch
from hybrid.patchfile.parts import DEEPEST_PARTS, MOST_PARTS
from hybrid.schema import json_schema

WHEEL = """\
title: A wheel that follows a demand
inputs:
  moment: {constant: 1 N*m, full_scale: 2 N*m}
  demand: 2*base
outputs: [rate, angle, sum]
parameters:
  inertia: 2 kg*m^2
  base: top/4
  top: 10 rad/s
analog:
  rate: {integrate: {moment: 1/inertia, push: 1/inertia}, initial: base, full_scale: top}
  angle: {integrate: {rate: 1}, initial: 0, full_scale: 100}
interface:
  rate_word: {adc: rate, bits: 12}
  push: {dac: wrong, full_scale: 10 N*m, initial: 0}
digital:
  period: 10 ms
  program:
    wrong: gain*(demand - rate_word)
    gain: 1 kg*m^2/s
    sum: wrong + previous(sum)
  remember: {sum: 0 N*m}
run: {until: 1 s}
"""

TWO = """\
title: Two wheels
machine: ideal
parameters: {cycle: 5 ms, big: 3 kg*m^2}
analog:
  push: {constant: 1 N*m, full_scale: 2 N*m}
  turned: {coefficient: {left.rate: 0.5 N*m*s}, full_scale: 20 N*m}
digital: {period: cycle}
parts:
  left: {file: wheel.yaml, inputs: {moment: push, demand: right.sum/half}, parameters: {inertia: big}}
  right: {file: wheel.yaml, inputs: {moment: turned, demand: 1 rad/s}, parameters: {base: 0}}
run: {until: 0.5 s}
readouts: {end: {final: left.angle}}
"""
TWO = TWO.replace("big: 3 kg*m^2", "big: 3 kg*m^2, half: 40 N*m*s")

# The same, written out by hand.
FLAT = """\
title: Two wheels
machine: ideal
parameters: {cycle: 5 ms, big: 3 kg*m^2, half: 40 N*m*s, top: 10 rad/s}
analog:
  push: {constant: 1 N*m, full_scale: 2 N*m}
  turned: {coefficient: {left_rate: 0.5 N*m*s}, full_scale: 20 N*m}
  left_rate: {integrate: {push: 1/big, left_push: 1/big}, initial: top/4, full_scale: top}
  left_angle: {integrate: {left_rate: 1}, initial: 0, full_scale: 100}
  right_rate: {integrate: {turned: 0.5, right_push: 0.5}, initial: 0, full_scale: top}
  right_angle: {integrate: {right_rate: 1}, initial: 0, full_scale: 100}
interface:
  left_rate_word: {adc: left_rate, bits: 12}
  left_push: {dac: left_wrong, full_scale: 10 N*m, initial: 0}
  right_rate_word: {adc: right_rate, bits: 12}
  right_push: {dac: right_wrong, full_scale: 10 N*m, initial: 0}
digital:
  period: cycle
  program:
    left_demand: right_sum/half
    left_wrong: left_gain*(left_demand - left_rate_word)
    left_gain: 1 kg*m^2/s
    left_sum: left_wrong + previous(left_sum)
    right_demand: 1 rad/s
    right_wrong: right_gain*(right_demand - right_rate_word)
    right_gain: 1 kg*m^2/s
    right_sum: right_wrong + previous(right_sum)
  remember: {left_sum: 0 N*m, right_sum: 0 N*m}
run: {until: 0.5 s}
readouts: {end: {final: left_angle}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "wheel.yaml").write_text(WHEEL)
    (tmp_path / "two.yaml").write_text(TWO)
    return tmp_path


def test_parts_are_the_patch_written_out_by_hand(folder: Path) -> None:
    parts, flat = hybrid.run(read_patch(folder / "two.yaml")), hybrid.run(parse_patch(FLAT))
    assert {name.replace(".", "_") for name in parts.record} == set(flat.record)
    for name in parts.record:
        written = flat.record[str(name).replace(".", "_")]
        np.testing.assert_array_equal(parts.record[name], written, err_msg=str(name))
        assert parts.record[name].attrs["units"] == written.attrs["units"]
    assert np.ptp(parts.record["right.rate"].values) > 0.1


def test_order_of_parts_changes_nothing(folder: Path) -> None:
    left, right = (
        next(x for x in TWO.splitlines(True) if f"  {w}:" in x) for w in ("left", "right")
    )
    (folder / "turned.yaml").write_text(TWO.replace(left + right, right + left))
    one, other = (hybrid.run(folder / f"{n}.yaml").record for n in ("two", "turned"))
    assert one.equals(other)


def test_a_sub_patch_runs_by_itself_on_what_stands_in(folder: Path) -> None:
    record = hybrid.run(folder / "wheel.yaml", machine="ideal").record
    # From base = 2.5 rad/s: rate' = (1 + (5 - rate))/2, to 12 bits and a held output.
    expected = 6 - 3.5 * np.exp(-record.time / 2)
    np.testing.assert_allclose(record["rate"], expected, atol=0.02)
    assert (record["demand"][1:] == 5.0).all()


def test_parameters_are_set_by_dotted_names(folder: Path) -> None:
    patch = read_patch(folder / "two.yaml")
    numbers = patch.bind({"big": 4.0, "right.top": 20.0})
    assert numbers["left.inertia"] == 4.0 and numbers["right.inertia"] == 2.0
    assert numbers["left.base"] == 2.5 and numbers["right.base"] == 0.0
    assert numbers["left.top"] == 10.0 and numbers["right.top"] == 20.0


def test_commands_take_dotted_names(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    options = ["--set", "right.top=20 rad/s", "--xy", "left.rate:right.rate", "--json"]
    main(["run", "two.yaml", *options])
    answer = json.loads(capsys.readouterr().out)
    assert answer["parameters_si"]["right.top"] == 20.0
    assert answer["files"][0].startswith("out/two_right.top=20")
    with xarray.open_dataset(answer["files"][0]) as record:
        assert record["right.rate"].attrs["full_scale"] == 20.0
        assert answer["readouts"]["end"]["value"] == record["left.angle"][-1]
    main(["draw", "two.yaml", "--out", "two.svg"])
    drawn = re.sub("<[^>]*>", " ", Path("two.svg").read_text())
    assert "left.rate" in drawn and "right.rate" in drawn
    main(["sweep", "two.yaml", "--over", "right.top=10:20:2", "--jobs", "1", "--no-chart"])
    assert Path("out/two_over_right.top.nc").exists()


def test_the_hash_covers_the_files_of_sub_patches(folder: Path) -> None:
    before = hybrid.run(folder / "two.yaml").record.attrs["patch_hash"]
    (folder / "wheel.yaml").write_text(WHEEL + "# a remark\n")
    assert hybrid.run(folder / "two.yaml").record.attrs["patch_hash"] != before


LIBRARY = (
    """\
title: A train of lags
machine: ideal
parameters: {slow: 2 s}
inputs: {in: {step: 1, at: 0.1 s, full_scale: 1}}
definitions:
  one:
    inputs: {in: {constant: 0, full_scale: 1}}
    parameters: {time: 1 s}
    analog: {out: {lag: {in: 1}, time_constant: time, full_scale: 1}}
  two:
    inputs: {in: {constant: 0, full_scale: 1}}
    outputs: [late.out]
    parameters: {time: 1 s}
    parts:
      early: {use: one, inputs: {in: in}, parameters: {time: time}}
      late: {use: one, inputs: {in: early.out}, parameters: {time: 2*time}}
parts:
  pair: {use: two, inputs: {in: in}, parameters: {time: slow}}
analog:
  last: {sum: {pair.late.out: 1}, full_scale: 1}
run: {until: 1 s, every: 0.1 s}
""".replace("in:", "entry:")
    .replace("{in: 1}", "{entry: 1}")
    .replace(": in}", ": entry}")
)


def test_definitions_in_the_file_and_parts_of_parts(tmp_path: Path) -> None:
    patch = parse_patch(LIBRARY)
    by_name = {c.name: c for c in patch.components}
    assert set(by_name) == {"entry", "pair.early.out", "pair.late.out", "last"}
    assert by_name["pair.early.out"].sources == ("entry",)
    assert by_name["pair.late.out"].sources == ("pair.early.out",)
    assert patch.bind({"slow": 3.0})["pair.late.time"] == 6.0
    (tmp_path / "library.yaml").write_text(LIBRARY)
    user = (
        "title: User\nmachine: ideal\nanalog: {one: {step: 1, at: 0.5 s, full_scale: 1}}\n"
        "parts: {lag: {file: library.yaml, use: one, inputs: {entry: one}}}\n"
        "run: {until: 1 s, every: 0.5 s}\n"
    )
    (tmp_path / "user.yaml").write_text(user)
    record = hybrid.run(tmp_path / "user.yaml").record
    assert float(record["lag.out"][-1]) == pytest.approx(1 - np.exp(-0.5), abs=1e-12)


def test_words_of_a_sub_patch_may_be_remembered_inputs(folder: Path) -> None:
    text = WHEEL.replace("previous(sum)", "previous(demand)*gain").replace(
        "{sum: 0 N*m}", "{demand: 7 rad/s}"
    )
    (folder / "wheel.yaml").write_text(text)
    record = hybrid.run(folder / "two.yaml").record
    first = record["right.sum"][1]
    assert first == pytest.approx(record["right.wrong"][1] + 7.0)


def test_a_word_has_the_unit_of_what_stands_in_for_it() -> None:
    text = (
        "title: T\ndefinitions:\n  twice: {inputs: {x: 1 m}, digital: {program: {y: 2*x}}}\n"
        "parts: {a: {use: twice, inputs: {x: 3 s}}}\n"
        "digital: {period: 1 ms}\nrun: {until: 1 s}\n"
    )
    with pytest.raises(
        PatchError, match=r"^t:4: input 'x' of part 'a' .t:3. must be in m; .* a time"
    ):
        parse_patch(text, "t")
    parse_patch(text.replace("3 s", "3 km"), "t")


def test_dotted_names_are_arithmetic() -> None:
    tree = parse("2*a.b.c - previous(w.x_1)", allow_previous=True)
    assert Name("a.b.c") in (tree.left.right,)  # type: ignore[union-attr]
    assert parse(to_text(tree), allow_previous=True) == tree


def _wrong(name: str, old: str, new: str, *says: str, line: int = 0, file: str = "two") -> object:
    """TWO or WHEEL with `old` replaced; the message begins with the line and has all of `says`."""
    return pytest.param(file, old, new, line, says, id=name)


@pytest.mark.parametrize(
    ("file", "old", "new", "line", "says"),
    [
        _wrong("input", "demand: 1 rad/s", "demnd: 1 rad/s", "no input 'demnd'", "'demand'", line=10),
        _wrong("parameter", "{inertia:", "{inertai:", "no parameter 'inertai'", "'inertia'", line=9),
        _wrong("open", "moment: turned, ", "", "leaves input 'moment'", "wheel.yaml:3", line=10),
        _wrong("output", "{left.rate:", "{left.push:", "'push' is no output", "wheel.yaml", line=6),
        _wrong("no output", "right.sum/", "right.smu/", "'smu' is no output", "'sum'", line=9),
        _wrong("no part", "{left.rate:", "{lift.rate:", "'lift.rate'", "'left.rate'", line=6),
        _wrong("file", "left: {file: wheel", "left: {file: wheal", "No such file", "two.yaml:9"),
        _wrong("no file", "left: {file: wheel.yaml, ", "left: {", "give file: FILE, or use:", line=9),
        _wrong("use", "left: {file: wheel.yaml", "left: {use: wheel", "unknown definition", line=9),
        _wrong("key", "left: {file: wheel", "left: {of: 1, file: wheel", "'of'", "file", line=9),
        _wrong("list", "{file: wheel.yaml, inputs: {mo", "{file: [a], inputs: {mo", "a list", line=9),
        _wrong("coefficient", "moment: turned", "moment: 2*turned", "name of a signal", line=10),
        _wrong("word", "moment: turned", "moment: left.sum", "program word", "wheel.yaml:3", line=10),
        _wrong("unit", "moment: turned", "moment: left.rate", "wheel.yaml:3", "kg*m^2/s^2", line=10),
        _wrong("word's unit", "demand: 1 rad/s", "demand: 1 m", "(wheel.yaml:4) must be", line=10),
        _wrong("setting", "inertia: big", "inertia: cycle", "wheel.yaml:7", "kg*m^2", line=9),
        _wrong("unknown", "inertia: big", "inertia: bog", "'bog'", "'big'", line=9),
        _wrong("name", "  left:", "  push:", "'push' is defined twice", line=9),
        _wrong("reserved", "  left:", "  sin:", "cannot name a part", line=9),
        _wrong("dot", "  push: {c", "  a.b: {c", "only parts: makes names with a dot", line=5),
        _wrong("no clock", "digital: {period: cycle}\n", "", "needs a digital machine", "of two.yaml:8"),
        _wrong("not a mapping", "parts:\n  left: {", "parts:\n  left: 3 #", "mapping", line=9),
        _wrong("closed", "demand - rate", "cycle - rate", "unknown 'left.cycle'", "of two.yaml:9",
               file="wheel", line=19),
        _wrong("own", "push: 1/inertia", "push: 1/inartia", "'left.inartia'", "(part left of",
               file="wheel", line=11),
        _wrong("product", "initial: base", "initial: 2 base", "write 2*base", file="wheel", line=11),
        _wrong("key of it", "full_scale: top", "fullscale: top", "'fullscale'", "(part left of",
               file="wheel", line=11),
        _wrong("section", "analog:\n", "anolog:\n", "'anolog'", file="wheel", line=10),
        _wrong("yaml", "{adc: rate,", "{adc: rate: 1", "not valid YAML", "of two.yaml:9",
               file="wheel", line=14),
        _wrong("listed output", "outputs: [rate,", "outputs: [rat,", "unknown signal 'rat'",
               file="wheel", line=5),
        _wrong("outputs", "outputs: [rate, angle, sum]", "outputs: rate", "a list", file="wheel",
               line=5),
        _wrong("input of a signal's name", "  demand: 2", "  wrong: 2", "defined twice", file="wheel",
               line=4),
        _wrong("input without", "demand: 2*base", "demand: []", "stand in", file="wheel", line=4),
        _wrong("no scale", "1 N*m, full_scale: 2 N*m}", "1 N*m}", "no full_scale", file="wheel",
               line=3),
        _wrong("itself", "outputs: [rate", "parts: {x: {file: wheel.yaml}}\noutputs: [rate",
               "part of itself: ", file="wheel", line=5),
    ],
)  # fmt: skip
def test_mistakes_are_told_in_both_places(
    folder: Path, file: str, old: str, new: str, line: int, says: tuple[str, ...]
) -> None:
    text = TWO if file == "two" else WHEEL
    assert old in text
    (folder / f"{file}.yaml").write_text(text.replace(old, new, 1))
    with pytest.raises(PatchError) as caught:
        read_patch(folder / "two.yaml")
    message = str(caught.value).replace(f"{folder}/", "")
    assert "\n" not in message
    for part in says:
        assert part in message, message
    if line:
        assert re.match(rf"{file}\.yaml:{line}[: ]", message), message
    if file == "wheel":
        assert "(part left of two.yaml:9)" in message, message


def test_one_signal_on_two_inputs_of_a_component_counts_twice(folder: Path) -> None:
    text = WHEEL.replace("  demand:", "  other: {constant: 0 N*m, full_scale: 1 N*m}\n  demand:")
    wheel = text.replace("{moment: 1/inertia,", "{moment: 1/inertia, other: 2/inertia,")
    (folder / "wheel.yaml").write_text(wheel)
    two = TWO.replace("inputs: {moment:", "inputs: {other: push, moment:")
    (folder / "two.yaml").write_text(two)
    patch = read_patch(folder / "two.yaml")
    terms = next(dict(c.terms) for c in patch.components if c.name == "left.rate")
    assert terms["push"].number({"left.inertia": 1.5}) == 2.0
    (folder / "wheel.yaml").write_text(wheel.replace("other: 2/inertia", "other: 2 1/s"))
    with pytest.raises(PatchError, match=r"both connected to 'push'.*parameters"):
        read_patch(folder / "two.yaml")


def _chain(count: int, uses: int) -> str:
    """Definitions each of which uses the next `uses` times."""
    lines = ["title: Many", "run: {until: 1 s, every: 1 s}", "definitions:"]
    lines.append("  d0: {analog: {x: {constant: 1, full_scale: 1}}}")
    for i in range(1, count):
        parts = ", ".join(f"p{k}: {{use: d{i - 1}}}" for k in range(uses))
        lines.append(f"  d{i}: {{parts: {{{parts}}}}}")
    return "\n".join([*lines, f"parts: {{top: {{use: d{count - 1}}}}}", ""])


def test_parts_cannot_unfold_without_end() -> None:
    with pytest.raises(PatchError, match=f"at most {MOST_PARTS} parts"):
        parse_patch(_chain(7, 4))
    with pytest.raises(PatchError, match=f"at most {DEEPEST_PARTS} deep"):
        parse_patch(_chain(DEEPEST_PARTS + 1, 1))
    patch = parse_patch(_chain(DEEPEST_PARTS, 1))
    assert patch.components[0].name == "top." + "p0." * (DEEPEST_PARTS - 1) + "x"


@pytest.mark.parametrize("text", [WHEEL, TWO, LIBRARY], ids=["sub-patch", "patch", "definitions"])
def test_the_schema_knows_parts(text: str) -> None:
    validator = jsonschema.Draft202012Validator(json_schema())
    validator.validate(yaml.safe_load(text))
    for old in ("inputs:", "inputs: {moment"):
        if old in text:
            wrong = yaml.safe_load(text.replace(old, old.replace("inputs", "imputs"), 1))
            assert not validator.is_valid(wrong)


def test_a_sub_patch_has_tables_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "lift.csv").write_text("alpha,other,lift\n0,9,0\n1,9,2\n2,9,3\n")
    (tmp_path / "inner" / "wing.yaml").write_text(
        "title: Wing\n"
        "inputs: {alpha: 0.5}\n"
        "tables:\n"
        "  lift: {inputs: {alpha: 1}, file: lift.csv}\n"
        "  drag: {inputs: {alpha: 1}, values: {0: 1, 2: 5}}\n"
        "digital:\n  period: 1 s\n  program: {force: lift(alpha) - drag(2*alpha)}\n"
        "run: {until: 1 s}\n"
    )
    (tmp_path / "plane.yaml").write_text(
        "title: Plane\n"
        "tables: {drag: {inputs: {alpha: 1}, values: {0: 0, 2: 1}}}\n"
        "parts:\n"
        "  left: {file: inner/wing.yaml, inputs: {alpha: 0.5}}\n"
        "  right: {file: inner/wing.yaml, inputs: {alpha: drag(1.5)}}\n"
        "digital: {period: 1 s}\nrun: {until: 1 s}\n"
    )
    record = hybrid.run(tmp_path / "plane.yaml", machine="ideal").record
    assert float(record["left.force"][-1]) == 1.0 - 3.0
    assert float(record["right.force"][-1]) == 1.5 - 4.0
    text = (tmp_path / "inner" / "wing.yaml").read_text()
    (tmp_path / "inner" / "wing.yaml").write_text(text.replace("lift.csv", "left.csv"))
    with pytest.raises(
        PatchError, match=r"inner/wing.yaml:4 \(part left of .*plane.yaml:4\): .*left.csv"
    ):
        read_patch(tmp_path / "plane.yaml")


def test_words_of_a_sub_patch_have_lengths_and_states_of_their_own() -> None:
    text = (
        "title: T\ndefinitions:\n  third:\n    inputs: {x: 1}\n"
        "    digital:\n      program: {y: x/3}\n      words: {y: float32}\n"
        "      states: {sum: {integrate: y + k, initial: 0, formula: euler}}\n"
        "    parameters: {k: 1}\n"
        "parts:\n  a: {use: third, inputs: {x: 1}}\n  b: {use: third, inputs: {x: a.sum}}\n"
        "digital: {period: 1 s, compute_time: 0}\nrun: {until: 3 s}\n"
    )
    record = hybrid.run(parse_patch(text, "t"), machine="ideal").record
    third = float(np.float32(1) / np.float32(3))
    assert float(record["a.y"][-1]) == third != 1 / 3
    np.testing.assert_allclose(record["a.sum"], (1 + third) * np.array([0, 1, 2, 3]), rtol=1e-15)
    assert float(record["b.y"][-1]) == np.float32(np.float32(record["a.sum"][-1]) / np.float32(3))
    with pytest.raises(PatchError, match=r"^t:8 \(part a of t:11\): .*'a.kk'"):
        parse_patch(text.replace("y + k,", "y + kk,"), "t")


AROUND_DRAG = """\
title: A part whose inputs have units
parts:
  air:
    use: air
    inputs: {vx: GIVEN, vy: 4 m/s}
definitions:
  air:
    inputs: {vx: 300 m/s, vy: 0 m/s}
    outputs: [speed]
    digital: {program: {speed: "sqrt(vx*vx + vy*vy)"}}
parameters: {two: 2, turn: 20 deg, fast: 3 m/s}
digital: {period: 10 ms, program: {twice: 2*air.speed}, remember: {twice: 0 m/s}}
run: {until: 1 s}
"""


@pytest.mark.parametrize("given", ["3", "3e0", "3.", "0.003 km/s", "1 + 2", "-1.5*two", "sqrt(9)"])
def test_a_bare_number_for_an_input_is_in_the_si_unit_that_is_due(given: str) -> None:
    result = hybrid.run(hybrid.parse_patch(AROUND_DRAG.replace("GIVEN", given)))
    speed = result.record["twice"]
    assert (float(speed[-1]), speed.attrs["units"]) == (10.0, "m/s")  # 3, 4, 5


@pytest.mark.parametrize(
    ("given", "is_"),
    [
        ("3 kg", "in kg"),
        ("20 deg", "a pure number"),
        ("3 m", "in m"),
        ("2*turn", "a pure number"),
        ("fast*fast", r"in m\^2/s\^2"),
        ("previous(twice)/fast", "a pure number"),
    ],
)
def test_what_is_in_another_unit_is_told_where_it_is_given(given: str, is_: str) -> None:
    with pytest.raises(
        PatchError,
        match=rf"^two.yaml:5: input 'vx' of part 'air' \(two.yaml:8\) must be in m/s; .* is {is_}",
    ):
        hybrid.parse_patch(AROUND_DRAG.replace("GIVEN", given), "two.yaml")
