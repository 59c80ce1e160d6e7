"""Saturation within full scale lights no indicator; the run says so instead."""

import pytest

import hybrid

PATCH = """
title: a sine of 1 beside what it drives
machine: {{preset: {machine}}}
analog:
  u: {{sine: 1, frequency: 1 Hz, full_scale: 1}}
  {name}: {{{what}, full_scale: 1}}
run: {{until: 1 s, every: 10 ms}}
"""


def note_of(name, what, machine="ideal"):
    patch = hybrid.parse_patch(PATCH.format(machine=machine, name=name, what=what))
    return hybrid.run(patch).status_note


@pytest.mark.parametrize("machine", ["ideal", "lags", "nominal"])
@pytest.mark.parametrize(
    "what",
    [
        "sum: {u: 1}, saturation: 0.8",
        "multiply: [u, u], saturation: 0.8",
        "integrate: {u: 20 1/s}, initial: 0, saturation: 0.8",
    ],
)
def test_what_stops_at_its_saturation_is_named(what, machine):
    """Sine, its square and 20 / (2 pi) (1 - cos) all go beyond 0.8."""
    assert "a was held back by its saturation, 0.8 of full scale" in note_of("a", what, machine)


@pytest.mark.parametrize(
    "what",
    [
        "sum: {u: 0.5}, saturation: 0.8",  # never gets there
        "sum: {u: 0.5}",
        "integrate: {u: 20 1/s}, initial: 0, low: -0.5, high: 0.5",  # as the patch wants it
        "limit: u, low: -0.5, high: 0.5",
    ],
)
def test_what_does_not_is_not(what):
    assert "held back" not in note_of("a", what)


def test_an_overload_is_told_by_its_indicator():
    """Beyond full scale at 1.05: the table of overloads says that."""
    patch = PATCH.format(machine="ideal", name="a", what="sum: {u: 2}, saturation: 1.05")
    result = hybrid.run(hybrid.parse_patch(patch))
    assert [o["signal"] for o in result.overloads] == ["a"]
    assert "held back" not in result.status_note
