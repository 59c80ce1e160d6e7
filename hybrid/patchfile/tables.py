"""The section `tables`: look-up tables, from the patch itself or from CSV files."""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hybrid.errors import PatchError, Place, counted, did_you_mean, quoted
from hybrid.fields import Fields, in_words, table_of
from hybrid.language import TABLE_KEYS
from hybrid.meshes import check_spread, scattered_table, twice
from hybrid.patchfile.book import Book
from hybrid.tables import (
    METHODS,
    MOST_VALUES,
    OUTSIDE,
    Axis,
    Floats,
    Table,
    TableError,
    check_points,
    check_size,
)
from hybrid.units import (
    Dimension,
    UnitError,
    looks_like_quantity,
    parse_quantity,
    unit_of,
)
from hybrid.yamltree import Text, Tree, kind_of

_Found = TypeVar("_Found")
_KEYS = {key.name: key for key in TABLE_KEYS}
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d")
UNCLOSED = "a quotation mark opens a cell that has no end on its line; close it, or leave it out"


@dataclass(frozen=True, slots=True)
class _Column:
    """A name with the unit of its numbers."""

    name: str
    unit: str
    dimension: Dimension
    factor: float = 1.0  # SI value of one `unit`

    def number(self, text: str, place: Place, what: str) -> float:
        """A number in SI units; a bare one is in the column's unit."""
        try:
            if looks_like_quantity(text):
                quantity = parse_quantity(text)
                if quantity.dimension != self.dimension:
                    raise UnitError(f"{text!r} must be {in_words(self.dimension, self.unit)}")
                return quantity.value
            return parse_quantity(f"{text} {self.unit}" if self.unit else text).value
        except UnitError as error:
            raise PatchError(f"{what}: {error}", place) from None


def read_tables(book: Book) -> dict[str, Table]:
    """Every table, by name."""
    section = book.section("tables")
    found = {}
    for name, tree, place in section or ():
        mapped = table_of(tree, f"table {quoted(name)}", "inputs: {mach: 1}, values: {0: 1, 2: 3}")
        fields = book.fields(mapped, f"table {name!r}", TABLE_KEYS, place)
        found[name] = _table(book, name, fields, place)
    return found


def _table(book: Book, name: str, fields: Fields, place: Place) -> Table:
    inputs = _inputs(fields)
    output = _column(name, fields.table.entries.get("unit"), fields)
    given = [key for key in ("values", "file") if key in fields.table.entries]
    if len(given) != 1:
        what = "both values and file; keep one" if given else "neither values nor file; give one"
        raise PatchError(f"{fields.what} has {what} of them", place)
    if given == ["values"] and "output" in fields.table.entries:
        raise PatchError(
            f"{fields.what}: output names a column of a file; leave it out", fields.place("output")
        )
    method = METHODS[fields.choice(_KEYS["method"])]
    action = OUTSIDE[_KEYS["outside"].choices[fields.choice(_KEYS["outside"])]]
    if method == "simplices":
        return _between_points(book, fields, inputs, output, action)
    read = _inline(fields, inputs, output) if given == ["values"] else None
    points, values = read or _from_file(book, fields, inputs, output)
    axes = tuple(
        _axis(column, p, (p[0], p[-1]), action) for column, p in zip(inputs, points, strict=True)
    )
    return Table(name, axes, values, method, output.dimension)


def _axis(column: _Column, points: Sequence[float], ends: tuple[float, float], action: int) -> Axis:
    unit, factor = column.unit, column.factor
    return Axis(column.name, np.array(points), ends, action, action, column.dimension, unit, factor)


def _between_points(
    book: Book, fields: Fields, inputs: tuple[_Column, ...], output: _Column, action: int
) -> Table:
    """A table whose points lie anywhere."""
    if "file" in fields.table.entries:
        sheet = _read_sheet(book, fields, inputs, output)
        rows, places = sheet.rows, [sheet.place(row) for row in range(len(sheet.rows))]
    else:
        rows, places = _leaves(fields, inputs, output)
    data = np.array(rows).reshape(-1, len(inputs) + 1)
    points, values = data[:, :-1], data[:, -1]
    if (same := twice(points)) is not None:
        raise PatchError(
            f"{fields.what}: a point stands at the place of an earlier one", places[same]
        )
    place = places[0] if places else fields.table.place
    _checked(lambda: check_spread(points), fields.what, place)
    ends = [(float(p.min()), float(p.max())) for p in points.T]
    axes = tuple(_axis(column, e, e, action) for column, e in zip(inputs, ends, strict=True))
    table = Table(output.name, axes, values, dimension=output.dimension)
    return _checked(lambda: scattered_table(table, points, values, action), fields.what, place)


def _inputs(fields: Fields) -> tuple[_Column, ...]:
    """The variables of a table, in the order written."""
    table = table_of(fields.tree("inputs"), f"inputs of {fields.what}", "input: unit")
    try:
        check_size([2] * len(table.entries))
    except TableError as error:
        raise PatchError(f"{fields.what}: {error}", table.place) from None
    return tuple(_column(name, tree, fields) for name, tree, _ in table)


