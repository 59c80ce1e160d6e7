"""Angle of attack and sideslip integrated on the analog machine: what passes a digital cycle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from six_dof import REFERENCE, nasa

import hybrid
from hybrid.patch import Patch, literal
from hybrid.shipped import shipped_folder

PARTS = shipped_folder() / "parts"
PART = PARTS / "incidence_rates.yaml"
NEAR = str(PARTS.parent / "incidence.yaml")  # a patch that finds the parts


def test_what_is_off_at_the_start_dies_with_the_tie() -> None:
    """A cycle of 10 ms late, a[n + 1] = a[n] - k T a[n - 1], the DAC at 0 before its first result."""
    record = hybrid.run(PART, machine="ideal").record
    expected = [0.01, 0.01]
    while len(expected) < record.sizes["time"]:
        expected.append(expected[-1] - 0.01 * expected[-2])
    alpha = np.radians(record["alpha"].values)
    np.testing.assert_allclose(alpha, expected, rtol=0, atol=1e-14)
    assert np.abs(record["beta"].values).max() == 0.0


def test_an_offset_of_the_integrator_ends_at_offset_over_tie() -> None:
    """Of 1e-4 full scales a second at tie = 2/s: 1e-5 rad; without, 1.2e-4 rad after 6 s."""
    text = PART.read_text(encoding="utf-8").replace("until: 4 s", "until: 6 s")
    text = text.replace("alpha_slow: 1}, initial", "alpha_slow: 1}, offset: 1e-4, initial")
    patch = hybrid.parse_patch(text, str(PART))
    for tie, expected in ((2.0, 1e-5), (0.0, 1.2e-4)):
        found = hybrid.run(patch, {"tie": tie, "alpha_start": 0.0}, machine="ideal").record
        assert np.radians(float(found["alpha"][-1])) == pytest.approx(expected, rel=2e-5)


PROGRAM = """\
title: The digital half
parts:
  part:
    file: parts/incidence_rates.yaml
    inputs: {p: none, q: none, r: none, p_sample: 0, q_sample: 0, r_sample: 0, p_air: 0.3 rad/s,
      q_air: -0.5 rad/s, r_air: 0.2 rad/s, u: 90 m/s, v: -30 m/s, w: 25 m/s,
      a_u: 4 m/s^2, a_v: 7 m/s^2, a_w: -9 m/s^2}
    parameters: {tie: 0, alpha_start: 0, rate: 10, most: 1}
analog:
  none: {constant: 0 rad/s, full_scale: 1 rad/s}
digital: {period: 1 ms, compute_time: 0}
run: {until: 1 ms}
record: [part.alpha_left, part.beta_left, part.alpha_rate, part.beta_rate]
"""


def test_the_rates_are_those_of_the_angles() -> None:
    """Beside (f(t + e) - f(t - e))/2e of the angles of (u, v, w)' = a - w x (u, v, w)."""
    motion, rates = np.array([90.0, -30.0, 25.0]), np.array([0.3, -0.5, 0.2])
    change = np.array([4.0, 7.0, -9.0]) - np.cross(rates, motion)
    record = hybrid.run(hybrid.parse_patch(PROGRAM, NEAR), machine="ideal").record

    def angles(t: float) -> np.ndarray:
        u, v, w = motion + t * change
        return np.array([np.arctan2(w, u), np.arctan2(v, np.hypot(u, w))])

    expected = (angles(1e-5) - angles(-1e-5)) / 2e-5  # to e^2 and 1e-16/e, some 1e-10
    for kind in ("rate", "left"):  # with p, q, r of the analog machine at 0 both are the whole
        found = [float(record[f"part.{name}_{kind}"][-1]) for name in ("alpha", "beta")]
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-9)


TURNING = """\
title: A body that turns while its path goes straight on
parameters: {{speed: 50 m/s}}
parts:
  part:
    file: parts/incidence_rates.yaml
    inputs: {{p: p, q: q, r: none, p_sample: p_now, q_sample: q_now, r_sample: 0, p_air: p_now,
      q_air: q_now, r_air: 0, u: "{u}", v: "{v}", w: "{w}", a_u: 0, a_v: 0, a_w: 0}}
    parameters: {{rate: 5, most: 0.3, alpha_start: {start}, tie: 0}}
analog:
  none: {{constant: 0 rad/s, full_scale: 1 rad/s}}
  q: {{integrate: {{theta: -100}}, initial: {q}, full_scale: 3 rad/s}}
  theta: {{integrate: {{q: 1}}, initial: 0, full_scale: 0.3}}
  p: {{constant: {p}, full_scale: 5 rad/s}}
  roll: {{integrate: {{p: 1}}, initial: 0, full_scale: 20}}
interface:
  p_now: {{adc: p}}
  q_now: {{adc: q}}
  theta_now: {{adc: theta}}
  roll_now: {{adc: roll}}
digital: {{period: 50 ms}}
run: {{until: 4 s, every: 1 ms}}
record: [part.alpha, part.beta, theta, roll]
"""


def test_pitching_passes_no_digital_cycle() -> None:
    """alpha = theta, at 10 rad/s and a cycle of 50 ms: as exact as the engine, not as the cycle."""
    text = TURNING.format(
        u="speed*cos(theta_now)", v=0, w="speed*sin(theta_now)", q=2, p=0, start=0
    )
    record = hybrid.run(hybrid.parse_patch(text, NEAR), machine="ideal").record
    theta = np.radians(record["part.alpha"].values)
    assert np.abs(theta).max() > 0.19
    np.testing.assert_allclose(theta, record["theta"], rtol=0, atol=1e-8)


