"""What is no part of the modes of a transient: rows between cycles show the ripple of the digital
machine, the first rows what its tasks stir up at the start.

Stage 5. A record is a sum of modes at instants at which the digital machine is where it was: a cycle
apart, with several tasks the time after which all of them are where they were. Between these it holds
and steps. Rows are put together that are so far apart; what each of these groups gives has no ripple in
it, and their mean differs from what all rows give by what the ripple does. Where no clock repeats, no
group helps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hybrid.cycle_map import stretch_s
from hybrid.linearity import NotLinear
from hybrid.machine import Floats, Machine
from hybrid.readout import FEWEST_ROWS_PER_CYCLE, Transient, measure_transient
from hybrid.scale import to_seconds, to_ticks

# Groups of rows that are measured, evenly among those that there are.
MOST_GROUPS = 16
# Rounds of the tasks in which what the start of a run stirs up has mostly died.
STARTING = 5
# A shift by more than this many deviations is none of noise.
DEVIATIONS = 2.0
FIGURES = ("omega", "omega_damped", "zeta")


@dataclass(frozen=True, slots=True)
class Repeat:
    """After how many ticks the digital machine is where it was, 0 for never and without one; `reason`:
    why never."""

    ticks: int = 0
    reason: str = ""


def repeat_of(machine: Machine) -> Repeat:
    """What one program repeats is its cycle."""
    tasks = machine.timing.tasks
    late = [task.name for task in tasks if task.jitter]
    if late:
        return Repeat(reason=f"the clock of {late[0]} jitters")
    called = [task.name for task in tasks if task.when]
    if called:
        return Repeat(reason=f"a comparator starts {called[0]}")
    if not tasks:
        return Repeat(machine.timing.period)
    try:
        return Repeat(to_ticks(stretch_s(machine)))
    except NotLinear:
        return Repeat(reason="the tasks do not come back to where they were")


def with_ripple(
    found: Transient, values: Floats, row_ticks: int, machine: Machine
) -> tuple[Transient, str]:
    """The transient with the ripple in its errors, and what to say of it: '' where there is none.

    values: (rows,), those that gave `found`, `row_ticks` apart.
    """
    if found.omega is None:
        return found, ""
    repeat = repeat_of(machine)
    if repeat.reason:
        seeds = any(task.jitter for task in machine.timing.tasks)
        more = "; see how runs differ (hybrid batch --runs)" if seeds else ""
        return found, (
            f"{repeat.reason}, so the record is no sum of modes: the +- leaves out what that does{more}"
        )
    if not repeat.ticks:
        return found, ""
    if row_ticks % repeat.ticks == 0:
        several = bool(machine.timing.tasks)
        return _with_start(found, values, row_ticks, repeat.ticks) if several else (found, "")
    apart = math.lcm(repeat.ticks, row_ticks) // row_ticks
    added = _ripple(found, values, row_ticks, apart)
    own = [getattr(found, f"{name}_error") for name in FIGURES]
    if added is not None:
        errors = {f"{n}_error": e + a for n, e, a in zip(FIGURES, own, added, strict=True)}
        found = replace(found, **errors)
        if all(a <= e for e, a in zip(own, added, strict=True)):
            return found, ""
    what = "all tasks are where they were" if machine.timing.tasks else "the program begins again"
    told = "is in the +-" if added is not None else "is not in the +-"
    return found, (
        f"the rows, {to_seconds(row_ticks):g} s apart, show the ripple between the instants at which "
        f"{what}; it {told}. every: {to_seconds(repeat.ticks):g} s, or a multiple, shows the modes alone"
    )


def _with_start(
    found: Transient, values: Floats, row_ticks: int, repeat_ticks: int
) -> tuple[Transient, str]:
    """The same with what the first stretches do to it: what dies in them is no part of the mode, and yet
    large beside the noise of the rest."""
    first = -(-STARTING * repeat_ticks // row_ticks)
    if len(values) - first < len(values) / 2:
        return found, ""
    later = measure_transient(np.ascontiguousarray(values[first:]), to_seconds(row_ticks))
    if later.omega is None:
        return found, ""
    added = [abs(getattr(later, name) - getattr(found, name)) for name in FIGURES]
    far = [
        shift > DEVIATIONS * getattr(later, f"{name}_error")
        for name, shift in zip(FIGURES, added, strict=True)
    ]
    if not any(far):
        return found, ""
    errors = {
        f"{name}_error": getattr(found, f"{name}_error") + shift
        for name, shift in zip(FIGURES, added, strict=True)
    }
    return replace(found, **errors), (
        "the first rows show what dies within a few rounds of the tasks; it is in the +-. from: "
        f"{to_seconds(first * row_ticks):g} s leaves it out"
    )


def _ripple(
    found: Transient, values: Floats, row_ticks: int, apart: int
) -> tuple[float, ...] | None:
    """By how much the ripple moves each of FIGURES; None where rows so far apart cannot tell.

    apart: rows from one of a group to the next.
    """
    interval_s = to_seconds(row_ticks) * apart
    if (found.omega_damped or 0.0) * interval_s * FEWEST_ROWS_PER_CYCLE > 2.0 * math.pi:
        return None
    firsts = np.unique(np.linspace(0, apart, MOST_GROUPS, endpoint=False).astype(int))
    groups = [
        measure_transient(np.ascontiguousarray(values[first::apart]), interval_s)
        for first in firsts.tolist()
    ]
    if any(group.omega is None for group in groups):
        return None
    means = [np.mean([getattr(group, name) for group in groups]) for name in FIGURES]
    return tuple(
        abs(float(mean) - getattr(found, name)) for mean, name in zip(means, FIGURES, strict=True)
    )
