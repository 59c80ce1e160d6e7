"""The section `interface`: analog-to-digital and digital-to-analog converters."""

from __future__ import annotations

from collections.abc import Iterator

from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.fields import Fields
from hybrid.language import ADC_KEYS, DAC_KEYS, ERROR_KEYS
from hybrid.patch import Adc, Dac
from hybrid.patchfile.book import Book, Role
from hybrid.yamltree import Table


def _converters(book: Book, role: Role) -> Iterator[tuple[str, Table, Place]]:
    """The converters of one role, sorted by name."""
    section = book.section("interface")
    for name in book.named(role):
        table = section.entries[name] if section else None
        assert isinstance(table, Table)
        yield name, table, book.places[name]


def read_dacs(book: Book) -> tuple[Dac, ...]:
    """The DACs, sorted by name."""
    return tuple(_dac(book, *entry) for entry in _converters(book, Role.DAC))


def read_adcs(book: Book) -> tuple[Adc, ...]:
    """The ADCs, sorted by name; the signals that they sample have been read."""
    return tuple(_adc(book, *entry) for entry in _converters(book, Role.ADC))


def _dac(book: Book, name: str, table: Table, place: Place) -> Dac:
    what = f"DAC {name!r}"
    fields = book.fields(table, what, (*DAC_KEYS, *ERROR_KEYS), place)
    scale = fields.full_scale()
    book.scales[name] = scale
    word = fields.text("dac")
    if book.roles.get(word) is not Role.WORD:
        role = book.roles.get(word)
        had = f"the {role.value}" if role else "unknown word"
        hint = did_you_mean(word, book.named(Role.WORD))
        raise PatchError(f"{what} converts {had} {quoted(word)}; {hint}", fields.tree("dac").place)
    own = [key for key in DAC_KEYS if key.name != "full_scale"]
    values = fields.quantities(own, scale)
    return Dac(
        name,
        word,
        fields.bits(),
        values["initial"],
        scale.value,
        scale.unit,
        scale.factor,
        scale.dimension,
        fields.quantities(ERROR_KEYS),
        place,
        _task(book, fields, "transfer", f"{what} is transferred by"),
        values.get("lead"),
    )


def _adc(book: Book, name: str, table: Table, place: Place) -> Adc:
    what = f"ADC {name!r}"
    fields = book.fields(table, what, ADC_KEYS, place)
    source = fields.text("adc")
    book.require_analog(source, f"{what} samples", fields.tree("adc").place)
    scale = book.scales[name] = book.scales[source]
    values = fields.quantities(ADC_KEYS, scale)
    return Adc(
        name,
        source,
        fields.bits(),
        values.get("range"),
        values.get("conversion_time"),
        fields.integer("channel", 0),
        place,
        _task(book, fields, "task", f"{what} is sampled by"),
    )


def _task(book: Book, fields: Fields, key: str, doing: str) -> str | None:
    """The task that is to sample or to show; None where it is not given."""
    if key not in fields.table.entries:
        return None
    task, place = fields.text(key), fields.place(key)
    if not book.tasks:
        raise PatchError(f"{doing} task {quoted(task)}; the patch has no tasks", place)
    if task not in book.tasks:
        hint = did_you_mean(task, book.tasks)
        raise PatchError(f"{doing} unknown task {quoted(task)}; {hint}", place)
    return task
