"""Comparators that start tasks of the digital machine: which ways of switching do, and which happened.

Stage 4, for the players of circuits.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from hybrid.engine.arrays import Floats, Ints
from hybrid.engine.sweep import CALLED, FALLS, HAPPENED, RISES, WANTED, State
from hybrid.engine.switching import CHATTER_EVENTS, CHATTER_LAGS, CHATTER_S
from hybrid.machine import Machine
from hybrid.scale import to_ticks

# The ways a comparator switches, as a patch names them.
EDGES = {"rises": RISES, "falls": FALLS, "changes": RISES | FALLS}


class Calls:
    """The tasks that comparators start, with the element of each comparator."""

    def __init__(self, machine: Machine, place: Ints) -> None:
        """Args: place: element of each signal."""
        signals = machine.analog.signals
        self.starts = [
            (number, int(place[signals.index(task.when[0])]), EDGES[task.when[1]])
            for number, task in enumerate(machine.timing.tasks)
            if task.when
        ]
        self._recent: deque[int] = deque()  # when they were called last, in ticks

    def listen(self, state: State) -> None:
        """From now on: how comparators stand at t = 0 is no switching."""
        for _, element, edges in self.starts:
            state.calls[element, WANTED] |= edges

    @property
    def pieces(self) -> frozenset[tuple[int, int]]:
        """Element and new piece of every switching that starts a task."""
        rises = [(element, 1) for _, element, edges in self.starts if edges & RISES]
        return frozenset(rises + [(e, 0) for _, e, edges in self.starts if edges & FALLS])

    def note(self, state: State, element: int, piece: int) -> None:
        """A comparator has switched that starts tasks."""
        state.calls[element, HAPPENED] |= RISES if piece else FALLS
        state.counts[CALLED] = 1

    def take(self, state: State) -> list[int]:
        """The tasks that are to start now, by number; what happened is done with."""
        happened = state.calls[:, HAPPENED]
        called = [number for number, element, edges in self.starts if happened[element] & edges]
        state.calls[:, HAPPENED] = 0
        state.counts[CALLED] = 0
        return called

    def chatter(self, at: int, taus_s: Floats) -> bool:
        """Whether they have switched, the last time at the tick `at`, too often without getting on."""
        self._recent.append(at)
        if len(self._recent) <= CHATTER_EVENTS:
            return False
        shortest_s = float(np.min(taus_s, initial=np.inf)) if len(taus_s) else 0.0
        return at - self._recent.popleft() <= to_ticks(max(CHATTER_S, CHATTER_LAGS * shortest_s))
