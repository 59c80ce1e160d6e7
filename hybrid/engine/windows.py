"""The nonlinear engine as a player: what lies between two instants is played by `relaxation`.

Stage 4. Everything else (converters, program, record) is the exact engine's: its kernel comes back
wherever the analog side must be advanced, or must follow a jump. Overloads of analog signals are those
that the circuit saw, also between instants.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections import OrderedDict
from collections.abc import Iterator
from typing import Any

import numpy as np

from hybrid.elements import INPUT
from hybrid.engine import kernel
from hybrid.engine.arrays import Coupling, Floats, Plant, Score, State
from hybrid.engine.beyond import TIMES, Overload
from hybrid.engine.blur import Blur
from hybrid.engine.calls import Calls
from hybrid.engine.circuit import SOURCE
from hybrid.engine.corners import new_log, settle
from hybrid.engine.interplay import (
    Clock,
    Side,
    begin,
    play_circuits,
    play_limited_circuit,
    settle_loops,
)
from hybrid.engine.linear import NO_DRAWS, ROWS, Player
from hybrid.engine.lines import Array, Lines, Places
from hybrid.engine.lost import Lost, runaway, tails, unresolved
from hybrid.engine.nodes import RESOLUTION, Shelf, new_shelf, nodes
from hybrid.engine.noise import SHARE_OF_NOISE, Noise, measure, new_noise
from hybrid.engine.relaxation import no_pen
from hybrid.engine.remarks import (
    chattering,
    ended_by,
    error_of_averages,
    held_back,
    over_corners,
    refuse_undefined,
)
from hybrid.engine.sweep import (
    DRIVE,
    FROZEN,
    ON_OVERLOAD,
    OVERLOAD_S,
    SUM_OF_ERRORS,
    new_state,
)
from hybrid.engine.sweep import State as CircuitState
from hybrid.engine.wiring import circuit_of
from hybrid.machine import Machine
from hybrid.modes import MODE_ELEMENT
from hybrid.scale import to_seconds, to_ticks

NODES = 8
# Of a circuit, what runs that are alike may differ in.
FIGURES = ("figures", "gain", "pieces", "initial")
# Sets of laws whose operators are kept, in each thread.
MOST_SHELVES = 8


class CircuitPlayer(Player):
    """One run of a machine whose analog side is a circuit."""

    side: Side
    names: tuple[str, ...]  # of the circuit's elements
    noise: Noise | None
    places: Places  # of all that is the run's own
    lines: Lines
    intervals_s: Floats  # of the intervals between instants
    calls: Calls  # of tasks by comparators

    @property
    def clock(self) -> Clock:
        """Times of the present segment."""
        segment, offsets = self.segments[self.segment], self.offsets[self.segment]
        if self._clock_of != self.segment:
            self._clock_of = self.segment
            self._clock = Clock(
                to_seconds(segment.start),
                to_seconds(segment.length),
                np.array([to_seconds(t) for t in offsets]),
                self.intervals_s,
            )
        return self._clock

    _clock_of = -1

    def play_cues(self, most_cues: int) -> None:
        """Play at most `most_cues` cues of the current segment, or up to where a task is called."""
        super().play_cues(most_cues)
        if self.outcome == kernel.CALLED:
            self.outcome = self._answer()

    def _answer(self) -> int:
        """A comparator has switched that starts tasks: have the timeline go on from there."""
        later, segment = self.timeline.later, self.segments[self.segment]
        assert later is not None
        cue, offsets = self.state.counts[kernel.CUE], self.offsets[self.segment]
        instant = int(self.scores[self.segment].cues["instant"][cue]) - 1  # all of it is done
        done = segment.start + offsets[instant]
        into = to_ticks(float(self.side.called_s[0]))
        at = min(done + into, segment.start + offsets[instant + 1])
        for task in self.calls.take(self.side.state):
            later.call(task, done, at)
        if self.calls.chatter(at, self.side.circuit.taus_s):
            self.side.stopped_s[0] = to_seconds(at)
            return kernel.CHATTERS
        self._cut(instant, at)
        self._next_segment(segment)
        return kernel.DONE if self.segment == len(self.scores) else kernel.PAUSED

    def _forget_intervals(self) -> None:
        self._numbers.clear()
        self.intervals_s = np.zeros(0)
        self.plant = self.plant._replace(draws=np.zeros(0, dtype=np.int64))

    def _more_intervals(self, intervals: list[int]) -> None:
        more = np.array([to_seconds(t) for t in intervals])
        self.intervals_s = np.concatenate([self.intervals_s, more])
        nothing = np.zeros(len(intervals), dtype=np.int64)
        self.plant = self.plant._replace(draws=np.concatenate([self.plant.draws, nothing]))

    def _analog_side(self, intervals: list[int]) -> Plant:
        """A plant without propagators; the circuit is `side`."""
        self.side, self.names = side_of(self.machine)
        self.calls = Calls(self.machine, self.side.place)
        circuit = self.side.circuit
        self.noise = new_noise(circuit, NODES) if len(circuit.noisy) else None
        self.intervals_s = np.array([to_seconds(t) for t in intervals])
        signals, inputs = len(self.machine.analog.signals), len(self.machine.analog.inputs)
        return Plant(
            np.zeros((0, 0, inputs, 8)),
            np.zeros(signals + 1),  # and the machine's mode
            np.zeros(len(intervals), dtype=np.int64),
            np.arange(signals, dtype=np.uint32),
            np.zeros((inputs, 0)),
        )

    def _first_state(self) -> State:
        """Every signal settled at t = 0."""
        state = super()._first_state()
        count = len(self.machine.analog.signals) + 1
        v = np.concatenate([np.zeros(count), state.v])
        state = self._in_a_line(state._replace(v=v, next_v=np.zeros(count)))
        begin(self.side, self.noise, self.random, self.plant, state, self.lines)
        refuse_undefined(self.machine, self.side.circuit, self.names, self.side.state.start)
        if self.noise is not None:
            measure(self.side.circuit, self.side.state, self.noise)
        self.calls.listen(self.side.state)
        return state

    def _in_a_line(self, state: State) -> State:
        """Put all that is the run's own into one line."""
        self.places = Places([*_own(self.side, self.noise), *self.coupling, *state])
        self.lines = self.places.lines(self.places.line[None])
        arrays = iter(self.places.alone())
        self.side, self.noise, self.coupling = with_own(self.side, self.noise, arrays)
        return State(*arrays)

    @property
    def random(self) -> np.random.Generator | None:
        """What the noise is drawn from."""
        return self._normals if self.noise else None

    @property
    def held_s(self) -> float | None:
        """When an overload put the machine into HOLD; None where none did."""
        frozen = self.side.state.counts[FROZEN] > 0
        return float(self.side.state.clock[OVERLOAD_S]) if frozen else None

    @property
    def done_s(self) -> float:
        """Until when it has been played, also where it stopped between two instants."""
        stopped_s = float(self.side.stopped_s[0])
        return super().done_s if np.isnan(stopped_s) else stopped_s

    @property
    def engine_error(self) -> float | None:
        """What the ends of the windows have gathered, of full scale, were nothing magnified."""
        smooth = float(self.side.state.clock[SUM_OF_ERRORS])
        if self.noise is None:
            return smooth
        squares = float(self.noise.truth.clock[SUM_OF_ERRORS])
        blurred = error_of_averages(self.side.circuit, self.noise.blur, self.done_s)
        return smooth + math.sqrt(squares) + blurred

    @property
    def coarse_by(self) -> str:
        """The loudest part, where windows are resolved only as well as its noise asks for."""
        circuit = self.side.circuit
        if not self.noise or SHARE_OF_NOISE * circuit.grain <= RESOLUTION:
            return ""
        loudest = circuit.noisy[np.argmax(circuit.noise), SOURCE]
        return str(self.names[loudest]).partition(":")[0]

    @property
    def lost(self) -> Lost | None:
        """Which signal the run was lost by: of the true ones, where these were."""
        circuit, grid = self.side.circuit, self.side.grid
        states = (self.noise.truth, self.side.state) if self.noise else (self.side.state,)
        if self.outcome == kernel.NOT_RESOLVED:
            worst = max(states, key=lambda state: float(tails(circuit, grid, state).max()))
            return unresolved(circuit, self.names, grid, worst)
        found = (runaway(circuit, self.names, state.start) for state in states)
        return next((one for one in found if one), None) or self._farthest()

    def remarks(self) -> tuple[str, ...]:
        """Parts that chatter, and those that saturate unseen."""
        circuit, state = self.side.circuit, self.side.state
        return (
            *chattering(circuit, self.names, state.changes),
            *held_back(self.machine, circuit, self.names, state, self._lit()),
            *(
                over_corners(circuit, self.names, self.noise.blur, self.done_s)
                if self.noise
                else ()
            ),
        )

    def _lit(self) -> frozenset[int]:
        """Elements that were beyond full scale."""
        rows = (self.noise.truth if self.noise else self.side.state).overload
        return frozenset(np.flatnonzero(rows[:, TIMES]).tolist())

    @property
    def why_ended(self) -> str:
        """Which part ended the run by how it switches."""
        gathered = self.outcome == kernel.GATHERS
        return ended_by(self.side.circuit, self.names, self.side.state, gathered)

    def overloads(self) -> tuple[Overload, ...]:
        """Converters as the kernel saw them; analog signals as they went between the instants, too."""
        signals = self.machine.analog.signals
        found = [o for o in super().overloads() if o.signal not in signals]
        rows = (self.noise.truth if self.noise else self.side.state).overload[self.side.place]
        for i in np.flatnonzero(rows[:, TIMES]).tolist():
            first_s, first, worst, worst_s, duration_s, times = rows[i].tolist()
            facts = (first_s, first, worst, worst_s, int(times), duration_s)
            if signals[i] not in self.machine.logic:
                found.append(Overload(signals[i], *facts))
        return tuple(sorted(found, key=lambda o: (o.time_s, o.signal)))

    def _play_to(self, score: Score, normals: Floats, stop_repeat: int, stop_cue: int) -> int:
        given = self._given(score, normals, stop_repeat, stop_cue)
        if len(self.deck.length_of):
            return int(play_limited_circuit(self.noise, self.random, *given, self.side, self.clock))
        self.lines.outcomes[0] = kernel.PAUSED  # whatever it came back for has been seen to
        outcome = self._play_lines(given, self.rows[None], self.lines, self.random)
        return outcome if outcome == kernel.PAUSED else int(self.lines.outcomes[0])

    def play_lines(self, records: Floats, lines: Lines, random: np.random.Generator | None) -> int:
        """Play on to the end of the present segment in all these runs; records: (runs, rows, pens).

        Gives PAUSED for a look at Ctrl-C, else DONE; `lines.outcomes` says what became of each.
        """
        score, repeats = self.scores[self.segment], self.segments[self.segment].repeats
        given = self._given(score, NO_DRAWS, repeats, 0)
        return self._play_lines(given, records, lines, random)

    def _play_lines(
        self,
        given: tuple[Any, ...],
        records: Floats,
        lines: Lines,
        random: np.random.Generator | None,
    ) -> int:
        shared = (self.side, self.noise, random, self.clock, lines)
        return int(play_circuits(*given[:ROWS], records, *given[ROWS + 1 :], *shared))


