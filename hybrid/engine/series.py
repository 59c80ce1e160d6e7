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
from hybrid.elements import INPUT
from hybrid.engine import helper_functions, kernel
from hybrid.engine.arrays import State
from hybrid.engine.beyond import FULL_SCALE
from hybrid.engine.circuit import Builder, Circuit
from hybrid.engine.interplay import begin
from hybrid.engine.linear import Overloads
from hybrid.engine.lines import RUN
from hybrid.engine.preparation import coupling_of
from hybrid.engine.sweep import put_at_first
from hybrid.engine.windows import FIGURES, CircuitPlayer, with_own
from hybrid.machine import Machine, Pen
from hybrid.modes import CONTINUE
from hybrid.timeline import Timeline

# Bytes that the runs of a series and their records take at once.
MOST_BYTES = 1 << 26


def circuit_of(machine: Machine) -> Circuit:
    """The circuit of a machine whose analog side is one."""
    builder = Builder()
    for name, element in machine.elements:
        builder.add(name, element)
        if element.kind == INPUT:
            builder.inputs.append(name)
    return builder.build()[0]


def fits(machine: Machine, timeline: Timeline) -> bool:
    """Whether runs of such a machine can be played in a series: circuits without noise, whose words are
    doubles and whose timeline is not laid out on the way."""
    noisy = any(element.noise > 0.0 for _, element in machine.elements)
    return bool(machine.elements) and not (noisy or timeline.later or len(machine.tape.length_of))


def likeness(
    machine: Machine, circuit: Circuit, timeline: Timeline, pens: tuple[Pen, ...]
) -> Hashable:
    """What all runs of one series have in common, as long as these objects live."""
    shared = (timeline, circuit.rows, machine.tape, coupling_of(machine))
    return (*map(id, shared), pens, machine.logic)


class Series:
    """Runs of one likeness; `machines` and `circuits` of each."""

    def __init__(
        self,
        machines: Sequence[Machine],
        circuits: Sequence[Circuit],
        timeline: Timeline,
        pens: tuple[Pen, ...],
        keep_every: int,
    ) -> None:
        """Prepare the runs; each settles at t = 0. Raises PatchError where the first one alone does."""
        self.machines = machines
        self.player = CircuitPlayer(machines[0], timeline, pens, 0, keep_every)
        self.lines = self.player.places.below_each_other(len(machines))
        arrays = iter(self.player.places.views(self.lines.lines))
        side, self.state = with_own(self.player.side, arrays), State(*arrays)
        for name in FIGURES:
            for own, circuit in zip(getattr(side.circuit, name), circuits, strict=True):
                own[...] = getattr(circuit, name)
        put_at_first(side.circuit.initial, side.state.memory, side.state.start)
        inputs = len(machines[0].analog.u0)
        for v, machine in zip(self.state.v, machines, strict=True):
            v[len(v) - inputs :] = machine.analog.u0
        self.state.words[:] = initial_words(machines[0])
        if machines[0].on_overload != CONTINUE:
            self.state.counts[:, kernel.STOPS] = kernel.NEXT
        begin(self.player.side, None, self.player.plant, self.player.state, self.lines)
        signals = self.state.v[:, self.player.plant.signal]
        # What has no figure at t = 0, or is beyond full scale there, is rare, and told by a run alone.
        self.alone = ~np.isfinite(side.state.start).all(axis=1)
        self.alone |= ~(np.abs(signals) <= FULL_SCALE).all(axis=1)
        self.lines.outcomes[self.alone] = kernel.DONE
        self.records = np.empty((len(machines), *self.player.rows.shape))
        self.ended_in = np.zeros(len(machines), dtype=np.int64)  # segment
        self.ended = self.alone.copy()
        self.noted: dict[int, Overloads] = {}  # of earlier segments, by run

    def play(self) -> Iterator[float]:
        """Play all runs to their end in chunks; yields the fraction that is done."""
        player, outcomes = self.player, self.lines.outcomes
        for number in range(len(player.segments)):
            if number:
                self._begin_again()
            going = outcomes == kernel.PAUSED
            self.ended_in[going], player.segment = number, number
            outcome = kernel.PAUSED
            while outcome == kernel.PAUSED:
                outcome = player.play_lines(self.records, self.lines)
                place = self.lines.now[RUN] / len(outcomes) if outcome == kernel.PAUSED else 1.0
                yield (number + place) / len(player.segments)
        self.ended[:] = True

    def _begin_again(self) -> None:
        """A segment has ended for all runs: the kernel's counts and notes are of the next one."""
        going = self.lines.outcomes == kernel.PAUSED
        noted = going & self.state.overload.any(axis=(1, 2))
        for run in np.flatnonzero(noted).tolist():
            self.noted[run] = self._at_its_end(run).overload_s
            self.lines.lines[run] = self.player.places.line
        self.state.counts[:, [kernel.REPEAT, kernel.CUE]] *= ~going[:, None]
        self.state.outside[going, -1, helper_functions.SEGMENT] = self.player.segment + 1

    def players(self) -> Iterator[tuple[int, CircuitPlayer]]:
        """Runs that have come to their end, by number; not those that are to be played alone.

        One at a time: the next one takes its place.
        """
        ended = self.ended | (self.lines.outcomes != kernel.PAUSED)
        if self.player.segment == len(self.player.segments) - 1:
            ended[: self.lines.now[RUN]] = True
        for run in np.flatnonzero(ended & ~self.alone).tolist():
            yield run, self._at_its_end(run)

    def _at_its_end(self, run: int) -> CircuitPlayer:
        """The player in the state that a run came to, with the segment done that it had played."""
        self.player.places.line[:] = self.lines.lines[run]
        player = copy.copy(self.player)
        player.machine, player.rows = self.machines[run], self.records[run]
        player.overload_s = dict(self.noted.get(run, {}))
        player.segment = int(self.ended_in[run])
        player.come_to(int(self.lines.outcomes[run]))
        return player
