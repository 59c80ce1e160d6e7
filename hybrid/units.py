"""Units at the door: text such as "1 ms" becomes an SI float and a dimension.

Everything inside the package is a plain float in SI units. This module alone knows unit names, and
it asks pint for their meaning; pint is imported when the first named unit is met, never for a bare
number.

The product of a decimal and a unit factor is formed exactly, as a fraction, and rounded once:
"0.1 ms" is the float 1e-4 and not its neighbour. Angles, percent and counts are pure numbers
(radian = 1).
"""

from __future__ import annotations

import difflib
import json
import math
import numbers
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

LONGEST_TEXT = 200
LARGEST_POWER = 12

# The order in which a product of base units is customarily written.
_SI_SYMBOL = {
    "mass": "kg",
    "length": "m",
    "time": "s",
    "current": "A",
    "temperature": "K",
    "substance": "mol",
    "luminosity": "cd",
}

# Offered where a name is unknown; pint knows many more.
_COMMON_UNITS = """
    s ms us ns second min minute h hour day Hz kHz MHz rpm
    rad mrad radian deg degree turn arcmin arcsec % percent ppm bit
    m mm um cm km meter in inch ft foot feet mile nautical_mile mph knot
    g kg slug lb pound N kN lbf J kJ W kW Pa kPa bar psi K kelvin mol cd standard_gravity
    V mV uV kV volt A mA uA ampere ohm kohm Mohm F uF nF pF H mH
"""

# Possessive quantifiers of single letters, "\s*+": hostile text must not make the matcher back up. None
# of groups, "(?:...)?+": once in a while Python 3.11 keeps what they match in part ("1e" as a number).
_NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?(?![0-9.])(?![eE](?![A-Za-z_]))"
_LETTER = "A-Za-zµμΩΩÅΔ"
_NAME = rf"(?:%|°[CF]?|[{_LETTER}][{_LETTER}0-9_]*+)"
_POWER = r"(?:\s*+(?:\*\*|\^)\s*+(?:[+-]?\d{1,2}(?:\.\d{1,3})?|\(\d{1,2}/\d{1,2}\)))?"
_FACTOR = rf"{_NAME}{_POWER}"
_PRODUCT = rf"{_FACTOR}(?:\s*+[*/]\s*+{_FACTOR})*"
_TERM = rf"(?:{_FACTOR}|\(\s*+{_PRODUCT}\s*+\))"
_UNIT = re.compile(rf"(?:1\s*+/\s*+)?{_TERM}(?:\s*+[*/]\s*+{_TERM})*", re.ASCII)
_QUANTITY = re.compile(rf"({_NUMBER})\s*+(.*)", re.ASCII | re.DOTALL)
_QUANTITY_START = re.compile(rf"\s*+{_NUMBER}\s*+(?:[%°{_LETTER}]|1\s*+/)", re.ASCII)

_SUPERSCRIPT = re.compile("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+")
_PLAIN_DIGITS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_PLAIN_TIMES = str.maketrans("·⋅", "**")


class UnitError(ValueError):
    """A quantity that cannot be read; the message is one line and says what would be valid."""


def _exact(power: float | Fraction) -> int | Fraction:
    """An exponent as int or Fraction; 0.3333... is taken for 1/3."""
    exact = Fraction(power).limit_denominator(1000)
    return exact.numerator if exact.denominator == 1 else exact


@dataclass(frozen=True, slots=True)
class Dimension:
    """Exponents of the base dimensions, sorted by name, for example (("length", 1), ("time", -2)).

    Exponents are exact: an int, or a Fraction where a root was taken. Raises UnitError for a base
    dimension other than mass, length, time, current, temperature, substance, luminosity.
    """

    exponents: tuple[tuple[str, int | Fraction], ...] = ()

    def __post_init__(self) -> None:
        total: dict[str, int | Fraction] = {}
        for name, power in self.exponents:
            if name not in _SI_SYMBOL:
                raise UnitError(f"{name!r} is no base dimension; valid are {', '.join(_SI_SYMBOL)}")
            total[name] = _exact(total.get(name, 0) + power)
        kept = sorted((name, power) for name, power in total.items() if power != 0)
        object.__setattr__(self, "exponents", tuple(kept))

    @property
    def is_pure(self) -> bool:
        """True for a pure number; radians, degrees and percent are pure."""
        return not self.exponents

    def __mul__(self, other: Dimension) -> Dimension:
        return Dimension(self.exponents + other.exponents)

    def __truediv__(self, other: Dimension) -> Dimension:
        return self * other**-1

    def __pow__(self, power: float | Fraction) -> Dimension:
        exact = _exact(power)
        return Dimension(tuple((name, old * exact) for name, old in self.exponents))

    def __str__(self) -> str:
        powers = dict(self.exponents)
        ordered = [(symbol, powers[name]) for name, symbol in _SI_SYMBOL.items() if name in powers]
        above = _product_text((symbol, power) for symbol, power in ordered if power > 0)
        below = [(symbol, -power) for symbol, power in ordered if power < 0]
        if not below:
            return above or "1"
        under = _product_text(below)
        return f"{above or '1'}/({under})" if len(below) > 1 else f"{above or '1'}/{under}"


