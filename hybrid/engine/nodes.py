"""Windows of time with signals held at a few points: operators for integrators and lags.

Stage 4. A window of H seconds has the start and q Radau nodes, the last of them at its end. A signal is
the polynomial of degree q through these q + 1 points; every linear first-order law

    y' = drive * v - rate * y,    an integrator (drive 1) or a lag (drive = rate = 1/tau),

is then solved without error, by variation of constants:

    y(c H) = exp(-z c) y(0) + drive H * integral over 0 <= x <= c of exp(-z (c - x)) v(x),  z = rate H.

The start is one of the points because v is known there: without it the polynomial misses v(0), and a
short lag passes that error on with weight tau. At the end of the window the weights are those of Radau
quadrature, so the end is of order 2 q - 1 (Hairer and Wanner, Solving Ordinary Differential
Equations II, section IV.5).
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from hybrid.engine.arrays import Floats, Ints, lined_up
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.lanes import LANES

# Above this many time constants the integral is summed by parts, which ends after q + 1 terms; up to it
# a Gauss rule of this many points errs by less than 1e-16 for q <= 8. Below a part of one, the series of
# the exponential does, after this many powers: 0.5^15 / 15! is 2e-17.
FEW_CONSTANTS = 20.0
GAUSS_POINTS = 26
PART_OF_ONE = 0.5
POWERS = 15
# Where to look first for what a shelf keeps of a length, and how many ratios of lengths it keeps.
HINTS = 64
GUESSES = 64
# How well windows resolve every signal, as a fraction of full scale.
RESOLUTION = 1e-8


class Nodes(NamedTuple):
    """Fixed tables for one q; n = q + 1 points: the start (0), then the nodes."""

    marks: Floats  # (q,): the nodes, as fractions of the window; the last is 1
    points: Floats  # (n,): the start and the nodes
    abscissae: Floats  # (GAUSS_POINTS,) on [0, 1]
    basis: Floats  # (q, GAUSS_POINTS, n): weight * l_k(c_j (1 - s_i)), l_k the Lagrange polynomials
    powers: Floats  # (q, POWERS, n): integral over 0 <= x <= c_j of (-x)^m / m! l_k(c_j - x)
    slopes: Floats  # (n, n, n): [m, j, k], derivative number m of l_k at point j
    series: Floats  # (n, n): Legendre coefficients on [0, 1] from the values at the points
    series_of: Floats  # (n, n): the same, a row for each point
    tail: Floats  # (2, LANES): the last of these and the one before, from the values at the nodes
    tail_of_start: Floats  # (2,): and from that at the start
    between: (
        Floats  # (n, n): from values at the points to values midway between them (the last: at 1)
    )
    midway: Floats  # (1 + LANES, LANES): the same for all lanes at once
    averages: Floats  # (1 + LANES, LANES): the polynomial of degree q - 2 of a signal's moments
    rejoined: Floats  # (1 + LANES, LANES): one of degree q - 1 with such moments, 0 at the end
    peak: Floats  # (1, LANES): one that has no moments, 1 at the end


class Shelf(NamedTuple):
    """Operators made so far, by window length; a full shelf loses its oldest.

    Powers of two of seconds and three lengths between each two are kept at once, others when they are
    asked for a second time: most come from events and never return. Slot 0 is for those.
    """

    lengths_s: Floats  # (slots,): 0 where free
    met_s: Floats  # (slots,): other lengths asked for, most recently
    next_slot: Ints  # (3,): of the two above; and the slot asked for last
    weights: (
        Floats  # (slots, laws, blocks, n, BLOCK): rows of eight nodes, beside each other in memory
    )
    decay: Floats  # (slots, laws, BLOCK * blocks): exp(-rate c H)
    hints: Ints  # (HINTS,): slot of a length, by its binary digits
    guesses: Floats  # (GUESSES * (1 + LANES), LANES): from the last window's points to new nodes
    guess_for: (
        Floats  # (GUESSES, 3): length, place and degree they are for, in lengths of the last window
    )


@cache
def nodes(q: int = 8) -> Nodes:
    """Tables for q Radau nodes, 4 <= q <= LANES; in rows of LANES those beyond q repeat the last."""
    if not 4 <= q <= LANES:
        raise ValueError(f"q = {q}: between 4 and {LANES} nodes are supported")
    marks = _radau(q)
    points = np.concatenate([[0.0], marks])
    series = np.linalg.inv(legendre.legvander(2 * points - 1, q))
    gauss, weights = legendre.leggauss(GAUSS_POINTS)
    abscissae, weights = (gauss + 1) / 2, weights / 2
    at = marks[:, None] * (1 - abscissae)
    basis = legendre.legvander(2 * at - 1, q) @ series * weights[:, None]
    signs_and_factorials = np.cumprod(np.append(1.0, -1.0 / np.arange(1, POWERS)))
    reach = (marks[:, None] * abscissae) ** np.arange(POWERS)[:, None, None]  # (POWERS, q, points)
    reach *= signs_and_factorials[:, None, None] * marks[:, None]
    powers = np.einsum("mjg,jgk->jmk", reach, basis)
    slopes = np.empty((q + 1, q + 1, q + 1))
    for m in range(q + 1):
        slopes[m] = legendre.legval(2 * points - 1, legendre.legder(series, m)).T * 2.0**m
    middle = np.append((points[1:] + points[:-1]) / 2, 1.0)
    between = legendre.legvander(2 * middle - 1, q) @ series
    series_of = np.ascontiguousarray(series.T)
    midway = lined_up(1 + LANES, LANES)
    midway[: q + 1] = between[np.minimum(np.arange(LANES), q - 1)].T
    tail = lined_up(2, LANES)
    tail[:, :q] = series[: q - 2 : -1, 1:]
    of_start = series[: q - 2 : -1, 0].copy()
    every = np.minimum(np.arange(LANES), q - 1)
    legendres = legendre.legvander(2 * marks - 1, q - 1)
    low, top = np.linalg.inv(legendres)[: q - 1], legendres[:, q - 1 :]
    averages, rejoined, peak = (
        lined_up(1 + LANES, LANES),
        lined_up(1 + LANES, LANES),
        lined_up(1, LANES),
    )
    averages[1 : q + 1] = (legendres[:, : q - 1] @ low)[every].T
    rejoined[1 : q + 1] = ((legendres[:, : q - 1] - top) @ low)[every].T
    peak[0] = top[every, 0]
    return Nodes(
        marks,
        points,
        abscissae,
        basis,
        powers,
        slopes,
        series,
        series_of,
        tail,
        of_start,
        between,
        midway,
        averages,
        rejoined,
        peak,
    )


def _radau(q: int) -> Floats:
    """Roots of P_q - P_(q-1) on [0, 1], polished by Newton's method."""
    polynomial = np.zeros(q + 1)
    polynomial[q - 1 :] = -1.0, 1.0
    roots = np.sort(legendre.legroots(polynomial).real)
    for _ in range(3):
        roots -= legendre.legval(roots, polynomial) / legendre.legval(
            roots, legendre.legder(polynomial)
        )
    roots[-1] = 1.0
    return (roots + 1) / 2


