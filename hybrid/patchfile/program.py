"""The section `digital`: the digital machine's clock and its program, or its tasks."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace

from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.expressions import (
    ExpressionError,
    Node,
    names,
    next_names,
    previous_calls,
    previous_names,
    shown,
    to_text,
)
from hybrid.fields import Fields, FullScale, table_of, value_of
from hybrid.formulas import DEFAULT_FORMULA
from hybrid.graph import dependency_order, find_loop
from hybrid.integration import next_of
from hybrid.language import COUNTED, FULL_SCALE, PROCESSOR_KEYS, TASK_KEYS, Key
from hybrid.parsing import parse
from hybrid.patch import Assignment, ProcessorSettings, Program, State, Task, Value
from hybrid.patchfile.book import Book, Role, digital_keys, tasks_of
from hybrid.patchfile.connections import WordInputs
from hybrid.patchfile.homes import ONLY, Habits
from hybrid.patchfile.models import check_input, model_names, model_words, refuse_model_name
from hybrid.patchfile.shownunits import read_shown_units
from hybrid.patchfile.starting import read_when
from hybrid.patchfile.states import formula_of, read_states, settle_dimensions, with_dimension
from hybrid.patchfile.wordlengths import (
    read_word_length,
    read_word_lengths,
    task_word_length,
)
from hybrid.processors import PROCESSORS
from hybrid.units import PURE, Dimension
from hybrid.yamltree import Table, Text, Tree

Remembered = Mapping[str, tuple[Value, Dimension | None]]


def read_program(book: Book, inputs: WordInputs) -> Program | None:
    """The digital machine, or None where the patch has none; inputs: of parts, which are words."""
    digital = book.section("digital")
    if digital is None:
        return None
    keys = digital_keys(digital)
    fields = book.fields(digital, "digital", keys, book.root.places["digital"])
    counted, processor = _is_counted(digital), _processor(book, digital)
    if counted:
        _require_processor(processor, "digital", fields)
    given = [key for key in keys if not (counted and key.name == "compute_time")]
    values = fields.quantities(given)
    tables = [(f"task {name!r}", task) for name, task, _ in tasks_of(digital)]
    tables = tables or [("digital", digital)]
    readable = frozenset(book.named(Role.PARAMETER, Role.ADC, Role.WORD)) | model_names(book)
    integrated = [read_states(book, digital, table, what, readable) for what, table in tables]
    programs = _programs(book, [table for _, table in tables], integrated, readable)
    _check_own(programs, integrated)
    written = {word: found for program in programs for word, found in program.items()}
    states = {word: state for own in integrated for word, state in own.items()}
    orders = [computing_order(*both) for both in zip(programs, integrated, strict=True)]
    order = tuple(word for words in orders for word in words)
    remember = _remember(book, digital, written, states)
    in_order = {word: written[word] for word in order}
    dimensions = _word_dimensions(book, inputs, in_order, states, remember, len(programs))
    tasks = _tasks(book, digital, orders, integrated, processor)
    computed = [frozenset((*own, *p)) for own, p in zip(integrated, programs, strict=True)]
    all_words = frozenset((*written, *states))
    return Program(
        next((t.period for t in tasks if t.period), None) if tasks else values["period"],
        values.get("compute_time"),
        values.get("skew"),
        tuple(replace(written[word], dimension=dimensions[word]) for word in order),
        {word: value for word, (value, _) in remember.items()},
        digital.place,
        tuple(with_dimension(state, dimensions) for state in states.values()),
        read_word_length(book, digital),
        read_word_lengths(book, digital, dimensions, computed),
        tasks,
        not _chosen(fields, keys, "scheduling"),
        processor,
        counted,
        read_shown_units(digital, dimensions, all_words),
    )


def usual_habits(book: Book) -> dict[str, Habits]:
    """Formula and word length of what says nothing else: of the machine (""), and of each task."""
    digital = book.section("digital")
    if digital is None:
        return {ONLY: Habits(DEFAULT_FORMULA)}
    usual = formula_of(digital, "integration", "digital", DEFAULT_FORMULA)
    found = {ONLY: Habits(usual)}
    for name, table, _ in tasks_of(digital):
        what = f"task {name!r}"
        formula = formula_of(table, "integration", what, usual)
        found[name] = Habits(formula, task_word_length(book, name, table))
    return found


def read_full_scales(book: Book, program: Program | None) -> dict[str, FullScale]:
    """Full scales that words have for when they are put on the analog machine."""
    digital = book.section("digital")
    tree = digital.entries.get("full_scales") if digital else None
    if tree is None:
        return {}
    words, found = set(program.words if program else ()), {}
    for word, item, place in table_of(tree, "full_scales", "word: full scale"):
        if word not in words:
            hint = did_you_mean(word, words)
            raise PatchError(f"full_scales: no word or state {quoted(word)}; {hint}", place)
        table = Table({"full_scale": item}, {"full_scale": place}, place)
        found[word] = book.fields(table, f"word {word!r}", (FULL_SCALE,), place).full_scale()
    return found


def _is_counted(table: Table) -> bool:
    """Whether the compute time is to be counted from the operations."""
    tree = table.entries.get("compute_time")
    return isinstance(tree, Text) and tree.text == COUNTED


def _require_processor(processor: ProcessorSettings | None, what: str, fields: Fields) -> None:
    if processor is None:
        raise PatchError(
            f"{what}: compute_time is counted, which needs operation times; add processor: with one of "
            f"{', '.join(PROCESSORS)}, or times of your own, in digital:",
            fields.place("compute_time"),
        )


def _processor(book: Book, digital: Table) -> ProcessorSettings | None:
    """Whose operation times are counted."""
    tree = digital.entries.get("processor")
    if tree is None:
        return None
    if isinstance(tree, Text):
        if tree.text not in PROCESSORS:
            hint = did_you_mean(tree.text, PROCESSORS)
            raise PatchError(f"unknown processor {quoted(tree.text)}; {hint}", tree.place)
        return ProcessorSettings(tree.text, {}, tree.place)
    place = digital.places["processor"]
    table = table_of(tree, "processor", "a name, or operation: time")
    fields = book.fields(table, "processor", PROCESSOR_KEYS, place)
    return ProcessorSettings("", fields.quantities(PROCESSOR_KEYS), place)


def _programs(
    book: Book,
    tables: Sequence[Table],
    integrated: Sequence[Mapping[str, State]],
    readable: frozenset[str],
) -> list[dict[str, Assignment]]:
    """The assignments of each program, by word; what several read of a model the first computes.

    integrated: the states of each.
    """
    programs: list[dict[str, Assignment]] = []
    known = set[str]()
    every = {word: state for states in integrated for word, state in states.items()}
    for table, states in zip(tables, integrated, strict=True):
        tree = table.entries.get("program")
        entries = table_of(tree, "program", "word: arithmetic") if tree else ()
        program = {word: _assignment(book, word, tree, readable) for word, tree, _ in entries}
        reading: tuple[Assignment | State, ...] = (*program.values(), *states.values())
        read = frozenset[str]().union(*(names(expr) for entry in reading for expr in entry.reads))
        for entry in reading:
            for expr in entry.reads:
                _check_reads(book, entry, expr, readable, every)
        found = model_words(book, read, readable)
        program |= {word: entry for word, entry in found.items() if word not in known}
        known |= program.keys()
        programs.append(program)
    return programs


def _not_among(read: Iterable[frozenset[str]], *known: Container[str]) -> list[str]:
    """Names that are in none of what is known, sorted."""
    return sorted({n for some in read for n in some if not any(n in known_ for known_ in known)})


def _check_own(
    programs: Sequence[Mapping[str, Assignment]], integrated: Sequence[Mapping[str, State]]
) -> None:
    """previous() and next() are of the cycles of one task; of another only the last result is known."""
    for program, states in zip(programs, integrated, strict=True):
        entries: list[Assignment | State] = [*program.values(), *states.values()]
        for entry in entries:
            word = entry.word
            what = f"{'state' if word in states else 'word'} {word!r}"
            read = [previous_names(expr) for expr in entry.reads]
            for name in _not_among(read, program, states):
                raise PatchError(
                    f"{what} reads previous({name}) of another task; read {name}, which is that "
                    f"task's last result, or the previous() of a word {word}_copy: {name} of its own",
                    entry.place,
                )
            read = [next_names(expr) for expr in entry.reads]
            for name in _not_among(read, states):
                raise PatchError(
                    f"{what} reads next({name}) of another task; read {name}, which is that task's "
                    f"last result, or a word {name}_next: next({name}) of that task",
                    entry.place,
                )


def _tasks(
    book: Book,
    digital: Table,
    orders: Sequence[tuple[str, ...]],
    integrated: Sequence[Mapping[str, State]],
    processor: ProcessorSettings | None,
) -> tuple[Task, ...]:
    """The tasks by name, or none where there is one program."""
    found = []
    for (name, table, place), words, states in zip(
        tasks_of(digital), orders, integrated, strict=False
    ):
        fields = book.fields(table, f"task {name!r}", TASK_KEYS, place)
        counted = _is_counted(table)
        if counted:
            _require_processor(processor, f"task {name!r}", fields)
        values = fields.quantities(
            [key for key in TASK_KEYS if not (counted and key.name == "compute_time")]
        )
        given = "priority" in table.entries
        overruns = next(key for key in TASK_KEYS if key.name == "overrun").choices
        found.append(
            Task(
                name,
                values.get("period"),
                values.get("phase"),
                fields.integer("priority", 0) if given else None,
                values.get("compute_time"),
                overruns[_chosen(fields, TASK_KEYS, "overrun")],
                words,
                place,
                values.get("jitter"),
                tuple(states),
                read_when(book, fields, frozenset(states)),
            )
        )
    if len({task.priority is None for task in found}) > 1:
        first = next(task for task in found if task.priority is None)
        raise PatchError(
            f"task {first.name!r} has no priority; give all tasks one, or none (then the shorter the "
            "period, the higher)",
            first.place,
        )
    return tuple(found)


def _chosen(fields: Fields, keys: Sequence[Key], name: str) -> int:
    """Which of a key's choices is given; the first where none is."""
    value = fields.wholes([key for key in keys if key.name == name]).get(name)
    return int(value.number({})) if value else 0


