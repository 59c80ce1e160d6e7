"""Operators of the windows against figures with 120 digits, computed another way."""

from decimal import Decimal, localcontext

import numpy as np
import pytest

from hybrid.engine.lanes import LANES
from hybrid.engine.nodes import (
    law_weights,
    new_shelf,
    nodes,
    point_weights,
    shelved,
)


def exact_weights(q, z):
    """Weights of z * integral of exp(-z (c - x)) v(x), by monomials: I_m = c^m - m I_(m-1) / z."""
    with localcontext() as context:
        context.prec = 120
        points = [Decimal(float(p)) for p in nodes(q).points]
        result = np.zeros((q, q + 1))
        for k in range(q + 1):
            coefficients = lagrange(points, k)
            for j, c in enumerate(points[1:]):
                total, integral = Decimal(0), None
                for m, a in enumerate(coefficients):
                    integral = 1 - (-z * c).exp() if m == 0 else c**m - m * integral / z
                    total += a * integral
                result[j, k] = float(total)
        return result


def lagrange(points, k):
    """Coefficients, lowest power first, of the polynomial that is 1 at point k and 0 at the others."""
    coefficients = [Decimal(1)]
    for i, p in enumerate(points):
        if i != k:
            shifted = [Decimal(0), *coefficients]
            kept = [*coefficients, Decimal(0)]
            scale = points[k] - p
            coefficients = [(a - p * b) / scale for a, b in zip(shifted, kept, strict=True)]
    return coefficients


def weights(q, rate, drive, length_s):
    out, decay = np.zeros((1 + LANES, LANES)), np.zeros(LANES)
    law_weights(nodes(q), rate, drive, length_s, out, decay)
    assert not np.any(out[q + 1 :])
    return out[: q + 1].T, decay


@pytest.mark.parametrize("q", [4, 7, 8])
@pytest.mark.parametrize(
    "z", ["1e-6", "1e-3", "0.3", "1", "5", "19", "21", "60", "1500", "1e5", "1e9"]
)
def test_a_lag_is_exact_for_every_polynomial_through_the_points(q, z):
    got, decay = weights(q, float(z), float(z), 1.0)
    np.testing.assert_allclose(got[:q], exact_weights(q, Decimal(z)), rtol=0, atol=2e-14)
    np.testing.assert_allclose(decay[:q], np.exp(-float(z) * nodes(q).marks), rtol=1e-13)
    # Constant in, the same constant out.
    np.testing.assert_allclose(got.sum(axis=1) + decay, 1.0, atol=2e-14)


def test_short_windows_keep_their_relative_precision():
    got, _ = weights(8, 1e-6, 1e-6, 1.0)
    np.testing.assert_allclose(got[:8], exact_weights(8, Decimal("1e-6")), rtol=0, atol=1e-20)


@pytest.mark.parametrize("q", [4, 7, 8])
def test_an_integrator_integrates_every_power_up_to_q_and_to_2q_minus_2_at_the_end(q):
    got, decay = weights(q, 0.0, 1.0, 1.0)
    points = nodes(q).points
    assert np.all(decay == 1.0)
    for m in range(q + 1):
        np.testing.assert_allclose(got[:q] @ points**m, points[1:] ** (m + 1) / (m + 1), atol=1e-15)
    for m in range(2 * q - 1):
        assert got[q - 1] @ points**m == pytest.approx(1 / (m + 1), abs=1e-15)
    assert got[q - 1] @ points ** (2 * q - 1) != pytest.approx(1 / (2 * q), abs=1e-12)


def test_an_integrator_with_growing_feedback():
    """x' = 3 x + t^2 over 0.5 s: x(t) = ((2 + 6 t + 9 t^2) (-1) + 2 exp(3 t)) / 27 from x(0) = 0."""
    got, decay = weights(8, -3.0, 1.0, 0.5)
    t = 0.5 * nodes(8).points
    exact = (2 * np.exp(3 * t) - 2 - 6 * t - 9 * t**2) / 27
    np.testing.assert_allclose(got[:8] @ t**2, exact[1:], atol=1e-15)
    np.testing.assert_allclose(decay, np.exp(3 * t[1:]), rtol=1e-14)


def test_nodes_beyond_q_repeat_the_last():
    got, decay = weights(6, 2.0, 2.0, 1.0)
    assert np.array_equal(got[6:], np.vstack([got[5], got[5]]))
    assert decay[6] == decay[7] == decay[5]


def test_the_shelf_keeps_powers_of_two_and_what_comes_again():
    grid, laws = nodes(8), np.array([[0.0, 1.0], [1e6, 1e6]])
    shelf = new_shelf(2, slots=4)
    slots = [shelved(shelf, grid, laws, h) for h in (2.0**-10, 3e-3, 2e-3, 3e-3, 2.0**-10, 2.0**-9)]
    assert slots == [1, 0, 0, 2, 1, 3]
    assert shelved(shelf, grid, laws, 2.0**-8) == 1
    assert shelved(shelf, grid, laws, 3e-3) == 2
    expected = weights(8, 1e6, 1e6, 2.0**-8)[0]
    assert np.array_equal(shelf.weights[1, 1].T, expected)


def test_weights_of_a_point_reproduce_polynomials_inside_and_outside_the_window():
    grid, out = nodes(8), np.zeros(9)
    for at in (0.0, 0.3, 1.0, 1.7):
        point_weights(grid, at, 8, out)
        for m in range(9):
            assert out @ grid.points**m == pytest.approx(at**m, rel=1e-9, abs=1e-14)
    point_weights(grid, 2.0, 4, out)
    assert out @ grid.points**4 == pytest.approx(16.0)
