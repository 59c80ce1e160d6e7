"""The strip chart: one pen lane per signal over a shared time axis, as on a pen recorder.

A record of any length is drawn as at most four of its own rows per column (`style.envelope`), so
that drawing time hardly grows with the run and no peak is lost.
"""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from hybrid.charts import style
from hybrid.charts.lanes import Lane, Overloaded, draw_lane, lane_of, overload_text
from hybrid.charts.readout_table import COLUMNS, tables_of
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

__all__ = ["save", "strip_chart"]

MAX_LANES = 12
MOST_TASKS = 5  # of which the heading tells the cycle time
LETTERS = 165  # of a line of the heading

WIDTH_IN = 12.0
LEFT_IN = 2.15
RIGHT_IN = 1.55
GAP_IN = 0.1

BROKEN_OFF = ("interrupted", "stopped")


def strip_chart(
    record: Recorded,
    readouts: Mapping[str, Mapping[str, Any]] | None = None,
    prediction: Sequence[Mapping[str, Any]] | None = None,
    signals: Sequence[str] | None = None,
) -> Figure:
    """Draw a record as a strip chart.

    record: dimension `time` (s); one float64 variable per signal, in problem units, with
        attributes units, full_scale, kind ('analog', 'adc', 'dac' or 'word').
    readouts: name -> {'omega', 'omega_damped' (rad/s), 'zeta', each with '..._error', 'reason'}, or
        {'value', 'time_s', 'units', 'kind', 'signal'}.
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
    lanes = [lane_of(record, name, overloads.get(name, ())) for name in names[:MAX_LANES]]
    spans = _mode_spans(record, time_s)
    head = _heading(record, lanes, len(names), LEGEND if spans else "")
    span_s = float(np.abs(time_s).max(initial=0.0))
    tables = tables_of(readouts or {}, prediction or (), span_s)
    foot = _footnotes(lanes, overloads, span_s)
    with style.chart_style():
        broken_off = record.attrs.get("status") in BROKEN_OFF
        until_s = float(record.attrs.get("until_s", 0.0))
        return _draw(time_s, lanes, spans, head, tables, foot, broken_off, until_s)


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


def _overloads(record: Recorded) -> dict[str, list[Overloaded]]:
    """Signal -> its overloads, by time."""
    found: dict[str, list[Overloaded]] = {}
    for event in json.loads(record.attrs.get("overloads") or "[]"):
        signal = str(event["signal"]).removesuffix(" (DAC)")
        lasts_s = float(event.get("duration_s") or 0.0)
        shown = Overloaded(float(event["time_s"]), int(event.get("instants", 1)), lasts_s)
        found.setdefault(signal, []).append(shown)
    return {signal: sorted(events) for signal, events in found.items()}


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
        f"{int(about['operations']):,} operations" if "operation" in about else "",
        f"{style.duration(span, 6)} recorded",
        str(about.get("rows_note", "")),
        _between_rows(record, lanes),
        legend,
    ]
    lines = [(str(about.get("title") or about.get("patch") or "Record"), style.INK)]
    lines += [(line, style.MUTED) for line in style.wrapped(facts, LETTERS)]
    lines += [(line, style.MUTED) for line in style.parameter_lines(about, LETTERS)]
    if about.get("status") in BROKEN_OFF:
        status, note = str(about["status"]), str(about.get("status_note", ""))
        told = note if note.lower().startswith(status) else f"{status}: {note}".rstrip(": ")
        lines += [(line, style.ALARM) for line in textwrap.wrap(told[0].upper() + told[1:], 150)]
    if signal_count > MAX_LANES:
        lines.append((f"{MAX_LANES} of {signal_count} signals are drawn.", style.INK))
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
    lanes: Sequence[Lane], overloads: Mapping[str, Sequence[Overloaded]], span_s: float
) -> list[str]:
    """Name the overloads that no lane can show."""
    drawn = {lane.name for lane in lanes}
    others = {name: overload_text(events, span_s) for name, events in overloads.items()}
    parts = [f"{name} {told}" for name, told in others.items() if name not in drawn]
    return textwrap.wrap(f"Signals not drawn: {';  '.join(parts)}", 160) if parts else []


# -- drawing ---------------------------------------------------------------------------------------


def _draw(
    time_s: Floats,
    lanes: Sequence[Lane],
    spans: list[Span],
    head: Sequence[tuple[str, str]],
    tables: tuple[Sequence[TableRow], Sequence[TableRow]],
    foot: Sequence[str],
    broken_off: bool,
    until_s: float,
) -> Figure:
    """Lay the chart out from the top, in inches: heading, lanes, time axis, tables, footnotes.

    tables: of modes, under their headings, and of what other readouts say, which has none; until_s:
    the end of the run, or 0 where the record does not say.
    """
    rows, readings = tables
    lane_in = min(max(9.0 / max(len(lanes), 1), 0.8), 1.35)
    head_in = 0.62 + LINE_IN * (len(head) - 1)
    below_in = head_in + max(len(lanes), 1) * (lane_in + GAP_IN) + 0.62
    readings_in = below_in + (LINE_IN * (len(rows) + 1) + 0.1 if rows else 0.0)
    foot_in = readings_in + (LINE_IN * len(readings) + 0.1 if readings else 0.0)
    figure = Figure(figsize=(WIDTH_IN, foot_in + LINE_IN * len(foot) + 0.1))
    style.draw_heading(figure, head)
    limits = _time_limits(time_s, until_s, broken_off)
    for place, lane in enumerate(lanes):
        top_in = head_in + place * (lane_in + GAP_IN)
        box_in = (LEFT_IN, top_in, WIDTH_IN - LEFT_IN - RIGHT_IN, lane_in)
        axes = style.axes_at(figure, box_in, lane.name)
        at_in = (top_in + lane_in / 2, WIDTH_IN - RIGHT_IN)
        shade_modes(axes, spans)
        draw_lane(figure, axes, lane, time_s, limits, at_in)
        if broken_off and len(time_s):
            axes.axvline(time_s[-1], color=style.ALARM, lw=1.2, ls=(0, (4, 2)))
    if lanes:
        _draw_time_axis(axes, limits)
    else:
        write(figure, LEFT_IN, head_in + lane_in / 2, "No signals in this record.", fontsize=11)
    if rows:
        style.draw_table(figure, rows, COLUMNS, below_in)
    style.draw_table(figure, readings, {}, readings_in - LINE_IN)
    for place, line in enumerate(foot):
        write(figure, MARGIN_IN, foot_in + place * LINE_IN, line, color=style.ALARM, va="center")
    return figure


def _time_limits(time_s: Floats, until_s: float, broken_off: bool) -> tuple[float, float]:
    """Return the ends of the time axis (s); a record of one row or none gets an axis to the end of the
    run, and one that was broken off gets blank paper after its end.
    """
    start, end = (float(time_s[0]), float(time_s[-1])) if len(time_s) else (0.0, 1.0)
    if end <= start:
        return start, until_s if until_s > start else start + 1.0
    return start, end + (0.04 * (end - start) if broken_off else 0.0)


def _draw_time_axis(axes: Axes, limits: tuple[float, float]) -> None:
    per_second, unit = style.time_scale(max(map(abs, limits)))
    slack = 1e-9 * (limits[1] - limits[0])
    ticks_s = [t for t in style.time_ticks(limits) if limits[0] - slack <= t <= limits[1] + slack]
    axes.set_xticks(ticks_s, [number(tick * per_second, 8) for tick in ticks_s])
    axes.set_xlabel(f"time, {unit}")
    axes.xaxis.set_visible(True)
