"""Functions that are asked beyond their range by what is known before the run: parameters and constants.

Stage 4, for `endings` and `checks`. What depends on the run is watched while it plays (`engine.ranges`);
what does not is computed once, before, and told here. What a `select` of known condition leaves out is
not asked.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace

from hybrid.engine.ranges import beyond_text
from hybrid.errors import Place, known_as
from hybrid.expressions import (
    FUNCTIONS,
    Call,
    ExpressionError,
    Node,
    children,
    evaluate,
    is_known,
    sub_expressions,
)
from hybrid.machine import Machine
from hybrid.patch import Patch, Value

MOST_NAMED = 3


@dataclass(frozen=True, slots=True)
class _Written:
    """Arithmetic of the patch file that calls a function with a range."""

    what: str
    place: Place
    expr: Node
    parameter: str = ""  # which it is the value of


def asked_before(machine: Machine) -> tuple[str, ...]:
    """A line for each function and argument, with the place in the patch file first."""
    return tuple(
        f"{place}: {told}" if str(place) else told for told, place in _found(machine).items()
    )


def asked_before_text(machine: Machine) -> str:
    """The same for the note of a run, without places; ''."""
    found = list(_found(machine))
    more = f"; and {len(found) - MOST_NAMED} more" if len(found) > MOST_NAMED else ""
    return "; ".join(found[:MOST_NAMED]) + more


def _found(machine: Machine) -> dict[str, Place]:
    """What is told, and where it is written."""
    return {
        f"{written.what} asks {told} (continued)": written.place
        for written in _watched(machine.patch)
        if written.parameter not in machine.overrides
        for told in _asked(written.expr, machine.parameters)
    }


def _asked(tree: Node, scope: Mapping[str, float]) -> Iterator[str]:
    """The calls with an argument that is known and out of range: 'density_us76 for height = ...'."""
    inner: Sequence[Node] = children(tree)
    if isinstance(tree, Call):
        helper = FUNCTIONS[tree.function].helper if tree.function in FUNCTIONS else None
        if tree.function == "select" and is_known(tree.args[0], scope):
            taken = tree.args[1 if _value(tree.args[0], scope) else 2]
            inner = (tree.args[0], taken)
        if helper and helper.valid and is_known(tree.args[0], scope):
            value, (low, high) = _value(tree.args[0], scope), helper.valid
            if value is not None and not low <= value <= high:
                name, dimension = helper.takes[0]
                beyond = beyond_text(value, low, high, str(dimension))
                yield f"{tree.function} for {name} = {beyond}"
    for child in inner:
        yield from _asked(child, scope)


def _value(tree: Node, scope: Mapping[str, float]) -> float | None:
    try:
        return evaluate(tree, scope)
    except ExpressionError:  # in a branch that is not taken
        return None


# The runs of a sweep or batch share a patch, and most patches call no such function.
@functools.lru_cache(maxsize=64)
def _watched(patch: Patch) -> tuple[_Written, ...]:
    """All arithmetic of a patch that calls a function with a range."""
    found = [
        _Written(f"parameter {name!r}", parameter.value.place, parameter.value.expr, name)
        for name, parameter in patch.parameters.items()
    ]
    program = patch.program
    for entry in program.written if program else ():
        what = f"word {known_as(entry.word)!r}"
        found += [_Written(what, entry.place, expr) for expr in entry.reads]
    rest = replace(patch, parameters={}, models=())  # models are in the words that read them
    found += [_Written(v.what, v.place, v.expr) for v in _values(rest)]
    return tuple(written for written in found if _has_range(written.expr))


def _has_range(tree: Node) -> bool:
    """Whether a function with a range is called."""
    calls = (node for node in sub_expressions(tree) if isinstance(node, Call))
    helpers = (FUNCTIONS[c.function].helper for c in calls if c.function in FUNCTIONS)
    return any(helper and helper.valid for helper in helpers)


def _values(of: object) -> Iterator[Value]:
    """Every number that is written in a part of a patch."""
    if isinstance(of, Value):
        yield of
    elif isinstance(of, Node | Place):
        return
    elif isinstance(of, Mapping):
        yield from _values(tuple(of.values()))
    elif isinstance(of, tuple):
        for part in of:
            yield from _values(part)
    elif is_dataclass(of):
        yield from _values(tuple(getattr(of, field.name) for field in fields(of)))
