"""Runs of circuits that are alike, played one after the other in compiled code.

Stage 4, for batches and sweeps. Such runs differ in figures alone: gains, constants of circuits and
programs, what they begin with, levels of sources, ranges of converters. One player has what they share;
what is a run's own is a line of figures (`lines`), and each line takes its turn. To the last bit, a run
gives what it gives alone.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.beginnings import initial_words
from hybrid.engine import helper_functions, kernel
from hybrid.engine.arrays import Coupling, Floats, State
from hybrid.engine.beyond import FULL_SCALE
from hybrid.engine.blur import blurs
from hybrid.engine.circuit import Circuit
from hybrid.engine.interplay import begin
from hybrid.engine.linear import NOISE, Overloads
from hybrid.engine.lines import RUN
from hybrid.engine.noise import measure
from hybrid.engine.preparation import deck_of
from hybrid.engine.sweep import put_at_first
from hybrid.engine.windows import FIGURES, CircuitPlayer, with_own
from hybrid.machine import Machine, Pen
from hybrid.modes import CONTINUE
from hybrid.streams import stream
from hybrid.tape import Tape
from hybrid.timeline import Timeline

# Bytes that the runs of a series and their records take at once.
MOST_BYTES = 1 << 26


def fits(machine: Machine, timeline: Timeline) -> bool:
    """Whether runs of such a machine can be played in a series: circuits, whose words are doubles and
    whose timeline is not laid out on the way."""
    return bool(machine.elements) and not (timeline.later or len(machine.tape.length_of))


@dataclass(frozen=True, slots=True)
class Member:
    """A run that can be played with others, and what it is played by."""

    machine: Machine
    circuit: Circuit
    coupling: Coupling
    registers: Floats  # what they begin with
    timeline: Timeline
    pens: tuple[Pen, ...]
    seed: int

    @property
    def likeness(self) -> Hashable:
        """What all runs of one series have in common, as long as its members live.

        Circuits that share their laws share all but `FIGURES`; decks that are equal, all but what their
        registers begin with; couplings of one shape, all but figures.
        """
        circuit, machine = self.circuit, self.machine
        corners = range(len(circuit.corners)) if len(circuit.noisy) else ()
        return (
            id(self.timeline),
            id(circuit.laws),
            _written(machine.tape),
            tuple(map(len, self.coupling)),
            self.pens,
            machine.logic,
            *(blurs(circuit, corner) for corner in corners),
        )

    @property
    def bytes(self) -> int:
        """About what it takes while it is played: its line and its record."""
        elements, corners = len(self.circuit.rows), len(self.circuit.corners)
        noisy = 2 if len(self.circuit.noisy) else 1
        return 8 * (noisy * (60 * elements + 60 * corners) + len(self.pens) * self.timeline.rows)


# The runs of a batch mostly share their tape.
@functools.lru_cache(maxsize=64)
def _written(tape: Tape) -> Hashable:
    """The programs but for what their registers begin with."""
    return (tape.words, len(tape.sites), *(array.tobytes() for array in deck_of(tape)[0]))


class Series:
    """Runs of one likeness."""

    def __init__(self, members: Sequence[Member], keep_every: int) -> None:
        """Prepare the runs; each settles at t = 0. Raises PatchError where the first one alone does."""
        first, self.members = members[0], members
        self.player = CircuitPlayer(
            first.machine, first.timeline, first.pens, first.seed, keep_every
        )
        self.randoms = [stream(m.seed, NOISE) for m in members] if self.player.noise else []
        self.lines = self.player.places.below_each_other(len(members))
        start = self._fill()
        self._begin()
        signals = self.state.v[:, self.player.plant.signal]
        # What has no figure at t = 0, or is beyond full scale there, is rare, and told by a run alone.
        self.alone = ~np.isfinite(start).all(axis=1)
        self.alone |= ~(np.abs(signals) <= FULL_SCALE).all(axis=1)
        self.lines.outcomes[self.alone] = kernel.DONE
        self.records = np.empty((len(members), *self.player.rows.shape))
        self.ended_in = np.zeros(len(members), dtype=np.int64)  # segment
        self.ended = np.zeros(len(members), dtype=bool)
        self.noted: dict[int, Overloads] = {}  # of earlier segments, by run

    def _fill(self) -> Floats:
        """Put what each run has to itself into its line; the place of all elements' signals."""
        arrays, members = iter(self.player.places.views(self.lines.lines)), self.members
        side, noise, coupling = with_own(self.player.side, self.player.noise, arrays)
        self.state = State(*arrays)
        for name in FIGURES:
            for own, member in zip(getattr(side.circuit, name), members, strict=True):
                own[...] = getattr(member.circuit, name)
        for state in (side.state, *([noise.truth] if noise else [])):
            put_at_first(side.circuit.initial, state.memory, state.start)
        inputs = len(members[0].machine.analog.u0)
        for run, member in enumerate(members):
            self.state.v[run, -inputs:] = member.machine.analog.u0
            if member.coupling is not members[0].coupling:
                for own, array in zip(coupling, member.coupling, strict=True):
                    own[run] = array
            self.state.registers[run] = member.registers
            self.state.words[run] = initial_words(member.machine)
        if members[0].machine.on_overload != CONTINUE:
            self.state.counts[:, kernel.STOPS] = kernel.NEXT
        start: Floats = side.state.start
        return start

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
        runs = len(self.members)
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
                at = int(lines.now[RUN]) if outcome == kernel.PAUSED else len(records)
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
        player.machine, player.seed = self.members[run].machine, self.members[run].seed
        player.rows = self.records[run]
        player.overload_s = dict(self.noted.get(run, {}))
        player.segment = int(self.ended_in[run])
        player.come_to(int(self.lines.outcomes[run]))
        return player
