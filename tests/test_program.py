"""The digital program as it is played: functions, conditions, choice, delays.

Expected figures come from Python's own arithmetic, cycle by cycle, and from theory; a patch here has
no analog side, so that a row of the record is what one cycle computed.
"""

import math

import numpy as np
import pytest

from hybrid.coupling import exact_modes
from hybrid.errors import PatchError
from hybrid.expressions import FUNCTIONS, evaluate
from hybrid.helpers import HELPERS
from hybrid.linearity import NotLinear, linear_program
from hybrid.parsing import parse
from hybrid.patchfile import parse_patch

CYCLES = 40

PROGRAM = """
title: a program alone
parameters: {gain: 2, delay: 3 ms, cycle: 1 ms}
digital:
  period: cycle
  compute_time: 0 s
  remember: {k: -1, DELAYED}
  program: {k: previous(k) + 1, WORDS}
run: {until: 40 ms}
"""


def program(remember="", **words):
    listed = ", ".join(f"{name}: '{text}'" for name, text in words.items())
    return PROGRAM.replace(", DELAYED", remember and ", " + remember).replace("WORDS", listed)


def column(played, name):
    return played[name][:CYCLES]


K = np.arange(CYCLES)


# Arguments that sweep through each function's range, as arithmetic on the cycle number k.
SWEEP = {
    "acosh": ("1 + k/7",),
    "atanh": ("k/20 - 0.975",),
    "asin": ("k/20 - 0.975",),
    "acos": ("k/20 - 0.975",),
    "sqrt": ("k/3",),
    "log": ("k + 0.3",),
    "log10": ("k + 0.3",),
    "limit": ("k - 20", "-3.5", "k/5"),
    "dead_zone": ("k - 20", "-3.5", "k/5"),
    "select": ("k > 11", "-k", "k*k"),
    "mod": ("7.25 - k", "3.5 - k"),
    "round": ("k/4 - 5",),
    "floor": ("k/4 - 5",),
    "ceil": ("k/4 - 5",),
}


@pytest.mark.parametrize("name", sorted(FUNCTIONS.keys() - HELPERS.keys()))
def test_the_kernel_computes_functions_as_python_does(name, play):
    arguments = SWEEP.get(name, ("k/7 - 3", "2 - k/3")[: FUNCTIONS[name].fewest])
    text = f"{name}({', '.join(arguments)})"
    found = column(play(program(value=text)), "value")
    expected = [evaluate(parse(text), {"k": float(k)}) for k in K]
    # Two libraries' elementary functions, each good to an ulp or two.
    np.testing.assert_allclose(found, expected, rtol=1e-15, atol=0)
    assert len(set(expected)) > 2


CONDITIONS = [
    *(f"k {op} 17" for op in ("<", "<=", ">", ">=", "==", "!=")),
    "k > 5 and k < 20",
    "k < 5 or k > 20",
    "not k",
    "not (k > 5 and not k < 20) or k == 11",
    "5 < k <= 20",
    "k and k - 7",
    "(k > 3) + (k > 6)*10",
    "select(k > 9, select(k > 19, 3, 2), 1)*k",
]


@pytest.mark.parametrize("text", CONDITIONS)
def test_conditions_and_choices(text, play):
    found = column(play(program(value=text)), "value")
    assert found.tolist() == [evaluate(parse(text), {"k": float(k)}) for k in K]
    assert len(set(found.tolist())) > 1


def test_what_is_not_selected_does_no_harm(play):
    found = column(play(program(value="select(k > 0, 1/k, -1)")), "value")
    assert found.tolist() == [-1.0] + [1 / k for k in K[1:]]
    # A choice between parameters is made before the run, so that the other need have no value.
    found = column(play(program(value="select(gain > 1, gain*k, 1/(gain - 2))")), "value")
    assert found.tolist() == (2.0 * K).tolist()


@pytest.mark.parametrize(
    "text",
    [
        "sqrt(5 - k) > 1",
        "not sqrt(5 - k)",
        "select(sqrt(5 - k), 1, 2)",
        "limit(1, k, 5)",
        "mod(1, 5 - k)",
    ],
)
def test_no_number_stays_no_number_through_conditions(text, play):
    played = play(program(value=text))
    # From the first cycle on in which it has no value the run is stopped.
    assert not np.isfinite(played.player.state.words).all()
    assert played.player.done_s == pytest.approx(6e-3 if "mod" not in text else 5e-3, abs=1e-9)


@pytest.mark.parametrize("cycles", [1, 2, 3, 7, 39, 1000])
def test_a_delay_of_n_cycles(cycles, play):
    text = program("square: 0.5", square="k*k", late=f"previous(square, {cycles})")
    expected = [float((k - cycles) ** 2) if k >= cycles else 0.5 for k in K]
    assert column(play(text), "late").tolist() == expected


