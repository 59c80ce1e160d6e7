"""What a program's operations are counted as: powers, tables and helper functions, by hand.

The formulas of the helper functions are counted a second time, by numbers that count what is done with
them.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from types import SimpleNamespace

import pytest

from hybrid import surroundings
from hybrid.compiler import compile_patch
from hybrid.counting import program_operations
from hybrid.patchfile import parse_patch

TEXT = """\
title: One word
machine: ideal
parameters: {one: 1 m, rho: 1.2 kg/m^3, e: EXPONENT}
analog: {c: {constant: 1, full_scale: 1}}
interface: {x: {adc: c, channel: 0}, y: {adc: c, channel: 1}, z: {adc: c, channel: 2}}
tables:
  line: {inputs: {a: 1}, values: {0: 1, 1: 2}, outside: extrapolate}
  bend: {inputs: {a: 1}, values: {0: 1, 1: 2, 3: 0, 4: 4}, outside: clamp}
  curve: {inputs: {a: 1}, values: {0: 1, 1: 2, 3: 0, 4: 4}, outside: clamp, method: cubic}
  plane: {file: plane.csv, inputs: {a: 1, b: 1}, output: v}
  curved: {file: plane.csv, inputs: {a: 1, b: 1}, output: v, method: cubic}
  cube: {file: cube.csv, inputs: {a: 1, b: 1, c: 1}, output: v, outside: extrapolate}
  loose: {file: loose.csv, inputs: {a: 1, b: 1}, output: v, method: simplices, outside: clamp}
digital:
  period: 1 s
  compute_time: 0
  program:
