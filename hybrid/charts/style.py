"""What every chart shares: colours, type, numbers as text, thinned traces, a table, the PNG writer.

The pen colours are those of Okabe and Ito's set for colour-blind readers, darkened a little for
thin lines on white. Matplotlib's own number formats need its formula typesetter, which costs a
tenth of a second to load; the few formats used here are plain text instead.
"""

from __future__ import annotations

import json
import math
import re
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from PIL import Image

from hybrid.errors import RunError
from hybrid.naming import on_text

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

INK = "#22303A"
MUTED = "#66737C"
RULING = "#EDF1EE"
RULING_MAJOR = "#D9E1DC"
FRAME = "#AEB8B2"
LIMIT = "#E5A9A0"
LIMIT_TEXT = "#A8564A"
ALARM = "#C1121F"
PENS = ("#0B62A4", "#B85C00", "#007A5A", "#8A4F9E", "#5B6770", "#3C93C2")

DPI = 110
LINE_IN = 0.215  # one line of small print
MARGIN_IN = 0.22  # from the paper's edge to the text

# Written out where a name of the patch takes the short form.
SHORT_UNITS = {
    "meter": "m",
    "second": "s",
    "kilogram": "kg",
    "gram": "g",
    "kelvin": "K",
    "ampere": "A",
    "newton": "N",
    "volt": "V",
    "watt": "W",
    "joule": "J",
    "pascal": "Pa",
    "hertz": "Hz",
    "radian": "rad",
    "degree": "deg",
    "minute": "min",
    "hour": "h",
}
_LONG_UNIT = re.compile(rf"(?<![A-Za-z_])({'|'.join(SHORT_UNITS)})(?![A-Za-z_])")

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

# The family is named outright: the font comes with Matplotlib, and a generic family such as
# "sans-serif" would send each text through a search of the machine's fonts.
_RC = {
    "font.family": ["DejaVu Sans"],
    "font.size": 9.0,
    "text.color": INK,
    "axes.edgecolor": FRAME,
    "axes.linewidth": 0.8,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.5,
    "axes.axisbelow": True,
    "axes.grid": False,
    "axes.unicode_minus": True,
    "xtick.color": FRAME,
    "ytick.color": FRAME,
    "xtick.labelcolor": MUTED,
    "ytick.labelcolor": MUTED,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.major.size": 4.0,
    "ytick.major.size": 3.0,
    "lines.solid_joinstyle": "round",
    "path.simplify": True,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    # To fit letters to pixels takes two fifths of the time of all text; without, they read as well.
    "text.hinting": "no_hinting",
    "figure.facecolor": "white",
}


@contextmanager
def chart_style() -> Iterator[None]:
    """Draw in the project's style, leaving the caller's Matplotlib settings as they were."""
    with matplotlib.rc_context(_RC):  # type: ignore[arg-type]
        yield


def axes_at(figure: Figure, box_in: tuple[float, float, float, float], label: str) -> Axes:
    """Axes at a fixed place: `box_in` is left, top, width, height in inches from the top left."""
    width, height = figure.get_size_inches()
    left, top, box_width, box_height = box_in
    place = (left / width, 1 - (top + box_height) / height, box_width / width, box_height / height)
    return figure.add_axes(place, label=label)


def write(figure: Figure, left_in: float, top_in: float, text: str, **properties: object) -> None:
    """Put text at a place in inches from the figure's top left corner."""
    width, height = figure.get_size_inches()
    # A title is the user's: a $ in it is a dollar, not mathematics.
    properties = {"parse_math": False, **properties}
    figure.text(left_in / width, 1 - top_in / height, text, **properties)  # type: ignore[arg-type]


def draw_heading(figure: Figure, lines: Sequence[tuple[str, str]]) -> None:
    """Write the title and the lines below it, each given with its colour; alarms in bold."""
    (title, _), *facts = lines
    write(figure, MARGIN_IN, 0.3, title, fontsize=15, weight="bold", va="center")
    for place, (line, color) in enumerate(facts):
        weight = "bold" if color == ALARM else "normal"
        top_in = 0.62 + LINE_IN * place
        write(figure, MARGIN_IN, top_in, line, color=color, weight=weight, va="center")


def number(value: float, digits: int = 4) -> str:
    """Write a number with `digits` significant digits: '0.25', '−1.5×10⁻⁶', 'none' for NaN."""
    if math.isnan(value):
        return "none"
    rounded = float(f"{value:.{digits}g}") + 0.0  # no -0
    mantissa, _, exponent = f"{rounded:.{max(digits, 6)}g}".replace("-", "−").partition("e")
    if not exponent:
        return mantissa
    power = _power_of_ten(int(exponent.replace("−", "-")))
    return {"1": power, "−1": f"−{power}"}.get(mantissa, f"{mantissa}×{power}")