def test_rolling_passes_the_cycle_in_its_third_power_only() -> None:
    """Rolling at p, alpha turns into beta: (u, v, w) = (cos a, sin a sin pt, sin a cos pt).

    What is left to the digital machine is p a^3 in size, and late by d = 75 ms: off by a^3 p d at most,
    where all of it would be off by a p d, a hundred times as much.
    """
    a, p, d = 0.1, 2.0, 0.075
    across = f"{np.sin(a)}*speed"
    u, v, w = f"{np.cos(a)}*speed", f"{across}*sin(roll_now)", f"{across}*cos(roll_now)"
    text = TURNING.format(u=u, v=v, w=w, q=0, p=p, start=a)
    record = hybrid.run(hybrid.parse_patch(text, NEAR), machine="ideal").record
    alpha, beta = (np.radians(record[f"part.{name}"].values) for name in ("alpha", "beta"))
    roll = p * record["time"].values
    v, w = np.sin(a) * np.sin(roll), np.sin(a) * np.cos(roll)
    true = np.arctan2(w, np.cos(a)), np.arctan2(v, np.hypot(w, np.cos(a)))
    off = max(np.abs(alpha - true[0]).max(), np.abs(beta - true[1]).max())
    assert 0.01 * a**3 * p * d < off < a**3 * p * d


# -- the F-16 -------------------------------------------------------------------------------------

YAWED = {"r_start": "1 deg/s", "rate": "20 deg/s", "moment": "1e5 ft*lbf", "most": "20 deg"}


def yawing(patch: Patch, cycle_s: float, compute_s: float, given: dict[str, float]) -> np.ndarray:
    """Yaw rate in deg/s, a row every 40 ms, swinging after a start with 1 deg/s on ideal parts."""
    patch = replace(patch, run=replace(patch.run, until=literal(8.0), every=literal(0.04)))
    settings = {**YAWED, "cycle": cycle_s, "compute_time": compute_s, **given}
    result = hybrid.run(patch, settings, machine="ideal")
    assert result.status == "complete" and not result.overloads
    return result.record["body.r"].values


@pytest.fixture
def f16(monkeypatch: pytest.MonkeyPatch) -> Path:
    nasa("11", "05")  # skips without the reference data
    monkeypatch.setenv("HYBRID_REFERENCE", str(REFERENCE.resolve()))
    return PARTS / "f16.yaml"


def test_the_f16_swings_in_time_where_its_moments_lead(f16: Path) -> None:
    """Moments late by d = T feed the swing by w^2 d/2 (Eq. 2.1): half the cycle, half the error.

    With lead there remain the forces, half a cycle late. Their part is Yb/(m V) to the swing's w/2, some
    0.2/s to 1.5/s, of half that delay: a fifteenth.
    """
    split, whole = hybrid.read_patch(f16), hybrid.read_patch(f16, "digital")
    true = yawing(whole, 2e-3, 0.0, {})
    late, led = (
        [np.abs(yawing(split, T, T / 2, given) - true)[1:].max() for T in (0.02, 0.01, 0.005)]
        for given in ({"lead": 0.0}, {})
    )
    # The second order, w d of the first, takes off or adds 1.5 rad/s times 20 ms and less to each.
    assert 1.9 < late[1] / late[2] < 2.2 and 1.9 < late[0] / late[1] < 2.4
    assert all(with_lead < without / 10 for with_lead, without in zip(led, late, strict=True))


def test_the_f16_swings_as_all_digital_as_its_header_says(f16: Path) -> None:
    """Of both rates, rolling being twice the yawing; all is largest in the first swing."""
    split, whole = hybrid.read_patch(f16), hybrid.read_patch(f16, "digital")

    def rates(patch: Patch, given: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
        found = hybrid.run(patch, {**YAWED, **given}, machine="ideal", until=8.0).record
        return found["body.p"].values, found["body.r"].values

    true = rates(whole, {"compute_time": 0.0})
    for given, rolling, yawing_ in (({}, 0.006, 0.003), ({"lead": 0.0}, 0.13, 0.0501)):
        p, r = (float(np.abs(a - b).max()) for a, b in zip(rates(split, given), true, strict=True))
        assert 0.9 * rolling < p < rolling
        assert 0.85 * yawing_ < r < yawing_


def test_the_f16s_angles_begin_as_its_motion_and_attitude_have_them(f16: Path) -> None:
    """Whatever the attitude and the climb at the start: as the digital machine forms them."""
    patch = hybrid.read_patch(f16, "digital")
    patch = replace(
        patch,
        record=("incidence.alpha", "incidence.beta", "axes.alpha", "axes.beta"),
        run=replace(patch.run, until=literal(0.02), every=None),
    )
    given = {"yaw": 0.6, "pitch": 0.15, "roll": -0.4, "down": -12.0, "most": 0.5, "compute_time": 0}
    record = hybrid.run(patch, given, machine="ideal").record
    assert abs(float(record["axes.beta"][0])) > 1.0
    for name in ("alpha", "beta"):
        found, formed = float(record[f"incidence.{name}"][0]), float(record[f"axes.{name}"][0])
        assert found == pytest.approx(formed, abs=1e-11)
