"""Safe arithmetic: the text of a patch file becomes a small tree of our own nodes, never code.

Valid are numbers, names (ASCII letters, digits, underscore), + - * / ** and parentheses, the
constant pi and the functions in `FUNCTIONS`. `^` means power, as on paper. A number with a unit
("1 ms") stands alone and becomes a `Number` in SI units. Python's parser reads the text; nothing
is ever evaluated by Python.

The tree is canonical: a minus before a literal is part of the number, a plus before a term is
dropped. So `parse(to_text(tree)) == tree` for every tree that `parse` gives.
"""

from __future__ import annotations

import ast
import keyword
import math
import re
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass
from typing import Literal, TypeAlias, TypeVar

from hybrid.errors import did_you_mean
from hybrid.units import (
    PURE,
    Dimension,
    UnitError,
    looks_like_quantity,
    parse_quantity,
    split_quantity,
)

LONGEST_TEXT = 2000
DEEPEST_TREE = 100


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

_VALID = "valid are numbers, names, + - * / ** ( ), pi and " + ", ".join(FUNCTIONS)

_OPERATORS: dict[type[ast.operator], Literal["+", "-", "*", "/", "**"]] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
}

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

_WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*+", re.ASCII)
_BAD_CHARACTER = re.compile(r"[^A-Za-z0-9_.+\-*/^(), \t\n]")
_NUMBER_THEN_NAME = re.compile(
    r"(?<![\w.])((?:\d++\.?+\d*+|\.\d++)(?:[eE][+-]?\d++)?+)[ \t]*+([A-Za-z_]\w*+)", re.ASCII
)


def parse(
    text: str | int | float, names: Set[str] = frozenset(), allow_previous: bool = False
) -> Node:
    """Read an expression such as "-omega_p**2 * theta", a number, or a quantity such as "1 ms".

    Parameters
    ----------
    text
        at most 2000 characters and 100 operations deep.
    names
        known signals and parameters: "3 cycle" is refused if cycle is one of them.
    allow_previous
        whether previous(name) is valid, as it is in a digital program.

    Raises
    ------
    ExpressionError
        for anything else; the message says what would be valid.
    """
    if not isinstance(text, str):
        return _quantity(text)
    if len(text) > LONGEST_TEXT:
        raise ExpressionError(
            f"an expression has at most {LONGEST_TEXT} characters, this has {len(text)}"
        )
    if looks_like_quantity(text):
        _refuse_hidden_product(text, names)
        return _quantity(text)
    _refuse_foreign_text(text)
    return _Reader(text, allow_previous).expression()


def _quantity(text: str | int | float) -> Number:
    """A number or a quantity, by the units module."""
    try:
        quantity = parse_quantity(text)
    except UnitError as error:
        advice = " (a product needs *)" if isinstance(text, str) else ""
        raise ExpressionError(f"{error}{advice}") from None
    return Number(quantity.value, quantity.dimension)


def _refuse_hidden_product(text: str, names: Set[str]) -> None:
    """Refuse "3 cycle" where cycle is a name of the patch: it would be read as three turns."""
    try:
        number, unit = split_quantity(text)
    except UnitError as error:
        raise ExpressionError(str(error)) from None
    words = _WORD.findall(unit)
    if names & set(words) and set(words) <= names | RESERVED_NAMES:
        raise ExpressionError(
            f"write {number}*{unit}: {words[0]} is a name of this patch "
            "(for a unit of the same name write its long form, such as meter for m)"
        )


def _refuse_foreign_text(text: str) -> None:
    """Refuse, with its column, what Python would read and arithmetic does not know."""
    if found := _BAD_CHARACTER.search(text):
        raise ExpressionError(f"unexpected {found[0]!r}; {_VALID}", found.start() + 1)
    if found := _NUMBER_THEN_NAME.search(text):
        raise ExpressionError(
            f"write {found[1]}*{found[2]} for a product; a number with a unit must stand alone, "
            "so make it a parameter",
            found.start() + 1,
        )
    for found in _WORD.finditer(text):
        if keyword.iskeyword(found[0]):
            raise ExpressionError(f"{found[0]!r} is a reserved word; {_VALID}", found.start() + 1)


