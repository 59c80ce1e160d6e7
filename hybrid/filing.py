"""A run's files, written by a second process that loads the drawing libraries while the run goes on.

Stage 6. Loading matplotlib takes longer than most runs; on its own core it costs no waiting. So that
it starts at once, nothing else of the project is loaded before it.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.errors import HybridError
from hybrid.interrupts import held_back
from hybrid.loading import load_matplotlib_without_3d, seldom_collect

if TYPE_CHECKING:
    from hybrid.storage import Parts

# How long the process has to end before it is made to. It may not hear: SIGTERM may be ignored since
# before the command was started.
PATIENCE_S = 2.0


class Filing:
    """Start it before the run; `write` what the run gave. A context: at its end the process ends."""

    def __init__(self, chart: bool) -> None:
        """Start loading; `chart`: a strip chart will be asked for."""
        self.chart = chart
        forks = _may_fork()
        processes: Any = get_context("fork" if forks else "spawn")
        self.line, far_end = processes.Pipe()
        copied = self.line if forks else None
        # A daemon: whatever happens, it is gone with the main process and nobody waits for it.
        self.process = processes.Process(target=_serve, args=(far_end, chart, copied), daemon=True)
        with held_back(starts_tracker=not forks):
            self.process.start()
        far_end.close()

    def __enter__(self) -> Filing:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing more to write: a run that could not begin must not leave it loading."""
        self.line.close()
        for end in (self.process.terminate, self.process.kill):
            end()
            self.process.join(PATIENCE_S)
            if not self.process.is_alive():
                return

    def write(
        self,
        parts: Parts,
        readouts: dict[str, dict[str, Any]],
        prediction: list[dict[str, Any]] | None,
        stem: Path,
        pens: Sequence[str] | None = None,
    ) -> None:
        """Have `stem`.nc and, if asked for, `stem`.png written; `written` waits for them.

        pens: the signals that the chart draws; the first of the record if not given.
        """
        self.work = (parts, readouts, prediction, stem, self.chart, pens)
        with suppress(OSError):  # the process was killed, as `written` will find, too
            self.line.send(self.work)

    def written(self) -> list[str]:
        """The names of the files, once they are there. Raises HybridError where they cannot be."""
        try:
            answer = self.line.recv()
        except (EOFError, OSError):  # the process was killed: do it here
            return write_files(*self.work)
        if isinstance(answer, HybridError):
            raise answer
        files: list[str] = answer
        return files


def _may_fork() -> bool:
    """Whether a copy of this process will do, which is there at once: it must not lack any threads.

    A command begins like that; numpy brings threads that Python does not count.
    """
    alone = threading.active_count() == 1 and "numpy" not in sys.modules
    return alone and "fork" in get_all_start_methods()


def write_files(
    parts: Parts,
    readouts: dict[str, dict[str, Any]],
    prediction: list[dict[str, Any]] | None,
    stem: Path,
    chart: bool,
    pens: Sequence[str] | None = None,
) -> list[str]:
    """Write the record and the strip chart; each file appears whole or not at all.

    Raises NotWritten, also of a chart, with the record that was.
    """
    from hybrid.storage import NotWritten, PlainRecord, write_parts, write_whole

    record_file = stem.with_name(stem.name + ".nc")
    write_parts(parts, record_file)
    if not chart:
        return [str(record_file)]
    from hybrid.charts.strip import save, strip_chart

    figure = strip_chart(PlainRecord(parts), readouts, prediction, signals=pens)
    chart_file = stem.with_name(stem.name + ".png")
    try:
        write_whole(chart_file, lambda part: save(figure, part))
    except NotWritten as error:
        error.before = (str(record_file),)
        raise
    return [str(record_file), str(chart_file)]


def _serve(line: Connection, chart: bool, copied: Connection | None) -> None:
    """Load what writing needs, then do one piece of work.

    `copied`: the other end of the line, which must be open in the main process alone, so that its end is
    heard here.
    """
    if copied:
        copied.close()
    seldom_collect()
    if chart:
        load_matplotlib_without_3d()
        import hybrid.charts.strip
    import netCDF4  # noqa: F401

    import hybrid.storage  # noqa: F401

    try:
        answer: Any = write_files(*line.recv())
    except EOFError:
        return
    except HybridError as error:
        answer = error
    line.send(answer)
