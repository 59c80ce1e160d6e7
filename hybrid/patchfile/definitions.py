"""Sub-patches as they are written: a file, or an entry of `definitions:` in one."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.fields import only_keys, table_of
from hybrid.language import DEFINITION_KEYS, PART_DIGITAL_KEYS, TOP_KEYS
from hybrid.patchfile.source import name_of, read_text, short
from hybrid.shipped import shipped_folder
from hybrid.yamltree import Sequence, Table, Text, Tree, kind_of, read_yaml

# Sections whose entries a part brings along; those WITHIN_DIGITAL stand in `digital`, in this form.
SECTIONS = (
    "parameters",
    "tables",
    "models",
    "analog",
    "interface",
    "program",
    "states",
    "remember",
    "words",
    "full_scales",
    "units",
)
WITHIN_DIGITAL = {
    "program": "word: arithmetic",
    "states": "state: {integrate: rate, initial: value}",
    "remember": "word: first value",
    "words": "word: word length",
    "full_scales": "word: full scale",
    "units": "word: unit",
}
# Of these, what each of several tasks has for itself.
OF_TASKS = ("program", "states", "words")
_NAMING = ("parameters", "tables", "models", "analog", "interface", "program", "states")


@dataclass(frozen=True, slots=True)
class Definition:
    """A sub-patch as it is written."""

    source: str  # "parts/euler.yaml", or "brick.yaml, wheel" of a definition, for messages
    table: Table
    folder: Path
    neighbours: Table | None  # the definitions of its file

    def section(self, name: str) -> Table | None:
        """A section that is a mapping, or None where it is absent."""
        if name not in WITHIN_DIGITAL:
            tree = self.table.entries.get(name)
            form = "key: value" if name == "digital" else "name: value"
            return None if tree is None else table_of(tree, name, form)
        digital = self.section("digital")
        tree = digital.entries.get(name) if digital else None
        return None if tree is None else table_of(tree, name, WITHIN_DIGITAL[name])

    def entries(self, *sections: str) -> Iterator[tuple[str, Tree, Place]]:
        """Name, tree and place of all that stands in these sections."""
        for section in sections:
            yield from (entry for _, entry in self.by_task(section))

    def by_task(self, section: str) -> Iterator[tuple[str, tuple[str, Tree, Place]]]:
        """The same of one section, each with the task that it stands in; "" where it stands in none."""
        yield from (("", entry) for entry in self.section(section) or ())
        if section not in OF_TASKS:
            return
        for task, table in self.tasks().items():
            tree = table.entries.get(section)
            for entry in table_of(tree, section, WITHIN_DIGITAL[section]) if tree else ():
                yield task, entry

    def tasks(self) -> dict[str, Table]:
        """The tasks of its digital machine by name, those that are mappings."""
        digital = self.section("digital")
        tree = digital.entries.get("tasks") if digital else None
        found = tree.entries.items() if isinstance(tree, Table) else ()
        return {name: task for name, task in found if isinstance(task, Table)}

    def defines(self, name: str) -> bool:
        """Whether a signal, word or parameter has this name."""
        return any(name == other for other, _, _ in self.entries("inputs", *_NAMING))

    def outputs(self) -> frozenset[str]:
        """What may be read of it: what `outputs` lists, or else all its own signals and words."""
        own = {name for name, _, _ in self.entries("analog", "interface", "program", "states")}
        own |= {name for name, tree, _ in self.entries("inputs") if isinstance(tree, Text)}
        tree = self.table.entries.get("outputs")
        if tree is None:
            return frozenset(own)
        if not isinstance(tree, Sequence):
            raise PatchError(
                f"outputs must be a list of signals, such as [rate, angle], not {kind_of(tree)}",
                tree.place,
            )
        within = {name for name, _, _ in self.entries("parts", "models")}
        listed = set()
        for item in tree.items:
            name = item.text if isinstance(item, Text) else ""
            # What a part or a model of it has is known only when that is looked up.
            if name not in own and name.partition(".")[0] not in within:
                hint = did_you_mean(name, own)
                raise PatchError(f"outputs: unknown signal {quoted(name)}; {hint}", item.place)
            listed.add(name)
        return frozenset(listed)


def definition_in(file: str, root: Table) -> Definition:
    """The sub-patch that a whole file is."""
    tree = root.entries.get("definitions")
    neighbours = None if tree is None else table_of(tree, "definitions", "name: sub-patch")
    made = Definition(file, root, Path(file).parent, neighbours)
    _check(made)
    return made


def named_definition(name: str, of: Definition, what: str, place: Place) -> Definition:
    """One of the definitions in the file of a sub-patch."""
    neighbours = of.neighbours.entries if of.neighbours else {}
    if name not in neighbours:
        hint = did_you_mean(name, neighbours)
        raise PatchError(f"{what} uses unknown definition {quoted(name)}; {hint}", place)
    table = table_of(neighbours[name], f"definition {name!r}")
    only_keys(table, DEFINITION_KEYS, f"definition {name!r}")
    made = Definition(f"{of.source.partition(', ')[0]}, {name}", table, of.folder, of.neighbours)
    if digital := made.section("digital"):
        only_keys(digital, PART_DIGITAL_KEYS, "digital of a definition")
    _check(made)
    return made


class Files:
    """The files of sub-patches, each read once."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self._definitions: dict[str, Definition] = {}

    def definition(self, text: str, folder: Path) -> Definition:
        """The sub-patch in a file as seen from `folder`, or else from the patches that ship."""
        path = Path(os.path.normpath(folder / text))
        shipped = shipped_folder() / text
        # Not Path.exists, which raises for a name that no file can have.
        if not os.path.exists(path) and os.path.exists(shipped):
            path = shipped
        name = name_of(path)
        if name not in self._definitions:
            advice = f"; give the path of a patch file as seen from {folder}"
            content = read_text(path, Place(short(name)), advice)
            root = read_yaml(content, name)
            only_keys(root, [replace(key, required=False) for key in TOP_KEYS], "the sub-patch")
            self._definitions[name] = definition_in(name, root)
            digital = self._definitions[name].section("digital")
            if digital and "tasks" in digital.entries:
                raise PatchError(
                    "a sub-patch cannot have tasks, which are of the whole machine; give it program:",
                    digital.places["tasks"],
                )
            self.texts[name] = content
        return self._definitions[name]


def _check(of: Definition) -> None:
    """Refuse inputs that nothing stands in for or whose name is taken, and unknown outputs."""
    for name, tree, place in of.entries("inputs"):
        if isinstance(tree, Sequence) or tree == Text("", tree.place):
            raise PatchError(
                f"input {name!r} must be a component or arithmetic, to stand in for it where the "
                f"sub-patch is run by itself, not {kind_of(tree)}",
                tree.place,
            )
        if any(name == other for other, _, _ in of.entries(*_NAMING)):
            raise PatchError(f"{name!r} is defined twice, first as an input; rename one", place)
    of.outputs()
