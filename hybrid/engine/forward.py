"""Every signal of a circuit at one instant, by forward substitution in plain Python.

Stage 4, for `reference`. Written after what `elements` says an element computes; the flat `Circuit` is
all that it shares with the compiled sweep.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hybrid.elements import (
    ANGLE,
    COS,
    INPUT,
    INTEGRATE,
    MODE,
    NUMBER,
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
    EXPONENT,
    FEEDBACK,
    FIRST,
    FIRST_PIECE,
    GAIN,
    HOLD_BY,
    KEEPS,
    KIND,
    LAG,
    LEAK,
    OFFSET,
    OMEGA,
    PHASE,
    RESET,
    SECOND,
    SECOND_CONSTANT,
    STOP,
    TEAR,
    WHICH,
    Circuit,
)
from hybrid.modes import HOLD, IC, OP


class NotResolved(RuntimeError):
    """Something has no figure that agrees with itself, or the integrator found no step short enough."""


@dataclass
class Values:
    """Everything at one instant, for n elements."""

    signal: Floats  # (n,): outputs
    before: Floats  # (n,): outputs before their lags
    kept: Floats  # (n,): what integrators and stores remember, or what those have that follow now
    drive: Floats  # (n,): how fast that changes where no limit stops it, 1/s
    guard: Floats  # (corners,)
    mode: list[int]  # (n,): of integrators, and of the machine


class Part(NamedTuple):
    """One element in plain numbers, which Python reads faster than arrays."""

    kind: int
    first: list[tuple[int, float]]  # signal, gain
    second: list[tuple[int, float]]
    control: int
    reset: int
    hold: int
    corner: int
    stop: int
    rate: float  # of its lag, 1/s; -1: it has none
    figures: list[float]


class Forward:
    """A circuit, the pieces that hold and the inputs that are held: both are the caller's to change."""

    def __init__(self, circuit: Circuit, held: Floats) -> None:
        """Every corner in its initial piece."""
        self.parts, self.pieces = _parts(circuit), circuit.pieces.tolist()
        self.first_piece = circuit.corners[:, FIRST_PIECE].tolist()
        self.piece: list[int] = circuit.initial_piece.tolist()
        self.held = held
        self.starting = False  # integrators that follow a signal in IC also begin with it
        remembers = np.isin(circuit.rows[:, KIND], (INTEGRATE, TRACK))
        at_once = remembers & (circuit.rows[:, LAG] < 0)
        self.at_once: list[int] = np.flatnonzero(at_once).tolist()
        self.torn: list[int] = np.flatnonzero(at_once & (circuit.rows[:, TEAR] != 0)).tolist()

    def values(self, t_s: float, x: Floats, y: Floats) -> Values:
        """All signals, where integrators and stores remember x, and lags y; both (n,).

        What follows its inputs without lag, as an integrator does in IC, may be read before it is
        computed: its readers see it in a further pass. Raises NotResolved where that does not end.
        """
        for _ in range(len(self.torn) + 2):
            values = self.once(t_s, x, y)
            if not self.moves(x, values.kept):
                return values
            x = values.kept
        raise NotResolved("a loop without lag")

    def moves(self, x: Floats, kept: Floats) -> bool:
        """Whether what has been read before it was computed is now another; what is no number is not."""
        return any(kept[e] != x[e] and kept[e] == kept[e] for e in self.torn)

    def once(self, t_s: float, x: Floats, y: Floats) -> Values:
        """The same in one pass: what is read before it is computed is as x has it."""
        signal, kept, count = y.tolist(), x.tolist(), len(self.parts)
        before, drive, mode = [0.0] * count, [0.0] * count, [OP] * count
        guard = [0.0] * len(self.piece)
        for e in self.at_once:
            part = self.parts[e]
            signal[e] = kept[e] if part.kind == TRACK else self._output(part, kept[e], guard)
        for e, part in enumerate(self.parts):
            figures, kind = part.figures, part.kind
            u, w = figures[CONSTANT], figures[SECOND_CONSTANT]
            for source, gain in part.first:
                u += gain * signal[source]
            for source, gain in part.second:
                w += gain * signal[source]
            if kind == INTEGRATE:
                mode[e] = self._mode(part, before)
                value, drive[e] = _integrated(part, mode[e], u, w, kept[e])
                if part.corner >= 0:
                    value = self._limited(part.corner, mode[e], value, drive[e], guard)
                kept[e] = value
            elif kind == MODE:
                mode[e] = self._mode(part, before)
                which = figures[WHICH]
                value = float(mode[e]) if which == NUMBER else float(mode[e] == which)
            elif kind == PIECES:
                guard[part.corner] = u
                value = self._piece_value(part.corner, u)
            elif kind == SWITCH:
                value = u if self.is_high(part.control, before) else w
            elif kind == INPUT:
                value = float(self.held[part.control])
            elif kind == SINE:
                value = figures[AMPLITUDE] * math.sin(figures[OMEGA] * t_s + figures[PHASE])
            elif kind == TRACK:
                value = u
            else:
                value = _FUNCTIONS[kind](u, w, figures[EXPONENT])
                if kind == ANGLE:
                    value, guard[part.corner] = _angle(value, self.piece[part.corner])
            if kind == TRACK and not self.is_high(part.control, before):
                before[e], drive[e] = kept[e], -figures[LEAK] * kept[e]
            else:
                before[e] = self._output(part, value, guard)
                if kind == TRACK:
                    kept[e] = before[e]
            if part.rate < 0.0:
                signal[e] = before[e]
        return Values(
            np.array(signal),
            np.array(before),
            np.array(kept),
            np.array(drive),
            np.array(guard),
            mode,
        )

    def row(self, corner: int) -> list[float]:
        """The piece that holds, a row of `Circuit.pieces`."""
        row: list[float] = self.pieces[self.first_piece[corner] + self.piece[corner]]
        return row

    def is_high(self, by: int, before: list[float]) -> bool:
        """Whether what element `by` controls sees it high."""
        part = self.parts[by]
        return self.piece[part.corner] > 0 if part.kind == PIECES else before[by] > 0.5

    def _mode(self, part: Part, before: list[float]) -> int:
        """Of an integrator, or of the machine: IC goes before HOLD."""
        number = int(before[part.control]) if part.control >= 0 else OP
        if self.starting and part.second:
            return IC
        if number == IC or (part.reset >= 0 and self.is_high(part.reset, before)):
            return IC
        return HOLD if part.hold >= 0 and self.is_high(part.hold, before) else number

    def _limited(
        self, corner: int, mode: int, value: float, drive: float, guard: list[float]
    ) -> float:
        """A limited integrator: in IC as a limiter, else free, or stopped until it is driven back."""
        if self.piece[corner] == 1:
            guard[corner] = value
            return value
        limit = self.row(corner)[C0]
        guard[corner] = value - limit if mode == IC else drive
        return limit

    def _output(self, part: Part, value: float, guard: list[float]) -> float:
        value = part.figures[GAIN] * value + part.figures[OFFSET]
        if part.stop >= 0:
            guard[part.stop] = value
            value = self._piece_value(part.stop, value)
        return value

    def _piece_value(self, corner: int, g: float) -> float:
        row = self.row(corner)
        x = g - row[AT]
        return row[C0] + row[C1] * x + row[C2] * x * x


