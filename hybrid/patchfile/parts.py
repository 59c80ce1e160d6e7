"""Sub-patches in use: what `parts:` names is written out, so that all else knows one flat patch only.

The inputs of a sub-patch are connected and its parameters set where it is used; its outputs are read
there as "part.signal". How its names change is in `renaming`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.fields import check_name, only_keys, table_of
from hybrid.language import MACHINES, PART_KEYS
from hybrid.parsing import NAME_IN_TEXT
from hybrid.patchfile.connections import Connection
from hybrid.patchfile.definitions import (
    OF_TASKS,
    SECTIONS,
    WITHIN_DIGITAL,
    Definition,
    Files,
    definition_in,
    named_definition,
)
from hybrid.patchfile.inputs import fitted
from hybrid.patchfile.placing import Told
from hybrid.patchfile.renaming import Part, Scope
from hybrid.yamltree import Table, Text, Tree, kind_of

MOST_PARTS = 200  # of a patch, with the parts of parts
DEEPEST_PARTS = 8
LONGEST_NAME = 200  # of a signal in a part of a part; the file format of records takes 256


@dataclass(frozen=True, slots=True)
class Setting:
    """A parameter of a part that is set where the part is used."""

    what: str
    default: Text
    given: Text


@dataclass(frozen=True, slots=True)
class Flat:
    """A patch without parts; `texts` are those of the other files that it was written out from."""

    root: Table
    connections: tuple[Connection, ...]
    settings: Mapping[str, Setting]
    texts: tuple[str, ...]
    parts: tuple[str, ...]
    told: tuple[Told, ...]  # which parts run on a machine of their own
    homes: Mapping[str, str]  # analog signals of parts that name a task, with it


@dataclass(frozen=True, slots=True)
class _Use:
    """One entry of `parts`, with the definition that it uses."""

    name: str  # with those of the parts that it is in
    definition: Definition
    table: Table
    place: Place
    task: str = ""  # which it names


def expand(root: Table, file: str) -> Flat:
    """Write out the parts of the patch `root`, which `file` holds.

    Raises PatchError for parts that do not exist or do not fit, with the place in the sub-patch and
    where that is used.
    """
    writer = _Writer()
    top = definition_in(file, root)
    writer.tasks = {task: {name: ({}, {}) for name in OF_TASKS} for task in top.tasks()}
    # By itself a sub-patch has what stands in for its inputs.
    words = {name: tree for name, tree, _ in top.entries("inputs") if isinstance(tree, Text)}
    for name, tree, place in top.entries("inputs"):
        if isinstance(tree, Table):
            writer.add("analog", Scope(), name, tree, place)
    writer.write(top, Scope(), (file,), {}, words)
    return writer.flat(root)


class _Writer:
    """Collects what all parts have in each section."""

    def __init__(self) -> None:
        self.sections: dict[str, tuple[dict[str, Tree], dict[str, Place]]]
        self.sections = {name: ({}, {}) for name in SECTIONS}
        self.tasks: dict[str, dict[str, tuple[dict[str, Tree], dict[str, Place]]]] = {}
        self.connections: list[Connection] = []
        self.settings: dict[str, Setting] = {}
        self.files = Files()
        self.parts: list[str] = []
        self.told: list[Told] = []
        self.homes: dict[str, str] = {}

    def write(
        self,
        of: Definition,
        scope: Scope,
        trail: tuple[str, ...],
        given: Mapping[str, Text],
        words: Mapping[str, Text],
    ) -> None:
        """Add a sub-patch with all its parts.

        trail: the sub-patches that it is in, itself the last; given: its parameters as they are set
        where it is used; words: the same of its inputs that are words.
        """
        uses = {n: self._use(of, scope, n, t, p, trail) for n, t, p in of.entries("parts")}
        parts = {
            n: Part(use.definition.source, use.definition.outputs()) for n, use in uses.items()
        }
        names = frozenset(name for name, _, _ in of.entries("parameters"))
        scope = replace(scope, parts=parts, names=names)
        readable = names | frozenset(
            name for name, _, _ in of.entries("inputs", "interface", "program")
        )
        for name, tree, place in of.entries("parameters"):
            self._add_parameter(scope, name, tree, place, given.get(name))
        for section in SECTIONS[1:]:
            within = replace(scope, names=readable) if section == "program" else scope
            for task, (name, tree, place) in of.by_task(section):
                self.add(section, replace(within, task=task or scope.task), name, tree, place)
        for name, text in words.items():
            self._put("program", scope, name, text, text.place)
        _check_outputs(of, scope)
        for use in uses.values():
            self._write_part(scope, use, trail)

    def add(self, section: str, scope: Scope, name: str, tree: Tree, place: Place) -> None:
        """Add an entry as it stands in a sub-patch."""
        rewrite = {
            "tables": scope.plain,
            "models": scope.model,
            "analog": scope.component,
            "interface": scope.converter,
            "states": scope.state,
            "words": scope.word_length,
            "units": scope.plain,
        }
        rewritten = rewrite.get(section, scope.arithmetic)(tree)
        self._put(section, scope, name, rewritten, scope.place(place))

    def _put(self, section: str, scope: Scope, name: str, tree: Tree, place: Place) -> None:
        """Add an entry that is written in the whole patch's names."""
        if "." in name and section not in ("remember", "words", "full_scales", "units"):
            raise PatchError(
                f"{quoted(name)} cannot be defined here; only parts: makes names with a dot", place
            )
        full = scope.name(name, place)
        if scope.part and len(full) > LONGEST_NAME:
            raise PatchError(
                f"{quoted(full)} has {len(full)} letters, with the parts that it is in; a name has at "
                f"most {LONGEST_NAME}",
                place,
            )
        own = self.tasks[scope.task] if scope.task and section in OF_TASKS else self.sections
        entries, places = own[section]
        entries[full], places[full] = tree, place
        if scope.task and section == "analog":
            self.homes[full] = scope.task

    def _add_parameter(
        self, scope: Scope, name: str, tree: Tree, place: Place, given: Text | None
    ) -> None:
        default = scope.arithmetic(tree)
        if given is not None and isinstance(default, Text):
            what = f"parameter {name!r} of part {scope.part!r} ({place})"
            self.settings[scope.name(name, place)] = Setting(what, default, given)
        self._put("parameters", scope, name, given or default, scope.place(place))

    def _use(
        self,
        of: Definition,
        scope: Scope,
        name: str,
        tree: Tree,
        place: Place,
        trail: tuple[str, ...],
    ) -> _Use:
        """One entry of `parts`: which sub-patch it uses."""
        place = scope.place(place)
        check_name(name, place, "part")
        if of.defines(name):
            raise PatchError(f"{name!r} is defined twice, as a part too; rename one", place)
        what = f"part {name!r}"
        table = table_of(scope.plain(tree), what)
        only_keys(table, PART_KEYS, what, place)
        keys = ("file", "use", "task")
        texts = {key: _text(table, key, what) for key in keys if key in table.entries}
        if "task" in texts:
            self._check_task(texts["task"], what)
        if not {"file", "use"} & texts.keys():
            raise PatchError(
                f"{what} names no sub-patch; give file: FILE, or use: NAME of one in definitions:",
                place,
            )
        full = scope.within(name)
        definition = of
        try:
            if "file" in texts:
                definition = self.files.definition(texts["file"].text, of.folder)
            if "use" in texts:
                use = texts["use"]
                definition = named_definition(use.text, definition, what, use.place)
        except PatchError as error:
            used = error.place if error.place.used else replace(error.place, part=full, used=place)
            raise PatchError(error.message, used) from None
        self._refuse_endless(definition, what, place, trail)
        self.parts.append(full)
        if "on" in table.entries:
            self.told.append(Told(full, _machine(_text(table, "on", what), what), place))
        task = texts["task"].text if "task" in texts else ""
        return _Use(full, definition, table, place, task)

    def _check_task(self, task: Text, what: str) -> None:
        """Refuse a task that the machine does not have."""
        if not self.tasks:
            raise PatchError(
                f"{what} has a task, but the digital machine has no tasks; leave task: out",
                task.place,
            )
        if task.text not in self.tasks:
            hint = did_you_mean(task.text, self.tasks)
            raise PatchError(f"{what} has unknown task {quoted(task.text)}; {hint}", task.place)

    def _refuse_endless(
        self, definition: Definition, what: str, place: Place, trail: tuple[str, ...]
    ) -> None:
        if definition.source in trail:
            circle = " -> ".join((*trail[trail.index(definition.source) :], definition.source))
            raise PatchError(f"{what} is part of itself: {circle}; take one of them out", place)
        if len(self.parts) >= MOST_PARTS:
            raise PatchError(f"a patch has at most {MOST_PARTS} parts, those of parts too", place)
        if len(trail) > DEEPEST_PARTS:
            raise PatchError(f"parts are at most {DEEPEST_PARTS} deep in each other", place)

    def _write_part(self, scope: Scope, use: _Use, trail: tuple[str, ...]) -> None:
        """Add a part; `scope` is that in which it is used."""
        of = use.definition
        inputs = _bindings(use, "inputs", {n: p for n, _, p in of.entries("inputs")})
        known = {n: p for n, _, p in of.entries("parameters")}
        given = {n: scope.text(t) for n, t in _bindings(use, "parameters", known).items()}
        words: dict[str, Text] = {}
        aliases: dict[str, str] = {}
        for name, tree, place in of.entries("inputs"):
            if name not in inputs:
                raise PatchError(
                    f"part {use.name!r} leaves input {name!r} ({place}) open; connect it, "
                    f"inputs: {{{name}: SIGNAL}}",
                    use.place,
                )
            text = scope.text(inputs[name])
            if isinstance(tree, Text):
                words[name] = fitted(f"input {name!r} of part {use.name!r} ({place})", tree, text)
            elif NAME_IN_TEXT.fullmatch(text.text):
                aliases[name] = text.text
            else:
                raise PatchError(
                    f"input {name!r} of part {use.name!r} ({place}) is analog and takes the name of a "
                    f"signal, not {quoted(inputs[name].text)}",
                    text.place,
                )
        inside = Scope(use.name, use.place, aliases, task=use.task or scope.task)
        for name, tree, place in of.entries("inputs"):
            what = f"input {name!r} of part {use.name!r} ({place})"
            stand_in = inside.component(tree) if name in aliases else inside.arithmetic(tree)
            at = scope.place(inputs[name].place)
            self.connections.append(Connection(what, stand_in, inside.name(name, at), at))
        self.write(of, inside, (*trail, of.source), given, words)

    def _with_tasks(self, digital: Table) -> Tree | None:
        """The section `tasks`, each with the words of its parts; None where there is none."""
        tree = digital.entries.get("tasks")
        if not isinstance(tree, Table):
            return tree
        entries = {
            name: _filled(task, self.tasks[name]) if isinstance(task, Table) else task
            for name, task in tree.entries.items()
        }
        return Table(entries, tree.places, tree.place)

    def flat(self, root: Table) -> Flat:
        """The patch with all that was added in its sections."""
        entries, places = dict(root.entries), dict(root.places)
        for section in ("parts", "definitions", "inputs", "outputs"):
            entries.pop(section, None)
        digital = entries.get("digital")
        given = {**entries, **(digital.entries if isinstance(digital, Table) else {})}
        made = {
            name: Table(*self.sections[name], given[name].place if name in given else root.place)
            for name in SECTIONS
        }
        for name in SECTIONS:
            if name in WITHIN_DIGITAL or not made[name].entries:
                continue
            entries[name] = made[name]
            places.setdefault(name, root.place)
        if isinstance(digital, Table):
            entries["digital"] = _digital(digital, made, self._with_tasks(digital))
        elif words := {**made["program"].places, **made["states"].places}:
            word, place = next(iter(words.items()))
            raise PatchError(
                f"the word {word!r} needs a digital machine; add digital: {{period: TIME}}", place
            )
        return Flat(
            Table(entries, places, root.place),
            tuple(self.connections),
            self.settings,
            tuple(self.files.texts.values()),
            tuple(self.parts),
            tuple(self.told),
            self.homes,
        )


