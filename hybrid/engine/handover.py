"""From one window to the next: the first guess, the end that becomes a start.

Stage 4.
"""

from __future__ import annotations

from hybrid.engine.arrays import Floats
from hybrid.engine.circuit import Circuit
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.lanes import LANES, combine, copy, weigh
from hybrid.engine.nodes import GUESSES, Nodes, Shelf
from hybrid.engine.sweep import (
    AGE,
    BEFORE,
    BEFORE_END,
    DRIVE,
    DRIVE_END,
    KNOWN,
    LENGTH,
    SUM_OF_ERRORS,
    WINDOWS,
    WORST,
    X_END,
    State,
    X,
)

# Spreads ratios of lengths, which are mostly quotients of small numbers, over the slots of a shelf.
SPREAD = 65536.0


@inlined
def guess(
    circuit: Circuit,
    state: State,
    shelf: Shelf,
    grid: Nodes,
    place: float,
    ratio: float,
    degree: int,
    start: Floats,
    nodes: Floats,
) -> None:
    """Read the polynomials through `start` and `nodes` from `place` on, over `ratio` of their length.

    Only for signals that are read before they are computed.
    """
    slot = 1 + int(ratio * SPREAD) % (GUESSES - 1) if place == 1.0 else 0
    wanted, first = shelf.guess_for, slot * (1 + LANES)
    if wanted[slot, 0] != ratio or wanted[slot, 1] != place or wanted[slot, 2] != degree:
        wanted[slot, 0], wanted[slot, 1], wanted[slot, 2] = ratio, place, degree
        _read_at_nodes(grid, place, ratio, degree, state.legendre, shelf.guesses, first)
    new, torn = state.nodes, circuit.torn
    for k in range(torn.shape[0]):
        e = torn[k]
        combine(new, e, nodes, e, 0.0, shelf.guesses, first, start[e], nodes, e)


@compiled
def _read_at_nodes(
    grid: Nodes,
    place: float,
    ratio: float,
    degree: int,
    legendre: Floats,
    weights: Floats,
    first: int,
) -> None:
    """Fill 1 + q rows of `weights` (rows, P) from `first` on with `nodes.point_weights` of each node.

    `legendre` (1 + P, P): scratch.
    """
    q = len(grid.marks)
    for i in range(LANES):
        x = 2.0 * (place + ratio * grid.marks[min(i, q - 1)]) - 1.0
        legendre[0, i], legendre[1, i] = 1.0, x
    for n in range(1, degree):
        on, back = (2 * n + 1) / (n + 1), n / (n + 1)
        for i in range(LANES):
            x = legendre[1, i]
            legendre[n + 1, i] = on * x * legendre[n, i] - back * legendre[n - 1, i]
    for k in range(q + 1):
        weigh(weights, first + k, legendre, 0, grid.series_of[k], 0, degree + 1)


@inlined
def accept(
    circuit: Circuit, state: State, grid: Nodes, length_s: float, tail: float, swept: float
) -> None:
    """Make the end of the window the start of the next; swept: what its sweeps may have left.

    SUM_OF_ERRORS of the true signals of a run with noise has the squares of that.
    """
    end = len(grid.marks) - 1
    start, past, nodes, last, memory = (
        state.start,
        state.past,
        state.nodes,
        state.last,
        state.memory,
    )
    for e in range(start.shape[0]):
        past[e] = start[e]
        start[e] = nodes[e, end]
        memory[e, X] = memory[e, X_END]
        memory[e, DRIVE] = memory[e, DRIVE_END]
        memory[e, BEFORE] = memory[e, BEFORE_END]
    for k in range(circuit.torn.shape[0]):
        copy(last, circuit.torn[k], nodes, circuit.torn[k])
    for corner in range(state.piece.shape[0]):
        state.guard_start[corner] = state.guard[corner, end]
    clock = state.clock
    clock[AGE] += length_s
    clock[LENGTH] = length_s
    clock[WORST] = max(clock[WORST], tail)
    clock[SUM_OF_ERRORS] += 10.0 * tail * tail + swept
    state.counts[KNOWN] = 1
    state.counts[WINDOWS] += 1
