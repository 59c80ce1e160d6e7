"""What the tasks of a machine do on their processor: when, from when on it repeats, and how well.

Stage 3. `processor` plays the tasks; here it is asked how far it must be played, and what the cycles of
each task came to.
"""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from hybrid.clockwork import Cycles, Event
from hybrid.errors import PatchError
from hybrid.machine import Machine, TaskTiming, utilisation
from hybrid.processor import MOST_BEHIND, Duty, FallsBehind, Note, Processor, TaskClock
from hybrid.scale import to_seconds


@dataclass(frozen=True, slots=True)
class Rota:
    """The events and notes of all tasks until before some instant, in the processor's order."""

    events: tuple[Event, ...]
    notes: tuple[Note, ...]
    stopped: Note | None = None  # the first overrun of a task that stops the run


def duty_of(machine: Machine) -> Duty:
    """The tasks with the converters that each serves."""
    tasks = []
    for number, task in enumerate(machine.timing.tasks):
        channels = [
            (i, s.delay_ticks, s.conversion_ticks)
            for i, s in enumerate(machine.samplers)
            if s.task == number
        ]
        dacs = [i for i, h in enumerate(machine.holders) if h.task == number]
        tasks.append(
            TaskClock(
                task.period,
                task.phase,
                task.compute,
                task.rank,
                task.overrun,
                tuple(channels),
                tuple(dacs),
            )
        )
    return Duty(tuple(tasks), machine.timing.preemptive)


def cycles_of(machine: Machine) -> Cycles:
    """The clock of a machine's one program, and of the record."""
    timing = machine.timing
    channels = tuple((s.delay_ticks, s.conversion_ticks) for s in machine.samplers)
    return Cycles(timing.period, timing.compute, timing.every, channels, len(machine.holders))


def rota_until(machine: Machine, until: int) -> Rota:
    """What the tasks do before the instant `until`; raises PatchError where one falls ever further
    behind."""
    try:
        return _rota(duty_of(machine), until)
    except FallsBehind as error:
        raise _behind(machine, error) from None


def settled(machine: Machine, stretch: int, most_events: int) -> tuple[int, int] | None:
    """After how many stretches (at least one) the tasks repeat what they do, and how many stretches
    that takes, where the first is a multiple of the second; None where it is not found in the run or
    within `most_events` events. Raises PatchError as `rota_until` does."""
    try:
        return _settled(duty_of(machine), stretch, machine.timing.until, most_events)
    except FallsBehind as error:
        raise _behind(machine, error) from None


def _behind(machine: Machine, error: FallsBehind) -> PatchError:
    task = machine.timing.tasks[error.task]
    total = utilisation(machine.timing.tasks)
    return PatchError(
        f"task {task.name!r} falls more than {MOST_BEHIND} cycles behind: the processor is asked for "
        f"{100 * total:.4g} % of its time; lengthen a period, shorten a compute_time, or leave cycles "
        "out with overrun: skip",
        task.place,
    )


def overrun_text(machine: Machine, note: Note) -> str:
    """Why the run ends at the overrun of a task that is to stop it."""
    return (
        f"task {machine.timing.tasks[note.task].name!r} has overrun: it had not finished its cycle when "
        "the next was due, and it has overrun: stop"
    )


# Runs, checks and predictions of one machine ask for the same.
@functools.lru_cache(maxsize=8)
def _rota(duty: Duty, until: int) -> Rota:
    processor = Processor(duty)
    processor.run(until)
    return Rota(tuple(processor.log), tuple(processor.notes), processor.stopped)


@functools.lru_cache(maxsize=64)
def _settled(duty: Duty, stretch: int, until: int, most_events: int) -> tuple[int, int] | None:
    """Played until the state at the end of a stretch, seen from there, is one that has been before.

    Where it differs only by how long cycles have waited, those that end have begun since, as they will
    again, and the others never end: the next stretches repeat, not the ones before.
    """
    processor, number = Processor(duty), 0
    seen: dict[tuple[object, ...], tuple[int, tuple[object, ...]]] = {}
    while len(processor.log) <= most_events and number * stretch <= until:
        state, aged = processor.state(ages=False), processor.state()
        if state in seen:
            before, its = seen[state]
            again, first = number - before, before if its == aged else number
            return max(-(-first // again), 1) * again, again
        seen[state] = number, aged
        number += 1
        processor.run(number * stretch)
    return None


# -- how well the tasks did -------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class TaskReport:
    """What the cycles of one task came to; times in s of problem time, None where no cycle ended."""

    task: str
    cycles: int  # finished
    overruns: int  # ticks of its clock at which the cycle before was not finished
    worst_response_s: float | None  # from the tick to the results
    utilisation: (
        float  # share of the processor's time that it asks for: all its cycles that are due
    )
    waiting: int = 0  # of those that queue: due, and not begun at the end


def fold(done: Mapping[Note, int], notes: Iterable[Note]) -> dict[Note, int]:
    """The notes of a long run in few: their numbers, and of each task the slowest cycle."""
    found = dict(done)
    for note in notes:
        short = Note(0, note.task, note.response, note.called)
        found[short] = found.get(short, 0) + 1
    return found


def reports(
    machine: Machine, notes: Iterable[tuple[Note, int]], played: int
) -> tuple[TaskReport, ...]:
    """Of every task, by name, after `played` ticks; `notes` with how often each stands for a cycle."""
    cycles, overruns, calls = Counter[int](), Counter[int](), Counter[int]()
    worst = dict[int, int]()
    for note, times in notes:
        if note.called:
            calls[note.task] += times
        elif note.response is None:
            overruns[note.task] += times
        else:
            cycles[note.task] += times
            worst[note.task] = max(worst.get(note.task, 0), note.response)
    return tuple(
        TaskReport(
            task.name,
            cycles[i],
            overruns[i],
            to_seconds(worst[i]) if i in worst else None,
            task.compute / task.period if task.period else task.compute * calls[i] / max(played, 1),
            _waiting(task, calls[i] or _ticks(task, played), cycles[i], overruns[i]),
        )
        for i, task in enumerate(machine.timing.tasks)
    )


def _ticks(task: TaskTiming, played: int) -> int:
    """How often its clock has ticked for certain: where it jitters, the last may be yet to come."""
    if not task.period:
        return 0
    return max(0, (played - task.phase - task.jitter) // task.period + 1)


def _waiting(task: TaskTiming, due: int, ended: int, overruns: int) -> int:
    """Of the cycles that were due, those that wait behind the one that is under way."""
    return min(max(due - ended - 1, 0), overruns) if task.overrun == "queue" else 0
