"""Tasks beside states, sub-patches and word lengths: what each program has, and what is refused."""

import re

import numpy as np
import pytest

from hybrid.compiler import compile_patch
from hybrid.counting import program_operations
from hybrid.cycle_map import cycle_maps
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch, read_patch
from hybrid.prediction import predict
from hybrid.runs import run
from hybrid.together import only

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


DECAY = (
    COUNTED.replace("{integrate: rate,", "{integrate: -x/tau,")
    .replace(
        "  program: {rate: previous(rate)}\n  remember: {rate: 1}\n", "  program: {double: x + x}\n"
    )
    .replace("digital:", "parameters: {tau: 1 s}\ndigital:")
)


@pytest.mark.parametrize(
    ("formula", "add", "multiply", "divide", "store"),
    [
        # A rate is a change of sign and a division. The step is a product for each rate, their sum, and
        # the sum with the state; words and states are stored, and so is each rate that is kept.
        ("euler", 2, 1, 1, 1),
        ("ab2", 3, 2, 1, 2),
        ("ab3", 4, 3, 1, 3),
        ("ab4", 5, 4, 1, 4),
        # Rates 1 + s, and s - 1 stages of a product and a sum at least.
        ("rk2", 5, 3, 2, 1),
        ("rk4", 11, 7, 4, 1),
    ],
)
def test_the_operations_are_those_counted_by_hand(formula, add, multiply, divide, store):
    tape = compile_patch(parse_patch(DECAY.replace("FORMULA", formula))).tape
    expected = {"add": add + 1, "multiply": multiply, "divide": divide, "store": store + 1}
    assert program_operations(tape, 0) == {**expected, "square_root": 0}  # 1 and 1 for the word


def test_formulas_that_start_one_after_the_other_are_counted_as_later_on():
    """Of ab2, ab4 and rk2 side by side: each its own step, and no word of how they start."""
    own = [(3, 2, 1, 2), (5, 4, 1, 4), (5, 3, 2, 1)]
    add, multiply, divide, store = map(sum, zip(*own, strict=True))
    states = ", ".join(
        f"{x}: {{integrate: -{x}/tau, initial: 0, formula: {formula}}}"
        for x, formula in (("x", "ab2"), ("y", "ab4"), ("z", "rk2"))
    )
    text = DECAY.replace("{x: {integrate: -x/tau, initial: 0, formula: FORMULA}}", f"{{{states}}}")
    found = program_operations(compile_patch(parse_patch(text)).tape, 0)
    print(found, add, multiply, divide, store)
    assert found["divide"] == divide and found["store"] == store + 1


# --- integration in tasks --------------------------------------------------------------------------

ONE = """\
title: A pendulum, all digital
machine: ideal
digital:
  CLOCK
    states:
      angle: {integrate: rate, initial: 0.5}
      rate: {integrate: pull, initial: 0, reset_when: rate < -1, reset_to: next(angle) - 1}
    program: {pull: -sin(angle), ahead: next(angle)}
    integration: FORMULA
run: {until: 3 s, every: 10 ms}
"""


@pytest.mark.parametrize("formula", ["euler", "ab3", "rk2", "rk4"])
def test_the_states_of_one_task_are_those_of_the_one_program(formula):
    text = ONE.replace("FORMULA", formula)
    # The keys of a task stand one level deeper than those of the machine.
    alone = text.replace("  CLOCK\n", "  period: 10 ms\n  compute_time: 2 ms\n").replace(
        "\n    ", "\n  "
    )
    task = text.replace(
        "  CLOCK\n", "  tasks:\n   only:\n    period: 10 ms\n    compute_time: 2 ms\n"
    )
    one, other = (run(parse_patch(text)).record for text in (alone, task))
    for name in ("angle", "rate", "pull", "ahead"):
        np.testing.assert_array_equal(one[name], other[name])
    assert float(one["rate"].min()) < -0.4


DECAYS = """\
title: Two decays, each by its own formula and step
machine: ideal
digital:
  integration: euler
  tasks:
    fast: {period: 10 ms, compute_time: 0 s, states: {x: {integrate: -a*x, initial: 1}}}
    slow:
      period: 40 ms
      compute_time: 0 s
      integration: rk4
      states: {y: {integrate: -a*y, initial: 1}, z: {integrate: 3 - y, initial: 0, formula: ab2}}
parameters: {a: 5}
run: {until: 2 s, every: 40 ms}
"""


