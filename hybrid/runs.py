"""run(patch) -> Run: play a compiled machine to its end and read it out.

Stage 5. An interrupted or stopped run keeps what was computed and says so.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hybrid.arguments import Parameters, Source, check_progress, machine_of, whole_number
from hybrid.beginnings import initial_words
from hybrid.endings import ending, one_row_text, operations_done
from hybrid.engine.beyond import DAC_SUFFIX, Overload
from hybrid.engine.linear import Player
from hybrid.engine.ranges import outside
from hybrid.engines import check_engine, engine_of, player_of, wants_circuit
from hybrid.errors import PatchError, known_as
from hybrid.growth import growth_text
from hybrid.indicators import overloads_of
from hybrid.machine import Machine, Pen
from hybrid.one_thread import one_thread
from hybrid.played import Run
from hybrid.read_out import read_out
from hybrid.record import full_scales, pens_for, signal_units
from hybrid.roundoff import roundoff_text
from hybrid.scale import to_seconds
from hybrid.timeline import build_timeline

Progress = Callable[[float], None]

LARGEST_SEED = 2**63 - 1


@one_thread
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
    check_progress(progress)
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
