"""Air, gravity and the figure of the Earth: the named helper functions of program arithmetic.

Stage 0. Scalars in SI units, plain formulas that call nothing but `math`, so that the engine compiles
the very same ones. Where a formula has no answer it gives NaN, never an exception of its own.
"""

from __future__ import annotations

import math

# U.S. Standard Atmosphere, 1976 (NOAA, NASA, USAF; NASA-TM-X-74335), part 1: constants of tables 1
# and 2, layers of table 4, Eqs. 18, 23, 33a, 33b, 42 and 50.
US76_RADIUS_M = 6356766.0
US76_GRAVITY = 9.80665
US76_GAS_CONSTANT = 8314.32 / 28.9644  # R*/M0, J/(kg K)
US76_GAMMA = 1.4
US76_LOWEST_M = -5000.0
US76_HIGHEST_M = 86000.0
# Geopotential height of the base, temperature there, its gradient. The last one goes on for good: above
# 86 km the standard leaves hydrostatic layers, and here the air stays as warm as it is at their top.
_BASE_M = (0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3, 84852.0)
_BASE_K = (288.15, 216.65, 216.65, 228.65, 270.65, 270.65, 214.65, 186.946)
_GRADIENT = (-6.5e-3, 0.0, 1e-3, 2.8e-3, 0.0, -2.8e-3, -2e-3, 0.0)
_HYDROSTATIC = US76_GRAVITY / US76_GAS_CONSTANT  # K/m


def _base_pressures() -> tuple[float, ...]:
    """Pressure at the base of each layer, from that of the layer below."""
    pressures = [101325.0]
    for i in range(len(_BASE_M) - 1):
        rise = _BASE_M[i + 1] - _BASE_M[i]
        if _GRADIENT[i] == 0.0:
            ratio = math.exp(-_HYDROSTATIC * rise / _BASE_K[i])
        else:
            ratio = (_BASE_K[i] / _BASE_K[i + 1]) ** (_HYDROSTATIC / _GRADIENT[i])
        pressures.append(pressures[-1] * ratio)
    return tuple(pressures)


_BASE_PA = _base_pressures()

# WGS 84, NIMA TR8350.2 (3rd edition): defining parameters a, 1/f and GM, and the J2 derived from them.
WGS84_RADIUS_M = 6378137.0
WGS84_FLATTENING = 1.0 / 298.257223563
WGS84_GM = 3.986004418e14
WGS84_J2 = 1.08262982e-3
_POLAR_M = WGS84_RADIUS_M * (1.0 - WGS84_FLATTENING)
_E2 = WGS84_FLATTENING * (2.0 - WGS84_FLATTENING)  # first eccentricity, squared
_E2_SECOND = _E2 / (1.0 - _E2)


def us76(height: float) -> tuple[float, float]:
    """Temperature (K) and pressure (Pa) of the U.S. Standard Atmosphere at a geometric height (m).

    The temperature is that of the molecular scale, which is the kinetic one up to 80 km and 0.04 % above
    it at 86 km. Below -5 km the lowest layer goes on, above 86 km the air is isothermal.
    """
    layer, rise = us76_layer(height)
    temperature = us76_temperature(layer, rise)
    return temperature, us76_pressure(layer, rise, temperature)


def us76_layer(height: float) -> tuple[int, float]:
    """The layer in which a geometric height (m) is, and how far above its base in geopotential (m)."""
    if not height > -US76_RADIUS_M:
        return 0, math.nan
    geopotential = US76_RADIUS_M * (height / (US76_RADIUS_M + height))
    layer = 0
    while layer < 7 and geopotential >= _BASE_M[layer + 1]:
        layer += 1
    return layer, geopotential - _BASE_M[layer]


def us76_temperature(layer: int, rise: float) -> float:
    """Temperature (K) in a layer, so far above its base."""
    return _BASE_K[layer] + _GRADIENT[layer] * rise


def us76_pressure(layer: int, rise: float, temperature: float) -> float:
    """Pressure (Pa) in a layer, so far above its base, at the temperature there."""
    base, gradient = _BASE_K[layer], _GRADIENT[layer]
    if gradient == 0.0:
        return _BASE_PA[layer] * math.exp(-_HYDROSTATIC * rise / base)
    exponent = _HYDROSTATIC / gradient
    return _BASE_PA[layer] * math.pow(base / temperature, exponent)


