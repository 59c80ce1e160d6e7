"""Circuits put together element by element, for tests of the engine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

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
from hybrid.engine.circuit import Circuit
from hybrid.engine.wiring import lay_out


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
        return lay_out(tuple(self.elements.items()))
