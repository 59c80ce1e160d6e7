"""The coupling chart: how far a patch's modes are from the ideal, against a swept parameter."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from hybrid.charts import style
from hybrid.charts.style import LINE_IN, MARGIN_IN, number, write

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

WIDE = 8.0  # a sweep is drawn on logarithmic scales if its ends are at least this ratio apart
DECADES = 9  # of a logarithmic scale of errors; an error that changes sign has no smallest value

WIDTH_IN = 12.0
LETTERS = 165  # of a line of the heading
PANEL_IN = 4.4
RESIDUAL_IN = 1.3
LEFT_IN = 1.12
PANEL_WIDTH_IN = 4.7
MARKERS = "osD^v<>"

LABELS = {
    ("zeta", True): "damping-ratio error |ζ − ζ ideal|",
    ("omega", True): "relative frequency error |ω / ω ideal − 1|",
    ("zeta", False): "damping ratio ζ",
    ("omega", False): "undamped frequency ω = |s|, rad/s",
}


@dataclass(frozen=True)
class Panel:
    """One quantity against the swept value: (points, readouts) measured, (points, modes) computed.

    With `ideal` known the figures are signed errors against it, else they are the values.
    """

    label: str
    ideal: bool
    measured: Floats
    error: Floats
    predicted: Floats
    closed_form: Floats
    residual: Floats

    def drawn(self) -> Floats:
        """Every finite figure of the panel, as it is drawn."""
        parts = [part.ravel() for part in (self.measured, self.predicted, self.closed_form)]
        figures = np.concatenate(parts)
        figures = figures[np.isfinite(figures)]
        return np.abs(figures) if self.ideal else figures


@dataclass(frozen=True)
class Curves:
    """What the panels share: swept values in order, names of the readouts, each one's mode."""

    swept: str
    units: str
    x: Floats
    readouts: tuple[str, ...]
    partners: tuple[int | None, ...]
    modes: int
    closed_form: str
    gaps: bool = False  # whether values between those that are drawn were never played

    def pen(self, readout: int) -> str:
        """Colour of a readout: that of the mode it is compared with."""
        partner = self.partners[readout]
        return style.PENS[(readout if partner is None else partner) % len(style.PENS)]


def coupling_chart(sweep: xr.Dataset) -> Figure:
    """Draw the errors of damping ratio and frequency against the swept parameter.

    sweep: one swept dimension with its coordinate (attribute units), and
        measured_zeta, measured_omega and their ..._error over (swept, readout);
        predicted_zeta, predicted_omega, closed_form_zeta, closed_form_omega, zeta_ideal,
        omega_ideal over (swept, mode). Any may be missing, hold NaN, or lack the swept dimension.
        Frequencies are undamped, |s|, in rad/s.

    Left: |zeta - zeta_ideal|; right: |omega / omega_ideal - 1|; below: measured minus predicted.
    A readout is compared with the mode whose frequency is nearest to its own. Without any ideal
    value the panels show zeta and omega themselves. Scales are logarithmic if the swept values
    are positive and their ends at least a factor of 8 apart.
    Raises ValueError if the dataset has no swept dimension, more than one, or one without numbers.
    """
    swept = _swept(sweep)
    sweep = sweep.isel({swept: np.argsort(sweep[swept].values, kind="stable")})
    curves = _curves(sweep, swept)
    panels = _panel(sweep, curves, "zeta"), _panel(sweep, curves, "omega")
    with style.chart_style():
        return _draw(
            curves, panels, _heading(sweep, curves, panels), _footnotes(sweep, curves, panels)
        )


# -- from the sweep to curves ----------------------------------------------------------------------


def _swept(sweep: xr.Dataset) -> str:
    """Return the name of the swept dimension."""
    found = sorted(str(name) for name in sweep.dims if name not in ("mode", "readout"))
    if len(found) != 1:
        listed = ", ".join(found) or "none"
        raise ValueError(
            f"a coupling chart needs one swept dimension beside 'mode' and 'readout', not: {listed}"
        )
    if found[0] not in sweep.coords or sweep[found[0]].dtype.kind not in "iuf":
        raise ValueError(f"the swept dimension '{found[0]}' needs numbers as its coordinate")
    return found[0]


