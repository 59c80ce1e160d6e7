"""A comparator gives a logic level: its own noise and tolerance overload nothing."""

import pytest

import hybrid

LOGIC = """
title: A comparator at full scale
machine: nominal
parameters: {level: 1}
analog:
  wave: {sine: 0.5, omega: 1000 rad/s, full_scale: 1}
  up: {compare: {wave: 1}, high: level, low: -1, full_scale: 1}
  way: {integrate: {up: 100 1/s}, initial: 0, full_scale: 1}
run: {until: 20 ms, every: 0.1 ms, on_overload: stop}
"""


def played(machine=None, level=1.0, text=LOGIC, **options):
    return hybrid.run(hybrid.parse_patch(text), {"level": level}, machine=machine, **options)


@pytest.mark.parametrize("machine", ["nominal", "howe_1964", "analog_thing"])
def test_a_level_of_full_scale_is_no_overload_and_stops_nothing(machine):
    """Its noise of 1e-4 carries it beyond half of the time, on `analog_thing` its gain does always, for
    one of the serial numbers; a level is not an amplifier's output."""
    for serial in (0, 1, 2):
        result = played(machine, serial=serial, seed=3)
        assert (result.status, result.overloads) == ("complete", ())
    gains = [
        hybrid.compiler.compile_patch(
            hybrid.parse_patch(LOGIC), machine="analog_thing", serial=serial
        )
        .stages["up"]
        .gain
        for serial in (0, 1, 2)
    ]
    assert max(gains) > 1.0005


def test_levels_beyond_the_full_scale_given_are_told():
    result = played(level=1.5)
    assert result.status == "stopped"
    assert [o["signal"] for o in result.overloads] == ["up"]


def test_what_a_comparator_drives_is_watched_as_ever():
    """1.2 on a summer's output is beyond it, and found where the comparator switches, at t = 0."""
    text = LOGIC.replace("run:", "  sum_of_it: {sum: {up: 1.2}, full_scale: 1}\nrun:")
    assert "sum_of_it" in {o["signal"] for o in played(text=text).overloads}


def test_a_level_needs_no_more_range():
    rows = {
        r.signal: r for r in hybrid.check(hybrid.parse_patch(LOGIC), machine="analog_thing").scaling
    }
    assert rows["up"].remark == ""
    assert 0.998 <= rows["up"].used <= 1.0
    assert rows["wave"].used == pytest.approx(0.5, rel=5e-3)
