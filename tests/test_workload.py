"""How busy the processor is, from the patch file to the answer: against fixed-priority scheduling played
millisecond by millisecond in plain Python, in every shipped patch with tasks, and beyond 100 %."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hybrid
from hybrid.cli import main
from hybrid.compiler import compile_patch
from hybrid.errors import PatchError
from hybrid.patchfile import parse_patch
from hybrid.rota import rota_until, settled
from hybrid.timeline import stretch_of

UNTIL = 97  # ms


@dataclass
class Task:
    name: str
    period: int
    compute: int
    phase: int
    overrun: str
    priority: int | None

    @property
    def text(self) -> str:
        told = f"period: {self.period} ms, phase: {self.phase} ms, overrun: {self.overrun}"
        if self.priority is not None:
            told += f", priority: {self.priority}"
        return told


def scheduled(tasks, preemptive):
    """By task: cycles ended, overruns, worst response in ms, of fixed-priority scheduling."""
    order = sorted(tasks, key=lambda t: (t.period if t.priority is None else -t.priority, t.name))
    due, left, waiting = {}, {}, {t.name: [] for t in tasks}  # of the cycle under way
    done = {t.name: [0, 0, None] for t in tasks}
    running = None

    def end(task, now):
        response = now - due.pop(task.name)
        count, overruns, worst = done[task.name]
        done[task.name] = [count + 1, overruns, max(response, worst or 0)]
        if waiting[task.name]:
            due[task.name], left[task.name] = waiting[task.name].pop(0), task.compute

    for now in range(UNTIL + 1):
        if running and left[running.name] == 0:
            end(running, now)
            running = None
        for task in tasks:
            if now >= task.phase and (now - task.phase) % task.period == 0:
                if task.name not in due:
                    due[task.name], left[task.name] = now, task.compute
                else:
                    done[task.name][1] += 1
                    if task.overrun == "queue":
                        waiting[task.name].append(now)
        while ready := [task for task in order if task.name in due]:
            if running is None or (preemptive and order.index(ready[0]) < order.index(running)):
                running = ready[0]
            if left[running.name]:
                left[running.name] -= 1
                break
            end(running, now)
            running = None
    return done


def patch_of(tasks, preemptive, counted):
    """The patch: a task whose compute time is counted adds as often as it has milliseconds."""
    lines = []
    for task in tasks:
        added = " + ".join([f"previous({task.name})"] * (task.compute + 1))
        compute = f"{task.compute} ms"
        if counted and task.compute:
            compute = "counted"
        program = f"program: {{{task.name}: {added}}}"
        lines.append(f"    {task.name}: {{{task.text}, compute_time: {compute}, {program}}}")
    remember = ", ".join(f"{task.name}: 0" for task in tasks)
    body = "\n".join(lines)
    return f"""\
