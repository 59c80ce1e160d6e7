"""Parts that ship, each by itself: beside sums over masses, rotations and orbits derived here."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
import sphere_cone as cone
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from six_dof import EARTH_RATE, tensor

import hybrid
from hybrid import surroundings
from hybrid.shipped import shipped_folder

PARTS = shipped_folder() / "parts"
ATTITUDES = [Rotation.random(random_state=seed) for seed in (1, 2, 3)]


def computed(part: str, inputs: dict[str, str], settings: dict[str, str] | None = None):
    """What the program of a part makes of steady inputs; what stands in, where they say nothing."""
    file = (PARTS / f"{part}.yaml").read_text(encoding="utf-8")
    rows = file.partition("\ninputs:\n")[2].partition("\noutputs:")[0]
    own = dict(row.partition("#")[0].strip().split(": ", 1) for row in rows.splitlines())
    inputs = {**own, **inputs}
    wired = "\n".join(f"      {name}: {value}" for name, value in inputs.items())
    given = "\n".join(f"      {name}: {value}" for name, value in (settings or {}).items())
    text = f"""\
title: One part
parts:
  part:
    file: parts/{part}.yaml
    inputs:
{wired}
    parameters:
{given or "      {}"}
digital: {{period: 1 s, compute_time: 0}}
run: {{until: 1 s}}
"""
    record = hybrid.run(hybrid.parse_patch(text, str(PARTS.parent / "one.yaml"))).record
    return {name.removeprefix("part."): float(record[name][-1]) for name in record.data_vars}


def told(names: Iterable[str], values: Iterable[float], unit: str = "") -> dict[str, str]:
    """Inputs or parameters by name, to the last bit."""
    return {n: f"{float(value)!r} {unit}" for n, value in zip(names, values, strict=True)}


def quaternion(attitude: Rotation, length: float = 1.0) -> dict[str, str]:
    """Inputs x, y, z, s."""
    return told("xyzs", attitude.as_quat() * length)


# -- programs -------------------------------------------------------------------------------------


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_body_axes_turn_motion_and_forces(attitude: Rotation) -> None:
    velocity, rates = np.array([210.0, -340.0, 95.0]), np.array([0.02, -0.3, 0.11])
    force, turned = np.array([-900.0, 250.0, 4000.0]), 0.7
    change = np.array([3.0, -9.0, 5.0])
    earth = Rotation.from_euler("z", turned)
    inputs = {
        **quaternion(attitude),
        **told(("vx", "vy", "vz"), velocity, "m/s"),
        **told(("ax", "ay", "az"), change, "m/s^2"),
        **told("pqr", rates, "rad/s"),
        **told(("force_u", "force_v", "force_w"), force, "N"),
        "turned": f"{turned}",
    }
    found = computed("body_axes", inputs)
    seen = attitude.inv().apply(earth.apply(velocity))
    np.testing.assert_allclose([found[n] for n in "uvw"], seen, rtol=1e-13, atol=1e-12)
    told_change = [found[f"a_{n}"] for n in "uvw"]
    there = attitude.inv().apply(earth.apply(change))
    np.testing.assert_allclose(told_change, there, rtol=1e-13, atol=1e-14)
    assert found["speed"] == pytest.approx(np.linalg.norm(velocity), rel=1e-14)
    # Turned by beta about z and then by -alpha about y, the wind's direction is the body's x axis.
    wind = Rotation.from_euler("zy", [found["beta"], -found["alpha"]], degrees=True)
    np.testing.assert_allclose(seen / found["speed"], wind.apply([1.0, 0.0, 0.0]), atol=1e-14)
    air = rates - attitude.inv().apply([0.0, 0.0, EARTH_RATE])
    np.testing.assert_allclose([found[f"{n}_air"] for n in "pqr"], air, rtol=1e-13)
    there = earth.inv().apply(attitude.apply(force))
    np.testing.assert_allclose([found[f"force_{n}"] for n in "xyz"], there, rtol=1e-13, atol=1e-10)


@pytest.mark.parametrize("length", [1.0, 0.9])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_gravity_gradient_is_what_attraction_does_to_six_masses(seed: int, length: float) -> None:
    """Masses m at +-a, +-b and +-c along three axes any way: I = 2 m sum (|a|^2 - a a^T).

    Newton's attraction of each, crossed with its arm. Arms of either sign leave the next order out,
    so what the formula neglects is of the order of (size/distance)^2.
    """
    size, distance, gm, mass = 100.0, 7000e3, 3.986004415e14, 10.0
    _, axes = tensor(np.array([1.0, 2.0, 3.0]), seed)
    arms = size * axes.T * np.array([[1.0], [0.6], [0.3]])
    matrix = 2 * mass * sum(a @ a * np.eye(3) - np.outer(a, a) for a in arms)
    attitude = ATTITUDES[seed - 1]
    place = distance * np.array([0.6, -0.48, 0.64])  # of length 1
    expected = np.zeros(3)
    for arm in (*arms, *-arms):
        there = place + attitude.apply(arm)
        pull = -gm * mass * there / np.linalg.norm(there) ** 3
        expected += np.cross(arm, attitude.inv().apply(pull))
    inputs = {**quaternion(attitude, length), **told(("px", "py", "pz"), place, "m")}
    moments = told(("ixx", "iyy", "izz"), np.diag(matrix), "kg*m^2")
    products = told(("ixy", "ixz", "iyz"), -matrix[[0, 0, 1], [1, 2, 2]], "kg*m^2")
    found = computed("gravity_gradient", inputs, {**moments, **products})
    moment = np.array([found[f"moment_{n}"] for n in "xyz"])
    largest = np.abs(expected).max()
    # Of the expansion's fourth moments (35/2 at most); rounding of the sum, 1e-16 r/a of it a mass.
    bound = 18 * (size / distance) ** 2 + 6 * 4e-16 * distance / size
    np.testing.assert_allclose(moment, expected, rtol=0, atol=bound * largest)


def switched(sense: int, shortest: float, until_s: float) -> np.ndarray:
    """Whether the sampled jet is open at each cycle of 10 ms, its error sin(1 rad/s t)."""
    text = f"""\
