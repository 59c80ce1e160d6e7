"""The predicted mode that stands beside a measured one. Stage 0: imports nothing of the project."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any


def mode_beside(
    measured: Mapping[str, Any], modes: Sequence[Mapping[str, Any]]
) -> Mapping[str, Any] | None:
    """The predicted mode that a measured one is, by its place in the plane; None where there is none.

    Two real poles as one mode have `poles` and `ideal_poles` besides, the rates at which they decay.
    """
    if measured.get("omega") is None:
        return None
    candidates = [m for m in (*modes, *_real_pairs(measured, modes)) if m["omega"] > 0]

    def distance(mode: Mapping[str, Any]) -> float:
        along = mode["zeta"] * mode["omega"] - measured["zeta"] * measured["omega"]
        across = mode["omega_damped"] - measured["omega_damped"]
        return math.hypot(along, across)

    return min(candidates, key=distance, default=None)


def _real_pairs(
    measured: Mapping[str, Any], modes: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Every two real poles as the one mode that a transient of both is measured as.

    Beside an overdamped measurement only: it has omega and zeta of two poles together, the prediction
    lists each of them alone.
    """
    if not measured.get("omega") or measured["omega_damped"] > 0:
        return []
    real = [m for m in modes if m["omega"] > 0 and m["omega_damped"] == 0]
    pairs = []
    for one, other in itertools.combinations(real, 2):
        made = _as_one(one["zeta"] * one["omega"], other["zeta"] * other["omega"])
        if made is None:
            continue
        ideals = [m["zeta_ideal"] * m["omega_ideal"] for m in (one, other) if _is_real_ideal(m)]
        ideal = _as_one(*ideals) if len(ideals) == 2 else None
        pairs.append(
            {
                "omega": made[0],
                "omega_damped": 0.0,
                "zeta": made[1],
                "omega_ideal": ideal[0] if ideal else None,
                "zeta_ideal": ideal[1] if ideal else None,
                "closed_form": None,
                "poles": [m["zeta"] * m["omega"] for m in (one, other)],
                "ideal_poles": ideals,
            }
        )
    return pairs


def _is_real_ideal(mode: Mapping[str, Any]) -> bool:
    """Whether the ideal of a mode is a real pole too; |zeta| of one is 1 but for rounding."""
    zeta = mode["zeta_ideal"]
    return zeta is not None and abs(abs(zeta) - 1.0) < 1e-12


def _as_one(p: float, q: float) -> tuple[float, float] | None:
    """omega and zeta of two real poles that decay at the rates p and q; None where one grows alone."""
    if p * q <= 0:
        return None
    omega = math.sqrt(abs(p)) * math.sqrt(abs(q))
    return omega, 0.5 * (p / omega + q / omega)
