"""Speed: digital cycles per second of wall time, beside a hand-written loop and python-control.

The loop is the pitch loop of five elements: DAC, coefficient, two integrators, summer. A figure of
Hybrid is one whole call of `hybrid.run`: patch compiled, clockwork laid out, run played, a row of
the record kept every cycle. Beside it, in the same rounds,

  numba loop      what one would write by hand for this one loop: the exact propagator of a cycle
                  found once by scipy, then compiled loops over fixed sizes
  python-control  the same loop as a discrete state-space system, played by `initial_response`; for
                  the sweep, `damp` of the sampled loop at every T (which predicts, but measures
                  nothing)

All are called once before anything is timed, then in turn; a figure is the median of its repeats.
The line at the end says whether the programs computed the same thing (difference of the records
below 32 u a cycle, u = 2^-53), not whether a goal was met: a goal stands beside each figure.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from bench import Options, Table, finish, parse_options
from peers.by_control import control_damping, control_run
from peers.by_hand import hand_loop
from peers.pitch_loop import BITS, OMEGA_P, PERIOD_S, THETA_0

import hybrid

ROUNDING = 32 * 2.0**-53  # a cycle: 8 states, 4 roundings each

FIVE_ELEMENTS = f"""
title: Pitch loop of five elements
parameters: {{omega_p: {OMEGA_P} rad/s, cycle: {PERIOD_S} s, until: 10 s}}
analog:
  theta_ddot: {{coefficient: {{moment: 1}}, full_scale: omega_p**2, unit: rad/s^2}}
  theta_dot: {{integrate: {{theta_ddot: 1}}, initial: 0 rad/s, full_scale: omega_p, unit: rad/s}}
  theta: {{integrate: {{theta_dot: 1}}, initial: {THETA_0} rad, full_scale: 1 rad}}
  alpha: {{sum: {{theta: 1}}, full_scale: 1 rad}}
interface:
  sample: {{adc: alpha, bits: {BITS}}}
  moment: {{dac: answer, bits: {BITS}, full_scale: omega_p**2, unit: rad/s^2, initial: 0 rad/s^2}}
digital:
  period: cycle
  program: {{answer: -omega_p**2 * sample}}
run: {{until: until}}
record: [theta]
"""

TIMES_CONTROL = 50.0  # goal of every row that stands beside python-control

QUIET = "machine: {preset: nominal, noise: 0, tolerance: 0}\n"

MEETS = ("meets_goal", "meets_goal_over_control")

Timed = Mapping[str, Callable[[], Any]]


# -- timing -----------------------------------------------------------------------------------------


def medians_s(candidates: Timed, repeats: int) -> dict[str, float]:
    """Median wall time of each candidate: one call to warm up, then all in turn."""
    for call in candidates.values():
        call()
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(repeats):
        for name, call in candidates.items():
            began = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - began)
    return {name: statistics.median(values) for name, values in times.items()}


def run_rows(options: Options) -> list[dict[str, Any]]:
    """Cycles per second of single runs."""
    patch = hybrid.parse_patch(FIVE_ELEMENTS)
    long, slow = (40_000, 2_000) if options.quick else (900_000, 20_000)
    repeats = 3 if options.quick else 9
    cases = (
        ("ideal integrators and converters", "ideal", long, None),
        ("five lags of 1 us, ideal converters", "lags", long, 1e7),
        ("the same, 10 s at T = 1 ms", "lags", 10_000, None),
        (f"five lags, {BITS}-bit converters, clipping, noise", "nominal", long, 3e6),
    )
    return [run_row(patch, *case, slow, repeats) for case in cases]


def run_row(
    patch: Any, what: str, case: str, cycles: int, goal: float | None, slow: int, repeats: int
) -> dict[str, Any]:
    """One case: every program timed, and the records compared; `slow`: cycles for python-control."""

    def emulated(count: int) -> np.ndarray:
        return hybrid.run(patch, {"until": count * PERIOD_S}, machine=case).rows[:, 0]

    by_hand = hand_loop(case)
    candidates: dict[str, Callable[[], Any]] = {
        "hybrid": lambda: emulated(cycles),
        "numba": lambda: by_hand(cycles),
    }
    if case != "nominal":
        candidates["control"] = lambda: control_run(case == "lags", slow)
    taken = medians_s(candidates, repeats)
    speeds = {name: (slow if name == "control" else cycles) / s for name, s in taken.items()}
    return {
        "case": what,
        "cycles": cycles,
        "hybrid": speeds["hybrid"],
        "goal": goal,
        "numba": speeds["numba"],
        "over_numba": speeds["hybrid"] / speeds["numba"],
        "control": speeds.get("control"),
        "over_control": speeds["hybrid"] / speeds["control"] if "control" in speeds else None,
        "goal_over_control": TIMES_CONTROL if "control" in speeds else None,
        **agreement(case, emulated, slow),
    }


def agreement(case: str, emulated: Callable[[int], np.ndarray], cycles: int) -> dict[str, Any]:
    """Largest difference between the programs' records, beside what rounding may do."""
    if case == "nominal":
        # The draws differ; without noise and drawn errors both must play the same codes.
        patch = hybrid.parse_patch(FIVE_ELEMENTS + QUIET)
        quiet = hybrid.run(patch, {"until": cycles * PERIOD_S}).rows[:, 0]
        records = [quiet, hand_loop("quiet")(cycles)]
    else:
        records = [emulated(cycles), hand_loop(case)(cycles), control_run(case == "lags", cycles)]
    difference = max(float(np.max(np.abs(records[0] - other))) for other in records[1:])
    bound = ROUNDING * cycles
    return {"difference": difference, "bound": bound, "agrees": difference <= bound}


