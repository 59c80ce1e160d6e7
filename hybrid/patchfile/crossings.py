"""Who reads what, and by which converter, once everything has its machine.

A reader finds what it reads on its own machine. What is on the other comes by a converter of the patch,
or by one that is made for it; a converter that has both its ends on one machine is a plain connection.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from hybrid.errors import PatchError, Place, known_as
from hybrid.expressions import (
    ExpressionError,
    Name,
    Node,
    Number,
    evaluate,
    names,
    sub_expressions,
    substituted,
)
from hybrid.fields import FullScale
from hybrid.patch import Adc, Component, Dac, Patch, Program, State, Value, literal
from hybrid.patchfile.to_components import is_cord
from hybrid.patchfile.to_program import Surroundings, edges_of, words_of

CLOCK_AT_ZERO = "t = 0"  # no name that a patch can have
# In a value at t = 0: words written out grow as the product of what they share.
MOST_TERMS = 1000
ANALOG, DIGITAL = "analog", "digital"


class Crossings:
    """One patch, with the machine of each of its signals and words."""

    def __init__(
        self,
        patch: Patch,
        program: Program,
        where: Mapping[str, str],
        full_scales: Mapping[str, FullScale],
    ) -> None:
        """full_scales: of words that have one for themselves."""
        self.patch, self.where = patch, where
        self.components = {c.name: c for c in patch.components}
        self.words = {e.word: e for e in program.written}
        self.dacs = {d.name: d for d in patch.dacs}
        self.adcs = {a.name: a for a in patch.adcs}
        self.full_scales = {d.word: scale_of(d) for d in reversed(patch.dacs)} | dict(full_scales)
        for word in program.units.keys() & self.full_scales.keys():
            unit, factor = program.units[word]
            self.full_scales[word] = replace(self.full_scales[word], unit=unit, factor=factor)
        self.full_scales |= {part.name: scale_of(part) for part in patch.analog_parts}
        self.cords = {
            word: entry.expr.id
            for word, entry in self.words.items()
            if where[word] == ANALOG and is_cord(entry, patch.parameters)
            if isinstance(entry.expr, Name)
        }
        scales = {name: scale.value for name, scale in self.full_scales.items()}
        dimensions = {name: scale.dimension for name, scale in self.full_scales.items()}
        period = program.period.expr if program.period else Number(1.0)
        self._at_zero = Surroundings("", scales, dimensions, CLOCK_AT_ZERO, period)
        self.made: dict[str, Adc | Dac] = {}
        self._used: set[str] = set()  # converters that something reads
        self._read_before = _read(patch)

    def free(self, name: str) -> str:
        """A name that nothing has."""
        taken = {*self.patch.parameters, *self.patch.signals, *self.where, *self.made}
        while name in taken:
            name += "_1"
        return name

    def is_kept(self, converter: Adc | Dac) -> bool:
        """Whether its input is on the side that it converts from."""
        if isinstance(converter, Dac):
            return self.where[converter.word] == DIGITAL
        source = converter.source
        return source in self.dacs or self.where[source] == ANALOG

    def found(self, name: str, machine: str) -> str:
        """By which name a reader on `machine` has what the patch calls `name`."""
        if name in self.dacs:
            if machine == ANALOG and self.is_kept(self.dacs[name]):
                self._used.add(name)
                return name
            return self.found(self.dacs[name].word, machine)
        if name in self.adcs:
            if machine == DIGITAL and self.is_kept(self.adcs[name]):
                self._used.add(name)
                return name
            return self.found(self.adcs[name].source, machine)
        if name in self.cords:
            return self.found(self.cords[name], machine)
        if name not in self.where or self.where[name] == machine:
            return name
        return self._converted(name)

    def _converted(self, name: str) -> str:
        """The converter of a signal or word to the other machine."""
        if self.where[name] == DIGITAL:
            fitting = [d.name for d in self.patch.dacs if d.word == name]
        else:
            fitting = [a.name for a in self.patch.adcs if self._samples(a, name)]
        if not fitting:
            end = "_held" if self.where[name] == DIGITAL else "_sample"
            fitting = [m for m, one in self.made.items() if name == _end(one)]
            if not fitting:
                fitting = [self.free(name + end)]
                self.made[fitting[0]] = self._converter(fitting[0], name)
        self._used.add(fitting[0])
        return fitting[0]

    def _samples(self, adc: Adc, name: str) -> bool:
        source = adc.source
        if source in self.dacs:
            source = self.dacs[source].word
        while source in self.cords:
            source = self.cords[source]
        return source == name

    def _converter(self, made: str, name: str) -> Adc | Dac:
        """A converter that the patch does not have, of the word length that its converters share."""
        place = self.place(name)
        lengths = {adc.bits for adc in self.patch.adcs} | {dac.bits for dac in self.patch.dacs}
        if len(lengths) > 1:
            kind = "dac" if self.where[name] == DIGITAL else "adc"
            raise PatchError(
                f"{known_as(name)!r} is on the {self.where[name]} machine and read by the other, and "
                "the patch's converters have different bits; add one to interface: "
                f"name: {{{kind}: {known_as(name)}, ...}}",
                place,
            )
        bits = next(iter(lengths), None)
        if self.where[name] == ANALOG:
            return Adc(made, name, bits, None, None, 0, place)
        scale = self.scale(name)
        initial = self.initial(name)
        return Dac(
            name=made,
            word=name,
            bits=bits,
            initial=initial or literal(0.0),
            full_scale=scale.value,
            unit=scale.unit,
            factor=scale.factor,
            dimension=scale.dimension,
            errors={},
            place=place,
            begins_unknown=initial is None,
        )

    def initial(self, name: str) -> Value | None:
        """What a DAC shows of a word before there is a result: its value at t = 0; None if not known."""
        try:
            value = Value(self._begins(name), self.place(name), f"value of {name!r} at t = 0")
            evaluate(value.expr, self.patch.bind())
        except (ExpressionError, PatchError):  # of what only a run or the analog machine can tell
            return None
        return value

    def _begins(self, name: str, above: frozenset[str] = frozenset()) -> Node:
        """The value at t = 0 over parameters; raises ExpressionError where it shows in a run only."""
        if name in above:
            raise ExpressionError(f"{name!r} depends on itself")
        above |= {name}
        if name in self.adcs:
            return self._begins(self.adcs[name].source, above)
        if name in self.dacs:
            dac = self.dacs[name]
            return dac.initial.expr if self.is_kept(dac) else self._begins(dac.word, above)
        if name not in {**self.components, **self.words}:
            return Name(name)  # a parameter
        component, entry = self.components.get(name), self.words.get(name)
        edges: Mapping[str, Node] = {}
        if component:
            if "initial" in component.values:
                return component.values["initial"].expr
            edges = {edge.word: edge.expr for edge in edges_of(component, self._at_zero)}
            entry = words_of(component, self._at_zero)
        assert entry is not None
        if isinstance(entry, State):
            return entry.initial.expr
        expr = substituted(entry.expr, edges)
        begins = {n: self._begins(n, above) for n in sorted(names(expr) - {CLOCK_AT_ZERO})}
        whole = substituted(expr, {**begins, CLOCK_AT_ZERO: Number(0.0)})
        if sum(1 for _ in sub_expressions(whole)) > MOST_TERMS:
            raise ExpressionError(f"{name!r} is too long")
        return whole

    def place(self, name: str) -> Place:
        """Where a signal or word is written."""
        return self.components[name].place if name in self.components else self.words[name].place

    def scale(self, name: str) -> FullScale:
        """The full scale that a signal or word has on the analog machine."""
        if name in self.words and self.words[name].hidden:
            raise PatchError(
                f"word {known_as(name)!r} is of a model, which has no analog form; keep what reads it "
                "on the digital machine",
                self.place(name),
            )
        if name not in self.full_scales:
            raise PatchError(
                f"word {known_as(name)!r} is read by or put on the analog machine, where it needs a "
                f"full scale; add digital: full_scales: {{{name.rpartition('.')[2]}: VALUE}}",
                self.place(name),
            )
        return self.full_scales[name]

    def root(self, name: str) -> str:
        """The signal that is shown in place of a converter or a cord that is no more."""
        if name in self.dacs and not self.remains(self.dacs[name]):
            return self.root(self.dacs[name].word)
        if name in self.adcs and not self.remains(self.adcs[name]):
            return self.root(self.adcs[name].source)
        return self.root(self.cords[name]) if name in self.cords else name

    def converters(self) -> tuple[list[Adc], list[Dac]]:
        """Those of the patch that remain, and those that are made; when all has been found."""
        adcs = [adc for adc in self.patch.adcs if self.remains(adc)]
        adcs = [replace(adc, source=self.found(adc.source, ANALOG)) for adc in adcs]
        dacs = [dac for dac in self.patch.dacs if self.remains(dac)]
        made = self.made.values()
        adcs += [one for one in made if isinstance(one, Adc)]
        return adcs, dacs + [one for one in made if isinstance(one, Dac)]

    def remains(self, converter: Adc | Dac) -> bool:
        """Whether a converter is needed still: somebody reads it, or nobody ever did."""
        return self.is_kept(converter) and (
            converter.name in self._used or converter.name not in self._read_before
        )


def _end(converter: Adc | Dac) -> str:
    return converter.source if isinstance(converter, Adc) else converter.word


def scale_of(part: Component | Dac) -> FullScale:
    """The full scale of a signal."""
    return FullScale(part.full_scale, part.unit, part.factor, part.dimension)


def _read(patch: Patch) -> Collection[str]:
    """Every name that a component, a converter, the program or the modes read."""
    found = {signal for component in patch.components for signal in component.sources}
    found |= {adc.source for adc in patch.adcs}
    for entry in patch.program.written if patch.program else ():
        for expr in entry.reads:
            found |= names(expr)
    if patch.modes:
        found |= {name for name in (patch.modes.reset_when, patch.modes.hold_when) if name}
    return found
