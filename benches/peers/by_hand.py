"""Compiled loops over fixed sizes, as one would write them by hand for this one loop."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numba
import numpy as np

from peers.pitch_loop import OMEGA_P, PERIOD_S, STEP, Floats, noise_spread, plant, propagator

compiled = numba.njit(nogil=True, fastmath={"contract"})


@compiled
def loop_ideal(cycles, phi, gamma, start, gain):
    """Two integrators; theta at every cycle."""
    theta, rate, held, record = start[0], start[1], 0.0, np.empty(cycles + 1)
    record[0] = theta
    for k in range(cycles):
        answer = gain * theta
        theta, rate = (
            phi[0, 0] * theta + phi[0, 1] * rate + gamma[0] * held,
            phi[1, 0] * theta + phi[1, 1] * rate + gamma[1] * held,
        )
        held = answer
        record[k + 1] = theta
    return record


@compiled
def loop_lags(cycles, phi, gamma, start, gain):
    """Seven states; theta at every cycle."""
    x, y, held, record = start.copy(), np.empty(7), 0.0, np.empty(cycles + 1)
    record[0] = x[0]
    for k in range(cycles):
        answer = gain * x[6]
        for i in range(7):
            total = gamma[i] * held
            for j in range(7):
                total += phi[i, j] * x[j]
            y[i] = total
        x, y = y, x
        held = answer
        record[k + 1] = x[0]
    return record


@compiled
def convert(value, step):
    """A converter: clip to full scale, round to whole steps."""
    return np.rint(min(max(value, -1.0), 1.0) / step) * step


@compiled
def loop_nominal(cycles, phi, gamma, start, gain, spread, step, rng):
    """Seven states, converters that round and clip, seven normal draws a cycle."""
    x, y, held, record = start.copy(), np.empty(7), 0.0, np.empty(cycles + 1)
    draws = np.empty(7)
    record[0] = x[0]
    for k in range(cycles):
        answer = convert(gain * convert(x[6], step), step)
        for j in range(7):
            draws[j] = rng.standard_normal()
        for i in range(7):
            total = gamma[i] * held
            for j in range(7):
                total += phi[i, j] * x[j] + spread[i, j] * draws[j]
            y[i] = total
        x, y = y, x
        held = answer
        record[k + 1] = x[0]
    return record


def hand_loop(
    case: str, omega_p: float = OMEGA_P, period_s: float = PERIOD_S
) -> Callable[[int], Floats]:
    """cycles -> theta at every cycle, for 'ideal', 'lags', 'nominal' or its 'quiet' twin.

    'quiet' is the nominal loop without noise.
    """
    loop = plant(case != "ideal")
    phi, gamma = propagator(loop, period_s)
    common = (phi, gamma, loop.start, -(omega_p**2))
    if case in ("ideal", "lags"):
        return partial(_call, loop_ideal if case == "ideal" else loop_lags, common)
    spread = noise_spread(loop, period_s)
    if case == "quiet":
        spread = np.zeros_like(spread)
    return partial(_call, loop_nominal, (*common, spread, STEP, np.random.default_rng(1)))


def _call(loop, arguments, cycles: int) -> Floats:
    return loop(cycles, *arguments)
