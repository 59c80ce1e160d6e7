"""`units:` of the digital machine: what words and states are shown in, and nothing else."""

import math

import pytest

import hybrid
from hybrid.errors import PatchError

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
            "unit of 'pitch' is 'ft'; it must be that of what is a pure number",
        ),
        ("height: ft", "height: deg", "unit of 'height' is 'deg'; it must be"),
        ("height: ft", "height: furlongs_", "unit of 'height'"),
        ("height: ft", "height: [ft]", "units: 'height' needs a unit, not a list"),
    ],
)
def test_units_that_do_not_fit(old, new, said):
    with pytest.raises(PatchError) as caught:
        hybrid.parse_patch(PATCH.replace(old, new, 1), "units.yaml")
    assert str(caught.value).startswith("units.yaml:5: ") and said in str(caught.value)
