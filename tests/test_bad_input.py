"""Every mistake of a user: one line with file, line and remedy, exit code 2, nothing written."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

import hybrid
from hybrid.cli import main

PATCH = """\
title: Loop
machine: ideal
parameters:
  omega: 10 rad/s
  cycle: 1 ms
  gain: 2
analog:
  rate: {integrate: {torque: 1}, initial: 0 rad/s, full_scale: 10 rad/s}
  angle: {integrate: {rate: 1}, initial: 0.1 rad, full_scale: 1 rad}
  volts: {coefficient: {angle: 1 V}, full_scale: 1 V}
  wind: {sine: 0.1 V, omega: 3 rad/s, full_scale: 1 V}
interface:
  angle_word: {adc: angle, bits: 14}
  torque: {dac: demand, bits: 14, initial: 0, full_scale: 100 rad/s^2}
digital:
  period: cycle
  program:
    demand: -omega**2 * angle_word
run: {until: 0.1 s}
record: [angle, rate]
readouts:
  mode: {transient: angle}
"""


COMPILING = "hybrid: compiling the kernel, once after installation ...\n"


@dataclass(frozen=True)
class Wrong:
    """PATCH with `old` replaced by `new`; the fault is in the line of `at` (default: of `new`)."""

    name: str
    old: str
    new: str
    says: tuple[str, ...]  # all in the message
    at: str = ""
    verb: str = "check"

    @property
    def text(self) -> str:
        assert self.old in PATCH, self.old
        return PATCH.replace(self.old, self.new, 1)

    @property
    def line(self) -> int:
        at = self.at or self.new.strip().splitlines()[0].strip()
        return next(i for i, line in enumerate(self.text.splitlines(), 1) if at in line)


def complaint(
    capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str, verb: str = "check"
) -> str:
    """The one line that a command gives; checks the exit code and that nothing is written."""
    before = sorted(folder.rglob("*"))
    code = main([verb, *arguments])
    out, err = capsys.readouterr()
    assert code == 2, (code, out, err)
    assert out == ""
    assert err.startswith("hybrid: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert len(err) < 1500
    assert sorted(folder.rglob("*")) == before
    return err.removeprefix("hybrid: ").rstrip("\n")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_patch_itself_is_right(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("loop.yaml").write_text(PATCH)
    assert main(["check", "loop.yaml"]) == 0
    assert capsys.readouterr().err == ""


ANGLE = "  angle: {integrate: {rate: 1}, initial: 0.1 rad, full_scale: 1 rad}\n"
TORQUE = "  torque: {dac: demand, bits: 14, initial: 0, full_scale: 100 rad/s^2}\n"
DEMAND = "    demand: -omega**2 * angle_word\n"
RUN = "run: {until: 0.1 s}\n"

KEYS = [
    Wrong("top level", "machine: ideal", "machin: ideal", ("'machin'", "did you mean 'machine'")),
    Wrong("top level, no likeness", "machine: ideal", "xyz: 1", ("'xyz'", "valid:", "analog")),
    Wrong("component", "initial: 0.1 rad", "initail: 0.1 rad", ("'initail'", "'initial'")),
    Wrong("converter", "adc: angle, bits", "adc: angle, bit", ("'bit'", "did you mean 'bits'")),
    Wrong("converter, key of the other", "adc: angle,", "adc: angle, initial: 0,", ("'initial'",)),
    Wrong("digital", "  period: cycle", "  perod: cycle", ("'perod'", "'period'")),
    Wrong("run", "until: 0.1 s", "untill: 0.1 s", ("'untill'", "'until'")),
    Wrong("readout", "{transient: angle}", "{transient: angle, to: 1 s}", ("'to'", "until")),
    Wrong("machine", "machine: ideal", "machine: {serail: 3}", ("'serail'", "'serial'")),
    Wrong("kind", "{sine: 0.1 V", "{sin: 0.1 V", ("'wind'", "'sin'", "did you mean 'sine'")),
    Wrong("kind, no likeness", "{sine: 0.1 V", "{zzz: 0.1 V", ("'zzz'", "integrate", "sum")),
    Wrong("kind missing", "{sine: 0.1 V, omega: 3 rad/s, full", "{full", ("no kind", "integrate")),
    Wrong("two kinds", "{sine: 0.1 V,", "{sine: 0.1 V, sum: {angle: 1},", ("sine and sum", "keep")),
    Wrong("converter kind", "{adc: angle,", "{adb: angle,", ("'adb'", "did you mean 'adc'")),
    Wrong("both converters", "{adc: angle,", "{adc: angle, dac: demand,", ("adc and dac", "keep")),
    Wrong("readout kind", "{transient: angle}", "{transent: angle}", ("'transent'", "'transient'")),
    Wrong("no full_scale", ", full_scale: 1 rad}", "}", ("'angle'", "no full_scale"), "  angle:"),
    Wrong(
        "no full_scale, DAC", ", full_scale: 100 rad/s^2", "", ("no full_scale",), "torque: {dac"
    ),
    Wrong("no initial", " initial: 0.1 rad,", "", ("'angle'", "no initial"), "  angle:"),
    Wrong("no title", "title: Loop\n", "", ("no title",), "machine"),
    Wrong("no run", RUN, "", ("no run",), "title"),
    Wrong("no until", "{until: 0.1 s}", "{max_rows: 9}", ("no until",)),
    Wrong("no period", "  period: cycle\n", "", ("no period",), "digital:"),
    Wrong("no program", "  program:\n" + DEMAND, "", ("no program",), "digital:"),
    Wrong(
        "no digital",
        PATCH[PATCH.index("digital:") : PATCH.index(RUN)],
        "",
        ("converters", "digital:"),
        "adc: angle",
    ),
    Wrong("sine without omega", " omega: 3 rad/s,", "", ("omega", "frequency"), "  wind:"),
    Wrong("sine with both", "omega: 3 rad/s", "omega: 3 rad/s, frequency: 1 Hz", ("either",)),
    Wrong("two inputs", "{angle: 1 V}", "{angle: 1 V, rate: 1 V*s}", ("one signal", "sum:")),
]

SIGNALS = [
    Wrong("terms", "{rate: 1}", "{rat: 1}", ("unknown signal 'rat'", "did you mean 'rate'")),
    Wrong("adc", "adc: angle", "adc: angl", ("unknown signal 'angl'", "did you mean 'angle'")),
    Wrong("dac", "dac: demand", "dac: demad", ("unknown word 'demad'", "did you mean 'demand'")),
    Wrong("record", "[angle, rate]", "[angle, rat]", ("unknown signal 'rat'", "'rate'")),
    Wrong("readout", "transient: angle", "transient: angel", ("unknown signal 'angel'", "'angle'")),
    Wrong("program", "* angle_word", "* angle_wrd", ("unknown 'angle_wrd'", "'angle_word'")),
    Wrong("program, analog", "* angle_word", "* angle", ("analog signal 'angle'", "adc")),
    Wrong("terms, word", "{rate: 1}", "{demand: 1}", ("word", "'demand'", "dac")),
    Wrong("terms, ADC", "{rate: 1}", "{angle_word: 1}", ("ADC 'angle_word'", "samples")),
    Wrong("terms, parameter", "{rate: 1}", "{gain: 1}", ("parameter 'gain'", "constant:")),
    Wrong("dac, signal", "dac: demand", "dac: angle", ("analog signal 'angle'", "demand")),
    Wrong("adc of an adc", "{adc: angle,", "{adc: angle_word,", ("ADC 'angle_word'",)),
    Wrong("parameter", "  period: cycle", "  period: cicle", ("'cicle'", "did you mean 'cycle'")),
    Wrong("record, parameter", "[angle, rate]", "[angle, gain]", ("unknown signal 'gain'",)),
    Wrong("record empty", "[angle, rate]", "[]", ("empty",), "record:"),
    Wrong("machine", "machine: ideal", "machine: ideel", ("'ideel'", "did you mean 'ideal'")),
    Wrong("preset", "machine: ideal", "machine: {preset: best}", ("'best'", "nominal")),
    Wrong("remember", "  period: cycle", "  remember: {demad: 0}\n  period: cycle", ("'demand'",)),
    Wrong("no inputs", "{rate: 1}", "{}", ("no inputs",), "  angle:"),
]

UNITS = [
    Wrong("initial", "initial: 0.1 rad", "initial: 1 ms", ("'1 ms'", "pure number")),
    Wrong("initial, derived", "initial: 0 rad/s", "initial: 3 V", ("'3 V'", "in rad/s")),
    Wrong("sine", "{sine: 0.1 V", "{sine: 1 ms", ("'1 ms'", "in V")),
    Wrong(
        "coefficient",
        "{angle: 1 V}",
        "{angle: 1 ms}",
        ("coefficient of 'angle'", "rad into V", "kg*m^2"),
    ),
    Wrong(
        "coefficient, rate",
        "{rate: 1}",
        "{rate: 1 s}",
        ("of 'rate'", "rad/s into rad per second", "pure"),
    ),
    Wrong("word", "-omega**2 *", "-omega *", ("'demand'", "a rate", "in rad/s^2"), "  torque:"),
    Wrong("word, sum", "-omega**2 *", "-omega**2 + cycle *", ("'demand'", "1/s^2"), "demand:"),
    Wrong("unit", "full_scale: 1 V}", "full_scale: 1 V, unit: rad}", ("'rad'", "full_scale")),
    Wrong("unit unknown", "full_scale: 1 V}", "full_scale: 1 V, unit: vlt}", ("'vlt'", "volt")),
    Wrong("unit with number", "full_scale: 1 V}", "full_scale: 1 V, unit: 5 V}", ("unit",)),
    Wrong("period", "  period: cycle", "  period: 1 V", ("'1 V'", "a time, such as 1 ms")),
    Wrong("period, radians", "  period: cycle", "  period: 1 rad", ("'1 rad'", "a time")),
    Wrong("until", "until: 0.1 s", "until: 5 m", ("'5 m'", "a time")),
    Wrong("omega", "omega: 3 rad/s", "omega: 3 s", ("'3 s'", "rad/s")),
    Wrong("omega in Hz", "omega: 3 rad/s", "omega: 3 Hz", ("3 Hz", "frequency:")),
    Wrong("frequency in rad/s", "omega: 3 rad/s", "frequency: 3 rad/s", ("rad/s", "omega:")),
    Wrong("frequency, parameter", "omega: 3 rad/s", "frequency: omega", ("omega:",)),
    Wrong("noise", "full_scale: 1 V}", "full_scale: 1 V, noise: 1 mV}", ("noise", "pure number")),
    Wrong("range", "adc: angle,", "adc: angle, range: 1 s,", ("range of ADC", "pure number")),
    Wrong("exponent", "-omega**2", "-omega**cycle", ("pure number",), "demand:"),
    Wrong("sine of a rate", "-omega**2 *", "omega*sin(omega)*", ("sin", "pure number"), "demand:"),
    Wrong(
        "first value",
        "  period: cycle",
        "  remember: {demand: 1 V}\n  period: cycle",
        ("1/s^2",),
        "demand: -",
    ),
    Wrong("temperature", "gain: 2", "gain: 20 degC", ("kelvin",)),
    Wrong("unknown", "gain: 2", "gain: 2 apples", ("'apples'",)),
]

NAMES = [
    Wrong(
        "same key", "  gain: 2", "  gain: 2\n  gain: 3", ("'gain'", "twice", "line 6"), "gain: 3"
    ),
    Wrong("same section", RUN, RUN + "run: {until: 1 s}\n", ("'run'", "twice", "line 19"), " 1 s}"),
    Wrong(
        "same component", ANGLE, ANGLE + ANGLE.replace("0.1", "0.2"), ("'angle'", "line 9"), "0.2"
    ),
    Wrong("same key of one", "{rate: 1}", "{rate: 1, rate: 2}", ("'rate'", "twice")),
    Wrong(
        "parameter and signal", "  gain: 2", "  wind: 2", ("'wind'", "parameter in line 6"), "sine"
    ),
    Wrong("analog and interface", "  torque: {dac", "  angle: {dac", ("'angle'", "line 9")),
    Wrong("word and ADC", "    demand:", "    angle_word:", ("ADC in line 13",), "    angle_word:"),
    Wrong("function", "  gain: 2", "  sin: 2", ("'sin'", "function")),
    Wrong("pi", "  gain: 2", "  pi: 2", ("'pi'", "constant")),
    Wrong("previous", "  volts:", "  previous:", ("'previous'",)),
    Wrong("reserved", "  volts:", "  lambda:", ("'lambda'", "reserved", "lambda_1")),
    Wrong("time", "  volts:", "  time:", ("'time'", "time axis", "clock")),
    Wrong("space", "  gain: 2", "  two words: 2", ("'two words'", "letters")),
    Wrong("digit", "  gain: 2", "  2nd: 2", ("'2nd'", "letters, digits")),
    Wrong("integer", "  gain: 2", "  7: 2", ("'7'", "letters")),
    Wrong("minus", "  volts:", "  my-volts:", ("'my-volts'", "underscores")),
    Wrong("unicode", "  gain: 2", "  größe: 2", ("'größe'", "letters")),
    Wrong("greek", "  volts:", "  ω_p:", ("'ω_p'", "letters")),
    Wrong("escape", "  gain: 2", '  "a\\x1b[31mb": 2', (r"\x1b", "letters")),
    Wrong("newline", "  gain: 2", '  "a\\nb": 2', (r"a\nb", "letters")),
    Wrong("empty", "  gain: 2", '  "": 2', ("''", "letters")),
    Wrong("null key", "  gain: 2", "  ~: 2", ("'~'", "letters")),
    Wrong("long", "  gain: 2", f"  {'n' * 65}: 2", ("nnn...", "at most 64")),
    Wrong("very long", "  gain: 2", f"  {'n' * 1000}: 2", ("nnn...", "at most 64")),
    Wrong("very long key", "machine: ideal", f"{'n' * 1000}: 2", ("nnn...", "valid:")),
    Wrong("longest key", "machine: ideal", f"{'n' * 100_000}: 2", ("not valid YAML", "key: value")),
    Wrong("very long signal", "{rate: 1}", f"{{{'n' * 1000}: 1}}", ("nnn...", "valid:")),
    Wrong("list key", "  gain: 2", "  [a, b]: 2", ("key", "single word")),
    Wrong("mapping key", "  gain: 2", "  ? {a: b}\n  : 2", ("key", "single word"), "? {a"),
    Wrong("merge key", "  gain: 2", "  <<: {gain: 2}", ("'<<'", "letters")),
    Wrong("readout", "  mode: {tr", "  my mode: {tr", ("'my mode'", "readout")),
]

VALUES = [
    Wrong("underscore", "gain: 2", "gain: 1_000", ("1*_000", "product")),
    Wrong("hexadecimal", "gain: 2", "gain: 0x10", ("'x10'",)),
    Wrong("infinity", "gain: 2", "gain: .inf", ("numbers",)),
    Wrong("nan", "gain: 2", "gain: .nan", ("numbers",)),
    Wrong("named nan", "gain: 2", "gain: nan", ("'nan'", "cycle, omega")),
    Wrong("too large", "gain: 2", "gain: 1e999", ("too large", "1.8e308")),
    Wrong("too small", "gain: 2", "gain: 1e-999", ("too small", "5e-324")),
    Wrong("two numbers", "gain: 2", "gain: 1 ms 2", ("'ms 2'", "'rad/s^2'")),
    Wrong("division by zero", "gain: 2", "gain: 1/0", ("no finite value",)),
    Wrong("overflow", "gain: 2", "gain: 1e200*1e200", ("no finite value",)),
    Wrong("root", "gain: 2", "gain: sqrt(-1)", ("no finite value",)),
    Wrong("code", "gain: 2", "gain: __import__('os')", ('"\'"', "valid are numbers")),
    Wrong("attribute", "gain: 2", "gain: cycle.real", ("not arithmetic", "valid are")),
    Wrong("unclosed", "gain: 2", "gain: (1 + 2", ("not arithmetic", "valid are")),
    Wrong("deep", "gain: 2", f"gain: {'(' * 300}1{')' * 300}", ("numbers",)),
    Wrong("deep minus", "gain: 2", f"gain: {'-' * 500}cycle", ("100 operations deep",)),
    Wrong("long expression", "gain: 2", f"gain: {'1+' * 3000}1", ("2000 characters",)),
    Wrong("nothing", "gain: 2", "gain:", ("'gain'", "needs a value", "1 ms")),
    Wrong("null", "gain: 2", "gain: null", ("'gain'", "needs a value")),
    Wrong("tilde", "initial: 0.1 rad", "initial: ~", ("initial", "needs a value")),
    Wrong("list", "gain: 2", "gain: [2]", ("'gain'", "needs a value")),
    Wrong("mapping", "gain: 2", "gain: {value: 2}", ("'gain'", "needs a value")),
    Wrong("list as quantity", "initial: 0.1 rad", "initial: [1]", ("initial", "needs a value")),
    Wrong("list as word", DEMAND, "    demand: [1]\n", ("'demand'", "arithmetic")),
    Wrong("list as title", "title: Loop", "title: [Loop]", ("title", "text", "a list")),
    Wrong("no title", "title: Loop", "title:", ("title", "text", "nothing")),
    Wrong("two lines", "title: Loop", 'title: "a\\nb"', ("title", "one line")),
    Wrong("escape in title", "title: Loop", 'title: "a\\x1bb"', ("title", "printable")),
    Wrong("long title", "title: Loop", f"title: {'x' * 201}", ("title", "200")),
    Wrong("list as section", "run: {until: 0.1 s}", "run: [0.1 s]", ("run", "mapping", "a list")),
    Wrong("text as section", RUN, "run: 0.1 s\n", ("run", "mapping", "'0.1 s'")),
    Wrong("list as terms", "{rate: 1}", "[rate]", ("mapping", "signal: coefficient", "a list")),
    Wrong("text as terms", "{rate: 1}", "rate", ("signal: coefficient", "'rate'"), "  angle:"),
    Wrong("text as component", ANGLE, "  angle: 5\n", ("'angle'", "mapping", "'5'")),
    Wrong("list as component", ANGLE, "  angle: [5]\n", ("'angle'", "mapping", "a list")),
    Wrong("text as converter", TORQUE, "  torque: 5\n", ("'torque'", "mapping")),
    Wrong("text as program", "  program:\n" + DEMAND, "  program: 5\n", ("program", "mapping")),
    Wrong("empty program", "  program:\n" + DEMAND, "  program: {}\n", ("no words", "arithmetic")),
    Wrong("mapping as record", "[angle, rate]", "{angle: 1}", ("record", "list", "a mapping")),
    Wrong("text as record", "[angle, rate]", "angle", ("record", "list", "'angle'"), "record:"),
    Wrong("list in record", "[angle, rate]", "[[angle]]", ("record", "a list")),
    Wrong("mapping as signal", "adc: angle", "adc: {angle: 1}", ("adc", "text", "a mapping")),
    Wrong("text as readouts", "  mode: {transient: angle}", "  - mode", ("readouts", "a list")),
    Wrong("text as readout", "{transient: angle}", "transient", ("'mode'", "mapping")),
    Wrong("bits 1", "bits: 14}", "bits: 1}", ("bits is '1'", "2 to 32")),
    Wrong("bits 33", "bits: 14}", "bits: 33}", ("bits is '33'", "2 to 32")),
    Wrong("bits 2.5", "bits: 14}", "bits: 2.5}", ("bits is '2.5'", "whole number")),
    Wrong("bits with a unit", "bits: 14}", "bits: 14 bits}", ("'14 bits'", "whole number")),
    Wrong("bits, full-width", "bits: 14}", "bits: １４}", ("whole number",)),
    Wrong("bits, parameter", "bits: 14}", "bits: gain}", ("'gain'", "whole number")),
    Wrong("bits, list", "bits: 14}", "bits: [14]}", ("a list", "whole number")),
    Wrong("bits, long", "bits: 14}", f"bits: {'9' * 5000}}}", ("999...", "whole number")),
    Wrong("channel", "bits: 14}", "channel: -1}", ("'-1'", "0 to 999")),
    Wrong("serial", "machine: ideal", "machine: {serial: -1}", ("'-1'", "0 to")),
    Wrong("max_rows", "until: 0.1 s", "until: 0.1 s, max_rows: 1", ("max_rows", "2 to")),
    Wrong("full_scale 0", "full_scale: 1 V}", "full_scale: 0 V}", ("is 0", "greater than 0")),
    Wrong("full_scale negative", "full_scale: 1 V}", "full_scale: -1 V}", ("-1", "greater than 0")),
    Wrong("tiny full_scale", "full_scale: 1 V}", "full_scale: 1e-200 V}", ("1e-200", "1e-100")),
    Wrong("huge full_scale", "full_scale: 1 V}", "full_scale: 1e200 V}", ("1e+200", "1e+100")),
    Wrong("initial", "initial: 0.1 rad", "initial: 1.1 rad", ("'angle'", "1.1 times", "within")),
    Wrong("DAC initial", "initial: 0,", "initial: 101,", ("'torque'", "1.01 times", "within")),
    Wrong("huge coefficient", "{angle: 1 V}", "{angle: 1e300 V}", ("1e+300", "1e+15")),
    Wrong("huge rate", "{rate: 1}", "{rate: 1e300}", ("'angle'", "1e+15")),
    Wrong("overflowing rate", "{rate: 1}", "{rate: 1e308}", ("'angle'", "1e+15")),
    Wrong("huge omega", "omega: 3 rad/s", "omega: 1e300 rad/s", ("'wind'", "1e+15")),
    Wrong("tiny tau", "full_scale: 1 V}", "full_scale: 1 V, tau: 1e-30 s}", ("tau", "femtosecond")),
    Wrong("negative tau", "full_scale: 1 V}", "full_scale: 1 V, tau: -1 us}", ("tau", "0 or greater")),
    Wrong("noise 5", "full_scale: 1 V}", "full_scale: 1 V, noise: 5}", ("noise", "fraction")),
    Wrong("noise alone", "full_scale: 1 V}", "full_scale: 1 V, noise: 0.1}", ("lag", "tau")),
    Wrong("range", "adc: angle,", "adc: angle, range: 1e-20,", ("range", "full scale of 'angle'")),
]  # fmt: skip

TIMES = [
    Wrong("T = 0", "cycle: 1 ms", "cycle: 0 s", ("period", "is 0", "greater"), "period:"),
    Wrong("T negative", "cycle: 1 ms", "cycle: -1 ms", ("-0.001", "greater"), "period:"),
    Wrong("T nan", "cycle: 1 ms", "cycle: .nan s", ("numbers",)),
    Wrong("T infinite", "cycle: 1 ms", "cycle: inf", ("'inf'", "gain, omega")),
    Wrong("T tiny", "cycle: 1 ms", "cycle: 1e-30 s", ("1e-30", "femtosecond"), "period:"),
    Wrong("T short", "cycle: 1 ms", "cycle: 1 fs", ("cycles", "1e+11"), RUN.strip()),
    Wrong("T long", "cycle: 1 ms", "cycle: 1e300 s", ("1e+300", "1e+15"), "period:"),
    Wrong("until 0", "until: 0.1 s", "until: 0 s", ("until", "greater than 0")),
    Wrong("until tiny", "until: 0.1 s", "until: 1e-30 s", ("until", "femtosecond")),
    Wrong("until far", "until: 0.1 s", "until: 1e300 s", ("until", "1e+15")),
    Wrong("many cycles", "until: 0.1 s", "until: 1e9 s", ("1e+12 cycles", "1e+11")),
    Wrong("every 0", "until: 0.1 s", "until: 0.1 s, every: 0 s", ("every", "greater than 0")),
    Wrong("every tiny", "until: 0.1 s", "until: 0.1 s, every: 1e-30 s", ("every", "femtosecond")),
    Wrong("every short", "until: 0.1 s", "until: 0.1 s, every: 1 fs", ("1e+14", "1e+11")),
    Wrong("incommensurate", "until: 0.1 s", "until: 1e5 s, every: 0.9999997 ms", ("multiple",)),
    Wrong("many intervals", "until: 0.1 s", "until: 15 s, every: 0.9999997 ms", ("multiple",)),
    Wrong("rows", "until: 0.1 s", "until: 1e6 s, max_rows: 100000000", ("max_rows", "record")),
    Wrong("compute_time", "  program:", "  compute_time: 1e6 s\n  program:", ("1e+09", "1000")),
    Wrong("compute negative", "  program:", "  compute_time: -1 s\n  program:", ("0 or greater",)),
    Wrong("compute huge", "  program:", "  compute_time: 1e300 s\n  program:", ("1e+15",)),
    Wrong("conversion", "bits: 14}", "conversion_time: 1 ms}", ("shorter than the period",)),
    Wrong("skew", "  program:", "  skew: -1 us\n  program:", ("skew", "0 or greater")),
    Wrong(
        "skew huge", PATCH[PATCH.index("interface") :],
        PATCH[PATCH.index("interface") :].replace("bits: 14}", "channel: 9}")
        .replace("  program:", "  skew: 1 s\n  program:"), ("1000 periods",), "channel",
    ),
]  # fmt: skip

LOOPS = [
    Wrong("parameters", "gain: 2", "gain: lead\n  lead: 2*gain", ("gain -> lead -> gain",)),
    Wrong("parameter itself", "gain: 2", "gain: gain", ("gain -> gain", "value of its own")),
    Wrong(
        "program", DEMAND, DEMAND + "    a: b\n    b: c\n    c: a\n",
        ("a -> b -> c -> a", "previous(a)"), "    a: b",
    ),
    Wrong("word itself", DEMAND, DEMAND + "    a: a + 1\n", ("a -> a", "previous(a)"), "a: a"),
    Wrong("previous", DEMAND, DEMAND + "    a: previous(a) + 1\n", ("remember", "{a: 0}"), "a: p"),
    Wrong("previous unknown", DEMAND, DEMAND + "    a: previous(c)\n", ("'c'", "valid:"), "a: p"),
    Wrong("previous of ADC", DEMAND, DEMAND + "    a: previous(angle_word)\n", ("no word",), "a: p"),
    Wrong("previous in parameter", "gain: 2", "gain: previous(gain)", ("only in a digital program",)),
    Wrong(
        "algebraic", "  volts: {coefficient: {angle: 1 V}, full_scale: 1 V}",
        "  volts: {sum: {angle: 1 V, more: 0.5}, full_scale: 1 V}\n"
        "  half: {coefficient: {volts: 0.5}, full_scale: 1 V}\n"
        "  more: {invert: half, full_scale: 1 V}",
        ("half -> more -> volts -> half", "tau", "integrator"), "  half:",
    ),
    Wrong("one part", "{angle: 1 V}", "{volts: 0.5}", ("volts -> volts", "tau"), "  volts:"),
]  # fmt: skip


def _cases() -> list[object]:
    tables = {"key": KEYS, "signal": SIGNALS, "unit": UNITS, "name": NAMES}
    tables |= {"value": VALUES, "time": TIMES, "loop": LOOPS}
    return [pytest.param(w, id=f"{t}: {w.name}") for t, ws in tables.items() for w in ws]


@pytest.mark.parametrize("wrong", _cases())
def test_a_wrong_patch(wrong: Wrong, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("wrong.yaml").write_text(wrong.text, encoding="utf-8")
    message = complaint(capsys, here, "wrong.yaml")
    print(message)
    for part in wrong.says:
        assert part in message
    assert message.startswith(f"wrong.yaml:{wrong.line}: ")


# -- files ------------------------------------------------------------------------------------------

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n"
    for a, b in zip("abcdefghijkl", "bcdefghijklm", strict=True)
)

FILES: dict[str, tuple[bytes | str, int, tuple[str, ...]]] = {
    "empty": ("", 0, ("empty", "title:")),
    "white": ("\n \n\n", 0, ("empty", "title:")),
    "comment": ("# nothing\n", 0, ("empty", "title:")),
    "null": ("~\n", 0, ("empty", "title:")),
    "list": ("- title\n- run\n", 1, ("mapping", "a list")),
    "text": ("# a\ntitle\n", 2, ("mapping", "'title'")),
    "tab": ("title: a\nrun:\n\tuntil: 1 s\n", 3, ("not valid YAML", "spaces", "tabs")),
    "indentation": ("title: a\n  run: b\n", 2, ("not valid YAML", "quotes", "indentation")),
    "colon": ("title: a: b\n", 1, ("not valid YAML", "quotes")),
    "quote": ("title: 'a\nrun: b\n", 2, ("not valid YAML", "line 1", "close the quotes")),
    "brace": ("title: a\nrun: {until: 1 s\n", 2, ("not valid YAML", "{key: value,")),
    "at sign": ("title: @a\n", 1, ("not valid YAML", "quotes")),
    "two documents": ("title: a\n---\ntitle: b\n", 2, ("second document", "remove the ---")),
    "control": ("title: a\nrun: \x07\n", 2, ("U+0007", "UTF-8")),
    "escape": ("title: \x1b[31m\n", 1, ("U+001B", "UTF-8")),
    "nul": ("title: a\nrun: \0\n", 2, ("U+0000", "UTF-8")),
    "non-character": ("title: \ufffe\n", 1, ("U+FFFE", "UTF-8")),
    "anchor": ("title: &a b\n", 1, ("anchors", "write it out")),
    "alias": ("title: a\nrun: *b\n", 2, ("aliases", "parameters:")),
    "anchored key": ("title: a\n&b run: c\n", 2, ("anchors", "write it out")),
    "merge": ("title: a\nrun:\n  <<: *b\n", 3, ("aliases", "write it out")),
    "laughs": ("title: a\n" + LAUGHS, 2, ("anchors", "write it out")),
    "tag": ("title: a\nrun: !!float 3\n", 2, ("tags", "float", "plain value")),
    "object": ("title: !!python/object/apply:os.system [ls]\n", 1, ("tags", "plain value")),
    "tagged key": ("!!str title: a\n", 1, ("tags", "plain value")),
    "nested lists": ("title: a\nrun: " + "[" * 100_000, 2, ("12 levels",)),
    "nested mappings": ("title: a\nrun: " + "{a: " * 100_000, 2, ("12 levels",)),
    "nested blocks": ("title: a\nrun:\n" + "".join(f"{' ' * n}- \n" for n in range(1, 99)), 14, ("12",)),
    "5 MB": ("title: a\n" * 600_000, 0, ("too long", "1000000")),
    "UTF-16": ("title: a\n".encode("utf-16"), 0, ("UTF-16", "UTF-8")),
    "UTF-16, no mark": ("title: a\n".encode("utf-16-le"), 1, ("U+0000", "UTF-8")),
    "Latin-1": ("title: a\nrun: größe\n".encode("latin-1"), 2, ("UTF-8",)),
    "binary": (bytes(range(256)) * 10, 2, ("UTF-8",)),
    "parameters": (
        "title: a\nparameters:\n" + "".join(f"  p{n}: 1\n" for n in range(5001)) + "run: {}\n",
        3, ("5001 entries", "5000"),
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "line", "says"), FILES.values(), ids=FILES)
def test_a_wrong_file(
    content: bytes | str,
    line: int,
    says: tuple[str, ...],
    here: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    raw = content if isinstance(content, bytes) else content.encode("utf-8")
    Path("wrong.yaml").write_bytes(raw)
    message = complaint(capsys, here, "wrong.yaml")
    for part in says:
        assert part in message
    assert message.startswith(f"wrong.yaml:{line}: " if line else "wrong.yaml: ")


NO_FILES = {
    "missing": ("missing.yaml", "No such file"),
    "directory": (".", "Is a directory"),
    "below a file": ("loop.yaml/patch.yaml", "Not a directory"),
    "long name": ("n" * 300, "File name too long"),
    "unreadable": ("/proc/self/mem", "cannot be read"),
    "endless": ("/dev/zero", "at most 1000000 bytes"),
    "NUL": ("a\0b", "no file has such a name"),
    "empty name": ("", "Is a directory"),
    "not shipped": ("pitch_lop", "No such file"),
}


@pytest.mark.parametrize(("name", "says"), NO_FILES.values(), ids=NO_FILES)
def test_no_file(name: str, says: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("loop.yaml").write_text(PATCH)
    assert says in complaint(capsys, here, name, verb="run")


# -- options ----------------------------------------------------------------------------------------

OPTIONS: dict[str, tuple[str, ...]] = {
    # arguments, separated by spaces; what the message says
    "set, no value": ("check --set gain", "NAME=VALUE"),
    "set, empty value": ("check --set gain=", "NAME=VALUE"),
    "set, no name": ("check --set =3", "no parameter ''", "gain"),
    "set, unknown": ("check --set gian=3", "loop.yaml: ", "no parameter 'gian'", "'gain'"),
    "set, twice": ("check --set gain=3 --set gain=4", "gain is given twice"),
    "set, unit": ("check --set cycle=1_V", "'1 V'", "a time, such as 1 ms"),
    "set, radians for a time": ("check --set cycle=1_rad", "'1 rad'", "a time"),
    "set, unit for a pure number": ("check --set gain=1_ms", "'1 ms'", "pure number"),
    "set, Hz for rad/s": ("check --set omega=2_Hz", "'2 Hz'", "rad/s"),
    "set, name": ("check --set gain=omega", "names are not known here", "2 ms"),
    "set, text": ("check --set gain=much", "names are not known here"),
    "set, code": ("check --set gain=__import__('os')", "valid are numbers"),
    "set, nan": ("check --set gain=nan", "names are not known"),
    "set, infinite": ("check --set gain=1e999", "too large"),
    "set, zero period": ("check --set cycle=0", "loop.yaml:16: ", "greater than 0"),
    "set, negative period": ("check --set cycle=-1_ms", "loop.yaml:16: ", "greater than 0"),
    "set, tiny period": ("check --set cycle=1e-30", "loop.yaml:16: ", "femtosecond"),
    "set, short period": ("check --set cycle=1_fs", "loop.yaml:19: ", "1e+11"),
    "set, overload": ("check --set omega=1e200", "loop.yaml:18: ", "no finite value"),
    "machine": ("check --machine nominel", "'nominel'", "did you mean 'nominal'"),
    "machine, run": ("run --machine perfect", "'perfect'", "ideal, lags, nominal"),
    "serial": ("check --serial -1", "serial is -1", "2^63"),
    "serial, text": ("check --serial x", "--serial", "'x'", "--help"),
    "serial, large": ("check --serial 9223372036854775808", "serial is", "2^63"),
    "seed": ("run --seed -1", "seed is -1", "2^63"),
    "seed, text": ("run --seed x", "--seed", "'x'", "--help"),
    "seed, fraction": ("run --seed 1.5", "--seed", "'1.5'", "--help"),
    "seed, large": ("run --seed 9223372036854775808", "seed is", "2^63"),
    "until, unit": ("run --until 3_V", "--until", "'3 V'", "20 s"),
    "until, zero": ("run --until 0", "--until is 0", "greater than 0"),
    "until, negative": ("run --until=-1", "--until is -1", "greater than 0"),
    "until, tiny": ("run --until 1e-30", "--until", "femtosecond"),
    "until, far": ("run --until 1e300", "--until", "1e+15"),
    "until, many cycles": ("run --until 1e10", "1e+13", "1e+11"),
    "until, parameter": ("run --until cycle", "--until", "'cycle'"),
    "until, empty": ("run --until ", "--until", "needs a value"),
    "out, file in the way": ("run --out loop.yaml", "loop.yaml", "cannot write", "File exists"),
    "out, below a file": ("run --out loop.yaml/out", "cannot write", "Not a directory"),
    "out, no such place": ("run --out /proc/nonexistent/out", "cannot write"),
    "sweep without over": ("sweep", "--over", "--help"),
    "over, no range": ("sweep --over cycle", "NAME=START:STOP:COUNT"),
    "over, two parts": ("sweep --over cycle=1:2", "START:STOP:COUNT"),
    "over, five parts": ("sweep --over cycle=1:2:3:log:5", "START:STOP:COUNT"),
    "over, linn": ("sweep --over cycle=1:2:3:linn", ":log"),
    "over, count 0": ("sweep --over cycle=1_ms:2_ms:0", "COUNT is '0'", "1 to 1000000"),
    "over, count negative": ("sweep --over cycle=1_ms:2_ms:-1", "COUNT is '-1'"),
    "over, count fraction": ("sweep --over cycle=1_ms:2_ms:2.5", "COUNT is '2.5'"),
    "over, count large": ("sweep --over cycle=1_ms:2_ms:1000001", "COUNT", "1000000"),
    "over, count endless": (f"sweep --over cycle=1_ms:2_ms:{'9' * 5000}", "COUNT", "1000000"),
    "over, log of zero": ("sweep --over cycle=0:2_ms:3:log", "above 0"),
    "over, log of negative": ("sweep --over cycle=-1:2_ms:3:log", "above 0"),
    "over, unit": ("sweep --over cycle=1_V:2_V:3", "'1 V'", "a time"),
    "over, unknown": ("sweep --over cicle=1:2:3", "'cicle'", "'cycle'"),
    "over, zero period": ("sweep --over cycle=0:1_ms:3", "loop.yaml:16: ", "greater than 0"),
    "over, too wide": ("sweep --over gain=-1e308:1e308:3", "too wide", ":log"),
    "over, also set": ("sweep --over gain=1:2:3 --set gain=3", "both set and swept"),
    "sweep, machine": ("sweep --over gain=1:2:3 --machine x", "'x'", "ideal"),
    "sweep, seed": ("sweep --over gain=1:2:3 --seed -1", "seed is -1"),
    "sweep, jobs 0": ("sweep --over gain=1:2:3 --jobs 0", "jobs is 0", "1 to 1000"),
    "sweep, jobs": ("sweep --over gain=1:2:3 --jobs 100000", "jobs is 100000", "1 to 1000"),
    "sweep, out": ("sweep --over gain=1:2:3 --out a.csv", "a.csv", ".nc"),
    "sweep, out below a file": ("sweep --over gain=1:2:3 --out loop.yaml/a.nc", "cannot write"),
    "predict, 0": ("predict --max-damping-error 0", "above 0"),
    "predict, negative": ("predict --max-damping-error=-1", "above 0"),
    "predict, nan": ("predict --max-damping-error nan", "above 0"),
    "predict, inf": ("predict --max-damping-error inf", "above 0"),
    "predict, text": ("predict --max-damping-error x", "'x'", "--help"),
    "unknown option": ("check --sett gain=3", "--sett", "--help"),
}


@pytest.mark.parametrize("case", OPTIONS.values(), ids=OPTIONS)
def test_a_wrong_option(
    case: tuple[str, ...], here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    verb, *options = (word.replace("_", " ") for word in case[0].split(" "))
    if "__" in case[0]:
        options = case[0].split(" ")[1:]
    Path("loop.yaml").write_text(PATCH)
    message = complaint(capsys, here, "loop.yaml", *options, verb=verb)
    for part in case[1:]:
        assert part in message


COMMANDS = {
    "no verb": ((), "VERB"),
    "unknown verb": (("rnu", "pitch_loop"), "'rnu'"),
    "no patch": (("run",), "PATCH"),
    "no patch, check": (("check",), "PATCH"),
    "two patches": (("run", "a", "b"), "b"),
    "new line in an option": (("run", "a", "--x\ny"), "--x y"),
    "new line in a name": (("run", "a\nb"), "a b: cannot be read"),
    "escape in a name": (("run", "a\x1bb"), "a b: cannot be read"),
}


@pytest.mark.parametrize(("arguments", "says"), COMMANDS.values(), ids=COMMANDS)
def test_a_wrong_command(
    arguments: tuple[str, ...], says: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(list(arguments)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("hybrid: ")
    assert err.count("\n") == 1
    assert says in err
    assert sorted(here.iterdir()) == []


# -- as a process of its own ------------------------------------------------------------------------

LIMITED = (
    "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (10**9, 10**9)); "
    "from hybrid.cli import main; sys.exit(main(sys.argv[1:]))"
)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("check", "wrong.yaml"), "wrong.yaml:2: "),
        (("check", "laughs.yaml"), "laughs.yaml:2: "),
        (("run", "/dev/zero"), "/dev/zero: "),
        (("run", "loop.yaml", "--set", "cycle=0"), "loop.yaml:16: "),
        (("run", b"no\xffname.yaml"), "no?name.yaml: "),
        (("sweep", "loop.yaml", "--over", "cycle=0:1:0"), "COUNT"),
    ],
    ids=str,
)
def test_a_process(arguments: tuple[str | bytes, ...], says: str, here: Path) -> None:
    """One line and exit code 2 also from outside, within a gigabyte and a few seconds."""
    Path("loop.yaml").write_text(PATCH)
    Path("wrong.yaml").write_text(PATCH.replace("machine: ideal", "machine: idaal"))
    Path("laughs.yaml").write_text("title: a\n" + LAUGHS)
    before = sorted(here.rglob("*"))
    command = [sys.executable, "-c", LIMITED, *arguments]
    done = subprocess.run(command, capture_output=True, timeout=30, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stdout == b""
    assert done.stderr.decode().startswith(f"hybrid: {says}")
    assert done.stderr.count(b"\n") == 1
    assert sorted(here.rglob("*")) == before


# -- odd but right ----------------------------------------------------------------------------------

ODD = {
    "one row": ("until: 0.1 s", "until: 0.1 ms"),
    "long interval": ("until: 0.1 s", "until: 0.1 s, every: 1 s"),
    "late step": ("  wind: {sine: 0.1 V, omega: 3 rad/s,", "  wind: {step: 1 V, at: 1e14 s,"),
    "deep pipeline": ("  program:", "  compute_time: 0.2 s\n  program:"),
    "least figures": ("full_scale: 1 V}", "full_scale: 1 V, tau: 1e-15 s, noise: 1}"),
}


@pytest.mark.parametrize("change", ODD.values(), ids=ODD)
def test_odd_but_right(change: tuple[str, str], recwarn: pytest.WarningsRecorder) -> None:
    assert change[0] in PATCH
    patch = hybrid.parse_patch(PATCH.replace(*change))
    for machine in ("ideal", "nominal"):
        assert hybrid.run(patch, machine=machine).status == "complete"
    assert not recwarn.list


@pytest.mark.parametrize("rate", ["1e4", "1e9", "1e14"])
def test_a_patch_that_runs_away(rate: str, recwarn: pytest.WarningsRecorder) -> None:
    """Growth beyond all numbers within one cycle stops the run and is not a warning of numpy's."""
    text = PATCH.replace("{torque: 1}", f"{{torque: 1, rate: {rate}}}")
    patch = hybrid.parse_patch(text.replace("0 rad/s,", "1 rad/s,"))
    for machine in ("ideal", "nominal"):
        run = hybrid.run(patch, machine=machine)
        assert run.status == "stopped"
        assert "unstable" in run.status_note
        try:
            hybrid.predict(patch, machine=machine)
        except hybrid.RunError as error:
            assert "runs away" in str(error)
    assert not recwarn.list


