"""Arithmetic as a small tree of our own nodes: its functions, its value and its text.

`parsing` makes the trees and `dimensions` finds their units. A tree is canonical: a minus before a
literal is part of the number, a plus before a term is dropped. So `parse(to_text(tree)) == tree` for
every tree that `parse` gives.
"""

from __future__ import annotations

import keyword
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, TypeVar

from hybrid.errors import did_you_mean
from hybrid.units import PURE, Dimension


class ExpressionError(ValueError):
    """An expression that cannot be read, evaluated or given a dimension.

    The message is one line and says what would be valid. `column` counts from 1 in the text given
    to `parse`; it is None where no one place is at fault.
    """

    def __init__(self, message: str, column: int | None = None):
        super().__init__(message if column is None else f"{message} (column {column})")
        self.column = column


@dataclass(frozen=True, slots=True)
class Number:
    """A finite constant in SI units; a literal without a unit is PURE."""

    value: float
    dimension: Dimension = PURE


@dataclass(frozen=True, slots=True)
class Name:
    """The present value of a signal or parameter."""

    id: str


@dataclass(frozen=True, slots=True)
class Unary:
    """Minus; `operand` is never a Number."""

    op: Literal["-"]
    operand: Node


@dataclass(frozen=True, slots=True)
class Binary:
    """One of + - * / ** (power, which groups to the right)."""

    op: Literal["+", "-", "*", "/", "**"]
    left: Node
    right: Node


@dataclass(frozen=True, slots=True)
class Call:
    """A function of `FUNCTIONS`, or "previous" with one Name: its value of the cycle before."""

    function: str
    args: tuple[Node, ...]


Node: TypeAlias = Number | Name | Unary | Binary | Call


def _sign(x: float) -> float:
    return float((x > 0.0) - (x < 0.0))


@dataclass(frozen=True, slots=True)
class Function:
    """How a function is computed, how many arguments it takes and what it does to dimensions.

    `rule` is "pure" (pure arguments, pure result), "alike" (arguments alike, result like them),
    "ratio" (arguments alike, pure result) or "root" (halves the exponents).
    """

    compute: Callable[..., float]
    rule: Literal["pure", "alike", "ratio", "root"]
    fewest: int = 1
    most: int = 1


FUNCTIONS: Mapping[str, Function] = {
    "abs": Function(abs, "alike"),
    "sqrt": Function(math.sqrt, "root"),
    "sin": Function(math.sin, "pure"),
    "cos": Function(math.cos, "pure"),
    "tan": Function(math.tan, "pure"),
    "asin": Function(math.asin, "pure"),
    "acos": Function(math.acos, "pure"),
    "atan": Function(math.atan, "pure"),
    "atan2": Function(math.atan2, "ratio", 2, 2),
    "exp": Function(math.exp, "pure"),
    "log": Function(math.log, "pure"),
    "min": Function(min, "alike", 2, 8),
    "max": Function(max, "alike", 2, 8),
    "sign": Function(_sign, "ratio"),
}

# Names that no signal or parameter may bear; Python's own words because its parser reads the text.
RESERVED_NAMES = frozenset(FUNCTIONS) | frozenset(keyword.kwlist) | {"pi", "previous"}

# math.pow and not **: a root of a negative number must fail, not turn complex.
_COMPUTE: dict[str, Callable[[float, float], float]] = {
    "+": lambda left, right: left + right,
    "-": lambda left, right: left - right,
    "*": lambda left, right: left * right,
    "/": lambda left, right: left / right,
    "**": math.pow,
}

# How strongly an operator binds: the higher first.
_STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2, "**": 4}
_UNARY_STRENGTH = 3
_STRONGEST = 5


def children(tree: Node) -> tuple[Node, ...]:
    """The operands of a node, from left to right."""
    if isinstance(tree, Unary):
        return (tree.operand,)
    if isinstance(tree, Binary):
        return (tree.left, tree.right)
    return tree.args if isinstance(tree, Call) else ()