def us76_sound_speed(temperature: float) -> float:
    """Speed of sound (m/s) in air of a molecular-scale temperature (K)."""
    return math.sqrt(US76_GAMMA * US76_GAS_CONSTANT * temperature)


def exponential_density(height: float, density: float, scale_height: float) -> float:
    """Density of an isothermal atmosphere: `density` at height 0, a factor e less every scale height."""
    return density * math.exp(-height / scale_height)


def gravity_sphere(distance: float, gm: float = WGS84_GM) -> float:
    """Attraction of a sphere (m/s^2) at a distance (m) from its centre."""
    return gm / (distance * distance) if distance > 0.0 else math.nan


def gravity_j2(
    x: float,
    y: float,
    z: float,
    gm: float = WGS84_GM,
    radius: float = WGS84_RADIUS_M,
    j2: float = WGS84_J2,
) -> tuple[float, float, float]:
    """Attraction (m/s^2) of an oblate body along axes through its centre, z through its north pole.

    Gradient of GM/r [1 - J2 (a/r)^2 (3 sin^2 - 1)/2], as in any text on orbits (Vallado, Eq. 8-30).
    No centrifugal part: axes that turn with the body give the attraction, too.
    """
    squared = x * x + y * y + z * z
    if not squared > 0.0:
        return math.nan, math.nan, math.nan
    central = -gm / (squared * math.sqrt(squared))
    oblate, sine2 = 1.5 * j2 * (radius * radius / squared), 5.0 * (z * z / squared)
    across = central * (1.0 + oblate * (1.0 - sine2))
    return across * x, across * y, central * (1.0 + oblate * (3.0 - sine2)) * z


def gravity_j2_polar(
    distance: float,
    latitude: float,
    gm: float = WGS84_GM,
    radius: float = WGS84_RADIUS_M,
    j2: float = WGS84_J2,
) -> tuple[float, float]:
    """The same down to the centre and north (m/s^2), at a distance (m) and a geocentric latitude."""
    if not distance > 0.0:
        return math.nan, math.nan
    central, oblate = gm / (distance * distance), 1.5 * j2 * (radius / distance) ** 2
    sine = math.sin(latitude)
    down = central * (1.0 + oblate * (1.0 - 3.0 * sine * sine))
    return down, -central * oblate * math.sin(2.0 * latitude)


def geodetic(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Latitude (rad), longitude (rad) and height (m) above WGS 84 of a point in Earth-fixed axes (m).

    Bowring's formula (Survey Review 23, 1976) three times over, from the reduced latitude of the
    point's direction. From 300 km off the centre of the Earth up to 1e9 m it errs by rounding only:
    4e-16 rad, and 4e-9 m or 4e-16 of the distance.
    """
    north, outwards, height = geodetic_meridian(x, y, z)
    if math.isnan(north):
        return math.nan, math.nan, math.nan
    return math.atan2(north, outwards), math.atan2(y, x), height


def geodetic_meridian(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Two parts of the vertical in the plane of the meridian, north and outwards, and the height (m)."""
    across = math.sqrt(x * x + y * y)  # hypot takes most of the time, and no place is 1e150 m away
    if not across + abs(z) > 0.0:
        return math.nan, math.nan, math.nan
    sine, cosine = z, (1.0 - WGS84_FLATTENING) * across
    for _ in range(3):
        size = math.sqrt(sine * sine + cosine * cosine)
        north = z + _E2_SECOND * _POLAR_M * (sine / size) ** 3
        outwards = across - _E2 * WGS84_RADIUS_M * (cosine / size) ** 3
        sine, cosine = (1.0 - WGS84_FLATTENING) * north, outwards
    size = math.sqrt(north * north + outwards * outwards)
    sine, cosine = north / size, outwards / size
    height = across * cosine + z * sine - WGS84_RADIUS_M * math.sqrt(1.0 - _E2 * sine * sine)
    return north, outwards, height


def earth_fixed(latitude: float, longitude: float, height: float) -> tuple[float, float, float]:
    """Place in Earth-fixed axes (m) of a geodetic latitude and longitude (rad) and a height (m).

    x through latitude and longitude 0, z through the north pole; the inverse of `geodetic`.
    """
    sine, cosine = math.sin(latitude), math.cos(latitude)
    normal = WGS84_RADIUS_M / math.sqrt(1.0 - _E2 * sine * sine)
    across = (normal + height) * cosine
    up = (normal * (1.0 - _E2) + height) * sine
    return across * math.cos(longitude), across * math.sin(longitude), up
