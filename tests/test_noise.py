"""Noise: its spectrum, its independence, and what a hybrid loop makes of it, within sampling error.

Every bound is 4.5 standard deviations of the estimate (one false alarm in 150,000), every seed fixed.
"""

import functools
import itertools
import math

import numpy as np
import pytest
from copies import apart, in_copies
from scipy.linalg import expm

from hybrid.compiler import compile_patch
from hybrid.engine.exact import ExactPlayer as Player
from hybrid.engine.windows import CircuitPlayer
from hybrid.patchfile import parse_patch
from hybrid.record import pens_for
from hybrid.timeline import build_timeline

SIGMAS = 4.5

# --- noise of single components ----------------------------------------------------------------------

SOURCES = """
title: Two quiet sources with noise
machine: {preset: ideal, noise: 0.01, tau: 1 ms}
analog:
  a: {constant: 0, full_scale: 1}
  b: {constant: 1, full_scale: 8}
run: {until: 200 s, every: 0.5 ms}
"""
TAU_S, EVERY_S = 1e-3, 0.5e-3
RHO = math.exp(-EVERY_S / TAU_S)


@pytest.fixture(scope="module")
def sources(play):
    """Noise of the two sources in fractions of full scale, 400,000 rows after settling."""
    played = play(SOURCES, seed=1)
    return played["a"][1000:], (played["b"][1000:] - 1) / 8


def test_rms_and_mean(sources):
    # A first-order Gauss process seen every half tau: rho = exp(-1/2) between rows.
    for noise in sources:
        rows = len(noise)
        spread = math.sqrt(2 * (1 + RHO**2) / (1 - RHO**2) / rows)
        assert np.mean(noise**2) == pytest.approx(1e-4, rel=SIGMAS * spread)
        assert abs(np.mean(noise)) < SIGMAS * 0.01 * math.sqrt((1 + RHO) / (1 - RHO) / rows)


def test_autocorrelation_falls_as_exp_of_t_over_tau(sources):
    for noise in sources:
        rows, power = len(noise), np.mean(noise**2)
        for lag in (1, 2, 3, 5, 8, 20):
            found = np.mean(noise[lag:] * noise[:-lag]) / power
            # Bartlett's formula for a first-order process.
            own = RHO ** (2 * lag)
            spread = (1 + RHO**2) * (1 - own) / (1 - RHO**2) - 2 * lag * own
            expected = math.exp(-lag * EVERY_S / TAU_S)
            assert found == pytest.approx(expected, abs=SIGMAS * math.sqrt(spread / rows)), lag


def test_innovations_are_normal(sources):
    for noise in sources:
        steps = noise[1:] - RHO * noise[:-1]
        steps = steps / (0.01 * math.sqrt(1 - RHO**2))
        rows = len(steps)
        assert np.mean(steps**2) == pytest.approx(1, rel=SIGMAS * math.sqrt(2 / rows))
        assert abs(np.mean(steps**3)) < SIGMAS * math.sqrt(15 / rows)
        assert np.mean(steps**4) == pytest.approx(3, abs=SIGMAS * math.sqrt(96 / rows))
        beyond = np.mean(np.abs(steps) > 3)
        share = math.erfc(3 / math.sqrt(2))
        assert beyond == pytest.approx(share, abs=SIGMAS * math.sqrt(share / rows))


def correlation_spread(rows):
    """Deviation of the correlation of two independent first-order processes of the same rho."""
    return math.sqrt((1 + RHO**2) / (1 - RHO**2) / rows)


def test_components_and_seeds_are_independent(sources, play):
    a, b = sources
    other = play(SOURCES, seed=2)
    pairs = [(a, b), (a, other["a"][1000:]), (a, (other["b"][1000:] - 1) / 8)]
    for one, two in pairs:
        for lag in (0, 1, 7):
            found = np.mean(one[lag:] * two[: len(two) - lag]) / 1e-4
            assert abs(found) < SIGMAS * correlation_spread(len(one)), lag


