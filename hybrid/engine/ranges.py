"""Which functions of the program were asked beyond their range, and when first. Stage 4."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid.engine.helper_functions import PER_SITE, SIDES, TIMES, VALUE, WORST
from hybrid.engine.linear import Player
from hybrid.errors import known_as
from hybrid.scale import to_seconds
from hybrid.tables import ACTIONS, ENDLESS, STOPS
from hybrid.tape import Site

# A value that differs from an end of the range only beyond these is told with by how much.
MOST_DIGITS = 9


@dataclass(frozen=True, slots=True)
class Outside:
    """One place in the program that asked beyond the range of a function, on one side; SI units."""

    site: Site
    argument: int
    value: float  # the first
    worst: float  # the farthest out
    time_s: float  # of the first
    times: int

    @property
    def range(self) -> tuple[float, float]:
        """From where to where the function is defined along that argument."""
        return self.site.ranges[self.argument]

    @property
    def action(self) -> int:
        """What was done."""
        return self.site.actions[self.argument][self.value > self.range[1]]

    def facts(self) -> dict[str, Any]:
        """For JSON and the record."""
        return {
            "function": known_as(self.site.function),
            "word": known_as(self.site.word),
            "argument": self.site.arguments[self.argument],
            "value": self.value,
            "worst": self.worst,
            "range": [end if abs(end) < ENDLESS else None for end in self.range],
            "units": self.site.units[self.argument],
            "time_s": self.time_s,
            "times": self.times,
            "action": ACTIONS[self.action],
        }

    def __str__(self) -> str:
        site, (unit, factor) = self.site, self.site.told_in[self.argument]
        if site.table and self.argument == len(site.table.axes):
            place = f"a place beyond its points, by {self.value:.3g} of their range"
        else:
            beyond = beyond_text(self.value, *self.range, unit, factor)
            place = f"{site.arguments[self.argument]} = {beyond}"
        asked = f"{known_as(site.function)} in word {known_as(site.word)!r} was asked for {place}"
        if self.action == STOPS:
            return asked
        often = "once" if self.times == 1 else f"{self.times} times, first"
        worst = ""
        if self.worst != self.value:
            worst = f"; at worst {self.worst / factor:.6g} {unit}".rstrip()
        return f"{asked} ({often} at {self.time_s:.6g} s{worst}; {ACTIONS[self.action]})"


def beyond_text(value: float, low: float, high: float, unit: str, factor: float = 1.0) -> str:
    """A value and the range it is outside of, in digits that tell the two apart, or by how much.

    Args: all in SI units; unit, factor: in which they are told, and its SI value.
    """
    for digits in range(6, MOST_DIGITS + 1):
        told, first, last = (f"{x / factor:.{digits}g}" for x in (value, low, high))
        if told not in (first, last):
            by = ""
            break
    else:
        told, first, last = (f"{x / factor:.6g}" for x in (value, low, high))
        by = f" by {max(low - value, value - high) / factor:.1g}"
    told = f"{told} {unit}".rstrip()
    if high >= ENDLESS:
        return f"{told}, below {first}{by}"
    if low <= -ENDLESS:
        return f"{told}, above {last}{by}"
    return f"{told}, outside {first} to {last}{by}"


def outside(player: Player) -> tuple[Outside, ...]:
    """Every place that has asked so far, by first time, then by its place in the program; below and
    above the range of each argument by itself."""
    notes = player.state.outside
    found: list[Outside] = []
    if not player.machine.tape.sites:
        return ()
    for row in np.flatnonzero(notes[:-1, TIMES]).tolist():
        (site, side), note = divmod(row, PER_SITE), notes[row]
        found.append(
            Outside(
                player.machine.tape.sites[site],
                side // SIDES,
                float(note[VALUE]),
                float(note[WORST]),
                to_seconds(player.asked_ticks(row)),
                int(note[TIMES]),
            )
        )
    return tuple(sorted(found, key=lambda o: o.time_s))
