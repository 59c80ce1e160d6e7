"""Standard output and error: one JSON object, one line, a bar. Stage 8."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from contextlib import suppress
from io import TextIOWrapper
from typing import TYPE_CHECKING, Any

from hybrid.errors import one_line

if TYPE_CHECKING:
    from rich.console import Console

# A bar for less than this would only flicker.
SHOW_PROGRESS_AFTER_S = 0.7
# Tables that go to a file or another program are broken later than those on a terminal.
WIDTH_OF_FILES = 130


def prepare_output() -> None:
    """Standard output takes any text and may be closed or lack letters."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - it stays open to the end
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # a title may hold letters that the terminal lacks


def drop_output() -> None:
    """What standard output still holds goes nowhere, so that Python does not try again at its end."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say(message: str) -> None:
    """One line on standard error, whatever it holds and whether or not anybody reads it."""
    with suppress(OSError):
        print(f"hybrid: {one_line(message)}", file=sys.stderr)


def console() -> Console:
    """Rich's console, which leaves a closed pipe to the command."""
    from rich.console import Console

    class Piped(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError

        def print(self, *objects: Any, **options: Any) -> None:
            """Sentences stay in one line where no terminal has an edge to break them at."""
            if not self.is_terminal and all(isinstance(each, str) for each in objects):
                options.setdefault("soft_wrap", True)
            super().print(*objects, **options)

    made = Piped(highlight=False)
    if not made.is_terminal:
        made.width = max(made.width, WIDTH_OF_FILES)
    return made


def print_json(**facts: Any) -> None:
    """One object on standard output."""
    print(json.dumps(_plain(facts), allow_nan=False))


def _plain(value: Any) -> Any:
    """Plain JSON values: no NaN, no numpy, no -0.0."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None
    return value


class Progress:
    """A bar on standard error, shown only once the work has taken a while."""

    def __init__(self, doing: str) -> None:
        """Args: doing: what takes so long, beside the bar."""
        self.doing, self.began = doing, time.monotonic()
        self.bar: Any = None
        self.task: Any = None

    def __enter__(self) -> Progress:
        return self

    def __call__(self, done: float) -> None:
        """Show the fraction that is done."""
        late = time.monotonic() - self.began > SHOW_PROGRESS_AFTER_S
        if self.bar is None and late and done < 1 and sys.stderr and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import Progress as Bar

            self.bar = Bar(console=Console(stderr=True), transient=True)
            self.task = self.bar.add_task(self.doing, total=1.0)
            self.bar.start()
        if self.bar is not None:
            self.bar.update(self.task, completed=done)

    def __exit__(self, *_: object) -> None:
        if self.bar is not None:
            self.bar.stop()