def test_each_task_integrates_over_its_own_period():
    record, k = run(parse_patch(DECAYS)).record, np.arange(51)
    # Growth of x' = -a x in a step: 1 + w for Euler, the first five terms of exp(w) for RK4.
    np.testing.assert_allclose(record["x"], (1 - 5 * 0.01) ** (4 * k), rtol=1e-13)
    w = -5 * 0.04
    growth = 1 + w + w**2 / 2 + w**3 / 6 + w**4 / 24
    np.testing.assert_allclose(record["y"], growth**k, rtol=1e-13)
    # AB2 of the rates of y, its first step by RK2 (Heun's or the midpoint: here the rate at the end or
    # in the middle is of the other state on its parabola).
    y, z = growth**k, record["z"].values
    np.testing.assert_allclose(
        np.diff(z)[1:], 0.04 * (3 - 1.5 * y[1:-1] + 0.5 * y[:-2]), rtol=1e-12
    )


def test_modes_of_decays_in_two_tasks():
    found = sorted(mode.omega for mode in predict(parse_patch(DECAYS)).modes if mode.omega)
    w = -5 * 0.04
    rk4 = -np.log(1 + w + w**2 / 2 + w**3 / 6 + w**4 / 24) / 0.04
    expected = sorted([-np.log(1 - 5 * 0.01) / 0.01, rk4])
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    ideal = sorted(mode.omega_ideal for mode in predict(parse_patch(DECAYS)).modes)
    np.testing.assert_allclose(ideal, [0, 5, 5], atol=1e-12)


COUPLED = """\
title: An oscillator between two tasks
machine: ideal
digital:
  integration: euler
  tasks:
    fast: {period: 10 ms, compute_time: 0 s, states: {x: {integrate: y, initial: 1}}}
    slow: {period: 40 ms, compute_time: 0 s, states: {y: {integrate: -9*x, initial: 0}}}
run: {until: 4 s, every: 40 ms}
"""


def test_states_of_two_tasks_that_read_each_other():
    # At every fourth step fast goes first: it reads the y of the slow cycle before, then three times the
    # new one; slow reads what fast has just published. Over 40 ms, of x, y and the y that fast last saw:
    h = 0.01
    step = np.array([[1, 3 * h, h], [-9 * 4 * h, 1, 0], [0, 1, 0]])
    patch = parse_patch(COUPLED)
    rows, v = run(patch).record["x"].values, np.array([1.0, 0.0, 0.0])
    for row in rows:
        assert row == pytest.approx(v[0], abs=1e-12)
        v = step @ v
    change, ticks = only(cycle_maps([compile_patch(patch)]))
    assert ticks == 40 * 10**12
    found = np.linalg.eigvals(change + np.eye(len(change)))
    for z in np.linalg.eigvals(step):
        assert np.min(np.abs(found - z)) < 1e-12
    (mode,) = (mode for mode in predict(patch).modes if mode.omega_ideal > 0)
    assert mode.omega_ideal == pytest.approx(3, rel=1e-12) and mode.zeta_ideal == pytest.approx(0)


UPDATED = """\
title: Two integrations of one circle
machine: ideal
digital:
  remember: {k: -1}
  tasks:
    fast:
      period: 1 ms
      compute_time: 0 s
      integration: ab2
      word: float32
      words: {k: float64}
      program: {k: "mod(previous(k) + 1, 8)"}
      states:
        x: {integrate: -y, initial: 1, reset_when: k == 7, reset_to: X}
        y: {integrate: x, initial: 0, reset_when: k == 7, reset_to: Y}
    slow:
      period: 8 ms
      compute_time: 4 ms
      integration: rk4
      states: {xs: {integrate: -ys, initial: 1}, ys: {integrate: xs, initial: 0}}
      program: {X: next(xs), Y: next(ys)}
run: {until: 400 ms, every: 1 ms}
"""


def test_the_fast_integration_is_updated_at_each_slow_cycle():
    record, single = run(parse_patch(UPDATED)).record, np.float32
    x, y = record["x"].values, record["y"].values
    assert x.tolist() == single(x).tolist()
    t = np.arange(401) * 1e-3
    # At every eighth row it is what the slow one has come to, rounded once: RK4 of x' = i x.
    w = 8e-3j
    circle = (1 + w + w**2 / 2 + w**3 / 6 + w**4 / 24) ** np.arange(51)
    np.testing.assert_allclose(x[::8], circle.real, rtol=2**-24 * (1 + 1e-6), atol=0)
    # In between AB2 in single precision. Each of 7 steps leaves 5/12 h^3 of the third derivative, which
    # is 1; half a unit of the last place of x and the rounding of three products and sums of 1e-3.
    off = np.hypot(x - np.cos(t), y - np.sin(t))
    bound = 7 * (5 / 12 * 1e-9 + 2**-25 * np.sqrt(2) + 4e-3 * 2**-24) + 2**-24
    assert 2**-26 < np.max(off) < bound


