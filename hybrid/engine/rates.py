"""How fast the integrators of a machine run right after the start, with its inputs standing still.

Stage 4, for the rate test. The analog side alone is played, without noise: DACs and sources that step
stay at their first values, and where the machine has modes it is in OP.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid.engine.propagator import propagator
from hybrid.machine import Floats, Machine
from hybrid.modes import OP, TIMED_MODE


@dataclass(frozen=True, slots=True)
class Start:
    """Mean rates of every signal over equal intervals, (intervals, signals), machine units a second.

    why_not: by integrator, why its rate tells nothing; switched: whether a part has changed its piece.
    """

    rates_mu: Floats
    why_not: dict[str, str]
    switched: bool


def first_rates(machine: Machine, wait_s: float, step_s: float, steps: int) -> Start:
    """Play the machine for `wait_s`, in which layers of lags die out, and then `steps` of `step_s`."""
    if machine.elements:
        return _of_circuit(machine, wait_s, step_s, steps)
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
    from hybrid.engine.circuit import CORNER
    from hybrid.engine.nodes import RESOLUTION
    from hybrid.engine.relaxation import DONE, advance

    side, names = windows.side_of(machine)
    circuit, state = side.circuit, side.state
    held = machine.analog.u0[side.held]
    for i, which in enumerate(side.held.tolist()):
        if machine.analog.inputs[which] == TIMED_MODE:
            held[i] = float(OP)
    interplay.settle_loops(side, held)
    switched, shown, now_s = False, [], 0.0
    why_not: dict[str, str] = {}
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
    integrators = {c.name for c in machine.patch.components if c.kind == "integrate"}
    for name, e in zip(machine.analog.signals, side.place.tolist(), strict=True):
        corner = int(circuit.rows[e, CORNER])
        if name not in integrators:
            continue
        if names[e] == name and state.memory[e, sweep.AS] != OP:
            why_not[name] = "in IC or HOLD"
        elif corner >= 0 and state.piece[corner] != 1:
            why_not[name] = "at its limit"
    return Start(np.diff(np.array(shown), axis=0) / step_s, why_not, switched)
