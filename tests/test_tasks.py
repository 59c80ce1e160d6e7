"""Several tasks on one processor: against a tick-by-tick simulation, response-time analysis and
timelines by hand; what their words read; multi-rate loops against products of hand-written matrices."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hybrid
from hybrid.clockwork import Happening
from hybrid.cycle_map import cycle_maps
from hybrid.errors import PatchError, RunError
from hybrid.machine import Holder, Sampler, TaskTiming, Timing
from hybrid.patchfile import parse_patch
from hybrid.scale import TICKS_PER_SECOND
from hybrid.timeline import build_timeline
from hybrid.together import only

MS = TICKS_PER_SECOND // 1000
START, END = Happening.START, Happening.END


def tasks_of(*figures):
    """Tasks of (period, compute, phase, overrun) in ticks; the first has the highest rank."""
    return tuple(
        TaskTiming(f"t{i}", period, phase, compute, i, overrun)
        for i, (period, compute, phase, overrun) in enumerate(figures)
    )


@pytest.fixture(scope="module")
def machine(shipped, compiled):
    """The pitch loop, whose clockwork the tests replace."""
    return compiled(shipped("pitch_loop"))


def rewired(machine, tasks, until, every=1, preemptive=True, adcs=(), dacs=()):
    """The machine with these tasks; `adcs` lists (task, delay, conversion), `dacs` tasks."""
    samplers = [
        Sampler(f"s{i}", 0, 1.0, 1.0, 0.0, False, d, c, t) for i, (t, d, c) in enumerate(adcs)
    ]
    holders = [Holder(f"h{i}", 0, 1, 1.0, 0.0, False, task) for i, task in enumerate(dacs)]
    shortest, longest = min(t.period for t in tasks), max(t.compute for t in tasks)
    timing = Timing(shortest, longest, every, until, tasks, preemptive)
    return replace(
        machine, timing=timing, samplers=tuple(samplers), holders=tuple(holders), steps=()
    )


# --- tick by tick ----------------------------------------------------------------------------------


class Slow:
    """The processor played one tick at a time, from the rules as README and `clockwork` state them."""

    def __init__(self, tasks, preemptive, adcs, dacs):
        self.tasks, self.preemptive, self.adcs, self.dacs = tasks, preemptive, adcs, dacs
        self.cycle = [None] * len(tasks)  # [due, begun, left, started]
        self.queue = [[] for _ in tasks]
        self.running, self.events, self.responses, self.overruns = None, [], [], []
        self.ticks = None  # of each task's clock, where it is late by chance

    def begin(self, i, due, now):
        self.cycle[i] = [due, now, self.tasks[i].compute, False]

    def finish(self, i, now):
        self.at_once.append((now, int(END), i))
        self.latched |= {d for d, task in enumerate(self.dacs) if task == i}
        self.responses.append((i, now - self.cycle[i][0]))
        self.cycle[i] = self.running = None
        if self.queue[i]:
            self.begin(i, self.queue[i].pop(0), now)

    def ready(self, now):
        for i, cycle in enumerate(self.cycle):
            own = [d + c for task, d, c in self.adcs if task == i]
            if cycle and now >= cycle[1] + max(own, default=0):
                yield i

    def instant(self, now):
        self.at_once, self.latched = [], set()
        if self.running is not None and self.cycle[self.running][2] == 0:
            self.finish(self.running, now)
        for i, task in enumerate(self.tasks):
            if now in self.ticks[i]:
                if self.cycle[i] is None:
                    self.begin(i, now, now)
                else:
                    self.overruns.append(i)
                    if task.overrun == "queue":
                        self.queue[i].append(now)
        while waiting := list(self.ready(now)):
            if self.running is None or (self.preemptive and waiting[0] < self.running):
                self.running = waiting[0]
            cycle = self.cycle[self.running]
            if not cycle[3]:
                cycle[3] = True
                self.at_once.append((now, int(START), self.running))
            if cycle[2]:
                break
            self.finish(self.running, now)
        sampled = []
        for a, (task, delay, conversion) in enumerate(self.adcs):
            sampled += [(now, 0, a)] * (now - delay in self.begun[task])
            sampled += [(now, 1, a)] * (now - delay - conversion in self.begun[task])
        self.events += sorted(sampled) + self.at_once + [(now, 4, d) for d in sorted(self.latched)]

    def play(self, until, every):
        self.begun = [set() for _ in self.tasks]
        self.ticks = self.ticks or [set(range(t.phase, until + 1, t.period)) for t in self.tasks]
        old = self.begin

        def begin(i, due, now):
            self.begun[i].add(now)
            old(i, due, now)

        self.begin = begin
        for now in range(until + 1):
            self.instant(now)
            self.events += [(now, int(Happening.RECORD), 0)] * (now % every == 0)
            if self.running is not None:
                self.cycle[self.running][2] -= 1
        return self


def listed(timeline):
    """The events, an instant's LATCH of a DAC once."""
    seen = [(t, int(kind), i) for t, kind, i in timeline if kind != Happening.REST]
    return [e for k, e in enumerate(seen) if not k or e != seen[k - 1]]


