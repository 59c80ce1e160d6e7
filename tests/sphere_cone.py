"""Coefficients of a blunt cone in closed form, and the table of them that ships with `reentry`.

    python tests/sphere_cone.py patches/parts/sphere_cone.csv

Continuum: modified Newtonian theory, pressure coefficient k (n.v)^2 with k that of the stagnation point
behind a normal shock (L. Lees, 1955). While the angle of attack is below the cone's half angle all of
the face is exposed and the integrals over cap and frustum are elementary. Free molecules: they leave
all their momentum, so the force is along the stream, twice the dynamic pressure over the shadow of the
base, through its middle. Between them the sine-squared bridge over Knudsen numbers from 1e-3 to 10.
Not data of any flown vehicle.
"""

from __future__ import annotations

import itertools
import math
import sys
from pathlib import Path

from hybrid import surroundings

HALF = math.radians(45.0)
RADIUS, NOSE = 2.0, 1.0  # m, of base and nose
CENTRE = 1.3  # m, of mass, behind the nose
AREA, LENGTH = math.pi * RADIUS**2, 2 * RADIUS
GAMMA = 1.4
MACH = (1.5, 2.0, 3.0, 5.0, 10.0, 25.0)
HEIGHT_KM = (70.0, 80.0, 85.0, 90.0, 95.0, 100.0, 105.0, 110.0)
INCIDENCE_DEG = tuple(range(0, 50, 5))

EDGE = NOSE * math.cos(HALF)  # radius where cap and frustum meet
EDGE_BACK = NOSE * (1 - math.sin(HALF))  # and how far that is behind the nose
BASE_BACK = EDGE_BACK + (RADIUS - EDGE) / math.tan(HALF)


def stagnation(mach: float) -> float:
    """Pressure coefficient behind a normal shock, brought to rest (Rayleigh's Pitot formula)."""
    g, square = GAMMA, mach * mach
    jump = ((g + 1) ** 2 * square / (4 * g * square - 2 * (g - 1))) ** (g / (g - 1))
    return 2 / (g * square) * (jump * (1 - g + 2 * g * square) / (g + 1) - 1)


def newtonian(alpha: float) -> tuple[float, float, float]:
    """Axial, normal and pitching-moment coefficient for k = 1, alpha from 0 to the half angle."""
    s, c, t = math.sin(HALF), math.cos(HALF), math.tan(HALF)
    sa, ca = math.sin(alpha), math.cos(alpha)
    cap = (NOSE / RADIUS) ** 2
    axial = cap * (ca**2 * (1 - s**4) / 2 + sa**2 * c**4 / 4)
    normal = cap * sa * ca * c**4 / 2
    moment = -normal * (NOSE - CENTRE) / LENGTH  # all pressure on a sphere passes its middle
    ring = 1 - (EDGE / RADIUS) ** 2
    axial += ring * (2 * s**2 * ca**2 + c**2 * sa**2) / 2
    normal += ring * c**2 * sa * ca
    # A ring of the frustum pushes towards the point of the axis that is r tan(half) behind it.
    squares, cubes = (RADIUS**2 - EDGE**2) / 2, (RADIUS**3 - EDGE**3) / 3
    start = EDGE_BACK - EDGE / t - CENTRE
    arm = start * squares + (1 / t + t) * cubes
    moment -= 2 * c**2 * sa * ca * arm / (RADIUS**2 * LENGTH)
    return axial, normal, moment


def free_molecular(alpha: float) -> tuple[float, float, float]:
    """The same for free molecules: a drag of 2 cos(alpha) through the middle of the base."""
    normal = 2 * math.sin(alpha) * math.cos(alpha)
    return 2 * math.cos(alpha) ** 2, normal, -normal * (BASE_BACK - CENTRE) / LENGTH


def bridge(height_m: float) -> float:
    """Share of free molecules: 0 below a Knudsen number of 1e-3, 1 above 10."""
    temperature, pressure = surroundings.us76(height_m)
    number = pressure / (1.380649e-23 * temperature)
    path = 1 / (math.sqrt(2) * math.pi * (3.65e-10) ** 2 * number)
    decades = min(max(math.log10(path / LENGTH), -3.0), 1.0)
    return math.sin(math.pi * (3 + decades) / 8) ** 2


def coefficients(mach: float, height_m: float, alpha: float) -> tuple[float, float, float]:
    """Axial, normal and pitching-moment coefficient about the centre of mass."""
    share, k = bridge(height_m), stagnation(mach)
    pairs = zip(newtonian(alpha), free_molecular(alpha), strict=True)
    a, n, m = ((1 - share) * k * near + share * far for near, far in pairs)
    return a, n, m


def table() -> str:
    """The CSV file."""
    lines = [
        "# Made by tests/sphere_cone.py from modified Newtonian theory, bridged to free molecules;",
        f"# no measured data. Cone of 45 deg, base radius {RADIUS} m, nose radius {NOSE} m; base area",
        "# and diameter are the references.",
        f"# Moments are about the centre of mass, {CENTRE} m behind the nose.",
        "mach,height,incidence,axial,normal,pitching",
    ]
    for mach, height, incidence in itertools.product(MACH, HEIGHT_KM, INCIDENCE_DEG):
        found = coefficients(mach, height * 1e3, math.radians(incidence))
        told = ",".join(f"{value:.6f}" for value in found)
        lines.append(f"{mach:g},{height:g},{incidence},{told}")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(table(), encoding="utf-8")
