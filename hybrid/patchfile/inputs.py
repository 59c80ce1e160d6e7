"""Numbers that are connected to an input of a part: in the unit of what stands in for the input."""

from __future__ import annotations

from dataclasses import replace

from hybrid.errors import PatchError
from hybrid.fields import in_words
from hybrid.units import UnitError, parse_quantity, split_quantity
from hybrid.yamltree import Text


def fitted(what: str, stand_in: Text, given: Text) -> Text:
    """What is given for an input; a bare number becomes one in the SI unit that is due.

    Arithmetic is left as it is, as its unit shows later on only. Raises PatchError for a number in
    another unit, where it stands.
    """
    try:
        due = parse_quantity(stand_in.text).dimension
        found = parse_quantity(given.text).dimension
    except UnitError:
        return given
    if due.is_pure or found == due:
        return given
    if split_quantity(given.text)[1]:
        raise PatchError(
            f"{what} must be {in_words(due)}; what is connected to it is {in_words(found)}",
            given.place,
        )
    return replace(given, text=f"{given.text} {due}")
