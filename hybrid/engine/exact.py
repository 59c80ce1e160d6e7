"""The exact engine: a linear run, watched between its instants, too.

Stage 4. What the kernel plays is kept where no signal can have gone beyond full scale unseen, which is
what mostly holds. Where one can have, the stretch is played again, and looked at interval by interval.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable

import numpy as np

from hybrid.engine import kernel
from hybrid.engine.arrays import Floats, Score, State
from hybrid.engine.beyond import TIMES, Overload, with_notes
from hybrid.engine.limited import play_limited
from hybrid.engine.linear import Player
from hybrid.engine.lookout import Lookout
from hybrid.engine.programs import play_programs
from hybrid.scale import to_seconds

LOGGER = logging.getLogger("hybrid")


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
        state = self.state
        self.lookout.expect(tuple(map(to_seconds, self._numbers)))
        if not self.near_full_scale:
            before = _copied(state)
            state.most[:] = 0.0
            outcome = super()._play_to(score, normals, stop_repeat, stop_cue)
            if self.lookout.is_clear(self.plant, state):
                return outcome
            _put_back(state, before)
        state.most[:] = 0.0
        outcome = self._look_to(score, normals, stop_repeat, stop_cue)
        self.near_full_scale = not self.lookout.is_clear(self.plant, state)
        return outcome

    def _look_to(self, score: Score, normals: Floats, stop_repeat: int, stop_cue: int) -> int:
        """Play on, with a look at every interval."""
        from hybrid.engine import looking

        play = {
            kernel.play: looking.play,
            play_programs: looking.play_programs,
            play_limited: looking.play_limited,
        }[self._compiled]
        _tell_of_compiling(play)
        given = self._given(score, normals, stop_repeat, stop_cue)
        outcome: int = play(*given, *self.lookout.begin())
        # An interval ends at an instant, and begins at the one before.
        self.lookout.end(lambda repeat, instant: self._instant_s(repeat, instant - 1))
        if outcome == kernel.OVERLOADED:
            self.lookout.stop()
        return outcome


@functools.cache
def _tell_of_compiling(play: Callable[..., int]) -> None:
    """Once, as nobody can know before a run how near to full scale it comes."""
    if not kernel.is_compiled(play):
        LOGGER.info(
            "compiling what looks between instants near full scale, once after installation ..."
        )


def _copied(state: State) -> list[np.ndarray]:
    return [entry.copy() for entry in state]


def _put_back(state: State, entries: list[np.ndarray]) -> None:
    """The state as it was, in the same arrays."""
    for now, before in zip(state, entries, strict=True):
        now[...] = before
