"""One description on either machine: what moves means the same there, and crosses where it must."""

from __future__ import annotations

import cmath
import json
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hybrid
from hybrid.cli import main
from hybrid.errors import PatchError
from hybrid.formulas import FORMULAS
from hybrid.patchfile import parse_patch, read_patch

# Every kind of component that the digital machine has a meaning for.
KINDS = """\
title: Kinds
machine: ideal
parameters: {half: 0.5, rate: 1 1/s, step: 0.01 s}
analog:
  x: {integrate: {y: rate}, initial: 0.2, full_scale: 1}
  y: {integrate: {x: -1}, initial: 0.9, leak: 0.1 1/s, full_scale: 1}
  late: {lag: {x: 1}, time_constant: 0.5 s, initial: 0.1, full_scale: 1}
  one: {constant: 1, full_scale: 1}
  sum: {sum: {x: 1, y: -half, one: 0.25}, full_scale: 2}
  part: {coefficient: {x: half}, full_scale: 1}
  other: {invert: x, full_scale: 1}
  product: {multiply: [x, y], gain: 2, full_scale: 2}
  squares: {multiply: [x, x], full_scale: 1}
  above: {sum: {y: 1, one: 2}, full_scale: 4}
  quotient: {divide: [x, above], gain: half, full_scale: 1}
  root: {square_root: above, gain: 3, full_scale: 10}
  sine_of: {sin: x, amplitude: 2, full_scale: 2}
  cosine_of: {cos: x, full_scale: 1}
  angle_of: {atan2: [x, above], gain: 2, full_scale: 2}
  size: {absolute: x, full_scale: 1}
  kept: {limit: x, low: -0.25, high: half, full_scale: 1}
  outside: {dead_zone: x, low: -0.25, high: half, full_scale: 1}
  curve: {function: x, points: {-1: 0.5, 0: 0, 0.5: 0.4}, full_scale: 1}
  high: {compare: {x: 1}, high: 1, threshold: 0.1, full_scale: 1}
  chosen: {switch: [x, y], control: high, full_scale: 1}
  stepped: {step: 0.5, at: 1.003 s, before: -0.5, full_scale: 1}
  risen: {ramp: 0.1 1/s, at: 1 s, until: 3 s, full_scale: 1}
  pulsed: {pulse: 0.7, at: 1.003 s, width: 1 s, full_scale: 1}
  wave: {sine: 0.5, omega: 2 rad/s, phase: 0.3, bias: 0.1, full_scale: 1}
digital: {period: step, compute_time: 0, integration: rk4}
run: {until: 5 s, every: 0.1 s}
"""
STATIC = ["one", "sum", "part", "other", "product", "squares", "above", "quotient", "root"]
STATIC += ["sine_of", "cosine_of", "angle_of", "size", "kept"]
STATIC += ["outside", "curve", "high", "chosen", "stepped", "risen", "pulsed", "wave"]


def test_every_kind_means_the_same_in_the_program() -> None:
    """The engine is right to 1e-8 of full scale; rk4 errs by (rate T)^5/120 a step, so 5e-10 in all."""
    nothing = KINDS.replace("digital: {period: step, compute_time: 0, integration: rk4}\n", "")
    analog = hybrid.run(parse_patch(nothing)).record
    patch = parse_patch(KINDS, on="digital")
    assert not patch.components and {s.word for s in patch.program.states} >= {"x", "y", "late"}
    digital = hybrid.run(patch).record
    assert "time" not in digital.data_vars and len(analog["time"]) == len(digital["time"])
    for name in ("x", "y", "late", *STATIC):
        # What jumps at x = 0.1 does so between two rows in both.
        np.testing.assert_allclose(digital[name], analog[name], atol=1e-7, err_msg=name)


def test_a_translated_integrator_has_the_order_of_its_formula() -> None:
    """Against x'' + 0.1 x' + x = 0 and a lag, tightly integrated."""

    def rates(_: float, s: np.ndarray) -> list[float]:
        return [s[1], -s[0] - 0.1 * s[1], (s[0] - s[2]) / 0.5]

    exact = solve_ivp(rates, (0, 5), [0.2, 0.9, 0.1], "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    for formula, order in (("euler", 1), ("ab2", 2), ("rk2", 2), ("ab3", 3), ("rk4", 4)):
        patch = parse_patch(KINDS.replace("rk4", formula), on="digital")
        errors = []
        for step in (0.02, 0.01):
            record = hybrid.run(patch, {"step": step}).record
            found = [float(record[name][-1]) for name in ("x", "y", "late")]
            errors.append(np.abs(found - exact).max())
        # Terms of the next order are a few times the step.
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15), formula


