"""The digital parts of six degrees of freedom, each by itself, beside theory and tight integration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from scipy.special import ellipk
from six_dof import (
    EARTH_RATE,
    REFERENCE,
    free_body,
    local_directions,
    nasa,
    settings,
    tensor,
    turned,
)

import hybrid
from hybrid import surroundings
from hybrid.patch import literal
from hybrid.shipped import shipped_folder

PARTS = shipped_folder() / "parts"
INERTIA = np.array([1.0, 2.0, 3.0])
FT = 0.3048


def play(part: str, until_s: float, every_s: float, settings: dict[str, float]):
    """A digital part by itself, its words shown in the cycle that computes them."""
    text = (PARTS / f"{part}.yaml").read_text(encoding="utf-8")
    head, _, _ = text.partition("\nrun:")
    head = head.replace("  period: 10 ms", f"  period: {every_s} s\n  compute_time: 0")
    text = f"{head}\nrun: {{until: {until_s} s}}\n"
    result = hybrid.run(hybrid.parse_patch(text, part), settings, machine="ideal")
    assert result.status == "complete"
    return result.record


@pytest.mark.parametrize("seed", [1, 2])
def test_a_free_body_is_right_to_fourth_order(seed: int) -> None:
    matrix, axes = tensor(INERTIA, seed)
    start = np.array([0.3, 0.5, -0.4])
    errors = []
    for step in (0.1, 0.05):
        record = play("euler_digital", 20.0, step, settings(matrix, axes @ start))
        rates = np.array([record[name].values for name in "pqr"])
        errors.append(np.abs(rates - axes @ free_body(INERTIA, start, record["time"].values)).max())
    # (h^4, with terms of h^5 and h^6 that are smaller by the step times the rates, 0.1)
    assert errors[0] < 1e-4 and 14.0 < errors[0] / errors[1] < 18.0


def test_the_quaternion_of_a_steady_turn() -> None:
    record = play("attitude_digital", 10.0, 0.01, {})
    rate, time = np.array([0.3, -0.2, 0.6]), record["time"].values
    size = np.linalg.norm(rate)
    expected = [np.cos(size * time / 2), *np.outer(rate / size, np.sin(size * time / 2))]
    # Local error of RK4 on q' = i (size/2) q: (size h/2)^5/120 a step, of 1000.
    np.testing.assert_allclose(
        [record[n].values for n in "sxyz"], expected, atol=1000 * (0.0035**5) / 120 * 1.01 + 1e-14
    )


def test_the_length_of_the_digital_quaternion_is_held() -> None:
    """RK4 multiplies it by 1 - a^6/144 a cycle, a = |w| T/2 (|1 + ia - a^2/2 - ia^3/6 + a^4/24|), so
    that the excess, twice that, grows evenly. The stages are longer or shorter than the quaternion: the
    tie sees (2 (-a^2/4) + 2 (a^2/4 - a^4/16) + a^4/4)/6 = a^4/48 of that. Both are at rest together."""
    half, tie = np.linalg.norm([0.3, -0.2, 0.6]) / 2, 0.05
    lost = half**6 / 72 * (1 - half**2 / 8)
    free = play("attitude_digital", 300.0, 1.0, {"tie": 0.0})["excess"].values
    np.testing.assert_allclose(free, -np.expm1(np.arange(301) * np.log1p(-lost)), atol=1e-12)
    held = play("attitude_digital", 300.0, 1.0, {"tie": tie})["excess"].values
    # (to tie T of what it comes to, lost/tie)
    assert held[-1] == pytest.approx(lost / tie - half**4 / 48, abs=lost)
    assert held[-1] == pytest.approx(held[-2], rel=1e-3) and free[-1] > 10 * held[-1]


def test_an_excess_of_the_digital_quaternion_dies_with_the_tie() -> None:
    """excess' = -tie excess (1 - excess), so excess/(1 - excess) falls as exp(-tie t)."""
    record = play("attitude_digital", 5.0, 0.01, {"a_s": 0.95})
    left = (1 - 0.95**2) / 0.95**2 * np.exp(-record["time"].values)
    np.testing.assert_allclose(record["excess"], left / (1 + left), atol=1e-10)


