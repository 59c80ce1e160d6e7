"""Which analog signals stand still but where they jump: what comparators, relays, DACs and stepping
sources give, and what parts without a memory make of nothing else.

Stage 4, for the record. Charts draw such a signal as steps, not as ramps from row to row.
"""

from __future__ import annotations

from hybrid.components import CATALOG
from hybrid.machine import Machine
from hybrid.patch import Component
from hybrid.scale import to_seconds


def stepwise_signals(machine: Machine) -> frozenset[str]:
    """Their names; one whose own lag is no shorter than the rows are apart, so that they show it, is not
    among them, nor is what it drives."""
    every_s = to_seconds(machine.timing.every)
    quick = {name for name, stage in machine.stages.items() if stage.tau < every_s}
    kinds = {c.name: CATALOG[c.kind] for c in machine.patch.components}
    found = {dac.name for dac in machine.patch.dacs} | {n for n, k in kinds.items() if k.jumps}
    found &= quick
    # A loop of parts through each other may be anything, so it is not found.
    waiting = [
        c
        for c in machine.patch.components
        if kinds[c.name].passes_jumps and c.name in quick and not _droops(machine, c)
    ]
    while new := {c.name for c in waiting if found.issuperset(c.sources)} - found:
        found |= new
    return frozenset(found)


def _droops(machine: Machine, component: Component) -> bool:
    """Whether it loses what it stores."""
    own = component.values.get("leak")
    given = own.number(machine.parameters) if own else 0.0
    return given + machine.stages[component.name].leak > 0.0
