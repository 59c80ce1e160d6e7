"""How many additions, multiplications, divisions and square roots there are in what a program does.

Stage 0. A subtraction, a comparison, a choice, a sign count as an addition; every word computed is
stored, which is one `store`. What is known before a run (constants, products of these, reciprocals of
the intervals of tables) is computed before it. Addresses are left out, as machines have index registers
for them; so is what only notices that an argument is out of range. Where machines have no instruction:

- A function is a polynomial of six terms, 6 multiplications and 6 additions (C. Hastings,
  "Approximations for Digital Computers", 1955, has those of 1e-7), with what leads to it and from it.
- A power: whole ones up to 64 by repeated squaring (x**2 is 1 product, x**3 2, x**15 6), negative ones
  with a division, halves with a square root; any other one is a logarithm, a product and an exponential.
- A table, of each variable: comparisons by halving until one of its m intervals is left, log2(m) rounded
  up, and one for each side on which it is held or stops; how far into the interval, a subtraction and a
  product. Then, of d variables,
  - linear: 2^d - 1 times a + t (b - a), a product and 2 additions each;
  - cubic: weights of two values and two slopes along each variable (5 products, 4 additions); four
    products and 3 additions for each cubic, one along the first variable, 4 along the second, 16 along
    the third ... (fewer where it has fewer points). Slopes along the last variable are stored with the
    values. Those along others are made for each cubic (Fritsch and Butland, inner points): 3 differences
    by stored reciprocals, and for two slopes a product, a comparison, a sum and 3 divisions each;
  - simplices: each variable to a part of the range (a subtraction, a product), held there (2
    comparisons) and to its cell (a product, an addition); d weights of d products, the last one, and
    whether one is below 0, d^2 products and (d + 1)^2 additions, for half of the simplices that reach
    into a cell, on average, and half a one; d + 1 products and d additions for the value.
- A helper function: its formula in `surroundings`, operation by operation, see `HELPER_PARTS`. The layer
  of the standard atmosphere is found by halving, 3 comparisons among 8, and is taken as one with a
  gradient, as most are.

Look-ups and helper functions of the same arguments have parts in common (the search, the field, the
figure of the Earth), which are counted once, as they are played.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Iterator, Mapping
from types import MappingProxyType

from hybrid.meshes import CELLS, LISTS
from hybrid.tables import CONTINUES, Axis, Table

OPERATIONS = ("add", "multiply", "divide", "square_root", "store")
LARGEST_POWER = 64
_LAYER_HALVINGS = 3

Count = Mapping[str, int]


def _of(*parts: Count, **more: int) -> Count:
    total: Counter[str] = Counter(more)
    for part in parts:
        total.update(part)
    return MappingProxyType(dict(total))


_ADD, _DIVIDE, _MULTIPLY, _ROOT = ({key: 1} for key in ("add", "divide", "multiply", "square_root"))
_POLYNOMIAL = _of(add=6, multiply=6)
_POWER = _of(_POLYNOMIAL, _POLYNOMIAL, _MULTIPLY)
_ATAN2 = _of(_POLYNOMIAL, _DIVIDE)
# Operations of the tape by name; any other is a function of one polynomial.
_COST: Mapping[str, Count] = {
    "copy": {"store": 1},
    **dict.fromkeys(("add", "sub", "neg", "abs", "sign", "min", "max", "not", "and", "or"), _ADD),
    **dict.fromkeys(
        ("lt", "le", "gt", "ge", "eq", "ne", "select", "skip", "floor", "ceil", "round"), _ADD
    ),
    "limit": {"add": 2},
    "dead_zone": {"add": 3},
    "mul": _MULTIPLY,
    "div": _DIVIDE,
    "pow": _POWER,
    "sqrt": _ROOT,
    "hypot": _of(_ROOT, add=1, multiply=2),
    "mod": _of(_DIVIDE, add=2, multiply=1),
    "tan": _of(_POLYNOMIAL, _POLYNOMIAL, _DIVIDE),
    "asin": _of(_POLYNOMIAL, _ROOT),
    "acos": _of(_POLYNOMIAL, _ROOT),
    "atan2": _ATAN2,
    **dict.fromkeys(("sinh", "cosh", "tanh"), _of(_POLYNOMIAL, _DIVIDE, add=2)),
    **dict.fromkeys(("asinh", "acosh"), _of(_POLYNOMIAL, _ROOT, multiply=1, add=2)),
    "atanh": _of(_POLYNOMIAL, _DIVIDE, add=2),
}

# Parts of the helper functions, in the order of their formulas in `surroundings`.
_PART_COST: Mapping[str, Count] = {
    # Geopotential R (h/(R + h)), the layer, how far above its base; then base + gradient rise.
    "us76 layer": _of(add=1 + _LAYER_HALVINGS + 1, multiply=1, divide=1),
    "us76 temperature": _of(add=1, multiply=1),
    "us76 sound speed": _of(_ROOT, multiply=1),
    # Whether there is a gradient; base pressure (base temperature / temperature)^exponent.
    "us76 pressure": _of(_POWER, add=1, multiply=1, divide=1),
    "us76 density": _of(multiply=1, divide=1),
    "exponential": _of(_POLYNOMIAL, add=1, multiply=1, divide=1),
    "sphere": _of(multiply=1, divide=1),
    # x^2 + y^2 + z^2; -gm/(it times its root); 1.5 j2 (a^2/it); 5 (z^2/it).
    "field": _of(_ROOT, add=2, multiply=3 + 1 + 1 + 2, divide=1 + 1 + 1),
    "field across": _of(add=2, multiply=2),  # central (1 + oblate (1 - sine2))
    "field along x": _MULTIPLY,
    "field along y": _MULTIPLY,
    "field along z": _of(add=2, multiply=3),  # central (1 + oblate (3 - sine2)) z
    # gm/r^2, and 1.5 j2 (a/r)^2; central (1 + oblate (1 - 3 sin^2)); -central oblate sin(2 latitude).
    "polar field": _of(multiply=1 + 2, divide=1 + 1),
    "polar field down": _of(_POLYNOMIAL, add=2, multiply=4),
    "polar field north": _of(_POLYNOMIAL, add=1, multiply=3),
    # The way from the axis and 1 - f of it; three times a size, two parts of it cubed, a difference
    # each, and 1 - f of one.
    "meridian": _of(add=1 + 3 * 3, multiply=3 + 3 * 9, divide=3 * 2, square_root=1 + 3),
    "meridian latitude": _ATAN2,
    # A size, sine and cosine; across cosine + z sine - a sqrt(1 - e^2 sine^2).
    "meridian height": _of(add=1 + 3, multiply=2 + 5, divide=2, square_root=2),
    "longitude": _ATAN2,
    # a/sqrt(1 - e^2 sine^2); (normal + height) cosine; cosine or sine of the longitude times it; (normal
    # (1 - e^2) + height) sine.
    "figure": _of(_POLYNOMIAL, _ROOT, add=1, multiply=2, divide=1),
    "figure across": _of(_POLYNOMIAL, add=1, multiply=1),
    "figure x": _of(_POLYNOMIAL, multiply=1),
    "figure y": _of(_POLYNOMIAL, multiply=1),
    "figure z": _of(add=1, multiply=2),
}
_AIR = ("us76 layer", "us76 temperature")
HELPER_PARTS: Mapping[str, tuple[str, ...]] = {
    "temperature_us76": _AIR,
    "pressure_us76": (*_AIR, "us76 pressure"),
    "density_us76": (*_AIR, "us76 pressure", "us76 density"),
    "sound_speed_us76": (*_AIR, "us76 sound speed"),
    "density_exponential": ("exponential",),
    "gravity_sphere": ("sphere",),
    "gravity_x_j2": ("field", "field across", "field along x"),
    "gravity_y_j2": ("field", "field across", "field along y"),
    "gravity_z_j2": ("field", "field along z"),
    "gravity_down_j2": ("polar field", "polar field down"),
    "gravity_north_j2": ("polar field", "polar field north"),
    "latitude_wgs84": ("meridian", "meridian latitude"),
    "longitude_wgs84": ("longitude",),
    "height_wgs84": ("meridian", "meridian height"),
    "x_wgs84": ("figure", "figure across", "figure x"),
    "y_wgs84": ("figure", "figure across", "figure y"),
    "z_wgs84": ("figure", "figure z"),
}


def of_operation(code: str) -> Count:
    """What an operation of the tape is, by its name in lower case, where its operands do not matter."""
    return _COST.get(code, _POLYNOMIAL)


def of_power(exponent: float) -> Count:
    """What a power with a known exponent is."""
    size = abs(exponent)
    if not size <= LARGEST_POWER or not (2.0 * size).is_integer():
        return _POWER
    whole, has_half = int(size), size != int(size)
    products = whole.bit_length() + whole.bit_count() - 2 if whole else 0
    if has_half and whole:
        products += 1
    return {"multiply": products, "square_root": int(has_half), "divide": int(exponent < 0.0)}


def helper_parts(name: str, arguments: tuple[Hashable, ...]) -> Iterator[tuple[Hashable, Count]]:
    """What a helper function of these arguments is; parts of the same key are computed once."""
    for part in HELPER_PARTS[name]:
        yield (part, arguments), _PART_COST[part]


def table_parts(table: Table, arguments: tuple[Hashable, ...]) -> Iterator[tuple[Hashable, Count]]:
    """What a look-up in a table is: a search for each argument and the rest, in such parts."""
    if table.method == "limits":
        yield (id(table), arguments), {"add": _held(table.axes[0])}
        return
    if table.method != "simplices":
        for argument, axis in zip(arguments, table.axes, strict=True):
            key = (argument, axis.points.tobytes(), axis.range, axis.below, axis.above)
            yield key, _search(axis)
            if table.method == "cubic":
                yield ("weights", key), {"add": 4, "multiply": 5}
    reading = {"linear": _linear, "cubic": _cubic, "simplices": _simplices}[table.method]
    yield (id(table), arguments), reading(table)


def _held(axis: Axis) -> int:
    """On how many sides an argument is compared with its range."""
    return (axis.below != CONTINUES) + (axis.above != CONTINUES)


def _search(axis: Axis) -> Count:
    intervals = len(axis.points) - 1
    return {"add": _held(axis) + math.ceil(math.log2(intervals)) + 1, "multiply": 1}


def _linear(table: Table) -> Count:
    mixes = 2 ** len(table.axes) - 1
    return {"add": 2 * mixes, "multiply": mixes}


def _cubic(table: Table) -> Count:
    total, cubics = Counter[str](), 1
    for number, points in enumerate(table.values.shape):
        total.update(add=3 * cubics, multiply=4 * cubics)
        if number < table.values.ndim - 1:  # of the last variable slopes are stored
            total.update(_slopes(points, cubics))
        cubics *= min(points, 4)
    return total


def _slopes(points: int, cubics: int) -> Count:
    """Slopes at two neighbours; two points alone have but one, a difference by a stored reciprocal."""
    if points == 2:
        return {"add": cubics, "multiply": cubics}
    return {
        "add": (3 + 2 * 2) * cubics,
        "multiply": (3 + 2) * cubics,
        "divide": 2 * 3 * cubics,
    }


def _simplices(table: Table) -> Count:
    assert table.mesh is not None
    n, cells = len(table.axes), int(table.mesh[CELLS]) ** len(table.axes)
    lists = int(table.mesh[LISTS])
    listed = (table.mesh[lists + cells] - table.mesh[lists]) / cells
    tried = math.ceil((1.0 + listed) / 2.0)
    return {
        "add": (1 + 2 + 1) * n + tried * (n + 1) ** 2 + n,
        "multiply": (1 + 1) * n + tried * n**2 + n + 1,
    }
