"""Calls of the program that have no value in any cycle: limits the wrong way round, remainders of 0.

Stage 2, for `compiler`. All that is known then is refused; what only a run shows ends it. What a
`select` may leave out is not looked at.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from hybrid.errors import PatchError, known_as
from hybrid.expressions import (
    NEEDS,
    Call,
    Node,
    children,
    evaluate,
    is_known,
)
from hybrid.patch import Program

# Functions whose later arguments alone may leave them without a value.
BY_LATER = frozenset({"limit", "dead_zone", "mod"})


def refuse_valueless(program: Program | None, scope: Mapping[str, float]) -> None:
    """Raise PatchError with the line of a word that calls one of these with arguments that never do."""
    for entry in program.written if program else ():
        for call in (call for tree in entry.reads for call in _calls(tree)):
            later = call.args[1:]
            if not all(is_known(node, scope) for node in later):
                continue
            given = [evaluate(node, scope) for node in later]
            has_value, needs = NEEDS[call.function]
            if not has_value(0.0, *given):
                told = ", ".join(f"{value:.12g}" for value in given)
                raise PatchError(
                    f"word {known_as(entry.word)!r}: {call.function}(..., {told}) has no value; it "
                    f"needs {needs}",
                    entry.place,
                )


def calls_any(tree: Node, functions: frozenset[str]) -> bool:
    """Whether one of these functions is called."""
    return (isinstance(tree, Call) and tree.function in functions) or any(
        calls_any(child, functions) for child in children(tree)
    )


def _calls(tree: Node) -> Iterator[Call]:
    """The calls that are computed in every cycle and of which the result matters."""
    if isinstance(tree, Call) and tree.function in BY_LATER:
        yield tree
    inner = children(tree)
    if isinstance(tree, Call) and tree.function == "select":
        inner = inner[:1]
    for child in inner:
        yield from _calls(child)