def test_next_is_of_the_own_task():
    text = UPDATED.replace("reset_to: Y", "reset_to: next(ys)")
    with pytest.raises(
        PatchError, match=r":15: state 'y' reads next\(ys\) of another task.*ys_next"
    ):
        parse_patch(text)


def steps_of_single_precision(largest):
    """The last places of largest*cos(angle) round a circle, and the angles."""
    angle = 2 * np.pi * (np.arange(100_000) + 0.5) / 100_000
    return np.spacing(np.float32(np.abs(largest * np.cos(angle)))).astype(float), angle


def test_two_precisions_err_by_what_their_words_cannot_hold(shipped):
    text = shipped("two_precisions")
    result = run(parse_patch(text))
    miss = result.record["miss"].values
    step, angle = steps_of_single_precision(7e6)
    added = 2 * np.mean(step**2) / 12  # to the variance of both coordinates, by each rounding
    assert "mean square of that is 0.163 m^2" in text and round(np.mean(step**2), 3) == 0.163
    # Squares of a random walk: over 1,166 cycles and two coordinates their mean scatters by
    # sqrt(2/2332) at one place in the cycle, here five times that.
    for k in range(10):
        assert np.mean(miss[k::10] ** 2) == pytest.approx(
            added * (k + 1), rel=5 * (2 / 2332) ** 0.5
        )
    expected = np.sqrt(added * 5.5)
    assert "0.386 m rms" in text and round(expected, 3) == 0.386
    found = result.readouts["miss"]["value"]
    # RK4 steps of 10 s put slow (n h)^4/120 of the way ahead: 1 cm; that is left out above.
    assert found == pytest.approx(expected, rel=0.06) and f"measured: {found:.3f} m" in text
    # Eleven roundings by half a last place at the most, of both coordinates, and that centimetre.
    assert result.readouts["worst"]["value"] < 11 * 0.25 * np.sqrt(2) + 0.02
    # The drift of what is never set right, see the patch: 441 m rms over orbits like this one.
    t, n = 11657.0, np.sqrt(3.986004418e14 / 7e6**3)
    of_radius = 2 * np.mean((np.cos(angle) * step) ** 2) / 12
    slow_steps, _ = steps_of_single_precision(7e6 * n)
    of_speed = 2 * np.mean((np.cos(angle) * slow_steps) ** 2) / 12
    drift = np.sqrt(9 * (n**2 * of_radius + of_speed) * t**3 / 3)
    assert "441 m rms" in text and round(drift) == 441
    alone = result.readouts["alone"]["value"]
    assert drift / 30 < alone < 4 * drift and f"one orbit: {alone:.0f} m" in text


# --- sub-patches ---------------------------------------------------------------------------------

WHEEL = """\
title: A wheel turned by the program, in single precision
inputs: {demand: 2 rad/s}
parameters: {stiffness: 5 1/s}
digital:
  period: 2 ms
  remember: {slip: 0 rad/s}
  words: {slip: float32}
  states: {rate: {integrate: stiffness*slip, initial: 0 rad/s}}
  program: {slip: demand - rate, old: previous(slip)}
run: {until: 1 s, every: 2 ms}
"""
WHEELS = """\
title: Two wheels in two tasks
machine: ideal
parameters: {base: 1 rad/s}
parts:
  left: {file: wheel.yaml, inputs: {demand: wanted}, task: slow}
  right: {file: wheel.yaml, inputs: {demand: left.rate}, parameters: {stiffness: 8 1/s}, task: fast}
digital:
  tasks:
    fast: {period: 2 ms, compute_time: 0.5 ms}
    slow: {period: 10 ms, compute_time: 3 ms, program: {wanted: base + right.rate/4}}
run: {until: 1 s, every: 1 ms}
"""
BY_HAND = """\
title: Two wheels in two tasks
machine: ideal
parameters: {left_stiffness: 5 1/s, right_stiffness: 8 1/s, base: 1 rad/s}
digital:
  remember: {left_slip: 0 rad/s, right_slip: 0 rad/s}
  words: {left_slip: float32}
  tasks:
    fast:
      period: 2 ms
      compute_time: 0.5 ms
      words: {right_slip: float32}
      states: {right_rate: {integrate: right_stiffness*right_slip, initial: 0 rad/s}}
      program:
        right_demand: left_rate
        right_slip: right_demand - right_rate
        right_old: previous(right_slip)
    slow:
      period: 10 ms
      compute_time: 3 ms
      states: {left_rate: {integrate: left_stiffness*left_slip, initial: 0 rad/s}}
      program:
        wanted: base + right_rate/4
        left_demand: wanted
        left_slip: left_demand - left_rate
        left_old: previous(left_slip)
run: {until: 1 s, every: 1 ms}
"""


