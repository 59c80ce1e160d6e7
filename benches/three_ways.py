"""The same vehicle three ways: all digital, hybrid, all analog, each from the one description in `entry_probe`.

The paper's own question (R. M. Howe, "Computers for Simulation of Space Vehicle Systems", 1964, sections 2 and
4): which computer for which simulation. Each machine flies the probe with several cycle times; what it flies
is compared with the equations written out by hand and integrated to 1e-13. Shown are the error of the pitch
angle, in parts of its first amplitude, and that of the height at the end; the longest cycle time that keeps both
within what is asked for; and the cost: parts of the analog machine, converters, operations of the digital one, and
how many times faster than real time processors of the time would be, if they did nothing else.

Theory and the paper's equations beside the runs. A damping zeta of an oscillation of omega lets its amplitude grow
by exp(-integral(zeta omega dt)):

  formula   all-digital errors fall as T^n, n the formula's order
  theory    all delays d of a loop add: zeta = -1/2 omega d. Moments on the digital machine: d = 3/2 T and the lags of
            the four elements that are left in the loop; all analog: the lags of four elements, two integrators, a
            summer and a multiplier, times `speed`
  paper     Eq. 2.1, moments on the digital machine: zeta = -3/4 omega T, the lags left out; Eq. 2.3, all analog:
            zeta = 1/2 omega sum(tau), which is meant with the other sign (README, Source) and shown with it
"""

from __future__ import annotations

import functools
import itertools
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bench import Options, Table, finish, parse_options
from scipy.integrate import cumulative_simpson, solve_ivp

import hybrid
from hybrid import theory
from hybrid.processors import PROCESSORS
from hybrid.shipped import shipped_patches

PITCH, HEIGHT_M = 0.02, 20.0  # asked for: 2 % of the first amplitude, and 20 m of 29 km
AMPLITUDE, UNTIL_S, LAG_S, LOOP = 0.1, 15.0, 1e-6, 4
ROWS = 20  # of the end of a flight, two seconds
ORDERS = {"ab2": 2, "rk4": 4}
PROCESSORS_1964 = ("ibm_7090", "ibm_1620", "apollo_guidance_computer", "cdc_6600")
HEADINGS = ("x 7090", "x 1620", "x AGC", "x 6600")
MOMENTS = {"rotation.push": "digital", "rotation.drag": "digital"}


@dataclass(frozen=True)
class Machine:
    """One way of flying it."""

    name: str
    on: Any  # as read_patch takes it
    cycles_ms: Sequence[float] = ()  # rows lie 100 ms apart
    formula: str = "ab2"
    settings: Mapping[str, float] = field(default_factory=dict)


USUAL_MS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
MACHINES = (
    Machine(
        "all digital, ab2", "digital", (0.5, 1.0, 2.0, 5.0, 10.0), "ab2", {"compute_time": 0.0}
    ),
    Machine(
        "all digital, rk4", "digital", (2.0, 5.0, 10.0, 20.0, 50.0), "rk4", {"compute_time": 0.0}
    ),
    Machine("hybrid", None, USUAL_MS),
    Machine("hybrid, DACs that do not lead", None, USUAL_MS, "ab2", {"lead": 0.0}),
    Machine("hybrid, moments digital", MOMENTS, (0.025, 0.05, 0.1, 0.2, 0.5)),
    Machine("all analog", "analog"),
)


# -- what is right ----------------------------------------------------------------------------------


def stiffness(density: Any, speed: Any) -> Any:
    """The square of the pitch frequency."""
    return 0.5 * 1.0 * 0.3 / 100.0 * density * speed**2 / 2


def rates(_: float, state: np.ndarray) -> list[float]:
    """The probe's equations with its figures: speed, path, height, density, theta, theta'."""
    v, c, _, d, theta, rate = state
    flow = d * v / 2
    return [
        -0.5 * 0.2 / 500 * flow * v - 9.80665 * math.sin(c),
        0.5 * 2.0 / 500 * flow * (theta - c) + (v / 6371e3 - 9.80665 / v) * math.cos(c),
        v * math.sin(c),
        -d * v * math.sin(c) / 7100,
        rate,
        -stiffness(d, v) * (theta - c) - 0.5 * 0.2 / 200 * flow * rate,
    ]


