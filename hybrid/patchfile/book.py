"""What is known of a patch while it is read: every name with its role, and the dimensions found."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from enum import Enum
from typing import TYPE_CHECKING

from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.fields import Fields, FullScale, check_name, one_kind, only_keys, table_of
from hybrid.language import (
    ADC_KEYS,
    DAC_KEYS,
    DIGITAL_KEYS,
    ERROR_KEYS,
    ONE_PROGRAM_KEYS,
    TASK_KEYS,
    Key,
)
from hybrid.modes import LOGIC
from hybrid.patchfile.files import Files
from hybrid.tables import Table as LookUpTable
from hybrid.units import Dimension
from hybrid.yamltree import Table

if TYPE_CHECKING:
    from hybrid.patchfile.models import ModelUse

# More than any patch has; a file of more would take minutes to compile and gigabytes to run.
MOST_ENTRIES = {
    "parameters": 5000,
    "tables": 1000,
    "models": 1000,
    "analog": 1000,
    "interface": 1000,
    "program": 5000,
    "states": 1000,
    "tasks": 100,
    "readouts": 1000,
}


class Role(Enum):
    """What a name stands for."""

    PARAMETER = "parameter"
    TABLE = "table"
    MODEL = "model"
    COMPONENT = "analog signal"
    DAC = "DAC"
    ADC = "ADC"
    WORD = "program word"


# How a name of each other role gets onto the analog side.
_WAY_TO_ANALOG = {
    Role.PARAMETER: "a parameter becomes a signal through constant:",
    Role.TABLE: "the program asks it, and its word enters through a dac in the interface",
    Role.MODEL: "the program reads it, and its word enters through a dac in the interface",
    Role.ADC: "what an ADC reads stays in the program; take the signal that it samples",
    Role.WORD: "a word enters the analog side through a dac in the interface",
}


class Book:
    """The names of a patch, each defined once, and what the sections read so far have added."""

    def __init__(self, root: Table, may_lack_words: bool = False) -> None:
        """Take down every name that `root` defines, in the order written.

        may_lack_words: whether a digital machine may be without any; something may be put on it.
        """
        self.root, self._may_lack_words = root, may_lack_words
        self.files = Files()
        self.models: dict[str, ModelUse] = {}
        self.tables: dict[str, LookUpTable] = {}
        self.roles: dict[str, Role] = {}
        self.places: dict[str, Place] = {}
        self.scope: dict[str, Dimension | None] = {}  # parameters, for arithmetic
        self.units: dict[str, str] = {}  # in which the parameters are written
        self.scales: dict[str, FullScale] = {}  # of analog signals, DACs and ADCs
        self.tasks: tuple[str, ...] = ()
        for section in root.entries:
            if section in ("parameters", "tables", "models", "analog", "interface"):
                self._take_section(section)
            elif section == "digital":
                self._take_words()
        converters = self.named(Role.ADC, Role.DAC)
        if converters and "digital" not in root.entries:
            first = min((self.places[name] for name in converters), key=lambda place: place.line)
            raise PatchError("converters need a digital machine; add digital:", first)

    def section(self, name: str) -> Table | None:
        """A section that is a mapping, or None where it is absent."""
        tree = self.root.entries.get(name)
        return None if tree is None else _limited(table_of(tree, name, "name: value"), name)

    def fields(self, table: Table, what: str, keys: Iterable[Key], place: Place) -> Fields:
        """Reader for the mapping of the name at `place`, whose numbers may use the parameters."""
        return Fields(table, what, keys, self.scope, place, self.places, self.units)

    def named(self, *roles: Role) -> tuple[str, ...]:
        """Names of these roles, sorted."""
        return tuple(sorted(name for name, role in self.roles.items() if role in roles))

    @functools.cached_property
    def controls(self) -> frozenset[str]:
        """What can switch a component: comparators, sources that jump, and DACs."""
        kinds = {"compare", "step", "pulse", "square"}
        analog = self.section("analog") or ()
        found = (n for n, t, _ in analog if isinstance(t, Table) and kinds & t.entries.keys())
        return frozenset((*found, *self.named(Role.DAC)))

    def control(self, fields: Fields, key: str, doing: str, modes: bool = True) -> str | None:
        """The signal that switches something, or the machine's mode; None where `key` is not given.

        doing: begins the message, "component 'x' is controlled by"; modes: whether the mode may.
        """
        if key not in fields.table.entries:
            return None
        name, place = fields.text(key), fields.place(key)
        if name in LOGIC and name not in self.roles:
            if modes and "modes" in self.root.entries:
                return name
            reason = "which the machine's mode gives; " + (
                "the patch has no modes:" if modes else "it cannot set itself"
            )
            raise PatchError(f"{doing} {name!r}, {reason}", place)
        self.require_analog(name, doing, place)
        if name not in self.controls:
            raise PatchError(
                f"{doing} {quoted(name)}; a control is a comparator, a DAC, or a step, pulse or square "
                + (
                    "source, or operating, resetting or holding of a patch with modes:"
                    if modes
                    else "source"
                ),
                place,
            )
        return name

    @property
    def has_clock(self) -> bool:
        """Whether there is a cycle time, which the record may follow."""
        digital = self.root.entries.get("digital")
        if not isinstance(digital, Table):
            return False
        tasks = [task for _, task, _ in tasks_of(digital)]
        return any("period" in task.entries for task in tasks) if tasks else True

    @property
    def signals(self) -> frozenset[str]:
        """All that can be recorded."""
        kept = self.named(Role.PARAMETER, Role.TABLE, Role.MODEL)
        return frozenset(self.roles) - frozenset(kept)

    def require_analog(self, name: str, doing: str, place: Place) -> None:
        """Refuse a cord from anything but an analog signal; `doing` begins the message."""
        role = self.roles.get(name)
        if role in (Role.COMPONENT, Role.DAC):
            return
        if role:
            raise PatchError(f"{doing} the {role.value} {name!r}; {_WAY_TO_ANALOG[role]}", place)
        hint = did_you_mean(name, self.named(Role.COMPONENT, Role.DAC))
        raise PatchError(f"{doing} unknown signal {quoted(name)}; {hint}", place)

    def _take_section(self, section: str) -> None:
        for name, tree, place in self.section(section) or ():
            if section == "interface":
                table = table_of(tree, f"converter {quoted(name)}")
                role = _converter_role(name, table, place)
            else:
                roles = {"parameters": Role.PARAMETER, "tables": Role.TABLE, "models": Role.MODEL}
                role = roles.get(section, Role.COMPONENT)
            self._take(name, role, place)

    def _take_words(self) -> None:
        digital = table_of(self.root.entries["digital"], "digital")
        only_keys(digital, digital_keys(digital), "digital", self.root.places["digital"])
        tasks = tasks_of(digital)
        self.tasks = tuple(name for name, _, _ in tasks)
        if not (tasks or self._may_lack_words or {"program", "states"} & digital.entries.keys()):
            raise PatchError(
                "digital has no program; add program: (assignments, word: arithmetic) or states:",
                self.root.places["digital"],
            )
        for name, task, place in tasks:
            if not (self._may_lack_words or {"program", "states"} & task.entries.keys()):
                raise PatchError(
                    f"task {name!r} has no program; add program: (assignments, word: arithmetic) or "
                    "states:",
                    place,
                )
        for within in [task for _, task, _ in tasks] or [digital]:
            self._take_program(within)

    def _take_program(self, within: Table) -> None:
        """The words of one program, and its states."""
        for section in within.entries:
            if section not in ("program", "states"):
                continue
            table = table_of(within.entries[section], section, "word: arithmetic")
            if not table.entries:
                message = f"the {section} has no words; give word: arithmetic"
                if section == "states":
                    message = "states is empty; give state: {integrate: rate, initial: value}"
                raise PatchError(message, table.place)
            for name, _, place in _limited(table, section):
                self._take(name, Role.WORD, place)

    def _take(self, name: str, role: Role, place: Place) -> None:
        what = "signal" if role is Role.COMPONENT else role.value
        for word in name.split("."):
            check_name(word, place, what)
        if name in self.roles:
            first = f"the {self.roles[name].value} in line {self.places[name].line}"
            raise PatchError(f"{name!r} is defined twice, first as {first}; rename one", place)
        self.roles[name], self.places[name] = role, place


def digital_keys(digital: Table) -> tuple[Key, ...]:
    """The keys of the digital machine: with tasks, each has a period and a program of its own."""
    if "tasks" not in digital.entries:
        if "scheduling" in digital.entries:
            place = digital.places["scheduling"]
            raise PatchError("scheduling is of tasks; digital has no tasks", place)
        return DIGITAL_KEYS
    for key in ONE_PROGRAM_KEYS:
        if key in digital.entries:
            raise PatchError(
                f"digital has both tasks and {key}; give each task "
                + ("the states that it integrates" if key == "states" else f"a {key} of its own"),
                digital.places[key],
            )
    return tuple(key for key in DIGITAL_KEYS if key.name not in ONE_PROGRAM_KEYS)


def tasks_of(digital: Table) -> list[tuple[str, Table, Place]]:
    """The tasks by name, each with the keys that it must have; none where there is one program."""
    if "tasks" not in digital.entries:
        return []
    section = table_of(digital.entries["tasks"], "tasks", "name: task")
    if not section.entries:
        raise PatchError(
            "tasks has no task; give name: {period, compute_time, program}", section.place
        )
    found = []
    for name, tree, place in sorted(_limited(section, "tasks"), key=lambda entry: entry[0]):
        check_name(name, place, "task")
        table = table_of(tree, f"task {quoted(name)}")
        only_keys(table, TASK_KEYS, f"task {name!r}", place)
        found.append((name, table, place))
    return found


def _limited(table: Table, section: str) -> Table:
    most = MOST_ENTRIES.get(section)
    if most is not None and len(table.entries) > most:
        raise PatchError(
            f"{section} has {len(table.entries)} entries; at most {most} are allowed", table.place
        )
    return table


def _converter_role(name: str, table: Table, place: Place) -> Role:
    beside = {key.name for key in (*ADC_KEYS, *DAC_KEYS, *ERROR_KEYS)} - {"adc", "dac"}
    kind = one_kind(table, ("adc", "dac"), beside, f"converter {quoted(name)}", place)
    return Role.ADC if kind == "adc" else Role.DAC
