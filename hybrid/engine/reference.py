"""The same circuit integrated by SciPy at tight tolerances, to check the other engines against.

Stage 4; `reference_player` plays whole runs with it. Every lag is a state and is resolved, pieces
change at located events, and nothing is shared with the engine but the flat `Circuit` and what counts
as chatter and as changes that gather (`switching`). Slow: lags of 1 us cost some 10^6 to 10^7
evaluations a machine second.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from hybrid.elements import (
    ANGLE,
    COS,
    INPUT,
    INTEGRATE,
    PIECES,
    POWER,
    PRODUCT,
    QUOTIENT,
    SIN,
    SINE,
    SQRT,
    SUM,
    SWITCH,
    TRACK,
)
from hybrid.engine.arrays import Floats
from hybrid.engine.circuit import (
    AMPLITUDE,
    AT,
    C0,
    C1,
    C2,
    CONSTANT,
    CONTROL,
    CORNER,
    END,
    END_PIECE,
    EXPONENT,
    FEEDBACK,
    FIRST,
    FIRST_PIECE,
    GAIN,
    HIGH,
    KIND,
    LAG,
    LEAK,
    LOW,
    OF_INTEGRATOR,
    OFFSET,
    OMEGA,
    OWNER,
    PHASE,
    ROLE,
    SECOND,
    SECOND_CONSTANT,
    STOP,
    Circuit,
)
from hybrid.engine.kernel import RUNAWAY_MU
from hybrid.engine.switching import since
from hybrid.engine.too_often import Chatters, Count, Gathers

# A guard this far beyond its bound at rest means another piece; events are located better than that.
SLACK = 1e-11
# One that does not get this far beyond its bound has not left it: so far rounding may take it.
ROUNDING = 1e-13
MOST_EVENTS = 10_000
# The slope of a guard is taken over this share of the time since it changed its piece.
SHORT = 1e-3

Method = Literal["DOP853", "Radau"]


class RunsAway(RuntimeError):
    """A signal is far beyond any scale, or no number."""


class NotResolved(RuntimeError):
    """The integrator found no step short enough."""


@dataclass
class Values:
    """Everything at one instant, for n elements."""

    signal: Floats  # (n,): outputs
    before: Floats  # (n,): outputs before their lags
    drive: Floats  # (n,): what integrators integrate
    guard: Floats  # (corners,)


class Part(NamedTuple):
    """One element in plain numbers, which Python reads faster than arrays."""

    kind: int
    first: list[tuple[int, float]]  # signal, gain
    second: list[tuple[int, float]]
    control: int
    corner: int
    stop: int
    rate: float  # of its lag, 1/s; -1: it has none
    figures: list[float]


def _parts(circuit: Circuit) -> list[Part]:
    terms = list(zip(circuit.signal.tolist(), circuit.gain.tolist(), strict=True))
    return [
        Part(
            row[KIND],
            terms[row[FIRST] : row[SECOND]],
            terms[row[SECOND] : row[END]],
            row[CONTROL],
            row[CORNER],
            row[STOP],
            float(circuit.laws[row[LAG], 0]) if row[LAG] >= 0 else -1.0,
            figures,
        )
        for row, figures in zip(circuit.rows.tolist(), circuit.figures.tolist(), strict=True)
    ]


@dataclass
class Reference:
    """One run in progress; `x` and `y` are the states of integrators and of lags.

    It knows no modes: its integrators are in OP.
    """

    circuit: Circuit
    held: Floats
    rtol: float = 1e-11
    atol: float = 1e-13
    method: Method = "DOP853"
    now_s: float = 0.0
    events: list[tuple[float, int, int]] = field(default_factory=list)  # time, element, new piece
    evaluations: int = 0
    step_s: float = 0.0  # to begin with; 0: the integrator finds one
    look: Callable[[float, Floats], None] | None = None  # shown time and signals after every step
    ends_at: frozenset[tuple[int, int]] = frozenset()  # element, new piece: at these play() ends
    count: Count | None = None  # where given, changes that come too often end it

    def __post_init__(self) -> None:
        """Start with lags settled, unless the circuit says otherwise."""
        rows, initial = self.circuit.rows, self.circuit.initial
        self.parts, self.pieces = _parts(self.circuit), self.circuit.pieces.tolist()
        self.first_piece = self.circuit.corners[:, FIRST_PIECE].tolist()
        self.x = np.where(rows[:, KIND] == INTEGRATE, initial[:, 0], 0.0)
        self.y = np.nan_to_num(initial[:, 1])
        self.stored = initial[:, 0].copy()
        self.stored_s = np.full(len(rows), self.now_s)
        self._freed: set[int] = set()  # limited integrators, at this instant
        self.stores = np.flatnonzero(rows[:, KIND] == TRACK).tolist()
        self.piece = self.circuit.initial_piece.tolist()
        follows = np.isnan(initial[:, 1]) & (rows[:, LAG] >= 0)
        for _ in range(len(rows) + 1):  # each pass settles at least one more lag of a chain
            self.y[follows] = self._settled(0.0).before[follows]
        self.events.clear()

    def signals(self) -> Floats:
        """Every signal now (n,)."""
        return self._settled(self.now_s).signal

    def signals_after(self, span_s: float) -> Floats:
        """Every signal (n,) so shortly after now that states go straight."""
        x, y = self.x, self.y
        z = np.concatenate([x, y])
        self.x, self.y = np.split(z + span_s * self._slope(self.now_s, z), 2)
        soon = self._values(self.now_s + span_s).signal
        self.x, self.y = x, y
        return soon

    def follow(self, held: Floats) -> None:
        """Take over what the caller holds from now on; stores keep what they had before."""
        before, were_high = self._values(self.now_s).before, self._open_stores()
        self.held = held
        self._keep(were_high - self._open_stores(), before)

    def _open_stores(self) -> set[int]:
        """Stores that follow their input now."""
        before = self._values(self.now_s).before.tolist()
        return {e for e in self.stores if self._is_high(self.parts[e].control, before)}

    def _keep(self, stores: set[int], before: Floats) -> None:
        """Stores that begin to hold keep these outputs."""
        for e in stores:
            self.stored[e], self.stored_s[e] = before[e], self.now_s

    def play(self, duration_s: float, instants_s: Floats | None = None) -> Floats:
        """Go on with the present held inputs; the signals at instants after the start (rows, n).

        Raises Chatters, Gathers, RunsAway and NotResolved; `now_s` says when, as it does where play()
        ends early.
        """
        instants = np.zeros(0) if instants_s is None else instants_s
        begin, end = self.now_s, self.now_s + duration_s
        if self.count:
            self.count.begin()
        rows = np.zeros((len(instants), len(self.circuit.rows)))
        self._settled(begin)
        for _ in range(MOST_EVENTS):
            solution = solve_ivp(
                self._slope,
                (self.now_s, end),
                np.concatenate([self.x, self.y]),
                self.method,
                rtol=self.rtol,
                atol=self.atol,
                events=[*self._events(), _far_out],
                dense_output=len(instants) > 0,
                first_step=min(self.step_s, end - self.now_s) or None,
            )
            self.evaluations += solution.nfev
            self._show(solution.t, solution.y)
            for row in np.flatnonzero(
                (begin + instants > self.now_s) & (begin + instants <= solution.t[-1])
            ):
                assert solution.sol is not None
                self.x, self.y = np.split(solution.sol(begin + instants[row]), 2)
                rows[row] = self._values(begin + instants[row]).signal
            self.x, self.y = np.split(solution.y[:, -1], 2)
            self.now_s = solution.t[-1]
            # The last step may have been cut short by the end.
            self.step_s = float(np.max(np.diff(solution.t)[-2:], initial=0.0))
            if solution.status < 0:
                raise NotResolved(solution.message)
            if solution.status == 0:
                return rows
            *times_s, lost = solution.t_events or []
            if len(lost):
                raise RunsAway("beyond any scale")
            before = len(self.events)
            self._change_piece(times_s)
            if any(event[1:] in self.ends_at for event in self.events[before:]):
                return rows
        raise Chatters(f"more than {MOST_EVENTS} events")

    def _show(self, times_s: Floats, states: Floats) -> None:
        """Let `look` see every step."""
        if self.look is None:
            return
        for t_s, z in zip(times_s.tolist(), states.T, strict=True):
            self.x, self.y = np.split(z, 2)
            self.look(t_s, self._values(t_s).signal)

    def _slope(self, t_s: float, z: Floats) -> Floats:
        self.x, self.y = np.split(z, 2)
        values = self._values(t_s)
        count = len(self.parts)
        slope = np.zeros(2 * count)
        for e, part in enumerate(self.parts):
            if part.kind == INTEGRATE and (part.corner < 0 or self.piece[part.corner] == 1):
                slope[e] = values.drive[e] + part.figures[FEEDBACK] * self.x[e]
            if part.rate >= 0.0:
                slope[count + e] = part.rate * (values.before[e] - self.y[e])
        return slope

    def _values(self, t_s: float) -> Values:
        """All signals for the present states and pieces, by forward substitution."""
        x, signal, count = self.x.tolist(), self.y.tolist(), len(self.parts)
        before, drive = [0.0] * count, [0.0] * count
        guard = [0.0] * len(self.circuit.corners)
        for e, part in enumerate(self.parts):
            if part.kind == INTEGRATE and part.rate < 0.0:
                signal[e] = self._output(part, x[e], guard)
        for e, part in enumerate(self.parts):
            figures, kind = part.figures, part.kind
            u, w = figures[CONSTANT], figures[SECOND_CONSTANT]
            for source, gain in part.first:
                u += gain * signal[source]
            for source, gain in part.second:
                w += gain * signal[source]
            if kind == INTEGRATE:
                drive[e], value = u, x[e]
                if part.corner >= 0:
                    free = self.piece[part.corner] == 1
                    guard[part.corner] = value if free else u + figures[FEEDBACK] * value
            elif kind == PIECES:
                guard[part.corner] = u
                value = self._piece_value(part.corner, u)
            elif kind == SWITCH:
                value = u if self._is_high(part.control, before) else w
            elif kind == TRACK:
                value = u
            elif kind == INPUT:
                value = float(self.held[part.control])
            elif kind == SINE:
                value = figures[AMPLITUDE] * math.sin(figures[OMEGA] * t_s + figures[PHASE])
            else:
                value = _FUNCTIONS[kind](u, w, figures[EXPONENT])
                if kind == ANGLE:
                    value, guard[part.corner] = _angle(value, self.piece[part.corner])
            if kind == TRACK and not self._is_high(part.control, before):
                age_s = t_s - self.stored_s[e]
                before[e] = float(self.stored[e]) * math.exp(-figures[LEAK] * age_s)
            else:
                before[e] = self._output(part, value, guard)
            if part.rate < 0.0:
                signal[e] = before[e]
        return Values(np.array(signal), np.array(before), np.array(drive), np.array(guard))

    def _output(self, part: Part, value: float, guard: list[float]) -> float:
        value = part.figures[GAIN] * value + part.figures[OFFSET]
        if part.stop >= 0:
            guard[part.stop] = value
            value = self._piece_value(part.stop, value)
        return value

    def _row(self, corner: int) -> list[float]:
        row: list[float] = self.pieces[self.first_piece[corner] + self.piece[corner]]
        return row

    def _piece_value(self, corner: int, g: float) -> float:
        row = self._row(corner)
        x = g - row[AT]
        return row[C0] + row[C1] * x + row[C2] * x * x

    def _is_high(self, by: int, before: list[float]) -> bool:
        part = self.parts[by]
        return self.piece[part.corner] > 0 if part.kind == PIECES else before[by] > 0.5

    def _settled(self, t_s: float) -> Values:
        """Values at an instant, after every piece that does not hold has been changed."""
        for _ in range(MOST_EVENTS):
            values = self._values(t_s)
            for corner in range(len(self.circuit.corners)):
                step = self._outside(corner, values)
                if step != 0:
                    self._go(corner, step)
                    break
            else:
                return values
        raise Chatters("pieces do not settle")

    def _outside(self, corner: int, v: Values) -> int:
        """Which way the guard is out of its piece."""
        row, g = self._row(corner), v.guard[corner]
        slack = SLACK * max(1.0, abs(g))
        e = self.circuit.corners[corner, OWNER]
        if self.circuit.corners[corner, ROLE] == OF_INTEGRATOR and self.piece[corner] == 1:
            if corner in self._freed:
                return 0
            drive = v.drive[e] + self.circuit.figures[e, FEEDBACK] * g
            if g >= row[HIGH] and drive > SLACK * max(1.0, abs(drive)):
                return 1
            return -1 if g <= row[LOW] and drive < -SLACK * max(1.0, abs(drive)) else 0
        if g > row[HIGH] + slack:
            return 1
        return -1 if g < row[LOW] - slack else 0

    def _go(self, corner: int, step: int) -> None:
        e = self.circuit.corners[corner, OWNER]
        before = self._values(self.now_s)
        self.piece[corner] += step
        self.step_s = 0.0
        assert self.piece[corner] < self.circuit.corners[corner, END_PIECE]
        self.events.append((self.now_s, int(e), int(self.piece[corner])))
        if self.circuit.corners[corner, ROLE] == OF_INTEGRATOR and self.piece[corner] != 1:
            self.x[e] = self._row(corner)[C0]
        if step < 0:
            self._keep({s for s in self.stores if self.parts[s].control == e}, before.before)

    def _events(self) -> list[Callable[[float, Floats], float]]:
        """A terminal event for each bound of each present piece.

        What another event has left a rounding beyond its bound would never cross it, so that it changes
        a little further out.
        """
        found = []
        self._watched: list[tuple[int, int]] = []
        guard = self._values(self.now_s).guard
        for corner in range(len(self.circuit.corners)):
            row, g = self._row(corner), guard[corner]
            for bound, step in ((row[HIGH], 1), (row[LOW], -1)):
                if math.isfinite(bound):
                    beyond = step * (g - bound) >= 0.0
                    further = 2.0 * SLACK if beyond else ROUNDING
                    at = bound + step * further * max(1.0, abs(g))
                    found.append(self._event(corner, at, step))
                    self._watched.append((corner, step))
        return found

    def _event(self, corner: int, bound: float, step: int) -> Callable[[float, Floats], float]:
        def event(t_s: float, z: Floats) -> float:
            self.x, self.y = np.split(z, 2)
            return float(self._values(t_s).guard[corner] - bound)

        event.terminal = True  # type: ignore[attr-defined]
        event.direction = float(step)  # type: ignore[attr-defined]
        return event

    def _change_piece(self, times_s: list[Floats]) -> None:
        """Change what has come to its bound, and all that follows; raises Chatters and Gathers.

        Time has no digits to tell that a drive is beyond 0 by more than SLACK where it falls fast, so
        that an integrator which it has just freed is not stopped again at the same instant.
        """
        reason: Chatters | Gathers | None = None
        for (corner, step), times in zip(self._watched, times_s, strict=True):
            if len(times):
                try:
                    self._count(corner, step)
                except (Chatters, Gathers) as too_often:
                    reason = too_often
                self._go(corner, step)
                if self.circuit.corners[corner, ROLE] == OF_INTEGRATOR and self.piece[corner] == 1:
                    self._freed.add(corner)
        self._settled(self.now_s)
        self._freed.clear()
        if reason:
            raise reason

    def _count(self, corner: int, step: int) -> None:
        """Count a change that is due.

        A guard that falls back as a ball does, at a constant rate, swings by slope * interval / 4.
        """
        if self.count:
            row = self._row(corner)
            span_s = since(self.count.changes, corner, step, self.now_s)
            swing = 0.25 * abs(self._guard_slope(corner, SHORT * span_s)) * span_s
            bound = row[HIGH] if step > 0 else row[LOW]
            self.count.add(corner, step, bound, swing, self.now_s)

    def _guard_slope(self, corner: int, over_s: float) -> float:
        """How fast a guard moves now, in its unit a second; infinite where there is no time to see."""
        if not 0.0 < over_s < math.inf:
            return math.inf
        x, y = self.x, self.y
        before = self._values(self.now_s).guard[corner]
        z = np.concatenate([x, y])
        self.x, self.y = np.split(z + over_s * self._slope(self.now_s, z), 2)
        after = self._values(self.now_s + over_s).guard[corner]
        self.x, self.y = x, y
        return float(after - before) / over_s


def _angle(angle: float, piece: int) -> tuple[float, float]:
    """An angle beyond its cut, and how far it is from where its piece, 0 below or 1 above, ends."""
    side = 1.0 if piece else -1.0
    turned = side * angle
    if turned < -0.5 * math.pi:
        turned += 2.0 * math.pi
    return side * turned, side * (math.pi - turned) * (turned + 1.0)


def _far_out(t_s: float, z: Floats) -> float:
    """An event where a state is beyond any scale; one that is no number is not within it either."""
    within = np.abs(z) <= RUNAWAY_MU
    return -1.0 if not within.all() else float(RUNAWAY_MU - np.max(np.abs(z), initial=0.0))


_far_out.terminal = True  # type: ignore[attr-defined]

_FUNCTIONS: dict[int, Callable[[float, float, float], float]] = {
    SUM: lambda u, w, p: u,
    PRODUCT: lambda u, w, p: u * w,
    QUOTIENT: lambda u, w, p: float(np.divide(u, w)),
    SQRT: lambda u, w, p: math.sqrt(max(u, 0.0)),
    SIN: lambda u, w, p: float(np.sin(u)),
    COS: lambda u, w, p: float(np.cos(u)),
    ANGLE: lambda u, w, p: float(np.arctan2(u, w)),
    POWER: lambda u, w, p: math.copysign(abs(u) ** p, u),
}
