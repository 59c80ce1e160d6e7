"""The customary symbols of analog computing as SVG, one for each kind of component.

A symbol is drawn in a field of its own size with its output in the middle of the right side; its
inputs come to the left side. Triangles add, a rectangle before the triangle integrates, circles are
potentiometers and sources, boxes hold the curve or the sign of what they do.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any
from xml.sax.saxutils import escape, quoteattr

from matplotlib.font_manager import findfont, get_font
from matplotlib.ft2font import LoadFlags

from hybrid.charts import style

FONT = "DejaVu Sans, Verdana, sans-serif"
STROKE = 1.4
FILL = "#FFFFFF"
TINT = "#F3F6F4"


@dataclass(frozen=True)
class Field:
    """The room of a symbol, and what it may show of its component."""

    width: float
    height: float
    ins: tuple[float, ...] = ()  # heights at which cords arrive
    text: str = ""
    curve: tuple[tuple[float, float], ...] = ()


Draw = Callable[[Field], str]


@dataclass(frozen=True)
class Symbol:
    """How a symbol is drawn, and the least room it takes."""

    draw: Draw
    width: float = 46.0
    height: float = 46.0


# -- small marks -----------------------------------------------------------------------------------


def tag(name: str, content: str = "", **attributes: Any) -> str:
    """An element; numbers are written short, `_` in a name stands for `-`."""
    written = "".join(
        f" {key.rstrip('_').replace('_', '-')}={quoteattr(_value(value))}"
        for key, value in attributes.items()
        if value is not None
    )
    return f"<{name}{written}>{content}</{name}>" if content else f"<{name}{written}/>"


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".").replace("-0", "-0") or "0"
    return str(value)


def printable(text: str) -> str:
    """Text without the control characters that XML cannot hold."""
    return "".join(
        letter if letter.isprintable() and not "\ud800" <= letter <= "\udfff" else " "
        for letter in text
    )


def words(
    x: float,
    y: float,
    text: str,
    size: float = 10.0,
    *,
    anchor: str = "middle",
    bold: bool = False,
    color: str = style.INK,
    **attributes: Any,
) -> str:
    """A line of text whose middle is at height y."""
    return tag(
        "text",
        escape(printable(text)),
        x=x,
        y=y + 0.36 * size,
        font_size=size,
        text_anchor=None if anchor == "start" else anchor,
        font_weight="bold" if bold else None,
        fill=color,
        **attributes,
    )


def text_width(text: str, size: float, bold: bool = False) -> float:
    """Width of a line of text in px, rounded up."""
    return math.ceil(sum(_advance(letter, bold) for letter in text) * size)


@lru_cache(maxsize=4096)
def _advance(letter: str, bold: bool) -> float:
    """Width of a letter in the font that the charts use, in ems; a letter it lacks is taken as wide."""
    font = get_font(findfont("DejaVu Sans:bold" if bold else "DejaVu Sans"))
    if not font.get_char_index(ord(letter)):
        return 1.1
    font.set_size(100, 72)
    glyph = font.load_char(ord(letter), flags=LoadFlags.NO_HINTING)
    return float(glyph.linearHoriAdvance) / 65536 / 100


def line(*points: tuple[float, float], **attributes: Any) -> str:
    """An open line through points."""
    path = "M" + "L".join(f"{_value(float(x))} {_value(float(y))}" for x, y in points)
    given = {"fill": "none", "stroke": style.INK, "stroke_width": STROKE, **attributes}
    return tag("path", d=path, **given)


def shape(*points: tuple[float, float], **attributes: Any) -> str:
    """A closed outline."""
    path = "M" + "L".join(f"{_value(float(x))} {_value(float(y))}" for x, y in points) + "Z"
    given = {"fill": FILL, "stroke": style.INK, "stroke_width": STROKE, **attributes}
    return tag("path", d=path, stroke_linejoin="round", **given)


def _box(field: Field, fill: str = FILL) -> str:
    return tag(
        "rect",
        x=0.0,
        y=0.0,
        width=field.width,
        height=field.height,
        rx=2.5,
        fill=fill,
        stroke=style.INK,
        stroke_width=STROKE,
    )


def _circle(field: Field, fill: str = FILL) -> str:
    r = min(field.width, field.height) / 2
    x = field.width - r
    return tag(
        "circle",
        cx=x,
        cy=field.height / 2,
        r=r,
        fill=fill,
        stroke=style.INK,
        stroke_width=STROKE,
    )


def _into(field: Field, points: Sequence[tuple[float, float]], inset: float = 9.0) -> list[Any]:
    """Points of a square of side 2 about the origin, y upwards, as points of the field's middle."""
    half = min(field.width, field.height) / 2 - inset
    x, y = field.width / 2, field.height / 2
    return [(x + half * a, y - half * b) for a, b in points]


