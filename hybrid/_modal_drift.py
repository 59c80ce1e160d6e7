"""Error of the fitted poles from noise that enters the mode itself, and not just its record.

In a loop with noisy parts, or with converters, every cycle kicks the mode a little: its complex
amplitude walks at random. Relative to the fitted exp(s t) that walk is rho(t), and the least-squares
fit takes its weighted slope for a change of the pole: delta s = slope of rho. Neighbouring residuals
hardly show it (the walk is far below the noise of a row), so a rule for independent rows states errors
that are too small by the square root of the number of rows.

The record is cut into K segments, each at least half a cycle long. In each the residual gives rho_k, a
complex number; with weights w = exp(2 sigma t) its noise from the rows is r / w, and from a walk of
strength q it has the covariance q C, seen through the segments. What is left of sqrt(w / r) rho beside a
straight line, turned to the axes in which C is diagonal (lambda_i), are K - 2 independent numbers
z_i with

    E|z_i|^2 = 1 + (q / r) lambda_i,

and q is where sum |z_i|^2 / (1 + (q / r) lambda_i) = K - 2 (restricted maximum likelihood of a variance,
Patterson and Thompson, Biometrika 58 (1971) 545, in its moment form). The slope's row h gives the error:
E|delta s|^2 = q h C h^T.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hybrid._modal_fit import mode_functions
from hybrid._modal_search import Mode

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

MOST_SEGMENTS = 16
FEWEST_SEGMENTS = 6
KICKS_PER_SEGMENT = 8
# Excess of the weighted residual, in its own standard deviations, that shows a walk.
SIGNIFICANT = 2.5
# Steeper modes than this die or explode within a segment; there is no walk to be seen.
STEEPEST = 3.0


def drift_covariance(mode: Mode) -> Array | None:
    """Covariance (2, 2) of sigma and a0, per row, from a walk of the amplitude; None without one."""
    sigma, a0 = mode.poles
    square = a0 - sigma * sigma
    if square <= 0.0:
        return None
    damped = math.sqrt(square)
    rows = mode.rows_used
    count = min(MOST_SEGMENTS, int(rows * damped / math.pi))
    length = rows // count if count else 0
    if count < FEWEST_SEGMENTS or length < 4 or abs(sigma) * length > STEEPEST:
        return None
    rho, noise = _relative_amplitudes(mode, damped, count, length)
    variance = _slope_variance(rho, noise, sigma * length, mode.backward)
    if variance is None:
        return None
    # rho is per segment; the slope is shared evenly by growth and frequency.
    each = 0.5 * variance / length**2
    jacobian = np.array([[1.0, 0.0], [2.0 * sigma, 2.0 * damped]])
    covariance: Array = each * jacobian @ jacobian.T
    return covariance


def _relative_amplitudes(
    mode: Mode, damped: float, count: int, length: int
) -> tuple[Complex, float]:
    """rho of each segment, relative to the mode, and its variance at t = 0 from the rows."""
    sigma, a0 = mode.poles
    a, b, offset = mode.fit.weights
    values = mode.fitted_values()[: count * length]
    f, g = mode_functions(np.arange(float(len(values))), sigma, a0)
    residual = (values - a * f - b * g - offset).reshape(count, length)
    design = np.stack([f[:length], damped * g[:length]], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    local = residual @ design @ inverse
    left = residual - local @ design.T
    row_variance = float(np.sum(left * left)) / (count * (length - 2))
    start = np.arange(count) * length
    amplitude = complex(a, -b / damped)
    rho = (local[:, 0] - 1j * local[:, 1]) * np.exp(-(sigma + 1j * damped) * start) / amplitude
    return rho, row_variance * float(np.trace(inverse)) / abs(amplitude) ** 2


def _slope_variance(rho: Complex, noise: float, growth: float, backward: bool) -> float | None:
    """E|slope|^2 per segment^2 of a weighted line through rho, from a walk; None if none shows."""
    count = len(rho)
    segment = np.arange(float(count))
    weight = np.exp(2.0 * growth * (segment - (count - 1 if growth > 0 else 0)))
    noise *= math.exp(-2.0 * growth * (count - 1)) if growth > 0 else 1.0
    line = np.stack([np.ones(count), segment], axis=1)
    solve = np.linalg.solve(line.T @ (weight[:, None] * line), line.T * weight)
    walk = _walk_covariance(count, growth, backward)
    strength = _walk_strength(rho, noise, np.sqrt(weight), line, walk)
    return strength * float(solve[1] @ walk @ solve[1]) if strength is not None else None


def _walk_strength(
    rho: Complex, noise: float, root_weight: Array, line: Array, walk: Array
) -> float | None:
    """q of the module's text; None where the residuals pass for noise of the rows."""
    beside = np.linalg.qr(root_weight[:, None] * line, mode="complete")[0][:, 2:]
    seen = beside.T * root_weight
    strength, axes = np.linalg.eigh(seen @ walk @ seen.T)
    power = np.abs(axes.T @ seen @ rho) ** 2
    free = len(power)
    if float(np.sum(power)) - noise * free <= SIGNIFICANT * noise * math.sqrt(free):
        return None
    low, high = 0.0, float(np.sum(power)) / float(strength[0])
    for _ in range(60):
        middle = 0.5 * (low + high)
        if float(np.sum(power / (noise + middle * strength))) > free:
            low = middle
        else:
            high = middle
    return high


def _walk_covariance(count: int, growth: float, backward: bool) -> Array:
    """Covariance of the segment means of a walk whose kicks have unit strength before scaling."""
    kick = (np.arange(count * KICKS_PER_SEGMENT) + 0.5) / KICKS_PER_SEGMENT
    after = np.clip(np.arange(1.0, count + 1.0)[:, None] - kick, 0.0, 1.0)
    share = 1.0 - after if backward else after
    strength = np.exp(-2.0 * growth * kick) / KICKS_PER_SEGMENT
    covariance: Array = (share * strength) @ share.T
    return covariance
