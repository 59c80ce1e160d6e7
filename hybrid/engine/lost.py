"""Which signal a run was lost by: one beyond any scale, or one that no window is short enough for.

Stage 4. Where several are, it is the first whose own inputs are still sound; in a loop, the worst.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hybrid.elements import ANGLE, QUOTIENT
from hybrid.engine.arrays import Floats
from hybrid.engine.circuit import END, FIRST, KIND, SECOND, Circuit
from hybrid.engine.kernel import RUNAWAY_MU
from hybrid.engine.nodes import Nodes
from hybrid.engine.sweep import State

Truths = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Lost:
    """The signal and its last value; `through_zero`: what it divides by, or the two signals of whose
    direction it is the angle, with their values. All values in machine units."""

    signal: str
    value_mu: float | None  # None: of a part inside it, or no number
    through_zero: tuple[tuple[str, float], ...] = ()


def farthest(names: Sequence[str], values: Floats) -> Lost | None:
    """The one farthest beyond any scale, before all others what is no number; None: there is none."""
    with np.errstate(invalid="ignore"):
        beyond = np.flatnonzero(~(np.abs(values) <= RUNAWAY_MU)).tolist()
    if not beyond:
        return None
    worst = max(beyond, key=lambda i: float(np.nan_to_num(abs(values[i]), nan=np.inf)))
    return _lost(names[worst], float(values[worst]))


def runaway(
    circuit: Circuit, names: Sequence[str], start: Floats, scale: float = RUNAWAY_MU
) -> Lost | None:
    """What went beyond any scale first in a circuit with these signals; None: nothing did."""
    with np.errstate(invalid="ignore"):
        beyond = ~(np.abs(start) <= scale)
    if not beyond.any():
        return None
    size = np.nan_to_num(np.abs(start), nan=np.inf)
    return _named(circuit, names, _first(circuit, beyond, size), start)


def unresolved(circuit: Circuit, names: Sequence[str], grid: Nodes, state: State) -> Lost:
    """What the last window that was tried leaves most of, in relation to what it is."""
    return _named(circuit, names, int(np.argmax(tails(circuit, grid, state))), state.start)


def tails(circuit: Circuit, grid: Nodes, state: State) -> Floats:
    """What the window leaves of every signal, (n,), as `relaxation` has it; infinite for the first that
    is no number."""
    start, nodes = state.start, state.nodes
    with np.errstate(all="ignore"):
        last = np.abs(grid.tail_of_start[0] * start + nodes @ grid.tail[0])
        previous = np.abs(grid.tail_of_start[1] * start + nodes @ grid.tail[1])
        size = np.maximum(1.0, np.abs(nodes[:, -1]))
        share: Floats = np.maximum(last, 0.1 * previous) / size
    without = ~np.isfinite(share)
    share[without] = -1.0
    if without.any():
        share[_first(circuit, without, without.astype(float))] = np.inf
    return share


def steepest(circuit: Circuit, names: Sequence[str], before: Floats, after: Floats) -> Lost:
    """What changes most from one instant to one just after it, in relation to what it is."""
    with np.errstate(all="ignore"):
        share = np.abs(after - before) / np.maximum(1.0, np.abs(before))
    return _named(circuit, names, int(np.argmax(np.nan_to_num(share, nan=np.inf))), before)


def _first(circuit: Circuit, wrong: Truths, size: Floats) -> int:
    """The first element that is wrong and reads nothing that is; in a loop, the largest."""
    for e in np.flatnonzero(wrong).tolist():
        if not wrong[_reads(circuit, e, FIRST, END)].any():
            return int(e)
    return int(np.argmax(np.where(wrong, size, -1.0)))


def _reads(circuit: Circuit, e: int, first: int, end: int) -> npt.NDArray[np.int64]:
    return circuit.signal[circuit.rows[e, first] : circuit.rows[e, end]].astype(np.int64)


def _named(circuit: Circuit, names: Sequence[str], e: int, start: Floats) -> Lost:
    """The component of an element, and what passes through zero where its kind does not bear that."""
    kind, through = circuit.rows[e, KIND], dict[str, float]()
    if kind in (QUOTIENT, ANGLE):
        for read in _reads(circuit, e, SECOND if kind == QUOTIENT else FIRST, END).tolist():
            through[names[read]] = float(start[read])
    return _lost(names[e], float(start[e]), tuple(through.items()))


def _lost(name: str, value: float, through: tuple[tuple[str, float], ...] = ()) -> Lost:
    component, _, hidden = name.partition(":")
    return Lost(component, None if hidden or not np.isfinite(value) else value, through)
