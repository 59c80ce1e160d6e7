"""What a DAC shows ahead of its word: a straight line through the last two cycles, prolonged.

A word reaches the analog machine late by its compute time and, as the DAC holds it for a cycle, by half
a cycle more on the average. A `lead` of so much makes up for it to first order. It belongs to the
converter: where both ends are on one machine there is none.
"""

from __future__ import annotations

from dataclasses import replace

from hybrid.expressions import Binary, Call, Name
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
    """word + lead/period (word - previous(word)), and its name, which no patch can have."""
    assert dac.lead is not None
    word = Name(dac.word)
    cycles = Binary("/", dac.lead.expr, program.period.expr)
    change = Binary("-", word, Call("previous", (word,)))
    expr = Binary("+", word, Binary("*", cycles, change))
    name = f"{dac.name} ahead"
    entry = next(entry for entry in program.written if entry.word == dac.word)
    made = Assignment(name, expr, dac.place, entry.dimension, hidden=True)
    remember = dict(program.remember)
    if not isinstance(entry, State):
        remember.setdefault(dac.word, dac.initial)
    lengths = dict(program.lengths)
    if dac.word in lengths:
        lengths[name] = lengths[dac.word]
    assignments = (*program.assignments, made)
    return replace(program, assignments=assignments, remember=remember, lengths=lengths), name