PURE = Dimension()
TIME = Dimension((("time", 1),))


@dataclass(frozen=True, slots=True)
class Quantity:
    """A value in SI units and its dimension."""

    value: float
    dimension: Dimension = PURE


def parse_quantity(text: str | int | float) -> Quantity:
    """Read a number with an optional unit: "1 ms", "-0.1 deg", "20 rad/s^2", "5 1/s", 1e-3.

    Parameters
    ----------
    text
        a number, or text: a decimal number and then a product of unit names with * / ** or ^.

    Returns
    -------
    Quantity
        in SI units, correctly rounded wherever the unit's factor is rational.

    Raises
    ------
    UnitError
        for an unknown unit (naming close ones), malformed text, temperatures with an offset (degC,
        degF), logarithmic units (dB), bool, nan, infinities, overflow and underflow.
    """
    number, unit = split_quantity(text)
    factor, dimension = _unit(unit)
    return Quantity(_rounded_product(number, factor, text), dimension)


def looks_like_quantity(text: str) -> bool:
    """True if text starts with a number and then a unit: "1 ms", "5%", "5 1/s".

    Bare numbers ("1e3") and arithmetic ("1.5*cycle", "1/s") are not quantities. Whether the rest
    is a valid unit is for `parse_quantity` to say.
    """
    return _QUANTITY_START.match(text) is not None


def split_quantity(text: str | int | float) -> tuple[str, str]:
    """Number and unit of a quantity as text, neither evaluated: ("1", "ms") for "1 ms".

    Raises UnitError where the text does not start with a finite number.
    """
    if isinstance(text, numbers.Real) and not isinstance(text, bool):
        return _number_text(text), ""
    if not isinstance(text, str):
        raise UnitError(f"{_shown(text)} is not a quantity; write a number such as 5 or '1 ms'")
    if len(text) > LONGEST_TEXT:
        raise UnitError(f"a quantity has at most {LONGEST_TEXT} characters, this has {len(text)}")
    match = _QUANTITY.fullmatch(text.strip())
    if match is None:
        raise UnitError(f"{_shown(text)} is not a quantity; write a number and a unit: '1 ms'")
    return match[1], match[2]


def unit_of(text: str | int | float) -> tuple[str, float, Dimension]:
    """Unit of a quantity: its text as written, its size in SI units, its dimension.

    "2 rad/s" gives ("rad/s", 1.0, 1/s), "20 deg" gives ("deg", pi/180, PURE) and a bare number
    ("", 1.0, PURE). Raises UnitError as `parse_quantity` does.
    """
    parse_quantity(text)
    _, unit = split_quantity(text)
    factor, dimension = _unit(unit)
    return unit, _rounded_product("1", factor, unit), dimension


def _number_text(number: numbers.Real) -> str:
    """Shortest decimal that gives back the float nearest to a number."""
    try:
        value = float(number)
    except OverflowError:
        value = math.inf
    if not math.isfinite(value):
        raise UnitError("a quantity must be a finite number below about 1.8e308 in size")
    return repr(value)


def _rounded_product(number: str, factor: Fraction, text: object) -> float:
    """Float nearest to the exact product of a decimal and a unit's factor."""
    plain = float(number)
    if plain == 0.0 and not re.search("[1-9]", re.split("[eE]", number)[0]):
        return plain
    # Only now is the exponent known to be one that a float has, and the fraction small.
    try:
        value = float(Fraction(number) * factor) if 0.0 < abs(plain) < math.inf else plain
    except OverflowError:
        value = math.inf
    if math.isinf(value):
        raise UnitError(f"{_shown(text)} is too large; the limit is about 1.8e308 in SI units")
    if value == 0.0:
        raise UnitError(f"{_shown(text)} is too small; the limit is about 5e-324 in SI units")
    return value


