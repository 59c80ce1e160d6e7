"""Noise sources that the nonlinear engine plays in windows so short that a run takes very long.

Stage 5. A source that reaches what is not linear is shown as it swings, not by its averages alone:
windows are at most 1/32 of the time in which it forgets, however slow all else is.
"""

from __future__ import annotations

from hybrid.machine import Machine
from hybrid.scale import to_seconds

# Elements times windows that take about a minute, at some 0.3 us each with noise.
MOST_PLAYED = 2e8


def short_windows(machine: Machine) -> str:
    """Which source makes the run of this machine long, and what would do; '' where none does."""
    if not machine.elements:
        return ""
    from hybrid.engine.wiring import distorted_noise

    lengths_s = distorted_noise(dict(machine.elements))
    if not lengths_s:
        return ""
    until_s, name = to_seconds(machine.timing.until), min(lengths_s, key=lambda n: lengths_s[n])
    windows = until_s / lengths_s[name]
    if windows * len(machine.elements) <= MOST_PLAYED:
        return ""
    a_second = machine.time_scale / lengths_s[name]
    source = next(c for c in machine.patch.components if c.name == name.partition(":")[0])
    bandwidth = source.values["bandwidth"].number(machine.parameters)
    would_do = bandwidth * MOST_PLAYED / (windows * len(machine.elements))
    place = f"{source.place}: " if str(source.place) else ""
    return (
        f"{place}noise source {source.name!r} reaches parts that are not linear, and its bandwidth of "
        f"{bandwidth:.4g} rad/s asks for {a_second:.2g} windows in a second of the machine, "
        f"{windows:.2g} in this run; with one of {would_do:.1g} rad/s it would take about a minute"
    )
