"""Which stretches of a linear run must be looked at between their instants, and what is seen there.

Stage 4. The kernel sees signals at instants. From the largest value and the largest change over an
interval that it meets follows how far signals can have gone in between (`ladder`): mostly not beyond
full scale, and then that is all. Where they can have, the stretch is played again, and each interval is
looked at (`between`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from hybrid.engine.arrays import Ints, Plant, State
from hybrid.engine.beyond import FIRST_S, FULL_SCALE, TIMES, WORST_S
from hybrid.engine.kernel import LOGGED
from hybrid.engine.ladder import MOST_RUNGS, chord_bounds, ladder_of, rungs_for, shortest_s
from hybrid.engine.propagator import Propagator, propagators
from hybrid.machine import Analog

if TYPE_CHECKING:
    from hybrid.engine.between import Rungs  # compiled where it is needed

# Advances that are logged before they are looked at: they stay in the cache.
LOGGED_AT_ONCE = 4096
# Noise goes this many of its deviations away within an interval at most: once in 5e8.
DEVIATIONS = 6.0


class Lookout:
    """Watches over the signals of one linear run between its instants."""

    def __init__(self, analog: Analog) -> None:
        self.analog = analog
        self.seen = np.zeros((len(analog.signals), 6))  # as `sweep.State.overload`
        self.intervals_s: tuple[float, ...] = ()

    def expect(self, intervals_s: tuple[float, ...]) -> None:
        """Get ready for these intervals between instants, in the order of their numbers."""
        if intervals_s == self.intervals_s:
            return
        self.intervals_s = intervals_s
        lengths_s, longest_s = np.array(intervals_s), max(intervals_s)
        self.ladder = None
        rungs = rungs_for(self.analog, longest_s)
        if rungs > MOST_RUNGS:
            return
        self.ladder = ladder_of(self.analog, shortest_s(self.analog, longest_s), rungs)
        self.of_rates, of_changes = chord_bounds(self.analog, self.ladder, lengths_s)
        self.spread = np.zeros(len(self.analog.a))
        for p in self._propagators():
            self.spread = np.maximum(self.spread, np.sqrt(np.sum(p.spread**2, axis=1)))
        self.of_changes = np.max(of_changes, axis=0)

    def is_clear(self, plant: Plant, state: State) -> bool:
        """Whether no signal can have been beyond full scale since `state.most` was cleared."""
        if self.ladder is None:
            return True  # it runs away within an interval, and the run ends
        n = len(self.analog.a)
        at = plant.signal
        values = np.maximum(state.most[0, at], np.abs(state.v[at]))
        values = np.where(plant.kept[at] > 0.0, values, np.maximum(values, state.most[1, at]))
        changes = state.most[1, state.most.shape[1] - n :] + DEVIATIONS * self.spread
        with np.errstate(over="ignore", invalid="ignore"):
            return bool(np.all(values + self.of_changes @ changes <= FULL_SCALE))

    def look(self, state: State, began_s: Callable[[Ints], float], stops: bool) -> Ints | None:
        """Look at what is logged; the interval in which a signal went beyond, if that stops the run.

        began_s: when an interval began that was logged as this.
        """
        from hybrid.engine.between import desk_for, look

        count = state.counts[LOGGED]
        log, logged = state.log[:count], state.logged[:count]
        rows = np.full((len(self.seen), 2), -1)
        before = float(np.sum(self.seen[:, TIMES]))
        done = look(self._rungs(), desk_for(self.analog), log, logged, self.seen, rows, stops)
        for column, since in ((0, FIRST_S), (1, WORST_S)):
            for s in np.flatnonzero(rows[:, column] >= 0).tolist():
                self.seen[s, since] += began_s(logged[rows[s, column]])
        found = float(np.sum(self.seen[:, TIMES])) > before
        return logged[done - 1].copy() if stops and found else None

    def with_log(self, state: State) -> State:
        """The same state, of which the kernel logs where intervals begin."""
        log = np.zeros((LOGGED_AT_ONCE, state.log.shape[1]))
        return state._replace(log=log, logged=np.zeros((LOGGED_AT_ONCE, 4), dtype=np.int64))

    def _propagators(self) -> list[Propagator]:
        return propagators([(self.analog, h) for h in self.intervals_s])

    def _rungs(self) -> Rungs:
        from hybrid.engine.between import Rungs

        analog, ladder = self.analog, self.ladder
        assert ladder is not None
        return Rungs(
            np.ascontiguousarray(analog.a),
            np.hstack([analog.a, analog.b]),
            np.ascontiguousarray(analog.c),
            ladder.rate,
            ladder.shortest_s,
            ladder.change,
            ladder.apart,
            np.array(self.intervals_s),
            np.array([p.change for p in self._propagators()]),
            self.of_rates,
        )