title: Some tasks
machine: ideal
digital:
  scheduling: {"preemptive" if preemptive else "cooperative"}
  processor: {{add: 1 ms, multiply: 1 s, divide: 1 s}}
  remember: {{{remember}}}
  tasks:
{body}
run: {{until: {UNTIL} ms, every: 1 ms}}
"""


figures = st.tuples(
    st.sampled_from([4, 5, 6, 8, 12, 20]),
    st.integers(0, 6),
    st.integers(0, 9),
    st.sampled_from(["skip", "queue"]),
)


@given(
    figures=st.lists(figures, min_size=1, max_size=4),
    priorities=st.one_of(st.none(), st.permutations([5, 1, 3, 2])),
    preemptive=st.booleans(),
    counted=st.booleans(),
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_a_run_and_a_check_tell_what_fixed_priority_scheduling_does(
    figures, priorities, preemptive, counted
):
    tasks = [
        Task("dcba"[i], *figure, priorities[i] if priorities else None)
        for i, figure in enumerate(figures)
    ]
    load = sum(Fraction(task.compute, task.period) for task in tasks)
    text = patch_of(tasks, preemptive, counted)
    if load > 1 and any(task.overrun == "queue" for task in tasks):
        with pytest.raises(PatchError, match="% of the processor's time, and the cycles of task"):
            hybrid.check(parse_patch(text), trial=False)
        tasks = [Task(t.name, t.period, t.compute, t.phase, "skip", t.priority) for t in tasks]
        text = patch_of(tasks, preemptive, counted)
    result, check = hybrid.run(parse_patch(text)), hybrid.check(parse_patch(text), trial=False)
    expected = scheduled(tasks, preemptive)
    assert result.tasks == check.tasks and len(result.tasks) == len(tasks)
    for row in result.tasks:
        task = next(task for task in tasks if task.name == row.task)
        cycles, overruns, worst = expected[row.task]
        assert (row.cycles, row.overruns) == (cycles, overruns)
        assert row.worst_response_s == (None if worst is None else pytest.approx(worst / 1e3))
        assert row.compute_s == pytest.approx(task.compute / 1e3)
        assert row.utilisation == pytest.approx(task.compute / task.period)
    too_much = f"ask for {100 * float(load):.4g} % of the processor's time"
    assert (too_much in result.status_note) == (load > 1)
    assert any(too_much in warning for warning in check.warnings) == (load > 1)
    late = {name for name, (_, overruns, _) in expected.items() if overruns}
    assert {
        t.name for t in tasks if any(f"task {t.name!r} has" in w for w in check.warnings)
    } == late


@given(
    figures=st.lists(figures, min_size=1, max_size=4),
    priorities=st.one_of(st.none(), st.permutations([5, 1, 3, 2])),
    preemptive=st.booleans(),
)
@settings(max_examples=100, deadline=None, derandomize=True)
def test_tasks_that_fall_behind_by_skipping_repeat_what_they_do(figures, priorities, preemptive):
    """Whatever is asked of the processor, also where a task never gets it: what is left to compute is a
    whole number of ms, so the tasks come to a round, which then goes on, responses included."""
    tasks = [
        Task("dcba"[i], *figure[:3], "skip", priorities[i] if priorities else None)
        for i, figure in enumerate(figures)
    ]
    machine = compile_patch(parse_patch(patch_of(tasks, preemptive, counted=False)))
    stretch = stretch_of(machine)
    long = replace(machine, timing=replace(machine.timing, until=300 * stretch))
    after, again = settled(long, stretch, 100_000)
    assert after % again == 0

    def done_in(round_: int) -> tuple[list, list]:
        first, end = ((after + again * n) * stretch for n in (round_, round_ + 1))
        rota = rota_until(long, end)
        return (
            [(tick - first, *rest) for tick, *rest in rota.events if tick >= first],
            [(n.tick - first, n.task, n.response) for n in rota.notes if n.tick >= first],
        )

    assert done_in(0) == done_in(1) == done_in(4)


def test_a_clock_that_is_late_changes_neither_utilisation_nor_the_number_of_cycles():
    """Ranks, loads and periods as without; a response is counted from when a cycle is due, so it is
    longer by at most the jitter of the task and of the one that goes first."""
    tasks = [Task("b", 10, 4, 0, "queue", None), Task("a", 20, 8, 0, "queue", None)]
    text = patch_of(tasks, True, True)
    sharp = hybrid.run(parse_patch(text)).tasks
    jittery = text.replace("overrun: queue", "jitter: 1 ms, overrun: queue")
    for seed in range(5):
        late = hybrid.run(parse_patch(jittery), seed=seed).tasks
        for one, other in zip(sharp, late, strict=True):
            assert (one.utilisation, one.operations) == (other.utilisation, other.operations)
            assert abs(one.cycles - other.cycles) <= 1 and other.overruns == 0
            assert 0 <= other.worst_response_s - one.worst_response_s <= 2e-3
    too_long = jittery.replace("period: 10 ms", "period: 6 ms")  # 4/6 + 8/20
    with pytest.raises(PatchError, match=r"ask for 106.7 % of the processor's time"):
        hybrid.run(parse_patch(too_long))


@pytest.mark.parametrize("name", ["rate_groups", "two_precisions"])
def test_every_shipped_patch_with_tasks_tells_of_them(name, capsys, tmp_path):
    keys = {"task", "period_s", "place", "operations", "compute_s", "utilisation", "cycles"}
    keys |= {"overruns", "waiting", "worst_response_s", "when", "samples", "sends"}
    verbs = (["run", "--no-chart", "--out", str(tmp_path)], ["check", "--no-trial"])
    for verb, *options in verbs:
        assert main([verb, name, *options, "--json"]) == 0
        rows = json.loads(capsys.readouterr().out)["tasks"]
        assert len(rows) > 1
        for row in rows:
            assert row.keys() == keys
            assert row["utilisation"] == pytest.approx(row["compute_s"] / row["period_s"])
            assert row["worst_response_s"] >= row["compute_s"] and row["cycles"] > 0
        assert main([verb, name, *options]) == 0
        shown = capsys.readouterr().out
        assert all(row["task"] in shown for row in rows) and "rank 1 goes first" in shown


def test_all_shipped_patches_with_tasks_are_tested_above():
    names = {n for n in hybrid.shipped_patches() if _has_tasks(hybrid.read_patch(n))}
    assert names == {"rate_groups", "two_precisions"}


def _has_tasks(patch):
    return bool(patch.program and patch.program.tasks)


ONE = """\
title: One program, counted
machine: ideal
digital:
  period: 10 ms
  compute_time: counted
  processor: {add: ADD, multiply: 1 s, divide: 1 s}
  remember: {n: 0}
  program: {n: previous(n) + 1}
