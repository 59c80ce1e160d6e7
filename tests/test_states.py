"""States of the digital program: integration formulas, what a stage sees, and their exact modes.

Expected figures come from exact solutions, from the textbook polynomials of the formulas, and from the
formulas played step by step in Python.
"""

import itertools
import math

import numpy as np
import pytest

from hybrid.coupling import exact_modes, ideal_modes, modes
from hybrid.errors import PatchError
from hybrid.formulas import FORMULAS, MULTISTEP, RUNGE_KUTTA
from hybrid.patchfile import parse_patch
from hybrid.prediction import predict
from hybrid.runs import run

ORDERS = {"euler": 1, "ab2": 2, "ab3": 3, "ab4": 4, "rk2": 2, "rk3": 3, "rk4": 4}

PENDULUM = """
title: a pendulum in the program alone
parameters: {step: 0.05 s}
digital:
  period: step
  compute_time: 0 s
  integration: FORMULA
  states:
    angle: {integrate: rate, initial: 1 rad}
    rate: {integrate: pull, initial: 0 rad/s}
    clock: {integrate: 1, initial: 0 s}
  program:
    pull: -weight * sin(angle) * (1 + 0.1 * cos(clock * 1))
    weight: 1
    late: next(angle)
run: {until: 2 s}
"""
PENDULUM = PENDULUM.replace("parameters: {step", "parameters: {unit: 1 1/s, step").replace(
    "cos(clock * 1)", "cos(clock * unit)"
)
PENDULUM = PENDULUM.replace("weight: 1\n", "weight: unit**2\n")


def slope(x):
    """x = [angle, rate, clock]."""
    return np.array([x[1], -math.sin(x[0]) * (1 + 0.1 * math.cos(x[2])), 1.0])


def by_hand(formula, h, steps, f=slope, x0=(1.0, 0.0, 0.0)):
    """The same steps in Python, written down apart from the tape."""
    x, past, found = np.array(x0), [], [np.array(x0)]
    for _ in range(steps):
        rate = f(x)
        past.insert(0, rate)
        weights = MULTISTEP.get(formula, ())
        if weights and len(past) >= len(weights):
            x = x + h * sum(w * r for w, r in zip(weights, past, strict=False))
        else:
            tableau = RUNGE_KUTTA[formula if formula in RUNGE_KUTTA else f"rk{len(weights)}"]
            k = [rate]
            for row in tableau.stages:
                k.append(f(x + h * sum(w * r for w, r in zip(row, k, strict=True))))
            x = x + h * sum(w * r for w, r in zip(tableau.weights, k, strict=True))
        found.append(x)
    return np.array(found)


def test_order_conditions():
    """Adams-Bashforth: sum b_j (-j)^m = 1/(m+1) for m < order. Runge-Kutta: the conditions up to 4."""
    for weights in MULTISTEP.values():
        for m in range(len(weights)):
            moment = sum(w * float(-j) ** m for j, w in enumerate(weights))
            assert moment == pytest.approx(1 / (m + 1), abs=1e-14)
    for name, tableau in RUNGE_KUTTA.items():
        b = np.array(tableau.weights)
        a = np.zeros((len(b), len(b)))
        for i, row in enumerate(tableau.stages, start=1):
            a[i, : len(row)] = row
        c = a.sum(axis=1)
        conditions = [(b.sum(), 1), (b @ c, 1 / 2)]
        if ORDERS[name] >= 3:
            conditions += [(b @ c**2, 1 / 3), (b @ a @ c, 1 / 6)]
        if ORDERS[name] >= 4:
            conditions += [(b @ c**3, 1 / 4), (b @ (c * (a @ c)), 1 / 8)]
            conditions += [(b @ a @ c**2, 1 / 12), (b @ a @ a @ c, 1 / 24)]
        for found, due in conditions:
            assert found == pytest.approx(due, abs=1e-15)


@pytest.mark.parametrize("formula", FORMULAS)
def test_steps_agree_with_steps_by_hand(formula, play):
    played = play(PENDULUM.replace("FORMULA", formula))
    expected = by_hand(formula, 0.05, 41)
    for column, name in enumerate(("angle", "rate", "clock")):
        # Some ten roundings a step of values about 1; the pendulum does not amplify them much.
        np.testing.assert_allclose(
            played[name][:40], expected[:40, column], rtol=0, atol=40 * 2e-15
        )
    # next(angle), read in the same cycle, is the value at the start of the one after.
    assert played["late"][:39].tolist() == played["angle"][1:40].tolist()


