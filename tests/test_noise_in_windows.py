"""Noise on the nonlinear engine: exact covariances, and small steps through a nonlinear patch.

Bounds are 4.5 standard deviations of the estimate (5 or more where there are hundreds), seeds fixed.
"""

import math

import numpy as np
import pytest
from copies import apart, in_copies

import hybrid
from hybrid.compiler import compile_patch
from hybrid.engine.propagator import propagator
from hybrid.engine.sweep import REJECTED, WINDOWS
from hybrid.engine.windows import CircuitPlayer, settled
from hybrid.record import pens_for
from hybrid.runs import run
from hybrid.timeline import build_timeline

SIGMAS = 4.5

# An oscillator with summers in a row, a slow lag and an integral of noise alone.
LINEAR = """
title: Oscillator with noise everywhere
parameters: {tau: 1 us, every: 0.3 ms, until: 1.5 ms, on: 1}
machine: {preset: nominal, noise: 1e-2*on, tolerance: 0, tau: tau}
analog:
  speed: {integrate: {third: -1000}, initial: 0, full_scale: 1}
  place: {integrate: {speed: 1000}, initial: 0.5, full_scale: 1}
  first: {sum: {place: 1}, full_scale: 1}
  second: {sum: {first: 1, speed: 0.1}, full_scale: 1, noise: 5e-3*on}
  third: {sum: {second: 1}, full_scale: 1, tau: 2*tau}
  slow: {lag: {second: 1}, time_constant: 2 ms, full_scale: 1}
  zero: {constant: 0, full_scale: 1}
  walk: {integrate: {zero: 1000}, initial: 0, full_scale: 1}
run: {until: until, every: every}
"""
# A noise generator, its integral, and what a lag makes of it.
GENERATOR = """
title: Noise generator
parameters: {tau: 1 us, every: 0.3 ms, until: 1.5 ms, on: 1}
machine: {preset: nominal, noise: 1e-2*on, tolerance: 0, tau: tau}
analog:
  n: {noise_source: 0.1*on, bandwidth: 1e4 rad/s, full_scale: 1}
  area: {integrate: {n: 2000}, initial: 0.1, full_scale: 1}
  slow: {lag: {n: 1}, time_constant: 0.2 ms, full_scale: 1}
run: {until: until, every: every}
"""
ROWS = 5
COPIES = 8