def wheels(tmp_path, text=WHEELS):
    (tmp_path / "wheel.yaml").write_text(WHEEL)
    (tmp_path / "two.yaml").write_text(text)
    return read_patch(tmp_path / "two.yaml")


def test_parts_in_tasks_are_the_patch_written_out_by_hand(tmp_path):
    parts, flat = run(wheels(tmp_path)).record, run(parse_patch(BY_HAND)).record
    assert {str(name).replace(".", "_") for name in parts} == set(flat)
    for name in parts:
        written = flat[str(name).replace(".", "_")]
        np.testing.assert_array_equal(parts[name], written, err_msg=str(name))
    assert float(parts["right.rate"].max()) > 0.5


def test_parts_of_parts_run_in_the_task_of_the_whole(tmp_path):
    axle = "title: Axle\nparts: {a: {file: wheel.yaml, inputs: {demand: 3 rad/s}}}\n"
    (tmp_path / "axle.yaml").write_text(axle + "outputs: [a.rate]\n")
    text = WHEELS.replace(
        "{file: wheel.yaml, inputs: {demand: wanted}, task", "{file: axle.yaml, task"
    )
    text = text.replace("left.rate", "left.a.rate")
    slow = next(t for t in wheels(tmp_path, text).program.tasks if t.name == "slow")
    assert {"left.a.slip", "left.a.old", "left.a.demand", "wanted"} == set(slow.words)
    assert slow.states == ("left.a.rate",)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (", task: slow", "", r"wheel.yaml:9 .*'left.slip' of a part belongs to no task; give"),
        ("task: slow", "task: slwo", r"two.yaml:5: part 'left' has unknown task 'slwo'; did you"),
        ("right.rate/4", "right.slop/4", r"two.yaml:10: 'slop' is no output of part 'right'"),
    ],
)
def test_a_part_in_no_task(old, new, says, tmp_path):
    assert old in WHEELS
    with pytest.raises(PatchError, match=says):
        wheels(tmp_path, WHEELS.replace(old, new))


def test_a_part_with_a_task_where_there_is_one_program(tmp_path):
    text = (
        WHEELS[: WHEELS.index("digital:")] + "digital: {period: 1 ms, program: {wanted: 1 rad/s}}\n"
    )
    with pytest.raises(PatchError, match=r"two.yaml:5: part 'left' has a task.*no tasks"):
        wheels(tmp_path, text + "run: {until: 1 s}\n")


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        (
            "  words:",
            "  states: {x: {integrate: chaos, initial: 0}}\n  words:",
            5,
            "tasks and states",
        ),
        ("program: {third", "word: flaot, program: {third", 8, "word of task 'slow' is 'flaot'"),
        (
            "program: {third",
            "words: {chaos: float32}, program: {third",
            8,
            "no word or state 'chaos'",
        ),
        ("program: {third", "words: {third: float64}, program: {third", 8, "digital: words: too"),
        ("program: {third", "integration: rk5, program: {third", 8, "integration of task 'slow'"),
        (
            "program: {third: chaos/3",
            "states: {x: {integrate: 1, initial: 0}}, program: {third: next(chaos)",
            8,
            "reads next(chaos), but 'chaos' is no state",
        ),
        (
            "0 s, program: {third",
            "0 s, states: {x: {integrate: previous(chaos), initial: 0}}, program: {third",
            8,
            "state 'x' reads previous(chaos) of another task",
        ),
        ("0 s, program: {third: chaos/3, sum: previous(sum) + 1/4}", "0 s", 8, "has no program"),
        ("words: {third", "words: {thrid", 5, "did you mean 'third'"),
        ("run:", "parts: {p: {file: brought.yaml}}\nrun:", 3, "belongs to no task"),
        ("run:", "parts: {p: {file: brought.yaml, task: slw}}\nrun:", 9, "did you mean 'slow'"),
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