class _Reader:
    """Turns Python's syntax tree of one text into nodes of our own, refusing all else."""

    def __init__(self, text: str, allow_previous: bool):
        self._allow_previous = allow_previous
        body = text.replace("\n", " ")
        skipped = len(body) - len(body.lstrip())
        # Column in the text given, for each character that Python sees.
        self._column = [
            place + 1
            for place, letter in enumerate(body)
            for _ in range(2 if letter == "^" else 1)
            if place >= skipped
        ]
        self._source = body.strip().replace("^", "**")

    def expression(self) -> Node:
        if not self._source:
            raise ExpressionError(f"an expression is missing; {_VALID}")
        try:
            tree = ast.parse(self._source, mode="eval")
        except SyntaxError as error:
            place = min(error.offset or len(self._source), len(self._source))
            reason = re.split("[.;] ", error.msg)[0]
            raise ExpressionError(
                f"not arithmetic ({reason}); {_VALID}", self._column[place - 1]
            ) from None
        # How deep Python's parser goes depends on its version and on the stack in use.
        except (RecursionError, MemoryError):
            raise self._too_deep() from None
        return self._read(tree.body, 1)

    def _read(self, node: ast.expr, depth: int) -> Node:
        if depth > DEEPEST_TREE:
            raise self._too_deep()
        match node:
            case ast.Constant(value=int() | float() as value):
                return self._number(node, value)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._read(operand, depth + 1)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return _negative(self._read(operand, depth + 1))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                symbol = _OPERATORS[type(op)]
                return Binary(symbol, self._read(left, depth + 1), self._read(right, depth + 1))
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
                return self._call(node, name, tuple(self._read(a, depth + 1) for a in args))
        shown = _shown(self._source[node.col_offset : node.end_col_offset])
        raise self._error(f"{shown} is not arithmetic; {_VALID}", node)

    def _number(self, node: ast.expr, value: int | float) -> Number:
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if math.isinf(number):
            raise self._error("this number is too large; the limit is about 1.8e308", node)
        text = self._source[node.col_offset : node.end_col_offset]
        if number == 0.0 and re.search("[1-9]", re.split("[eE]", text)[0]):
            raise self._error("this number is too small; the limit is about 5e-324", node)
        return Number(number)

    def _name(self, node: ast.expr, name: str) -> Node:
        if name == "pi":
            return Number(math.pi)
        if name in RESERVED_NAMES:
            raise self._error(f"{name} is a function; write {name}(...)", node)
        return Name(name)

    def _call(self, node: ast.expr, name: str, args: tuple[Node, ...]) -> Call:
        if name == "previous":
            if not self._allow_previous:
                raise self._error("previous() is valid only in a digital program", node)
            if len(args) != 1 or not isinstance(args[0], Name):
                raise self._error("previous() takes one name: previous(theta)", node)
            return Call(name, args)
        function = FUNCTIONS.get(name)
        if function is None:
            advice = did_you_mean(name, FUNCTIONS)
            raise self._error(f"unknown function {name!r}; {advice}", node)
        if not function.fewest <= len(args) <= function.most:
            count = " to ".join(map(str, sorted({function.fewest, function.most})))
            raise self._error(f"{name}() takes {count} argument(s), not {len(args)}", node)
        return Call(name, args)

    def _error(self, message: str, node: ast.expr) -> ExpressionError:
        return ExpressionError(message, self._column[node.col_offset])

    def _too_deep(self) -> ExpressionError:
        return ExpressionError(
            f"nested more than {DEEPEST_TREE} operations deep; split it into named signals"
        )


def _negative(operand: Node) -> Node:
    if isinstance(operand, Number):
        return Number(-operand.value, operand.dimension)
    return Unary("-", operand)


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
        compute, operands = float, (_look_up(tree, scope),)
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
        shown = ", ".join(f"{operand:g}" for operand in operands)
        raise ExpressionError(f"{_shown(to_text(tree))} has no finite value for operands {shown}")
    return value


def dimension_of(tree: Node, scope: Mapping[str, Dimension | None]) -> Dimension | None:
    """Dimension of an expression; None where it is unknown.

    A literal 0 has no dimension of its own (None), so it fits any. What is unknown never
    conflicts: the sum of a known and an unknown dimension is the known one.

    Raises ExpressionError for a name that `scope` lacks, and naming both sides and their units
    where dimensions conflict.
    """
    if isinstance(tree, Number):
        return None if tree.value == 0.0 and tree.dimension.is_pure else tree.dimension
    if isinstance(tree, Name):
        return _look_up(tree, scope)
    parts = [(part, dimension_of(part, scope)) for part in children(tree)]
    if isinstance(tree, Unary):
        return parts[0][1]
    if isinstance(tree, Call):
        return _call_dimension(tree, parts)
    if tree.op in ("+", "-"):
        return _alike(tree, parts)
    (_, left), (_, right) = parts
    if tree.op == "**":
        return _power_dimension(tree, left, right)
    if left is None or right is None:
        return None
    return left * right if tree.op == "*" else left / right


_Parts: TypeAlias = list[tuple[Node, Dimension | None]]


def _alike(tree: Node, parts: _Parts) -> Dimension | None:
    """The one dimension that all known parts share."""
    known = [(part, dimension) for part, dimension in parts if dimension is not None]
    for part, dimension in known[1:]:
        first, expected = known[0]
        if dimension != expected:
            raise ExpressionError(
                f"in {_shown(to_text(tree))}: {_shown(to_text(first))} [{expected}] and "
                f"{_shown(to_text(part))} [{dimension}] must have the same units"
            )
    return known[0][1] if known else None


def _call_dimension(tree: Call, parts: _Parts) -> Dimension | None:
    if tree.function == "previous":
        return parts[0][1]
    rule = FUNCTIONS[tree.function].rule
    if rule == "pure":
        for part, dimension in parts:
            _require_pure(tree, part, dimension)
        return PURE
    shared = _alike(tree, parts)
    if rule == "ratio":
        return PURE
    return shared**0.5 if rule == "root" and shared is not None else shared


def _power_dimension(
    tree: Binary, base: Dimension | None, exponent: Dimension | None
) -> Dimension | None:
    _require_pure(tree, tree.right, exponent)
    if base is None or base.is_pure:
        return base
    if not is_constant(tree.right):
        raise ExpressionError(
            f"in {_shown(to_text(tree))}: {_shown(to_text(tree.left))} [{base}] has a unit, so its "
            "exponent must be a plain number"
        )
    return base ** evaluate(tree.right, {})


def _require_pure(tree: Node, part: Node, dimension: Dimension | None) -> None:
    if dimension is not None and not dimension.is_pure:
        raise ExpressionError(
            f"in {_shown(to_text(tree))}: {_shown(to_text(part))} [{dimension}] must be a pure "
            "number; divide it by a unit or a full scale"
        )


_Value = TypeVar("_Value")


def _look_up(name: Name, scope: Mapping[str, _Value]) -> _Value:
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


def _shown(text: str) -> str:
    """Text quoted for a one-line message, cut where it is long."""
    return repr(text if len(text) <= 60 else text[:57] + "...")
