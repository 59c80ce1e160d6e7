"""Which overload indicators are lit: each signal once, as a converter is not the signal it makes.

Stage 5, for `runs` and `endings`.
"""

from __future__ import annotations

from dataclasses import replace

from hybrid.engine.beyond import DAC_SUFFIX, Overload
from hybrid.engine.linear import Player


def overloads_of(player: Player) -> tuple[Overload, ...]:
    """Every signal that went beyond its range so far, by first time, then name.

    A word beyond the range of its DAC is an overload of "NAME (DAC)". What the DAC makes of it is at the
    end of the range from then on, and above it by tolerance and noise, or beyond it where converters do
    not clip: the same overload, seen a lag later, which tells no more than how long it lasted. The
    output is an overload of its own where it was beyond full scale before.
    """
    found = {overload.signal: overload for overload in player.overloads()}
    kept = dict(found)
    for name, output in found.items():
        of_dac = found.get(name + DAC_SUFFIX)
        if of_dac and of_dac.time_s <= output.time_s:
            kept[of_dac.signal] = replace(of_dac, duration_s=output.duration_s)
            del kept[name]
    return tuple(kept.values())
