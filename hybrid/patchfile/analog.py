"""The sections `machine` and `analog`: which machine, and its components with their inputs."""

from __future__ import annotations

from hybrid.components import CATALOG, Kind
from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.expressions import Name
from hybrid.fields import Fields, one_kind, table_of, unit_words
from hybrid.language import (
    ERROR_KEYS,
    FULL_SCALE,
    LEAK_LIMIT,
    MACHINE_KEYS,
    TIME_SCALE,
    TOP_KEYS,
    UNIT,
    Holds,
)
from hybrid.machines import PRESETS
from hybrid.patch import Component, MachineSettings, Value
from hybrid.patchfile.book import Book
from hybrid.yamltree import Table, Text


def read_machine(book: Book) -> MachineSettings:
    """The make of machine, with what the patch sets for all its components."""
    tree = book.root.entries.get("machine")
    if tree is None:
        return MachineSettings()
    if isinstance(tree, Text):
        return MachineSettings(_preset(tree.text, tree.place), place=tree.place)
    table = table_of(tree, "machine")
    fields = book.fields(table, "machine", MACHINE_KEYS, tree.place)
    return MachineSettings(
        _preset(fields.text("preset", "nominal"), fields.place("preset")),
        fields.integer("serial", 1),
        fields.quantities((*ERROR_KEYS, LEAK_LIMIT)),
        tree.place,
        fields.quantities(MACHINE_KEYS).get("pot_resolution"),
    )


def read_time_scale(book: Book) -> Value | None:
    """Problem seconds in a machine second, None where the patch does not say."""
    fields = book.fields(book.root, "the patch", TOP_KEYS, book.root.place)
    return fields.quantities((TIME_SCALE,)).get(TIME_SCALE.name)


def _preset(name: str, place: Place) -> str:
    if name not in PRESETS:
        raise PatchError(f"unknown machine {quoted(name)}; {did_you_mean(name, PRESETS)}", place)
    return name


def read_components(book: Book) -> tuple[Component, ...]:
    """The components, sorted by name."""
    entries = sorted(book.section("analog") or (), key=lambda entry: entry[0])
    return tuple(
        _component(book, name, table_of(tree, f"component {name!r}"), place)
        for name, tree, place in entries
    )


def _component(book: Book, name: str, table: Table, place: Place) -> Component:
    what = f"component {name!r}"
    beside = [key.name for key in (FULL_SCALE, UNIT, *ERROR_KEYS)]
    beside += [key.name for kind in CATALOG.values() for key in kind.keys]
    kind = CATALOG[one_kind(table, CATALOG, beside, what, place)]
    keys = (kind.main, *kind.keys, FULL_SCALE, UNIT, *ERROR_KEYS)
    fields = book.fields(table, what, keys, place)
    scale = fields.full_scale()
    book.scales[name] = scale
    complaint = kind.complaint(table.entries)
    if complaint:
        raise PatchError(f"{what}: {complaint}", place)
    initial = _initial_signal(book, fields)
    values = fields.quantities(
        [k for k in (kind.main, *kind.keys) if not (initial and k.name == "initial")], scale
    )
    values |= fields.wholes(kind.keys)
    _refuse_mixed_frequency(book, values, fields)
    return Component(
        name,
        kind.key,
        _terms(book, fields, kind),
        values,
        scale.value,
        scale.unit,
        scale.factor,
        scale.dimension,
        fields.quantities(ERROR_KEYS),
        place,
        _signals(book, fields, kind),
        book.control(fields, "control", f"{what} is controlled by"),
        fields.points("points", scale) if "points" in table.entries else (),
        initial,
        book.control(fields, "reset_when", f"{what} is reset by"),
        book.control(fields, "hold_when", f"{what} is held by"),
    )


def _signals(book: Book, fields: Fields, kind: Kind) -> tuple[str, ...]:
    """Inputs without coefficients, of a kind that is not linear."""
    main = kind.main
    if kind.is_linear or main.holds not in (Holds.SIGNAL, Holds.SIGNALS):
        return ()
    tree = fields.tree(main.name)
    found: tuple[str, ...]
    found = (
        (fields.text(main.name),) if main.holds is Holds.SIGNAL else fields.list_of_texts(main.name)
    )
    if len(found) != kind.inputs:
        raise PatchError(
            f"{fields.what}: {main.name} takes {kind.inputs} signals, not {len(found)}", tree.place
        )
    for signal in found:
        book.require_analog(signal, f"{fields.what} reads", tree.place)
    return found


def _initial_signal(book: Book, fields: Fields) -> str | None:
    """The signal that an integrator follows in IC, where `initial` names one."""
    tree = fields.table.entries.get("initial")
    if not isinstance(tree, Text) or tree.text not in book.roles or tree.text in book.scope:
        return None
    book.require_analog(tree.text, f"initial of {fields.what} is", tree.place)
    if "integrate" not in fields.table.entries:
        raise PatchError(
            f"initial of {fields.what} is the signal {tree.text!r}; only an integrator follows a signal",
            tree.place,
        )
    return tree.text


def _terms(book: Book, fields: Fields, kind: Kind) -> tuple[tuple[str, Value], ...]:
    """Inputs with their coefficients; each must be an analog signal."""
    main, doing = kind.main, f"{fields.what} reads"
    if main.holds is Holds.SIGNAL and kind.is_linear:
        terms = fields.unit_term(main.name)
        book.require_analog(terms[0][0], doing, fields.tree(main.name).place)
        return terms
    if main.holds is not Holds.TERMS:
        return ()
    terms = fields.terms(main.name)
    for signal, _, place in table_of(fields.tree(main.name), main.name):
        book.require_analog(signal, doing, place)
    if kind.single_input and len(terms) != 1:
        raise PatchError(
            f"{fields.what}: {main.name} takes one signal, not {len(terms)}; use sum:",
            fields.place(main.name),
        )
    return terms


def _refuse_mixed_frequency(book: Book, values: dict[str, Value], fields: Fields) -> None:
    """Dimensions alone cannot tell Hz from rad/s, so the unit written must fit the key."""
    for key, wrong, right in (
        ("omega", "hz", "frequency: "),
        ("frequency", "rad", "omega: "),
        ("bandwidth", "hz", "rad/s (1 Hz is 2*pi rad/s)"),
    ):
        tree = fields.table.entries.get(key)
        if key not in values or not isinstance(tree, Text):
            continue
        text, expr = tree.text, values[key].expr
        if isinstance(expr, Name):
            text = "1 " + book.units[expr.id]
        if any(word.endswith(wrong) for word in unit_words(text)):
            raise PatchError(
                f"{fields.what}: {key} is given in {quoted(tree.text)}; use {right}".rstrip(),
                tree.place,
            )
