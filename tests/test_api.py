"""The verbs as Python functions: what they take, what they refuse, how their answers print."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import hybrid
from hybrid.linearity import NotLinear
from hybrid.runs import _play
from hybrid.scale import to_ticks

LOOP = """
title: Loop
machine: ideal
parameters: {cycle: 10 ms, rate: 2 1/s, begin: 0.5 s}
analog:
  x: {integrate: {y: 1}, initial: 1 V, full_scale: 2 V}
interface:
  s: {adc: x, bits: 12}
  y: {dac: w, bits: 12, full_scale: 10 V/s, initial: 0 V/s}
digital:
  period: cycle
  program:
    w: -rate * s
run: {until: 2 s}
readouts:
  end: {final: x}
  top: {maximum: x, from: begin, until: 1 s}
  level: {mean: x}
"""


@pytest.fixture(scope="module")
def loop() -> hybrid.patch.Patch:
    return hybrid.parse_patch(LOOP, "loop.yaml")


# -- what the verbs take ----------------------------------------------------------------------------


def test_the_verbs_are_listed() -> None:
    assert set(hybrid.__all__) <= set(dir(hybrid))
    assert {"run", "predict", "sweep", "check", "read_patch"} <= set(dir(hybrid))
    assert "__version__" in dir(hybrid)


@pytest.mark.parametrize(
    "value", [0.02, "20 ms", "0.02", np.float64(0.02), np.array(0.02), np.array("20 ms")], ids=repr
)
def test_a_parameter_is_a_number_in_si_or_a_text(loop, value) -> None:
    assert hybrid.run(loop, {"cycle": value}).cycles == 100
    assert hybrid.predict(loop, {"cycle": value}).machine.cycle_s == 0.02
    assert hybrid.check(loop, {"cycle": value}).machine.cycle_s == 0.02
    swept = hybrid.sweep(loop, "rate", [1, "2 1/s"], {"cycle": value})
    assert swept.parameters["cycle"] == "20 ms"
    assert swept.values.tolist() == [1.0, 2.0]


def test_a_patch_is_a_file_or_a_name(tmp_path: Path) -> None:
    file = tmp_path / "loop.yaml"
    file.write_text(LOOP)
    for source in (file, str(file)):
        assert hybrid.run(source).status == "complete"
        assert hybrid.check(source).machine.patch.title == "Loop"
        assert len(hybrid.sweep(source, "cycle", "1 ms:2 ms:2").points) == 2
    assert hybrid.predict("pitch_loop").machine.patch.title == "Pitch loop"
    assert hybrid.read_patch("pitch_loop").title == "Pitch loop"


def test_the_seed_may_be_numpys(loop) -> None:
    assert type(hybrid.run(loop, seed=np.int64(3)).seed) is int


# -- what they refuse -------------------------------------------------------------------------------

REFUSED = {
    "text of no quantity": ({"cycle": "soon"}, {}, "names are not known"),
    "no unit of time": ({"cycle": "1 V"}, {}, "a time, such as 1 ms"),
    "empty": ({"cycle": ""}, {}, "nothing is given"),
    "none": ({"cycle": None}, {}, "finite number"),
    "bool": ({"cycle": True}, {}, "finite number"),
    "list": ({"cycle": [1e-3]}, {}, "finite number"),
    "complex": ({"cycle": 1j}, {}, "finite number"),
    "nan": ({"cycle": float("nan")}, {}, "finite number"),
    "huge": ({"cycle": 10**400}, {}, "finite number"),
    "unknown name": ({"cycel": 1}, {}, "did you mean 'cycle'"),
    "no name": ({3: 1}, {}, "names are texts"),
    "no mapping": ([1], {}, "mapping"),
    "machine": (None, {"machine": 5}, "ideal, lags, nominal"),
    "empty machine": (None, {"machine": ""}, "ideal, lags, nominal"),
    "machine misspelt": (None, {"machine": "nominel"}, "did you mean 'nominal'"),
    "serial": (None, {"serial": "x"}, "serial is 'x'"),
    "serial fraction": (None, {"serial": 1.5}, "serial is 1.5"),
}


@pytest.mark.parametrize("verb", ["run", "predict", "check", "sweep"])
@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_what_every_verb_refuses(loop, verb, case) -> None:
    parameters, options, says = case
    order = (loop, "rate", [1.0]) if verb == "sweep" else (loop,)
    with pytest.raises(hybrid.HybridError) as caught:
        getattr(hybrid, verb)(*order, parameters, **options)
    assert says in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "source", [None, 5, b"x", {}, "nowhere.yaml", "a\nb: c", "x" * 5000, "", "."]
)
@pytest.mark.parametrize("verb", ["run", "predict", "check", "read_patch"])
def test_what_is_no_patch(verb, source) -> None:
    with pytest.raises(hybrid.PatchError) as caught:
        getattr(hybrid, verb)(source)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 600


def test_a_shipped_name_misspelt() -> None:
    with pytest.raises(hybrid.PatchError, match="did you mean 'pitch_loop'"):
        hybrid.run("pitch_lop")


@pytest.mark.parametrize("seed", [1.5, "x", None, True, -1, 2**63, [1]], ids=repr)
def test_what_is_no_seed(loop, seed) -> None:
    for verb in (hybrid.run, lambda p, seed: hybrid.sweep(p, "rate", [1.0], seed=seed)):
        with pytest.raises(
            hybrid.RunError, match=r"seed is .*; it must be a whole number from 0 to"
        ):
            verb(loop, seed=seed)


def test_a_compiled_machine_is_as_it_is(loop) -> None:
    machine = hybrid.predict(loop).machine
    assert hybrid.run(machine).status == "complete"
    for more in ({"machine": "ideal"}, {"serial": 2}, {"parameters": {"rate": 1}}):
        with pytest.raises(hybrid.RunError, match="give the patch"):
            hybrid.run(machine, **more)


@pytest.mark.parametrize("error", ["x", True, 0, -1, float("nan")], ids=repr)
def test_what_is_no_damping_error(error) -> None:
    with pytest.raises(hybrid.RunError, match="must be above 0 and finite"):
        hybrid.predict("pitch_loop", max_damping_error=error)


def test_lags_are_not_blamed_where_there_are_none() -> None:
    with pytest.raises(hybrid.RunError, match="rounding") as caught:
        hybrid.predict("pitch_loop", max_damping_error=1e-15)
    assert "lags" not in str(caught.value)
    with pytest.raises(hybrid.RunError, match="lags"):
        hybrid.predict("pitch_loop", machine="lags", max_damping_error=1e-15)


# -- what they say ----------------------------------------------------------------------------------


def test_scalar_readouts_carry_their_unit(loop) -> None:
    result = hybrid.run(loop)
    assert {q["units"] for q in result.readouts.values()} == {"V"}
    told = f"end: final value of x = {result.readouts['end']['value']:.9g} V, at 2 s"
    assert told in repr(result)
    assert json.loads(result.record.attrs["readouts"])["level"]["units"] == "V"


def test_what_is_not_linear_has_its_line() -> None:
    patch = hybrid.parse_patch(LOOP.replace("-rate * s", "-rate * s * sign(s)"), "loop.yaml")
    with pytest.raises(NotLinear, match=r"^loop\.yaml:13: word 'w' is not linear"):
        hybrid.predict(patch)
    assert "loop.yaml:13: word 'w'" in hybrid.check(patch).prediction


def test_a_readout_that_ends_before_it_begins(loop) -> None:
    for verb in (hybrid.run, hybrid.check):
        with pytest.raises(hybrid.PatchError, match=r"^loop\.yaml:17: from .* 1\.5 s, not before"):
            verb(loop, {"begin": 1.5})
    failed, done = hybrid.sweep(loop, "begin", ["0.5 s", "1.5 s"]).points[::-1]
    assert (failed.status, done.status) == ("failed", "complete")
    assert "loop.yaml:17: " in failed.note


def test_a_readout_after_the_end_of_the_run(loop) -> None:
    patch = hybrid.parse_patch(LOOP.replace("until: 1 s}", "until: 9 s}"), "loop.yaml")
    top = hybrid.run(patch, {"begin": "3 s"}).readouts["top"]
    assert top["reason"] == (
        "loop.yaml:17: from of readout 'top' is 3 s, after the end of the record at 2 s"
    )
    assert "value" not in top


def test_a_program_without_an_answer_says_in_which_cycle() -> None:
    text = LOOP.replace("w: -rate * s", "n: previous(n) + 1\n    w: 1 / (n - 5)")
    patch = hybrid.parse_patch(text.replace("  program:", "  remember: {n: 0}\n  program:"))
    result = hybrid.run(patch)
    assert result.status == "stopped"
    assert result.status_note.startswith(
        "stopped at 0.05 s: in cycle 5, which began at 0.04 s, the program computed no finite number"
    )


def test_a_check_prints_and_tabulates(loop) -> None:
    result = hybrid.check(loop, machine="nominal")
    assert repr(result).startswith("<Check 'Loop' on 'nominal': valid, 200 cycles")
    assert "s (adc): quantises and clips" in repr(result)
    assert "s (adc): bits ignored" in repr(hybrid.check(loop))
    frame = result.to_pandas()
    assert frame.index.tolist() == ["x", "y"]
    assert frame.loc["x", "value"] == 1.0
    assert frame.loc["x", "units"] == "V"


def test_converters_of_a_check(loop) -> None:
    adc, dac = hybrid.check(loop, machine="nominal").converters
    assert (adc.converter, adc.kind, adc.converts, adc.bits) == ("s", "adc", "x", 12)
    assert (adc.range, adc.units) == (2.0, "V")
    assert adc.step == pytest.approx(2.0 / 2047, rel=1e-14)
    assert (dac.converts, dac.range) == ("w", 10.0)
    assert dac.step == pytest.approx(10.0 / 2047, rel=1e-14)
    assert [row.step for row in hybrid.check(loop).converters] == [None, None]


POTS = """
title: Potentiometers
machine: ideal
analog:
  big: {constant: 3 V, full_scale: 10 V}
  small: {integrate: {big: -0.5 1/s, sum1: 20 1/s}, initial: -0.25 V, full_scale: 1 V}
  sum1: {sum: {big: 0.04, small: -0.3}, full_scale: 2 V}
