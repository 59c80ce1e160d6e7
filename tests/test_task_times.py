"""Times of tasks set and swept from outside, `TASK.period`: as if they had been written so."""

import json

import numpy as np
import pytest

import hybrid
from hybrid.cli import main
from hybrid.errors import PatchError

TEXT = """\
title: Two tasks with times of their own
machine: ideal
parameters: {slow_period: 20 ms, gain: 14 1/s}
analog:
  rate: {integrate: {torque: 1}, initial: 0, full_scale: 10 rad/s}
  angle: {integrate: {rate: 1}, initial: 0.1 rad, full_scale: 1 rad}
interface:
  seen: {adc: angle}
  turning: {adc: rate}
  torque: {dac: push, full_scale: 100 rad/s^2, initial: 0, lead: 1 ms}
digital:
  tasks:
    fast: {period: 2 ms, compute_time: 0.5 ms, program: {push: -gain*turning - 100*trim}}
    slow:
      period: slow_period
      phase: 1 ms
      compute_time: 3 ms
      states: {trim: {integrate: 5*(seen - trim), initial: 0.1, formula: ab2}}
run: {until: 1 s, every: 20 ms}
readouts: {mode: {transient: angle}}
"""
# What is set, and how the same is written.
TIMES = {
    "fast.period": ("4 ms", "period: 2 ms", "period: 4 ms"),
    "fast.compute_time": ("0.25 ms", "compute_time: 0.5 ms", "compute_time: 0.25 ms"),
    "slow.period": ("10 ms", "period: slow_period", "period: 10 ms"),
    "slow.phase": ("3 ms", "phase: 1 ms", "phase: 3 ms"),
    "slow.compute_time": ("5 ms", "compute_time: 3 ms", "compute_time: 5 ms"),
}


@pytest.fixture
def patch():
    return hybrid.parse_patch(TEXT)


@pytest.mark.parametrize("name", TIMES)
def test_a_time_that_is_set_is_as_if_written(patch, name):
    """To the last bit: in the clocks, in the step of the states and in the lead of the DAC."""
    value, old, new = TIMES[name]
    written = hybrid.run(hybrid.parse_patch(TEXT.replace(old, new)))
    found = hybrid.run(patch, {name: value})
    assert np.array_equal(found.rows, written.rows)
    assert found.tasks == written.tasks
    assert not np.array_equal(found.rows, hybrid.run(patch).rows)


@pytest.mark.parametrize("name", ["fast.period", "slow.period"])
def test_the_prediction_sees_it(patch, name):
    value, old, new = TIMES[name]
    written = hybrid.predict(hybrid.parse_patch(TEXT.replace(old, new))).modes
    found = hybrid.predict(patch, {name: value}).modes
    assert [(m.omega, m.zeta) for m in found] == [(m.omega, m.zeta) for m in written]
    plain = hybrid.predict(patch).modes
    assert [m.zeta for m in found] != [m.zeta for m in plain]


def test_jitter_is_a_time_of_a_task_too():
    text = TEXT.replace("period: 2 ms,", "period: 2 ms, jitter: 0 s,").replace(", lead: 1 ms", "")
    early = hybrid.run(hybrid.parse_patch(text), {"fast.jitter": "0.3 ms"}, seed=4)
    written = hybrid.run(hybrid.parse_patch(text.replace("0 s,", "0.3 ms,")), seed=4)
    assert np.array_equal(early.rows, written.rows)


def test_a_parameter_still_sets_the_times_that_are_written_with_it(patch):
    by_parameter = hybrid.run(patch, {"slow_period": "10 ms"})
    by_task = hybrid.run(patch, {"slow.period": "10 ms"})
    assert np.array_equal(by_parameter.rows, by_task.rows)
    both = hybrid.run(patch, {"slow_period": "40 ms", "slow.period": "10 ms"})
    assert np.array_equal(both.rows, by_task.rows)  # the nearer one holds


def test_what_is_set_is_told_and_plays_again(patch):
    """Times that nobody set are no parameters of the patch, so that those follow their own ones."""
    plain = hybrid.run(patch).record.attrs
    assert json.loads(plain["parameters"]).keys() == {"slow_period", "gain"}
    assert "fast.period" not in repr(patch)
    run = hybrid.run(patch, {"slow.period": "10 ms", "fast.period": 4e-3})
    told = json.loads(run.record.attrs["parameters"])
    assert (told["slow.period"], told["fast.period"]) == ("10 ms", "4 ms")
    again = hybrid.run(patch, json.loads(run.record.attrs["parameters_si"]))
    assert np.array_equal(run.rows, again.rows)


