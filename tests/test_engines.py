"""Three engines, one answer; and what each of them refuses."""

import json
from dataclasses import replace

import numpy as np
import pytest
from test_windows import EVERYTHING

import hybrid
from hybrid.cli import main
from hybrid.compiler import compile_patch
from hybrid.engine import reference_player
from hybrid.errors import PatchError, RunError
from hybrid.patchfile import parse_duration
from hybrid.runs import run
from hybrid.shipped import shipped_patches

RESOLUTION = 1e-9  # of the nonlinear engine, in full scales


def short(name, until, **settings):
    """A shipped patch that ends early."""
    patch = hybrid.read_patch(name)
    ended = replace(patch.run, until=parse_duration(until, "until"), **settings)
    return replace(patch, run=ended, readouts=())


def apart(one, other, machine):
    """Largest difference of two records, of full scale."""
    assert [p.name for p in one.pens] == [p.name for p in other.pens]
    scale = [p.factor for p in one.pens]
    return np.max(np.abs(one.rows - other.rows) / np.abs(scale))


def test_the_three_engines_agree_on_the_pitch_loop():
    """Converters, program and all. The reference's tolerance of 1e-10 adds up over 20 intervals."""
    patch = short("pitch_loop", "20 ms")
    found = {e: run(patch, machine="lags", engine=e) for e in ("exact", "nonlinear", "reference")}
    assert {e: r.engine for e, r in found.items()} == {e: e for e in found}
    assert all(r.status == "complete" and r.cycles == 20 for r in found.values())
    for engine in ("nonlinear", "reference"):
        assert apart(found["exact"], found[engine], "lags") < 2e-9, engine
    assert np.ptp(found["exact"].record["theta"].values) > 1e-3


@pytest.mark.parametrize("name", ["harmonic_oscillator", "damped_oscillator"])
def test_the_engine_tells_what_it_may_err_by(name):
    """Neither patch magnifies an error by more than the tenth by which the circle grows."""
    exact, played = hybrid.run(name), hybrid.run(name, engine="nonlinear")
    assert exact.engine_error is None
    assert apart(exact, played, "lags") < 1.2 * played.engine_error < RESOLUTION
    half = hybrid.run(short(name, "5 ms"), engine="nonlinear")
    assert half.engine_error < played.engine_error


@pytest.mark.parametrize("tau", [0.0, 1e-4])
def test_the_reference_agrees_on_every_linear_kind(tau):
    """Skew, conversion time, memory, a late step, lags that the problem wants; 100 intervals."""
    patch = hybrid.parse_patch(EVERYTHING)
    exact = run(patch, {"tau": tau})
    reference = run(patch, {"tau": tau}, engine="reference")
    scale = [p.factor if p.kind != "word" else 1.0 for p in exact.pens]
    assert np.max(np.abs(exact.rows - reference.rows) / scale) < 1e-8


# What the README promises of shipped nonlinear patches is 1e-7. A relay changes a signal at a full scale
# in a lag of 1 us, so that a crossing that is off by the resolution over the slope shows there.
@pytest.mark.parametrize(
    ("name", "until", "bound"),
    [
        ("van_der_pol", "5 ms", 10 * RESOLUTION),
        ("relay_servo", "3 ms", 1e-7),
        ("bouncing_ball", "50 ms", 1e-7),
    ],
)
def test_the_reference_agrees_on_nonlinear_patches(name, until, bound):
    patch = short(name, until)
    played, reference = run(patch), run(patch, engine="reference")
    assert (played.engine, reference.engine) == ("nonlinear", "reference")
    assert apart(played, reference, "lags") < bound
    assert reference.overloads == played.overloads == ()


# Every shipped patch whose analog side is played by elements, and how long it is played:
# the reference takes a second or ten for each. Chaotic ones end long before neighbours have parted.
PLAYED = {
    "bouncing_ball": "20 ms",
    "cannonball": "60 ms",
    "entry_probe": "50 ms",
    "jerk": "2 ms",
    "jet_control": "2 ms",
    "jet_control_sampled": "50 ms",
    "lorenz": "1 ms",
    "mathieu": "1 ms",
    "orbiting_cylinder": "0.2 s",
    "predator_prey": "1 ms",
    "reentry": "50 ms",
    "relay_servo": "0.5 ms",
    "roessler": "2 ms",
    "shooting": "1.4 ms",
    "tumbling_brick": "2 ms",
    "van_der_pol": "2 ms",
}


