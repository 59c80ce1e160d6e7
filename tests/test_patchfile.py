"""Patch files: what the reader makes of right ones, and that nothing but PatchError comes of others."""

from __future__ import annotations

import json
import math
import random
import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hybrid
from hybrid.cli import main
from hybrid.compiler import compile_patch
from hybrid.errors import PatchError
from hybrid.expressions import evaluate, to_text
from hybrid.patch import Patch
from hybrid.patchfile import parse_duration, parse_override, parse_patch, read_patch
from hybrid.shipped import shipped_patches
from hybrid.timeline import build_timeline
from hybrid.units import PURE, TIME
from hybrid.yamltree import Sequence, Table, Text, Tree, read_yaml

PATCH = """\
# A loop with everything.
title: Everything
description: |
  Two lines
  of text
machine: {preset: nominal, serial: 7, tau: 2 us}
parameters:
  half: cycle/2          # before what it is computed from
  cycle: 2 ms
  same: cycle
  omega: 3 rad/s
  turn: 30 deg
  bare: 3
analog:
  rate: {integrate: {torque: 1, wind: 0.1}, initial: 0, full_scale: 10 rad/s, leak: 0.1 1/s}
  angle:
    initial: turn
    integrate: {rate: 1}
    full_scale: 2*pi/4
    unit: deg
  sum: {sum: {angle: 1, rate: half}, full_scale: 2, tau: 0, noise: 0}
  minus: {invert: sum, full_scale: 2}
  slow: {lag: {minus: 1}, time_constant: 10 ms, full_scale: 2}
  wind: {sine: 1 rad/s^2, frequency: 3 Hz, phase: 90 deg, bias: 0.1, full_scale: 2 rad/s^2}
  push: {step: 1 V, at: half, before: -1 V, full_scale: 5 V}
  level: {constant: 1 V, full_scale: 5 V, offset: 1 %}
interface:
  angle_word: {adc: angle, bits: 12, channel: 0}
  rate_word: {adc: rate, bits: 12, channel: 1, conversion_time: 5 us, range: 5 rad/s}
  back_word: {adc: torque, channel: 2}
  torque: {dac: demand, bits: 14, initial: 0, full_scale: 100 rad/s^2}
digital:
  period: cycle
  compute_time: 1.5*cycle
  skew: 10 us
  remember: {count: 1, demand: 0}
  program:
    demand: stiff - omega*rate_word
    stiff: -omega**2 * angle_word
    count: previous(count) + 1
run: {until: 0.1 s, every: half, max_rows: 50}
record: [rate, angle, count]
readouts:
  mode: {transient: angle, from: 10 ms, until: 90 ms}
  most: {maximum: rate}
"""


def test_everything_is_read() -> None:
    patch = parse_patch(PATCH, "a.yaml")
    assert (patch.title, patch.description) == ("Everything", "Two lines\nof text")
    assert patch.file == "a.yaml"
    assert (patch.machine.preset, patch.machine.serial) == ("nominal", 7)
    assert list(patch.machine.errors) == ["tau"]
    scope = patch.bind()
    assert scope == pytest.approx(
        {"cycle": 2e-3, "half": 1e-3, "same": 2e-3, "omega": 3, "turn": math.pi / 6, "bare": 3}
    )
    assert [c.name for c in patch.components] == sorted(c.name for c in patch.components)
    parts = {part.name: part for part in patch.components}
    assert parts["angle"].kind == "integrate"
    assert parts["angle"].place.line == 16
    assert parts["angle"].unit == "deg"
    assert parts["angle"].factor == pytest.approx(math.pi / 180, rel=1e-15)
    assert parts["angle"].full_scale.number(scope) == pytest.approx(math.pi / 2)
    assert parts["rate"].unit == "rad/s"
    assert [name for name, _ in parts["rate"].terms] == ["torque", "wind"]
    assert parts["wind"].values["frequency"].number(scope) == 3
    assert parts["level"].errors["offset"].number(scope) == 0.01
    adcs = {adc.name: adc for adc in patch.adcs}
    assert adcs["back_word"].bits is None
    assert adcs["back_word"].source == "torque"
    assert (adcs["rate_word"].bits, adcs["rate_word"].channel) == (12, 1)
    (dac,) = patch.dacs
    assert (dac.word, dac.bits, dac.unit) == ("demand", 14, "rad/s^2")
    assert patch.program is not None
    assert [a.word for a in patch.program.assignments] == ["count", "stiff", "demand"]
    assert str(patch.program.assignments[2].dimension) == "1/s^2"
    assert patch.record == ("rate", "angle", "count")
    assert patch.run.max_rows == 50
    assert [(r.name, r.kind, r.signal) for r in patch.readouts] == [
        ("mode", "transient", "angle"),
        ("most", "maximum", "rate"),
    ]


