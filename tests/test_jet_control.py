"""Jets switched by comparators and by the digital machine, beside parabolas in the phase plane."""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import hybrid
from hybrid.shipped import shipped_folder, shipped_patches

PARTS = shipped_folder() / "parts"
DEG = math.pi / 180
LAG_S = 1e-6
QUIET = dict.fromkeys(("pitch_start", "yaw_start", "q_start", "r_start"), 0.0)


@dataclass(frozen=True)
class Law:
    """One axis and its law, in rad and s: those of the patch about x."""

    acceleration: float = 50.0 / 2000.0
    lead: float = 0.5
    opens: float = 0.33 * DEG
    closes: float = 0.26 * DEG
    shortest: float = 0.02

    def settings(self) -> dict[str, float]:
        """The patch's parameters."""
        names = ("lead", "opens", "closes", "shortest")
        return {name: getattr(self, name) for name in names}


def first_root(a: float, b: float, c: float) -> float:
    """Smallest positive root of a t^2 + b t + c = 0, infinite if there is none."""
    if a == 0.0:
        roots = [-c / b] if b else []
    else:
        square = b * b - 4 * a * c
        roots = [(-b + s * math.sqrt(square)) / (2 * a) for s in (-1, 1)] if square >= 0 else []
    return min((t for t in roots if t > 0.0), default=math.inf)


def phase_plane(
    law: Law, angle: float, rate: float, until: float
) -> list[tuple[float, float, float]]:
    """(on, off, rate after) of every jet in turn: parabolas between the switching lines.

    The error angle + lead rate starts between the lines, and jets act with no delay.
    """
    now, found = 0.0, []
    while rate:
        side = math.copysign(1.0, rate)
        now += (side * law.opens - angle - law.lead * rate) / rate  # coasting
        angle = side * law.opens - law.lead * rate
        a = law.acceleration
        # side*error = opens + (side*rate - lead a) t - a t^2/2 comes down to closes
        on = first_root(-a / 2, side * rate - law.lead * a, law.opens - law.closes)
        on = max(on, law.shortest)
        if now + on > until:
            break
        angle += rate * on - side * a * on**2 / 2
        rate -= side * a * on
        found.append((now, now + on, rate))
        now += on
    return found


def roll(law: Law, angle: float, rate: float, until: float, every: float, machine: str = "ideal"):
    """The shipped patch with nothing to do about y and z; angles in rad."""
    text = shipped_patches()["jet_control"].read_text(encoding="utf-8")
    head, _, tail = text.partition("run: {until: 300 s, every: 0.1 s}")
    text = f"{head}run: {{until: {until} s, every: {every} s}}{tail}".replace(", until: 100 s", "")
    patch = hybrid.parse_patch(text, str(shipped_patches()["jet_control"]))
    given = {**law.settings(), **QUIET, "roll_start": angle, "p_start": rate}
    result = hybrid.run(patch, given, machine=machine)
    assert result.status == "complete" and not result.overloads
    return result.record


def switched(record, acceleration: float) -> np.ndarray:
    """On and off of every jet, from the rates: coasting before, one row within, coasting after."""
    time, rate = record["time"].values, np.radians(record["body.p"].values)
    fires = record["jets.flow"].values > 0
    edges = np.flatnonzero(np.diff(fires.astype(int)))
    starts, ends = edges[::2] + 1, edges[1::2]
    starts = starts[: len(ends)]
    before, within, after = rate[starts - 1], rate[starts], rate[ends + 1]
    on = time[starts] - np.abs(within - before) / acceleration
    return np.array([on, on + np.abs(after - before) / acceleration]).T


def test_a_jet_opens_and_closes_where_its_error_says() -> None:
    record = hybrid.run(PARTS / "jet.yaml", machine="ideal").record
    is_open, time = record["open"].values > 0.5, record["time"].values
    within = (time > math.asin(0.5)) & (time < math.pi - math.asin(0.3))
    np.testing.assert_array_equal(is_open, within)
    record = hybrid.run(PARTS / "jet.yaml", {"shortest": "3 s"}, machine="ideal").record
    is_open, opened = record["open"].values > 0.5, math.asin(0.5)
    np.testing.assert_array_equal(is_open, (time > opened) & (time < opened + 3.0))
    # The clock starts at the instant itself.
    np.testing.assert_allclose((time - record["clock"].values)[is_open], opened, atol=1e-9)


