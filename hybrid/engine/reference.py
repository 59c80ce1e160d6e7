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
from typing import Literal

import numpy as np
from scipy.integrate import solve_ivp

from hybrid.elements import INTEGRATE, TRACK
from hybrid.engine.arrays import Floats
from hybrid.engine.circuit import (
    C0,
    END_PIECE,
    HIGH,
    KIND,
    LAG,
    LOW,
    OF_INTEGRATOR,
    OWNER,
    ROLE,
    Circuit,
)
from hybrid.engine.forward import Forward, NotResolved, Values
from hybrid.engine.kernel import RUNAWAY_MU
from hybrid.engine.switching import since
from hybrid.engine.too_often import Chatters, Count, Gathers
from hybrid.modes import IC

# A guard this far beyond its bound at rest means another piece; events are located better than that.
SLACK = 1e-11
# One that does not get this far beyond its bound has not left it: so far rounding may take it.
ROUNDING = 1e-13
MOST_EVENTS = 10_000
# As the engine settles loops of lags before the run.
MOST_PASSES = 1000
# The slope of a guard is taken over this share of the time since it changed its piece.
SHORT = 1e-3

Method = Literal["DOP853", "Radau"]
# An explicit method takes steps of a lag or two, however smooth the signals are; with more of the
# shortest lag than this in the run, the implicit method is faster.
MANY_LAGS = 1000


def method_for(circuit: Circuit, until_s: float) -> Method:
    """The method that is the faster one for so long a run."""
    shortest_s = float(circuit.taus_s[0]) if len(circuit.taus_s) else 0.0
    return "Radau" if until_s > MANY_LAGS * shortest_s > 0.0 else "DOP853"


class RunsAway(RuntimeError):
    """A signal is far beyond any scale, or no number."""


