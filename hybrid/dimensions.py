"""Dimensions of arithmetic, so that a patch cannot add volts to seconds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

from hybrid.expressions import (
    COMPARISONS,
    FUNCTIONS,
    LOGIC,
    OTHER_TIMES,
    Binary,
    Call,
    ExpressionError,
    LookUp,
    Name,
    Node,
    Number,
    Unary,
    children,
    evaluate,
    is_constant,
    look_up,
    shown,
    to_text,
)
from hybrid.units import PURE, Dimension


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
        return look_up(tree, scope)
    parts = [(part, dimension_of(part, scope)) for part in children(tree)]
    if isinstance(tree, Unary):
        return parts[0][1] if tree.op == "-" else _all_pure(tree, parts)
    if isinstance(tree, LookUp):
        for axis, (part, dimension) in zip(tree.table.axes, parts, strict=True):
            _require(tree, part, dimension, axis.name, axis.dimension)
        return tree.table.dimension
    if isinstance(tree, Call):
        return _call_dimension(tree, parts)
    if tree.op in LOGIC:
        return _all_pure(tree, parts)
    if tree.op in ("+", "-") or tree.op in COMPARISONS:
        shared = _alike(tree, parts)
        return PURE if tree.op in COMPARISONS else shared
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
                f"in {shown(to_text(tree))}: {shown(to_text(first))} [{expected}] and "
                f"{shown(to_text(part))} [{dimension}] must have the same units"
                + _remedy(first, expected, part, dimension)
            )
    return known[0][1] if known else None


def _remedy(first: Node, expected: Dimension, part: Node, dimension: Dimension) -> str:
    """How a plain number beside what has a unit gets one: within arithmetic only a parameter has."""
    for number, its, due in ((first, expected, dimension), (part, dimension, expected)):
        if its.is_pure and is_constant(number):
            text = to_text(number)
            return f"; a number with a unit is a parameter here, such as level: {text} {due}"
    return ""


def _call_dimension(tree: Call, parts: _Parts) -> Dimension | None:
    if tree.function in OTHER_TIMES:
        _all_pure(tree, parts[1:])
        return parts[0][1]
    rule, helper = FUNCTIONS[tree.function].rule, FUNCTIONS[tree.function].helper
    if helper:
        for (name, due), (part, dimension) in zip(helper.takes, parts, strict=False):
            _require(tree, part, dimension, name, due)
        return helper.gives
    if rule == "pure":
        return _all_pure(tree, parts)
    if rule == "select":
        _all_pure(tree, parts[:1])
        parts = parts[1:]
    shared = _alike(tree, parts)
    if rule == "ratio":
        return PURE
    return shared**0.5 if rule == "root" and shared is not None else shared


def _all_pure(tree: Node, parts: _Parts) -> Dimension:
    """Pure parts, a pure result."""
    for part, dimension in parts:
        _require_pure(tree, part, dimension)
    return PURE


def _power_dimension(
    tree: Binary, base: Dimension | None, exponent: Dimension | None
) -> Dimension | None:
    _require_pure(tree, tree.right, exponent)
    if base is None or base.is_pure:
        return base
    if not is_constant(tree.right):
        raise ExpressionError(
            f"in {shown(to_text(tree))}: {shown(to_text(tree.left))} [{base}] has a unit, so its "
            "exponent must be a plain number"
        )
    return base ** evaluate(tree.right, {})


def _require(tree: Node, part: Node, found: Dimension | None, name: str, due: Dimension) -> None:
    """Refuse an argument in the wrong unit; a bare literal is in SI units of whatever is due."""
    bare = isinstance(part, Number) and part.dimension.is_pure
    if found is not None and found != due and not bare:
        unit = "a pure number" if due.is_pure else f"in {due}"
        raise ExpressionError(
            f"in {shown(to_text(tree))}: the {name}, {shown(to_text(part))} [{found}], must be {unit}"
        )


def _require_pure(tree: Node, part: Node, dimension: Dimension | None) -> None:
    if dimension is not None and not dimension.is_pure:
        raise ExpressionError(
            f"in {shown(to_text(tree))}: {shown(to_text(part))} [{dimension}] must be a pure "
            "number; divide it by a unit or a full scale"
        )
