"""What is noted of a signal beyond its range, and how it is told. Stage 4."""

from __future__ import annotations

from dataclasses import dataclass, replace

from hybrid.engine.arrays import Floats

# A lag that settles at full scale may stand above it by rounding.
FULL_SCALE = 1.0 + 1e-12
# Steps in which an instant is found by bisection: more than a fraction of an interval has bits.
HALVINGS = 60
# Columns of the notes of a signal beyond full scale: when first and its value then, the worst value and
# when, how long altogether, in how many windows or stretches.
FIRST_S, FIRST_VALUE, WORST_VALUE, WORST_S, BEYOND_S, TIMES = range(6)
# Tells the overload of a DAC's input from that of the analog signal it drives.
DAC_SUFFIX = " (DAC)"


@dataclass(frozen=True, slots=True)
class Overload:
    """One signal beyond its range: first and worst instant and value, in machine units."""

    signal: str
    time_s: float
    value_mu: float
    worst_mu: float
    worst_time_s: float
    instants: int
    duration_s: float | None = None  # of analog signals; converters and words have none


def with_notes(signal: str, at_instants: Overload | None, notes: Floats) -> Overload:
    """An overload as the instants show it, if they do, and as it was noted between them."""
    first_s, first, worst, worst_s, duration_s, times = notes.tolist()
    if at_instants is None:
        return Overload(signal, first_s, first, worst, worst_s, 0, duration_s)
    found = replace(at_instants, duration_s=duration_s)
    if times and first_s < found.time_s:
        found = replace(found, time_s=first_s, value_mu=first)
    if abs(worst) > abs(found.worst_mu):
        found = replace(found, worst_mu=worst, worst_time_s=worst_s)
    return found
