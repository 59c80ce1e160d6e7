"""The figures by which two flights of a case are compared, whoever flew them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

FT, DEG = 0.3048, np.pi / 180
# Name of a signal -> its values at the published times, SI.
Shown = Callable[[str], np.ndarray]
Published = np.ndarray

# Signal -> column of a published run and SI value of its unit.
COLUMNS: Mapping[str, tuple[str, float]] = {
    "flight.height": ("altitudeMsl_ft", FT),
    "flight.longitude": ("longitude_deg", DEG),
    "flight.north": ("feVelocity_ft_s_X", FT),
    "flight.east": ("feVelocity_ft_s_Y", FT),
    "flight.down": ("feVelocity_ft_s_Z", FT),
    "angles.yaw": ("eulerAngle_deg_Yaw", DEG),
    "angles.pitch": ("eulerAngle_deg_Pitch", DEG),
    "angles.roll": ("eulerAngle_deg_Roll", DEG),
    "body.p": ("bodyAngularRateWrtEi_deg_s_Roll", DEG),
    "body.q": ("bodyAngularRateWrtEi_deg_s_Pitch", DEG),
    "body.r": ("bodyAngularRateWrtEi_deg_s_Yaw", DEG),
}
# The same of an orbit; NASA's quaternion turns the other way.
ORBIT_COLUMNS: Mapping[str, tuple[str, float]] = {
    **{f"orbit.{axis}": (f"{axis}_m", 1.0) for axis in "xyz"},
    **{f"orbit.v{axis}": (f"v{axis}_m_s", 1.0) for axis in "xyz"},
    **{f"body.{rate}": (f"w{axis}_rad_s", 1.0) for rate, axis in zip("pqr", "xyz", strict=True)},
    "attitude.s": ("q_scalar", 1.0),
    **{f"attitude.{axis}": (f"q_v{i}", -1.0) for i, axis in enumerate("xyz")},
}
# Figure -> the signals of which the largest difference is taken, and its unit.
LARGEST: Mapping[str, tuple[tuple[str, ...], float]] = {
    "altitude_ft": (("flight.height",), FT),
    "longitude_deg": (("flight.longitude",), DEG),
    "velocity_ft_s": (("flight.north", "flight.east", "flight.down"), FT),
    "euler_deg": (("angles.yaw", "angles.pitch", "angles.roll"), DEG),
    "pitch_deg": (("angles.pitch",), DEG),
    "rate_deg_s": (("body.p", "body.q", "body.r"), DEG),
}
# Figure -> the signals whose vectors are compared at the end of the flight, SI.
VECTORS: Mapping[str, tuple[str, ...]] = {
    "position_m": ("orbit.x", "orbit.y", "orbit.z"),
    "velocity_m_s": ("orbit.vx", "orbit.vy", "orbit.vz"),
    "rate_rad_s": ("body.p", "body.q", "body.r"),
}
ANGLES = frozenset({"flight.longitude", "angles.yaw", "angles.pitch", "angles.roll"})


def published_as_shown(published: Published, orbits: bool) -> Shown:
    """A published run under the names of our signals."""
    columns = ORBIT_COLUMNS if orbits else COLUMNS

    def shown(name: str) -> np.ndarray:
        column, unit = columns[name]
        return published[column] * unit

    return shown


def apart(one: Shown, other: Shown, figure: str) -> float:
    """By how much two flights differ."""
    if figure in LARGEST:
        signals, unit = LARGEST[figure]
        return max(_largest(one(name), other(name), name in ANGLES) for name in signals) / unit
    if figure in VECTORS:
        ends = [one(name)[-1] - other(name)[-1] for name in VECTORS[figure]]
        return float(np.linalg.norm(ends))
    assert figure == "attitude_deg", figure
    turned = _turned(
        *(np.stack([of(f"attitude.{s}") for s in "sxyz"], axis=-1) for of in (one, other))
    )
    return float(turned.max())


def _largest(one: np.ndarray, other: np.ndarray, is_angle: bool) -> float:
    """Largest difference; angles may be whole turns apart."""
    difference = one - other
    if is_angle:
        difference = (difference + np.pi) % (2 * np.pi) - np.pi
    return float(np.abs(difference).max())


def _turned(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angles (deg) between the attitudes of two rows of quaternions of any length, shape (rows, 4)."""
    first, second = (q / np.linalg.norm(q, axis=-1, keepdims=True) for q in (one, other))
    apart_by = [np.linalg.norm(first - side * second, axis=-1) for side in (1.0, -1.0)]
    angles: np.ndarray = np.degrees(4 * np.arcsin(np.minimum(*apart_by) / 2))
    return angles
