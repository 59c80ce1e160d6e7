"""A blunt cone that enters the atmosphere: its table, its flight and its swing, beside theory."""

from __future__ import annotations

import math
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sphere_cone as cone
from scipy.integrate import cumulative_trapezoid, solve_ivp
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation
from six_dof import EARTH_RATE, local_directions

import hybrid
from hybrid import surroundings
from hybrid.shipped import shipped_folder, shipped_patches

MASS, INERTIA, ROLL_INERTIA = 3000.0, 3600.0, 4000.0
GENTLE = {"pitch": "-5 deg"}  # 3 deg above the path: within the first 5 deg the table is one line
DIGITAL = {"lead": 0.0, "compute_time": 0.0}  # with which the digital machine flies it alone
TABLE = shipped_folder() / "parts" / "sphere_cone.csv"


# -- the table ------------------------------------------------------------------------------------


def by_pressure(alpha: float, newton: bool) -> np.ndarray:
    """Axial, normal and moment coefficient by summing over the surface; k = 1, or free molecules."""

    def summed(back, radius, slope, ahead):
        """Strips of a surface of revolution; the normal leans forward by `ahead` (its sine)."""
        angle = (np.arange(400) + 0.5) * 2 * np.pi / 400  # from the windward side
        back, radius, slope, ahead = (
            np.broadcast_to(v, back.shape)[:, None] for v in (back, radius, slope, ahead)
        )
        out = np.sqrt(1 - ahead**2)
        into = ahead * math.cos(alpha) + out * math.sin(alpha) * np.cos(angle)
        area = radius * slope * 2 * np.pi / 400 / cone.AREA
        if newton:
            aft, up = into**2 * ahead, into**2 * out * np.cos(angle)
        else:  # all momentum of the stream: 2 (n.v) along the stream
            aft, up = 2 * into * math.cos(alpha), 2 * into * math.sin(alpha)
        low = radius * np.cos(angle)  # on the windward side
        moment = -(up * (back - cone.CENTRE) + aft * low) / cone.LENGTH
        return np.array([np.sum(f * area) for f in (aft, up, moment)])

    n = 4000
    bend = (np.arange(n) + 0.5) / n * (np.pi / 2 - cone.HALF)
    step = (np.pi / 2 - cone.HALF) / n
    cap = summed(
        cone.NOSE * (1 - np.cos(bend)), cone.NOSE * np.sin(bend), cone.NOSE * step, np.cos(bend)
    )
    along = (np.arange(n) + 0.5) / n * (cone.RADIUS - cone.EDGE)
    side = (cone.RADIUS - cone.EDGE) / n / math.sin(cone.HALF)
    frustum = summed(
        cone.EDGE_BACK + along / math.tan(cone.HALF),
        cone.EDGE + along,
        side,
        np.array(math.sin(cone.HALF)),
    )
    return cap + frustum


@pytest.mark.parametrize("degrees", [0.0, 5.0, 20.0, 45.0])
def test_the_closed_forms_are_the_integrals_over_the_surface(degrees: float) -> None:
    alpha = math.radians(degrees)
    for newton, closed in ((True, cone.newtonian), (False, cone.free_molecular)):
        np.testing.assert_allclose(closed(alpha), by_pressure(alpha, newton), atol=3e-7)


def test_the_stagnation_pressure_is_that_of_the_tables() -> None:
    """NACA Report 1135: p02/p1 = 5.640 at M = 2 and 129.2 at M = 10; 1.839 at the limit."""
    for mach, ratio in ((2.0, 5.640), (10.0, 129.2)):
        assert cone.stagnation(mach) == pytest.approx((ratio - 1) / (0.7 * mach**2), rel=4e-4)
    assert cone.stagnation(1e4) == pytest.approx(1.8394, abs=1e-4)


def test_the_table_that_ships_is_that_of_the_formulas() -> None:
    assert TABLE.read_text(encoding="utf-8") == cone.table()
    shares = [cone.bridge(h * 1e3) for h in (70.0, 100.0, 150.0)]
    assert shares[0] == 0.0 and 0.2 < shares[1] < 0.5 and shares[2] > 0.95


# -- the flight, integrated independently ---------------------------------------------------------


