"""The machines by name: figures from the sources that `hybrid/machines.py` names."""

import math

import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.components import CATALOG
from hybrid.machines import PRESETS

PATCH = """
title: One of each
machine: {preset: PRESET}
analog:
  x: {integrate: {product: 1 1/s}, initial: 0.5, full_scale: 1}
  pot: {coefficient: {x: 0.5}, full_scale: 1}
  mix: {sum: {x: 0.5, pot: 0.5}, full_scale: 1}
  product: {multiply: [mix, held], full_scale: 1}
  own: {multiply: [x, x], full_scale: 1, tolerance: 0, tau: 3 us}
interface:
  seen: {adc: x, bits: 12}
  held: {dac: word, bits: 12, full_scale: 1, initial: 0}
digital: {period: 1 ms, program: {word: seen}}
run: {until: 10 ms}
"""


def stages(preset, serial=1, text=PATCH):
    return compile_patch(hybrid.parse_patch(text.replace("PRESET", preset)), serial=serial).stages


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_kinds_that_differ_are_kinds(preset):
    assert set(preset.kinds) <= {*CATALOG, "dac"}
    for figures in preset.kinds.values():
        assert set(figures) <= {"tau", "tolerance", "offset_limit", "noise", "saturation"}


@pytest.mark.parametrize(
    ("preset", "limits"),
    [
        ("nominal", {"x": 1e-4, "pot": 1e-4, "mix": 1e-4, "product": 1e-4, "held": 1e-4}),
        ("howe_1964", {"x": 1e-4, "pot": 1e-4, "mix": 1e-4, "product": 5e-4, "held": 1e-4}),
        # 0.1 % resistors: (1 + 1e-3) / (1 - 1e-3) - 1 = 0.2 %; with 2 % capacitors 2.1 %.
        ("analog_thing", {"x": 2.1e-2, "pot": 1e-3, "mix": 2e-3, "product": 2e-2, "held": 2e-3}),
    ],
)
def test_gain_errors_fill_their_limits(preset, limits):
    """Over 60 machines the largest error comes near the limit and never beyond: uniform draws stay
    below 0.8 of it in all 60 with probability 0.8^60 = 2e-6."""
    drawn = [stages(preset, serial) for serial in range(60)]
    for name, limit in limits.items():
        largest = max(abs(found[name].gain - 1.0) for found in drawn)
        assert 0.8 * limit < largest <= limit * (1 + 1e-9), name


@pytest.mark.parametrize("preset", ["howe_1964", "analog_thing"])
def test_offsets_are_drawn_for_each_component_and_machine(preset):
    """Uniform within the limit: mean 0, variance limit^2 / 3, of 240 draws within 4 standard errors.

    The variance of the square of a uniform draw of limit 1 is 1/5 - 1/9 = 4/45.
    """
    limit, names = PRESETS[preset].offset_limit, ("x", "pot", "mix", "held")
    drawn = [stages(preset, serial)[name].offset / limit for serial in range(60) for name in names]
    assert max(map(abs, drawn)) <= 1
    count = len(drawn)
    assert abs(sum(drawn)) / count < 4 * math.sqrt(1 / 3 / count)
    assert abs(sum(x * x for x in drawn) / count - 1 / 3) < 4 * math.sqrt(4 / 45 / count)


def test_a_fixed_offset_adds_to_the_one_that_is_drawn():
    text = PATCH.replace("tolerance: 0, tau: 3 us", "offset: 0.01")
    drawn = stages("howe_1964")["own"].offset
    assert abs(drawn) < 2e-6
    assert stages("howe_1964", text=text)["own"].offset == pytest.approx(0.01 + drawn, abs=1e-12)


def test_the_table_top_machine_by_its_data_sheets():
    found = stages("analog_thing")
    multiplier, amplifier = found["product"], found["mix"]
    assert multiplier.tau == pytest.approx(1 / (2 * math.pi * 1e6), rel=0.01)  # AD633: 1 MHz
    # 100 uV rms in 10 kHz, white up to pi/2 times 1 MHz, of 10 V.
    assert multiplier.noise == pytest.approx(
        100e-6 * math.sqrt(math.pi / 2 * 1e6 / 10e3) / 10, rel=0.01
    )
    limit = PRESETS["analog_thing"].offset_limit
    assert limit == pytest.approx(2 * 1e-3 / 10)  # TL074H: 1 mV, gain of 2 for it
    # Two resistors of 1 Mohm at 300 K: 4 k T R each, over 1 / (4 tau), of 10 V.
    thermal_v = math.sqrt(2 * 4 * 1.380649e-23 * 300 * 1e6 / (4 * amplifier.tau))
    assert amplifier.noise == pytest.approx(thermal_v / 10, rel=0.2)
    assert amplifier.saturation == 11.5 / 10


def test_a_component_keeps_what_it_sets_itself():
    found = stages("analog_thing")["own"]
    assert (found.gain, found.tau) == (1.0, 3e-6)
    common = PATCH.replace("{preset: PRESET}", "{preset: analog_thing, tolerance: 0}")
    assert all(stage.gain == 1.0 for stage in stages("", text=common).values())


def test_an_amplifier_of_1964_stops_at_its_saturation():
    """x' = 20 x from 0.5 passes 1.1 at ln(2.2)/20 s = 39 ms and stays there."""
    text = """
title: Overload
machine: {preset: howe_1964, noise: 0}
analog:
  x: {integrate: {x: 20 1/s}, initial: 0.5, full_scale: 1}
run: {until: 0.2 s, every: 1 ms}
"""
    found = hybrid.run(hybrid.parse_patch(text))
    assert found.status == "complete"
    assert float(found.record["x"][-1]) == pytest.approx(1.1, abs=1e-9)
    (overload,) = found.overloads
    assert overload["time_s"] == pytest.approx(math.log(2.0) / 20, rel=2e-4)  # 0.01 % of its gain
    assert overload["worst_value"] == pytest.approx(1.1, abs=1e-9)
