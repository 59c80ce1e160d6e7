"""Equations of the analog patches that ship, written out by hand with the lag of every component.

They know nothing of the engine. Signals are small letters; what an integrator holds before its lag is a
capital.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

TAU_S = 1e-6  # of the preset `lags`


@dataclass(frozen=True)
class Model:
    """Lagged equations of a patch: names of the recorded states, all initial values, derivative."""

    names: tuple[str, ...]
    initial: tuple[float, ...]
    rhs: object
    until: float


def van_der_pol(t, s):
    x, y, square, damping, X, Y = s
    r = 1000.0
    return [
        (X - x) / TAU_S,
        (Y - y) / TAU_S,
        (x * x - square) / TAU_S,
        (square * y - damping) / TAU_S,
        r * y,
        r * (-x + y - damping),
    ]


def lorenz(t, s):
    x, y, z, xz, xy, X, Y, Z = s
    r = 100.0
    return [
        (X - x) / TAU_S,
        (Y - y) / TAU_S,
        (Z - z) / TAU_S,
        (x * z - xz) / TAU_S,
        (x * y - xy) / TAU_S,
        10 * r * (y - x),
        r * (28 * x - y - xz),
        r * (xy - 8 / 3 * z),
    ]


def roessler(t, s):
    x, y, z, xz, X, Y, Z = s
    r = 1000.0
    return [
        (X - x) / TAU_S,
        (Y - y) / TAU_S,
        (Z - z) / TAU_S,
        (x * z - xz) / TAU_S,
        r * (-y - z),
        r * (x + 0.2 * y),
        r * (0.2 + xz - 5.7 * z),
    ]


def mathieu(t, s):
    wave, pump, x, y, X, Y = s
    r = 1000.0
    return [
        (math.cos(2 * r * t) - wave) / TAU_S,
        (x * wave - pump) / TAU_S,
        (X - x) / TAU_S,
        (Y - y) / TAU_S,
        r * y,
        r * (-1.5 * x + 0.4 * pump),
    ]


def predator_prey(t, s):
    hares, lynxes, meetings, H, L = s
    year = 1e-3
    return [
        (H - hares) / TAU_S,
        (L - lynxes) / TAU_S,
        (hares * lynxes - meetings) / TAU_S,
        (0.55 * hares - 0.028 * meetings) / year,
        (0.024 * meetings - 0.80 * lynxes) / year,
    ]


def jerk(t, s):
    x, v, a, size, X, V, A = s
    r = 1000.0
    return [
        (X - x) / TAU_S,
        (V - v) / TAU_S,
        (A - a) / TAU_S,
        (abs(x) - size) / TAU_S,
        r * v,
        r * a,
        r * (-0.6 * a - v + size - 1),
    ]


MODELS = {
    "van_der_pol": Model(
        ("x", "y", "square", "damping"), (0.5, 0, 0.25, 0, 0.5, 0), van_der_pol, 4e-3
    ),
    "lorenz": Model(("x", "y", "z", "xz", "xy"), (1, 1, 20, 20, 1, 1, 1, 20), lorenz, 5e-3),
    "roessler": Model(("x", "y", "z", "xz"), (-6, 0, 0, 0, -6, 0, 0), roessler, 4e-3),
    "mathieu": Model(("wave", "pump", "x", "y"), (1, 0.5, 0.5, 0, 0.5, 0), mathieu, 4e-3),
    "predator_prey": Model(
        ("hares", "lynxes", "meetings"), (34, 6, 204, 34, 6), predator_prey, 4e-3
    ),
    "jerk": Model(("x", "v", "a", "size"), (0,) * 7, jerk, 4e-3),
}


LINEAR_LAGGED = {  # states x' = A x + b with every lag; signals are the first states
    "harmonic_oscillator": (
        ("x", "y", "minus_x"),
        lambda r: [
            [-r, 0, 0, r, 0],
            [0, -r, 0, 0, r],
            [-r, 0, -r, 0, 0],
            [0, 1000, 0, 0, 0],
            [0, 0, 1000, 0, 0],
        ],
        [0, 0, 0, 0, 0],
        [0.8, 0, -0.8, 0.8, 0],
    ),
    "damped_oscillator": (  # in mm, m/s and m/s^2; the push is settled from the start
        ("x", "v", "a", "push"),
        lambda r: [
            [-r, 0, 0, 0, r, 0],
            [0, -r, 0, 0, 0, r],
            [-1e3 * r, -200 * r, -r, r, 0, 0],
            [0, 0, 0, -r, 0, 0],
            [0, 1e3, 0, 0, 0, 0],
            [0, 0, 1, 0, 0, 0],
        ],
        [0, 0, 0, 1e9, 0, 0],
        [0, 0, 0, 0, 0, 0],
    ),
}


# What switches: linear between its events, so exact pieces of exp(A t), each event located in time.


def pieces(matrices, guards, state, mode, time_s):
    """Rows of a system that is linear in each mode; a guard that turns positive leads to its mode.

    Guards are looked at in the rows: none may turn positive and back between two of them.
    """
    steps = {}

    def go(mode, length):
        if length not in steps.get(mode, {}):
            steps.setdefault(mode, {})[length] = expm(matrices[mode] * length)
        return steps[mode][length]

    rows, switched = [state], []
    every = time_s[1] - time_s[0]
    for row in range(1, len(time_s)):
        left = every
        while True:
            after = go(mode, left) @ state
            exits = []
            for guard, new in guards[mode]:
                if guard @ after > 0:
                    g, here = guard, state

                    def value(length, g=g, here=here, mode=mode):
                        return g @ (expm(matrices[mode] * length) @ here)

                    exits.append((brentq(value, 0.0, left, xtol=1e-17), new))
            if not exits:
                break
            at, new = min(exits)
            state, mode, left = expm(matrices[mode] * at) @ state, new, left - at
            switched.append((row * every - left, state, mode))
        state = after
        rows.append(state)
    return np.array(rows), switched


def affine(rows, constant):
    """Matrix of x' = rows x + constant for states with a 1 at the end."""
    n = len(rows)
    full = np.zeros((n + 1, n + 1))
    full[:n, :n], full[:n, n] = rows, constant
    return full


