"""run(patch) -> Run: play a compiled machine to its end and read it out.

Stage 5. An interrupted or stopped run keeps what was computed and says so.
"""

from __future__ import annotations

import bisect
import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.arguments import Parameters, Source, machine_of, whole_number
from hybrid.beginnings import first_results, initial_words
from hybrid.coupling import modes
from hybrid.endings import ending, one_row_text, operations_done
from hybrid.engine.beyond import DAC_SUFFIX, Overload
from hybrid.engine.linear import Player
from hybrid.engine.ranges import outside
from hybrid.engines import check_engine, engine_of, player_of, wants_circuit
from hybrid.errors import PatchError, counted, known_as
from hybrid.growth import growth_text
from hybrid.indicators import overloads_of
from hybrid.linearity import NotLinear
from hybrid.machine import AT_SATURATION, Floats, Machine, Pen
from hybrid.naming import asked_text
from hybrid.patch import Readout
from hybrid.readout import FEWEST_ROWS_PER_CYCLE, READOUTS, figures, measure_transient
from hybrid.record import full_scales, pens_for, record_parts, signal_units
from hybrid.ripple import with_ripple
from hybrid.roundoff import roundoff_text
from hybrid.scale import row_times_s, to_seconds, to_ticks
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
    status, note = _play(player, progress, keep_every)
    played_s = time.perf_counter() - began_s
    if status == "complete":
        found = (growth_text(pens, player.record), roundoff_text(compiled))
        note = "; ".join(filter(None, (note, one_row_text(player), *found)))
    result = Run(
        compiled,
        seed,
        timeline,
        player.done_ticks,
        status,
        note,
        keep_every,
        pens,
        player.record,
        _overloads(compiled, overloads_of(player)),
        operations_done(player),
        engine=played_by,
        engine_error=player.engine_error,
        coarse_by=player.coarse_by,
        outside=tuple(found.facts() for found in outside(player)),
        played_s=played_s,
    )
    try:
        result.readouts.update(_read_out(result))
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


def _play(player: Player, progress: Progress | None, keep_every: int) -> tuple[str, str]:
    try:
        for done in player.play():
            if progress:
                progress(done)
    except KeyboardInterrupt:
        last = (len(player.record) - 1) * player.machine.timing.every * keep_every
        ends = "there" if last == player.done_ticks else f"with its row at {to_seconds(last):.6g} s"
        found = f"the record ends {ends}" if last >= 0 else "before the first row of the record"
        note = f"interrupted at {player.done_s:.6g} s; {found}"
        return "interrupted", "; ".join((note, *player.remarks()))
    return ending(player)


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


def _read_out(result: Run) -> dict[str, dict[str, Any]]:
    scope, units = result.machine.parameters, signal_units(result.machine)
    columns = {pen.name: i for i, pen in enumerate(result.pens)}
    interval_s = to_seconds(result.row_ticks)
    found: dict[str, dict[str, Any]] = {}
    for readout in result.machine.patch.readouts:
        first, last = _window(readout, scope, result)
        values = np.ascontiguousarray(result.rows[first:last, columns[readout.signal]])
        is_transient = readout.kind == "transient"
        sparse = _too_sparse(result.machine, interval_s) if is_transient else ""
        late = _too_late(readout, result)
        notes = [_overload_note(readout, result, last)]
        try:
            if late or sparse:
                raise ValueError(late or sparse)
            if is_transient:
                measured = measure_transient(values, interval_s)
                measured, note = with_ripple(measured, values, result.row_ticks, result.machine)
                quantities = figures(measured)
                notes.append(note)
            else:
                quantities = READOUTS[readout.kind](result.time_s[first:last], values)
        except ValueError as reason:
            none = ("omega", "omega_damped", "zeta") if is_transient else ()
            quantities = dict.fromkeys(none)
            quantities["reason"] = str(reason)
        about = {"kind": readout.kind, "signal": readout.signal}
        about |= {"units": units[readout.signal][0], "note": "; ".join(filter(None, notes))}
        found[readout.name] = {**quantities, **about}
    return found


def _too_late(readout: Readout, result: Run) -> str:
    """Why a readout that begins after the record's end has no rows; '' where it has."""
    start_s = readout.start.number(result.machine.parameters) if readout.start else 0.0
    last_s = result.row_s(max(len(result.rows) - 1, 0))
    if result.first_s(readout.signal) > last_s:
        return f"{readout.signal} has no result before the end of the record at {last_s:g} s"
    if not readout.start or start_s <= last_s:
        return ""
    place = f"{readout.start.place}: " if str(readout.start.place) else ""
    return (
        f"{place}{readout.start.what} is {start_s:g} s, after the end of the record at {last_s:g} s"
    )


def _too_sparse(machine: Machine, interval_s: float) -> str:
    """Why rows so far apart cannot show the patch's fastest mode; '' where they can.

    A record alone cannot tell an oscillation from its alias. Rows at every cycle always can: the
    program itself sees no more.
    """
    if machine.timing.period and interval_s <= machine.cycle_s:
        return ""
    try:
        fastest = max((m.omega_damped for m in modes(machine) if m.omega_ideal > 0), default=0.0)
    except NotLinear:
        return ""
    if fastest * interval_s * FEWEST_ROWS_PER_CYCLE <= 2.0 * np.pi:
        return ""
    return (
        f"a row every {interval_s:g} s is too sparse for the predicted mode of {fastest:.6g} rad/s: "
        "shorten every: or raise max_rows: in run:"
    )


def _window(readout: Readout, scope: Mapping[str, float], result: Run) -> tuple[int, int]:
    """First row and row after the last that a readout uses; of a word, from its first result on.

    A transient is read up to the first overload on a machine that clips: after that the loop is no
    longer the one that was patched.
    """
    # Through ticks, as the rows' times are, so that 3 * 0.1 s names the row at 0.3 s.
    start_s = to_seconds(to_ticks(readout.start.number(scope))) if readout.start else 0.0
    end_s = to_seconds(to_ticks(readout.end.number(scope))) if readout.end else np.inf
    start_s = max(start_s, result.first_s(readout.signal))
    rows = range(len(result.rows))
    first = bisect.bisect_left(rows, start_s, key=result.row_s) if start_s > 0.0 else 0
    last = bisect.bisect_right(rows, end_s, key=result.row_s) if end_s < np.inf else len(rows)
    clipped = _first_clip(readout, result)
    if clipped is not None:
        last = min(last, bisect.bisect_left(rows, clipped["time_s"], key=result.row_s))
    return first, max(last, first)


def _first_clip(readout: Readout, result: Run) -> dict[str, Any] | None:
    """The first overload, for a transient, of what clips: a converter, or an analog signal that came to
    its saturation; one below goes on as it was patched."""
    if readout.kind != "transient" or not result.overloads:
        return None
    machine = result.machine
    clips = {s.name for s in machine.samplers if s.clips}
    clips |= {h.name + DAC_SUFFIX for h in machine.holders if h.clips}
    for o in result.overloads:
        stage = machine.stages.get(o["signal"])
        level = AT_SATURATION * stage.saturation if stage else math.inf
        if o["signal"] in clips or abs(o["worst_value"]) >= level * o["full_scale"]:
            return o
    return None


def _overload_note(readout: Readout, result: Run, last: int) -> str:
    first = _first_clip(readout, result) if last < len(result.rows) else None
    if first is None:
        return ""
    return f"read up to the overload of {first['signal']} at {first['time_s']:.6g} s"
