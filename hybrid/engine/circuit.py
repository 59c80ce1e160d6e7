"""A flat description of an analog circuit: one row for each element, in the order they are computed.

Stage 4. Every parameter is data, so the kernel is compiled once. Figures are in machine units (1 is full
scale) and seconds; `elements` says what an element computes, and `wiring` lays it out.

What is not smooth is cut into pieces. An element with a corner has a list of pieces, each a parabola in
the guarded quantity that is valid between two bounds; inside a window the piece is fixed, so everything
is smooth there. Bounds of neighbouring pieces overlap where there is hysteresis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hybrid.elements import (
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
)
from hybrid.engine.arrays import Floats, Ints

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
        from hybrid.engine.wiring import lay_out  # which makes circuits, and so knows this module

        return lay_out(tuple(self.elements.items()))
