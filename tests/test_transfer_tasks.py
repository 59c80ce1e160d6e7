"""One description on either machine where the digital one has tasks: which of them computes what."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import hybrid
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch, read_patch


def test_two_rate_groups_all_digital_are_the_multirate_program_by_hand() -> None:
    """The body goes into the task that is first on the processor; Adams-Bashforth 2 of 2 ms.

    The rate loop has the processor for 0.5 ms of every 2 ms, so the attitude loop's 5 ms end 7 ms after
    it is due: the fifth cycle of the rate loop, at 8 ms, is the first to read the new demand.
    """
    patch = read_patch("rate_groups", on="digital")
    tasks = {task.name: task for task in patch.program.tasks}
    assert tasks["rate_loop"].states == ("theta", "theta_dot") and not patch.components
    record = hybrid.run(patch, machine="ideal").record
    k_rate, k_angle, step = 10 * math.sqrt(2), 10 / math.sqrt(2), 0.002
    state, last, demand, due = np.array([0.1, 0.0]), None, 0.0, 0.0
    shown = [state[0]]
    for k in range(1001):
        if k % 10 == 9:
            shown.append(state[0])
        if k % 10 == 0:
            due = -k_angle * state[0]
        if k % 10 == 4:
            demand = due

        def rate(s: np.ndarray, to: float = demand) -> np.ndarray:
            return np.array([s[1], -k_rate * (s[1] - to)])

        now = rate(state)
        # All Runge-Kutta formulas of two stages and second order agree where rates are linear.
        slope = rate(state + step / 2 * now) if last is None else 1.5 * now - 0.5 * last
        state, last = state + step * slope, now
    # The row at 20 j ms comes before the result of the cycle that begins there: it shows that before.
    np.testing.assert_allclose(record["theta"], shown, rtol=0, atol=1e-14)
    assert hybrid.run(patch, machine="ideal").readouts["pitch_mode"]["zeta"] == pytest.approx(
        hybrid.predict(patch).modes[0].zeta, rel=1e-9
    )


def test_two_rate_groups_all_analog_are_the_equation_itself() -> None:
    """s^2 + k_rate s + k_rate k_angle: 10 rad/s, damped by 1/sqrt(2); no task is left."""
    patch = read_patch("rate_groups", on="analog")
    assert patch.program is None
    run = hybrid.run(patch, machine="ideal")
    assert len(run.record["time"]) == 101  # rows as they were
    mode = run.readouts["pitch_mode"]
    assert mode["omega"] == pytest.approx(10, rel=1e-9)
    assert mode["zeta"] == pytest.approx(math.sqrt(0.5), rel=1e-9)


PARTS = """\
title: A part in a task that it names
machine: ideal
definitions:
  body:
    inputs: {push: {constant: 1, full_scale: 2}}
    analog: {x: {integrate: {push: 1 1/s}, initial: 0, full_scale: 10}}
parts:
  a: {use: body, inputs: {push: one}, on: digital, task: slow}
  b: {use: body, inputs: {push: one}, on: digital}
analog: {one: {constant: 0.1, full_scale: 1}}
digital:
  integration: rk2
  tasks:
    fast: {period: 1 ms, compute_time: 0, integration: euler}
    slow: {period: 4 ms, compute_time: 0, word: float32}
