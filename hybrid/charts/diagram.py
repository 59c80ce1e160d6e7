"""The patch diagram: every component by its customary symbol, every cord, and the digital program.

What stands in the patch becomes boxes and cords (`Sheet`), `layered` places them, and the sheet is
written as SVG. Figures are in the units in which the signals are shown; a coefficient of 1 is not
written. The same patch gives the same bytes, in whatever order its entries stand.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from hybrid.charts import style
from hybrid.charts.layered import Box, Cord, Net, Plan, Point, Route, lay_out
from hybrid.charts.programs import ProgramBox, adcs_served, drawn, program_boxes, sender_of
from hybrid.charts.style import number, unit_text
from hybrid.charts.symbols import (
    FONT,
    OTHER,
    SYMBOLS,
    Field,
    line,
    printable,
    tag,
    text_width,
    words,
)
from hybrid.components import CATALOG
from hybrid.errors import RunError
from hybrid.expressions import to_text
from hybrid.modes import LOGIC
from hybrid.naming import on_text, stem_of
from hybrid.patch import Adc, Component, Dac, Patch, Value
from hybrid.storage import write_whole

NAME_SIZE, SMALL_SIZE, PILL_SIZE = 11.0, 9.0, 9.0
LINE = 12.0  # between lines below a symbol
NAME_WIDTH = 15  # letters of a name on one line
PILL_HEIGHT = 16.0
EDGE = 30.0  # of the paper
HEAD = 78.0  # title and provenance
FOOT = 46.0

# What the heading counts, by its customary name.
COUNTED_FIRST = ("integrator", "summer", "inverter", "potentiometer", "multiplier")
COUNTED_AS = {
    "absolute": "absolute value",
    "dead_zone": "dead zone",
    "square_root": "square root",
}

CORD_COLORS = (*style.PENS, "#9A2F4C", "#6B7A1E")

# What it costs the layout to run the output of a component back to the left: least for a
# converter's held output and for integrators, at which a loop is customarily cut.
CUT_HELD, CUT_STATE, CUT_OTHER = 0.6, 1.0, 8.0


class Svg(str):
    """SVG text that a notebook shows as a picture."""

    def _repr_svg_(self) -> str:
        return str(self)


def draw(patch: Patch, parameters: Mapping[str, float] | None = None) -> Svg:
    """The diagram of a patch as SVG text; `parameters` (SI) replace the patch's own.

    Raises PatchError for a parameter that the patch does not have or a value not allowed.
    """
    sheet = Sheet(patch, patch.bind(parameters))
    return Svg(sheet.svg(lay_out(sheet.boxes, sheet.cords)))


def save_diagram(
    patch: Patch, parameters: Mapping[str, float] | None, path: str | Path | None
) -> str:
    """Write the diagram, by default to the patch's name with .svg; returns the file's name."""
    if path is not None and not str(path).strip():
        raise RunError("--out is empty; name an SVG file")
    target = Path(path or f"{stem_of(patch)}.svg")
    if target.suffix.lower() != ".svg":
        raise RunError(f"--out {target} must be an SVG file, ending in .svg")
    text = draw(patch, parameters)
    write_whole(target, lambda part: Path(part).write_text(text, encoding="utf-8", newline="\n"))
    return str(target)


@dataclass(frozen=True)
class Part:
    """One symbol with its text: everything lies within `box`, measured from its top left corner."""

    box: Box
    key: str
    symbol: tuple[float, float, float, float]  # left, top, width, height
    names: tuple[str, ...]  # the signal's name, in lines
    below: tuple[str, ...] = ()
    above: str = ""
    text: str = ""
    curve: tuple[tuple[float, float], ...] = ()
    tip: str = ""


@dataclass(frozen=True)
class Pill:
    """A coefficient on a cord."""

    text: str
    tip: str


@dataclass
class Sheet:
    """The patch as boxes and cords, and the sheet they are drawn on."""

    patch: Patch
    scope: dict[str, float]
    parts: dict[str, Part] = field(default_factory=dict)
    cords: list[Cord] = field(default_factory=list)
    pills: dict[Cord, Pill] = field(default_factory=dict)
    programs: dict[str, ProgramBox] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.shown = {part.name: (part.unit, part.factor) for part in self.patch.analog_parts}
        boxes = program_boxes(self.patch, self.scope)
        self.computed_by = {row.word: each.box.name for each in boxes for row in each.rows}
        self.sampled_by = adcs_served(self.patch, self.scope)
        for component in self.patch.components:
            self._add_component(component)
        for adc in self.patch.adcs:
            self._add_adc(adc)
        for dac in self.patch.dacs:
            self._add_dac(dac)
        for program in boxes:
            self._add_program(program)

    @property
    def boxes(self) -> list[Box]:
        """What is to be placed."""
        return [part.box for part in self.parts.values()]

    # -- the parts

    def _add_component(self, component: Component) -> None:
        name, kind = component.name, component.kind
        # What is taken zero times has no cord; a part of which nothing would be left shows them all.
        taken = [(s, v) for s, v in component.terms if v.number(self.scope)]
        inputs: list[tuple[str, Value | None]] = [*(taken or component.terms)]
        inputs += [(signal, None) for signal in component.signals]
        # What sets a mode comes in as a control does; the machine's own mode needs no cord.
        others = (component.initial_signal, *component.controls)
        inputs += [(signal, None) for signal in others if signal in self.shown]
        cords = [Cord(s, s, name, place) for place, (s, _) in enumerate(inputs)]
        pills: dict[Cord, Pill] = {}
        text = CATALOG[kind].key
        for cord, (source, value) in zip(cords, inputs, strict=True):
            if value is None:
                continue
            figure = value.number(self.scope) * self.shown[source][1] / component.factor
            if kind == "coefficient":
                text = number(figure, 4)
            elif kind != "invert" and not abs(figure - 1.0) < 1e-12:
                pills[cord] = Pill(number(figure, 4), to_text(value.expr))
        symmetric = bool(component.terms) or kind == "multiply"
        curve = tuple((x.number(self.scope), y.number(self.scope)) for x, y in component.points)
        self._add(
            name,
            kind,
            cords,
            pills,
            below=(self._scale(component), *self._details(component)),
            above=self._initial(component) if kind == "integrate" else "",
            text=text,
            curve=tuple(sorted(curve)),
            any_order=symmetric,
            cut=CUT_STATE if kind in ("integrate", "lag", "track") else CUT_OTHER,
            tip=f"{name}: {CATALOG[kind].doc}",
        )

    def _add_adc(self, adc: Adc) -> None:
        cords = [Cord(adc.source, adc.source, adc.name, 0)]
        bits = f"{adc.bits} bit" if adc.bits else ""
        task = self.sampled_by.get(adc.name)
        below = tuple(filter(None, (bits, f"sampled by {task}" if task else "")))
        self._add(adc.name, "adc", cords, {}, below=below, tip=f"{adc.name}: A-D converter")

    def _add_dac(self, dac: Dac) -> None:
        cords = [Cord(self.computed_by[dac.word], dac.word, dac.name, 0)]
        task = sender_of(dac, self.patch.program)
        told = (f"{dac.bits} bit" if dac.bits else "", f"sent by {task}" if task else "")
        below = (self._scale(dac), *filter(None, told))
        tip = f"{dac.name}: D-A converter"
        self._add(dac.name, "dac", cords, {}, below=below, cut=CUT_HELD, tip=tip)

    def _add(
        self,
        name: str,
        key: str,
        cords: Sequence[Cord],
        pills: Mapping[Cord, Pill],
        *,
        below: tuple[str, ...] = (),
        above: str = "",
        text: str = "",
        curve: tuple[tuple[float, float], ...] = (),
        any_order: bool = False,
        cut: float = CUT_OTHER,
        tip: str = "",
    ) -> None:
        symbol = SYMBOLS.get(key, OTHER)
        pitch = PILL_HEIGHT + 3 if pills else 14.0
        height = max(symbol.height, pitch * len(cords) + (12 if pills else 4))
        width = symbol.width * min(max(height / symbol.height, 1.0), 1.6)
        if key == "coefficient":
            width = height = max(symbol.width, min(text_width(text, 11.0) + 8, 56.0))
        width, height = float(round(width)), float(2 * round(height / 2))
        pill_width = max((text_width(p.text, PILL_SIZE) + 10 for p in pills.values()), default=0)
        pill_width += 6 if pill_width else 0
        names = tuple(_lines(name))
        texts = [text_width(line_, NAME_SIZE, bold=True) for line_ in names]
        texts += [text_width(line_, SMALL_SIZE) for line_ in below]
        half = max([width / 2, *(t / 2 for t in texts)]) + 1
        top = LINE + 6 if above else 0.0
        if above:
            half = max(half, text_width(above, SMALL_SIZE) / 2 + 1)
        # The symbol stands in the middle of its texts; coefficients come before it.
        left = max(pill_width, half - width / 2)
        whole = left + width / 2 + half
        count = len(cords)
        ins = tuple(
            top
            + float(
                round(
                    height * (place + 0.5) / count if count < 3 else _spread(height, place, count)
                )
            )
            for place in range(count)
        )
        total = top + height + 4 + LINE * len(names) + LINE * len(below)
        box = Box(
            name,
            float(round(whole)),
            float(round(total)),
            ins,
            {name: top + height / 2},
            any_order,
            cut,
        )
        at = (float(round(left)), top, width, height)
        self.parts[name] = Part(box, key, at, names, below, above, text, curve, tip)
        self.cords += cords
        self.pills |= pills

    def _add_program(self, program: ProgramBox) -> None:
        box = program.box
        self.programs[box.name] = program
        self.parts[box.name] = Part(box, "program", (0.0, 0.0, box.width, box.height), ())
        self.cords += program.cords

    # -- their figures

    def _scale(self, part: Component | Dac) -> str:
        figure = part.full_scale.number(self.scope) / part.factor
        return f"±{number(figure, 4)} {unit_text(part.unit)}".rstrip()

    def _own(self, component: Component, key: str) -> str:
        """A quantity of the component in its own unit."""
        value = component.values[key].number(self.scope) / component.factor
        return f"{number(value, 4)} {unit_text(component.unit)}".rstrip()

    def _initial(self, component: Component) -> str:
        """What an integrator begins with: a figure, or the signal that it follows in IC."""
        return component.initial_signal or self._own(component, "initial")

    def _details(self, component: Component) -> list[str]:
        """What else the symbol stands for, a line each."""
        values, kind = component.values, component.kind
        told: list[str] = []

        def si(key: str) -> float:
            return values[key].number(self.scope)

        def bare(key: str) -> str:
            return number(si(key) / component.factor, 4) if key in values else "0"

        if kind == "constant":
            told.append(f"= {self._own(component, 'constant')}")
        elif kind == "step":
            told.append(f"{bare('before')} → {bare('step')} at {style.duration(si('at'))}")
        elif kind == "sine":
            rate = f"{number(si('omega'), 4)} rad/s" if "omega" in values else ""
            rate = rate or f"{number(si('frequency'), 4)} Hz"
            told.append(f"{bare('sine')} at {rate}")
        elif kind == "square":
            told.append(f"{bare('square')} every {style.duration(si('period'))}")
        elif kind == "ramp":
            rate = number(si("ramp") / component.factor, 4)
            told.append(f"{rate} 1/s from {style.duration(si('at') if 'at' in values else 0.0)}")
        elif kind == "pulse":
            when = f"at {style.duration(si('at'))} for {style.duration(si('width'))}"
            told.append(f"{bare('before')} → {bare('pulse')} {when}")
            if "period" in values:
                told.append(f"every {style.duration(si('period'))}")
        elif kind == "sawtooth":
            told.append(f"{bare('sawtooth')} every {style.duration(si('period'))}")
        elif kind == "backlash":
            told.append(f"play {bare('width')}")
        elif kind == "multiply" and "quarter_square" in values:
            told.append(f"{si('quarter_square'):g} segments")
        elif kind in ("divide", "square_root") and "circuit" in values and si("circuit"):
            told.append("in feedback")
        elif kind == "noise_source":
            told.append(f"{bare('noise_source')} rms, {number(si('bandwidth'), 4)} rad/s")
        elif kind == "delay":
            told.append(f"T = {style.duration(si('time'))}")
        elif kind == "lag":
            told.append(f"τ = {style.duration(si('time_constant'))}")
        elif kind in ("limit", "dead_zone", "compare"):
            told.append(f"{bare('low')} … {bare('high')}")
        elif kind == "integrate":
            if "low" in values or "high" in values:
                low = bare("low") if "low" in values else "−∞"
                high = bare("high") if "high" in values else "∞"
                told.append(f"stops at {low} … {high}")
            if "leak" in values and si("leak"):
                told.append(f"leak {number(si('leak'), 4)} 1/s")
        told += [name for name in component.controls if name in LOGIC and name not in self.shown]
        if "hysteresis" in values and si("hysteresis"):
            told.append("with hysteresis")
        if "gain" in values:
            ins = [self.shown[signal][1] for signal in component.signals]
            factor = {
                "square_root": ins[0] ** 0.5,
                "atan2": 1.0,
                "multiply": ins[0] * ins[-1],
                "divide": ins[0] / ins[-1],
            }[kind]
            told.append(f"gain {number(si('gain') * factor / component.factor, 4)}")
        if kind in ("sin", "cos") and "amplitude" in values:
            told.append(f"amplitude {bare('amplitude')}")
        return told

    def outlines(self, plan: Plan) -> Iterator[tuple[str, str, tuple[float, float, float, float]]]:
        """What is drawn over the cords: signal, 'symbol', 'label' or 'coefficient', and its
        left, top, right and bottom on the plan."""
        for name, part in self.parts.items():
            x, y = plan.places[name]
            left, top, width, height = part.symbol
            yield name, "symbol", (x + left, y + top, x + left + width, y + top + height)
            if part.key == "program":
                continue
            middle, at = x + left + width / 2, y + top + height + 4
            texts = [(text, NAME_SIZE, True) for text in part.names]
            texts += [(text, SMALL_SIZE, False) for text in part.below]
            for place, (text, size, bold) in enumerate(texts):
                half = text_width(text, size, bold) / 2
                upper = at + LINE * place
                yield name, "label", (middle - half, upper, middle + half, upper + LINE)
            if part.above:
                half = text_width(part.above, SMALL_SIZE) / 2
                yield name, "label", (middle - half, y, middle + half, y + LINE)
        for route in plan.routes:
            if route.cord in self.pills:
                yield route.cord.target, "coefficient", self._pill_outline(route, plan)

    def _pill_outline(self, route: Route, plan: Plan) -> tuple[float, float, float, float]:
        part = self.parts[route.cord.target]
        x, y = plan.places[route.cord.target]
        right, y = x + part.symbol[0] - 6, y + part.box.ins[route.place]
        width = max(text_width(self.pills[route.cord].text, PILL_SIZE) + 10, PILL_HEIGHT)
        return right - width, y - PILL_HEIGHT / 2, right, y + PILL_HEIGHT / 2

    # -- the sheet

    def svg(self, plan: Plan) -> str:
        """The sheet as SVG: heading, cords, dots, symbols."""
        heading = self._heading()
        wide = max(
            text_width(heading[0], 20.0, bold=True), *(text_width(h, 10) for h in heading[1:])
        )
        width = max(plan.width, wide) + 2 * EDGE
        height = HEAD + plan.height + FOOT + EDGE
        left = EDGE + (width - 2 * EDGE - plan.width) / 2
        left = float(round(left))
        colors = _cord_colors(plan)
        body = [
            tag("rect", x=0, y=0, width=width, height=height, fill="#FFFFFF"),
            tag(
                "rect",
                x=9.5,
                y=9.5,
                width=width - 19,
                height=height - 19,
                rx=4,
                fill="none",
                stroke=style.FRAME,
            ),
            words(EDGE, 36, heading[0], 20, anchor="start", bold=True),
            words(EDGE, 58, heading[1], 10, anchor="start", color=style.MUTED),
            words(EDGE, height - 26, heading[2], SMALL_SIZE, anchor="start", color=style.MUTED),
        ]
        inner = self._cords(plan, colors)
        inner += [tag("circle", cx=x, cy=y, r=3.0, fill=colors[net]) for net, (x, y) in plan.dots]
        for route in plan.routes:
            if route.cord in self.pills:
                inner.append(self._pill(route, plan, colors[route.cord.net]))
        came: dict[str, dict[int, str]] = {name: {} for name in self.programs}
        for route in plan.routes:
            came.get(route.cord.target, {})[route.place] = route.cord.port
        for name, part in sorted(self.parts.items()):
            at = plan.places[name]
            if name in self.programs:
                box = drawn(self.programs[name], came[name])
                inner.append(tag("g", box, transform=f"translate({at[0]:g} {at[1]:g})"))
            else:
                inner.append(self._part(part, at))
        body.append(tag("g", "\n".join(inner), transform=f"translate({left:g} {HEAD:g})"))
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
                aria_label=printable(f"Patch diagram: {self.patch.title}"),
            )
            + "\n"
        )

    def _heading(self) -> tuple[str, str, str]:
        counts = dict.fromkeys(COUNTED_FIRST, 0)
        for component in sorted(self.patch.components, key=lambda component: component.kind):
            name = COUNTED_AS.get(component.kind, CATALOG[component.kind].symbol)
            counts[name] = counts.get(name, 0) + 1
        counts["A-D converter"] = len(self.patch.adcs)
        counts["D-A converter"] = len(self.patch.dacs)
        told = [
            f"{count} {name if count == 1 or name == 'track-store' else _plural(name)}"
            for name, count in counts.items()
            if count
        ]
        file = self.patch.file.replace("\\", "/").rpartition("/")[2]
        file = "" if file.startswith("<") else file  # text that came from no file
        facts = "  ·  ".join(filter(None, (file, on_text(self.patch.on), ",  ".join(told))))
        note = (
            "Below each name: full scale. Figures in circles and on cords are coefficients in the "
            "units shown; 1 is not written. Above an integrator: its initial value."
        )
        return self.patch.title or file or "Patch", facts, note

    def _cords(self, plan: Plan, colors: Mapping[Net, str]) -> list[str]:
        """Every cord as a line; from where it shares an earlier one of its net, it is left out."""
        drawn: dict[Net, list[tuple[Point, Point]]] = {}
        found = []
        for route in plan.routes:
            cord = route.cord
            source, target = self.parts[cord.source], self.parts[cord.target]
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

    def _pill(self, route: Route, plan: Plan, color: str) -> str:
        pill = self.pills[route.cord]
        left, top, right, bottom = self._pill_outline(route, plan)
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

    def _part(self, part: Part, at: Point) -> str:
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


def _spread(height: float, place: int, count: int) -> float:
    """Inputs of one symbol evenly, a little off its corners."""
    inset = min(10.0, height / (2 * count))
    return inset + (height - 2 * inset) * place / (count - 1)


def _lines(name: str) -> list[str]:
    """A name in lines of some fifteen letters, broken after parts and underscores where it has any."""
    lines: list[str] = []
    while len(name) > NAME_WIDTH + 3:
        cut = name.find(".", 0, NAME_WIDTH) + 1 or name.rfind("_", 4, NAME_WIDTH) + 1 or NAME_WIDTH
        lines.append(name[:cut])
        name = name[cut:]
    return [*lines, name]


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