run: {until: 1 s, every: 0.1 s}
"""


def test_potentiometers_by_hand() -> None:
    """Coefficient x full scale in / full scale out; what exceeds 1 takes an input of 10 or 100."""
    rows = {(r.component, r.input): r for r in hybrid.check(hybrid.parse_patch(POTS)).pots}
    expected = {
        ("big", "(reference)"): (0.3, 1, False),  # 3 V of 10 V
        ("small", "big"): (0.5, 10, True),  # 0.5 x 10 / 1 = 5
        ("small", "sum1"): (0.4, 100, False),  # 20 x 2 / 1 = 40
        ("small", "(initial)"): (0.25, 1, True),  # -0.25 V of 1 V
        ("sum1", "big"): (0.2, 1, False),  # 0.04 x 10 / 2
        ("sum1", "small"): (0.15, 1, True),  # 0.3 x 1 / 2
    }
    assert rows.keys() == expected.keys()
    for key, (setting, gain, inverted) in expected.items():
        row = rows[key]
        assert (row.gain, row.inverted) == (gain, inverted), key
        assert row.setting == pytest.approx(setting, rel=1e-14), key
        assert row.coefficient_mu == pytest.approx((-1) ** inverted * setting * gain, rel=1e-14)


def test_no_minus_zero_in_a_record() -> None:
    """A word that is -1 times an ADC's 0 is 0 to whoever reads the record."""
    text = "title: a\nanalog: {x: {constant: 0, full_scale: 1}}\ninterface: {s: {adc: x}}\n"
    text += "digital: {period: 1 s, program: {w: -s}}\nrun: {until: 2 s}\n"
    record = hybrid.run(hybrid.parse_patch(text), machine="ideal").record
    assert not np.signbit(record["w"].values).any()


