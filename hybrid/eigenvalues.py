"""Eigenvalues of stiff and of nearly defective matrices, to the last digits.

Stage 4. A lag of 1 us beside a mode of 10 rad/s spans five decades and more, and a queue of results
has a repeated eigenvalue 0; both need more care than LAPACK's answer as it comes.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hybrid.linearity import NotLinear
from hybrid.machine import Floats

Complex = npt.NDArray[np.complex128]

# Modes that lose all but this much of themselves in one stretch are results passing through.
FORGOTTEN = 1e-9
BALANCING_SWEEPS = 20
# A half would do for one row by itself; all change at once, so two that share an entry would overshoot.
BALANCING_STEP = 1.0 / 3.0
# Figures that go round the loops: eigenvalues of more would take minutes, and polishing them from
# here on more than a second.
LARGEST_MAP, LARGEST_POLISHED = 600, 150
# Newton steps end when they move an eigenvalue by no more of itself, and its vector by the root of it.
SETTLED = 1e-13
# A figure that grows by more over one stretch cannot be squared.
LARGEST_GROWTH = 1e100


def eigenvalues(matrix: Floats, shifted: bool = False) -> Complex:
    """Eigenvalues, polished: LAPACK's are good to epsilon times the norm, which a lag of 1 us makes
    large; Newton steps on the eigenvector equation are good to epsilon times each entry.

    `shifted`: they are z - 1 of a map; those of results that pass through (z near 0) are left out.
    """
    if not len(matrix):
        return np.zeros(0, dtype=complex)
    if len(matrix) > LARGEST_MAP:
        raise NotLinear(
            f"{len(matrix)} figures go round the loops, at most {LARGEST_MAP} are analysed"
        )
    if not np.max(np.abs(matrix)) < LARGEST_GROWTH:
        raise NotLinear("the patch runs away within one cycle")
    # Figures of more than 300 decades may overflow below; what comes of them is refused or left out.
    with np.errstate(all="ignore"):
        matrix = _balanced(matrix)
        try:
            values, vectors = np.linalg.eig(matrix)
        except np.linalg.LinAlgError:
            raise NotLinear("its eigenvalues cannot be found") from None
        kept = values.imag >= 0
        if shifted:
            kept &= ~_forgotten(1.0 + np.asarray(values, dtype=np.complex128), vectors, matrix)
    values, vectors = values[kept].astype(complex), vectors[:, kept].T.astype(complex)
    if len(matrix) <= LARGEST_POLISHED and len(values):
        values = _polish(matrix, values, vectors)
    return np.concatenate([values, values[values.imag > 0].conj()])


def _balanced(matrix: Floats) -> Floats:
    """The matrix with its figures in units that make rows and columns alike in size.

    Words are in SI units, states in machine units; a condition is worth nothing before that. The
    units are powers of two, so nothing is rounded (Parlett and Reinsch, Numer. Math. 13, 1969).
    """
    others, unit = np.abs(matrix), np.ones(len(matrix))
    others.flat[:: len(matrix) + 1] = 0.0
    for _ in range(BALANCING_SWEEPS):
        rows, columns = (others @ unit) / unit, ((1.0 / unit) @ others) * unit
        powers = np.rint(BALANCING_STEP * np.log2(rows / columns))
        powers[~((rows > 0.0) & (columns > 0.0))] = 0.0
        unit = np.ldexp(unit, powers.astype(int))
        if (np.abs(powers) <= 1.0).all():  # a further factor of two mends nothing
            break
    return matrix * unit / unit[:, None]


def _forgotten(z: Complex, vectors: Complex, matrix: Floats) -> npt.NDArray[np.bool_]:
    """Which eigenvalues z of matrix + I, balanced, cannot be told from 0.

    A queue of d results has d equal eigenvalues 0, which rounding spreads over a disc of radius
    epsilon^(1/d). They give themselves away by their condition: rounding moves an eigenvalue by
    epsilon |matrix| / |y x|, x and y its right and left vectors of unit length.
    """
    size = np.abs(z)
    try:
        left = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        return np.asarray(size <= FORGOTTEN)
    condition = np.linalg.norm(left, axis=1) * np.linalg.norm(vectors, axis=0)
    norm = np.linalg.norm(matrix + np.eye(len(matrix)))
    rounding = 100.0 * np.finfo(float).eps * norm * condition
    return np.asarray(size <= np.maximum(FORGOTTEN, rounding))


def _polish(matrix: Floats, values: Complex, vectors: Complex) -> Complex:
    """Newton steps on (matrix - value) vector = 0, all pairs at once; rows of `vectors`."""
    count, n = vectors.shape
    pairs, at = np.arange(count), np.argmax(np.abs(vectors), axis=1)
    vectors = vectors / vectors[pairs, at][:, None]
    first, diagonal = values, np.arange(n)
    jacobian, right = (
        np.zeros((count, n + 1, n + 1), dtype=complex),
        np.zeros((count, n + 1, 1), complex),
    )
    jacobian[:, :n, :n] = matrix
    jacobian[pairs, n, at] = 1.0
    for _ in range(3):
        right[:, :n, 0] = values[:, None] * vectors - vectors @ matrix.T
        jacobian[:, diagonal, diagonal] = matrix.diagonal() - values[:, None]
        jacobian[:, :n, n] = -vectors
        try:
            step = np.linalg.solve(jacobian, right)[:, :, 0]
        except np.linalg.LinAlgError:
            return first
        # A step that is not small means a multiple eigenvalue: keep LAPACK's answer there.
        good = np.all(np.isfinite(step), axis=1) & (np.abs(step[:, n]) <= 1e-3 * np.abs(values))
        vectors = np.where(good[:, None], vectors + step[:, :n], vectors)
        moved = np.abs(step[:, n]) > SETTLED * np.abs(values)
        moved |= np.abs(step[:, :n]).max(axis=1) > math.sqrt(SETTLED)
        values = np.where(good, values + step[:, n], values)
        if not (moved & good).any():  # what the step has left is as small as its square
            break
    return values
