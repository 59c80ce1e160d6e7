"""What is connected to the inputs of parts: an analog signal, or arithmetic that becomes a word."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from hybrid.errors import PatchError, Place
from hybrid.expressions import is_known
from hybrid.fields import in_words, value_of
from hybrid.language import FULL_SCALE
from hybrid.patch import Assignment
from hybrid.patchfile.book import Book, Role
from hybrid.units import PURE, Dimension
from hybrid.yamltree import Table, Tree


@dataclass(frozen=True, slots=True)
class Connection:
    """An input of a part and what is connected to it."""

    what: str  # "input 'moment' of part 'wheel' (wheel.yaml:3)"
    stand_in: Tree  # what the input is in the sub-patch by itself, by the whole patch's names
    name: str  # the analog signal that is connected, or the word that the input becomes
    place: Place  # where it is connected


def check_inputs(book: Book, connections: Iterable[Connection]) -> None:
    """What is connected to an analog input of a part is an analog signal."""
    for one in connections:
        if isinstance(one.stand_in, Table):
            book.require_analog(one.name, f"{one.what} is", one.place)


def check_signals(book: Book, connections: Iterable[Connection]) -> None:
    """A signal that is connected to a part has the unit of what stands in for the input."""
    for one in connections:
        if one.name in book.scales:
            _require(one, book.scales[one.name].dimension, _due(book, one))


class WordInputs:
    """The inputs of parts that are words, each in the unit of what stands in for it."""

    def __init__(self, book: Book, connections: Iterable[Connection]) -> None:
        words = [one for one in connections if book.roles.get(one.name) is Role.WORD]
        self._due = {one.name: (one, _due(book, one)) for one in words}
        self._bare = frozenset(n for n in book.scope if not book.units.get(n))

    def dimension(self, entry: Assignment, found: Dimension | None) -> Dimension | None:
        """Dimension of a word whose arithmetic is in `found`; what is due where that is bare.

        Bare arithmetic, 2*3, over parameters without a unit if any, is in the SI unit that is due, as a
        bare number is. Raises PatchError for what is in another unit, where it is connected.
        """
        if entry.word not in self._due:
            return found
        one, due = self._due[entry.word]
        if found == PURE and is_known(entry.expr, self._bare):
            return due or found
        _require(one, found, due)
        return found


def _require(one: Connection, found: Dimension | None, due: Dimension | None) -> None:
    """Refuse what is connected in another unit than that of the input."""
    if None not in (found, due) and found != due:
        raise PatchError(
            f"{one.what} must be {in_words(due or PURE)}; what is connected to it is "
            f"{in_words(found or PURE)}",
            one.place,
        )


def _due(book: Book, one: Connection) -> Dimension | None:
    """Dimension of an input by itself; None where it may be any."""
    tree = one.stand_in
    scope: Mapping[str, Dimension | None] = book.scope
    if isinstance(tree, Table):
        if FULL_SCALE.name not in tree.entries:
            raise PatchError(f"{one.what} has no full_scale; add full_scale: VALUE", tree.place)
        tree = tree.entries[FULL_SCALE.name]
    else:
        scope = {**book.scope, **dict.fromkeys(book.signals)}  # that of a word may be anything
    return value_of(tree, one.what, scope)[1]
