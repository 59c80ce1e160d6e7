"""The names of a sub-patch as the whole patch knows them: "rate" of the part "wheel" is "wheel.rate".

A sub-patch sees nothing but its own names, so every name in it gets the part's name before it; what
is connected to an analog input takes the input's place. Texts are rewritten before anything reads
them, and each keeps its place, so messages show the whole patch's names and the line in the sub-patch.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

from hybrid.components import CATALOG
from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.expressions import RESERVED_NAMES, ExpressionError
from hybrid.language import (
    ADC_KEYS,
    DAC_KEYS,
    ERROR_KEYS,
    FULL_SCALE,
    STATE_KEYS,
    WORD_KEYS,
    Holds,
    Key,
)
from hybrid.modes import RESERVED_SIGNALS
from hybrid.parsing import NAME_IN_TEXT, is_quantity, refuse_hidden_product
from hybrid.yamltree import Sequence, Table, Text, Tree

_NO_NAMES = (Holds.INTEGER, Holds.TEXT, Holds.CHOICE)
_KEPT = RESERVED_NAMES | RESERVED_SIGNALS


@dataclass(frozen=True, slots=True)
class Part:
    """What can be seen of a part from outside."""

    source: str  # "parts/euler.yaml", for messages
    outputs: Collection[str]


@dataclass(frozen=True, slots=True)
class Scope:
    """Within a part, or in the patch itself: what its names are called outside of everything."""

    part: str = ""  # "" for the patch itself
    used: Place | None = None  # where the part is used
    aliases: Mapping[str, str] = field(default_factory=dict)  # analog input -> what is connected
    parts: Mapping[str, Part] = field(default_factory=dict)
    names: Collection[str] = ()  # of its parameters; in its program, of all it may read
    task: str = ""  # which computes its words, of a machine with tasks

    def place(self, place: Place) -> Place:
        """A place in the sub-patch, with where that is used."""
        return replace(place, part=self.part, used=self.used) if self.used else place

    def within(self, name: str) -> str:
        """A name of this scope with the part before it."""
        return f"{self.part}.{name}" if self.part else name

    def name(self, name: str, place: Place) -> str:
        """The name in the whole patch of what is `name` here."""
        if name in _KEPT:
            return name
        head, _, rest = name.partition(".")
        if rest and head in self.parts and rest not in self.parts[head].outputs:
            part = self.parts[head]
            hint = did_you_mean(rest, part.outputs)
            raise PatchError(
                f"{quoted(rest)} is no output of part {head!r} ({part.source}); {hint}",
                self.place(place),
            )
        return self.aliases.get(name) or self.within(name)

    def text(self, tree: Text) -> Text:
        """A name or arithmetic; the unit of a quantity is no name."""
        if is_quantity(tree.text):
            try:
                refuse_hidden_product(tree.text, frozenset(self.names))
            except ExpressionError as error:
                raise PatchError(str(error), self.place(tree.place)) from None
            return Text(tree.text, self.place(tree.place))

        def renamed(found: re.Match[str]) -> str:
            return self.name(found[0], tree.place)

        return Text(NAME_IN_TEXT.sub(renamed, tree.text), self.place(tree.place))

    def plain(self, tree: Tree) -> Tree:
        """What holds no names, in its place."""
        if isinstance(tree, Text):
            return Text(tree.text, self.place(tree.place))
        if isinstance(tree, Sequence):
            return Sequence(tuple(self.plain(item) for item in tree.items), self.place(tree.place))
        return self._table(tree, {key: self.plain(item) for key, item in tree.entries.items()})

    def arithmetic(self, tree: Tree) -> Tree:
        """All that `tree` holds as names and arithmetic, the keys of mappings too."""
        if isinstance(tree, Text):
            return self.text(tree)
        if isinstance(tree, Sequence):
            items = tuple(self.arithmetic(item) for item in tree.items)
            return Sequence(items, self.place(tree.place))
        entries: dict[str, Tree] = {}
        places: dict[str, Place] = {}
        for key, item, place in tree:
            name = self.text(Text(key, place)).text
            value = self.arithmetic(item)
            if name in entries:
                value = self._joined(entries[name], value, key, name)
            entries[name], places[name] = value, self.place(place)
        return Table(entries, places, self.place(tree.place))

    def _joined(self, one: Tree, other: Tree, key: str, name: str) -> Text:
        """The coefficient of a signal that is connected to two inputs of one component."""
        if (
            isinstance(one, Text)
            and isinstance(other, Text)
            and not any(is_quantity(tree.text) for tree in (one, other))
        ):
            return Text(f"({one.text}) + ({other.text})", other.place)
        raise PatchError(
            f"{quoted(key)} and another input are both connected to {quoted(name)}; their coefficients "
            "have units written out, so name these in parameters: to have them added",
            other.place,
        )

    def component(self, tree: Tree) -> Tree:
        """One entry of `analog`."""
        keys = tree.entries.keys() if isinstance(tree, Table) else ()
        kinds = [kind for key, kind in CATALOG.items() if key in keys]
        own = (kinds[0].main, *kinds[0].keys) if kinds else ()
        return self.keyed(tree, (*own, FULL_SCALE, *ERROR_KEYS))

    def converter(self, tree: Tree) -> Tree:
        """One entry of `interface`."""
        return self.keyed(tree, (*ADC_KEYS, *DAC_KEYS, *ERROR_KEYS))

    def state(self, tree: Tree) -> Tree:
        """One entry of `states`."""
        return self.keyed(tree, STATE_KEYS)

    def word_length(self, tree: Tree) -> Tree:
        """One entry of `words`."""
        return self.keyed(tree, WORD_KEYS)

    def model(self, tree: Tree) -> Tree:
        """One entry of `models`: what its inputs are connected to; their names are those of its file."""
        made = self.plain(tree)
        inputs = made.entries.get("inputs") if isinstance(made, Table) else None
        if not isinstance(made, Table) or not isinstance(inputs, Table):
            return made
        rewritten = {key: self.arithmetic(item) for key, item in inputs.entries.items()}
        whole = {**made.entries, "inputs": Table(rewritten, inputs.places, inputs.place)}
        return Table(whole, made.places, made.place)

    def keyed(self, tree: Tree, keys: Collection[Key]) -> Tree:
        """A mapping in which `keys` say which values hold names; unknown ones stay, to be refused."""
        if not isinstance(tree, Table):
            return self.plain(tree)
        holds = {key.name for key in keys if key.holds not in _NO_NAMES}
        return self._table(
            tree,
            {
                key: self.arithmetic(item) if key in holds else self.plain(item)
                for key, item in tree.entries.items()
            },
        )

    def _table(self, tree: Table, entries: dict[str, Tree]) -> Table:
        places = {key: self.place(place) for key, place in tree.places.items()}
        return Table(entries, places, self.place(tree.place))