def _digital(digital: Table, made: Mapping[str, Table], tasks: Tree | None) -> Table:
    """The digital machine with the words of all parts; tasks: with theirs, None where it has none."""
    entries, places = dict(digital.entries), dict(digital.places)
    if tasks is not None:
        entries["tasks"] = tasks
    for name in WITHIN_DIGITAL:
        if made[name].entries:
            if tasks is not None and name in ("program", "states") and name not in entries:
                word, place = next(iter(made[name].places.items()))
                raise PatchError(
                    f"the word {word!r} of a part belongs to no task; give the part its task: in "
                    "parts:, one of those under tasks:",
                    place,
                )
            entries[name] = made[name]
            places.setdefault(name, digital.place)
    return Table(entries, places, digital.place)


def _filled(table: Table, found: Mapping[str, tuple[dict[str, Tree], dict[str, Place]]]) -> Table:
    """A task with the words of parts."""
    entries, places = dict(table.entries), dict(table.places)
    for section, (own, own_places) in found.items():
        if own:
            place = entries[section].place if section in entries else table.place
            entries[section] = Table(own, own_places, place)
            places.setdefault(section, table.place)
    return Table(entries, places, table.place)


def _bindings(use: _Use, key: str, known: Mapping[str, Place]) -> dict[str, Text]:
    """What is set of a part, by name; `known` are the names that its definition has."""
    tree = use.table.entries.get(key)
    table = table_of(tree, f"{key} of part {use.name!r}", "name: value") if tree else None
    found = {}
    for name, item, place in table or ():
        if name not in known:
            hint = did_you_mean(name, known)
            raise PatchError(
                f"part {use.name!r} ({use.definition.source}) has no {key.removesuffix('s')} "
                f"{quoted(name)}; {hint}",
                place,
            )
        if not isinstance(item, Text) or not item.text:
            raise PatchError(
                f"{key} of part {use.name!r}: {name!r} must be a name or arithmetic, not "
                f"{kind_of(item)}",
                item.place,
            )
        found[name] = item
    return found


def _text(table: Table, key: str, what: str) -> Text:
    tree = table.entries[key]
    if not isinstance(tree, Text) or not tree.text:
        raise PatchError(f"{what}: {key} must be a text, not {kind_of(tree)}", tree.place)
    return tree


def _machine(text: Text, what: str) -> str:
    if text.text not in MACHINES:
        raise PatchError(
            f"{what}: on is {quoted(text.text)}; valid: {', '.join(MACHINES)}", text.place
        )
    return text.text


def _check_outputs(of: Definition, scope: Scope) -> None:
    """Refuse an output that a part of the sub-patch does not have."""
    tree = of.table.entries.get("outputs")
    if tree is not None:
        scope.arithmetic(tree)