def _table(sweep: xr.Dataset, name: str, swept: str, along: str) -> Floats:
    """Return a variable as (points, size of `along`), NaN where the sweep has none."""
    sizes = {swept: sweep.sizes[swept], along: sweep.sizes.get(along, 0)}
    if name not in sweep:
        return np.full(tuple(sizes.values()), np.nan)
    variable = sweep[name].astype(np.float64)
    missing = {key: size for key, size in sizes.items() if key not in variable.dims}
    return np.asarray(variable.expand_dims(missing).transpose(swept, along).values)


def _curves(sweep: xr.Dataset, swept: str) -> Curves:
    count = sweep.sizes.get("readout", 0)
    names = sweep["readout"].values if "readout" in sweep.coords else range(1, count + 1)
    reference = _table(sweep, "predicted_omega", swept, "mode")
    reference = np.where(
        np.isfinite(reference), reference, _table(sweep, "omega_ideal", swept, "mode")
    )
    measured = _table(sweep, "measured_omega", swept, "readout")
    return Curves(
        swept=swept,
        units=str(sweep[swept].attrs.get("units", "")),
        x=np.asarray(sweep[swept].values, dtype=np.float64),
        readouts=tuple(str(name) for name in names),
        partners=tuple(_nearest_mode(column, reference) for column in measured.T),
        modes=sweep.sizes.get("mode", 0),
        closed_form=str(sweep.attrs.get("closed_form", "")),
        gaps=sweep.attrs.get("status") == "interrupted",
    )


def _nearest_mode(measured: Floats, reference: Floats) -> int | None:
    """Find the mode whose frequency is nearest to a readout's over the sweep; None if unknown.

    measured: (points,), reference: (points, modes), both in rad/s.
    """
    if reference.shape[1] == 1:
        return 0
    gaps = np.abs(reference - measured[:, None]) / np.abs(measured[:, None])
    known = [column[np.isfinite(column)] for column in gaps.T]
    scores = [float(np.median(column)) if column.size else np.inf for column in known]
    return int(np.argmin(scores)) if scores and min(scores) < np.inf else None


def _panel(sweep: xr.Dataset, curves: Curves, quantity: str) -> Panel:
    """Take one quantity from the sweep; figures become errors where an ideal value is known."""

    def modes(name: str) -> Floats:
        return _table(sweep, name, curves.swept, "mode")

    def readouts(name: str) -> Floats:
        return _table(sweep, name, curves.swept, "readout")

    def of_partner(table: Floats, otherwise: float) -> Floats:
        blank = np.full(len(curves.x), otherwise)
        columns = [blank if mode is None else table[:, mode] for mode in curves.partners]
        return np.array(columns).reshape(len(columns), len(curves.x)).T

    ideal = modes(f"{quantity}_ideal")
    if quantity == "omega":  # a mode at rest has no relative error
        ideal = np.where(ideal > 0.0, ideal, np.nan)
    known = bool(np.isfinite(ideal).any())
    base = ideal if known else np.zeros_like(ideal)
    scale = ideal if known and quantity == "omega" else np.ones_like(ideal)
    measured, predicted = readouts(f"measured_{quantity}"), modes(f"predicted_{quantity}")
    measured_scale = of_partner(scale, 1.0)
    return Panel(
        label=LABELS[quantity, known],
        ideal=known,
        measured=(measured - of_partner(base, np.nan if known else 0.0)) / measured_scale,
        error=readouts(f"measured_{quantity}_error") / measured_scale,
        predicted=(predicted - base) / scale,
        closed_form=(modes(f"closed_form_{quantity}") - base) / scale,
        residual=(measured - of_partner(predicted, np.nan)) / measured_scale,
    )


def _heading(sweep: xr.Dataset, curves: Curves, panels: Sequence[Panel]) -> list[tuple[str, str]]:
    about = sweep.attrs
    title = str(about.get("title") or about.get("patch") or "Sweep")
    count = f"{len(curves.x):,} value{'s' * (len(curves.x) != 1)} of {curves.swept}"
    shown = "coupling errors" if any(panel.ideal for panel in panels) else "modes"
    lines = [(f"{title}: {shown} against {curves.swept}", style.INK)]
    barred = any(np.isfinite(panel.error).any() for panel in panels)
    bars = ["bars: ± one standard deviation"] if barred else []
    facts = [*style.provenance(about), count, *bars, style.changed_fact(about)]
    lines += [(line, style.MUTED) for line in style.wrapped(facts, LETTERS)]
    if about.get("status") == "interrupted":
        lines.append(("Interrupted: only the values that were done are drawn.", style.ALARM))
    return lines