PLACES = [
    {"latitude": 0.0, "longitude": 0.0, "yaw": 0.0, "pitch": 0.0, "roll": 0.0},
    {"latitude": 0.63, "longitude": -1.32, "yaw": 0.79, "pitch": 0.05, "roll": -0.2},
    {"latitude": -1.1, "longitude": 2.9, "yaw": -2.5, "pitch": -1.3, "roll": 3.0},
]


@pytest.mark.parametrize("given", PLACES)
@pytest.mark.parametrize("part", ["attitude", "attitude_digital"])
def test_attitude_starts_as_yaw_pitch_and_roll_at_a_place(part: str, given: dict) -> None:
    record = hybrid.run(PARTS / f"{part}.yaml", given, machine="ideal").record
    found = turned(np.array([[float(record[name][int(part != "attitude")])] for name in "sxyz"]))
    c, s = np.cos, np.sin
    yaw, pitch, roll = (given[name] for name in ("yaw", "pitch", "roll"))
    body = (
        np.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
        @ np.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
        @ np.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
    )
    place = local_directions(np.array([given["latitude"]]), np.array([given["longitude"]]))
    np.testing.assert_allclose(found[:, :, 0], place[:, :, 0] @ body, atol=1e-14)


@pytest.mark.parametrize("given", PLACES)
@pytest.mark.parametrize("length", [1.0, 0.98])
def test_angles_are_those_that_the_attitude_starts_with(
    tmp_path: Path, given: dict, length: float
) -> None:
    text = f"""
title: Angles
parameters: {{latitude: 0, longitude: 0, yaw: 0, pitch: 0, roll: 0}}
parts:
  attitude:
    file: parts/attitude_digital.yaml
    inputs: {{p: 0, q: 0, r: 0}}
    parameters: {{latitude: latitude, longitude: longitude, yaw: yaw, pitch: pitch, roll: roll}}
  angles:
    file: parts/angles.yaml
    inputs:
      s: {length}*attitude.s
      x: {length}*attitude.x
      y: {length}*attitude.y
      z: {length}*attitude.z
      latitude: latitude
      longitude: longitude - 0.4
      turned: 0.4
digital: {{period: 1 s, compute_time: 0}}
run: {{until: 1 s}}
"""
    record = hybrid.run(hybrid.parse_patch(text), given, machine="ideal").record
    for name in ("yaw", "pitch", "roll"):
        difference = np.radians(float(record[f"angles.{name}"][-1])) - given[name]
        assert abs((difference + np.pi) % (2 * np.pi) - np.pi) < 1e-14, name


@pytest.mark.parametrize(
    ("latitude", "longitude", "height", "north", "east", "down"),
    [(0.0, 0.0, 9144.0, 0.0, 0.0, 0.0), (0.7, -1.3, 3000.0, 120.0, -80.0, -30.0)],
)
def test_flight_is_that_in_axes_that_do_not_turn(
    latitude: float, longitude: float, height: float, north: float, east: float, down: float
) -> None:
    """Beside an integration in inertial axes, with no word of Coriolis or centrifugal forces."""
    given = {
        "latitude_start": latitude,
        "longitude_start": longitude,
        "height_start": height,
        "north_start": north,
        "east_start": east,
        "down_start": down,
    }
    record = play("flight", 30.0, 0.05, given)
    time = record["time"].values
    earth = np.array([0.0, 0.0, EARTH_RATE])
    place = np.array(surroundings.earth_fixed(latitude, longitude, height))
    axes = local_directions(np.array([latitude]), np.array([longitude]))[:, :, 0]
    speed = axes @ [north, east, down] + np.cross(earth, place)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        field = surroundings.WGS84_GM, surroundings.WGS84_RADIUS_M, surroundings.WGS84_J2
        return np.array([*y[3:], *surroundings.gravity_j2(*y[:3], *field)])

    flown = solve_ivp(rates, (0, 30), [*place, *speed], "DOP853", time, rtol=1e-13, atol=1e-6).y
    c, s = np.cos(EARTH_RATE * time), np.sin(EARTH_RATE * time)
    fixed = np.array([c * flown[0] + s * flown[1], c * flown[1] - s * flown[0], flown[2]])
    found = np.array([record[name].values for name in "xyz"])
    # Distances of 6.4e6 m in double precision, summed over 600 cycles.
    np.testing.assert_allclose(found, fixed, rtol=0, atol=1e-6)
    lat, lon, high = np.transpose([surroundings.geodetic(*p) for p in fixed.T])
    np.testing.assert_allclose(np.radians(record["latitude"]), lat, atol=1e-12)
    np.testing.assert_allclose(np.radians(record["longitude"]), lon, atol=1e-12)
    np.testing.assert_allclose(record["height"], high, atol=2e-6)
    told = [float(record[name][0]) for name in ("north", "east", "down")]
    np.testing.assert_allclose(told, [north, east, down], atol=1e-12)
    np.testing.assert_allclose(record["turned"], EARTH_RATE * time, atol=1e-15)


