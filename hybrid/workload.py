"""What the digital machine is asked to do, and how well it did: a row for each task.

Stage 4, for `runs` and `checks`. Times in s of problem time.
"""

from __future__ import annotations

import collections
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from hybrid.counting import program_operations
from hybrid.errors import counted
from hybrid.machine import Machine, TaskTiming
from hybrid.rota import TaskReport
from hybrid.scale import to_seconds
from hybrid.tasks import ROUNDING
from hybrid.timeline import Timeline

# Of a timeline that never repeats, some seconds of laying out.
MOST_STRETCHES = 25
MOST_LATE = 3  # ADCs that the note of a run tells of
PROGRAM = "program"  # what a row is called where there is one program


@dataclass(frozen=True, slots=True)
class TaskRow:
    """One task: what it is, and what its cycles came to in a run or a part of it."""

    task: str
    period_s: float | None  # None: a comparator starts it
    place: int  # 1 goes first
    operations: dict[str, int]  # additions, multiplications, ... of a cycle
    compute_s: float
    # Asked of the processor: compute time over period; of what a comparator starts, times its calls.
    utilisation: float
    cycles: int  # that ended
    overruns: int  # that were due while the one before had not ended
    waiting: int  # of these, what queues and had not begun at the end
    worst_response_s: float | None  # from when a cycle is due to its results; None: none ended
    when: str | None = None  # what starts it in place of a clock: 'beyond rises'
    samples: tuple[str, ...] = ()  # the ADCs that follow its clock
    sends: tuple[str, ...] = ()  # the DACs that show their words where it ends


