"""Arithmetic as a small tree of our own nodes: its functions, its value and its text.

`parsing` makes the trees and `dimensions` finds their units. A tree is canonical: a minus before a
literal is part of the number, a plus before a term is dropped. So `parse(to_text(tree)) == tree` for
every tree that `parse` gives. A condition is a number, too: true is 1, false is 0, and what is not 0
counts as true.
"""

from __future__ import annotations

import keyword
import math
import operator
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, TypeVar

from hybrid.errors import did_you_mean, known_as
from hybrid.helpers import HELPERS, Helper
from hybrid.tables import Table
from hybrid.units import PURE, Dimension


class ExpressionError(ValueError):
    """An expression that cannot be read, evaluated or given a dimension.

    The message is one line and says what would be valid. `column` counts from 1 in the text given
    to `parse`; it is None where no one place is at fault.
    """

    def __init__(self, message: str, column: int | None = None):
        at = "" if column is None else f" (character {column} of the expression)"
        super().__init__(message + at)
        self.column = column


BinaryOp: TypeAlias = Literal[
    "+", "-", "*", "/", "**", "<", "<=", ">", ">=", "==", "!=", "and", "or"
]


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
    """Minus, whose operand is never a Number, or "not"."""

    op: Literal["-", "not"]
    operand: Node


@dataclass(frozen=True, slots=True)
class Binary:
    """Arithmetic (** is power, which groups to the right), comparison, "and" or "or"."""

    op: BinaryOp
    left: Node
    right: Node


@dataclass(frozen=True, slots=True)
class Call:
    """A function of `FUNCTIONS`, or "previous" with one Name: its value of the cycle before, or with a
    second argument that many cycles before; or "next" with the Name of a state: its value at the end
    of the cycle."""

    function: str
    args: tuple[Node, ...]


@dataclass(frozen=True, slots=True)
class LookUp:
    """A table at the values of its arguments; it has a value only while a program runs."""

    table: Table
    args: tuple[Node, ...]


Node: TypeAlias = Number | Name | Unary | Binary | Call | LookUp


def _sign(x: float) -> float:
    return float((x > 0.0) - (x < 0.0))


def _limit(x: float, low: float, high: float) -> float:
    return min(max(x, low), high) if low <= high else math.nan


def _dead_zone(x: float, low: float, high: float) -> float:
    """0 from low to high, beyond them what is beyond them."""
    return x - _limit(x, low, high)


def _round(x: float) -> float:
    """To the nearest whole number, halves to the even one, as IEEE 754 rounds."""
    return float(round(x))


@dataclass(frozen=True, slots=True)
class Function:
    """How a function is computed, how many arguments it takes and what it does to dimensions.

    `rule` is "pure" (pure arguments, pure result), "alike" (arguments alike, result like them),
    "ratio" (arguments alike, pure result), "root" (halves the exponents), "select" (the first pure, the
    others alike, result like them) or "declared" (as `helper` says).
    """

    compute: Callable[..., float]
    rule: Literal["pure", "alike", "ratio", "root", "select", "declared"]
    fewest: int = 1
    most: int = 1
    helper: Helper | None = None


def _declared(helper: Helper) -> Function:
    most = len(helper.takes)
    return Function(helper.compute, "declared", most - len(helper.defaults), most, helper)


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
    "sinh": Function(math.sinh, "pure"),
    "cosh": Function(math.cosh, "pure"),
    "tanh": Function(math.tanh, "pure"),
    "asinh": Function(math.asinh, "pure"),
    "acosh": Function(math.acosh, "pure"),
    "atanh": Function(math.atanh, "pure"),
    "log10": Function(math.log10, "pure"),
    "hypot": Function(math.hypot, "alike", 2, 2),
    "floor": Function(lambda x: float(math.floor(x)), "pure"),
    "ceil": Function(lambda x: float(math.ceil(x)), "pure"),
    "round": Function(_round, "pure"),
    "mod": Function(operator.mod, "alike", 2, 2),  # has the sign of the divisor
    "limit": Function(_limit, "alike", 3, 3),
    "dead_zone": Function(_dead_zone, "alike", 3, 3),
    "select": Function(lambda chosen, a, b: a if chosen else b, "select", 3, 3),
    **{name: _declared(helper) for name, helper in HELPERS.items()},
}

