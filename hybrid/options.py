"""What can be written after `hybrid`, and how it is read. Stage 8."""

from __future__ import annotations

import argparse
import itertools
import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn

from hybrid.errors import RunError, did_you_mean, quoted
from hybrid.machines import PRESETS
from hybrid.version import __version__

MOST_PENS = 12  # of a strip chart

if TYPE_CHECKING:
    from hybrid.patch import Patch


class _Parser(argparse.ArgumentParser):
    """Complaints in one line; options in full, so that a slip of the pen is none of them."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        option, _, rest = message.removeprefix("argument ").partition(": ")
        if rest == "expected one argument" and option.startswith("--"):
            raise RunError(
                f"{option} needs a value; one that begins with - is written {option}=-..."
            )
        if message.endswith("required: VERB"):
            message = f"name a verb: {', '.join(_verbs_of(self))}"
        raise RunError(f"{message}; see {self.prog} --help")


def parsed(arguments: list[str] | None) -> argparse.Namespace:
    """The command line; raises RunError for what its verb does not know, and says which verbs do."""
    made = parser()
    options, left = made.parse_known_args(arguments)
    if not left:
        return options
    option, verb = left[0].partition("=")[0], options.verb
    if not option.startswith("-"):
        raise RunError(f"{quoted(left[0])} is too much for hybrid {verb}; see hybrid {verb} --help")
    others = [name for name, its in _verbs_of(made).items() if option in its._option_string_actions]
    known = f"it is one of {' and '.join(others)}; " if others else ""
    raise RunError(f"hybrid {verb} has no option {option}; {known}see hybrid {verb} --help")


def _verbs_of(made: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The verbs of the whole command line, each with its own."""
    return made._subparsers._group_actions[0].choices  # type: ignore[union-attr,return-value]