def _footnotes(sweep: xr.Dataset, curves: Curves, panels: Sequence[Panel]) -> list[str]:
    """Say what the chart does not show."""
    notes = []
    if "status" in sweep:
        failed = np.flatnonzero(sweep["status"].values.astype(str) != "complete")
        if failed.size:
            where = f"{number(curves.x[failed[0]], 6)} {style.unit_text(curves.units)}"
            told = str(sweep["note"].values[failed[0]]) if "note" in sweep else ""
            notes.append(
                f"{failed.size:,} of {len(curves.x):,} runs did not complete, the first at "
                f"{curves.swept} = {where.strip()}: {told}".rstrip(": ")
            )
    if "overloads" in sweep:
        count = int(np.count_nonzero(sweep["overloads"].values))
        notes += [f"{count:,} of {len(curves.x):,} runs had overloads."] if count else []
    for panel in panels:
        if _logarithmic(curves, panel):
            below = int(np.count_nonzero(panel.drawn() < _lowest(panel.drawn())))
            notes += [f"{below:,} figures below the {panel.label} axis."] if below else []
    return [line for note in notes for line in textwrap.wrap(note, 160)]


# -- drawing ---------------------------------------------------------------------------------------


def _is_wide(x: Floats) -> bool:
    return bool(len(x) and x[0] > 0 and x[-1] >= WIDE * x[0])


def _logarithmic(curves: Curves, panel: Panel) -> bool:
    """Whether the panel's errors go on a logarithmic scale."""
    return panel.ideal and _is_wide(curves.x) and bool((panel.drawn() > 0).any())


def _lowest(figures: Floats) -> float:
    """Return the lower end of a logarithmic scale: below the smallest, within `DECADES`."""
    positive = figures[figures > 0]
    return float(max(0.7 * positive.min(), positive.max() / 10.0**DECADES))


def _draw(
    curves: Curves,
    panels: Sequence[Panel],
    head: Sequence[tuple[str, str]],
    foot: Sequence[str],
) -> Figure:
    """Lay the chart out in inches: heading, legend, two panels, their residuals, footnotes."""
    below = any(np.isfinite(panel.residual).any() for panel in panels)
    legend_in = 0.62 + LINE_IN * len(head)
    top_in = legend_in + 0.25
    bottom_in = top_in + PANEL_IN + (RESIDUAL_IN + 0.12 if below else 0.0)
    foot_in = bottom_in + 0.7
    figure = Figure(figsize=(WIDTH_IN, foot_in + LINE_IN * len(foot) + 0.05))
    style.draw_heading(figure, head)
    for place, panel in enumerate(panels):
        left_in = LEFT_IN + place * (WIDTH_IN / 2)
        box_in = (left_in, top_in, PANEL_WIDTH_IN, PANEL_IN)
        axes = style.axes_at(figure, box_in, panel.label)
        _draw_panel(axes, curves, panel)
        lowest = axes
        if below:
            box_in = (left_in, top_in + PANEL_IN + 0.12, PANEL_WIDTH_IN, RESIDUAL_IN)
            lowest = style.axes_at(figure, box_in, f"residual of {panel.label}")
            _draw_residual(lowest, curves, panel)
            axes.tick_params(axis="x", which="both", labelbottom=False)
        lowest.set_xlabel(style.with_unit(curves.swept, curves.units))
        if place == 0:
            _draw_legend(figure, axes, legend_in)
    for place, line in enumerate(foot):
        write(figure, MARGIN_IN, foot_in + place * LINE_IN, line, color=style.ALARM, va="center")
    return figure


def _draw_panel(axes: Axes, curves: Curves, panel: Panel) -> None:
    """Draw the exact prediction as lines, the closed form dashed, the measured as markers."""
    size = np.abs if panel.ideal else np.positive
    for mode in range(curves.modes):
        color = style.PENS[mode % len(style.PENS)]
        suffix = f", mode {mode + 1}" if curves.modes > 1 else ""
        form = f"closed form, {curves.closed_form}" if curves.closed_form else "closed form"
        for table, name, line in (
            (panel.predicted, "exact prediction", {"ls": "-", "lw": 1.5}),
            (panel.closed_form, form, {"ls": (0, (5, 3)), "lw": 1.3, "color": style.INK}),
        ):
            if np.isfinite(table[:, mode]).any():
                alone = curves.gaps or np.count_nonzero(np.isfinite(table[:, mode])) == 1
                marker = "_" if alone else ""
                line |= {"ls": ""} if curves.gaps else {}
                look: dict[str, Any] = {
                    "color": color,
                    "zorder": 3,
                    "marker": marker,
                    "markersize": 7 if curves.gaps else 16,
                    **line,
                }
                axes.plot(curves.x, size(table[:, mode]), label=name + suffix, **look)
    for readout, name in enumerate(curves.readouts):
        if np.isfinite(panel.measured[:, readout]).any():
            figures = size(panel.measured[:, readout])
            _draw_markers(axes, curves, readout, figures, panel.error, f"measured, {name}")
    _scale(axes, curves, panel)
    axes.set_ylabel(panel.label)


