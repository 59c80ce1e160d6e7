"""The key `when` of a task: which comparator starts its cycles, and by switching which way."""

from __future__ import annotations

from hybrid.errors import PatchError, quoted
from hybrid.fields import Fields
from hybrid.language import EDGES
from hybrid.patchfile.book import Book
from hybrid.yamltree import Table


def read_when(book: Book, fields: Fields, states: frozenset[str]) -> tuple[str, str] | None:
    """Comparator and edge of a task; None where it has a clock.

    fields: of the task; states: that it integrates.
    """
    what, given = fields.what, fields.table.entries
    if "when" not in given:
        if "period" not in given:
            raise PatchError(
                f"{what} has no period; add period: TIME, or when: COMPARATOR rises, falls or changes",
                fields.place("period"),
            )
        return None
    place = fields.place("when")
    for key in ("period", "phase", "jitter"):
        if key in given:
            raise PatchError(
                f"{what} has both when and {key}; a clock starts its cycles, or a comparator does",
                fields.place(key),
            )
    if states:
        raise PatchError(
            f"{what} integrates {min(states)!r}, whose step is the period; give it a period in place "
            "of when",
            place,
        )
    name, _, edge = fields.text("when").rpartition(" ")
    if edge not in EDGES or not name.strip():
        raise PatchError(
            f"when of {what} is {quoted(fields.text('when'))}; valid: the name of a comparator and "
            f"{', '.join(EDGES[:-1])} or {EDGES[-1]}",
            place,
        )
    name = name.strip()
    book.require_analog(name, f"{what} is started by", place)
    tree = (book.section("analog") or Table({}, {}, place)).entries.get(name)
    if not isinstance(tree, Table) or "compare" not in tree.entries:
        raise PatchError(
            f"{what} is started by {quoted(name)}, which is no comparator; add one with compare:",
            place,
        )
    return name, edge
