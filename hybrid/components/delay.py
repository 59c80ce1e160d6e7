"""Transport delay as an analog computer makes it: an all-pass circuit that approximates exp(-s T)."""

from __future__ import annotations

import math
from collections.abc import Mapping

from hybrid.components.base import Block, Core, Kind
from hybrid.keys import Bound, Holds, Key, Unit

DEFAULT_ORDER = 4


class Delay(Kind):
    """The Pade all-pass of a given order, closest to exp(-s T) at s = 0.

    Its gain is 1 at every frequency; its phase follows omega T up to about omega T = `order`, see
    `phase_error`.
    """

    key, symbol = "delay", "delay"
    doc = "sum of inputs, later: the Pade all-pass circuit for a transport delay"
    main = Key("delay", Holds.TERMS, "signal: coefficient", required=True)
    keys = (
        Key("time", Holds.QUANTITY, "the delay", Unit.TIME, Bound.POSITIVE, required=True),
        Key(
            "order",
            Holds.INTEGER,
            "order of the circuit: so many integrators",
            default=str(DEFAULT_ORDER),
        ),
    )

    def core(self, values: Mapping[str, float], gains: Mapping[str, float]) -> Core:
        """w(t) = sum(coefficient * input) at about t - time; settled to the inputs at t = 0."""
        return Core(
            gains, block=pade_all_pass(int(values.get("order", DEFAULT_ORDER)), values["time"])
        )


def phase_error(order: int, omega_t: float) -> float:
    """At most how far the phase is off at omega T, in rad.

    D exp(-j x) - N of the approximant N / D is at most x^(2n + 1) n!^2 / ((2n)! (2n + 1)!) in size, from
    the remainder integral of Pade's approximant (Hermite), and |D(j x)| is at least 1.
    """
    return omega_t ** (2 * order + 1) * _remainder(order)


def good_to(order: int, time_s: float, error: float) -> float:
    """The frequency, in rad/s, up to which the phase is off by no more than `error`, in rad."""
    return float((error / _remainder(order)) ** (1.0 / (2 * order + 1)) / time_s)


def _remainder(n: int) -> float:
    return math.factorial(n) ** 2 / (math.factorial(2 * n) * math.factorial(2 * n + 1))


def pade_all_pass(order: int, time_s: float) -> Block:
    """The Pade approximant [order/order] of exp(-s time_s) with states that stay small.

    The signal on its way is a polynomial of degree n = order over the delay line, with Legendre
    coefficients m_0 to m_n. Its first end is the input, sum (-1)^k m_k = u, its last end the output,
    sum m_k = w, and it travels: m_k' = -(2 / T) (2 k + 1) (m_(k+1) + m_(k+3) + ...) for k < n, the
    Legendre coefficients of its slope. (The tau method of Lanczos, whose exponentials are diagonal Pade
    approximants.) m_n is eliminated by the input; for even n the first state is m_0 - m_1, so that it
    alone holds the signal at rest and follows the input as a lag does.
    """
    n, last = order, (-1.0) ** order
    a = [[0.0] * n for _ in range(n)]
    b = [0.0] * n
    for k in range(n):
        rate = 2.0 / time_s * (2 * k + 1)
        for j in range(k + 1, n, 2):
            a[k][j] -= rate
        if (n - k) % 2:
            b[k] = -rate * last
            for j in range(n):
                a[k][j] += rate * last * (-1.0) ** j
    c = [1.0 - last * (-1.0) ** j for j in range(n)]
    if n % 2 == 0:
        a[0] = [one - other for one, other in zip(a[0], a[1], strict=True)]
        b[0] -= b[1]
        for row in a:
            row[1] += row[0]
        c[1] += c[0]
    rest = (1.0, *[0.0] * (n - 1))
    return Block(tuple(tuple(row) for row in a), tuple(b), tuple(c), last, rest)
