"""What a component's symbol stands for beside its cords: the lines below its name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hybrid.charts import style
from hybrid.charts.style import number, unit_text
from hybrid.modes import LOGIC
from hybrid.patch import Component

Shown = Mapping[str, tuple[str, float]]  # signal -> unit and its SI value


@dataclass(frozen=True)
class Figures:
    """A component's own figures, in its unit or in SI."""

    component: Component
    scope: Mapping[str, float]

    def has(self, key: str) -> bool:
        """Whether the patch gives it."""
        return key in self.component.values

    def si(self, key: str) -> float:
        """In SI; 0 where the patch does not give it."""
        values = self.component.values
        return values[key].number(self.scope) if key in values else 0.0

    def bare(self, key: str) -> str:
        """In the component's unit, without it."""
        return number(self.si(key) / self.component.factor, 4)

    def own(self, key: str) -> str:
        """In the component's unit."""
        return f"{self.bare(key)} {unit_text(self.component.unit)}".rstrip()

    def time(self, key: str) -> str:
        """A time with its unit."""
        return style.duration(self.si(key))


def details(component: Component, scope: Mapping[str, float], shown: Shown) -> list[str]:
    """What else the symbol stands for, a line each."""
    f, kind = Figures(component, scope), component.kind
    told = [line for line in _BY_KIND[kind](f) if line] if kind in _BY_KIND else []
    told += [name for name in component.controls if name in LOGIC and name not in shown]
    if f.has("gain"):
        told.append(_gain(f, shown))
    if kind in ("sin", "cos") and f.has("amplitude"):
        told.append(f"amplitude {f.bare('amplitude')}")
    return told


def _gain(f: Figures, shown: Shown) -> str:
    """The gain of a part with units of its own, in those that are shown."""
    ins = [shown[signal][1] for signal in f.component.signals]
    factor = {
        "square_root": ins[0] ** 0.5,
        "atan2": 1.0,
        "multiply": ins[0] * ins[-1],
        "divide": ins[0] / ins[-1],
    }[f.component.kind]
    return f"gain {number(f.si('gain') * factor / f.component.factor, 4)}"


def _sine(f: Figures) -> list[str]:
    named = ("omega", "rad/s") if f.has("omega") else ("frequency", "Hz")
    return [f"{f.bare('sine')} at {number(f.si(named[0]), 4)} {named[1]}"]


def _ramp(f: Figures) -> list[str]:
    unit = unit_text(f.component.unit) or "1"
    unit = f"({unit})" if "/" in unit else unit
    return [f"{f.bare('ramp')} {unit}/s from {f.time('at')}"]


def _pulse(f: Figures) -> list[str]:
    once = f"{f.bare('before')} → {f.bare('pulse')} at {f.time('at')} for {f.time('width')}"
    return [once, f"every {f.time('period')}" if f.has("period") else ""]


def _squares(f: Figures) -> list[str]:
    return [f"{f.si('quarter_square'):g} segments" if f.has("quarter_square") else ""]


def _circuit(f: Figures) -> list[str]:
    return ["in feedback" if f.si("circuit") else ""]


def _between(f: Figures) -> list[str]:
    return [f"{f.bare('low')} … {f.bare('high')}"]


def _comparator(f: Figures) -> list[str]:
    """The levels of its sum at which it switches have no unit of their own: SI."""
    at, half = f.si("threshold"), f.si("hysteresis") / 2
    if not half:
        return [*_between(f), f"switches at {number(at, 4)}"]
    return [*_between(f), f"rises at {number(at + half, 4)},", f"falls at {number(at - half, 4)}"]


def _integrator(f: Figures) -> list[str]:
    low = f.bare("low") if f.has("low") else "−∞"
    high = f.bare("high") if f.has("high") else "∞"
    stops = f"stops at {low} … {high}" if f.has("low") or f.has("high") else ""
    return [stops, *_leak(f)]


def _leak(f: Figures) -> list[str]:
    return [f"leak {number(f.si('leak'), 4)} 1/s" if f.si("leak") else ""]


_BY_KIND: Mapping[str, Callable[[Figures], list[str]]] = {
    "constant": lambda f: [f"= {f.own('constant')}"],
    "step": lambda f: [f"{f.bare('before')} → {f.bare('step')} at {f.time('at')}"],
    "sine": _sine,
    "square": lambda f: [f"{f.bare('square')} every {f.time('period')}"],
    "ramp": _ramp,
    "pulse": _pulse,
    "sawtooth": lambda f: [f"{f.bare('sawtooth')} every {f.time('period')}"],
    "backlash": lambda f: [f"play {f.bare('width')}"],
    "multiply": _squares,
    "divide": _circuit,
    "square_root": _circuit,
    "noise_source": lambda f: [
        f"{f.bare('noise_source')} rms, {number(f.si('bandwidth'), 4)} rad/s"
    ],
    "delay": lambda f: [f"T = {f.time('time')}"],
    "lag": lambda f: [f"τ = {f.time('time_constant')}"],
    **dict.fromkeys(("limit", "dead_zone"), _between),
    "compare": _comparator,
    "integrate": _integrator,
    "track": _leak,
}