@pytest.mark.parametrize(("machine", "delay"), [("ideal", 0.0), ("lags", 10 * LAG_S)])
def test_jets_switch_where_the_parabolas_meet_the_lines(machine: str, delay: float) -> None:
    """The digital machine has a cycle of 100 ms; the comparators know nothing of it."""
    law = Law()
    expected = np.array(phase_plane(law, 0.1 * DEG, 0.08 * DEG, 70.0))
    found = switched(roll(law, 0.1 * DEG, 0.08 * DEG, 70.0, 0.02, machine), law.acceleration)
    assert len(found) == len(expected) > 6
    if not delay:
        # Parabolas are polynomials, which windows hold but for rounding: 1e-8 of T.
        np.testing.assert_allclose(found, expected[:, :2], atol=1e-9)
        assert (np.abs(found / 0.1 - np.round(found / 0.1)) > 0.2).any()  # anywhere between samples
        return
    # A jet that is late at either end leaves a rate that is off by that, which acts over a coast.
    slowest = np.abs(expected[:, 2]).min()
    each = delay + 0.7 * DEG / slowest**2 * 2 * law.acceleration * delay
    assert (np.abs(found - expected[:, :2]).max(axis=1) < each * np.arange(1, len(found) + 1)).all()


def test_the_limit_cycle_has_the_period_of_the_closed_form() -> None:
    law = Law()
    h = law.opens - law.closes
    rate, on = h / (2 * law.lead), h / (law.acceleration * law.lead)
    period = 4 * (law.opens + law.closes) / 2 / rate + 2 * on
    record = roll(law, 0.0, rate, 3 * period, 0.02)
    found = switched(record, law.acceleration)
    assert len(found) == 6
    np.testing.assert_allclose(np.diff(found, axis=1), on, atol=1e-9)
    np.testing.assert_allclose(found[2:, 0] - found[:-2, 0], period, atol=1e-8)
    top = (law.opens + law.closes) / 2 + rate**2 / (2 * law.acceleration)
    rows = 0.02 * rate  # a row may miss the top by that at most
    assert top - rows < np.radians(record["angles.roll"].values).max() < top + 1e-7
    assert (period, on) == pytest.approx((17.05, 0.0977), abs=0.01)  # the header


def test_pulses_of_the_shortest_time_turn_the_same_rate_every_time() -> None:
    """h/(a lead) below `shortest`: two rates whose sum is a shortest, for good."""
    law = replace(Law(), closes=0.3295 * DEG, shortest=0.05)
    turn = law.acceleration * law.shortest
    up = 0.7 * turn
    down = turn - up
    record = roll(law, 0.0, up, 150.0, 0.01)
    found = switched(record, law.acceleration)
    # From line to line at either rate; a pulse shifts the angle by (up^2 - down^2)/(2 a).
    between = 2 * law.opens - law.lead * turn
    shift = (up**2 - down**2) / (2 * law.acceleration)
    period = (between + shift) / down + (between - shift) / up + 2 * law.shortest
    assert len(found) >= 4
    np.testing.assert_allclose(np.diff(found, axis=1), law.shortest, atol=1e-9)
    np.testing.assert_allclose(found[2:, 0] - found[:-2, 0], period, atol=1e-8)
    grams = len(found) * law.shortest * 50.0 / (1.5 * 2.2)
    assert float(record["jets.propellant"][-1]) == pytest.approx(grams, rel=1e-9)


def test_propellant_goes_with_the_square_of_the_impulse() -> None:
    """Rates of half a pulse each way: a pulse takes as long, and comes as often, as its size says."""
    used = []
    for shortest in (0.04, 0.08):
        law = replace(Law(), closes=0.3295 * DEG, shortest=shortest)
        rate = law.acceleration * shortest / 2
        period = 4 * (law.opens - law.lead * rate) / rate + 2 * shortest
        record = roll(law, 0.0, rate, 3 * period, 0.02)
        used.append(float(record["jets.propellant"][-1]) / (3 * period))
        share = 2 * shortest / period
        assert used[-1] == pytest.approx(50.0 / (1.5 * 2.2) * share, rel=1e-9)
    # (a t)^2/(4 a opens), but for the lead in the dead band and the pulse in the period.
    assert used[1] / used[0] == pytest.approx(4.0, rel=0.08)


