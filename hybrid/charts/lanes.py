"""One lane of a strip chart: what its pen draws, the paper under it, what is written beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hybrid.charts import style
from hybrid.charts.style import MARGIN_IN, number, write

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from hybrid.storage import PlainRecord

    Recorded = xr.Dataset | PlainRecord

    Floats = NDArray[np.float64]

TINY = 1e-290  # below this a signal is drawn as zero, above its reciprocal as missing
FAR_LESS = 0.25  # a signal within this fraction of its full scale gets a lane scale of its own

PEN_OF_KIND = dict(zip(("analog", "dac", "adc", "word"), style.PENS, strict=False))
KIND_TEXT = {"analog": "analog", "dac": "DAC", "adc": "ADC", "word": "word"}


class Overloaded(NamedTuple):
    """An overload of a signal, as its lane shows it."""

    first_s: float
    instants: int
    duration_s: float  # 0 where it is not known, of converters and words


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
    overloads: tuple[Overloaded, ...]
    held: bool  # stands still but where it jumps
    first_s: float = -math.inf  # first result of an ADC or a word
    early: int = 0  # rows before it


def lane_limits(values: Floats, full_scale: float) -> tuple[float, float]:
    """Choose the lowest and highest value a lane shows, in problem units.

    Plus and minus full scale if the signal uses a good part of it (more if it went beyond); else
    round limits about zero, or about the signal itself where it varies little far from zero. What has
    no full scale and one sign goes from zero.
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
        one_sided = not limit and low * high >= 0.0
        limit = style.round_up(peak)
        if one_sided:
            return (0.0, limit) if high > 0.0 else (-limit, 0.0)
    return -limit, limit


def lane_of(record: Recorded, name: str, overloads: Sequence[Overloaded]) -> Lane:
    """The lane of a recorded signal."""
    about = record[name].attrs
    values = style.results(record, name)
    values = np.where(np.abs(values) < 1 / TINY, values, np.nan)
    full_scale = float(about.get("full_scale", math.nan))
    units, kind = style.unit_text(str(about.get("units", ""))), str(about.get("kind", "analog"))
    limits = lane_limits(values, full_scale)
    held = style.is_held(about)
    first_s = float(about.get("first_result_s", -math.inf))
    early = int(np.count_nonzero(np.asarray(record["time"].values) < first_s))
    lane = Lane(name, kind, units, full_scale, values, *limits, tuple(overloads), held)
    return replace(lane, first_s=first_s, early=early)


def overload_text(events: Sequence[Overloaded], span_s: float) -> str:
    """Write overloads as text: 'overload at 7.2 s', 'overload from 7.2 s, for 0.4 s in all'.

    Converters and words have instants alone: 'overload from 7.2 s, 310 instants'.
    """
    per_second, unit = style.time_scale(span_s)
    at = f"{number(events[0].first_s * per_second, 6)} {unit}"
    instants, lasts_s = (sum(each) for each in zip(*(event[1:] for event in events), strict=True))
    if lasts_s > 0.0:
        return f"overload from {at}, for {style.duration(lasts_s)} in all"
    return f"overload from {at}, {instants:,} instants" if instants > 1 else f"overload at {at}"


def draw_lane(
    figure: Figure,
    axes: Axes,
    lane: Lane,
    time_s: Floats,
    limits: tuple[float, float],
    at_in: tuple[float, float],
) -> None:
    """Draw a lane on its axes; limits: of the time axis, s; at_in: its middle from the figure's top,
    and where its axes end, from the figure's left."""
    _draw_paper(axes, lane, limits)
    _label(figure, lane, *at_in)
    _draw_pen(axes, lane, time_s)
    _draw_overloads(axes, lane, limits)


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


def _label(figure: Figure, lane: Lane, middle_in: float, end_in: float) -> None:
    """Write name, kind and unit at the lane's left, extremes and scale at its right."""
    name, color = style.broken(lane.name), PEN_OF_KIND.get(lane.kind, style.INK)
    bold = {"weight": "bold", "color": color, "fontsize": 9.0 if "\n" in name else 10.5}
    write(figure, MARGIN_IN, middle_in + 0.02, name, va="bottom", **bold)
    about = ",  ".join(text for text in (lane.units, KIND_TEXT.get(lane.kind, lane.kind)) if text)
    muted = {"color": style.MUTED, "fontsize": 8.5}
    write(figure, MARGIN_IN, middle_in + 0.08, about, va="top", **muted)
    lines = [(text, style.MUTED) for text in _extremes(lane)]
    if math.isfinite(lane.full_scale) and lane.full_scale > 0:
        lines.append((f"full scale ±{number(lane.full_scale)}", style.LIMIT_TEXT))
        share = (lane.high - lane.low) / (2 * lane.full_scale)
        if share < 0.999:
            # Of a lane away from 0 that is a width, not a part of the range around 0.
            told = "lane shows {} % of it" if lane.low < 0 < lane.high else "lane {} % of it wide"
            lines.append((told.format(number(100 * share, 2)), style.LIMIT_TEXT))
    for place, (text, color) in enumerate(lines):
        top_in = middle_in + 0.165 * (place - (len(lines) - 1) / 2)
        write(figure, end_in + 0.12, top_in, text, va="center", color=color, fontsize=8)


def _extremes(lane: Lane) -> list[str]:
    """Largest and least value, and why rows have none."""
    finite = lane.values[np.isfinite(lane.values)]
    if not finite.size:
        return ["no values"]
    least, largest = float(finite.min()), float(finite.max())
    digits = style.digits_apart(least, largest, 4)
    told = [f"max {number(largest, digits)}", f"min {number(least, digits)}"]
    if lane.early:
        told += ["nothing before the", f"first result, {style.duration(lane.first_s)}"]
    missing = lane.values.size - finite.size - lane.early
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
    """Mark the first instant of each overload on the lane's upper edge, and say how long."""
    events = [event for event in lane.overloads if limits[0] <= event.first_s <= limits[1]]
    if not events:
        return
    times, edge = [event.first_s for event in events], axes.get_xaxis_transform()
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
        overload_text(events, max(map(abs, limits))),
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
