"""Noise that reaches over corners of parts: in the mean, at instants, and where it does not.

Expected figures are closed forms of a normal distribution, or small steps (tau/20) of the stated model.
Bounds are 4.5 standard deviations of what is estimated, and what the method leaves out.
"""

import math

import numpy as np
import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.elements import abs_pieces, limit_pieces, table_pieces
from hybrid.engine import windows
from hybrid.engine.blur import LONGEST, SHARES, SHORTEST, mean_in_noise, unresolved
from hybrid.record import pens_for
from hybrid.timeline import build_timeline

SIGMAS = 4.5
RMS = 1e-3
TAU_S = 1e-6


def player_of(text, parameters=None, seed=0):
    """A player that has played the patch."""
    machine = compile_patch(hybrid.parse_patch(text), parameters, as_circuit=True)
    player = windows.CircuitPlayer(machine, build_timeline(machine), pens_for(machine), seed)
    for _ in player.play():
        pass
    return player


@pytest.mark.parametrize(
    ("pieces", "f"),
    [
        (abs_pieces(), np.abs),
        (limit_pieces(-1.0, 0.5), lambda x: np.clip(x, -1.0, 0.5)),
        (
            table_pieces((-1.0, 0.0, 2.0), (2.0, 0.0, 1.0), 0.5),
            # The rounded corner: a parabola of slope -2 at -0.25 and 0.5 at 0.25.
            lambda x: np.where(
                np.abs(x) < 0.25,
                0.5 - 2.0 * (x + 0.25) + 2.5 * (x + 0.25) ** 2,
                np.where(x < 0.0, -2.0 * x, 0.5 * x),
            ),
        ),
    ],
)
def test_the_mean_of_a_part_in_noise_is_its_integral(pieces, f):
    rows = np.array(pieces)
    n = np.linspace(-9.0, 9.0, 180_001)
    density = np.exp(-0.5 * n * n) / math.sqrt(2 * math.pi) * (n[1] - n[0])
    for m in (-3.0, -0.2, 0.0, 0.4, 5.0):
        for s in (0.05, 1.0):
            expected = float(density @ f(m + s * n))
            assert mean_in_noise(rows, 0, len(rows), m, s) == pytest.approx(expected, abs=1e-8)
        assert mean_in_noise(rows, 0, len(rows), m, 0.0) == pytest.approx(float(f(m)), abs=1e-15)


def test_windows_leave_open_what_theory_says():
    """2 z sum(1 / (2 (2 m - 1) (2 m + 3)), m > 6) of short windows, 1 - 7 * 2 / z of long ones."""
    lengths, shares = np.geomspace(SHORTEST, LONGEST, SHARES), unresolved(8)
    m = np.arange(7, 100_000)
    short = 2 * np.sum(1 / (2 * (2.0 * m - 1) * (2 * m + 3)))
    assert shares[0] / lengths[0] == pytest.approx(short, rel=5e-3)
    assert 1 - shares[-1] == pytest.approx(14 / lengths[-1], rel=1e-3)
    assert np.all(np.diff(shares) > 0)


CHAIN = """
title: Corners behind no, one and two lags
machine: {preset: nominal, noise: 0}
analog:
  n: {constant: 0.5, full_scale: 1, noise: 1e-3}
  w: {sum: {n: 1}, full_scale: 1}
  y: {coefficient: {w: 0.5}, full_scale: 1}
  half: {constant: 0.5, full_scale: 1}
  p: {multiply: [n, half], full_scale: 1}
  a: {absolute: n, full_scale: 1}
  b: {absolute: w, full_scale: 1}
  c: {absolute: y, full_scale: 1}
  d: {absolute: p, full_scale: 1}
run: {until: 10 us, every: 10 us}
"""


def test_deviations_and_memories_are_those_of_lags_in_a_row():
    """Through lags as long as its own noise has 1, 1/2, 3/8 of its variance.

    It remembers for tau, 2 tau, 8/3 tau: the spectrum at 0 is that of the source.
    """
    player = player_of(CHAIN)
    side, blur, tolerance = player.side, player.noise.blur, 3e-4  # gain errors of 1e-4 each
    corner = {player.names[owner]: k for k, owner in enumerate(side.circuit.corners[:, 0].tolist())}
    for name, size, lags in (
        ("a", 1.0, 1.0),
        ("b", math.sqrt(1 / 2), 2.0),
        ("c", 0.5 * math.sqrt(3 / 8), 8 / 3),
        ("d", 0.5 * math.sqrt(1 / 2), 2.0),
    ):
        k = corner[name]
        assert blur.deviation[k] == pytest.approx(size * RMS, rel=tolerance)
        assert 1.0 / blur.rate[k] == pytest.approx(lags * TAU_S, rel=tolerance)


# --- what is shown at instants ------------------------------------------------------------------------

