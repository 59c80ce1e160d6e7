"""The patch as boxes and cords: its symbols with their texts, and the coefficients on the cords.

Figures are in the units in which the signals are shown; a coefficient of 1 is not written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from hybrid.charts.details import Figures, details
from hybrid.charts.layered import Box, Cord, Plan, Route
from hybrid.charts.modebox import ModeBox, mode_box
from hybrid.charts.programs import ProgramBox, adcs_served, program_boxes, sender_of
from hybrid.charts.style import number, unit_text
from hybrid.charts.symbols import OTHER, SYMBOLS, text_width
from hybrid.components import CATALOG
from hybrid.expressions import to_text
from hybrid.patch import Adc, Component, Dac, Patch, Value

NAME_SIZE, SMALL_SIZE, PILL_SIZE = 11.0, 9.0, 9.0
LINE = 12.0  # between lines below a symbol
NAME_WIDTH = 15  # letters of a name on one line
PILL_HEIGHT = 16.0

# What it costs the layout to run the output of a component back to the left: least for a
# converter's held output and for integrators, at which a loop is customarily cut.
CUT_HELD, CUT_STATE, CUT_OTHER = 0.6, 1.0, 8.0


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
    """The patch as boxes and cords."""

    patch: Patch
    scope: dict[str, float]
    parts: dict[str, Part] = field(default_factory=dict)
    cords: list[Cord] = field(default_factory=list)
    pills: dict[Cord, Pill] = field(default_factory=dict)
    marks: dict[Cord, str] = field(default_factory=dict)  # letters at terminals that add nothing
    programs: dict[str, ProgramBox] = field(default_factory=dict)
    modes: ModeBox | None = None

    def __post_init__(self) -> None:
        self.shown = {part.name: (part.unit, part.factor) for part in self.patch.analog_parts}
        boxes = program_boxes(self.patch, self.scope)
        self.computed_by = {r.word: each.box.name for each in boxes for r in each.rows if r.word}
        self.sampled_by = adcs_served(self.patch, self.scope)
        for component in self.patch.components:
            self._add_component(component)
        for adc in self.patch.adcs:
            self._add_adc(adc)
        for dac in self.patch.dacs:
            self._add_dac(dac)
        for program in boxes:
            self._add_program(program)
        self.modes = mode_box(self.patch, self.scope)
        if self.modes:
            self._add_box(self.modes.box, "modes", self.modes.cords)

    @property
    def boxes(self) -> list[Box]:
        """What is to be placed."""
        return [part.box for part in self.parts.values()]

    def _add_component(self, component: Component) -> None:
        name, kind = component.name, component.kind
        # What is taken zero times has no cord; a part of which nothing would be left shows them all.
        taken = [(s, v) for s, v in component.terms if v.number(self.scope)]
        inputs: list[tuple[str, Value | None]] = [*(taken or component.terms)]
        inputs += [(signal, None) for signal in component.signals]
        # What sets a mode comes in as a control does; the machine's own mode needs no cord.
        others = [
            (signal, mark)
            for signal, mark in (
                (component.initial_signal, "I"),
                (component.control, ""),
                (component.reset_when, "R"),
                (component.hold_when, "H"),
            )
            if signal in self.shown
        ]
        adding = len(inputs)
        inputs += [(str(signal), None) for signal, _ in others]
        cords = [Cord(s, s, name, place) for place, (s, _) in enumerate(inputs)]
        marks = zip(cords[adding:], others, strict=True)
        self.marks |= {cord: mark for cord, (_, mark) in marks if mark}
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
        one_level = kind == "compare" and not Figures(component, self.scope).si("hysteresis")
        self._add(
            name,
            "compare at one level" if one_level else kind,
            cords,
            pills,
            below=(self._scale(component), *details(component, self.scope, self.shown)),
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
        count = len(cords)
        width, height = _size(key, count, bool(pills), text)
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
        ins = tuple(top + float(round(_spread(height, place, count))) for place in range(count))
        total = top + height + 4 + LINE * len(names) + LINE * len(below)
        size, outs = (float(round(whole)), float(round(total))), {name: top + height / 2}
        box = Box(name, *size, ins, outs, any_order, cut)
        at = (float(round(left)), top, width, height)
        self.parts[name] = Part(box, key, at, names, below, above, text, curve, tip)
        self.cords += cords
        self.pills |= pills

    def _add_program(self, program: ProgramBox) -> None:
        self.programs[program.box.name] = program
        self._add_box(program.box, "program", program.cords)

    def _add_box(self, box: Box, key: str, cords: Sequence[Cord]) -> None:
        """A box that holds its own text."""
        self.parts[box.name] = Part(box, key, (0.0, 0.0, box.width, box.height), ())
        self.cords += cords

    def _scale(self, part: Component | Dac) -> str:
        figure = part.full_scale.number(self.scope) / part.factor
        return f"±{number(figure, 4)} {unit_text(part.unit)}".rstrip()

    def _initial(self, component: Component) -> str:
        """What an integrator begins with: a figure, or the signal that it follows in IC."""
        return component.initial_signal or Figures(component, self.scope).own("initial")

    def outlines(self, plan: Plan) -> Iterator[tuple[str, str, tuple[float, float, float, float]]]:
        """What is drawn over the cords: signal, 'symbol', 'label' or 'coefficient', and its
        left, top, right and bottom on the plan."""
        for name, part in self.parts.items():
            x, y = plan.places[name]
            left, top, width, height = part.symbol
            yield name, "symbol", (x + left, y + top, x + left + width, y + top + height)
            if not part.names:  # a box that holds its own text
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
                yield route.cord.target, "coefficient", self.pill_outline(route, plan)

    def pill_outline(self, route: Route, plan: Plan) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the coefficient on a cord."""
        part = self.parts[route.cord.target]
        x, y = plan.places[route.cord.target]
        right, y = x + part.symbol[0] - 6, y + part.box.ins[route.place]
        width = max(text_width(self.pills[route.cord].text, PILL_SIZE) + 10, PILL_HEIGHT)
        return right - width, y - PILL_HEIGHT / 2, right, y + PILL_HEIGHT / 2


def _size(key: str, inputs: int, has_pills: bool, text: str) -> tuple[float, float]:
    """Width and height of a symbol that has room for its cords and its text."""
    symbol = SYMBOLS.get(key, OTHER)
    pitch = PILL_HEIGHT + 3 if has_pills else 14.0
    height = max(symbol.height, pitch * inputs + (12 if has_pills else 4))
    width = symbol.width * min(max(height / symbol.height, 1.0), 1.6)
    if key == "coefficient":
        width = height = max(symbol.width, min(text_width(text, 11.0) + 8, 56.0))
    return float(round(width)), float(2 * round(height / 2))


def _spread(height: float, place: int, count: int) -> float:
    """Inputs of one symbol evenly, many of them a little off its corners."""
    if count < 3:
        return height * (place + 0.5) / count
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