run: {until: 0.1 s}
"""


def test_a_program_that_takes_longer_than_its_period_on_its_processor_is_told():
    """One addition: 10 ms of 10 are in time, 12.5 are not."""
    for add, told in (("10 ms", False), ("12.5 ms", True)):
        patch = parse_patch(ONE.replace("ADD", add), "one.yaml")
        says = "one.yaml:4: the operations of a cycle take 125 % of the period on this processor"
        assert (says in hybrid.run(patch).status_note) == told
        warnings = hybrid.check(patch, trial=False).warnings
        assert any(says in warning for warning in warnings) == told
    given = ONE.replace("compute_time: counted", "compute_time: 12.5 ms").replace("ADD", "1 ms")
    assert not hybrid.run(parse_patch(given)).status_note  # a pipeline, as the README says


LATE = """\
title: A multiplexer with many channels
machine: ideal
analog:
  now: {integrate: {one: 1}, initial: 0 s, full_scale: 10 s}
  one: {constant: 1, full_scale: 1}
interface:
  seen: {adc: now, channel: CHANNEL}
digital:
  period: 10 ms
  skew: 1 ms
  program: {then: seen}
run: {until: 2 s}
"""


TURN = "ADC 'seen' samples {} s after its cycle begins, channel times skew, which is"


@pytest.mark.parametrize(
    ("channel", "told"),
    [
        (9, ""),
        (
            10,
            f"{TURN.format(0.01)} 1 periods",
        ),
        (
            900,
            f"{TURN.format(0.9)} 90 periods",
        ),
    ],
)
def test_an_adc_whose_turn_comes_after_its_period_is_told(channel, told):
    patch = parse_patch(LATE.replace("CHANNEL", str(channel)), "late.yaml")
    run, check = hybrid.run(patch), hybrid.check(patch, trial=False)
    assert run.status == "complete"
    assert told in run.status_note and bool(told) == bool(run.status_note)
    assert any(f"late.yaml:7: {told}" in warning for warning in check.warnings) == bool(told)
    # The words say the same: each is of so long after the start of a cycle.
    last_ms = 1e3 * run.record["then"].values[-1]
    assert math.remainder(last_ms - channel, 10) == pytest.approx(0, abs=1e-6)


def test_a_task_that_never_begins_is_told_by_check_and_run():
    text = hybrid.read_patch("rate_groups").text.replace(
        "period: outer", "period: outer\n      phase: 3 s"
    )
    patch = parse_patch(text, "late.yaml")
    (warning,) = [w for w in hybrid.check(patch).warnings if "never begins" in w]
    assert warning.startswith("late.yaml:")
    assert "'attitude_loop'" in warning and "phase of 3 s" in warning and "at 2 s" in warning
    assert "'attitude_loop' never begins" in hybrid.run(patch).status_note
    assert "never begins" not in hybrid.run(patch, until="3.5 s").status_note


@pytest.mark.parametrize(("compute_time", "ended"), [("0 s", 101), ("10 ms", 100), ("30 ms", 98)])
def test_heading_and_table_count_the_same_cycles(compute_time, ended):
    """Those that begin at 0, 10 ... 1000 ms, and end by then."""
    text = hybrid.read_patch("pitch_loop").text.replace("until: 10 s", "until: 1 s")
    patch = parse_patch(text, "pitch_loop.yaml")
    given = {"cycle": "10 ms", "compute_time": compute_time}
    found = hybrid.run(patch, given, machine="ideal")
    checked = hybrid.check(patch, given, machine="ideal", trial=False)
    assert found.cycles == found.tasks[0].cycles == checked.tasks[0].cycles == ended
    assert checked.events.startswith(f"{ended} cycles")
