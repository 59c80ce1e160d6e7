"""The tape's operations of several arguments: the helper functions, compiled.

Stage 4. Their arguments stand in registers side by side. The formulas are those of `surroundings`, which
parameters are computed with, too.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hybrid import surroundings
from hybrid.engine.compiling import strictly_alike
from hybrid.numbering import Burst
from hybrid.tables import CONTINUES, MOST_VARIABLES, STOPS
from hybrid.tape import Op

Floats = npt.NDArray[np.float64]

_us76_layer = strictly_alike(surroundings.us76_layer)
_us76_temperature = strictly_alike(surroundings.us76_temperature)
_us76_pressure = strictly_alike(surroundings.us76_pressure)
_us76_sound_speed = strictly_alike(surroundings.us76_sound_speed)
_exponential_density = strictly_alike(surroundings.exponential_density)
_gravity_sphere = strictly_alike(surroundings.gravity_sphere)
_gravity_j2 = strictly_alike(surroundings.gravity_j2)
_gravity_j2_polar = strictly_alike(surroundings.gravity_j2_polar)
_geodetic_meridian = strictly_alike(surroundings.geodetic_meridian)
_earth_fixed = strictly_alike(surroundings.earth_fixed)


TEMPERATURE_US76, PRESSURE_US76, DENSITY_US76, SOUND_SPEED_US76 = (
    int(op) for op in (Op.TEMPERATURE_US76, Op.PRESSURE_US76, Op.DENSITY_US76, Op.SOUND_SPEED_US76)
)
DENSITY_EXPONENTIAL, GRAVITY_SPHERE = int(Op.DENSITY_EXPONENTIAL), int(Op.GRAVITY_SPHERE)
GRAVITY_X_J2, GRAVITY_Y_J2, GRAVITY_Z_J2 = (
    int(op) for op in (Op.GRAVITY_X_J2, Op.GRAVITY_Y_J2, Op.GRAVITY_Z_J2)
)
GRAVITY_DOWN_J2, GRAVITY_NORTH_J2 = int(Op.GRAVITY_DOWN_J2), int(Op.GRAVITY_NORTH_J2)
LATITUDE_WGS84, LONGITUDE_WGS84, HEIGHT_WGS84 = (
    int(op) for op in (Op.LATITUDE_WGS84, Op.LONGITUDE_WGS84, Op.HEIGHT_WGS84)
)
X_WGS84, Y_WGS84, Z_WGS84 = (int(op) for op in (Op.X_WGS84, Op.Y_WGS84, Op.Z_WGS84))
GRAVITY_J2, GRAVITY_POLAR_J2, GEODETIC_WGS84 = (
    int(op) for op in (Burst.GRAVITY_J2, Burst.GRAVITY_POLAR_J2, Burst.GEODETIC_WGS84)
)
GAS_CONSTANT = surroundings.US76_GAS_CONSTANT
LOWEST_M, HIGHEST_M = surroundings.US76_LOWEST_M, surroundings.US76_HIGHEST_M

# Rows of State.outside for each place of the program that may be asked beyond its range: below and above
# the range of each argument, then beyond scattered points. How often, the first time as (segment,
# repeat, instant), the first value and the worst. The last row is the clock, with the present time
# in place of the first, and how many calls were to stop the run in place of how often.
TIMES, SEGMENT, REPEAT, INSTANT, VALUE, WORST = range(6)
SIDES = 2
PER_SITE = SIDES * (MOST_VARIABLES + 1)
# What is added to an action where the argument was above its range.
ABOVE = 8


@strictly_alike
def note_outside(notes: Floats, site: int, argument: int, value: float, done: int) -> None:
    """Remember that a function was asked beyond its range: the first time, or what stops the run.

    done: the action, and ABOVE where that was above the range.
    """
    above, action = done // ABOVE, done % ABOVE
    clock, row = notes.shape[0] - 1, PER_SITE * site + SIDES * argument + above
    if notes[row, TIMES] == 0.0 or action == STOPS:
        for column in (SEGMENT, REPEAT, INSTANT):
            notes[row, column] = notes[clock, column]
        notes[row, VALUE] = value
    if notes[row, TIMES] == 0.0 or (value > notes[row, WORST]) == (above > 0):
        notes[row, WORST] = value
    notes[row, TIMES] += 1.0
    if action == STOPS:
        notes[clock, TIMES] += 1.0


@strictly_alike
def compute_helper(op: int, r: Floats, at: int, site: int, notes: Floats) -> float:
    """A helper function of the registers from `at` on; `site` is its row of `notes`."""
    if op <= SOUND_SPEED_US76:
        if r[at] < LOWEST_M:
            note_outside(notes, site, 0, r[at], CONTINUES)
        elif r[at] > HIGHEST_M:
            note_outside(notes, site, 0, r[at], CONTINUES + ABOVE)
        layer, rise = _us76_layer(r[at])
        temperature = _us76_temperature(layer, rise)
        if op == TEMPERATURE_US76:
            return temperature
        if op == SOUND_SPEED_US76:
            return _us76_sound_speed(temperature)
        pressure = _us76_pressure(layer, rise, temperature)
        return pressure if op == PRESSURE_US76 else pressure / (GAS_CONSTANT * temperature)
    if op == DENSITY_EXPONENTIAL:
        return _exponential_density(r[at], r[at + 1], r[at + 2])
    if op == GRAVITY_SPHERE:
        return _gravity_sphere(r[at], r[at + 1])
    if op <= GRAVITY_Z_J2:
        x, y, z = _gravity_j2(r[at], r[at + 1], r[at + 2], r[at + 3], r[at + 4], r[at + 5])
        return x if op == GRAVITY_X_J2 else (y if op == GRAVITY_Y_J2 else z)
    if op <= GRAVITY_NORTH_J2:
        down, north = _gravity_j2_polar(r[at], r[at + 1], r[at + 2], r[at + 3], r[at + 4])
        return down if op == GRAVITY_DOWN_J2 else north
    if op == LONGITUDE_WGS84:
        return math.atan2(r[at + 1], r[at])
    if op <= HEIGHT_WGS84:
        north, outwards, height = _geodetic_meridian(r[at], r[at + 1], r[at + 2])
        return math.atan2(north, outwards) if op == LATITUDE_WGS84 else height
    x, y, z = _earth_fixed(r[at], r[at + 1], r[at + 2])
    return x if op == X_WGS84 else (y if op == Y_WGS84 else z)


@strictly_alike
def compute_jointly(op: int, r: Floats, at: int, first: int, second: int, third: int) -> None:
    """Several results of one formula of the registers from `at` on, each into its register.

    What nobody reads goes to the last one, and is left out where it would take long.
    """
    nowhere = r.shape[0] - 1
    if op == GRAVITY_J2:
        gravity = _gravity_j2(r[at], r[at + 1], r[at + 2], r[at + 3], r[at + 4], r[at + 5])
        r[first], r[second], r[third] = gravity
    elif op == GRAVITY_POLAR_J2:
        down, north = _gravity_j2_polar(r[at], r[at + 1], r[at + 2], r[at + 3], r[at + 4])
        r[first], r[second] = down, north
    elif op == GEODETIC_WGS84:
        x, y = r[at], r[at + 1]
        if third != nowhere or first != nowhere:
            north, outwards, height = _geodetic_meridian(x, y, r[at + 2])
            if first != nowhere:
                r[first] = math.atan2(north, outwards)
            r[third] = height
        if second != nowhere:
            r[second] = math.atan2(y, x)
    else:
        r[first], r[second], r[third] = _earth_fixed(r[at], r[at + 1], r[at + 2])
