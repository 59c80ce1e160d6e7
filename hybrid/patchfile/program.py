"""The section `digital`: the digital machine's clock and its program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hybrid.dimensions import dimension_of
from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.expressions import (
    ExpressionError,
    names,
    previous_calls,
    previous_names,
    shown,
    to_text,
)
from hybrid.fields import table_of, value_of
from hybrid.graph import dependency_order, find_loop
from hybrid.language import DIGITAL_KEYS
from hybrid.parsing import parse
from hybrid.patch import Assignment, Program, Value
from hybrid.patchfile.book import Book, Role
from hybrid.patchfile.models import check_input, model_names, model_words, refuse_model_name
from hybrid.units import PURE, Dimension
from hybrid.yamltree import Table, Text, Tree

Remembered = Mapping[str, tuple[Value, Dimension | None]]


def read_program(book: Book) -> Program | None:
    """The digital machine, or None where the patch has none."""
    digital = book.section("digital")
    if digital is None:
        return None
    fields = book.fields(digital, "digital", DIGITAL_KEYS, book.root.places["digital"])
    values = fields.quantities(DIGITAL_KEYS)
    table = table_of(fields.tree("program"), "program", "word: arithmetic")
    readable = frozenset(book.named(Role.PARAMETER, Role.ADC, Role.WORD)) | model_names(book)
    written = {word: _assignment(book, word, tree, readable) for word, tree, _ in table}
    read = frozenset[str]().union(*(names(entry.expr) for entry in written.values()))
    written |= model_words(book, read, readable)
    order = _order(written)
    remember = _remember(book, digital, written)
    dimensions = _word_dimensions(book, written, order, remember)
    return Program(
        values["period"],
        values.get("compute_time"),
        values.get("skew"),
        tuple(replace(written[word], dimension=dimensions[word]) for word in order),
        {word: value for word, (value, _) in remember.items()},
        digital.place,
    )


def _assignment(book: Book, word: str, tree: Tree, readable: frozenset[str]) -> Assignment:
    what = f"word {word!r}"
    if not isinstance(tree, Text) or not tree.text:
        raise PatchError(f"{what} needs arithmetic, such as 2 * angle_sample", tree.place)
    try:
        expr = parse(tree.text, readable, allow_previous=True, tables=book.tables)
    except ExpressionError as error:
        raise PatchError(f"{what}: {error}", tree.place) from None
    for name in sorted((names(expr) | previous_names(expr)) - readable):
        _refuse(book, what, name, tree.place)
    for call in previous_calls(expr):
        for name in sorted(names(call) - set(book.named(Role.PARAMETER))):
            raise PatchError(
                f"{what} reads {shown(to_text(call))}, but how many cycles ago cannot depend on "
                f"{name!r}; give a whole number, or arithmetic over parameters",
                tree.place,
            )
    for name in sorted(previous_names(expr)):
        if book.roles[name] is not Role.WORD:
            raise PatchError(
                f"{what} reads previous({name}), but {name!r} is no word of the program; add "
                f"the word {name}_copy: {name} and read previous({name}_copy)",
                tree.place,
            )
    return Assignment(word, expr, tree.place)


def _refuse(book: Book, what: str, name: str, place: Place) -> None:
    """The program reads a name that it cannot read."""
    refuse_model_name(book, what, name, place)
    if name in book.tables:
        axes = ", ".join(axis.name for axis in book.tables[name].axes)
        raise PatchError(f"{what}: {name!r} is a table; write {name}({axes})", place)
    if name in book.roles:
        raise PatchError(
            f"{what} reads the analog signal {name!r}; the program reads it through an adc in the "
            "interface",
            place,
        )
    hint = did_you_mean(name, book.named(Role.PARAMETER, Role.ADC, Role.WORD))
    raise PatchError(f"{what} reads unknown {quoted(name)}; {hint}", place)


def _order(written: Mapping[str, Assignment]) -> tuple[str, ...]:
    """Words so that each is computed after those it reads."""
    needs = {word: sorted(names(a.expr) & written.keys()) for word, a in written.items()}
    loop = find_loop(needs)
    if loop:
        path = " -> ".join((*loop, loop[0]))
        raise PatchError(
            f"circular program: {path}; read last cycle's value with previous({loop[0]})",
            written[loop[0]].place,
        )
    return dependency_order(needs)


def _remember(book: Book, digital: Table, written: Mapping[str, Assignment]) -> Remembered:
    """First values of the words that are read with previous()."""
    tree = digital.entries.get("remember")
    table = table_of(tree, "remember", "word: first value") if tree else None
    found = {}
    for word, item, place in table or ():
        if word not in written:
            hint = did_you_mean(word, written)
            raise PatchError(f"remember: no word {quoted(word)} in the program; {hint}", place)
        found[word] = value_of(item, f"first value of {word!r}", book.scope)
    for word, assignment in written.items():
        for name in sorted(previous_names(assignment.expr) - found.keys()):
            raise PatchError(
                f"word {word!r} reads previous({name}); give its first value in "
                f"digital: remember: {{{name}: 0}}",
                assignment.place,
            )
    return found


def _word_dimensions(
    book: Book,
    written: Mapping[str, Assignment],
    order: tuple[str, ...],
    remember: Remembered,
) -> dict[str, Dimension | None]:
    """Dimension of every word; two passes, since a word may use its own last value."""
    scope: dict[str, Dimension | None] = dict(book.scope)
    scope |= {name: book.scales[name].dimension for name in book.named(Role.ADC)}
    scope |= dict.fromkeys(written)
    for word, (_, dimension) in remember.items():
        # A bare first value says nothing about the unit.
        scope[word] = None if dimension is None or dimension.is_pure else dimension
    for _ in range(2):
        for word in order:
            try:
                found = dimension_of(written[word].expr, scope)
            except ExpressionError as error:
                raise PatchError(f"word {word!r}: {error}", written[word].place) from None
            check_input(book, word, found)
            stated = remember[word][1] if word in remember else None
            if stated and not stated.is_pure and found not in (None, PURE, stated):
                raise PatchError(
                    f"word {word!r} is in {found}, but its first value under remember: is in "
                    f"{stated}; they must agree",
                    written[word].place,
                )
            scope[word] = found if found is not None else scope[word]
    return {word: scope[word] for word in written}