class _Met:
    """Units met before, kept on disk: pint takes a quarter of a second to load, and rarely has news.

    What is kept is pint's answer word for word, under the version of pint that gave it. A folder that
    cannot be read or written, or a damaged file, only means asking pint again.
    """

    def __init__(self) -> None:
        self.answers: dict[str, list[str]] | None = None

    def _file(self) -> Path:
        base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
        return Path(base) / "hybrid" / f"units-{version('pint')}.json"

    def get(self, unit: str) -> tuple[Fraction, dict[str, Fraction]] | None:
        """Factor and exponents of a unit met before."""
        if self.answers is None:
            try:
                self.answers = json.loads(self._file().read_text(encoding="utf-8"))
            except (OSError, ValueError):
                self.answers = {}
        try:
            factor, *powers = self.answers[unit]
            pairs = (power.split("=") for power in powers)
            return Fraction(factor), {name: Fraction(power) for name, power in pairs}
        except (KeyError, TypeError, ValueError, AttributeError):
            return None

    def keep(self, unit: str, factor: Fraction, powers: dict[str, Any]) -> None:
        """Add an answer of pint's; the file is replaced whole, so that two runs cannot mix theirs."""
        if not isinstance(self.answers, dict):
            self.answers = {}
        try:
            pairs = [f"{name}={Fraction(power)}" for name, power in powers.items()]
            self.answers[unit] = [str(factor), *pairs]
            file = self._file()
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_suffix(f".{os.getpid()}")
            part.write_text(json.dumps(self.answers), encoding="utf-8")
            part.replace(file)
        except (OSError, ValueError, TypeError):
            return


_MET = _Met()


@lru_cache(maxsize=1024)
def _unit(unit: str) -> tuple[Fraction, Dimension]:
    """Exact factor to SI units and dimension of a unit's text; the empty text is a pure 1."""
    if not unit:
        return Fraction(1), PURE
    plain = unit.translate(_PLAIN_TIMES)
    plain = _SUPERSCRIPT.sub(lambda found: "^" + found[0].translate(_PLAIN_DIGITS), plain)
    if _UNIT.fullmatch(plain) is None:
        raise UnitError(
            f"cannot read the unit {_shown(unit)}; "
            f"write names joined by * and /, powers with ^ (at most {LARGEST_POWER}): 'rad/s^2'"
        )
    factor, powers = _ask_pint(plain, unit)
    if any(abs(power) > LARGEST_POWER for power in powers.values()):
        raise UnitError(f"powers in the unit {_shown(unit)} must not exceed {LARGEST_POWER}")
    return factor, _dimension(powers, unit)


def _ask_pint(plain: str, unit: str) -> tuple[Fraction, dict[str, Any]]:
    """Factor to SI base units and exponents of pint's dimensions ("[time]") of a checked unit."""
    known = _MET.get(plain)
    if known is not None:
        return known
    registry = _registry()
    try:
        parsed = registry.parse_units(plain)
        powers = dict(parsed.dimensionality)
        zero = registry.Quantity(Fraction(0), parsed).to_base_units().magnitude
        factor = Fraction(registry.Quantity(Fraction(1), parsed).to_base_units().magnitude)
    # pint's parser raises a dozen unrelated types; whatever it was, the unit cannot be used.
    except Exception as error:
        raise UnitError(_unknown_unit(error, unit)) from None
    # A unit is a mere factor only where zero of it is zero; 0 degC is 273.15 K.
    if zero != 0:
        raise UnitError(f"{_shown(unit)} has an offset zero point; give temperatures in kelvin (K)")
    if factor <= 0:
        raise UnitError(f"{_shown(unit)} is not a positive unit; write the number itself")
    _MET.keep(plain, factor, powers)
    return factor, powers


def _dimension(powers: dict[str, Any], unit: str) -> Dimension:
    """Dimension from pint's exponents, which are named "[time]"."""
    try:
        return Dimension(tuple((name.strip("[]"), power) for name, power in powers.items()))
    except UnitError as error:
        raise UnitError(f"the unit {_shown(unit)} cannot be used: {error}") from None


@lru_cache(maxsize=1)
def _registry() -> Any:
    """Pint's registry, with factors as exact fractions; imported on first need (0.4 s)."""
    import pint

    settings: dict[str, Any] = {"non_int_type": Fraction, "system": "mks"}
    try:
        return pint.UnitRegistry(cache_folder=":auto:", **settings)
    # The cache only saves time: a folder that cannot be written, or is damaged, must not matter.
    except Exception:
        return pint.UnitRegistry(**settings)


def _unknown_unit(error: Exception, unit: str) -> str:
    names = getattr(error, "unit_names", None)
    if not names:
        return f"cannot use the unit {_shown(unit)}; valid are linear units like ms or slug*ft^2"
    name = names if isinstance(names, str) else str(next(iter(names)))
    close = difflib.get_close_matches(name, _COMMON_UNITS.split(), n=3, cutoff=0.5)
    advice = f"did you mean {' or '.join(close)}?" if close else "valid are ms, rad/s, slug*ft^2"
    return f"unknown unit {_shown(name)}; {advice}"


def _product_text(factors: Iterable[tuple[str, int | Fraction]]) -> str:
    return "*".join(symbol + _power_text(power) for symbol, power in factors)


def _power_text(power: int | Fraction) -> str:
    if power == 1:
        return ""
    return f"^{power}" if isinstance(power, int) else f"^({power})"


def _shown(text: object) -> str:
    """Text quoted for a one-line message, cut where it is long."""
    shown = repr(text if isinstance(text, str | bool | float) else type(text).__name__)
    return shown if len(shown) <= 60 else shown[:57] + "..."
