"""Results in the terminal, as tables. Stage 7; prints, decides nothing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from hybrid.batches import Batch
from hybrid.beside import mode_beside
from hybrid.errors import counted
from hybrid.machine import Machine
from hybrid.naming import on_text
from hybrid.played import Run, readout_text
from hybrid.points import Point
from hybrid.prediction import Prediction
from hybrid.scale import time_scale_text, to_seconds
from hybrid.sweeps import Sweep
from hybrid.workload import TaskRow, columns, total_utilisation

TRANSIENT = ("omega", "omega_damped", "zeta")
MOST_SWEEP_ROWS = 12
MOST_OVERLOADS = 10
FEWEST_DIGITS, MOST_DIGITS = 5, 17  # of an overload; a double has no more
WIDEST = 100_000  # letters
NARROWEST_WRAP = 60


def figure(value: Any, digits: int = 9) -> str:
    """A number as a reader wants it; '-' where there is none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return f"{value + 0.0:.{digits}g}" if isinstance(value, float) else str(value)


def show_table(
    console: Console,
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    texts: int = 1,
    wrap: bool = False,
    style: str = "",
) -> None:
    """A plain table: the first `texts` columns to the left, figures to the right.

    A table wider than the terminal keeps its width, and the terminal breaks its lines: a figure that
    is cut off would be a wrong figure. `wrap`: the first column takes several lines instead. Without
    rows nothing is printed.
    """
    rows = list(rows)
    if not rows:
        return
    made = Table(
        title=escape(title), title_justify="left", title_style="bold", box=None, pad_edge=False
    )
    for i, column in enumerate(columns):
        made.add_column(
            escape(column),
            justify="left" if i < texts else "right",
            no_wrap=not wrap or i > 0,
            overflow="fold",
        )
    for row in rows:
        made.add_row(*(escape(cell) for cell in row))
    own_width = console.width
    anything = console.options.update_width(WIDEST)
    needed = NARROWEST_WRAP if wrap else console.measure(made, options=anything).maximum
    console.width = max(own_width, needed)
    console.print(made, style=style)
    console.width = own_width


def show_run(
    console: Console, run: Run, prediction: Prediction | str, files: Sequence[str]
) -> None:
    """What was run, the readouts beside the prediction, the overloads, the files."""
    machine = run.machine
    cycles = ""
    if machine.timing.period:
        cycles = f"{counted(run.cycles, 'cycle')} of {machine.cycle_s:g} s, "
    if machine.operation:
        cycles += f"{_operations_text(run)}, "
    error = run.engine_error
    beside = f" beside the noise of {run.coarse_by}" if run.coarse_by else ""
    about = "" if error is None else f" (error about {error:.1g} of full scale{beside})"
    console.print(f"[bold]{escape(machine.patch.title)}[/]  ({escape(machine.patch.file)})")
    console.print(
        f"machine {speed_text(machine)}, seed {run.seed}, {run.engine} engine{about}; "
        f"{cycles}{counted(len(run.rows), 'row')}"
        + (f" ({run.rows_note})" if run.rows_note else "")
    )
    if run.status_note:
        style = "yellow" if run.status == "complete" else "bold red"
        console.print(f"[{style}]{escape(run.status_note)}[/]")
    modes = prediction.to_dicts() if isinstance(prediction, Prediction) else []
    above = "none"  # a table stands between blank lines, single lines stay together
    for name, quantities in run.readouts.items():
        kind = "table" if "zeta" in quantities and not quantities.get("reason") else "line"
        if "table" in (above, kind) or above == "none":
            console.print()
        above = kind
        _show_readout(console, name, quantities, modes)
    if isinstance(prediction, str):
        console.print(escape(prediction))
    _show_tasks(console, run.tasks)
    _show_overloads(console, run.overloads)
    console.print()
    for file in files:
        console.print(f"wrote {escape(file)}", soft_wrap=True)


def _operations_text(run: Run) -> str:
    """How many operations were played: the clock alone is counted where signals may cut OP short."""
    operation, modes = run.machine.operation, run.machine.patch.modes
    assert operation is not None and modes is not None
    told = f"{counted(run.operations, 'operation')} of {to_seconds(operation.operate):g} s"
    return f"{told} by the clock" if modes.reset_when or modes.hold_when else told


def _show_tasks(console: Console, rows: Sequence[TaskRow]) -> None:
    """How several tasks shared the processor; one program is its own measure."""
    if len(rows) > 1 or any(row.period_s is None or row.overruns for row in rows):
        headings, cells = columns(rows)
        total = 100 * total_utilisation(rows)
        title = f"Tasks, asking for {total:.4g} % of the processor's time; rank 1 goes first"
        show_table(console, title, headings, cells, texts=1)