def interpolator() -> RegularGridInterpolator:
    rows = np.genfromtxt(TABLE, delimiter=",", names=True, skip_header=4)
    axes = [np.unique(rows[name]) for name in ("mach", "height", "incidence")]
    shape = tuple(map(len, axes))
    values = np.stack([rows[n].reshape(shape) for n in ("axial", "normal", "pitching")], axis=-1)
    found = RegularGridInterpolator(axes, values)
    low, high = (np.array([end(axis) for axis in axes]) for end in (np.min, np.max))
    return lambda point: found(np.clip(point, low, high))[0]


def start(yaw: float, pitch: float, speed: tuple[float, float]) -> np.ndarray:
    """Place and velocity in inertial axes, attitude as a quaternion, rates."""
    latitude = math.radians(30.0)
    place = np.array(surroundings.earth_fixed(latitude, 0.0, 100e3))
    local = local_directions(np.array([latitude]), np.array([0.0]))[:, :, 0]
    velocity = local @ [0.0, *speed] + np.cross([0, 0, EARTH_RATE], place)
    body = Rotation.from_euler("ZYX", [yaw, pitch, 0.0], degrees=True).as_matrix()
    return np.array([*place, *velocity, *Rotation.from_matrix(local @ body).as_quat(), 0, 0, 0])


def rates_of(coefficients):
    """Six degrees of freedom in axes that do not turn; quaternions as (x, y, z, s)."""

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        place, velocity, quaternion, spin = y[:3], y[3:6], y[6:10], y[10:]
        turn = Rotation.from_quat(quaternion).as_matrix()
        wind = velocity - np.cross([0, 0, EARTH_RATE], place)
        u, v, w = turn.T @ wind
        height = surroundings.geodetic(*place)[2]
        temperature, pressure = surroundings.us76(height)
        side, speed = math.hypot(v, w), float(np.linalg.norm(wind))
        push = 0.7 * pressure * speed**2 / surroundings.us76_sound_speed(temperature) ** 2
        push *= 12.566371
        mach = speed / surroundings.us76_sound_speed(temperature)
        a, n, m = coefficients([mach, height / 1e3, math.degrees(math.atan2(side, u))])
        force = turn @ np.array([-a, -n * v / side, -n * w / side]) * push
        gravity = surroundings.gravity_j2(*place, surroundings.WGS84_GM, 6378137.0, 1.08262982e-3)
        moments = push * 4.0 * m / side * np.array([0.0, w, -v])
        size = np.array([ROLL_INERTIA, INERTIA, INERTIA])
        x, y_, z, s = quaternion
        p, q, r = spin
        turning = 0.5 * np.array(
            [
                s * p + y_ * r - z * q,
                s * q + z * p - x * r,
                s * r + x * q - y_ * p,
                -(x * p + y_ * q + z * r),
            ]
        )
        spun = (moments - np.cross(spin, size * spin)) / size
        return np.array([*velocity, *(gravity + force / MASS), *turning, *spun])

    return rates


def played(until: float, given=None, machine="digital", every: float = 0.02):
    """The patch over a shorter time, on a machine of that preset or on the digital machine alone."""
    file, alone = shipped_patches()["reentry"], machine == "digital"
    text = file.read_text(encoding="utf-8").replace(", from: 50 s", "")
    text = text.replace("until: 100 s, every: 0.02 s", f"until: {until} s, every: {every} s")
    patch = hybrid.parse_patch(text, str(file), "digital" if alone else None)
    given = {**(DIGITAL if alone else {}), **(given or {})}
    result = hybrid.run(patch, given, machine="ideal" if alone else machine)
    assert result.status == "complete"
    return result


