"""Corners of the reference that switch too often; what counts as that is `switching`'s.

Stage 4, for `reference`.
"""

from __future__ import annotations

import numpy as np

from hybrid.engine.arrays import Floats
from hybrid.engine.circuit import Circuit
from hybrid.engine.sweep import new_ways
from hybrid.engine.switching import chatters, closes_in, count_change, forced, watch_outside


class Chatters(RuntimeError):
    """Pieces change without end."""


class Gathers(RuntimeError):
    """Changes of a piece come at ever shorter intervals, without end within a finite time."""


class Count:
    """The changes of every corner; `changes` as in `sweep.State`, ended_by the corner that ended it."""

    def __init__(self, circuit: Circuit, changes: Floats) -> None:
        """Nothing has changed yet."""
        self.circuit, self.changes, self.ended_by = circuit, changes, -1
        self.ways = new_ways(circuit)
        self.shortest_s = float(circuit.taus_s[0]) if len(circuit.taus_s) else 0.0
        self.begin()

    def begin(self) -> None:
        """Begin an interval: what is to be chatter happens within one."""
        self.recent = np.zeros((len(self.circuit.corners), 2))

    def watch(self, signals: Floats) -> None:
        """See all signals (n,) go on by a step."""
        watch_outside(self.circuit, self.ways, signals)

    def add(self, corner: int, step: int, bound: float, swing: float, at_s: float) -> None:
        """Count a change up or down; `swing`: how far the guard went since the last that way.

        Raises Chatters and Gathers.
        """
        gathers = closes_in(self.changes, corner, step, at_s, swing, bound, self.shortest_s)
        is_forced = forced(self.circuit, self.ways, corner, step)
        count_change(self.circuit, self.changes, corner, at_s, is_forced)
        if gathers or chatters(self.circuit, self.recent, corner, at_s, is_forced):
            self.ended_by = corner
            raise Gathers if gathers else Chatters
