"""The nonlinear engine as a player: what lies between two instants is played by `relaxation`.

Stage 4. Everything else (converters, program, record) is the exact engine's: its kernel comes back
wherever the analog side must be advanced, or must follow a jump. Overloads of analog signals are those
that the circuit saw, also between instants.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import NamedTuple

import numpy as np

from hybrid.elements import INPUT
from hybrid.engine import kernel
from hybrid.engine.calls import Calls
from hybrid.engine.circuit import Builder, Circuit
from hybrid.engine.compiling import allocating, compiled
from hybrid.engine.corners import Log, new_log, settle
from hybrid.engine.kernel import Coupling, Deck, Floats, Ints, Pens, Plant, Score, State
from hybrid.engine.limited import compute
from hybrid.engine.linear import Overload, Player
from hybrid.engine.nodes import RESOLUTION, Nodes, Shelf, new_shelf, nodes
from hybrid.engine.noise import Noise, jump, new_noise
from hybrid.engine.relaxation import (
    CHATTER,
    GATHERED,
    OVERLOADED,
    RUNAWAY,
    SWITCHED,
    advance,
    hold_for_good,
    no_pen,
)
from hybrid.engine.relaxation import Pen as WindowPen
from hybrid.engine.remarks import chattering, ended_by, refuse_undefined
from hybrid.engine.sweep import (
    DRIVE,
    FROZEN,
    ON_OVERLOAD,
    OVERLOAD_S,
    SUM_OF_ERRORS,
    TIMES,
    WINDOWS,
    new_state,
)
from hybrid.engine.sweep import State as CircuitState
from hybrid.machine import Machine
from hybrid.modes import MODE_ELEMENT, OP, STOP_RUN
from hybrid.scale import to_seconds, to_ticks

NODES = 8
# Instants between two looks at Ctrl-C.
CHUNK_ADVANCES = 2000
# Windows after which no further instant is begun: some tenths of a second where something switches fast.
CHUNK_WINDOWS = 10_000
# Sets of laws whose operators are kept, in each thread.
MOST_SHELVES = 8
# To let loops settle before a run.
MOST_PASSES = 1000


class Side(NamedTuple):
    """The analog side of one run: the circuit, its state and where its signals and inputs stand."""

    circuit: Circuit
    state: CircuitState
    shelf: Shelf
    grid: Nodes
    log: Log
    no_pen: WindowPen
    place: Ints  # (signals,): element of each signal
    held: Ints  # (inputs of the circuit,): which of the machine's held inputs
    mode: Ints  # (1,): the element that gives the machine's mode; -1: it is always in OP
    stopped_s: Floats  # (1,): when it could not go on; nan: it could
    called_s: Floats  # (1,): how far into an interval a task was called that a comparator starts


class Clock(NamedTuple):
    """Times of one segment, in s."""

    start_s: float
    length_s: float
    instants_s: Floats  # (instants,): offsets
    intervals_s: Floats  # (intervals,)


@compiled
def follow(
    side: Side, noise: Noise | None, plant: Plant, state: State, t_s: float, duration_s: float
) -> int:
    """Advance the circuit (by nothing: let it follow a jump) and show its signals; why it ended."""
    v, inputs_at = state.v, plant.kept.shape[0]
    for i in range(side.held.shape[0]):
        side.state.held[i] = v[inputs_at + side.held[i]]
    why, done_s = advance(
        side.circuit,
        side.state,
        side.shelf,
        side.grid,
        t_s,
        duration_s,
        RESOLUTION,
        side.log,
        side.no_pen,
        noise,
    )
    for s in range(side.place.shape[0]):
        if noise is None:
            v[s] = side.state.start[side.place[s]]
        else:
            v[s] = noise.truth.start[side.place[s]]
    v[side.place.shape[0]] = side.state.start[side.mode[0]] if side.mode[0] >= 0 else OP
    if why == 0 or (why == SWITCHED and duration_s == 0.0):  # of an instant, all is done first
        return kernel.WAITING
    if why == SWITCHED:
        side.called_s[0] = done_s
        return kernel.CALLED
    side.stopped_s[0] = t_s + done_s
    if why == RUNAWAY:
        return kernel.RUNAWAY
    if why == OVERLOADED:
        return kernel.OVERLOADED
    if why == GATHERED:
        return kernel.GATHERS
    return kernel.CHATTERS if why == CHATTER else kernel.NOT_RESOLVED


@compiled
def _hold_now(score: Score, side: Side, noise: Noise | None, clock: Clock, state: State) -> None:
    """A converter is beyond its range: put the machine into HOLD at the cue that found it."""
    count = state.counts
    count[kernel.STOPS] = kernel.NEVER
    if side.state.counts[FROZEN] > 0:
        return
    now_s = clock.start_s + count[kernel.REPEAT] * clock.length_s
    now_s += clock.instants_s[score.cues[count[kernel.CUE], 2]]
    side.state.clock[OVERLOAD_S] = now_s
    hold_for_good(side.circuit, side.state, now_s, 0.0, side.log)
    if noise is not None:
        jump(side.circuit, side.state, noise, now_s, 0.0)


@allocating
def play_circuit(
    score: Score,
    plant: Plant,
    coupling: Coupling,
    deck: Deck,
    pens: Pens,
    state: State,
    normals: Floats,
    rows: Floats,
    keep_every: int,
    stop_repeat: int,
    stop_cue: int,
    side: Side,
    noise: Noise | None,
    clock: Clock,
) -> int:
    """Like `kernel.play`, with the circuit as the analog side; at most CHUNK_ADVANCES instants."""
    cues, count = score.cues, state.counts
    last = side.state.counts[WINDOWS] + CHUNK_WINDOWS
    for _ in range(CHUNK_ADVANCES):
        if side.state.counts[WINDOWS] > last:
            break
        outcome = kernel.play(
            score,
            plant,
            coupling,
            deck,
            pens,
            state,
            normals,
            rows,
            keep_every,
            stop_repeat,
            stop_cue,
        )
        if outcome == kernel.OVERLOADED and side.state.counts[ON_OVERLOAD] != STOP_RUN:
            _hold_now(score, side, noise, clock, state)
            continue
        if outcome != kernel.WAITING:
            return int(outcome)
        cue = count[kernel.CUE]
        at = cues[cue, 2]
        t_s, duration_s = clock.start_s + count[kernel.REPEAT] * clock.length_s, 0.0
        if cues[cue, 0] == kernel.ADVANCE:
            duration_s = clock.intervals_s[cues[cue, 1]]
            t_s += clock.instants_s[at - 1]
        else:
            t_s += clock.instants_s[at]
        outcome = follow(side, noise, plant, state, t_s, duration_s)
        if outcome != kernel.WAITING:
            return int(outcome)
        count[kernel.CUE] += 1
        if count[kernel.CUE] == cues.shape[0]:
            count[kernel.CUE], count[kernel.REPEAT] = 0, count[kernel.REPEAT] + 1
    return kernel.PAUSED


@allocating
def play_limited_circuit(
    score: Score,
    plant: Plant,
    coupling: Coupling,
    deck: Deck,
    pens: Pens,
    state: State,
    normals: Floats,
    rows: Floats,
    keep_every: int,
    stop_repeat: int,
    stop_cue: int,
    side: Side,
    noise: Noise | None,
    clock: Clock,
) -> int:
    """The same for programs of limited word length, a cycle of which is computed between two calls."""
    last = side.state.counts[WINDOWS] + CHUNK_WINDOWS
    for _ in range(CHUNK_ADVANCES):
        if side.state.counts[WINDOWS] > last:
            break
        outcome = play_circuit(
            score,
            plant,
            coupling,
            deck,
            pens,
            state,
            normals,
            rows,
            keep_every,
            stop_repeat,
            stop_cue,
            side,
            noise,
            clock,
        )
        if outcome != kernel.COMPUTES:
            return int(outcome)
        if compute(score, deck, state):
            return int(kernel.OVERFLOWED)
    return kernel.PAUSED


@allocating
def begin(side: Side, noise: Noise | None, plant: Plant, state: State, held: Floats) -> None:
    """Let loops come to rest with these figures at the inputs, and every signal follow, at t = 0."""
    settle_loops(side, held)
    follow(side, noise, plant, state, 0.0, 0.0)


@allocating
def settle_loops(side: Side, held: Floats) -> None:
    """Let loops of lagged parts come to rest before the run, with these figures at the inputs.

    Each pass lets every output that follows at once or settles follow its inputs; in a loop of gain
    below 1 the passes converge. Where they do not, the run begins from a single pass, as a circuit does.
    """
    state = side.state
    state.held[:] = held
    start, memory, piece = state.start.copy(), state.memory.copy(), state.piece.copy()
    for _ in range(MOST_PASSES):
        before = state.start.copy()
        settle(side.circuit, state, state, 0.0, 0.0, side.log, True, 0.0)
        rests = True
        for e in range(before.shape[0]):  # never, where a quotient has no figure
            size = max(1.0, abs(before[e]))
            rests = rests and abs(state.start[e] - before[e]) <= 1e-15 * size
        if rests:
            return
    state.start[:], state.memory[:, :], state.piece[:] = start, memory, piece


class CircuitPlayer(Player):
    """One run of a machine whose analog side is a circuit."""

    side: Side
    names: tuple[str, ...]  # of the circuit's elements
    noise: Noise | None
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
        instant = int(self.scores[self.segment].cues[cue, 2]) - 1  # all of it is done
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
        self.noise = new_noise(circuit, self._normals, NODES) if len(circuit.noisy) else None
        self.intervals_s = np.array([to_seconds(t) for t in intervals])
        signals, inputs = len(self.machine.analog.signals), len(self.machine.analog.inputs)
        return Plant(
            np.zeros((0, 0, inputs, 8)),
            np.zeros(signals + 1),  # and the machine's mode
            np.zeros(len(intervals), dtype=np.int64),
            np.arange(signals),
            np.zeros((inputs, 0)),
        )

    def _first_state(self) -> State:
        """Every signal settled at t = 0."""
        state = super()._first_state()
        count = len(self.machine.analog.signals) + 1
        v = np.concatenate([np.zeros(count), state.v])
        state = state._replace(v=v, next_v=np.zeros(count))
        begin(self.side, self.noise, self.plant, state, state.v[count + self.side.held])
        refuse_undefined(self.machine, self.side.circuit, self.names, self.side.state.start)
        self.calls.listen(self.side.state)
        return state

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
        return float(self.side.state.clock[SUM_OF_ERRORS])

    def remarks(self) -> tuple[str, ...]:
        """Parts that chatter."""
        return chattering(self.side.circuit, self.names, self.side.state.changes)

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
        play = play_limited_circuit if len(self.deck.length_of) else play_circuit
        outcome: int = play(
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
            self.side,
            self.noise,
            self.clock,
        )
        return outcome


def settled(machine: Machine) -> tuple[list[float], dict[str, float]]:
    """Every signal at t = 0, in order, and what each integrator integrates then; machine units."""
    side, names = side_of(machine)
    settle_loops(side, machine.analog.u0[side.held])
    advance(
        side.circuit,
        side.state,
        side.shelf,
        side.grid,
        0.0,
        0.0,
        RESOLUTION,
        side.log,
        side.no_pen,
        None,  # at t = 0 there is none yet
    )
    refuse_undefined(machine, side.circuit, names, side.state.start)
    values = side.state.start[side.place].tolist()
    drives = zip(machine.analog.signals, side.state.memory[side.place, DRIVE].tolist(), strict=True)
    return values, dict(drives)


def side_of(machine: Machine) -> tuple[Side, tuple[str, ...]]:
    """The analog side of a run that has not started, and the names of its elements."""
    builder = Builder()
    inputs = machine.analog.inputs
    held = []
    for name, element in machine.elements:
        builder.add(name, element)
        if element.kind == INPUT:
            builder.inputs.append(name)
            held.append(inputs.index(name.removesuffix(":source")))
    circuit, number = builder.build()
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
