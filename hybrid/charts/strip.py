"""The strip chart: one pen lane per signal over a shared time axis, as on a pen recorder.

A record of any length is drawn as at most four of its own rows per column (`style.envelope`), so
that drawing time hardly grows with the run and no peak is lost.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hybrid.beside import mode_beside
from hybrid.charts import style
from hybrid.charts.shading import LEGEND, Span, mode_spans, shade_modes
from hybrid.charts.style import LINE_IN, MARGIN_IN, TableRow, number, save, write
from hybrid.errors import RunError, did_you_mean
from hybrid.modes import MODE_VARIABLE
from hybrid.scale import time_scale_text

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from hybrid.storage import PlainRecord

    Recorded = xr.Dataset | PlainRecord

    Floats = NDArray[np.float64]

__all__ = ["lane_limits", "save", "strip_chart"]

MAX_LANES = 12
MOST_TASKS = 5  # of which the heading tells the cycle time
LETTERS = 165  # of a line of the heading
TINY = 1e-290  # below this a signal is drawn as zero, above its reciprocal as missing
FAR_LESS = 0.25  # a signal within this fraction of its full scale gets a lane scale of its own

WIDTH_IN = 12.0
LEFT_IN = 2.15
RIGHT_IN = 1.55
GAP_IN = 0.1

PEN_OF_KIND = dict(zip(("analog", "dac", "adc", "word"), style.PENS, strict=False))
KIND_TEXT = {"analog": "analog", "dac": "DAC", "adc": "ADC", "word": "word"}
BROKEN_OFF = ("interrupted", "stopped")
TABLE_COLUMNS = {
    "omega": "undamped frequency |s|, rad/s",
    "omega_damped": "damped frequency, rad/s",
    "zeta": "damping ratio ζ",
}
MAX_TABLE_ROWS = 10
# Below a table that has errors: what a reader has to know of them.
ERROR_TEXT = (
    "±  one standard deviation, as this record alone tells it, of noise in it and in the loop"
)


@dataclass(frozen=True)
class Lane:
    """What one pen draws: values in problem units, the scale of its lane, its overloads."""

    name: str
    kind: str
    units: str
    full_scale: float
    values: Floats
    low: float
    high: float
    overloads: tuple[tuple[float, int], ...]  # first time (s), number of instants
    held: bool  # stands still but where it jumps


def strip_chart(
    record: Recorded,
    readouts: Mapping[str, Mapping[str, Any]] | None = None,
    prediction: Sequence[Mapping[str, Any]] | None = None,
    signals: Sequence[str] | None = None,
) -> Figure:
    """Draw a record as a strip chart.

    record: dimension `time` (s); one float64 variable per signal, in problem units, with
        attributes units, full_scale, kind ('analog', 'adc', 'dac' or 'word').
    readouts: name -> {'omega', 'omega_damped' (rad/s), 'zeta', each with '..._error', 'reason'}.
    prediction: modes of the exact one-cycle map, each {'omega', 'omega_damped', 'zeta',
        'omega_ideal', 'zeta_ideal', 'closed_form': {'equation', 'omega', 'zeta'} or None}.
    signals: names of the signals to draw, in order; the first 12 of the record if not given.

    Analog signals are lines; converters, words and those with the attribute `held` (comparators,
    relays and what follows of them alone) are steps that hold their value. A lane shows
    plus and minus full scale, or less where the signal stays within a quarter of it, and says so.
    Where the record has the machine's mode, IC and HOLD are shaded.
    Raises ValueError for a record without `time`, RunError for a signal that is not in it.
    """
    if "time" not in record.coords:
        raise ValueError("a strip chart needs a record with the coordinate 'time', in seconds")
    names = _chosen_signals(record, signals)
    time_s = np.asarray(record["time"].values, dtype=np.float64)
    overloads = _overloads(record)
    lanes = [_lane(record, name, overloads.get(name, ())) for name in names[:MAX_LANES]]
    spans = _mode_spans(record, time_s)
    head = _heading(record, lanes, len(names), LEGEND if spans else "")
    transients = {name: its for name, its in (readouts or {}).items() if "omega" in its}
    others = {name: its for name, its in (readouts or {}).items() if "omega" not in its}
    rows = _table_rows(transients, prediction or ())
    readings = _cut([row for name, its in others.items() for row in _readout_rows(name, its)])
    if any(math.isfinite(error) for row in rows for _, error in row.cells.values()):
        rows = [*rows, TableRow(ERROR_TEXT, color=style.MUTED)]
    foot = _footnotes(lanes, overloads, float(np.abs(time_s).max(initial=0.0)))
    with style.chart_style():
        broken_off = record.attrs.get("status") in BROKEN_OFF
        return _draw(time_s, lanes, spans, head, (rows, readings), foot, broken_off)


def lane_limits(values: Floats, full_scale: float) -> tuple[float, float]:
    """Choose the lowest and highest value a lane shows, in problem units.

    Plus and minus full scale if the signal uses a good part of it (more if it went beyond); else
    round limits about zero, or about the signal itself where it varies little far from zero.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    peak, used = max(abs(low), abs(high)), high - low
    limit = full_scale if math.isfinite(full_scale) and full_scale > 0 else 0.0
    if peak < TINY:
        limit = limit or 1.0
    elif 0 < used < FAR_LESS / 2 * peak:
        ticks = MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
        return float(ticks[0]), float(ticks[-1])
    elif not FAR_LESS * limit <= peak <= limit:
        limit = style.round_up(peak)
    return -limit, limit


