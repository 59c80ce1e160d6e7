"""ADC and DAC: exact inverses up to half a step, zero to zero, monotone, symmetric, honest overload."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.engine.kernel import convert
from hybrid.errors import PatchError

# A ramp from -1.25 to 1.25 full scale, converted and shown again, one sample a second.
RAMP = """
title: A ramp through a converter pair
machine: {preset: nominal, tau: 0 s, noise: 0, tolerance: 0}
parameters: {scale: 1, range: scale, slope: 1}
analog:
  one: {constant: 1, full_scale: 1}
  x: {integrate: {one: slope*scale/160}, initial: 0, full_scale: scale}
interface:
  word: {adc: x, ADC}
  shown: {dac: again, DAC, full_scale: scale, initial: 0}
digital:
  period: 1 s
  compute_time: 0 s
  program: {again: word, code: 1*word}
run: {until: 200 s}
"""


def ramp(play, bits, scale=1.0, reach=1.0, slope=1, dac_bits=None):
    """Columns of the record: samples, words and what the DAC shows, in machine units of the range."""
    text = RAMP.replace("ADC", f"bits: {bits}, range: range")
    text = text.replace("DAC,", f"bits: {dac_bits}," if dac_bits else "")
    return play(text, {"scale": scale, "range": reach * scale, "slope": slope})


def largest_code(bits):
    return 2 ** (bits - 1) - 1


bits_and_ranges = given(
    bits=st.integers(2, 32),
    scale=st.floats(1e-9, 1e9),
    reach=st.floats(0.1, 1.25),
)


@bits_and_ranges
@settings(max_examples=60, deadline=None, derandomize=True)
def test_ramp_comes_back_to_half_a_step(play, bits, scale, reach):
    played = ramp(play, bits, scale, reach)
    limit, step = reach * scale, reach * scale / largest_code(bits)
    x, word = played["x"], played["word"]
    rounding = 1e-15 * limit
    inside = np.abs(x) <= limit
    assert np.all(np.abs(word - x)[inside] <= step / 2 + 4 * rounding)
    assert np.all(np.abs(word[~inside] - limit) <= rounding)
    codes = word / step
    np.testing.assert_allclose(codes, np.rint(codes), rtol=0, atol=1e-15 * largest_code(bits) * 4)
    assert word[0] == 0.0 and x[0] == 0.0
    assert np.all(np.diff(word) >= 0)
    down = ramp(play, bits, scale, reach, slope=-1)
    assert np.array_equal(down["word"], -word)


@bits_and_ranges
@settings(max_examples=30, deadline=None, derandomize=True)
def test_dac_shows_every_code_of_an_adc_of_the_same_word_length(play, bits, scale, reach):
    # ADC over the full scale, then DAC: the code comes back, so the second rounding changes nothing.
    played = ramp(play, bits, scale, 1.0, dac_bits=bits)
    step = 1.0 / largest_code(bits)
    codes = played["word"] / scale / step
    assert np.array_equal(np.rint(codes), np.rint(played["shown"] / scale / step))
    np.testing.assert_allclose(played["shown"], played["word"], rtol=4e-16)


def test_coarse_codes_by_hand(play):
    # 3 bits: codes -3 to 3, a step of 1/3; 2 bits: -1, 0, 1.
    for bits, top in ((3, 3), (2, 1)):
        played = ramp(play, bits)
        expected = np.rint(np.clip(played["x"], -1, 1) * top) / top
        ties = np.isclose(np.abs(played["x"] * top) % 1, 0.5)
        np.testing.assert_allclose(played["word"][~ties], expected[~ties], rtol=1e-15, atol=0)
        assert set(np.rint(played["word"] * top).tolist()) == set(range(top + 1))


@given(st.integers(2, 32), st.floats(1e-3, 1e3), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
@settings(max_examples=500, deadline=None, derandomize=True)
def test_converter_itself(bits, limit, one, other):
    step = limit / largest_code(bits)

    def converted(share):
        return convert(share * limit, limit, step, 1.0)

    assert converted(0.0) == 0.0
    assert converted(-one) == -converted(one)
    assert abs(converted(one) - one * limit) <= step / 2 + 2e-16 * limit
    assert (converted(one) <= converted(other)) == (
        np.rint(one * limit / step) <= np.rint(other * limit / step)
    )
    # A converted value is a fixed point: the pair is an exact inverse from then on.
    assert converted(one) == convert(converted(one), limit, step, 1.0)
    # Saturation is at the limit itself, or an overload would be flagged of a value that is none.
    assert convert(7.0 * limit, limit, step, 1.0) == pytest.approx(limit, rel=3e-16)
    assert convert(7.0 * limit, limit, 0.0, 1.0) == limit
    assert convert(-7.0 * limit, limit, 0.0, 1.0) == -limit
    assert convert(one, limit, 0.0, 0.0) == one


@pytest.mark.parametrize("bits", range(2, 33))
def test_full_scale_saturates_exactly_and_is_no_overload_of_the_signal(play, bits):
    # Beyond full scale the DAC flags its word; the signal behind it stands at 1 and is no overload.
    played = ramp(play, 32, reach=1.25, slope=0.96, dac_bits=bits)
    beyond = {overload.signal: overload for overload in played.player.overloads()}
    assert set(beyond) == {"x", "shown (DAC)"}
    assert np.max(played["shown"]) == 1.0 and np.max(played["word"]) > 1.19
    rate = 1.25 * 0.96 / 200.0
    assert beyond["x"].time_s == pytest.approx(1.0 / rate, rel=1e-11)
    over = np.flatnonzero(played["code"] > 1.0)[0]
    assert beyond["shown (DAC)"].time_s == played.time_s[over]
    assert beyond["shown (DAC)"].worst_mu == pytest.approx(1.2, rel=1e-9)
    assert beyond["shown (DAC)"].worst_time_s == 200.0
    assert beyond["shown (DAC)"].instants == np.sum(played["code"] > 1.0)


@pytest.mark.parametrize(("slope", "reach"), [(1, 1.0), (-1, 1.0), (1, 0.5), (-1, 0.75)])
def test_adc_saturates_and_says_when(play, slope, reach):
    played = ramp(play, 12, reach=reach, slope=slope)
    found = {o.signal: o for o in played.player.overloads()}["word"]
    beyond = np.flatnonzero(np.abs(played["x"]) > reach)
    assert found.time_s == played.time_s[beyond[0]]
    assert found.instants == len(beyond)
    assert found.worst_mu == played["x"][-1] == pytest.approx(1.25 * slope, rel=1e-13)
    assert found.worst_time_s == 200.0
    assert np.max(np.abs(played["word"])) == reach
    # What the DAC shows is within its full scale, so no overload.
    assert {o.signal for o in played.player.overloads()} == {"word", "x"}


def test_a_signal_within_range_is_no_overload(play):
    text = RAMP.replace("ADC", "bits: 14").replace("DAC,", "bits: 14,")
    played = play(text.replace("200 s}", "160 s}"), {"slope": 0.999})
    assert played.player.overloads() == ()


def test_exact_machines_neither_round_nor_clip(play):
    text = RAMP.replace("ADC", "bits: 4").replace("DAC,", "bits: 4,")
    text = text.replace("{preset: nominal, tau: 0 s, noise: 0, tolerance: 0}", "ideal")
    played = play(text)
    assert np.array_equal(played["word"], played["x"])
    assert np.array_equal(played["shown"], played["x"])
    # It goes beyond full scale all the same, and says so.
    assert {o.signal for o in played.player.overloads()} == {"x", "word", "shown (DAC)", "shown"}


def test_no_bits_means_no_rounding_but_clipping(play):
    text = RAMP.replace("ADC", "range: 0.5").replace("DAC,", "")
    played = play(text)
    assert np.array_equal(played["word"], np.minimum(played["x"], 0.5))
    assert np.array_equal(played["shown"], played["word"])


@pytest.mark.parametrize("bits", [1, 33, 0])
def test_word_lengths_that_no_converter_has(compiled, bits):
    with pytest.raises(PatchError, match="bits"):
        compiled(RAMP.replace("ADC", f"bits: {bits}").replace("DAC,", ""))


def test_dac_starts_within_full_scale(compiled):
    text = (
        RAMP.replace("ADC", "bits: 8")
        .replace("DAC,", "")
        .replace("initial: 0}\nd", "initial: 2}\nd")
    )
    with pytest.raises(PatchError, match="initial value of 'shown' is 2 times its full_scale"):
        compiled(text)
