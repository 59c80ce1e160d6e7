"""The named helper functions of program arithmetic: what they take and give, in SI units.

Stage 0. `surroundings` has the formulas, `expressions` puts them among the other functions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hybrid import surroundings as s
from hybrid.units import PURE, TIME, Dimension

LENGTH = Dimension((("length", 1),))
MASS = Dimension((("mass", 1),))
TEMPERATURE = Dimension((("temperature", 1),))
SPEED = LENGTH / TIME
ACCELERATION = SPEED / TIME
DENSITY = MASS / LENGTH**3
PRESSURE = MASS / LENGTH / TIME**2
GM = LENGTH**3 / TIME**2


@dataclass(frozen=True, slots=True)
class Helper:
    """A function with declared units; `defaults` are those of the last arguments."""

    compute: Callable[..., float]
    takes: tuple[tuple[str, Dimension], ...]  # name and dimension of each argument
    gives: Dimension
    defaults: tuple[float, ...] = ()
    valid: tuple[float, float] | None = None  # of the first argument; beyond it the run says so


_HEIGHT = (("height", LENGTH),)
_US76 = (s.US76_LOWEST_M, s.US76_HIGHEST_M)
_PLACE = (("x", LENGTH), ("y", LENGTH), ("z", LENGTH))
_GEODETIC = (("latitude", PURE), ("longitude", PURE), ("height", LENGTH))
_POLAR = (("distance", LENGTH), ("latitude", PURE))
_GM = (("gm", GM),)
_FIELD = (*_GM, ("radius", LENGTH), ("j2", PURE))
_EARTH = (s.WGS84_GM, s.WGS84_RADIUS_M, s.WGS84_J2)
_EXPONENTIAL = (("height", LENGTH), ("density", DENSITY), ("scale height", LENGTH))


def _density_us76(height: float) -> float:
    temperature, pressure = s.us76(height)
    return pressure / (s.US76_GAS_CONSTANT * temperature)


HELPERS: Mapping[str, Helper] = {
    "temperature_us76": Helper(lambda h: s.us76(h)[0], _HEIGHT, TEMPERATURE, valid=_US76),
    "pressure_us76": Helper(lambda h: s.us76(h)[1], _HEIGHT, PRESSURE, valid=_US76),
    "density_us76": Helper(_density_us76, _HEIGHT, DENSITY, valid=_US76),
    "sound_speed_us76": Helper(
        lambda h: s.us76_sound_speed(s.us76(h)[0]), _HEIGHT, SPEED, valid=_US76
    ),
    "density_exponential": Helper(s.exponential_density, _EXPONENTIAL, DENSITY),
    "gravity_sphere": Helper(s.gravity_sphere, (*_POLAR[:1], *_GM), ACCELERATION, _EARTH[:1]),
    "gravity_x_j2": Helper(
        lambda *a: s.gravity_j2(*a)[0], (*_PLACE, *_FIELD), ACCELERATION, _EARTH
    ),
    "gravity_y_j2": Helper(
        lambda *a: s.gravity_j2(*a)[1], (*_PLACE, *_FIELD), ACCELERATION, _EARTH
    ),
    "gravity_z_j2": Helper(
        lambda *a: s.gravity_j2(*a)[2], (*_PLACE, *_FIELD), ACCELERATION, _EARTH
    ),
    "gravity_down_j2": Helper(
        lambda *a: s.gravity_j2_polar(*a)[0], (*_POLAR, *_FIELD), ACCELERATION, _EARTH
    ),
    "gravity_north_j2": Helper(
        lambda *a: s.gravity_j2_polar(*a)[1], (*_POLAR, *_FIELD), ACCELERATION, _EARTH
    ),
    "latitude_wgs84": Helper(lambda *a: s.geodetic(*a)[0], _PLACE, PURE),
    "longitude_wgs84": Helper(lambda *a: s.geodetic(*a)[1], _PLACE, PURE),
    "height_wgs84": Helper(lambda *a: s.geodetic(*a)[2], _PLACE, LENGTH),
    "x_wgs84": Helper(lambda *a: s.earth_fixed(*a)[0], _GEODETIC, LENGTH),
    "y_wgs84": Helper(lambda *a: s.earth_fixed(*a)[1], _GEODETIC, LENGTH),
    "z_wgs84": Helper(lambda *a: s.earth_fixed(*a)[2], _GEODETIC, LENGTH),
}