# -- from the record to plain values ---------------------------------------------------------------


def _chosen_signals(record: Recorded, signals: Sequence[str] | None) -> list[str]:
    available = [str(name) for name in record.data_vars]
    if signals is None:
        return [name for name in available if record[name].attrs.get("kind") != "mode"]
    for name in signals:
        if name not in available:
            raise RunError(f"no signal {name!r} in the record; {did_you_mean(name, available)}")
    return list(signals)


def _mode_spans(record: Recorded, time_s: Floats) -> list[Span]:
    """Where the machine was in IC and HOLD."""
    known = MODE_VARIABLE in record.data_vars and len(time_s) > 1
    if not known or record[MODE_VARIABLE].attrs.get("kind") != "mode":
        return []
    return mode_spans(time_s, np.asarray(record[MODE_VARIABLE].values))


def _overloads(record: Recorded) -> dict[str, list[tuple[float, int]]]:
    """Signal -> its overloads as (first time in s, number of instants), by time."""
    found: dict[str, list[tuple[float, int]]] = {}
    for event in json.loads(record.attrs.get("overloads") or "[]"):
        signal = str(event["signal"]).removesuffix(" (DAC)")
        found.setdefault(signal, []).append((float(event["time_s"]), int(event.get("instants", 1))))
    return {signal: sorted(events) for signal, events in found.items()}


def _lane(record: Recorded, name: str, overloads: Sequence[tuple[float, int]]) -> Lane:
    about = record[name].attrs
    values = style.results(record, name)
    values = np.where(np.abs(values) < 1 / TINY, values, np.nan)
    full_scale = float(about.get("full_scale", math.nan))
    units, kind = style.unit_text(str(about.get("units", ""))), str(about.get("kind", "analog"))
    limits = lane_limits(values, full_scale)
    held = style.is_held(about)
    return Lane(name, kind, units, full_scale, values, *limits, tuple(overloads), held)


def _heading(
    record: Recorded, lanes: Sequence[Lane], signal_count: int, legend: str = ""
) -> list[tuple[str, str]]:
    """Return the lines above the lanes, each with its colour; the first is the title."""
    about = record.attrs
    time_s = record["time"].values
    span = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
    facts = [
        *style.provenance(about),
        time_scale_text(float(about.get("time_scale", 1.0))),
        _clocks(about),
        f"{int(about['cycles']):,} cycles" if about.get("cycles") else "",
        f"{int(about['operations']):,} operations" if about.get("operations") else "",
        f"{style.duration(span)} recorded",
        str(about.get("rows_note", "")),
        _between_rows(record, lanes),
        legend,
    ]
    lines = [(str(about.get("title") or about.get("patch") or "Record"), style.INK)]
    lines += [(line, style.MUTED) for line in style.wrapped(facts, LETTERS)]
    given = json.loads(about.get("parameters") or "{}")
    if given:
        text = "with  " + ",  ".join(
            f"{key} = {style.unit_text(value)}".replace(" ", "\u00a0")
            for key, value in given.items()
        )
        wrapped = textwrap.wrap(text, LETTERS, max_lines=2, placeholder=" …")
        lines += [(line.replace("\u00a0", " "), style.MUTED) for line in wrapped]
    if about.get("status") in BROKEN_OFF:
        status, note = str(about["status"]), str(about.get("status_note", ""))
        told = note if note.lower().startswith(status) else f"{status}: {note}".rstrip(": ")
        lines += [(line, style.ALARM) for line in textwrap.wrap(told[0].upper() + told[1:], 150)]
    if signal_count > MAX_LANES:
        lines.append((f"The first {MAX_LANES} of {signal_count} signals are drawn.", style.INK))
    return lines


