"""What readouts read, against a swept parameter: a panel for each, one curve in it."""

from __future__ import annotations

import math
import re
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from hybrid.charts import style
from hybrid.charts.coupling import coupling_chart
from hybrid.charts.style import LINE_IN, MARGIN_IN, write

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

WIDE = 8.0  # a scale is logarithmic if its figures are positive and their ends this ratio apart
WIDTH_IN = 12.0
LEFT_IN = 1.05
PANEL_IN = 3.4
PANEL_WIDTH_IN = 4.7
BELOW_IN = 0.85  # axis label and room to the next panel
MOST_PANELS = 12
LETTERS = 165  # of a line of the heading
LABEL_LETTERS = 44  # of a line beside a panel


def readings_of(sweep: xr.Dataset) -> list[str]:
    """Variables that hold what a readout other than a transient gave, `value_NAME`."""
    return [str(name) for name in sweep.data_vars if str(name).startswith("value_")]


def sweep_charts(sweep: xr.Dataset, path: Path) -> dict[Path, Figure]:
    """The charts of a sweep by file: modes where it has any, and its other readouts.

    path: file of the first one; a second one has `_readouts` at the end of its name.
    """
    charts = {}
    if sweep.sizes["mode"] or sweep.sizes["readout"] or not readings_of(sweep):
        charts[path] = coupling_chart(sweep)
    if readings_of(sweep):
        file = path.with_name(f"{path.stem}_readouts{path.suffix}") if charts else path
        charts[file] = readings_chart(sweep)
    return charts


def readings_chart(sweep: xr.Dataset) -> Figure:
    """Draw every `value_NAME` of a sweep against the swept parameter.

    sweep: attribute `parameter` names its one swept dimension, whose coordinate has the attribute
        units, as have the variables. MOST_PANELS are drawn, and the heading says so. A scale is
        logarithmic where all its figures are positive and their ends at least a factor of 8 apart.
    """
    swept = str(sweep.attrs["parameter"])
    sweep = sweep.isel({swept: np.argsort(sweep[swept].values, kind="stable")})
    names = readings_of(sweep)
    lines = _heading(sweep, swept, len(names))
    top_in = 0.75 + LINE_IN * len(lines)
    rows = max(1, math.ceil(min(len(names), MOST_PANELS) / 2))
    with style.chart_style():
        figure = Figure(figsize=(WIDTH_IN, top_in + rows * (PANEL_IN + BELOW_IN)))
        style.draw_heading(figure, lines)
        for place, name in enumerate(names[:MOST_PANELS]):
            left_in = LEFT_IN + (place % 2) * WIDTH_IN / 2
            box_top_in = top_in + (place // 2) * (PANEL_IN + BELOW_IN)
            box_in = (left_in, box_top_in, PANEL_WIDTH_IN, PANEL_IN)
            _draw_panel(style.axes_at(figure, box_in, name), sweep, swept, name)
        if not names:
            write(figure, MARGIN_IN, top_in, "no readout has a figure", color=style.ALARM)
    return figure


def _heading(sweep: xr.Dataset, swept: str, count: int) -> list[tuple[str, str]]:
    about: dict[str, Any] = sweep.attrs
    points = sweep.sizes[swept]
    title = str(about.get("title") or about.get("patch") or "Sweep")
    told = f"{points:,} value{'s' * (points != 1)} of {swept}"
    lines = [(f"{title}: readouts against {swept}", style.INK)]
    facts = [*style.provenance(about), told, style.changed_fact(about)]
    lines += [(line, style.MUTED) for line in style.wrapped(facts, LETTERS)]
    if about.get("status") == "interrupted":
        lines.append(("Interrupted: only the values that were done are drawn.", style.ALARM))
    status = sweep["status"].values.astype(str) if "status" in sweep else np.array([], dtype=str)
    ended = int(np.count_nonzero(status != "complete"))
    if ended:
        lines.append((f"{ended:,} of {points:,} runs did not complete.", style.ALARM))
    if count > MOST_PANELS:
        lines.append((f"{MOST_PANELS} of {count} readouts are drawn", style.ALARM))
    return lines


def _draw_panel(axes: Axes, sweep: xr.Dataset, swept: str, name: str) -> None:
    """One readout: a marker for every point, joined but where one between has no figure or, in an
    interrupted sweep, may never have been played."""
    x, y = sweep[swept].values.astype(np.float64), sweep[name].values.astype(np.float64)
    known = np.isfinite(y)
    size = 5.5 if len(x) <= 60 else 3.0
    line = "o" if sweep.attrs.get("status") == "interrupted" else "-o"
    axes.plot(x, y, line, color=style.PENS[0], lw=1.2, ms=size, mfc="white", zorder=3)
    _scale(axes, "x", x)
    _scale(axes, "y", y[known])
    axes.grid(True, which="minor", color=style.RULING, lw=0.6)
    axes.grid(True, which="major", color=style.RULING_MAJOR, lw=0.8)
    about = sweep[name].attrs
    told = (about.get("readout"), about.get("signal"), about.get("window"))
    # A number and its unit stay on one line.
    words = [re.sub(r"(?<=\d) ", "\u00a0", str(word)) for word in told if word]
    label = f"{name.removeprefix('value_')} ({' '.join(words)})"
    label = style.with_unit(label, str(about.get("units", ""))).replace("), ", "),\u00a0")
    axes.set_ylabel("\n".join(textwrap.wrap(label, LABEL_LETTERS)).replace("\u00a0", " "))
    axes.yaxis.set_label_coords(-0.155, 0.5)
    axes.set_xlabel(style.with_unit(swept, str(sweep[swept].attrs.get("units", ""))))
    if not known.any():
        axes.text(0.5, 0.5, "nothing to show", transform=axes.transAxes, ha="center")


def _scale(axes: Axes, which: str, figures: Floats) -> None:
    """Even, or logarithmic where the figures are positive and wide apart."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    if len(figures) and figures.min() > 0 and figures.max() >= WIDE * figures.min():
        low, high = float(figures.min()) / 1.15, float(figures.max()) * 1.15
        axes.set(**{f"{which}scale": "log", f"{which}lim": (low, high)})
        style.mark_decades(axis, high / low)
        return
    style.mark_evenly(axis, 8 if which == "x" else 7)
