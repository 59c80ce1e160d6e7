"""The modes of the machine behind the pens of a chart: IC and HOLD shaded, OP left white."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybrid.modes import HOLD, IC, OP

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SHADE = {IC: "#DCE9F4", HOLD: "#F6E7CE"}
LEGEND = "IC shaded blue, HOLD shaded amber, OP white"
# More than this cannot be told apart on paper.
MOST_SPANS = 400

Span = tuple[float, float, int]


def mode_spans(time_s: Floats, mode: Floats) -> list[Span]:
    """Stretches (from, to, mode) in IC and HOLD; a row's mode holds until the next row, (rows,) each.

    An empty list where there are too many to be seen.
    """
    edges = np.flatnonzero(np.diff(mode)) + 1
    starts = np.concatenate([[0], edges]).astype(int)
    ends = np.concatenate([edges, [len(mode) - 1]]).astype(int)
    spans = [
        (float(time_s[a]), float(time_s[b]), int(mode[a]))
        for a, b in zip(starts, ends, strict=True)
        if len(mode) and mode[a] != OP and b > a
    ]
    return spans if len(spans) <= MOST_SPANS else []


def shade_modes(axes: Axes, spans: list[Span]) -> None:
    """Shade the stretches behind everything else."""
    for start, end, mode in spans:
        axes.axvspan(start, end, facecolor=SHADE[mode], edgecolor="none", zorder=0)
