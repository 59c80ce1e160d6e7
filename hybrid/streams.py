"""Random streams by name: one seed, one independent stream per (what, whom, ...).

Stage 0. A stream depends on the seed and its names alone, never on the order of entries or on what
else was drawn, so that run 731 of a sweep replays alone.
"""

from __future__ import annotations

import functools
import hashlib

import numpy as np


def stream(seed: int, *names: str) -> np.random.Generator:
    """Generator for `seed` (0 or greater) and a sequence of names."""
    digest = hashlib.sha256("\0".join(names).encode()).digest()
    key = tuple(np.frombuffer(digest[:16], dtype="<u4").tolist())
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=key)))


@functools.lru_cache(maxsize=65536)
def unit_error(serial: int, name: str, quantity: str) -> float:
    """A figure in [-1, 1), uniform, fixed for one component of one machine.

    A tolerance is a limit, so the errors of a batch of components fill it evenly.
    """
    return float(stream(serial, "machine", name, quantity).uniform(-1.0, 1.0))