def test_a_cylinder_swings_like_a_pendulum_of_twice_the_angle() -> None:
    """theta'' = -(3/2) n^2 k sin 2 theta in a circular orbit, k = (Iyy - Ixx)/Izz."""
    file = shipped_folder() / "orbiting_cylinder.yaml"
    text = file.read_text(encoding="utf-8").replace(
        "until: 1 h, every: 10 s", "until: 3 h, every: 60 s"
    )
    patch = hybrid.parse_patch(text, str(file), "digital")
    record = hybrid.run(patch, {"compute_time": 0.0}).record
    angle = np.arctan2(record["orbit.y"], record["orbit.x"]).values
    axis = 2 * np.arctan2(record["attitude.z"], record["attitude.s"]).values
    swing = (axis - angle + np.pi / 2) % np.pi - np.pi / 2
    time, rate = record["time"].values, np.sqrt(3.986004415e14 / 6778e3**3)
    period = 4 * ellipk(np.sin(np.radians(5)) ** 2) / (rate * np.sqrt(3 * 11750 / 12250))
    falls = np.flatnonzero((swing[:-1] > 0) & (swing[1:] <= 0))
    crossings = [np.interp(0, -swing[i : i + 2], time[i : i + 2]) for i in falls]
    # A row a minute: the chord is off by at most (w h)^2/8 of the amplitude, 0.18 % of 1/w or 0.9 s.
    np.testing.assert_allclose(crossings, period * (0.25 + np.arange(len(crossings))), atol=0.9)
    assert len(crossings) >= 2 and np.degrees(swing.max()) == pytest.approx(5.0, abs=0.01)


def test_the_singularity_of_the_angles_is_passed_and_told() -> None:
    """Over the top at a steady rate: the pitch rises to 90 deg and falls, yaw and roll turn over."""
    text = """
title: Over the top
parts:
  attitude:
    file: parts/attitude_digital.yaml
    inputs: {p: 0 rad/s, q: 0.5 rad/s, r: 0 rad/s}
    parameters: {latitude: 0}
  angles:
    file: parts/angles.yaml
    inputs:
      s: attitude.s
      x: attitude.x
      y: attitude.y
      z: attitude.z
      latitude: 0
      longitude: 0
      turned: 0
digital: {period: 10 ms, compute_time: 0, integration: rk4}
run: {until: 6.2 s}
"""
    made = hybrid.run(hybrid.parse_patch(text), machine="ideal")
    record = made.record
    turned_by = 0.5 * record["time"].values
    shown = {name: np.radians(record[f"angles.{name}"]) for name in ("yaw", "pitch", "roll")}
    before = turned_by < np.pi / 2
    expected = np.where(before, turned_by, np.pi - turned_by)
    np.testing.assert_allclose(shown["pitch"], expected, atol=1e-9)
    for name in ("yaw", "roll"):
        np.testing.assert_allclose(np.abs(shown[name]), np.where(before, 0.0, np.pi), atol=1e-9)
    size = sum(record[f"attitude.{name}"].values ** 2 for name in "sxyz")
    np.testing.assert_allclose(size, 1.0, atol=1e-12)  # the attitude knows nothing of it
    # A cycle every 0.005 rad: 7 of them within 1 deg of 90 deg, the first after 89 deg.
    assert np.count_nonzero(np.abs(turned_by - np.pi / 2) < np.radians(1.0)) == 7
    (told,) = made.outside
    assert (told["function"], told["times"], told["action"]) == ("angles.gimbal", 7, "clamped")
    assert told["time_s"] == 3.11 and "angles.gimbal" in made.status_note


