"""NASA's check cases of six degrees of freedom: all digital, and split between the two machines.

Each case is flown by a patch that ships and compared with a published run of one of NASA's tools, over all
its rows; a line for each case and machine says how far off it is, and of what is allowed. The bounds of
the digital runs say that the equations and the formula are right (double precision against double
precision); those of the hybrid ones what a machine of 0.01 % may do, less than NASA's tools differ among
themselves. Below, what the errors come of: each cause is switched off by itself, and the row says how much
of the flight that changes. Last, how many times real time the flights run, beside JSBSim where it is
installed (extra `peers`).

--quick leaves the causes out and measures the speed less often; its speed is not judged.

Reference data: folder HYBRID_REFERENCE, or ../shared/reference beside the repository. Source: NASA/TM-2015-
218675, "Check-Cases for Verification of 6-Degree-of-Freedom Flight Vehicle Simulations" (atmospheric cases);
NASA JEOD's stored verification runs, which are orbital cases 2 and 10A by their numbers.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bench import Options, Row, Table, finish, parse_options, say
from flights import shots, speeds
from flights.cases import CASES, Case
from flights.causes import IDEAL, causes_of, without_noise
from flights.figures import LARGEST, Published, Shown, apart, published_as_shown
from flights.flying import fly, prepared, shipped, time_column, trim_errors
from peers import by_jsbsim

from hybrid.arguments import parameters_of

FOLDER = Path(__file__).parent.parent.parent / "shared" / "reference"
REFERENCE = Path(os.environ.get("HYBRID_REFERENCE") or FOLDER)
MOST_NAMED = 3  # causes that are named for a figure
Figures = dict[str, float]


def published_run(file: Path) -> Published:
    """The rows of a published run."""
    return np.genfromtxt(file, delimiter=",", names=True)


# -- how far off, and why ---------------------------------------------------------------------------


def judge(
    case: Case, machine: str, options: Options
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The row of a case on a machine, and one for each cause of its errors."""
    flight = case.flights[machine]
    rows, given = prepared(case, flight, published_run(REFERENCE / case.file))
    times_s, patch = rows[time_column(case)], shipped(flight.patch, flight.on)
    figures = [name for name in flight.tolerances if not name.startswith("trim_")]
    told, flown = published_as_shown(rows, case.orbits), fly(patch, given, times_s)
    trims = trim_errors(given) if flight.trimmed else {}
    errors = {name: trims[name] for name in flight.tolerances if name in trims}
    errors |= differences(flown, told, figures)
    row = {
        "case": case.name,
        "machine": machine,
        "errors": errors,
        "tolerances": dict(flight.tolerances),
        "pass": all(errors[name] <= most for name, most in flight.tolerances.items()),
    }
    if options.quick:
        return row, []
    head, causes = {"case": case.name, "machine": machine}, []
    is_hybrid, usual = machine == "hybrid", patch.bind(parameters_of(patch, given))
    quiet = without_noise(patch) if is_hybrid else patch
    silent = fly(quiet, given, times_s) if is_hybrid else flown
    for cause in causes_of(patch, is_hybrid):
        settings = {**given, **cause.settings(usual)}
        changed = cause.change(quiet if cause.quiet else patch)
        without = fly(changed, settings, times_s, cause.machine)
        beside = silent if cause.quiet else flown
        found = compared(without, told, beside, figures)
        causes.append({**head, "without": cause.name, "group": cause.group, **found})
    return row, causes


def compared(
    without: Shown, told: Shown, beside: Shown, figures: Sequence[str]
) -> dict[str, Figures]:
    """How far off a flight without a cause is, and from the flight with it."""
    changes = differences(without, beside, figures)
    return {"errors": differences(without, told, figures), "changes": changes}


def differences(one: Shown, other: Shown, figures: Sequence[str]) -> Figures:
    """By how much two flights differ, figure by figure."""
    return {figure: apart(one, other, figure) for figure in figures}


def named(
    rows: Sequence[Row], causes: Sequence[Row], spreads: Mapping[str, Figures]
) -> Iterator[dict[str, Any]]:
    """For each error its largest causes with what each does, the largest part of a cause behind it."""
    for row in rows:
        own = [c for c in causes if (c["case"], c["machine"]) == (row["case"], row["machine"])]
        for figure in own[0]["changes"] if own else ():
            single = [c for c in own if not c["group"] and c["without"] != IDEAL]
            single.sort(key=lambda c: -c["changes"][figure])
            rest = next((c for c in own if c["without"] == IDEAL), None)
            yield {
                "case": row["case"],
                "machine": row["machine"],
                "figure": figure,
                "error": row["errors"][figure],
                "largest": [c["without"] for c in single[:MOST_NAMED]],
                "causes": "; ".join(_told(c, own, figure) for c in single[:MOST_NAMED]),
                "ideal": rest["errors"][figure] if rest else None,
                "nasa": spreads.get(row["case"], {}).get(figure),
            }


def _told(cause: Row, own: Sequence[Row], figure: str) -> str:
    """A cause and what it does, with its largest part."""
    parts = [c for c in own if c["group"] == cause["without"]]
    told = f"{cause['without']} {cause['changes'][figure]:.2g}"
    if not parts:
        return told
    most = max(parts, key=lambda c: c["changes"][figure])
    return f"{told} ({most['without']} {most['changes'][figure]:.2g})"