def _assignment(book: Book, word: str, tree: Tree, readable: frozenset[str]) -> Assignment:
    what = f"word {word!r}"
    if not isinstance(tree, Text) or not tree.text:
        raise PatchError(f"{what} needs arithmetic, such as 2 * angle_sample", tree.place)
    try:
        expr = parse(tree.text, readable, allow_previous=True, tables=book.tables)
    except ExpressionError as error:
        raise PatchError(f"{what}: {error}", tree.place) from None
    return Assignment(word, expr, tree.place)


def _check_reads(
    book: Book,
    entry: Assignment | State,
    expr: Node,
    readable: frozenset[str],
    states: Mapping[str, State],
) -> None:
    """Refuse names that the program cannot read, or not at that time."""
    what, place = f"{'state' if entry.word in states else 'word'} {entry.word!r}", entry.place
    for name in sorted((names(expr) | previous_names(expr) | next_names(expr)) - readable):
        _refuse(book, what, name, place)
    for call in previous_calls(expr):
        for name in sorted(names(call) - set(book.named(Role.PARAMETER))):
            raise PatchError(
                f"{what} reads {shown(to_text(call))}, but how many cycles ago cannot depend on "
                f"{name!r}; give a whole number, or arithmetic over parameters",
                place,
            )
    for name in sorted(previous_names(expr)):
        if book.roles.get(name) is not Role.WORD:
            raise PatchError(
                f"{what} reads previous({name}), but {name!r} is no word of the program; add "
                f"the word {name}_copy: {name} and read previous({name}_copy)",
                place,
            )
    for name in sorted(next_names(expr) - states.keys()):
        hint = did_you_mean(name, states)
        raise PatchError(f"{what} reads next({name}), but {name!r} is no state; {hint}", place)


