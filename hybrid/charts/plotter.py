"""The x-y plotter: one signal against another, on paper framed by their full scales.

A signal that stays on one side of zero has paper for that side only.

The pen is down from a given time to the end of the record, of a machine with modes in OP only.
Signals of the same unit are drawn to the same scale, so that a circle is a circle. A converter, a word
or a comparator holds its value, so the pen draws steps where one axis holds and the other moves.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from hybrid.charts import style
from hybrid.charts.style import LINE_IN, number
from hybrid.errors import RunError, did_you_mean, quoted
from hybrid.modes import MODE_VARIABLE, OP
from hybrid.storage import write_whole

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from hybrid.patch import Patch
    from hybrid.storage import PlainRecord

    Recorded = xr.Dataset | PlainRecord
    Floats = NDArray[np.float64]

PAPER_IN = 6.6  # the longer side of the frame
NARROWEST = 0.25  # shorter side by longer, beyond which scales are no longer kept equal
LEFT_IN, BELOW_IN, RIGHT_IN = 1.05, 0.85, 0.45
ONE_SIDE = 0.01  # of its frame, that a signal of one sign may be beyond zero, by noise say
FAR_LESS = 0.25  # a signal within this fraction of its full scale gets a frame of its own
TINY = 1e-290
BROKEN_OFF = ("interrupted", "stopped")


@dataclass(frozen=True)
class Pair:
    """What to plot: y against x, the pen down from a time on."""

    x: str
    y: str
    pen_down_from_s: float = 0.0


@dataclass(frozen=True)
class _Axis:
    """One signal as plotted: its values in problem units, and how far its frame goes from zero: to
    `frame` on both sides, or on the one that `low` and `high` leave."""

    name: str
    held: bool
    units: str
    full_scale: float
    values: Floats
    frame: float
    low: float
    high: float

    @property
    def span(self) -> float:
        """From end to end of the frame."""
        return self.high - self.low

    @property
    def label(self) -> str:
        return style.with_unit(self.name, self.units)

    @property
    def shows_full_scale(self) -> bool:
        """Whether its full scale is on the paper."""
        return 0 < self.full_scale <= self.frame

    @property
    def note(self) -> str:
        """Where the frame is not full scale, how much of it is shown."""
        share = self.frame / self.full_scale if self.full_scale > 0 else math.nan
        if not math.isfinite(share) or abs(share - 1) < 1e-9:
            return ""
        return f"{self.name}: frame is {number(100 * share, 2)} % of full scale"


def xy_plot(record: Recorded, x: str, y: str, *, pen_down_from_s: float = 0.0) -> Figure:
    """Draw signal y against signal x of a record (as `strip_chart` takes one).

    pen_down_from_s: rows before this time are not drawn, so that a transient can be left out.
    Raises RunError for a signal that is not in the record, or if the pen comes down after its end.
    """
    time_s = np.asarray(record["time"].values, dtype=np.float64)
    if not math.isfinite(pen_down_from_s):
        raise RunError(f"the pen cannot come down at {pen_down_from_s} s; give a finite time")
    down = time_s >= pen_down_from_s
    up = pen_is_up(record)[down]
    whole = record.attrs.get("status") not in BROKEN_OFF
    if whole and len(time_s) and not down.any():
        raise RunError(
            f"the pen would come down at {pen_down_from_s:g} s, after the record's end at "
            f"{time_s[-1]:g} s"
        )
    across, upward = (_axis(record, name, down, up) for name in (x, y))
    frames = _frames(across, upward)
    width_in, height_in = frames
    head = _heading(record, across, upward, time_s[down], bool(up.any()))
    top_in = 0.62 + LINE_IN * (len(head) - 1)
    with style.chart_style(), matplotlib.rc_context({"agg.path.chunksize": 10_000}):
        figure = Figure(
            figsize=(LEFT_IN + width_in + RIGHT_IN, top_in + height_in + BELOW_IN),
        )
        style.draw_heading(figure, head)
        axes = style.axes_at(figure, (LEFT_IN, top_in, width_in, height_in), f"{y} against {x}")
        _draw_paper(axes, across, upward)
        _draw_pen(axes, across, upward, frames)
    return figure


def pen_is_up(record: Recorded) -> NDArray[np.bool_]:
    """Where the machine is in IC or HOLD, (rows,): the pen writes in OP only."""
    if MODE_VARIABLE not in record.data_vars or record[MODE_VARIABLE].attrs.get("kind") != "mode":
        return np.zeros(len(record["time"].values), dtype=bool)
    up: NDArray[np.bool_] = np.asarray(record[MODE_VARIABLE].values) != OP
    return up


def parse_pair(text: str, signals: Collection[str]) -> Pair:
    """Read 'X:Y' or 'X:Y:TIME' (the pen comes down at TIME); raises RunError for anything else."""
    from hybrid.patchfile import parse_duration

    x, _, rest = text.partition(":")
    y, timed, time = rest.partition(":")
    if not x.strip() or not y.strip() or (timed and not time.strip()):
        raise RunError(f"--xy {quoted(text)} must be X:Y or X:Y:TIME, such as x:y or 'x:y:20 ms'")
    for name in (x.strip(), y.strip()):
        if name not in signals:
            raise RunError(f"--xy: no signal {quoted(name)}; {did_you_mean(name, signals)}")
    what = f"--xy {quoted(text)}: TIME"
    down = parse_duration(time.strip(), what, or_zero=True).number({}) if timed else 0.0
    return Pair(x.strip(), y.strip(), down)


def with_pens(patch: Patch, texts: Sequence[str]) -> tuple[Patch, tuple[Pair, ...]]:
    """Read --xy options: the patch, recording also what is to be plotted, and the pairs."""
    pairs = tuple(parse_pair(text, patch.signals) for text in texts)
    wanted = tuple(name for pair in pairs for name in (pair.x, pair.y))
    if len({(pair.x, pair.y) for pair in pairs}) < len(pairs):
        raise RunError("--xy names the same two signals twice; plot them once")
    if patch.record:  # one that names no signals records them all
        patch = replace(patch, record=tuple(dict.fromkeys((*patch.record, *wanted))))
    return patch, pairs


def check_pairs(pairs: Sequence[Pair], until_s: float) -> None:
    """Raise RunError where a run ends before a pen comes down."""
    for pair in pairs:
        if pair.pen_down_from_s > until_s:
            raise RunError(
                f"--xy: the pen for {pair.x}:{pair.y} would come down at "
                f"{pair.pen_down_from_s:g} s, after the run's end at {until_s:g} s"
            )


def save_plots(record: Recorded, pairs: Sequence[Pair], stem: Path) -> list[str]:
    """Write each pair as `stem`_y_against_x.png; returns the names."""
    files = []
    for pair in pairs:
        figure = xy_plot(record, pair.x, pair.y, pen_down_from_s=pair.pen_down_from_s)
        path = stem.with_name(f"{stem.name}_{pair.y}_against_{pair.x}.png")
        write_whole(path, lambda part, figure=figure: style.save(figure, part))  # type: ignore[misc]
        files.append(str(path))
    return files


# -- from the record to the paper ------------------------------------------------------------------


def _axis(record: Recorded, name: str, down: NDArray[np.bool_], up: NDArray[np.bool_]) -> _Axis:
    available = [str(signal) for signal in record.data_vars]
    if name not in available:
        raise RunError(f"no signal {name!r} in the record; {did_you_mean(name, available)}")
    about = record[name].attrs
    values = style.results(record, name)[down]
    values = np.where((np.abs(values) < 1 / TINY) & ~up, values, np.nan)
    full_scale = float(about.get("full_scale", math.nan))
    limit = full_scale if math.isfinite(full_scale) and full_scale > 0 else 0.0
    peak = float(np.nanmax(np.abs(values), initial=0.0))
    if peak < TINY:
        frame = limit or 1.0
    else:
        frame = limit if FAR_LESS * limit <= peak <= limit else style.round_up(peak)
    low, high = -frame, frame
    if peak >= TINY and np.nanmin(values) >= -ONE_SIDE * frame:
        low = 0.0
    elif peak >= TINY and np.nanmax(values) <= ONE_SIDE * frame:
        high = 0.0
    units = str(about.get("units", ""))
    return _Axis(name, style.is_held(about), units, limit, values, frame, low, high)


def _frames(across: _Axis, upward: _Axis) -> tuple[float, float]:
    """Width and height of the paper within its frame, in inches."""
    if across.units != upward.units:
        return PAPER_IN, PAPER_IN * 0.8
    ratio = upward.span / across.span
    if not NARROWEST <= ratio <= 1 / NARROWEST:
        return PAPER_IN, PAPER_IN * 0.8
    return (PAPER_IN, PAPER_IN * ratio) if ratio <= 1 else (PAPER_IN / ratio, PAPER_IN)


def _heading(
    record: Recorded, across: _Axis, upward: _Axis, time_s: Floats, lifted: bool
) -> list[tuple[str, str]]:
    about = record.attrs
    width_in = LEFT_IN + _frames(across, upward)[0] + RIGHT_IN
    facts = [*style.provenance(about)]
    if len(time_s):
        facts.append(f"pen down {style.duration(time_s[0])} to {style.duration(time_s[-1])}")
    facts += ["pen up in IC and HOLD"] if lifted else []
    facts += [note for note in (across.note, upward.note) if note]
    title = str(about.get("title") or about.get("patch") or "Record")
    longest = int(6.4 * width_in)
    whole = " ".join(title.split())
    shown = whole if len(whole) <= longest else f"{whole[: longest - 2].rstrip()} …"
    lines = [(shown, style.INK)]
    lines += [(line, style.MUTED) for line in style.wrapped(facts, int(13 * width_in))]
    given = style.parameter_lines(about, int(13 * width_in))
    lines += [(line, style.MUTED) for line in [*given, _key(across, upward)]]
    if about.get("status") in BROKEN_OFF:
        told = textwrap.wrap(
            f"{about['status']}: {about.get('status_note', '')}".rstrip(": "), int(12 * width_in)
        )
        lines += [(line[0].upper() + line[1:], style.ALARM) for line in told]
    return lines


def _key(across: _Axis, upward: _Axis) -> str:
    """What the marks on the paper mean."""
    full_scale = any(axis.shows_full_scale for axis in (across, upward))
    return "○ where the pen comes down;  ● end" + full_scale * ";  red lines: full scale"


# -- drawing ---------------------------------------------------------------------------------------


def _draw_paper(axes: Axes, across: _Axis, upward: _Axis) -> None:
    """Rule the paper, in squares where both scales are equal, and mark full scale and zero."""
    axes.set_xlim(across.low, across.high)
    axes.set_ylim(upward.low, upward.high)
    columns, rows = _squares(across, upward)
    ticks = np.linspace(across.low, across.high, columns + 1)
    style.rule(axes, ticks, np.linspace(upward.low, upward.high, 5 * rows + 1), heavy=5)
    for axis, line in ((across, axes.axvline), (upward, axes.axhline)):
        line(0.0, color=style.FRAME, lw=0.9, zorder=1)
        if axis.shows_full_scale:
            for place in (-axis.full_scale, axis.full_scale):
                if not axis.low <= place <= axis.high:
                    continue
                line(place, color=style.LIMIT, lw=1.6, zorder=2, label="full scale", clip_on=False)
    for axis, its in ((across, axes.xaxis), (upward, axes.yaxis)):
        marks = np.linspace(axis.low, axis.high, 5)
        its.set_ticks(marks, labels=[number(float(mark)) for mark in marks])
    axes.set_xlabel(across.label)
    axes.set_ylabel(upward.label)


def _squares(across: _Axis, upward: _Axis) -> tuple[int, int]:
    """How many squares wide and high the paper is."""
    ratio = upward.span / across.span
    width, height = (8.0, 8 * ratio) if ratio <= 1 else (8 / ratio, 8.0)
    if across.units == upward.units and width >= 2 <= height:
        counts = round(width), round(height)
        if math.isclose(counts[0], width) and math.isclose(counts[1], height):
            return counts
    return 8, 8


def _draw_pen(axes: Axes, across: _Axis, upward: _Axis, frames_in: tuple[float, float]) -> None:
    x, y = _thinned(across, upward, frames_in)
    steps = {(False, True): "steps-post", (True, False): "steps-pre"}
    drawn = steps.get((across.held, upward.held), "default")
    ink = style.PENS[0]
    axes.plot(x, y, color=ink, lw=1.15, drawstyle=drawn, label="pen", zorder=3, clip_on=False)
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if not known.size:
        axes.text(0, 0, "no values", ha="center", va="center", color=style.MUTED)
        return
    for place, fill, label in ((known[0], "white", "pen down"), (known[-1], ink, "end")):
        axes.plot(
            x[place],
            y[place],
            marker="o",
            markersize=4.5,
            markerfacecolor=fill,
            markeredgecolor=ink,
            ls="",
            label=label,
            zorder=4,
            clip_on=False,
        )


def _thinned(across: _Axis, upward: _Axis, frames_in: tuple[float, float]) -> tuple[Floats, Floats]:
    """Leave out rows in which the pen stays within a quarter of a pixel."""
    x, y = across.values, upward.values
    if len(x) < 3:
        return x, y
    cells = [
        np.round(axis.values / axis.span * side * style.DPI * 4)
        for axis, side in zip((across, upward), frames_in, strict=True)
    ]
    still = (np.diff(cells[0]) == 0) & (np.diff(cells[1]) == 0)
    kept = np.concatenate(([True], ~still[:-1] | ~still[1:], [True]))
    return x[kept], y[kept]
