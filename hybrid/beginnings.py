"""From when on the digital machine has something to show: its first samples and first results.

Stage 3. Before, a state of the program stands at its initial value; what an ADC or a word would show
is no result, so readouts and charts leave it out. The record has 0 there.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Set

from hybrid.clockwork import Happening
from hybrid.machine import Floats, Machine
from hybrid.timeline import Timeline, stretches_of


def initial_words(machine: Machine) -> Floats:
    """What every word shows before its first result, (words,) in SI units: a state its initial value, a
    word that other tasks read its first one."""
    return machine.tape.registers[machine.tape.word_registers]


def first_results(machine: Machine, timeline: Timeline, seed: int) -> dict[str, float]:
    """Tick from which on each ADC and each word shows what it has found; infinite where the run ends
    before. States are not among them, having a value from the start, nor what a task has that waits for
    a comparator: when that is, only the run shows.
    """
    tasks = machine.timing.tasks
    clocked = [i for i in range(max(len(tasks), 1)) if not (tasks and tasks[i].when)]
    samplers = {
        (Happening.CONVERT, i): s for i, s in enumerate(machine.samplers) if s.task in clocked
    }
    wanted = {*samplers, *((Happening.END, task) for task in clocked)}
    found = _first_of_each(machine, timeline, seed, wanted)
    tape = machine.tape
    firsts = {sampler.name: found.get(kind, math.inf) for kind, sampler in samplers.items()}
    states = set(tape.states[:, 0].tolist())
    starts = tape.starts[:, 1].tolist()
    for task, (first, last) in enumerate(itertools.pairwise(starts)):
        for word in range(first, last):
            if tape.word_registers[word] not in states and task in clocked:
                firsts[tape.words[word]] = found.get((Happening.END, task), math.inf)
    return firsts


def _first_of_each(
    machine: Machine, timeline: Timeline, seed: int, wanted: Set[tuple[Happening, int]]
) -> dict[tuple[Happening, int], float]:
    """Tick of the first of each that is wanted: conversions of an ADC, ends of a program."""
    found: dict[tuple[Happening, int], float] = {}
    pieces = ((segment.start, segment.events) for segment in timeline.segments)
    if timeline.later:  # laid out once more: that of the run goes on by itself
        pieces = ((at, tuple(events)) for at, _, _, events in stretches_of(machine, seed))
    for start, events in pieces:
        for offset, kind, index in events:
            if (kind, index) in wanted:
                found.setdefault((Happening(kind), index), start + offset)
        if len(found) == len(wanted):
            break
    return found
