"""NASA's check cases of six degrees of freedom: all digital, and split between the two machines.

Each case is flown by a patch that ships and compared with a published run of one of NASA's tools, over all
its rows; a line for each case and machine says how far off it is, and of what is allowed. The bounds of
the digital runs say that the equations and the formula are right (double precision against double
precision); those of the hybrid ones what a machine of 0.01 % may do, less than NASA's tools differ among
themselves. Below, each cause of a hybrid run's error is switched off by itself: what then is left.

Reference data: folder HYBRID_REFERENCE, or ../shared/reference beside the repository. Source: NASA/TM-2015-
218675, "Check-Cases for Verification of 6-Degree-of-Freedom Flight Vehicle Simulations" (atmospheric cases);
NASA JEOD's stored verification runs, which are orbital cases 2 and 10A by their numbers.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bench import Options, Table, finish, parse_options
from scipy.optimize import fsolve

import hybrid
from hybrid.shipped import shipped_folder
from hybrid.units import parse_quantity

FOLDER = Path(__file__).parent.parent.parent / "shared" / "reference"
REFERENCE = Path(os.environ.get("HYBRID_REFERENCE", FOLDER))
FT = 0.3048
Published = np.ndarray
Errors = dict[str, float]
Shown = Callable[[str], np.ndarray]  # name of a signal -> its values at the published times, SI


@dataclass(frozen=True)
class Flight:
    """How a case is flown on one kind of machine, and what is allowed."""

    patch: str
    tolerances: Mapping[str, float]
    parameters: Mapping[str, float | str] = field(default_factory=dict)
    file: str = ""  # of the published run; default: that of the case
    until_s: float | None = None  # rows beyond are left out
    trimmed: str = ""  # the patch whose trim is found first


@dataclass(frozen=True)
class Case:
    """A check case: its published run, who flies it, and how the two are compared."""

    name: str
    file: str
    compare: Callable[[Shown, Published, Mapping[str, float]], Errors]
    flights: Mapping[str, Flight]
    starts: bool = False  # the first published row gives the initial values


# -- what is compared -------------------------------------------------------------------------------


def apart(found: np.ndarray, published: np.ndarray, turn: float = np.inf) -> float:
    """Largest difference; angles may be whole turns apart."""
    difference = found - published
    if np.isfinite(turn):
        difference = (difference + turn / 2) % turn - turn / 2
    return float(np.abs(difference).max())


def flown(shown: Shown, published: Published, asked: Mapping[str, float]) -> Errors:
    """Differences from an atmospheric case, of the figures that are asked for."""
    pairs = {
        "altitude_ft": [("flight.height", "altitudeMsl_ft", FT)],
        "longitude_deg": [("flight.longitude", "longitude_deg", np.pi / 180)],
        "velocity_ft_s": [
            (f"flight.{name}", f"feVelocity_ft_s_{axis}", FT)
            for name, axis in (("north", "X"), ("east", "Y"), ("down", "Z"))
        ],
        "euler_deg": [
            (f"angles.{name.lower()}", f"eulerAngle_deg_{name}", np.pi / 180)
            for name in ("Yaw", "Pitch", "Roll")
        ],
        "pitch_deg": [("angles.pitch", "eulerAngle_deg_Pitch", np.pi / 180)],
        "rate_deg_s": [
            (f"body.{name}", f"bodyAngularRateWrtEi_deg_s_{axis}", np.pi / 180)
            for name, axis in (("p", "Roll"), ("q", "Pitch"), ("r", "Yaw"))
        ],
    }
    turns = {"euler_deg": 360.0, "longitude_deg": 360.0}
    asked = [figure for figure in asked if figure in pairs]
    return {
        figure: max(
            apart(shown(signal) / unit, published[column], turns.get(figure, np.inf))
            for signal, column, unit in pairs[figure]
        )
        for figure in asked
    }


def orbited(shown: Shown, published: Published, asked: Mapping[str, float]) -> Errors:
    """Differences from an orbital case at its last row that is flown, of what is asked for."""

    def length(part: str, names: tuple[str, ...], columns: tuple[str, ...]) -> float:
        found = [shown(f"{part}.{name}")[-1] for name in names]
        return float(np.linalg.norm(found - np.array([published[c][-1] for c in columns])))

    found = np.array([shown(f"attitude.{name}")[-1] for name in "sxyz"])
    told = published[-1]
    given = np.array([told["q_scalar"], -told["q_v0"], -told["q_v1"], -told["q_v2"]])
    found, given = found / np.linalg.norm(found), given / np.linalg.norm(given)
    between = min(np.linalg.norm(found - given), np.linalg.norm(found + given))
    figures = {
        "position_m": lambda: length("orbit", ("x", "y", "z"), ("x_m", "y_m", "z_m")),
        "velocity_m_s": lambda: length("orbit", ("vx", "vy", "vz"), ("vx_m_s", "vy_m_s", "vz_m_s")),
        "rate_rad_s": lambda: length("body", ("p", "q", "r"), ("wx_rad_s", "wy_rad_s", "wz_rad_s")),
        "attitude_deg": lambda: float(np.degrees(4 * np.arcsin(between / 2))),
    }
    return {figure: figures[figure]() for figure in asked}


# -- the cases --------------------------------------------------------------------------------------

TURNING = {"euler_deg": 1.0, "rate_deg_s": 0.1}
FALLING = {"altitude_ft": 0.01, "velocity_ft_s": 1e-3, "longitude_deg": 1e-7}
ORBIT = {"position_m": 1e-2, "velocity_m_s": 1e-5, "attitude_deg": 1e-6, "rate_rad_s": 1e-10}
SHOT = {"height_start": 0.0, "east_start": "1000 ft/s", "down_start": "-1000 ft/s"}
# A sphere of the weight of case 1 that does not turn; its rotation is on the analog machine, too.
SPHERE: dict[str, float | str] = dict.fromkeys(
    ("body.ixx", "body.iyy", "body.izz"), "3.6 slug*ft^2"
) | dict.fromkeys(("body.p_start", "body.q_start", "body.r_start"), 0.0)
CYLINDER = {"ixx": 500.0, "iyy": 12250.0, "izz": 12250.0}
STATION = {
    "ixx": 1.02e8,
    "iyy": 0.91e8,
    "izz": 1.64e8,
    "ixy": 6.96e6,
    "ixz": 5.48e6,
    "iyz": -5.9e5,
    "gradient": 0.0,
}


def atmospheric(number: str, tool: str, digital: Flight, split: Flight) -> Case:
    """A case in the air, compared with one of NASA's tools."""
    file = f"nesc_atmos/atmos_{number}_sim_{tool}.csv"
    return Case(number.lstrip("0"), file, flown, {"digital": digital, "hybrid": split})