def test_an_interrupted_run_names_the_row_at_which_its_record_ends():
    """Between rows, at one, and before the first."""
    machine = SimpleNamespace(timing=SimpleNamespace(every=to_ticks(0.1)))

    def told(rows: int, done_s: float) -> str:
        def play():
            raise KeyboardInterrupt
            yield

        player = SimpleNamespace(
            machine=machine,
            record=np.zeros((rows, 1)),
            done_s=done_s,
            done_ticks=to_ticks(done_s),
            play=play,
            remarks=tuple,
            keep_every=2,
        )
        return _play(player, None)

    assert told(4, 0.73) == "interrupted at 0.73 s; the record ends with its row at 0.6 s"
    assert told(4, 0.6) == "interrupted at 0.6 s; the record ends there"
    assert told(0, 0.0) == "interrupted at 0 s; before the first row of the record"


def test_docstrings_name_all_that_results_hold():
    """Every field of a run, a sweep and a check; every variable of a sweep, which has the shape told."""
    swept = hybrid.sweep("pitch_loop", "cycle", ["1 ms", "2 ms"], {"compute_time": 0}, jobs=1)
    checked = hybrid.check("pitch_loop", trial=False)
    for result in (hybrid.run("pitch_loop", readouts_only=True), swept, checked):
        named = set(re.findall(r"\w+", type(result).__doc__))
        assert {field.name for field in dataclasses.fields(result)} <= named
    named = set(re.findall(r"\w+", type(swept).__doc__))
    for name, variable in swept.dataset.data_vars.items():
        assert name.removesuffix("_error") in named
        second = {"measured": ("readout",), "predicted": ("mode",), "closed": ("mode",)}
        second |= {"omega": ("mode",), "zeta": ("mode",)}  # of the ideals
        assert variable.dims == ("cycle", *second.get(name.split("_")[0], ())), name
        assert variable.shape[0] == 2


def test_a_run_ends_where_it_is_asked_to_and_plays_again_from_its_record(loop) -> None:
    first = hybrid.run(loop, until="0.25 s", machine="nominal", seed=5)
    facts = first.record.attrs
    assert facts["until_s"] == 0.25
    again = hybrid.run(
        loop,
        json.loads(facts["parameters_si"]),
        machine=facts["machine"],
        serial=int(facts["serial"]),
        seed=int(facts["seed"]),
        until=facts["until_s"],
    )
    assert np.array_equal(first.rows, again.rows)
    assert len(first.rows) < len(hybrid.run(loop, seed=5).rows)


@pytest.mark.parametrize("until", ["0 s", "5 rad", "soon", -1.0, math.nan, [1.0]])
def test_an_end_of_the_run_that_is_none_is_one_line(loop, until) -> None:
    with pytest.raises(hybrid.HybridError, match="until") as told:
        hybrid.run(loop, until=until)
    assert "\n" not in str(told.value)