def test_parameters_are_shown_as_written() -> None:
    patch = parse_patch(PATCH)
    shown = {name: (p.unit, p.dimension) for name, p in patch.parameters.items()}
    assert shown["cycle"] == ("ms", TIME)
    assert shown["same"] == ("ms", TIME)
    assert shown["half"] == ("s", TIME)
    assert shown["turn"] == ("deg", PURE)
    assert shown["bare"] == ("", PURE)


@pytest.mark.parametrize(
    ("text", "si"),
    [
        ("2", 2.0),
        ("-2e-3", -2e-3),
        (".5", 0.5),
        ("5.", 5.0),
        ("+1", 1.0),
        ("1e3", 1e3),
        ("0.1 ms", 1e-4),
        ("90 deg", math.pi / 2),
        ("0.01 %", 1e-4),
        ("2*3 + 1", 7.0),
        ("2^3", 8.0),
        ("-2**2", -4.0),
        ("'3'", 3.0),
        ('"3 s"', 3.0),
        ("sqrt(16)/pi", 4 / math.pi),
        ("min(3, 1, 2)", 1.0),
        ("5 1/s", 5.0),
        (" 7 # seven", 7.0),
        ("\n    8", 8.0),
        ("|\n    9", 9.0),
    ],
)
def test_numbers(text: str, si: float) -> None:
    patch = parse_patch(PATCH.replace("bare: 3", f"bare: {text}"))
    assert patch.bind()["bare"] == pytest.approx(si, rel=1e-15)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: "\ufeff" + text,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("title:", '"title":'),
        lambda text: "---\n" + text + "...\n",
        lambda text: "%YAML 1.2\n---\n" + text,
        lambda text: text.replace("omega: 3 rad/s", "omega:\t3 rad/s"),
    ],
    ids=["byte order mark", "CRLF", "quoted key", "document marks", "directive", "tab between"],
)
def test_forms_of_one_file(change: Callable[[str], str], tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(change(PATCH).encode())
    assert _facts(read_patch(path)) == _facts(parse_patch(PATCH))


def _facts(patch: Patch) -> list[object]:
    """All of a patch that does not depend on lines."""
    parts = [
        (p.name, p.kind, [(s, to_text(v.expr)) for s, v in p.terms], p.unit, p.factor)
        for p in patch.components
    ]
    program = patch.program
    words = [(a.word, to_text(a.expr)) for a in program.assignments] if program else []
    readouts = [(r.name, r.kind, r.signal) for r in patch.readouts]
    return [patch.title, patch.bind(), parts, words, patch.record, readouts]


def test_a_bare_number_is_in_si_units() -> None:
    text = PATCH.replace("time_constant: 10 ms", "time_constant: 0.01").replace("90 ms", "0.09")
    text = text.replace("{rate: 1}", "{rate: 2}").replace("bias: 0.1,", "bias: 0.2,")
    patch = parse_patch(text)
    parts = {part.name: part for part in patch.components}
    assert parts["slow"].values["time_constant"].number({}) == 0.01
    assert parts["angle"].terms[0][1].number({}) == 2.0
    assert parts["wind"].values["bias"].number({}) == 0.2
    end = patch.readouts[0].end
    assert end is not None
    assert end.number({}) == 0.09


# -- quantities from outside ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "text", "si"),
    [
        ("cycle", "3 ms", 3e-3),
        ("cycle", "0.003", 3e-3),
        ("cycle", " 1/500 ", 2e-3),
        ("cycle", "1 min", 60.0),
        ("omega", "2 rad/s", 2.0),
        ("omega", "60 rpm", 2 * math.pi),
        ("omega", "2*pi", 2 * math.pi),
        ("turn", "0.5", 0.5),
        ("turn", "90 deg", math.pi / 2),
        ("bare", "50 %", 0.5),
        ("bare", "-1e-3", -1e-3),
        ("half", "7 us", 7e-6),
    ],
)
def test_overrides(name: str, text: str, si: float) -> None:
    assert parse_override(parse_patch(PATCH), name, text) == pytest.approx(si, rel=1e-15)


