"""The section `parameters`: named numbers that the command line may set."""

from __future__ import annotations

from collections.abc import Mapping

from hybrid.errors import PatchError, did_you_mean, quoted
from hybrid.expressions import ExpressionError, names
from hybrid.fields import fits, in_words, value_of
from hybrid.graph import dependency_order, find_loop
from hybrid.parsing import parse
from hybrid.patch import Parameter
from hybrid.patchfile.book import Book
from hybrid.patchfile.parts import Setting
from hybrid.units import PURE, Dimension, UnitError, unit_of
from hybrid.yamltree import Text


def read_parameters(book: Book, settings: Mapping[str, Setting]) -> dict[str, Parameter]:
    """Every parameter; a parameter may be computed from others, in any order.

    settings: what is set of the parameters of parts.
    """
    texts = _texts(book)
    needs = {name: _needed(name, tree, texts) for name, tree in texts.items()}
    for name, setting in settings.items():
        needs[name] += _needed(name, setting.default, texts)
    loop = find_loop(needs)
    if loop:
        path = " -> ".join((*loop, loop[0]))
        raise PatchError(
            f"circular parameters: {path}; give one of them a value of its own",
            book.places[loop[0]],
        )
    parameters: dict[str, Parameter] = {}
    for name in dependency_order(needs):
        tree = texts[name]
        value, dimension = value_of(tree, f"parameter {name!r}", book.scope)
        if name in settings:
            dimension = _set_dimension(settings[name], dimension, book.scope)
        unit, factor = unit_as_written(tree.text, dimension, parameters)
        parameters[name] = Parameter(name, value, unit, factor, dimension or PURE)
        book.scope[name], book.units[name] = dimension or PURE, unit
    return parameters


def _set_dimension(
    setting: Setting, given: Dimension | None, scope: Mapping[str, Dimension | None]
) -> Dimension | None:
    """A part's parameter is in the unit of its default, in which a bare number is read, too."""
    _, default = value_of(setting.default, setting.what, scope)
    if default is None:
        return given
    if not fits(setting.given.text, given, default):
        raise PatchError(
            f"{setting.what} is {quoted(setting.given.text)}; by its default it must be "
            f"{in_words(default)}",
            setting.given.place,
        )
    return default


def _texts(book: Book) -> dict[str, Text]:
    found = {}
    for name, tree, _ in book.section("parameters") or ():
        if not isinstance(tree, Text) or not tree.text:
            raise PatchError(f"parameter {name!r} needs a value, such as 1 ms", tree.place)
        found[name] = tree
    return found


def _needed(name: str, tree: Text, known: dict[str, Text]) -> list[str]:
    """Names of the parameters that a parameter's text uses."""
    try:
        needed = sorted(names(parse(tree.text, known.keys())))
    except ExpressionError as error:
        raise PatchError(f"parameter {name!r}: {error}", tree.place) from None
    for other in needed:
        if other not in known:
            hint = did_you_mean(other, known.keys() - {name})
            raise PatchError(
                f"parameter {name!r}: unknown parameter {quoted(other)}; {hint}", tree.place
            )
    return needed


def unit_as_written(
    text: str, dimension: Dimension | None, before: dict[str, Parameter]
) -> tuple[str, float]:
    """Unit in which a parameter is shown: as written, or that of the parameter it equals."""
    if text in before:
        return before[text].unit, before[text].factor
    try:
        unit, factor, _ = unit_of(text)
    except UnitError:
        return ("" if dimension is None or dimension.is_pure else str(dimension)), 1.0
    return unit, factor
