"""Van der Pol with a lag of 1 us in each of its four components, for SciPy's Radau."""

from __future__ import annotations

from functools import partial

import numba
import numpy as np
from scipy.integrate import solve_ivp

RATE, TAU_S = 1000.0, 1e-6
START = np.array([0.5, 0.5, 0.0, 0.0, 0.25, 0.0])


def slopes(t, s):
    """States: x before and after its lag, y before and after, x^2, x^2 y."""
    x, x_out, y, y_out, square, damping = s
    return np.array(
        [
            RATE * y_out,
            (x - x_out) / TAU_S,
            RATE * (y_out - x_out - damping),
            (y - y_out) / TAU_S,
            (x_out * x_out - square) / TAU_S,
            (square * y_out - damping) / TAU_S,
        ]
    )


compiled_slopes = numba.njit(slopes)


def radau(until_s: float, tolerance: float, compiled: bool = True) -> np.ndarray:
    """x and y behind their lags at until_s."""
    done = solve_ivp(
        compiled_slopes if compiled else slopes,
        (0.0, until_s),
        START,
        method="Radau",
        rtol=tolerance,
        atol=tolerance,
        t_eval=[until_s],
    )
    return done.y[[1, 3], -1]


plain_radau = partial(radau, compiled=False)