figures = st.tuples(
    st.sampled_from([2, 3, 4, 6, 8, 12]),
    st.integers(0, 5),
    st.integers(0, 13),
    st.sampled_from(["skip", "queue"]),
)


@given(
    tasks=st.lists(figures, min_size=1, max_size=4),
    preemptive=st.booleans(),
    adcs=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3), st.integers(0, 3)), max_size=3),
    dacs=st.lists(st.integers(0, 3), max_size=2),
    every=st.sampled_from([1, 4, 24]),
    until=st.sampled_from([20, 150, 700]),
)
@settings(max_examples=250, deadline=None, derandomize=True)
def test_any_tasks_equal_the_slow_processor(machine, tasks, preemptive, adcs, dacs, every, until):
    # Cycles that queue without end are refused; those that only may are not (see below).
    load = sum(Fraction(compute, period) for period, compute, _, _ in tasks)
    if load > 1:
        tasks = [(p, c, f, "skip") for p, c, f, _ in tasks]
    tasks = tasks_of(*tasks)
    adcs = [(task % len(tasks), d, c) for task, d, c in adcs]
    adcs = [(t, d % tasks[t].period, c % tasks[t].period) for t, d, c in adcs]
    dacs = [task % len(tasks) for task in dacs]
    wired = rewired(machine, tasks, until, every, preemptive, adcs, dacs)
    timeline = build_timeline(wired)
    slow = Slow(tasks, preemptive, adcs, dacs).play(until, every)
    assert listed(timeline) == slow.events
    for i, report in enumerate(timeline.reports(wired)):
        own = [response for task, response in slow.responses if task == i]
        assert report.cycles == len(own)
        assert report.overruns == slow.overruns.count(i)
        assert report.worst_response_s == (max(own) / TICKS_PER_SECOND if own else None)


