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
    names,
    next_names,
    previous_names,
    renamed,
)
from hybrid.fields import FullScale
from hybrid.modes import RESERVED_SIGNALS
from hybrid.patch import (
    Assignment,
    Component,
    ModeSettings,
    Patch,
    Program,
    State,
    Value,
    WordSettings,
    literal,
)
from hybrid.patchfile.crossings import ANALOG, DIGITAL, Crossings
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
    formula: str  # of states that integrators become
    full_scales: Mapping[str, FullScale]  # of words


def transferred(patch: Patch, orders: Orders) -> Patch:
    """The patch with everything on the machine that is asked for.

    Raises PatchError for what cannot be there, with its line and the reason.
    """
    written = {c.name: ANALOG for c in patch.components}
    written |= {e.word: DIGITAL for e in (patch.program.written if patch.program else ())}
    where = placed(written, orders.within, orders.outside, orders.parts, patch.file)
    on = {told.name or "all": told.machine for told in orders.outside}
    if where == written:
        idle = patch.program and not patch.program.words  # a machine on which nothing is put
        return replace(_without_program(patch) if idle else patch, on=on)
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
        assert self.program.period is not None  # only tasks may have none
        scales = self.crossings.full_scales
        self.around = Surroundings(
            orders.formula,
            {name: scale.value for name, scale in scales.items()},
            {name: scale.dimension for name, scale in scales.items()},
            self.crossings.free(CLOCK),
            self.program.period.expr,
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
        adcs, dacs = crossings.converters() if program else ([], [])
        shown = {name: crossings.root(name) for name in patch.signals}
        return replace(
            patch if program else _without_program(patch),
            components=tuple(sorted(components, key=lambda c: c.name)),
            adcs=tuple(sorted(adcs, key=lambda a: a.name)),
            dacs=tuple(sorted(dacs, key=lambda d: d.name)),
            program=program,
            record=tuple(dict.fromkeys(shown[name] for name in patch.record)),
            readouts=tuple(replace(r, signal=shown[r.signal]) for r in patch.readouts),
            modes=modes,
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
            entry = words_of(self.components[name], self.around)
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
        """When sources are on, and the state that counts the seconds where something reads it."""
        moved = [self.components[name] for name in self._on(DIGITAL) if name in self.components]
        edges = [edge for component in moved for edge in edges_of(component, self.around)]
        read = (expr for entry in (*written, *edges) for expr in entry.reads)
        if not any(self.around.clock in names(expr) for expr in read):
            return []
        return [*edges, clock_of(self.around)]

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
        own = self.program
        words = {*states, *assignments}
        lengths = {word: length for word, length in own.lengths.items() if word in words}
        shown = {name: self.components[name] for name in words if name in self.components}
        return replace(
            own,
            assignments=tuple(assignments[word] for word in computing_order(assignments, states)),
            states=tuple(states[word] for word in sorted(states)),
            remember={word: value for word, value in own.remember.items() if word in words},
            lengths=lengths | dict.fromkeys(exact, WordSettings()),
            units={**own.units, **{name: (c.unit, c.factor) for name, c in shown.items()}},
        )


def _without_program(patch: Patch) -> Patch:
    """The patch without a digital machine, its rows as they were."""
    assert patch.program is not None
    every = patch.run.every or patch.program.period
    return replace(patch, program=None, run=replace(patch.run, every=every))


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
    if patch.program.tasks:
        raise PatchError(
            "nothing can be put on another machine where the digital one has tasks, as it "
            "would belong to none; leave out on",
            patch.program.place,
        )
    return patch.program


def _joined(values: Sequence[Value]) -> Value:
    if len(values) == 1:
        return values[0]
    return replace(values[0], expr=joined([value.expr for value in values]))