def sub_expressions(tree: Node) -> Iterator[Node]:
    """The tree itself and all below it, each node before its operands."""
    yield tree
    for child in children(tree):
        yield from sub_expressions(child)


def names(tree: Node) -> frozenset[str]:
    """Names whose present value is needed; those only under previous() are not among them."""
    if isinstance(tree, Name):
        return frozenset({tree.id})
    if isinstance(tree, Call) and tree.function == "previous":
        return frozenset()
    return frozenset().union(*map(names, children(tree)))


def previous_names(tree: Node) -> frozenset[str]:
    """Names whose value of the cycle before is needed."""
    calls = (node for node in sub_expressions(tree) if isinstance(node, Call))
    return frozenset().union(
        *(names(call.args[0]) for call in calls if call.function == "previous")
    )


def is_constant(tree: Node) -> bool:
    """True if no name occurs, so that `evaluate` needs no scope."""
    return not any(isinstance(node, Name) for node in sub_expressions(tree))


def evaluate(tree: Node, scope: Mapping[str, float]) -> float:
    """Value of an expression, SI units in and out.

    Raises ExpressionError, naming the sub-expression, for a name that `scope` lacks, for
    previous(), and where the value is not finite and real (1/0, sqrt(-1), overflow).
    """
    compute: Callable[..., float]
    operands: tuple[float, ...]
    if isinstance(tree, Binary):
        compute = _COMPUTE[tree.op]
        operands = (evaluate(tree.left, scope), evaluate(tree.right, scope))
    elif isinstance(tree, Number):
        return tree.value
    elif isinstance(tree, Name):
        compute, operands = float, (look_up(tree, scope),)
    elif isinstance(tree, Unary):
        return -evaluate(tree.operand, scope)
    elif tree.function == "previous":
        raise ExpressionError(f"{to_text(tree)} has a value only while a program runs")
    else:
        compute = FUNCTIONS[tree.function].compute
        operands = tuple([evaluate(argument, scope) for argument in tree.args])
    try:
        value = compute(*operands)
    except (ArithmeticError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        listed = ", ".join(f"{operand:g}" for operand in operands)
        raise ExpressionError(f"{shown(to_text(tree))} has no finite value for operands {listed}")
    return value


_Value = TypeVar("_Value")


def look_up(name: Name, scope: Mapping[str, _Value]) -> _Value:
    """What `scope` says of a name; raises ExpressionError with the nearest name it has."""
    try:
        return scope[name.id]
    except KeyError:
        advice = did_you_mean(name.id, scope)
        raise ExpressionError(f"unknown name {name.id!r}; {advice}") from None


def to_text(tree: Node) -> str:
    """Text that `parse` turns into the same tree again."""
    return _text(tree, 0)


def _text(tree: Node, needed: int) -> str:
    """Text of a tree, in parentheses if it binds less strongly than `needed`."""
    if isinstance(tree, Number):
        text = _number_text(tree)
        strength = _UNARY_STRENGTH if text.startswith("-") else _STRONGEST
    elif isinstance(tree, Name):
        return tree.id
    elif isinstance(tree, Call):
        return f"{tree.function}({', '.join(map(to_text, tree.args))})"
    elif isinstance(tree, Unary):
        text, strength = "-" + _text(tree.operand, _UNARY_STRENGTH), _UNARY_STRENGTH
    else:
        strength = _STRENGTH[tree.op]
        # Power groups to the right and lets a minus stand in its exponent: a**-b**c.
        power = tree.op == "**"
        left = _text(tree.left, _STRONGEST if power else strength)
        right = _text(tree.right, _UNARY_STRENGTH if power else strength + 1)
        space = " " if strength == 1 else ""
        text = f"{left}{space}{tree.op}{space}{right}"
    return text if strength >= needed else f"({text})"


def _number_text(number: Number) -> str:
    text = repr(number.value).removesuffix(".0")
    return text if number.dimension.is_pure else f"{text} {number.dimension}"


def shown(text: str) -> str:
    """Text quoted for a one-line message, cut where it is long."""
    return repr(text if len(text) <= 60 else text[:57] + "...")
