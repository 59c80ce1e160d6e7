"""MathML content markup -> arithmetic of our own nodes.

Stage 2. What DAVE-ML files use of MathML 2: constants, variables, elementary functions, comparisons,
logic and choices, and the csymbol atan2.
"""

from __future__ import annotations

import functools
import itertools
import math
import re
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

# What qualifies an operation, and which one.
_QUALIFIERS = {"degree": "root", "logbase": "log"}
_NUMBERS = ("real", "integer", "double", "e-notation")

Named = Callable[[str, Element], str]


def read_math(math_element: Element, named: Named) -> Node:
    """The expression in a <math> element; `named` gives the name of a variable, or refuses it."""
    return _only(math_element, "expression", named)


def _only(element: Element, what: str, named: Named) -> Node:
    """The one expression in an element."""
    _refuse_text(element)
    if len(element.children) != 1:
        raise PatchError(
            f"<{element.tag}> holds {counted(len(element.children), what)}; it must hold one {what}",
            element.place,
        )
    return _read(element.children[0], named)


def _refuse_text(element: Element) -> None:
    """Raise PatchError for a text between elements, which nobody would read."""
    if text := element.text.strip():
        raise PatchError(
            f"<{element.tag}> holds the text {quoted(text)}; numbers stand in <cn>, names in <ci>",
            element.place,
        )


def _read(element: Element, named: Named) -> Node:
    tag = element.tag
    if tag == "cn":
        return Number(_number(element))
    if tag == "ci":
        _refuse_children(element, "a name")
        return Name(named(element.text.strip(), element))
    if tag in _CONSTANTS:
        return Number(_CONSTANTS[tag])
    if tag == "piecewise":
        return _piecewise(element, named)
    if tag == "apply":
        return _apply(element, named)
    raise PatchError(f"<{tag}> cannot be computed; {did_you_mean(tag, _KNOWN)}", element.place)


def _number(element: Element) -> float:
    kind, text = element.attributes.get("type", "real").strip(), element.text.strip()
    base = element.attributes.get("base", "10").strip()
    if kind not in _NUMBERS:
        known = ", ".join(_NUMBERS)
        raise PatchError(
            f"<cn> is of type {quoted(kind)}; the types read are {known}", element.place
        )
    if base != "10":
        raise PatchError(f"<cn> is of base {quoted(base)}; only 10 is read", element.place)
    if kind == "e-notation":  # <cn type="e-notation">1.5<sep/>3</cn>
        parts = [part.strip() for part in element.parts]
        if [child.tag for child in element.children] != ["sep"] or not _is_whole(parts[1]):
            raise PatchError(
                "<cn> of type e-notation needs a number, <sep/> and a whole exponent, such as "
                "1.5<sep/>3",
                element.place,
            )
        text = "e".join(parts)
    else:
        _refuse_children(element, "a number")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in text:
        raise PatchError(f"<cn> holds {quoted(text)}; it must be a number", element.place)
    return value


def _is_whole(text: str) -> bool:
    """Whether a text is a whole number."""
    return text.removeprefix("-").removeprefix("+").isdecimal() and text.isascii()


def _refuse_children(element: Element, what: str) -> None:
    """Raise PatchError for elements where there is to be but a text."""
    for child in element.children:
        raise PatchError(
            f"<{element.tag}> holds <{child.tag}/>; it must hold {what} and nothing else",
            element.place,
        )


def _piecewise(element: Element, named: Named) -> Node:
    _refuse_text(element)
    pieces, others = list(element.all("piece")), list(element.all("otherwise"))
    for child in element.children:
        if child.tag not in ("piece", "otherwise"):
            raise PatchError(
                f"<piecewise> holds <{child.tag}>; it must hold <piece>s, and <otherwise> at most",
                child.place,
            )
    if not pieces:
        raise PatchError(
            "<piecewise> needs a <piece> or more, each of a value and a condition", element.place
        )
    if len(others) > 1:
        raise PatchError(
            "a second <otherwise> in a <piecewise>; it has one at most", others[1].place
        )
    read = []
    for piece in pieces:
        _refuse_text(piece)
        if len(piece.children) != 2:
            what = counted(len(piece.children), "element")
            raise PatchError(
                f"<piece> has {what}; it needs two, a value and its condition", piece.place
            )
        value, condition = (_read(child, named) for child in piece.children)
        read.append((value, condition))
    conditions = [condition for _, condition in read]
    result = _only(others[0], "value", named) if others else _nothing(conditions)
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
    _refuse_text(element)
    if head.tag not in ("piecewise", "apply", "cn", "ci", "csymbol"):
        _refuse_text(head)
        _refuse_children(head, "nothing")
    qualifiers = [child for child in rest if child.tag in _QUALIFIERS]
    values = [_read(child, named) for child in rest if child.tag not in _QUALIFIERS]
    qualified = _qualified(head, qualifiers, named)

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
    address = head.attributes.get("definitionURL", "")
    if tag == "csymbol" and "atan2" in (head.text.strip(), re.split("[/#]", address)[-1]):
        count(2, 2)
        return Call("atan2", (values[0], values[1]))
    if tag != "csymbol":
        count(1, 1)
    return _of_one(head, values[0], qualified)


def _qualified(head: Element, qualifiers: list[Element], named: Named) -> Node | None:
    """The degree of a root or the base of a logarithm, where there is one."""
    for qualifier in qualifiers:
        if _QUALIFIERS[qualifier.tag] != head.tag:
            due = _QUALIFIERS[qualifier.tag]
            raise PatchError(
                f"<{head.tag}/> has no <{qualifier.tag}>; that is for <{due}/>", qualifier.place
            )
    if len(qualifiers) > 1:
        second = qualifiers[1]
        raise PatchError(
            f"a second <{second.tag}> of <{head.tag}/>; it has one at most", second.place
        )
    return _only(qualifiers[0], "value", named) if qualifiers else None


def _of_one(head: Element, value: Node, qualified: Node | None) -> Node:
    """A function of one argument, with the degree of a root or the base of a logarithm."""
    tag = head.tag
    if tag == "root":
        if qualified is None or qualified == Number(2.0):
            return Call("sqrt", (value,))
        return Binary("**", value, Binary("/", Number(1.0), qualified))
    if tag == "log":
        if qualified is None or qualified == Number(10.0):
            return Call("log10", (value,))
        return Binary("/", Call("log", (value,)), Call("log", (qualified,)))
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