def ensemble(text, runs, parameters=None):
    """Records of `runs` runs, with noise of their own: (runs, rows, signals by name)."""
    patch = hybrid.parse_patch(in_copies(text, COPIES))
    machine = compile_patch(patch, parameters, as_circuit=True)
    names = [pen.name for pen in pens_for(compile_patch(hybrid.parse_patch(text)))]
    assert [p.name for p in pens_for(machine)] == [f"{n}_{k}" for n in names for k in range(COPIES)]
    return apart(records(machine, runs // COPIES), COPIES)


def records(machine, runs):
    """Records of runs with the seeds 0, 1, ...: (runs, rows, signals)."""
    timeline, pens, found = build_timeline(machine), pens_for(machine), []
    for seed in range(runs):
        player = CircuitPlayer(machine, timeline, pens, seed)
        for _ in player.play():
            pass
        found.append(player.record)
    return np.array(found)


def covariance(machine, every_s):
    """Joint covariance of all signals at rows 1 to ROWS, from the exact propagator."""
    analog, n = machine.analog, len(machine.analog.states)
    exact = propagator(analog, every_s)
    step, gained = np.eye(n) + exact.change[:, :n], exact.spread @ exact.spread.T
    shown, at = analog.c[:, :n], [np.zeros((n, n))]
    for _ in range(ROWS):
        at.append(step @ at[-1] @ step.T + gained)
    blocks = [[np.empty(0)] * ROWS for _ in range(ROWS)]
    for i in range(ROWS):
        for j in range(i, ROWS):
            block = shown @ at[i + 1] @ np.linalg.matrix_power(step.T, j - i) @ shown.T
            blocks[i][j], blocks[j][i] = block, block.T
    return np.block(blocks)


@pytest.mark.parametrize(
    ("text", "tau", "every"),
    [
        (LINEAR, 1e-6, 3e-4),
        (LINEAR, 1e-6, 3e-5),
        (LINEAR, 1e-6, 5e-6),
        (LINEAR, 2e-5, 3e-4),
        (LINEAR, 1e-3, 3e-4),
        (GENERATOR, 1e-6, 3e-4),
        (GENERATOR, 1e-6, 2e-3),
        (GENERATOR, 3e-5, 3e-5),
    ],
)
def test_the_covariance_of_a_linear_patch_is_the_exact_one(text, tau, every):
    """All signals at five instants together, also whitened: no direction may be off."""
    runs = 800
    figures = {"tau": tau, "every": every, "until": ROWS * every}
    patch = hybrid.parse_patch(text)
    calm = records(compile_patch(patch, figures | {"on": 0.0}, as_circuit=True), 1)
    noisy = ensemble(text, runs, figures)
    deviations = (noisy - calm)[:, 1:].reshape(runs, -1)
    expected = covariance(compile_patch(patch, figures), every)
    scale = np.sqrt(np.diag(expected))
    # What lags make of noise is right to 1.5e-3 (tests/test_projection.py).
    ratios = np.mean(deviations**2, axis=0) / scale**2
    np.testing.assert_allclose(ratios, 1.0, atol=SIGMAS * math.sqrt(2 / runs) + 2e-3)
    assert np.all(np.abs(np.mean(deviations, axis=0)) < SIGMAS * scale / math.sqrt(runs))
    root = np.linalg.cholesky(expected / np.outer(scale, scale) + 1e-12 * np.eye(len(scale)))
    white = np.linalg.solve(root, (deviations / scale).T)
    assert np.mean(white**2) == pytest.approx(1, abs=SIGMAS * math.sqrt(2 / white.size) + 3e-3)
    each = np.mean(white**2, axis=1)
    assert np.all(np.abs(each - 1) < 5 * math.sqrt(2 / runs))
    between = white @ white.T / runs - np.diag(each)
    assert np.max(np.abs(between)) < 5.5 / math.sqrt(runs)  # hundreds of them


@pytest.mark.parametrize("as_circuit", [False, True])
def test_noise_without_a_lag_is_refused_on_either_engine(as_circuit):
    with pytest.raises(hybrid.PatchError, match="noise without a lag has no bandwidth"):
        compile_patch(hybrid.parse_patch(LINEAR), {"tau": 0.0}, as_circuit=as_circuit)


# --- a nonlinear patch, against small steps -----------------------------------------------------------

# Lags slow enough for a brute-force integration, and noise large enough to be seen.
OSCILLATOR = """
title: Van der Pol's oscillator with noise everywhere
machine: {preset: nominal, noise: 1e-2, tolerance: 0, tau: 20 us}
analog:
  x: {integrate: {y: 1000}, initial: 1, full_scale: 2.5}
  y: {integrate: {x: -1000, y: 1000, damping: -1000}, initial: 0, full_scale: 3}
  square: {multiply: [x, x], full_scale: 6.25}
  damping: {multiply: [square, y], full_scale: 5}
run: {until: 6 ms, every: 1 ms}
"""
SCALES = {"damping": 5.0, "square": 6.25, "x": 2.5, "y": 3.0}


def small_steps(runs, tau_s=20e-6, rms=1e-2, rate=1000.0, rows=6, row_s=1e-3):
    """The same by steps of tau/20: (runs, rows, signals of SCALES), deviations of the method 1e-3.

    Every output is v + n: v' = (u - v)/tau by the trapezoidal rule, u taken before and after the step,
    what stands first being computed first; n an Ornstein-Uhlenbeck process, exact.
    """
    random, h = np.random.default_rng(7), tau_s / 20
    fade = math.exp(-h / tau_s)
    kick = rms * math.sqrt(1 - fade**2)
    inner_x, inner_y = np.ones(runs), np.zeros(runs)
    u = {"x": inner_x, "y": inner_y, "square": np.ones(runs), "damping": np.zeros(runs)}
    v, n = dict(u), {name: np.zeros(runs) for name in u}
    found, steps = np.empty((runs, rows, len(SCALES))), round(row_s / h)
    for step in range(rows * steps):
        out = {name: v[name] + n[name] for name in v}
        draws = random.standard_normal((len(SCALES), runs))
        for name, draw in zip(SCALES, draws, strict=True):
            n[name] = fade * n[name] + kick * SCALES[name] * draw
        slope = -out["x"] + out["y"] - out["damping"]
        inner_x = inner_x + rate * h * out["y"]
        inner_y = inner_y + rate * h * slope
        for name in ("x", "y", "square", "damping"):
            before = u[name]
            if name == "x":
                u[name] = inner_x
            elif name == "y":
                u[name] = inner_y
            elif name == "square":
                u[name] = (v["x"] + n["x"]) ** 2
            else:
                u[name] = (v["square"] + n["square"]) * (v["y"] + n["y"])
            v[name] = fade * v[name] + (1 - fade) * (before + u[name]) / 2
        # Integrators by the trapezoidal rule, too.
        after = {name: v[name] + n[name] for name in v}
        inner_x = inner_x + rate * h / 2 * (after["y"] - out["y"])
        change = after["y"] - out["y"] - after["x"] + out["x"] - after["damping"] + out["damping"]
        inner_y = inner_y + rate * h / 2 * change
        if (step + 1) % steps == 0:
            found[:, (step + 1) // steps - 1] = np.stack([after[s] for s in SCALES], axis=1)
    return found


def test_an_ensemble_of_a_nonlinear_patch_is_that_of_small_steps():
    """Means and covariances of four signals at six instants; both are samples."""
    runs = 2000
    ours, theirs = ensemble(OSCILLATOR, runs)[:, 1:], small_steps(runs)
    ours, theirs = ours.reshape(runs, -1), theirs.reshape(runs, -1)
    spread = np.std(theirs, axis=0)
    apart = np.abs(np.mean(ours, axis=0) - np.mean(theirs, axis=0)) / spread
    # The steps' own error: second order in 1/20 of a lag and in 1e-3 rad.
    assert np.max(apart) < SIGMAS * math.sqrt(2 / runs) + 2e-3
    ratios = np.var(ours, axis=0) / np.var(theirs, axis=0)
    assert np.max(np.abs(ratios - 1)) < SIGMAS * math.sqrt(4 / runs) + 5e-3
    difference = np.corrcoef(ours.T) - np.corrcoef(theirs.T)
    assert np.max(np.abs(difference)) < 5 * math.sqrt(2 / runs)


RECTIFIED = """
title: Mean square and mean absolute value of noise
machine: {preset: ideal, tau: 1 us}
analog:
  n: {noise_source: 0.25, bandwidth: 1000 rad/s, full_scale: 2}
  square: {multiply: [n, n], full_scale: 4}
  size: {absolute: n, full_scale: 2}
  power: {integrate: {square: 16}, initial: 0, full_scale: 2}
  mean: {integrate: {size: 5}, initial: 0, full_scale: 2}
run: {until: 1 s, every: 0.5 s}
"""


def test_the_square_and_the_size_of_a_noise_source_have_their_means():
    """rms^2 and rms sqrt(2/pi); of the latter up to 1.6 % may be missing, see circuit.LOUD_LAGS.

    Over t >> 1/w the variances are, of the mean of n^2, 2 rms^4 / (w t); of |n| less in relation.
    """
    runs, w = 6, 1000.0
    machine = compile_patch(hybrid.parse_patch(RECTIFIED))
    found = records(machine, runs)[:, -1] * np.ones(5)
    names = [pen.name for pen in pens_for(machine)]
    spread = math.sqrt(2 / (w * runs))
    power = np.mean(found[:, names.index("power")]) / 16 / 0.25**2
    assert power == pytest.approx(1 - 1 / (2 * w), abs=SIGMAS * spread + 1.2e-3)
    mean = np.mean(found[:, names.index("mean")]) / 5 / (0.25 * math.sqrt(2 / math.pi))
    spread *= math.sqrt(math.pi / 2 - 1)  # more than it is: |n| forgets sooner
    assert 1 - 1.6e-2 - 2 / w - SIGMAS * spread < mean < 1 + SIGMAS * spread


# --- what else must hold ------------------------------------------------------------------------------


def test_one_seed_gives_the_same_bits_however_a_run_is_cut():
    machine = compile_patch(hybrid.parse_patch(OSCILLATOR))
    timeline, pens = build_timeline(machine), pens_for(machine)
    whole, other = records(machine, 2)
    stepped = CircuitPlayer(machine, timeline, pens, 0)
    while stepped.outcome == 1:
        stepped.play_cues(1)
    np.testing.assert_array_equal(whole, stepped.record)
    assert np.all(whole[1:] != other[1:])
    np.testing.assert_array_equal(whole[0], other[0])  # nothing at t = 0


@pytest.mark.parametrize(
    ("name", "most_pieces"), [("van_der_pol", 2.0), ("pitch_loop_analog", 2.0)]
)
def test_noise_needs_few_windows_more(name, most_pieces):
    """The smooth run has the windows of a quiet one; the true one at most a tail for each instant."""
    patch = hybrid.read_patch(hybrid.shipped_patches()[name])
    players = []
    for preset in ("lags", "nominal"):
        machine = compile_patch(patch, machine=preset, as_circuit=True)
        players.append(CircuitPlayer(machine, build_timeline(machine), pens_for(machine), 1))
        for _ in players[-1].play():
            pass
    quiet, smooth = (player.side.state.counts for player in players)
    assert smooth[WINDOWS] <= 1.05 * quiet[WINDOWS]
    assert smooth[REJECTED] <= quiet[REJECTED] + 0.01 * quiet[WINDOWS]
    assert players[1].noise.truth.counts[WINDOWS] <= most_pieces * smooth[WINDOWS]


def test_a_comparator_without_lag_sees_noise_where_it_is_looked_at():
    """Its input is 0.01 d and noise of rms 0.01: high where a normal figure is above -d."""
    patch = hybrid.parse_patch(
        """
title: A comparator in noise
machine: {preset: ideal, tau: 1 us, noise: 0.01}
parameters: {d: 0}
analog:
  level: {constant: 0.01*d, full_scale: 1}
  side: {compare: {level: 1}, high: 1, full_scale: 1, tau: 0, noise: 0}
run: {until: 200 ms, every: 0.1 ms}
"""
    )
    for d in (0.4, -1.0):
        rows = run(compile_patch(patch, {"d": d}), seed=3).rows[1:]
        np.testing.assert_array_equal(rows[:, 1] > 0.5, rows[:, 0] > 0.0)
        chance = math.erfc(-d / math.sqrt(2)) / 2
        spread = math.sqrt(chance * (1 - chance) / len(rows))
        assert np.mean(rows[:, 1]) == pytest.approx(chance, abs=SIGMAS * spread)


PRODUCT = """
title: Product of two constants
machine: {preset: ideal, tolerance: 0.02, offset: 0.01}
analog:
  a: {constant: 0.5, full_scale: 1}
  b: {constant: -0.8, full_scale: 1}
  c: {multiply: [a, b], full_scale: 1}
run: {until: 1 ms, every: 1 ms}
"""


def test_tolerance_and_offset_of_a_product_are_those_of_theory():
    """c = (1 + e) a b + o, a = 0.5 (1 + f) + o, b = -0.8 (1 + g) + o; e, f, g even within 0.02."""
    patch, serials, third = hybrid.parse_patch(PRODUCT), 1500, 0.02**2 / 3
    found = np.array([settled(compile_patch(patch, serial=k))[0][2] for k in range(serials)])
    a, b = (0.51, 0.25 * third), (-0.79, 0.64 * third)  # mean, variance
    mean = a[0] * b[0] + 0.01
    square = (a[0] ** 2 + a[1]) * (b[0] ** 2 + b[1]) * (1 + third)
    variance = square - (a[0] * b[0]) ** 2
    assert np.mean(found) == pytest.approx(mean, abs=SIGMAS * math.sqrt(variance / serials))
    # The fourth moment of a sum of even figures is below that of a normal one.
    assert np.var(found) == pytest.approx(variance, rel=SIGMAS * math.sqrt(2 / serials))


@pytest.mark.parametrize("name", sorted(hybrid.shipped_patches()))
def test_every_shipped_patch_runs_with_noise(name):
    machine = compile_patch(
        hybrid.read_patch(hybrid.shipped_patches()[name]), machine="nominal", as_circuit=True
    )
    result = run(machine, seed=5)
    assert result.status == "complete"
    assert result.status_note == "" or result.outside  # one begins above the standard atmosphere
    assert np.all(np.isfinite(result.rows))
