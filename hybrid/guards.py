"""What a part with corners compares, in machine units: the unit of a patch decides nothing.

Stage 3, for `circuits`. A corner is located, and a part is taken to chatter, by how far the guarded sum
is from a bound, in rounding errors of about 1. The sum that a comparator, a limiter or a function
generator reads is in problem units: 1e5 m has no such errors, and 1 nm is all error.
"""

from __future__ import annotations

from dataclasses import replace

from hybrid.elements import PIECES, Element


def in_machine_units(element: Element) -> Element:
    """The same element with the sum it guards in units of its largest term at full scale."""
    unit = max(map(abs, element.first.values()), default=0.0)
    if element.kind != PIECES or unit == 0.0:
        return element
    pieces = [
        (low / unit, high / unit, at / unit, c0, c1 * unit, c2 * unit * unit)
        for low, high, at, c0, c1, c2 in element.pieces
    ]
    first = {signal: gain / unit for signal, gain in element.first.items()}
    return replace(element, first=first, constant=element.constant / unit, pieces=pieces)
