"""Closed forms and exact roots of the coupling error, from the literature alone.

The pitch loop ``theta'' = -omega_p**2 * theta`` is closed through a digital machine or through
lagged analog components. The paper is R. M. Howe, "Computers for Simulation of Space Vehicle
Systems"; Eqs. 2.1 to 2.3 give what the coupling does to frequency and damping. This module holds
those forms as re-derived, and the exact roots that they are series of. It imports nothing of
the project and no engine imports it: a prediction and a run must not share a mistake.

Conventions, everywhere here:

* ``W = omega_p * period_s``; the ADC samples at nT, a zero-order hold shows the answer.
* A mode is ``s = -zeta * omega + j * omega_damped``. ``omega = |s|`` is the *undamped* natural
  frequency, the one of the paper; ``omega_damped = Im s = omega * sqrt(1 - zeta**2)`` is the one
  that zero crossings and spectra show. All frequencies are in rad/s.
* A negative ``zeta`` is a growing oscillation: its amplitude grows by the fraction
  ``-2 pi zeta`` a cycle of oscillation, to first order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import TypeVar

Real = TypeVar("Real", float, Decimal)

DIGITS = 100  # with a lead |z|^2 - 1 is W^4, left over from terms of W^2: floats would lose it
POLISH_STEPS = 4  # Newton doubles the digits: from 12 or more to 192
SMALLEST_STRIDE = 1e-4  # of the way gone so far; closer to critical damping nothing is found


@dataclass(frozen=True)
class ClosedForm:
    """A series of the paper at one working point; see the module for the sign convention.

    ``equation`` is the number in the paper, ``omega`` the undamped and ``omega_damped`` the damped
    frequency (rad/s; None where the form does not give it), ``zeta`` the fraction of critical
    damping, ``note`` one line on what the figure is or where the paper differs.
    """

    equation: str
    omega: float
    omega_damped: float | None
    zeta: float
    note: str


@dataclass(frozen=True)
class Mode:
    """An exact root: undamped and damped frequency (rad/s) and fraction of critical damping."""

    omega: float
    omega_damped: float
    zeta: float


def uncompensated(omega_p: float, period_s: float, *, higher_order: bool = False) -> ClosedForm:
    """Eq. 2.1: the answer to the sample at nT is held from (n+1)T to (n+2)T.

    omega = omega_p (1 - 7/12 W^2), omega_damped = omega_p (1 - 83/96 W^2), zeta = -3/4 W.
    ``higher_order`` adds + 177/160 W^4, + 18363/10240 W^4 and + 3/4 W^3 to them.
    Raises ValueError where W is not below 1.
    """
    w = _small("omega_p * period_s", omega_p, period_s)
    omega, damped, zeta = 1 - 7 / 12 * w**2, 1 - 83 / 96 * w**2, -3 / 4 * w
    if not higher_order:
        note = "the paper's orders; its omega is the undamped frequency"
        return ClosedForm("2.1", omega_p * omega, omega_p * damped, zeta, note)
    omega, damped = omega + 177 / 160 * w**4, damped + 18363 / 10240 * w**4
    zeta += 3 / 4 * w**3
    note = "Eq. 2.1 with the next term of each series, which the paper does not print"
    return ClosedForm("2.1, next order", omega_p * omega, omega_p * damped, zeta, note)


def lead_compensated(omega_p: float, period_s: float) -> ClosedForm:
    """Eq. 2.2 as re-derived: the ADC is fed theta + 1.5 T theta', for the delay T + T/2.

    omega = omega_p (1 + 13/24 W^2), zeta = -1/2 W^3; the damped frequency is the same to this
    order, as zeta^2 is of order W^6. Raises ValueError where W is not below 1.
    """
    w = _small("omega_p * period_s", omega_p, period_s)
    omega = omega_p * (1 + 13 / 24 * w**2)
    note = (
        "the paper says zeta is fourth order in T; the exact loop gives third order,"
        " and fourth for the growth per digital cycle, |z| - 1 = W^4/2"
    )
    return ClosedForm("2.2", omega, omega, -(w**3) / 2, note)


def all_analog(omega_p: float, lags_s: Sequence[float]) -> ClosedForm:
    """Eq. 2.3: N first-order lags 1/(1 + tau_i s) around an analog loop.

    zeta = -1/2 omega_p sum(tau); the frequencies, which the paper does not print, are
    omega = omega_p (1 - 1/4 omega_p^2 [(sum tau)^2 + sum tau^2]) and
    omega_damped = omega_p (1 - omega_p^2 [3/8 (sum tau)^2 + 1/4 sum tau^2]).
    Raises ValueError for a negative lag or where omega_p sum(tau) is not below 1.
    """
    lags = _lags(lags_s)
    total = _small("omega_p * sum(lags_s)", omega_p, math.fsum(lags), zero=True)
    square = omega_p**2 * math.fsum(lag * lag for lag in lags)
    omega = omega_p * (1 - (total**2 + square) / 4)
    damped = omega_p * (1 - 3 / 8 * total**2 - square / 4)
    note = "the paper prints zeta without its sign; lags destabilise"
    return ClosedForm("2.3", omega, damped, -total / 2, note)


def delay_sum(omega_p: float, delay_s: float) -> ClosedForm:
    """All delays of a loop add: zeta = -1/2 omega_p delay, to first order.

    ``delay_s`` is compute time + T/2 of the hold + the sum of all lags - any lead; a negative
    one (more lead than delay) damps. The frequencies are omega_p: their error is second order.
    Raises ValueError where |omega_p * delay_s| is not below 1.
    """
    total = math.copysign(_small("omega_p * |delay_s|", omega_p, abs(delay_s), zero=True), delay_s)
    note = "first order only: all delays of the loop add, whatever makes them"
    return ClosedForm("delays add", float(omega_p), float(omega_p), -total / 2, note)


def largest_period_s(omega_p: float, max_damping_error: float) -> float:
    """Longest cycle time (s) that Eq. 2.1 allows for a damping error: T = 4/3 |zeta| / omega_p.

    ``max_damping_error`` is the largest |zeta|, as a fraction (0.01 for one percent). Raises
    ValueError unless it is above 0 and below 3/4, where W reaches 1.
    """
    if not 0 < max_damping_error < 0.75:
        raise ValueError(f"max_damping_error is {max_damping_error}; Eq. 2.1 needs 0 < it < 0.75")
    return 4 / 3 * max_damping_error / _positive("omega_p", omega_p)


def exact_uncompensated(omega_p: float, period_s: float, *, compute_cycles: int = 1) -> Mode:
    """Exact root of the loop of Eq. 2.1, z (z-1)^2 + W^2/2 (z+1) = 0; see ``exact_lead``."""
    return exact_lead(omega_p, period_s, 0.0, compute_cycles=compute_cycles)


def exact_lead(
    omega_p: float, period_s: float, lead: float = 1.5, *, compute_cycles: int = 1
) -> Mode:
    """Exact root of the loop of Eq. 2.2 with any lead, and any whole number c of compute cycles.

    The ADC is fed theta + lead T theta' (``lead`` in cycles) at nT; the answer is held from
    (n+c)T to (n+c+1)T. Under a constant acceleration u/T^2, theta = u (z+1) / (2 (z-1)^2) and
    T theta' = u / (z-1); with u = -W^2 z^-c (theta + lead T theta') this gives

        z^c (z-1)^2 + W^2 [(z+1)/2 + lead (z-1)] = 0,   s = ln(z) / T,

    for c = 1: z (z-1)^2 + W^2/2 (z+1) = 0 at lead 0 and z (z-1)^2 + W^2 (2z-1) = 0 at lead 1.5.
    Returned is the root that starts from s = j omega_p at T = 0. Raises ValueError where that
    mode no longer oscillates (too much lead or too long a cycle).
    """
    omega_p, period_s = _positive("omega_p", omega_p), _positive("period_s", period_s)
    if not math.isfinite(lead):
        raise ValueError(f"lead is {lead}; it must be a finite number of cycles")
    if compute_cycles < 0 or not float(compute_cycles).is_integer():
        raise ValueError(f"compute_cycles is {compute_cycles}; it must be a whole number >= 0")
    with localcontext(prec=DIGITS):
        w = Decimal(omega_p) * Decimal(period_s)
        slope = (Decimal(float(lead)) + Decimal("0.5")) * w
        x, y = (w * part for part in _oscillating_root([w] * int(compute_cycles), slope))
        sigma = math.log1p(float(2 * x + x * x + y * y)) / 2  # ln|z| from |z|^2 - 1
        angle = math.atan2(float(y), float(1 + x))
    return _mode(sigma / period_s, angle / period_s)


def exact_all_analog(omega_p: float, lags_s: Sequence[float]) -> Mode:
    """Exact root of the loop of Eq. 2.3: s^2 prod(1 + tau_i s) + omega_p^2 = 0.

    Returned is the root that starts from s = j omega_p without lags. Raises ValueError for a
    negative lag.
    """
    omega_p, lags = _positive("omega_p", omega_p), _lags(lags_s)
    with localcontext(prec=DIGITS):
        scaled = [Decimal(omega_p) * Decimal(lag) for lag in lags]
        x, y = _oscillating_root(scaled, Decimal(0))
    return _mode(omega_p * float(x), omega_p * float(y))


def _mode(sigma: float, omega_damped: float) -> Mode:
    omega = math.hypot(sigma, omega_damped)
    return Mode(omega, omega_damped, -sigma / omega if sigma else 0.0)


def _oscillating_root(lags: list[Decimal], slope: Decimal) -> tuple[Decimal, Decimal]:
    """Root v = x + jy of v^2 prod(1 + lag v) + 1 + slope v = 0 that starts from j.

    Both families have this form: the analog loop with v = s/omega_p, the sampled one with
    z = 1 + W v and one "lag" W per compute cycle. Followed in floats, polished in decimals.
    """
    x, y = map(Decimal, _follow([float(lag) for lag in lags], float(slope)))
    for _ in range(POLISH_STEPS):
        dx, dy = _newton_step(x, y, lags, slope)
        x, y = x - dx, y - dy
    return x, y


def _follow(lags: list[float], slope: float) -> tuple[float, float]:
    """Follow the root from j at no delay to the full delay, in strides it cannot jump branch in."""
    x, y, done = 0.0, 1.0, 0.0
    stride = 0.05 / max(sum(lags) + abs(slope), 0.05)
    while done < 1:
        share = min(1.0, done + stride)
        new_x, new_y, step = x, y, math.inf
        for _ in range(8):
            dx, dy = _newton_step(new_x, new_y, [share * lag for lag in lags], share * slope)
            new_x, new_y, step = new_x - dx, new_y - dy, math.hypot(dx, dy)
        if step < 1e-12 * math.hypot(new_x, new_y) and math.hypot(new_x - x, new_y - y) < y / 2:
            x, y, done, stride = new_x, new_y, share, max(stride, 0.05 * share)
        elif (stride := stride / 2) < SMALLEST_STRIDE * share:
            raise ValueError(
                "the mode does not oscillate: critical damping is reached at"
                f" {share:.4g} of this period; use a shorter period or a smaller lead"
            )
    return x, y


def _newton_step(x: Real, y: Real, lags: list[Real], slope: Real) -> tuple[Real, Real]:
    """Real and imaginary part of f/f' at v = x + jy; f as in ``_oscillating_root``."""
    p, q, dp, dq = x * x - y * y, 2 * x * y, 2 * x, 2 * y  # v^2 and its derivative
    for lag in lags:
        a, b = 1 + lag * x, lag * y
        dp, dq = dp * a - dq * b + lag * p, dp * b + dq * a + lag * q
        p, q = p * a - q * b, p * b + q * a
    p, q, dp = p + 1 + slope * x, q + slope * y, dp + slope
    size = dp * dp + dq * dq
    return (p * dp + q * dq) / size, (q * dp - p * dq) / size


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise ValueError(f"{name} is {value}; it must be finite and above 0")
    return float(value)


def _small(name: str, omega_p: float, time_s: float, *, zero: bool = False) -> float:
    """Return omega_p * time_s, refused where a series in it says nothing."""
    w = _positive("omega_p", omega_p) * float(time_s)
    if not (0 <= w < 1) or (w == 0 and not zero):
        bound = "0 <= it < 1" if zero else "0 < it < 1"
        raise ValueError(f"{name} is {w:.6g}; the series needs {bound}; the exact roots go further")
    return w


def _lags(lags_s: Sequence[float]) -> list[float]:
    lags = [float(lag) for lag in lags_s]
    if any(not (math.isfinite(lag) and lag >= 0) for lag in lags):
        raise ValueError(f"lags_s is {lags}; every lag must be finite and 0 or more")
    return lags
