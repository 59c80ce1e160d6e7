"""Units as the flight simulation standard AIAA S-119 writes them: "ft_s", "slugft2", "_deg".

Stage 0. Names stand side by side for a product, a digit after one is its power, an underscore divides by
what follows it.
"""

from __future__ import annotations

import re

# Names of the standard and of older DAVE-ML files, with those that the units module knows.
_NAMES = {
    "slug": "slug",
    "frac": "",
    "deg": "deg",
    "rad": "rad",
    "pct": "percent",
    "lbf": "lbf",
    "lbm": "pound",
    "nmi": "nautical_mile",
    "min": "minute",
    "sec": "s",
    "psf": "lbf/ft^2",
    "psi": "psi",
    "ft": "ft",
    "in": "inch",
    "km": "km",
    "cm": "cm",
    "mm": "mm",
    "kg": "kg",
    "kt": "knot",
    "kN": "kN",
    "kW": "kW",
    "hp": "hp",
    "Hz": "Hz",
    "Pa": "Pa",
    "mi": "mile",
    "nd": "",
    "hr": "hour",
    "h": "hour",
    "f": "ft",
    "m": "m",
    "s": "s",
    "r": "rad",
    "N": "N",
    "J": "J",
    "W": "W",
    "K": "K",
    "R": "degR",
    "A": "A",
    "V": "V",
}
_TERM = re.compile(f"({'|'.join(_NAMES)})([2-9])?")  # the longer names come first


def unit_text(text: str) -> str | None:
    """The unit for the units module, "" for a pure number; None where it is not known."""
    above, *below = text.strip().split("_")
    found = [_product(part) for part in (above, *below)]
    if None in found or "" in below or not text.strip("_ "):
        return None
    top, *under = [part for part in found if part is not None]
    below = [f"({part})" if "*" in part else part for part in under if part]
    return "/".join([top or ("1" if below else ""), *below])


def _product(text: str) -> str | None:
    at, factors = 0, []
    while at < len(text):
        term = _TERM.match(text, at)
        if term is None:
            return None
        if name := _NAMES[term[1]]:
            factors.append(f"{name}^{term[2]}" if term[2] else name)
        at = term.end()
    return "*".join(factors)
