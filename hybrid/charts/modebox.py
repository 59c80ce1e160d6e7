"""The modes of the machine on the patch diagram: a box that says how time and signals set them.

Cords come from the comparators and DACs that put the machine into IC or HOLD, each at its line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hybrid.charts import style
from hybrid.charts.layered import Box, Cord
from hybrid.charts.symbols import TINT, line, tag, text_width, words
from hybrid.patch import ModeSettings, Patch

MODES = "modes of the machine"  # no signal can have a blank in its name
TITLE, TITLE_SIZE, TEXT_SIZE = "MODES", 10.0, 9.0
ROW, HEAD, LEFT = 15.0, 28.0, 14.0


@dataclass(frozen=True)
class ModeBox:
    """The box with its text: one line for each cord, and then those that time and overloads set."""

    box: Box
    by_signals: tuple[str, ...]
    others: tuple[str, ...]
    cords: tuple[Cord, ...]


def mode_box(patch: Patch, scope: Mapping[str, float]) -> ModeBox | None:
    """The box of a machine that may be in another mode than OP; None for one that is always in OP."""
    if not patch.leaves_op:
        return None
    modes = patch.modes or ModeSettings()
    setting = [(modes.reset_when, "IC"), (modes.hold_when, "HOLD")]
    by_signals = [(signal, f"{mode} while {signal} is high") for signal, mode in setting if signal]
    told = tuple(text for _, text in by_signals)
    others = _by_time(modes, scope)
    if patch.run.on_overload == "hold":
        others += ("HOLD for good from the first overload on",)
    widths = [text_width(text, TEXT_SIZE) for text in (*told, *others)]
    width = max([text_width(TITLE, TITLE_SIZE, bold=True), *widths]) + 2 * LEFT
    box = Box(
        MODES,
        float(round(width)),
        HEAD + ROW * len((*told, *others)) + 6,
        tuple(float(round(_middle(place))) for place in range(len(told))),
    )
    cords = tuple(Cord(signal, signal, MODES, i) for i, (signal, _) in enumerate(by_signals))
    return ModeBox(box, told, others, cords)


def _by_time(modes: ModeSettings, scope: Mapping[str, float]) -> tuple[str, ...]:
    """What time sets: the lengths of IC, OP and HOLD, and how often they come."""
    if modes.operate is None:
        return ("else OP, from t = 0 on",)
    lengths = (("IC", modes.reset), ("OP", modes.operate), ("HOLD", modes.hold))
    times = [(mode, value.number(scope)) for mode, value in lengths if value is not None]
    cycle = " → ".join(f"{mode} {style.duration(time_s)}" for mode, time_s in times if time_s)
    if modes.operations is None:
        return (cycle, "again and again")
    often = "once" if modes.operations == 1 else f"{modes.operations} times"
    return (cycle, f"{often}, then HOLD for good")


def _middle(place: int) -> float:
    return HEAD + ROW * (place + 0.5)


def drawn_modes(modes: ModeBox) -> str:
    """The box as SVG, its top left corner at the origin."""
    width, height = modes.box.width, modes.box.height
    edge: dict[str, Any] = {"rx": 3, "fill": TINT, "stroke": style.INK, "stroke_width": 1.4}
    inner = [
        tag("rect", "", x=0, y=0, width=width, height=height, **edge),
        words(LEFT, 14, TITLE, TITLE_SIZE, anchor="start", bold=True, color=style.PENS[3]),
        line((0, HEAD - 3), (width, HEAD - 3), stroke=style.FRAME, stroke_width=1.0),
    ]
    for place, text in enumerate((*modes.by_signals, *modes.others)):
        inner.append(words(LEFT, _middle(place), text, TEXT_SIZE, anchor="start"))
    for y in modes.box.ins:
        inner.append(line((2, y - 4), (8, y), (2, y + 4), stroke_width=1.2))
    return "".join(inner)
