"""The units in which words and states are shown: by the key `units` of the digital machine, or a DAC."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hybrid.errors import PatchError, did_you_mean, quoted
from hybrid.fields import in_words, table_of
from hybrid.patch import Patch
from hybrid.units import PURE, Dimension, UnitError, unit_of
from hybrid.yamltree import Table, Text, kind_of


def read_shown_units(
    digital: Table, dimensions: Mapping[str, Dimension | None], words: frozenset[str]
) -> dict[str, tuple[str, float]]:
    """Unit and SI value of one, by word; raises PatchError for a unit that does not fit."""
    tree = digital.entries.get("units")
    found = {}
    for word, item, place in table_of(tree, "units", "word: unit") if tree else ():
        if word not in words:
            hint = did_you_mean(word, words)
            raise PatchError(f"units: no word or state {quoted(word)}; {hint}", place)
        if not isinstance(item, Text) or not item.text:
            raise PatchError(f"units: {word!r} needs a unit, not {kind_of(item)}", place)
        try:
            unit, factor, dimension = unit_of(f"1 {item.text}")
        except UnitError as error:
            raise PatchError(f"unit of {word!r}: {error}", item.place) from None
        own = dimensions[word] or PURE
        if dimension != own:
            raise PatchError(
                f"unit of {word!r} is {quoted(unit)} [{dimension}]; it must be that of what is "
                f"{in_words(own)}",
                item.place,
            )
        found[word] = unit, factor
    return found


def with_units_of_dacs(patch: Patch) -> Patch:
    """The patch with the unit of its DAC for every word that has none of its own.

    Settled before anything is put on another machine, where the converter may be no more or have another
    word: what is shown is to be as it is written.
    """
    program = patch.program
    if program is None:
        return patch
    of_dacs = {dac.word: (dac.unit, dac.factor) for dac in patch.dacs}
    return replace(patch, program=replace(program, units={**of_dacs, **program.units}))
