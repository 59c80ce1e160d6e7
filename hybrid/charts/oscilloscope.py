"""The oscilloscope: the sweeps of repetitive operation one upon another, on a screen with a graticule.

Every operation triggers one sweep; without repetitive operation the first signal does, where it rises
through the middle of its range. The latest is brightest; older ones fade as the phosphor does, by
`persistence` sweeps. The scales are those of an instrument: 1, 2 or 5 times a power of ten a division.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from hybrid.charts import style
from hybrid.charts.style import LINE_IN, number
from hybrid.errors import RunError, did_you_mean, quoted
from hybrid.modes import MODE_VARIABLE, OP
from hybrid.scale import TICKS_PER_SECOND
from hybrid.storage import write_whole

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from hybrid.machine import Machine
    from hybrid.patch import Patch
    from hybrid.storage import PlainRecord

    Recorded = xr.Dataset | PlainRecord
    Floats = NDArray[np.float64]

ACROSS, UPWARD = 10, 8  # divisions
DIVISION_IN = 0.72
LEFT_IN, BELOW_IN = 0.35, 0.2
LABEL_IN = 0.27  # a line below the screen
SCREEN = "#0B1712"
GRATICULE = "#2E4A3D"
BEAMS = ("#8CFFC1", "#FFD27A", "#7FC8FF", "#FF9E9E", "#D9B3FF", "#F2F2F2")
FAINTEST = 0.06  # of the brightest, so that no sweep is lost
COLUMNS = 1000  # of the screen, in which each sweep keeps its peaks
MOST_SWEEPS = 2000  # more would take minutes to draw; the latest are kept


@dataclass(frozen=True)
class Sweep:
    """One sweep: when it was triggered, first row and row after the last."""

    start_s: float
    first: int
    last: int


@dataclass(frozen=True)
class Trace:
    """One signal on the screen: its unit, and problem units a division."""

    name: str
    units: str
    per_division: float
    held: bool  # stands still but where it jumps

    @property
    def label(self) -> str:
        """Name and scale, as written below the screen."""
        scale = f"{number(self.per_division)} {style.unit_text(self.units)}".rstrip()
        return f"{self.name}: {scale} a division"


def oscilloscope(
    record: Recorded,
    signals: Sequence[str],
    sweeps_s: Sequence[tuple[float, float]],
    *,
    persistence: float = 8.0,
) -> Figure:
    """Draw signals over the time since each sweep's trigger.

    record: as `strip_chart` takes one; sweeps_s: start and end of each sweep in s, in order, of which
    the record may hold less than all; persistence: sweeps after which a trace has faded to 1/e.
    Raises RunError for a signal that is not in the record, no signal, or no sweep with two rows.
    """
    if not signals:
        raise RunError("the oscilloscope needs a signal to show")
    known = [str(name) for name in record.data_vars]
    for name in signals:
        if name not in known:
            raise RunError(f"no signal {quoted(name)} in the record; {did_you_mean(name, known)}")
    time_s = np.asarray(record["time"].values, dtype=np.float64)
    sweeps = _sweeps(time_s, sweeps_s)
    if not sweeps:
        raise RunError("no sweep of the oscilloscope has two rows of the record; shorten every:")
    span_s = max(float(time_s[sweep.last - 1]) - sweep.start_s for sweep in sweeps)
    per_division_s = nice_division(span_s / ACROSS)
    traces = [_trace(record, name, sweeps) for name in signals]
    cut = _is_cut(record, sweeps[-1], sweeps_s)
    head = _heading(record, len(sweeps), len(sweeps_s), cut, per_division_s, persistence)
    top_in = 0.62 + LINE_IN * (len(head) - 1)
    size_in = (ACROSS * DIVISION_IN, UPWARD * DIVISION_IN)
    with style.chart_style():
        below_in = BELOW_IN + LABEL_IN * len(traces)
        figure = Figure(figsize=(size_in[0] + 2 * LEFT_IN, top_in + size_in[1] + below_in))
        style.draw_heading(figure, head)
        axes = style.axes_at(figure, (LEFT_IN, top_in, *size_in), "screen")
        _draw_screen(axes)
        for beam, trace in enumerate(traces):
            values = style.results(record, trace.name) / trace.per_division
            paths = [
                style.envelope(
                    (time_s[s.first : s.last] - s.start_s) / per_division_s,
                    values[s.first : s.last],
                    COLUMNS,
                )
                for s in sweeps
            ]
            if trace.held:
                paths = [style.stepped(*path) for path in paths]
            color = BEAMS[beam % len(BEAMS)]
            _draw_beam(axes, [np.column_stack(path) for path in paths], color, persistence)
            place_in = (LEFT_IN + 0.05, top_in + size_in[1] + LABEL_IN * (beam + 0.75))
            box = {"facecolor": SCREEN, "edgecolor": "none", "pad": 2.5}
            style.write(figure, *place_in, trace.label, color=color, va="center", bbox=box)
    return figure


def sweeps_of(record: Recorded, signal: str) -> list[tuple[float, float]]:
    """The sweeps that a record asks for: its operations, or else those that `signal` triggers.

    Operations by time start at exact instants; others at the first row that is in OP. A machine that
    an overload holds for good is in none of the last ones.
    """
    time_s = np.asarray(record["time"].values, dtype=np.float64)
    if "operation" in record.attrs:
        by_time = json.loads(record.attrs["operation"])
        length_s = by_time["reset_s"] + by_time["operate_s"] + by_time["hold_s"]
        count = by_time["operations"] or math.ceil(float(time_s[-1]) / length_s)
        starts_s = [k * length_s + by_time["reset_s"] for k in range(count)]
        last_s = _last_in_op(record, time_s)
        return [(at_s, at_s + by_time["operate_s"]) for at_s in starts_s if at_s <= last_s]
    if MODE_VARIABLE in record.data_vars and record[MODE_VARIABLE].attrs.get("kind") == "mode":
        operating = np.concatenate(
            [[False], np.asarray(record[MODE_VARIABLE].values) == OP, [False]]
        )
        edges = np.flatnonzero(operating[1:] != operating[:-1]).reshape(-1, 2)
        return [(float(time_s[first]), float(time_s[end - 1])) for first, end in edges]
    return triggers(time_s, np.asarray(record[signal].values, dtype=np.float64))


def _last_in_op(record: Recorded, time_s: Floats) -> float:
    """When the last row in OP was taken; infinite where the record has no mode."""
    if MODE_VARIABLE not in record.data_vars:
        return math.inf
    operating = np.flatnonzero(np.asarray(record[MODE_VARIABLE].values) == OP)
    return float(time_s[operating[-1]]) if len(operating) else -math.inf


def parse_beams(text: str, signals: Collection[str]) -> tuple[str, ...]:
    """Read 'SIGNAL,SIGNAL'; raises RunError for anything else."""
    beams = tuple(name.strip() for name in text.split(","))
    for name in beams:
        if name not in signals:
            hint = did_you_mean(name, signals)
            raise RunError(
                f"--scope {quoted(text)} must be SIGNAL or SIGNAL,SIGNAL; no signal {quoted(name)}; "
                f"{hint}"
            )
    if len(set(beams)) < len(beams):
        raise RunError(f"--scope {quoted(text)} names a signal twice")
    return beams


def with_beams(patch: Patch, texts: Sequence[str]) -> tuple[Patch, tuple[tuple[str, ...], ...]]:
    """Read --scope options: the patch, recording also what is to be shown, and each screen's beams."""
    screens = tuple(parse_beams(text, patch.signals) for text in texts)
    if len(set(screens)) < len(screens):
        raise RunError("--scope asks for the same screen twice")
    if patch.record:  # one that names no signals records them all
        wanted = (name for beams in screens for name in beams)
        patch = replace(patch, record=tuple(dict.fromkeys((*patch.record, *wanted))))
    return patch, screens