def _column(name: str, tree: Tree | None, fields: Fields) -> _Column:
    """A unit such as ft or rad/s; 1 and nothing are those of a pure number."""
    if tree is None or (isinstance(tree, Text) and tree.text == "1"):
        return _Column(name, "", Dimension())
    if not isinstance(tree, Text) or not tree.text:
        raise PatchError(
            f"{fields.what}: the unit of {quoted(name)} must be a text, such as ft, or 1, "
            f"not {kind_of(tree)}",
            tree.place,
        )
    try:
        unit, factor, dimension = unit_of(f"1 {tree.text}")
    except UnitError as error:
        told = f"{fields.what}: unit of {quoted(name)}: {error}; of a pure number it is 1"
        raise PatchError(told, tree.place) from None
    return _Column(name, unit, dimension, factor)


def _checked(check: Callable[[], _Found], what: str, place: Place) -> _Found:
    try:
        return check()
    except TableError as error:
        raise PatchError(f"{what}: {error}", place) from None


# --- values in the patch --------------------------------------------------------------------------


def _inline(
    fields: Fields, inputs: tuple[_Column, ...], output: _Column
) -> tuple[list[list[float]], Floats]:
    """Nested mappings, one level for each input, the first one outside."""
    found: list[list[float]] = [[] for _ in inputs]
    values: list[float] = []

    def level(tree: Tree, depth: int) -> None:
        what = f"{fields.what}, breakpoints of {inputs[depth].name}"
        table = table_of(tree, what, f"{inputs[depth].name}: value")
        points = [inputs[depth].number(text, at, what) for text, _, at in table]
        first = not found[depth]
        if first:
            _checked(lambda: check_points(inputs[depth].name, points), fields.what, table.place)
            found[depth] = points
        elif points != found[depth]:
            raise PatchError(
                f"{what} differ from those of the first row; every row needs the same "
                f"{len(found[depth])}",
                table.place,
            )
        for text, item, at in table:
            if depth + 1 < len(inputs):
                level(item, depth + 1)
            elif isinstance(item, Text) and item.text:
                values.append(output.number(item.text, item.place, f"{fields.what} at {text}"))
            else:
                raise PatchError(
                    f"{fields.what} at {text} needs a number, not {kind_of(item)}; its values are "
                    f"nested {len(inputs)} deep, one level for each input",
                    at,
                )

    level(fields.tree("values"), 0)
    return found, np.array(values).reshape([len(points) for points in found])


def _leaves(
    fields: Fields, inputs: tuple[_Column, ...], output: _Column
) -> tuple[list[tuple[float, ...]], list[Place]]:
    """The same nested mappings, whose levels need not be alike: every value with the way to it."""
    rows: list[tuple[float, ...]] = []
    places: list[Place] = []

    def level(tree: Tree, way: tuple[float, ...]) -> None:
        column = inputs[len(way)]
        what = f"{fields.what}, places along {column.name}"
        for text, item, at in table_of(tree, what, f"{column.name}: value"):
            here = (*way, column.number(text, at, what))
            if len(here) < len(inputs):
                level(item, here)
            elif isinstance(item, Text) and item.text:
                value = output.number(item.text, item.place, f"{fields.what} at {text}")
                rows.append((*here, value))
                places.append(at)
            else:
                raise PatchError(f"{fields.what} at {text} needs a number, not {kind_of(item)}", at)

    level(fields.tree("values"), ())
    return rows, places


# --- values in a file -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Sheet:
    """The rows of a CSV file as numbers in SI units, with the line of each."""

    file: str
    rows: list[tuple[float, ...]]
    lines: list[int]

    def place(self, row: int) -> Place:
        return Place(self.file, self.lines[row])


def _from_file(
    book: Book, fields: Fields, inputs: tuple[_Column, ...], output: _Column
) -> tuple[list[list[float]], Floats]:
    """Columns of a CSV file with a line of headings: a row for every combination of breakpoints."""
    sheet = _read_sheet(book, fields, inputs, output)
    points = [_distinct(sheet, i, column.name) for i, column in enumerate(inputs)]
    first = sheet.place(0)
    for column, found in zip(inputs, points, strict=True):
        check_points_of = column.name, found
        _checked(lambda given=check_points_of: check_points(*given), fields.what, first)  # type: ignore[misc]
    _checked(lambda: check_size([len(p) for p in points]), fields.what, first)
    _check_complete(sheet, inputs, points)
    values = np.array([row[-1] for row in sheet.rows])
    return points, values.reshape([len(p) for p in points])


def _read_sheet(book: Book, fields: Fields, inputs: tuple[_Column, ...], output: _Column) -> _Sheet:
    tree = fields.tree("file")
    path = Text(fields.text("file"), tree.place)
    file, text = book.files.read(path, fields.what)
    return _sheet(file, text, fields, inputs, output)


