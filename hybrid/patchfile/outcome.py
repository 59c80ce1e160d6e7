"""The sections `modes`, `run`, `record` and `readouts`: when and how long, and what comes out."""

from __future__ import annotations

from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.fields import check_name, one_kind, table_of
from hybrid.language import (
    DEFAULT_ROWS,
    MODES_KEYS,
    READOUT_KEYS,
    READOUT_KINDS,
    RUN_KEYS,
    Holds,
    Key,
)
from hybrid.modes import ON_OVERLOAD
from hybrid.patch import ModeSettings, Readout, RunSettings
from hybrid.patchfile.book import Book
from hybrid.yamltree import Sequence, Text, Tree, kind_of


def read_run(book: Book) -> RunSettings:
    """Length of the run and density of its record."""
    table = table_of(book.root.entries["run"], "run")
    place = book.root.places["run"]
    fields = book.fields(table, "run", RUN_KEYS, place)
    values = fields.quantities(RUN_KEYS)
    if "every" not in values and not book.has_clock:
        what = "task with a period" if book.tasks else "digital machine"
        raise PatchError(
            f"run: without a {what} the record needs its interval; add every: TIME", place
        )
    max_rows = fields.integer("max_rows", DEFAULT_ROWS)
    on_overload = fields.text("on_overload", "continue")
    if on_overload not in ON_OVERLOAD:
        raise PatchError(
            f"run: on_overload is {quoted(on_overload)}; {did_you_mean(on_overload, ON_OVERLOAD)}",
            fields.place("on_overload"),
        )
    return RunSettings(values["until"], values.get("every"), max_rows, on_overload)


def read_modes(book: Book) -> ModeSettings | None:
    """When the machine is in IC, OP and HOLD; None where it is always in OP."""
    tree = book.root.entries.get("modes")
    if tree is None:
        return None
    place = book.root.places["modes"]
    fields = book.fields(table_of(tree, "modes"), "modes", MODES_KEYS, place)
    values = fields.quantities(MODES_KEYS)
    given = fields.table.entries
    if ("operate" in given) != ("reset" in given):
        missing = "reset" if "operate" in given else "operate"
        raise PatchError(f"modes has no {missing}; operate and reset go together", place)
    for key in ("hold", "operations"):
        if key in given and "operate" not in given:
            raise PatchError(f"modes: {key} needs operate and reset beside it", fields.place(key))
    reset_when = book.control(fields, "reset_when", "the machine is reset by", modes=False)
    hold_when = book.control(fields, "hold_when", "the machine is held by", modes=False)
    if not given:
        raise PatchError(
            "modes is empty; give reset and operate, or reset_when, or hold_when", place
        )
    return ModeSettings(
        values.get("reset"),
        values.get("operate"),
        values.get("hold"),
        fields.integer("operations", 0) or None,
        reset_when,
        hold_when,
        place,
    )


def read_record(book: Book) -> tuple[str, ...]:
    """The signals to keep, in the order given; () for all."""
    tree = book.root.entries.get("record")
    if tree is None:
        return ()
    if not isinstance(tree, Sequence):
        raise PatchError(
            f"record must be a list of signals, such as [theta, alpha], not {kind_of(tree)}",
            tree.place,
        )
    if not tree.items:
        raise PatchError("record is empty; name signals, or leave it out for all", tree.place)
    known, found = book.signals, dict[str, None]()
    for item in tree.items:
        if not isinstance(item, Text) or not item.text:
            raise PatchError(f"record is a list of signals, not of {kind_of(item)}", item.place)
        if item.text not in known:
            hint = did_you_mean(item.text, known)
            raise PatchError(f"record: unknown signal {quoted(item.text)}; {hint}", item.place)
        if item.text in found:
            raise PatchError(f"record names {quoted(item.text)} twice; name it once", item.place)
        found[item.text] = None
    return tuple(found)


def read_readouts(book: Book) -> tuple[Readout, ...]:
    """The readouts, in the order written, in which they are shown."""
    entries = book.section("readouts") or ()
    return tuple(_readout(book, name, tree, place) for name, tree, place in entries)


def _readout(book: Book, name: str, tree: Tree, place: Place) -> Readout:
    check_name(name, place, "readout")
    what = f"readout {name!r}"
    table = table_of(tree, what, "quantity: signal")
    kind = one_kind(table, READOUT_KINDS, [key.name for key in READOUT_KEYS], what, place)
    main = Key(kind, Holds.SIGNAL, READOUT_KINDS[kind], required=True)
    fields = book.fields(table, what, (main, *READOUT_KEYS), place)
    signal = fields.text(kind)
    if signal not in book.signals:
        hint = did_you_mean(signal, book.signals)
        raise PatchError(
            f"{what}: unknown signal {quoted(signal)}; {hint}", fields.tree(kind).place
        )
    values = fields.quantities(READOUT_KEYS)
    return Readout(name, kind, signal, values.get("from"), values.get("until"), place)
