"""Figures of merit that a patch can ask of a record, by the key that asks for them.

Stage 5. Each takes the times (s) and values of one signal and gives its quantities by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from types import MappingProxyType
from typing import Any

import numpy as np

from hybrid.machine import Floats
from hybrid.readout import measure_transient

Quantities = dict[str, Any]


def transient(time_s: Floats, values: Floats) -> Quantities:
    """omega, omega_damped, zeta of the dominant mode with their errors, or None and the reason."""
    if len(time_s) < 2:
        return asdict(measure_transient(values, 1.0))
    interval_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    return asdict(measure_transient(values, interval_s))


def final(time_s: Floats, values: Floats) -> Quantities:
    """The last value and its time."""
    return _at(time_s, values, len(values) - 1)


def maximum(time_s: Floats, values: Floats) -> Quantities:
    """The largest value and its first time."""
    return _at(time_s, values, int(np.argmax(values)) if len(values) else -1)


def minimum(time_s: Floats, values: Floats) -> Quantities:
    """The smallest value and its first time."""
    return _at(time_s, values, int(np.argmin(values)) if len(values) else -1)


def rms(time_s: Floats, values: Floats) -> Quantities:
    """Root of the mean square over the rows."""
    return _whole(values, lambda v: float(np.sqrt(np.mean(v * v))))


def mean(time_s: Floats, values: Floats) -> Quantities:
    """Mean over the rows."""
    return _whole(values, lambda v: float(np.mean(v)))


def _at(time_s: Floats, values: Floats, row: int) -> Quantities:
    if row < 0:
        return {"value": None, "time_s": None, "reason": "the record has no rows there"}
    return {"value": float(values[row]), "time_s": float(time_s[row]), "reason": ""}


def _whole(values: Floats, figure: Callable[[Floats], float]) -> Quantities:
    if not len(values):
        return {"value": None, "reason": "the record has no rows there"}
    return {"value": figure(values), "reason": ""}


READOUTS: Mapping[str, Callable[[Floats, Floats], Quantities]] = MappingProxyType(
    {
        "transient": transient,
        "final": final,
        "maximum": maximum,
        "minimum": minimum,
        "rms": rms,
        "mean": mean,
    }
)
