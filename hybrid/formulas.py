"""Integration formulas of the digital machine: pure coefficients.

Stage 0. For x' = f(x), a step h and f_n = f(x_n):

multistep (Adams-Bashforth, of which Euler is the first):  x_{n+1} = x_n + h sum_j b_j f_{n-j};
Runge-Kutta:  k_i = f(x_n + h sum_j a_ij k_j),  x_{n+1} = x_n + h sum_i b_i k_i.

rk2 is Heun's (the average slope of start and end), rk3 Kutta's, rk4 the classical one. Coefficients as
in Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, sections II.1 and III.1; tests
check them against the order conditions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

# Weights of the rates of this cycle, the one before, and so on.
MULTISTEP: Mapping[str, tuple[float, ...]] = {
    "euler": (1.0,),
    "ab2": (3 / 2, -1 / 2),
    "ab3": (23 / 12, -16 / 12, 5 / 12),
    "ab4": (55 / 24, -59 / 24, 37 / 24, -9 / 24),
}


@dataclass(frozen=True, slots=True)
class RungeKutta:
    """Weights of the earlier rates in each stage after the first, and in the step."""

    stages: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]


RUNGE_KUTTA: Mapping[str, RungeKutta] = {
    "rk2": RungeKutta(((1.0,),), (1 / 2, 1 / 2)),
    "rk3": RungeKutta(((1 / 2,), (-1.0, 2.0)), (1 / 6, 4 / 6, 1 / 6)),
    "rk4": RungeKutta(((1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)), (1 / 6, 2 / 6, 2 / 6, 1 / 6)),
}
FORMULAS = (*MULTISTEP, *RUNGE_KUTTA)
DEFAULT_FORMULA = "ab2"


def past_rates(formula: str) -> int:
    """How many rates of earlier cycles a formula needs."""
    return len(MULTISTEP[formula]) - 1 if formula in MULTISTEP else 0


def starter(formula: str) -> str:
    """The Runge-Kutta formula of the same order, which starts a multistep formula."""
    return f"rk{len(MULTISTEP[formula])}"
