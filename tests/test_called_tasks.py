"""Tasks that comparators start: their instants against closed forms and SciPy, how they share the
processor against a tick-by-tick simulation and by hand, and what is refused."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_tasks import Slow, rewired

import hybrid
from hybrid.compiler import compile_patch
from hybrid.engines import player_of
from hybrid.errors import PatchError, RunError
from hybrid.machine import TaskTiming
from hybrid.patchfile import parse_patch
from hybrid.record import pens_for
from hybrid.scale import TICKS_PER_SECOND
from hybrid.stretches import Stretches
from hybrid.timeline import build_timeline

# --- where in time -------------------------------------------------------------------------------

CATCH = """\
title: A task that catches a sine going by 1/2
machine: ideal
analog:
  wave: {sine: 1, omega: 10 rad/s, full_scale: 2}
  now: {integrate: {one: 1}, initial: 0 s, full_scale: 10 s}
  one: {constant: 1, full_scale: 1}
  beyond: {compare: {wave: 1}, threshold: 0.5, high: 1, full_scale: 1}
interface:
  at: {adc: now, task: catch}
  seen: {adc: wave, task: catch}
  tick: {adc: now, task: clock}
digital:
  remember: {n: 0, k: 0}
  tasks:
    catch: {when: beyond rises, compute_time: 2 ms, program: {n: previous(n) + 1, a: at, s: seen}}
    clock: {period: 10 ms, compute_time: 1 ms, program: {k: previous(k) + 1, c: tick}}
run: {until: 5 s, every: 10 ms}
"""
RISING = (np.arcsin(0.5) + 2 * np.pi * np.arange(8)) / 10
FALLING = (np.pi - np.arcsin(0.5) + 2 * np.pi * np.arange(8)) / 10


@pytest.mark.parametrize("engine", ["nonlinear", "reference"])
@pytest.mark.parametrize(
    ("edge", "expected"),
    [("rises", RISING), ("falls", FALLING), ("changes", np.sort([*RISING, *FALLING]))],
)
def test_a_task_begins_where_the_comparator_switches(engine, edge, expected):
    if engine == "reference" and edge != "changes":
        pytest.skip("slow, and the same")
    result = hybrid.run(parse_patch(CATCH.replace("beyond rises", f"beyond {edge}")), engine=engine)
    record, expected = result.record, expected[expected < 5 - 2e-3]
    n = record["n"].values
    # The rows are 10 ms apart: each shows what ended since the one before.
    ended = np.searchsorted(expected + 2e-3, record["time"].values + 1e-9)
    np.testing.assert_array_equal(n, ended)
    shown = np.flatnonzero(np.diff(n) == 1) + 1
    # Sampled then and there: located to some 1e-12 of full scale (2 of the wave, slope 8.7/s).
    which = n[shown].astype(int) - 1
    np.testing.assert_allclose(record["a"].values[shown], expected[which], rtol=0, atol=2e-12)
    np.testing.assert_allclose(record["s"].values[shown], 0.5, rtol=0, atol=1e-11)
    # The task with a clock keeps its time.
    np.testing.assert_array_equal(record["k"].values[1:], np.arange(1, 501))
    np.testing.assert_allclose(record["c"].values[1:], np.arange(500) * 0.01, rtol=0, atol=1e-12)
    catch, clock = result.tasks
    assert (catch.period_s, catch.cycles, catch.overruns, catch.place) == (
        None,
        len(expected),
        0,
        1,
    )
    assert catch.worst_response_s == 2e-3
    assert catch.utilisation == pytest.approx(len(expected) * 2e-3 / 5)
    # A call within 1 ms after a tick takes the processor away, one just before keeps it: 3 ms at most.
    assert clock.cycles == 500 and 1e-3 < clock.worst_response_s <= 3e-3


def test_a_clock_samples_what_it_reads_rather_than_a_comparator():
    """Else a loop that a task waiting for a comparator looks at, too, would stand still."""
    text = CATCH.replace("{adc: wave, task: catch}", "{adc: wave}").replace("c: tick", "c: seen")
    machine = compile_patch(parse_patch(text))
    sampled_by = {s.name: machine.timing.tasks[s.task].name for s in machine.samplers}
    assert sampled_by == {"at": "catch", "seen": "clock", "tick": "clock"}


def test_a_machine_without_any_clock():
    text = CATCH.replace(
        "    clock: {period: 10 ms, compute_time: 1 ms, program: {k: previous(k) + 1, c: tick}}\n",
        "",
    )
    text = text.replace("  tick: {adc: now, task: clock}\n", "").replace("n: 0, k: 0", "n: 0")
    result = hybrid.run(parse_patch(text))
    assert result.cycles == 8 and result.record["n"].values[-1] == 8
    with pytest.raises(PatchError, match=r"run: without a task with a period.*add every"):
        parse_patch(text.replace(", every: 10 ms", ""))


def test_what_happens_where_a_dac_jumps(play_nonlinear):
    # The staircase 0.1 k reaches 0.35 when the cycle of 40 ms ends, at 41 ms; the called task samples
    # what is held from then on, and the row of that instant is taken before it.
    text = """\