title: A sampled jet
parts:
  jet:
    file: parts/jet_digital.yaml
    inputs: {{error: sin(angle)}}
    parameters: {{sense: {sense}, shortest: {shortest} s, cycle: 10 ms}}
digital:
  period: 10 ms
  compute_time: 0
  states: {{angle: {{integrate: turning, initial: 0}}}}
  program: {{turning: 1 rad/s}}
run: {{until: {until_s} s}}
"""
    record = hybrid.run(hybrid.parse_patch(text, str(PARTS.parent / "one.yaml"))).record
    return np.interp(
        0.01 * np.arange(int(until_s * 100)) + 1e-6, record["time"], record["jet.open"]
    )


@pytest.mark.parametrize(
    ("sense", "shortest", "opens", "closes"),
    [
        (1, 0.02, math.asin(0.5), math.pi - math.asin(0.3)),
        (1, 3.0, math.asin(0.5), 3.0 + 0.53),  # so long after the cycle at which it opened
        (-1, 0.02, math.pi + math.asin(0.5), 2 * math.pi - math.asin(0.3)),
    ],
)
def test_a_sampled_jet_switches_at_the_next_cycle(sense, shortest, opens, closes) -> None:
    shown = switched(sense, shortest, 6.5) > 0.5
    first, last = (math.ceil(100 * t - 1e-6) for t in (opens, closes))
    expected = np.zeros(650, dtype=bool)
    expected[first:last] = True
    np.testing.assert_array_equal(shown, expected)


def test_an_orbit_is_keplers_ellipse() -> None:
    """E - e sin E = n t from the pericentre; RK4's error falls with the fourth power of the step."""
    gm, near, speed = 3.986004415e14, 7000e3, 8.5e3
    axis = 1 / (2 / near - speed**2 / gm)
    e, mean = 1 - near / axis, math.sqrt(gm / axis**3)
    errors = []
    for step in (40.0, 20.0):
        text = (PARTS / "orbit.yaml").read_text(encoding="utf-8")
        text = text.replace("period: 1 s", f"period: {step} s\n  compute_time: 0")
        patch = hybrid.parse_patch(text, str(PARTS / "orbit.yaml"))
        record = hybrid.run(patch, {"vy_start": speed}, machine="ideal").record
        worst = 0.0
        for row, t in enumerate(record["time"].values):
            around = brentq(lambda E, t=t: E - e * math.sin(E) - mean * t, -1.0, 20.0, xtol=1e-15)
            there = axis * np.array(
                [math.cos(around) - e, math.sqrt(1 - e * e) * math.sin(around), 0.0]
            )
            place = np.array([float(record[n][row]) for n in "xyz"])
            worst = max(worst, float(np.linalg.norm(place - there)))
        errors.append(worst)
    # The next term is smaller by n h (1 + e)/(1 - e)^1.5 at the pericentre: within a quarter.
    assert errors[0] < 1e-3 * near and 12.0 < errors[0] / errors[1] < 20.0