# Cycles in which something begins, and a pulse between the 57th and the 7057th.
EDGES = (0, 1, 3, 6, 8, 29, 57, 900, 9999)
SOURCES = """\
title: Edges
machine: ideal
parameters: {{cycle: {period} s}}
analog:
{steps}
  pulsed: {{pulse: 1, at: 57*cycle, width: 7000*cycle, full_scale: 1}}
  between: {{step: 1, at: 3.5*cycle, full_scale: 1}}
digital: {{period: cycle, compute_time: 0, integration: {formula}, word: {word}}}
run: {{until: 10000*cycle, max_rows: 20000}}
"""


@pytest.mark.parametrize(
    "word", ["float64", "float32", "{mantissa: 12}", "{fixed: 12, full_scale: 4}"]
)
@pytest.mark.parametrize("period", ["0.1", "0.01", "0.007", "0.29"])
def test_an_edge_at_a_cycle_is_in_that_cycle(period: str, word: str) -> None:
    """Times as people write them, such as 0.8 s of cycles of 0.1 s, under every formula."""
    steps = "\n".join(
        f"  z{k}: {{step: 1, at: {k * Decimal(period)} s, before: -1, full_scale: 1}}"
        for k in EDGES
    )
    cycles = np.arange(10001)
    for formula in FORMULAS:
        text = SOURCES.format(period=period, steps=steps, formula=formula, word=word)
        record = hybrid.run(parse_patch(text, on="digital")).record
        np.testing.assert_array_equal(record["seconds"], cycles * float(period))
        for k in EDGES:
            np.testing.assert_array_equal(record[f"z{k}"], np.where(cycles >= k, 1.0, -1.0))
        np.testing.assert_array_equal(record["pulsed"], (cycles >= 57) & (cycles < 7057))
        np.testing.assert_array_equal(record["between"], cycles >= 4)


# The same the other way: words that are one component each.
WORDS = """\
title: Words
machine: ideal
parameters: {half: 0.5, rate: 1 1/s}
tables:
  curve: {inputs: {x: 1}, values: {-1: 0.5, 0: 0, 0.5: 0.4}, outside: OUTSIDE}
digital:
  period: 2 ms
  compute_time: 0
  integration: rk4
  states:
    x: {integrate: y*rate, initial: 0.2}
    y: {integrate: (1.5*half - 0.75 - x)*rate - 0.1*y*rate, initial: 0.9}
    t: {integrate: 1, initial: 0 s}
  program:
    sum: x - half*(y - 0.5) + 1
    part: -x/4
    again: x
    five: 5*half
    product: -2*x*y/3
    square: half*x**2
    above: 2 + y
    quotient: x/(4*above)
    inverse: half/above
    root: 3*sqrt(above)
    sine_of: 2*sin(x)
    cosine_of: -cos(again)
    angle_of: -atan2(x, above)/2
    size: abs(x)
    kept: limit(x, -0.25, half)
    outside: dead_zone(x, -0.25, half)
    looked: curve(x)
  full_scales: {x: 1, y: 1, t: 10 s, sum: 4, part: 1, five: 5, product: 2, square: 1, above: 4,
    quotient: 1, inverse: 1, root: 10, sine_of: 2, cosine_of: 1, angle_of: 1, size: 1, kept: 1,
    outside: 1, looked: 1}
run: {until: 5 s, every: 0.1 s}
"""


@pytest.mark.parametrize("outside", ["clamp", "extrapolate"])
def test_every_word_means_the_same_on_the_analog_machine(outside: str) -> None:
    text = WORDS.replace("OUTSIDE", outside)
    digital, patch = hybrid.run(parse_patch(text)).record, parse_patch(text, on="analog")
    kinds = {c.name: c.kind for c in patch.components}
    assert patch.program is None and "again" not in kinds  # a plain cord
    assert kinds["sum"] == "sum" and kinds["part"] == "coefficient" and kinds["five"] == "constant"
    assert kinds["square"] == kinds["product"] == "multiply" and kinds["inverse"] == "divide"
    analog = hybrid.run(patch).record
    for name in set(kinds) - {"reference"}:
        scale = analog[name].attrs["full_scale"]
        np.testing.assert_allclose(
            analog[name], digital[name], atol=1e-7 * scale, rtol=0, err_msg=name
        )


