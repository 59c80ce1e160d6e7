"""Reading arithmetic: the text of a patch file becomes a tree, never code.

Valid are numbers, names (ASCII letters, digits, underscore; a dot between a part and what is in it),
+ - * / ** and parentheses, comparisons, `and`, `or`, `not`, the constant pi and the functions in
`expressions.FUNCTIONS`. `^` means power, as on paper; a < b < c means a < b and b < c. A number with a
unit ("1 ms") stands alone and becomes a `Number` in SI units. Python's parser reads the text; nothing
is ever evaluated by Python.
"""

from __future__ import annotations

import ast
import functools
import keyword
import math
import re
from collections.abc import Mapping, Set
from types import MappingProxyType

from hybrid.errors import counted, did_you_mean
from hybrid.expressions import (
    FUNCTIONS,
    LOGIC,
    OTHER_TIMES,
    RESERVED_NAMES,
    Binary,
    BinaryOp,
    Call,
    ExpressionError,
    LookUp,
    Name,
    Node,
    Number,
    Unary,
    shown,
)
from hybrid.tables import Table
from hybrid.units import UnitError, looks_like_quantity, parse_quantity, split_quantity

LONGEST_TEXT = 2000
DEEPEST_TREE = 100

_PLAIN = [name for name, function in FUNCTIONS.items() if function.rule != "declared"]
_VALID = (
    "valid are numbers, names, + - * / ** ( ), < <= > >= == !=, and or not, pi, "
    + ", ".join(_PLAIN)
    + " and helper functions"
)

_OPERATORS: dict[type[ast.operator | ast.cmpop | ast.boolop], BinaryOp] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Pow: "**",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.And: "and",
    ast.Or: "or",
}
# Python's words for what is said otherwise here.
_OTHERWISE = {
    "if": "write select(condition, a, b)",
    "else": "write select(condition, a, b)",
    "True": "write 1",
    "False": "write 0",
}

_WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*+", re.ASCII)
_BAD_CHARACTER = re.compile(r"[^A-Za-z0-9_.+\-*/^(), \t\n<>=!]|!(?!=)")
_EQUALS = re.compile(r"(?<![<>=!])=(?!=)")
_LOGIC_WORD = re.compile(r"(?<![\w.])(and|or|not)(?!\w)", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?\.?(nan|inf|infinity)(\s+\S.*)?", re.ASCII | re.IGNORECASE)
_DECIMAL_COMMA = re.compile(r"(?<![\w.,])(\d++),(\d++)(?![\w.]*,)", re.ASCII)
# A name as it stands in arithmetic, "rotation.rate" in one piece; the e of 1e3 and a unit are none.
NAME_IN_TEXT = re.compile(r"(?<![\w.])[A-Za-z_]\w*+(?:\.[A-Za-z_]\w*+)*", re.ASCII)
_QUANTITY_THEN_SUM = re.compile(r"\s*+([^-+()]*[^-+()\s])(?:\s*+\+|\s++-)", re.ASCII)
_NAME_ALONE = re.compile(r"[A-Za-z_]\w*+", re.ASCII)
_NUMBER_THEN_NAME = re.compile(
    r"(?<![\w.])((?:\d++\.?+\d*+|\.\d++)(?:[eE][+-]?\d++)?(?![eE][+-]?\d))"
    r"[ \t]*+(?!(?:and|or|not|if|else)\b)([A-Za-z_]\w*+)",
    re.ASCII,
)


def parse(
    text: str | int | float,
    names: Set[str] = frozenset(),
    allow_previous: bool = False,
    tables: Mapping[str, Table] = MappingProxyType({}),
) -> Node:
    """Read an expression such as "-omega_p**2 * theta", a number, or a quantity such as "1 ms".

    Parameters
    ----------
    text
        at most 2000 characters and 100 operations deep.
    names
        known signals and parameters: "3 cycle" is refused if cycle is one of them.
    allow_previous
        whether previous(name) and next(name) are valid, as in a digital program.
    tables
        by the name under which they are asked.

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
    _refuse_what_is_no_number(text, names)
    if is_quantity(text):
        refuse_hidden_product(text, names)
        return _quantity(text)
    _refuse_foreign_text(text)
    return _Reader(text, allow_previous, tables).expression()


def is_quantity(text: str) -> bool:
    """Whether a text is a number with a unit, not arithmetic."""
    return looks_like_quantity(text) and not _LOGIC_WORD.search(text)


def _quantity(text: str | int | float) -> Number:
    """A number or a quantity, by the units module."""
    try:
        quantity = parse_quantity(text)
    except UnitError as error:
        if alone := _arithmetic_with(text):
            raise ExpressionError(
                f"{alone!r} must stand alone, as any number with a unit; in arithmetic it is a "
                f"parameter: declare one, as in parameters: {{extra: {alone}}}, and write its name"
            ) from None
        advice = " (a product needs *)" if _may_be_a_product(text) else ""
        raise ExpressionError(f"{error}{advice}") from None
    return Number(quantity.value, quantity.dimension)


def _arithmetic_with(text: str | int | float) -> str:
    """The quantity that begins arithmetic, "1 ms" of "1 ms + cycle"; '' where none does."""
    found = _QUANTITY_THEN_SUM.match(text) if isinstance(text, str) else None
    try:
        return found[1] if found and parse_quantity(found[1]) else ""
    except UnitError:
        return ""


def _may_be_a_product(text: str | int | float) -> bool:
    """Whether what stands for an unknown unit may be a name, "2 gain", or arithmetic, "2 ms + 1"."""
    try:
        _, unit = split_quantity(text)
    except UnitError:
        return False
    try:
        parse_quantity(f"1 {unit}")
    except UnitError as error:
        unknown = str(error).startswith("unknown unit") and _NAME_ALONE.fullmatch(unit)
        return bool(unknown or re.search(r"[-+(]", unit))
    return False


def _refuse_what_is_no_number(text: str, names: Set[str]) -> None:
    """Say it of nan and infinities, and of a comma where a number has its point."""
    found = _NOT_FINITE.fullmatch(text.strip())
    if found and found[1] not in names:
        raise ExpressionError(
            f"{text.strip()[:40]!r} is not a finite number; give one, such as 5 or 1 ms"
        )
    # Within parentheses a comma may part the arguments of a function.
    if found := _DECIMAL_COMMA.search(text.partition("(")[0]):
        raise ExpressionError(
            f"write a point in a number, not a comma: {found[1]}.{found[2]}", found.start() + 1
        )


def refuse_hidden_product(text: str, names: Set[str]) -> None:
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
    if found := _EQUALS.search(text):
        raise ExpressionError("write == to compare", found.start() + 1)
    if found := _NUMBER_THEN_NAME.search(text):
        raise ExpressionError(
            f"{found[1]} {found[2]}: a number with a unit must stand alone, so make it a parameter; for "
            f"a product write {found[1]}*{found[2]}",
            found.start() + 1,
        )
    for found in _WORD.finditer(text):
        if keyword.iskeyword(found[0]) and found[0] not in LOGIC:
            instead = _OTHERWISE.get(found[0], _VALID)
            raise ExpressionError(f"{found[0]!r} is a reserved word; {instead}", found.start() + 1)


class _Reader:
    """Turns Python's syntax tree of one text into nodes of our own, refusing all else."""

    def __init__(self, text: str, allow_previous: bool, tables: Mapping[str, Table]):
        self._allow_previous, self._tables = allow_previous, tables
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
        self._require_depth(depth)
        match node:
            case ast.Constant(value=int() | float() as value):
                return self._number(node, value)
            case ast.Name(id=name):
                return self._name(node, name)
            case ast.Attribute() if name := _dotted(node):
                return Name(name)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                return self._read(operand, depth + 1)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return _negative(self._read(operand, depth + 1))
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return Unary("not", self._read(operand, depth + 1))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                symbol = _OPERATORS[type(op)]
                return Binary(symbol, self._read(left, depth + 1), self._read(right, depth + 1))
            case ast.BoolOp(op=op, values=values):
                self._require_depth(depth + len(values))
                return _joined(_OPERATORS[type(op)], [self._read(v, depth + 1) for v in values])
            case ast.Compare(left=left, ops=ops, comparators=others) if self._compares(ops):
                self._require_depth(depth + len(ops))
                parts = [self._read(part, depth + 1) for part in (left, *others)]
                pairs = zip(ops, parts, parts[1:], strict=False)
                return _joined("and", [Binary(_OPERATORS[type(op)], a, b) for op, a, b in pairs])
            case ast.Call(func=ast.Attribute() as func, args=args, keywords=[]) if (
                name := _dotted(func)
            ) in self._tables:
                return self._call(node, name, tuple(self._read(a, depth + 1) for a in args))
            case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
                return self._call(node, name, tuple(self._read(a, depth + 1) for a in args))
        text = shown(self._source[node.col_offset : node.end_col_offset])
        raise self._error(f"{text} is not arithmetic; {_VALID}", node)

    @staticmethod
    def _compares(ops: list[ast.cmpop]) -> bool:
        return all(type(op) in _OPERATORS for op in ops)

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

    def _call(self, node: ast.expr, name: str, args: tuple[Node, ...]) -> Node:
        if name in self._tables:
            return self._look_up(node, self._tables[name], args)
        if name in OTHER_TIMES and not self._allow_previous:
            raise self._error(f"{name}() is valid only in a digital program", node)
        if name == "next":
            if len(args) != 1 or not isinstance(args[0], Name):
                raise self._error("next() takes the name of one state: next(height)", node)
            return Call(name, args)
        if name == "previous":
            if len(args) not in (1, 2) or not isinstance(args[0], Name):
                raise self._error(
                    "previous() takes one name, and how many cycles ago: previous(theta), "
                    "previous(theta, 3)",
                    node,
                )
            return Call(name, args)
        function = FUNCTIONS.get(name)
        if function is None:
            advice = did_you_mean(name, {**FUNCTIONS, **self._tables})
            raise self._error(f"unknown function {name!r}; {advice}", node)
        if not function.fewest <= len(args) <= function.most:
            fewest = f"{function.fewest} to " if function.fewest < function.most else ""
            count = f"{fewest}{counted(function.most, 'argument')}"
            raise self._error(f"{name}() takes {count}, not {len(args)}", node)
        return Call(name, args)

    def _look_up(self, node: ast.expr, table: Table, args: tuple[Node, ...]) -> LookUp:
        axes = [axis.name for axis in table.axes]
        if len(args) != len(axes):
            raise self._error(
                f"the table {table.name} takes {counted(len(axes), 'argument')}, {', '.join(axes)}, not "
                f"{len(args)}",
                node,
            )
        return LookUp(table, args)

    def _error(self, message: str, node: ast.expr) -> ExpressionError:
        return ExpressionError(message, self._column[node.col_offset])

    def _require_depth(self, depth: int) -> None:
        if depth > DEEPEST_TREE:
            raise self._too_deep()

    def _too_deep(self) -> ExpressionError:
        return ExpressionError(
            f"nested more than {DEEPEST_TREE} operations deep; split it into named signals"
        )


def _joined(op: BinaryOp, parts: list[Node]) -> Node:
    """Parts in a row with the same operator between them, grouped from the left."""
    return functools.reduce(lambda left, right: Binary(op, left, right), parts)


def _dotted(node: ast.expr) -> str:
    """The name of something in a part, such as "rotation.rate"; "" for what is no name."""
    if isinstance(node, ast.Name):
        return "" if node.id in RESERVED_NAMES else node.id
    if isinstance(node, ast.Attribute) and (part := _dotted(node.value)):
        return f"{part}.{node.attr}"
    return ""


def _negative(operand: Node) -> Node:
    if isinstance(operand, Number):
        return Number(-operand.value, operand.dimension)
    return Unary("-", operand)
