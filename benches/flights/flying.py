"""Flying a case with a patch that ships: initial values, the F-16's trim, the signals at given times."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.optimize import fsolve

import hybrid
from flights.cases import TRIM, Case, Flight
from flights.figures import Published, Shown
from hybrid.patch import Patch, literal
from hybrid.shipped import shipped_folder
from hybrid.units import parse_quantity

Given = dict[str, float | str]
TRIM_START = (
    0.0,
    0.0,
    5.0,
)  # pitch, elevator (deg) and power (percent) that the search begins with


def factor(unit: str) -> float:
    """SI value of a unit of the record."""
    return 1.0 if not unit else parse_quantity(f"1 {unit}").value


@functools.cache
def shipped(name: str, on: str | None = None) -> Patch:
    """A patch that ships, all of it on a machine, with a row of the record for every cycle."""
    patch = hybrid.read_patch(shipped_folder() / f"{name}.yaml", on)
    return replace(patch, run=replace(patch.run, every=None))


def until(patch: Patch, until_s: float) -> Patch:
    """The patch with its run ending at that time."""
    return replace(patch, run=replace(patch.run, until=literal(until_s)))


def orbit_start(published: Published) -> Given:
    """Parameters of an orbit from the first published row."""
    row = published[0]
    given = {f"{name}_start": row[f"{name}_m"] for name in "xyz"}
    given |= {f"v{name}_start": row[f"v{name}_m_s"] for name in "xyz"}
    given |= {
        f"{rate}_start": row[f"w{axis}_rad_s"] for rate, axis in zip("pqr", "xyz", strict=True)
    }
    given |= {f"a{axis}_start": -row[f"q_v{i}"] for i, axis in enumerate("xyz")}
    return {name: float(value) for name, value in {**given, "s_start": row["q_scalar"]}.items()}


def turning_start(published: Published) -> Given:
    """Initial body rates as published; in level flight over the Earth they are not zero."""
    axes = zip("pqr", ("Roll", "Pitch", "Yaw"), strict=True)
    return {
        f"{rate}_start": float(np.radians(published[f"bodyAngularRateWrtEi_deg_s_{axis}"][0]))
        for rate, axis in axes
    }


def trim(name: str, given: Mapping[str, float | str]) -> Given:
    """Pitch, elevator and power at which the first cycle changes neither speed, nor climb, nor pitch rate.

    All of it is digital, its words shown on time.
    """
    patch = until(shipped(name, "digital"), 0.02)
    units = {key: factor(unit) for key, (unit, _) in TRIM.items()}

    def rates(unknown: np.ndarray) -> list[float]:
        tried = {key: value * units[key] for key, value in zip(TRIM, unknown, strict=True)}
        record = hybrid.run(patch, {**given, **tried, "compute_time": 0.0}).record
        # Shown in m/s and rad/s or deg/s; a change of a cycle that is nothing is so in any unit.
        return [
            float(np.diff(record[signal].values[:2])[0]) * 100.0
            for signal in ("flight.speed", "flight.down", "body.q")
        ]

    # From afar: the patch's own parameters are the trim that is judged.
    found, _, reached, why = fsolve(rates, TRIM_START, xtol=1e-12, full_output=True)
    assert reached == 1, why
    return {key: value * units[key] for key, value in zip(TRIM, found.tolist(), strict=True)}


def prepared(case: Case, flight: Flight, published: Published) -> tuple[np.ndarray, Given]:
    """The published rows that are flown, and the parameters that fly them."""
    time = published[time_column(case)]
    rows = published[time <= flight.until_s] if flight.until_s else published
    given: Given = {**flight.parameters, **(orbit_start(rows) if case.orbits else {})}
    if flight.trimmed:
        given |= turning_start(rows)
        given |= trim(flight.patch, given)
    return rows, given


def time_column(case: Case) -> str:
    """Heading of the column of times of a published run."""
    return "time_s" if case.orbits else "time"


def trim_errors(given: Given) -> dict[str, float]:
    """By how much the trim differs from the one found by other means."""
    return {
        f"trim_{key}_{unit}": abs(float(given[key]) / factor(unit) - value)
        for key, (unit, value) in TRIM.items()
    }


def fly(patch: Patch, given: Given, times_s: np.ndarray, machine: str | None = None) -> Shown:
    """The signals of a flight at given times, in SI."""
    result = hybrid.run(until(patch, float(times_s[-1]) + 5.0), given, machine=machine)
    assert result.status == "complete", result
    record, rows_s, timing = result.record, result.record["time"].values, result.machine.timing
    step_s = rows_s[1]
    # What the program computes of a sample is shown in the first row after its compute time.
    late_s = -(-timing.compute // timing.every) * step_s

    def shown(name: str) -> np.ndarray:
        is_word = record[name].attrs["kind"] == "word"
        at = np.searchsorted(rows_s, times_s + (late_s if is_word else 0.0) - step_s / 4)
        return record[name].values[at] * factor(record[name].attrs["units"])

    return shown