# -- the pitch loop, on three machines --------------------------------------------------------------


def test_the_pitch_loop_on_the_analog_machine_is_that_of_the_paper() -> None:
    """Eq. 2.3: five elements with a lag of 1 us each; both converters are plain cords."""
    patch = read_patch("pitch_loop", "analog")
    assert not patch.adcs and not patch.dacs and patch.program is None
    assert patch.record == ("theta", "theta_dot", "alpha", "moment")
    (mode,) = hybrid.predict(patch, machine="lags").modes
    (paper,) = hybrid.predict("pitch_loop_analog").modes
    assert mode.zeta == pytest.approx(paper.zeta, rel=1e-9)
    assert mode.omega == pytest.approx(paper.omega, rel=1e-14)


def test_the_pitch_loop_on_the_digital_machine_is_its_formula() -> None:
    """z = R(i W) of rk4: the modes of theta'' = -omega^2 theta without any converter."""
    text = Path(read_patch("pitch_loop").file).read_text(encoding="utf-8")
    text = text.replace("  period: cycle\n", "  period: cycle\n  integration: rk4\n")
    patch = parse_patch(text, on="digital")
    assert not (patch.components or patch.adcs or patch.dacs)
    (mode,) = hybrid.predict(patch, {"cycle": 0.02}).modes
    w = 1j * 10.0 * 0.02
    s = cmath.log(1 + w + w**2 / 2 + w**3 / 6 + w**4 / 24) / 0.02
    assert mode.omega == pytest.approx(abs(s), rel=1e-12)
    assert mode.zeta == pytest.approx(-s.real / abs(s), rel=1e-8)


def test_what_is_told_of_nothing_changes_nothing() -> None:
    plain, told = read_patch("pitch_loop"), read_patch("pitch_loop", {"theta": "analog"})
    assert (told.components, told.adcs, told.dacs) == (plain.components, plain.adcs, plain.dacs)
    np.testing.assert_array_equal(
        hybrid.run(plain, machine="nominal").record["theta"],
        hybrid.run(told, machine="nominal").record["theta"],
    )


# -- what crosses -----------------------------------------------------------------------------------

LOOP = """\
title: Loop
machine: nominal
parameters: {cycle: 10 ms}
analog:
  rate: {integrate: {torque: 1}, initial: 0.5 rad/s, full_scale: 10 rad/s}
  angle: {integrate: {rate: 1}, initial: 0.1 rad, full_scale: 1 rad}
interface:
  sample: {adc: angle, bits: 12}
  torque: {dac: word, bits: 12, full_scale: 100 rad/s^2, initial: 0 rad/s^2}
digital:
  period: cycle
  integration: euler
  program: {word: -100*sample*unit, unit: 1 1/s^2}
run: {until: 2 s}
readouts: {top: {maximum: torque}}
"""


def test_a_converter_is_made_where_none_is() -> None:
    patch = parse_patch(LOOP, on={"rate": "digital"})
    assert [c.name for c in patch.components] == ["angle"]
    (state,) = patch.program.states
    assert (state.word, state.formula) == ("rate", "euler")
    (dac,) = (
        patch.dacs
    )  # of the rate, which the angle needs; the torque's is a plain connection now
    assert (dac.name, dac.word, dac.bits) == ("rate_held", "rate", 12)
    scope = patch.bind()
    assert dac.full_scale.number(scope) == 10.0 and dac.initial.number(scope) == 0.5
    assert [a.name for a in patch.adcs] == ["sample"]
    assert patch.readouts[0].signal == "word"
    assert hybrid.run(patch).status == "complete"


MADE = """\
title: Made
machine: lags
parameters: {cycle: 10 ms, half: 0.5, rate: 1 1/s}
analog:
  x: {integrate: {LINE}, initial: half, full_scale: 4}
  y: {integrate: {x: -rate}, initial: 2, full_scale: 4}
  made: {WHAT, full_scale: 8}
  a: {sum: {b: 0.5, x: 1}, full_scale: 8}
  b: {coefficient: {a: 0.5}, full_scale: 8}
digital: {period: cycle}
run: {until: 1 s}
"""