def _axes(field: Field) -> str:
    thin = {"stroke": style.FRAME, "stroke_width": 0.8}
    return line(*_into(field, [(-1.15, 0), (1.15, 0)]), **thin) + line(
        *_into(field, [(0, -1.15), (0, 1.15)]), **thin
    )


# -- symbols ---------------------------------------------------------------------------------------

RECTANGLE = 11.0  # of an integrator, before its triangle


def _triangle(field: Field, left: float = 0.0) -> str:
    return shape((left, 0.0), (field.width, field.height / 2), (left, field.height))


def _integrator(field: Field) -> str:
    bar = tag(
        "rect",
        x=0.0,
        y=0.0,
        width=RECTANGLE,
        height=field.height,
        fill=TINT,
        stroke=style.INK,
        stroke_width=STROKE,
    )
    x = RECTANGLE + (field.width - RECTANGLE) * 0.36
    return bar + _triangle(field, RECTANGLE) + words(x, field.height / 2 - 1, "∫", 17)


def _summer(field: Field) -> str:
    return _triangle(field) + words(field.width * 0.36, field.height / 2, "Σ", 14)


def _amplifier(field: Field) -> str:
    return _triangle(field) + words(field.width * 0.36, field.height / 2, "A", 14)


def _inverter(field: Field) -> str:
    tip = field.width - 8
    body = shape((0.0, 0.0), (tip, field.height / 2), (0.0, field.height))
    dot = tag(
        "circle",
        cx=field.width - 4,
        cy=field.height / 2,
        r=4.0,
        fill=FILL,
        stroke=style.INK,
        stroke_width=STROKE,
    )
    return body + dot + words(tip * 0.36, field.height / 2, "−1", 10)


def _potentiometer(field: Field) -> str:
    size = min(11.0, 11.0 * (field.width - 7) / max(text_width(field.text, 11.0), 1))
    return _circle(field) + words(field.width / 2, field.height / 2, field.text, round(size, 1))


def _sign(text: str, size: float = 22.0) -> Draw:
    def draw(field: Field) -> str:
        return _box(field) + words(field.width / 2, field.height / 2, text, size)

    return draw


def _divider(field: Field) -> str:
    body = _box(field) + words(field.width / 2, field.height / 2, "÷", 22)
    return body + _marks(field, ("N", "D"))


def _angle(field: Field) -> str:
    body = _circle(field) + words(field.width / 2, field.height / 2, "∠", 17)
    return body + _marks(field, ("y", "x"))


def _marks(field: Field, marks: Sequence[str]) -> str:
    """Small letters at the inputs, where it matters which is which."""
    return "".join(
        words(3.0, y, mark, 7.5, anchor="start", color=style.MUTED)
        for y, mark in zip(field.ins, marks, strict=False)
    )


def _round(text: str) -> Draw:
    def draw(field: Field) -> str:
        return _circle(field) + words(field.width / 2, field.height / 2, text, 11)

    return draw


def _curve(*points: tuple[float, float], axes: bool = True, dashed: bool = False) -> Draw:
    def draw(field: Field) -> str:
        at = _into(field, points)
        bold = line(*at, stroke_width=1.8, stroke=style.PENS[0], stroke_linejoin="round")
        return _box(field) + (_axes(field) if axes else "") + bold

    return draw