BALL = {"g": 9.81, "k": 100.0**2, "c": 2 * 0.05 * 100.0, "speed": 10.0}
FLIGHT, CONTACT = 0, 1


def ball(time_s, lagged):
    """y, v and, where lagged, depth, rubbing, push and contact."""
    g, k, c, speed = BALL["g"], BALL["k"], BALL["c"], BALL["speed"]
    if not lagged:
        matrices = {
            FLIGHT: affine([[0, speed], [0, 0]], [0, -g * speed]),
            CONTACT: affine([[0, speed], [-k * speed, -c * speed]], [0, -g * speed]),
        }
        first = [1.0, 0.0, 1.0]
    else:
        r = 1 / TAU_S

        def matrix(on):
            return affine(
                [
                    [-r, 0, 0, 0, 0, 0, r, 0],  # y
                    [0, -r, 0, 0, 0, 0, 0, r],  # v
                    [on * r, 0, -r, 0, 0, 0, 0, 0],  # depth
                    [0, on * r, 0, -r, 0, 0, 0, 0],  # rubbing
                    [0, 0, -k * r, -c * r, -r, 0, 0, 0],  # push
                    [0, 0, 0, 0, 0, -r, 0, 0],  # contact
                    [0, speed, 0, 0, 0, 0, 0, 0],
                    [0, 0, 0, 0, speed, 0, 0, 0],
                ],
                [0, 0, 0, 0, 0, on * r, 0, -g * speed],
            )

        matrices = {FLIGHT: matrix(0), CONTACT: matrix(1)}
        first = [1.0, 0, 0, 0, 0, 0, 1.0, 0, 1.0]
    up = np.eye(len(first))[0]
    guards = {FLIGHT: [(-up, CONTACT)], CONTACT: [(up, FLIGHT)]}
    return pieces(matrices, guards, np.array(first), FLIGHT, time_s)


SERVO = {"K": 10.0, "T": 0.1, "band": 0.05, "hysteresis": 0.04, "speed": 100.0}
NEITHER, LEFT, RIGHT = 0, 1, 2


def servo(time_s, lagged):
    """theta, w and, where lagged, left and right."""
    K, T, speed = SERVO["K"], SERVO["T"], SERVO["speed"]
    on = SERVO["band"] + SERVO["hysteresis"] / 2
    off = SERVO["band"] - SERVO["hysteresis"] / 2
    torque = {NEITHER: 0.0, LEFT: 1.0, RIGHT: -1.0}
    if not lagged:
        matrices = {
            mode: affine([[0, speed], [0, -speed / T]], [0, speed * K / T * torque[mode]])
            for mode in torque
        }
        first = [0.3, 0.0, 1.0]
    else:
        r = 1 / TAU_S
        matrices = {
            mode: affine(
                [
                    [-r, 0, 0, 0, r, 0],  # theta
                    [0, -r, 0, 0, 0, r],  # w
                    [0, 0, -r, 0, 0, 0],  # left
                    [0, 0, 0, -r, 0, 0],  # right
                    [0, speed, 0, 0, 0, 0],
                    [0, -speed / T, speed * K / T, speed * K / T, 0, 0],
                ],
                [0, 0, r * (mode == LEFT), -r * (mode == RIGHT), 0, 0],
            )
            for mode in torque
        }
        first = [0.3, 0, 0, -1.0, 0.3, 0, 1.0]
    theta, one = np.eye(len(first))[0], np.eye(len(first))[-1]
    guards = {
        NEITHER: [(-theta - on * one, LEFT), (theta - on * one, RIGHT)],
        LEFT: [(theta + off * one, NEITHER)],
        RIGHT: [(-theta + off * one, NEITHER)],
    }
    return pieces(matrices, guards, np.array(first), RIGHT, time_s)


SWITCHED = {
    "bouncing_ball": (ball, ("y", "v", "depth", "rubbing", "push", "contact")),
    "relay_servo": (servo, ("theta", "w", "left", "right")),
}
