"""Runs of circuits that are alike, played one after the other in compiled code.

Stage 4, for batches and sweeps. Such runs differ in figures alone: gains, constants, what they begin
with, what their inputs hold. One player has what they share; what is a run's own is a line of figures
(`lines`), and each line takes its turn. To the last bit, a run gives what it gives alone.
"""

from __future__ import annotations

import copy
from collections.abc import Hashable, Iterator, Sequence

import numpy as np

from hybrid.beginnings import initial_words
from hybrid.engine import helper_functions, kernel
from hybrid.engine.arrays import State
from hybrid.engine.beyond import FULL_SCALE
from hybrid.engine.blur import blurs
from hybrid.engine.circuit import Circuit
from hybrid.engine.interplay import begin
from hybrid.engine.linear import NOISE, Overloads
from hybrid.engine.lines import RUN
from hybrid.engine.noise import measure
from hybrid.engine.preparation import coupling_of
from hybrid.engine.sweep import put_at_first
from hybrid.engine.windows import FIGURES, CircuitPlayer, with_own
from hybrid.machine import Machine, Pen
from hybrid.modes import CONTINUE
from hybrid.streams import stream
from hybrid.timeline import Timeline

# Bytes that the runs of a series and their records take at once.
MOST_BYTES = 1 << 26


def fits(machine: Machine, timeline: Timeline) -> bool:
    """Whether runs of such a machine can be played in a series: circuits, whose words are doubles and
    whose timeline is not laid out on the way."""
    return bool(machine.elements) and not (timeline.later or len(machine.tape.length_of))


def likeness(
    machine: Machine, circuit: Circuit, timeline: Timeline, pens: tuple[Pen, ...]
) -> Hashable:
    """What all runs of one series have in common, as long as these objects live.

    Circuits that share their laws share all but `FIGURES`.
    """
    shared = (timeline, circuit.laws, machine.tape, coupling_of(machine))
    corners = range(len(circuit.corners)) if len(circuit.noisy) else ()
    return (*map(id, shared), pens, machine.logic, *(blurs(circuit, c) for c in corners))


class Series:
    """Runs of one likeness: of each its machine, its circuit and the seed of its noise."""

    def __init__(
        self,
        machines: Sequence[Machine],
        circuits: Sequence[Circuit],
        seeds: Sequence[int],
        timeline: Timeline,
        pens: tuple[Pen, ...],
        keep_every: int,
    ) -> None:
        """Prepare the runs; each settles at t = 0. Raises PatchError where the first one alone does."""
        self.machines, self.seeds = machines, seeds
        self.player = CircuitPlayer(machines[0], timeline, pens, seeds[0], keep_every)
        self.randoms = [stream(seed, NOISE) for seed in seeds] if self.player.noise else []
        self.lines = self.player.places.below_each_other(len(machines))
        arrays = iter(self.player.places.views(self.lines.lines))
        side, noise = with_own(self.player.side, self.player.noise, arrays)
        self.state = State(*arrays)
        for name in FIGURES:
            for own, circuit in zip(getattr(side.circuit, name), circuits, strict=True):
                own[...] = getattr(circuit, name)
        for state in (side.state, *([noise.truth] if noise else [])):
            put_at_first(side.circuit.initial, state.memory, state.start)
        inputs = len(machines[0].analog.u0)
        for v, machine in zip(self.state.v, machines, strict=True):
            v[len(v) - inputs :] = machine.analog.u0
        self.state.words[:] = initial_words(machines[0])
        if machines[0].on_overload != CONTINUE:
            self.state.counts[:, kernel.STOPS] = kernel.NEXT
        self._begin()
        signals = self.state.v[:, self.player.plant.signal]
        # What has no figure at t = 0, or is beyond full scale there, is rare, and told by a run alone.
        self.alone = ~np.isfinite(side.state.start).all(axis=1)
        self.alone |= ~(np.abs(signals) <= FULL_SCALE).all(axis=1)
        self.lines.outcomes[self.alone] = kernel.DONE
        self.records = np.empty((len(machines), *self.player.rows.shape))
        self.ended_in = np.zeros(len(machines), dtype=np.int64)  # segment
        self.ended = np.zeros(len(machines), dtype=bool)
        self.noted: dict[int, Overloads] = {}  # of earlier segments, by run

    def _begin(self) -> None:
        player = self.player
        begin(player.side, player.noise, player.random, player.plant, player.state, self.lines)
        if player.noise and player.noise.chain.blurs.any():
            for line in self.lines.lines:
                player.places.line[:] = line
                measure(player.side.circuit, player.side.state, player.noise)
                line[:] = player.places.line

    def play(self) -> Iterator[float]:
        """Play all runs to their end in chunks; yields the fraction that is done.

        All in one go, or one after the other where each draws noise of its own.
        """
        runs = len(self.machines)
        if not self.player.noise:
            yield from self._play(slice(0, runs), None)
            return
        for run, random in enumerate(self.randoms):
            for done in self._play(slice(run, run + 1), random):
                yield (run + done) / runs

    def _play(self, some: slice, random: np.random.Generator | None) -> Iterator[float]:
        """The same of some runs, which draw from `random`."""
        player, until = self.player, max(self.player.timeline.until, 1)
        lines, records = self.lines.part(some), self.records[some]
        for number, segment in enumerate(player.segments):
            if number:
                self._begin_again(some)
            self.ended_in[some][lines.outcomes == kernel.PAUSED] = player.segment = number
            outcome = kernel.PAUSED
            while outcome == kernel.PAUSED:
                outcome = player.play_lines(records, lines, random)
                at = lines.now[RUN] if outcome == kernel.PAUSED else len(records)
                self.ended[some][:at] |= number == len(player.segments) - 1
                yield (segment.start + segment.length * segment.repeats * at / len(records)) / until

    def _begin_again(self, some: slice) -> None:
        """A segment has ended for these runs: the kernel's counts and notes are of the next one."""
        state, player = self.state, self.player
        going = self.lines.outcomes[some] == kernel.PAUSED
        noted = going & state.overload[some].any(axis=(1, 2))
        for run in (some.start + np.flatnonzero(noted)).tolist():
            self.noted[run] = self._at_its_end(run).overload_s
            self.lines.lines[run] = player.places.line
        state.counts[some, [kernel.REPEAT, kernel.CUE]] *= ~going[:, None]
        state.outside[some][going, -1, helper_functions.SEGMENT] = player.segment + 1

    def players(self) -> Iterator[tuple[int, CircuitPlayer]]:
        """Runs that have come to their end, by number; not those that are to be played alone.

        One at a time: the next one takes its place.
        """
        ended = self.ended | (self.lines.outcomes != kernel.PAUSED)
        for run in np.flatnonzero(ended & ~self.alone).tolist():
            yield run, self._at_its_end(run)

    def _at_its_end(self, run: int) -> CircuitPlayer:
        """The player in the state that a run came to, with the segment done that it had played."""
        self.player.places.line[:] = self.lines.lines[run]
        player = copy.copy(self.player)
        player.machine, player.seed = self.machines[run], self.seeds[run]
        player.rows = self.records[run]
        player.overload_s = dict(self.noted.get(run, {}))
        player.segment = int(self.ended_in[run])
        player.come_to(int(self.lines.outcomes[run]))
        return player
