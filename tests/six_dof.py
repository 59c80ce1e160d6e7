"""What the tests of six degrees of freedom share: published runs, rotation, the free body."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import xarray
from scipy.special import ellipj, ellipkinc

EARTH_RATE = 7.292115e-5  # rad/s, of the check cases
BRICK = np.array([0.00189422, 0.006211019, 0.007194665])  # slug ft2

_FOLDER = Path(__file__).parent.parent.parent / "shared" / "reference"
REFERENCE = Path(os.environ.get("HYBRID_REFERENCE", _FOLDER))


def nasa(case: str, tool: str) -> np.ndarray:
    """A published run of an atmospheric check case by one of the tools, columns by name."""
    file = REFERENCE / "nesc_atmos" / f"atmos_{case}_sim_{tool}.csv"
    if not file.exists():
        pytest.skip(f"no reference data in {REFERENCE}; set HYBRID_REFERENCE")
    return np.genfromtxt(file, delimiter=",", names=True)


def columns(record: xarray.Dataset, part: str, names: str) -> np.ndarray:
    """Signals of a part, one row each, at the record's times."""
    return np.array([record[f"{part}.{name}"].values for name in names])


def turned(quaternion: np.ndarray) -> np.ndarray:
    """Matrices from body to reference axes, shape (3, 3, n), of quaternions of any length."""
    s, x, y, z = quaternion / np.linalg.norm(quaternion, axis=0)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - s * z), 2 * (x * z + s * y)],
            [2 * (x * y + s * z), 1 - 2 * (x * x + z * z), 2 * (y * z - s * x)],
            [2 * (x * z - s * y), 2 * (y * z + s * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def euler_angles(body_from_ned: np.ndarray) -> np.ndarray:
    """Yaw, pitch and roll in deg of matrices of shape (3, 3, n)."""
    c = body_from_ned
    return np.degrees(
        [np.arctan2(c[0, 1], c[0, 0]), -np.arcsin(c[0, 2]), np.arctan2(c[1, 2], c[2, 2])]
    )


def local_directions(latitude: np.ndarray, longitude: np.ndarray) -> np.ndarray:
    """Matrices from north, east, down to axes through the pole, shape (3, 3, n); angles in rad."""
    (n, e), (c, s) = (np.sin(latitude), np.sin(longitude)), (np.cos(latitude), np.cos(longitude))
    return np.array([[-n * s, -e, -c * s], [-n * e, s, -c * e], [c, 0.0 * n, -n]])


def errors_of_rotation(
    record: xarray.Dataset, published: np.ndarray, body: str = "body", attitude: str = "attitude"
) -> tuple[float, float]:
    """Largest difference of body rates (deg/s) and of Euler angles (deg) from a published run."""
    rows = np.searchsorted(record["time"].values, published["time"] - 1e-6)
    np.testing.assert_allclose(record["time"].values[rows], published["time"], atol=1e-3)
    rates = columns(record, body, "pqr")[:, rows]
    told = [published[f"bodyAngularRateWrtEi_deg_s_{name}"] for name in ("Roll", "Pitch", "Yaw")]
    longitude = np.radians(published["longitude_deg"]) + EARTH_RATE * published["time"]
    frame = local_directions(np.radians(published["latitude_deg"]), longitude)
    matrices = turned(columns(record, attitude, "sxyz")[:, rows])
    angles = euler_angles(np.einsum("jin,jkn->ikn", matrices, frame))
    shown = [published[f"eulerAngle_deg_{name}"] for name in ("Yaw", "Pitch", "Roll")]
    apart = (angles - np.array(shown) + 180.0) % 360.0 - 180.0
    return float(np.abs(rates - told).max()), float(np.abs(apart).max())


def free_body(inertia: np.ndarray, rates: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Rates of a free body about its principal axes, moments ascending, shape (3, n).

    L. D. Landau and E. M. Lifshitz, "Mechanics", 3rd edition, section 37, for angular momentum squared
    above 2 E I2; where it is below, axes 1 and 3 change their parts.
    """
    i1, i2, i3 = inertia
    energy2, square = inertia @ rates**2, (inertia**2) @ rates**2
    if (energy2 * i2 - square) * (i3 - i1) > 0:
        return free_body(inertia[::-1], rates[::-1] * [1, -1, 1], time)[::-1] * [[1], [-1], [1]]
    top1 = np.sqrt((energy2 * i3 - square) / (i1 * (i3 - i1)))
    top2 = np.sqrt((energy2 * i3 - square) / (i2 * (i3 - i2)))
    top3 = np.sqrt((square - energy2 * i1) / (i3 * (i3 - i1)))
    m = (i2 - i1) * (energy2 * i3 - square) / ((i3 - i2) * (square - energy2 * i1))
    speed = np.sqrt((i3 - i2) * (square - energy2 * i1) / (i1 * i2 * i3))
    # The other way about axis 3, the rate about axis 1 has the other sign, too.
    side = np.sign(rates[2])
    phase = ellipkinc(np.arctan2(rates[1] / top2, side * rates[0] / top1), m)
    sn, cn, dn, _ = ellipj(speed * time * np.sign(i3 - i1) + phase, m)
    return np.array([side * top1 * cn, top2 * sn, side * top3 * dn])


def tensor(inertia: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The tensor of a body whose principal axes lie any way, and the matrix of those axes."""
    axes, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    axes *= np.linalg.det(axes)
    return axes @ np.diag(inertia) @ axes.T, axes


def settings(matrix: np.ndarray, rates: np.ndarray) -> dict[str, float]:
    """Parameters of Euler's equations for a tensor and initial rates, in SI units."""
    return {
        "ixx": matrix[0, 0],
        "iyy": matrix[1, 1],
        "izz": matrix[2, 2],
        "ixy": -matrix[0, 1],
        "ixz": -matrix[0, 2],
        "iyz": -matrix[1, 2],
        **dict(zip(("p_start", "q_start", "r_start"), rates, strict=True)),
    }
