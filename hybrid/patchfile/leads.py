"""What a DAC shows ahead of its word: a straight line through the last two cycles, prolonged.

A word reaches the analog machine late by its compute time and, as the DAC holds it for a cycle, by half
a cycle more on the average. A `lead` of so much makes up for it to first order. It belongs to the
converter: where both ends are on one machine there is none. The cycles are those of the word's task. The
first of them knows none before it, and shows the word itself.
"""

from __future__ import annotations

from dataclasses import replace

from hybrid.errors import PatchError
from hybrid.expressions import Binary, Call, Name
from hybrid.integration import FIRST
from hybrid.patch import Assignment, Dac, Patch, Program, State


def with_leads(patch: Patch) -> Patch:
    """The patch with a word, unseen, for what every DAC that leads shows."""
    program, dacs = patch.program, []
    for dac in patch.dacs:
        if dac.lead is None or program is None:
            dacs.append(dac)
            continue
        program, ahead = _led(dac, program)
        dacs.append(replace(dac, word=ahead))
    return replace(patch, dacs=tuple(dacs), program=program)


def _led(dac: Dac, program: Program) -> tuple[Program, str]:
    """word + lead/period (word - the word before), and its name, which no patch can have."""
    task = next((t for t in program.tasks if dac.word in (*t.words, *t.states)), None)
    period = task.period if task else program.period
    if period is None:
        raise PatchError(
            f"DAC {dac.name!r} has a lead, but a comparator starts the task of {dac.word!r}: its cycles "
            "have no period; leave lead: out",
            dac.place,
        )
    assert dac.lead is not None
    word = Name(dac.word)
    cycles = Binary("/", dac.lead.expr, period.expr)
    before = Call("select", (Name(FIRST), word, Call("previous", (word,))))
    expr = Binary("+", word, Binary("*", cycles, Binary("-", word, before)))
    name = f"{dac.name} ahead"
    entry = next(entry for entry in program.written if entry.word == dac.word)
    made = Assignment(name, expr, dac.place, entry.dimension, hidden=True)
    remember = dict(program.remember)
    if not isinstance(entry, State):
        remember.setdefault(dac.word, dac.initial)
    lengths = dict(program.lengths)
    if dac.word in lengths:
        lengths[name] = lengths[dac.word]
    own = set(task.words) if task else set(program.words)
    at = max((i + 1 for i, a in enumerate(program.assignments) if a.word in own), default=0)
    assignments = (*program.assignments[:at], made, *program.assignments[at:])
    tasks = tuple(replace(t, words=(*t.words, name)) if t is task else t for t in program.tasks)
    return replace(
        program, assignments=assignments, remember=remember, lengths=lengths, tasks=tasks
    ), name
