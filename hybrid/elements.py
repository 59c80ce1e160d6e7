"""One element of a nonlinear analog circuit: what it computes, before any machine is chosen.

Stage 1. An element, in the order things happen to its signal:

1. sums u = gains * signals + constant, and w likewise where it has a second input;
2. its function: of u alone, of u and w, or the integral of u + feedback * x; in IC an integrator's
   state is w, in HOLD its u is the constant alone (or it stays as it is: figures of a wanted lag);
3. gain * v + offset, gain = 1 + its error;
4. saturation at +-level (an integrator stops there instead: its state does not wind up);
5. lag: lag_s * y' = v - y;
6. noise: white noise into that lag, so that it adds `noise` (rms) to the output.

What is not smooth is cut into pieces: each a parabola in the guarded quantity g, a row (low, high, at,
c0, c1, c2) for c0 + c1 (g - at) + c2 (g - at)^2, valid from low to high. Bounds of neighbouring pieces
overlap where there is hysteresis. An ANGLE goes on smoothly beyond its cut until it is led back by a
turn; its two pieces tell on which side of the cut it is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from hybrid.modes import LOGIC

# What an element computes.
INPUT, SINE, SUM, PIECES, SWITCH, TRACK = 0, 1, 2, 3, 4, 5
PRODUCT, QUOTIENT, SQRT, SIN, COS, POWER, INTEGRATE = 6, 7, 8, 9, 10, 11, 12
MODE = 13
ANGLE = 14
# What a MODE element gives: the number of the machine's mode, or 1 in one of them and else 0.
NUMBER = -1


@dataclass(frozen=True, slots=True)
class Element:
    """One element by names, as the builder collects them."""

    kind: int
    first: Mapping[str, float] = field(default_factory=dict)
    constant: float = 0.0
    second: Mapping[str, float] = field(default_factory=dict)
    second_constant: float = 0.0
    control: str | None = None
    figures: tuple[float, ...] = ()
    pieces: Sequence[tuple[float, ...]] = ()
    limits: tuple[float, float] | None = None
    initial: float = 0.0
    initial_output: float = math.nan
    initial_piece: int = 0
    # What sets the mode of an integrator or of the machine: `control`, whose value is the number of a
    # mode, and then two that act while they are high.
    reset: str | None = None
    hold: str | None = None
    gain: float = 1.0
    offset: float = 0.0
    saturation: float = math.inf
    lag_s: float = 0.0
    noise: float = 0.0
    loud: bool = False  # its square matters, too: windows show the noise, not only its averages

    def reads(self) -> Iterable[str]:
        """Names of the signals it needs at the same instant."""
        controls = [c for c in (self.control, self.reset, self.hold) if c is not None]
        return [*self.first, *self.second, *controls]

    def remembers(self) -> bool:
        """Whether a loop may be cut there: its output is continuous whatever its inputs do, unless the
        mode makes an integrator or a store follow them; then others in the loop do not."""
        stores = self.kind == TRACK and self.control in LOGIC
        return self.kind == INTEGRATE or self.lag_s > 0.0 or stores


def amplified(element: Element, gain: float) -> Element:
    """The same element with its output times `gain`."""
    return replace(element, gain=gain * element.gain)


def angle_pieces() -> list[tuple[float, ...]]:
    """Angle below and above its cut, where it is c0: valid while `sweep.room_of` keeps its sign."""
    return [(-math.inf, 0.0, 0.0, -math.pi, 0.0, 0.0), (0.0, math.inf, 0.0, math.pi, 0.0, 0.0)]


def abs_pieces() -> list[tuple[float, ...]]:
    """|g|."""
    return [(-math.inf, 0.0, 0.0, 0.0, -1.0, 0.0), (0.0, math.inf, 0.0, 0.0, 1.0, 0.0)]


def limit_pieces(low: float, high: float) -> list[tuple[float, ...]]:
    """Limiter: g between low and high."""
    return [
        (-math.inf, low, 0.0, low, 0.0, 0.0),
        (low, high, 0.0, 0.0, 1.0, 0.0),
        (high, math.inf, 0.0, high, 0.0, 0.0),
    ]


def dead_zone_pieces(low: float, high: float) -> list[tuple[float, ...]]:
    """Dead zone: 0 from low to high, slope 1 outside."""
    return [
        (-math.inf, low, low, 0.0, 1.0, 0.0),
        (low, high, 0.0, 0.0, 0.0, 0.0),
        (high, math.inf, high, 0.0, 1.0, 0.0),
    ]


def comparator_pieces(
    low: float, high: float, falls_at: float, rises_at: float
) -> list[tuple[float, ...]]:
    """Comparator: `high` once g rises above rises_at, `low` once it falls below falls_at."""
    return [
        (-math.inf, rises_at, 0.0, low, 0.0, 0.0),
        (falls_at, math.inf, 0.0, high, 0.0, 0.0),
    ]


def table_pieces(
    x: Sequence[float], y: Sequence[float], rounding: float = 0.0
) -> list[tuple[float, ...]]:
    """Straight lines through the points, the outer ones prolonged; corners rounded over this width.

    A rounded corner is the parabola that joins both lines with their slopes, as diodes round it.
    """
    slopes = [(y[i + 1] - y[i]) / (x[i + 1] - x[i]) for i in range(len(x) - 1)]
    half = rounding / 2
    rows: list[tuple[float, ...]] = []
    for i, slope in enumerate(slopes):
        low = x[i] + half if i > 0 else -math.inf
        high = x[i + 1] - half if i + 1 < len(slopes) else math.inf
        rows.append((low, high, x[i], y[i], slope, 0.0))
        if rounding > 0.0 and i + 1 < len(slopes):
            bend = (slopes[i + 1] - slope) / (2 * rounding)
            rows.append((high, high + rounding, high, y[i + 1] - slope * half, slope, bend))
    return rows
