"""The door of the `hybrid` command: Ctrl-C is quiet from the first of our own lines on.

Nothing is loaded before the signal is heard that the interpreter does not need itself.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False

if TYPE_CHECKING:
    from typing import Any, NoReturn


def main() -> int:
    """Run the command line; returns its exit code."""
    listening = signal.getsignal(signal.SIGINT) is not signal.SIG_IGN  # not a job in the background
    if listening:
        signal.signal(signal.SIGINT, _leave)
    from hybrid.loading import seldom_collect

    seldom_collect()
    # Matrices here are small: threads for them cost more than they bring.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from hybrid.cli import main as command

    code = command()
    if listening:  # the answer is given and the files are written: nothing is left to interrupt
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    if "joblib" not in sys.modules:  # which has workers to dismiss
        _end(code)
    return code


def _end(code: int) -> NoReturn:
    """Everything is written: taking numba apart piece by piece would only take longer."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream:
                stream.flush()
        except (OSError, ValueError):  # nobody reads any more
            pass
    os._exit(code)


def _leave(*_: Any) -> None:
    """Nothing is computed yet and nothing is to be kept, so no import need be unwound."""
    os.write(2, b"hybrid: interrupted before there was a result; nothing written\n")
    os._exit(130)


if __name__ == "__main__":
    sys.exit(main())
