"""Single values of a patch file: quantities with their dimension, integers, texts, terms.

Stage 2. What a key may hold is defined in `language`; here it is read and checked.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from hybrid.dimensions import dimension_of
from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.expressions import RESERVED_NAMES, ExpressionError, Name, Number, names
from hybrid.keys import Bound, Holds, Key, Unit
from hybrid.modes import RESERVED_SIGNALS
from hybrid.parsing import parse
from hybrid.patch import Value
from hybrid.units import (
    PURE,
    TIME,
    Dimension,
    UnitError,
    looks_like_quantity,
    split_quantity,
    unit_of,
)
from hybrid.wordlength import FEWEST_BITS, MOST_BITS, MOST_FIXED_BITS
from hybrid.yamltree import Sequence, Table, Text, Tree, kind_of

Scope = Mapping[str, Dimension | None]

LONGEST_NAME = 64
NAME = rf"^[A-Za-z_][A-Za-z0-9_]{{0,{LONGEST_NAME - 1}}}$"  # a JSON Schema reads it too
# A name as it is read: of something in a part, "rotation.rate", too.
SIGNAL_NAME = rf"{NAME[:-1]}(\.[A-Za-z_][A-Za-z0-9_]{{0,{LONGEST_NAME - 1}}})*$"
# Least and largest value of every key that holds an integer.
RANGES: Mapping[str, tuple[int, int]] = {
    "bits": (2, 32),
    "channel": (0, 999),
    "serial": (0, 2**63 - 1),
    "max_rows": (2, 100_000_000),
    "order": (1, 30),
    "quarter_square": (1, 200),
    "operations": (1, 100_000),
    "mantissa": (FEWEST_BITS, MOST_BITS),
    "fixed": (FEWEST_BITS, MOST_FIXED_BITS),
    "priority": (0, 999),
}
LONGEST_LINE = 200  # of a title
# The record's coordinate, which no signal may hide.
TIME_AXIS = "time"

_NAME = re.compile(NAME[:-1] + r"\Z")
_INTEGER = re.compile(r"[+-]?[0-9]{1,20}\Z")
_RATE = PURE / TIME


def check_name(name: str, place: Place, what: str) -> None:
    """Names are single words of ASCII letters, digits and underscores, and not functions."""
    article = "an" if what[0] in "aeiouAEIOU" else "a"
    if not _NAME.match(name) and name.count(")") > name.count("("):
        raise PatchError(
            f"{quoted(name)} cannot name {article} {what}; where it belongs to the text before it, put "
            "quotes around all of that: in braces a comma begins the next entry",
            place,
        )
    if not _NAME.match(name):
        raise PatchError(
            f"{quoted(name)} cannot name {article} {what}; use letters a to z or A to Z, digits "
            f"and underscores, at most {LONGEST_NAME}, no digit first",
            place,
        )
    if name in RESERVED_NAMES:
        raise PatchError(
            f"{name!r} cannot name {article} {what}; it is a function, a constant or a reserved word, "
            f"so take another, such as {name}_1",
            place,
        )
    if name in RESERVED_SIGNALS and what not in ("parameter", "readout"):
        raise PatchError(
            f"{name!r} cannot name {article} {what}; it tells the mode of the machine, so take another, "
            f"such as {name}_1",
            place,
        )
    if name == TIME_AXIS and what != "parameter":
        raise PatchError(
            f"{name!r} cannot name {article} {what}; it is the time axis of the record, so take "
            "another, such as clock",
            place,
        )


def table_of(tree: Tree, what: str, form: str = "key: value") -> Table:
    """The tree as a mapping; `form` shows one entry in the complaint."""
    if not isinstance(tree, Table):
        raise PatchError(f"{what} must be a mapping ({form}), not {kind_of(tree)}", tree.place)
    return tree


def only_keys(table: Table, keys: Iterable[Key], what: str, place: Place | None = None) -> None:
    """Refuse unknown keys, and missing required ones at `place` (default: where the table begins)."""
    keys = tuple(keys)
    known = {key.name for key in keys}
    for name, _, at in table:
        if name not in known:
            hint = did_you_mean(name, known)
            raise PatchError(f"unknown key {quoted(name)} in {what}; {hint}", at)
    for key in keys:
        if key.required and key.name not in table.entries:
            message = f"{what} has no {key.name}; add {key.name}: ({key.doc})"
            raise PatchError(message, place or table.place)


def one_kind(
    table: Table, kinds: Iterable[str], others: Iterable[str], what: str, place: Place
) -> str:
    """The only key of `table` that is one of `kinds`; `others` are valid beside it."""
    known, beside = sorted(kinds), set(others)
    found = [key for key in table.entries if key in known]
    if len(found) > 1:
        raise PatchError(
            f"{what} is both {found[0]} and {found[1]}; keep one of them", table.places[found[1]]
        )
    if found:
        return found[0]
    for key, _, at in table:
        if key not in beside:
            hint = did_you_mean(key, known)
            raise PatchError(f"{what} has no kind, {quoted(key)} is none; {hint}", at)
    raise PatchError(f"{what} has no kind; valid: {', '.join(known)}", place)


def value_of(tree: Tree, what: str, scope: Scope) -> tuple[Value, Dimension | None]:
    """An expression over the parameters in `scope`, with its dimension (None: unknown)."""
    if not isinstance(tree, Text) or not tree.text:
        raise PatchError(f"{what} needs a value, such as 1 ms or 2*gain", tree.place)
    try:
        expr = parse(tree.text, scope.keys())
        for name in sorted(names(expr) - scope.keys()):
            hint = did_you_mean(name, scope)
            raise PatchError(f"{what}: unknown parameter {quoted(name)}; {hint}", tree.place)
        return Value(expr, tree.place, what), dimension_of(expr, scope)
    except ExpressionError as error:
        raise PatchError(f"{what}: {error}", tree.place) from None


def unit_words(text: str) -> frozenset[str]:
    """Names in the unit of a quantity, lower case: {"rad", "s"} of "10 rad/s", none of "10"."""
    if not looks_like_quantity(text):
        return frozenset()
    return frozenset(re.findall(r"[^\W\d_]+|[%°]", split_quantity(text)[1].lower()))


def fits(text: str, found: Dimension | None, wanted: Dimension) -> bool:
    """Whether a value in `found` may stand where `wanted` is due.

    A bare number is taken in SI units; a number with a unit must fit, be it only a radian.
    """
    if found is None or found == wanted:
        return True
    return found.is_pure and not unit_words(text)


def in_words(dimension: Dimension, unit: str = "") -> str:
    """A dimension as a message names it: "a time, such as 1 ms", or "in V" where the unit is known."""
    if unit and not dimension.is_pure:
        return f"in {unit}"
    if dimension.is_pure:
        return "a pure number (rad, deg and % are pure)"
    if dimension == TIME:
        return "a time, such as 1 ms"
    if dimension == _RATE:
        return "a rate, such as 10 rad/s or 3 1/s"
    return f"in {dimension}"


def _si_unit(dimension: Dimension) -> str:
    """SI unit of a dimension, none of a pure number."""
    return "" if dimension.is_pure else str(dimension)


@dataclass(frozen=True, slots=True)
class FullScale:
    """Full scale of a signal, with the unit that the signal is shown in and its SI factor."""

    value: Value
    unit: str
    factor: float
    dimension: Dimension


class Fields:
    """Reads the values of one mapping; `scope` gives the dimensions of the parameters."""

    def __init__(
        self,
        table: Table,
        what: str,
        keys: Iterable[Key],
        scope: Scope,
        place: Place | None = None,
        places: Mapping[str, Place] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> None:
        """Refuses unknown keys at once; `place`: where a missing key is missed; `places`: where the
        parameters stand, `units`: in which they are written."""
        self.table, self.what, self.scope, self._places = table, what, scope, places or {}
        self._units = units or {}
        only_keys(table, keys, what, place)

    def tree(self, key: str) -> Tree:
        """The value of a required key."""
        return self.table.entries[key]

    def place(self, key: str) -> Place:
        """Where a key stands."""
        return self.table.places.get(key, self.table.place)

    def text(self, key: str, default: str | None = None) -> str:
        """A text value."""
        tree = self.table.entries.get(key)
        if tree is None and default is not None:
            return default
        if not isinstance(tree, Text) or not tree.text:
            had = kind_of(tree) if tree else "nothing"
            raise PatchError(f"{self.what}: {key} must be a text, not {had}", self.place(key))
        return tree.text

    def line(self, key: str) -> str:
        """A text of one line that can be printed."""
        text = self.text(key)
        if not text.isprintable() or len(text) > LONGEST_LINE:
            raise PatchError(
                f"{self.what}: {key} must be one line of at most {LONGEST_LINE} printable characters",
                self.place(key),
            )
        return text

    def integer(self, key: str, default: int) -> int:
        """A whole number within the key's range."""
        tree = self.table.entries.get(key)
        if tree is None:
            return default
        least, most = RANGES[key]
        text = tree.text if isinstance(tree, Text) else ""
        if not _INTEGER.match(text) or not least <= int(text) <= most:
            raise PatchError(
                f"{self.what}: {key} is {kind_of(tree) if not text else quoted(text)}; it must be a "
                f"whole number from {least} to {most}",
                self.place(key),
            )
        return int(text)

    def wholes(self, keys: Iterable[Key]) -> dict[str, Value]:
        """The whole numbers among `keys` that are given, and the choices as their number."""
        found = {}
        for key in keys:
            if key.name not in self.table.entries:
                continue
            if key.holds is Holds.INTEGER:
                number = self.integer(key.name, 0)
            elif key.holds is Holds.CHOICE:
                number = self.choice(key)
            else:
                continue
            what = f"{key.name} of {self.what}"
            found[key.name] = Value(Number(float(number)), self.place(key.name), what)
        return found

    def choice(self, key: Key) -> int:
        """The number of a word among those that may be chosen; the first where it is not given."""
        text = self.text(key.name, key.choices[0])
        if text not in key.choices:
            # A few words are all told: the nearest in letters need not be what is meant.
            hint = f"valid: {', '.join(key.choices)}"
            raise PatchError(
                f"{self.what}: {key.name} is {quoted(text)}; {hint}", self.place(key.name)
            )
        return key.choices.index(text)

    def bits(self) -> int | None:
        """Word length of a converter; None where it is not given."""
        return self.integer("bits", 0) or None

    def full_scale(self) -> FullScale:
        """The full scale, shown in `unit` where that is given, else in the unit it is written in, which
        of a parameter is that of the parameter."""
        tree = self.tree("full_scale")
        value, found = self.value_of(tree, f"full_scale of {self.what}")
        dimension = found or PURE
        positive = Value(
            value.expr, value.place, value.what, positive=True, unit=_si_unit(dimension)
        )
        shown = self.table.entries.get("unit")
        if shown is not None:
            unit, factor = self._unit(Text("1 " + self.text("unit"), shown.place), dimension)
        elif isinstance(tree, Text) and isinstance(value.expr, Number):
            unit, factor = self._unit(tree, dimension)
        elif isinstance(value.expr, Name) and (own := self._units.get(value.expr.id)):
            unit, factor = self._unit(Text(f"1 {own}", value.place), dimension)
        else:
            unit, factor = "" if dimension.is_pure else str(dimension), 1.0
        return FullScale(positive, unit, factor, dimension)

    def _unit(self, source: Text, dimension: Dimension) -> tuple[str, float]:
        """Display unit and its SI factor, which must fit the full scale."""
        try:
            unit, factor, found = unit_of(source.text)
        except UnitError as error:
            raise PatchError(f"{self.what}: {error}", source.place) from None
        if found != dimension:
            due = in_words(dimension)
            raise PatchError(
                f"{self.what}: unit {quoted(unit)} does not fit full_scale, which is {due}",
                source.place,
            )
        return unit, factor

    def value_of(self, tree: Tree, what: str) -> tuple[Value, Dimension | None]:
        """An expression over the parameters, with its dimension."""
        return value_of(tree, what, self.scope)

    def quantities(self, keys: Iterable[Key], own: FullScale | None = None) -> dict[str, Value]:
        """The quantities among `keys` that are given, checked against their dimension.

        `own` is the scale of the signal, for keys in its unit.
        """
        holds = (Holds.QUANTITY, Holds.EITHER)
        given = [k for k in keys if k.holds in holds and k.name in self.table.entries]
        return {key.name: self._quantity(key, own) for key in given}

    def _quantity(self, key: Key, own: FullScale | None) -> Value:
        tree, what = self.tree(key.name), f"{key.name} of {self.what}"
        value, found = self.value_of(tree, what)
        wanted = {
            Unit.OWN: own.dimension if own else PURE,
            Unit.OWN_RATE: (own.dimension if own else PURE) / TIME,
            Unit.PURE: PURE,
            Unit.TIME: TIME,
            Unit.RATE: _RATE,
            Unit.ANY: found or PURE,
        }[key.unit]
        assert isinstance(tree, Text)
        if not fits(tree.text, found, wanted):
            due = in_words(wanted, own.unit if own and key.unit is Unit.OWN else "")
            raise PatchError(f"{what} is {self._as_given(tree)}; it must be {due}", tree.place)
        return Value(
            value.expr,
            value.place,
            what,
            positive=key.bound is Bound.POSITIVE,
            not_negative=key.bound is Bound.NOT_NEGATIVE,
            unit=_si_unit(wanted),
        )

    def _as_given(self, tree: Text) -> str:
        """The text of a value, and of a parameter alone what it is and by which line."""
        dimension, place = self.scope.get(tree.text), self._places.get(tree.text)
        if dimension is None or place is None:
            return quoted(tree.text)
        kind = in_words(dimension).partition(",")[0]
        return f"{quoted(tree.text)}, which is {kind} by {place}"

    def terms(self, key: str) -> tuple[tuple[str, Value], ...]:
        """{signal: coefficient, ...}, sorted by signal."""
        what = f"{key} of {self.what}"
        table = table_of(self.tree(key), what, "signal: coefficient")
        if not table.entries:
            raise PatchError(f"{what} has no inputs; give {{signal: coefficient}}", table.place)
        terms = []
        for signal, tree, _ in sorted(table, key=lambda entry: entry[0]):
            value, _ = self.value_of(tree, f"coefficient of {quoted(signal)} in {self.what}")
            terms.append((signal, value))
        return tuple(terms)

    def list_of_texts(self, key: str) -> tuple[str, ...]:
        """[name, ...], in the order written."""
        tree = self.tree(key)
        if not isinstance(tree, Sequence):
            raise PatchError(
                f"{self.what}: {key} must be a list of signals, such as [x, y], not {kind_of(tree)}",
                tree.place,
            )
        for item in tree.items:
            if not isinstance(item, Text) or not item.text:
                raise PatchError(
                    f"{self.what}: {key} is a list of signals, not of {kind_of(item)}", item.place
                )
        return tuple(item.text for item in tree.items if isinstance(item, Text))

    def points(self, key: str, own: FullScale) -> tuple[tuple[Value, Value], ...]:
        """{input: output, ...}, in the order written; outputs in the unit of the signal."""
        table = table_of(self.tree(key), f"{key} of {self.what}", "input: output")
        found = []
        for text, tree, place in table:
            what = f"point {quoted(text)} of {self.what}"
            x, _ = value_of(Text(text, place), f"input of {what}", self.scope)
            y, dimension = value_of(tree, f"output of {what}", self.scope)
            if not isinstance(tree, Text) or not fits(tree.text, dimension, own.dimension):
                due = in_words(own.dimension, own.unit)
                raise PatchError(f"output of {what} must be {due}", tree.place)
            found.append((x, y))
        return tuple(found)

    def unit_term(self, key: str) -> tuple[tuple[str, Value], ...]:
        """One signal with coefficient 1."""
        value = Value(Number(1.0), self.place(key), f"{key} of {self.what}")
        return ((self.text(key), value),)