def test_noise_builds_up_from_nothing_within_the_lag(compiled):
    # s^2 (1 - exp(-2t/tau)): after a time that is short beside tau, little is there yet.
    rows = finish_all(compiled(SOURCES.replace("200 s", "2 ms")), 1500)[:, :, 0]
    assert np.all(rows[:, 0] == 0.0)
    for k in range(1, 5):
        expected = 1e-4 * -math.expm1(-2 * k * EVERY_S / TAU_S)
        assert np.mean(rows[:, k] ** 2) == pytest.approx(expected, rel=SIGMAS * math.sqrt(2 / 1500))


def test_noise_far_slower_rows_than_the_lag_are_independent(play):
    text = SOURCES.replace("tau: 1 ms", "tau: 1 us").replace("200 s", "50 s")
    noise = play(text, seed=4)["a"][1:]
    rows = len(noise)
    assert rows == 100_000
    assert np.mean(noise**2) == pytest.approx(1e-4, rel=SIGMAS * math.sqrt(2 / rows))
    assert abs(np.mean(noise[1:] * noise[:-1])) < SIGMAS * 1e-4 / math.sqrt(rows)


# --- noise in a hybrid loop ----------------------------------------------------------------------------

# Figures chosen so that no source drowns the others: each makes a part of every signal's variance.
LOOP = """
title: Pitch loop with noise everywhere
parameters: {on: 1}
machine: {preset: nominal, tolerance: 0, noise: 2e-3*on, tau: 0.5 ms}
analog:
  M_c: {constant: 0, full_scale: 1e5}
  theta_ddot: {sum: {M_a: 1e-3, M_c: 1e-3}, full_scale: 100, tau: 2 ms}
  theta_dot: {integrate: {theta_ddot: 1}, initial: 0, full_scale: 10, noise: 1e-3*on, tau: 1 ms}
  theta: {integrate: {theta_dot: 1}, initial: 0.1, full_scale: 1, noise: 5e-4*on}
  gamma: {constant: 0, full_scale: 1, noise: 5e-4*on, tau: 5 ms}
  alpha: {sum: {theta: 1, gamma: -1}, full_scale: 1, noise: 5e-4*on}
interface:
  alpha_sample: {adc: alpha}
  M_a: {dac: moment, full_scale: 1e5, initial: 0, noise: 1e-3*on}
digital:
  period: 10 ms
  program:
    moment: -1e5 * alpha_sample
run: {until: 400 ms}
"""
RUNS, COPIES = 2000, 8
#        name, full scale, lag in s, rms as a fraction of full scale
PARTS = (
    ("M_a", 1e5, 0.5e-3, 1e-3),
    ("M_c", 1e5, 0.5e-3, 2e-3),
    ("theta_ddot", 100.0, 2e-3, 2e-3),
    ("theta_dot", 10.0, 1e-3, 1e-3),
    ("theta", 1.0, 0.5e-3, 5e-4),
    ("gamma", 1.0, 5e-3, 5e-4),
    ("alpha", 1.0, 0.5e-3, 5e-4),
)
PLACE = {name: i for i, (name, *_) in enumerate(PARTS)}
INSIDES = 7  # theta_dot and theta before their lags
SHOWN = ("M_a", "alpha", "theta", "theta_dot")