def orbital(number: str, body: Mapping[str, float], rates: Mapping[str, float]) -> Case:
    """An orbital case; `rates` are parameters of the hybrid patch's scaling."""
    file = f"orbit_jeod/jeod_dyncomp_RUN_{number}.csv"
    digital = Flight("orbiting_cylinder_digital", ORBIT, body)
    split = Flight("orbiting_cylinder", {"attitude_deg": 0.5}, {**body, **rates}, until_s=480.0)
    flights = {"digital": digital, "hybrid": split}
    return Case(f"orbital {number}", file, orbited, flights, starts=True)


CASES = (
    atmospheric(
        "01",
        "04",
        Flight("cannonball_digital", FALLING, {"coefficient": 0.0}),
        Flight("tumbling_brick", FALLING, {"damping": 0.0, **SPHERE}),
    ),
    atmospheric(
        "02",
        "04",
        Flight("tumbling_brick_digital", {"euler_deg": 1e-3, "rate_deg_s": 1e-4}, {"damping": 0.0}),
        Flight("tumbling_brick", TURNING, {"damping": 0.0}),
    ),
    atmospheric(
        "03",
        "05",
        Flight("tumbling_brick_digital", {"euler_deg": 2e-3, "rate_deg_s": 2e-4}),
        Flight("tumbling_brick", TURNING),
    ),
    atmospheric(
        "06",
        "04",
        Flight("cannonball_digital", {"altitude_ft": 0.02, "velocity_ft_s": 2e-3}),
        Flight("cannonball", {"altitude_ft": 1.0}),
    ),
    atmospheric(
        "09",
        "04",
        Flight("cannonball_digital", {"altitude_ft": 0.05, "velocity_ft_s": 2e-3}, SHOT),
        Flight("cannonball", {"altitude_ft": 5.0}, SHOT),
    ),
    orbital("2", STATION, {}),
    orbital("10A", CYLINDER, {}),
)