def test_an_override_in_hertz_where_the_parameter_is() -> None:
    patch = parse_patch(PATCH.replace("bare: 3", "bare: 3 Hz"))
    assert parse_override(patch, "bare", "2 kHz") == 2000.0
    with pytest.raises(PatchError, match=r"must be in Hz"):
        parse_override(patch, "bare", "2 rad/s")


def test_overrides_reach_what_is_computed_from_them() -> None:
    patch = parse_patch(PATCH)
    assert patch.bind({"cycle": 4e-3})["half"] == 2e-3
    with pytest.raises(PatchError, match="finite"):
        patch.bind({"cycle": math.nan})


@pytest.mark.parametrize(("text", "si"), [("20 s", 20.0), ("3", 3.0), (" 1 min ", 60.0)])
def test_durations(text: str, si: float) -> None:
    assert evaluate(parse_duration(text, "--until").expr, {}) == si


# -- what is legal on one machine and not on another ------------------------------------------------

LOOP = PATCH.replace("{sum: {angle: 1, rate: half}", "{sum: {angle: 1, rate: half, minus: 0.5}")


def test_a_loop_is_legal_where_there_are_lags(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "loop.yaml"
    path.write_text(LOOP)
    assert main(["check", str(path)]) == 0
    assert main(["predict", str(path)]) == 0
    assert main(["check", str(path), "--machine", "lags"]) == 0
    capsys.readouterr()
    assert main(["check", str(path), "--machine", "ideal"]) == 2
    assert "minus -> sum -> minus" in capsys.readouterr().err


def test_a_dac_may_have_any_name() -> None:
    """Among them the one that the layout once gave its own input, the constant 1."""
    first = hybrid.run(parse_patch(PATCH), machine="ideal").record
    other = hybrid.run(parse_patch(PATCH.replace("torque", "one")), machine="ideal").record
    # The signals stand in another order, so sums may round in another.
    np.testing.assert_allclose(other["angle"], first["angle"], rtol=1e-12)


# -- nothing but PatchError -------------------------------------------------------------------------

HYPOTHESIS = settings(
    max_examples=100,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
TEXTS = {name: path.read_text(encoding="utf-8") for name, path in shipped_patches().items()}
TEXTS["everything"] = PATCH
LONGEST_S = 15.0  # of the processor; what it guards against takes minutes


def _read_compile_lay_out(text: str) -> bool:
    """Whether the text is a patch that can be run; anything but PatchError is an error."""
    began = time.process_time()
    try:
        for preset in ("ideal", "nominal"):
            build_timeline(compile_patch(parse_patch(text, "a.yaml"), machine=preset))
        right = True
    except PatchError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 1500
        place = error.place
        while place.used:  # of a sub-patch: where it is used
            place = place.used
        assert place.file == "a.yaml"
        right = False
    assert time.process_time() - began < LONGEST_S
    return right


@HYPOTHESIS
@given(st.text())
def test_any_text(text: str) -> None:
    assert not _read_compile_lay_out(text)


@HYPOTHESIS
@given(st.text(alphabet="ab1:,-{}[]'\"&*!|>%@#?~ \n\t.", max_size=60))
def test_any_text_like_yaml(text: str) -> None:
    assert not _read_compile_lay_out("title: a\n" + text)


NASTY = re.findall(
    r"\S+",
    r"""
    0 -1 1e-30 1e300 1e999 .inf nan null ~ true 1_000 0x10 '' "" [] {} [[]] {a: 1} - : , ? & * !!str
    pi sin previous time rad Hz kg ms % ** ^ / ( ) # | > \ ' " 1ms 1e-320 9999999999 0.5 -0
    theta alpha cycle omega_p moment ideal nominal integrate sum lag adc dac full_scale initial unit
    tau noise offset tolerance bits channel period program run until every record readouts
    """,
)
TOKEN = re.compile(r"\w+|\s+|[^\w\s]")


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """A patch with up to four tokens deleted, doubled, replaced or swapped."""
    tokens = TOKEN.findall(TEXTS[draw(st.sampled_from(sorted(TEXTS)))])
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(tokens) - 1))
        deed = draw(st.sampled_from(["delete", "double", "replace", "swap", "copy"]))
        if deed == "delete":
            tokens[at] = ""
        elif deed == "double":
            tokens[at] *= 2
        elif deed == "replace":
            tokens[at] = draw(st.sampled_from(NASTY))
        else:
            other = draw(st.integers(0, len(tokens) - 1))
            held = tokens[at]
            tokens[at] = tokens[other]
            tokens[other] = held if deed == "swap" else tokens[other]
    return "".join(tokens)


