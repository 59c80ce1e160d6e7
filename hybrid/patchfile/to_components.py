"""A program word as one analog component: what a patch panel has for its arithmetic.

One word is one component, since every output of the analog machine needs a full scale, and only a word
can be given one. A state becomes an integrator, and its rate must be a sum.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field

import numpy as np

from hybrid.errors import PatchError
from hybrid.expressions import (
    Binary,
    Call,
    LookUp,
    Name,
    Node,
    Number,
    Unary,
    names,
    shown,
    sub_expressions,
    to_text,
)
from hybrid.fields import FullScale
from hybrid.patch import Assignment, Component, State, Value
from hybrid.tables import CLAMPS, CONTINUES, Table
from hybrid.units import PURE

ONE = Number(1.0)
Terms = dict[str, Node]


@dataclass(frozen=True, slots=True)
class _Made:
    """What a word is as a component, before it has a full scale."""

    kind: str
    terms: Mapping[str, Node] = field(default_factory=dict)
    signals: tuple[str, ...] = ()
    values: Mapping[str, Node] = field(default_factory=dict)
    points: tuple[tuple[float, float], ...] = ()


def is_cord(entry: Assignment | State, parameters: Collection[str]) -> bool:
    """Whether a word is another signal under another name: a plain cord on the analog machine."""
    expr = entry.expr
    return isinstance(entry, Assignment) and isinstance(expr, Name) and expr.id not in parameters


def component_of(
    entry: Assignment | State,
    scale_of: Callable[[str], FullScale],
    parameters: Collection[str],
    reference: str,
) -> Component:
    """The component that gives what the word is; it has the word's name.

    scale_of: full scale of a word, may refuse; reference: name of a constant 1, which is read where a
    number stands by itself.
    Raises PatchError where that is not one component.
    """
    writer = _Writer(entry, parameters, reference)
    made = writer.integrator(entry) if isinstance(entry, State) else writer.word(entry.expr)
    scale = scale_of(entry.word)
    if entry.dimension not in (None, PURE, scale.dimension):
        raise PatchError(
            f"full scale of word {entry.word!r} is in {scale.dimension}, and the word in "
            f"{entry.dimension}",
            scale.value.place,
        )
    values = {key: _value(entry, expr, key) for key, expr in made.values.items()}
    if isinstance(entry, State):
        values["initial"] = entry.initial
    return Component(
        entry.word,
        made.kind,
        tuple(
            (signal, _value(entry, expr, f"coefficient of {signal!r}"))
            for signal, expr in sorted(made.terms.items())
        ),
        values,
        scale.value,
        scale.unit,
        scale.factor,
        scale.dimension,
        {},
        entry.place,
        made.signals,
        points=tuple(
            (_value(entry, Number(x), "point"), _value(entry, Number(y), "point"))
            for x, y in made.points
        ),
    )


def _value(entry: Assignment | State, expr: Node, what: str) -> Value:
    return Value(expr, entry.place, f"{what} of {entry.word!r}")


class _Writer:
    """Reads the arithmetic of one word."""

    def __init__(
        self, entry: Assignment | State, parameters: Collection[str], reference: str
    ) -> None:
        self.entry, self.parameters, self.reference = entry, parameters, reference

    def refused(self, reason: str) -> PatchError:
        what = "state" if isinstance(self.entry, State) else "word"
        return PatchError(
            f"{what} {self.entry.word!r} cannot go to the analog machine: {reason}",
            self.entry.place,
        )

    def integrator(self, state: State) -> _Made:
        if state.reset_when is not None:
            raise self.refused("it has reset_when, which the program looks at once a cycle")
        terms = self.linear(state.expr)
        if terms is None:
            raise self.refused(
                f"its rate {shown(to_text(state.expr))} is no sum; give what is added words of their own"
            )
        return _Made("integrate", terms or {self.reference: Number(0.0)})

    def word(self, expr: Node) -> _Made:
        """The component by the form of the arithmetic: constant, sum, product or function."""
        if self.is_number(expr):
            return _Made("constant", values={"constant": expr})
        terms = self.linear(expr)
        if terms is not None:
            return _Made("coefficient" if len(terms) == 1 else "sum", terms)
        gain, above, below = self.factors(expr)
        if len(above) == 1 and not below and not isinstance(above[0], Name):
            return self.function(gain, above[0])
        signals = [part.id for part in (*above, *below) if isinstance(part, Name)]
        if len(signals) == len(above) + len(below) <= 2:
            if not below:
                return _Made("multiply", signals=tuple(signals), values={"gain": gain})
            if len(above) == 0 and len(below) == 1:
                signals.insert(0, self.reference)
            if len(signals) == 2 and len(below) == 1:
                return _Made("divide", signals=tuple(signals), values={"gain": gain})
        raise self.unfit(expr)

    def is_number(self, expr: Node) -> bool:
        if any(isinstance(node, LookUp) for node in sub_expressions(expr)):
            return False
        return names(expr) <= set(self.parameters) and not self.other_time(expr)

    def other_time(self, expr: Node) -> str:
        calls = (n.function for n in sub_expressions(expr) if isinstance(n, Call))
        return next((function for function in calls if function in ("previous", "next")), "")

    def unfit(self, expr: Node) -> PatchError:
        """Why it is not one component."""
        if function := self.other_time(expr):
            return self.refused(f"{function}() is of the cycles of a program")
        known = ("sqrt", "sin", "cos", "atan2", "abs", "limit", "dead_zone")
        for part in sub_expressions(expr):
            if isinstance(part, Call) and part.function not in known:
                return self.refused(f"{part.function}() has no analog component")
            if isinstance(part, LookUp) and len(part.args) > 1:
                return self.refused(
                    f"the table {part.table.name} has {len(part.args)} inputs, a function generator one"
                )
        return self.refused(
            f"{shown(to_text(expr))} is more than one component; give its parts words of their own, "
            "each with a full scale"
        )

    def linear(self, expr: Node) -> Terms | None:
        """Coefficients by signal, that of a number alone under the reference; None: not linear."""
        if self.is_number(expr):
            return {} if expr == Number(0.0) else {self.reference: expr}
        match expr:
            case Name(id):
                return {id: ONE}
            case Unary("-", operand):
                return _scaled(self.linear(operand), _negative)
            case Binary("+" | "-" as op, left, right):
                return _added(op, self.linear(left), self.linear(right))
            case Binary("*", left, right) if self.is_number(left):
                return _scaled(self.linear(right), lambda c: _product(left, c))
            case Binary("*", left, right) if self.is_number(right):
                return _scaled(self.linear(left), lambda c: _product(c, right))
            case Binary("/", left, right) if self.is_number(right):
                return _scaled(self.linear(left), lambda c: Binary("/", c, right))
        return None

    def factors(self, expr: Node) -> tuple[Node, list[Node], list[Node]]:
        """A number, and what else is multiplied by and divided by."""
        if self.is_number(expr):
            return expr, [], []
        match expr:
            case Unary("-", operand):
                gain, above, below = self.factors(operand)
                return _negative(gain), above, below
            case Binary("*" | "/" as op, left, right):
                gain, above, below = self.factors(left)
                other, over, under = self.factors(right)
                if op == "*":
                    return _product(gain, other), above + over, below + under
                return (
                    gain if other == ONE else Binary("/", gain, other),
                    above + under,
                    below + over,
                )
            case Binary("**", base, Number(2.0)):
                gain, above, below = self.factors(base)
                return _product(gain, gain), above * 2, below * 2
        return ONE, [expr], []

    def function(self, gain: Node, expr: Node) -> _Made:
        """The component of a function of one signal."""
        arguments = expr.args if isinstance(expr, Call | LookUp) else ()
        if not arguments or not isinstance(arguments[0], Name):
            raise self.unfit(expr)
        source = arguments[0].id
        if source in self.parameters:
            raise self.unfit(expr)
        if isinstance(expr, LookUp):
            if len(arguments) > 1 or expr.table.method == "limits":
                raise self.unfit(expr)
            return _Made("function", signals=(source,), points=self.points(expr.table, gain))
        match expr:
            case Call("sqrt"):
                return _Made("square_root", signals=(source,), values={"gain": gain})
            case Call("sin" | "cos" as name):
                return _Made(name, signals=(source,), values={"amplitude": gain})
            case Call("atan2", (_, Name(ahead))) if ahead not in self.parameters:
                return _Made("atan2", signals=(source, ahead), values={"gain": gain})
            case Call("abs") if gain == ONE:
                return _Made("absolute", signals=(source,))
            case Call("limit" | "dead_zone" as name, (_, low, high)) if gain == ONE:
                if self.is_number(low) and self.is_number(high):
                    return _Made(name, signals=(source,), values={"low": low, "high": high})
        raise self.unfit(expr)

    def points(self, table: Table, gain: Node) -> tuple[tuple[float, float], ...]:
        """A function generator's points: its outer lines are prolonged, so level ones clamp."""
        (axis,) = table.axes
        if (
            table.method != "linear"
            or gain != ONE
            or {axis.below, axis.above} - {CLAMPS, CONTINUES}
        ):
            raise self.refused(
                f"a function generator has straight lines and goes on beyond them; make the table "
                f"{table.name} linear, with outside: clamp or extrapolate, and no factor"
            )
        x, y = np.asarray(axis.points), np.asarray(table.values)
        if axis.below == CLAMPS:
            x, y = np.insert(x, 0, 2 * x[0] - x[1]), np.insert(y, 0, y[0])
        if axis.above == CLAMPS:
            x, y = np.append(x, 2 * x[-1] - x[-2]), np.append(y, y[-1])
        return tuple(zip(x.tolist(), y.tolist(), strict=True))


def _negative(expr: Node) -> Node:
    if isinstance(expr, Number):
        return Number(-expr.value, expr.dimension)
    return Unary("-", expr)


def _product(left: Node, right: Node) -> Node:
    if left == ONE:
        return right
    return left if right == ONE else Binary("*", left, right)


def _scaled(terms: Terms | None, by: Callable[[Node], Node]) -> Terms | None:
    return None if terms is None else {signal: by(c) for signal, c in terms.items()}


def _added(op: str, left: Terms | None, right: Terms | None) -> Terms | None:
    if left is None or right is None:
        return None
    found = dict(left)
    for signal, coefficient in right.items():
        other = coefficient if op == "+" else _negative(coefficient)
        found[signal] = Binary("+", found[signal], other) if signal in found else other
    return found


def joined(coefficients: list[Node]) -> Node:
    """The sum of coefficients of one signal."""
    return functools.reduce(lambda a, b: Binary("+", a, b), coefficients)
