"""The reference as a player: whole runs with every lag resolved by SciPy, slow and independent.

Stage 4. Converters, program, events and record are those of the other engines, as the kernel plays them;
what lies between two instants is integrated by `Reference` at its tight tolerances.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hybrid.engine import kernel
from hybrid.engine.arrays import Floats, Score, State
from hybrid.engine.beyond import Overload
from hybrid.engine.forward import NotResolved
from hybrid.engine.linear import Player
from hybrid.engine.lost import Lost, runaway, steepest
from hybrid.engine.reference import Reference, RunsAway, method_for
from hybrid.engine.remarks import refuse_undefined
from hybrid.engine.sweep import CALLED, ENDED_BY
from hybrid.engine.too_often import Chatters, Count, Gathers
from hybrid.engine.windows import CircuitPlayer
from hybrid.modes import OP
from hybrid.scale import to_seconds

# Cues between two looks at the progress bar.
CHUNK_CUES = 50
# Of every signal, and a hundredth of it where that is zero: some hundred times better than what the
# nonlinear engine promises, without the steps becoming too short for the implicit method.
TOLERANCE = 1e-10
# Of the time, to see how fast signals change.
SOON = 1e-14
# Beyond full scale by more than the integrator's own error.
FULL_SCALE = 1.0 + 1e-9

OUTCOMES: dict[type[Exception], int] = {
    Chatters: kernel.CHATTERS,
    Gathers: kernel.GATHERS,
    RunsAway: kernel.RUNAWAY,
    NotResolved: kernel.NOT_RESOLVED,
}


@dataclass
class _Beyond:
    """How signals went beyond full scale, step by step; between steps they go straight."""

    last_s: float
    last: Floats  # (signals,)
    overloads: dict[int, list[float]] = field(default_factory=dict)

    def __call__(self, t_s: float, signals: Floats) -> None:
        """Go on to an instant."""
        before, now = np.abs(self.last), np.abs(signals)
        for i in np.flatnonzero((before > FULL_SCALE) | (now > FULL_SCALE)).tolist():
            self._note(i, t_s, float(self.last[i]), float(signals[i]))
        self.last_s, self.last = t_s, signals.copy()

    def _note(self, i: int, t_s: float, before: float, now: float) -> None:
        high, low = max(abs(before), abs(now)), min(abs(before), abs(now))
        share = 1.0 if low > 1.0 else (high - 1.0) / (high - low)
        rises, lasts_s = abs(now) > abs(before), t_s - self.last_s
        worst, worst_s = (now, t_s) if rises else (before, self.last_s)
        first_s = self.last_s + (lasts_s * (1.0 - share) if rises else 0.0)
        found = self.overloads.setdefault(i, [first_s, worst, worst, worst_s, 0, 0.0])
        if abs(worst) > abs(found[2]):
            found[2:4] = worst, worst_s
        found[4] += 1
        found[5] += share * lasts_s


class ReferencePlayer(CircuitPlayer):
    """One run of a machine whose analog side is a circuit, by SciPy."""

    plays_noise = False
    engine_error = None  # SciPy keeps its tolerance in each step and adds nothing up
    coarse_by = ""
    reference: Reference
    beyond: _Beyond
    count: Count

    def _first_state(self) -> State:
        """Every signal settled at t = 0."""
        state = Player._first_state(self)
        count = len(self.machine.analog.signals)
        shown = np.zeros(count + 1)  # and the machine's mode
        state = state._replace(v=np.concatenate([shown, state.v]), next_v=np.zeros(count + 1))
        circuit = self.side.circuit
        method = method_for(circuit, to_seconds(self.machine.timing.until))
        held = self.machine.analog.u0[self.side.held]
        with np.errstate(all="ignore"):
            self.reference = Reference(circuit, held, TOLERANCE, TOLERANCE / 100, method)
            settled = self.reference.signals()
        refuse_undefined(self.machine, circuit, self.names, settled)
        first = settled[self.side.place]
        self.beyond = _Beyond(0.0, first)
        self.reference.look = self._look
        state.v[:count], state.v[count] = first, self._mode(settled)
        self.calls.listen(self.side.state)
        self.reference.ends_at = self.calls.pieces
        self.count = Count(circuit, self.side.state.changes)
        self.reference.count = self.count
        self.reference.events.clear()
        return state

    def _mode(self, signals: Floats) -> float:
        """The machine's mode among the signals of all elements."""
        by = int(self.side.mode[0])
        return float(signals[by]) if by >= 0 else OP

    def _look(self, t_s: float, signals: Floats) -> None:
        """See every step of the integrator; signals of all elements."""
        self.beyond(t_s, signals[self.side.place])
        self.count.watch(signals)

    def _switched(self) -> bool:
        """Whether comparators that start tasks have switched; take note of which."""
        for _, element, piece in self.reference.events:
            if (element, piece) in self.reference.ends_at:
                self.calls.note(self.side.state, element, piece)
        self.reference.events.clear()
        return bool(self.side.state.counts[CALLED])

    def _chunk(self) -> int:
        return CHUNK_CUES

    def _play_to(self, score: Score, normals: Floats, stop_repeat: int, stop_cue: int) -> int:
        """Play on in the segment; why it ended."""
        counts = self.state.counts
        while True:
            outcome = Player._play_to(self, score, normals, stop_repeat, stop_cue)
            if outcome != kernel.WAITING:
                return outcome
            outcome = self._follow(score.cues[counts[kernel.CUE]].tolist())
            if outcome != kernel.WAITING:
                return outcome
            counts[kernel.CUE] += 1
            if counts[kernel.CUE] == len(score.cues):
                counts[kernel.CUE], counts[kernel.REPEAT] = 0, counts[kernel.REPEAT] + 1

    def _follow(self, cue: tuple[int, int, int]) -> int:
        """Advance the circuit to the cue's instant, or let it follow a jump; WAITING: done."""
        clock, reference = self.clock, self.reference
        start_s = clock.start_s + int(self.state.counts[kernel.REPEAT]) * clock.length_s
        v, inputs_at = self.state.v, self.plant.kept.shape[0]
        advances = cue[0] == kernel.ADVANCE
        if not advances:  # something has jumped
            reference.step_s = 0.0
        reference.now_s = began_s = start_s + float(clock.instants_s[cue[2] - advances])
        with np.errstate(all="ignore"):
            reference.follow(v[inputs_at + self.side.held])
        if self._switched() and advances:
            self.side.called_s[0] = 0.0
            return kernel.CALLED
        try:
            with np.errstate(all="ignore"):
                if advances:
                    reference.play(float(clock.intervals_s[cue[1]]))
                every = reference.signals()
        except (Chatters, Gathers, RunsAway, NotResolved) as reason:
            self.side.stopped_s[0] = reference.now_s
            self.side.state.counts[ENDED_BY] = self.count.ended_by
            return OUTCOMES[type(reason)]
        signals = every[self.side.place]
        self.beyond(reference.now_s, signals)
        v[: len(signals)], v[len(signals)] = signals, self._mode(every)
        if advances and self._switched():
            self.side.called_s[0] = reference.now_s - began_s
            return kernel.CALLED
        if np.all(np.abs(signals) <= kernel.RUNAWAY_MU):
            return kernel.WAITING
        self.side.stopped_s[0] = reference.now_s
        return kernel.RUNAWAY

    @property
    def lost(self) -> Lost | None:
        """Which signal went beyond any scale, or changes fastest where no step is short enough."""
        with np.errstate(all="ignore"):
            try:
                signals = self.reference.signals_after(0.0)
                soon = self.reference.signals_after(SOON * max(self.reference.now_s, SOON))
            except NotResolved:
                return self._farthest()
        if self.outcome == kernel.NOT_RESOLVED:
            return steepest(self.side.circuit, self.names, signals, soon)
        scale = kernel.RUNAWAY_MU / FULL_SCALE  # where it stops, but for its own error
        return runaway(self.side.circuit, self.names, signals, scale) or self._farthest()

    def _lit(self) -> frozenset[int]:
        return frozenset(int(self.side.place[i]) for i in self.beyond.overloads)

    def overloads(self) -> tuple[Overload, ...]:
        """Converters as the kernel saw them; analog signals at every step of the integrator."""
        signals = self.machine.analog.signals
        found = [o for o in Player.overloads(self) if o.signal not in signals]
        found += [
            Overload(signals[i], first_s, value, worst, worst_s, int(steps), float(lasts_s))
            for i, (first_s, value, worst, worst_s, steps, lasts_s) in self.beyond.overloads.items()
            if signals[i] not in self.machine.logic
        ]
        return tuple(sorted(found, key=lambda o: (o.time_s, o.signal)))
