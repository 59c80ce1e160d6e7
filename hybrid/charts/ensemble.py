"""The chart of a batch: how the figures of many runs are spread.

A panel for each figure: dots over the parameter where one alone differs, else a histogram with the
mean and one standard deviation either side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from hybrid.charts import style
from hybrid.charts.style import LINE_IN, MARGIN_IN, number, write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

WIDTH_IN = 12.0
LEFT_IN = 0.95
PANEL_IN = 2.5
PANEL_WIDTH_IN = 4.75
BELOW_IN = 1.0  # axis label and the statistics
MOST_PANELS = 12
LETTERS = 165  # of a line of the heading
KEY = "solid line: mean;  dashed lines: one standard deviation to either side of it"


@dataclass(frozen=True)
class Spread:
    """One figure of every run, NaN where a run has none; unit as text."""

    name: str
    values: Floats  # (runs,)
    units: str


@dataclass(frozen=True)
class Across:
    """The one parameter that differs, in its unit."""

    name: str
    values: Floats  # (runs,)
    units: str


def ensemble_chart(
    title: str, facts: Sequence[str], spreads: Sequence[Spread], across: Across | None = None
) -> Figure:
    """Draw how figures are spread over runs.

    title, facts: heading and what stands below it; spreads: MOST_PANELS are drawn, and the heading says
    so; across: what the figures are drawn over, else they are counted.
    """
    shown = spreads[:MOST_PANELS]
    lines = [(title, style.INK)]
    lines += [(line, style.MUTED) for line in style.wrapped(facts, LETTERS)]
    if across is None and any(len(set(spread.values)) > 1 for spread in shown):
        lines.append((KEY, style.MUTED))
    if len(shown) < len(spreads):
        lines.append((f"{len(shown)} of {len(spreads)} figures are drawn", style.ALARM))
    top_in = 0.75 + LINE_IN * len(lines)
    rows = max(1, math.ceil(len(shown) / 2))
    with style.chart_style():
        figure = Figure(figsize=(WIDTH_IN, top_in + rows * (PANEL_IN + BELOW_IN)))
        style.draw_heading(figure, lines)
        for place, spread in enumerate(shown):
            left_in = LEFT_IN + (place % 2) * WIDTH_IN / 2
            box_top_in = top_in + (place // 2) * (PANEL_IN + BELOW_IN)
            box_in = (left_in, box_top_in, PANEL_WIDTH_IN, PANEL_IN)
            axes = style.axes_at(figure, box_in, spread.name)
            _draw_panel(axes, spread, across)
            below_in = box_top_in + PANEL_IN + 0.72
            write(figure, left_in, below_in, _statistics(spread), color=style.MUTED, va="center")
        if not shown:
            write(figure, MARGIN_IN, top_in, "no readout has a figure", color=style.ALARM)
    return figure


def _statistics(spread: Spread) -> str:
    known = spread.values[np.isfinite(spread.values)]
    without = len(spread.values) - len(known)
    left_out = f"; {without} without a figure" if without else ""
    if not len(known):
        return "no run has this figure"
    deviation = float(np.std(known, ddof=1)) if len(known) > 1 else math.nan
    return (
        f"{len(known)} runs: mean {number(float(np.mean(known)), 8)}, standard deviation "
        f"{number(deviation, 3)}{left_out}"
    )


def _draw_panel(axes: Axes, spread: Spread, across: Across | None) -> None:
    label = style.with_unit(spread.name, spread.units)
    known = np.isfinite(spread.values)
    axes.grid(True, color=style.RULING_MAJOR, lw=0.8)
    axes.ticklabel_format(axis="both", useMathText=True)
    if across is None:
        _count(axes, spread.values[known])
        axes.set_xlabel(label)
        axes.set_ylabel("runs")
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        style.mark_evenly(axes.xaxis, 5)
        return
    axes.plot(
        across.values[known], spread.values[known], "o", ms=3.0, mfc="white", color=style.PENS[0]
    )
    axes.set_xlabel(style.with_unit(across.name, across.units))
    axes.set_ylabel(label)


def _count(axes: Axes, values: Floats) -> None:
    """A histogram with the mean and one standard deviation either side."""
    if not len(values):
        return
    if values.min() == values.max():  # all the same: one bar, wide enough to be seen
        half = abs(float(values[0])) * 1e-3 or 1.0
        axes.bar([values[0]], [len(values)], width=half, color=style.PENS[0])
        axes.set_xlim(values[0] - 5 * half, values[0] + 5 * half)
        return
    axes.hist(values, bins="auto" if len(values) > 8 else 8, color=style.PENS[0], ec="white")
    mean, deviation = float(np.mean(values)), float(np.std(values, ddof=1))
    axes.axvline(mean, color=style.INK, lw=1.4)
    for side in (-1.0, 1.0):
        axes.axvline(mean + side * deviation, color=style.INK, lw=1.0, ls=(0, (4, 3)))