title: A staircase
machine: ideal
analog:
  level: {sum: {stair: 1}, full_scale: 2}
  high: {compare: {level: 1}, threshold: 0.35, high: 1, full_scale: 1}
interface:
  stair: {dac: k, full_scale: 2, initial: 0}
  held: {adc: level, task: called}
digital:
  remember: {k: -0.1}
  tasks:
    called: {when: high rises, compute_time: 0 s, program: {seen: held}}
    clock: {period: 10 ms, compute_time: 1 ms, program: {k: previous(k) + 0.1}}
run: {until: 60 ms, every: 1 ms}
"""
    record = play_nonlinear(text)
    assert record["stair"].values[[40, 41]] == pytest.approx([0.3, 0.4])
    np.testing.assert_allclose(record["seen"].values, 0.4 * (np.arange(61) > 41), atol=1e-12)


@pytest.fixture(scope="module")
def play_nonlinear():
    return lambda text: hybrid.run(parse_patch(text), engine="nonlinear").record


def test_what_never_comes_to_rest_is_chatter():
    text = CATCH.replace(
        "wave: {sine: 1, omega: 10 rad/s, full_scale: 2}",
        "wave: {sum: {now: 0.1 1/s, d: 1}, full_scale: 2}",
    )
    text = text.replace("interface:\n", "interface:\n  d: {dac: back, full_scale: 2, initial: 0}\n")
    text = text.replace("beyond rises, compute_time: 2 ms", "beyond changes, compute_time: 0 s")
    text = text.replace("a: at", "back: 'select(seen > 0, -1, 1)'")
    result = hybrid.run(parse_patch(text.replace("until: 5 s", "until: 6 s")))
    assert result.status == "stopped" and "stopped at 5 s: a comparator" in result.status_note


def test_noise_and_lags_are_those_of_the_seed():
    one, two, other = (
        hybrid.run(parse_patch(CATCH), machine="nominal", seed=seed) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.record["a"], two.record["a"])
    assert not np.array_equal(one.record["a"], other.record["a"])
    # Noise of 1e-4 of 2 in the wave moves a slope of 8.7/s by 23 us rms; that of the clock that is read
    # is 1e-4 of 10 s, its tolerance as much.
    assert abs(one.record["a"].values[-1] - RISING[-1]) < 6e-3
    assert len({run.tasks[0].cycles for run in (one, other)}) == 1


# --- the processor -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def machine(shipped, compiled):
    """The pitch loop, whose clockwork the tests replace."""
    return compiled(shipped("pitch_loop"))


def called_timeline(machine, calls):
    """All events where comparators make these calls, (tick, task) in order, and the timeline's reports.

    Plays as an engine does: stretch by stretch, up to the last instant before each call.
    """
    later, found, calls = Stretches(machine, 0), [], list(calls)
    for start, _, end, events in later:
        ticks = [(start + t, int(kind), i) for t, kind, i in events]
        at = calls[0][0] if calls else None
        if at is None or at > end or (at == end and end < machine.timing.until):
            found += ticks
            continue
        done = max((t for t, *_ in [*found, *ticks] if t < at), default=-1)
        found += [event for event in ticks if event[0] <= done]
        while calls and calls[0][0] == at:
            later.call(calls.pop(0)[1], done, at)
    return found, later.reports(None)


figures = st.tuples(
    st.sampled_from([0, 3, 4, 6, 8, 12]), st.integers(0, 5), st.sampled_from(["skip", "queue"])
)


@given(
    tasks=st.lists(figures, min_size=1, max_size=4),
    gaps=st.lists(st.tuples(st.integers(0, 40), st.integers(0, 3)), max_size=25),
    preemptive=st.booleans(),
    adcs=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 2), st.integers(0, 2)), max_size=3),
    every=st.sampled_from([1, 7]),
)
@settings(max_examples=150, deadline=None, derandomize=True)
def test_any_calls_equal_the_slow_processor(machine, tasks, gaps, preemptive, adcs, every):
    load = sum(compute / period for period, compute, _ in tasks if period)
    made = tuple(
        TaskTiming(
            f"t{i}", period, 0, compute, i, "skip" if load > 1 else overrun,
            when=None if period else ("c", "rises"),
        )
        for i, (period, compute, overrun) in enumerate(tasks)
    )  # fmt: skip
    until = 300
    numbers = [i for i, task in enumerate(made) if task.when]
    times = itertools.accumulate(gap for gap, _ in gaps)
    calls = sorted(
        {(t, numbers[i % len(numbers)]) for t, (_, i) in zip(times, gaps, strict=True) if t < until}
        if numbers
        else ()
    )
    adcs = [(task % len(made), d, c) for task, d, c in adcs]
    clocked = [replace(task, period=task.period or 1) for task in made]
    wired = rewired(machine, clocked, until, every, preemptive, adcs, [0])
    shortest = min((t.period for t in made if t.period), default=0)
    wired = replace(wired, timing=replace(wired.timing, tasks=made, period=shortest))
    found, reports = called_timeline(wired, calls)
    slow = Slow(made, preemptive, adcs, [0])
    slow.ticks = [
        set(range(0, until + 1, task.period))
        if task.period
        else {t for t, i in calls if i == number}
        for number, task in enumerate(made)
    ]
    assert found == slow.play(until, every).events
    for i, report in enumerate(reports):
        own = [response for task, response in slow.responses if task == i]
        assert (report.cycles, report.overruns) == (len(own), slow.overruns.count(i))
        assert report.worst_response_s == (max(own) / TICKS_PER_SECOND if own else None)


def test_calls_do_not_move_what_is_drawn():
    # The clock is late by the same chance whether or not the other task is called in between.
    text = CATCH.replace("clock: {period: 10 ms,", "clock: {period: 10 ms, jitter: 3 ms,")
    text = text.replace("beyond rises, compute_time: 2 ms", "beyond rises, compute_time: 0 s")
    called, never = (
        hybrid.run(parse_patch(t), seed=4).record["c"].values
        for t in (text, text.replace("threshold: 0.5", "threshold: 1.5"))
    )
    np.testing.assert_allclose(called, never, rtol=0, atol=1e-12)
    assert np.ptp(never[1:] - 0.01 * np.arange(500)) > 2e-3


LONG = CATCH.replace("compute_time: 2 ms", "compute_time: 300 ms").replace(
    "beyond rises", "beyond changes"
)


def test_a_task_that_is_called_again_too_early():
    # It rises for 209 ms and falls for 419 ms, so of 300 ms each second call comes too early.
    (left_out, _) = hybrid.run(parse_patch(LONG)).tasks
    assert (left_out.cycles, left_out.overruns) == (8, 8)
    # 16 calls ask for 300 ms each, whatever becomes of them; the clock for 1 ms of 10.
    assert left_out.utilisation == pytest.approx(16 * 0.3 / 5)
    run = hybrid.run(parse_patch(LONG.replace("300 ms,", "300 ms, overrun: queue,")))
    queued = run.tasks[0]
    assert (queued.cycles, queued.overruns) == (15, 8) and RISING[7] + 0.6 > 5
    # The eighth of them begins 300 ms after the last rise.
    assert queued.waiting == 0 and RISING[7] + 0.3 < 5
    assert queued.utilisation == left_out.utilisation
    assert "the tasks ask for 106 % of the processor's time" in run.status_note
    assert queued.worst_response_s == pytest.approx(0.6 - (FALLING - RISING)[0], abs=1e-12)
    stopped = hybrid.run(parse_patch(LONG.replace("300 ms,", "300 ms, overrun: stop,")))
    assert stopped.status == "stopped" and "'catch' has overrun" in stopped.status_note
    assert f"stopped at {FALLING[0]:.9g} s" in stopped.status_note


BUSY = """\
title: A task that is called far more often than it can be served
machine: ideal
analog:
  wave: {sine: 1, omega: 300 rad/s, full_scale: 2}
  up: {compare: {wave: 1}, high: 1, full_scale: 1}
