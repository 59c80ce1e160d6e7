"""The commands: one thin function per verb. Stage 8.

Exit codes: 0 done; 1 the run stopped early (unstable, or no finite number); 2 a mistake in the patch,
the options or the output folder, said in one line; 130 interrupted, what was computed is kept.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from hybrid.errors import HybridError, PatchError, RunError

if TYPE_CHECKING:
    from rich.console import Console

    from hybrid.filing import Filing
    from hybrid.patch import Patch

EXIT_STOPPED, EXIT_MISTAKE, EXIT_INTERRUPTED = 1, 2, 130
NARROWEST_TABLE = 130
# A bar for less than this would only flicker.
SHOW_PROGRESS_AFTER_S = 0.7


def main(arguments: list[str] | None = None) -> int:
    """Entry point of the `hybrid` command; returns the exit code."""
    signal.signal(signal.SIGTERM, _interrupt)
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a title may hold letters that the terminal lacks
    try:
        options = _parser().parse_args(arguments)
        verb: Callable[[argparse.Namespace], int] = options.verb
        code = verb(options)
        sys.stdout.flush()
        return code
    except HybridError as error:
        return _complain(str(error))
    except MemoryError:
        return _complain("not enough memory; shorten the run or record fewer rows and signals")
    except KeyboardInterrupt:
        print("hybrid: interrupted before anything was computed; nothing written", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        _drop_output()
        return 0
    except OSError as error:
        _drop_output()
        return _complain(f"cannot write the answer: {error.strerror or error}")


def _drop_output() -> None:
    """What standard output still holds goes nowhere, so that Python does not try again at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(message: str) -> int:
    """One line on standard error, whatever characters a file name brings into it."""
    line = "".join(letter if letter.isprintable() else " " for letter in message)
    print(f"hybrid: {line}", file=sys.stderr)
    return EXIT_MISTAKE


def _interrupt(*_: object) -> NoReturn:
    raise KeyboardInterrupt


class _Parser(argparse.ArgumentParser):
    """Complaints in one line."""

    def error(self, message: str) -> NoReturn:
        raise RunError(f"{message}; see {self.prog} --help")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="hybrid", description="An emulated hybrid analog-digital computer.")
    verbs = parser.add_subparsers(required=True, metavar="VERB", parser_class=_Parser)

    run = _verb(verbs, "run", run_command, "run a patch: strip chart, readouts, record")
    run.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the noise (default 0)"
    )
    run.add_argument("--until", metavar="TIME", help="end of the run, such as '20 s'")
    run.add_argument(
        "--out", default="out", metavar="DIR", help="folder for the files (default out)"
    )
    run.add_argument("--no-chart", action="store_true", help="write the record only")

    predict = _verb(
        verbs, "predict", predict_command, "exact modes and closed forms, without a run"
    )
    predict.add_argument(
        "--max-damping-error", type=float, metavar="X", help="find the largest T that keeps below X"
    )

    sweep = _verb(
        verbs, "sweep", sweep_command, "measure and predict over a range of one parameter"
    )
    sweep.add_argument(
        "--over", required=True, metavar="NAME=START:STOP:COUNT[:log]", help="the range"
    )
    sweep.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the noise (default 0)"
    )
    sweep.add_argument(
        "--jobs", type=int, metavar="N", help="worker processes (default: all cores)"
    )
    sweep.add_argument("--out", metavar="FILE", help="NetCDF file; the chart goes beside it")
    sweep.add_argument("--no-chart", action="store_true", help="write the data only")

    _verb(verbs, "check", check_command, "validate a patch; scaling, potentiometers, static check")

    listing = verbs.add_parser("list", help="the patches that ship")
    listing.add_argument("--json", action="store_true", help="print one JSON object")
    listing.set_defaults(verb=list_command)
    schema = verbs.add_parser("schema", help="the patch language as JSON Schema")
    schema.add_argument("--markdown", action="store_true", help="as a reference table instead")
    schema.set_defaults(verb=schema_command)
    return parser


def _verb(
    verbs: Any, name: str, command: Callable[[argparse.Namespace], int], doc: str
) -> argparse.ArgumentParser:
    """A verb with the options that all verbs on a patch share."""
    parser: argparse.ArgumentParser = verbs.add_parser(name, help=doc, description=doc)
    parser.add_argument("patch", metavar="PATCH", help="patch file, or the name of a shipped patch")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="set a parameter: cycle='2 ms'",
    )
    parser.add_argument("--machine", metavar="PRESET", help="ideal, lags or nominal")
    parser.add_argument("--serial", type=int, metavar="N", help="serial number of the machine")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(verb=command)
    return parser