@pytest.mark.parametrize("formula", FORMULAS)
def test_order_of_convergence(formula, play):
    """x' = -x^2 + cos(t)... with x = 2/(1 + t): error at t = 1 falls as h^order."""
    text = """
title: Riccati
parameters: {step: 0.1 s, second: 1 s}
digital:
  period: step
  compute_time: 0 s
  states: {x: {integrate: -x**2/(2*second), initial: 2, formula: FORMULA}}
run: {until: 1 s, every: 1 s}
"""
    errors = []
    steps = (0.02, 0.01, 0.005)
    for step in steps:
        played = play(text.replace("FORMULA", formula), {"step": step})
        errors.append(abs(played["x"][1] - 1.0))
    slopes = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    # The next term of the error is smaller by some h: a slope off by a few times 0.02.
    assert slopes[-1] == pytest.approx(ORDERS[formula], abs=0.1)


def test_the_order_of_mixed_formulas(play):
    text = PENDULUM.replace(
        "integrate: rate, initial: 1 rad", "integrate: rate, formula: rk4, initial: 1"
    )
    text = text.replace("until: 2 s", "until: 2 s, every: 2 s")
    exact = by_hand("rk4", 1e-3, 2000)[-1, 0]
    for others, order in (("euler", 1), ("ab2", 2), ("rk2", 2), ("rk3", 2), ("ab3", 3), ("ab4", 3)):
        errors = []
        for step in (0.005, 0.0025):
            found = play(text.replace("FORMULA", others), {"step": step})["angle"][1]
            errors.append(abs(found - exact))
        assert (
            math.log2(errors[0] / errors[1]) > order - 0.25
        )  # the errors of both may have opposite signs


# -- characteristic roots

LINEAR = """
title: x' = lambda x
parameters: {step: 0.1 s, a: -1 1/s, b: 2 1/s}
digital:
  period: step
  compute_time: 0 s
  integration: FORMULA
  states:
    u: {integrate: a*u - b*v, initial: 1}
    v: {integrate: fall, initial: 0}
  program: {fall: b*u + a*v}
run: {until: 10 s}
readouts: {mode: {transient: u}}
"""


def polynomial(formula, mu):
    """Textbook characteristic polynomial in z for x' = lambda x, mu = lambda h."""
    weights = MULTISTEP.get(formula)
    if weights:
        head = [1.0, -1.0 - mu * weights[0]]
        return np.array(head + [-mu * w for w in weights[1:]])
    return np.array([1.0, -sum(mu**k / math.factorial(k) for k in range(ORDERS[formula] + 1))])


@pytest.mark.parametrize("formula", FORMULAS)
def test_characteristic_roots(formula, compiled):
    """The pair u + i v obeys x' = (a + i b) x; the map has the roots for mu and for its conjugate."""
    found = exact_modes(compiled(LINEAR.replace("FORMULA", formula)))
    mu = 0.1 * (-1 + 2j)
    roots = np.concatenate([np.roots(polynomial(formula, m)) for m in (mu, mu.conjugate())])
    expected = np.log(roots.astype(complex)) / 0.1
    assert len(found) == len(expected)
    for s in expected:
        # ln of a root on the negative real axis has either sign of pi.
        gap = min(abs(np.exp(0.1 * found) - np.exp(0.1 * s)))
        assert gap < 1e-12


@pytest.mark.parametrize("formula", FORMULAS)
def test_the_ideal_is_the_continuous_meaning(formula, compiled):
    machine = compiled(LINEAR.replace("FORMULA", formula))
    mode, *others = sorted(modes(machine), key=lambda m: abs(m.s - (-1 + 2j)))
    # A root of the formula that lasts from cycle to cycle is told, with nothing ideal beside it.
    assert all(math.isnan(m.omega_ideal) and m.s.real > -math.log(2.0) / 0.1 for m in others)
    assert len(others) == (formula == "ab4")
    assert mode.omega_ideal == pytest.approx(math.sqrt(5), rel=1e-14)
    assert mode.zeta_ideal == pytest.approx(1 / math.sqrt(5), rel=1e-14)
    # s - lambda = lambda (h lambda)^p C + ..., C at most 3/8 (AB3: 3/8, AB4: 251/720, Euler: 1/2).
    size = 0.1 * math.sqrt(5)
    assert abs(mode.s - (-1 + 2j)) < 1.5 * 0.5 * math.sqrt(5) * size ** ORDERS[formula]
    assert abs(mode.s - (-1 + 2j)) > 1e-5


