"""How fast the integrators of a machine run right after the start, with its inputs standing still.

Stage 4, for the rate test. The analog side alone is played, without noise: DACs and sources that step
stay at their first values, and where the machine has modes it is in OP.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybrid.engine.arrays import Ints
from hybrid.engine.beyond import FULL_SCALE
from hybrid.engine.propagator import propagator
from hybrid.machine import Floats, Machine
from hybrid.modes import HOLD, HOLD_MACHINE, OP, STOP_RUN, TIMED_MODE

if TYPE_CHECKING:
    from hybrid.engine.interplay import Side

# Of the reference, in each step: signals at the ends of intervals are then known as those of windows.
TOLERANCE = 1e-13


@dataclass(frozen=True, slots=True)
class Start:
    """Mean rates of every signal over equal intervals, (intervals, signals), machine units a second.

    why_not: by integrator, why its rate tells nothing; switched: whether a part has changed its piece.
    """

    rates_mu: Floats
    why_not: dict[str, str]
    switched: bool


def first_rates(
    machine: Machine, wait_s: float, step_s: float, steps: int, plainly: bool = False
) -> Start:
    """Play the machine for `wait_s`, in which layers of lags die out, and then `steps` of `step_s`.

    plainly: by the reference, which need not be compiled, where windows would be played.
    """
    if machine.elements:
        play = _by_reference if plainly else _of_circuit
        return play(machine, wait_s, step_s, steps)
    analog = machine.analog
    u, x = analog.u0, analog.x0

    def after(x: Floats, duration_s: float) -> Floats:
        later: Floats = x + propagator(analog, duration_s).change @ np.concatenate([x, u])
        return later

    x = after(x, wait_s) if wait_s > 0.0 else x
    shown = [analog.c @ np.concatenate([x, u])]
    for _ in range(steps):
        x = after(x, step_s)
        shown.append(analog.c @ np.concatenate([x, u]))
    return Start(np.diff(np.array(shown), axis=0) / step_s, {}, False)


def _of_circuit(machine: Machine, wait_s: float, step_s: float, steps: int) -> Start:
    """The same of a machine that is played by elements."""
    from hybrid.engine import interplay, sweep, windows  # take long to load
    from hybrid.engine.nodes import RESOLUTION
    from hybrid.engine.relaxation import DONE, advance

    side, names = windows.side_of(machine)
    circuit, state, held = side.circuit, side.state, _held(machine, side.held)
    interplay.settle_loops(side, held)
    switched, shown, now_s = False, [], 0.0
    for duration_s in (wait_s, *[step_s] * steps):
        why, _ = advance(
            circuit,
            state,
            side.shelf,
            side.grid,
            now_s,
            duration_s,
            RESOLUTION,
            side.log,
            side.no_pen,
            None,
        )
        now_s += duration_s
        # What ends the run by itself, such as an overload, shows no more rates than a switch does.
        switched |= int(state.counts[sweep.EVENTS]) > 0 or why != DONE
        shown.append(state.start[side.place])
    modes = state.memory[:, sweep.AS].astype(np.int64)
    why_not = _why_not(machine, side, names, modes.tolist(), state.piece.tolist())
    return Start(np.diff(np.array(shown), axis=0) / step_s, why_not, switched)


def _by_reference(machine: Machine, wait_s: float, step_s: float, steps: int) -> Start:
    """The same by SciPy."""
    from hybrid.engine import windows
    from hybrid.engine.forward import NotResolved
    from hybrid.engine.reference import Reference, RunsAway, method_for
    from hybrid.engine.too_often import Chatters

    side, names = windows.side_of(machine)
    watched = side.state.watched > 0
    held = _held(machine, side.held)
    beyond = False

    def look(t_s: float, signals: Floats) -> None:
        nonlocal beyond
        beyond |= bool(np.any(np.abs(signals[watched]) > FULL_SCALE))

    method = method_for(side.circuit, wait_s + steps * step_s)
    with np.errstate(all="ignore"):
        played = Reference(side.circuit, held, TOLERANCE, TOLERANCE / 100, method)
        values, played.look = played.values(), look
        switched, shown = False, []
        for duration_s in (wait_s, *[step_s] * steps):
            if duration_s > 0.0 and not switched:
                try:
                    played.play(duration_s)
                    values = played.values()
                except (Chatters, NotResolved, RunsAway):
                    switched = True
            shown.append(values.signal[side.place])
    held_back = beyond and machine.on_overload == HOLD_MACHINE
    modes = [HOLD] * len(values.mode) if held_back else values.mode
    why_not = _why_not(machine, side, names, modes, played.piece)
    switched |= len(played.events) > 0 or (beyond and machine.on_overload == STOP_RUN)
    return Start(np.diff(np.array(shown), axis=0) / step_s, why_not, switched)


def _held(machine: Machine, places: Ints) -> Floats:
    """What the circuit's inputs hold at first, the machine's mode being OP."""
    held = machine.analog.u0[places]
    for i, which in enumerate(places.tolist()):
        if machine.analog.inputs[which] == TIMED_MODE:
            held[i] = float(OP)
    return held


def _why_not(
    machine: Machine, side: Side, names: tuple[str, ...], modes: list[int], pieces: list[int]
) -> dict[str, str]:
    """By integrator, why its rate tells nothing; modes and pieces as they are in the end."""
    from hybrid.engine.circuit import CORNER

    found: dict[str, str] = {}
    integrators = {c.name for c in machine.patch.components if c.kind == "integrate"}
    for name, e in zip(machine.analog.signals, side.place.tolist(), strict=True):
        corner = int(side.circuit.rows[e, CORNER])
        if name not in integrators:
            continue
        if names[e] == name and modes[e] != OP:
            found[name] = "in IC or HOLD"
        elif corner >= 0 and pieces[corner] != 1:
            found[name] = "at its limit"
    return found