# -- the verbs --------------------------------------------------------------------------------------


def run_command(options: argparse.Namespace) -> int:
    """hybrid run."""
    from hybrid.filing import Filing

    with Filing(chart=not options.no_chart) as filing:
        return _run(options, filing)


def _run(options: argparse.Namespace, filing: Filing) -> int:
    patch, parameters = _read(options)
    if options.until is not None:
        patch = _with_until(patch, options.until)
    from hybrid.compiler import compile_patch
    from hybrid.record import output_folder
    from hybrid.runs import check_seed, run
    from hybrid.timeline import build_timeline

    check_seed(options.seed)
    machine = compile_patch(patch, parameters, options.machine, options.serial)
    build_timeline(machine)
    folder = output_folder(options.out)
    prediction = _prediction(machine)
    _say_if_compiling()
    with _Progress("running") as progress:
        result = run(machine, seed=options.seed, progress=progress)
    modes = None if isinstance(prediction, str) else prediction.to_dicts()
    stem = folder / Path(patch.file).stem
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # another Ctrl-C must not lose the record
    try:
        files = filing.write(result.parts(), result.readouts, modes, stem)
    finally:
        signal.signal(signal.SIGINT, before)
    if options.json:
        _print_json(
            patch=patch.file,
            title=patch.title,
            machine=machine.preset,
            serial=machine.serial,
            seed=result.seed,
            cycles=result.cycles,
            status=result.status,
            status_note=result.status_note,
            readouts=result.readouts,
            prediction=modes,
            overloads=result.overloads,
            files=files,
        )
    else:
        from hybrid.show import show_run

        show_run(_console(), result, prediction, files)
    return {"complete": 0, "stopped": EXIT_STOPPED}.get(result.status, EXIT_INTERRUPTED)


def predict_command(options: argparse.Namespace) -> int:
    """hybrid predict."""
    patch, parameters = _read(options)
    from hybrid.prediction import predict

    result = predict(
        patch,
        parameters,
        machine=options.machine,
        serial=options.serial,
        max_damping_error=options.max_damping_error,
    )
    if options.json:
        from hybrid.record import parameter_texts

        facts: dict[str, Any] = {
            "patch": patch.file,
            "machine": result.machine.preset,
            "parameters": parameter_texts(result.machine),
            "modes": result.to_dicts(),
        }
        if options.max_damping_error is not None:
            facts["max_damping_error"] = options.max_damping_error
            facts["max_cycle_s"] = result.max_cycle_s
        _print_json(**facts)
    else:
        from hybrid.show import show_prediction

        show_prediction(_console(), result)
    return 0


def sweep_command(options: argparse.Namespace) -> int:
    """hybrid sweep."""
    patch, parameters = _read(options)
    from hybrid.patchfile import parse_override
    from hybrid.record import output_folder, write_dataset
    from hybrid.runs import check_seed
    from hybrid.sweeps import check_sweep, parse_range, sweep

    check_seed(options.seed)
    name, _, text = options.over.partition("=")
    if not text:
        raise RunError(f"--over {options.over!r} must be NAME=START:STOP:COUNT or ...:COUNT:log")
    values = parse_range(text, lambda end: parse_override(patch, name, end))
    out = Path(options.out or f"out/{Path(patch.file).stem}_over_{name}.nc")
    if out.suffix != ".nc":
        raise RunError(f"--out {out} must be a NetCDF file, ending in .nc")
    # Whatever would stop every point is said before a folder is made.
    check_sweep(patch, name, values, parameters, options.machine, options.serial, options.jobs)
    output_folder(out.parent)
    _say_if_compiling()
    with _Progress("sweeping") as progress:
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
    if not result.points:
        raise KeyboardInterrupt
    write_dataset(result.dataset, out)
    files = [str(out)]
    if not options.no_chart:
        from hybrid.charts.coupling import coupling_chart

        files.append(_save_chart(coupling_chart(result.dataset), out.with_suffix(".png")))
    if options.json:
        points = [
            {
                "value": float(values[p.index]),
                "readouts": p.measured,
                "modes": p.modes,
                "status": p.status,
                "note": p.note,
                "overloads": p.overloads,
                "seed": p.seed,
            }
            for p in result.points
        ]
        _print_json(
            patch=patch.file,
            over=name,
            machine=result.machine,
            seed=options.seed,
            status=result.status,
            points=points,
            files=files,
        )
    else:
        from hybrid.show import show_sweep

        show_sweep(_console(), result, files)
    return 0 if result.status == "complete" else EXIT_INTERRUPTED