def _parts(circuit: Circuit) -> list[Part]:
    terms = list(zip(circuit.signal.tolist(), circuit.gain.tolist(), strict=True))
    return [
        Part(
            row[KIND],
            terms[row[FIRST] : row[SECOND]],
            terms[row[SECOND] : row[END]],
            row[CONTROL],
            row[RESET],
            row[HOLD_BY],
            row[CORNER],
            row[STOP],
            float(circuit.laws[row[LAG], 0]) if row[LAG] >= 0 else -1.0,
            figures,
        )
        for row, figures in zip(circuit.rows.tolist(), circuit.figures.tolist(), strict=True)
    ]


def _integrated(part: Part, mode: int, u: float, w: float, x: float) -> tuple[float, float]:
    """Its state and how fast that changes: in IC at w, in HOLD by what the integrator itself adds."""
    if mode == IC:
        return w, 0.0
    if mode == HOLD and part.figures[KEEPS]:
        return x, 0.0
    return x, (part.figures[CONSTANT] if mode == HOLD else u) + part.figures[FEEDBACK] * x


def _angle(angle: float, piece: int) -> tuple[float, float]:
    """An angle beyond its cut, and how far it is from where its piece, 0 below or 1 above, ends."""
    side = 1.0 if piece else -1.0
    turned = side * angle
    if turned < -0.5 * math.pi:
        turned += 2.0 * math.pi
    return side * turned, side * (math.pi - turned) * (turned + 1.0)


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
