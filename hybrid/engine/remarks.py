"""What is wrong with a circuit that its signals alone do not tell: parts that chatter, or have no value.

Stage 4.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from hybrid.elements import QUOTIENT
from hybrid.engine.arrays import Floats
from hybrid.engine.blur import Blur
from hybrid.engine.circuit import (
    AT,
    C0,
    C1,
    C2,
    END,
    FIRST,
    GAIN,
    HIGH,
    KIND,
    LOW,
    OF_ANGLE,
    OF_INTEGRATOR,
    OF_OUTPUT,
    OF_SUM,
    OWNER,
    ROLE,
    Circuit,
)
from hybrid.engine.sweep import ENDED_BY, FROM_S, MOST, SHRUNK, TURNED_S, TURNS, State
from hybrid.engine.switching import drives_itself, jumps
from hybrid.errors import PatchError
from hybrid.machine import Machine

GIVE = "give it hysteresis"
NO_HYSTERESIS = "it has no hysteresis, so give the loop less gain"
# Parts whose averages are blurred for less of a run are not told of.
LEAST_BLURRED = 0.05


def chattering(circuit: Circuit, names: Sequence[str], changes: Floats) -> tuple[str, ...]:
    """Each part that jumped to and fro as fast as its lag lets it, and by what it does itself, in words;
    `changes`: of a State."""
    found = []
    for corner in np.flatnonzero(changes[:, MOST]).tolist():
        if not drives_itself(circuit, corner):
            continue
        name, _, _ = names[circuit.corners[corner, OWNER]].partition(":")
        found.append(
            f"{name} chatters from {changes[corner, FROM_S]:.6g} s on, {changes[corner, MOST]:.0f} "
            f"changes as fast as the lags allow: {_cure(circuit, names, corner)}"
        )
    return tuple(found)


def held_back(
    machine: Machine,
    circuit: Circuit,
    names: Sequence[str],
    state: State,
    lit: Collection[int],
) -> tuple[str, ...]:
    """Each output that stopped at its saturation without being beyond full scale, which no indicator
    tells, in words. Limits that the patch gives an integrator are not meant. `lit`: elements that were
    beyond full scale."""
    elements, found = dict(machine.elements), []
    for corner, (e, role, first, *_) in enumerate(circuit.corners.tolist()):
        by_limits = role == OF_INTEGRATOR and elements[names[e]].limits is not None
        if role in (OF_SUM, OF_ANGLE) or by_limits or e in lit:
            continue
        left = np.isfinite(state.changes[corner, [TURNED_S, TURNED_S + TURNS]])
        if state.piece[corner] != 1 or left.any():
            name, _, _ = names[e].partition(":")
            level = float(np.max(np.abs(circuit.pieces[first + 1, [LOW, HIGH]])))
            found.append(f"{name} was held back by its saturation, {level:.4g} of full scale")
    return tuple(found)


def over_corners(
    circuit: Circuit, names: Sequence[str], blur: Blur, played_s: float
) -> tuple[str, ...]:
    """Each part whose averages noise has blurred over its corners for long, and how much, in words."""
    found = []
    for corner, (e, role, *_) in enumerate(circuit.corners.tolist()):
        share = float(blur.blurred_s[corner]) / played_s if played_s > 0.0 else 0.0
        if share < LEAST_BLURRED:
            continue
        name, _, _ = names[e].partition(":")
        rms, rest = blur.deviation[corner], left_out(circuit, corner, float(blur.deviation[corner]))
        over = f"the {'saturation' if role == OF_OUTPUT else 'corners'} of {name}"
        found.append(
            f"noise of rms {rms:.2g} reached over {over} for {share:.0%} of the run: between instants "
            "its mean and gain in that noise stand for it, without the rest, of rms "
            f"{rest:.2g} of full scale"
        )
    return tuple(found)


def left_out(circuit: Circuit, corner: int, s: float) -> float:
    """What the mean and the gain in noise of deviation s at its guard leave out of a part: its rms.

    At the corner where that is most; E f^2 - (E f)^2 - (E f n)^2, by sums over a normal distribution.
    """
    e, role, first, end, _ = circuit.corners[corner].tolist()
    pieces, n = circuit.pieces[first:end], np.linspace(-5.0, 5.0, 401)
    weights, most = np.exp(-0.5 * n * n) / np.sum(np.exp(-0.5 * n * n)), 0.0
    for bound in pieces[1:, LOW]:
        g = bound + s * n
        p = pieces[np.searchsorted(pieces[:-1, HIGH], g)]
        x = g - p[:, AT]
        y = (p[:, C2] * x + p[:, C1]) * x + p[:, C0]
        mean, gain = weights @ y, weights @ (y * n)
        most = max(most, float(weights @ (y - mean - gain * n) ** 2))
    factor = abs(circuit.figures[e, GAIN]) if role == OF_SUM else 1.0
    return float(factor * np.sqrt(most))


def error_of_averages(circuit: Circuit, blur: Blur, played_s: float) -> float:
    """What that makes of an average over the run, of full scale: the rms, all parts together."""
    square = 0.0
    for corner in np.flatnonzero(blur.blurred_s > 0.0).tolist():
        rest = left_out(circuit, corner, float(blur.deviation[corner]))
        square += rest * rest * 2.0 * float(blur.blurred_s[corner] / blur.rate[corner])
    return float(np.sqrt(square)) / played_s if square > 0.0 else 0.0


def ended_by(circuit: Circuit, names: Sequence[str], state: State, gathered: bool) -> str:
    """What the part did that ended the run by how it switches; '' where none did. gathered: its changes
    add up to a finite time, else it chatters."""
    corner = int(state.counts[ENDED_BY])
    if corner < 0:
        return ""
    name, _, _ = names[circuit.corners[corner, OWNER]].partition(":")
    ways = state.changes[corner, TURNED_S:].reshape(-1, TURNS).tolist()
    turned_s, span_s, ratio, *_ = max(ways, key=lambda way: way[SHRUNK - TURNED_S])
    if not gathered:
        give = "" if _compares(circuit, names, corner) else "give "
        return f"{name} chatters: {_cure(circuit, names, corner)}, or {give}what it drives a lag"
    ends_s = turned_s + span_s * ratio / (1.0 - ratio)
    return (
        f"{name} switches either way at ever shorter intervals, each {ratio:.6g} of the one before, so "
        f"without end by {ends_s:.9g} s; nothing says what is after that: "
        + (GIVE + ", or parts a lag" if _compares(circuit, names, corner) else "give parts a lag")
    )


def _compares(circuit: Circuit, names: Sequence[str], corner: int) -> bool:
    """Whether it is a comparator, which may have hysteresis; other parts have comparators inside."""
    own = ":" not in names[circuit.corners[corner, OWNER]]
    return own and circuit.corners[corner, ROLE] == OF_SUM and bool(jumps(circuit, corner))


def _cure(circuit: Circuit, names: Sequence[str], corner: int) -> str:
    """What would keep a part from chattering, in words."""
    if circuit.corners[corner, ROLE] == OF_ANGLE:
        return (
            "its angle jumps at half a turn, where the loop holds it; invert both its inputs, which "
            "makes that angle 0"
        )
    return GIVE if _compares(circuit, names, corner) else NO_HYSTERESIS


def refuse_undefined(
    machine: Machine, circuit: Circuit, names: Sequence[str], start: Floats
) -> None:
    """Raise PatchError where a part has no finite value at t = 0; `start`: of a State."""
    without = np.flatnonzero(~np.isfinite(start)).tolist()
    if not without:
        return

    def first_of_all(e: int) -> bool:
        read = circuit.signal[circuit.rows[e, FIRST] : circuit.rows[e, END]].astype(np.int64)
        return bool(np.all(np.isfinite(start[read])))

    divides = [e for e in without if circuit.rows[e, KIND] == QUOTIENT]
    cause = next((e for e in without if first_of_all(e)), (divides or without)[0])
    name, _, _ = names[cause].partition(":")
    why = "its divisor is 0 there" if cause in divides else "its inputs are too large for it"
    raise PatchError(
        f"component {name!r} has no finite value at t = 0: {why}; change what it reads at the start",
        next(
            (p.place for p in machine.patch.analog_parts if p.name == name),
            machine.patch.run.until.place,
        ),
    )