def _own(side: Side, noise: Noise | None) -> list[Array]:
    """What a run has to itself of its analog side."""
    figures = [getattr(side.circuit, name) for name in FIGURES]
    loud = [*noise.truth, *noise.blur] if noise else []
    return [*figures, *side.state, side.stopped_s, side.called_s, *loud]


def with_own(
    side: Side, noise: Noise | None, arrays: Iterator[Array]
) -> tuple[Side, Noise | None, Coupling]:
    """The analog side with these in the places of a run's own, and the converters."""

    def taken(kind: type[Any]) -> Any:
        return kind(*itertools.islice(arrays, len(kind._fields)))

    figures: dict[str, Any] = dict(zip(FIGURES, arrays, strict=False))
    circuit, state = side.circuit._replace(**figures), taken(CircuitState)
    stopped_s, called_s = next(arrays), next(arrays)
    if noise:
        noise = noise._replace(truth=taken(CircuitState), blur=taken(Blur))
    own = {"circuit": circuit, "state": state, "stopped_s": stopped_s, "called_s": called_s}
    return side._replace(**own), noise, taken(Coupling)


def settled(machine: Machine) -> tuple[list[float], dict[str, float]]:
    """Every signal at t = 0, in order, and what each integrator integrates then; machine units."""
    side, names = side_of(machine)
    values, drives = at_start(side, machine.analog.u0)
    refuse_undefined(machine, side.circuit, names, side.state.start)
    return values.tolist(), dict(zip(machine.analog.signals, drives.tolist(), strict=True))


