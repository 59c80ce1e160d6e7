"""Fixed-point words in the trial run of a check: how far they went, and what they held back; by hand."""

import pytest

import hybrid
from hybrid.patchfile import parse_patch

# x goes from 0.5 m at -k x = -2 m/s^2, twice what the word acc takes.
PATCH = """
title: A word that is too small
machine: ideal
parameters: {k: 4 1/s^2, most: 1 m/s^2}
analog:
  v: {integrate: {a: 1}, initial: 0 m/s, full_scale: 3 m/s}
  x: {integrate: {v: 1}, initial: 0.5 m, full_scale: 1 m}
interface:
  xs: {adc: x}
  a: {dac: acc, full_scale: 2.5 m/s^2, initial: 0 m/s^2}
digital:
  period: 10 ms
  compute_time: 0 ms
  words: {acc: {fixed: 12, full_scale: most, overflow: OVERFLOW}}
  program: {acc: -k*xs}
run: {until: 0.5 s}
"""


def checked(overflow, **parameters):
    found = hybrid.check(parse_patch(PATCH.replace("OVERFLOW", overflow), "word.yaml"), parameters)
    return found, {row.signal: row for row in found.scaling}, found.words[0]


@pytest.mark.parametrize("overflow", ["saturate", "wrap", "stop"])
def test_a_word_that_overflows_is_told_and_its_dac_gets_no_proposal(overflow):
    found, rows, word = checked(overflow)
    (warning,) = found.warnings
    assert "'acc'" in warning
    assert "beyond its full_scale of 1 m/s^2" in warning
    assert word.overflow == overflow
    assert word.largest >= 2.0 - 1e-9
    assert "held back" in word.remark
    assert (rows["a"].proposed, word.proposed) == (None, None)
    assert "held back" in rows["a"].remark


def test_a_word_that_fits_has_its_use_and_a_proposal():
    found, rows, word = checked("stop", most=8.0)
    assert found.warnings == ()
    assert (word.largest, word.used) == (pytest.approx(2.0, 1e-3), pytest.approx(0.25, 1e-3))
    assert word.proposed == 2.5
    assert rows["a"].proposed == 2.5
    assert found.to_dict()["words"][0]["word"] == "acc"