def sweep_row(options: Options) -> dict[str, Any]:
    """Seconds for a sweep of T, measured and predicted, on the shipped pitch loop."""
    count = 50 if options.quick else 1000
    periods_s = np.linspace(1e-4, 1e-2, count)
    patch = hybrid.read_patch(hybrid.shipped_patches()["pitch_loop"])
    omega_p = patch.bind(None)["omega_p"]
    swept: list[Any] = []
    candidates: Timed = {
        "hybrid": lambda: swept.append(hybrid.sweep(patch, "cycle", periods_s)),
        "numba": lambda: [hand_loop("ideal", omega_p, t)(round(10 / t)) for t in periods_s],
        "control": lambda: [control_damping(omega_p, t) for t in periods_s],
    }
    taken = medians_s(candidates, 1 if options.quick else 3)
    damped = np.array([control_damping(omega_p, t) for t in periods_s])
    figures = swept[-1].dataset[["measured_zeta", "predicted_zeta"]].isel(readout=0, mode=0)
    difference = max(float(np.max(np.abs(figures[name] - damped))) for name in figures)
    # An eigenvalue near 1 is known to a few u of a matrix whose norm is 1 / (omega_p T) here, its
    # logarithm over omega_p T to (omega_p T)^-2 times that.
    bound = 8 * 2.0**-53 / (omega_p * periods_s[0]) ** 2
    return {
        "case": f"sweep of {count} values of T, 0.1 to 10 ms, 10 s each",
        **taken,
        "goal": 3.0,
        "difference": difference,
        "bound": bound,
        "agrees": bool(difference <= bound),
    }


def command_row(options: Options) -> dict[str, Any]:
    """Seconds for `hybrid run pitch_loop` as a user starts it, compiled kernels on disk."""
    patch = str(hybrid.shipped_patches()["pitch_loop"])
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hybrid", "run", patch, "--out", folder]

        def call() -> None:
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)

        taken = medians_s({"hybrid": call}, 1 if options.quick else 5)
        written = {path.suffix for path in Path(folder).iterdir()}
    return {
        "case": "hybrid run pitch_loop.yaml",
        **taken,
        "goal": 2.0,
        "agrees": written >= {".nc", ".png"},
    }


# -- report -----------------------------------------------------------------------------------------


def main() -> int:
    options = parse_options(__doc__ or "")
    runs, whole = run_rows(options), [sweep_row(options), command_row(options)]
    goals = judge(runs, whole, options.quick)
    agree = all(row["agrees"] for row in [*runs, *whole])
    verdict = f"the programs {'agree' if agree else 'do NOT agree'}"
    if goals:
        verdict += f"; {goals.count('yes')} of {len(goals)} goals met"
    return finish(__file__, options, (runs_table(runs), whole_table(whole)), agree, verdict)


def judge(runs: list[dict[str, Any]], whole: list[dict[str, Any]], quick: bool) -> list[str]:
    """Write beside every goal whether it is met; 'yes' or 'no' for each."""
    for row in [*runs, *whole]:
        # Short runs and few points are no test of the goals, which are for whole ones.
        row |= {key: None for key in ("goal", "goal_over_control") if quick and key in row}
    for row in runs:
        row["meets_goal"] = met(row["goal"], lambda goal, row=row: row["hybrid"] >= goal)
        row["meets_goal_over_control"] = met(
            row["goal_over_control"], lambda goal, row=row: row["over_control"] >= goal
        )
    for row in whole:
        row["meets_goal"] = met(row["goal"], lambda goal, row=row: row["hybrid"] < goal)
    verdicts = [row.get(key) for row in [*runs, *whole] for key in MEETS]
    return [told for told in verdicts if told in ("yes", "no")]


def met(goal: float | None, reached: Callable[[float], bool]) -> str:
    return "-" if goal is None else "yes" if reached(goal) else "no"


def runs_table(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "runs",
        "Single runs: digital cycles per second of wall time",
        {
            "case": ("case", ""),
            "cycles": ("cycles", ",d"),
            "hybrid": ("hybrid", ".2e"),
            "goal": ("goal", ".0e"),
            "met": ("meets_goal", ""),
            "numba loop": ("numba", ".2e"),
            "hybrid / numba": ("over_numba", ".2f"),
            "control": ("control", ".2e"),
            "hybrid / control": ("over_control", ".0f"),
            "goal ": ("goal_over_control", ".0f"),
            "met ": ("meets_goal_over_control", ""),
            "difference": ("difference", ".0e"),
            "": ("agrees", ""),
        },
        rows,
    )


def whole_table(rows: list[dict[str, Any]]) -> Table:
    return Table(
        "whole",
        "Whole tasks: seconds of wall time",
        {
            "case": ("case", ""),
            "hybrid": ("hybrid", ".2f"),
            "goal below": ("goal", "g"),
            "met": ("meets_goal", ""),
            "numba loop, no readout": ("numba", ".2f"),
            "control, predicts only": ("control", ".2f"),
            "": ("agrees", ""),
        },
        rows,
    )


if __name__ == "__main__":
    sys.exit(main())
