"""What the tests of six degrees of freedom share: published runs, rotation matrices, angles."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import xarray

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


def ned_of_the_start(longitude: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Matrices from north, east, down on the turning equator to those of longitude 0 at t = 0."""
    turn = EARTH_RATE * time + longitude
    c, s, one, no = np.cos(turn), np.sin(turn), np.ones_like(turn), np.zeros_like(turn)
    return np.array([[one, no, no], [no, c, -s], [no, s, c]])


def errors_of_rotation(
    record: xarray.Dataset, published: np.ndarray, body: str = "body", attitude: str = "attitude"
) -> tuple[float, float]:
    """Largest difference of body rates (deg/s) and of Euler angles (deg) from a published run."""
    rows = np.searchsorted(record["time"].values, published["time"] - 1e-6)
    np.testing.assert_allclose(record["time"].values[rows], published["time"], atol=1e-3)
    rates = columns(record, body, "pqr")[:, rows]
    told = [published[f"bodyAngularRateWrtEi_deg_s_{name}"] for name in ("Roll", "Pitch", "Yaw")]
    frame = ned_of_the_start(np.radians(published["longitude_deg"]), published["time"])
    matrices = turned(columns(record, attitude, "sxyz")[:, rows])
    angles = euler_angles(np.einsum("jin,jkn->ikn", matrices, frame))
    shown = [published[f"eulerAngle_deg_{name}"] for name in ("Yaw", "Pitch", "Roll")]
    apart = (angles - np.array(shown) + 180.0) % 360.0 - 180.0
    return float(np.abs(rates - told).max()), float(np.abs(apart).max())
