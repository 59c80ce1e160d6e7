"""Tasks beside states, sub-patches and word lengths: what each program has, and what is refused."""

import re

import numpy as np
import pytest

from hybrid.compiler import compile_patch
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch, read_patch
from hybrid.runs import run
from hybrid.tasks import program_operations

TASKS = """\
title: Two tasks
machine: ideal
digital:
  remember: {chaos: 0.3, sum: 0}
  words: {third: float32, sum: {fixed: 8, overflow: OVERFLOW}}
  tasks:
    fast: {period: 1 ms, compute_time: 0 s, program: {chaos: 3.7*previous(chaos)*(1 - previous(chaos))}}
    slow: {period: 2 ms, compute_time: 0 s, program: {third: chaos/3, sum: previous(sum) + 1/4}}
run: {until: 20 ms}
"""


def test_each_word_of_any_task_has_its_length():
    result = run(parse_patch(TASKS.replace("OVERFLOW", "saturate")))
    chaos = [0.3]
    for _ in range(21):
        chaos.append(3.7 * chaos[-1] * (1.0 - chaos[-1]))
    record = result.record
    assert record["chaos"].values.tolist() == chaos[1:]
    # At every second cycle of the fast task the slow one reads what that has just published.
    read = np.repeat(chaos[1::2], 2)[:21]
    assert record["third"].values.tolist() == np.float32(read / 3.0).tolist()
    cycles = 1 + np.arange(21) // 2
    assert record["sum"].values.tolist() == np.minimum(cycles / 4, 127 / 128).tolist()
    assert [overload["signal"] for overload in result.overloads] == ["sum"]


def test_a_word_that_overflows_stops_the_run_in_the_cycle_of_its_task():
    result = run(parse_patch(TASKS.replace("OVERFLOW", "stop")))
    # 1 is the fourth sum, in the cycle at 6 ms.
    assert result.status == "stopped" and "stopped at 0.006 s: sum does not" in result.status_note


COUNTED = """\
title: Counted
machine: ideal
digital:
  period: 10 ms
  compute_time: counted
  processor: cdc_6600
  states: {x: {integrate: rate, initial: 0, formula: FORMULA}}
  program: {rate: previous(rate)}
  remember: {rate: 1}
run: {until: 1 s}
"""


@pytest.mark.parametrize(
    ("formula", "products"), [("euler", 1), ("ab2", 2), ("ab3", 3), ("ab4", 4)]
)
def test_the_step_of_later_cycles_is_counted(formula, products):
    # One product for each rate of the formula; the step of the first cycles is a Runge-Kutta one.
    tape = compile_patch(parse_patch(COUNTED.replace("FORMULA", formula))).tape
    assert program_operations(tape, 0)["multiply"] == products


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        (
            "  words:",
            "  states: {x: {integrate: chaos, initial: 0}}\n  words:",
            5,
            "tasks and states",
        ),
        ("  words:", "  integration: rk4\n  words:", 5, "tasks and integration"),
        (
            "program: {third",
            "states: {x: {integrate: 1, initial: 0}}, program: {third",
            8,
            "states",
        ),
        ("program: {third", "word: float32, program: {third", 8, "give word and words in digital"),
        ("words: {third", "words: {thrid", 5, "did you mean 'third'"),
        ("run:", "parts: {p: {file: brought.yaml}}\nrun:", 3, "belongs to no task"),
        ("run:", "parts: {p: {file: tasks.yaml}}\nrun:", 5, "a sub-patch cannot have tasks"),
    ],
)
def test_what_is_refused(old, new, line, says, tmp_path):
    text = TASKS.replace("OVERFLOW", "wrap")
    (tmp_path / "tasks.yaml").write_text(text.replace("  remember: {chaos: 0.3, sum: 0}\n", ""))
    (tmp_path / "brought.yaml").write_text("title: Word\ndigital:\n  program: {one: 1}\n")
    (tmp_path / "patch.yaml").write_text(text.replace(old, new))
    with pytest.raises(PatchError) as raised:
        read_patch(tmp_path / "patch.yaml")
    told = str(raised.value)
    assert re.search(rf"\.yaml:{line}[: ]", told) and says in told
    assert "\n" not in told
