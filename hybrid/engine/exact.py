"""The exact engine: a linear run, watched between its instants, too.

Stage 4. What the kernel plays is kept where no signal can have gone beyond full scale unseen, which is
what mostly holds. Where one can have, the stretch is played again, and looked at interval by interval.
"""

from __future__ import annotations

import functools

import numpy as np

from hybrid.engine import kernel
from hybrid.engine.arrays import Floats, Ints, Score, State
from hybrid.engine.beyond import TIMES, Overload, with_notes
from hybrid.engine.linear import Player
from hybrid.engine.lookout import LOGGED_AT_ONCE, Lookout
from hybrid.modes import CONTINUE
from hybrid.scale import to_seconds


class ExactPlayer(Player):
    """One run of a machine whose analog side is linear."""

    near_full_scale = False  # the last stretch was: the next one will mostly be, too

    @functools.cached_property
    def lookout(self) -> Lookout:
        """What watches over the signals between the instants."""
        return Lookout(self.machine.analog)

    def overloads(self) -> tuple[Overload, ...]:
        """Every signal that went beyond its range so far, by first time, then name."""
        at_instants = {o.signal: o for o in super().overloads()}
        signals = self.machine.analog.signals
        for signal, notes in zip(signals, self.lookout.seen, strict=True):
            if signal in at_instants or notes[TIMES]:
                at_instants[signal] = with_notes(signal, at_instants.get(signal), notes)
        return tuple(sorted(at_instants.values(), key=lambda o: (o.time_s, o.signal)))

    def _play_to(self, score: Score, normals: Floats, stop_repeat: int, stop_cue: int) -> int:
        state, before = self.state, _copied(self.state)
        self.lookout.expect(tuple(map(to_seconds, self._numbers)))
        if not self.near_full_scale:
            state.most[:] = 0.0
            outcome = super()._play_to(score, normals, stop_repeat, stop_cue)
            if self.lookout.is_clear(self.plant, state):
                return outcome
            _put_back(state, before)
        state.most[:] = 0.0
        self.state = self.lookout.with_log(state)
        outcome = self._play_looking(score, normals, (stop_repeat, stop_cue))
        self.state = state
        self.near_full_scale = not self.lookout.is_clear(self.plant, state)
        return outcome

    def _play_looking(self, score: Score, normals: Floats, stop: tuple[int, int]) -> int:
        """Play a little at a time, each of which is looked at."""
        state, outcome = self.state, kernel.PAUSED
        stops = self.machine.on_overload != CONTINUE
        while outcome == kernel.PAUSED and self._next_cue < stop:
            before = _copied(state) if stops else []
            state.counts[kernel.LOGGED] = 0
            here = min(self._position(LOGGED_AT_ONCE), stop)
            outcome = super()._play_to(score, normals, *here)
            found = self.lookout.look(state, self._began_s, stops)
            if found is not None:
                _, repeat, _, cue = found.tolist()
                _put_back(state, before)
                super()._play_to(score, normals, repeat, cue)
                return kernel.OVERLOADED
        return outcome

    @property
    def _next_cue(self) -> tuple[int, int]:
        """Repeat and cue that come next in the present segment."""
        counts = self.state.counts
        return int(counts[kernel.REPEAT]), int(counts[kernel.CUE])

    def _began_s(self, logged: Ints) -> float:
        """When an interval that is logged began: its end is an instant, and it at the one before."""
        _, repeat, instant, _ = logged.tolist()
        return self._instant_s(repeat, instant - 1)


def _copied(state: State) -> list[np.ndarray]:
    return [entry.copy() for entry in state]


def _put_back(state: State, entries: list[np.ndarray]) -> None:
    """The state as it was, in the same arrays."""
    for now, before in zip(state, entries, strict=True):
        now[...] = before
