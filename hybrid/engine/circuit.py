"""A flat description of an analog circuit: one row for each element, in the order they are computed.

Stage 4. Every parameter is data, so the kernel is compiled once. Figures are in machine units (1 is full
scale) and seconds; `elements` says what an element computes.

What is not smooth is cut into pieces. An element with a corner has a list of pieces, each a parabola in
the guarded quantity that is valid between two bounds; inside a window the piece is fixed, so everything
is smooth there. Bounds of neighbouring pieces overlap where there is hysteresis.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hybrid.elements import (
    ANGLE,
    INPUT,
    INTEGRATE,
    MODE,
    NUMBER,
    PIECES,
    PRODUCT,
    QUOTIENT,
    SINE,
    SUM,
    SWITCH,
    TRACK,
    Element,
    angle_pieces,
    limit_pieces,
)
from hybrid.engine.arrays import Floats, Ints
from hybrid.engine.order import computing_order, loops_of, reach

# Columns of Circuit.rows: kind; terms FIRST to SECOND make u, SECOND to END make w; the element that
# controls a switch or store, or whose value is a mode (of INPUT: its place in State.held); rows in laws
# of the integrator and of the lag; corners of the function and of the saturation; 1 where an element
# computed earlier reads this one; elements that reset and hold while they are high; row in noisy;
# the kind of a sum, product or integrator without corners. -1: none.
KIND, FIRST, SECOND, END, CONTROL, LAW, LAG, CORNER, STOP, TEAR, RESET, HOLD_BY, NOISE, PLAIN = (
    range(14)
)
# Columns of Circuit.figures; the last three depend on the kind.
CONSTANT, SECOND_CONSTANT, GAIN, OFFSET = 0, 1, 2, 3
AMPLITUDE, OMEGA, PHASE = 4, 5, 6  # of SINE
EXPONENT = 4  # of POWER
FEEDBACK, KEEPS = 4, 5  # of INTEGRATE; KEEPS: its feedback is an input, off in HOLD
WHICH = 4  # of MODE
LEAK = 4  # of TRACK: at which rate it loses what it keeps
# Columns of Circuit.corners: element, what is guarded, range of rows in pieces; 1 where the element
# reads itself by way of others.
OWNER, ROLE, FIRST_PIECE, END_PIECE, LOOPED = 0, 1, 2, 3, 4

# Columns of Circuit.pieces: valid from LOW to HIGH of the guarded quantity g, where the function is
# c0 + c1 (g - AT) + c2 (g - AT)^2.
LOW, HIGH, AT, C0, C1, C2 = range(6)

# Columns of Circuit.noisy: element, row in noise_rates.
SOURCE, RATE = 0, 1

# What a corner guards: the sum u, the figure before saturation, a limited integrator, or how far an
# angle is from where its piece ends.
OF_SUM, OF_OUTPUT, OF_INTEGRATOR, OF_ANGLE = 0, 1, 2, 3


# Before an instant at which signals are seen, noise is resolved by a window of so many lags. What up to
# four lags make of noise is then right to 1.5e-3 of its variance (tests/test_projection.py).
TAIL_LAGS = 11.0
# In relation to that of the noise.
LEAST_LAG = 0.01
# Windows of so many lags at most show loud noise. Of a Wiener process of variance 1 per window a
# polynomial of degree 6 leaves out sum(1 / (2 (2 m - 1) (2 m + 3)), m > 6) = 0.018 on the average, so of
# the mean square of the noise n less than 2 * LOUD_LAGS * 0.018 = 0.12 %. A corner is taken on the side
# of the start, where E[sign(n(0)) n(t)] falls as exp(-t / lag): LOUD_LAGS / 2 = 1.6 % of mean |n|.
LOUD_LAGS = 1 / 32
# Kinds that are linear in their inputs.
LINEAR = frozenset({INPUT, INTEGRATE, MODE, SINE, SUM, SWITCH, TRACK})


class Circuit(NamedTuple):
    """n elements in computing order; the signal of an element has its number.

    Elements [0, heads) depend on no signal of a loop, [heads, cores) are swept until they agree,
    [cores, n) drive nothing that is in a loop.
    """

    rows: Ints  # (n, 14): see the columns above
    figures: Floats  # (n, 7): see the columns above
    signal: npt.NDArray[np.uint64]  # (terms,); unsigned: a sign would be looked at each time
    gain: Floats  # (terms,)
    laws: Floats  # (laws, 2): y' = drive * v - rate * y as (rate, drive), 1/s
    taus_s: Floats  # distinct times of decay, ascending: the boundary layers after a jump
    corners: Ints  # (corners, 5): see the columns above
    pieces: Floats  # (pieces, 6): see the columns above
    ranges: Ints  # (2,): heads, cores
    torn: Ints  # elements that are read before they are computed
    initial: (
        Floats  # (n, 2): integrator's state or what a store holds; lagged output (nan: settled)
    )
    initial_piece: Ints  # (corners,)
    noisy: Ints  # (noisy, 2): see the columns above
    noise: Floats  # (noisy,): rms
    noise_rates: Floats  # distinct rates at which noise forgets, 1/s
    tails_s: Floats  # before an instant, no longer window ends within these; descending
    longest_s: float  # no window is longer
    grain: float  # largest rms of any noise
    outside: Ints  # (pairs, 2): a corner, and an element that drives its loops from outside


class Builder:
    """Collects elements by name and lays them out as a `Circuit`.

    `errors` are the fields of `Element` that any of them may have: gain (1 plus its error), offset,
    saturation, lag_s, noise (needs a lag), initial_output.
    """

    def __init__(self) -> None:
        """Start with no elements."""
        self.elements: dict[str, Element] = {}
        self.inputs: list[str] = []

    def add(self, name: str, element: Element) -> None:
        """Add an element whose output is the signal `name`."""
        if name in self.elements:
            raise ValueError(f"{name} is driven twice")
        self.elements[name] = element

    def input(self, name: str, **errors: Any) -> None:
        """A figure held by the caller between instants: State.held, in the order of these calls."""
        self.inputs.append(name)
        self.add(name, Element(INPUT, **errors))

    def sine(
        self, name: str, amplitude: float, omega: float, phase: float = 0.0, **errors: Any
    ) -> None:
        """amplitude * sin(omega * t + phase), omega in rad/s."""
        self.add(name, Element(SINE, figures=(amplitude, omega, phase), **errors))

    def sum(self, name: str, of: Mapping[str, float], constant: float = 0.0, **errors: Any) -> None:
        """Sum of gains * signals + constant."""
        self.add(name, Element(SUM, of, constant, **errors))

    def integrate(
        self,
        name: str,
        of: Mapping[str, float],
        initial: float = 0.0,
        constant: float = 0.0,
        feedback: float = 0.0,
        limits: tuple[float, float] | None = None,
        initial_of: Mapping[str, float] | None = None,
        keeps: bool = False,
        **errors: Any,
    ) -> None:
        """x' = gains * signals + constant + feedback * x, gains in 1/s; stopped at its limits.

        At the start and in IC: x = `initial` plus the sum `initial_of`; keeps: HOLD turns off the
        feedback, too. `errors` may also name what sets its mode: control, reset, hold.
        """
        element = Element(
            INTEGRATE,
            of,
            constant,
            initial_of or {},
            initial,
            figures=(feedback, float(keeps)),
            limits=limits,
            initial=initial,
            **errors,
        )
        self.add(name, element)

    def product(
        self, name: str, of: Mapping[str, float], by: Mapping[str, float], **errors: Any
    ) -> None:
        """Product of two sums."""
        self.add(name, Element(PRODUCT, of, second=by, **errors))

    def quotient(
        self, name: str, of: Mapping[str, float], by: Mapping[str, float], **errors: Any
    ) -> None:
        """Quotient of two sums."""
        self.add(name, Element(QUOTIENT, of, second=by, **errors))

    def function(
        self, name: str, kind: int, of: Mapping[str, float], exponent: float = 0.0, **errors: Any
    ) -> None:
        """SQRT (0 below 0), SIN, COS, or POWER: sign(u) |u|^exponent."""
        self.add(name, Element(kind, of, figures=(exponent,), **errors))

    def piecewise(
        self,
        name: str,
        of: Mapping[str, float],
        pieces: Sequence[tuple[float, ...]],
        constant: float = 0.0,
        initial_piece: int = 0,
        **errors: Any,
    ) -> None:
        """A function of a sum, in pieces: see `abs_pieces` and those beside it."""
        element = Element(
            PIECES, of, constant, pieces=pieces, initial_piece=initial_piece, **errors
        )
        self.add(name, element)

    def switch(
        self,
        name: str,
        on: Mapping[str, float],
        off: Mapping[str, float],
        control: str,
        **errors: Any,
    ) -> None:
        """The sum `on` while `control` is high, else `off`.

        A comparator is high in its upper piece, any other signal above 1/2 right after a jump.
        """
        self.add(name, Element(SWITCH, on, second=off, control=control, **errors))

    def track(
        self,
        name: str,
        of: Mapping[str, float],
        control: str,
        initial: float = 0.0,
        leak: float = 0.0,
        **errors: Any,
    ) -> None:
        """Follows the sum while `control` is high, else holds what it was, but for `leak`, in 1/s."""
        store = Element(TRACK, of, control=control, initial=initial, figures=(leak,), **errors)
        self.add(name, store)

    def mode(
        self,
        name: str,
        which: int = NUMBER,
        control: str | None = None,
        reset: str | None = None,
        hold: str | None = None,
    ) -> None:
        """The machine's mode as `control` (its number), `reset` and `hold` make it.

        which: NUMBER, or the mode in which the output is 1, else 0.
        """
        made = Element(MODE, control=control, reset=reset, hold=hold, figures=(float(which),))
        self.add(name, made)

    def build(self) -> tuple[Circuit, dict[str, int]]:
        """The circuit, and the number of each signal."""
        order, ranges = computing_order(self.elements)
        return lay_out(self.elements, self.inputs, order, ranges), {
            n: i for i, n in enumerate(order)
        }


def lay_out(
    elements: Mapping[str, Element],
    inputs: Sequence[str],
    order: Sequence[str],
    ranges: tuple[int, int],
) -> Circuit:
    """The rows of a `Circuit` for elements in this order."""
    row = [elements[name] for name in order]
    corners = [_corners(e) for e in row]
    shapes = tuple(_shape(e, found) for e, found in zip(row, corners, strict=True))
    frame = _frame(tuple(order), tuple(inputs), ranges, shapes)
    figures = [_figures(e) for e in row]
    gains = [gain for e in row for gain in _gains(e)]
    pieces = [p for found in corners for _, these, _ in found for p in these]
    return frame._replace(
        figures=np.array(figures, dtype=float).reshape(-1, 7),
        gain=np.array(gains, dtype=float),
        pieces=np.array(pieces, dtype=float).reshape(-1, 6),
        initial=np.array([(e.initial, e.initial_output) for e in row]).reshape(-1, 2),
    )


def _figures(e: Element) -> tuple[float, ...]:
    """A row of `Circuit.figures`. The gain of sums and products is in those of their terms."""
    constant, gain, offset = e.constant, e.gain, e.offset
    if e.kind in (SUM, PRODUCT):
        constant, gain = constant * gain, 1.0
    if e.kind == SUM:
        constant, offset = constant + offset, 0.0
    return (constant, e.second_constant, gain, offset, *e.figures, 0.0, 0.0, 0.0)[:7]


def _gains(e: Element) -> list[float]:
    """The gains of its terms, of the first sum and then of the second."""
    factor = e.gain if e.kind in (SUM, PRODUCT) else 1.0
    return [*(factor * gain for gain in e.first.values()), *e.second.values()]


# What an element has beside its gains, constants and first values.
Shape = tuple[Any, ...]
# What a corner guards, its pieces, and the piece it begins in.
Corner = tuple[int, Sequence[tuple[float, ...]], int]
_KIND, _FIRST, _SECOND, _CONTROL, _RESET, _HOLD, _LAG_S, _NOISE, _LOUD, _FEEDBACK, _CORNERS = range(
    11
)


def _shape(e: Element, corners: Sequence[Corner]) -> Shape:
    """What decides where the figures of an element stand; runs of one patch mostly share it."""
    return (
        e.kind,
        tuple(e.first),
        tuple(e.second),
        e.control,
        e.reset,
        e.hold,
        e.lag_s,
        e.noise,
        e.loud,
        e.figures[0] if e.kind == INTEGRATE and e.figures else 0.0,
        tuple((role, len(pieces), first) for role, pieces, first in corners),
    )


def _corners(e: Element) -> list[Corner]:
    """What each corner guards, its pieces, and the piece it begins in."""
    found: list[Corner] = []
    if e.kind == INTEGRATE:
        limits = _integrator_limits(e)
        if limits is not None:
            found.append((OF_INTEGRATOR, _integrator_pieces(*limits), 1))
    elif e.kind == PIECES:
        found.append((OF_SUM, e.pieces, e.initial_piece))
    elif e.kind == ANGLE:
        found.append((OF_ANGLE, angle_pieces(), 1))
    if math.isfinite(e.saturation) and e.kind != INTEGRATE:
        found.append((OF_OUTPUT, limit_pieces(-e.saturation, e.saturation), 1))
    return found


@functools.lru_cache(maxsize=64)
def _frame(
    order: tuple[str, ...],
    inputs: tuple[str, ...],
    ranges: tuple[int, int],
    shapes: tuple[Shape, ...],
) -> Circuit:
    """The circuit without gains, constants, pieces and first values; runs share its arrays."""
    place = {name: i for i, name in enumerate(order)}
    laws: dict[tuple[float, float], int] = {}
    corners: list[tuple[int, int, int, int]] = []  # element, role, pieces, first piece
    noisy = [i for i, s in enumerate(shapes) if s[_NOISE] > 0.0]
    noise_rates = sorted({1.0 / shapes[i][_LAG_S] for i in noisy})
    noisy_rows = [(i, noise_rates.index(1.0 / shapes[i][_LAG_S])) for i in noisy]
    rows, reads = np.full((len(order), 14), -1), [_reads(s) for s in shapes]
    edges = {(place[r], i) for i, names in enumerate(reads) for r in names}
    loops = loops_of(len(order), edges)
    read_at: dict[str, int] = {}  # by which element first
    for i, names in enumerate(reads):
        for name in names:
            read_at.setdefault(name, i)
    for i, (name, s) in enumerate(zip(order, shapes, strict=True)):
        rows[i, KIND], rows[i, CONTROL] = s[_KIND], _control(name, s, inputs, place)
        rows[i, RESET] = -1 if s[_RESET] is None else place[s[_RESET]]
        rows[i, HOLD_BY] = -1 if s[_HOLD] is None else place[s[_HOLD]]
        if s[_KIND] == INTEGRATE:
            rows[i, LAW] = laws.setdefault((-s[_FEEDBACK], 1.0), len(laws))
        for role, pieces, first in s[_CORNERS]:
            rows[i, STOP if role == OF_OUTPUT else CORNER] = len(corners)
            corners.append((i, role, pieces, first))
        if s[_LAG_S] > 0.0:
            rows[i, LAG] = laws.setdefault((1.0 / s[_LAG_S], 1.0 / s[_LAG_S]), len(laws))
        rows[i, TEAR] = read_at.get(name, len(order)) <= i
        rows[i, NOISE] = noisy.index(i) if s[_NOISE] > 0.0 else -1
        if s[_KIND] in (SUM, PRODUCT, INTEGRATE) and not s[_CORNERS]:
            rows[i, PLAIN] = s[_KIND]
    sums = [terms for s in shapes for terms in (s[_FIRST], s[_SECOND])]
    ends = np.cumsum([0] + [len(terms) for terms in sums])
    rows[:, FIRST], rows[:, SECOND], rows[:, END] = ends[:-1:2], ends[1::2], ends[2::2]
    piece_ends = np.cumsum([0] + [c[2] for c in corners])
    taus_s = np.array(sorted({1.0 / rate for rate, _ in laws if rate > 0.0}))
    none = np.zeros((0, 0))
    return Circuit(
        rows,
        none,
        np.array([place[name] for terms in sums for name in terms], dtype=np.uint64),
        np.zeros(0),
        np.array(list(laws), dtype=float).reshape(-1, 2),
        taus_s,
        np.array(
            [
                (c[0], c[1], piece_ends[k], piece_ends[k + 1], c[0] in loops)
                for k, c in enumerate(corners)
            ],
            dtype=np.int64,
        ).reshape(-1, 5),
        none,
        np.array(ranges),
        np.flatnonzero(rows[:, TEAR]),
        none,
        np.array([c[3] for c in corners], dtype=np.int64),
        np.array(noisy_rows, dtype=np.int64).reshape(-1, 2),
        np.array([shapes[i][_NOISE] for i in noisy], dtype=float),
        np.array(noise_rates, dtype=float),
        _tails(taus_s, noise_rates),
        LOUD_LAGS * min((shapes[i][_LAG_S] for i in _distorted(shapes, edges)), default=math.inf),
        max((s[_NOISE] for s in shapes), default=0.0),
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


def _reads(s: Shape) -> tuple[str, ...]:
    """Names of the signals that an element of this shape needs at the same instant."""
    return (*s[_FIRST], *s[_SECOND], *(c for c in (s[_CONTROL], s[_RESET], s[_HOLD]) if c))


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
        return any(s[_KIND] not in LINEAR or s[_CORNERS] for s in reached)

    loud = [i for i, s in enumerate(shapes) if s[_LOUD] and s[_NOISE] > 0.0]
    return [i for i in loud if reaches_curves(i)]


def distorted_noise(elements: Mapping[str, Element]) -> dict[str, float]:
    """Loud noise that reaches what is not linear, by element: how long a window may be for it, in s."""
    names = list(elements)
    place = {name: i for i, name in enumerate(names)}
    shapes = [_shape(e, _corners(e)) for e in elements.values()]
    edges = {(place[r], i) for i, s in enumerate(shapes) for r in _reads(s)}
    return {names[i]: LOUD_LAGS * shapes[i][_LAG_S] for i in _distorted(shapes, edges)}


def _control(name: str, s: Shape, inputs: Sequence[str], place: Mapping[str, int]) -> int:
    if s[_KIND] == INPUT:
        return inputs.index(name)
    return -1 if s[_CONTROL] is None else place[s[_CONTROL]]


def _integrator_limits(element: Element) -> tuple[float, float] | None:
    """Bounds of the state: its own, or those at which the output saturates."""
    if element.limits is not None or not math.isfinite(element.saturation):
        return element.limits
    ends = [(s * element.saturation - element.offset) / element.gain for s in (-1.0, 1.0)]
    return min(ends), max(ends)


def _integrator_pieces(low: float, high: float) -> list[tuple[float, ...]]:
    """At its lower limit and free to leave once driven up, between the limits, at its upper limit."""
    return [
        (-math.inf, 0.0, 0.0, low, 0.0, 0.0),
        (low, high, 0.0, 0.0, 1.0, 0.0),
        (0.0, math.inf, 0.0, high, 0.0, 0.0),
    ]