def _function(field: Field) -> str:
    """The component's own points, as many as it has."""
    points = field.curve or ((-1.0, -0.8), (-0.2, 0.3), (1.0, 0.8))
    xs, ys = [x for x, _ in points], [y for _, y in points]

    def unit(value: float, values: Sequence[float]) -> float:
        span = max(values) - min(values)
        return 2 * (value - min(values)) / span - 1 if span > 0 else 0.0

    return _curve(*((unit(x, xs), unit(y, ys)) for x, y in points), axes=False)(field)


def _wave(points: Sequence[tuple[float, float]]) -> Draw:
    def draw(field: Field) -> str:
        at = _into(field, points, 8.0)
        return _circle(field, TINT) + line(
            *at, stroke_width=1.8, stroke=style.PENS[2], stroke_linejoin="round"
        )

    return draw


def _constant(field: Field) -> str:
    """A potentiometer at the reference: the bar is the reference terminal."""
    r, y = field.height / 2, field.height / 2
    x = field.width - 2 * r
    bar = line((0.0, y - 8), (0.0, y + 8), stroke_width=2.4) + line((0.0, y), (x, y))
    arrow = line((x + r - 8, y + 8), (x + r + 7, y - 7)) + shape(
        (x + r + 10, y - 10),
        (x + r + 3.5, y - 7.5),
        (x + r + 7.5, y - 3.5),
        fill=style.INK,
        stroke="none",
    )
    return bar + _circle(field, TINT) + arrow


def _comparator(field: Field) -> str:
    """A triangle with the steps it makes, one up and one down."""
    x, y = field.width * 0.34, field.height / 2
    down = line((x + 3, y - 8), (x - 4, y - 8), (x - 4, y + 8), stroke=style.PENS[0])
    return _comparator_at_one_level(field) + down


def _comparator_at_one_level(field: Field) -> str:
    """One without hysteresis, which goes up and down at the same place."""
    x, y = field.width * 0.34, field.height / 2
    corners = ((x - 11, y + 8), (x + 3, y + 8), (x + 3, y - 8), (x + 11, y - 8))
    return _triangle(field) + line(*corners, stroke=style.PENS[0])


def _switch(field: Field) -> str:
    """Two contacts and a blade, which the control (third input) moves."""
    w = field.width
    high, low, control = (*field.ins, field.height * 0.2, field.height * 0.5, field.height * 0.8)[
        :3
    ]
    middle = field.height / 2
    thin = {"stroke_dasharray": "3 2", "stroke": style.MUTED, "stroke_width": 1.0}
    blade = (w * 0.30 + w * 0.68) / 2, (high + middle) / 2
    parts = [
        _box(field),
        line((0.0, high), (w * 0.30, high)),
        line((0.0, low), (w * 0.30, low)),
        line((w * 0.70, middle), (w, middle)),
        line((w * 0.70, middle), (w * 0.33, high + 2.5), stroke_width=1.8),
        line((0.0, control), (blade[0], control), (blade[0], blade[1] + 2), **thin),
    ]
    for at in ((w * 0.30, high), (w * 0.30, low), (w * 0.70, middle)):
        parts.append(
            tag("circle", cx=at[0], cy=at[1], r=2.2, fill=FILL, stroke=style.INK, stroke_width=1.2)
        )
    return "".join(parts)


def _track(field: Field) -> str:
    """Follows, then holds."""
    wave = [(-1, -0.6), (-0.7, 0.0), (-0.4, 0.5), (-0.1, 0.6), (0.35, 0.6)]
    wave += [(0.35, 0.6), (0.5, -0.2), (0.75, -0.5), (1, -0.3)]
    at = _into(field, wave, 10.0)
    curve = line(*at, stroke_width=1.8, stroke=style.PENS[0], stroke_linejoin="round")
    return _box(field) + curve + words(field.width / 2, field.height - 8, "T/S", 8)


def _pentagon(text: str, color: str) -> Draw:
    def draw(field: Field) -> str:
        w, h = field.width, field.height
        outline = ((0.0, 0.0), (w - 14, 0.0), (w, h / 2), (w - 14, h), (0.0, h))
        return shape(*outline, fill=TINT, stroke=color) + words(
            w / 2 - 4, h / 2, text, 11, bold=True, color=color
        )

    return draw


