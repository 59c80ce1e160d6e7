"""Operation counts and times by hand, and what a run and a check tell of tasks."""

import json

import pytest

import hybrid
from hybrid.cli import main
from hybrid.compiler import compile_patch
from hybrid.counting import program_operations
from hybrid.errors import PatchError
from hybrid.helpers import HELPERS
from hybrid.operations import HELPER_PARTS, OPERATIONS, of_operation
from hybrid.patchfile import parse_patch
from hybrid.processors import PROCESSORS
from hybrid.tape import Op

TEXT = """\
title: A program whose operations can be counted
machine: ideal
parameters: {k: 2}
analog: {x: {constant: 1, full_scale: 4}}
interface: {s: {adc: x}, y: {dac: w, full_scale: 100, initial: 0}}
digital:
  period: 10 ms
  compute_time: counted
  processor: PROCESSOR
  program:
    v: k**2 * s + 3*s - s/7
    w: sqrt(v) + sin(s)
run: {until: 0.1 s}
"""
# k**2 is known before the run: 2 products, a quotient and 2 additions for v; for w a root, an addition
# and a sine (6 products, 6 additions); 2 words are stored.
COUNTED = {"add": 2 + 1 + 6, "multiply": 2 + 6, "divide": 1, "square_root": 1, "store": 2}


def compute_s(processor):
    machine = compile_patch(parse_patch(TEXT.replace("PROCESSOR", processor)))
    assert program_operations(machine.tape, 0) == COUNTED
    return machine.timing.compute / 1e15


@pytest.mark.parametrize(
    ("processor", "expected_s"),
    [
        # Nine additions and two stores of two cycles, eight products and a quotient of 14, a root of
        # three times 14 + 2.
        ("ibm_7090", (9 * 2 + 8 * 14 + 14 + 2 * 2 + 3 * 16) * 2.18e-6),
        ("ibm_1620", 9 * 1.2e-3 + 8 * 12.5e-3 + 41.7e-3 + 3 * (41.7e-3 + 1.2e-3)),
        ("apollo_guidance_computer", (9 * 2 + 8 * 4 + 7 + 2 * 2 + 3 * 9) * 11.72e-6),
        ("cdc_6600", (9 * 4 + 8 * 10 + 29 + 2 * 3 + 3 * 33) * 1e-7),
        ("cortex_m4f", (9 * 5 + 8 * 5 + 18 + 2 * 1 + 16) / 48e6),
        ("{add: 1 us, multiply: 10 us, divide: 100 us}", 9e-6 + 80e-6 + 100e-6 + 303e-6),
        (
            "{add: 1 us, multiply: 10 us, divide: 100 us, store: 0.1 us, square_root: 50 us}",
            9e-6 + 80e-6 + 100e-6 + 50e-6 + 0.2e-6,
        ),
    ],
)
def test_the_compute_time_is_the_sum_of_the_operations(processor, expected_s):
    assert compute_s(processor) == pytest.approx(expected_s, rel=1e-12)


def test_every_operation_has_a_count_and_no_other():
    for op in Op:
        counts = of_operation(op.name.lower())
        assert counts.keys() <= set(OPERATIONS) and sum(counts.values()) > 0
    assert HELPER_PARTS.keys() == HELPERS.keys()
    for processor in PROCESSORS.values():
        assert 0 < processor.add_s <= processor.multiply_s <= processor.divide_s


def test_a_task_is_counted_by_itself_and_in_machine_time():
    digital = TEXT[TEXT.index("digital:") : TEXT.index("run:")]
    tasks = """\
digital:
  processor: ibm_7090
  tasks:
    a: {period: 10 ms, compute_time: counted, program: {v: 'k**2 * s + 3*s - s/7'}}
    b: {period: 20 ms, compute_time: counted, program: {w: 'sqrt(v) + sin(s)'}}
time_scale: 10
"""
    machine = compile_patch(parse_patch(TEXT.replace(digital, tasks)))
    cycles = [2 * 14 + 14 + 2 * 2 + 2, 3 * 16 + 6 * 14 + 7 * 2 + 2]
    found = [task.compute / 1e15 for task in machine.timing.tasks]
    assert found == pytest.approx([10 * 2.18e-6 * n for n in cycles], rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("  processor: PROCESSOR\n", "", 8, "needs operation times; add processor:"),
        ("PROCESSOR", "ibm_709", 9, "did you mean 'ibm_7090'"),
        ("PROCESSOR", "{add: 1 us, multiply: 2 us}", 9, "no divide"),
        ("PROCESSOR", "{add: 1 V, multiply: 2 us, divide: 1 us}", 9, "must be a time"),
        ("PROCESSOR", "{add: -1 us, multiply: 2 us, divide: 1 us}", 9, "0 or greater"),
        ("PROCESSOR", "[1, 2]", 9, "must be a mapping"),
        ("counted", "count", 8, "unknown parameter 'count'"),
    ],
)
def test_mistakes_have_their_line(old, new, line, says):
    with pytest.raises(PatchError) as raised:
        parse_patch(TEXT.replace(old, new).replace("PROCESSOR", "ibm_7090"))
    assert f":{line}: " in str(raised.value) and says in str(raised.value)