@functools.cache
def exact() -> Any:
    """The flight at any time."""
    path = math.radians(-40.0)
    start = [3000.0, path, 45e3, 2.2e-3, path + AMPLITUDE, 0.0]
    tight = {"rtol": 1e-13, "atol": 1e-12, "dense_output": True}
    return solve_ivp(rates, (0.0, UNTIL_S), start, "DOP853", **tight).sol


def last_swings() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the rows of the last two seconds: exact states, omega, and the integral of omega^2 until then."""
    time = np.linspace(0.0, UNTIL_S, 3001)
    v, _, _, d, _, _ = exact()(time)
    until = cumulative_simpson(stiffness(d, v), x=time, initial=0.0)
    rows = slice(len(time) - 20 * (ROWS - 1) - 1, None, 20)
    return exact()(time[rows]), stiffness(d, v)[rows] ** 0.5, until[rows]


# -- what is flown ----------------------------------------------------------------------------------


def patch_of(machine: Machine) -> hybrid.Patch:
    """The one description, with a formula and put on its machine."""
    file = shipped_patches()["entry_probe"]
    text, shipped = file.read_text(encoding="utf-8"), "integration: ab2"
    assert text.count(shipped) == 1, f"{file} has another formula than {shipped!r}"
    text = text.replace(shipped, f"integration: {machine.formula}")
    return hybrid.parse_patch(text, str(file), machine.on)


def fly(
    machine: Machine, settings: Mapping[str, float], preset: str = "lags", serial: int | None = None
) -> dict[str, float]:
    """Errors of one flight, and by how much its oscillation has grown beside what is right."""
    patch = patch_of(machine)
    result = hybrid.run(patch, {**machine.settings, **settings}, machine=preset, serial=serial)
    record = result.record
    late = patch.bind({**machine.settings, **settings})["compute_time"]

    def shown(name: str) -> tuple[np.ndarray, np.ndarray]:
        """Values in SI, and the times of which they tell: words are shown when they are done."""
        signal, time = record[name], record["time"].values
        is_word = signal.attrs["kind"] == "word"
        factor = 1000.0 if signal.attrs["units"] == "km" else 1.0
        known = slice(1, None) if is_word and late else slice(None)
        return signal.values[known] * factor, time[known] - (late if is_word else 0.0)

    theta, time = shown("rotation.theta")
    height, seen = shown("translation.height")
    return {
        "pitch": float(np.abs(theta - exact()(time)[4]).max() / AMPLITUDE),
        "height_m": float(abs(height[-1] - exact()(seen[-1])[2])),
        "growth": growth(shown("rotation.alpha")[0], shown("rotation.rate")[0]),
    }


def energies(angle: np.ndarray, turning: np.ndarray) -> np.ndarray:
    """The square of the amplitude, times omega, which an oscillation without damping keeps."""
    _, omega, _ = last_swings()
    energy: np.ndarray = omega * angle[-ROWS:] ** 2 + turning[-ROWS:] ** 2 / omega
    return energy


def growth(alpha: np.ndarray, rate: np.ndarray) -> float:
    """Logarithm of the amplitude beside the right one, over the last rows."""
    (_, path, _, _, theta, turning), _, _ = last_swings()
    right = energies(theta - path, turning)
    return 0.5 * math.log(energies(alpha, rate).sum() / right.sum())


def grown(law: float) -> float:
    """The same where the amplitude grows by exp(law integral(omega^2 dt))."""
    (_, path, _, _, theta, turning), _, until = last_swings()
    right = energies(theta - path, turning)
    return 0.5 * math.log((right * np.exp(2.0 * law * until)).sum() / right.sum())


def longest(rows: Sequence[Mapping[str, float]], figure: str, most: float) -> float | None:
    """The cycle time at which an error reaches `most`, between two that were flown, in s."""
    for before, after in itertools.pairwise(rows):
        if before[figure] <= most < after[figure]:
            part = math.log(most / before[figure]) / math.log(after[figure] / before[figure])
            return float(before["cycle_s"] * (after["cycle_s"] / before["cycle_s"]) ** part)
    return float(rows[-1]["cycle_s"]) if rows and rows[-1][figure] <= most else None


def cost(machine: Machine, cycle_s: float | None) -> dict[str, Any]:
    """What the machine is made of, and what its program asks of a processor."""
    check = hybrid.check(patch_of(machine), dict(machine.settings), trial=False)
    found = check.to_dict()
    parts = {row["part"]: row["count"] for row in found["parts"]}
    operations = found["tasks"][0]["operations"] if found["tasks"] else {}
    total = sum(operations.values())
    multipliers = ("multiplier", "divider", "resolver")
    return {
        "amplifiers": parts.get("amplifier", 0),
        "multipliers": sum(parts.get(part, 0) for part in multipliers),
        "converters": parts.get("ADC", 0) + parts.get("DAC", 0),
        "operations": total,
        "operations_per_s": total / cycle_s if cycle_s else None,
        "times_real_time": {
            name: cycle_s / PROCESSORS[name].time_s(operations)
            for name in PROCESSORS_1964
            if cycle_s and operations
        },
    }


# -- the study --------------------------------------------------------------------------------------


def study(options: Options) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """A row for every flight, and one for every machine."""
    flights, summary = [], []
    for machine in MACHINES:
        cycles = machine.cycles_ms[1:3] if options.quick else machine.cycles_ms
        own = []
        for cycle_ms in cycles:
            found = fly(machine, {"cycle": cycle_ms / 1e3})
            own.append({"machine": machine.name, "cycle_s": cycle_ms / 1e3, "speed": 1.0, **found})
        if not cycles:
            for speed in (1.0, 10.0) if options.quick else (1.0, 10.0, 30.0, 100.0):
                found = fly(machine, {"speed": speed})
                own.append({"machine": machine.name, "cycle_s": None, "speed": speed, **found})
        flights += own
        asked = (("pitch", PITCH), ("height_m", HEIGHT_M))
        needed = [longest(own, *what) for what in asked] if cycles else [None]
        cycle_s = None if None in needed else min(n for n in needed if n)
        row = {"machine": machine.name, "cycle_s": cycle_s, **cost(machine, cycle_s)}
        summary.append({**row, **floor(machine, 1 if options.quick else 6, cycle_s)})
    return flights, summary


def floor(machine: Machine, machines: int, cycle_s: float | None) -> dict[str, float | None]:
    """Errors (rms) on machines of 0.01 % with 14-bit converters, at the next flown T below that needed."""
    if machine.on == "digital" or (machine.cycles_ms and cycle_s is None):
        return {"nominal_pitch": None, "nominal_height_m": None}
    flown = [cycle_ms / 1e3 for cycle_ms in machine.cycles_ms]
    cycle = {"cycle": max(c for c in flown if c <= cycle_s)} if cycle_s else {}
    found = [fly(machine, cycle, "nominal", serial) for serial in range(1, machines + 1)]
    return {
        f"nominal_{key}": float(np.sqrt(np.mean([row[key] ** 2 for row in found])))
        for key in ("pitch", "height_m")
    }


def beside_theory(flights: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Orders of the formulas, and growth by Eqs. 2.1 and 2.3."""
    rows = []
    for formula, order in ORDERS.items():
        own = [row for row in flights if row["machine"] == f"all digital, {formula}"][:2]
        ratio = math.log(own[1]["pitch"] / own[0]["pitch"])
        found = ratio / math.log(own[1]["cycle_s"] / own[0]["cycle_s"])
        rows.append(
            {
                "what": f"order of {formula}",
                "theory": float(order),
                "run": found,
                "paper": None,
                "equation": None,
            }
        )
    for name, delay_s, of_paper, equation in (
        (
            "hybrid, moments digital",
            lambda row: 1.5 * row["cycle_s"] + LOOP * LAG_S,
            lambda row: theory.uncompensated(1.0, row["cycle_s"]),
            "2.1: zeta = -3/4 omega T",
        ),
        (
            "all analog",
            lambda row: row["speed"] * LOOP * LAG_S,
            lambda row: theory.all_analog(1.0, [row["speed"] * LAG_S] * LOOP),
            "2.3: zeta = -1/2 omega sum(tau)",
        ),
    ):
        row = [row for row in flights if row["machine"] == name][1]
        at = (
            f"T = {row['cycle_s'] * 1e3:g} ms"
            if row["cycle_s"]
            else f"{row['speed']:g} x real time"
        )
        what = f"growth of the oscillation, {name}, {at}"
        told = {
            "theory": grown(0.5 * delay_s(row)),
            "run": row["growth"],
            "paper": grown(-of_paper(row).zeta),  # of 1 rad/s: both are in proportion to omega
            "equation": equation,
        }
        rows.append({"what": what, **told})
    # The next terms: of the formulas some (omega T)^2, at most 0.003, and more steps make them no better;
    # of the equations omega T and speed omega tau, 0.003 too.
    return [{**row, "passed": abs(row["run"] / row["theory"] - 1.0) < 0.02} for row in rows]


