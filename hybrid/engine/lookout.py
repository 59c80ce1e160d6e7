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

from hybrid.engine.arrays import Floats, Ints, Plant, State
from hybrid.engine.beyond import (
    BEYOND_S,
    FIRST_S,
    FIRST_VALUE,
    FULL_SCALE,
    TIMES,
    WORST_S,
    WORST_VALUE,
)
from hybrid.engine.ladder import (
    MOST_RUNGS,
    bounds_of_changes,
    bounds_of_rates,
    ladder_of,
    rungs_for,
    shortest_s,
)
from hybrid.engine.propagator import Propagator, propagators
from hybrid.machine import Analog

if TYPE_CHECKING:
    from hybrid.engine.between import Desk, Rungs  # compiled where it is needed

# Noise goes this many of its deviations away within an interval at most: once in 5e8.
DEVIATIONS = 6.0


class Lookout:
    """Watches over the signals of one linear run between its instants."""

    def __init__(self, analog: Analog) -> None:
        self.analog = analog
        self.seen = np.zeros((len(analog.signals), 6))  # as `sweep.State.overload`
        self.intervals_s: tuple[float, ...] = ()
        self.rungs: Rungs | None = None  # for these intervals, where one has been looked at

    def expect(self, intervals_s: tuple[float, ...]) -> None:
        """Get ready for these intervals between instants, in the order of their numbers."""
        if intervals_s == self.intervals_s:
            return
        self.intervals_s = intervals_s
        longest_s = max(intervals_s)
        self.ladder, self.rungs = None, None
        rungs = rungs_for(self.analog, longest_s)
        if rungs > MOST_RUNGS:
            return
        self.ladder = ladder_of(self.analog, shortest_s(self.analog, longest_s), rungs)
        of_changes = bounds_of_changes(self.analog, self.ladder, np.array(intervals_s))
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

    def begin(self) -> tuple[Rungs, Desk, Floats, Ints]:
        """What `looking` needs."""
        from hybrid.engine.between import desk_for

        self.at = np.full((len(self.seen), 4), -1)
        if self.rungs is None:
            self.rungs = self._rungs()
        return self.rungs, desk_for(self.analog), self.seen, self.at

    def end(self, began_s: Callable[[int, int], float]) -> None:
        """What has been seen since is told by the run's time; began_s: of an interval, by its end."""
        for columns, since in (((0, 1), FIRST_S), ((2, 3), WORST_S)):
            for s in np.flatnonzero(self.at[:, columns[0]] >= 0).tolist():
                self.seen[s, since] += began_s(*self.at[s, list(columns)].tolist())

    def stop(self) -> None:
        """The run ends where the first signal passes full scale: what comes later never was."""
        seen = self.seen
        first_s = np.min(seen[seen[:, TIMES] > 0.0, FIRST_S], initial=np.inf)
        seen[seen[:, FIRST_S] > first_s] = 0.0
        seen[:, [WORST_S, WORST_VALUE]] = seen[:, [FIRST_S, FIRST_VALUE]]
        seen[:, BEYOND_S] = 0.0

    def _propagators(self) -> list[Propagator]:
        return propagators([(self.analog, h) for h in self.intervals_s])

    def _rungs(self) -> Rungs:
        from hybrid.engine.between import Rungs

        analog, ladder, lengths_s = self.analog, self.ladder, np.array(self.intervals_s)
        assert ladder is not None
        return Rungs(
            np.ascontiguousarray(analog.a),
            np.hstack([analog.a, analog.b]),
            np.ascontiguousarray(analog.c),
            ladder.rate,
            ladder.shortest_s,
            ladder.change,
            ladder.apart,
            lengths_s,
            np.array([p.change for p in self._propagators()]),
            bounds_of_rates(analog, ladder, lengths_s),
        )