def test_what_repeats_is_laid_out_once(machine):
    tasks = tasks_of((2 * MS, MS // 2, 0, "skip"), (10 * MS, 3 * MS, 7 * MS, "skip"))
    timeline = build_timeline(rewired(machine, tasks, 10**6 * 10 * MS, every=2 * MS))
    assert len(timeline.segments) <= 4
    assert max(segment.repeats for segment in timeline.segments) > 900_000
    report = timeline.reports(rewired(machine, tasks, 0))
    # The slow one begins at 7, gives way at 8 and 10 and ends at 11: the last one is not done.
    assert [r.cycles for r in report] == [5 * 10**6, 10**6 - 1]
    assert [r.worst_response_s for r in report] == [0.5e-3, 4e-3]


# --- jitter ----------------------------------------------------------------------------------------


def jittery(machine, until, every=100, overrun="skip"):
    """Two tasks whose clocks are late by up to 64 and 320 ticks, each with an ADC and a DAC."""
    tasks = (
        TaskTiming("t0", 1000, 0, 300, 0, overrun, jitter=64),
        TaskTiming("t1", 4000, 500, 1500, 1, overrun, jitter=320),
    )
    return rewired(machine, tasks, until, every, adcs=[(0, 0, 0), (1, 0, 0)], dacs=[0, 1])


def ticks_in(events):
    """When each task's clock ticked, from the samples that it takes then."""
    return [
        [t for t, kind, i in events if (kind, i) == (Happening.SAMPLE, task)] for task in (0, 1)
    ]


def test_clocks_are_late_by_what_is_drawn(machine):
    events = listed(build_timeline(jittery(machine, 4_000_000), seed=3))
    for late_by, period, phase, ticks in zip(
        (64, 320), (1000, 4000), (0, 500), ticks_in(events), strict=True
    ):
        late = np.array(ticks) - phase - period * np.arange(len(ticks))
        assert set(late.tolist()) == set(range(0, late_by + 1, late_by // 64))
        # Even over 65 values: mean and variance within five standard deviations.
        n, mean, variance = len(late), late_by / 2, late_by**2 / 12 * (66 / 64)
        assert abs(late.mean() - mean) < 5 * math.sqrt(variance / n)
        assert abs(late.var() / variance - 1) < 5 * math.sqrt(0.8 / n)
        assert abs(np.corrcoef(late[1:], late[:-1])[0, 1]) < 5 / math.sqrt(n)


def test_late_clocks_are_scheduled_like_any_other(machine):
    wired = jittery(machine, 400_000)
    timeline = build_timeline(wired, seed=8)
    events = listed(timeline)
    slow = Slow(wired.timing.tasks, True, [(0, 0, 0), (1, 0, 0)], [0, 1])
    slow.ticks = [set(ticks) for ticks in ticks_in(events)]
    assert events == slow.play(400_000, 100).events
    for i, report in enumerate(timeline.reports(wired)):
        assert report.cycles == len([1 for task, _ in slow.responses if task == i])
        # The response is counted from when the cycle was due.
        period, phase = wired.timing.tasks[i].period, wired.timing.tasks[i].phase
        worst = max(r + (t - phase) % period for (task, r), t in zip_ends(slow, i))
        assert report.worst_response_s == worst / TICKS_PER_SECOND


def zip_ends(slow, i):
    """Responses of one task, counted from the ticks, beside those ticks."""
    own = [(task, r) for task, r in slow.responses if task == i]
    ends = [t for t, kind, j in slow.events if (kind, j) == (END, i)]
    return [(pair, end - pair[1]) for pair, end in zip(own, ends, strict=True)]


def test_stretches_show_nowhere(machine, monkeypatch):
    whole = listed(build_timeline(jittery(machine, 50_000), seed=1))
    monkeypatch.setattr("hybrid.stretches.CLOCKS", 3)
    timeline = build_timeline(jittery(machine, 50_000), seed=1)
    assert listed(timeline) == whole
    assert listed(build_timeline(jittery(machine, 50_000), seed=2)) != whole


def test_an_overrun_by_chance_stops_the_run(machine):
    # The second task ends 500 + 1500 + at least 600 after its tick: it overruns where its next tick is
    # early. With a compute time of 2700 it has 4000 - 320 at worst and needs 2700 + 4 * 300 at most.
    wired = jittery(machine, 4_000_000, overrun="stop")
    tasks = (wired.timing.tasks[0], replace(wired.timing.tasks[1], compute=2750))
    wired = replace(wired, timing=replace(wired.timing, tasks=tasks))
    timeline = build_timeline(wired, seed=1)
    events = listed(timeline)
    assert "'t1' has overrun" in timeline.why_stopped
    started = [t for t, kind, i in events if (kind, i) == (START, 1)]
    ended = [t for t, kind, i in events if (kind, i) == (END, 1)]
    assert len(started) == len(ended) + 1 and events[-1][0] < 4_000_000
    assert 4000 - 320 <= events[-1][0] - ticks_in(events)[1][-1] <= 4000 + 320


JITTER = """
title: A loop whose clock is late by chance
machine: ideal
analog:
  rate: {integrate: {torque: 1}, initial: 0 rad/s, full_scale: 10 rad/s}
  angle: {integrate: {rate: 1}, initial: 0.1 rad, full_scale: 1 rad}
interface:
  angle_word: {adc: angle}
  torque: {dac: demand, initial: 0, full_scale: 100 rad/s^2}
digital:
  tasks:
    loop: {period: 10 ms, compute_time: 2 ms, jitter: 5 ms, program: {demand: -100*angle_word}}
run: {until: 1 s, every: 10 ms}
"""


@pytest.mark.parametrize("clocks", [7, 2000])
def test_a_jittery_run_is_that_of_its_events(play, monkeypatch, clocks):
    monkeypatch.setattr("hybrid.stretches.CLOCKS", clocks)
    played = play(JITTER, seed=5)
    x, torque, sample, rows, now = np.array([0.1, 0.0]), 0.0, 0.0, [], 0
    for t, kind, _ in listed(build_timeline(played.machine, 5)):
        dt, now = (t - now) / TICKS_PER_SECOND, t
        x = np.array([x[0] + dt * x[1] + dt * dt / 2 * torque, x[1] + dt * torque])
        if kind == Happening.SAMPLE:
            sample = x[0]
        elif kind == Happening.LATCH:
            torque = -100 * sample
        elif kind == Happening.RECORD:
            rows.append(x[0])
    np.testing.assert_allclose(played["angle"], rows, rtol=0, atol=1e-13)
    assert not np.array_equal(played["angle"], play(JITTER, seed=6)["angle"])
    # Done stretches are given up.
    assert all(not segment.events for segment in played.player.segments[:-1])


def test_jitter_on_the_nominal_machine_and_no_prediction(play):
    one, other = (play(JITTER, preset="nominal", seed=5) for _ in range(2))
    np.testing.assert_array_equal(one["angle"], other["angle"])
    ideal = play(JITTER, seed=5)
    assert np.max(np.abs(one["angle"] - ideal["angle"])) < 5e-3
    with pytest.raises(RunError, match="clock of a task jitters"):
        hybrid.predict(parse_patch(JITTER))
    (row,) = hybrid.run(parse_patch(JITTER), seed=5).tasks
    assert row.cycles == 100 and 6e-3 < row.worst_response_s <= 7e-3
    (row,) = hybrid.check(parse_patch(JITTER), trial=False).tasks
    assert row.cycles == 100


def test_when_a_function_was_asked_beyond_its_range_is_known_after_many_stretches(monkeypatch):
    low = "low: 'density_us76(high * max(0, 0.09 - angle_word))'"
    text, found = JITTER.replace("-100*angle_word}", f"-100*angle_word, {low}}}"), []
    text = text.replace("analog:", "parameters: {high: 1e8 m}\nanalog:")
    for clocks in (3, 2000):
        monkeypatch.setattr("hybrid.stretches.CLOCKS", clocks)
        found.append(hybrid.run(parse_patch(text), seed=5).outside)
    assert found[0] == found[1]
    assert 0 < found[0][0]["time_s"] < 0.5 and found[0][0]["times"] > 1


# --- double-buffered DACs --------------------------------------------------------------------------


def test_a_double_buffered_dac_shows_at_the_transfer(play):
    text = TWO_RATES.replace("FAST", "0.25 s").replace("SLOW", "0.5 s")
    text = text.replace("initial: -1}", "initial: -1, transfer: slow}")
    played = play(text)
    # slow ends at 4 j + 0.75, when the last result of fast is that of the cycle of 4 j.
    t = np.arange(25) / 2
    j = np.floor((t - 0.75) / 4)
    m = np.where(j > 0, j, 0)  # fast reads it at 4 j, when slow has ended j times
    np.testing.assert_allclose(played["shown"], np.where(j < 0, -1, 100 * m + 4 * j), atol=1e-12)


# --- theory ----------------------------------------------------------------------------------------


def joseph_and_pandya(tasks, i):
    """Worst response of task i released together with all above it: the least fixed point of
    r = C_i + sum over higher ranks of ceil(r / T_j) C_j (Joseph and Pandya, 1986)."""
    r = tasks[i].compute
    while True:
        new = tasks[i].compute + sum(-(-r // t.period) * t.compute for t in tasks[:i])
        if new == r:
            return r
        r = new


@pytest.mark.parametrize(
    "figures",
    [
        [(7, 3), (12, 3), (20, 5)],
        [(30, 10), (40, 10), (60, 12)],
        [(100, 40), (150, 40), (350, 100)],
        [(5, 1), (7, 2), (11, 2), (13, 1)],
    ],
)
def test_worst_responses_are_those_of_the_analysis(machine, figures):
    tasks = tasks_of(*((period, compute, 0, "skip") for period, compute in figures))
    wired = rewired(machine, tasks, 10 * math.lcm(*(t.period for t in tasks)))
    report = build_timeline(wired).reports(wired)
    for i, task in enumerate(tasks):
        worst = joseph_and_pandya(tasks, i)
        assert worst <= task.period  # else the analysis does not hold
        assert report[i].worst_response_s == worst / TICKS_PER_SECOND
        assert report[i].overruns == 0
        assert report[i].utilisation == task.compute / task.period


def test_without_preemption_a_long_task_blocks_all(machine):
    # A begins at 1 while B computes from 0 to 5; preemptive, B ends at 7.
    tasks = tasks_of((10, 2, 1, "skip"), (20, 5, 0, "skip"))
    ends = {}
    for preemptive in (True, False):
        timeline = build_timeline(rewired(machine, tasks, 9, preemptive=preemptive))
        ends[preemptive] = [(t, kind, i) for t, kind, i in timeline if kind in (START, END)]
    assert ends[True] == [(0, START, 1), (1, START, 0), (3, END, 0), (7, END, 1)]
    assert ends[False] == [(0, START, 1), (5, END, 1), (5, START, 0), (7, END, 0)]


def test_a_task_that_stops_the_run(machine):
    # 3 of 5 and 4 of 10: the second ends at 10 - just in time; with 5 it does not.
    tasks = tasks_of((5, 3, 0, "skip"), (10, 4, 0, "stop"))
    assert build_timeline(rewired(machine, tasks, 10**6)).stopped == ""
    tasks = tasks_of((5, 3, 0, "skip"), (10, 5, 0, "stop"))
    timeline = build_timeline(rewired(machine, tasks, 10**6))
    assert timeline.until == 10 and "'t1' has overrun" in timeline.stopped


# --- what words read -------------------------------------------------------------------------------

TWO_RATES = """
title: A fast and a slow count
machine: ideal
analog:
  ramp: {integrate: {one: 1}, initial: 0, full_scale: 100}
  one: {constant: 1, full_scale: 1}
interface:
  now: {adc: ramp}
  shown: {dac: seen, full_scale: 100, initial: -1}
digital:
  remember: {n: 0}
  tasks:
    fast: {period: 1 s, compute_time: FAST, program: {seen: 100*m + now}}
    slow: {period: 4 s, compute_time: SLOW, program: {n: previous(n) + 1, m: n}}
run: {until: 12 s, every: 0.5 s}
"""


def counts(play, fast, slow):
    return play(TWO_RATES.replace("FAST", fast).replace("SLOW", slow))


def test_a_word_of_another_task_is_its_last_result(play):
    played = counts(play, "0.25 s", "0.5 s")
    # fast: starts at k, ends k + 0.25; slow: starts at 4 j + 0.25, ends 4 j + 0.75. So m is j + 1 from
    # 4 j + 0.75 on, and fast first reads that at 4 j + 1.
    t = np.arange(25) / 2
    m = np.floor((t - 0.75) / 4) + 1
    np.testing.assert_array_equal(played["m"], m)
    k = np.floor(t - 0.25)  # the cycle whose result is shown
    read = np.floor((k - 0.75) / 4) + 1
    np.testing.assert_array_equal(played["seen"], np.where(t < 0.25, 0, 100 * read + k))


def test_the_task_that_follows_at_once_reads_the_new_result(play):
    # With compute times of 0 all is done at the ticks, fast before slow: fast reads m of 4 s ago.
    t = np.arange(25) / 2
    k = np.floor(t)
    played = counts(play, "0 s", "0 s")
    np.testing.assert_array_equal(played["m"], np.floor(t / 4) + 1)
    np.testing.assert_array_equal(played["seen"], 100 * np.ceil(k / 4) + k)
    # The slow one first: fast starts where it ends.
    text = TWO_RATES.replace("FAST", "0 s").replace("SLOW", "0 s")
    text = text.replace("fast: {", "fast: {priority: 1, ").replace(
        "slow: {", "slow: {priority: 2, "
    )
    np.testing.assert_array_equal(play(text)["seen"], 100 * (np.floor(k / 4) + 1) + k)


def test_the_order_of_entries_changes_nothing(play):
    text = TWO_RATES.replace("FAST", "0.25 s").replace("SLOW", "1.5 s")
    lines = text.splitlines()
    at = next(i for i, line in enumerate(lines) if "fast:" in line)
    lines[at], lines[at + 1] = lines[at + 1], lines[at]
    there, back = play(text), play("\n".join(lines))
    for name in ("m", "seen", "n", "now"):
        np.testing.assert_array_equal(there[name], back[name])


def test_one_task_is_the_one_program(play, shipped):
    alone = shipped("pitch_loop")
    begin, end = alone.index("digital:"), alone.index("run:")
    task = "digital:\n  tasks: {only: {period: cycle, compute_time: compute_time, program: "
    program = "{moment: -I_yy * omega_p**2 * alpha_sample}}}\n\n"
    tasks = alone[:begin] + task + program + alone[end:]
    for compute in ("cycle", "0.3*cycle", "0 s"):
        change = ("compute_time: cycle", f"compute_time: {compute}")
        one = play(alone.replace(*change, 1), preset="nominal", seed=3)
        other = play(tasks.replace(*change, 1), preset="nominal", seed=3)
        np.testing.assert_array_equal(one.player.record, other.player.record)


def test_an_adc_is_sampled_by_the_first_that_reads_it(compiled):
    text = TWO_RATES.replace("FAST", "0 s").replace("SLOW", "0 s")
    assert [s.task for s in compiled(text).samplers] == [0]
    both = text.replace("m: n}", "m: n + 0*now}")
    assert [s.task for s in compiled(both).samplers] == [0]
    alone = both.replace("100*m + now", "100*m")
    assert [s.task for s in compiled(alone).samplers] == [1]
    named = both.replace("{adc: ramp}", "{adc: ramp, task: slow}")
    assert [s.task for s in compiled(named).samplers] == [1]
    assert [h.task for h in compiled(text).holders] == [0]


# --- multi-rate loops ------------------------------------------------------------------------------

LOOP = """
title: Two rates in one loop
machine: ideal
parameters: {t: 10 ms}
analog:
  rate: {integrate: {torque: 1}, initial: 0 rad/s, full_scale: 10 rad/s}
  angle: {integrate: {rate: 1}, initial: 0.1 rad, full_scale: 1 rad}
interface:
  angle_word: {adc: angle}
  torque: {dac: demand, initial: 0, full_scale: 100 rad/s^2}
digital:
  tasks:
    fast: {period: t, compute_time: 0.2*t, program: {demand: -100*angle_word + trim}}
    slow: {period: 2*t, phase: PHASE, compute_time: 0.7*t, program: {trim: -20*angle_word}}
run: {until: 4 s, every: 2*t} # rows in between show the ripple of the slow rate
readouts: {mode: {transient: angle}}
"""


def free(t):
    """Over t s: states angle, rate, held torque; angle sample; trim."""
    m = np.eye(5)
    m[:3, :3] = [[1, t, t * t / 2], [0, 1, t], [0, 0, 1]]
    return m


def hand_map(t):
    """x = angle, rate, torque, angle sample, trim over 2 t, in the order of the clockwork.

    fast samples at 0 and t and latches 0.2 t later; slow starts when fast has ended, at 0.2 t, reads the
    sample of 0 and ends at 0.9 t, so that fast sees its trim from t on.
    """
    sample, latch, trim = np.eye(5), np.eye(5), np.eye(5)
    sample[3] = [1, 0, 0, 0, 0]
    latch[2] = [0, 0, 0, -100, 1]
    trim[4] = [0, 0, 0, -20, 0]
    first = free(0.1 * t) @ trim @ free(0.7 * t) @ latch @ free(0.2 * t) @ sample
    second = free(0.8 * t) @ latch @ free(0.2 * t) @ sample
    return second @ first


def test_the_map_of_two_rates_is_the_product_of_its_steps(compiled):
    machine = compiled(LOOP.replace("PHASE", "0 s"))
    change, ticks = only(cycle_maps([machine]))
    assert ticks == 20 * MS
    # In fast the trim is read at its start, and latched when it ends; here trim ends after the latch.
    expected = np.linalg.eigvals(hand_map(0.01))
    found = np.linalg.eigvals(np.eye(len(change)) + change)
    big = sorted(expected[np.abs(expected) > 1e-3], key=lambda z: (z.real, z.imag))
    own = sorted(found[np.abs(found) > 1e-3], key=lambda z: (z.real, z.imag))
    np.testing.assert_allclose(own, big, rtol=0, atol=1e-12)


@pytest.mark.parametrize("phase", ["0 s", "0.4*t", "1.9*t"])
def test_a_run_has_the_predicted_mode(phase):
    patch = parse_patch(LOOP.replace("PHASE", phase))
    measured = hybrid.run(patch).readouts["mode"]
    (mode,) = hybrid.predict(patch).modes
    # Rows a stretch apart see powers of one matrix, so rounding is all that is left.
    assert measured["omega"] == pytest.approx(mode.omega, rel=1e-12)
    assert measured["zeta"] == pytest.approx(mode.zeta, rel=0, abs=1e-12)
    # Meant, with T -> 0, is omega^2 = 120 undamped.
    assert mode.omega_ideal == pytest.approx(math.sqrt(120), rel=1e-12) and mode.zeta_ideal == 0


def test_tasks_that_leave_cycles_out_come_back_later(compiled):
    # fast has 0.2 of every t, so slow ends 2.1 t after it began, with its next tick left out: only
    # every second one begins a cycle.
    text = LOOP.replace("PHASE", "0 s").replace("0.7*t", "1.7*t")
    assert only(cycle_maps([compiled(text)]))[1] == 40 * MS


def test_no_single_cycle_time_to_find():
    with pytest.raises(RunError, match=r"sweep one instead: --over .* with \w+\.period or"):
        hybrid.predict(parse_patch(LOOP.replace("PHASE", "0 s")), max_damping_error=0.01)


def test_rate_groups_have_the_mode_of_their_header(shipped):
    # Delays from sample to moment, by hand: of the rate 0.5 ms and half a hold; of the angle until the
    # outer task is done (7 ms), the inner one has read that (8 ms) and shows it (8.5 ms), held 20 ms.
    k_rate, k_angle, d1, d2 = math.sqrt(200), math.sqrt(50), 1.5e-3, 18.5e-3
    square = d2**2 + 20e-3**2 / 12
    first = 1 - k_rate * d1 + 100 * square / 2
    omega = math.sqrt(k_rate * k_angle / first)
    zeta = (k_rate - 100 * d2) / first / (2 * omega)
    text = shipped("rate_groups")
    assert "omega = 10.01 rad/s" in text and round(omega, 2) == 10.01
    assert "zeta = 0.615" in text and round(zeta, 3) == 0.615
    patch = parse_patch(text)
    (mode,) = hybrid.predict(patch).modes
    third = (10 * d2) ** 3 / 6  # what the series leaves out
    assert abs(mode.omega / omega - 1) < third and abs(mode.zeta - zeta) < third
    assert f"{mode.omega:.4f} rad/s, {mode.zeta:.5f}" in text
    measured = hybrid.run(patch).readouts["pitch_mode"]
    assert measured["omega"] == pytest.approx(mode.omega, rel=1e-12)
    assert measured["zeta"] == pytest.approx(mode.zeta, rel=1e-12)


def test_rate_groups_are_timed_as_their_header_says(compiled, shipped):
    machine = compiled(shipped("rate_groups"))
    outer, inner = build_timeline(machine).reports(machine)
    assert (inner.task, inner.worst_response_s) == ("rate_loop", 0.5e-3)
    assert (outer.task, outer.worst_response_s) == ("attitude_loop", 7e-3)


def test_what_tasks_remember_is_in_the_map():
    # Each task has delays of its own, of one cycle and of several.
    text = LOOP.replace("PHASE", "0.3*t").replace(
        "  tasks:\n", "  remember: {old: 0, trim: 0, demand: 0}\n  tasks:\n"
    )
    text = text.replace(
        "-100*angle_word + trim", "'-100*angle_word + 0.2*previous(demand, 3) + trim'"
    )
    text = text.replace(
        "{trim: -20*angle_word}",
        "{old: angle_word, trim: '-15*previous(old, 2) + 0.3*previous(trim)'}",
    )
    patch = parse_patch(text)
    measured = hybrid.run(patch).readouts["mode"]
    mode = min(hybrid.predict(patch).modes, key=lambda m: abs(m.omega - measured["omega"]))
    assert measured["omega"] == pytest.approx(mode.omega, rel=1e-10)
    assert measured["zeta"] == pytest.approx(mode.zeta, rel=0, abs=1e-10)


# --- mistakes --------------------------------------------------------------------------------------

WRONG = {
    "both": ("  tasks:\n", "  period: t\n  tasks:\n", 11, "both tasks and period"),
    "previous": ("demand: -100*angle_word + trim", "demand: previous(trim)", 12, "of another task"),
    "priority": ("slow: {", "slow: {priority: 3, ", 12, "'fast' has no priority"),
    "key": ("slow: {", "slow: {perod: 3, ", 13, "did you mean 'period'"),
    "no compute time": (", compute_time: 0.7*t", "", 13, "no compute_time"),
    "overrun": (
        "slow: {",
        "slow: {overrun: wait, ",
        13,
        "overrun is 'wait'; valid: skip, queue, stop",
    ),
    "unknown task": ("{adc: angle}", "{adc: angle, task: quick}", 8, "unknown task 'quick'"),
    "scheduling": ("  tasks:\n", "  scheduling: fair\n  tasks:\n", 11, "scheduling is 'fair'"),
    "jitter": ("slow: {", "slow: {jitter: 2*t, ", 13, "must be shorter than the period"),
    "transfer": ("initial: 0, full", "initial: 0, transfer: slw, full", 9, "did you mean 'slow'"),
    "full": ("slow: {", "slow: {overrun: queue, compute_time: 2*t, ", 13, "twice"),
    "no words": ("{trim: -20*angle_word}", "{}", 13, "no words"),
    "long conversion": (
        "{adc: angle}",
        "{adc: angle, conversion_time: t}",
        8,
        "not shorter than the",
    ),
    "a list": (
        "{period: t, compute_time: 0.2*t, program: {demand: -100*angle_word + trim}}",
        "3",
        12,
        "map",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_mistake_has_its_line(name, compiled):
    old, new, line, says = WRONG[name]
    text = LOOP.lstrip("\n").replace("PHASE", "0 s")
    assert old in text
    with pytest.raises(PatchError) as raised:
        compiled(text.replace(old, new, 1))
    assert f":{line}: " in str(raised.value) and says in str(raised.value)


def test_a_processor_that_is_asked_for_too_much(compiled):
    text = LOOP.lstrip("\n").replace("PHASE", "0 s").replace("0.7*t", "1.7*t")
    with pytest.raises(PatchError, match=r"ask for 105 % of the processor's time.*queue"):
        compiled(text.replace("slow: {", "slow: {overrun: queue, "))
    machine = compiled(text)  # skip leaves cycles out
    assert build_timeline(machine).reports(machine)[1].overruns > 0


def test_a_run_says_that_the_processor_is_asked_for_too_much():
    text = LOOP.lstrip("\n").replace("PHASE", "0 s").replace("0.7*t", "1.7*t")
    result = hybrid.run(parse_patch(text))
    assert (
        result.status == "complete"
        and "ask for 105 % of the processor's time" in result.status_note
    )
    # At 100 %, but for the rounding of three terms, nobody asks for too much.
    whole = hybrid.run(parse_patch(text.replace("1.7*t", "1.6*t")))
    assert "processor" not in whole.status_note


def test_check_says_which_matrix_there_is():
    text = LOOP.replace("PHASE", "0 s")
    told = hybrid.check(parse_patch(text), trial=False).prediction
    assert told.startswith(
        "the exact matrix over 0.02 s, after which all tasks are where they were ("
    )
    # In this one every second cycle of the slow task is left out.
    told = hybrid.check(parse_patch(text.replace("0.7*t", "1.7*t")), trial=False).prediction
    assert told.startswith("the exact matrix over 0.04 s")
    apart = text.replace("period: 2*t", "period: 20.00000000001 ms")
    told = hybrid.check(parse_patch(apart), trial=False).prediction
    assert "no exact prediction" in told and "no short common multiple" in told
    with pytest.raises(RunError, match="no short common multiple, so there is no exact map"):
        hybrid.predict(parse_patch(apart))