def _sheet(
    file: str, text: str, fields: Fields, inputs: tuple[_Column, ...], output: _Column
) -> _Sheet:
    wanted: list[tuple[int, _Column]] = []
    rows: list[tuple[float, ...]] = []
    lines: list[int] = []
    headings: list[str] = []
    met: dict[tuple[int, str], float] = {}  # breakpoints come again and again
    reader, read = csv.reader(text.splitlines(), strict=True), 0
    try:
        for cells in reader:
            place, before, read = Place(file, reader.line_num), read, reader.line_num
            if read > before + 1:
                raise PatchError(UNCLOSED, Place(file, before + 1))
            cells = [cell.strip() for cell in cells]
            if not any(cells) or cells[0].startswith("#"):
                continue
            if len(cells) == 1 or (wanted and len(cells) != len(headings)):
                _refuse_other_commas(cells, place)
            if not wanted:
                wanted, headings = _wanted(cells, fields, inputs, output, place), cells
                continue
            if len(cells) != len(headings):
                due = counted(len(headings), "heading")
                raise PatchError(f"{counted(len(cells), 'cell')}, but {due}; give as many", place)
            if len(rows) == MOST_VALUES:
                raise PatchError(f"a table has at most {MOST_VALUES} rows", place)
            for i, column in wanted:
                if (i, cells[i]) not in met:
                    _refuse_decimal_comma(cells[i], headings[i], place)
                    met[i, cells[i]] = column.number(cells[i], place, headings[i])
            rows.append(tuple(met[i, cells[i]] for i, _ in wanted))
            lines.append(reader.line_num)
    except csv.Error as error:
        open_ = "unexpected end" in str(error)
        told = UNCLOSED if open_ else f"not a CSV file: {error}"
        raise PatchError(told, Place(file, read + 1 if open_ else reader.line_num)) from None
    if not rows:
        raise PatchError(
            "no rows; give a line of headings and a row for each value", Place(file, 1)
        )
    return _Sheet(file, rows, lines)


def _refuse_other_commas(cells: Sequence[str], place: Place) -> None:
    """Raise PatchError for a row whose cells something else than commas keeps apart."""
    for mark, name in ((";", "semicolons"), ("\t", "tabs")):
        if any(mark in cell for cell in cells):
            raise PatchError(
                f"cells are kept apart by {name}; keep them apart by commas, and write numbers with a "
                "point: 0.5",
                place,
            )


def _refuse_decimal_comma(cell: str, heading: str, place: Place) -> None:
    """Raise PatchError for a number that is written with a comma, which only quotes keep together."""
    if _DECIMAL_COMMA.match(cell):
        raise PatchError(
            f"{heading}: {quoted(cell)} has a comma; write numbers with a point, such as 0.5, and "
            "thousands without a mark",
            place,
        )


def _wanted(
    headings: list[str],
    fields: Fields,
    inputs: tuple[_Column, ...],
    output: _Column,
    place: Place,
) -> list[tuple[int, _Column]]:
    """Numbers of the columns of the inputs and, last, of the output."""
    twice = next((h for i, h in enumerate(headings) if h in headings[:i]), None)
    if twice is not None:
        raise PatchError(f"two columns are named {quoted(twice)}; rename one", place)
    left = [heading for heading in headings if heading not in {c.name for c in inputs}]
    own_name = output.name.rpartition(".")[2]  # without those of the parts that it is in
    asked = fields.text("output", left[0] if len(left) == 1 else own_name)
    found = []
    for name, column in [*((c.name, c) for c in inputs), (asked, output)]:
        if name not in headings:
            hint = did_you_mean(name, headings)
            raise PatchError(f"{fields.what}: no column is named {quoted(name)}; {hint}", place)
        found.append((headings.index(name), column))
    return found


def _distinct(sheet: _Sheet, column: int, name: str) -> list[float]:
    """Breakpoints of a column, which must come in increasing order."""
    seen: Mapping[float, None] = dict.fromkeys(row[column] for row in sheet.rows)
    points = list(seen)
    for before, after in itertools.pairwise(points):
        if not after > before:
            row = next(i for i, cells in enumerate(sheet.rows) if cells[column] == after)
            raise PatchError(
                f"breakpoints of {name} must increase, but {after:g} comes after {before:g} (SI)",
                sheet.place(row),
            )
    return points


def _check_complete(sheet: _Sheet, inputs: tuple[_Column, ...], points: list[list[float]]) -> None:
    """Refuse a row that is missing, comes twice or is out of order, with its line."""
    expected = itertools.product(*points)
    names = ", ".join(column.name for column in inputs)
    order = f"rows give {names} in increasing order, the last one changing fastest"
    for row, due in itertools.zip_longest(range(len(sheet.rows)), expected):
        if row is None:
            shown = ", ".join(f"{x:g}" for x in due)
            raise PatchError(
                f"the row of {names} = {shown} (SI) is missing; {order}", sheet.place(-1)
            )
        if due is None or sheet.rows[row][:-1] != due:
            shown = ", ".join(f"{x:g}" for x in sheet.rows[row][:-1])
            raise PatchError(
                f"the row of {names} = {shown} (SI) is not due here: one is missing, is given twice "
                f"or is out of order; {order}",
                sheet.place(row),
            )