def loop_matrices():
    """x' = A x + b u + noise of intensity W, x = [outputs of PARTS, two integrators inside]."""
    a, b = np.zeros((9, 9)), np.zeros(9)
    intensity = np.zeros((9, 9))
    for i, (_, scale, tau, rms) in enumerate(PARTS):
        a[i, i] = -1 / tau
        intensity[i, i] = 2 * (rms * scale) ** 2 / tau
    lag = {name: tau for name, _, tau, _ in PARTS}
    b[PLACE["M_a"]] = 1 / lag["M_a"]
    a[PLACE["theta_ddot"], [PLACE["M_a"], PLACE["M_c"]]] = 1e-3 / lag["theta_ddot"]
    a[INSIDES, PLACE["theta_ddot"]] = a[INSIDES + 1, PLACE["theta_dot"]] = 1.0
    a[PLACE["theta_dot"], INSIDES] = 1 / lag["theta_dot"]
    a[PLACE["theta"], INSIDES + 1] = 1 / lag["theta"]
    a[PLACE["alpha"], PLACE["theta"]] = 1 / lag["alpha"]
    a[PLACE["alpha"], PLACE["gamma"]] = -1 / lag["alpha"]
    return a, b, intensity


@functools.cache
def spreads_of_one_cycle(period_s):
    """Weights and exp(A s) over a cycle: Gauss quadrature on panels that double."""
    a, _, _ = loop_matrices()
    nodes, weights = np.polynomial.legendre.leggauss(12)
    edges = np.concatenate([[0.0], period_s / 2.0 ** np.arange(8, -1, -1)])
    found = []
    for left, right in itertools.pairwise(edges.tolist()):
        half = (right - left) / 2
        for node, weight in zip(nodes, weights, strict=True):
            found.append((weight * half, expm(a * (left + half * (1 + node)))))
    return found


def noise_of_one_cycle(intensity, period_s):
    """Integral of exp(A s) W exp(A s)' over a cycle."""
    return sum(w * spread @ intensity @ spread.T for w, spread in spreads_of_one_cycle(period_s))


@pytest.fixture(scope="module")
def cycle_of_covariance():
    """(M, G): the state [x, M_a held, moment on its way] just after nT, P' = M P M' + G."""
    a, b, intensity = loop_matrices()
    block = np.zeros((10, 10))
    block[:9, :9], block[:9, 9] = a, b
    grown = expm(block * 0.01)
    step = np.zeros((11, 11))
    step[:9, :10] = grown[:9]
    step[9, 10] = 1.0  # the moment on its way is latched
    carry = np.eye(11, 9)
    carry[10, PLACE["alpha"]] = -1e5  # the sample holds the noise of this very instant
    step[10] = -1e5 * step[PLACE["alpha"]]
    return step, carry @ noise_of_one_cycle(intensity, 0.01) @ carry.T


def finish_all(machine, runs):
    """Records of runs with the seeds 0, 1, ...: (runs, rows, signals)."""
    timeline, pens, records = build_timeline(machine), pens_for(machine), []
    kind = CircuitPlayer if machine.elements else Player
    for seed in range(runs):
        player = kind(machine, timeline, pens, seed)
        for _ in player.play():
            pass
        assert player.overloads() == ()
        records.append(player.record)
    return np.array(records)


def columns(machine, names):
    """Places of the signals in a row of the record."""
    recorded = [pen.name for pen in pens_for(machine)]
    return [recorded.index(name) for name in names]


