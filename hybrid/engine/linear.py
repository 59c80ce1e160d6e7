"""Plays a machine's timeline in chunks, from the arrays that `preparation` makes.

Stage 4. A `Player` owns the state of one run. Playing instant by instant, in chunks of any size or in
one go gives the same bits: normal draws come from one stream, in the order of the events.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid.engine import helper_functions, kernel
from hybrid.engine.arrays import CUE, Deck, Plant, Score, State
from hybrid.engine.beyond import DAC_SUFFIX, FULL_SCALE, Overload
from hybrid.engine.bursts import MULTIPLY_ADD
from hybrid.engine.limited import play_limited
from hybrid.engine.lost import Lost, farthest
from hybrid.engine.preparation import (
    coupling_of,
    cues_of,
    deck_of,
    draws_before,
    pens_of,
    plant_of,
    state_of,
    sums_of,
)
from hybrid.engine.programs import play_programs
from hybrid.errors import PatchError
from hybrid.machine import Floats, Machine, Pen
from hybrid.modes import CONTINUE
from hybrid.scale import to_seconds
from hybrid.streams import stream
from hybrid.timeline import Segment, Timeline, most_intervals

# Small enough to answer Ctrl-C at once and to keep the normal draws in the cache.
CHUNK_CUES = 1_000_000
CHUNK_DRAWS = 1 << 17
NOISE = "noise"  # the name of the stream of normal draws
# Where the rows stand in what `kernel.play` takes.
ROWS = 7
NO_DRAWS = np.zeros(0)
NO_COUNTS = np.zeros(1, dtype=np.int64)
# By row of the kernel's notes: first time, value then, worst value, its time, instants.
Overloads = dict[int, tuple[float, float, float, float, int]]


def player_of(deck: Deck) -> Callable[..., int]:
    """The compiled function that plays these programs, which has in it no more than they need."""
    if len(deck.length_of):
        return play_limited  # type: ignore[no-any-return]
    more = np.any(deck.bursts[:, 0] != MULTIPLY_ADD)
    return play_programs if more else kernel.play  # type: ignore[no-any-return]


class Player:
    """One run of one machine, in progress."""

    plays_noise = True

    def __init__(
        self,
        machine: Machine,
        timeline: Timeline,
        pens: tuple[Pen, ...],
        seed: int = 0,
        keep_every: int = 1,
    ) -> None:
        """Prepare the run; nothing is played yet. `keep_every`: rows of the record kept, 1 in n."""
        self.machine, self.timeline, self.keep_every = machine, timeline, keep_every
        self.seed = seed
        self.segments: list[Segment] = []
        self.offsets: list[list[int]] = []
        self.scores: list[Score] = []
        self._numbers: dict[int, int] = {}  # of the intervals met so far, in ticks
        self._further = timeline.further()
        self._asked_ticks: dict[int, int] = {}  # of segments that are no more held
        for segment in timeline.segments or (next(self._further),):
            self._add(segment)
        self.plant = self._analog_side(list(self._numbers))
        self.coupling, self.deck, self.pens = (
            coupling_of(machine),
            deck_of(machine.tape)[0],
            pens_of(machine, pens),
        )
        self._compiled = player_of(self.deck)
        self.state = self._first_state()
        self.rows = np.empty((-(-timeline.rows // keep_every), len(pens)))
        self.segment = 0
        self.outcome = kernel.PAUSED
        self._draws = [draws_before(score.cues, self.plant.draws) for score in self.scores]
        # Where earlier segments' overloads began, as the kernel's counts start anew in each.
        self.overload_s: Overloads = {}
        for row, value in enumerate(self.state.v[self.plant.signal].tolist()):
            if abs(value) > FULL_SCALE:
                self.overload_s[row] = (0.0, value, value, 0.0, 1)
                self.state.overload[row, kernel.LAST] = 1
        if machine.on_overload != CONTINUE:
            self.state.counts[kernel.STOPS] = kernel.AT_ONCE if self.overload_s else kernel.NEXT

    def play(self) -> Iterator[float]:
        """Play to the end in chunks; yields the fraction of the run that is done."""
        while self.outcome == kernel.PAUSED:
            self.play_cues(self._chunk())
            yield self.done_s / max(to_seconds(self.timeline.until), 1e-300)

    def play_cues(self, most_cues: int) -> None:
        """Play at most `most_cues` cues of the current segment."""
        if self.segment == len(self.scores):
            self.outcome = kernel.DONE
            return
        score, segment = self.scores[self.segment], self.segments[self.segment]
        self.state.counts[kernel.DRAWS] = 0
        needed = self._draws_needed(segment, most_cues)
        normals = self._normals.standard_normal(needed) if needed else NO_DRAWS
        self.come_to(self._play_to(score, normals, *self._position(most_cues)))

    def come_to(self, outcome: int) -> None:
        """The kernel came back with this; at the end of a segment the next one is due."""
        segment = self.segments[self.segment]
        if outcome == kernel.PAUSED and self.state.counts[kernel.REPEAT] == segment.repeats:
            self._next_segment(segment)
            outcome = kernel.DONE if self.segment == len(self.scores) else kernel.PAUSED
        self.outcome = outcome

    @functools.cached_property
    def _normals(self) -> np.random.Generator:
        """The one stream of normal draws of this run."""
        return stream(self.seed, NOISE)

    def _analog_side(self, intervals: list[int]) -> Plant:
        """The analog side, ready to be advanced over these intervals (ticks)."""
        return plant_of(self.machine, intervals)

    def _first_state(self) -> State:
        """What changes during the run, as it is at t = 0."""
        return state_of(self.machine, self.plant)

    def _play_to(self, score: Score, normals: Floats, stop_repeat: int, stop_cue: int) -> int:
        """Play on in the segment; why it ended."""
        outcome: int = self._compiled(*self._given(score, normals, stop_repeat, stop_cue))
        return outcome

    def _given(
        self, score: Score, normals: Floats, stop_repeat: int, stop_cue: int
    ) -> tuple[Any, ...]:
        """What `kernel.play` takes, and first whatever plays in its place."""
        return (
            score,
            self.plant,
            self.coupling,
            self.deck,
            self.pens,
            self.state,
            normals,
            self.rows,
            self.keep_every,
            stop_repeat,
            stop_cue,
        )

    @property
    def held_s(self) -> float | None:
        """When an overload put the machine into HOLD; None where none did."""
        return None

    @property
    def engine_error(self) -> float | None:
        """What the engine may have erred by, of full scale; None where it rounds alone or cannot say."""
        return None

    @property
    def why_ended(self) -> str:
        """Which part ended the run by how it switches; '' where none is known to have."""
        return ""

    @property
    def lost(self) -> Lost | None:
        """Which signal went beyond any scale, or changes too fast to follow; None: none is known."""
        return self._farthest()

    def _farthest(self) -> Lost | None:
        """The same of what the kernel has: signals, converters, and states inside of components."""
        analog, state, worst = self.machine.analog, self.state, self.overloads()
        inner = state.v[: len(self.plant.kept)][self.plant.kept > 0.0]
        return (
            farthest(analog.signals, state.v[self.plant.signal])
            or farthest([o.signal for o in worst], np.array([o.worst_mu for o in worst]))
            or farthest(analog.states, inner)
        )

    @property
    def coarse_by(self) -> str:
        """The part whose noise says how well windows are resolved; '' where none does."""
        return ""

    def remarks(self) -> tuple[str, ...]:
        """What else is to be said of the run."""
        return ()

    @property
    def record(self) -> Floats:
        """Rows taken so far, (rows, pens), in problem units."""
        return self.rows[: self.state.counts[kernel.ROWS]]

    @property
    def done_ticks(self) -> int:
        """Problem time up to which the run has been played."""
        if self.segment == len(self.scores):
            last = self.segments[-1]
            return last.start + last.length * last.repeats
        counts = self.state.counts
        cue = counts[kernel.CUE]
        instant = self.scores[self.segment].cues["instant"][cue - 1] if cue else 0
        return self._instant_ticks(counts[kernel.REPEAT], instant)

    @property
    def done_s(self) -> float:
        """The same in s."""
        return to_seconds(self.done_ticks)

    def overloads(self) -> tuple[Overload, ...]:
        """Every signal that went beyond its range so far, by first time, then name."""
        self._collect_overloads()
        names = [
            *self.machine.analog.signals,
            *(s.name for s in self.machine.samplers),
            *(h.name + DAC_SUFFIX for h in self.machine.holders),
            *self.machine.tape.words,
        ]
        found = [Overload(names[row], *facts) for row, facts in self.overload_s.items()]
        return tuple(sorted(found, key=lambda o: (o.time_s, o.signal)))

    def _chunk(self) -> int:
        if self.segment == len(self.scores):
            return 1
        cues = len(self.scores[self.segment].cues)
        per_repeat = max(int(self._draws[self.segment][-1]), 1)
        repeats = max(1, min(CHUNK_DRAWS // per_repeat, CHUNK_CUES // cues))
        return repeats * cues

    def _position(self, most_cues: int) -> tuple[int, int]:
        """Repeat and cue of the present segment that is `most_cues` further on, or its end."""
        count, cues = self.state.counts, len(self.scores[self.segment].cues)
        at = int(count[kernel.REPEAT]) * cues + int(count[kernel.CUE]) + most_cues
        return divmod(min(at, self.segments[self.segment].repeats * cues), cues)

    def _draws_needed(self, segment: Segment, most_cues: int) -> int:
        """Exact number of draws of the next `most_cues` cues, so that none is wasted."""
        count, totals = self.state.counts, self._draws[self.segment]
        per_repeat = len(totals) - 1
        at = int(count[kernel.REPEAT]) * per_repeat + int(count[kernel.CUE])
        end = min(at + most_cues, segment.repeats * per_repeat)

        def drawn(instant: int) -> int:
            return instant // per_repeat * int(totals[-1]) + int(totals[instant % per_repeat])

        return drawn(end) - drawn(at)

    def _next_segment(self, segment: Segment) -> None:
        self._collect_overloads()
        self.state.counts[[kernel.REPEAT, kernel.CUE]] = 0
        self.segment += 1
        self.state.outside[-1, helper_functions.SEGMENT] = self.segment
        if self.segment < len(self.segments):
            return
        further = next(self._further, None)
        if further is not None:  # the last one is no more needed
            outside = self.state.outside[:-1]
            here = outside[:, helper_functions.SEGMENT] == self.segment - 1
            for row in np.flatnonzero(here & (outside[:, helper_functions.TIMES] > 0.0)).tolist():
                self._asked_ticks[row] = self.asked_ticks(row)
            self._forget_intervals()
            known, nothing = len(self._numbers), Score(np.zeros(0, dtype=CUE))
            self.scores[-1], self.offsets[-1], self._draws[-1] = nothing, [], NO_COUNTS
            self.segments[-1] = replace(self.segments[-1], events=())
            self._add(further)
            if len(self._numbers) > known:
                self._more_intervals(list(self._numbers)[known:])
            self._draws.append(draws_before(self.scores[-1].cues, self.plant.draws))

    def asked_ticks(self, row: int) -> int:
        """When a place of the program first asked a function beyond its range."""
        columns = (helper_functions.SEGMENT, helper_functions.REPEAT, helper_functions.INSTANT)
        segment, repeat, instant = (int(self.state.outside[row, column]) for column in columns)
        if not self.offsets[segment]:  # long past
            return self._asked_ticks[row]
        stretch = self.segments[segment]
        offset = self.offsets[segment][instant] if instant >= 0 else 0
        return stretch.start + repeat * stretch.length + offset

    def _add(self, segment: Segment) -> None:
        """Take in a segment: its score and its instants."""
        looks = bool(sums_of(self.machine)) or bool(self.machine.elements)
        cues, at = cues_of(segment, self._numbers, looks)
        most = most_intervals(self.machine)
        if len(self._numbers) > most:
            raise PatchError(
                f"the run has more than {most} different intervals between events in a short time; make "
                "periods, compute times and 1/64 of every jitter small multiples of each other",
                self.machine.patch.run.until.place,
            )
        self.segments.append(segment)
        self.offsets.append(at)
        self.scores.append(Score(np.array(cues, dtype=CUE)))

    def _cut(self, instant: int, at: int) -> None:
        """End the present segment at the tick `at`, after the instant of this number."""
        segment, offsets = self.segments[self.segment], self.offsets[self.segment]
        length = at - segment.start
        self.offsets[self.segment] = offsets[: instant + 1] + [length] * (length > offsets[instant])
        self.segments[self.segment] = replace(segment, length=length)

    def _forget_intervals(self) -> None:
        """Before another stretch is taken in: propagators are kept, as intervals come again, while there
        is room for those of another one."""
        if 2 * len(self._numbers) > most_intervals(self.machine):
            self._numbers.clear()
            nothing = self.plant.change[:0], self.plant.draws[:0]
            self.plant = self.plant._replace(change=nothing[0], draws=nothing[1])

    def _more_intervals(self, intervals: list[int]) -> None:
        """Get ready to advance the analog side over further intervals (ticks)."""
        more = plant_of(self.machine, intervals)
        blocks, inputs = more.change.shape[1], more.change.shape[2]
        old = self.plant
        missing = old.change.shape[2] - inputs
        if missing < 0:  # the rank of the noise is higher
            self.state = self.state._replace(v=np.concatenate([self.state.v, np.zeros(-missing)]))
            self.plant = plant_of(self.machine, list(self._numbers))
            return
        assert blocks == old.change.shape[1]
        change = np.pad(more.change, ((0, 0), (0, 0), (0, missing), (0, 0)))
        self.plant = old._replace(
            change=np.concatenate([old.change, change]),
            draws=np.concatenate([old.draws, more.draws]),
        )

    def _instant_ticks(self, repeat: int, instant: int) -> int:
        segment = self.segments[self.segment]
        offset = self.offsets[self.segment][instant] if instant >= 0 else 0
        return segment.start + int(repeat) * segment.length + offset

    def _instant_s(self, repeat: int, instant: int) -> float:
        return to_seconds(self._instant_ticks(repeat, instant))

    def _collect_overloads(self) -> None:
        """Turn the kernel's notes into times and merge them with those of earlier segments."""
        if self.segment == len(self.scores):
            return
        notes = self.state.overload
        if not notes.any():
            return
        for row in np.flatnonzero(notes[:, kernel.TIMES]).tolist():
            note, (value, worst) = notes[row].tolist(), self.state.beyond[row].tolist()
            first = self._instant_s(note[kernel.FIRST_REPEAT], note[kernel.FIRST_INSTANT])
            worst_s = self._instant_s(note[kernel.WORST_REPEAT], note[kernel.WORST_INSTANT])
            instants = note[kernel.TIMES]
            if row in self.overload_s:
                first, value, old_worst, old_s, old_instants = self.overload_s[row]
                instants += old_instants
                if abs(old_worst) >= abs(worst):
                    worst, worst_s = old_worst, old_s
            self.overload_s[row] = (first, value, worst, worst_s, instants)
        self.state.beyond[:] = 0.0
        # An overload at the very end of a segment is at the first instant of the next one too.
        segment, last = self.segments[self.segment], len(self.offsets[self.segment]) - 1
        at_the_end = notes[:, kernel.LAST] == segment.repeats * last + 1
        notes[:] = 0
        notes[at_the_end, kernel.LAST] = 1
