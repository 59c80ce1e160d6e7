"""`units:` of the digital machine: what words and states are shown in, and nothing else."""

import math

import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.errors import PatchError
from hybrid.record import signal_units

PATCH = """\
title: Units
digital:
  period: 10 ms
  compute_time: 0
  units: {pitch: deg, height: ft, fall: ft/s}
  states: {height: {integrate: -fall, initial: 1000 ft}}
  program:
    pitch: atan2(1, 1)
    fall: 10 ft/s
    plain: pitch + 0
run: {until: 1 s}
readouts: {pitch: {final: pitch}, height: {final: height}}
"""


def test_words_are_shown_in_their_units_and_computed_in_si():
    made = hybrid.run(hybrid.parse_patch(PATCH), machine="ideal")
    record = made.record
    units = {name: variable.attrs["units"] for name, variable in record.data_vars.items()}
    assert units == {"pitch": "deg", "height": "ft", "fall": "ft/s", "plain": ""}
    assert made.readouts["pitch"] | {"note": ""} == {
        "value": pytest.approx(45.0, rel=1e-15), "time_s": 1.0, "units": "deg", "note": "",
        "kind": "final", "signal": "pitch",
    }  # fmt: skip
    assert made.readouts["height"]["value"] == pytest.approx(990.0, rel=1e-14)
    assert record["plain"].values[-1] == math.pi / 4
    without = hybrid.run(hybrid.parse_patch(PATCH.replace("  units", "  # units")), machine="ideal")
    assert without.record["height"].values[-1] == pytest.approx(990.0 * 0.3048, rel=1e-14)


def test_parts_bring_their_units():
    text = """\
title: Parts
parts: {top: {use: wheel, inputs: {rate: 30/60 1/s}}}
definitions:
  wheel:
    inputs: {rate: 1 1/s}
    digital:
      units: {angle: deg}
      states: {angle: {integrate: rate, initial: 0}}
digital: {period: 10 ms, compute_time: 0, units: {top.rate: rpm}}
run: {until: 1 s}
"""
    record = hybrid.run(
        hybrid.parse_patch(text.replace("30/60 1/s", "0.5 1/s")), machine="ideal"
    ).record
    assert record["top.angle"].attrs["units"] == "deg"
    assert record["top.angle"].values[-1] == pytest.approx(math.degrees(0.5), rel=1e-13)
    assert record["top.rate"].values[-1] == pytest.approx(0.5 * 60 / math.tau, rel=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("pitch: deg", "pich: deg", "units: no word or state 'pich'; did you mean 'pitch'"),
        (
            "pitch: deg",
            "pitch: ft",
            "unit of 'pitch' is 'ft' [m]; it must be that of what is a pure number",
        ),
        ("height: ft", "height: deg", "unit of 'height' is 'deg' [1]; it must be"),
        ("height: ft", "height: furlongs_", "unit of 'height'"),
        ("height: ft", "height: [ft]", "units: 'height' needs a unit, not a list"),
    ],
)
def test_units_that_do_not_fit(old, new, said):
    with pytest.raises(PatchError) as caught:
        hybrid.parse_patch(PATCH.replace(old, new, 1), "units.yaml")
    assert str(caught.value).startswith("units.yaml:5: ") and said in str(caught.value)


CROSSED = """\
title: A word, its DAC and what becomes of them
machine: ideal
analog:
  theta_dot: {integrate: {moment: 1}, initial: 0 rad/s, full_scale: 90 deg/s}
  theta: {integrate: {theta_dot: 1}, initial: 0.1 rad, full_scale: 60 deg}
interface:
  angle: {adc: theta, bits: 14}
  moment: {dac: asked, bits: 14, full_scale: 720 deg/s^2, initial: 0, LEAD}
digital:
  period: 10 ms
  compute_time: 0
  units: {half: deg}
  full_scales: {half: 1 rad}
  program:
    half: angle/2
    asked: -2*k*half
parameters: {k: 4 1/s^2}
run: {until: 1 s}
record: [theta, theta_dot, moment, asked, half]
readouts: {pitch: {final: theta}, push: {final: moment}}
"""


@pytest.mark.parametrize("lead", ["lead: 5 ms", ""])
@pytest.mark.parametrize(
    "on", [None, "digital", "analog", {"asked": "analog"}, {"theta": "digital"}]
)
def test_units_are_those_of_the_patch_on_either_machine(on, lead):
    """theta is in deg, asked in its DAC's deg/s^2, half in deg; x'' = -4 x."""
    text = CROSSED.replace(", LEAD", f", {lead}" if lead else "")
    run = hybrid.run(hybrid.parse_patch(text, on=on))
    units = {name: variable.attrs["units"] for name, variable in run.record.data_vars.items()}
    due = {"theta": "deg", "theta_dot": "deg/s", "asked": "deg/s^2", "half": "deg"}
    assert due.items() <= units.items()
    assert units.get("moment", "deg/s^2") == "deg/s^2"
    assert run.readouts["push"]["units"] == "deg/s^2" and run.readouts["pitch"]["units"] == "deg"
    degrees = math.degrees(0.1)
    record = run.record.isel(time=10)  # hold and lead move the phase by 0.01 * 2 rad/s and less
    now = degrees * math.cos(0.2)
    assert float(record["theta"]) == pytest.approx(now, rel=0.03)
    assert float(record["half"]) == pytest.approx(now / 2, rel=0.03)
    assert float(record["asked"]) == pytest.approx(-4 * now, rel=0.03)


@pytest.mark.parametrize("name", sorted(hybrid.shipped_patches()))
def test_shipped_patches_keep_their_units_all_digital(name):
    plain = signal_units_of(hybrid.read_patch(name))
    try:
        moved = signal_units_of(hybrid.read_patch(name, on="digital"))
    except PatchError as reason:
        assert "digital" in str(reason) or "word" in str(reason)
        return
    both = plain.keys() & moved.keys()
    assert both and {n: moved[n] for n in both} == {n: plain[n] for n in both}


def signal_units_of(patch):
    return signal_units(compile_patch(patch))