def check_command(options: argparse.Namespace) -> int:
    """hybrid check."""
    patch, parameters = _read(options)
    from hybrid.checks import check

    result = check(patch, parameters, machine=options.machine, serial=options.serial)
    if options.json:
        _print_json(**result.to_dict())
    else:
        from hybrid.show import show_check

        show_check(_console(), result)
    return 0


def list_command(options: argparse.Namespace) -> int:
    """hybrid list."""
    from hybrid.patchfile import read_patch
    from hybrid.shipped import shipped_patches

    found = {name: (read_patch(path).title, str(path)) for name, path in shipped_patches().items()}
    if options.json:
        patches = [{"name": n, "title": t, "file": f} for n, (t, f) in found.items()]
        _print_json(patches=patches)
    else:
        from hybrid.show import show_list

        show_list(_console(), found)
    return 0


def schema_command(options: argparse.Namespace) -> int:
    """hybrid schema."""
    from hybrid.schema import json_schema, reference

    print(reference() if options.markdown else json.dumps(json_schema(), indent=2))
    return 0


# -- what the verbs share ---------------------------------------------------------------------------


def _read(options: argparse.Namespace) -> tuple[Patch, dict[str, float]]:
    """The patch, and the parameters set from outside, in SI."""
    from hybrid.patchfile import parse_override, read_patch
    from hybrid.shipped import find_patch

    patch = read_patch(find_patch(options.patch))
    parameters: dict[str, float] = {}
    for entry in options.set:
        name, equals, text = entry.partition("=")
        if not equals or not text.strip():
            raise RunError(f"--set {entry!r} must be NAME=VALUE, such as --set cycle='2 ms'")
        if name.strip() in parameters:
            raise RunError(f"--set {name.strip()} is given twice")
        parameters[name.strip()] = parse_override(patch, name.strip(), text.strip())
    return patch, parameters


def _with_until(patch: Patch, text: str) -> Patch:
    from dataclasses import replace

    from hybrid.patchfile import parse_duration

    return replace(patch, run=replace(patch.run, until=parse_duration(text, "--until")))


def _prediction(machine: Any) -> Any:
    """The prediction, or the reason why there is none."""
    from hybrid.prediction import predict_machine

    try:
        return predict_machine(machine)
    except RunError as reason:
        return f"no prediction: {reason}"


def _save_chart(figure: Any, path: Path) -> str:
    from hybrid.charts.strip import save
    from hybrid.record import write_whole

    write_whole(path, lambda part: save(figure, part))
    return str(path)


def _console() -> Console:
    from rich.console import Console

    console = Console(highlight=False)
    # A line too long for the terminal wraps there; a figure that is cut off would be a wrong figure.
    console.width = max(console.width, NARROWEST_TABLE)
    return console


def _say_if_compiling() -> None:
    from hybrid.engine import kernel

    if not kernel.is_compiled():
        print("hybrid: compiling the kernel, once after installation ...", file=sys.stderr)


def _print_json(**facts: Any) -> None:
    print(json.dumps(_plain(facts), allow_nan=False))


def _plain(value: Any) -> Any:
    """Plain JSON values: no NaN, no numpy."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


class _Progress:
    """A bar on standard error, shown only once the work has taken a while."""

    def __init__(self, doing: str) -> None:
        self.doing, self.began = doing, time.monotonic()
        self.bar: Any = None
        self.task: Any = None

    def __enter__(self) -> _Progress:
        return self

    def __call__(self, done: float) -> None:
        late = time.monotonic() - self.began > SHOW_PROGRESS_AFTER_S
        if self.bar is None and late and done < 1 and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress

            self.bar = Progress(console=Console(stderr=True), transient=True)
            self.task = self.bar.add_task(self.doing, total=1.0)
            self.bar.start()
        if self.bar is not None:
            self.bar.update(self.task, completed=done)

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()


__all__ = ["PatchError", "main"]

if __name__ == "__main__":
    sys.exit(main())
