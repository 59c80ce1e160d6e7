"""The commands: one thin function per verb. Stage 8; `options` reads what is asked for, `terminal`
says it.

Exit codes: 0 done; 1 the run stopped early (unstable, or no finite number) or a point of the sweep
failed; 2 a mistake in the patch, the options or the output folder, said in one line; 130 interrupted,
what was computed is kept.
"""

from __future__ import annotations

import argparse
import functools
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid import interrupts
from hybrid.compilation import say_if_compiling, say_if_slow
from hybrid.destinations import batch_file, file_stem, run_folder, sweep_file, writable
from hybrid.errors import HybridError, RunError, counted
from hybrid.options import combined, parsed, patch_and_parameters, swept_range, with_chosen
from hybrid.terminal import (
    Progress,
    console,
    drop_output,
    prepare_output,
    print_json,
    say,
)

if TYPE_CHECKING:
    from hybrid.batches import Batch
    from hybrid.filing import Filing
    from hybrid.machine import Machine
    from hybrid.prediction import Prediction
    from hybrid.sweeps import Sweep

Charts = Callable[[Any, Path], list[str]]  # draws a result into files, the first of that name
EXIT_STOPPED, EXIT_MISTAKE, EXIT_INTERRUPTED = 1, 2, 130


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the `hybrid` command; returns the exit code."""
    prepare_output()
    try:
        with interrupts.as_before():
            return _answer(arguments)
    except HybridError as error:
        say(str(error))
    except MemoryError:
        say("not enough memory; shorten the run or record fewer rows and signals")
    except KeyboardInterrupt:
        say("interrupted before there was a result; nothing written")
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # whoever reads has read enough
        drop_output()
        return 0
    except OSError as error:
        drop_output()
        say(f"cannot write the answer: {error.strerror or error}")
    return EXIT_MISTAKE


def _answer(arguments: list[str] | None) -> int:
    try:
        options = parsed(arguments)
    except SystemExit:  # --help and --version have said what there is to say
        sys.stdout.flush()
        return 0
    code = VERBS[options.verb](options)
    sys.stdout.flush()
    return code


def run_command(options: argparse.Namespace) -> int:
    """hybrid run."""
    from hybrid.filing import Filing

    with Filing(chart=not options.no_chart) as filing:
        return _run(options, filing)


def _run(options: argparse.Namespace, filing: Filing) -> int:
    patch, parameters = patch_and_parameters(options)
    from hybrid.arguments import with_until

    patch, pens = with_chosen(with_until(patch, options.until, "--until"), options.pens)
    if options.xy:
        from hybrid.charts.plotter import check_pairs, save_plots, with_pens

        patch, pairs = with_pens(patch, options.xy)
    if options.scope:
        from hybrid.charts.oscilloscope import check_operates, save_screens, with_beams

        patch, screens = with_beams(patch, options.scope)
    from hybrid.arguments import machine_of
    from hybrid.engines import check_engine, engine_of, wants_circuit
    from hybrid.record import machine_facts, span_facts
    from hybrid.runs import check_run, run

    ordered = (patch, parameters, options.machine, options.serial)
    circuit = wants_circuit(check_engine(options.engine))
    machine = machine_of(*ordered, circuit)
    engine = engine_of(machine, options.engine)
    check_run(machine, options.seed)
    if options.xy:
        check_pairs(pairs, span_facts(machine)["until_s"])
    if options.scope:
        check_operates(machine)
    stem = run_folder(options) / file_stem(options, patch)
    writable(*(stem.with_name(stem.name + suffix) for suffix in (".nc", ".png")))
    prediction = _prediction(machine_of(*ordered) if circuit else machine)
    say_if_compiling(machine, engine)
    say_if_slow(machine, engine)
    interrupts.hear()
    with Progress("running") as progress:
        result = run(machine, seed=options.seed, progress=progress, engine=engine)
        interrupts.ignore()
    if result.status == "interrupted" and not len(result.time_s):
        raise KeyboardInterrupt  # before the first row, so that there is nothing to keep
    modes = None if isinstance(prediction, str) else prediction.to_dicts()
    filing.write(result.parts(), result.readouts, modes, stem, pens)
    if not options.json:
        import hybrid.show  # noqa: F401  # takes half as long as drawing, so meanwhile
    from hybrid.storage import PlainRecord

    writers = [filing.written]
    if options.xy:
        writers.append(lambda: save_plots(PlainRecord(result.parts()), pairs, stem))
    if options.scope:
        writers.append(lambda: save_screens(PlainRecord(result.parts()), screens, stem))
    files, failure = _files_of(writers)
    if options.json:
        from hybrid.workload import to_dicts

        print_json(
            **machine_facts(machine),
            **span_facts(machine),
            seed=result.seed,
            engine=result.engine,
            engine_error=result.engine_error,
            coarse_by=result.coarse_by,
            cycles=result.cycles,
            operations=result.operations,
            tasks=to_dicts(result.tasks),
            status=result.status,
            status_note=result.status_note,
            readouts=result.readouts,
            prediction=modes,
            prediction_note=prediction if isinstance(prediction, str) else "",
            overloads=result.overloads,
            outside=result.outside,
            files=files,
        )
    else:
        from hybrid.show import show_run

        show_run(console(), result, prediction, files)
    if failure:
        raise failure  # the answer has been given
    return {"complete": 0, "stopped": EXIT_STOPPED}.get(result.status, EXIT_INTERRUPTED)


def _files_of(writers: Sequence[Callable[[], list[str]]]) -> tuple[list[str], HybridError | None]:
    """Let each write its files; those that are there, and why there are no more.

    What was computed must be told, be there room for its files or not.
    """
    from hybrid.storage import NotWritten

    files: list[str] = []
    for write in writers:
        try:
            files += write()
        except NotWritten as error:
            return [*files, *error.before], error
    return files, None


def _prediction(machine: Machine) -> Prediction | str:
    """The prediction, or the reason why there is none."""
    from hybrid.linearity import brief
    from hybrid.prediction import predict_machine

    try:
        return predict_machine(machine)
    except RunError as reason:
        return f"no prediction: {brief(reason)}"


def predict_command(options: argparse.Namespace) -> int:
    """hybrid predict."""
    patch, parameters = patch_and_parameters(options)
    from hybrid.prediction import predict

    result = predict(
        patch,
        parameters,
        machine=options.machine,
        serial=options.serial,
        max_damping_error=options.max_damping_error,
    )
    if options.json:
        from hybrid.record import machine_facts

        asked = {
            "max_damping_error": options.max_damping_error,
            "max_cycle_s": result.max_cycle_s,
        }
        print_json(
            **machine_facts(result.machine),
            modes=result.to_dicts(),
            notes=result.notes,
            **(asked if options.max_damping_error is not None else {}),
        )
    else:
        from hybrid.show import show_prediction

        show_prediction(console(), result)
    return 0


def sweep_command(options: argparse.Namespace) -> int:
    """hybrid sweep."""
    patch, parameters = patch_and_parameters(options)
    from hybrid.engines import engine_of
    from hybrid.runs import check_seed
    from hybrid.sweeps import check_sweep, sweep, values_of

    check_seed(options.seed)
    name, text = swept_range(options.over)
    values, out = values_of(patch, name, text), sweep_file(options, patch, name)
    # Whatever would stop every point, or either end, is said before a folder is made.
    first = check_sweep(
        patch, name, values, parameters, options.machine, options.serial, options.jobs
    )
    writable(out, out.with_suffix(".png"), out.with_name(f"{out.stem}_readouts.png"))
    say_if_compiling(first, engine_of(first, "auto"))
    say_if_slow(first, engine_of(first, "auto"))
    interrupts.hear()
    with Progress("sweeping") as progress:
        result = sweep(
            patch,
            name,
            values,
            parameters,
            machine=options.machine,
            seed=options.seed,
            serial=options.serial,
            jobs=options.jobs,
            progress=progress,
        )
        interrupts.ignore()
    files, failure = _written(options, result, out, _sweep_charts)
    if not options.json:
        from hybrid.show import show_sweep

        show_sweep(console(), result, files)
    return _exit_of(result, failure)


def _written(
    options: argparse.Namespace, result: Sweep | Batch, out: Path, charts: Charts
) -> tuple[list[str], HybridError | None]:
    """Write the data and the charts of many runs, and print them if JSON is asked for.

    Returns the files, and why there are no more.
    """
    from hybrid.storage import write_dataset

    if not result.points:
        raise KeyboardInterrupt

    def data() -> list[str]:
        write_dataset(result.dataset, out)
        return [str(out)]

    writers = [data]
    if not options.no_chart:
        writers.append(lambda: charts(result, out.with_suffix(".png")))
    files, failure = _files_of(writers)
    if options.json:
        print_json(**result.to_dict(), files=files)
    return files, failure


def _exit_of(result: Sweep | Batch, failure: HybridError | None) -> int:
    """Exit code of many runs; raises what kept a file from being written, the answer being given."""
    if failure:
        raise failure
    if result.status != "complete":
        return EXIT_INTERRUPTED
    return EXIT_STOPPED if any(p.status == "failed" for p in result.points) else 0


def batch_command(options: argparse.Namespace) -> int:
    """hybrid batch."""
    patch, parameters = patch_and_parameters(options)
    from hybrid.batches import batch, check_batch
    from hybrid.engines import engine_of
    from hybrid.orders import orders_of

    lists, serials = combined(options, patch, parameters)
    orders, differ = orders_of(patch, lists, None, serials, options.seed)
    out = batch_file(options, patch)
    first = check_batch(patch, orders, differ, options.machine, options.jobs)
    writable(out, out.with_suffix(".png"))
    say_if_compiling(first, engine_of(first, "auto"))
    say_if_slow(first, engine_of(first, "auto"))
    interrupts.hear()
    with Progress("running") as progress:
        result = batch(
            patch,
            lists,
            machine=options.machine,
            serial=serials,
            seed=options.seed,
            jobs=options.jobs,
            progress=progress,
        )
        interrupts.ignore()
    files, failure = _written(options, result, out, _ensemble_chart)
    if not options.json:
        from hybrid.show import show_batch

        show_batch(console(), result, files)
    return _exit_of(result, failure)


def _ensemble_chart(result: Batch, path: Path) -> list[str]:
    from hybrid.charts.ensemble import Across, Spread, ensemble_chart
    from hybrid.charts.style import changed_fact, provenance, save
    from hybrid.storage import write_whole

    data, title = result.dataset, f"{result.patch.title}: {counted(len(result.points), 'run')}"
    title += f" over {' and '.join(result.differ)}" if result.differ else ""
    across = None
    if len(result.differ) == 1:
        name = result.differ[0]
        across = Across(name, data[name].values, data[name].attrs["units"])
    one = len({result.serial_of(order) for order in result.orders}) == 1
    same = f"serial {result.first.serial}" if one else ""
    facts = [*provenance(data.attrs), same, *result.varied, result.status_note]
    facts.append(changed_fact(data.attrs))
    spreads = [Spread(name, *figure) for name, figure in result.figures().items()]
    figure = ensemble_chart(title, facts, spreads, across)
    write_whole(path, lambda part: save(figure, part))
    return [str(path)]


def _sweep_charts(result: Sweep, path: Path) -> list[str]:
    from hybrid.charts.readings import sweep_charts
    from hybrid.charts.style import save
    from hybrid.storage import write_whole

    drawn = sweep_charts(result.dataset, path)
    for file, figure in drawn.items():
        write_whole(file, functools.partial(save, figure))
    return [str(file) for file in drawn]


def check_command(options: argparse.Namespace) -> int:
    """hybrid check."""
    patch, parameters = patch_and_parameters(options)
    from hybrid.arguments import machine_of
    from hybrid.checks import check
    from hybrid.engines import engine_of

    machine = machine_of(patch, parameters, options.machine, options.serial)
    if not options.no_trial:
        say_if_compiling(machine, engine_of(machine, "auto"))
    result = check(machine, trial=not options.no_trial)
    if options.json:
        print_json(**result.to_dict())
    else:
        from hybrid.show_check import show_check

        show_check(console(), result)
    return 0


def list_command(options: argparse.Namespace) -> int:
    """hybrid list."""
    from hybrid.patchfile import read_patch
    from hybrid.shipped import shipped_patches

    found = {name: (read_patch(path).title, str(path)) for name, path in shipped_patches().items()}
    if options.json:
        print_json(patches=[{"name": n, "title": t, "file": f} for n, (t, f) in found.items()])
    else:
        from hybrid.show import show_list

        show_list(console(), found)
    return 0


def schema_command(options: argparse.Namespace) -> int:
    """hybrid schema."""
    from hybrid.schema import json_schema, reference

    print(reference() if options.markdown else json.dumps(json_schema(), indent=2))
    return 0


def draw_command(options: argparse.Namespace) -> int:
    """hybrid draw."""
    patch, parameters = patch_and_parameters(options)
    from hybrid.charts.diagram import save_diagram

    out = f"{file_stem(options, patch)}.svg" if options.out is None else options.out
    file = save_diagram(patch, parameters, out)
    if options.json:
        print_json(patch=patch.file, title=patch.title, files=[file])
    else:
        print(f"wrote {file}")
    return 0


VERBS: Mapping[str, Callable[[argparse.Namespace], int]] = {
    "run": run_command,
    "predict": predict_command,
    "sweep": sweep_command,
    "batch": batch_command,
    "check": check_command,
    "draw": draw_command,
    "list": list_command,
    "schema": schema_command,
}

if __name__ == "__main__":
    sys.exit(main())
