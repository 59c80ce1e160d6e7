"""run(patch) -> Run: play a compiled machine to its end and read it out.

Stage 5. An interrupted or stopped run keeps what was computed and says so.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hybrid.arguments import Parameters, Source, machine_of, whole_number
from hybrid.beginnings import first_results, initial_words
from hybrid.endings import ending, one_row_text, operations_done
from hybrid.engine.beyond import DAC_SUFFIX, Overload
from hybrid.engine.linear import Player
from hybrid.engine.ranges import outside
from hybrid.engines import check_engine, engine_of, player_of, wants_circuit
from hybrid.errors import PatchError, counted, known_as
from hybrid.growth import growth_text
from hybrid.indicators import overloads_of
from hybrid.machine import Floats, Machine, Pen
from hybrid.naming import asked_text
from hybrid.read_out import read_out
from hybrid.record import full_scales, pens_for, record_parts, signal_units
from hybrid.roundoff import roundoff_text
from hybrid.scale import row_times_s, to_seconds
from hybrid.storage import Parts
from hybrid.timeline import Timeline, build_timeline
from hybrid.workload import TaskRow, ended_cycles, task_rows, to_dicts

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Progress = Callable[[float], None]

LARGEST_SEED = 2**63 - 1
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


def run(
    patch: Source | Machine,
    parameters: Parameters | None = None,
    *,
    machine: str | None = None,
    seed: int = 0,
    serial: int | None = None,
    until: float | str | None = None,
    progress: Progress | None = None,
    readouts_only: bool = False,
    engine: str = "auto",
) -> Run:
    """Run a patch from t = 0 to its end.

    Args: patch: a patch, the file or shipped name of one, or a compiled machine; parameters: SI
    numbers or texts with units ('2 ms'); machine: preset name; seed for the noise; serial: which
    machine of the make; until: end of the run in place of the patch's, in s or '20 s'; progress: called
    with the fraction done; readouts_only: record only what the readouts need; engine: `exact`,
    `nonlinear`, `reference` (SciPy, slow) or `auto`, see `engines`. Returns a Run: its `record` is over
    time in s, (rows,) a signal in the signal's units, its `readouts` are dicts by name. A
    KeyboardInterrupt ends the run early and returns what was played. Raises PatchError and RunError for
    the mistakes of the user.
    """
    seed = check_seed(seed)
    circuit = wants_circuit(check_engine(engine))
    compiled = machine_of(patch, parameters, machine, serial, circuit, until)
    played_by = engine_of(compiled, engine)
    check_windows(compiled)
    timeline = build_timeline(compiled, seed)
    keep_every = thinning(compiled, timeline.rows)
    pens = pens_for(compiled, readouts_only)
    player = player_of(compiled, engine)(compiled, timeline, pens, seed, keep_every)
    player.state.words[:] = initial_words(compiled)
    began_s = time.perf_counter()
    interrupted = _play(player, progress)
    return finished(player, pens, played_by, time.perf_counter() - began_s, interrupted)


def finished(
    player: Player, pens: tuple[Pen, ...], engine: str, played_s: float, interrupted: str = ""
) -> Run:
    """What a player has played, read out; `interrupted`: what is to be said of a run that was."""
    compiled = player.machine
    status, note = ("interrupted", interrupted) if interrupted else ending(player)
    if status == "complete":
        found = (growth_text(pens, player.record), roundoff_text(compiled))
        note = "; ".join(filter(None, (note, one_row_text(player), *found)))
    result = Run(
        compiled,
        player.seed,
        player.timeline,
        player.done_ticks,
        status,
        note,
        player.keep_every,
        pens,
        player.record,
        _overloads(compiled, overloads_of(player)),
        operations_done(player),
        engine=engine,
        engine_error=player.engine_error,
        coarse_by=player.coarse_by,
        outside=tuple(found.facts() for found in outside(player)),
        played_s=played_s,
    )
    try:
        result.readouts.update(read_out(result))
    except KeyboardInterrupt:
        note = (
            "interrupted while the readouts were measured; the record goes on to where the run did"
        )
        return replace(result, status="interrupted", status_note=note)
    return result


def thinning(machine: Machine, rows: int) -> int:
    """Every how many of the rows one is kept, so that they are no more than max_rows."""
    return -(-rows // machine.patch.run.max_rows)


def thinning_text(keep_every: int) -> str:
    """The same in words; '' where all are kept."""
    return f"every {_ordinal(keep_every)} row kept" if keep_every > 1 else ""


def check_seed(seed: int) -> int:
    """The seed as an int; raises RunError for one that is none."""
    return whole_number("seed", seed, 0, LARGEST_SEED)


def check_run(machine: Machine, seed: int) -> None:
    """Raise PatchError or RunError for whatever would stop the run before it begins."""
    check_seed(seed)
    check_windows(machine)
    build_timeline(machine)


def check_windows(machine: Machine) -> None:
    """Raise PatchError for a readout that these parameters make end before it begins."""
    scope = machine.parameters
    for readout in machine.patch.readouts:
        if readout.start and readout.end:
            start_s, end_s = readout.start.number(scope), readout.end.number(scope)
            if start_s >= end_s:
                raise PatchError(
                    f"{readout.start.what} is {start_s:g} s, not before its until, {end_s:g} s",
                    readout.start.place,
                )


def _play(player: Player, progress: Progress | None) -> str:
    """Play to the end; what is to be said where that was interrupted, else ''."""
    try:
        for done in player.play():
            if progress:
                progress(done)
    except KeyboardInterrupt:
        last = (len(player.record) - 1) * player.machine.timing.every * player.keep_every
        ends = "there" if last == player.done_ticks else f"with its row at {to_seconds(last):.6g} s"
        found = f"the record ends {ends}" if last >= 0 else "before the first row of the record"
        note = f"interrupted at {player.done_s:.6g} s; {found}"
        return "; ".join((note, *player.remarks()))
    return ""


def _ordinal(number: int) -> str:
    suffix = {1: "st", 2: "nd", 3: "rd"}.get(number % 10 if number % 100 not in (11, 12, 13) else 0)
    return f"{number}{suffix or 'th'}"


def _overloads(machine: Machine, found: tuple[Overload, ...]) -> tuple[dict[str, Any], ...]:
    """In problem units: first time beyond range, worst value with its time, instants beyond."""
    units, scales = signal_units(machine), full_scales(machine)
    to_problem = {
        s.name: s.to_si / units[s.name][1] for s in machine.samplers
    }  # an ADC's value is in machine units of the signal it samples
    entries = []
    for o in found:
        name = o.signal.removesuffix(DAC_SUFFIX)
        scale = to_problem.get(name, scales[name])
        entries.append(
            {
                "signal": known_as(o.signal),
                "time_s": o.time_s,
                "value": o.value_mu * scale,
                "worst_value": o.worst_mu * scale,
                "worst_time_s": o.worst_time_s,
                "instants": o.instants,
                "duration_s": o.duration_s,
                "units": units[name][0],
                "full_scale": scales[name],
            }
        )
    return tuple(entries)