def speed_text(machine: Machine) -> str:
    """The machine's name, its time scale where it has one, and what `--on` has moved."""
    told = (machine.preset, time_scale_text(machine.time_scale), on_text(machine.patch.on))
    return ", ".join(filter(None, told))


def _show_readout(
    console: Console, name: str, quantities: Mapping[str, Any], modes: Sequence[Mapping[str, Any]]
) -> None:
    if quantities.get("reason"):
        console.print(f"[bold]{escape(name)}[/]: {escape(str(quantities['reason']))}")
    elif "zeta" in quantities:
        mode = mode_beside(quantities, modes)
        closed = (mode or {}).get("closed_form")
        columns = [name, "measured", "+-", "exact", "ideal"]
        if closed:
            columns.insert(4, f"Eq. {closed['equation']}")
        rows = []
        for quantity in TRANSIENT:
            unit = "" if quantity == "zeta" else " rad/s"
            row = [quantity + unit, figure(quantities[quantity])]
            row.append(figure(quantities.get(quantity + "_error"), 2))
            row.append(figure(mode.get(quantity) if mode else None))
            if closed:
                row.append(figure(closed.get(quantity)))
            ideal = {"omega": "omega_ideal", "zeta": "zeta_ideal"}.get(quantity, "")
            row.append(figure(mode.get(ideal) if mode else None, 6))
            rows.append(row)
        show_table(console, "", columns, rows)
        if closed and closed.get("note"):
            console.print(f"Eq. {closed['equation']}: {escape(closed['note'])}", style="dim")
        if mode and mode.get("poles"):
            console.print(f"exact: {_poles_text(mode['poles'])}", style="dim")
            if mode["omega_ideal"] is not None:
                console.print(f"ideal: {_poles_text(mode['ideal_poles'])}", style="dim")
    else:
        figures = {k: v for k, v in quantities.items() if k != "note"}
        console.print(f"[bold]{escape(name)}[/]: {escape(readout_text(figures))}")
    if quantities.get("note"):
        console.print(escape(str(quantities["note"])), style="yellow")


def _poles_text(rates: Sequence[float]) -> str:
    first, second = (figure(-rate, 7) for rate in sorted(rates, key=abs))
    return f"the real poles s = {first} and {second} 1/s as one mode"


def _show_overloads(console: Console, overloads: Sequence[Mapping[str, Any]]) -> None:
    if not overloads:
        return
    rows = []
    for o in overloads[:MOST_OVERLOADS]:
        digits = _digits_apart(o["worst_value"], o["full_scale"])
        rows.append(
            (
                o["signal"],
                figure(o["time_s"], 7),
                f"{figure(o['worst_value'], digits)} {o['units']}".strip(),
                figure(o["worst_time_s"], 7),
                figure(o["full_scale"], digits),
                "-" if o["duration_s"] is None else figure(o["duration_s"], 4),
            )
        )
    console.print()
    columns = ("overload", "first at s", "worst", "at s", "full scale", "for s")
    show_table(console, "", columns, rows, style="red")
    if len(overloads) > MOST_OVERLOADS:
        console.print(f"and {len(overloads) - MOST_OVERLOADS} more")


def _digits_apart(worst: float, full_scale: float) -> int:
    """So many digits that two show of what the worst value is beyond full scale by: 10.0013 of 10."""
    excess = abs(worst) / full_scale - 1.0
    if not 0.0 < excess < 1.0:
        return FEWEST_DIGITS
    return min(max(FEWEST_DIGITS, math.ceil(-math.log10(excess)) + 2), MOST_DIGITS)


def show_prediction(console: Console, prediction: Prediction) -> None:
    """Modes, each with its closed form and its ideal."""
    machine = prediction.machine
    console.print(
        f"[bold]{escape(machine.patch.title)}[/] on machine {speed_text(machine)}: prediction"
    )
    for mode in prediction.to_dicts():
        closed = mode["closed_form"]
        columns = ["mode", "exact"] + ([f"Eq. {closed['equation']}"] if closed else []) + ["ideal"]
        rows = []
        for quantity in TRANSIENT:
            row = [quantity + ("" if quantity == "zeta" else " rad/s"), figure(mode[quantity])]
            if closed:
                row.append(figure(closed.get(quantity)))
            row.append(figure(mode.get(quantity + "_ideal"), 6))
            rows.append(row)
        show_table(console, "", columns, rows)
        if closed and closed.get("note"):
            console.print(f"Eq. {closed['equation']}: {escape(closed['note'])}", style="dim")
    if not prediction.modes:
        console.print(
            "the patch has no modes: nothing in it integrates, and no word remembers for long"
        )
    if prediction.max_damping_error is not None:
        asked = f"damping-ratio error below {prediction.max_damping_error:g}"
        if prediction.max_cycle_s is None:
            console.print(
                f"{asked}: no cycle time exceeds it that leaves two samples for a period of a mode"
            )
        else:
            console.print(f"{asked}: T up to [bold]{prediction.max_cycle_s:.9g} s[/]")
    for note in prediction.notes:
        console.print(escape(note), style="dim")


