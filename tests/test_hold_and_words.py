"""run: on_overload beside programs of limited word length: what holds the machine, and what goes on."""

from __future__ import annotations

import numpy as np
import pytest

from hybrid.patchfile import parse_patch
from hybrid.runs import run

LENGTHS = {
    "float64": "float64",
    "float32": "float32",
    "short": "{mantissa: 10}",
    "cut": "{mantissa: 10, rounding: truncate}",
    "saturate": "{fixed: 12, full_scale: 64, overflow: saturate}",
    "wrap": "{fixed: 12, full_scale: 64, overflow: wrap}",
    "stop": "{fixed: 12, full_scale: 64, overflow: stop}",
}
# A ramp of 20 1/s with a full scale of its own, and a count from FIRST on in steps of 1.
PATCH = """\
title: A ramp and a count
machine: ideal
analog:
  one: {constant: 1, full_scale: 2}
  x: {integrate: {one: 20 1/s}, initial: 0, full_scale: SCALE}
  bent: {absolute: x, full_scale: 9}
interface: {seen: {adc: x}, shown: {dac: half, full_scale: 300, initial: 0}}
digital:
  word: WORD
  CLOCK
    remember: {count: FIRST}
    program: {count: previous(count) + 1, half: seen/2}
run: {until: 40 ms, every: 1 ms, on_overload: WHAT}
"""


def played(word, what="hold", scale="1", first="-1", until="40 ms"):
    text = PATCH.replace("  CLOCK\n", "  period: 1 ms\n  compute_time: 0\n").replace(
        "\n    ", "\n  "
    )
    for old, new in {"SCALE": scale, "FIRST": first, "WHAT": what, "40 ms": until}.items():
        text = text.replace(old, new)
    return run(parse_patch(text.replace("WORD", LENGTHS[word])))


@pytest.mark.parametrize("word", LENGTHS)
def test_an_analog_overload_holds_the_machine_and_the_program_goes_on(word):
    """x = 20 t goes beyond 0.313 at 15.65 ms; the count is 40 in the cycle at 40 ms."""
    result = played(word, scale="0.313")
    assert result.status == "complete"
    assert "in HOLD since 0.01565 s: x went beyond its full scale" in result.status_note
    record, time_s = result.record, 0.001 * np.arange(41)
    held = np.minimum(20 * time_s, 0.313)
    np.testing.assert_allclose(record["x"], held, atol=1e-11)
    np.testing.assert_array_equal(record["mode"], np.where(time_s < 0.01565, 1, 2))
    assert record["count"].values.tolist() == list(range(41))
    # Half of it in the word's own digits: 2^-10 of the number, or a step of 64/2^11.
    step = 64 / 2**11 if word in ("saturate", "wrap", "stop") else 0.0
    np.testing.assert_allclose(record["half"], held / 2, rtol=2**-9, atol=step)
    assert (len(set(record["half"].values[17:].tolist()))) == 1
    np.testing.assert_allclose(record["shown"], record["half"], atol=1e-13)
    # Held just beyond its full scale, it is beyond its ADC's range, too.
    assert [o["signal"] for o in result.overloads] == ["x", "seen"]


@pytest.mark.parametrize("word", ["saturate", "wrap"])
def test_a_word_beyond_its_range_holds_the_machine_in_the_same_cycle(word):
    """From 48 the count is 64, one beyond the range, in the cycle at 15 ms, where x is 0.3."""
    result = played(word, first="48")
    assert "in HOLD since 0.015 s: count went beyond its full scale" in result.status_note
    assert result.status == "complete"
    record = result.record
    np.testing.assert_allclose(record["x"], np.minimum(0.02 * np.arange(41), 0.3), atol=1e-12)
    count = np.arange(49, 90)
    largest = 64 - 64 / 2**11
    expected = np.where(count < 64, count, count - 128 if word == "wrap" else largest)
    assert record["count"].values.tolist() == expected.tolist()
    (overload,) = result.overloads
    assert (overload["signal"], overload["time_s"], overload["value"]) == ("count", 0.015, 64)


def test_what_comes_first_holds_and_a_word_that_is_to_stop_the_run_does_so_in_hold():
    first_x = played("saturate", first="48", scale="0.25")  # beyond at 12.5 ms
    assert "in HOLD since 0.0125 s: x" in first_x.status_note
    assert [o["signal"] for o in first_x.overloads] == ["x", "seen", "count"]
    stopped = played("stop", first="48", scale="0.25")
    assert stopped.status == "stopped"
    assert "stopped at 0.015 s: count does not fit into its word" in stopped.status_note
    np.testing.assert_allclose(stopped.record["x"].values[13:], 0.25, atol=1e-11)
    assert stopped.record["mode"].values[-1] == 2


def test_a_word_that_does_not_fit_at_once_holds_the_machine_from_the_start():
    result = played("wrap", first="63")
    assert "in HOLD since 0 s: count" in result.status_note
    np.testing.assert_array_equal(result.record["x"], 0.0)


@pytest.mark.parametrize("word", ["saturate", "wrap", "stop"])
def test_the_run_stops_at_the_overflow_where_that_is_asked_for(word):
    result = played(word, what="stop", first="48")
    assert result.status == "stopped" and "stopped at 0.015 s: count" in result.status_note
    assert result.record["count"].values[-1] == 63


TASKS = """\
  tasks:
    slow:
      period: 5 ms
      phase: 2 ms
      compute_time: 0
      word: {fixed: 8, full_scale: 4, overflow: saturate}
      program: {few: previous(few) + 1}
    fast:
      period: 1 ms
      compute_time: 0
      word: float32
      program: {third: seen/3, fine: few/3}
  remember: {few: 0}
"""


def test_a_word_of_one_task_holds_the_machine_and_all_tasks_go_on():
    """The slow count is 4 in its fourth cycle, at 2 + 3 * 5 = 17 ms: x stays at 0.34."""
    head, _, _ = PATCH.partition("  word: WORD")
    _, _, end = PATCH.partition("half: seen/2}\n")
    text = (head + TASKS + end).replace("dac: half", "dac: third").replace("SCALE", "1")
    result = run(parse_patch(text.replace("WHAT", "hold")))
    assert "in HOLD since 0.017 s: few" in result.status_note and result.status == "complete"
    record, n = result.record, np.arange(41)
    x = np.minimum(0.02 * n, 0.34)
    np.testing.assert_allclose(record["x"], x, atol=1e-12)
    np.testing.assert_allclose(record["third"], x / 3, rtol=2**-23)
    assert np.all(np.float32(record["third"]) == record["third"])
    few = np.minimum((n + 3) // 5, 4 - 4 / 2**7)
    np.testing.assert_array_equal(record["few"], few)