def test_orbit_adds_the_accelerations_of_its_forces() -> None:
    """No attraction: s = F/(2 m) t^2, which Runge-Kutta formulas hold exactly."""
    text = (PARTS / "orbit.yaml").read_text(encoding="utf-8")
    for name, force in (("x", 3.0), ("y", -2.0), ("z", 1.0)):
        text = text.replace(f"force_{name}: 0 N", f"force_{name}: {force} N")
    text = text.replace("period: 1 s", "period: 1 s\n  compute_time: 0")
    free = {"gm": 0.0, "mass": 2.0, "vy_start": 0.0}
    record = hybrid.run(hybrid.parse_patch(text), free, machine="ideal").record
    t = record["time"].values
    for name, force, start in (("x", 3.0, 7000e3), ("y", -2.0, 0.0), ("z", 1.0, 0.0)):
        np.testing.assert_allclose(record[name], start + force / 4 * t**2, rtol=1e-12)


def test_the_air_pushes_a_blunt_cone_as_newtons_theory_says() -> None:
    """At a line of the table: its coefficients are those of the closed form there."""
    found = computed("capsule", {})
    temperature, pressure = surroundings.us76(60e3)
    mach = 7000.0 / surroundings.us76_sound_speed(temperature)
    assert found["mach"] == pytest.approx(mach, rel=1e-12)
    push = 0.7 * pressure * mach**2 * cone.AREA
    axial, normal, moment = cone.coefficients(mach, 60e3, math.radians(5.0))
    # Mach 22 lies between 10 and 25, where k is 1.8317 and 1.8382, and k goes with 1/M^2: the chord is
    # off by less than their difference. Six digits of the table, of 0.02 at least.
    bound = 0.0065 / 1.83 + 0.5e-6 / 0.02
    assert -found["force_u"] == pytest.approx(push * axial, rel=bound)
    assert -found["force_w"] == pytest.approx(push * normal, rel=bound)
    assert found["moment_y"] == pytest.approx(push * cone.LENGTH * moment, rel=bound)
    assert found["force_v"] == found["moment_z"] == 0.0
    assert found["moment_y"] == pytest.approx(-7.8e3, rel=0.01)  # the header
    assert found["incidence"] == pytest.approx(5.0, rel=1e-14)
    # From the side it is the same, turned by 90 deg about x.
    aside = computed("capsule", {"alpha": "0 deg", "beta": "5 deg"})
    assert aside["force_v"] == pytest.approx(found["force_w"], rel=1e-12)
    assert aside["moment_z"] == pytest.approx(-found["moment_y"], rel=1e-12)
    # From both sides at once the force lies in the plane of the axis and the motion.
    both = computed("capsule", {"alpha": "3 deg", "beta": "-4 deg"})
    u, v, w = Rotation.from_euler("zy", [-4.0, -3.0], degrees=True).apply([1.0, 0.0, 0.0])
    assert both["incidence"] == pytest.approx(math.degrees(math.acos(u)), rel=1e-12)
    assert both["force_v"] / both["force_w"] == pytest.approx(v / w, rel=1e-12)
    assert both["moment_y"] / both["moment_z"] == pytest.approx(-w / v, rel=1e-12)


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_earth_axes_are_those_of_body_axes(attitude: Rotation) -> None:
    force, turned = np.array([-900.0, 250.0, 4000.0]), 0.7
    inputs = {
        **quaternion(attitude),
        **told(("force_u", "force_v", "force_w"), force, "N"),
        "turned": f"{turned}",
    }
    found = computed("earth_axes", inputs)
    there = Rotation.from_euler("z", -turned).apply(attitude.apply(force))
    np.testing.assert_allclose([found[f"force_{n}"] for n in "xyz"], there, rtol=1e-13, atol=1e-10)