@pytest.mark.parametrize("formula", FORMULAS)
def test_a_measured_mode_is_the_predicted_one(formula):
    """A damped oscillation of 2 rad/s; the readout begins when the roots that nobody meant are gone."""
    text = LINEAR.replace("FORMULA", formula).replace("{transient: u}", "{transient: u, from: 3 s}")
    patch = parse_patch(text)
    parameters = {"a": -0.05, "step": 0.05}
    (mode,) = predict(patch, parameters).modes
    read = run(patch, parameters).readouts["mode"]
    # The readout of a clean transient is good to 1e-9; here it has 140 rows of it.
    assert read["omega"] == pytest.approx(mode.omega, rel=1e-9)
    assert read["zeta"] == pytest.approx(mode.zeta, abs=1e-9)


HYBRID = """
title: half analog, half digital
machine: ideal
parameters: {step: 10 ms, stiffness: 100 1/s^2}
analog:
  rate: {integrate: {pull: 1}, initial: 0 rad/s, full_scale: 20 rad/s}
interface:
  rate_sample: {adc: rate}
  pull: {dac: pull_word, initial: -100 rad/s^2, full_scale: 200 rad/s^2}
digital:
  period: step
  compute_time: 0 s
  states: {angle: {integrate: rate_sample, initial: 1 rad, formula: FORMULA}}
  program: {pull_word: -stiffness * angle}
run: {until: 3 s}
"""


@pytest.mark.parametrize("formula", ["euler", "ab2", "rk4"])
def test_states_in_a_hybrid_loop(formula, play, compiled):
    """Sampled rate r, held pull: r' = r - k h x; x' by the formula with r held, which for Euler and RK4
    alike is x + h r, and for AB2 x + h (1.5 r - 0.5 r_before)."""
    text = HYBRID.replace("FORMULA", formula)
    h, k = 0.01, 100.0
    r, x, before, column = 0.0, 1.0, None, []
    for _ in range(300):
        column.append(x)
        slope_ = r if formula != "ab2" or before is None else 1.5 * r - 0.5 * before
        before = r
        r, x = r - k * h * x, x + h * slope_
    np.testing.assert_allclose(play(text)["angle"][:300], column, rtol=0, atol=1e-11)
    machine = compiled(text)
    if formula == "ab2":
        matrix = [[1, -k * h, 0], [1.5 * h, 1, -0.5 * h], [1, 0, 0]]
    else:
        matrix = [[1, -k * h], [h, 1]]
    expected = np.log(np.linalg.eigvals(np.array(matrix)).astype(complex)) / h
    found = exact_modes(machine)
    for s in expected:
        assert min(abs(np.exp(h * found) - np.exp(h * s))) < 1e-12
    ideal = ideal_modes(machine.patch, {})
    assert sorted(ideal.imag) == pytest.approx([-10, 10], rel=1e-14)
    assert np.max(np.abs(ideal.real)) < 1e-12


# -- held, reset, delayed


def test_what_a_stage_holds(play):
    """previous() stays as it is within a step: x' = previous(count) is a staircase for every formula."""
    text = """
title: staircase
parameters: {step: 1 s, second: 1 s}
digital:
  period: step
  compute_time: 0 s
  remember: {count: 0}
  states: {x: {integrate: previous(count)/second, initial: 0, formula: rk4}}
  program: {count: previous(count) + 1, before: previous(x), before_2: "previous(x, 2)"}
run: {until: 10 s}
"""
    played = play(text)
    n = np.arange(10)
    # Weights 1/6 + 2/6 + 2/6 + 1/6 round.
    np.testing.assert_allclose(played["x"][:10], n * (n - 1) / 2, rtol=1e-15)
    assert played["before"][:10].tolist() == [0.0, *played["x"][:9]]
    assert played["before_2"][:10].tolist() == [0.0, 0.0, *played["x"][:8]]