def spread(case: Case) -> Figures:
    """By how much the other runs that NASA published of a case differ from the one it is compared with."""
    chosen = published_run(REFERENCE / case.file)
    time = chosen[time_column(case)]
    found: Figures = {}
    for file in sorted(REFERENCE.glob(case.others)) if case.others else ():
        other = published_run(file)
        if file == REFERENCE / case.file or not np.array_equal(other["time"], time):
            continue
        pair = published_as_shown(other, case.orbits), published_as_shown(chosen, case.orbits)
        for figure in {name for flight in case.flights.values() for name in flight.tolerances}:
            if figure in LARGEST:
                found[figure] = max(found.get(figure, 0.0), apart(*pair, figure))
    return found


# -- what is printed --------------------------------------------------------------------------------


def told(figures: Mapping[str, float], of: Mapping[str, float]) -> str:
    """Figures in one line, each with what is allowed."""
    return ", ".join(f"{name} {value:.2g} (of {of[name]:g})" for name, value in figures.items())


def tables_of(
    rows: Sequence[Row], tables: Sequence[Row], causes: Sequence[Row], races: Sequence[Row]
) -> list[Table]:
    """Everything for people; `causes` in JSON has every one, what is printed the largest."""
    lines = [{**row, "figures": told(row["errors"], row["tolerances"])} for row in rows]
    line = {"case": ("case", ""), "machine": ("machine", "")}
    shape = {**line, "largest errors": ("figures", ""), "": ("pass", "")}
    found = [Table("cases", "NASA's check cases", shape, lines), table_of_shots(tables)]
    if causes:
        spreads = {case.name: spread(case) for case in CASES}
        shape = {
            **line,
            "figure": ("figure", ""),
            "error": ("error", ".2g"),
            "what it comes of: the flight changes by, without": ("causes", ""),
            "left without all": ("ideal", ".2g"),
            "NASA's tools": ("nasa", ".2g"),
        }
        notes = (
            "In brackets the largest part of a cause: the gain errors of that part of the patch, that "
            "converter. All but the noise are switched off on a machine without noise. The formula and the word length are made worse in place of better, by one order and "
            "by three bits: as they are they do less. NASA's tools: by how much its other runs differ from "
            "the one that is compared."
        )
        reasons = [*named(rows, causes, spreads)]
        found.append(Table("reasons", "What the errors come of", shape, reasons, notes))
    shape = {
        **line,
        "step s": ("step_s", "g"),
        "length s": ("until_s", "g"),
        "times real time": ("times_real_time", ".0f"),
        "JSBSim's F-16": ("jsbsim_times_real_time", ".0f"),
        "goal": ("goal", ".0f"),
        "reached": ("reached", ""),
    }
    notes = "" if by_jsbsim.installed() else "JSBSim is not installed (extra peers)."
    races = [{**row, "reached": YES[row["meets_goal"]]} for row in races]
    found.append(Table("speeds", "Speed, on one core", shape, races, notes))
    return found


def table_of_shots(rows: Sequence[Row]) -> Table:
    """The shots of the F-16's models."""
    shape = {
        "model": ("model", ""),
        "shots": ("shots", "d"),
        "values": ("values", "d"),
        "within tolerance": ("within", "d"),
        "within a float32": ("within_float32", "d"),
        "largest error": ("largest_error", ".2g"),
        "of": ("output", ""),
        "published": ("published", ".10g"),
        "tolerance": ("tolerance", "g"),
        "": ("pass", ""),
    }
    notes = "Tolerances are as published, and half of the last digit printed besides."
    return Table("table_shots", "Table shots of the F-16's models", shape, rows, notes)


YES = {True: "yes", False: "no", None: ""}


def main() -> int:
    options = parse_options(__doc__ or "")
    if not REFERENCE.is_dir():
        reason = f"no reference data in {REFERENCE}; set HYBRID_REFERENCE"
        skipped = {"bench": "check_cases", "skipped": reason, "cases": []}
        say(json.dumps(skipped) if options.json else reason)
        return 0
    os.environ["HYBRID_REFERENCE"] = str(REFERENCE.resolve())  # where the F-16 finds its files
    flown = [judge(case, machine, options) for case in CASES for machine in case.flights]
    rows, causes = [row for row, _ in flown], [cause for _, found in flown for cause in found]
    races = speeds.measure(options.quick)
    tables = shots.judged(REFERENCE)
    passed = all(row["pass"] for row in (*rows, *tables))
    verdict = f"{sum(row['pass'] for row in rows)} of {len(rows)} within what is allowed"
    verdict += f"; {sum(row['values'] for row in tables)} values of table shots"
    verdict += "" if all(row["pass"] for row in tables) else ", not all within tolerance"
    if not options.quick:
        wanted = [
            row[key]
            for row in races
            for key in ("meets_goal", "as_fast_as_jsbsim")
            if row["goal"] and row[key] is not None
        ]
        verdict += f"; {sum(wanted)} of {len(wanted)} as fast as is wanted"
        passed = passed and all(wanted)
    facts = {"reference": str(REFERENCE), **({"causes": causes} if causes else {})}
    lines = tables_of(rows, tables, causes, races)
    return finish(__file__, options, lines, passed, verdict, **facts)


if __name__ == "__main__":
    sys.exit(main())
