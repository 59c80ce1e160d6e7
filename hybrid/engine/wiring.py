"""Lays elements out as a `Circuit`: which row each has, where its figures stand.

Stage 4. The runs of a batch mostly share the shapes of their elements and differ in figures, so where
those stand is kept by the shapes.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hybrid.elements import (
    INPUT,
    INTEGRATE,
    PRODUCT,
    SUM,
    Element,
)
from hybrid.engine.arrays import Floats, Ints
from hybrid.engine.circuit import (
    CONTROL,
    CORNER,
    END,
    FIRST,
    HOLD_BY,
    KIND,
    LAG,
    LAW,
    LEAST_LAG,
    LINEAR,
    LOUD_LAGS,
    NOISE,
    OF_OUTPUT,
    PLAIN,
    RESET,
    SECOND,
    STOP,
    TAIL_LAGS,
    TEAR,
    Circuit,
)
from hybrid.engine.order import loops_of, ordered, reach
from hybrid.engine.shapes import Rates, Shape, part_of
from hybrid.machine import Machine


def circuit_of(machine: Machine) -> tuple[Circuit, dict[str, int]]:
    """The circuit of a machine, and the number of each element by name, in computing order.

    Machines that share all but figures share `rows`, `signal`, `laws`, `corners` and the numbers.
    """
    return lay_out(machine.elements)


def lay_out(elements: Sequence[tuple[str, Element]]) -> tuple[Circuit, dict[str, int]]:
    """The same of elements by name, those of INPUT in the order in which State.held has them."""
    parts = [part_of(element) for _, element in elements]
    frame = _frame(
        tuple([name for name, _ in elements]),
        tuple([part.shape for part in parts]),
        tuple([part.rates for part in parts]),
    )
    row = [parts[i] for i in frame.order]
    own = _joined([part.own for part in row]).reshape(-1, 9)
    circuit = frame.circuit._replace(
        figures=own[:, :7].copy(),
        gain=_joined([part.gain for part in row]),
        pieces=_joined([part.pieces for part in row]).reshape(-1, 6),
        initial=own[:, 7:].copy(),
    )
    return circuit, frame.number


def _joined(rows: Sequence[bytes]) -> Floats:
    """Rows of floats, packed, as one array of this circuit alone."""
    return np.frombuffer(bytearray().join(rows)) if any(rows) else np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class _Wiring:
    """All that shapes decide."""

    order: tuple[int, ...]  # in which the elements are computed
    number: dict[str, int]
    shapes: tuple[Shape, ...]  # in computing order, as all that follows
    rows: Ints  # but for laws
    signal: npt.NDArray[np.uint64]
    corners: Ints
    ranges: Ints
    torn: Ints
    initial_piece: Ints
    noisy: tuple[int, ...]
    distorted: tuple[int, ...]  # loud noise that reaches what is not linear
    outside: Ints


class _Frame(NamedTuple):
    """A circuit without gains, constants, pieces and first values; runs share its arrays."""

    order: tuple[int, ...]
    number: dict[str, int]
    circuit: Circuit


@functools.lru_cache(maxsize=64)
def _frame(names: tuple[str, ...], shapes: tuple[Shape, ...], rates: tuple[Rates, ...]) -> _Frame:
    """What all elements of these shapes and rates share."""
    wiring = _wired(names, shapes)
    found = [rates[i] for i in wiring.order]
    laws: dict[tuple[float, float], int] = {}
    numbers = list[tuple[int, int]]()  # of each element's own law and of its lag's
    for shape, r in zip(wiring.shapes, found, strict=True):
        integrates, lagged = shape.kind == INTEGRATE, shape.lagged
        own = laws.setdefault((r.decay, 1.0), len(laws)) if integrates else -1
        lag = laws.setdefault((1.0 / r.lag_s, 1.0 / r.lag_s), len(laws)) if lagged else -1
        numbers.append((own, lag))
    noise_rates = sorted({1.0 / found[i].lag_s for i in wiring.noisy})
    noisy = [(i, noise_rates.index(1.0 / found[i].lag_s)) for i in wiring.noisy]
    taus_s = np.array(sorted({1.0 / rate for rate, _ in laws if rate > 0.0}))
    none = np.zeros((0, 0))
    circuit = Circuit(
        _rows(wiring, tuple(numbers)),
        none,
        wiring.signal,
        np.zeros(0),
        np.array(list(laws), dtype=float).reshape(-1, 2),
        taus_s,
        wiring.corners,
        none,
        wiring.ranges,
        wiring.torn,
        none,
        wiring.initial_piece,
        np.array(noisy, dtype=np.int64).reshape(-1, 2),
        np.array([found[i].noise for i in wiring.noisy], dtype=float),
        np.array(noise_rates, dtype=float),
        _tails(taus_s, noise_rates),
        LOUD_LAGS * min((found[i].lag_s for i in wiring.distorted), default=math.inf),
        max((r.noise for r in found), default=0.0),
        wiring.outside,
    )
    return _Frame(wiring.order, wiring.number, circuit)


@functools.lru_cache(maxsize=64)
def _rows(wiring: _Wiring, laws: tuple[tuple[int, int], ...]) -> Ints:
    """`Circuit.rows` with these laws of each element and its lag: rates may differ, and these not."""
    rows = wiring.rows.copy()
    rows[:, [LAW, LAG]] = np.array(laws, dtype=np.int64).reshape(-1, 2)
    return rows


@functools.lru_cache(maxsize=64)
def _wired(names: tuple[str, ...], of: tuple[Shape, ...]) -> _Wiring:
    parts = zip(names, of, strict=True)
    order, ranges = ordered([(name, shape.reads, shape.rank) for name, shape in parts])
    at, place = {n: i for i, n in enumerate(names)}, {n: i for i, n in enumerate(order)}
    inputs = [name for name, shape in zip(names, of, strict=True) if shape.kind == INPUT]
    shapes = tuple(of[at[name]] for name in order)
    edges = {(place[r], i) for i, s in enumerate(shapes) for r in s.reads}
    loops = loops_of(len(order), edges)
    noisy = [i for i, s in enumerate(shapes) if s.noisy]
    corners: list[tuple[int, int, int, int]] = []  # element, role, pieces, first piece
    rows = np.full((len(order), 14), -1)
    read_at: dict[str, int] = {}  # by which element first
    for i, s in enumerate(shapes):
        for name in s.reads:
            read_at.setdefault(name, i)
    for i, (name, s) in enumerate(zip(order, shapes, strict=True)):
        control = -1 if s.control is None else place[s.control]
        rows[i, KIND], rows[i, CONTROL] = s.kind, inputs.index(name) if s.kind == INPUT else control
        rows[i, RESET] = -1 if s.reset is None else place[s.reset]
        rows[i, HOLD_BY] = -1 if s.hold is None else place[s.hold]
        for role, pieces, first in s.corners:
            rows[i, STOP if role == OF_OUTPUT else CORNER] = len(corners)
            corners.append((i, role, pieces, first))
        rows[i, TEAR] = read_at.get(name, len(order)) <= i
        rows[i, NOISE] = noisy.index(i) if s.noisy else -1
        if s.kind in (SUM, PRODUCT, INTEGRATE) and not s.corners:
            rows[i, PLAIN] = s.kind
    sums = [terms for s in shapes for terms in (s.first, s.second)]
    ends = np.cumsum([0] + [len(terms) for terms in sums])
    rows[:, FIRST], rows[:, SECOND], rows[:, END] = ends[:-1:2], ends[1::2], ends[2::2]
    piece_ends = np.cumsum([0] + [c[2] for c in corners])
    of_corners = [
        (c[0], c[1], piece_ends[k], piece_ends[k + 1], c[0] in loops) for k, c in enumerate(corners)
    ]
    return _Wiring(
        tuple(at[name] for name in order),
        place,
        shapes,
        rows,
        np.array([place[name] for terms in sums for name in terms], dtype=np.uint64),
        np.array(of_corners, dtype=np.int64).reshape(-1, 5),
        np.array(ranges),
        np.flatnonzero(rows[:, TEAR]),
        np.array([c[3] for c in corners], dtype=np.int64),
        tuple(noisy),
        tuple(_distorted(shapes, edges)),
        np.array(_outside(corners, edges, loops), dtype=np.int64).reshape(-1, 2),
    )


def _outside(
    corners: Sequence[tuple[int, int, int, int]],
    edges: set[tuple[int, int]],
    loops: Mapping[int, frozenset[int]],
) -> list[tuple[int, int]]:
    """Of each corner of two pieces (others do not jump) what its loops read that is in none of them."""
    into: dict[frozenset[int], list[int]] = {
        loop: sorted({a for a, b in edges if b in loop and a not in loop})
        for loop in {loops[c[0]] for c in corners if c[0] in loops and c[2] == 2}
    }
    return [
        (k, a)
        for k, c in enumerate(corners)
        if c[0] in loops and c[2] == 2
        for a in into[loops[c[0]]]
    ]


def _tails(taus_s: Floats, noise_rates: Sequence[float]) -> Floats:
    """Lengths of the windows that resolve noise before an instant, longest first.

    A lag much shorter than that of the noise lets it pass as it is.
    """
    if not noise_rates:
        return np.zeros(0)
    return TAIL_LAGS * taus_s[taus_s > LEAST_LAG / noise_rates[-1]][::-1]


def _distorted(shapes: Sequence[Shape], edges: set[tuple[int, int]]) -> list[int]:
    """Loud noise that reaches what is not linear: windows must show it."""

    def reaches_curves(i: int) -> bool:
        reached = [shapes[k] for k in reach(edges, {i}, 1)]
        return any(s.kind not in LINEAR or s.corners for s in reached)

    loud = [i for i, s in enumerate(shapes) if s.loud and s.noisy]
    return [i for i in loud if reaches_curves(i)]


def distorted_noise(elements: Mapping[str, Element]) -> dict[str, float]:
    """Loud noise that reaches what is not linear, by element: how long a window may be for it, in s."""
    wiring = _wired(tuple(elements), tuple(part_of(e).shape for e in elements.values()))
    found = [n for n in elements if wiring.number[n] in wiring.distorted]
    return {name: LOUD_LAGS * elements[name].lag_s for name in found}
