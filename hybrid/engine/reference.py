"""The same circuit integrated by SciPy at tight tolerances, to check the nonlinear engine against.

Stage 4. Every lag is a state and is resolved, pieces change at located events, and nothing but the flat
`Circuit` is shared with the engine. Slow: a lag of 1 us costs some 10^5 evaluations per second.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.integrate import solve_ivp

from hybrid.elements import (
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
from hybrid.engine.kernel import Floats

# A guard this far beyond its bound at rest means another piece; events are located better than that.
SLACK = 1e-11
MOST_EVENTS = 10_000


@dataclass
class Values:
    """Everything at one instant, for n elements."""

    signal: Floats  # (n,): outputs
    before: Floats  # (n,): outputs before their lags
    drive: Floats  # (n,): what integrators integrate
    guard: Floats  # (corners,)


@dataclass
class Reference:
    """One run in progress; `x` and `y` are the states of integrators and of lags."""

    circuit: Circuit
    held: Floats
    rtol: float = 1e-11
    atol: float = 1e-13
    method: Literal["DOP853", "Radau"] = "DOP853"
    now_s: float = 0.0
    events: list[tuple[float, int, int]] = field(default_factory=list)  # time, element, new piece
    evaluations: int = 0

    def __post_init__(self) -> None:
        """Start with lags settled, unless the circuit says otherwise."""
        rows, initial = self.circuit.rows, self.circuit.initial
        self.x = np.where(rows[:, KIND] == INTEGRATE, initial[:, 0], 0.0)
        self.y = np.nan_to_num(initial[:, 1])
        self.stored = initial[:, 0].copy()
        self.piece = self.circuit.initial_piece.copy()
        follows = np.isnan(initial[:, 1]) & (rows[:, LAG] >= 0)
        for _ in range(len(rows) + 1):  # each pass settles at least one more lag of a chain
            self.y[follows] = self._settled(0.0).before[follows]
        self.events.clear()

    def signals(self) -> Floats:
        """Every signal now (n,)."""
        return self._settled(self.now_s).signal

    def play(self, duration_s: float, instants_s: Floats | None = None) -> Floats:
        """Go on with the present held inputs; the signals at instants after the start (rows, n)."""
        instants = np.zeros(0) if instants_s is None else instants_s
        begin, end = self.now_s, self.now_s + duration_s
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
                events=self._events() or None,
                dense_output=len(instants) > 0,
            )
            self.evaluations += solution.nfev
            for row in np.flatnonzero(
                (begin + instants > self.now_s) & (begin + instants <= solution.t[-1])
            ):
                assert solution.sol is not None
                self.x, self.y = np.split(solution.sol(begin + instants[row]), 2)
                rows[row] = self._values(begin + instants[row]).signal
            self.x, self.y = np.split(solution.y[:, -1], 2)
            self.now_s = solution.t[-1]
            if solution.status != 1:
                return rows
            self._change_piece(solution.t_events or [])
        raise RuntimeError(f"more than {MOST_EVENTS} events")

    def _slope(self, t_s: float, z: Floats) -> Floats:
        rows, laws = self.circuit.rows, self.circuit.laws
        self.x, self.y = np.split(z, 2)
        values = self._values(t_s)
        dx, dy = np.zeros(len(rows)), np.zeros(len(rows))
        for e, row in enumerate(rows):
            if row[KIND] == INTEGRATE and (row[CORNER] < 0 or self.piece[row[CORNER]] == 1):
                dx[e] = values.drive[e] + self.circuit.figures[e, FEEDBACK] * self.x[e]
            if row[LAG] >= 0:
                dy[e] = laws[row[LAG], 0] * (values.before[e] - self.y[e])
        return np.concatenate([dx, dy])

    def _values(self, t_s: float) -> Values:
        """All signals for the present states and pieces, by forward substitution."""
        circuit, rows = self.circuit, self.circuit.rows
        n = len(rows)
        v = Values(self.y.copy(), np.zeros(n), np.zeros(n), np.zeros(len(circuit.corners)))
        for e in np.flatnonzero((rows[:, KIND] == INTEGRATE) & (rows[:, LAG] < 0)).tolist():
            v.signal[e] = self._output(e, self.x[e], v)
        for e, row in enumerate(rows.tolist()):
            figures = circuit.figures[e]
            u = figures[CONSTANT] + self._terms(v.signal, row[FIRST], row[SECOND])
            w = figures[SECOND_CONSTANT] + self._terms(v.signal, row[SECOND], row[END])
            kind = row[KIND]
            if kind == INTEGRATE:
                v.drive[e] = u
                if row[CORNER] >= 0:
                    free = self.piece[row[CORNER]] == 1
                    v.guard[row[CORNER]] = self.x[e] if free else u + figures[FEEDBACK] * self.x[e]
                value = self.x[e]
            elif kind == PIECES:
                v.guard[row[CORNER]] = u
                value = self._piece_value(row[CORNER], u)
            elif kind in (SWITCH, TRACK):
                value = (
                    u
                    if self._is_high(row[CONTROL], v)
                    else (w if kind == SWITCH else self.stored[e])
                )
            elif kind == INPUT:
                value = self.held[row[CONTROL]]
            elif kind == SINE:
                value = figures[AMPLITUDE] * math.sin(figures[OMEGA] * t_s + figures[PHASE])
            else:
                value = _FUNCTIONS[kind](u, w, figures[EXPONENT])
            v.before[e] = self._output(e, value, v)
            if row[LAG] < 0:
                v.signal[e] = v.before[e]
        return v

    def _terms(self, signal: Floats, first: int, end: int) -> float:
        return float(self.circuit.gain[first:end] @ signal[self.circuit.signal[first:end]])

    def _output(self, e: int, value: float, v: Values) -> float:
        value = self.circuit.figures[e, GAIN] * value + self.circuit.figures[e, OFFSET]
        stop = self.circuit.rows[e, STOP]
        if stop >= 0:
            v.guard[stop] = value
            value = self._piece_value(stop, value)
        return float(value)

    def _row(self, corner: int) -> Floats:
        row: Floats = self.circuit.pieces[
            self.circuit.corners[corner, FIRST_PIECE] + self.piece[corner]
        ]
        return row

    def _piece_value(self, corner: int, g: float) -> float:
        row = self._row(corner)
        x = g - row[AT]
        return float(row[C0] + row[C1] * x + row[C2] * x * x)

    def _is_high(self, by: int, v: Values) -> bool:
        if self.circuit.rows[by, KIND] == PIECES:
            return bool(self.piece[self.circuit.rows[by, CORNER]] > 0)
        return bool(v.signal[by] > 0.5)

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
        raise RuntimeError("pieces do not settle")

    def _outside(self, corner: int, v: Values) -> int:
        """Which way the guard is out of its piece."""
        row, g = self._row(corner), v.guard[corner]
        slack = SLACK * max(1.0, abs(g))
        e = self.circuit.corners[corner, OWNER]
        if self.circuit.corners[corner, ROLE] == OF_INTEGRATOR and self.piece[corner] == 1:
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
        assert self.piece[corner] < self.circuit.corners[corner, END_PIECE]
        self.events.append((self.now_s, int(e), int(self.piece[corner])))
        if self.circuit.corners[corner, ROLE] == OF_INTEGRATOR and self.piece[corner] != 1:
            self.x[e] = self._row(corner)[C0]
        for store in np.flatnonzero(self.circuit.rows[:, KIND] == TRACK):
            if self.circuit.rows[store, CONTROL] == e and step < 0:
                self.stored[store] = before.before[store]

    def _events(self) -> list[Callable[[float, Floats], float]]:
        """A terminal event for each bound of each present piece."""
        found = []
        self._watched: list[tuple[int, int]] = []
        for corner in range(len(self.circuit.corners)):
            row = self._row(corner)
            for bound, step in ((row[HIGH], 1), (row[LOW], -1)):
                if math.isfinite(bound):
                    found.append(self._event(corner, float(bound), step))
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
        for (corner, step), times in zip(self._watched, times_s, strict=True):
            if len(times):
                self._go(corner, step)
        self._settled(self.now_s)


_FUNCTIONS: dict[int, Callable[[float, float, float], float]] = {
    SUM: lambda u, w, p: u,
    PRODUCT: lambda u, w, p: u * w,
    QUOTIENT: lambda u, w, p: u / w,
    SQRT: lambda u, w, p: math.sqrt(max(u, 0.0)),
    SIN: lambda u, w, p: math.sin(u),
    COS: lambda u, w, p: math.cos(u),
    POWER: lambda u, w, p: math.copysign(abs(u) ** p, u),
}