def test_wind_is_the_direction_of_motion_in_axes_that_do_not_turn() -> None:
    velocity, turned = np.array([210.0, -340.0, 95.0]), 0.7
    speed = float(np.linalg.norm(velocity))
    inputs = {
        **told(("vx", "vy", "vz"), velocity, "m/s"),
        "speed": f"{speed!r} m/s",
        "turned": f"{turned}",
    }
    found = computed("wind", inputs)
    there = Rotation.from_euler("z", turned).apply(velocity / speed)
    np.testing.assert_allclose([found[n] for n in "xyz"], there, rtol=1e-14)


# -- circuits -------------------------------------------------------------------------------------


def test_incidence_is_what_the_header_says_and_its_rates_carry_ahead() -> None:
    """Yawed by 0.4 rad and pitched by 0.2 rad from the motion: alpha and -beta."""
    record = hybrid.run(PARTS / "incidence.yaml", machine="ideal").record
    # The header's quaternion has eight digits.
    for name, value in (("alpha", 0.2), ("beta", -0.4)):
        np.testing.assert_allclose(np.radians(record[name]), value, rtol=0, atol=2e-8)
    for name, of, by in (("alpha", 0.2, 0.1), ("beta", -0.4, -0.2)):
        ahead = np.radians(record[f"{name}_ahead"].values)
        np.testing.assert_allclose(ahead, of + 0.01 * by, rtol=0, atol=2e-8)


def incidence(attitude: Rotation, machine: str, motion: np.ndarray, serial: int = 1):
    """The part with an attitude and a motion, the mean of its rows; angles to half a turn."""
    text = (PARTS / "incidence.yaml").read_text(encoding="utf-8")
    for name, value in quaternion(attitude).items():
        text = re.sub(
            rf"^  {name}: {{constant: \S+,", f"  {name}: {{constant: {value},", text, flags=re.M
        )
    for name, value in zip("xyz", motion, strict=True):
        text = re.sub(rf"e{name}: {{constant: \d", f"e{name}: {{constant: {value!r}", text)
    patch = hybrid.parse_patch(text)
    record = hybrid.run(patch, {"most": 3.2}, machine=machine, serial=serial).record
    return {name: float(record[name].mean()) for name in record.data_vars}


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_incidence_turns_the_motion_into_the_bodys_axes(attitude: Rotation) -> None:
    motion = [float(v) for v in Rotation.random(random_state=7).apply([1.0, 0.0, 0.0])]
    found = incidence(attitude, "ideal", motion)
    u, v, w = attitude.inv().apply(motion)
    np.testing.assert_allclose([found[n] for n in "uvw"], [u, v, w], rtol=0, atol=1e-12)
    assert math.radians(found["alpha"]) == pytest.approx(math.atan2(w, u), abs=1e-12)
    assert math.radians(found["beta"]) == pytest.approx(math.asin(v), abs=1e-12)


