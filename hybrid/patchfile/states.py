"""The section `digital: states`: words that the program integrates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from hybrid.dimensions import dimension_of
from hybrid.errors import PatchError, Place, known_as, quoted
from hybrid.expressions import ExpressionError, Node, next_names
from hybrid.fields import Fields, in_words, table_of, value_of
from hybrid.formulas import DEFAULT_FORMULA, FORMULAS
from hybrid.language import STATE_KEYS
from hybrid.parsing import parse
from hybrid.patch import Assignment, State
from hybrid.patchfile.book import Book
from hybrid.tables import Table as LookUpTable
from hybrid.units import PURE, TIME, Dimension
from hybrid.yamltree import Table, Text, Tree

Dimensions = dict[str, Dimension | None]


def read_states(
    book: Book, digital: Table, within: Table, what: str, readable: frozenset[str]
) -> dict[str, State]:
    """The states by name, sorted, without the dimensions that their rates may give them.

    within: the task that integrates them, or `digital` itself; what: the same for messages.
    """
    usual = formula_of(digital, "integration", "digital", DEFAULT_FORMULA)
    usual = formula_of(within, "integration", what, usual)
    tree = within.entries.get("states")
    if tree is None:
        return {}
    table = table_of(tree, "states", "state: {integrate: rate, initial: value}")
    found = {name: _state(book, name, item, place, usual, readable) for name, item, place in table}
    return dict(sorted(found.items()))


def _state(
    book: Book, name: str, tree: Tree, place: Place, usual: str, readable: frozenset[str]
) -> State:
    what = f"state {name!r}"
    table = table_of(tree, what, "integrate: rate, initial: value")
    fields = book.fields(table, what, STATE_KEYS, place)
    reset = [key for key in ("reset_when", "reset_to") if key in table.entries]
    if len(reset) == 1:
        missing = {"reset_when": "reset_to", "reset_to": "reset_when"}[reset[0]]
        raise PatchError(
            f"{what} has {reset[0]}, but no {missing}; give both", fields.place(reset[0])
        )
    rate = _arithmetic(fields, "integrate", readable, book.tables)
    for read in sorted(next_names(rate)):
        raise PatchError(
            f"integrate of {what} reads next({read}), which the step only gives; read {read}",
            fields.place("integrate"),
        )
    value, dimension = value_of(fields.tree("initial"), f"initial of {what}", book.scope)
    return State(
        name,
        rate,
        value,
        formula_of(table, "formula", what, usual),
        place,
        None if dimension is None or dimension.is_pure else dimension,
        *(_arithmetic(fields, key, readable, book.tables) for key in reset),
    )


def _arithmetic(
    fields: Fields, key: str, readable: frozenset[str], tables: Mapping[str, LookUpTable]
) -> Node:
    tree, what = fields.tree(key), f"{key} of {fields.what}"
    if not isinstance(tree, Text) or not tree.text:
        raise PatchError(f"{what} needs arithmetic, such as speed * sin(angle)", tree.place)
    try:
        return parse(tree.text, readable, allow_previous=True, tables=tables)
    except ExpressionError as error:
        raise PatchError(f"{what}: {error}", tree.place) from None


def formula_of(table: Table, key: str, what: str, default: str) -> str:
    """The integration formula under a key, `default` where there is none."""
    tree = table.entries.get(key)
    if tree is None:
        return default
    if not isinstance(tree, Text) or tree.text not in FORMULAS:
        given = quoted(tree.text) if isinstance(tree, Text) else "no name"
        raise PatchError(
            f"{key} of {what} is {given}; valid: {', '.join(FORMULAS)}",
            tree.place,
        )
    return tree.text


def settle_dimensions(
    written: Mapping[str, Assignment],
    states: Mapping[str, State],
    scope: Dimensions,
    fitted: Callable[[Assignment, Dimension | None], Dimension | None],
    programs: int,
) -> None:
    """Find the dimension of every word and state, in `scope`; raises PatchError where two conflict.

    written: in the order in which they are computed. A word may use its own last value, and a state has
    the dimension of its rate times a time, and words of tasks may use those of each other, so it takes
    passes until nothing new is found. fitted: what a word's dimension is where its arithmetic has the
    given one, which it may refuse.
    """
    for _ in range(len(states) + programs + 1):
        before = dict(scope)
        for word, assignment in written.items():
            found = _dimension(assignment.expr, scope, f"word {known_as(word)!r}", assignment.place)
            found = fitted(assignment, found)
            scope[word] = found if found is not None else scope[word]
        for name, state in states.items():
            rate = _dimension(state.expr, scope, f"integrate of state {name!r}", state.place)
            if scope[name] is None and rate not in (None, PURE):
                scope[name] = rate and rate * TIME
        if scope == before:
            break
    for state in states.values():
        _check_state(state, scope)


def with_dimension(state: State, scope: Dimensions) -> State:
    """The state with what has been found."""
    return replace(state, dimension=scope[state.word])


def _dimension(expr: Node, scope: Dimensions, what: str, place: Place) -> Dimension | None:
    try:
        return dimension_of(expr, scope)
    except ExpressionError as error:
        raise PatchError(f"{what}: {error}", place) from None


def _check_state(state: State, scope: Dimensions) -> None:
    """A rate is in the state's unit per time, a reset in its unit, a condition a number."""
    due, what = scope[state.word], f"state {state.word!r}"
    rate = _dimension(state.expr, scope, f"integrate of {what}", state.place)
    if due is not None and rate not in (None, PURE, due / TIME):
        raise PatchError(
            f"{what} integrates what is {in_words(rate or PURE)}; it must be {in_words(due / TIME)}, as "
            f"the state is {in_words(due)}",
            state.place,
        )
    if state.reset_when is None or state.reset_to is None:
        return
    condition = _dimension(state.reset_when, scope, f"reset_when of {what}", state.place)
    if condition not in (None, PURE):
        raise PatchError(f"reset_when of {what} must be {in_words(PURE)}", state.place)
    target = _dimension(state.reset_to, scope, f"reset_to of {what}", state.place)
    if due is not None and target not in (None, PURE, due):
        raise PatchError(
            f"reset_to of {what} is {in_words(target or PURE)}; it must be {in_words(due)}",
            state.place,
        )