def show_sweep(console: Console, sweep: Sweep, files: Sequence[str]) -> None:
    """A selection of the points, the largest difference from the prediction, the files."""
    console.print(repr(sweep)[1:-1], highlight=False, markup=False)
    data = sweep.dataset
    readouts = data["readout"].values.tolist()
    unit = data[sweep.parameter].attrs["units"]
    scalars = [str(n) for n in data.data_vars if str(n).startswith("value_")]
    overloads = any(p.overloads for p in sweep.points)
    rows = []
    listed = some_rows(len(sweep.points), MOST_SWEEP_ROWS)
    for i in listed:
        row = [figure(float(data[sweep.parameter].values[i]), 6)]
        for j in range(len(readouts)):
            row += [figure(float(data["measured_zeta"].values[i, j]))]
            row += [figure(float(data["measured_omega"].values[i, j]))]
        for k in range(data.sizes["mode"]):
            row += [figure(float(data["predicted_zeta"].values[i, k]))]
            row += [figure(float(data["predicted_omega"].values[i, k]))]
        row += [figure(float(data[name].values[i])) for name in scalars]
        row += [str(sweep.points[i].overloads)] if overloads else []
        rows.append(row)
    columns = [f"{sweep.parameter} {unit}".strip()]
    columns += [f"{name} {q}" for name in readouts for q in ("zeta", "omega")]
    modes = data.sizes["mode"]
    told = [f"predicted mode {k + 1}" for k in range(modes)] if modes > 1 else ["predicted"] * modes
    columns += [f"{name} {q}" for name in told for q in ("zeta", "omega")]
    columns += [f"{n.removeprefix('value_')} {data[n].attrs['units']}".strip() for n in scalars]
    columns += ["overloads"] if overloads else []
    show_table(console, "", columns, rows)
    if len(listed) < len(sweep.points):
        console.print(
            f"the table has {len(listed)} of {len(sweep.points)} points; the file has all",
            style="dim",
        )
    _show_notes(console, sweep.points, "point")
    for file in files:
        console.print(f"wrote {escape(file)}", soft_wrap=True)


def show_batch(console: Console, batch: Batch, files: Sequence[str]) -> None:
    """How the figures are spread, the first note, the files."""
    console.print(repr(batch).partition("\n")[0][1:-1], highlight=False, markup=False)
    if batch.varied:
        console.print(f"over {';  '.join(batch.varied)}", highlight=False, markup=False)
    groups = batch.groups()
    listed = some_rows(len(groups), MOST_SWEEP_ROWS)
    told = [(batch.combination_text(groups[i][0]), groups[i][1]) for i in listed]
    rows = [
        (
            f"{name} {about['units']}".strip(),
            *([made] if groups else []),
            str(about["runs"]),
            figure(about["mean"]),
            figure(about["std"], 4),
            figure(about["minimum"]),
            figure(about["maximum"]),
        )
        for made, summary in told or [("", batch.summary())]
        for name, about in summary.items()
    ]
    columns = ("figure", *(["of"] if groups else []), "runs", "mean", "std", "least", "largest")
    show_table(console, "", columns, rows, texts=2 if groups else 1)
    if len(listed) < len(groups):
        console.print(f"the table has {len(listed)} of {len(groups)} combinations", style="dim")
    _show_notes(console, batch.points, "run")
    for file in files:
        console.print(f"wrote {escape(file)}", soft_wrap=True)


def _show_notes(console: Console, points: Sequence[Point], what: str) -> None:
    """What holds of all points is said once; of what holds of some, how many and the first."""
    remarks = [p.remarks.split("; ") if p.remarks else [] for p in points]
    shared = [part for part in remarks[0] if all(part in own for own in remarks)] if points else []
    if shared:
        console.print(escape("; ".join(shared)))
    rest = ["; ".join(part for part in own if part not in shared) for own in remarks]
    notes = [text for text in rest if text]
    if notes:
        console.print(f"{counted(len(notes), what)} with a note, the first: {escape(notes[0])}")


def some_rows(count: int, most: int) -> list[int]:
    """Evenly spread rows out of `count`, about `most` of them, the last one always among them."""
    step = max(1, -(-count // most))
    return sorted({*range(0, count, step), count - 1}) if count else []


def show_list(console: Console, titles: Mapping[str, tuple[str, str]]) -> None:
    """Shipped patches: name, title, file."""
    rows = [(name, title, path) for name, (title, path) in titles.items()]
    show_table(console, "Patches that ship", ("name", "title", "file"), rows, texts=3)
