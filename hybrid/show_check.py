"""What a check found, as tables in the terminal. Stage 7; prints, decides nothing."""

from __future__ import annotations

from rich.console import Console
from rich.markup import escape

from hybrid.checks import PHASE_ERROR, Check, ScaleRow, WordRow
from hybrid.equipment import is_cord
from hybrid.loops import loops_text
from hybrid.shots import columns as columns_of_shots
from hybrid.show import figure, show_table, speed_text
from hybrid.workload import columns, total_utilisation, work_text


def show_check(console: Console, check: Check) -> None:
    """Scaling and static check, potentiometers, loops, prediction."""
    machine = check.machine
    console.print(f"[bold]{escape(machine.patch.title)}[/] on machine {speed_text(machine)}: valid")
    console.print(check.events)
    for warning in check.warnings:
        console.print(f"warning: {warning}", style="yellow", markup=False)
    _show_scaling(console, check)
    _show_trial(console, check)
    _show_rates(console, check)
    settings = [
        (
            p.component,
            p.input,
            f"{p.setting:.4f}",
            str(p.gain),
            _about_pot(p.setting, p.inverted),
            figure(p.coefficient_mu, 6),
        )
        for p in check.pots
    ]
    headings = ("component", "input", "setting", "gain", "", "coefficient")
    show_table(console, "Coefficients and their potentiometers", headings, settings, texts=2)
    _show_parts(console, check)
    _show_delays(console, check)
    _show_converters(console, check)
    _show_tasks(console, check)
    if check.shots:
        names, cells, _ = columns_of_shots(check.shots)
        show_table(console, "Check shots of models", names, cells, texts=1)
    loops = [
        (" -> ".join(loop.path), figure(loop.lag_s, 4), "sampled" if loop.sampled else "analog")
        for loop in check.loops.listed
    ]
    show_table(console, "Loops", ("path", "sum of lags s", ""), loops, wrap=True)
    if left_out := loops_text(check.loops):
        console.print(left_out)
    console.print(f"Prediction: {escape(check.prediction)}")


def _about_pot(setting: float, inverted: bool) -> str:
    """What is unlike a plain setting: 1 takes no potentiometer, as *Parts* counts them."""
    told = ("no potentiometer" if is_cord(setting) else "", "inverted" if inverted else "")
    return ", ".join(filter(None, told))


def _show_tasks(console: Console, check: Check) -> None:
    """The work of the digital machine: its tasks, and the operations of a cycle of each."""
    if not check.tasks:
        return
    headings, cells = columns(check.tasks)
    total = 100 * total_utilisation(check.tasks)
    title = f"Digital machine, asked for {total:.4g} % of its time"
    title += "; rank 1 goes first" if len(check.tasks) > 1 else ""
    show_table(console, title, headings, cells, texts=1)
    for row in check.tasks:
        console.print(f"{escape(row.task)}: {escape(work_text(row))}")


def _show_delays(console: Console, check: Check) -> None:
    if not check.delays:
        return
    rows = [
        (row.delay, figure(row.time_s, 6), str(row.order), figure(row.good_to, 4))
        for row in check.delays
    ]
    columns = ("delay", "time s", "order", f"right to {PHASE_ERROR:g} rad up to rad/s")
    show_table(console, "Transport delays", columns, rows)


def _show_converters(console: Console, check: Check) -> None:
    if not check.converters:
        return
    rows = [
        (
            row.converter,
            row.kind,
            row.converts,
            str(row.bits or "-"),
            f"{figure(row.range, 6)} {row.units}".strip(),
            "-" if row.step is None else figure(row.step, 4),
            row.remark,
        )
        for row in check.converters
    ]
    columns = ("converter", "", "converts", "bits", "range", "step", "on this machine")
    show_table(console, "Converters", columns, rows, texts=3)


def _show_scaling(console: Console, check: Check) -> None:
    rows = [
        (
            r.signal,
            r.kind,
            f"{figure(r.full_scale, 6)} {r.units}".strip(),
            figure(r.value, 6),
            figure(r.value_mu, 6),
            figure(r.rate_mu, 6),
        )
        for r in check.scaling
    ]
    columns = ("signal", "kind", "full scale", "at t = 0", "machine units", "rate 1/s")
    show_table(console, "Scaling and static check", columns, rows, texts=2)


def _show_trial(console: Console, check: Check) -> None:
    trial = check.trial
    if trial is None:
        return
    length = f"{figure(trial.played_s, 6)} s"
    if trial.status != "complete":
        length += f" of {figure(trial.of_s, 6)} s"
    if not trial.tells:
        console.print(
            f"Trial run, {length}: {escape(trial.note)}; no full scales proposed", style="red"
        )
        return
    named: list[tuple[str, ScaleRow | WordRow]] = [(row.signal, row) for row in check.scaling]
    named += [(f"{row.word} ({row.bits} bit fixed)", row) for row in check.words]
    rows = [
        (
            name,
            r.remark,
            f"{figure(r.largest, 5)} {r.units}".strip(),
            "-" if r.used is None else f"{100 * r.used:.3g} %",
            figure(r.full_scale, 6),
            figure(r.proposed, 6),
        )
        for name, r in named
    ]
    columns = ("signal", "", "largest", "of range", "full scale", "proposed")
    show_table(console, f"Trial run, {length}", columns, rows, texts=2)
    if trial.note:
        console.print(escape(trial.note), style="yellow")


def _show_rates(console: Console, check: Check) -> None:
    if not check.rates:
        return
    rows = [
        (
            r.integrator,
            figure(r.rate_mu, 6),
            figure(r.first_mu, 6),
            figure(r.gain_error, 3),
            figure(r.drift_mu, 3),
        )
        for r in check.rates
    ]
    columns = ("integrator", "rate 1/s", "trial run", "gain error", "drift 1/s")
    show_table(console, "Rate test", columns, rows)
    first = [
        (
            r.integrator,
            figure(r.expected_mu, 6),
            r.remark or figure(r.shown_mu, 6),
            figure(r.allowed_mu, 2),
        )
        for r in check.rates
    ]
    headings = ("integrator", "by hand 1/s", "shown", "may differ")
    show_table(console, "Rates at the start", headings, first)


def _show_parts(console: Console, check: Check) -> None:
    rows = [(part.part, str(part.count)) for part in check.parts]
    show_table(console, "Parts", ("part", "count"), rows)