def _power_of_ten(exponent: int) -> str:
    return f"10{str(exponent).translate(_SUPERSCRIPT)}"


def _decade(value: float) -> str:
    """Write a power of ten: in full from 0.01 to 1000, else as 10 to its exponent."""
    exponent = round(math.log10(value))
    return number(value) if -2 <= exponent <= 3 else _power_of_ten(exponent)


def unit_text(units: str) -> str:
    """Write a unit for the eye: 'N*m/s^2', 'N*m/s**2' and 'newton*meter/second^2' become 'N·m/s²'."""
    units = _LONG_UNIT.sub(lambda found: SHORT_UNITS[found[0]], units)
    head, *powers = units.replace("**", "^").replace("*", "·").split("^")
    for power in powers:
        size = len(power) - len(power.lstrip("-0123456789"))
        head += power[:size].translate(_SUPERSCRIPT) + power[size:]
    return head


def with_unit(label: str, units: str) -> str:
    """Label an axis: 'cycle, s', or 'gain' alone for a pure number."""
    return f"{label}, {unit_text(units)}" if units else label


def time_scale(span_s: float) -> tuple[float, str]:
    """Choose the unit in which a time span reads best: (units per second, name of the unit)."""
    for per_second, name in ((1.0, "s"), (1e3, "ms"), (1e6, "µs")):
        if abs(span_s) * per_second >= 1:
            return per_second, name
    return (1.0, "s") if span_s == 0 or not math.isfinite(span_s) else (1e9, "ns")


def duration(time_s: float, digits: int = 4) -> str:
    """Write a time in the unit that suits it: 0.0005 -> '500 µs'."""
    per_second, name = time_scale(time_s)
    return f"{number(time_s * per_second, digits)} {name}"