def test_every_nonlinear_patch_is_compared_with_the_reference():
    nonlinear = set()
    for name in shipped_patches():
        machine = compile_patch(hybrid.read_patch(name), machine="lags")
        if machine.elements:
            nonlinear.add(name)
    assert nonlinear == PLAYED.keys()


@pytest.mark.parametrize("name", PLAYED)
def test_nonlinear_patches_agree_with_a_tight_reference(name, monkeypatch):
    """To a thousandth of what a component of 0.01 % errs by, every lag on; the reference at 1e-11."""
    monkeypatch.setattr(reference_player, "TOLERANCE", 1e-11)
    every_s = parse_duration(PLAYED[name], "until").number({}) / 5
    patch = replace(
        short(name, PLAYED[name], every=parse_duration(f"{every_s!r} s", "every")), record=()
    )
    played, reference = (run(patch, machine="lags", engine=e) for e in ("auto", "reference"))
    assert (played.engine, reference.engine) == ("nonlinear", "reference")
    assert len(played.rows) == len(reference.rows) == 6
    words = [pen.kind == "word" for pen in played.pens]
    scale = np.where(words, np.inf, np.abs([pen.factor for pen in played.pens]))
    assert np.max(np.abs(played.rows - reference.rows) / scale) < 1e-7
    assert np.max(np.ptp(played.rows, axis=0) / scale) > 1e-4  # something happens


LEAVING = """
title: A limited integrator leaves its stop
machine: lags
analog:
  sq: {SOURCE, full_scale: 1}
  fl: {integrate: {sq: 50 1/s}, initial: 0, LIMITS, full_scale: 1}
run: {until: 38 ms, every: 0.5 ms}
"""


@pytest.mark.parametrize("engine", ["nonlinear", "reference"])
@pytest.mark.parametrize(
    ("source", "limits"),
    [
        ("step: -0.4, at: 20 ms, before: 0.4", "low: -0.3, high: 0.3"),
        ("step: -0.4, at: 20 ms, before: 0.4", "saturation: 0.3"),
        ("square: 0.4, period: 40 ms", "low: -0.3, high: 0.3"),
    ],
)
def test_a_limited_integrator_leaves_its_stop(source, limits, engine):
    """It rises by 20 a second to 0.3. From 20 ms on its input is 0.8 exp(-s / tau) - 0.4, which is 0
    after tau ln 2: then it falls by 20 a second, less what the rest of the layer, 0.4 tau 50, holds up.
    Its own lag shows a ramp tau late."""
    text = LEAVING.replace("SOURCE", source).replace("LIMITS", limits)
    found = run(hybrid.parse_patch(text), engine=engine)
    assert found.status == "complete"
    t, tau = found.time_s, 1e-6
    falls = 0.3 - 20 * (t - 0.02 - tau * np.log(2)) + 50 * 0.4 * tau + 20 * tau
    expected = np.where(t <= 0.02, np.minimum(20 * (t - tau), 0.3), falls)
    expected[0] = 0.0
    # At 15 ms the ramp has come to its stop, and what its lag shows not yet, by 20 tau.
    assert np.max(np.abs(found.record["fl"].values - expected)) < 1e-8


OVERLOAD = """
title: An oscillator that is scaled too small
machine: lags
analog:
  x: {integrate: {v: 200}, initial: 0, full_scale: 1}
  v: {integrate: {x: -200}, initial: 1.5, full_scale: 2}
run: {until: 20 ms, every: 1 ms}
"""


