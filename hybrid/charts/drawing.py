"""The sheet on paper: heading, cords, dots, symbols, as SVG."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

from hybrid.charts import style
from hybrid.charts.layered import Net, Plan, Point, Route
from hybrid.charts.modebox import drawn_modes
from hybrid.charts.programs import drawn
from hybrid.charts.sheet import LINE, NAME_SIZE, PILL_HEIGHT, PILL_SIZE, SMALL_SIZE, Part, Sheet
from hybrid.charts.symbols import (
    FONT,
    OTHER,
    RECTANGLE,
    SYMBOLS,
    Field,
    line,
    printable,
    tag,
    text_width,
    words,
)
from hybrid.components import CATALOG
from hybrid.naming import on_text

EDGE = 30.0  # of the paper
HEAD = 78.0  # title and provenance
FOOT = 46.0

# What the heading counts, by its customary name.
COUNTED_FIRST = ("integrator", "summer", "inverter", "coefficient", "multiplier")
# A potentiometer is what a coefficient is set on, of whatever component: `check` counts those.
COUNTED_AS = {"potentiometer": "coefficient"}

CORD_COLORS = (*style.PENS, "#9A2F4C", "#6B7A1E")


def svg(sheet: Sheet, plan: Plan) -> str:
    """The sheet as SVG: heading, cords, dots, symbols."""
    heading = _heading(sheet)
    wide = max(text_width(heading[0], 20.0, bold=True), *(text_width(h, 10) for h in heading[1:]))
    width = max(plan.width, wide) + 2 * EDGE
    height = HEAD + plan.height + FOOT + EDGE + LINE * (len(heading) - 3)
    left = EDGE + (width - 2 * EDGE - plan.width) / 2
    left = float(round(left))
    inner = _inner(sheet, plan)
    body = [
        *_paper(width, height, heading),
        tag("g", "\n".join(inner), transform=f"translate({left:g} {HEAD:g})"),
    ]
    return (
        tag(
            "svg",
            "\n" + "\n".join(body) + "\n",
            xmlns="http://www.w3.org/2000/svg",
            width=width,
            height=height,
            viewBox=f"0 0 {width:g} {height:g}",
            font_family=FONT,
            role="img",
            aria_label=printable(f"Patch diagram: {sheet.patch.title}"),
        )
        + "\n"
    )


def _paper(width: float, height: float, heading: tuple[str, ...]) -> list[str]:
    """The sheet itself, its frame and what is written on its edges."""
    wide, high = width - 19, height - 19
    notes = enumerate(reversed(heading[2:]))
    return [
        tag("rect", x=0, y=0, width=width, height=height, fill="#FFFFFF"),
        tag("rect", x=9.5, y=9.5, width=wide, height=high, rx=4, fill="none", stroke=style.FRAME),
        words(EDGE, 36, heading[0], 20, anchor="start", bold=True),
        words(EDGE, 58, heading[1], 10, anchor="start", color=style.MUTED),
        *(
            words(EDGE, height - 26 - LINE * n, note, SMALL_SIZE, anchor="start", color=style.MUTED)
            for n, note in notes
        ),
    ]


def _inner(sheet: Sheet, plan: Plan) -> list[str]:
    """Cords, dots, coefficients, and the symbols over them."""
    colors = _cord_colors(plan)
    inner = _cords(sheet, plan, colors)
    inner += [tag("circle", cx=x, cy=y, r=3.0, fill=colors[net]) for net, (x, y) in plan.dots]
    for route in plan.routes:
        if route.cord in sheet.pills:
            inner.append(_pill(sheet, route, plan, colors[route.cord.net]))
    came: dict[str, dict[int, str]] = {name: {} for name in sheet.programs}
    for route in plan.routes:
        came.get(route.cord.target, {})[route.place] = route.cord.port
    for name, part in sorted(sheet.parts.items()):
        at = plan.places[name]
        if name in sheet.programs:
            box = drawn(sheet.programs[name], came[name])
            inner.append(tag("g", box, transform=f"translate({at[0]:g} {at[1]:g})"))
        elif sheet.modes and part.box is sheet.modes.box:
            box = drawn_modes(sheet.modes)
            inner.append(tag("g", box, transform=f"translate({at[0]:g} {at[1]:g})"))
        else:
            inner.append(_part(part, at))
    inner += [_mark(sheet, route, plan) for route in plan.routes if route.cord in sheet.marks]
    return inner


def _mark(sheet: Sheet, route: Route, plan: Plan) -> str:
    """The letter of a terminal, within the symbol where its cord ends."""
    part, (x, y) = sheet.parts[route.cord.target], plan.places[route.cord.target]
    mark = sheet.marks[route.cord]
    middle, at = x + part.symbol[0] + RECTANGLE / 2, y + part.box.ins[route.place]
    return words(middle, at, mark, 8.0, bold=True, color=style.PENS[1], data_terminal=mark)


def _heading(sheet: Sheet) -> tuple[str, ...]:
    """Title and facts above, and one or two lines of notes below."""
    counts = dict.fromkeys(COUNTED_FIRST, 0)
    for component in sorted(sheet.patch.components, key=lambda component: component.kind):
        symbol = CATALOG[component.kind].symbol
        name = COUNTED_AS.get(symbol, symbol)
        counts[name] = counts.get(name, 0) + 1
    counts["A-D converter"] = len(sheet.patch.adcs)
    counts["D-A converter"] = len(sheet.patch.dacs)
    told = [
        f"{count} {name if count == 1 else _plural(name)}"
        for name, count in counts.items()
        if count
    ]
    file = sheet.patch.file.replace("\\", "/").rpartition("/")[2]
    file = "" if file.startswith("<") else file  # text that came from no file
    facts = "  ·  ".join(filter(None, (file, on_text(sheet.patch.on), ",  ".join(told))))
    note = (
        "Below each name: full scale. Figures in circles and in rounded boxes on cords are coefficients "
        "in the units shown; 1 is not written. Above an integrator: its initial value."
    )
    return sheet.patch.title or file or "Patch", facts, note, *_more_notes(sheet)


def _more_notes(sheet: Sheet) -> list[str]:
    """A second line of notes, where there is more to explain."""
    explained = {
        "R": "R resets it to its initial value (IC) while high",
        "H": "H holds it (HOLD) while high",
        "I": "I is its initial value",
    }
    there = set(sheet.marks.values())
    told = [text for mark, text in explained.items() if mark in there]
    notes = [f"Terminals of an integrator that add nothing: {', '.join(told)}."] if told else []
    if any(component.kind == "compare" for component in sheet.patch.components):
        notes.append("A comparator rises and falls at these levels of its sum, in SI units.")
    return [" ".join(notes)] if notes else []


def _cords(sheet: Sheet, plan: Plan, colors: Mapping[Net, str]) -> list[str]:
    """Every cord as a line; from where it shares an earlier one of its net, it is left out."""
    drawn: dict[Net, list[tuple[Point, Point]]] = {}
    found = []
    for route in plan.routes:
        cord = route.cord
        source, target = sheet.parts[cord.source], sheet.parts[cord.target]
        (x0, _), (x1, _) = plan.places[cord.source], plan.places[cord.target]
        start = (x0 + source.symbol[0] + source.symbol[2], route.points[0][1])
        end = (x1 + target.symbol[0], route.points[-1][1])
        points = _corners([start, *route.points[1:-1], end])
        before = drawn.setdefault(cord.net, [])
        rest = _not_drawn(points, before)
        before += list(itertools.pairwise(rest))
        found.append(
            line(
                *rest,
                stroke=colors[cord.net],
                stroke_width=1.5,
                stroke_linejoin="round",
                data_cord=f"{cord.port}>{cord.target}",
            )
        )
    return found


def _pill(sheet: Sheet, route: Route, plan: Plan, color: str) -> str:
    pill = sheet.pills[route.cord]
    left, top, right, bottom = sheet.pill_outline(route, plan)
    outline = tag(
        "rect",
        x=left,
        y=top,
        width=right - left,
        height=bottom - top,
        rx=PILL_HEIGHT / 2,
        fill="#FFFFFF",
        stroke=color,
        stroke_width=1.2,
    )
    text = words((left + right) / 2, (top + bottom) / 2, pill.text, PILL_SIZE)
    return tag("g", _title(pill.tip) + outline + text)


def _part(part: Part, at: Point) -> str:
    left, top, width, height = part.symbol
    symbol = SYMBOLS.get(part.key, OTHER)
    ins = tuple(y - top for y in part.box.ins)
    drawn = symbol.draw(Field(width, height, ins, part.text, part.curve))
    inner = [_title(part.tip), tag("g", drawn, transform=f"translate({left:g} {top:g})")]
    middle, y = left + width / 2, top + height + 4 + LINE / 2
    lines = "".join(
        tag("tspan", printable(text), x=middle, dy=LINE if place else None)
        for place, text in enumerate(part.names)
    )
    inner.append(
        tag(
            "text",
            lines,
            x=middle,
            y=y + 0.36 * NAME_SIZE,
            font_size=NAME_SIZE,
            font_weight="bold",
            text_anchor="middle",
            fill=style.INK,
            data_signal=part.box.name,
        )
    )
    y += LINE * len(part.names)
    for text in part.below:
        inner.append(words(middle, y, text, SMALL_SIZE, color=style.MUTED))
        y += LINE
    if part.above:
        x = left + 5.5
        inner.append(line((x, top), (x, top - 5), stroke_width=1.0, stroke=style.MUTED))
        inner.append(words(middle, LINE / 2, part.above, SMALL_SIZE, color=style.PENS[1]))
    return tag("g", "".join(inner), transform=f"translate({at[0]:g} {at[1]:g})")


def _corners(points: Sequence[Point]) -> list[Point]:
    return [point for point, _ in itertools.groupby(points)]


def _not_drawn(points: Sequence[Point], drawn: Sequence[tuple[Point, Point]]) -> list[Point]:
    """What is left of a line from where it leaves lines that are drawn already."""
    for place, (a, b) in enumerate(itertools.pairwise(points)):
        along = a
        while along != b:
            ahead = [end for piece in drawn for end in [_shared(along, b, piece)] if end]
            if not ahead:
                return [along, *points[place + 1 :]]
            along = max(ahead, key=lambda p, o=along: abs(p[0] - o[0]) + abs(p[1] - o[1]))  # type: ignore[misc]
    return [points[-1], points[-1]]


def _shared(a: Point, b: Point, piece: tuple[Point, Point]) -> Point | None:
    """How far the line from a towards b runs along a piece that is drawn; None if not at all."""
    for axis in (0, 1):
        other = 1 - axis
        low, high = sorted((piece[0][axis], piece[1][axis]))
        level = {a[other], b[other], piece[0][other], piece[1][other]}
        if len(level) == 1 and low <= a[axis] <= high and low < high:
            end = min(b[axis], high) if b[axis] > a[axis] else max(b[axis], low)
            if end != a[axis]:
                return (end, a[1]) if axis == 0 else (a[0], end)
    return None


def _escaped(text: str) -> str:
    from xml.sax.saxutils import escape

    return escape(printable(text))


def _title(text: str) -> str:
    return tag("title", _escaped(text)) if text else ""


def _plural(name: str) -> str:
    return name + ("es" if name.endswith(("ch", "s")) else "s")


def _cord_colors(plan: Plan) -> dict[Net, str]:
    """A colour for each net, unlike those of its neighbours as far as there are colours."""
    beside: dict[Net, dict[Net, int]] = {route.cord.net: {} for route in plan.routes}
    for (a, b), count in plan.near_nets.items():
        beside[a][b] = beside[b][a] = count
    chosen: dict[Net, int] = {}
    for place, net in enumerate(sorted(beside)):
        uses = [0] * len(CORD_COLORS)
        for other, count in beside[net].items():
            if other in chosen:
                uses[chosen[other]] += count
        first = place % len(CORD_COLORS)
        chosen[net] = min(
            range(len(CORD_COLORS)), key=lambda c: (uses[c], (c - first) % len(CORD_COLORS))
        )
    return {net: CORD_COLORS[c] for net, c in chosen.items()}
