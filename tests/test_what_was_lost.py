"""A run that cannot go on says by which signal: how far that came, and what passes through zero."""

import math
import re

import numpy as np
import pytest

import hybrid

ONE = "  one: {constant: 1, full_scale: 1}\n"
POLE = (
    "  b: {integrate: {one: -1 1/s}, initial: 0.5, full_scale: 1}\n"
    "  q: {divide: [one, b], gain: 1 V, full_scale: 10 V}\n"
)
ROOT = (
    "  q: {divide: [one, a], gain: -1, full_scale: 10}\n"
    "  a: {integrate: {q: 1 1/s}, initial: 1, full_scale: 1}\n"
)
SQUARE = (
    "  x: {integrate: {sq: 1 1/s}, initial: 1, full_scale: 10}\n"
    "  sq: {multiply: [x, x], full_scale: 10}\n"
)
TURN = (
    "  b: {integrate: {one: -1 1/s}, initial: 0.5, full_scale: 1}\n"
    "  c: {integrate: {one: -2 1/s}, initial: 1, full_scale: 1}\n"
    "  angle: {atan2: [c, b], full_scale: 10}\n"
)


def stopped(parts, machine="ideal", engine="auto", until="2 s"):
    """The note of a run that stopped, without its first words, and when it stopped."""
    text = f"title: Lost\nmachine: {machine}\nanalog:\n{ONE}{parts}run: {{until: {until}, every: 10 ms}}"
    run = hybrid.run(hybrid.parse_patch(text), engine=engine)
    assert run.status == "stopped"
    assert np.all(np.isfinite(run.rows))
    found = re.fullmatch(r"stopped at (\S+) s: (.*)", run.status_note)
    assert found is not None, run.status_note
    return found[2], float(found[1])


@pytest.mark.parametrize("engine", ["nonlinear", "reference"])
def test_a_quotient_through_a_pole(engine):
    """q = 1 V / b, b = 0.5 - t: beyond 1e13 V where b is within 1e-13 of zero."""
    note, at_s = stopped(POLE, engine=engine)
    found = re.fullmatch(
        r"q went beyond 1e\+12 times its full scale, to (\S+) V; its divisor is b at (\S+)", note
    )
    assert found is not None, note
    q, b = float(found[1]), float(found[2])
    assert abs(q) > 1e13 and q * b == pytest.approx(1.0, rel=1e-3)  # four digits of each
    assert at_s == pytest.approx(0.5, abs=1e-6)


def test_a_rate_that_becomes_infinite():
    """a' = -1 / a: a = sqrt(1 - 2 t), which ends at 0.5 s with a slope that no window resolves."""
    note, at_s = stopped(ROOT)
    found = re.fullmatch(
        r"q changes too fast to follow from (\S+) on: its divisor is a at (\S+)", note
    )
    assert found is not None, note
    assert float(found[1]) * float(found[2]) == pytest.approx(-1.0, rel=1e-3)
    assert at_s == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize(
    ("machine", "engine", "late_s"),
    [("ideal", "auto", 1e-6), ("ideal", "reference", 1e-6), ("nominal", "auto", 0.02)],
)
def test_a_square_that_feeds_itself(machine, engine, late_s):
    """x' = x^2 from 1 on is 1 / (1 - t); 0.01 % of tolerance and noise move the pole by some 1e-3."""
    note, at_s = stopped(SQUARE, machine, engine)
    found = re.fullmatch(
        r"sq went beyond 1e\+12 times its full scale, to (\S+); the patch is unstable", note
    )
    assert found is not None, note
    assert abs(float(found[1])) > 1e13
    assert at_s == pytest.approx(1.0, abs=late_s)


def test_an_angle_without_a_direction():
    """Both signals pass zero at 0.5 s, where the angle jumps by half a turn from atan2(2, 1)."""
    note, at_s = stopped(TURN)
    found = re.fullmatch(
        r"angle changes too fast to follow from (\S+) on: its angle jumps, "
        r"with c at (\S+) and b at (\S+)",
        note,
    )
    assert found is not None, note
    assert float(found[1]) == pytest.approx(math.atan2(2, 1), rel=1e-3)
    assert abs(float(found[2])) < 1e-9 and abs(float(found[3])) < 1e-9
    assert at_s == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("engine", ["exact", "nonlinear", "reference"])
def test_a_linear_loop_that_grows(engine):
    """x' = 10 x from 1 V: 1e12 times 5 V at ln(5e12) / 10 s; the exact engine looks every 10 ms."""
    parts = "  x: {integrate: {x: 10 1/s}, initial: 1 V, full_scale: 5 V}\n"
    note, at_s = stopped(parts, engine=engine, until="10 s")
    found = re.fullmatch(
        r"x went beyond 1e\+12 times its full scale, to (\S+) V; the patch is unstable", note
    )
    assert found is not None, note
    assert float(found[1]) >= 0.999e12 * 5
    assert at_s == pytest.approx(math.log(5e12) / 10, abs=0.02)


def test_a_word_that_runs_away():
    """2^k passes 1e12 times the 5 V of its DAC at k = 43, while what it drives is far below."""
    text = """
title: Doubling
machine: ideal
analog:
  x: {integrate: {m: 1e-6 1/s}, initial: 0, full_scale: 100 V}
interface:
  m: {dac: w, full_scale: 5 V, initial: 0}
digital: {period: 1 ms, compute_time: 0, remember: {w: 1 V}, program: {w: 2 * previous(w)}}
run: {until: 1 s}
"""
    for engine in ("exact", "nonlinear"):
        note = hybrid.run(hybrid.parse_patch(text), engine=engine).status_note
        assert re.search(r"m( \(DAC\))? went beyond 1e\+12 times its full scale", note), note