def check_operates(machine: Machine) -> None:
    """Raise RunError where a run ends before the first operation that would be a sweep."""
    operation, until = machine.operation, machine.timing.until
    if operation and until <= operation.reset:
        raise RunError(
            f"--scope: the run ends at {until / TICKS_PER_SECOND:g} s, before the first operation "
            f"begins at {operation.reset / TICKS_PER_SECOND:g} s"
        )


def save_screens(record: Recorded, screens: Sequence[Sequence[str]], stem: Path) -> list[str]:
    """Write each screen as `stem`_scope_SIGNALS.png; returns the names."""
    files = []
    for beams in screens:
        figure = oscilloscope(record, beams, sweeps_of(record, beams[0]))
        path = stem.with_name(f"{stem.name}_scope_{'_'.join(beams)}.png")
        write_whole(path, lambda part, figure=figure: style.save(figure, part))  # type: ignore[misc]
        files.append(str(path))
    return files


def triggers(time_s: Floats, values: Floats) -> list[tuple[float, float]]:
    """Sweeps of an oscillation: from each rise through the middle of its range, two cycles long or
    somewhat more, so that they fill the screen.

    time_s, values: (rows,). The instant of a rise is read between rows by a straight line. A signal
    that rises less than twice gives one sweep of the whole record.
    """
    level = 0.5 * (float(np.nanmax(values)) + float(np.nanmin(values)))
    above = values > level
    before = np.flatnonzero(~above[:-1] & above[1:])
    if len(before) < 2:
        return [(float(time_s[0]), float(time_s[-1]))]
    share = (level - values[before]) / (values[before + 1] - values[before])
    rises_s = time_s[before] + share * (time_s[before + 1] - time_s[before])
    length_s = ACROSS * nice_division(2.0 * float(np.median(np.diff(rises_s))) / ACROSS)
    whole = rises_s[rises_s + length_s <= time_s[-1]]
    return [(float(start_s), float(start_s + length_s)) for start_s in whole] or [
        (float(rises_s[0]), float(time_s[-1]))
    ]