def task_rows(
    machine: Machine, timeline: Timeline, until: int | None = None
) -> tuple[TaskRow, ...]:
    """Of every task, by name, or of the one program; none without a digital machine.

    Args: until: ticks up to which the timeline was played (default: all; where clocks jitter it is then
    laid out here, for MOST_STRETCHES stretches at most).
    """
    timing = machine.timing
    if not timing.period and not timing.tasks:
        return ()
    if not timing.tasks:
        end, latency = timeline.until if until is None else until, machine.latency_ticks
        cycles = max(0, (end - latency) // timing.period + 1)
        response_s = to_seconds(latency) if cycles else None
        share = timing.compute / timing.period
        report = TaskReport(PROGRAM, cycles, 0, response_s, share)
        whole = TaskTiming(PROGRAM, timing.period, 0, timing.compute, 0)
        return (_row(machine, 0, report, whole),)
    if timeline.later and until is None:  # of a run that is not played
        collections.deque(itertools.islice(timeline.further(), MOST_STRETCHES), maxlen=0)
    return tuple(
        _row(machine, i, report, task)
        for i, (report, task) in enumerate(
            zip(timeline.reports(machine, until), timing.tasks, strict=True)
        )
    )


def _row(machine: Machine, number: int, report: TaskReport, task: TaskTiming) -> TaskRow:
    return TaskRow(
        report.task,
        to_seconds(task.period) if task.period else None,
        task.rank + 1,
        program_operations(machine.tape, number),
        to_seconds(task.compute),
        report.utilisation,
        report.cycles,
        report.overruns,
        report.waiting,
        report.worst_response_s,
        " ".join(task.when) if task.when else None,
        tuple(sampler.name for sampler in machine.samplers if sampler.task == number),
        tuple(holder.name for holder in machine.holders if holder.task == number),
    )


def ended_cycles(machine: Machine, rows: Sequence[TaskRow]) -> int:
    """Cycles that ended of the program or, of tasks, of the one with the shortest period; where none has
    a clock, of all."""
    clock_s = to_seconds(machine.timing.period)
    fastest = [row.cycles for row in rows if row.period_s == clock_s]
    return max(fastest) if fastest else sum(row.cycles for row in rows)


def columns(rows: Sequence[TaskRow]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and cells of a table of the tasks, for people."""
    headings = (
        "task",
        "rank",
        "period s",
        "compute s",
        "of the time",
        "worst s",
        "cycles",
        "over",
    )
    cells: list[tuple[str, ...]] = [
        (
            row.task,
            str(row.place),
            "-" if row.period_s is None else f"{row.period_s:.6g}",
            f"{row.compute_s:.4g}",
            f"{100 * row.utilisation:.4g} %",
            "-" if row.worst_response_s is None else f"{row.worst_response_s:.4g}",
            str(row.cycles),
            str(row.overruns),
        )
        for row in rows
    ]
    return headings, cells


def work_text(row: TaskRow) -> str:
    """What starts a task, what it samples and sends, and what a cycle is made of."""
    counts = (f"{n} {name.replace('_', ' ')}" for name, n in row.operations.items() if n)
    operations = ", ".join(counts)
    told = [
        f"when {row.when}" if row.when else "",
        f"samples {', '.join(row.samples)}" if row.samples else "",
        f"sends {', '.join(row.sends)}" if row.sends else "",
        f"{operations} a cycle" if operations else "no operations",
    ]
    return "; ".join(filter(None, told))


def total_utilisation(rows: Sequence[TaskRow]) -> float:
    """The share of its time that the processor is asked for."""
    return sum(row.utilisation for row in rows)


def warnings(machine: Machine, rows: Sequence[TaskRow]) -> list[str]:
    """What is valid but hardly meant: too much work, cycles that are due too early."""
    tasks = {task.name: task for task in machine.timing.tasks}
    found = []
    total = total_utilisation(rows)
    if tasks and total > 1.0:
        first = min(tasks.values(), key=lambda task: task.place.line)
        found.append(
            f"{first.place}: the tasks ask for {100 * total:.4g} % of the processor's time"
        )
    if too_slow := beyond_the_processor(machine):
        found.append(too_slow)
    found += [f"{tasks[name].place}: {told}" for name, told in never_begun(machine).items()]
    places = {adc.name: adc.place for adc in machine.patch.adcs}
    found += [f"{places[name]}: {told}" for name, told in late_samples(machine).items()]
    for row in rows:
        if row.overruns:
            task = tasks[row.task]
            does = {"skip": "left out", "queue": "begun late", "stop": "the end of the run"}
            never = f", but for {row.waiting} that still wait at the end" if row.waiting else ""
            found.append(
                f"{task.place}: task {row.task!r} has {row.overruns} of its cycles due before the one "
                f"before has ended; they are {does[task.overrun]}{never} (overrun: {task.overrun})"
            )
    return found


def load_text(machine: Machine, rows: Sequence[TaskRow]) -> str:
    """The same of a run that was played, without places: tasks that never began, too much work, and what
    became of cycles that were due too early; ''."""
    did = {"skip": "left out {}", "queue": "began {} late", "stop": "ended the run by {}"}
    overrun = {task.name: task.overrun for task in machine.timing.tasks}
    total = total_utilisation(rows)
    told = [*never_begun(machine).values(), beyond_the_processor(machine)]
    late = list(late_samples(machine).values())
    told += late[:MOST_LATE]
    if len(late) > MOST_LATE:
        told.append(f"so do {len(late) - MOST_LATE} more")
    if overrun and total > 1.0 + ROUNDING:
        told.append(f"the tasks ask for {100 * total:.4g} % of the processor's time")
    for row in rows:
        if row.overruns:
            what = did[overrun[row.task]].format(counted(row.overruns - row.waiting, "cycle"))
            never = f" and left {row.waiting} waiting at the end" if row.waiting else ""
            told.append(f"task {row.task} {what}{never} (overrun: {overrun[row.task]})")
    return "; ".join(filter(None, told))


def never_begun(machine: Machine) -> dict[str, str]:
    """The tasks whose first cycle is due after the end of the run, and what is told of each."""
    until = machine.timing.until
    return {
        task.name: f"task {task.name!r} never begins: its phase of {to_seconds(task.phase):.6g} s is "
        f"after the end of the run at {to_seconds(until):.6g} s"
        for task in machine.timing.tasks
        if task.period and task.phase > until
    }


def late_samples(machine: Machine) -> dict[str, str]:
    """The ADCs whose turn comes a period or more after their cycle begins, and what is told of each."""
    timing, found = machine.timing, {}
    for sampler in machine.samplers:
        period = timing.tasks[sampler.task].period if timing.tasks else timing.period
        if period and sampler.delay_ticks >= period:
            late_s, period_s = to_seconds(sampler.delay_ticks), to_seconds(period)
            found[sampler.name] = (
                f"ADC {sampler.name!r} samples {late_s:.6g} s after its cycle begins, channel times "
                f"skew, which is {late_s / period_s:.4g} periods of {period_s:.6g} s"
            )
    return found


def beyond_the_processor(machine: Machine) -> str:
    """That the one program has more operations in a cycle than its processor has time for; ''.

    A compute time that is given may be that of a pipeline of several processors.
    """
    program, timing = machine.patch.program, machine.timing
    if program is None or not program.counted or timing.compute <= timing.period:
        return ""
    share = 100 * timing.compute / timing.period
    return (
        f"{program.place}: the operations of a cycle take {share:.4g} % of the period on this "
        "processor; it is played as if several took turns"
    )


def to_dicts(rows: Sequence[TaskRow]) -> list[dict[str, Any]]:
    """The rows as plain data, for JSON."""
    names = TaskRow.__dataclass_fields__
    return [{name: getattr(row, name) for name in names} for row in rows]