SHOWN = """
title: What parts with corners show of noise
machine: {preset: lags}
parameters: {low: -0.001, high: 0.001}
analog:
  n: {constant: 0, full_scale: 1, noise: 1e-3}
  size: {absolute: n, full_scale: 1}
  limited: {limit: n, low: low, high: high, full_scale: 1e-2}
  steep: {function: n, points: {-1: -1, -0.0001: -1, 0.0001: 1, 1: 1}, full_scale: 1}
  slow: {lag: {steep: 1}, time_constant: 10 us, full_scale: 1}
  held: {sum: {n: 1}, full_scale: 1, saturation: 1e-3}
run: {until: 20 ms, every: 10 us}
"""


def small_steps(runs=300, per_lag=20, lags=120):
    """Samples of SHOWN by the trapezoidal rule, once it has forgotten its start: by name."""
    random, fade = np.random.default_rng(5), math.exp(-1 / per_lag)
    slower, kick = fade**0.1, RMS * math.sqrt(1 - fade**2)
    n = RMS * random.standard_normal(runs)
    y = {name: np.zeros(runs) for name in ("size", "limited", "steep", "core", "slow")}
    found, before = {name: [] for name in y}, None
    for step in range(lags * per_lag):
        n = fade * n + kick * random.standard_normal(runs)
        now = {
            "size": np.abs(n),
            "limited": np.clip(n, -1e-3, 1e-3),
            "steep": np.clip(n / 1e-4, -1.0, 1.0),
        }
        for name, u in now.items():
            was = y[name]
            y[name] = fade * was + (1 - fade) * (u + (before or now)[name]) / 2
            if name == "steep":
                core = slower * y["core"] + (1 - slower) * (was + y[name]) / 2
                y["slow"] = fade * y["slow"] + (1 - fade) * (core + y["core"]) / 2
                y["core"] = core
        before = now
        if step > 60 * per_lag and step % (10 * per_lag) == 0:
            for name, values in y.items():
                found[name].append(values)
    return {name: np.concatenate(values) for name, values in found.items()}


def test_shown_values_are_those_of_small_steps():
    """2000 instants 10 lags apart; of the slow lag 1000 at most are independent of each other."""
    result, expected = hybrid.run(hybrid.parse_patch(SHOWN), seed=2), small_steps()
    names = ("size", "limited", "steep", "held", "slow")
    shown = {name: result.record[name].values[20:] for name in names}
    expected["held"] = expected["limited"]
    for name in names:
        ours, theirs, independent = shown[name], expected[name], 500 if name == "slow" else 1800
        spread = np.std(theirs)
        assert np.mean(ours) == pytest.approx(
            np.mean(theirs), abs=SIGMAS * spread * math.sqrt(2 / independent)
        ), name
        assert np.std(ours) == pytest.approx(
            spread, rel=SIGMAS * math.sqrt(1 / independent) + 1e-2
        ), name
    assert np.min(shown["size"]) > 0.0
    assert np.max(np.abs(shown["limited"])) <= 1e-3 * (1 + 1e-9)
    assert np.max(np.abs(shown["held"])) <= 1e-3 * (1 + 1e-9)
    assert np.max(np.abs(shown["steep"])) <= 1.0
    assert np.max(np.abs(shown["slow"])) <= 1.0
    assert result.overloads == ()
    assert result.status_note == ""  # all of it was resolved


# --- averages -----------------------------------------------------------------------------------------

AVERAGES = """
title: Averages of noise over corners
machine: {preset: nominal, noise: 0, tolerance: 0}
parameters: {d: 0, low: -0.001, high: 0.001}
analog:
  n: {constant: d, full_scale: 1, noise: 1e-3}
  w: {sum: {n: 1}, full_scale: 1}
  size: {absolute: n, full_scale: 1}
  later: {absolute: w, full_scale: 1}
  limited: {limit: n, low: low, high: high, full_scale: 1}
  of_n: {integrate: {n: 10000}, initial: 0, full_scale: 20}
  of_size: {integrate: {size: 10000}, initial: 0, full_scale: 20}
  of_later: {integrate: {later: 10000}, initial: 0, full_scale: 20}
  of_limited: {integrate: {limited: 10000}, initial: 0, full_scale: 20}
run: {until: 1 s, every: 1 ms}
"""