def new_shelf(laws: int, slots: int = 48) -> Shelf:
    """An empty shelf for circuits with this many different laws."""
    return Shelf(
        np.zeros(slots),
        np.zeros(slots),
        np.array([1, 0, 0]),
        lined_up(slots, laws, 1 + LANES, LANES),
        lined_up(slots, laws, LANES),
        np.zeros(HINTS, dtype=np.int64),
        lined_up(GUESSES * (1 + LANES), LANES),
        np.full((GUESSES, 3), np.nan),
    )


@compiled
def law_weights(
    grid: Nodes, rate: float, drive: float, length_s: float, weights: Floats, decay: Floats
) -> None:
    """Fill `weights` (1 + LANES, LANES) and `decay` (LANES,) for one law and one window length."""
    q = len(grid.marks)
    z = rate * length_s
    weights[:, :] = 0.0
    for i in range(decay.shape[0]):
        j = min(i, q - 1)
        c = grid.marks[j]
        decay[i] = math.exp(-z * c)
        if abs(z) <= PART_OF_ONE:
            factor = drive * length_s
            for m in range(POWERS if z != 0.0 else 1):
                for k in range(q + 1):
                    weights[k, i] += factor * grid.powers[j, m, k]
                factor *= z
        elif z * c <= FEW_CONSTANTS:
            _by_quadrature(grid, j, z * c, drive * length_s * c, weights, i)
        else:
            # By parts: the sum over m of (-1/z)^m [v^(m)(c) - exp(-z c) v^(m)(0)] / z ends at m = q.
            factor = drive / rate
            for m in range(q + 1):
                for k in range(q + 1):
                    weights[k, i] += factor * (
                        grid.slopes[m, j + 1, k] - decay[i] * grid.slopes[m, 0, k]
                    )
                factor /= -z


