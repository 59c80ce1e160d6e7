"""The times of tasks as parameters that need not be declared: `TASK.period` and so on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hybrid.errors import PatchError
from hybrid.expressions import Name
from hybrid.patch import TASK_TIMES, Parameter, Program, Task
from hybrid.patchfile.book import Book, tasks_of
from hybrid.patchfile.parameters import unit_as_written
from hybrid.units import TIME
from hybrid.yamltree import Table, Text


def with_task_times(
    book: Book, parameters: Mapping[str, Parameter], program: Program | None
) -> tuple[dict[str, Parameter], Program | None]:
    """The parameters with those of the tasks, and the program that reads its times from them.

    A time that a task does not say (a phase, what is counted) is none of them. Raises PatchError where a
    part of the task's name has a parameter of that name.
    """
    found, digital = dict(parameters), book.section("digital")
    if program is None or digital is None or not program.tasks:
        return found, program
    tables = {name: table for name, table, _ in tasks_of(digital)}
    tasks = tuple(_named(task, tables[task.name], found) for task in program.tasks)
    period = next((task.period for task in tasks if task.period), None)
    return found, replace(program, tasks=tasks, period=period)


def _named(task: Task, table: Table, parameters: dict[str, Parameter]) -> Task:
    """The task that reads its times from parameters, which are added to those there are."""
    for key in TASK_TIMES:
        value, tree = getattr(task, key), table.entries.get(key)
        if value is None or not isinstance(tree, Text):
            continue
        name = f"{task.name}.{key}"
        if name in parameters:
            raise PatchError(
                f"task {task.name!r} has the name of a part with a parameter {key}, and --set {name} "
                "would be either; rename one of them",
                task.place,
            )
        unit, factor = unit_as_written(tree.text, TIME, parameters)
        parameters[name] = Parameter(name, value, unit, factor, TIME, task.name)
        task = replace(task, **{key: replace(value, expr=Name(name))})
    return task