@pytest.fixture(scope="module", params=[False, True], ids=["exact engine", "nonlinear engine"])
def ensemble(request, play):
    """Deviations from the quiet run, (runs, rows, signals of SHOWN)."""
    machine = compile_patch(parse_patch(in_copies(LOOP, COPIES)), as_circuit=request.param)
    quiet = play(LOOP, {"on": 0.0})
    calm = np.stack([quiet[name] for name in SHOWN], axis=1)
    shown = columns(machine, [f"{name}_{k}" for name in SHOWN for k in range(COPIES)])
    return apart(finish_all(machine, RUNS // COPIES)[:, :, shown], COPIES) - calm


def covariance_of_rows(cycle_of_covariance, rows):
    """Joint covariance of the signals of SHOWN at the given rows, in order."""
    step, gained = cycle_of_covariance
    pick = np.eye(11)[[PLACE[name] for name in SHOWN]]
    present, at = np.zeros((11, 11)), {}
    for row in range(max(rows) + 1):
        if row:
            present = step @ present @ step.T + gained
        at[row] = present
    blocks = [[None] * len(rows) for _ in rows]
    for i, early in enumerate(rows):
        for j, late in enumerate(rows[i:], i):
            block = pick @ at[early] @ np.linalg.matrix_power(step.T, late - early) @ pick.T
            blocks[i][j], blocks[j][i] = block, block.T
    return np.block(blocks)


@pytest.mark.parametrize("row", [1, 2, 3, 10, 40])
def test_variance_of_every_signal_of_a_loop(row, ensemble, cycle_of_covariance):
    expected = np.diag(covariance_of_rows(cycle_of_covariance, [row]))
    found = np.mean(ensemble[:, row] ** 2, axis=0)
    np.testing.assert_allclose(found, expected, rtol=SIGMAS * math.sqrt(2 / RUNS))
    mean = np.mean(ensemble[:, row], axis=0)
    assert np.all(np.abs(mean) < SIGMAS * np.sqrt(expected / RUNS))


def test_joint_covariance_over_the_whole_run(ensemble, cycle_of_covariance):
    # All signals at 13 rows at once, whitened: the squares of 104,000 independent normal figures,
    # whose mean is 1 to 2 %. An error of a few per cent in any direction of any signal would show.
    rows = list(range(1, 41, 3))[:13]
    expected = covariance_of_rows(cycle_of_covariance, rows)
    scale = np.sqrt(np.diag(expected))
    root = np.linalg.cholesky(expected / np.outer(scale, scale))
    whitened = np.linalg.solve(root, (ensemble[:, rows].reshape(RUNS, -1) / scale).T)
    assert np.mean(whitened**2) == pytest.approx(1, abs=SIGMAS * math.sqrt(2 / whitened.size))
    each = np.mean(whitened**2, axis=1)
    assert np.all(np.abs(each - 1) < 5 * math.sqrt(2 / RUNS))  # 52 figures: 5 in place of 4.5
    between = whitened @ whitened.T / RUNS - np.diag(each)
    assert np.max(np.abs(between)) < 5.5 / math.sqrt(RUNS)  # 1,326 of them


def test_every_source_of_noise_matters_here(cycle_of_covariance):
    # The loop test can only see what makes a visible part of some variance: so that it can fail.
    whole = np.diag(covariance_of_rows(cycle_of_covariance, [40]))
    _, _, intensity = loop_matrices()
    carry = np.eye(11, 9)
    carry[10, PLACE["alpha"]] = -1e5
    step = cycle_of_covariance[0]
    for name, place in PLACE.items():
        silent = intensity.copy()
        silent[place, place] = 0.0
        gained = carry @ noise_of_one_cycle(silent, 0.01) @ carry.T
        part = 1 - np.diag(covariance_of_rows((step, gained), [40])) / whole
        assert np.max(part) > 0.05, name


def test_noise_of_a_shipped_patch_is_that_of_its_full_scales(shipped, compiled):
    # 1e-4 of full scale, seen behind the lag: theta's noise is 1e-4 rad at once.
    machine = compiled(shipped("pitch_loop", ("until: 10 s", "until: 3 ms")), preset="nominal")
    own = {"M_a": 10.0, "theta": 1e-4, "theta_dot": 1e-3}
    # alpha has theta's noise and gamma's too, each seen through its own lag: half the power of two
    # equal first-order lags in a row passes the second.
    own["alpha"] = 1e-4 * math.sqrt(1 + 2 * 0.5)
    own["alpha_sample"] = math.hypot(own["alpha"], 1 / 8191 / math.sqrt(12))
    rows = finish_all(machine, RUNS)[:, 1, columns(machine, own)]
    for name, found in zip(own, np.std(rows, axis=0, ddof=1), strict=True):
        loose = 0.05 if name == "alpha_sample" else 0.0  # rounding is only nearly independent
        assert found == pytest.approx(own[name], rel=SIGMAS / math.sqrt(2 * RUNS) + loose), name