class _Once(argparse.Action):
    """An option that must not be given twice."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        if getattr(namespace, self.dest) is not None:
            parser.error(f"{option_string} is given twice; sweep one range at a time")
        setattr(namespace, self.dest, values)


def _whole(text: str) -> int:
    """A whole number in plain digits; int() takes more, such as 1_0."""
    if not re.fullmatch(r"[+-]?[0-9]{1,1000}", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{quoted(text)} is no whole number")
    return int(text)


def _decimal(text: str) -> float:
    """A decimal number; float() takes more, such as 1_0 and digits of other scripts."""
    if not re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?(nan|inf)", text):
        raise argparse.ArgumentTypeError(f"{quoted(text)} is no number, such as 0.01")
    return float(text)


def parser() -> argparse.ArgumentParser:
    """The parser of the whole command line; `verb` in what it gives is the name of the verb."""
    made = _Parser(prog="hybrid", description="An emulated hybrid analog-digital computer.")
    made.add_argument("--version", action="version", version=f"hybrid {__version__}")
    verbs = made.add_subparsers(required=True, metavar="VERB", dest="verb", parser_class=_Parser)
    _run(_verb(verbs, "run", "run a patch: strip chart, readouts, record"))
    _predict(_verb(verbs, "predict", "exact modes and closed forms, without a run"))
    _sweep(_verb(verbs, "sweep", "measure and predict over a range of one parameter"))
    _batch(_verb(verbs, "batch", "many runs: machines of a make, noise, several parameters"))
    _check(_verb(verbs, "check", "validate a patch; scaling, potentiometers, static check"))
    doc = "the patch diagram with the customary symbols"
    _draw(verbs.add_parser("draw", help=doc, description=doc))
    listing = verbs.add_parser("list", help="the patches that ship")
    listing.add_argument("--json", action="store_true", help="print one JSON object")
    schema = verbs.add_parser("schema", help="the patch language as JSON Schema")
    schema.add_argument("--markdown", action="store_true", help="as a reference table instead")
    return made


def _verb(verbs: Any, name: str, doc: str) -> argparse.ArgumentParser:
    """A verb with the options that all verbs on a patch share."""
    made: argparse.ArgumentParser = verbs.add_parser(name, help=doc, description=doc)
    _patch(made)
    made.add_argument("--machine", metavar="PRESET", help=", ".join(PRESETS))
    made.add_argument("--serial", type=_whole, metavar="N", help="serial number of the machine")
    return made


def _patch(made: argparse.ArgumentParser) -> None:
    made.add_argument("patch", metavar="PATCH", help="patch file, or the name of a shipped patch")
    made.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="set a parameter, cycle='2 ms', or a time of a task, NAME.period='2 ms'",
    )
    made.add_argument(
        "--on",
        action="append",
        default=[],
        metavar="[NAME=]MACHINE",
        help="run all, or a part, signal or word, on the analog or digital machine: body=digital",
    )
    made.add_argument("--json", action="store_true", help="print one JSON object")


def _draw(made: argparse.ArgumentParser) -> None:
    _patch(made)
    made.add_argument("--out", metavar="FILE", help="SVG file (default: PATCH.svg)")


def _seed(made: argparse.ArgumentParser) -> None:
    made.add_argument(
        "--seed", type=_whole, default=0, metavar="N", help="seed of the noise (default 0)"
    )


def _run(made: argparse.ArgumentParser) -> None:
    _seed(made)
    made.add_argument(
        "--engine",
        default="auto",
        metavar="ENGINE",
        help="auto (default), exact, nonlinear or reference (slow)",
    )
    made.add_argument("--until", metavar="TIME", help="end of the run, such as '20 s'")
    made.add_argument(
        "--out", default="out", metavar="DIR", help="folder for the files (default out)"
    )
    made.add_argument("--no-chart", action="store_true", help="write the record only")
    made.add_argument(
        "--pens",
        metavar="SIGNAL[,SIGNAL]",
        help="the signals that the strip chart draws, in order (default: the first 12 of record:, or "
        "without it those of readouts, then integrators, then the rest)",
    )
    made.add_argument(
        "--xy",
        action="append",
        default=[],
        metavar="X:Y[:TIME]",
        help="also plot signal Y against X, from TIME on",
    )
    made.add_argument(
        "--scope",
        action="append",
        default=[],
        metavar="SIGNAL[,SIGNAL]",
        help="also show signals on an oscilloscope, one sweep for each operation",
    )


def _predict(made: argparse.ArgumentParser) -> None:
    made.add_argument(
        "--max-damping-error",
        type=_decimal,
        metavar="X",
        help="find the largest T that keeps below X",
    )


def _check(made: argparse.ArgumentParser) -> None:
    made.add_argument("--no-trial", action="store_true", help="leave the trial run out")


def _sweep(made: argparse.ArgumentParser) -> None:
    made.add_argument(
        "--over",
        action=_Once,
        required=True,
        metavar="NAME=START:STOP:COUNT[:lin|:log]",
        help="the range, evenly spaced (as with :lin) or evenly in the logarithm (:log)",
    )
    _seed(made)
    _many(made)


def _many(made: argparse.ArgumentParser) -> None:
    """Options of the verbs that make many runs."""
    made.add_argument(
        "--jobs",
        type=_whole,
        metavar="N",
        help="runs at a time (default: as many as there are cores)",
    )
    made.add_argument("--out", metavar="FILE", help="NetCDF file; the chart goes beside it")
    made.add_argument("--no-chart", action="store_true", help="write the data only")


def _batch(made: argparse.ArgumentParser) -> None:
    made.add_argument(
        "--over",
        action="append",
        default=[],
        metavar="NAME=START:STOP:COUNT[:lin|:log]",
        help="a range, as of a sweep; of several, every combination is run",
    )
    made.add_argument("--runs", type=_whole, metavar="N", help="N runs of each, each its own noise")
    made.add_argument(
        "--serials", metavar="FIRST:LAST", help="each on every machine of these serial numbers"
    )
    _seed(made)
    _many(made)


# -- what was written -------------------------------------------------------------------------------


def patch_and_parameters(options: argparse.Namespace) -> tuple[Patch, dict[str, float]]:
    """The patch, and the parameters set from outside, in SI."""
    from hybrid.arguments import parameters_of
    from hybrid.patchfile import read_patch, told_from_texts

    patch = read_patch(options.patch, told_from_texts(options.on))
    texts: dict[str, float | str] = {}
    for entry in options.set:
        name, equals, text = (part.strip() for part in entry.partition("="))
        if not (name and equals and text):
            raise RunError(f"--set {quoted(entry)} must be NAME=VALUE, such as --set cycle='2 ms'")
        if name in texts:
            raise RunError(f"--set {name} is given twice")
        texts[name] = text
    return patch, parameters_of(patch, texts)


def with_chosen(patch: Patch, pens: str | None) -> tuple[Patch, list[str] | None]:
    """The signals of --pens, or of a record of more than fit those that say most first; the patch with
    them in its record, too."""
    if pens is None:
        crowded = not patch.record and len(patch.signals) > MOST_PENS
        return patch, _by_weight(patch) if crowded else None
    names = [name.strip() for name in pens.split(",")]
    if not all(names):
        many = f"an empty name in {quoted(pens)}" if any(names) else "no signal"
        listed = ", ".join(patch.signals[:MOST_PENS])
        raise RunError(f"--pens has {many}; give one or more of {listed}, with commas between")
    for place, name in enumerate(names):
        if name in names[:place]:
            raise RunError(f"--pens names {quoted(name)} twice; one pen draws it")
        if name not in patch.signals:
            raise RunError(f"--pens: no signal {quoted(name)}; {did_you_mean(name, patch.signals)}")
    if len(names) > MOST_PENS:
        raise RunError(f"--pens names {len(names)} signals; a strip chart has {MOST_PENS} pens")
    if not patch.record:  # all are in it
        return patch, names
    return replace(patch, record=tuple(dict.fromkeys((*patch.record, *names)))), names


def _by_weight(patch: Patch) -> list[str]:
    """All signals: what readouts read, what integrates, and then the rest, each by the alphabet."""
    from hybrid.patch import State

    read = {readout.signal for readout in patch.readouts}
    states = {component.name for component in patch.components if component.kind == "integrate"}
    if patch.program:
        states |= {entry.word for entry in patch.program.written if isinstance(entry, State)}
    return sorted(patch.signals, key=lambda name: (name not in read, name not in states))


def swept_range(over: str) -> tuple[str, str]:
    """Name and range of --over NAME=START:STOP:COUNT[:lin] or NAME=START:STOP:COUNT:log."""
    name, _, text = (part.strip() for part in over.partition("="))
    if not (name and text):
        raise RunError(
            f"--over {quoted(over)} must be NAME=START:STOP:COUNT[:lin] or NAME=START:STOP:COUNT:log, "
            "such as --over 'cycle=1 ms:5 ms:9'"
        )
    return name, text


def combined(
    options: argparse.Namespace, patch: Patch, parameters: dict[str, float]
) -> tuple[dict[str, Any], list[int | None]]:
    """Every combination that a batch asks for: parameters, and serial numbers if given.

    The last range runs through fastest but for the serial numbers, and these but for --runs.
    """
    from hybrid.arguments import whole_number
    from hybrid.points import MOST_POINTS
    from hybrid.sweeps import values_of

    ranges: dict[str, list[float]] = {}
    for over in options.over:
        name, text = swept_range(over)
        if name in ranges or name in parameters:
            where = "swept twice" if name in ranges else "both set and swept"
            raise RunError(f"{name} is {where}; leave out one of them")
        ranges[name] = values_of(patch, name, text).tolist()
    again = whole_number("--runs", 1 if options.runs is None else options.runs, 1, MOST_POINTS)
    serials: list[int | None] = [options.serial]
    if options.serials is not None:
        serials = [*serial_range(options.serials)]
    if options.serials is not None and options.serial is not None:
        raise RunError("give either --serial or --serials")
    if not ranges and options.runs is None and options.serials is None:
        raise RunError("a batch needs --over, --serials or --runs to tell what to run")
    count = again * len(serials) * math.prod(len(values) for values in ranges.values())
    if count > MOST_POINTS:
        raise RunError(f"{count} runs are too many; a batch makes {MOST_POINTS} at most")
    table = [
        (values, serial)
        for values in itertools.product(*ranges.values())
        for serial in serials
        for _ in range(again)
    ]
    columns: dict[str, Any] = {n: [row[0][i] for row in table] for i, n in enumerate(ranges)}
    return {**parameters, **columns}, [serial for _, serial in table]


def serial_range(text: str) -> list[int]:
    """Serial numbers of --serials FIRST:LAST, both included."""
    from hybrid.points import MOST_POINTS

    ends = re.fullmatch(r"([0-9]{1,19}):([0-9]{1,19})", text)
    if not ends:
        raise RunError(f"--serials {quoted(text)} must be FIRST:LAST, such as 1:1000")
    first, last = map(int, ends.groups())
    if last < first:
        raise RunError(f"--serials {quoted(text)}: LAST must not be below FIRST")
    if last - first >= MOST_POINTS:
        told = f"--serials {quoted(text)} asks for {last - first + 1} machines"
        raise RunError(f"{told}; a batch makes {MOST_POINTS} runs at most")
    return list(range(first, last + 1))
