"""Eigenvalues of stiff and of nearly defective matrices, to the last digits.

Stage 4. A lag of 1 us beside a mode of 10 rad/s spans five decades and more, and a queue of results
has a repeated eigenvalue 0; both need more care than LAPACK's answer as it comes.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hybrid.linearity import NotLinear
from hybrid.machine import Floats
from hybrid.together import in_stacks

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
NEWTON_STEPS, SETTLED = 3, 1e-13
# A figure that grows by more over one stretch cannot be squared.
LARGEST_GROWTH = 1e100


def eigenvalues(matrices: Sequence[Floats], shifted: bool = False) -> list[Complex | NotLinear]:
    """Eigenvalues of each square matrix, or why there are none.

    They are polished: LAPACK's are good to epsilon times the norm, which a lag of 1 us makes large;
    Newton steps on the eigenvector equation are good to epsilon times each entry.

    `shifted`: they are z - 1 of maps; those of results that pass through (z near 0) are left out.
    """
    # What the Newton steps of all eigenvalues take.
    return in_stacks(matrices, len, lambda m: len(m) ** 3, lambda some: _of_alike(some, shifted))


def _of_alike(matrices: list[Floats], shifted: bool) -> list[Complex | NotLinear]:
    """The same of matrices of one size."""
    size = len(matrices[0])
    if not size:
        return [np.zeros(0, dtype=complex) for _ in matrices]
    if size > LARGEST_MAP:
        what = f"{size} figures go round the loops, at most {LARGEST_MAP} are analysed"
        return [NotLinear(what) for _ in matrices]
    stack = np.stack(matrices)
    sound = np.abs(stack).max(axis=(1, 2)) < LARGEST_GROWTH
    found = iter(_of_stack(stack[sound], shifted))
    return [
        next(found) if each else NotLinear("the patch runs away within one cycle")
        for each in sound.tolist()
    ]


def _of_stack(matrices: Floats, shifted: bool) -> list[Complex | NotLinear]:
    """The same of a stack (points, n, n) whose figures are sound."""
    count, n, _ = matrices.shape
    # Figures of more than 300 decades may overflow below; what comes of them is refused or left out.
    with np.errstate(all="ignore"):
        matrices = _balanced(matrices)
        needs_vectors = shifted or n <= LARGEST_POLISHED  # they double the time
        find, rows = (_eigenpairs, n + 1) if needs_vectors else (_eigenvalues_alone, 1)
        pairs = _solved(find, np.empty((count, rows, n), dtype=complex), matrices)
        values, vectors = pairs[:, 0], pairs[:, 1:]
        kept = values.imag >= 0  # which NaN is not
        if shifted:
            kept &= ~_forgotten(1.0 + values, vectors, matrices)
    owner, column = np.nonzero(kept)
    polished = values[kept]
    if n <= LARGEST_POLISHED:
        polished = _polish(matrices[owner], polished, vectors[owner, :, column])
    edges = itertools.pairwise([0, *np.cumsum(kept.sum(axis=1)).tolist()])
    unknown: list[bool] = np.isnan(values.sum(axis=1)).tolist()
    return [
        NotLinear("its eigenvalues cannot be found") if lost else _with_conjugates(polished[a:b])
        for lost, (a, b) in zip(unknown, edges, strict=True)
    ]


def _with_conjugates(values: Complex) -> Complex:
    return np.concatenate([values, values[values.imag > 0].conj()])


def _solved(solve: Callable[..., Any], found: Complex, *stacks: Floats | Complex) -> Complex:
    """What `solve` makes of stacks of matrices, in `found`; NaN for those that it cannot solve.

    NumPy refuses the whole stack for one of them; then each is tried alone.
    """
    try:
        found[:] = solve(*stacks)
    except np.linalg.LinAlgError:
        if len(found) == 1:
            found[:] = np.nan
        else:
            for i in range(len(found)):
                _solved(solve, found[i : i + 1], *(stack[i : i + 1] for stack in stacks))
    return found


def _eigenpairs(matrices: Floats) -> Complex:
    """Of each matrix the eigenvalues, and below each its vector: (points, 1 + n, n)."""
    values, vectors = np.linalg.eig(matrices)
    return np.concatenate([values[:, None], vectors], axis=1)


def _eigenvalues_alone(matrices: Floats) -> Complex:
    return np.linalg.eigvals(matrices).astype(complex)[:, None]


def _balanced(matrices: Floats) -> Floats:
    """The matrices (points, n, n) with figures in units that make rows and columns alike in size.

    Words are in SI units, states in machine units; a condition is worth nothing before that. The
    units are powers of two, so nothing is rounded (Parlett and Reinsch, Numer. Math. 13, 1969).
    """
    others, unit = np.abs(matrices), np.ones(matrices.shape[:2])
    diagonal = np.arange(matrices.shape[1])
    others[:, diagonal, diagonal] = 0.0
    going = np.ones((len(matrices), 1), dtype=bool)
    for _ in range(BALANCING_SWEEPS):
        rows = (others @ unit[:, :, None])[:, :, 0] / unit
        columns = ((1.0 / unit)[:, None] @ others)[:, 0] * unit
        powers = np.rint(BALANCING_STEP * np.log2(rows / columns))
        powers[~((rows > 0.0) & (columns > 0.0) & going)] = 0.0
        unit = np.ldexp(unit, powers.astype(int))
        # Where nothing takes more than a further factor of two, that mends nothing.
        going = np.max(np.abs(powers), axis=1, keepdims=True) > 1.0
        if not going.any():
            break
    return matrices * unit[:, None] / unit[:, :, None]


def _forgotten(z: Complex, vectors: Complex, matrices: Floats) -> npt.NDArray[np.bool_]:
    """Which eigenvalues z (points, n) of the balanced matrices + I cannot be told from 0.

    A queue of d results has d equal eigenvalues 0, which rounding spreads over a disc of radius
    epsilon^(1/d). They give themselves away by their condition: rounding moves an eigenvalue by
    epsilon |matrix| / |y x|, x and y its right and left vectors of unit length. Never by more than
    (2 |matrix|)^(1 - 1/n) |rounding|^(1/n), however ill its condition: that of an eigenvalue 1 of two
    integrators in a row is infinite (L. Elsner, An optimal bound for the spectral variation of two
    matrices, Linear Algebra Appl. 71, 1985).
    """
    left = _solved(np.linalg.inv, np.empty_like(vectors), vectors)
    condition = np.linalg.norm(left, axis=2) * np.linalg.norm(vectors, axis=1)
    norm = np.linalg.norm(matrices + np.eye(matrices.shape[1]), axis=(1, 2))
    rounding = 100.0 * np.finfo(float).eps * norm[:, None]
    order = 1.0 / z.shape[1]
    farthest = (2.0 * norm[:, None]) ** (1.0 - order) * rounding**order
    # Where the vectors have no inverse, there is no condition to go by.
    moved = np.minimum(rounding * condition, farthest)
    return np.asarray(np.abs(z) <= np.fmax(FORGOTTEN, moved))


def _polish(matrices: Floats, values: Complex, vectors: Complex) -> Complex:
    """Newton steps on (matrix - value) vector = 0 for each value (pairs,) of a matrix (pairs, n, n)
    with its vector (pairs, n)."""
    count, n = vectors.shape
    diagonal, at = np.arange(n), np.argmax(np.abs(vectors), axis=1)
    vectors = vectors / vectors[np.arange(count), at][:, None]
    values, going = values.copy(), np.arange(count)
    for _ in range(NEWTON_STEPS):
        if not len(going):
            break
        matrix, value, vector = matrices[going], values[going], vectors[going]
        jacobian = np.zeros((len(going), n + 1, n + 1), dtype=complex)
        jacobian[:, :n, :n] = matrix
        jacobian[:, diagonal, diagonal] -= value[:, None]
        jacobian[:, :n, n] = -vector
        jacobian[np.arange(len(going)), n, at[going]] = 1.0
        right = np.zeros((len(going), n + 1, 1), dtype=complex)
        right[:, :n, 0] = value[:, None] * vector - (matrix @ vector[:, :, None])[:, :, 0]
        step = _solved(np.linalg.solve, np.empty_like(right), jacobian, right)[:, :, 0]
        # A step that is not small means a multiple eigenvalue: keep LAPACK's answer there.
        size = np.abs(value)
        good = np.all(np.isfinite(step), axis=1) & (np.abs(step[:, n]) <= 1e-3 * size)
        vectors[going[good]] += step[good, :n]
        values[going[good]] += step[good, n]
        # What a small step has left is as small as its square.
        moved = np.abs(step[:, n]) > SETTLED * size
        moved |= np.abs(step[:, :n]).max(axis=1) > math.sqrt(SETTLED)
        going = going[good & moved]
    return values