# The F-16 from its DAVE-ML files; its trim is compared with one found from the same tables by other means.
TRIM = {"pitch": ("deg", 2.638938), "elevator": ("deg", -3.23276), "power": ("percent", 13.8738)}
CASES += (
    Case(
        "11",
        "nesc_atmos/atmos_11_sim_05.csv",
        flown,
        {
            "digital": Flight(
                "parts/f16_digital",
                {
                    "trim_pitch_deg": 1e-4,
                    "trim_elevator_deg": 1e-3,
                    "trim_power_percent": 0.01,
                    "altitude_ft": 0.05,
                    "velocity_ft_s": 1e-3,
                    "euler_deg": 1e-3,
                },
                trimmed="parts/f16_digital",
            ),
            "hybrid": Flight(
                "parts/f16",
                {"altitude_ft": 5.0, "pitch_deg": 0.05},
                until_s=30.0,
                trimmed="parts/f16_digital",
            ),
        },
    ),
)

# What a hybrid run's error may come of: how the patch's text is changed to have it without that.
CAUSES: Mapping[str, tuple[str, str]] = {
    "gain errors": ("preset: nominal", "preset: nominal, tolerance: 0"),
    "noise": ("preset: nominal", "preset: nominal, noise: 0"),
    "noise and lags": ("preset: nominal", "preset: nominal, noise: 0, tau: 0"),
    "word length of converters": ("bits: 14, ", ""),
    "three quarters of the cycle": ("", ""),
}


# -- flying -----------------------------------------------------------------------------------------


def read(name: str, until_s: float, without: str = "") -> hybrid.Patch:
    """A shipped patch on its own machine, with a row a cycle, and without one cause of error."""
    file = shipped_folder() / f"{name}.yaml"
    text = file.read_text(encoding="utf-8")
    text = re.sub(r"(?m)^machine: (\w+)$", r"machine: {preset: \1}", text)
    text = re.sub(r"(?m)^run: .*$", f"run: {{until: {float(until_s)!r} s}}", text)
    if without:
        text = re.sub(*CAUSES[without], text) if any(CAUSES[without]) else text
    return hybrid.parse_patch(text, str(file))


def initial(published: Published) -> dict[str, float]:
    """Parameters of an orbit from the first published row."""
    row = published[0]
    given = {f"{name}_start": row[f"{name}_m"] for name in "xyz"}
    given |= {f"v{name}_start": row[f"v{name}_m_s"] for name in "xyz"}
    given |= {
        f"{rate}_start": row[f"w{axis}_rad_s"] for rate, axis in zip("pqr", "xyz", strict=True)
    }
    given |= {f"a{axis}_start": -row[f"q_v{i}"] for i, axis in enumerate("xyz")}
    return {name: float(value) for name, value in {**given, "s_start": row["q_scalar"]}.items()}


def turning(published: Published) -> dict[str, float]:
    """Initial body rates as published; in level flight over the Earth they are not zero."""
    axes = zip("pqr", ("Roll", "Pitch", "Yaw"), strict=True)
    return {
        f"{rate}_start": float(np.radians(published[f"bodyAngularRateWrtEi_deg_s_{axis}"][0]))
        for rate, axis in axes
    }


def trim(name: str, given: Mapping[str, float | str]) -> dict[str, float]:
    """Pitch, elevator and power at which the first cycle changes neither speed, nor climb, nor pitch rate."""
    patch = read(name, 0.02)
    usual = patch.bind()
    units = {key: factor(unit) for key, (unit, _) in TRIM.items()}

    def rates(unknown: np.ndarray) -> list[float]:
        tried = {key: value * units[key] for key, value in zip(TRIM, unknown, strict=True)}
        record = hybrid.run(patch, {**given, **tried}).record
        # Shown in m/s and rad/s or deg/s; a change of a cycle that is nothing is so in any unit.
        return [
            float(np.diff(record[signal].values[:2])[0]) * 100.0
            for signal in ("flight.speed", "flight.down", "body.q")
        ]

    start = [usual[key] / unit for key, unit in units.items()]
    found = fsolve(rates, start, xtol=1e-12)
    return {key: value * units[key] for key, value in zip(TRIM, found.tolist(), strict=True)}


