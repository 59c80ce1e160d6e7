"""The clocks of the digital machine: of its one program, or of its tasks and who serves which converter.

Stage 3, for `compiler`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hybrid.counting import program_operations
from hybrid.errors import PatchError
from hybrid.expressions import names
from hybrid.machine import TaskTiming, utilisation
from hybrid.patch import Adc, Dac, Program, Task, Value
from hybrid.processors import PROCESSORS, Processor
from hybrid.scale import to_seconds, to_ticks
from hybrid.tape import Tape

# 30 million years; no duration may be longer.
LONGEST_S = 1e15
# What a share of the processor may be above 1 by rounding of its terms.
ROUNDING = 1e-12


def ticks_of(duration: Value | None, scope: Mapping[str, float], time_scale: float = 1.0) -> int:
    """A duration in ticks of problem time, 0 where it is not given."""
    if duration is None:
        return 0
    seconds = duration.number(scope) * time_scale
    if seconds > LONGEST_S:
        raise PatchError(
            f"{duration.what} is {seconds:g} s; at most {LONGEST_S:g} s are possible",
            duration.place,
        )
    ticks = to_ticks(seconds)
    if duration.positive and ticks == 0:
        raise PatchError(
            f"{duration.what} is {seconds:g} s, below a femtosecond, the resolution of time; "
            "give a longer one",
            duration.place,
        )
    return ticks


def processor_of(program: Program, scope: Mapping[str, float]) -> Processor | None:
    """The operation times of the digital machine; None where there are none."""
    settings = program.processor
    if settings is None:
        return None
    if settings.name:
        return PROCESSORS[settings.name]
    time_s = {name: value.number(scope) for name, value in settings.times.items()}
    return Processor(
        "",
        "",
        time_s["add"],
        time_s["multiply"],
        time_s["divide"],
        time_s.get("store", 0.0),
        time_s.get("square_root"),
    )


def counted_ticks(
    program: Program, tape: Tape, number: int, scope: Mapping[str, float], time_scale: float
) -> int:
    """The compute time of one of the programs, counted from its operations."""
    processor = processor_of(program, scope)
    assert processor is not None
    return to_ticks(processor.time_s(program_operations(tape, number)) * time_scale)


def task_timings(
    program: Program, tape: Tape, scope: Mapping[str, float], time_scale: float
) -> tuple[TaskTiming, ...]:
    """The tasks by name, ranked: by priority (without any: those that comparators start first, then the
    shorter the period, the higher), then by name. Raises PatchError where cycles would pile up."""
    ranks, periods = ranks_of(program, scope), [ticks_of(t.period, scope) for t in program.tasks]
    tasks = tuple(
        TaskTiming(
            task.name,
            periods[number],
            ticks_of(task.phase, scope),
            ticks_of(task.compute_time, scope, time_scale)
            if task.compute_time
            else counted_ticks(program, tape, number, scope, time_scale),
            ranks[number],
            task.overrun,
            task.place,
            _jitter(task, periods[number], scope, time_scale),
            task.when,
        )
        for number, task in enumerate(program.tasks)
    )
    _refuse_piling_up(tasks)
    return tasks


def ranks_of(program: Program, scope: Mapping[str, float]) -> tuple[int, ...]:
    """Who goes first on the processor: a rank for each task, 0 before all others."""

    def place(number: int) -> tuple[int, str]:
        task = program.tasks[number]
        first = ticks_of(task.period, scope) if task.priority is None else -task.priority
        return first, task.name

    order = sorted(range(len(program.tasks)), key=place)
    return tuple(order.index(number) for number in range(len(order)))


def _jitter(task: Task, period: int, scope: Mapping[str, float], time_scale: float) -> int:
    """How late the clock of a task may be: so little that no cycle begins before the one before."""
    jitter = ticks_of(task.jitter, scope, time_scale)
    if task.jitter and jitter >= period:
        raise PatchError(
            f"{task.jitter.what} is {to_seconds(jitter):g} s; it must be shorter than the period, "
            f"{to_seconds(period):g} s",
            task.jitter.place,
        )
    return jitter


def _refuse_piling_up(tasks: tuple[TaskTiming, ...]) -> None:
    total = utilisation(tasks)
    queued = next((task for task in tasks if task.overrun == "queue"), None)
    if queued and total > 1.0 + ROUNDING:
        raise PatchError(
            f"the tasks ask for {100 * total:.4g} % of the processor's time, and the cycles of task "
            f"{queued.name!r} would pile up (overrun: queue); lengthen a period, shorten a "
            "compute_time, or give overrun: skip or stop",
            queued.place,
        )


def task_of_adc(adc: Adc, program: Program, ranks: Sequence[int]) -> int:
    """The task whose clock samples an ADC: the one it names, else of those that read it the first by
    rank, else (nobody reads it) the first of all. Tasks that wait for a comparator come last: a loop
    would stand still until then."""
    if adc.task is not None:
        return next(i for i, task in enumerate(program.tasks) if task.name == adc.task)
    readers = [i for i, single in enumerate(program.programs) if adc.name in read_by(single)]
    return min(
        readers or range(len(ranks)), key=lambda i: (program.tasks[i].when is not None, ranks[i])
    )


def read_by(program: Program) -> frozenset[str]:
    """Every name that the arithmetic of a program reads at present."""
    return frozenset().union(*(names(expr) for entry in program.written for expr in entry.reads))


def task_of_dac(dac: Dac, program: Program) -> int:
    """The task that ends when a DAC shows its word: the one it names, else the one that computes it."""
    if dac.transfer is not None:
        return next(i for i, task in enumerate(program.tasks) if task.name == dac.transfer)
    return next(i for i, single in enumerate(program.programs) if dac.word in single.words)
