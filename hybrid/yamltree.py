"""YAML text -> a tree of mappings, lists and texts that all know their line; nothing else of YAML.

Stage 1, the only module that imports yaml. Every scalar stays the text the author wrote: whether
"1e-3" is a number is decided where its meaning is known. Anchors, aliases and tags are refused, so
no small file can unfold into a huge one. The tree is built from the parser's events, one by one, so
nothing is built of a file that is refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import yaml

from hybrid.errors import PatchError, Place, quoted

LARGEST_FILE = 1_000_000  # characters, and bytes
DEEPEST_NESTING = 12

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

# YAML 1.2, production c-printable. All else is refused here, where its line is known.
_UNPRINTABLE = re.compile(
    "[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]"
)
# An unquoted scalar that stands for nothing.
_NOTHING = frozenset({"", "~", "null", "Null", "NULL"})

# What to do about the complaints of YAML parsers that are hard to read, by a part of their text.
_ADVICE = {
    "mapping values are not allowed": "put a text with a colon in quotes and check the indentation",
    "cannot start any token": "indent by spaces, not tabs, and put a text that starts so in quotes",
    "violates indentation": "indent by spaces, not tabs",
    "expected ':'": "every line is key: value",
    "expected key": "check the indentation",
    "expected <block end>": "check the indentation",
    "unexpected end of stream": "close the quotes",
    "expected ',' or": "write {key: value, key: value} or [name, name]",
}


@dataclass(frozen=True, slots=True)
class Text:
    """A scalar as written, without white space around it; "" where there is no value."""

    text: str
    place: Place


@dataclass(frozen=True, slots=True)
class Sequence:
    """A list."""

    items: tuple[Tree, ...]
    place: Place


@dataclass(frozen=True, slots=True)
class Table:
    """A mapping, in the order written."""

    entries: dict[str, Tree]
    places: dict[str, Place]  # of the keys
    place: Place

    def __iter__(self) -> Iterator[tuple[str, Tree, Place]]:
        for key, tree in self.entries.items():
            yield key, tree, self.places[key]


Tree = Text | Sequence | Table


def read_yaml(text: str, file: str) -> Table:
    """The mapping that `text` holds; raises PatchError with the line of whatever is wrong."""
    if len(text) > LARGEST_FILE:
        raise PatchError(
            f"the file has {len(text)} characters; a patch has at most {LARGEST_FILE}", Place(file)
        )
    text = text.removeprefix("\ufeff")
    _refuse_unprintable(text, file)
    try:
        tree = _Builder(text, file).document()
    except yaml.MarkedYAMLError as error:
        raise _not_yaml(error, text, file) from None
    if tree is None or tree == Text("", tree.place):
        raise PatchError("the file is empty; a patch needs at least title: and run:", Place(file))
    if not isinstance(tree, Table):
        raise PatchError(
            "a patch is a mapping (title: ..., analog: ..., run: ...); "
            f"this file holds {kind_of(tree)}",
            tree.place,
        )
    return tree


def kind_of(tree: Tree) -> str:
    """What a tree is, in words."""
    if isinstance(tree, Text):
        return f"the text {quoted(tree.text)}" if tree.text else "nothing"
    return "a list" if isinstance(tree, Sequence) else "a mapping"


def _refuse_unprintable(text: str, file: str) -> None:
    found = _UNPRINTABLE.search(text)
    if found is None:
        return
    line = text.count("\n", 0, found.start()) + 1
    raise PatchError(
        f"the character U+{ord(found[0]):04X} has no place in a text; a patch is a YAML file in UTF-8",
        Place(file, line),
    )


def _not_yaml(error: yaml.MarkedYAMLError, text: str, file: str) -> PatchError:
    """The parser's complaint with what to do about it and where the fault began."""
    problem = (error.problem or "unreadable").removeprefix("but ")
    mark, began = error.problem_mark or error.context_mark, error.context_mark
    # A file that ends too early is at fault in its last line, not in the one after it.
    lines = text.count("\n") + (not text.endswith("\n"))
    line = min(mark.line + 1, lines) if mark else 0
    if began and began.line + 1 != line and error.context:
        problem += f" {error.context} that begins in line {began.line + 1}"
    advice = next((a for part, a in _ADVICE.items() if part in problem), "write key: value")
    return PatchError(f"not valid YAML: {problem}; {advice}", Place(file, line))


class _Builder:
    """Builds the tree of one document from the parser's events."""

    def __init__(self, text: str, file: str) -> None:
        self.file = file
        self.events: Iterator[Any] = iter(yaml.parse(text, Loader=_Loader))

    def document(self) -> Tree | None:
        """The only document; None where there is none."""
        root: Tree | None = None
        for event in self.events:
            if not isinstance(event, yaml.DocumentStartEvent):
                continue
            if root is not None:
                raise PatchError(
                    "a second document begins here; a patch is one document, so remove the ---",
                    self._place(event),
                )
            root = self._tree(next(self.events), 1)
        return root

    def _place(self, event: Any) -> Place:
        return Place(self.file, event.start_mark.line + 1)

    def _tree(self, event: Any, depth: int) -> Tree:
        """The node that begins with `event`, `depth` levels below the text."""
        place = self._place(event)
        self._refuse_references(event, place)
        if isinstance(event, yaml.ScalarEvent):
            nothing = event.style in (None, "") and event.value in _NOTHING
            return Text("" if nothing else event.value.strip(), place)
        if depth > DEEPEST_NESTING:
            raise PatchError(
                f"nested more than {DEEPEST_NESTING} levels deep; a patch needs at most 4", place
            )
        if isinstance(event, yaml.SequenceStartEvent):
            return Sequence(tuple(self._items(depth)), place)
        return self._table(place, depth)

    def _items(self, depth: int) -> Iterator[Tree]:
        while not isinstance(event := next(self.events), yaml.SequenceEndEvent):
            yield self._tree(event, depth + 1)

    def _table(self, place: Place, depth: int) -> Table:
        entries: dict[str, Tree] = {}
        places: dict[str, Place] = {}
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            at = self._place(event)
            self._refuse_references(event, at)
            if not isinstance(event, yaml.ScalarEvent):
                raise PatchError("a key is a single word, not a list or a mapping", at)
            key = event.value
            if key in entries:
                first = places[key].line
                raise PatchError(
                    f"{quoted(key)} is defined twice, first in line {first}; keep one", at
                )
            places[key] = at
            entries[key] = self._tree(next(self.events), depth + 1)
        return Table(entries, places, place)

    @staticmethod
    def _refuse_references(event: Any, place: Place) -> None:
        if isinstance(event, yaml.AliasEvent) or event.anchor:
            raise PatchError(
                "anchors and aliases (& and *) are not used in patches; write it out, or name a "
                "figure in parameters:",
                place,
            )
        if event.tag:
            raise PatchError(
                f"tags such as {quoted(event.tag)} are not used in patches; write the plain value",
                place,
            )