def _draw_markers(
    axes: Axes, curves: Curves, readout: int, figures: Floats, errors: Floats, label: str
) -> None:
    """Draw a readout's figures as open markers, with their errors as bars where known."""
    look: dict[str, Any] = {
        "ls": "",
        "marker": MARKERS[readout % len(MARKERS)],
        "markersize": 5.5 if len(curves.x) <= 60 else 3.0,
        "markerfacecolor": "white",
        "color": curves.pen(readout),
        "elinewidth": 1.0,
        "capsize": 2.0 if len(curves.x) <= 60 else 0.0,
        "zorder": 4,
    }
    bars = np.where(np.isfinite(errors[:, readout]), errors[:, readout], 0.0)
    axes.errorbar(curves.x, figures, yerr=bars if bars.any() else None, label=label, **look)


def _draw_residual(axes: Axes, curves: Curves, panel: Panel) -> None:
    """Draw measured minus exactly predicted, with the errors of the measurement."""
    axes.axhline(0.0, color=style.MUTED, lw=1.2, zorder=2)
    for readout in range(len(curves.readouts)):
        residual = panel.residual[:, readout]
        _draw_markers(axes, curves, readout, residual, panel.error, "measured − exact")
    reach = np.abs(panel.residual) + np.where(np.isfinite(panel.error), panel.error, 0.0)
    limit = 1.15 * float(np.nanmax(reach, initial=0.0)) or 1.0
    axes.set_ylim(-limit, limit)
    _scale_swept(axes, curves)
    style.mark_evenly(axes.yaxis, 4)
    axes.grid(True, which="minor", color=style.RULING, lw=0.6)
    axes.grid(True, which="major", color=style.RULING_MAJOR, lw=0.8)
    axes.set_ylabel("measured − exact", fontsize=8.5)
    axes.yaxis.set_label_coords(-0.165, 0.5)


def _scale_swept(axes: Axes, curves: Curves) -> None:
    """Set the axis of the swept parameter, a little wider than its values."""
    x = curves.x if len(curves.x) else np.array([0.0, 1.0])
    if _is_wide(x):
        axes.set_xscale("log")
        axes.set_xlim(x[0] / 1.15, x[-1] * 1.15)
        style.mark_decades(axes.xaxis, float(x[-1] / x[0]))
        return
    middle, half = (x[0] + x[-1]) / 2, (x[-1] - x[0]) / 2
    half = half * 1.05 if half > 0 else abs(middle) * 0.5 or 1.0
    axes.set_xlim(middle - half, middle + half)
    style.mark_evenly(axes.xaxis, 8)


def _scale(axes: Axes, curves: Curves, panel: Panel) -> None:
    """Set both scales of a panel, and rule it."""
    _scale_swept(axes, curves)
    drawn = panel.drawn()
    if _logarithmic(curves, panel):
        low, high = _lowest(drawn), 1.6 * float(drawn.max())
        axes.set_yscale("log", nonpositive="clip")
        axes.set_ylim(low, high)
        style.mark_decades(axes.yaxis, high / low)
    else:
        style.mark_evenly(axes.yaxis, 7)
        if panel.ideal and drawn.any():
            axes.set_ylim(0.0, 1.08 * float(drawn.max()))
    axes.grid(True, which="minor", color=style.RULING, lw=0.6)
    axes.grid(True, which="major", color=style.RULING_MAJOR, lw=0.8)
    axes.yaxis.set_label_coords(-0.165, 0.5)
    if not drawn.size:
        axes.text(0.5, 0.5, "nothing to show", transform=axes.transAxes, ha="center")


def _draw_legend(figure: Figure, axes: Axes, top_in: float) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        height_in = figure.get_size_inches()[1]
        place = (LEFT_IN / WIDTH_IN, 1 - top_in / height_in)
        columns = 4 if len(labels) > 4 else len(labels)
        figure.legend(
            handles, labels, loc="center left", bbox_to_anchor=place, ncols=columns, borderpad=0.0
        )