WORDS
run: {until: 3 s}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Tables of 3 x 5 and 2 x 2 x 2 values, and of the corners of a square."""
    at = tmp_path_factory.mktemp("tables")
    plane = [f"{a},{b},{a * b}" for a in range(3) for b in range(5)]
    cube = [f"{a},{b},{c},1" for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    for name, head, rows in (("plane", "a,b,v", plane), ("cube", "a,b,c,v", cube)):
        (at / f"{name}.csv").write_text("\n".join([head, *rows]) + "\n")
    (at / "loose.csv").write_text("a,b,v\n0,0,1\n1,0,2\n0,1,3\n1,1.5,5\n")
    return at


def counted(folder, *exprs, exponent="2"):
    """(add, multiply, divide, square_root) of words with these expressions; each stores one word."""
    words = "\n".join(f"    w{i}: {expr}" for i, expr in enumerate(exprs))
    text = TEXT.replace("WORDS", words).replace("EXPONENT", exponent)
    machine = compile_patch(parse_patch(text, str(folder / "one.yaml")))
    found = program_operations(machine.tape, 0)
    assert found.pop("store") == len(exprs)
    return tuple(found.values())


@pytest.mark.parametrize(
    ("exponent", "multiply", "divide", "root"),
    [
        ("2", 1, 0, 0),
        ("3", 2, 0, 0),
        ("4", 2, 0, 0),
        ("15", 6, 0, 0),  # x^2, x^4, x^8 and three products of them
        ("64", 6, 0, 0),
        ("1", 0, 0, 0),
        ("0", 0, 0, 0),
        ("0.5", 0, 0, 1),
        ("1.5", 1, 0, 1),
        ("2.5", 2, 0, 1),
        ("-1", 0, 1, 0),
        ("-3", 2, 1, 0),
        ("-0.5", 0, 1, 1),
    ],
)
def test_small_powers_are_products_and_roots(folder, exponent, multiply, divide, root):
    for expr in (f"x**({exponent})", "x**e"):  # as a number, or as a parameter
        assert counted(folder, expr, exponent=exponent) == (0, multiply, divide, root)


@pytest.mark.parametrize("expr", ["x**0.3", "x**65", "x**y", "x**(1/3)"])
def test_other_powers_are_a_logarithm_and_an_exponential(folder, expr):
    assert counted(folder, expr) == (12, 13, 0, 0)


@pytest.mark.parametrize(
    ("expr", "expected"),
    [
        # Part of the interval: 1 and 1; between two values: 2 additions and a product.
        ("line(x)", (1 + 2, 1 + 1, 0, 0)),
        # Both sides held: 2; 3 intervals: 2 halvings.
        ("bend(x)", (2 + 2 + 1 + 2, 1 + 1, 0, 0)),
        # The search, weights of 4 and 5, one cubic of 3 and 4 with stored slopes.
        ("curve(x)", (5 + 4 + 3, 1 + 5 + 4, 0, 0)),
        # 2 intervals of a, 4 of b: 1 and 2 halvings; 3 interpolations.
        ("plane(x, y)", ((2 + 1 + 1) + (2 + 2 + 1) + 3 * 2, 2 + 3, 0, 0)),
        # One cubic along a with slopes made (7, 5 and 6 divisions), 3 along b with stored ones.
        ("curved(x, y)", (9 + 2 * 4 + 4 * 3 + 7, 2 + 2 * 5 + 4 * 4 + 5, 6, 0)),
        # One interval each, not held: the part alone; 7 interpolations.
        ("cube(x, y, z)", (3 + 7 * 2, 3 + 7, 0, 0)),
    ],
)
def test_tables_are_counted_by_their_dimensions_and_method(folder, expr, expected):
    assert counted(folder, expr) == expected


def test_scattered_points_are_counted_by_the_simplices_that_are_tried(folder):
    # Two triangles between four points, in one cell: (1 + 2)/2 = 1.5, so 2 tried, each of 9 additions
    # and 4 products; the place 4 and 2 of each variable, the value 2 and 3.
    assert counted(folder, "loose(x, y)") == (4 * 2 + 2 * 9 + 2, 2 * 2 + 2 * 4 + 3, 0, 0)


def test_a_search_and_a_formula_of_the_same_arguments_are_counted_once(folder):
    one = counted(folder, "bend(x)")
    both = counted(folder, "bend(x)", "curve(x)")
    # The search of `bend` (5 and 1) serves `curve`, whose breakpoints are the same.
    assert both == (one[0] + 4 + 3, one[1] + 5 + 4, 0, 0)
    apart = counted(folder, "bend(x)", "curve(y)")
    assert apart == (both[0] + 5, both[1] + 1, 0, 0)
    place = "(x*one, y*one, z*one)"  # not the same registers, so nothing is shared
    assert counted(folder, f"gravity_x_j2{place}", f"gravity_y_j2{place}") == tuple(
        2 * n for n in counted(folder, f"gravity_x_j2{place}")
    )


class Number:
    """A number that counts what is done with it, but comparisons, which only refuse."""

    def __init__(self, value: float, total: Counter[str]) -> None:
        self.value, self.total = value, total

    def made(self, value: float, **done: int) -> Number:
        self.total.update(done)
        return Number(value, self.total)

    def __add__(self, other):
        return self.made(self.value + value_of(other), add=1)

    def __sub__(self, other):
        return self.made(self.value - value_of(other), add=1)

    def __rsub__(self, other):
        return self.made(other - self.value, add=1)

    def __neg__(self):
        return self.made(-self.value, add=1)

    def __mul__(self, other):
        return self.made(self.value * value_of(other), multiply=1)

    def __truediv__(self, other):
        return self.made(self.value / value_of(other), divide=1)

    def __rtruediv__(self, other):
        return self.made(other / self.value, divide=1)

    def __pow__(self, power):
        return self.made(self.value**power, multiply=power - 1)

    def __abs__(self):
        return Number(abs(self.value), self.total)

    def __gt__(self, other):
        return self.value > value_of(other)

    def __ge__(self, other):
        return self.value >= value_of(other)

    __radd__, __rmul__ = __add__, __mul__


def value_of(number):
    return number.value if isinstance(number, Number) else number


def counting_math(total):
    """The module `math`, counting."""

    def function(compute, **done):
        def call(*arguments):
            total.update(done)
            return Number(compute(*map(value_of, arguments)), total)

        return call

    polynomial = {"add": 6, "multiply": 6}
    return SimpleNamespace(
        sqrt=function(math.sqrt, square_root=1),
        sin=function(math.sin, **polynomial),
        cos=function(math.cos, **polynomial),
        exp=function(math.exp, **polynomial),
        atan2=function(math.atan2, **polynomial, divide=1),
        pow=function(math.pow, add=12, multiply=13),
        isnan=lambda number: math.isnan(value_of(number)),
        nan=math.nan,
    )


AT = (4e6, 3e6, 4.5e6)


@pytest.mark.parametrize(
    ("formula", "given", "asked", "by_hand", "beside"),
    [
        # beside: additions that are counted and not in the formula as it is written, or the other way:
        # of the air 3 comparisons to find the layer, and one whether that has a gradient.
        ("us76", (5e3,), ["temperature_us76(h)", "pressure_us76(h)"], (19, 16, 2, 0), 3 + 1),
        ("exponential_density", (5e3,), ["density_exponential(h, rho, one)"], (7, 7, 1, 0), 0),
        ("gravity_sphere", (7e6,), ["gravity_sphere(h)"], (0, 1, 1, 0), 0),
        (
            "gravity_j2",
            AT,
            ["gravity_x_j2(h, k, l)", "gravity_y_j2(h, k, l)", "gravity_z_j2(h, k, l)"],
            (6, 14, 3, 1),
            0,
        ),
        (
            "gravity_j2_polar",
            (7e6, 0.4),
            ["gravity_down_j2(h, x)", "gravity_north_j2(h, x)"],
            (15, 22, 2, 0),
            0,
        ),
        (
            "geodetic",
            AT,
            ["latitude_wgs84(h, k, l)", "longitude_wgs84(h, k, l)", "height_wgs84(h, k, l)"],
            (26, 49, 10, 6),
            -1,  # whether there is a direction at all
        ),
        (
            "earth_fixed",
            (0.4, 0.3, 5e3),
            ["x_wgs84(x, y, h)", "y_wgs84(x, y, h)", "z_wgs84(x, y, h)"],
            (27, 31, 1, 1),
            0,
        ),
    ],
)
def test_helper_functions_are_counted_by_their_formulas(
    folder, monkeypatch, formula, given, asked, by_hand, beside
):
    made = ["x*one", "y*one", "z*one"]  # three products, words 0 to 2
    found = counted(folder, *made, *map(_with_words, asked))
    assert (found[0], found[1] - 3, *found[2:]) == by_hand
    total: Counter[str] = Counter()
    monkeypatch.setattr(surroundings, "math", counting_math(total))
    arguments = [Number(value, total) for value in given]
    if formula == "exponential_density":
        arguments += [Number(1.2, total), Number(7e3, total)]
    getattr(surroundings, formula)(*arguments)
    total["add"] += beside
    assert tuple(total[key] for key in ("add", "multiply", "divide", "square_root")) == by_hand


def _with_words(expr):
    """The arguments h, k, l as the words that are lengths."""
    words = {"h": "w0", "k": "w1", "l": "w2"}
    return re.sub(r"\b[hkl]\b", lambda letter: words[letter[0]], expr)


@pytest.mark.parametrize(
    ("expr", "expected"),
    [
        ("temperature_us76(w0)", (6, 2, 1, 0)),
        ("sound_speed_us76(w0)", (6, 3, 1, 1)),
        ("density_us76(w0)", (19, 17, 3, 0)),
        ("gravity_x_j2(w0, w0, w0)", (4, 10, 3, 1)),
        ("gravity_z_j2(w0, w0, w0)", (4, 10, 3, 1)),
        ("gravity_down_j2(w0, x)", (8, 13, 2, 0)),
        ("latitude_wgs84(w0, w0, w0)", (16, 36, 7, 4)),
        ("longitude_wgs84(w0, w0, w0)", (6, 6, 1, 0)),
        ("height_wgs84(w0, w0, w0)", (14, 37, 8, 6)),
        ("x_wgs84(x, y, w0)", (20, 22, 1, 1)),
        ("z_wgs84(x, y, w0)", (8, 10, 1, 1)),
    ],
)
def test_one_result_alone_is_counted_without_what_the_others_need(folder, expr, expected):
    found = counted(folder, "x*one", expr)
    assert (found[0], found[1] - 1, *found[2:]) == expected


def test_arguments_that_are_handed_over_are_no_words(folder):
    assert counted(folder, "limit(x, 0, 1)") == (2, 0, 0, 0)
    assert counted(folder, "dead_zone(x, 0, 1)") == (3, 0, 0, 0)
    assert counted(folder, "select(x > 0, y, z)") == (2, 0, 0, 0)