def _refuse(book: Book, what: str, name: str, place: Place) -> None:
    """The program reads a name that it cannot read."""
    refuse_model_name(book, what, name, place)
    if name in book.tables:
        axes = ", ".join(axis.name for axis in book.tables[name].axes)
        raise PatchError(f"{what}: {name!r} is a table; write {name}({axes})", place)
    if name in book.roles:
        raise PatchError(
            f"{what} reads the analog signal {name!r}; the program reads it through an adc in the "
            "interface",
            place,
        )
    hint = did_you_mean(name, book.named(Role.PARAMETER, Role.ADC, Role.WORD))
    raise PatchError(f"{what} reads unknown {quoted(name)}; {hint}", place)


# Stands for the step of all states, which needs all their rates.
STEP = "the step"


def computing_order(
    written: Mapping[str, Assignment], states: Mapping[str, State]
) -> tuple[str, ...]:
    """Words so that each is computed after those it reads, and after the step where it reads next()."""
    needs = {word: _needs(assignment, written) for word, assignment in written.items()}
    needs[STEP] = sorted({name for s in states.values() for name in names(s.expr) & written.keys()})
    for name, state in states.items():
        resets = [_needs(replace(state, expr=expr), written) for expr in state.reads[1:]]
        needs[next_of(name)] = [STEP, *sorted(set[str]().union(*resets))]
    loop = find_loop(needs)
    if not loop:
        return tuple(word for word in dependency_order(needs) if word in written)
    shown_ = [name for name in loop if name != STEP]
    first = next((name for name in shown_ if name in written), shown_[0])
    at = shown_.index(first)
    path = " -> ".join((*shown_[at:], *shown_[:at], first))
    stepped = [name for name in states if next_of(name) in loop]
    advice = f"read last cycle's value with previous({first})"
    if stepped:
        advice = f"read {stepped[0]}, or previous({first}), in place of {next_of(stepped[0])}"
    place = written[first].place if first in written else states[stepped[0]].place
    raise PatchError(f"circular program: {path}; {advice}", place)


