"""Propellant against the digital cycle: attitude control by jets, switched by comparators or once a cycle.

Each axis is a double integrator that coasts between two switching lines, angle + lead rate = +-opens; its jet
gives the acceleration a until the sum has fallen to closes. If the jets answer after a delay d, the limit cycle
comes back to itself where each is on for

    t = (h/a + lead d - d^2/2) / (lead - d),  h = opens - closes,

which turns the rate from w = a t/2 to -w; the coast back at that rate takes 2 (opens - (lead - d) w)/w, so a jet
is on for the share 2 t/(4 (opens - (lead - d) w)/w + 2 t) of the time: about a t^2/(4 opens) while t is short,
the square of the impulse over the dead band. With comparators d = 0 whatever T is. Sampled, d is the compute time
and half a cycle, on the average, as in the paper's Eq. 2.1: 1.5 T adds to the time that a jet is on and is taken
from the lead, and at 1.5 T = lead there is no limit cycle any more.

Each opening and each closing by itself is late by T to 2 T: a line is crossed anywhere between two samples. So a
limit cycle with equal rates either way cannot take less than the closed form with d = T, nor more than with d = 2 T,
but for one pulse of each axis more or less in the time that is measured; comparators have that one pulse alone. By
these bounds the runs are judged.

Measured is what `hybrid sweep patches/jet_control_sampled.yaml --over cycle=...` gives, the propellant used after
the first `SETTLED_S`. `one axis` is the sum of three axes by themselves, each followed exactly from sample to sample
along its parabolas; what is left beside it is that three axes turn each other a little, which shifts where in a
cycle a line is crossed. Where all on-times of an axis are the same number of cycles, its rates either way may stay
unequal for long. That takes less than the closed form, since the slower coast takes longer than the faster one
saves: an axis by itself does so at 10 ms (its `one axis` there is 41 % below), all three at 23.5 ms (1.2 g/s). No
T of those that are flown does it in all three; one that did would fail here, since the bounds leave it out.

--out FILE.png draws the curve.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench import Table, finish, parse_options

import hybrid

PATCH = hybrid.read_patch("jet_control_sampled")
SETTINGS = PATCH.bind()
LEAD_S, OPENS, CLOSES = (SETTINGS[name] for name in ("lead", "opens", "closes"))
SHORTEST_S = SETTINGS["shortest"]
FLOW = 1 / (SETTINGS["jets.arm"] * SETTINGS["jets.specific_impulse"])  # kg/s for each N m
SETTLED_S, UNTIL_S = 100.0, PATCH.run.until.number(SETTINGS)


@dataclass(frozen=True)
class Axis:
    """One axis: inertia, moment of its jets, and how it starts."""

    inertia: float  # kg m2
    moment: float  # N m
    angle: float  # rad
    rate: float  # rad/s

    @property
    def acceleration(self) -> float:
        """Of one jet, rad/s2."""
        return self.moment / self.inertia


AXES = tuple(
    Axis(*(SETTINGS[name] for name in names))
    for names in (
        ("body.ixx", "jets.x_moment", "roll_start", "p_start"),
        ("body.iyy", "jets.y_moment", "pitch_start", "q_start"),
        ("body.izz", "jets.z_moment", "yaw_start", "r_start"),
    )
)


def limit_cycle(acceleration: float, delay_s: float) -> tuple[float, float, float]:
    """Time that a jet is on (s), rate of coasting (rad/s), period (s); see above."""
    push = (OPENS - CLOSES) / acceleration + LEAD_S * delay_s - delay_s**2 / 2
    on_s = push / (LEAD_S - delay_s)
    rate = acceleration * on_s / 2
    coast_s = 2 * (OPENS - (LEAD_S - delay_s) * rate) / rate
    return on_s, rate, 2 * (coast_s + on_s)


def closed_form(delay_s: float) -> float:
    """Propellant of all axes in kg/s."""
    used = 0.0
    for axis in AXES:
        on_s, _, period_s = limit_cycle(axis.acceleration, delay_s)
        used += axis.moment * FLOW * 2 * on_s / period_s
    return used


def bounds(least_s: float, most_s: float) -> tuple[float, float]:
    """Least and most propellant in kg/s where every delay is between these; see above."""
    pulses = [
        sum(axis.moment * FLOW * limit_cycle(axis.acceleration, delay_s)[0] for axis in AXES)
        / (UNTIL_S - SETTLED_S)
        for delay_s in (least_s, most_s)
    ]
    return closed_form(least_s) - pulses[0], closed_form(most_s) + pulses[1]


def sampled(axis: Axis, cycle_s: float, until_s: float) -> list[int]:
    """The jet's state (-1, 0, 1) in each cycle, by parabolas from sample to sample; it is a cycle late.

    Needs nothing of Hybrid: the law of the patch's header on an axis by itself.
    """
    angle, rate, drive = axis.angle, axis.rate, 0
    cycles, shown = {1: 0, -1: 0}, []
    for _ in range(round(until_s / cycle_s)):
        error, next_drive = angle + LEAD_S * rate, 0
        for side in cycles:
            seen = side * error
            if cycles[side]:
                is_open = seen > CLOSES or cycles[side] * cycle_s < 0.999999 * SHORTEST_S
            else:
                is_open = seen > OPENS
            cycles[side] = cycles[side] + 1 if is_open else 0
            next_drive -= side * is_open
        push = drive * axis.acceleration
        angle, rate = angle + (rate + push * cycle_s / 2) * cycle_s, rate + push * cycle_s
        shown.append(drive)
        drive = next_drive
    return shown


def one_axis(cycle_s: float, until_s: float) -> float:
    """Propellant in kg/s of three such axes after `SETTLED_S`."""
    first, used = round(SETTLED_S / cycle_s), 0.0
    for axis in AXES:
        shown = sampled(axis, cycle_s, until_s)[first:]
        used += axis.moment * FLOW * sum(map(abs, shown)) / len(shown)
    return used


def swept(patch: str, cycles_s: Sequence[float]) -> list[float]:
    """Propellant in kg/s for each cycle, by a sweep."""
    data = hybrid.sweep(patch, "cycle", cycles_s, machine="lags").dataset
    assert (data["status"] == "complete").all()
    used = (data["value_propellant"] - data["value_acquired"]) / 1000
    over_s = data["time_propellant"] - data["time_acquired"]
    return [float(rate) for rate in (used / over_s).values]


def row(cycle_s: float, law: str, found: float) -> dict:
    """What a run takes beside the theory."""
    late = law == "sampled"
    form = closed_form(1.5 * cycle_s if late else 0.0)
    axes = one_axis(cycle_s, UNTIL_S) if late else None
    least, most = bounds(cycle_s, 2 * cycle_s) if late else bounds(0.0, 0.0)
    return {
        "cycle_ms": cycle_s * 1e3,
        "law": law,
        "measured_g_s": found * 1e3,
        "one_axis_g_s": None if axes is None else axes * 1e3,
        "closed_form_g_s": form * 1e3,
        "least_g_s": least * 1e3,
        "most_g_s": most * 1e3,
        "off": found / form - 1,
        "agrees": least <= found <= most,
    }


def beside_bounds(rows: Sequence[dict]) -> str:
    """What the bounds are of, and where the axes by themselves lie outside of them; see above."""
    told = "Judged is what was measured: least and most are of limit cycles with equal rates either way."
    apart = [
        f"{r['one_axis_g_s']:.3f} g/s at {r['cycle_ms']:g} ms"
        for r in rows
        if r["one_axis_g_s"] and not r["least_g_s"] <= r["one_axis_g_s"] <= r["most_g_s"]
    ]
    if apart:
        told += (
            f" One axis is outside of them at {', '.join(apart)}, and is not judged: an axis by itself "
            "whose on-times are all the same number of cycles keeps unequal rates, and takes less."
        )
    return told


def draw(rows: Sequence[dict], file: Path) -> None:
    """The curve: measured, axes by themselves, closed form."""
    from matplotlib.figure import Figure

    from hybrid.charts import save, style

    with style.chart_style():
        figure = Figure(figsize=(9.0, 6.0))
        axes = figure.add_axes((0.11, 0.12, 0.85, 0.76))
        late = [r for r in rows if r["law"] == "sampled"]
        span = [
            s * (late[-1]["cycle_ms"] / late[0]["cycle_ms"]) ** (i / 200)
            for i, s in enumerate([late[0]["cycle_ms"]] * 201)
        ]
        axes.plot(
            span,
            [closed_form(1.5e-3 * t) * 1e3 for t in span],
            color=style.INK,
            lw=1.2,
            ls=(0, (5, 3)),
            label="closed form, delay of 1.5 T",
        )
        axes.plot(
            [r["cycle_ms"] for r in late],
            [r["one_axis_g_s"] for r in late],
            "x",
            color=style.PENS[1],
            label="three axes by themselves, exact",
        )
        for law, pen in (("sampled", style.PENS[0]), ("comparators", style.PENS[2])):
            of = [r for r in rows if r["law"] == law]
            axes.plot(
                [r["cycle_ms"] for r in of],
                [r["measured_g_s"] for r in of],
                "o-",
                color=pen,
                mfc="white",
                lw=1.2,
                label=f"measured, {law}",
            )
        axes.set(xscale="log", yscale="log", xlabel="digital cycle T, ms", ylabel="propellant, g/s")
        axes.set_title("Jet control: propellant against T")
        axes.grid(True, which="both", color=style.RULING_MAJOR, lw=0.7)
        axes.legend(loc="upper left")
        save(figure, file)


def main() -> int:
    options = parse_options(__doc__ or "", draws=True)
    cycles_s = (
        [0.02, 0.1] if options.quick else [0.005, 0.01, 0.02, 0.035, 0.05, 0.07, 0.1, 0.14, 0.2]
    )
    rows = [
        row(t, "sampled", found)
        for t, found in zip(cycles_s, swept("jet_control_sampled", cycles_s), strict=True)
    ]
    few = cycles_s[:: len(cycles_s) - 1]
    rows += [
        row(t, "comparators", found)
        for t, found in zip(few, swept("jet_control", few), strict=True)
    ]
    formats = {
        "T, ms": ("cycle_ms", "g"),
        "law": ("law", ""),
        "measured, g/s": ("measured_g_s", ".3f"),
        "one axis": ("one_axis_g_s", ".3f"),
        "closed form": ("closed_form_g_s", ".3f"),
        "least": ("least_g_s", ".3f"),
        "most": ("most_g_s", ".3f"),
        "off": ("off", "+.1%"),
        "": ("agrees", ""),
    }
    passed = all(r["agrees"] for r in rows)
    worst = max(abs(r["off"]) for r in rows)
    verdict = f"propellant at most {worst:.1%} off the closed form; comparators do not know T"
    title = "Propellant used by the jets after the first 100 s"
    table = Table("propellant", title, formats, rows, beside_bounds(rows))
    code = finish(__file__, options, [table], passed, verdict)
    if options.out:
        draw(rows, options.out)
    return code


if __name__ == "__main__":
    sys.exit(main())