def test_the_reference_tells_overloads_as_the_nonlinear_engine_does():
    patch = hybrid.parse_patch(OVERLOAD)
    (one,) = run(patch, engine="nonlinear").overloads
    (other,) = run(patch, engine="reference").overloads
    # The reference goes straight between steps of some 10 us: a crossing is off by 1e-8 s at most.
    for key, bound in (("time_s", 1e-6), ("duration_s", 2e-6)):
        assert other[key] == pytest.approx(one[key], abs=bound), key
    # Eq. 2.3: two lags of 1 us make it grow by exp(omega^2 tau t), up to its top at pi / (2 omega).
    top = 1.5 * np.exp(200**2 * 1e-6 * np.pi / 400)
    assert other["worst_value"] == pytest.approx(top, abs=1e-6)
    assert one["worst_value"] == pytest.approx(top, abs=1e-6)  # of which the next order is 1e-8


@pytest.mark.parametrize("engine", ["nonlinear", "reference"])
def test_a_patch_that_runs_away_is_stopped(engine):
    """exp(1000 t) passes 1e12 at 27.63 ms."""
    text = "title: Away\nmachine: ideal\nanalog:\n  x: {integrate: {x: 1000}, initial: 1, "
    text += "full_scale: 1}\nrun: {until: 1 s, every: 1 ms}\n"
    found = run(hybrid.parse_patch(text), engine=engine)
    assert found.status == "stopped"
    assert "the patch is unstable" in found.status_note
    assert 27 <= len(found.time_s) <= 29
    assert found.rows[-1, 0] == pytest.approx(np.exp(1000 * found.time_s[-1]), rel=1e-6)


def test_an_interrupted_reference_keeps_what_was_done():
    def interrupt(done):
        if done > 0.3:
            raise KeyboardInterrupt

    found = run(
        short("pitch_loop", "200 ms"), machine="lags", engine="reference", progress=interrupt
    )
    assert found.status == "interrupted"
    assert 60 < len(found.time_s) < 120


def test_the_exact_engine_names_what_is_not_linear():
    with pytest.raises(
        PatchError,
        match=r"van_der_pol.yaml:24: the exact engine plays linear patches"
        r" only: component 'square' \(multiply\) is not linear$",
    ):
        run("van_der_pol", engine="exact")
    with pytest.raises(PatchError, match="its outputs saturate"):
        run("pitch_loop", machine="howe_1964", engine="exact")


def test_engines_that_do_not_fit():
    with pytest.raises(RunError, match="unknown engine 'refrence'; did you mean 'reference'"):
        run("pitch_loop", engine="refrence")
    with pytest.raises(
        RunError, match="unknown engine 3; valid: auto, exact, nonlinear, reference"
    ):
        run("pitch_loop", engine=3)
    patch = hybrid.read_patch("pitch_loop")
    with pytest.raises(RunError, match="compiled for the exact engine; give the patch"):
        run(compile_patch(patch), engine="reference")
    with pytest.raises(RunError, match="compiled for other engines"):
        run(compile_patch(patch, as_circuit=True), engine="exact")


OWN_MODE = """
title: An integrator that resets itself
analog:
  x: {integrate: {one: 1}, initial: 0, reset_when: done, full_scale: 1}
  one: {constant: 1, full_scale: 1}
  done: {compare: {x: 1}, threshold: 0.5, high: 1, full_scale: 1}
run: {until: 1 s, every: 0.1 s}
"""


def test_which_part_leaves_op():
    told = r"the exact engine plays no modes \(IC, HOLD\), and"
    with pytest.raises(
        PatchError, match=rf"shooting.yaml:\d+: {told} the machine leaves OP; take non"
    ):
        run("shooting", engine="exact")
    with pytest.raises(PatchError, match=rf":4: {told} x has its own; take nonlinear"):
        run(hybrid.parse_patch(OWN_MODE), engine="exact")


def test_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    order = ["run", "pitch_loop", "--until", "5 ms", "--no-chart", "--engine"]
    assert main([*order, "reference", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["engine"] == "reference"
    assert found["prediction"][0]["closed_form"]["equation"] == "2.1"
    assert main([*order, "nonlinear"]) == 0
    assert "of full scale); 5 cycles" in capsys.readouterr().out
    assert main([*order, "fast"]) == 2
    assert "unknown engine 'fast'" in capsys.readouterr().err