def test_delays_of_one_word_by_several_counts(play):
    text = program(
        a="previous(k, 5) - previous(k, 2) + previous(k)",
        b="previous(k, delay/cycle)",
        c="previous(k, gain + 2) + previous(k, 5)",
    )
    played = play(text)
    ago = {n: np.maximum(K - n, -1.0) for n in (1, 2, 3, 4, 5)}
    assert column(played, "a").tolist() == (ago[5] - ago[2] + ago[1]).tolist()
    assert column(played, "b").tolist() == ago[3].tolist()
    assert column(played, "c").tolist() == (ago[4] + ago[5]).tolist()


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "previous(k, 1.5)",
            "asks for 1.5 cycles ago; that must be a whole number from 1 to 1000000",
        ),
        ("previous(k, 0)", "asks for 0 cycles ago"),
        ("previous(k, -2)", "asks for -2 cycles ago"),
        ("previous(k, 1e9)", "asks for 1000000000 cycles ago"),
        ("previous(k, delay/(2*cycle))", "asks for 1.5 cycles ago"),
        (
            "previous(k, k)",
            "cannot depend on 'k'; give a whole number, or arithmetic over parameters",
        ),
        ("previous(k, delay)", "'delay' [s] must be a pure number"),
        ("previous(k, gone)", "unknown 'gone'"),
        ("previous(k, 1/(gain - 2))", "'1/(gain - 2)' has no finite value"),
        ("previous(later, 2)", "give its first value in digital: remember: {later: 0}"),
        ("limit(k, 2, 1/gain)*limit(1, 2, 1)", "limit(..., 2, 0.5) has no value; it needs a low"),
        ("select(cycle, k, 1)", "'cycle' [s] must be a pure number"),
    ],
)
def test_mistakes_are_told_with_their_place(text, reason, compiled):
    written = program(value=text, later="k")
    with pytest.raises(PatchError) as caught:
        compiled(written)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.place.line == 8


# -- delays and choices in the prediction


@pytest.mark.parametrize("cycles", [1, 2, 5])
def test_modes_of_a_delay_line(cycles, compiled):
    """y(k) = a y(k - n): z^n = a, so ln z = (ln a + 2 pi i m)/n."""
    text = program("y: 1", y=f"0.5*previous(y, {cycles})").replace("k: previous(k) + 1, ", "")
    found = exact_modes(compiled(text.replace("k: -1, ", "")))
    expected = [
        (math.log(0.5) + 2j * math.pi * m) / cycles / 1e-3
        for m in range(-((cycles - 1) // 2), cycles // 2 + 1)
    ]
    assert len(found) == cycles
    order = np.lexsort((np.real(expected), np.round(np.imag(expected), 3)))
    # The root is simple: rounding of 1e-16 moves it by 1e-16 over n a^((n-1)/n).
    np.testing.assert_allclose(
        found[np.lexsort((found.real, np.round(found.imag, 3)))],
        np.array(expected)[order],
        rtol=1e-13,
    )


@pytest.mark.parametrize("cycles", [1, 3])
def test_a_delay_acts_as_a_longer_compute_time(cycles, shipped, compiled):
    plain = shipped("pitch_loop")
    late = plain.replace("moment: -", f"moment: previous(now, {cycles})\n    now: -")
    late = late.replace("  program:", "  remember: {now: 0 N*m}\n  program:")
    delayed = exact_modes(compiled(late, machine_parameters(1)))
    computed = exact_modes(compiled(plain, machine_parameters(1 + cycles)))
    slow = [min(modes[modes.imag > 0], key=abs) for modes in (delayed, computed)]
    assert abs(slow[0] - slow[1]) < 1e-12 * abs(slow[1])


def machine_parameters(cycles):
    return {"cycle": 1e-3, "compute_time": cycles * 1e-3}


def test_a_choice_made_by_parameters_is_linear(compiled):
    text = program("y: 0", rule="gain > 1", y="select(rule, 0.5*previous(y), k)")
    tape = compiled(text).tape
    chosen = linear_program(tape, 0).rows[tape.words.index("y")]
    # The delays come in the order in which the program reads them: k, then y.
    assert chosen.tolist() == [0.0, 0.5, 0.0]
    with pytest.raises(NotLinear, match="word 'rule' is not linear"):
        linear_program(compiled(text.replace("gain > 1", "k > 1")).tape, 0)


def test_a_long_delay_is_played_but_not_predicted(compiled, play):
    text = program(late="previous(k, 30000)")
    assert column(play(text), "late").tolist() == [-1.0] * CYCLES
    with pytest.raises(
        NotLinear, match="remembers 30001 values; an exact prediction takes at most"
    ):
        exact_modes(compiled(text))


def test_units_of_conditions_are_checked():
    with pytest.raises(
        PatchError, match=r"'cycle' \[s\] and 'gain' \[1\] must have the same units"
    ):
        parse_patch(program(value="select(cycle < gain, k, 1)"))
