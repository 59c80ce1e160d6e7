"""The chart of a batch: how the figures of many runs are spread.

A panel for each figure: dots over the parameter where one alone differs, with the mean and one standard
deviation to either side where several runs share its value, else a histogram with the same.
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
from hybrid.errors import counted

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

WIDTH_IN = 12.0
LEFT_IN = 0.95
PANEL_IN = 2.5
PANEL_WIDTH_IN = 4.75
BELOW_IN = 1.0  # axis label and a line of statistics
MOST_PANELS = 12
LETTERS = 165  # of a line of the heading
KEY = "solid line: mean;  dashed lines: one standard deviation to either side of it"
KEY_ACROSS = "dots: runs;  bars: mean and one standard deviation of the runs at one value"
MOST_TOLD = 3  # values whose mean stands below a panel


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
    if across is not None and any(_means(spread, across) for spread in shown):
        lines.append((KEY_ACROSS, style.MUTED))
    if len(shown) < len(spreads):
        lines.append((f"{len(shown)} of {len(spreads)} figures are drawn", style.ALARM))
    top_in = 0.75 + LINE_IN * len(lines)
    rows = max(1, math.ceil(len(shown) / 2))
    told = [_statistics(spread, across) for spread in shown]
    below_in = BELOW_IN + LINE_IN * (max(map(len, told), default=1) - 1)
    with style.chart_style():
        figure = Figure(figsize=(WIDTH_IN, top_in + rows * (PANEL_IN + below_in)))
        style.draw_heading(figure, lines)
        for place, spread in enumerate(shown):
            left_in = LEFT_IN + (place % 2) * WIDTH_IN / 2
            box_top_in = top_in + (place // 2) * (PANEL_IN + below_in)
            box_in = (left_in, box_top_in, PANEL_WIDTH_IN, PANEL_IN)
            axes = style.axes_at(figure, box_in, spread.name)
            _draw_panel(axes, spread, across)
            for line, text in enumerate(told[place]):
                at_in = box_top_in + PANEL_IN + 0.72 + LINE_IN * line
                write(figure, left_in, at_in, text, color=style.MUTED, va="center")
        if not shown:
            write(figure, MARGIN_IN, top_in, "no readout has a figure", color=style.ALARM)
    return figure


def _statistics(spread: Spread, across: Across | None) -> list[str]:
    """How the runs are spread, in lines; those at different values of a parameter each by themselves."""
    known = spread.values[np.isfinite(spread.values)]
    without = len(spread.values) - len(known)
    left_out = f"; {without} without a figure" if without else ""
    if not len(known):
        return ["no run has this figure"]
    means = _means(spread, across) if across else []
    if not across or not means:
        return [_told(len(known), float(np.mean(known)), _deviation(known)) + left_out]
    if len(means) > MOST_TOLD:
        spreads = [deviation for *_, deviation in means if math.isfinite(deviation)]
        least, most = (number(each, 3) for each in (min(spreads), max(spreads)))
        told = f"{len(known)} runs at {len(means)} values: standard deviations {least} to {most}"
        return [told + left_out]
    lines = []
    for value, count, mean, deviation in means:
        at = f"{across.name} {number(value)} {style.unit_text(across.units)}".rstrip()
        lines.append(f"{at}, {_told(count, mean, deviation)}")
    return [*lines[:-1], lines[-1] + left_out]


def _told(count: int, mean: float, deviation: float) -> str:
    told = f"{counted(count, 'run')}: mean {number(mean, 8)}"
    return told + (f", standard deviation {number(deviation, 3)}" if count > 1 else "")


def _deviation(values: Floats) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else math.nan


def _means(spread: Spread, across: Across) -> list[tuple[float, int, float, float]]:
    """Value of the parameter, runs at it, their mean and deviation; empty where none has two."""
    known = np.isfinite(spread.values)
    found = []
    for value in np.unique(across.values[known]):
        theirs = spread.values[known & (across.values == value)]
        found.append((float(value), len(theirs), float(np.mean(theirs)), _deviation(theirs)))
    return found if any(count > 1 for _, count, _, _ in found) else []


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
    means = _means(spread, across)
    x, y, ink = across.values[known], spread.values[known], style.PENS[0]
    if not means:
        axes.plot(x, y, "o", ms=3.0, mfc="white", color=ink)
    else:
        axes.plot(x, y, "o", ms=3.0, mec="none", color=ink, alpha=0.3)
        _draw_means(axes, means)
    axes.set_xlabel(style.with_unit(across.name, across.units))
    axes.set_ylabel(label)


def _draw_means(axes: Axes, means: Sequence[tuple[float, int, float, float]]) -> None:
    """Bars beside the dots, so that both are seen; what is not known of a single run has none."""
    values = [value for value, *_ in means]
    apart = float(np.min(np.diff(values))) if len(values) > 1 else abs(values[0]) or 1.0
    aside = min(0.15 * apart, 0.02 * (values[-1] - values[0] + apart))
    axes.errorbar(
        [value + aside for value in values],
        [mean for _, _, mean, _ in means],
        yerr=[deviation if math.isfinite(deviation) else 0.0 for *_, deviation in means],
        fmt="_",
        ms=7.0,
        mew=1.6,
        lw=1.4,
        capsize=3.0,
        color=style.INK,
        zorder=4,
    )
    axes.set_xlim(values[0] - 0.5 * apart, values[-1] + 0.5 * apart)


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
    mean, deviation = float(np.mean(values)), _deviation(values)
    axes.axvline(mean, color=style.INK, lw=1.4)
    for side in (-1.0, 1.0):
        axes.axvline(mean + side * deviation, color=style.INK, lw=1.0, ls=(0, (4, 3)))