@settings(HYPOTHESIS, max_examples=300)
@given(mutated())
def test_any_mutated_patch(text: str) -> None:
    _read_compile_lay_out(text)


def test_the_mutated_patches_are_not_all_wrong() -> None:
    assert all(_read_compile_lay_out(text) for text in TEXTS.values())


def test_a_chain_of_parameters() -> None:
    """Order and loops of a long chain are found in time proportional to its length."""
    chain = "".join(f"  p{n}: p{n - 1}\n" for n in range(4900, 0, -1))
    began = time.process_time()
    patch = parse_patch(PATCH.replace("parameters:\n", f"parameters:\n{chain}  p0: 2\n"))
    assert patch.bind()["p4900"] == 2.0
    with pytest.raises(PatchError, match="circular parameters: p0 -> p4900 -> p4899"):
        parse_patch(PATCH.replace("parameters:\n", f"parameters:\n{chain}  p0: p4900\n"))
    assert time.process_time() - began < LONGEST_S


def test_a_chain_of_parts_without_lag() -> None:
    chain = "".join(f"  s{n}: {{sum: {{s{n - 1}: 1}}, full_scale: 2}}\n" for n in range(1, 900))
    text = PATCH.replace(
        "interface:", f"  s0: {{sum: {{angle: 1}}, full_scale: 2}}\n{chain}interface:"
    )
    machine = compile_patch(parse_patch(text), machine="ideal")
    last, first = (machine.analog.signals.index(name) for name in ("s899", "angle"))
    np.testing.assert_allclose(machine.analog.c[last] * 2, machine.analog.c[first] * math.pi / 2)


# -- the order of entries ---------------------------------------------------------------------------


def _shuffled(tree: Tree, dice: random.Random) -> object:
    """The tree as plain values, every mapping in another order."""
    if isinstance(tree, Text):
        return tree.text
    if isinstance(tree, Sequence):
        return [_shuffled(item, dice) for item in tree.items]
    assert isinstance(tree, Table)
    entries = [(key, _shuffled(value, dice)) for key, value in tree.entries.items()]
    dice.shuffle(entries)
    return dict(entries)


@pytest.mark.parametrize("name", TEXTS)
def test_the_order_of_entries_changes_nothing(name: str) -> None:
    """Not the last bit, with lags, noise, tolerances and quantisation."""
    first = hybrid.run(parse_patch(TEXTS[name]), machine="nominal", seed=5)
    for seed in range(3):
        text = json.dumps(_shuffled(read_yaml(TEXTS[name], ""), random.Random(seed)))
        assert text != TEXTS[name]
        again = hybrid.run(parse_patch(text), machine="nominal", seed=5)
        assert list(again.record.data_vars) == list(first.record.data_vars)
        for signal in first.record.variables:
            assert again.record[signal].values.tobytes() == first.record[signal].values.tobytes()
        assert again.readouts == first.readouts
        assert again.overloads == first.overloads
