"""MathML content markup -> arithmetic of our own nodes.

Stage 2. What DAVE-ML files use of MathML 2: constants, variables, elementary functions, comparisons,
logic and choices, and the csymbol atan2.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence

from hybrid.errors import PatchError, counted, did_you_mean, quoted
from hybrid.expressions import Binary, BinaryOp, Call, Name, Node, Number, Unary
from hybrid.xmltree import Element

_CHAINS: dict[str, BinaryOp] = {"plus": "+", "times": "*", "and": "and", "or": "or"}
_COMPARISONS: dict[str, BinaryOp] = {
    "lt": "<",
    "leq": "<=",
    "gt": ">",
    "geq": ">=",
    "eq": "==",
    "neq": "!=",
}
_FUNCTIONS = {"abs": "abs", "exp": "exp", "ln": "log", "floor": "floor", "ceiling": "ceil"}
_FUNCTIONS |= {name: name for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")}
_FUNCTIONS |= {f"arc{name}": f"a{name}" for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")}
_INVERSE = {"sec": "cos", "csc": "sin", "cot": "tan"}
_CONSTANTS = {"pi": math.pi, "exponentiale": math.e, "true": 1.0, "false": 0.0}
_WHOLE = ("quotient", "rem")
_OTHERS = ("minus", "divide", "power", "root", "log", "not", "min", "max", "piecewise", "csymbol")
_KNOWN = (*_CHAINS, *_COMPARISONS, *_FUNCTIONS, *_INVERSE, *_WHOLE, "xor", *_OTHERS)

_NUMBERS = ("real", "integer", "double", "e-notation")

Named = Callable[[str, Element], str]


def read_math(math_element: Element, named: Named) -> Node:
    """The expression in a <math> element; `named` gives the name of a variable, or refuses it."""
    if len(math_element.children) != 1:
        raise PatchError("<math> must hold one expression", math_element.place)
    return _read(math_element.children[0], named)


def _read(element: Element, named: Named) -> Node:
    tag = element.tag
    if tag == "cn":
        return Number(_number(element))
    if tag == "ci":
        return Name(named(element.text.strip(), element))
    if tag in _CONSTANTS:
        return Number(_CONSTANTS[tag])
    if tag == "piecewise":
        return _piecewise(element, named)
    if tag == "apply":
        return _apply(element, named)
    raise PatchError(f"<{tag}> cannot be computed; {did_you_mean(tag, _KNOWN)}", element.place)


def _number(element: Element) -> float:
    kind, text = element.attributes.get("type", "real"), element.text.strip()
    if kind == "e-notation":  # <cn type="e-notation">1.5<sep/>3</cn>
        parts = [part.strip() for part in element.parts]
        if [child.tag for child in element.children] != ["sep"] or not _is_whole(parts[1]):
            raise PatchError(
                "<cn> of type e-notation needs a number, <sep/> and a whole exponent, such as "
                "1.5<sep/>3",
                element.place,
            )
        text = "e".join(parts)
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or kind not in _NUMBERS or "_" in text:
        raise PatchError(f"<cn> holds {quoted(text)}; it must be a number", element.place)
    return value


def _is_whole(text: str) -> bool:
    """Whether a text is a whole number."""
    return text.removeprefix("-").removeprefix("+").isdecimal() and text.isascii()


def _piecewise(element: Element, named: Named) -> Node:
    otherwise = element.first("otherwise")
    pieces = list(element.all("piece"))
    if not pieces:
        raise PatchError(
            "<piecewise> needs a <piece> or more, each of a value and a condition", element.place
        )
    if otherwise and len(otherwise.children) != 1:
        what = counted(len(otherwise.children), "value")
        raise PatchError(f"<otherwise> has {what}; it needs one", otherwise.place)
    read = []
    for piece in pieces:
        if len(piece.children) != 2:
            what = counted(len(piece.children), "element")
            raise PatchError(
                f"<piece> has {what}; it needs two, a value and its condition", piece.place
            )
        value, condition = (_read(child, named) for child in piece.children)
        read.append((value, condition))
    conditions = [condition for _, condition in read]
    result = _read(otherwise.children[0], named) if otherwise else _nothing(conditions)
    for value, condition in reversed(read):
        result = Call("select", (condition, value, result))
    return result


def _nothing(conditions: Sequence[Node]) -> Node:
    """What has no value where none of these holds, as 0/0 has none; it ends a run."""
    return Binary("/", Number(0.0), functools.reduce(lambda a, b: Binary("or", a, b), conditions))


def may_be_nothing(tree: Node) -> bool:
    """Whether an expression is a <piecewise> without <otherwise>, which may have no value."""
    conditions = []
    while isinstance(tree, Call) and tree.function == "select":
        conditions.append(tree.args[0])
        tree = tree.args[2]
    return bool(conditions) and tree == _nothing(conditions)


def _apply(element: Element, named: Named) -> Node:
    if not element.children:
        raise PatchError("<apply> is empty", element.place)
    head, rest = element.children[0], element.children[1:]
    if head.tag not in (*_KNOWN, "apply", "cn", "ci"):
        valid = did_you_mean(head.tag, _KNOWN)
        raise PatchError(f"<{head.tag}/> is no operation that is read; {valid}", head.place)
    if head.tag in ("piecewise", "apply", "cn", "ci") and not rest:
        return _read(head, named)  # <apply> around what needs none
    qualifiers = {child.tag: child for child in rest if child.tag in ("degree", "logbase")}
    values = [_read(child, named) for child in rest if child.tag not in qualifiers]

    def count(fewest: int, most: int | None = None) -> None:
        if len(values) < fewest or (most is not None and len(values) > most):
            due = (
                f"{fewest}" if most == fewest else f"{fewest} or more" if most is None else "1 or 2"
            )
            raise PatchError(
                f"<{head.tag}/> has {counted(len(values), 'operand')}; it needs {due}", head.place
            )

    tag = head.tag
    if tag in _CHAINS:
        count(1)
        return functools.reduce(lambda a, b: Binary(_CHAINS[tag], a, b), values)
    if tag in _COMPARISONS:
        count(2, 2 if tag == "neq" else None)  # of more, each is compared with the next
        pairs = (Binary(_COMPARISONS[tag], a, b) for a, b in itertools.pairwise(values))
        return functools.reduce(lambda a, b: Binary("and", a, b), pairs)
    if tag in ("min", "max"):
        count(1)
        return functools.reduce(lambda a, b: Call(tag, (a, b)), values)
    if tag == "minus":
        count(1, 2)
        return Binary("-", values[0], values[1]) if len(values) == 2 else _negative(values[0])
    if tag in _WHOLE:
        count(2, 2)
        return _whole_part(*values) if tag == "quotient" else _remainder(*values)
    if tag == "xor":
        count(1)
        truths: list[Node] = [Unary("not", Unary("not", value)) for value in values]
        return functools.reduce(lambda a, b: Binary("!=", a, b), truths)
    if tag in ("divide", "power"):
        count(2, 2)
        return Binary("/" if tag == "divide" else "**", values[0], values[1])
    if tag == "csymbol" and "atan2" in (head.text + head.attributes.get("definitionURL", "")):
        count(2, 2)
        return Call("atan2", (values[0], values[1]))
    count(1, 1)
    return _of_one(head, values[0], qualifiers, named)


def _of_one(head: Element, value: Node, qualifiers: dict[str, Element], named: Named) -> Node:
    """A function of one argument, with the degree of a root or the base of a logarithm."""
    tag = head.tag
    inside = {name: _read(q.children[0], named) for name, q in qualifiers.items() if q.children}
    if tag == "root":
        if inside.get("degree", Number(2.0)) == Number(2.0):
            return Call("sqrt", (value,))
        return Binary("**", value, Binary("/", Number(1.0), inside["degree"]))
    if tag == "log":
        if inside.get("logbase", Number(10.0)) == Number(10.0):
            return Call("log10", (value,))
        return Binary("/", Call("log", (value,)), Call("log", (inside["logbase"],)))
    if tag == "not":
        return Unary("not", value)
    if tag in _FUNCTIONS:
        return Call(_FUNCTIONS[tag], (value,))
    if tag in _INVERSE:
        return Binary("/", Number(1.0), Call(_INVERSE[tag], (value,)))
    told = head.attributes.get("definitionURL", "") or head.text.strip()
    raise PatchError(f"<{tag}/> {quoted(told)} is no function that is read; atan2 is", head.place)


def _remainder(a: Node, b: Node) -> Node:
    """What is left of a by the whole quotient towards 0: it has the sign of a."""
    size = Call("mod", (Call("abs", (a,)), Call("abs", (b,))))
    return Binary("*", Call("sign", (a,)), size)


def _whole_part(a: Node, b: Node) -> Node:
    """The quotient rounded towards 0; without its remainder it is whole but for rounding."""
    return Call("round", (Binary("/", Binary("-", a, _remainder(a, b)), b),))


def _negative(value: Node) -> Node:
    return Number(-value.value) if isinstance(value, Number) else Unary("-", value)