@pytest.mark.parametrize(
    ("what", "first"),
    [
        ("sum: {x: 1, y: 3}", 6.5),
        ("multiply: [x, y], gain: 2", 2.0),
        ("sine: 2, omega: 1 rad/s, phase: 0.5", 2 * np.sin(0.5)),
        ("step: 1, at: 0 s, before: 3", 1.0),
        ("step: 1, at: 1 s, before: 3", 3.0),
        ("integrate: {x: 1 1/s}, initial: 1.5", 1.5),
        ("function: x, points: {0: 1, 1: 2}", None),
        ("invert: a", None),
    ],
)
def test_a_made_dac_begins_at_the_value_of_its_word(what: str, first: float | None) -> None:
    """By hand, with x = half and y = 2 at t = 0; and it is told of where only a run can tell."""
    text = MADE.replace("WHAT", what).replace("LINE", "made: rate")
    patch = parse_patch(text, "t.yaml", {"made": "digital"})
    (dac,) = patch.dacs
    assert dac.name == "made_held"
    assert dac.initial.number(patch.bind()) == pytest.approx(first or 0.0, rel=1e-15)
    told = [w for w in hybrid.check(patch, trial=False).warnings if "begins" in w]
    assert len(told) == (first is None)
    assert all(w.startswith("t.yaml:7: DAC 'made_held' is made for 'made'") for w in told)
    if what.startswith("sum"):
        assert dac.initial.number(patch.bind({"half": 0.75})) == 6.75


def test_an_adc_is_made_where_none_is() -> None:
    text = LOOP.replace("word: -100*sample*unit", "word: -100*sample*unit, shown: 2*word")
    text = text.replace(", unit: 1 1/s^2", "")
    text = text.replace("{cycle: 10 ms}", "{cycle: 10 ms, unit: 1 1/s^2}")
    patch = parse_patch(text, on={"word": "analog"})
    assert [(a.name, a.source, a.bits) for a in patch.adcs] == [("word_sample", "word", 12)]
    assert not patch.dacs and [e.word for e in patch.program.written] == ["shown"]
    assert {c.name: c.kind for c in patch.components}["word"] == "coefficient"


def test_a_converter_of_the_patch_is_used() -> None:
    """The angle's own ADC, for a component that is put behind it."""
    more = "  twice: {coefficient: {angle: 2}, full_scale: 2 rad}\ninterface:"
    patch = parse_patch(LOOP.replace("interface:", more), on={"twice": "digital"})
    assert [a.name for a in patch.adcs] == ["sample"] and len(patch.dacs) == 1


def test_the_longer_name_goes_first_and_the_command_line_before_the_patch() -> None:
    text = """\
title: Parts
definitions:
  two:
    parts: {a: {use: one}, b: {use: one, on: analog}}
  one:
    parameters: {rate: 1 1/s}
    analog: {x: {integrate: {x: -rate}, initial: 1, full_scale: 1}}
parts: {p: {use: two, on: digital}}
digital: {period: 10 ms}
run: {until: 1 s}
"""

    def states(on: object = None) -> list[str]:
        program = parse_patch(text, on=on).program
        return [state.word for state in program.states] if program else []

    assert states() == ["p.a.x"]
    assert states("digital") == ["p.a.x", "p.b.x"]
    assert states({"p": "analog", "p.b.x": "digital"}) == ["p.b.x"]
    assert states("analog") == []
    assert hybrid.run(parse_patch(text, on="analog"), machine="ideal").cycles == 0


def test_a_lead_makes_up_for_what_a_ramp_is_late() -> None:
    """A ramp is shown where it is in the middle of the cycle for which it is held."""
    text = """\
title: Ramp
machine: ideal
parameters: {cycle: 10 ms}
analog: {x: {ramp: 2 1/s, full_scale: 10}}
interface:
  sample: {adc: x}
  shown: {dac: word, full_scale: 20, initial: 0, lead: 1.5*cycle}
digital: {period: cycle, program: {word: 3*sample}}
run: {until: 1 s, every: 10 ms}
record: [x, shown]
"""
    record = hybrid.run(parse_patch(text)).record
    # Row k shows the word of cycle k - 1, which knows cycle k - 2: exact from row 1 on, as the word
    # is 0 before the first cycle.
    k = np.arange(1, len(record["time"]))
    np.testing.assert_allclose(
        record["shown"][1:], np.where(k == 1, 0, 0.06 * (k + 0.5)), atol=1e-12
    )
    moved = parse_patch(text, on={"x": "digital"})
    assert moved.program.remember and not moved.adcs


