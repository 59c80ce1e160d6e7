"""Which task computes what is put on the digital machine, and what stays where comparators start tasks.

The analog machine integrates all at once, so what leaves it goes together into one task: the first on
the processor of those that have a clock, unless the part that it is in names another. A comparator that
starts a task is the digital machine's interrupt, and a word of such a task changes only when it comes:
neither has a meaning on the other machine.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from hybrid.errors import PatchError, quoted
from hybrid.patch import Component, Patch, Program, Task, WordSettings
from hybrid.patchfile.crossings import ANALOG, DIGITAL

ONLY = ""  # stands for the one program, where there are no tasks


@dataclass(frozen=True, slots=True)
class Habits:
    """What a task, or the one program, does with words that say nothing else."""

    formula: str  # of states
    word: WordSettings | None = None  # None: that of the digital machine


def settled(patch: Patch, where: Mapping[str, str], named: Collection[str]) -> dict[str, str]:
    """The machine of every name, interrupts and what waits for them left where they are.

    named: what is told by its own name, and so is refused in place of left.
    """
    found, program = dict(where), patch.program
    for task in program.tasks if program else ():
        if task.when is None:
            continue
        comparator, edge = task.when
        if found[comparator] == DIGITAL and comparator in named:
            raise PatchError(
                f"{comparator!r} cannot go to the digital machine: it is the interrupt that starts task "
                f"{task.name!r}; leave it on the analog one",
                next(c.place for c in patch.components if c.name == comparator),
            )
        found[comparator] = ANALOG
        for entry in program.written if program else ():
            if entry.word not in task.words:
                continue
            if found[entry.word] == ANALOG and entry.word in named:
                raise PatchError(
                    f"word {entry.word!r} cannot go to the analog machine: task {task.name!r} computes "
                    f"it when {comparator!r} {edge}; write a track-store, or leave it where it is",
                    entry.place,
                )
            found[entry.word] = DIGITAL
    return found


class Homes:
    """The task of every word, those that components become too."""

    def __init__(
        self, program: Program, told: Mapping[str, str], scope: Mapping[str, float]
    ) -> None:
        """told: tasks by the names of components whose part names one; scope: the parameters."""
        self.tasks = {task.name: task for task in program.tasks}
        self._of = {w: t.name for t in program.tasks for w in (*t.words, *t.states)}
        self._told = told
        clocked = [task for task in program.tasks if task.period]
        self._first = min(clocked, key=lambda task: _place(task, scope)).name if clocked else None

    def of(self, name: str) -> str:
        """The task of a word."""
        return self._of.get(name, ONLY)

    def put(self, name: str, task: str) -> None:
        """Another word of a task."""
        self._of[name] = task

    def receive(self, component: Component) -> str:
        """The task into which a component goes."""
        if not self.tasks:
            return ONLY
        task = self._told.get(component.name, self._first)
        if task is None:
            raise PatchError(
                f"{component.name!r} is put on the digital machine, where comparators start all tasks; "
                "add a task with a period for it",
                component.place,
            )
        self.put(component.name, task)
        return task

    def require_clock(self, component: Component, task: str) -> None:
        """Refuse what needs a period in a task that has none."""
        if task != ONLY and self.tasks[task].period is None:
            raise PatchError(
                f"component {component.name!r} ({component.kind}) cannot go to task {quoted(task)}: it "
                "needs a period, and a comparator starts that; give its part another task",
                component.place,
            )


def _place(task: Task, scope: Mapping[str, float]) -> tuple[float, str]:
    """What goes first on the processor has the least, see `tasks.ranks_of`."""
    assert task.period is not None
    first = task.period.number(scope) if task.priority is None else -task.priority
    return first, task.name
