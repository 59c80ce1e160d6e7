"""What the readouts of a run say: each of its part of the record, with figures or a reason.

Stage 5, for `runs`.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid.coupling import modes
from hybrid.engine.beyond import DAC_SUFFIX
from hybrid.linearity import NotLinear
from hybrid.machine import AT_SATURATION, Machine
from hybrid.patch import Readout
from hybrid.played import Run
from hybrid.readout import FEWEST_ROWS_PER_CYCLE, READOUTS, figures, measure_transient
from hybrid.record import signal_units
from hybrid.ripple import with_ripple
from hybrid.scale import to_seconds, to_ticks


def read_out(result: Run) -> dict[str, dict[str, Any]]:
    """The figures of every readout of the patch by its name, as `Run.readouts` has them."""
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