def test_incidence_is_as_good_as_the_machine() -> None:
    """Gain errors of 1e-4: six products and three sums of up to 2 lie before a direction, 1e-4 each."""
    ahead = Rotation.from_euler("ZYX", [0.3, 0.1, 1.0])
    motion = [float(v) for v in ahead.apply([math.cos(0.2), 0.0, math.sin(0.2)])]
    wrong = [
        math.radians(incidence(ahead, "nominal", motion, serial)["alpha"]) - 0.2
        for serial in range(1, 7)
    ]
    assert 1e-6 < max(map(abs, wrong)) < 9 * 2e-4


COUPLES = {
    "x_plus": 0.4,
    "x_minus": 1.1,
    "y_plus": 2.0,
    "y_minus": 0.3,
    "z_plus": 0.7,
    "z_minus": 1.9,
}


def test_thrusters_give_moments_and_take_propellant_while_they_are_open() -> None:
    """Each couple open once: impulse is moment times time, propellant force times time over Isp.

    One of each axis is open after the other, so that the flow stays within its scale: three at once.
    """
    pulses = "\n".join(
        f"  p_{n}: {{pulse: 1, at: {0.5 if n.endswith('plus') else 2.6} s, width: {width} s, "
        "full_scale: 1.01}"
        for n, width in COUPLES.items()
    )
    wired = ", ".join(f"{n}: p_{n}" for n in COUPLES)
    turns = "\n".join(
        f"  turn_{n}: {{integrate: {{jets.moment_{n}: 1}}, initial: 0, full_scale: 200 N*m*s}}"
        for n in "xyz"
    )
    text = f"""\
title: Six pulses
machine: ideal
parts: {{jets: {{file: parts/thrusters.yaml, inputs: {{{wired}}}}}}}
analog:
{pulses}
{turns}
run: {{until: 5 s, every: 0.01 s}}
"""
    result = hybrid.run(hybrid.parse_patch(text, str(PARTS.parent / "one.yaml")))
    assert not result.overloads
    record, moments = result.record, {"x": 50.0, "y": 75.0, "z": 75.0}
    time, taken = record["time"].values, 0.0
    for n, moment in moments.items():
        plus, minus = COUPLES[f"{n}_plus"], COUPLES[f"{n}_minus"]
        assert float(record[f"turn_{n}"][-1]) == pytest.approx(moment * (plus - minus), abs=2e-7)
        taken += moment / (1.5 * 2200.0) * (plus + minus)
    assert float(record["jets.propellant"][-1]) == pytest.approx(1e3 * taken, abs=1e-6)  # g
    for at, flow, about_x in ((0.7, 200.0, 50.0), (1.0, 150.0, 0.0), (2.8, 200.0, -50.0)):
        row = np.searchsorted(time, at)
        assert float(record["jets.flow"][row]) == pytest.approx(flow / 1.5 / 2.2, rel=1e-8)
        assert float(record["jets.moment_x"][row]) == pytest.approx(about_x, abs=1e-6)


def test_one_couple_by_itself_takes_what_the_header_says() -> None:
    record = hybrid.run(PARTS / "thrusters.yaml", machine="ideal").record
    time = record["time"].values
    rate = 50.0 / 1.5 / 2200.0
    np.testing.assert_allclose(record["propellant"], 1e3 * rate * time, atol=1e-6)
    assert 1e3 * rate == pytest.approx(15.15, abs=0.005)


# -- all of them ----------------------------------------------------------------------------------

OURS = {path.stem for path in PARTS.glob("*.yaml")} - {"f16"}


@pytest.mark.parametrize("part", sorted(OURS))
def test_every_part_runs_by_itself(part: str) -> None:
    """As it ships, on its own machine, whole, and with nothing beyond its scale."""
    result = hybrid.run(PARTS / f"{part}.yaml")
    assert result.status == "complete" and not result.overloads
    # Below its lowest height the cone's table says that the air is dense.
    assert bool(result.outside) == (part == "capsule")


def test_every_part_is_named_in_a_test_of_its_own() -> None:
    here = Path(__file__).parent
    texts = "".join(path.read_text(encoding="utf-8") for path in here.glob("test_*.py"))
    unnamed = {p for p in OURS if f'"{p}"' not in texts and f"{p}.yaml" not in texts}
    assert not unnamed