run: {until: 1 s, every: 4 ms}
"""


def test_a_part_goes_into_the_task_that_it_names_with_its_formula_and_word_length() -> None:
    program = parse_patch(PARTS).program
    assert {t.name: t.states for t in program.tasks} == {"fast": ("b.x",), "slow": ("a.x",)}
    assert {s.word: s.formula for s in program.states} == {"a.x": "rk2", "b.x": "euler"}
    assert {word: length.bits for word, length in program.lengths.items()} == {"a.x": 24}
    record = hybrid.run(parse_patch(PARTS)).record
    time = record["time"].values
    np.testing.assert_allclose(record["b.x"], 0.1 * time, atol=1e-12)
    # 250 additions to at most 0.1, each rounded to 2^-24 of 1/8 at most.
    np.testing.assert_allclose(record["a.x"], 0.1 * time, atol=250 * 2**-27)
    assert np.all(np.float32(record["a.x"]) == record["a.x"])
    with pytest.raises(PatchError, match="task 'fast' has no program; add program"):
        parse_patch(PARTS.replace(", on: digital", ""))


def test_a_task_on_which_nothing_is_put_is_no_more() -> None:
    program = parse_patch(PARTS.replace("on: digital, task: slow", "on: analog")).program
    assert [task.name for task in program.tasks] == ["fast"]
    assert parse_patch(PARTS, on="analog").program is None


SOURCES = """\
title: Sources in a task that begins late
machine: ideal
analog:
  jump: {step: 1, at: 53 ms, full_scale: 1}
  rise: {ramp: 2 1/s, full_scale: 10}
digital:
  tasks: {only: {period: 10 ms, phase: 3 ms, compute_time: 0}}
run: {until: 1 s, every: 1 ms}
"""


def test_sources_keep_the_time_of_their_task() -> None:
    """Cycles begin at 3 ms + k 10 ms; a word stands until the next one."""
    record = hybrid.run(parse_patch(SOURCES, on="digital")).record
    n = np.arange(len(record["time"]))  # ms
    begun = n - (n - 3) % 10
    np.testing.assert_allclose(record["rise"][3:], 0.002 * begun[3:], rtol=1e-12)
    np.testing.assert_array_equal(record["jump"][3:], begun[3:] >= 53)
    np.testing.assert_allclose(record["only_seconds"][3:], 0.001 * begun[3:], rtol=1e-12)


def test_seconds_and_states_know_nothing_of_cycles_that_are_left_out() -> None:
    """12 ms of work every 10 ms: every other cycle is left out, at 3 ms + j 20 ms it is cycle j."""
    text = SOURCES.replace("compute_time: 0", "compute_time: 12 ms, overrun: skip").replace(
        "full_scale: 10}\n",
        "full_scale: 10}\n  area: {integrate: {one: 1 1/s}, initial: 0, full_scale: 10}\n"
        "  one: {constant: 1, full_scale: 1}\n",
    )
    result = hybrid.run(parse_patch(text, on="digital"))
    (only,), record = result.tasks, result.record
    assert only.overruns == only.cycles == 50
    n = np.arange(len(record["time"]))  # ms
    shown = n >= 15  # the first result
    cycle = (n[shown] - 15) // 20
    np.testing.assert_allclose(record["only_seconds"][shown], 0.003 + 0.01 * cycle, rtol=1e-12)
    np.testing.assert_allclose(record["rise"][shown], 2 * (0.003 + 0.01 * cycle), rtol=1e-12)
    np.testing.assert_allclose(record["area"][shown], 0.01 * cycle, rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(record["jump"][shown], cycle >= 5)  # 53 ms is the fifth's time


FIRST = """\
title: What stands before the first result
machine: ideal
analog: {x: {integrate: {u: 1 1/s}, initial: 0, full_scale: 10}}
interface: {u: {dac: w, full_scale: 10, initial: 5}}
digital:
  integration: euler
  tasks:
    fast: {period: 1 ms, compute_time: 0}
    slow: {period: 20 ms, compute_time: 10 ms, program: {w: 1 + 0}}
run: {until: 20 ms, every: 1 ms}
"""


def test_before_the_first_result_another_task_reads_what_the_dac_showed() -> None:
    record = hybrid.run(parse_patch(FIRST, on="digital")).record
    n = np.arange(21)
    np.testing.assert_allclose(
        record["x"], 0.001 * np.where(n <= 10, 5 * n, 50 + (n - 10)), atol=1e-15
    )


CALLED = """\
title: A task that a comparator starts
machine: ideal
analog:
  x: {ramp: 1 1/s, full_scale: 2}
  beyond: {compare: {x: 1}, threshold: 0.503, high: 1, full_scale: 1}
