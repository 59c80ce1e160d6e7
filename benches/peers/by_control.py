"""The loop in python-control: a sampled plant, one cycle of delay, closed."""

from __future__ import annotations

import control
import numpy as np

from peers.pitch_loop import OMEGA_P, PERIOD_S, Floats, plant


def closed_loop(
    lagged: bool, omega_p: float = OMEGA_P, period_s: float = PERIOD_S
) -> control.StateSpace:
    """Discrete system whose output is theta; the last state is the held answer."""
    loop = plant(lagged)
    n = len(loop.a)
    analog = control.ss(loop.a, loop.b[:, None], np.eye(n), np.zeros((n, 1))).sample(
        period_s, "zoh"
    )
    a = np.zeros((n + 1, n + 1))
    a[:n, :n], a[:n, n:] = analog.A, analog.B
    a[n, loop.alpha] = -(omega_p**2)
    return control.ss(a, np.zeros((n + 1, 1)), np.eye(n + 1)[:1], 0.0, period_s)


def control_run(lagged: bool, cycles: int) -> Floats:
    """theta at every cycle."""
    times = np.arange(cycles + 1) * PERIOD_S
    start = np.append(plant(lagged).start, 0.0)
    return control.initial_response(closed_loop(lagged), times, start).outputs


def control_damping(omega_p: float, period_s: float) -> float:
    """Damping ratio of the pitch mode with ideal integrators."""
    omega, zeta, _ = control.damp(closed_loop(False, omega_p, period_s), doprint=False)
    return float(zeta[np.argmin(np.abs(omega - omega_p))])