# What some operations must be given to have a value: whether it is so, and in words.
NEEDS: Mapping[str, tuple[Callable[..., bool], str]] = {
    "/": (lambda _, b: b != 0.0, "a divisor other than 0"),
    "mod": (lambda _, b: b != 0.0, "a divisor other than 0"),
    "**": (
        lambda a, b: a > 0.0 or (a == 0.0 and b >= 0.0) or (a < 0.0 and b == round(b)),
        "a base above 0",
    ),
    "sqrt": (lambda a: a >= 0.0, "0 or more"),
    "log": (lambda a: a > 0.0, "more than 0"),
    "log10": (lambda a: a > 0.0, "more than 0"),
    "asin": (lambda a: -1.0 <= a <= 1.0, "-1 to 1"),
    "acos": (lambda a: -1.0 <= a <= 1.0, "-1 to 1"),
    "acosh": (lambda a: a >= 1.0, "1 or more"),
    "atanh": (lambda a: -1.0 < a < 1.0, "less than 1 and more than -1"),
    "limit": (lambda _, low, high: low <= high, "a low that is not above its high"),
    "dead_zone": (lambda _, low, high: low <= high, "a low that is not above its high"),
}

# Functions of a program word that give its value of another cycle.
OTHER_TIMES = frozenset({"previous", "next"})
# Names that no signal or parameter may bear; Python's own words because its parser reads the text.
RESERVED_NAMES = frozenset(FUNCTIONS) | frozenset(keyword.kwlist) | OTHER_TIMES | {"pi"}

# math.pow and not **: a root of a negative number must fail, not turn complex.
OPERATORS: Mapping[str, Callable[[float, float], float]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "**": math.pow,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
    "and": lambda left, right: left != 0.0 and right != 0.0,
    "or": lambda left, right: left != 0.0 or right != 0.0,
}
COMPARISONS = frozenset({"<", "<=", ">", ">=", "==", "!="})
LOGIC = frozenset({"and", "or", "not"})

# How strongly an operator binds: the higher first, as in Python.
_STRENGTH = {"or": 1, "and": 2, **dict.fromkeys(COMPARISONS, 4), "+": 5, "-": 5, "*": 6, "/": 6}
_STRENGTH["**"] = 8
_UNARY_STRENGTH = {"not": 3, "-": 7}
_STRONGEST = 9


def children(tree: Node) -> tuple[Node, ...]:
    """The operands of a node, from left to right."""
    if isinstance(tree, Unary):
        return (tree.operand,)
    if isinstance(tree, Binary):
        return (tree.left, tree.right)
    return tree.args if isinstance(tree, Call | LookUp) else ()


def sub_expressions(tree: Node) -> Iterator[Node]:
    """The tree itself and all below it, each node before its operands."""
    yield tree
    for child in children(tree):
        yield from sub_expressions(child)


def names(tree: Node) -> frozenset[str]:
    """Names whose present value is needed; a word only under previous() or next() is not."""
    if isinstance(tree, Name):
        return frozenset({tree.id})
    needed = children(tree)
    if isinstance(tree, Call) and tree.function in OTHER_TIMES:
        needed = needed[1:]
    return frozenset().union(*map(names, needed))


def previous_calls(tree: Node) -> tuple[Call, ...]:
    """Every previous() in the tree."""
    calls = (node for node in sub_expressions(tree) if isinstance(node, Call))
    return tuple(call for call in calls if call.function == "previous")


def previous_names(tree: Node) -> frozenset[str]:
    """Names whose value of a cycle before is needed."""
    return frozenset().union(*(names(call.args[0]) for call in previous_calls(tree)))


def next_names(tree: Node) -> frozenset[str]:
    """States whose value at the end of the cycle is needed."""
    calls = (node for node in sub_expressions(tree) if isinstance(node, Call))
    return frozenset().union(*(names(call.args[0]) for call in calls if call.function == "next"))


def renamed(tree: Node, new: Mapping[str, str]) -> Node:
    """The tree with other names for present values; what previous() and next() name stays."""
    return substituted(tree, {old: Name(name) for old, name in new.items()})


def substituted(tree: Node, new: Mapping[str, Node]) -> Node:
    """The tree with expressions in place of present values; what previous() and next() name stays."""
    match tree:
        case Name(id):
            return new.get(id, tree)
        case Unary(op, operand):
            return Unary(op, substituted(operand, new))
        case Binary(op, left, right):
            return Binary(op, substituted(left, new), substituted(right, new))
        case Call(function, args) if function not in OTHER_TIMES:
            return Call(function, tuple([substituted(argument, new) for argument in args]))
        case LookUp(table, args):
            return LookUp(table, tuple([substituted(argument, new) for argument in args]))
    return tree


def is_constant(tree: Node) -> bool:
    """True if no name and no table occurs, so that `evaluate` needs no scope."""
    return not any(isinstance(node, Name | LookUp) for node in sub_expressions(tree))


def asks_table(tree: Node) -> bool:
    """Whether a table occurs."""
    return any(isinstance(node, LookUp) for node in sub_expressions(tree))