@dataclass
class Reference:
    """One run in progress; `x` is what integrators and stores remember, `y` what lags do, both (n,).

    In IC an integrator follows its initial value, as a store does that is open its input; `x` has what
    they followed last, which they keep where a jump sets them free.
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
        self.forward = Forward(self.circuit, self.held)
        self.piece = self.forward.piece
        self.x = np.where(np.isin(rows[:, KIND], (INTEGRATE, TRACK)), initial[:, 0], 0.0)
        self.y = np.nan_to_num(initial[:, 1])
        self._crossed: dict[
            int, float
        ] = {}  # guards of corners that come to a bound at this instant
        follows = np.isnan(initial[:, 1]) & (rows[:, LAG] >= 0)
        self.forward.starting = True
        self._settle_lags(follows)
        self.forward.starting = False
        self._settled(0.0)
        self.events.clear()

    def _settle_lags(self, follows: np.typing.NDArray[np.bool_]) -> None:
        """Let the lags that follow their inputs before the run come to rest, those in loops, too."""
        rows, initial = self.circuit.rows, self.circuit.initial
        stores = rows[:, KIND] == TRACK

        def settle() -> None:
            self.x[stores] = initial[stores, 0]  # what opens one on the way does not count
            self.y[follows] = self._settled(0.0).before[follows]

        for _ in range(len(rows) + 1):  # each pass settles at least one more lag of a chain
            settle()
        given, piece = self.y.copy(), list(self.piece)
        for _ in range(MOST_PASSES):  # and of a loop a part, where its gain is below 1
            before = self.y.copy()
            settle()
            moved = np.abs(self.y - before)
            if np.all(moved <= 1e-15 * np.maximum(1.0, np.abs(before))):
                return
            if not np.all(moved < RUNAWAY_MU):
                break
        self.y[:], self.piece[:] = given, piece

    def signals(self) -> Floats:
        """Every signal now (n,)."""
        return self.values().signal

    def values(self) -> Values:
        """Everything now."""
        return self._settled(self.now_s)

    def signals_after(self, span_s: float) -> Floats:
        """Every signal (n,) so shortly after now that states go straight."""
        x, y = self.x, self.y
        z = np.concatenate([x, y])
        self.x, self.y = np.split(z + span_s * self._slope(self.now_s, z), 2)
        soon = self._values(self.now_s + span_s).signal
        self.x, self.y = x, y
        return soon

    def follow(self, held: Floats) -> None:
        """Take over what the caller holds from now on."""
        self.held = self.forward.held = held

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
            self.x = self._values(self.now_s).kept
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
        count = len(self.x)
        slope = np.zeros(2 * count)
        for e, part in enumerate(self.forward.parts):
            if part.corner < 0 or part.kind != INTEGRATE or self.piece[part.corner] == 1:
                slope[e] = values.drive[e]
            if part.rate >= 0.0:
                slope[count + e] = part.rate * (values.before[e] - self.y[e])
        return slope

    def _values(self, t_s: float) -> Values:
        """All signals for the present states and pieces."""
        return self.forward.values(t_s, self.x, self.y)

    def _settled(self, t_s: float) -> Values:
        """Values right after a jump, every piece that does not hold having been changed in order.

        What comes before such a piece in the order has followed by then, and keeps that where a change
        sets it free; what comes after it has not.
        """
        for _ in range(MOST_EVENTS):
            values = self.forward.once(t_s, self.x, self.y)
            for corner in range(len(self.circuit.corners)):
                step = self._outside(corner, values)
                if step != 0:
                    done = self.circuit.corners[corner, OWNER]
                    self.x[:done] = values.kept[:done]
                    self._go(corner, step)
                    break
            else:
                followed = self.forward.moves(self.x, values.kept)
                self.x = values.kept
                if not followed:
                    return values
        raise Chatters("pieces do not settle")

    def _outside(self, corner: int, v: Values) -> int:
        """Which way the guard is out of its piece."""
        row, g = self.forward.row(corner), v.guard[corner]
        slack = SLACK * max(1.0, abs(g))
        e = self.circuit.corners[corner, OWNER]
        stops = self.circuit.corners[corner, ROLE] == OF_INTEGRATOR and v.mode[e] != IC
        if stops and self.piece[corner] == 1:
            if corner in self._crossed:
                return 0
            drive = v.drive[e]
            if g >= row[HIGH] and drive > SLACK * max(1.0, abs(drive)):
                return 1
            return -1 if g <= row[LOW] and drive < -SLACK * max(1.0, abs(drive)) else 0
        if g == self._crossed.get(corner):
            return 0
        if g > row[HIGH] + slack:
            return 1
        return -1 if g < row[LOW] - slack else 0

    def _go(self, corner: int, step: int) -> None:
        e = self.circuit.corners[corner, OWNER]
        self.piece[corner] += step
        self.step_s = 0.0
        assert self.piece[corner] < self.circuit.corners[corner, END_PIECE]
        self.events.append((self.now_s, int(e), int(self.piece[corner])))
        if self.circuit.corners[corner, ROLE] == OF_INTEGRATOR and self.piece[corner] != 1:
            self.x[e] = self.forward.row(corner)[C0]

    def _events(self) -> list[Callable[[float, Floats], float]]:
        """A terminal event for each bound of each present piece.

        What another event has left a rounding beyond its bound would never cross it, so that it changes
        a little further out.
        """
        found = []
        self._watched: list[tuple[int, int]] = []
        guard = self._values(self.now_s).guard
        for corner in range(len(self.circuit.corners)):
            row, g = self.forward.row(corner), guard[corner]
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

        Time has no digits to tell on which side of its bound a fast guard is, by more than SLACK: so
        what has just left its piece is not put back at the same instant, but where something jumps, nor
        is an integrator stopped again which its drive has just freed.
        """
        reason: Chatters | Gathers | None = None
        guard = self._values(self.now_s).guard
        for (corner, step), times in zip(self._watched, times_s, strict=True):
            if len(times):
                try:
                    self._count(corner, step)
                except (Chatters, Gathers) as too_often:
                    reason = too_often
                self._go(corner, step)
                self._crossed[corner] = float(guard[corner])
        self._settled(self.now_s)
        self._crossed.clear()
        if reason:
            raise reason

    def _count(self, corner: int, step: int) -> None:
        """Count a change that is due.

        A guard that falls back as a ball does, at a constant rate, swings by slope * interval / 4.
        """
        if self.count:
            row = self.forward.row(corner)
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


def _far_out(t_s: float, z: Floats) -> float:
    """An event where a state is beyond any scale; one that is no number is not within it either."""
    within = np.abs(z) <= RUNAWAY_MU
    return -1.0 if not within.all() else float(RUNAWAY_MU - np.max(np.abs(z), initial=0.0))


_far_out.terminal = True  # type: ignore[attr-defined]