def at_start(side: Side, inputs: Floats) -> tuple[Floats, Floats]:
    """The same of a side that has not started, both (signals,); inputs: all held ones of the machine."""
    settle_loops(side, inputs[side.held])
    # As a run begins, of which no window need be played, nor be compiled.
    settle(side.circuit, side.state, side.state, 0.0, 0.0, side.log, True, 0.0)
    return side.state.start[side.place], side.state.memory[side.place, DRIVE]


def side_of(machine: Machine) -> tuple[Side, tuple[str, ...]]:
    """The analog side of a run that has not started, and the names of its elements."""
    circuit, number = circuit_of(machine)
    inputs = machine.analog.inputs
    held = [
        inputs.index(name.removesuffix(":source"))
        for name, element in machine.elements
        if element.kind == INPUT
    ]
    grid, state = nodes(NODES), new_state(circuit, NODES)
    logic = machine.logic
    state.watched[[number[s] for s in machine.analog.signals if s not in logic]] = 1
    state.counts[ON_OVERLOAD] = machine.on_overload
    side = Side(
        circuit,
        state,
        shelf_for(circuit.laws),
        grid,
        new_log(),
        no_pen(),
        np.array([number[s] for s in machine.analog.signals], dtype=np.int64),
        np.array(held, dtype=np.int64),
        np.array([number.get(MODE_ELEMENT, -1)], dtype=np.int64),
        np.full(1, np.nan),
        np.zeros(1),
    )
    return side, tuple(number)


class _Shelves(threading.local):
    """Operators that the runs of a thread share: they depend on lags and window lengths alone."""

    def __init__(self) -> None:
        self.kept: OrderedDict[bytes, Shelf] = OrderedDict()


_shelves = _Shelves()


def shelf_for(laws: Floats) -> Shelf:
    """A shelf for these laws, with what earlier runs of this thread have put there."""
    kept, key = _shelves.kept, laws.tobytes()
    if key not in kept:
        kept[key] = new_shelf(len(laws))
        if len(kept) > MOST_SHELVES:
            kept.popitem(last=False)
    return kept[key]
