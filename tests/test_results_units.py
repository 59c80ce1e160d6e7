"""What a nonlinear component makes of units must be the unit of its full scale."""

import pytest

import hybrid
from hybrid.errors import PatchError

PATCH = """
title: Units of results
machine: ideal
analog:
  a: {constant: 10 ft, full_scale: 20 ft}
  v: {constant: 2 V, full_scale: 4 V}
  turn: {constant: 30 deg, full_scale: 90 deg}
  gate: {step: 1, at: 1 ms, full_scale: 1}
  m: {COMPONENT}
run: {until: 2 ms, every: 1 ms}
"""


def final(component):
    found = hybrid.run(hybrid.parse_patch(PATCH.replace("COMPONENT", component)))
    return float(found.record["m"].values[-1])


@pytest.mark.parametrize(
    ("component", "said"),
    [
        ("multiply: [a, a], full_scale: 1000 ft", "gain of component 'm' must be in 1/m"),
        ("multiply: [v, v], full_scale: 4 V", "gain of component 'm' must be in"),
        ("multiply: [v, v], full_scale: 16", "gain of component 'm' must be in"),
        ("divide: [a, v], full_scale: 4 ft", "gain of component 'm' must be in"),
        ("square_root: a, full_scale: 1 kg", "gain of component 'm' must be in"),
        ("sin: a, full_scale: 1", "is the sin of 'a', which is in ft; it must be an angle"),
        ("cos: a, amplitude: 1 ft, full_scale: 1 ft", "it must be an angle"),
        ("sin: turn, full_scale: 1 ft", "amplitude of component 'm' must be in m"),
        ("atan2: [a, v], full_scale: 4", "reads 'a', which is in ft, and 'v', which is in V"),
        ("atan2: [a, a], full_scale: 4 V", "gain of component 'm' must be in"),
        ("absolute: a, full_scale: 4 V", "units of component 'm' do not fit: the result is in m"),
        ("limit: a, low: 0, high: 1 V, full_scale: 4 V", "units of component 'm' do not fit"),
        ("switch: [a, v], control: gate, full_scale: 4 V", "must have the same units"),
        ("track: a, control: gate, full_scale: 4 V", "units of component 'm' do not fit"),
        ("backlash: a, width: 1 V, full_scale: 4 V", "units of component 'm' do not fit"),
    ],
)
def test_units_that_do_not_fit(component, said):
    with pytest.raises(PatchError) as refused:
        hybrid.parse_patch(PATCH.replace("COMPONENT", component))
    assert said in str(refused.value)
    assert str(refused.value).startswith("<text>:9: ")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("component", "expected"),
    [
        ("multiply: [a, a], full_scale: 1000 ft^2", 100.0),
        ("multiply: [a, a], gain: 0.1 1/ft, full_scale: 1000 ft", 10.0),
        ("multiply: [a, a], gain: 1, full_scale: 1000 ft", 100 * 0.3048),  # of SI units, 1/m
        ("multiply: [a, turn], full_scale: 20 ft", 10 * 3.141592653589793 / 6),
        ("divide: [a, v], full_scale: 20 ft/V", 5.0),
        ("square_root: a, gain: 2 V/ft^0.5, full_scale: 20 V", 2 * 10**0.5),
        ("sin: turn, amplitude: 3 ft, full_scale: 4 ft", 1.5),
        ("sin: turn, full_scale: 1", 0.5),
        ("atan2: [a, a], full_scale: 180 deg", 45.0),
        ("switch: [a, a], control: gate, full_scale: 20 ft", 10.0),
    ],
)
def test_units_that_fit(component, expected):
    assert final(component) == pytest.approx(expected, rel=1e-12)