interface: {seen: {adc: x}, again: {adc: x, task: idle}}
digital:
  tasks:
    catch: {when: beyond rises, compute_time: 0, program: {kept: seen}}
    clock: {period: 10 ms, compute_time: 0, program: {twice: 2*again}}
    idle: {period: 20 ms, compute_time: 0, program: {never: 0*again}}
  full_scales: {twice: 4, never: 1}
run: {until: 1 s, every: 10 ms}
"""


def test_an_interrupt_stays_analog_and_sees_what_the_dac_shows() -> None:
    """All digital, the ramp jumps past 0.503 at 0.51 s; analog, it is caught at 0.503 itself."""
    patch = parse_patch(CALLED, on="digital")
    assert [c.name for c in patch.components] == ["beyond"] and not patch.adcs
    assert [dac.name for dac in patch.dacs] == ["x_held"]
    for on, kept in ((None, 0.503), ({"x": "digital"}, 0.51), ("digital", 0.51)):
        record = hybrid.run(parse_patch(CALLED, on=on)).record
        np.testing.assert_allclose(record["kept"][-1], kept, atol=1e-12)


def test_a_task_that_a_comparator_starts_stays_digital() -> None:
    patch = parse_patch(CALLED, on="analog")
    assert [task.name for task in patch.program.tasks] == ["catch"]
    assert [adc.name for adc in patch.adcs] == ["seen"]
    patch = parse_patch(CALLED, on={"never": "analog"})
    assert {adc.name: adc.task for adc in patch.adcs}["again"] is None


PART_IN_CATCH = CALLED.replace(
    "interface:",
    "parts: {p: {use: q, on: digital, task: catch}}\n"
    "definitions: {q: {analog: {y: WHAT}}}\ninterface:",
)
REFUSED = {
    "comparator": (CALLED, {"beyond": "digital"}, ":5: 'beyond' cannot go", "starts task 'catch'"),
    "called": (CALLED, {"kept": "analog"}, ":9: word 'kept' cannot go", "when 'beyond' rises;"),
    "state": (
        PART_IN_CATCH.replace("WHAT", "{integrate: {y: -1 1/s}, initial: 1, full_scale: 1}"),
        None,
        "component 'p.y' (integrate) cannot go to task 'catch'",
        "give its part another task",
    ),
    "source": (
        PART_IN_CATCH.replace("WHAT", "{sine: 1, omega: 1 rad/s, full_scale: 1}"),
        None,
        "component 'p.y' (sine) cannot go to task 'catch'",
        "it needs a period",
    ),
    "no clock": (
        CALLED.replace("    clock: {period: 10 ms", "    other: {when: beyond falls").replace(
            "    idle: {period: 20 ms", "    idle: {when: beyond changes"
        ),
        {"x": "digital"},
        ":4: 'x' is put on the digital machine, where comparators start all tasks",
        "add a task with a period",
    ),
    "word of no task": (
        CALLED.replace("parts:", "").replace(
            "interface:",
            "parts: {p: {use: q, on: analog}}\n"
            "definitions: {q: {digital: {program: {y: 2*pi}}}}\ninterface:",
        ),
        None,
        "the word 'p.y' of a part belongs to no task",
        "give the part its task",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_no_meaning_elsewhere(case: str) -> None:
    text, on, *says = REFUSED[case]
    with pytest.raises(PatchError) as error:
        parse_patch(text, "t.yaml", on)
    assert str(error.value).startswith("t.yaml:") and "\n" not in str(error.value)
    assert all(part in str(error.value) for part in says), str(error.value)


def test_the_diagram_and_the_check_know_the_tasks(tmp_path: Path) -> None:
    found = hybrid.check(read_patch("rate_groups", on="digital")).to_dict()
    assert {row["task"] for row in found["tasks"]} == {"rate_loop", "attitude_loop"}
    assert found["on"] == {"all": "digital"} and found["converters"] == []