def test_a_lead_shows_the_word_itself_in_the_first_cycle() -> None:
    """A steady 5 is 5 ahead too, though the DAC shows 0 before it; a program and tasks, in any word."""
    text = """\
title: Steady
machine: ideal
parameters: {cycle: 10 ms}
analog: {x: {integrate: {shown: 1 1/s}, initial: 0, full_scale: 10}}
interface: {shown: {dac: word, full_scale: 20, initial: 0, lead: 1.5*cycle}}
digital: DIGITAL
run: {until: 50 ms, every: 5 ms}
"""
    one = "{period: cycle, compute_time: 0, integration: ab3, word: WORD, program: {word: 2 + 3}}"
    tasks = "{word: WORD, tasks: {a: {period: cycle, compute_time: 0, program: {word: 2 + 3}}}}"
    for digital in (one, tasks):
        for word in ("float64", "float32", "{fixed: 16, full_scale: 8}"):
            changed = text.replace("DIGITAL", digital).replace("WORD", word)
            record = hybrid.run(parse_patch(changed)).record
            np.testing.assert_array_equal(record["shown"][1:], 5.0)
            modes = hybrid.predict(parse_patch(changed)).modes  # linear as before
            assert all(np.isfinite(mode.omega) for mode in modes)


def test_a_lead_goes_by_the_cycles_of_the_task_that_computes_the_word() -> None:
    """A ramp of 6 1/s through a slow and a fast task, each shown ahead by half its own cycle."""
    text = """\
title: Ramp
machine: ideal
analog: {x: {ramp: 2 1/s, full_scale: 10}}
interface:
  seen: {adc: x, task: fast}
  caught: {adc: x, task: slow}
  quickly: {dac: quick, full_scale: 20, initial: 0, lead: 5 ms}
  slowly: {dac: late, full_scale: 20, initial: 0, lead: 25 ms}
digital:
  tasks:
    fast: {period: 10 ms, compute_time: 0, program: {quick: 3*seen}}
    slow: {period: 50 ms, compute_time: 0, program: {late: 3*caught}}
run: {until: 1 s, every: 5 ms}
record: [quickly, slowly]
"""
    record = hybrid.run(parse_patch(text)).record
    n = np.arange(len(record["time"]))  # of 5 ms; rows where a cycle begins show either word
    for name, rows in (("quickly", 2), ("slowly", 10)):
        within = (n % rows != 0) & (n > rows)  # the first cycle knows none before it
        middle_s = 0.005 * rows * (n // rows + 0.5)
        np.testing.assert_allclose(record[name][within], 6 * middle_s[within], atol=1e-12)


# -- what cannot be ---------------------------------------------------------------------------------

TO_DIGITAL = {
    "z: {delay: {x: 1}, time: 1 s, full_scale: 1}": "(delay) cannot go to the digital machine: its",
    "z: {amplify: {x: 1, z: -1}, full_scale: 1}": "(amplify) cannot go to the digital machine: an open",
    "z: {backlash: x, width: 0.1, full_scale: 1}": "(backlash) cannot go",
    "z: {noise_source: 0.1, bandwidth: 1 rad/s, full_scale: 1}": "the program makes no noise",
    "z: {compare: {x: 1}, high: 1, hysteresis: 0.1, full_scale: 1}": "it has hysteresis",
    "z: {lag: {x: 1}, time_constant: 1 s, full_scale: 1}": "give it an initial value",
    "z: {integrate: {x: 1}, initial: 0, high: 1, full_scale: 1}": "it stops at high",
    "z: {function: x, points: {0: 0, half: 1}, full_scale: 1}": "its points depend on parameters",
    "z: {pulse: 1, at: 0 s, width: 1 s, period: 2 s, full_scale: 1}": "again and again",
    "z: {sum: {x: 1, w: 1}, full_scale: 1}\n  w: {coefficient: {z: 0.5}, full_scale: 1}": (
        "circular program: w -> z -> w"
    ),
}


@pytest.mark.parametrize("line", TO_DIGITAL)
def test_what_the_digital_machine_has_nothing_for(line: str) -> None:
    text = f"""\
title: T
parameters: {{half: 0.5}}
analog:
  x: {{integrate: {{x: -1}}, initial: 1, full_scale: 1}}
  {line}
digital: {{period: 1 ms}}
run: {{until: 1 s}}
"""
    names = ["z", "w"] if "w:" in line else ["z"]
    with pytest.raises(PatchError) as error:
        parse_patch(text, "t.yaml", dict.fromkeys(names, "digital"))
    assert TO_DIGITAL[line] in str(error.value) and str(error.value).startswith("t.yaml:")
    assert "\n" not in str(error.value)


TO_ANALOG = {
    "z: x*x*x": "'x*x*x' is more than one component",
    "z: sqrt(x + 1)": "is more than one component",
    "z: 2*abs(x)": "is more than one component",
    "z: x + x*x": "is more than one component",
    "z: exp(x)": "exp() has no analog component",
    "z: density_us76(x*metre)": "density_us76() has no analog component",
    "z: select(x > 0, x, 0)": "select() has no analog component",
    "z: x + previous(x)": "previous() is of the cycles of a program",
    "z: flat(x, x)": "the table flat has 2 inputs",
    "z: stops(x)": "with outside: clamp or extrapolate",
    "w: x/2": "word 'w' is read by or put on the analog machine, where it needs a full scale",
    "z: 2*metre": "full scale of word 'z' is in 1, and the word in m",
}


@pytest.mark.parametrize("line", TO_ANALOG)
def test_what_the_analog_machine_has_nothing_for(line: str) -> None:
    text = f"""\
title: T
parameters: {{metre: 1 meter}}
tables:
  flat: {{inputs: {{a: 1, b: 1}}, values: {{0: {{0: 0, 1: 1}}, 1: {{0: 0, 1: 1}}}}}}
  stops: {{inputs: {{a: 1}}, values: {{0: 0, 1: 1}}}}
digital:
  period: 1 ms
  states: {{x: {{integrate: -x, initial: 1}}}}
  program:
    {line}
  full_scales: {{x: 1, {line[0]}: 1}}
run: {{until: 1 s}}
""".replace("w: 1}", "x: 1}").replace("{x: 1, x: 1}", "{x: 1}")
    with pytest.raises(PatchError) as error:
        parse_patch(text, "t.yaml", "analog")
    assert TO_ANALOG[line] in str(error.value) and str(error.value).startswith("t.yaml:")


OTHERWISE = {
    "no digital machine": ("digital", "and the patch has none; add digital: {period: TIME}"),
    "bits": ({"rate": "digital"}, "converters have different bits; add one to interface"),
    "unknown": ({"rat": "digital"}, "no part, signal or word 'rat'; did you mean 'rate'"),
    "neither": ({"rate": "hybrid"}, "on 'rate' is 'hybrid'; valid: analog, digital"),
    "no mapping": (3, "on is 3; give a machine"),
    "converter": ({"sample": "digital"}, "no part, signal or word 'sample'"),
    "modes": ({"rate": "digital"}, "it has the analog machine's modes"),
    "reset": ({"x": "analog"}, "it has reset_when"),
    "rate": ({"x": "analog"}, "its rate 'sin(x)*unit2' is no sum"),
    "no such word": (
        {"word": "analog"},
        "full_scales: no word or state 'wod'; did you mean 'word'",
    ),
    "lead": (
        None,
        "DAC 'torque' has a lead, but a comparator starts the task of 'word': its cycles",
    ),
    "on": (None, "part 'p': on is 'both'; valid: analog, digital"),
}


@pytest.mark.parametrize("case", OTHERWISE)
def test_what_else_cannot_be(case: str) -> None:
    on, says = OTHERWISE[case]
    text = LOOP
    states = "integration: euler\n  states: {x: {integrate: RATE, initial: 1}}\n"
    changes = {
        "bits": ("bits: 12, full", "bits: 10, full"),
        "modes": ("readouts:", "modes: {reset: 1 ms, operate: 1 s}\nreadouts:"),
        "reset": (
            "integration: euler\n",
            states.replace("initial: 1", "initial: 1, reset_when: x > 1, reset_to: 0").replace(
                "RATE", "x*unit2"
            ),
        ),
        "rate": ("integration: euler\n", states.replace("RATE", "sin(x)*unit2")),
        "no such word": ("integration: euler\n", "full_scales: {wod: 1}\n"),
        "on": ("interface:", "parts: {p: {file: parts/euler.yaml, on: both}}\ninterface:"),
    }
    text = text.replace("{cycle: 10 ms}", "{cycle: 10 ms, unit2: 1 1/s}")
    if case in changes:
        text = text.replace(*changes[case])
    if case == "lead":
        head, _, _ = text.partition("digital:")
        task = "{when: high rises, compute_time: 0, program: {word: -100*sample*unit2}}"
        text = f"{head}digital: {{tasks: {{one: {task}}}}}\nrun: {{until: 1 s}}\n"
        text = text.replace("rad/s^2", "rad/s")
        text = text.replace("{torque: 1}", "{torque: unit2}")
        text = text.replace("bits: 12, full", "lead: 1 ms, bits: 12, full")
        high = "high: {compare: {angle: 1}, high: 1, hysteresis: 0.1, full_scale: 1}"
        text = text.replace("analog:\n", f"analog:\n  {high}\n")
        text = text.replace("until: 1 s", "until: 1 s, every: 0.1 s")
    if case == "no digital machine":
        text = """\
title: T
analog: {x: {integrate: {x: -1}, initial: 1, full_scale: 1}}
run: {until: 1 s, every: 0.1 s}
"""
    with pytest.raises(PatchError) as error:
        parse_patch(text, "t.yaml", on)  # type: ignore[arg-type]
    assert says in str(error.value) and "\n" not in str(error.value)


# -- the command line -------------------------------------------------------------------------------


def test_the_command_line_tells_and_says_what_it_was_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop.yaml").write_text(LOOP)
    assert main(["run", "loop.yaml", "--on", "rate=digital", "--json", "--no-chart"]) == 0
    assert json.loads(capsys.readouterr().out)["on"] == {"rate": "digital"}
    assert main(["check", "loop.yaml", "--on", "digital", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["on"] == {"all": "digital"} and found["parts"] == []
    sweep = ["--over", "cycle=1 ms:2 ms:2", "--jobs", "1", "--json", "--no-chart", "--out", "a.nc"]
    assert main(["sweep", "loop.yaml", "--on", "rate=digital", *sweep]) == 0
    assert json.loads(capsys.readouterr().out)["on"] == {"rate": "digital"}
    assert main(["run", "loop.yaml", "--no-chart"]) == 0
    assert "on digital" not in capsys.readouterr().out
    assert main(["run", "loop.yaml", "--on", "digital", "--on", "rate=analog", "--no-chart"]) == 0
    assert "machine nominal, all on digital, rate on analog" in capsys.readouterr().out
    assert main(["draw", "loop.yaml", "--on", "digital"]) == 0
    assert "all on digital" in Path("loop_on_digital.svg").read_text()
    files = {path.name for path in Path("out").iterdir()}
    assert files == {"loop.nc", "loop_on_rate_digital.nc", "loop_on_digital_rate_analog.nc"}
    for given, says in (
        ("both", "--on 'both' must be analog or digital, or PART=analog or PART=digital"),
        ("=digital", "--on '=digital' must be"),
        ("rat=digital", "loop.yaml: no part, signal or word 'rat'"),
    ):
        assert main(["run", "loop.yaml", "--on", given]) == 2
        assert says in capsys.readouterr().err
    assert main(["check", "loop.yaml", "--on", "digital", "--on", "analog"]) == 2
    assert "the whole patch is told twice" in capsys.readouterr().err


def test_an_angle_jumps_at_half_a_turn_and_is_right_again() -> None:
    """A direction that turns at 1 rad/s; rows lie 0.04 rad and more from the jumps."""
    text = """\
title: Round
machine: lags
analog:
  x: {integrate: {y: -1}, initial: 1, full_scale: 1.1}
  y: {integrate: {x: 1}, initial: 0, full_scale: 1.1}
  a: {atan2: [y, x], full_scale: 3.3}
run: {until: 10 s, every: 0.1 s}
"""
    record = hybrid.run(parse_patch(text)).record
    time = record["time"].values
    # Late by the lag of the angle and that of an integrator, 1 us each; lags change the turn's frequency
    # by their square, and make it grow, which is no matter.
    apart = (record["a"].values - time + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(apart).max() < 4e-6 and np.abs(record["a"].values).max() < np.pi
