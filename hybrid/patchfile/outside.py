"""Quantities given outside a patch file: parameters that are set, the end of the run."""

from __future__ import annotations

from dataclasses import replace

from hybrid.dimensions import dimension_of
from hybrid.errors import PatchError, Place, did_you_mean, quoted
from hybrid.expressions import ExpressionError, evaluate, is_constant
from hybrid.fields import fits, in_words, unit_words, value_of
from hybrid.parsing import parse
from hybrid.patch import Parameter, Patch, Value
from hybrid.units import TIME
from hybrid.yamltree import Text

_CYCLES = frozenset({"hz", "khz", "mhz", "ghz", "hertz", "kilohertz", "megahertz"})
_ANGLES = frozenset({"rad", "mrad", "radian", "radians", "deg", "degree", "degrees", "rpm"})


def parse_override(patch: Patch, name: str, text: str) -> float:
    """The SI value of a parameter set from outside, such as ("cycle", "2 ms").

    A bare number is in SI units. Raises PatchError for an unknown parameter or a unit that does not
    fit.
    """
    place = Place(patch.file)
    if name not in patch.parameters:
        hint = did_you_mean(name, patch.parameters)
        raise PatchError(f"no parameter {quoted(name)}; {hint}", place)
    given = f"{name}={quoted(text)}"
    parameter = patch.parameters[name]
    try:
        expr = parse(text)
        if not is_constant(expr):
            raise ExpressionError("names are not known here; give a quantity, such as 2 ms")
        dimension, value = dimension_of(expr, {}), evaluate(expr, {})
    except ExpressionError as error:
        raise PatchError(f"{given}: {error}", place) from None
    if not fits(text, dimension, parameter.dimension):
        raise PatchError(f"{given} does not fit; it must be {in_words(parameter.dimension)}", place)
    _refuse_mixed_frequency(text, parameter, given, place)
    return value


def _refuse_mixed_frequency(text: str, parameter: Parameter, given: str, place: Place) -> None:
    """Dimensions alone cannot tell Hz from rad/s: a parameter stays what its unit says."""
    words, own = unit_words(text), unit_words("1 " + parameter.unit)
    if (words & _CYCLES and own & _ANGLES) or (words & _ANGLES and own & _CYCLES):
        raise PatchError(
            f"{given} does not fit; it must be in {parameter.unit} (1 Hz is 2*pi rad/s)", place
        )


def parse_duration(text: str, what: str, *, or_zero: bool = False) -> Value:
    """A time greater than zero, such as "20 s", given outside a patch; `what` names it in messages."""
    try:
        if text.strip() and not is_constant(parse(text.strip())):
            raise ExpressionError("names are not known here; give a time, such as 20 s")
    except ExpressionError as error:
        raise PatchError(f"{what} is {quoted(text)}: {error}") from None
    value, dimension = value_of(Text(text.strip(), Place()), what, {})
    if not fits(text, dimension, TIME):
        raise PatchError(f"{what} is {quoted(text)}; it must be a time, such as 20 s")
    return replace(value, positive=not or_zero, not_negative=or_zero, unit=str(TIME))