def test_what_the_air_does_to_a_body_is_that_of_its_coefficients() -> None:
    """By the formulas with the speed below: L = clp (p b/2V) q S b; in sea level air of 1.225 kg/m^3."""
    text = """\
title: Air
parts:
  body:
    file: parts/damping.yaml
    inputs: {p: 1e-3 rad/s, q: -2e-3 rad/s, r: 3e-3 rad/s, s: 0.5, x: 0.1, y: -0.7, z: 0.5,
      density: 0.9 kg/m^3, speed: 50 m/s}
    parameters: {area: 2 m^2, span: 3 m, chord: 0.5 m, clp: -0.4, cmq: -8, cnr: -0.2}
  ball:
    file: parts/drag.yaml
    inputs: {vx: 100 m/s, vy: -50 m/s, vz: 20 m/s, height: 0 m}
    parameters: {area: 2 m^2, coefficient: 0.3}
digital: {period: 1 s, compute_time: 0}
run: {until: 1 s}
"""
    record = hybrid.run(hybrid.parse_patch(text, str(PARTS.parent / "air.yaml"))).record
    shown = {name: float(record[name][-1]) for name in record.data_vars}
    attitude = Rotation.from_quat([0.1, -0.7, 0.5, 0.5])  # of length 1
    rates = np.array([1e-3, -2e-3, 3e-3]) - attitude.inv().apply([0.0, 0.0, EARTH_RATE])
    lengths, slopes = np.array([3.0, 0.5, 3.0]), np.array([-0.4, -8.0, -0.2])
    moments = slopes * rates * lengths / (2 * 50.0) * (0.9 * 50.0**2 / 2 * 2.0 * lengths)
    found = [shown[f"body.moment_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(found, moments, rtol=1e-12)
    velocity = np.array([100.0, -50.0, 20.0])
    speed = np.linalg.norm(velocity)
    drag = 1.225 * speed**2 / 2 * 2.0 * 0.3
    found = [shown[f"ball.force_{axis}"] for axis in "xyz"]
    # The table of the standard gives 1.2250 kg/m^3 and 340.294 m/s in so many digits.
    np.testing.assert_allclose(found, -drag * velocity / speed, rtol=5e-5)
    assert shown["ball.mach"] == pytest.approx(speed / 340.294, rel=2e-6)


def test_the_f16_of_nasa_on_the_digital_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten seconds of case 11 from the published trim, within what is allowed of a digital machine."""
    published = nasa("11", "05")[:11]
    monkeypatch.setenv("HYBRID_REFERENCE", str(REFERENCE.resolve()))
    patch = hybrid.read_patch(PARTS / "f16.yaml", "digital")
    patch = replace(patch, run=replace(patch.run, until=literal(10.0), every=literal(1.0)))
    rates = zip("pqr", ("Roll", "Pitch", "Yaw"), strict=True)
    given = {
        f"{n}_start": np.radians(published[f"bodyAngularRateWrtEi_deg_s_{axis}"][0])
        for n, axis in rates
    }
    record = hybrid.run(patch, {**given, "compute_time": 0.0}).record
    np.testing.assert_allclose(record["time"], published["time"], atol=1e-9)
    height = record["flight.height"].values / FT
    np.testing.assert_allclose(height, published["altitudeMsl_ft"], rtol=0, atol=0.05)
    for name, axis in (("north", "X"), ("east", "Y"), ("down", "Z")):
        speed = record[f"flight.{name}"].values / FT
        np.testing.assert_allclose(speed, published[f"feVelocity_ft_s_{axis}"], rtol=0, atol=1e-3)
    for name in ("yaw", "pitch", "roll"):
        angle = record[f"angles.{name}"].values
        told = published[f"eulerAngle_deg_{name.capitalize()}"]
        np.testing.assert_allclose(angle, told, rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("on", "says"),
    [
        ("analog", "is of a model, which has no analog form; keep what reads it on the digital"),
        ({"axes": "analog"}, "is more than one component"),
        ({"axes.c": "analog"}, "needs a full scale"),
    ],
)
def test_what_the_analog_machine_cannot_have_of_the_f16_is_one_line(
    monkeypatch: pytest.MonkeyPatch, on: str | dict[str, str], says: str
) -> None:
    nasa("11", "05")
    monkeypatch.setenv("HYBRID_REFERENCE", str(REFERENCE.resolve()))
    with pytest.raises(hybrid.HybridError) as raised:
        hybrid.read_patch(PARTS / "f16.yaml", on)
    assert says in str(raised.value) and "\n" not in str(raised.value)