def round_up(value: float) -> float:
    """Round a positive number up to 1, 1.5, 2, 2.5, 3, 4, 5, 6, 8 or 10 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    steps = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(step * power for step in steps if value <= step * power * (1 + 1e-9))


def broken(name: str, width: int = 15) -> str:
    """Break a long name behind a dot or an underscore into two lines, the second cut if need be."""
    if len(name) <= width:
        return name
    cut = max(name.rfind(mark, 0, width) for mark in "._") + 1 or width
    rest = name[cut:]
    return f"{name[:cut]}\n{rest if len(rest) <= width else rest[: width - 1] + '…'}"


def time_ticks(limits: tuple[float, float]) -> Floats:
    """Round instants (s) that cover a time axis from end to end, whatever unit it is written in."""
    per_second, _ = time_scale(max(map(abs, limits)))
    locator = MaxNLocator(10, steps=[1, 2, 2.5, 5, 10])
    return (
        np.asarray(locator.tick_values(limits[0] * per_second, limits[1] * per_second)) / per_second
    )


def rule(axes: Axes, across: Floats, levels: Floats, heavy: int = 4) -> None:
    """Rule axes as chart paper: lines at `across` with four finer ones between, and at `levels`,
    of which every fourth (or `heavy`-th) is heavy. Two collections draw in a tenth of the time of
    grid lines.
    """
    fine = np.linspace(across[0], across[-1], 5 * (len(across) - 1) + 1)
    upright, level = axes.get_xaxis_transform(), axes.get_yaxis_transform()
    for transform, places, every in ((upright, fine, 5), (level, levels, heavy)):
        ends = np.array([[0.0, 1.0]] * len(places))
        along = np.repeat(places[:, None], 2, axis=1)
        pair = (along, ends) if transform is upright else (ends, along)
        colors = [RULING if place % every else RULING_MAJOR for place in range(len(places))]
        lines = LineCollection(
            list(np.stack(pair, axis=2)),
            colors=colors,
            linewidths=0.7,
            zorder=0,
            transform=transform,
        )
        axes.add_collection(lines, autolim=False)


def mark_evenly(axis: Axis, count: int) -> None:
    """Put about `count` round figures on a linear axis."""
    axis.set_major_locator(MaxNLocator(count, steps=[1, 2, 2.5, 5, 10]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: number(value, _digits(axis))))


def digits_apart(low: float, high: float, least: int) -> int:
    """So many significant digits, `least` or more, that a hundredth of the way from `low` to `high`
    shows."""
    peak, span = max(abs(low), abs(high)), high - low
    if not (math.isfinite(peak) and span > 0.0):
        return least
    return min(max(least, math.ceil(math.log10(peak / span)) + 2), 15)


def _digits(axis: Axis) -> int:
    """Digits with which all figures on an axis differ."""
    low, high = sorted(float(end) for end in axis.get_view_interval())
    return digits_apart(low, high, 6)


def mark_decades(axis: Axis, ratio: float) -> None:
    """Label a logarithmic axis at powers of ten; at 2 and 5 times them too if it has few."""
    few = ratio < 1e3
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=12))
    axis.set_major_formatter(
        FuncFormatter(lambda value, _: number(value, 6) if few else _decade(value))
    )
    axis.set_minor_locator(LogLocator(subs=tuple(range(2, 10)), numticks=12))
    axis.set_minor_formatter(NullFormatter())


def provenance(about: Mapping[str, Any]) -> list[str]:
    """Say where the data come from: patch file, what it runs on and the seed, as far as known."""
    told = [str(about.get("patch", "")).replace("\\", "/").rpartition("/")[2]]
    moved = on_text(json.loads(about.get("on") or "{}"))
    told += [moved] if moved else []
    told += [f"machine {about['machine']}"] if about.get("machine") else []
    told += [f"seed {about['seed']}"] if "seed" in about else []
    return told if told[0] else told[1:]


def wrapped(facts: Sequence[str], letters: int) -> list[str]:
    """Facts in lines of at most so many letters that end between two facts."""
    whole = "  ·  ".join(fact.replace(" ", "\u00a0") for fact in facts if fact)
    lines = textwrap.wrap(whole, letters)
    return [line.replace("\u00a0", " ").strip(" ·") for line in lines]


def parameter_lines(about: Mapping[str, Any], letters: int) -> list[str]:
    """'set  cycle = 5 ms' in as many lines as it takes, for what was changed of the patch, and below
    'with  omega_p = 10 rad/s,  I_yy = 1 kg·m²' in two lines at most, for the rest."""
    given = json.loads(about.get("parameters") or "{}")
    changed = [name for name in json.loads(about.get("changed") or "[]") if name in given]
    rest = [name for name in given if name not in changed]
    lines = _listed("set", given, changed, letters)
    lines += _listed("with", given, rest, letters, max_lines=2, placeholder=" …")
    return [line.replace("\u00a0", " ") for line in lines]


def changed_fact(about: Mapping[str, Any]) -> str:
    """What was changed of the patch, 'set cycle = 5 ms, omega_p = 12 rad/s'; '' for nothing."""
    given = json.loads(about.get("parameters") or "{}")
    changed = [name for name in json.loads(about.get("changed") or "[]") if name in given]
    told = ", ".join(f"{name} = {unit_text(given[name])}" for name in changed)
    return f"set {told}" if told else ""


def _listed(
    verb: str, given: Mapping[str, str], names: Sequence[str], letters: int, **limits: Any
) -> list[str]:
    """Parameters with their values in lines that end between two of them; none without any."""
    if not names:
        return []
    told = (f"{name} = {unit_text(given[name])}".replace(" ", "\u00a0") for name in names)
    return textwrap.wrap(f"{verb}  {',  '.join(told)}", letters, **limits)


def is_held(about: Mapping[str, Any]) -> bool:
    """Whether a signal stands still but where it jumps, so that it is drawn as steps."""
    return bool(about.get("held", str(about.get("kind", "analog")) != "analog"))


def results(record: Any, name: str) -> Floats:
    """The values of a signal of a record, NaN before an ADC or a word has its first result."""
    values = np.asarray(record[name].values, dtype=np.float64)
    first_s = float(record[name].attrs.get("first_result_s", -math.inf))
    if first_s == -math.inf:
        return values
    return np.where(np.asarray(record["time"].values) >= first_s, values, np.nan)


def stepped(time: Floats, values: Floats) -> tuple[Floats, Floats]:
    """The corners of a trace that holds each value to the next row: (2n - 1,) from (n,)."""
    return np.repeat(time, 2)[1:], np.repeat(values, 2)[:-1]


def envelope(time: Floats, values: Floats, columns: int = 2000) -> tuple[Floats, Floats]:
    """Thin a long trace to the first, lowest, highest and last row of each column of time.

    time: (n,), not decreasing; values: (n,). Returns the rows kept, in order, as two arrays of at
    most 4 * columns values; a trace that is no longer than that is returned whole. Drawn at one
    or more columns a pixel, the picture is that of all rows (Jugel et al., "M4: a
    visualization-oriented time series data aggregation", VLDB 2014).
    """
    if len(time) <= 4 * columns:
        return time, values
    edges = np.linspace(time[0], time[-1], columns + 1)[:-1]
    starts = np.unique(np.searchsorted(time, edges))
    column = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(time)))
    kept = [starts, np.append(starts[1:], len(time)) - 1]
    for extreme in (np.fmin, np.fmax):
        candidates = np.flatnonzero(values == extreme.reduceat(values, starts)[column])
        _, first = np.unique(column[candidates], return_index=True)
        kept.append(candidates[first])
    rows = np.unique(np.concatenate(kept))
    return time[rows], values[rows]


@dataclass(frozen=True)
class TableRow:
    """One line of a table: column -> (value, error), NaN where unknown; a note at its end."""

    label: str
    cells: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    note: str = ""
    color: str = INK


def draw_table(
    figure: Figure, rows: Sequence[TableRow], columns: Mapping[str, str], top_in: float
) -> None:
    """Write a table at `top_in` inches: `columns` gives each column's key and its heading.

    The figures of a column share one count of decimals, so that they can be compared by eye, and
    a column without a figure is left out. The note of a row without figures takes their place.
    """
    left_in, width_in, first_in = 3.0, 2.5, 3.0
    at = {"fontsize": 9.0, "va": "center"}
    for key, heading in columns.items():
        cells = [row.cells[key] for row in rows if key in row.cells]
        if not any(math.isfinite(value) for value, _ in cells):
            continue
        write(figure, left_in, top_in, heading, **{**at, "color": MUTED, "fontsize": 8.5})
        decimals = _decimals(cells)
        for place, row in enumerate(rows, start=1):
            value, error = row.cells.get(key, (math.nan, math.nan))
            if math.isfinite(value):
                line_in = top_in + place * LINE_IN
                text = _fixed(value, decimals)
                write(figure, left_in + 0.95, line_in, text, ha="right", color=row.color, **at)
                if math.isfinite(error):
                    visible = error == 0 or error >= 0.5 * 10.0**-decimals
                    text = f" ± {_fixed(error, decimals) if visible else number(error, 2)}"
                    write(figure, left_in + 0.95, line_in, text, color=MUTED, **at)
        left_in += width_in
    for place, row in enumerate(rows, start=1):
        line_in = top_in + place * LINE_IN
        write(figure, MARGIN_IN, line_in, row.label, color=row.color, **at)
        empty = not any(math.isfinite(value) for value, _ in row.cells.values())
        note_in = first_in if empty else left_in
        write(figure, note_in, line_in, row.note, **{**at, "color": MUTED, "fontsize": 8.5})


def _decimals(cells: Sequence[tuple[float, float]]) -> int:
    """Enough for two digits of the smallest error, or six digits of the smallest value."""
    errors = [error for _, error in cells if math.isfinite(error) and error > 0]
    values = [abs(value) for value, _ in cells if math.isfinite(value) and value != 0]
    smallest, digits = (min(errors), 2) if errors else (min(values, default=1.0), 6)
    return min(max(digits - 1 - math.floor(math.log10(smallest)), 0), 10)


def _fixed(value: float, decimals: int) -> str:
    if abs(value) >= 1e7:
        return number(value, 6)
    return f"{value:.{decimals}f}".replace("-", "−")


def save(figure: Figure, path: str | PathLike[str]) -> Path:
    """Write a figure as PNG and return the path; equal figures give equal bytes.

    Raises RunError if the path does not end in .png, OSError if it cannot be written.
    """
    target = Path(path)
    if target.suffix.lower() != ".png":
        raise RunError(f"charts are written as PNG: the path must end in .png, not {str(path)!r}")
    # Packing harder takes three times as long and saves a quarter of a small file.
    Image.fromarray(_pixels(figure)).save(target, compress_level=1, dpi=(DPI, DPI))
    return target


def _pixels(figure: Figure) -> NDArray[np.uint8]:
    """A figure's red, green and blue, (rows, columns, 3); the figure stays as it was."""
    canvas, dpi = figure.canvas, figure.dpi
    try:
        figure.dpi = DPI
        paper = FigureCanvasAgg(figure)
        with chart_style(), warnings.catch_warnings():
            # A title in a script that the font lacks shows boxes; that is no reason to complain.
            warnings.filterwarnings("ignore", message="Glyph .* missing", category=UserWarning)
            paper.draw()  # type: ignore[no-untyped-call]
    finally:
        figure.dpi = dpi
        figure.set_canvas(canvas)
    colors: NDArray[np.uint8] = np.asarray(paper.buffer_rgba())  # type: ignore[no-untyped-call]
    return colors[..., :3]
