"""The published table shots of the F-16's models: what each gives for given inputs, and how far off it is.

The shots are a file beside each model; they are put back into it as its check data and compared as
`hybrid check` does. One of the engine's thrusts is printed with four decimals, but is a single-precision
figure in the published file: where a figure misses its tolerance, a spacing of float32 is allowed.
"""

from __future__ import annotations

import csv
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

import hybrid
from hybrid.shots import ShotRow, check_shots

TOLERANCES = {"F16_aero": 1e-6, "F16_prop": 1e-5}  # as published
UNITS = {
    "trueAirspeed": "f_s",
    "powerLeverAngle": "pct",
    "altitudeMSL": "ft",
    "mach": "nd",
    "bodyAngularRate_Roll": "r_s",
    "bodyAngularRate_Pitch": "r_s",
    "bodyAngularRate_Yaw": "r_s",
}  # all other inputs are in deg
PATCH = """\
title: Shots
models: {{{name}: {{file: {name}.dml, inputs: {{}}}}}}
digital: {{period: 1 s, program: {{x: 1 + 1}}}}
run: {{until: 1 s}}
"""


def judged(reference: Path) -> list[dict[str, Any]]:
    """A row for each model: how many values, how many agree, the largest error and where that is."""
    return [_row(name, _compared(reference, name)) for name in TOLERANCES]


def _row(name: str, rows: list[ShotRow]) -> dict[str, Any]:
    worst = max(rows, key=_error)
    within = sum(row.agrees for row in rows)
    single = sum(not row.agrees and _error(row) <= _spacing(row) for row in rows)
    return {
        "model": name,
        "shots": len({row.shot for row in rows}),
        "values": len(rows),
        "within": within,
        "within_float32": single,
        "largest_error": _error(worst),
        "output": worst.output,
        "published": worst.published,
        "tolerance": TOLERANCES[name],
        "pass": within + single == len(rows),
    }


def _error(row: ShotRow) -> float:
    return np.inf if row.found is None else abs(row.found - row.published)


def _spacing(row: ShotRow) -> float:
    return float(np.spacing(np.float32(abs(row.published))))


def _compared(reference: Path, name: str) -> list[ShotRow]:
    """Every published value beside what the model gives; printed ones are off by half of a last digit."""
    model = (reference / "models" / f"{name}.dml").read_text(encoding="utf-8")
    with (reference / "f16_table_shots" / f"{name}_shots.csv").open() as stream:
        shots = "".join(_shot(row, TOLERANCES[name]) for row in csv.DictReader(stream))
    with tempfile.TemporaryDirectory() as folder:
        patch, file = (Path(folder) / f"{name}.{ending}" for ending in ("yaml", "dml"))
        data = f"<checkData>{shots}</checkData></DAVEfunc>"
        file.write_text(model.replace("</DAVEfunc>", data), encoding="utf-8")
        patch.write_text(PATCH.format(name=name), encoding="utf-8")
        return check_shots(hybrid.read_patch(patch))[0]


def _shot(row: Mapping[str, str], tolerance: float) -> str:
    inputs, outputs = "".join(_inputs(row)), "".join(_outputs(row, tolerance))
    return (
        f'<staticShot name="{escape(row["shot"])}"><checkInputs>{inputs}</checkInputs>'
        f"<checkOutputs>{outputs}</checkOutputs></staticShot>"
    )


def _inputs(row: Mapping[str, str]) -> Iterator[str]:
    for key, value in row.items():
        if name := key.removeprefix("in_") if key.startswith("in_") else "":
            units = f"<signalUnits>{UNITS.get(name, 'deg')}</signalUnits>"
            yield f"<signal><signalName>{name}</signalName>{units}{_value(value)}</signal>"


def _outputs(row: Mapping[str, str], tolerance: float) -> Iterator[str]:
    for key, value in row.items():
        if name := key.removeprefix("out_") if key.startswith("out_") else "":
            most = tolerance + 0.5 * 10.0 ** -len(value.partition(".")[2])
            told = f"<signalName>{name}</signalName>{_value(value)}<tol>{most!r}</tol>"
            yield f"<signal>{told}</signal>"


def _value(text: str) -> str:
    return f"<signalValue>{text}</signalValue>"
