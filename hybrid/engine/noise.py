"""Component noise in windows: two runs side by side, one smooth, one as it truly is.

Stage 4. Noise is white noise into a component's output lag. What a lag remembers of it decays like all
else that it holds, so each window adds only fresh noise: its average against every polynomial up to
degree q - 2 and its value at the end, drawn together (`projection`). The *true* signals are solved with
that noise in. Their windows are chosen by *smooth* signals, which begin at what the true integrators
hold and have no noise within the window: they tell how long it may be, which first guess is good, and on
which side of a corner every element is. Nothing is drawn before that is settled, so no draw is rejected
for where it leads; only where loops do not agree with noise in them a piece is halved and drawn anew.

Exact in distribution at every instant, and jointly: the noise of a component, and what integrators make
of it. What shorter lags make of it is as good as the windows before an instant resolve it
(`circuit.TAIL_LAGS`). Products of noise do nothing in windows longer than it lasts (of corners: `blur`).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hybrid.elements import INTEGRATE, TRACK
from hybrid.engine.arrays import Floats, Ints, lined_up
from hybrid.engine.blur import Blur, near, new_blur, share_left, spread_out
from hybrid.engine.circuit import (
    CONTROL,
    CORNER,
    KIND,
    LAG,
    RATE,
    SOURCE,
    Circuit,
)
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.corners import Log, moves, new_log, settle
from hybrid.engine.deviations import Chain, new_chain, noise_at_guards
from hybrid.engine.handover import accept, guess
from hybrid.engine.lanes import LANES, add_scaled, weigh
from hybrid.engine.nodes import Nodes, Shelf, free_slot, new_shelf
from hybrid.engine.overloads import watch
from hybrid.engine.projection import Projection, noise_spread, projected_law, projection
from hybrid.engine.sweep import (
    AS,
    BEFORE,
    CRUISE,
    EVENTS,
    STARTED,
    SWEPT,
    State,
    X,
    is_high,
    new_state,
    solve,
)
from hybrid.modes import IC

# Smooth signals need be resolved no better than to this share of the largest noise.
SHARE_OF_NOISE = 1e-3
# What sweeps may leave.
SHARE_LEFT = 1e-7
# What arithmetic leaves of full scale in a window.
ROUNDING = 1e-15
# No piece of a window is made shorter.
SHORTEST_S = 1e-15


class Noise(NamedTuple):
    """What noise needs beside the smooth run; owned by the run."""

    truth: State
    shelf: Shelf  # operators of `projection`
    spread: Floats  # (slots, rates, q, P): nodes of fresh noise of rms 1 from unit normal draws
    table: Projection
    random: np.random.Generator | None  # None outside of compiled code, see `drawn_from`
    draws: Floats  # (q,): scratch
    held: Floats  # (n,): scratch
    log: Log  # events of the truth are those of the smooth run: nothing fits
    chain: Chain
    blur: Blur


def new_noise(circuit: Circuit, q: int = 8) -> Noise:
    """Noise of a run that has not started."""
    shelf = new_shelf(len(circuit.laws))
    return Noise(
        new_state(circuit, q),
        shelf,
        lined_up(len(shelf.lengths_s), len(circuit.noise_rates), q, LANES),
        projection(q),
        None,
        np.zeros(q),
        np.zeros(len(circuit.rows)),
        new_log(0),
        new_chain(circuit),
        new_blur(circuit, q),
    )


@inlined
def drawn_from(random: np.random.Generator, noise: Noise) -> Noise:
    """The noise with what it is drawn from: numba takes half a millisecond to see what a tuple is that
    holds such a thing, so it is handed over by itself."""
    return Noise(
        noise.truth,
        noise.shelf,
        noise.spread,
        noise.table,
        random,
        noise.draws,
        noise.held,
        noise.log,
        noise.chain,
        noise.blur,
    )


def measure(circuit: Circuit, smooth: State, noise: Noise) -> None:
    """Find what noise there is at corners, of a run that has settled at its start."""
    if not noise.chain.blurs.any():
        return
    blur, most = noise.blur, np.zeros(len(circuit.corners))
    noise_at_guards(circuit, smooth.start, smooth, noise.chain, blur, most, True)
    noise_at_guards(circuit, smooth.start, smooth, noise.chain, blur, blur.deviation, False)
    most[~(most < 1.0)] = 1.0  # loops whose bound has no end
    blur.most[:] = most if noise.chain.live[0] else blur.deviation


@compiled
def take(to: npt.NDArray[Any], source: npt.NDArray[Any]) -> None:
    """Copy a line of figures; a statement with slices would make an array in between."""
    for i in range(to.shape[0]):
        to[i] = source[i]


@compiled
def finest(circuit: Circuit, rtol: float, tolerance: float) -> tuple[float, float]:
    """How well windows must resolve smooth signals, and loops agree, of full scale."""
    return max(rtol, SHARE_OF_NOISE * circuit.grain), max(tolerance, SHARE_LEFT * circuit.grain)


@compiled
def jump(circuit: Circuit, smooth: State, noise: Noise, t_s: float, now_s: float) -> None:
    """Let the truth follow what has just jumped in the smooth run, which leads modes and stores."""
    truth = noise.truth
    take(truth.held, smooth.held)
    take(truth.piece, smooth.piece)
    if truth.counts[STARTED] == 0:  # there is no noise yet
        take(truth.start, smooth.start)
        take(truth.guard_start, smooth.guard_start)
        for column in range(truth.memory.shape[1]):
            take(truth.memory[:, column], smooth.memory[:, column])
        truth.counts[STARTED] = 1
        return
    settle(circuit, truth, smooth, t_s, now_s, noise.log, False, 0.0)


@inlined
def play_truth(
    circuit: Circuit,
    smooth: State,
    noise: Noise,
    grid: Nodes,
    t_s: float,
    length_s: float,
    left_s: float,
    tolerance: float,
) -> bool:
    """Play a window that the smooth run has solved, in pieces; false where no piece is short enough.

    Before the next instant at which signals are seen, in left_s from the start of the window, noise is
    resolved by a short piece.
    """
    truth, done_s, most_s = noise.truth, 0.0, length_s
    take(truth.piece, smooth.piece)
    if noise.blur.times_s[0] > 0.0:
        _reach_over(circuit, smooth, noise)
    while done_s < length_s:
        piece_s = _piece(circuit.tails_s, min(length_s - done_s, most_s), left_s - done_s)
        if noise.blur.rough[0] > 0:
            piece_s = _blur(circuit, noise, piece_s, left_s - done_s)
        place, share, degree = done_s / length_s, piece_s / length_s, len(grid.marks)
        guess(circuit, truth, noise.shelf, grid, place, share, degree, smooth.start, smooth.nodes)
        slot = _find(noise.shelf.lengths_s, piece_s)
        if slot < 0:
            slot = _operators(circuit, noise, piece_s)
        _draw(
            circuit.noisy,
            circuit.noise,
            noise.spread[slot],
            truth.fresh,
            truth.nodes,
            noise.draws,
            noise.random,
        )
        if solve(circuit, truth, noise.shelf, grid, t_s + done_s, piece_s, tolerance):
            watch(truth, grid, t_s + done_s, piece_s)
            swept = truth.clock[SWEPT]
            accept(circuit, truth, grid, piece_s, 0.0, swept * swept)
            done_s = length_s if piece_s == length_s - done_s else done_s + piece_s
        else:
            most_s = 0.5 * piece_s
            if most_s < SHORTEST_S:
                return False
    return True


@compiled
def _reach_over(circuit: Circuit, smooth: State, noise: Noise) -> None:
    """Find the corners that noise reaches over in the window that the smooth run has solved."""
    chain, blur, truth, found = noise.chain, noise.blur, noise.truth, False
    for corner in range(circuit.corners.shape[0]):
        if blur.most[corner] > 0.0 and _near(circuit, smooth, truth, corner, blur.most[corner]):
            if not found and chain.live[0] > 0:
                middle, end = noise.held, smooth.nodes.shape[1] - 1
                for e in range(middle.shape[0]):
                    middle[e] = 0.5 * (smooth.start[e] + smooth.nodes[e, end])
                noise_at_guards(circuit, middle, smooth, chain, blur, blur.deviation, False)
            found = True
            break
    was = blur.rough[0] > 0
    if not (found or was):
        return
    found = False
    for corner in range(circuit.corners.shape[0]):
        s = blur.deviation[corner]
        if s > 0.0 and _near(circuit, smooth, truth, corner, s):
            truth.blur[corner], found = s, True
        else:
            truth.blur[corner] = -1.0
    spread_out(circuit, truth.blur, truth.rough)
    blur.rough[0] = 1 if found else 0


@compiled
def _near(circuit: Circuit, smooth: State, truth: State, corner: int, s: float) -> bool:
    """Whether noise of deviation s reaches over a bound of the piece that a corner is on."""
    held, piece = truth.guard_start[corner], smooth.piece[corner]
    return bool(near(circuit, corner, piece, smooth.guard_start, smooth.guard, held, s))


@compiled
def _blur(circuit: Circuit, noise: Noise, piece_s: float, left_s: float) -> float:
    """How long the piece may be, and what it leaves unresolved of noise that reaches over corners."""
    blur, truth = noise.blur, noise.truth
    fine_s, tail_s = blur.times_s[0], blur.times_s[1]
    piece_s = min(piece_s, left_s - tail_s if left_s > 1.25 * tail_s else fine_s)
    for corner in range(circuit.corners.shape[0]):
        if truth.blur[corner] < 0.0:
            continue
        share = share_left(blur.shares, piece_s * blur.rate[corner])
        truth.blur[corner] = blur.deviation[corner] * math.sqrt(share)
        if piece_s > fine_s:
            blur.blurred_s[corner] += piece_s
    return piece_s


@compiled
def _piece(tails_s: Floats, length_s: float, left_s: float) -> float:
    """The length, or up to where a tail before the next instant begins, if it reaches there."""
    for k in range(tails_s.shape[0]):
        if length_s > max(tails_s[k], left_s - tails_s[k]) and left_s > 1.25 * tails_s[k]:
            return float(left_s - tails_s[k])
    return length_s


@compiled
def _find(lengths_s: Floats, length_s: float) -> int:
    for slot in range(lengths_s.shape[0]):
        if lengths_s[slot] == length_s:
            return slot
    return -1


@compiled
def _operators(circuit: Circuit, noise: Noise, length_s: float) -> int:
    """Make what windows of this length need; its slot, where `solve` will find it."""
    slot = free_slot(noise.shelf, length_s)
    for law in range(circuit.laws.shape[0]):
        projected_law(
            noise.table,
            circuit.laws[law, 0],
            circuit.laws[law, 1],
            length_s,
            noise.shelf.weights[slot, law],
            noise.shelf.decay[slot, law],
        )
    for rate in range(circuit.noise_rates.shape[0]):
        noise_spread(noise.table, circuit.noise_rates[rate] * length_s, noise.spread[slot, rate])
    return int(slot)


@compiled
def _draw(
    noisy: Ints,
    rms: Floats,
    spread: Floats,
    fresh: Floats,
    nodes: Floats,
    draws: Floats,
    random: np.random.Generator,
) -> None:
    """Fresh noise of every component, also added to the first guess."""
    for k in range(noisy.shape[0]):
        e, rate = noisy[k, SOURCE], noisy[k, RATE]
        for j in range(draws.shape[0]):
            draws[j] = rms[k] * random.standard_normal()
        weigh(fresh, k, spread, rate * len(draws), draws, 0, len(draws))
        add_scaled(nodes, e, 1.0, fresh, k)


@inlined
def bring_up(
    circuit: Circuit, smooth: State, noise: Noise, t_s: float, now_s: float, log: Log
) -> bool:
    """Let the smooth run begin its next window at the truth; whether that led to events.

    Integrators, lags at least as slow as windows and held samples take the true value. Fast lags only
    move by as much as their inputs do: the noise they hold would be a layer in every window.
    """
    rows, laws, truth, events = circuit.rows, circuit.laws, noise.truth, smooth.counts[EVENTS]
    start, memory, piece = smooth.start, smooth.memory, smooth.piece
    true_start, true_memory = truth.start, truth.memory
    moving_s = 0.5 * min(smooth.clock[CRUISE], circuit.longest_s)
    for e in range(rows.shape[0]):
        if rows[e, KIND] == INTEGRATE:
            memory[e, X] = true_memory[e, X]
        elif rows[e, KIND] == TRACK and not is_high(rows, piece, memory, rows[e, CONTROL]):
            memory[e, BEFORE] = true_memory[e, BEFORE]
        if rows[e, LAG] >= 0 and not moves(rows, laws, e, moving_s):
            start[e] = true_start[e]
    settle(circuit, smooth, smooth, t_s, now_s, log, False, moving_s)
    for e in range(rows.shape[0]):
        limited = rows[e, KIND] == INTEGRATE and rows[e, CORNER] >= 0
        if limited and memory[e, AS] != IC:  # it may have reached its limit
            true_memory[e, X] = memory[e, X]
    return bool(smooth.counts[EVENTS] > events)


@compiled
def show(circuit: Circuit, smooth: State, noise: Noise, t_s: float, now_s: float) -> None:
    """At an instant that is looked at, put what has corners on the side where the true signals are."""
    if circuit.corners.shape[0] == 0:
        return
    held, memory = noise.held, noise.truth.memory
    take(held, memory[:, BEFORE])
    settle(circuit, noise.truth, smooth, t_s, now_s, noise.log, False, 0.0)
    take(memory[:, BEFORE], held)  # what stores hold is not opened for a look
