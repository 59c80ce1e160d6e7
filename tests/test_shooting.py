"""The patch that shoots, against its equations written out by hand, operation by operation."""

import itertools
import math

import numpy as np
import pytest
from lagged_models import TAU_S
from scipy.integrate import solve_ivp

from hybrid import parse_patch, run
from hybrid.shipped import shipped_patches

RATE, GAIN, SHOTS = 1000.0, 0.4, 8
POINTWISE = 1e-7  # of full scale
TIGHT = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-12}
ROWS = 120  # of one operation: 10 of IC, 100 of OP, 10 of HOLD


def play(machine, **parameters):
    text = shipped_patches()["shooting"].read_text(encoding="utf-8")
    text = text.replace("record: [y, v, slope]\n", "")
    result = run(parse_patch(text), parameters or None, machine=machine)
    assert (result.status, result.operations, result.overloads) == ("complete", SHOTS, ())
    return result


def columns(result):
    return {pen.name: result.rows[:, i] for i, pen in enumerate(result.pens)}


def test_every_shot_on_the_ideal_machine():
    """y'' = 3/2 y^2 from 4 with the slope that the last shot's miss corrected."""
    found = columns(play("ideal"))
    slope, x = -10.0, np.linspace(0.0, 1.0, 101)
    for shot in range(SHOTS):
        exact = solve_ivp(
            lambda x, z: [z[1], 1.5 * z[0] ** 2], (0, 1), [4.0, slope], t_eval=x, **TIGHT
        ).y
        rows = slice(ROWS * shot + 10, ROWS * shot + 111)
        for name, row, scale in (("y", exact[0], 5.0), ("v", exact[1], 12.0)):
            assert np.max(np.abs(found[name][rows] - row)) < POINTWISE * scale
        # While the machine shoots, the slope it began with stays.
        begun = found["slope"][ROWS * shot + 1 : ROWS * shot + 109]
        assert np.all(begun == begun[0])
        assert begun[0] == pytest.approx(slope, abs=POINTWISE)
        slope -= GAIN * (exact[0][-1] - 1.0)


def test_the_slope_converges_as_the_header_says():
    """The sensitivity u'' = 12 u / (1 + x)^2, u(0) = 0, u'(0) = 1 ends at (2^4 - 2^-3) / 7 = 127/56."""
    result = play("ideal", first=-8.1)
    slopes = columns(result)["slope"][0::ROWS][:SHOTS]
    errors = slopes + 8.0
    factor = 1.0 - GAIN * 127 / 56
    assert factor == pytest.approx(0.0929, abs=1e-4)
    # What is left out is of second order: the error times some figure of order one.
    for before, after in itertools.pairwise(errors[:5]):
        assert after / before == pytest.approx(factor, abs=abs(before))
    x = np.linspace(0.0, 1.0, 101)
    shipped = columns(play("ideal"))
    off = shipped["slope"][ROWS * (SHOTS - 1)] + 8.0
    last = shipped["y"][ROWS * (SHOTS - 1) + 10 :][:101] - 4 / (1 + x) ** 2
    assert np.max(np.abs(last)) == pytest.approx(abs(off) * 127 / 56, rel=0.01)
    assert abs(play("ideal").readouts["slope"]["value"] + 8.0) < 1e-7


def lagged_shots():
    """(time, y, v, slope) at the rows, every lag a state, mode by mode."""
    y0, v0 = 4.0, -10.0
    corrected = v0 - GAIN * (y0 - 1.0)
    state = np.array([y0, y0, v0, v0, y0**2, corrected, v0, v0])
    caught_before, slope_before = v0, v0
    every = 0.01e-3
    rows = []

    def slopes(mode):
        def rhs(_, s):
            y_core, y, v_core, v, square, corrected, caught, slope = s
            op = mode == "OP"
            y_in, v_in = (4.0, slope) if mode == "IC" else (y_core, v_core)
            lagged = [
                y_in - y,
                v_in - v,
                y * y - square,
                slope + GAIN * (1.0 - y) - corrected,
                (corrected if op else caught_before) - caught,
                (caught if mode == "HOLD" else slope_before) - slope,
            ]
            d = [value / TAU_S for value in lagged]
            cores = (RATE * v, 1.5 * RATE * square) if op else (0.0, 0.0)
            return [cores[0], d[0], cores[1], d[1], *d[2:]]

        return rhs

    for _ in range(SHOTS):
        for mode, count in (("IC", 10), ("OP", 100), ("HOLD", 10)):
            times = np.arange(count + 1) * every
            found = solve_ivp(slopes(mode), (0.0, times[-1]), state, t_eval=times, **TIGHT)
            rows += found.y[[1, 3, 7], :-1].T.tolist()
            state = found.y[:, -1].copy()
            if mode == "IC":
                state[0], state[2] = 4.0, state[7]
            elif mode == "OP":
                caught_before = state[5]
            else:
                slope_before = state[6]
    return np.array(rows), state


def test_every_shot_with_every_lag():
    found, (rows, last) = columns(play("lags")), lagged_shots()
    for i, (name, scale) in enumerate((("y", 5.0), ("v", 12.0), ("slope", 12.0))):
        assert np.max(np.abs(found[name][: len(rows)] - rows[:, i])) < POINTWISE * scale, name
    assert last[7] == pytest.approx(-8.0164, abs=5e-5)  # the header
    assert math.isclose(found["slope"][-1], last[7], abs_tol=POINTWISE)