def _between_rows(record: Recorded, lanes: Sequence[Lane]) -> str:
    """Say where the digital machine is faster than the record, whose steps then are not its own."""
    time_s, about = record["time"].values, record.attrs
    periods_s = [row.get("period_s") for row in json.loads(about.get("tasks") or "[]")]
    period_s = min(filter(None, periods_s), default=float(about.get("cycle_s", math.nan)))
    digital = any(lane.held and lane.kind != "analog" for lane in lanes)
    if not digital or len(time_s) < 2 or not period_s < (time_s[1] - time_s[0]) * (1 - 1e-9):
        return ""
    apart, fastest = style.duration(time_s[1] - time_s[0]), style.duration(period_s)
    return f"digital signals as they stand at the rows, {apart} apart; a cycle takes {fastest}"


def _clocks(about: Mapping[str, Any]) -> str:
    """The cycle time, of several tasks that of each, or what starts it: 'T = 2 ms'."""
    rows = json.loads(about.get("tasks") or "[]")
    cycle_s = float(about.get("cycle_s", math.nan))
    if len(rows) < 2 and not any(row.get("when") for row in rows):
        return f"T = {style.duration(cycle_s)}" if math.isfinite(cycle_s) else ""
    told = [
        f"{row['task']} {style.duration(row['period_s'])}"
        if row["period_s"]
        else f"{row['task']} when {row['when']}"
        for row in rows[:MOST_TASKS]
    ]
    told += [f"{len(rows) - MOST_TASKS} more"] if len(rows) > MOST_TASKS else []
    return f"T: {', '.join(told)}"


def _footnotes(
    lanes: Sequence[Lane], overloads: Mapping[str, Sequence[tuple[float, int]]], span_s: float
) -> list[str]:
    """Name the overloads that no lane can show."""
    drawn = {lane.name for lane in lanes}
    others = {name: _told(events, span_s) for name, events in overloads.items()}
    parts = [f"{name} {told}" for name, told in others.items() if name not in drawn]
    return textwrap.wrap(f"Signals not drawn: {';  '.join(parts)}", 160) if parts else []


def _told(events: Sequence[tuple[float, int]], span_s: float) -> str:
    """Write overloads as text: 'overload at 7.2 s', 'overload from 7.2 s, 310 instants'."""
    instants = sum(count for _, count in events)
    per_second, unit = style.time_scale(span_s)
    at = f"{number(events[0][0] * per_second, 6)} {unit}"
    return f"overload from {at}, {instants:,} instants" if instants > 1 else f"overload at {at}"


def _table_rows(
    readouts: Mapping[str, Mapping[str, Any]], prediction: Sequence[Mapping[str, Any]]
) -> list[TableRow]:
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
    if len(rows) <= MAX_TABLE_ROWS:
        return rows
    left_out = len(rows) - MAX_TABLE_ROWS + 1
    return [*rows[: MAX_TABLE_ROWS - 1], TableRow(f"and {left_out} more lines")]


def _pair_rows(
    readouts: Mapping[str, Mapping[str, Any]], prediction: Sequence[Mapping[str, Any]]
) -> list[TableRow]:
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


def _readout_rows(name: str, measured: Mapping[str, Any]) -> list[TableRow]:
    """Return a transient's figures in columns, any other readout's in words; then the remarks."""
    cells = _cells(measured)
    told = [str(measured[key]) for key in ("reason", "note") if measured.get(key)]
    row = TableRow(f"measured, {name}", cells, color=style.PENS[0])
    if any(math.isfinite(value) for value, _ in cells.values()):
        remarks = textwrap.wrap(";  ".join(told), 120)
        return [row, *(TableRow("", note=remark) for remark in remarks)]
    if not told:
        numbers = {key: value for key, value in measured.items() if isinstance(value, int | float)}
        units = {"value": style.unit_text(str(measured.get("units", ""))), "time_s": "s"}
        told = [
            f"{key.removesuffix('_s')} {number(float(value), 6)} {units.get(key, '')}".rstrip()
            for key, value in numbers.items()
        ]
    lines = textwrap.wrap(",  ".join(told), 120) or ["none"]
    return [replace(row, note=lines[0]), *(TableRow("", note=line) for line in lines[1:])]