@compiled
def _by_quadrature(
    grid: Nodes, j: int, constants: float, factor: float, weights: Floats, i: int
) -> None:
    """Add node j's weights, column i, by a Gauss rule, half of the exponentials from the other half."""
    last = grid.abscissae.shape[0] - 1
    whole = math.exp(-constants)
    for g in range(grid.abscissae.shape[0] // 2):
        near = math.exp(-constants * grid.abscissae[g])  # the points lie evenly about the middle
        far = whole / near
        for k in range(len(grid.points)):
            weights[k, i] += factor * (
                near * grid.basis[j, g, k] + far * grid.basis[j, last - g, k]
            )


@inlined
def shelved(shelf: Shelf, grid: Nodes, laws: Floats, length_s: float) -> int:
    """Slot of the operators of all `laws` (laws, 2: rate, drive) for this length, made if need be."""
    slot = shelf.next_slot[2]
    if shelf.lengths_s[slot] != length_s:
        slot = find_or_make(shelf, grid, laws, length_s)
        shelf.next_slot[2] = slot
    return int(slot)


@compiled
def find_or_make(shelf: Shelf, grid: Nodes, laws: Floats, length_s: float) -> int:
    """The same, for another length than that of the window before."""
    share, exponent = math.frexp(length_s)
    hint = (int(16.0 * share) + 8 * exponent) % HINTS
    slot = shelf.hints[hint]
    if shelf.lengths_s[slot] == length_s:
        return int(slot)
    for slot in range(shelf.lengths_s.shape[0]):
        if shelf.lengths_s[slot] == length_s:
            shelf.hints[hint] = slot
            return slot
    slot = free_slot(shelf, length_s)
    for law in range(laws.shape[0]):
        law_weights(
            grid,
            laws[law, 0],
            laws[law, 1],
            length_s,
            shelf.weights[slot, law],
            shelf.decay[slot, law],
        )
    return int(slot)


@compiled
def free_slot(shelf: Shelf, length_s: float) -> int:
    """The slot for the operators of a length that is not there yet."""
    slots = shelf.lengths_s.shape[0]
    share = 16.0 * math.frexp(length_s)[0]
    kept = share == math.floor(share)
    for k in range(slots):
        kept = kept or shelf.met_s[k] == length_s
    slot = 0
    if kept:
        slot = shelf.next_slot[0]
        shelf.next_slot[0] = slot + 1 if slot + 1 < slots else 1
    else:
        shelf.met_s[shelf.next_slot[1]] = length_s
        shelf.next_slot[1] = (shelf.next_slot[1] + 1) % slots
    shelf.lengths_s[slot] = length_s
    return int(slot)


@compiled
def point_weights(grid: Nodes, at: float, degree: int, out: Floats) -> None:
    """Fill `out` (n,): weights that give a signal at fraction `at` of the window, which may lie outside.

    Below degree q the Legendre series is cut there: a guess far outside is steadier so.
    """
    x = 2.0 * at - 1.0
    out[:] = 0.0
    before, now = 0.0, 1.0
    for n in range(degree + 1):
        for k in range(out.shape[0]):
            out[k] += now * grid.series[n, k]
        before, now = now, ((2 * n + 1) * x * now - n * before) / (n + 1)


@compiled
def slope_at(grid: Nodes, start: float, nodes: Floats, point: int) -> float:
    """The slope at one of the points, per window, of the signal through `start` and `nodes` (q,)."""
    slope = grid.slopes[1, point, 0] * start
    for j in range(len(grid.marks)):
        slope += grid.slopes[1, point, j + 1] * nodes[j]
    return float(slope)
