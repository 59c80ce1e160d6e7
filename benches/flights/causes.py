"""What a flight's errors come of: each cause is switched off by itself, and the flights are compared.

A change of the flight is what the cause does to it. All but the noise are switched off on a machine without
noise: another T or compute time would draw another noise. The formula and the word length cannot be switched
off, so they are made worse instead, by one order and by three bits: what they do as they are is less, by
far or to an eighth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from flights.flying import Given
from hybrid.patch import Component, Dac, Patch, WordSettings, literal
from hybrid.wordlength import MOST_BITS, Kind

Part = TypeVar("Part", Component, Dac)
Changed = Callable[[Patch], Patch]
IDEAL = "everything: ideal machine, a quarter of T, no compute time"


@dataclass(frozen=True)
class Cause:
    """One cause: how a patch is changed to be without it, and what is set for that."""

    name: str
    change: Changed = lambda patch: patch
    settings: Callable[[Mapping[str, float]], Given] = lambda usual: {}
    machine: str | None = None
    group: str = ""  # it is part of the cause of that name
    quiet: bool = True  # the machine it is switched off on has no noise


def parts_without(figures: Mapping[str, float], prefix: str = "") -> Changed:
    """The patch with figures of all components and DACs, or of those whose name begins so."""
    own = {key: literal(value) for key, value in figures.items()}

    def changed(patch: Patch) -> Patch:
        def of(part: Part) -> Part:
            chosen = part.name == prefix or part.name.startswith(f"{prefix}." if prefix else "")
            return replace(part, errors={**part.errors, **own}) if chosen else part

        components, dacs = (tuple(map(of, parts)) for parts in (patch.components, patch.dacs))
        return replace(patch, components=components, dacs=dacs)

    return changed


without_noise = parts_without({"noise": 0.0})


def exact_converters(name: str = "") -> Changed:
    """The patch with exact converters, or with one of them exact."""

    def changed(patch: Patch) -> Patch:
        adcs, dacs = (
            tuple(replace(c, bits=None) if name in ("", c.name) else c for c in converters)
            for converters in (patch.adcs, patch.dacs)
        )
        return replace(patch, adcs=adcs, dacs=dacs)

    return changed


def other_formula(formula: str) -> Changed:
    """The patch with another formula of integration."""

    def changed(patch: Patch) -> Patch:
        assert patch.program is not None
        states = tuple(replace(state, formula=formula) for state in patch.program.states)
        return replace(patch, program=replace(patch.program, states=states))

    return changed


def shorter_words(patch: Patch) -> Patch:
    """The patch with words of three significant bits fewer."""
    assert patch.program is not None
    return replace(patch, program=replace(patch.program, word=WordSettings(Kind.BITS, MOST_BITS)))


def _set(**scaled: float) -> Callable[[Mapping[str, float]], Given]:
    return lambda usual: {name: usual[name] * scale for name, scale in scaled.items()}


FORMULA = Cause("formula (third order)", other_formula("rk3"))
WORDS = Cause("word length (50 bits)", shorter_words)


def causes_of(patch: Patch, hybrid_machine: bool) -> Iterator[Cause]:
    """Every cause of a patch's errors, with its parts after it."""
    if not hybrid_machine:
        yield Cause("T (half of it)", settings=_set(cycle=0.5))
        yield FORMULA
        yield WORDS
        return
    yield Cause("noise", without_noise, quiet=False)
    yield Cause("gain errors", parts_without({"tolerance": 0.0}))
    for part in sorted({part.name.split(".")[0] for part in patch.analog_parts}):
        yield Cause(part, parts_without({"tolerance": 0.0}, part), group="gain errors")
    yield Cause("lags", parts_without({"tau": 0.0}))
    yield Cause("converters", exact_converters())
    for converter in (*patch.adcs, *patch.dacs):
        if converter.bits is not None:
            yield Cause(converter.name, exact_converters(converter.name), group="converters")
    yield Cause("compute time", settings=_set(compute_time=0.0))
    yield Cause("T (a quarter of it)", settings=_set(cycle=0.25))
    yield FORMULA
    yield WORDS
    yield Cause(IDEAL, settings=_set(compute_time=0.0, cycle=0.25), machine="ideal")