def draw(flights: Sequence[Mapping[str, Any]], file: Path) -> None:
    """Errors over the cycle time, one panel each."""
    from matplotlib.figure import Figure

    from hybrid.charts import save

    figure = Figure(figsize=(11, 4.5), layout="constrained")
    panels = figure.subplots(1, 2)
    asked = (("pitch", PITCH, "pitch error / amplitude"), ("height_m", HEIGHT_M, "height error, m"))
    for panel, (figure_of, most, label) in zip(panels, asked, strict=True):
        for machine in MACHINES:
            own = [row for row in flights if row["machine"] == machine.name]
            if machine.cycles_ms:
                x = [row["cycle_s"] * 1e3 for row in own]
                panel.loglog(x, [row[figure_of] for row in own], "o-", label=machine.name)
            else:
                panel.axhline(own[0][figure_of], ls="--", color="k", label=machine.name)
        panel.axhline(most, color="0.7", zorder=0)
        panel.set(xlabel="cycle time T, ms", ylabel=label)
        panel.grid(which="major", color="0.92")
    panels[0].set_ylim(1e-5, 10)
    panels[1].legend(fontsize=8)
    figure.suptitle("Entry probe on three machines, 1 us lags (grey: what is asked for)")
    save(figure, file)


def main() -> int:
    options = parse_options(__doc__ or "", draws=True)
    flights, summary = study(options)
    judged_rows = beside_theory(flights)
    flat = [{**row, **row["times_real_time"]} for row in summary]
    columns = {
        "machine": ("machine", ""),
        "T needed s": ("cycle_s", ".2g"),
        "amplifiers": ("amplifiers", ""),
        "multipliers": ("multipliers", ""),
        "converters": ("converters", ""),
        "operations": ("operations", ""),
        "a second": ("operations_per_s", ".3g"),
        "0.01 %: pitch": ("nominal_pitch", ".2g"),
        "height m": ("nominal_height_m", ".2g"),
        **{heading: (name, ".2g") for heading, name in zip(HEADINGS, PROCESSORS_1964, strict=True)},
    }
    per_flight = {
        "machine": ("machine", ""),
        "T s": ("cycle_s", "g"),
        "x real time": ("speed", "g"),
        "pitch error": ("pitch", ".2g"),
        "height error m": ("height_m", ".2g"),
    }
    judged = {
        "": ("what", ""),
        "theory": ("theory", ".4g"),
        "paper": ("paper", ".4g"),
        "by its Eq.": ("equation", ""),
        "run": ("run", ".4g"),
        " ": ("passed", ""),
    }
    asked = f"Needed for {PITCH:.0%} of the pitch amplitude and {HEIGHT_M:g} m of height"
    tables = (
        Table("flights", "Entry probe, 1 us lags", per_flight, flights),
        Table("machines", asked + "; x: times real time", columns, flat),
        Table("theory", "Theory, paper and run", judged, judged_rows),
    )
    passed = all(row["passed"] for row in judged_rows)
    needs = ", ".join(
        f"{row['machine']} {row['cycle_s'] * 1e3:.2g} ms" for row in summary if row["cycle_s"]
    )
    verdict = f"T needed: {needs or 'not asked with --quick'}"
    code = finish(__file__, options, tables, passed, verdict)
    if options.out:
        draw(flights, options.out)
    return code


if __name__ == "__main__":
    sys.exit(main())