digital:
  remember: {n: 0, m: 0}
  tasks:
    c: {when: up changes, compute_time: 15 ms, overrun: queue, program: {n: previous(n) + 1}}
    d: {period: 10 ms, compute_time: 2 ms, program: {m: previous(m) + 1}}
run: {until: 2 s}
"""


@pytest.mark.parametrize("overrun", ["queue", "skip"])
def test_what_is_asked_of_the_processor_is_told_of_all_calls(overrun):
    """The sine switches each pi/300 s, in 2 s 190 times (and as it leaves 0, which is no call or one):
    of 15 ms each these ask for 1.425 to 1.433 of the time, beside 0.2 of the clock. The called task goes
    first and computes without a pause from the first call on, so it ends (2 s - 10 ms)/15 ms cycles."""
    patch = parse_patch(BUSY.replace("queue", overrun), "busy.yaml")
    run, check = hybrid.run(patch), hybrid.check(patch)
    called, clocked = run.tasks
    calls = round(called.utilisation * 2 / 0.015)
    assert calls in (190, 191) and called.utilisation == pytest.approx(calls * 0.015 / 2)
    assert clocked.utilisation == 0.2
    told = f"the tasks ask for {100 * (called.utilisation + 0.2):.4g} % of the processor's time"
    assert told in run.status_note
    assert any(f"busy.yaml:9: {told}" in warning for warning in check.warnings)
    if overrun == "skip":
        # Every second call comes too early, and one cycle is under way at the end at most.
        assert called.waiting == 0 and calls - called.cycles - called.overruns in (0, 1)
    else:
        assert called.cycles in (132, 133)
        assert called.waiting == calls - called.cycles - 1
        late = called.overruns - called.waiting
        left = f"task c began {late} cycles late and left {called.waiting} waiting at the end"
        assert left in run.status_note
        assert any(f"{called.waiting} that still wait" in warning for warning in check.warnings)


def test_cycles_that_queue_without_end_stop_the_run(monkeypatch):
    for module in ("processor", "stretches"):
        monkeypatch.setattr(f"hybrid.{module}.MOST_BEHIND", 5)
    text = LONG.replace("300 ms,", "2 s, overrun: queue,")
    stopped = hybrid.run(parse_patch(text))
    assert stopped.status == "stopped" and "more than 5 cycles behind" in stopped.status_note


def test_chunks_show_nowhere():
    compiled = hybrid.compiler.compile_patch(parse_patch(CATCH))
    found = []
    for cues in (1, 7, 10**6):
        player = player_of(compiled)(compiled, build_timeline(compiled), pens_for(compiled))
        while player.outcome == 1:
            player.play_cues(cues)
        found.append(player.record.copy())
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_array_equal(found[1], found[2])


# --- what is said --------------------------------------------------------------------------------


def test_check_and_predict_say_what_applies():
    checked = hybrid.check(parse_patch(CATCH))
    assert checked.prediction.startswith("no exact prediction: ")
    assert "task 'catch' begins when beyond switches" in checked.prediction
    assert checked.tasks[0].cycles == 8
    with pytest.raises(RunError, match=r":15: task 'catch' begins when beyond switches"):
        hybrid.predict(parse_patch(CATCH))


WRONG = {
    "no comparator": ("beyond rises", "wave rises", "'wave', which is no comparator"),
    "unknown": ("beyond rises", "beyont rises", "did you mean 'beyond'"),
    "edge": ("beyond rises", "beyond rising", "valid: the name of a comparator and rises, falls"),
    "no edge": ("beyond rises", "beyond", "when of task 'catch' is 'beyond'"),
    "word": ("beyond rises", "n rises", "program word 'n'"),
    "both": ("when: beyond rises", "period: 1 s, when: beyond rises", "both when and period"),
    "phase": ("when: beyond rises", "phase: 1 s, when: beyond rises", "both when and phase"),
    "neither": (
        "when: beyond rises, ",
        "",
        "task 'catch' has no period; add period: TIME, or when",
    ),
    "states": (
        "program: {n: previous(n) + 1,",
        "states: {z: {integrate: 1, initial: 0}}, program: {n: previous(n) + 1,",
        "integrates 'z', whose step is the period",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_mistake_has_its_line(name):
    old, new, says = WRONG[name]
    assert old in CATCH
    with pytest.raises(PatchError) as raised:
        parse_patch(CATCH.replace(old, new, 1))
    told = str(raised.value)
    assert ":15: " in told and says in told and "\n" not in told