def _needs(entry: Assignment | State, written: Mapping[str, Assignment]) -> list[str]:
    """What must be computed before."""
    read = names(entry.expr) & written.keys()
    return sorted(read | {next_of(name) for name in next_names(entry.expr)})


def _remember(
    book: Book, digital: Table, written: Mapping[str, Assignment], states: Mapping[str, State]
) -> Remembered:
    """First values of the words that are read with previous(); a state has its initial value."""
    tree = digital.entries.get("remember")
    table = table_of(tree, "remember", "word: first value") if tree else None
    found = {}
    for word, item, place in table or ():
        if word in states:
            raise PatchError(f"remember: {word!r} is a state, which has its initial value", place)
        if word not in written:
            hint = did_you_mean(word, written)
            raise PatchError(f"remember: no word {quoted(word)} in the program; {hint}", place)
        found[word] = value_of(item, f"first value of {word!r}", book.scope)
    entries: tuple[Assignment | State, ...] = (*written.values(), *states.values())
    for entry in entries:
        read = frozenset[str]().union(*(previous_names(expr) for expr in entry.reads))
        for name in sorted(read - found.keys() - states.keys()):
            raise PatchError(
                f"word {entry.word!r} reads previous({name}); give its first value in "
                f"digital: remember: {{{name}: 0}}",
                entry.place,
            )
    return found


def _word_dimensions(
    book: Book,
    inputs: WordInputs,
    written: Mapping[str, Assignment],
    states: Mapping[str, State],
    remember: Remembered,
    programs: int,
) -> dict[str, Dimension | None]:
    """Dimension of every word; written: in the order in which each program computes them."""
    scope: dict[str, Dimension | None] = dict(book.scope)
    scope |= {name: book.scales[name].dimension for name in book.named(Role.ADC)}
    scope |= dict.fromkeys(written)
    scope |= {name: state.dimension for name, state in states.items()}
    for word, (_, dimension) in remember.items():
        # A bare first value says nothing about the unit.
        scope[word] = None if dimension is None or dimension.is_pure else dimension

    def fitted(entry: Assignment, found: Dimension | None) -> Dimension | None:
        check_input(book, entry.word, found)
        return inputs.dimension(entry, found)

    settle_dimensions(written, states, scope, fitted, programs)
    for word, (_, stated) in remember.items():
        if stated and not stated.is_pure and scope[word] not in (None, PURE, stated):
            raise PatchError(
                f"word {word!r} is in {scope[word]}, but its first value under remember: is in "
                f"{stated}; they must agree",
                written[word].place,
            )
    return scope
