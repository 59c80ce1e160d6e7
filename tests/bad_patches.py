"""A right patch and tables of what can be wrong with it, with the line and words of each message."""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class Wrong:
    """PATCH with `old` replaced by `new`; the fault is in the line of `at` (default: of `new`)."""

    name: str
    old: str
    new: str
    says: tuple[str, ...]  # all in the message
    at: str = ""

    @property
    def text(self) -> str:
        assert self.old in PATCH, self.old
        return PATCH.replace(self.old, self.new, 1)

    @property
    def line(self) -> int:
        at = self.at or self.new.strip().splitlines()[0].strip()
        return next(i for i, line in enumerate(self.text.splitlines(), 1) if at in line)


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
    Wrong("kind", "{sine: 0.1 V", "{sien: 0.1 V", ("'wind'", "'sien'", "did you mean", "'sine'")),
    Wrong("kind, no likeness", "{sine: 0.1 V", "{zzz: 0.1 V", ("'zzz'", "constant", "divide")),
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
    Wrong(
        "parameter",
        "cycle: 1 ms",
        "cycle: 1 V",
        ("'cycle', which is in kg*m^2/(s^3*A) by", "yaml:5; it must be a time"),
        at="period: cycle",
    ),
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
    Wrong(
        "comma in braces",
        "  program:\n" + DEMAND,
        "  program: {demand: -omega**2 * max(angle_word, 2)}\n",
        ("'2)'", "quotes around all of that"),
        at="max(",
    ),
    Wrong("word", "-omega**2 *", "-omega *", ("'demand'", "a rate", "in rad/s^2"), "  torque:"),
    Wrong("word, sum", "-omega**2 *", "-omega**2 + cycle *", ("'demand'", "1/s^2"), "demand:"),
    Wrong(
        "threshold",
        ANGLE,
        ANGLE + "  part: {compare: {volts: 1}, threshold: 3 m, high: 1, full_scale: 1}\n",
        ("threshold of component 'part' is '3 m'", "must be in V"),
        at="part:",
    ),
    Wrong(
        "hysteresis",
        ANGLE,
        ANGLE
        + "  part: {compare: {volts: 2, wind: -1}, hysteresis: 10 ms, high: 1, full_scale: 1}\n",
        ("hysteresis of component 'part'", "must be in V"),
        at="part:",
    ),
    Wrong(
        "threshold, by coefficient",
        ANGLE,
        ANGLE
        + "  part: {compare: {volts: 2 m/V, wind: 1}, threshold: 1 V, high: 1, full_scale: 1}\n",
        ("threshold of component 'part'", "must be in m"),
        at="part:",
    ),
    Wrong(
        "compared",
        ANGLE,
        ANGLE + "  part: {compare: {volts: 2 m/V, wind: 3 s/V}, high: 1, full_scale: 1}\n",
        ("coefficient of 'wind'", "makes it a time", "added to is in m"),
        at="part:",
    ),
    Wrong(
        "point",
        ANGLE,
        ANGLE + "  part: {function: volts, points: {0 V: 0, 1 m: 1}, full_scale: 1}\n",
        ("input of point '1 m' of component 'part'", "reads 'volts'", "in V"),
        at="part:",
    ),
    Wrong(
        "rounding",
        ANGLE,
        ANGLE
        + "  part: {function: volts, points: {0: 0, 1: 1, 2: 0}, rounding: 1 s, full_scale: 1}\n",
        ("rounding of component 'part'", "in V"),
        at="part:",
    ),
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
    Wrong("digit", "  gain: 2", "  2nd: 2", ("'2nd'", "letters a to z or A to Z, digits")),
    Wrong("integer", "  gain: 2", "  7: 2", ("'7'", "letters")),
    Wrong("minus", "  volts:", "  my-volts:", ("'my-volts'", "underscores")),
    Wrong("unicode", "  gain: 2", "  größe: 2", ("'größe'", "letters")),
    Wrong("greek", "  volts:", "  ω_p:", ("'ω_p'", "letters a to z")),
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
    Wrong("infinity", "gain: 2", "gain: .inf", ("'.inf'", "finite number")),
    Wrong("nan", "gain: 2", "gain: .nan", ("'.nan'", "finite number")),
    Wrong("named nan", "gain: 2", "gain: nan", ("'nan'", "finite number")),
    Wrong("comma", "cycle: 1 ms", "cycle: '1,5 ms'", ("point", "not a comma: 1.5")),
    Wrong("too large", "gain: 2", "gain: 1e999", ("too large", "1.8e308", "(character 1 of the")),
    Wrong("too small", "gain: 2", "gain: 1e-999", ("too small", "5e-324")),
    Wrong("two numbers", "gain: 2", "gain: 1 ms 2", ("'ms 2'", "'rad/s^2'")),
    Wrong("division by zero", "gain: 2", "gain: 1/0", ("no finite value",)),
    Wrong("overflow", "gain: 2", "gain: 1e200*1e200", ("no finite value",)),
    Wrong("root", "gain: 2", "gain: sqrt(-1)", ("no finite value",)),
    Wrong("code", "gain: 2", "gain: __import__('os')", ('"\'"', "valid are numbers")),
    Wrong("attribute", "gain: 2", "gain: cycle.real", ("unknown parameter 'cycle.real'", "'cycle'")),
    Wrong("attribute of a number", "gain: 2", "gain: (2).real", ("not arithmetic", "valid are")),
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
    Wrong("twice in record", "[angle, rate]", "[angle, rate, angle]", ("'angle' twice",)),
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
    Wrong("T = 0", "cycle: 1 ms", "cycle: 0 s", ("period", "= 0 s", "greater"), "period:"),
    Wrong("T negative", "cycle: 1 ms", "cycle: -1 ms", ("-0.001", "greater"), "period:"),
    Wrong("T nan", "cycle: 1 ms", "cycle: .nan s", ("finite number",)),
    Wrong("T infinite", "cycle: 1 ms", "cycle: inf", ("'inf'", "finite number")),
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