def evaluate(tree: Node, scope: Mapping[str, float]) -> float:
    """Value of an expression, SI units in and out.

    Raises ExpressionError, naming the sub-expression, for a name that `scope` lacks, for
    previous(), and where the value is not finite and real (1/0, sqrt(-1), overflow).
    """
    if isinstance(tree, Number):
        return tree.value
    if isinstance(tree, Name):
        return _finite(tree, float, (look_up(tree, scope),))
    if isinstance(tree, Unary):
        value = evaluate(tree.operand, scope)
        return -value if tree.op == "-" else float(not value)
    if isinstance(tree, Binary):
        return _evaluate_binary(tree, scope)
    if isinstance(tree, LookUp) or tree.function in OTHER_TIMES:
        raise ExpressionError(f"{to_text(tree)} has a value only while a program runs")
    if tree.function == "select":  # what is not selected need have no value
        condition, chosen, other = tree.args
        return evaluate(chosen if evaluate(condition, scope) else other, scope)
    operands = tuple([evaluate(argument, scope) for argument in tree.args])
    return _finite(tree, FUNCTIONS[tree.function].compute, operands)


def _evaluate_binary(tree: Binary, scope: Mapping[str, float]) -> float:
    left = evaluate(tree.left, scope)
    if tree.op in LOGIC and bool(left) is (tree.op == "or"):
        return float(bool(left))  # the right side need have no value
    return _finite(tree, OPERATORS[tree.op], (left, evaluate(tree.right, scope)))


def _finite(tree: Node, compute: Callable[..., float], operands: tuple[float, ...]) -> float:
    """The value that `compute` gives; raises ExpressionError where it is not finite and real."""
    try:
        value = float(compute(*operands))
    except (ArithmeticError, ValueError):
        value = math.nan
    if not math.isfinite(value):
        listed = ", ".join(f"{operand:g}" for operand in operands)
        raise ExpressionError(
            f"{shown(to_text(tree))} has no finite value for operands {listed}{_need(tree, operands)}"
        )
    return value


def _need(tree: Node, operands: tuple[float, ...]) -> str:
    """What would be valid where an operation is asked for what it has no value for; else ''."""
    name = tree.op if isinstance(tree, Binary) else getattr(tree, "function", "")
    fits, told = NEEDS.get(name, (lambda *_: True, ""))
    if not fits(*operands):
        return f"; {name} needs {told}"
    return "" if isinstance(tree, Name) else "; numbers end at 1.8e308"


_Value = TypeVar("_Value")


def look_up(name: Name, scope: Mapping[str, _Value]) -> _Value:
    """What `scope` says of a name; raises ExpressionError with the nearest name it has."""
    try:
        return scope[name.id]
    except KeyError:
        advice = did_you_mean(name.id, scope)
        raise ExpressionError(f"unknown name {name.id!r}; {advice}") from None


def is_known(tree: Node, parameters: Collection[str]) -> bool:
    """Whether an expression has a value before the run: it reads parameters alone, and no table."""
    timeless = not (previous_names(tree) or next_names(tree) or asks_table(tree))
    return timeless and all(name in parameters for name in names(tree))


def to_text(tree: Node) -> str:
    """Text that `parse` turns into the same tree again."""
    return _text(tree, 0)


def _text(tree: Node, needed: int) -> str:
    """Text of a tree, in parentheses if it binds less strongly than `needed`."""
    if isinstance(tree, Number):
        text = _number_text(tree)
        strength = _UNARY_STRENGTH["-"] if text.startswith("-") else _STRONGEST
    elif isinstance(tree, Name):
        return known_as(tree.id)
    elif isinstance(tree, Call):
        return f"{tree.function}({', '.join(map(to_text, tree.args))})"
    elif isinstance(tree, LookUp):
        return f"{known_as(tree.table.name)}({', '.join(map(to_text, tree.args))})"
    elif isinstance(tree, Unary):
        strength = _UNARY_STRENGTH[tree.op]
        text = ("-" if tree.op == "-" else "not ") + _text(tree.operand, strength)
    else:
        strength = _STRENGTH[tree.op]
        # Power groups to the right and lets a minus stand in its exponent: a**-b**c. What a comparison
        # compares is no comparison: a < b < c means a < b and b < c.
        power, compares = tree.op == "**", tree.op in COMPARISONS
        left = _text(tree.left, _STRONGEST if power else strength + compares)
        right = _text(tree.right, _UNARY_STRENGTH["-"] if power else strength + 1)
        space = " " if strength <= _STRENGTH["+"] else ""
        text = f"{left}{space}{tree.op}{space}{right}"
    return text if strength >= needed else f"({text})"


def _number_text(number: Number) -> str:
    text = repr(number.value).removesuffix(".0")
    return text if number.dimension.is_pure else f"{text} {number.dimension}"


def shown(text: str) -> str:
    """Text quoted for a one-line message, cut where it is long."""
    return repr(text if len(text) <= 60 else text[:57] + "...")