def test_a_title_is_not_a_formula(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    title = r"title: 'a $x^$ \frac{ %s {0} [bold] [/x] 中文'"
    Path("odd.yaml").write_text(PATCH.replace("title: Loop", title), encoding="utf-8")
    assert main(["run", "odd.yaml"]) == 0
    out, err = capsys.readouterr()
    assert err in ("", COMPILING)
    assert r"a $x^$ \frac{ %s {0} [bold] [/x]" in out
    assert sorted(path.name for path in Path("out").iterdir()) == ["odd.nc", "odd.png"]


def test_a_range_may_run_downwards(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("loop.yaml").write_text(PATCH)
    options = ["--over", "cycle=2 ms:1 ms:2", "--no-chart", "--out", "a/b.nc"]
    assert main(["sweep", "loop.yaml", *options]) == 0
    assert capsys.readouterr().err in ("", COMPILING)
    assert Path("a/b.nc").exists()


def test_letters_that_the_terminal_lacks(here: Path) -> None:
    Path("odd.yaml").write_text(PATCH.replace("title: Loop", "title: ω"), encoding="utf-8")
    command = [sys.executable, "-m", "hybrid.cli", "check", "odd.yaml"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, timeout=30, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(b"? on machine ideal")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk(here: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        command = [sys.executable, "-m", "hybrid.cli", "schema"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, timeout=30, check=False)
    assert done.returncode == 2
    assert done.stderr == b"hybrid: cannot write the answer: No space left on device\n"