@pytest.fixture
def bench(monkeypatch):
    """The module benches/jet_control.py."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "benches"))
    return importlib.import_module("jet_control")


@pytest.mark.parametrize("cycle", [0.013, 0.05, 0.1])
def test_the_sampled_law_is_that_of_parabolas_from_sample_to_sample(bench, cycle: float) -> None:
    """Every cycle the same valves open: no difference is left for anything but chance to make."""
    axis, until = bench.Axis(2000.0, 50.0, 0.1 * DEG, 0.12 * DEG), 60.0
    text = shipped_patches()["jet_control_sampled"].read_text(encoding="utf-8")
    text = text.replace("until: 300 s", f"until: {until} s, every: {cycle / 2} s")
    text = text.replace(", acquired: {final: jets.propellant, until: 100 s}", "")
    patch = hybrid.parse_patch(text, str(shipped_patches()["jet_control_sampled"]))
    start = {"roll_start": axis.angle, "p_start": axis.rate, **QUIET}
    record = hybrid.run(patch, {**start, "cycle": cycle}, machine="ideal").record
    shown = bench.sampled(axis, cycle, until)
    middle = record["jets.flow"].values[1::2][: len(shown)] > 0
    np.testing.assert_array_equal(middle, np.array(shown)[: len(middle)] != 0)
    assert np.count_nonzero(np.diff(middle.astype(int))) > 8


def test_delay_in_the_closed_form_is_that_of_the_phase_plane(bench) -> None:
    """One stroke with the jet late by d at either end comes back to its rate, turned round."""
    for delay in (0.0, 0.05, 0.2):
        for axis in bench.AXES:
            on, rate, period = bench.limit_cycle(axis.acceleration, delay)
            a, lead = axis.acceleration, bench.LEAD_S
            at_line = bench.OPENS - lead * rate
            burning = on - delay  # until the error is down at `closes`; the jet stops `delay` later
            angle = at_line + rate * delay + rate * burning - a * burning**2 / 2
            assert angle + lead * (rate - a * burning) == pytest.approx(bench.CLOSES, rel=1e-12)
            assert rate - a * on == pytest.approx(-rate, rel=1e-12)
            stop = at_line + rate * delay + rate * on - a * on**2 / 2
            assert period == pytest.approx(2 * ((stop + at_line - delay * -rate) / rate + on))


def test_the_bench_refuses_what_delays_cannot_make(bench) -> None:
    """Half a cycle late or 2.4 in place of 1.5, and pulses of one length."""
    for cycle in (0.02, 0.1, 0.2):
        least, most = bench.bounds(cycle, 2 * cycle)
        assert least < bench.closed_form(1.5 * cycle) < most
        assert not least <= bench.closed_form(0.5 * cycle) <= most
        assert not least <= bench.closed_form(2.4 * cycle) <= most
    assert bench.row(0.01, "sampled", bench.one_axis(0.01, bench.UNTIL_S))["agrees"] is False


def test_small_angles_are_right_to_the_second_order() -> None:
    record = hybrid.run(PARTS / "small_angles.yaml", machine="ideal").record
    p, q, r = np.radians([0.6, 0.5, 0.6])
    size = math.sqrt(p * p + q * q + r * r)
    # The matrix of a turn about (p, q, r) for 1 s, by Rodrigues' formula.
    x, y, z = np.array([p, q, r]) / size
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(3) + math.sin(size) * cross + (1 - math.cos(size)) * cross @ cross
    yaw = math.atan2(matrix[1, 0], matrix[0, 0])
    pitch, roll_ = -math.asin(matrix[2, 0]), math.atan2(matrix[2, 1], matrix[2, 2])
    found = np.radians([float(record[n][-1]) for n in ("roll", "pitch", "yaw")])
    assert np.abs(found - [roll_, pitch, yaw]).max() < size**3
    first = np.abs(np.array([p, q, r]) - [roll_, pitch, yaw]).max()
    assert first > 10 * size**3  # which the products make up


def test_both_counts_of_the_propellant_are_in_one_unit() -> None:
    """Counted once a cycle T, it errs by at most T times what the flow changes by, all jets together,
    for every cycle in which it does, and by the last cycle."""
    text = shipped_patches()["jet_control"].read_text(encoding="utf-8")
    text = text.replace("until: 300 s, every: 0.1 s", "until: 6 s, every: 1 ms")
    result = hybrid.run(hybrid.parse_patch(text), {"cycle": 1e-3})
    assert {result.readouts[name]["units"] for name in ("propellant", "counted")} == {"g"}
    flow = result.record["jets.flow"].values
    bound = (np.abs(np.diff(flow)).sum() + flow[-1]) * 1e-3
    differ = result.readouts["counted"]["value"] - result.readouts["propellant"]["value"]
    assert abs(differ) <= bound + 1e-6 < 0.1 * result.readouts["propellant"]["value"]