def nice_division(least: float) -> float:
    """The smallest of 1, 2, 5 times a power of ten that is not below `least` (1 for zero)."""
    if not least > 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(least))
    return next(m * power for m in (1.0, 2.0, 5.0, 10.0) if least <= m * power * (1 + 1e-9))


def _sweeps(time_s: Floats, sweeps_s: Sequence[tuple[float, float]]) -> list[Sweep]:
    """Those with two rows or more, the latest ones."""
    found = []
    for start_s, end_s in sweeps_s:
        slack_s = 1e-9 * max(abs(end_s), abs(start_s))  # rows stand at the nearest floats
        first = int(np.searchsorted(time_s, start_s - slack_s))
        last = int(np.searchsorted(time_s, end_s + slack_s, side="right"))
        if last - first >= 2:
            found.append(Sweep(start_s, first, last))
    return found[-MOST_SWEEPS:]


def _is_cut(record: Recorded, last: Sweep, sweeps_s: Sequence[tuple[float, float]]) -> bool:
    """Whether the last sweep is of an operation that the run did not play to its end."""
    if "operation" not in record.attrs:
        return False
    whole = int(record.attrs.get("operations", 0))
    return any(start_s == last.start_s for start_s, _ in sweeps_s[whole:])


def _trace(record: Recorded, name: str, sweeps: Sequence[Sweep]) -> Trace:
    values = np.asarray(record[name].values, dtype=np.float64)
    shown = np.concatenate([values[sweep.first : sweep.last] for sweep in sweeps])
    finite = np.abs(shown[np.isfinite(shown)])
    largest = float(finite.max()) if len(finite) else 0.0
    units = str(record[name].attrs.get("units", ""))
    held = style.is_held(record[name].attrs)
    return Trace(name, units, nice_division(2.0 * largest / UPWARD), held)


def _heading(
    record: Recorded,
    shown: int,
    ordered: int,
    cut: bool,
    per_division_s: float,
    persistence: float,
) -> list[tuple[str, str]]:
    sweeps = f"{shown} sweeps" if shown != 1 else "1 sweep"
    left_out = f" of {ordered}" if shown < ordered else ""
    facts = [
        f"{style.duration(per_division_s)} a division",
        f"{sweeps}{left_out}{', the last cut short' if cut else ''}, latest brightest",
    ]
    facts += [f"fading to 1/e in {number(persistence)} sweeps"] if shown > 1 else []
    lines = [(str(record.attrs.get("title", "")), style.INK)]
    lines.append((" · ".join([*style.provenance(record.attrs), *facts]), style.MUTED))
    return lines


def _draw_screen(axes: Axes) -> None:
    """The dark screen, divisions, and marks of a fifth along the two middle lines."""
    axes.set_facecolor(SCREEN)
    axes.set_xlim(0, ACROSS)
    axes.set_ylim(-UPWARD / 2, UPWARD / 2)
    axes.set_xticks([])
    axes.set_yticks([])
    lines: list[list[tuple[float, float]]] = []
    lines += [[(x, -UPWARD / 2), (x, UPWARD / 2)] for x in range(ACROSS + 1)]
    lines += [[(0, y), (ACROSS, y)] for y in range(-UPWARD // 2, UPWARD // 2 + 1)]
    fifths = np.arange(0, ACROSS * 5 + 1) / 5
    lines += [[(x, -0.06), (x, 0.06)] for x in fifths]
    fifths = np.arange(-UPWARD * 5 // 2, UPWARD * 5 // 2 + 1) / 5
    lines += [[(ACROSS / 2 - 0.06, y), (ACROSS / 2 + 0.06, y)] for y in fifths]
    axes.add_collection(LineCollection(lines, colors=GRATICULE, linewidths=0.7, zorder=1))


def _draw_beam(axes: Axes, paths: Sequence[Floats], color: str, persistence: float) -> None:
    """Every sweep of one signal, in divisions; a broad faint line under each is the beam's glow."""
    ages = np.arange(len(paths))[::-1]  # the latest last, so that it lies on top
    fading = np.exp(-ages / persistence) if persistence > 0 else (ages == 0).astype(float)
    bright = np.maximum(fading, FAINTEST)
    for width, share in ((4.0, 0.18), (1.4, 1.0)):
        shades = [(*to_rgba(color)[:3], float(share * b)) for b in bright]
        lines = LineCollection(list(paths), colors=shades, linewidths=width, zorder=3)
        axes.add_collection(lines, autolim=False)