# --- what is told ----------------------------------------------------------------------------------

LATE = """\
title: Too much work
machine: ideal
analog: {x: {constant: 1, full_scale: 4}}
interface: {s: {adc: x}}
digital:
  tasks:
    fast: {period: 10 ms, compute_time: 6 ms, program: {v: 2*s}}
    slow: {period: 20 ms, compute_time: 10 ms, overrun: skip, program: {w: v + 1}}
run: {until: 1 s}
"""


def test_a_run_tells_of_its_tasks(tmp_path, capsys):
    # fast has 0-6, 10-16, ...; slow 6-10, 16-20 and the rest from 26 on, until 28: so of its ticks
    # 0, 20, 40 ... every second one is left out, and it answers after 28 ms.
    patch = parse_patch(LATE)
    result = hybrid.run(patch)
    fast, slow = result.tasks
    assert (fast.cycles, fast.overruns, fast.worst_response_s) == (100, 0, 6e-3)
    assert (slow.cycles, slow.overruns, slow.worst_response_s) == (25, 25, 28e-3)
    assert (fast.utilisation, slow.utilisation) == (0.6, 0.5)
    assert (fast.place, slow.place) == (1, 2) and slow.operations["add"] == 1
    assert json.loads(result.record.attrs["tasks"])[1]["overruns"] == 25
    assert "task slow: 25 overruns" in repr(result)
    file = tmp_path / "late.yaml"
    file.write_text(LATE)
    assert main(["run", str(file), "--json", "--no-chart", "--out", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out)["tasks"]
    assert [row["task"] for row in told] == ["fast", "slow"] and told[1]["cycles"] == 25
    assert main(["run", str(file), "--no-chart", "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "the tasks ask for 110 % of the processor's time; task slow left out 25 cycles" in shown
    assert "(overrun: skip)" in shown and "0.028" in shown
    table = next(line.split() for line in shown.splitlines() if line.startswith("slow "))
    assert table[-2:] == ["25", "25"]  # cycles, and those that were due too early


def test_a_run_tells_of_cycles_left_out_where_the_load_is_no_more_than_the_processor_has():
    # slow 0-6 (cooperative), fast due at 0 and 5: begins at 6, so the tick at 5 is left out; again every
    # 20 ms, of which 6 + 4 are asked for.
    text = """
title: A long task in the way
machine: ideal
digital:
  scheduling: cooperative
  tasks:
    fast: {period: 5 ms, compute_time: 1 ms, priority: 1, program: {v: 1}}
    slow: {period: 20 ms, compute_time: 6 ms, priority: 2, program: {w: 1}}
run: {until: 100 ms, every: 1 ms}
"""
    result = hybrid.run(parse_patch(text))
    assert sum(row.utilisation for row in result.tasks) == pytest.approx(0.5)
    late = next(row.overruns for row in result.tasks if row.task == "fast")
    assert late == pytest.approx(5, abs=1)
    assert result.status_note == f"task fast left out {late} cycles (overrun: skip)"
    queued = text.replace("compute_time: 1 ms,", "compute_time: 1 ms, overrun: queue,")
    assert f"task fast began {late} cycles late (overrun: queue)" in (
        hybrid.run(parse_patch(queued)).status_note
    )


def test_a_lonely_task_that_is_late_has_its_table(tmp_path, capsys):
    text = """
title: One task
machine: ideal
digital: {tasks: {only: {period: 10 ms, compute_time: 15 ms, program: {v: 1}}}}
run: {until: 1 s, every: 10 ms}
"""
    file = tmp_path / "one.yaml"
    file.write_text(text)
    assert main(["run", str(file), "--no-chart", "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    assert "the tasks ask for 150 % of the processor's time; task only left out" in shown
    assert "Tasks, asking for 150 % of the processor's time" in shown


def test_a_check_warns_of_too_much_work(tmp_path, capsys):
    found = hybrid.check(parse_patch(LATE, "late.yaml"), trial=False)
    assert "late.yaml:7: the tasks ask for 110 % of the processor's time" in found.warnings
    assert any("late.yaml:8: task 'slow' has 25 of its cycles" in line for line in found.warnings)
    assert [row.task for row in found.tasks] == ["fast", "slow"]
    file = tmp_path / "late.yaml"
    file.write_text(LATE)
    assert main(["check", str(file), "--no-trial"]) == 0
    assert "slow: 1 add, 1 store a cycle" in capsys.readouterr().out


def test_a_run_that_a_task_stops(tmp_path, capsys):
    file = tmp_path / "late.yaml"
    file.write_text(LATE.replace("overrun: skip", "overrun: stop"))
    assert main(["run", str(file), "--json", "--no-chart", "--out", str(tmp_path)]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (
        told["status"] == "stopped" and "at 0.02 s: task 'slow' has overrun" in told["status_note"]
    )
    assert told["tasks"][1]["overruns"] == 1 and told["tasks"][1]["cycles"] == 0
    result = hybrid.run(file)
    assert result.time_s[-1] == 0.02


def test_one_program_is_a_row_too():
    text = TEXT.replace("PROCESSOR", "cortex_m4f")
    (row,) = hybrid.run(parse_patch(text)).tasks
    assert (row.task, row.cycles, row.overruns) == ("program", 10, 0)
    assert row.operations == COUNTED
    assert row.worst_response_s == row.compute_s == pytest.approx(121 / 48e6)


SHARED = """\
title: Who serves whom
machine: ideal
analog:
  wave: {sine: 1, frequency: 1 Hz, full_scale: 1}
  high: {compare: {wave: 1}, low: 0, high: 1, full_scale: 1}
interface:
  own: {adc: wave, task: caught}
  both: {adc: wave}
  idle: {adc: wave}
  late: {dac: v, full_scale: 4, initial: 0, transfer: slow}
  lamp: {dac: c, full_scale: 4, initial: 0}
digital:
  tasks:
    caught: {when: high falls, compute_time: 1 ms, program: {c: own + both}}
    fast: {period: 10 ms, compute_time: 1 ms, program: {v: 2*both}}
    slow: {period: 20 ms, compute_time: 1 ms, program: {w: both + own}}
run: {until: 1 s}
"""


def test_a_check_says_who_samples_what_and_sends_it(tmp_path, capsys):
    """An ADC follows the task it names, else of those with a clock the first that reads it, else the
    first of all; a DAC the task of its word or the one it waits for."""
    file = tmp_path / "shared.yaml"
    file.write_text(SHARED)
    assert main(["check", str(file), "--no-trial", "--json"]) == 0
    rows = {row["task"]: row for row in json.loads(capsys.readouterr().out)["tasks"]}
    assert {name: (row["samples"], row["sends"], row["when"]) for name, row in rows.items()} == {
        "caught": (["own"], ["lamp"], "high falls"),
        "fast": (["both", "idle"], [], None),
        "slow": ([], ["late"], None),
    }
    assert main(["check", str(file), "--no-trial"]) == 0
    shown = capsys.readouterr().out
    assert "caught: when high falls; samples own; sends lamp; 1 add, 1 store a cycle" in shown
    assert "fast: samples both, idle; 1 multiply, 1 store a cycle" in shown
    assert "rank 1 goes first" in shown


def test_the_one_program_samples_and_sends_all(pitch_loop):
    (row,) = hybrid.check(pitch_loop, trial=False).tasks
    assert (row.when, row.samples, row.sends) == (None, ("alpha_sample",), ("M_a",))


LED = """
title: A DAC that leads
machine: ideal
analog: {x: {integrate: {d: 1}, initial: 1, full_scale: 2}}
interface:
  s: {adc: x}
  d: {dac: w, full_scale: 2, initial: 0, lead: 15 ms}
digital: {period: 10 ms, compute_time: counted, processor: ibm_7090, program: {w: 2*s}}
run: {until: 1 s}
"""


def test_a_lead_is_what_a_later_cycle_computes():
    """w + 1.5 (w - w before): two additions, a product, and a word that is stored; that the first cycle
    shows w itself is no operation of the others."""
    of = [
        hybrid.check(parse_patch(text), trial=False).tasks[0].operations
        for text in (LED, LED.replace(", lead: 15 ms", ""))
    ]
    more = {name: of[0][name] - of[1][name] for name in of[0]}
    assert more == {"add": 2, "multiply": 1, "divide": 0, "square_root": 0, "store": 1}
