"""Words that grow without end: a digital program has no full scale by which to tell that it runs away.

Stage 5. Where the analog machine runs away the run is stopped; a program's numbers go on to 1e308.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.machine import Floats, Pen

# In exponential growth the second half of a run is as many times larger than the first half as that
# is than its beginning. Neither bound is met by numbers in SI units that mean something.
RUNAWAY_GROWTH = 1e12
RUNAWAY_VALUE = 1e18
MOST_NAMED = 3


def growing(pens: Sequence[Pen], rows: Floats) -> list[str]:
    """The words of a record (rows, pens) that have run away, the largest first."""
    half = len(rows) // 2
    if not half:
        return []
    found = []
    for i, pen in enumerate(pens):
        if pen.kind != "word":
            continue
        before, after = (float(np.abs(part[:, i]).max()) for part in (rows[:half], rows[half:]))
        if after > RUNAWAY_VALUE and 0.0 < before < after / RUNAWAY_GROWTH:
            found.append((-after, pen.name))
    return [name for _, name in sorted(found)]


def growth_text(pens: Sequence[Pen], rows: Floats) -> str:
    """What to say of them; ''."""
    names = growing(pens, rows)
    if not names:
        return ""
    column = next(i for i, pen in enumerate(pens) if pen.name == names[0])
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    largest = float(np.abs(rows[:, column]).max())
    return (
        f"the program runs away: {', '.join(names[:MOST_NAMED])}{more} grew more than "
        f"{RUNAWAY_GROWTH:.0e} times from one half of the run to the other, {names[0]} to "
        f"{largest:.2g}; it is unstable, or its step is too long"
    )
