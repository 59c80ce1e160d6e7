"""What every bench shares: two options, tables for people, one JSON object for programs."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table as RichTable

Row = Mapping[str, Any]
WIDTH = 180  # figures are never cut; a narrower terminal folds the lines


@dataclass(frozen=True, slots=True)
class Options:
    """How a bench was called."""

    quick: bool
    json: bool
    out: Path | None = None  # a chart as PNG, of a bench that draws one


@dataclass(frozen=True, slots=True)
class Table:
    """Rows with one value a column; `formats` gives heading -> (key, format of the value)."""

    name: str
    title: str
    formats: Mapping[str, tuple[str, str]]
    rows: Sequence[Row]
    notes: str = ""


def parse_options(about: str, draws: bool = False) -> Options:
    """Read --quick and --json, and --out where it draws; `about` is the bench's own docstring."""
    parser = argparse.ArgumentParser(
        description=about, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="fewer cases, shorter runs")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    if draws:
        parser.add_argument("--out", metavar="FILE.png", help="draw a chart")
    options = parser.parse_args()
    out = Path(options.out) if draws and options.out is not None else None
    if out and out.suffix.lower() != ".png":  # told now, not when all is computed
        parser.error(f"--out: charts are PNG, so the file must end in .png, not {options.out!r}")
    if out and not out.parent.is_dir():
        parser.error(f"--out: there is no folder {str(out.parent)!r}")
    return Options(options.quick, options.json, out)


def finish(
    file: str, options: Options, tables: Sequence[Table], passed: bool, verdict: str, **facts: Any
) -> int:
    """Print everything with one line at the end; returns the exit code, 0 where it passed."""
    if options.json:
        figures = {table.name: [dict(row) for row in table.rows] for table in tables}
        head = {"bench": Path(file).stem, "quick": options.quick, "passed": passed}
        say(json.dumps({**head, "verdict": verdict, **facts, **figures}, allow_nan=False))
        return 0 if passed else 1
    console = Console(width=WIDTH)
    for table in tables:
        _print_table(console, table)
    colour = "green" if passed else "red"
    console.print(f"[bold {colour}]{'PASS' if passed else 'FAIL'}[/]: {verdict}", highlight=False)
    return 0 if passed else 1


def say(line: str) -> None:
    """Print a line, to a reader such as `head` that may have read enough."""
    try:
        print(line, flush=True)
    except BrokenPipeError:
        # Nor is Python to say so at its end, where it flushes what is left.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_table(console: Console, table: Table) -> None:
    shown = RichTable(title=table.title, box=box.SIMPLE_HEAD, title_justify="left")
    for number, heading in enumerate(table.formats):
        shown.add_column(heading, justify="left" if number == 0 else "right")
    for row in table.rows:
        shown.add_row(*(_cell(row.get(key), form) for key, form in table.formats.values()))
    console.print(shown)
    if table.notes:
        console.print(table.notes + "\n", highlight=False, markup=False)


def _cell(value: Any, form: str) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "pass" if value else "[bold red]FAIL[/]"
    return format(value, form)