def test_a_sweep_and_a_batch_over_a_time(patch):
    swept = hybrid.sweep(patch, "slow.period", ["10 ms", "20 ms"], jobs=1)
    for point, value in zip(swept.points, ("10 ms", "20 ms"), strict=True):
        alone = hybrid.predict(patch, {"slow.period": value}).modes[0]
        assert point.modes[0]["zeta"] == alone.zeta
    assert swept.dataset["slow.period"].attrs["units"] == "ms"
    assert "slow.period" not in swept.parameters
    crowd = hybrid.batch(patch, {"slow.compute_time": [1e-3, 5e-3]}, jobs=1)
    zeta = [point.measured["mode"]["zeta"] for point in crowd.points]
    assert zeta[0] > zeta[1]  # the later the trim, the less damping


def test_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "two.yaml").write_text(TEXT)
    assert main(["predict", "two.yaml", "--set", "fast.period=4 ms", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["parameters"]["fast.period"] == "4 ms" and told["cycle_s"] == 4e-3
    over = ["--over", "slow.period=10 ms:20 ms:2", "--no-chart", "--jobs", "1"]
    assert main(["sweep", "two.yaml", *over]) == 0
    assert (tmp_path / "out" / "two_over_slow.period.nc").exists()
    capsys.readouterr()
    assert main(["sweep", "two.yaml", *over, "--set", "slow.period=1 ms"]) == 2
    assert "slow.period is both set and swept" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("fast.perod", "1 ms", "two.yaml: no parameter 'fast.perod'; did you mean 'fast.period'"),
        ("fast.phase", "1 ms", "two.yaml: no parameter 'fast.phase'; did you mean 'slow.phase'"),
        ("fast.program", "1 ms", "no parameter 'fast.program'"),
        ("x", "1", "valid: fast.compute_time, fast.period, gain, slow.compute_time, slow.per"),
        ("fast.period", "1 V", "two.yaml:13: fast.period cannot be '1 V': its unit does not fit"),
        ("fast.period", "nan", "two.yaml:13: fast.period cannot be 'nan'"),
        (
            "fast.period",
            "0",
            "two.yaml:13: period of task 'fast' is 0 s; it must be greater than 0",
        ),
        ("slow.phase", "-1 ms", "two.yaml:16: phase of task 'slow' is -0.001 s; it must be 0 or"),
    ],
)
def test_mistakes(name, value, said):
    with pytest.raises(PatchError) as caught:
        hybrid.run(hybrid.parse_patch(TEXT, "two.yaml"), {name: value})
    assert said in str(caught.value)


def test_a_time_of_a_task_that_is_no_more():
    full = TEXT.replace("run:", "  full_scales: {trim: 1 rad}\nrun:").replace(", lead: 1 ms", "")
    patch = hybrid.parse_patch(full, "two.yaml", on={"trim": "analog"})
    with pytest.raises(
        PatchError, match=r"two.yaml:15: slow.period cannot be set: nothing is left"
    ):
        hybrid.run(patch, {"slow.period": "1 ms"})
    assert hybrid.run(patch, {"fast.period": "4 ms"}).cycles == 250


def test_a_counted_compute_time_is_counted():
    text = TEXT.replace("compute_time: 0.5 ms", "compute_time: counted")
    text = text.replace("digital:\n", "digital:\n  processor: ibm_7090\n")
    with pytest.raises(PatchError, match=r"no parameter 'fast\.compute_time'"):
        hybrid.run(hybrid.parse_patch(text), {"fast.compute_time": "1 ms"})


def test_a_part_with_the_name_of_a_task_and_a_parameter_with_that_of_a_time():
    text = (
        TEXT
        + """\
definitions:
  wheel:
    parameters: {period: 1 s}
    analog: {turn: {constant: 1/period, full_scale: 2 1/s}}
parts: {fast: {use: wheel}}
"""
    )
    with pytest.raises(PatchError, match=r"two.yaml:13: task 'fast' has the name of a part with a"):
        hybrid.parse_patch(text, "two.yaml")


def test_tasks_have_no_one_largest_cycle_time(patch):
    with pytest.raises(hybrid.HybridError, match=r"--over .* with fast\.period or slow\.period"):
        hybrid.predict(patch, max_damping_error=0.01)
