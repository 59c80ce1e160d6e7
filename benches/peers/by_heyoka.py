"""Van der Pol without lags in heyoka, a Taylor integrator; optional, so imported when asked for."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import numpy as np

from peers.by_scipy import RATE


def installed() -> bool:
    return find_spec("heyoka") is not None


def taylor(tolerance: float) -> Callable[[float], np.ndarray]:
    """until_s -> x and y; compiled once, so that calls are runs only."""
    import heyoka

    x, y = heyoka.make_vars("x", "y")
    system = [(x, RATE * y), (y, RATE * (y - x - x * x * y))]
    integrator = heyoka.taylor_adaptive(system, [0.5, 0.0], tol=tolerance)

    def play(until_s: float) -> np.ndarray:
        integrator.time = 0.0
        integrator.state[:] = [0.5, 0.0]
        integrator.propagate_until(until_s)
        return integrator.state.copy()

    return play
