"""The figures below a strip chart: what readouts measured, and beside it what was predicted."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from hybrid.beside import mode_beside
from hybrid.charts import style
from hybrid.charts.style import TableRow, number
from hybrid.naming import asked_text

Figures = Mapping[str, Any]

COLUMNS = {
    "omega": "undamped frequency |s|, rad/s",
    "omega_damped": "damped frequency, rad/s",
    "zeta": "damping ratio ζ",
}
MOST_ROWS = 10
# Below a table that has errors: what a reader has to know of them.
ERROR_TEXT = (
    "±  one standard deviation, as this record alone tells it, of noise in it and in the loop"
)


def tables_of(
    readouts: Mapping[str, Figures], prediction: Sequence[Figures], span_s: float = 0.0
) -> tuple[list[TableRow], list[TableRow]]:
    """The table of modes, and that of what other readouts say; the arguments are `strip_chart`'s.

    span_s: the largest time of the chart, whose unit is that of the times in the tables.
    """
    transients = {name: its for name, its in readouts.items() if "omega" in its}
    others = {name: its for name, its in readouts.items() if "omega" not in its}
    rows = mode_rows(transients, prediction)
    if any(math.isfinite(error) for row in rows for _, error in row.cells.values()):
        rows = [*rows, TableRow(ERROR_TEXT, color=style.MUTED)]
    told = [row for name, its in others.items() for row in _readout_rows(name, its, span_s)]
    return rows, _cut(told)


def mode_rows(readouts: Mapping[str, Figures], prediction: Sequence[Figures]) -> list[TableRow]:
    """Return the measured figures of transients, and below them those of each predicted mode."""
    rows = [row for name, measured in readouts.items() for row in _readout_rows(name, measured)]
    for place, mode in enumerate(prediction, start=1):
        suffix = f", mode {place}" if len(prediction) > 1 else ""
        rows.append(TableRow(f"exact prediction{suffix}", _cells(mode)))
        closed = mode.get("closed_form")
        if closed:
            rows.append(TableRow(f"closed form, Eq. {closed['equation']}{suffix}", _cells(closed)))
        ideal = _cells({"omega": mode.get("omega_ideal"), "zeta": mode.get("zeta_ideal")})
        if any(math.isfinite(value) for value, _ in ideal.values()):
            rows.append(TableRow(f"ideal{suffix}", ideal, color=style.MUTED))
    rows += _pair_rows(readouts, prediction)
    return _cut(rows)


def _cut(rows: list[TableRow]) -> list[TableRow]:
    """Return the rows, or the first of many with a note of the rest."""
    if len(rows) <= MOST_ROWS:
        return rows
    left_out = len(rows) - MOST_ROWS + 1
    return [*rows[: MOST_ROWS - 1], TableRow(f"and {left_out} more lines")]


def _pair_rows(readouts: Mapping[str, Figures], prediction: Sequence[Figures]) -> list[TableRow]:
    """Return the real poles that an overdamped measurement has as one mode."""
    rows: list[TableRow] = []
    for measured in readouts.values():
        overdamped = measured.get("omega") and measured.get("omega_damped") == 0
        mode = mode_beside(measured, prediction) if overdamped else None
        if mode is None or not mode.get("poles"):
            continue
        made = [TableRow("exact, real poles as one", _cells(mode))]
        if mode["omega_ideal"] is not None:
            ideal = _cells({"omega": mode["omega_ideal"], "zeta": mode["zeta_ideal"]})
            made.append(TableRow("ideal, real poles as one", ideal, color=style.MUTED))
        rows += [row for row in made if row not in rows]
    return rows


def _readout_rows(name: str, measured: Figures, span_s: float = 0.0) -> list[TableRow]:
    """Return a transient's figures in columns, any other readout's in words; then the remarks."""
    cells = _cells(measured)
    told = [str(measured[key]) for key in ("reason", "note") if measured.get(key)]
    row = TableRow(f"measured, {name}", cells, color=style.PENS[0])
    if any(math.isfinite(value) for value, _ in cells.values()):
        remarks = textwrap.wrap(";  ".join(told), 120)
        return [row, *(TableRow("", note=remark) for remark in remarks)]
    if not told:
        numbers = {key: value for key, value in measured.items() if isinstance(value, int | float)}
        told = [_figure(measured, key, float(value), span_s) for key, value in numbers.items()]
    lines = textwrap.wrap(",  ".join(told), 120) or ["none"]
    return [replace(row, note=lines[0]), *(TableRow("", note=line) for line in lines[1:])]


def _figure(measured: Figures, key: str, value: float, span_s: float) -> str:
    """One figure of a readout: 'maximum of x = 2.5 V', 'at 85.7 ms'."""
    if key == "value":
        units = style.unit_text(str(measured.get("units", "")))
        return f"{asked_text(measured)} = {number(value, 6)} {units}".rstrip()
    if key == "time_s":
        per_second, unit = style.time_scale(span_s or value)
        return f"at {number(value * per_second, 6)} {unit}"
    return f"{key} {number(value, 6)}"


def _cells(figures: Figures) -> dict[str, tuple[float, float]]:
    def figure(key: str) -> float:
        return math.nan if figures.get(key) is None else float(figures[key])

    return {key: (figure(key), figure(f"{key}_error")) for key in COLUMNS}