def _cells(figures: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    def figure(key: str) -> float:
        return math.nan if figures.get(key) is None else float(figures[key])

    return {key: (figure(key), figure(f"{key}_error")) for key in TABLE_COLUMNS}


# -- drawing ---------------------------------------------------------------------------------------


def _draw(
    time_s: Floats,
    lanes: Sequence[Lane],
    spans: list[Span],
    head: Sequence[tuple[str, str]],
    tables: tuple[Sequence[TableRow], Sequence[TableRow]],
    foot: Sequence[str],
    broken_off: bool,
) -> Figure:
    """Lay the chart out from the top, in inches: heading, lanes, time axis, tables, footnotes.

    tables: of modes, under their headings, and of what other readouts say, which has none.
    """
    rows, readings = tables
    lane_in = min(max(9.0 / max(len(lanes), 1), 0.8), 1.35)
    head_in = 0.62 + LINE_IN * (len(head) - 1)
    below_in = head_in + max(len(lanes), 1) * (lane_in + GAP_IN) + 0.62
    readings_in = below_in + (LINE_IN * (len(rows) + 1) + 0.1 if rows else 0.0)
    foot_in = readings_in + (LINE_IN * len(readings) + 0.1 if readings else 0.0)
    figure = Figure(figsize=(WIDTH_IN, foot_in + LINE_IN * len(foot) + 0.1))
    style.draw_heading(figure, head)
    limits = _time_limits(time_s, broken_off)
    for place, lane in enumerate(lanes):
        top_in = head_in + place * (lane_in + GAP_IN)
        box_in = (LEFT_IN, top_in, WIDTH_IN - LEFT_IN - RIGHT_IN, lane_in)
        axes = style.axes_at(figure, box_in, lane.name)
        _draw_paper(axes, lane, limits)
        shade_modes(axes, spans)
        _label_lane(figure, lane, top_in + lane_in / 2)
        _draw_pen(axes, lane, time_s)
        _draw_overloads(axes, lane, limits)
        if broken_off and len(time_s):
            axes.axvline(time_s[-1], color=style.ALARM, lw=1.2, ls=(0, (4, 2)))
    if lanes:
        _draw_time_axis(axes, limits)
    else:
        write(figure, LEFT_IN, head_in + lane_in / 2, "No signals in this record.", fontsize=11)
    if rows:
        style.draw_table(figure, rows, TABLE_COLUMNS, below_in)
    style.draw_table(figure, readings, {}, readings_in - LINE_IN)
    for place, line in enumerate(foot):
        write(figure, MARGIN_IN, foot_in + place * LINE_IN, line, color=style.ALARM, va="center")
    return figure


def _time_limits(time_s: Floats, broken_off: bool) -> tuple[float, float]:
    """Return the ends of the time axis (s); a record of one row or none still gets an axis, and
    one that was broken off gets blank paper after its end.
    """
    start, end = (float(time_s[0]), float(time_s[-1])) if len(time_s) else (0.0, 1.0)
    if end <= start:
        return start - 0.5, start + 0.5
    return start, end + (0.04 * (end - start) if broken_off else 0.0)


def _draw_paper(axes: Axes, lane: Lane, limits: tuple[float, float]) -> None:
    """Rule the lane as chart paper and mark full scale, where it lies within the lane."""
    middle, half = (lane.low + lane.high) / 2, (lane.high - lane.low) / 2
    axes.set_xlim(*limits)
    headroom = 1.45 if lane.overloads else 1.18  # for the mark and its text
    axes.set_ylim(middle - 1.18 * half, middle + headroom * half)
    style.rule(axes, style.time_ticks(limits), np.linspace(lane.low, lane.high, 9))
    for full_scale in (-lane.full_scale, lane.full_scale):
        if abs(full_scale - middle) <= 1.1 * half:
            axes.axhline(full_scale, color=style.LIMIT, lw=1.1, zorder=1, label="full scale")
    digits = 4 + max(0, math.ceil(math.log10(abs(middle) / half))) if middle else 4
    marks = (lane.low, middle, lane.high)
    axes.set_yticks(marks, [number(mark, digits) for mark in marks])
    axes.xaxis.set_visible(False)


def _draw_time_axis(axes: Axes, limits: tuple[float, float]) -> None:
    per_second, unit = style.time_scale(max(map(abs, limits)))
    slack = 1e-9 * (limits[1] - limits[0])
    ticks_s = [t for t in style.time_ticks(limits) if limits[0] - slack <= t <= limits[1] + slack]
    axes.set_xticks(ticks_s, [number(tick * per_second, 8) for tick in ticks_s])
    axes.set_xlabel(f"time, {unit}")
    axes.xaxis.set_visible(True)


def _label_lane(figure: Figure, lane: Lane, middle_in: float) -> None:
    """Write name, kind and unit at the lane's left, extremes and scale at its right."""
    name, color = style.broken(lane.name), PEN_OF_KIND.get(lane.kind, style.INK)
    bold = {"weight": "bold", "color": color, "fontsize": 9.0 if "\n" in name else 10.5}
    write(figure, MARGIN_IN, middle_in + 0.02, name, va="bottom", **bold)
    about = ",  ".join(text for text in (lane.units, KIND_TEXT.get(lane.kind, lane.kind)) if text)
    muted = {"color": style.MUTED, "fontsize": 8.5}
    write(figure, MARGIN_IN, middle_in + 0.08, about, va="top", **muted)
    lines = [(text, style.MUTED) for text in _extremes(lane.values)]
    if math.isfinite(lane.full_scale) and lane.full_scale > 0:
        lines.append((f"full scale ±{number(lane.full_scale)}", style.LIMIT_TEXT))
        share = (lane.high - lane.low) / (2 * lane.full_scale)
        if share < 0.999:
            lines.append((f"lane shows {number(100 * share, 2)} % of it", style.LIMIT_TEXT))
    for place, (text, color) in enumerate(lines):
        top_in = middle_in + 0.165 * (place - (len(lines) - 1) / 2)
        right_in = WIDTH_IN - RIGHT_IN + 0.12
        write(figure, right_in, top_in, text, va="center", color=color, fontsize=8)


def _extremes(values: Floats) -> list[str]:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return ["no values"]
    told = [f"max {number(finite.max())}", f"min {number(finite.min())}"]
    missing = values.size - finite.size
    rows = "1 row has" if missing == 1 else f"{missing:,} rows have"
    return [*told, f"{rows} no value"] if missing else told


def _draw_pen(axes: Axes, lane: Lane, time_s: Floats) -> None:
    """Draw the trace: a line, or steps where the signal holds its values."""
    times, values = style.envelope(time_s, lane.values)
    style_of_line = "steps-post" if lane.held else "default"
    marker = "o" if np.count_nonzero(np.isfinite(values)) == 1 else ""
    color = PEN_OF_KIND.get(lane.kind, style.INK)
    look: dict[str, Any] = {"color": color, "lw": 1.15, "marker": marker, "zorder": 3}
    axes.plot(times, values, drawstyle=style_of_line, label=lane.name, **look)


def _draw_overloads(axes: Axes, lane: Lane, limits: tuple[float, float]) -> None:
    """Mark the first instant of each overload on the lane's upper edge, and say how many."""
    events = [event for event in lane.overloads if limits[0] <= event[0] <= limits[1]]
    if not events:
        return
    times, edge = [time for time, _ in events], axes.get_xaxis_transform()
    look: dict[str, Any] = {
        "color": style.ALARM,
        "marker": "v",
        "markersize": 6.5,
        "ls": "",
        "zorder": 5,
    }
    axes.plot(times, [0.96] * len(times), transform=edge, label="overload", clip_on=False, **look)
    axes.axvline(times[0], color=style.ALARM, lw=0.8, alpha=0.6, zorder=2)
    on_left = times[0] < (limits[0] + limits[1]) / 2
    axes.annotate(
        _told(events, max(map(abs, limits))),
        (times[0], 0.93),
        xycoords=edge,
        xytext=(7 if on_left else -7, 0),
        textcoords="offset points",
        ha="left" if on_left else "right",
        va="center",
        color=style.ALARM,
        fontsize=8,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.2},
        zorder=6,
    )