def test_the_digital_flight_is_that_of_an_independent_integration() -> None:
    """Askew in pitch and in yaw, for 50 s; the swing's phase is what a step of RK4 gets wrong."""
    record = played(50.0, {"yaw": "80 deg"}, every=0.1).record
    time = record["time"].values[1:]
    first = start(80.0, 12.0, (7330.0, 1030.0))
    flown = solve_ivp(
        rates_of(interpolator()), (0, 50), first, "DOP853", time, rtol=1e-9, atol=1e-9
    ).y
    swing = np.degrees(record["air.incidence"].values[1:])
    expected, height, speed = [], [], []
    for y in flown.T:
        wind = y[3:6] - np.cross([0, 0, EARTH_RATE], y[:3])
        u, v, w = Rotation.from_quat(y[6:10]).as_matrix().T @ wind
        expected.append(math.degrees(math.atan2(math.hypot(v, w), u)))
        height.append(surroundings.geodetic(*y[:3])[2])
        speed.append(math.sqrt(u * u + v * v + w * w))
    # (w T)^5/120 a step: the swing, of 10 rad/s at most and some 5 deg then, is off by less than
    # 5000 steps of that; where the table has corners it is one order less, for some hundred steps.
    bound = 5.0 * (5000 * 0.1**5 / 120 + 300 * 0.1**4 / 24)
    assert np.abs(swing - expected).max() < bound
    # Of 7400 m/s; what the force is off by the angle squared (1e-3 at most) times 25 m/s^2.
    assert np.abs(record["flight.speed"].values[1:] - speed).max() < 1e-3
    assert np.abs(record["flight.height"].values[1:] - height).max() < 1e-2


# -- what the swing and the flight obey -----------------------------------------------------------


@cache
def gentle(machine: str = "digital", lead: str = ""):
    """Angle of attack (rad) and frequency of the swing (rad/s) at the rows of a gentle start."""
    given = {**GENTLE, **({"lead": lead} if lead else {})}
    record = played(45.0, given, machine).record.isel(time=slice(1, None))
    coefficients = interpolator()
    points = zip(record["air.mach"].values, record["flight.height"].values / 1e3, strict=True)
    slope = np.array([coefficients([m, h, 5.0])[2] / math.radians(5.0) for m, h in points])
    pressure = record["air.pressure"].values
    omega = np.sqrt(np.maximum(-slope * pressure * 12.566371 * 4.0 / INERTIA, 0.0))
    return record["time"].values, record["axes.alpha"].values, omega