@pytest.mark.parametrize("d", [0.0, 7e-4])
def test_averages_have_the_mean_and_the_gain_of_the_part_in_noise(d):
    """E|n| and E[limited] of a normal n; an average over t of what passes with gain 1 has the variance
    2 rms^2 tau / t, and each part's is that by its gain, P(n > 0) - P(n < 0) or P(|n| < 1e-3)."""
    result = hybrid.run(hybrid.parse_patch(AVERAGES), {"d": d}, seed=1)
    over_s, rate = 1e-3, 1e4
    means = {
        name: np.diff(result.record[f"of_{name}"].values[1:]) / (over_s * rate)
        for name in ("n", "size", "later", "limited")
    }
    per_row = RMS * math.sqrt(2 * TAU_S / over_s)

    def mean_size(s):
        return d * math.erf(d / s / math.sqrt(2)) + s * math.sqrt(2 / math.pi) * math.exp(
            -d * d / (2 * s * s)
        )

    n = np.linspace(-9.0, 9.0, 20_001)
    density = np.exp(-0.5 * n * n) / math.sqrt(2 * math.pi) * (n[1] - n[0])
    v, later = d + RMS * n, RMS * math.sqrt(0.5)
    expected = {
        "n": (d, 1.0),
        "size": (mean_size(RMS), math.erf(d / RMS / math.sqrt(2))),
        "later": (mean_size(later), math.erf(d / later / math.sqrt(2))),
        "limited": (float(density @ np.clip(v, -RMS, RMS)), float(density @ (np.abs(v) < RMS))),
    }
    for name, (mean, gain) in expected.items():
        count = len(means[name])
        # The variance of what is resolved of the input moves a mean with no gain by its square.
        bound = SIGMAS * (gain + 0.1) * per_row / math.sqrt(count)
        assert np.mean(means[name]) == pytest.approx(mean, abs=bound + 2e-4 * RMS), name
        if gain > 0.1:
            assert np.std(means[name]) == pytest.approx(
                gain * per_row, rel=SIGMAS * math.sqrt(1 / (2 * count)) + 2e-2
            ), name
    told = result.status_note
    assert "noise of rms 0.001 reached over the corners of size for" in told
    # |n| at 0: E n^2 - (E |n|)^2 is 1 - 2 / pi, of which the rms is 0.603.
    assert "without the rest, of rms 0.0006 of full scale" in told


MODULATED = """
title: Average size of noise behind a product with a sine
machine: {preset: nominal, noise: 0, tolerance: 0}
analog:
  n: {constant: 0, full_scale: 1, noise: 1e-3}
  g: {sine: 1, frequency: 10 Hz, full_scale: 1}
  p: {multiply: [n, g], full_scale: 1}
  size: {absolute: p, full_scale: 1}
  sum_of_sizes: {integrate: {size: 10000}, initial: 0, full_scale: 20}
run: {until: 200 ms, every: 1 ms}
"""


def test_noise_that_passes_a_product_is_taken_as_its_factor_goes():
    """p has the deviation rms |g| / sqrt(2), and |sin| the mean 2 / pi; windows are 0.06 rad long, whose
    factor is that of their middle: right to 0.06^2 / 24 beside the two where g passes 0."""
    found = hybrid.run(hybrid.parse_patch(MODULATED)).record["sum_of_sizes"].values[-1] / 0.2 / 1e4
    expected = RMS * math.sqrt(0.5) * math.sqrt(2 / math.pi) * 2 / math.pi
    assert found == pytest.approx(expected, rel=5e-3)


RUBBING = """
title: Mass, spring, dashpot and Coulomb friction
machine: nominal
parameters: {m: 2 kg, k: 800 N/m, c: 2 N*s/m}
analog:
  v: {integrate: {spring: 1/m, damper: 1/m, rub: 1/m}, initial: 0 m/s, full_scale: 2.5 m/s}
  x: {integrate: {v: 1}, initial: 0.1 meter, full_scale: 0.12 meter}
  spring: {coefficient: {x: -k}, full_scale: 100 N}
  damper: {coefficient: {v: -c}, full_scale: 5 N}
  rub:
    function: v
    points: {-2.5 m/s: 4 N, -1e-3 m/s: 4 N, 1e-3 m/s: -4 N, 2.5 m/s: -4 N}
    full_scale: 4.1 N
run: {until: 1.2 s, every: 10 ms, on_overload: stop}
"""


def test_friction_gives_no_more_than_it_has_and_stops_no_run():
    """4 N, its gain error of 1e-4 at most, and noise of its own of 1e-4 of full scale."""
    result = hybrid.run(hybrid.parse_patch(RUBBING))
    assert result.status == "complete"
    assert result.overloads == ()
    assert float(np.max(np.abs(result.record["rub"]))) < 4.0 * (1 + 1e-4) + 5 * 4.1e-4
    assert "reached over the corners of rub" in result.status_note


FAR = """
title: Corners that noise does not reach
machine: nominal
analog:
  speed: {integrate: {place: -1000}, initial: 0, full_scale: 1}
  place: {integrate: {speed: 1000}, initial: 0.4, full_scale: 1}
  limited: {limit: place, low: -0.5, high: 0.5, full_scale: 1}
  away: {sum: {place: 1, two: 0.5}, full_scale: 1}
  two: {constant: 0.9, full_scale: 1}
  size: {absolute: away, full_scale: 1}
run: {until: 10 ms, every: 0.1 ms}
"""


def test_nothing_changes_where_noise_reaches_no_corner(monkeypatch):
    with_it = player_of(FAR)
    monkeypatch.setattr(windows, "measure", lambda *given: None)
    without = player_of(FAR)
    np.testing.assert_array_equal(with_it.record, without.record)
    assert with_it.engine_error == without.engine_error
