"""Quantities given outside a patch file: parameters that are set, the end of the run."""

from __future__ import annotations

import re
from dataclasses import replace

from hybrid.dimensions import dimension_of
from hybrid.errors import PatchError, Place, quoted
from hybrid.expressions import ExpressionError, evaluate, is_constant
from hybrid.fields import fits, in_words, unit_words
from hybrid.parsing import parse
from hybrid.patch import Parameter, Patch, Value, literal
from hybrid.units import TIME, Dimension

_CYCLES = frozenset({"hz", "khz", "mhz", "ghz", "hertz", "kilohertz", "megahertz"})
_ANGLES = frozenset({"rad", "mrad", "radian", "radians", "deg", "degree", "degrees", "rpm"})


def parse_override(patch: Patch, name: str, text: str) -> float:
    """The SI value of a parameter set from outside, such as ("cycle", "2 ms").

    A bare number is in SI units. Raises PatchError, with the line on which the parameter stands, for
    what is no finite number or has a unit that does not fit.
    """
    patch.check_settable(name)
    parameter = patch.parameters[name]
    due = in_words(parameter.dimension)
    try:
        value = _number(text, parameter.dimension)
    except ExpressionError as error:
        why = str(error)
    else:
        why = _mixed_frequency(text, parameter)
        if not why:
            return value
        due = f"in {parameter.unit}"
    raise PatchError(
        f"{name} cannot be {quoted(text)}: {why}; it must be {due}", place_of(patch, name)
    )


def place_of(patch: Patch, name: str) -> Place:
    """Where a parameter stands; the file where that is not known."""
    place = patch.parameters[name].value.place
    return place if str(place) else Place(patch.file)


def _number(text: str, wanted: Dimension) -> float:
    """The SI value of a finite number in a unit that fits, or of arithmetic of such; raises
    ExpressionError with what is wrong, in a few words."""
    if not text.strip():
        raise ExpressionError("nothing is given")
    try:
        expr = parse(text)
        if not is_constant(expr):
            raise ExpressionError("names are not known here")
        dimension, value = dimension_of(expr, {}), evaluate(expr, {})
    except ExpressionError as error:
        # What arithmetic of a patch may have is no help to who wants to give a number.
        told = re.sub(r" \(character \d+ of the expression\)", "", str(error))
        short = re.split("; (?:valid are|give one)", told)[0]
        raise ExpressionError(_slip(text) or short) from None
    if not fits(text, dimension, wanted):
        raise ExpressionError("its unit does not fit")
    return value


def _slip(text: str) -> str:
    """What other languages let be a number; ''."""
    if any(letter.isdecimal() and not letter.isascii() for letter in text):
        return "digits are 0 to 9"
    if re.search(r"\d_+\d", text):
        return "digits are written without _"
    return "numbers are decimal" if re.match(r"\s*[+-]?0[xXoObB]", text) else ""


def _mixed_frequency(text: str, parameter: Parameter) -> str:
    """Dimensions alone cannot tell Hz from rad/s: a parameter stays what its unit says."""
    words, own = unit_words(text), unit_words("1 " + parameter.unit)
    mixed = (words & _CYCLES and own & _ANGLES) or (words & _ANGLES and own & _CYCLES)
    return "1 Hz is 2*pi rad/s" if mixed else ""


def parse_duration(text: str, what: str, *, or_zero: bool = False) -> Value:
    """A time greater than zero, such as "20 s", given outside a patch; `what` names it in messages."""
    try:
        value_s = _number(text, TIME)
    except ExpressionError as error:
        raise PatchError(
            f"{what} cannot be {quoted(text)}: {error}; it must be a time, such as 20 s"
        ) from None
    made = replace(literal(value_s), what=what, unit=str(TIME))
    return replace(made, positive=not or_zero, not_negative=or_zero)
