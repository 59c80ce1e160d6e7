"""What a run gave: its record, its readouts, its overloads, and the facts of it.

Stage 5, for `runs`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hybrid.beginnings import first_results
from hybrid.errors import counted
from hybrid.machine import Floats, Machine, Pen
from hybrid.naming import asked_text
from hybrid.record import record_parts
from hybrid.scale import row_times_s, to_seconds
from hybrid.storage import Parts
from hybrid.timeline import Timeline
from hybrid.workload import TaskRow, ended_cycles, task_rows, to_dicts

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


NO_FIGURES = ("kind", "signal", "units")  # of what a readout says


@dataclass(frozen=True, eq=False)
class Run:
    """What a run gave, up to where it came.

    record: an xarray.Dataset over `time` (rows,) in s, a float64 variable (rows,) for every signal, in
        its own `units` (attribute; beside it full_scale and kind); facts of the run are its attributes.
    readouts: by name; of a transient omega and omega_damped in rad/s, zeta, each with `..._error` (one
        standard deviation), amplitude and offset; of others `value`, and time_s in s of some. `units`
        are those of the signal; None, with its `reason`, where there is no answer.
    rows: (rows, pens), what record is made of, a column for each of `pens`, in their units; time_s:
        (rows,), in s; every `keep_every`-th of the rows that were asked for. done_ticks: in ticks, see
        `scale`; timeline: what happened on the digital machine until then.
    overloads: a dict each, by time: signal, time_s and duration_s in s, value, worst_value and
        full_scale in units; outside: a dict each place where a table or helper was asked beyond
        its range. tasks: a row for each task, times in s. operations: of the machine, how many were
        played to their end.
    status: 'complete', 'interrupted' or 'stopped', status_note says why; machine, seed and engine: what
        it was played with; engine_error: of full scale, None where the engine has no estimate;
        coarse_by: the part whose noise sets it; played_s: in s of real time.
    """

    machine: Machine
    seed: int
    timeline: Timeline
    done_ticks: int  # up to where it was played
    status: str  # 'complete', 'interrupted' or 'stopped'
    status_note: str  # why it ended early, or that it is too short to show the digital machine
    keep_every: int  # of the rows asked for, 1 in n
    pens: tuple[Pen, ...]
    rows: Floats
    overloads: tuple[dict[str, Any], ...]
    operations: int = 0  # of the machine, by its clock, whose OP came to its end
    readouts: dict[str, dict[str, Any]] = field(default_factory=dict)
    engine: str = "exact"  # which one played it
    engine_error: float | None = None  # its estimate, of full scale, if it has one
    coarse_by: str = ""  # the part whose noise says how well it resolves, if one does
    outside: tuple[dict[str, Any], ...] = ()  # functions of the program asked beyond their range
    played_s: float = 0.0  # how long the engine took, of real time

    @property
    def row_ticks(self) -> int:
        """From one row to the next."""
        return self.machine.timing.every * self.keep_every

    def row_s(self, number: int) -> float:
        """When a row was taken."""
        return to_seconds(number * self.row_ticks)

    @cached_property
    def time_s(self) -> Floats:
        """When each row was taken, (rows,)."""
        return row_times_s(len(self.rows), self.row_ticks)

    @property
    def rows_note(self) -> str:
        """Which rows were kept; '' for all."""
        return thinning_text(self.keep_every)

    @cached_property
    def tasks(self) -> tuple[TaskRow, ...]:
        """How the digital machine did."""
        return task_rows(self.machine, self.timeline, self.done_ticks)

    @property
    def cycles(self) -> int:
        """Digital cycles that ended: those of the program, or of the task with the shortest period."""
        return ended_cycles(self.machine, self.tasks)

    @cached_property
    def firsts_s(self) -> dict[str, float]:
        """When each ADC and word has its first result, infinite where the run ends before."""
        firsts = first_results(self.machine, self.timeline, self.seed).items()
        return {name: t if math.isinf(t) else to_seconds(int(t)) for name, t in firsts}

    def first_s(self, signal: str) -> float:
        """When a signal has its first result: one of the analog side, at once."""
        if signal in self.machine.analog.signals:
            return 0.0
        return self.firsts_s.get(signal, 0.0)

    @cached_property
    def record(self) -> xr.Dataset:
        """Every recorded signal in problem units, with the facts of the run as attributes."""
        import xarray as xr

        return xr.Dataset(*self.parts())

    def parts(self) -> Parts:
        """What `record` is made of, without xarray."""
        facts: dict[str, str | int | float] = {
            "seed": self.seed,
            "engine": self.engine,
            "cycles": self.cycles,
            "operations": self.operations,
            "status": self.status,
            "status_note": self.status_note,
            "rows_note": self.rows_note,
            "tasks": json.dumps(to_dicts(self.tasks)),
            "overloads": json.dumps(self.overloads),
            "outside": json.dumps(self.outside),
            "readouts": json.dumps(self.readouts),
        }
        if self.engine_error is not None:
            facts["engine_error"] = self.engine_error
            facts["coarse_by"] = self.coarse_by
        return record_parts(self.machine, self.pens, self.time_s, self.rows, facts, self.firsts_s)

    def to_pandas(self) -> pd.DataFrame:
        """The record as a DataFrame indexed by time in s."""
        return self.record.to_dataframe()

    def __repr__(self) -> str:
        cycles = f"{counted(self.cycles, 'cycle')}, " if self.machine.tape.words else ""
        lines = [
            f"<Run {self.machine.patch.title!r} on {self.machine.preset!r}, seed {self.seed}: "
            f"{cycles}{counted(len(self.rows), 'row')}, {self.status}>"
        ]
        lines += [f"  {self.status_note}"] * bool(self.status_note)
        for name, quantities in self.readouts.items():
            lines.append(f"  {name}: {readout_text(quantities)}")
        late = [row for row in self.tasks if row.overruns]
        lines += [f"  task {row.task}: {counted(row.overruns, 'overrun')}" for row in late]
        lines += [f"  overload: {o['signal']} at {o['time_s']:.6g} s" for o in self.overloads]
        return "\n".join(lines)


def readout_text(quantities: Mapping[str, Any]) -> str:
    """A readout's figures in one line, each in its unit; what it does not know is left out."""
    own = str(quantities.get("units", ""))
    units = {"value": own, "amplitude": own, "offset": own, "time_s": "s"}
    units |= {"omega": "rad/s", "omega_damped": "rad/s"}
    labels = {"value": f"{asked_text(quantities)} =", "time_s": "at"}
    figures = []
    for name, figure in quantities.items():
        if figure in (None, "") or name in NO_FIGURES or name.endswith("_error"):
            continue
        if isinstance(figure, float):
            label = labels.get(name, name)
            figures.append(f"{label} {figure + 0.0:.9g} {units.get(name, '')}".strip())
        else:
            figures.append(f"{name}: {figure}")
    return ", ".join(figures)


def thinning_text(keep_every: int) -> str:
    """The same in words; '' where all are kept."""
    return f"every {_ordinal(keep_every)} row kept" if keep_every > 1 else ""


def _ordinal(number: int) -> str:
    suffix = {1: "st", 2: "nd", 3: "rd"}.get(number % 10 if number % 100 not in (11, 12, 13) else 0)
    return f"{number}{suffix or 'th'}"