def errors(case: Case, flight: Flight, published: Published, without: str = "") -> Errors:
    """Fly a case and compare it."""
    time = published["time_s" if case.starts else "time"]
    if flight.until_s:
        published, time = published[time <= flight.until_s], time[time <= flight.until_s]
    given = {**flight.parameters, **(initial(published) if case.starts else {})}
    trims: Errors = {}
    if flight.trimmed:
        given |= turning(published)
        found = trim(flight.trimmed, given)
        given |= found
        trims = {
            f"trim_{key}_{unit}": abs(found[key] / factor(unit) - value)
            for key, (unit, value) in TRIM.items()
        }
    patch = read(flight.patch, time[-1] + 5.0, without)
    if without and not any(CAUSES[without]):
        usual = patch.bind()
        given |= {name: usual[name] / 4 for name in ("cycle", "compute_time")}
    result = hybrid.run(patch, given)
    assert result.status == "complete", result
    record, rows_s = result.record, result.record["time"].values
    step = rows_s[1]
    late = 0.0 if flight.patch.endswith("_digital") else step

    def shown(name: str) -> np.ndarray:
        # What the program computes of a sample is shown when its compute time is over.
        is_word = record[name].attrs["kind"] == "word"
        at = np.searchsorted(rows_s, time + (late if is_word else 0.0) - step / 4)
        return record[name].values[at] * factor(record[name].attrs["units"])

    asked = {name: trims[name] for name in trims if name in flight.tolerances}
    return asked | case.compare(shown, published, flight.tolerances)


def factor(unit: str) -> float:
    """SI value of a unit of the record."""
    return 1.0 if not unit else parse_quantity(f"1 {unit}").value


def fly(options: Options) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """A row for each case and machine, and for each cause of a hybrid run's errors."""
    rows, causes = [], []
    for case in CASES:
        published = np.genfromtxt(REFERENCE / case.file, delimiter=",", names=True)
        for machine, flight in case.flights.items():
            found = errors(case, flight, published)
            passed = all(found[name] <= most for name, most in flight.tolerances.items())
            row = {"case": case.name, "machine": machine, "errors": found}
            rows.append({**row, "tolerances": dict(flight.tolerances), "pass": passed})
            if machine == "hybrid" and not options.quick:
                causes += [
                    {
                        "case": case.name,
                        "without": cause,
                        "errors": errors(case, flight, published, cause),
                    }
                    for cause in CAUSES
                ]
    return rows, causes


def told(figures: Mapping[str, float], of: Mapping[str, float] | None = None) -> str:
    """Figures in one line, each with what is allowed."""
    return ", ".join(
        f"{name} {value:.2g}" + (f" (of {of[name]:g})" if of else "")
        for name, value in figures.items()
    )


def main() -> int:
    options = parse_options(__doc__ or "")
    if not REFERENCE.is_dir():
        reason = f"no reference data in {REFERENCE}; set HYBRID_REFERENCE"
        print(
            json.dumps({"bench": "check_cases", "skipped": reason, "cases": []})
            if options.json
            else reason
        )
        return 0
    rows, causes = fly(options)
    passed = all(row["pass"] for row in rows)
    lines = [{**row, "figures": told(row["errors"], row["tolerances"])} for row in rows]
    left = [{**row, "figures": told(row["errors"])} for row in causes]
    line = {"case": ("case", ""), "machine": ("machine", "")}
    tables = [
        Table(
            "cases",
            "NASA's check cases",
            {**line, "largest errors": ("figures", ""), "": ("pass", "")},
            lines,
        )
    ]
    if left:
        shape = {"case": ("case", ""), "without": ("without", ""), "what is left": ("figures", "")}
        tables.append(Table("causes", "Hybrid, without one cause of error", shape, left))
    verdict = f"{sum(row['pass'] for row in rows)} of {len(rows)} within what is allowed"
    return finish(__file__, options, tables, passed, verdict, reference=str(REFERENCE))


if __name__ == "__main__":
    sys.exit(main())