def _other(field: Field) -> str:
    """A kind without a symbol of its own: its name in a box."""
    size = min(10.0, 10.0 * (field.width - 8) / max(text_width(field.text, 10.0), 1))
    return _box(field) + words(field.width / 2, field.height / 2, field.text, round(size, 1))


_SINE = [(x / 8, 0.75 * math.sin(math.pi * x / 8)) for x in range(-8, 9)]
_NOISE = [
    (x / 6 - 1, y)
    for x, y in enumerate((0, 0.5, -0.3, 0.7, 0.1, -0.6, 0.4, -0.7, 0.2, 0.6, -0.5, 0.3, 0))
]
_LAG = [(x / 8, 1.6 * (1 - math.exp(-(x + 8) / 4)) - 0.8) for x in range(-8, 9)]

# By key of the component; those of kinds that are only planned cost nothing.
SYMBOLS: Mapping[str, Symbol] = MappingProxyType(
    {
        "constant": Symbol(_constant, 46.0, 34.0),
        "step": Symbol(_wave([(-1, -0.6), (0, -0.6), (0, 0.6), (1, 0.6)]), 40.0, 40.0),
        "ramp": Symbol(_wave([(-1, -0.6), (-0.5, -0.6), (0.5, 0.6), (1, 0.6)]), 40.0, 40.0),
        "pulse": Symbol(
            _wave([(-1, -0.5), (-0.3, -0.5), (-0.3, 0.6), (0.3, 0.6), (0.3, -0.5), (1, -0.5)]),
            40.0,
            40.0,
        ),
        "sawtooth": Symbol(
            _wave([(-1, -0.6), (0, 0.6), (0, -0.6), (1, 0.6), (1, -0.6)]), 40.0, 40.0
        ),
        "sine": Symbol(_wave(_SINE), 40.0, 40.0),
        "square": Symbol(
            _wave([(-1, -0.6), (-1, 0.6), (0, 0.6), (0, -0.6), (1, -0.6), (1, 0.6)]), 40.0, 40.0
        ),
        "noise_source": Symbol(_wave(_NOISE), 40.0, 40.0),
        "sum": Symbol(_summer, 46.0, 46.0),
        "coefficient": Symbol(_potentiometer, 40.0, 40.0),
        "amplify": Symbol(_amplifier, 46.0, 46.0),
        "invert": Symbol(_inverter, 44.0, 38.0),
        "integrate": Symbol(_integrator, 60.0, 48.0),
        "lag": Symbol(_curve(*_LAG, axes=False)),
        "delay": Symbol(_sign("e⁻ˢᵀ", 14.0)),
        "multiply": Symbol(_sign("×")),
        "divide": Symbol(_divider),
        "square_root": Symbol(_sign("√", 19.0)),
        "sin": Symbol(_round("sin"), 42.0, 42.0),
        "cos": Symbol(_round("cos"), 42.0, 42.0),
        "atan2": Symbol(_angle, 42.0, 42.0),
        "function": Symbol(_function),
        "absolute": Symbol(_curve((-1, 1), (0, 0), (1, 1))),
        "limit": Symbol(_curve((-1.1, -0.7), (-0.6, -0.7), (0.6, 0.7), (1.1, 0.7))),
        "dead_zone": Symbol(_curve((-1.1, -0.8), (-0.4, 0), (0.4, 0), (1.1, 0.8))),
        "backlash": Symbol(
            _curve((-1.1, -0.8), (-0.5, -0.8), (1.0, 0.8), (0.4, 0.8), (-1.1, -0.8), (-0.5, -0.8))
        ),
        "compare": Symbol(_comparator, 54.0, 50.0),
        "compare at one level": Symbol(_comparator_at_one_level, 54.0, 50.0),
        "switch": Symbol(_switch, 50.0, 54.0),
        "track": Symbol(_track, 46.0, 46.0),
        "adc": Symbol(_pentagon("A/D", style.PENS[2]), 58.0, 34.0),
        "dac": Symbol(_pentagon("D/A", style.PENS[1]), 58.0, 34.0),
    }
)
OTHER = Symbol(_other, 58.0, 46.0)
