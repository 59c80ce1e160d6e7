"""Modes of a sweep from point to point: each goes on as the one that it was.

Stage 0: imports nothing of the project. At a single point the ideal stands beside the nearest mode. Of
the pitch loop that is, beyond omega_p T = 2, another root than the one that began as the pitch mode at
small T.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

# Ideals that are the same: they differ by rounding alone.
SAME = 1e-9

Mode: TypeAlias = Mapping[str, Any]
IDEAL = ("omega_ideal", "zeta_ideal")


def followed(points: Sequence[Sequence[Mode]]) -> list[list[Mode | None]]:
    """The modes of each point in columns, the ideal of a column beside the mode that it began as.

    Args: points: modes of each point, by swept value, as `Prediction.to_dicts` has them. First come
    columns of the modes that are meant at the first point with any, then the others; None where a column
    has no mode. Where the ideals change from point to point every mode keeps its own, as they come.
    """
    first = next((modes for modes in points if any(map(_is_meant, modes))), [])
    begun = [mode for mode in first if _is_meant(mode)]
    last, columns = list(begun), []
    for modes in points:
        present = _columns_of(begun, [mode for mode in modes if _is_meant(mode)])
        if present is None:
            return [list(modes) for modes in points]
        found: list[Mode | None] = [None] * len(begun)
        free = list(range(len(modes)))
        pairs = sorted((_apart(last[c], modes[i]), c, i) for c in present for i in free)
        for _, column, i in pairs:
            if found[column] is None and i in free:
                free.remove(i)
                found[column] = last[column] = _with_ideal_of(modes[i], begun[column])
        columns.append([*found, *(_with_ideal_of(modes[i], None) for i in free)])
    return columns


def _columns_of(begun: Sequence[Mode], meant: Sequence[Mode]) -> list[int] | None:
    """The columns whose ideals these modes have; None where one has another ideal."""
    found: list[int] = []
    for mode in meant:
        same = (c for c, b in enumerate(begun) if c not in found and _same_ideal(b, mode))
        column = next(same, None)
        if column is None:
            return None
        found.append(column)
    return found


def _is_meant(mode: Mode) -> bool:
    value = mode["omega_ideal"]
    return value is not None and math.isfinite(value)


def _same_ideal(one: Mode, other: Mode) -> bool:
    apart = abs(_s(one, "_ideal") - _s(other, "_ideal"))
    return apart <= SAME * abs(float(one["omega_ideal"]))


def _apart(one: Mode, other: Mode) -> float:
    return abs(_s(one) - _s(other))


def _s(mode: Mode, which: str = "") -> complex:
    """The mode in the upper half plane; at rest where it has no damping ratio."""
    omega, zeta = mode[f"omega{which}"], mode[f"zeta{which}"]
    if zeta is None or math.isnan(zeta):
        return 0j
    return complex(-zeta * omega, omega * math.sqrt(max(1.0 - zeta * zeta, 0.0)))


def _with_ideal_of(mode: Mode, of: Mode | None) -> Mode:
    """The mode beside the ideal of another, or beside none."""
    nothing = dict.fromkeys(IDEAL, math.nan)
    return {**mode, **({key: of[key] for key in IDEAL} if of else nothing)}
