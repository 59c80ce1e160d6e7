"""Putting parts of a patch on the other machine: the same equations, told once, run where one likes.

What moves is translated: an analog component becomes a word or state of the program (`to_program`), a
word an analog component (`to_components`). Then everything is connected anew (`crossings`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from hybrid.components import CATALOG
from hybrid.errors import PatchError, Place, quoted
from hybrid.expressions import (
    Node,
    Number,
    names,
    next_names,
    previous_names,
    renamed,
)
from hybrid.fields import FullScale
from hybrid.modes import RESERVED_SIGNALS
from hybrid.patch import (
    Adc,
    Assignment,
    Component,
    Dac,
    ModeSettings,
    Patch,
    Program,
    State,
    Task,
    Value,
    WordSettings,
    literal,
)
from hybrid.patchfile.crossings import ANALOG, DIGITAL, Crossings
from hybrid.patchfile.homes import ONLY, Habits, Homes, settled
from hybrid.patchfile.placing import Told, placed
from hybrid.patchfile.program import computing_order
from hybrid.patchfile.to_components import component_of, joined
from hybrid.patchfile.to_program import CLOCK, Surroundings, clock_of, edges_of, words_of
from hybrid.units import PURE

_SWITCHES = frozenset({"compare", "step", "pulse", "square"})


@dataclass(frozen=True, slots=True)
class Orders:
    """What is to run where, and what the patch says for that."""

    within: Sequence[Told]  # by the patch
    outside: Sequence[Told]
    parts: Sequence[str]
    habits: Mapping[str, Habits]  # of the digital machine ("") and of each task
    homes: Mapping[str, str]  # components of parts that name a task, with it
    full_scales: Mapping[str, FullScale]  # of words


def transferred(patch: Patch, orders: Orders) -> Patch:
    """The patch with everything on the machine that is asked for.

    Raises PatchError for what cannot be there, with its line and the reason.
    """
    written = {c.name: ANALOG for c in patch.components}
    written |= {e.word: DIGITAL for e in (patch.program.written if patch.program else ())}
    where = placed(written, orders.within, orders.outside, orders.parts, patch.file)
    where = settled(patch, where, {told.name for told in (*orders.within, *orders.outside)})
    on = {told.name or "all": told.machine for told in orders.outside}
    if where == written:
        return replace(_without_idle(patch), on=on)
    return replace(_Transfer(patch, orders, where).patch_after(), on=on)


class _Transfer:
    """One patch on its way."""

    def __init__(self, patch: Patch, orders: Orders, where: Mapping[str, str]) -> None:
        self.patch, self.orders, self.where = patch, orders, where
        self.program = _program(patch, where)
        self.crossings = Crossings(patch, self.program, where, orders.full_scales)
        self.components, self.words = self.crossings.components, self.crossings.words
        self.found, self.scale = self.crossings.found, self.crossings.scale
        self.reference = self.crossings.free("reference")
        self.homes = Homes(self.program, orders.homes, patch.bind())
        self.around = {task: self._surroundings(task) for task in self.homes.tasks or (ONLY,)}

    def _surroundings(self, task: str) -> Surroundings:
        """What a component finds in a task, or in the one program."""
        clock = self.program if task == ONLY else self.homes.tasks[task]
        scales = self.crossings.full_scales
        return Surroundings(
            self.orders.habits[task].formula,
            {name: scale.value for name, scale in scales.items()},
            {name: scale.dimension for name, scale in scales.items()},
            self.crossings.free(CLOCK if task == ONLY else f"{task}_{CLOCK}"),
            clock.period.expr if clock.period else Number(1.0),
            (clock.phase if isinstance(clock, Task) else None) or literal(0.0),
        )

    def patch_after(self) -> Patch:
        """Everything translated and connected."""
        patch, crossings = self.patch, self.crossings
        components = [self._component(name) for name in self._on(ANALOG)]
        written = [self._entry(name) for name in self._on(DIGITAL)]
        modes = self._modes()
        components += self._reference(components)
        timing = self._timing(written)
        program = self._program_of([*written, *timing], [entry.word for entry in timing])
        adcs, dacs = self._converters(program)
        shown = {name: crossings.root(name) for name in patch.signals}
        return replace(
            _with_program(patch, program),
            components=tuple(sorted(components, key=lambda c: c.name)),
            adcs=tuple(sorted(adcs, key=lambda a: a.name)),
            dacs=tuple(sorted(dacs, key=lambda d: d.name)),
            record=tuple(dict.fromkeys(shown[name] for name in patch.record)),
            readouts=tuple(replace(r, signal=shown[r.signal]) for r in patch.readouts),
            modes=modes,
        )

    def _converters(self, program: Program | None) -> tuple[list[Adc], list[Dac]]:
        """Those that are left; one that names a task of which nothing is left goes by the others."""
        if program is None:
            return [], []
        left = {task.name for task in program.tasks}
        adcs, dacs = self.crossings.converters()
        return (
            [a if a.task in left else replace(a, task=None) for a in adcs],
            [d if d.transfer in left else replace(d, transfer=None) for d in dacs],
        )

    def _on(self, machine: str) -> list[str]:
        cords = self.crossings.cords
        return sorted(n for n, on in self.where.items() if on == machine and n not in cords)

    def _component(self, name: str) -> Component:
        """What is on the analog machine: as it was, or a word translated; it reads analog signals."""
        component = self.components.get(name) or component_of(
            self.words[name], self.scale, self.patch.parameters, self.reference
        )
        return self._connected(component)

    def _connected(self, c: Component) -> Component:
        terms: dict[str, list[Value]] = {}
        for signal, value in c.terms:
            terms.setdefault(self.found(signal, ANALOG), []).append(value)
        for control in c.controls:
            self._check_control(c.name, control, c.place)
        return replace(
            c,
            terms=tuple((signal, _joined(values)) for signal, values in sorted(terms.items())),
            signals=tuple(self.found(signal, ANALOG) for signal in c.signals),
            control=self._control(c.control),
            initial_signal=self._control(c.initial_signal),
            reset_when=self._control(c.reset_when),
            hold_when=self._control(c.hold_when),
        )

    def _control(self, name: str | None) -> str | None:
        return name and (name if name in RESERVED_SIGNALS else self.found(name, ANALOG))

    def _check_control(self, what: str, name: str, place: Place) -> None:
        """What switches something must be able to: a comparator, a DAC, a source that jumps."""
        found = self._control(name) or ""
        component = self.components.get(found)
        fits = (
            found in RESERVED_SIGNALS
            or found in self.crossings.dacs
            or found in self.crossings.made
        )
        if not (fits or (component and component.kind in _SWITCHES)):
            raise PatchError(
                f"{what!r} is controlled by {quoted(name)}, which on the analog machine is no "
                "comparator and no DAC; leave it on the digital machine",
                place,
            )

    def _entry(self, name: str) -> Assignment | State:
        """What is in the program: as it was, or a component translated; it reads words."""
        entry = self.words.get(name)
        if entry is None:
            if self.patch.leaves_op:
                self._refuse_modes(name)
            entry = self._translated(self.components[name])
        for expr in entry.reads:
            for other in sorted(previous_names(expr) | next_names(expr)):
                if self.where.get(other) == ANALOG:
                    raise PatchError(
                        f"word {name!r} reads previous or next of {other!r}, which is put on the analog "
                        "machine; leave that on the digital one",
                        entry.place,
                    )
        if isinstance(entry, Assignment):
            return replace(entry, expr=self._renamed(entry.expr))
        resets = {key: getattr(entry, key) for key in ("reset_when", "reset_to")}
        resets = {key: expr and self._renamed(expr) for key, expr in resets.items()}
        return replace(entry, expr=self._renamed(entry.expr), **resets)

    def _translated(self, component: Component) -> Assignment | State:
        """A component as a word of the task that it goes into."""
        task = self.homes.receive(component)
        around = self.around[task]
        entry = words_of(component, around)
        timed = any(around.clock in names(expr) for expr in entry.reads)
        if timed or isinstance(entry, State) or edges_of(component, around):
            self.homes.require_clock(component, task)
        return entry

    def _renamed(self, expr: Node) -> Node:
        return renamed(expr, {name: self.found(name, DIGITAL) for name in sorted(names(expr))})

    def _refuse_modes(self, name: str) -> None:
        component = self.components[name]
        if CATALOG[component.kind].key in ("integrate", "lag"):
            raise PatchError(
                f"component {name!r} cannot go to the digital machine: it has the analog machine's "
                "modes (modes: or on_overload: hold), and the program has none",
                component.place,
            )

    def _modes(self) -> ModeSettings | None:
        """Modes that a signal sets find it on the analog machine."""
        modes = self.patch.modes
        if modes is None:
            return None
        for name in (modes.reset_when, modes.hold_when):
            if name:
                self._check_control("modes", name, modes.place)
        return replace(
            modes,
            reset_when=self._control(modes.reset_when),
            hold_when=self._control(modes.hold_when),
        )

    def _timing(self, written: Sequence[Assignment | State]) -> list[Assignment | State]:
        """When sources are on, and in each task the state of its seconds where something reads it."""
        found: list[Assignment | State] = []
        moved = [self.components[name] for name in self._on(DIGITAL) if name in self.components]
        for task, around in self.around.items():
            own = [component for component in moved if self.homes.of(component.name) == task]
            edges = [edge for component in own for edge in edges_of(component, around)]
            readers = (*(e for e in written if self.homes.of(e.word) == task), *edges)
            if any(around.clock in names(expr) for entry in readers for expr in entry.reads):
                timing: list[Assignment | State] = [*edges, clock_of(around)]
                for made in timing:
                    self.homes.put(made.word, task)
                found += timing
        return found

    def _reference(self, components: Sequence[Component]) -> list[Component]:
        """The constant 1, where something reads it."""
        if not any(self.reference in component.sources for component in components):
            return []
        one, room = literal(1.0), literal(1.25)  # so that noise on it is no overload
        return [
            Component(self.reference, "constant", (), {"constant": one}, room, "", 1.0, PURE, {})
        ]

    def _program_of(
        self, written: Sequence[Assignment | State], exact: Sequence[str]
    ) -> Program | None:
        """The program; exact: words in double precision whatever the word length of all others is."""
        if not written:
            return None
        states = {e.word: e for e in written if isinstance(e, State)}
        assignments = {e.word: e for e in written if isinstance(e, Assignment)}
        own, words = self.program, {*states, *assignments}
        lengths = {word: length for word, length in own.lengths.items() if word in words}
        for word in words & self.components.keys():
            length = self.orders.habits[self.homes.of(word)].word
            if length and self.homes.tasks:
                lengths[word] = length
        shown = {name: self.components[name] for name in words if name in self.components}
        tasks = self._tasks(assignments, states)
        order = [word for task in tasks for word in task.words]
        remember = {word: value for word, value in own.remember.items() if word in words}
        return replace(
            own,
            period=next((t.period for t in tasks if t.period), None) if tasks else own.period,
            assignments=tuple(
                assignments[word] for word in order or computing_order(assignments, states)
            ),
            states=tuple(states[word] for word in sorted(states)),
            remember=self._first_values(tasks, {**assignments, **states}) | remember,
            lengths=lengths | dict.fromkeys(exact, WordSettings()),
            units={**own.units, **{name: (c.unit, c.factor) for name, c in shown.items()}},
            tasks=tasks,
        )

    def _tasks(
        self, assignments: Mapping[str, Assignment], states: Mapping[str, State]
    ) -> tuple[Task, ...]:
        """The tasks that anything is left of, with their words in the order in which they compute."""
        found = []
        for name, task in self.homes.tasks.items():
            words = {w: e for w, e in assignments.items() if self.homes.of(w) == name}
            own = {w: e for w, e in states.items() if self.homes.of(w) == name}
            if words or own:
                order = computing_order(words, own)
                found.append(replace(task, words=order, states=tuple(sorted(own))))
        return tuple(found)

    def _first_values(
        self, tasks: Sequence[Task], entries: Mapping[str, Assignment | State]
    ) -> dict[str, Value]:
        """What other tasks read before the first result of a word: what the DAC between them showed that
        is no more, or what the component was that it is now."""
        shown = {d.word: d.initial for d in self.patch.dacs if not self.crossings.remains(d)}
        found = {}
        for task in tasks:
            own = {*task.words, *task.states}
            reads = (expr for word in own for expr in entries[word].reads)
            for word in sorted(frozenset[str]().union(*map(names, reads)) - own):
                first = shown.get(word)
                if word in self.components:
                    first = self.crossings.initial(word)
                if first and isinstance(entries.get(word), Assignment):
                    found[word] = first
        return found


def _with_program(patch: Patch, program: Program | None) -> Patch:
    """The patch with another program or none, its rows as they were."""
    before, run = patch.program, patch.run
    if before and not run.every:
        scope = patch.bind()
        every = min(before.periods, key=lambda period: period.number(scope))
        if not (program and every in program.periods):
            run = replace(run, every=every)
    return replace(patch, program=program, run=run)


def _without_idle(patch: Patch) -> Patch:
    """The patch without the tasks, or the digital machine, on which nothing is put."""
    program = patch.program
    if program is None:
        return patch
    if not program.words:
        return _with_program(patch, None)
    tasks = tuple(task for task in program.tasks if task.words or task.states)
    if tasks == program.tasks:
        return patch
    period = next((task.period for task in tasks if task.period), None)
    return _with_program(patch, replace(program, tasks=tasks, period=period))


def _program(patch: Patch, where: Mapping[str, str]) -> Program:
    """The program; only a machine with one can take or give anything."""
    if patch.program is None:
        moved = min(name for name, machine in where.items() if machine == DIGITAL)
        place = next(c.place for c in patch.components if c.name == moved)
        raise PatchError(
            f"{moved!r} is put on the digital machine, and the patch has none; add digital: "
            "{period: TIME}",
            place,
        )
    return patch.program


def _joined(values: Sequence[Value]) -> Value:
    if len(values) == 1:
        return values[0]
    return replace(values[0], expr=joined([value.expr for value in values]))