def crossed(time: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """When the angle of attack passes 0, by straight lines between rows."""
    at = np.flatnonzero(np.diff(np.sign(alpha)) != 0)
    return time[at] - alpha[at] * (time[at + 1] - time[at]) / (alpha[at + 1] - alpha[at])


def test_the_swing_has_the_frequency_of_the_moments_slope() -> None:
    """Half a swing is where the integral of sqrt(-M_alpha/I) has grown by pi, as pressure grows."""
    time, alpha, omega = gentle()
    zeros = crossed(time, alpha)
    phase = np.interp(zeros, time[1:], cumulative_trapezoid(omega, time))
    late = zeros[:-1] > 15.0
    assert late.sum() > 25
    # In air that gets denser like exp(k t) the swing is J0(2 w/k): its zeros are pi (1 - (k/w)^2/32)
    # apart; k = 0.15 1/s. Lines between rows 0.02 s apart err by (w 0.02)^3/8. The path's turning
    # changes by less than 1e-4 rad/s^2, so the middle of the swing, of 0.01 rad, is 1e-4/w^2 off.
    w = np.interp(zeros[:-1], time, omega)[late]
    bound = math.pi * (0.15 / w) ** 2 / 32 + 2 * (w * 0.02) ** 3 / 8 + 2 * 1e-2 / w**2
    assert (np.abs(np.diff(phase)[late] - math.pi) < bound).all()
    assert omega.max() / omega[0] > 20


def envelope(time: np.ndarray, alpha: np.ndarray) -> tuple[float, float]:
    """Time and size of the last whole swing's extremes, the mean of two, by parabolas."""
    inner = slice(1, -1)
    tops = (
        np.flatnonzero(
            (np.abs(alpha[inner]) > np.abs(alpha[:-2]))
            & (np.abs(alpha[inner]) >= np.abs(alpha[2:]))
        )
        + 1
    )
    sizes = []
    for i in tops[-4:]:
        a, b, c = np.abs(alpha[i - 1 : i + 2])
        sizes.append(b - (a - c) ** 2 / (8 * (a - 2 * b + c)))
    return float(time[tops[-4:]].mean()), float(np.mean(sizes))


def test_the_swing_shrinks_as_pressure_grows() -> None:
    """Like w^-1/2, the action being kept, but for what lift and drag take: damping of the path."""
    time, alpha, omega = gentle()
    early = time < 25.0
    ends = [envelope(time[early], alpha[early]), envelope(time, alpha)]
    kept = [size * math.sqrt(np.interp(t, time, omega)) for t, size in ends]
    # C_N' q S/(2 m V) damps it, 0.005 1/s at the end and less than half of that before: 2 %.
    assert kept[1] / kept[0] == pytest.approx(1.0, abs=0.02)


def test_without_lead_the_digital_machine_feeds_the_swing() -> None:
    """zeta = -w d/2, d the compute time and half a cycle: growth of w^2 d/2; with lead none."""
    time, alpha, omega = gentle()
    d = 5e-3 + 10e-3 / 2
    t, size = envelope(time, alpha)
    grown = 0.5 * d * np.interp(t, time[1:], cumulative_trapezoid(omega**2, time))
    assert grown > 1.0
    for lead, expected in (("0 s", grown), ("", 0.0)):
        _, size_hybrid = envelope(*gentle("lags", lead)[:2])
        # Of the next order: (w d)^3/6 in place of w d/2, and T^2/12 more in its square.
        bound = 0.02 + grown * (omega.max() * d) ** 2
        assert math.log(size_hybrid / size) == pytest.approx(expected, abs=bound)


@pytest.mark.parametrize("scale", [6500.0, 7500.0])
def test_the_hardest_deceleration_is_that_of_allen_and_eggers(tmp_path: Path, scale: float) -> None:
    """V^2 sin(gamma)/(2 e H), whatever the ballistic coefficient (NACA Report 1381): straight down.

    Isothermal air. On the way gravity adds 2 g z to V^2 at most, z the way to the hardest point.
    """
    shutil.copytree(shipped_folder() / "parts", tmp_path / "parts")
    air = tmp_path / "parts" / "capsule.yaml"
    text = air.read_text(encoding="utf-8")
    thin = f"density_exponential(height, 1.225, {scale})"
    air.write_text(
        text.replace("pressure: density_us76(height)*speed**2/2", f'pressure: "{thin}*speed**2/2"'),
        encoding="utf-8",
    )
    text = shipped_patches()["reentry"].read_text(encoding="utf-8")
    (tmp_path / "fall.yaml").write_text(
        text.replace("100 s, every: 0.02 s", "30 s, every: 0.02 s").replace(", from: 50 s", ""),
        encoding="utf-8",
    )
    found = []
    for mass in (2000.0, 3000.0):
        fall = {"east": 0.0, "down": 6000.0, "pitch": "-90 deg", "mass": mass}
        patch = hybrid.read_patch(tmp_path / "fall.yaml", "digital")
        result = hybrid.run(patch, {**DIGITAL, **fall}, machine="ideal")
        hardest = result.readouts["hardest"]
        height = np.interp(hardest["time_s"], result.record["time"], result.record["flight.height"])
        # Where density H = m/(C A), C_A = 0.96 to 1 of k = 1.84 about a Mach number of 12.
        depth = 1.225 * math.exp(-height / scale) * scale * cone.AREA / mass
        assert 0.9 < depth < 1.2
        expected = 6000.0**2 / (2 * math.e * scale)
        gained = 2 * 9.83 * (100e3 - height) / 6000.0**2
        assert expected * 0.99 < hardest["value"] < expected * (1.01 + gained)
        found.append(hardest["value"])
    assert found[0] == pytest.approx(found[1], rel=gained)


def test_both_machines_fly_the_same_path() -> None:
    """Lags and converters hardly touch the path; the swing is what T may change."""
    split = played(45.0, machine="lags")
    whole = played(45.0)
    a, b = split.record.isel(time=slice(1, None)), whole.record.isel(time=slice(1, None))
    assert split.overloads == ()
    late = a["time"].values > 1.0
    # Words are a compute time old: 5 ms of what the forces change, 60 m/s^2 at most, and of the fall.
    assert np.abs(a["flight.speed"].values - b["flight.speed"].values)[late].max() < 60 * 0.015 * 2
    assert np.abs(a["flight.height"].values - b["flight.height"].values)[late].max() < 1030 * 0.015