def test_a_state_is_reset_by_a_condition(play):
    text = """
title: sawtooth in the program, and one that follows another
parameters: {step: 1 s, second: 1 s}
digital:
  period: step
  compute_time: 0 s
  states:
    saw: {integrate: 1, initial: 0 s, formula: ab3, reset_when: next(clock) >= mark + 4*second,
          reset_to: clock - clock}
    clock: {integrate: 1, initial: 0 s, formula: euler}
    mark: {integrate: 0, initial: 0 s, reset_when: next(saw) == 0, reset_to: next(clock)}
run: {until: 12 s}
"""
    played = play(text)
    np.testing.assert_allclose(played["saw"][:12], np.arange(12) % 4, atol=1e-14)
    assert played["mark"][:12].tolist() == [0.0] * 4 + [4.0] * 4 + [8.0] * 4


def test_a_state_shows_its_initial_value_before_the_first_result(play):
    played = play(
        HYBRID.replace("FORMULA", "rk2").replace("compute_time: 0 s", "compute_time: step")
    )
    assert played["angle"][0] == 1.0
    assert played["pull_word"][0] == 0.0


# -- mistakes

STATES = """
title: a state
parameters: {step: 1 ms, speed: 2 m/s}
digital:
  period: step
  states:
    height: {integrate: fall, initial: 3 m}
  program: {fall: speed, extra: 1}
run: {until: 1 s}
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("initial: 3 m", "initial: 3 m, formula: rk5", 7, "state 'height' is 'rk5'; valid: euler"),
        ("period: step", "period: step\n  integration: verlet", 6, "digital is 'verlet'; valid: euler"),
        ("integrate: fall", "integrate: next(height)/step", 7, "which the step only gives; read height"),
        ("integrate: fall", "integrate: gone", 7, "state 'height' reads unknown 'gone'"),
        ("integrate: fall", "integrate: fall +", 7, "integrate of state 'height': not arithmetic"),
        ("integrate: fall, ", "", 7, "state 'height' has no integrate"),
        (", initial: 3 m", "", 7, "state 'height' has no initial"),
        ("initial: 3 m", "initial: 3 s", 7, "it must be a pure number"),
        ("initial: 3 m", "initial: 3 m, begin: 1", 7, "unknown key 'begin' in state 'height'"),
        ("initial: 3 m", "initial: 3 m, reset_when: 1", 7, "has reset_when, but no reset_to"),
        ("initial: 3 m", "initial: 3 m, reset_when: step, reset_to: 0", 7, "reset_when of state"),
        ("initial: 3 m", "initial: 3 m, reset_when: 1, reset_to: speed", 7, "it must be in m"),
        ("initial: 3 m", "initial: 1/0", 7, "has no finite value"),
        ("fall: speed", "fall: speed*next(height)/height", 8,
         "circular program: fall -> next(height) -> fall; read height, or previous(fall), in place"),
        ("fall: speed", "fall: speed + next(extra)", 8, "'extra' is no state; valid: height"),
        ("fall: speed", "fall: speed + height", 8, "must have the same units"),
        ("extra: 1", "extra: next(speed)", 8, "'speed' is no state"),
        ("extra: 1", "height: 1", 8, "'height' is defined twice"),
        ("extra: 1", "extra: 'next(height, 2)'", 8, "next() takes the name of one state"),
        ("period: step", "period: step\n  remember: {height: 0 m}", 6, "which has its initial value"),
        ("    height: {integrate: fall, initial: 3 m}\n", "    {}\n", 7, "states is empty"),
    ],
)  # fmt: skip
def test_mistakes(old, new, line, reason):
    assert old in STATES
    with pytest.raises(PatchError) as caught:
        parse_patch(STATES.replace(old, new))
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.place.line == line


def test_a_program_of_states_alone_and_one_of_nothing():
    alone = STATES.replace("  program: {fall: speed, extra: 1}\n", "").replace("fall,", "speed,")
    assert parse_patch(alone).signals == ("height",)
    nothing = alone.replace("  states:\n    height: {integrate: speed, initial: 3 m}\n", "")
    with pytest.raises(PatchError, match="digital has no program; add program: "):
        parse_patch(nothing)


def test_a_state_that_overflows_stops_the_run(play):
    text = LINEAR.replace("FORMULA", "euler").replace("a: -1 1/s", "a: 1e300 1/s")
    played = play(text)
    assert not np.isfinite(played.player.state.words).all()
    assert played.player.done_s == pytest.approx(0.2)
