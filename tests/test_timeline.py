"""The timeline against a brute-force list of events, and what coincident events do to the values."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hybrid
import hybrid.timeline as timeline_module
from hybrid.compiler import compile_patch
from hybrid.cycle_map import _loop, cycle_maps
from hybrid.errors import PatchError
from hybrid.machine import Holder, Sampler, StepEvent, Timing
from hybrid.memo import KeptBySize
from hybrid.patchfile import parse_patch
from hybrid.scale import TICKS_PER_SECOND, row_times_s, to_seconds, to_ticks
from hybrid.timeline import Happening, build_timeline

MS = TICKS_PER_SECOND // 1000
ORDER = ("SAMPLE", "CONVERT", "START", "END", "LATCH", "SOURCE", "RECORD")
PIPES = {  # periods of computing
    "none": 0,
    "half": Fraction(1, 2),
    "one": 1,
    "two and a half": Fraction(5, 2),
    "seven": 7,
}


@pytest.fixture(scope="module")
def machine(shipped, compiled):
    """The pitch loop, whose clockwork the tests replace."""
    return compiled(shipped("pitch_loop"))


def rewired(machine, timing, adcs=(), dacs=1, steps=()):
    """The machine with other timing; `adcs` lists (delay, conversion), `steps` their times."""
    samplers = [Sampler(f"s{i}", 0, 1.0, 1.0, 0.0, False, d, c) for i, (d, c) in enumerate(adcs)]
    holders = [Holder(f"h{i}", 0, 1, 1.0, 0.0, False) for i in range(dacs)]
    changes = [StepEvent(f"step{i}", 1, 1.0, tick) for i, tick in enumerate(steps)]
    parts = {"samplers": tuple(samplers), "holders": tuple(holders), "steps": tuple(changes)}
    return replace(machine, timing=timing, **parts)


def brute_force(timing, adcs, dacs, steps):
    """Every event up to the end, from the definition: sorted by time, written order, index."""
    events = [(tick, 5, i) for i, tick in enumerate(steps)]
    events += [(tick, 6, 0) for tick in range(0, timing.until + 1, timing.every)]
    for begin in range(0, timing.until + 1, timing.period) if timing.period else ():
        events += [(begin + delay, 0, i) for i, (delay, _) in enumerate(adcs)]
        events += [(begin + delay + conversion, 1, i) for i, (delay, conversion) in enumerate(adcs)]
        ready = begin + max((delay + conversion for delay, conversion in adcs), default=0)
        events += [(ready, 2, 0), (ready + timing.compute, 3, 0)]
        events += [(ready + timing.compute, 4, i) for i in range(dacs)]
    return sorted(event for event in events if event[0] <= timing.until)


def listed(timeline):
    return [(t, int(kind), i) for t, kind, i in timeline if kind != Happening.REST]


def check_against_brute_force(machine, timing, adcs=(), dacs=1, steps=()):
    timeline = build_timeline(rewired(machine, timing, adcs, dacs, steps))
    assert listed(timeline) == brute_force(timing, adcs, dacs, steps)
    check_segments(timeline, timing)
    return timeline


def check_segments(timeline, timing):
    """Back to back, events inside and in order, each stretch ending in a rest."""
    at = 0
    for segment in timeline.segments:
        assert segment.start == at and segment.repeats >= 1
        assert segment.events[-1] == (segment.length, Happening.REST, 0)
        assert list(segment.events) == sorted(segment.events)
        at += segment.length * segment.repeats
    assert at == timeline.until == timing.until


# --- the written order ---------------------------------------------------------------------------


def test_written_order():
    assert tuple(h.name for h in sorted(Happening))[:-1] == ORDER
    assert max(Happening) is Happening.REST


@given(
    period=st.integers(0, 12),
    every=st.integers(1, 15),
    until=st.integers(1, 300),
    compute=st.integers(0, 40),
    adcs=st.lists(st.tuples(st.integers(0, 15), st.integers(0, 15)), max_size=3),
    dacs=st.integers(0, 2),
    steps=st.lists(st.integers(0, 320), max_size=3),
)
@settings(max_examples=300, deadline=None, derandomize=True)
def test_any_timeline_equals_brute_force(machine, period, every, until, compute, adcs, dacs, steps):
    # Small whole ticks make coincidences of every kind common; tiled and flat layouts both occur.
    timing = Timing(period, compute if period else 0, every, until)
    steps = sorted(step for step in steps if step <= until)
    if not period:
        adcs, dacs = [], 0
    timeline = check_against_brute_force(machine, timing, adcs, dacs, steps)
    assert timeline.rows == sum(kind == Happening.RECORD for _, kind, _ in timeline)
    assert timeline.cycles == (until // period if period else 0)


@pytest.mark.parametrize("periods", PIPES.values(), ids=PIPES)
def test_compute_time_in_periods(machine, periods):
    timing = Timing(2 * MS, int(2 * MS * periods), 2 * MS, 301 * MS)
    timeline = check_against_brute_force(machine, timing, [(0, 0)])
    assert any(segment.repeats > 100 for segment in timeline.segments)
    starts = [t for t, kind, _ in timeline if kind == Happening.START]
    ends = [t for t, kind, _ in timeline if kind == Happening.END]
    assert len(starts) == 151 and len(ends) == (301 * MS - timing.compute) // (2 * MS) + 1
    assert {e - s for s, e in zip(starts, ends, strict=False)} == {timing.compute}


def test_conversion_time_and_channels_with_skew(machine):
    timing = Timing(10 * MS, 25 * MS, 4 * MS, 2003 * MS)
    adcs = [(2 * MS, 300), (0, 700), (5 * MS, 0)]
    timeline = check_against_brute_force(
        machine, timing, adcs, dacs=2, steps=[0, 20 * MS, 777 * MS]
    )
    # The record interval and the period meet every 20 ms: that stretch is what repeats.
    assert {segment.length for segment in timeline.segments if segment.repeats > 1} == {20 * MS}


def test_steps_break_the_repetition_and_no_more(machine):
    timing = Timing(MS, MS, MS, 1000 * MS)
    steps = [0, MS, 499 * MS, 500 * MS + 1, 500 * MS + 1, 700 * MS, 1000 * MS]
    timeline = check_against_brute_force(machine, timing, [(0, 0)], steps=steps)
    assert len(timeline.segments) <= 2 + 2 * 4
    late = check_against_brute_force(machine, timing, [(0, 0)], steps=[])
    assert listed(late) == [e for e in listed(timeline) if e[1] != Happening.SOURCE]
    dropped = build_timeline(rewired(machine, timing, [(0, 0)], steps=[1000 * MS + 1]))
    assert listed(dropped) == listed(late)


@pytest.mark.parametrize("until", [1, MS - 1, MS, MS + 1, 10 * MS, 1000 * MS - 1, 1000 * MS + 1])
def test_end_that_is_no_multiple_of_the_period(machine, until):
    check_against_brute_force(machine, Timing(MS, MS // 2, MS, until), [(0, 0)])


def test_analog_machine_alone(machine):
    timeline = check_against_brute_force(machine, Timing(0, 0, 7, 1000), dacs=0, steps=[3, 14, 15])
    assert timeline.cycles == 0 and timeline.rows == 143


def test_digital_machine_without_converters(machine):
    check_against_brute_force(machine, Timing(3, 4, 5, 200), adcs=[], dacs=0)


# --- exact time ----------------------------------------------------------------------------------


def nth(timeline, kind, number):
    """Tick of event `number` (from 0) of a kind, from the segments alone."""
    for segment in timeline.segments:
        offsets = [offset for offset, k, _ in segment.events if k == kind]
        if number < len(offsets) * segment.repeats:
            repeat, place = divmod(number, len(offsets))
            return segment.start + repeat * segment.length + offsets[place]
        number -= len(offsets) * segment.repeats
    raise AssertionError("no such event")


def clock_of(period, until, **more):
    text = "\n".join(f"  {key}: {value}" for key, value in more.items())
    return parse_patch(f"""
title: A clock
parameters: {{T: {period}}}
digital:
  period: T
  compute_time: T
  program: {{tick: 1}}
run:
  until: {until}
{text}
""")


@pytest.mark.parametrize(
    ("period", "ticks"),
    [
        ("0.1 ms", 10**11),
        ("1/3e3", 333_333_333_333),  # to the nearest femtosecond
        ("0.7 us", 7 * 10**8),
        ("1 ns", 10**6),
        ("0.3", 3 * 10**14),
    ],
)
def test_event_k_is_at_k_periods_after_1e8_cycles(period, ticks, compiled):
    until_s = 1e8 * ticks / 1e15
    machine = compiled(clock_of(period, repr(until_s)).text)
    timeline = build_timeline(machine)
    assert machine.timing.period == ticks
    # 1e8 periods of 1/3 ms, to the nearest femtosecond each, end 33 ns before the run does.
    assert abs(timeline.cycles - 10**8) <= 1
    assert len(timeline.segments) <= 4
    for k in (0, 1, 2, 3, 12_345, 99_999_999):
        assert nth(timeline, Happening.START, k) == k * ticks
        assert nth(timeline, Happening.RECORD, k) == k * ticks
        if k:
            assert nth(timeline, Happening.END, k - 1) == k * ticks


@given(st.integers(1, 10**9), st.integers(0, 14), st.integers(1, 10**6))
@settings(max_examples=300, derandomize=True)
def test_multiples_of_a_period_land_on_its_ticks(mantissa, places, factor):
    # Arithmetic in floats such as 3 * 0.1 must not move an instant. The period is a decimal of at
    # most 15 digits that is a whole number of femtoseconds; so is its multiple.
    exact = Fraction(mantissa, 10**places)
    period_s = float(exact)
    assert to_ticks(period_s) == exact * TICKS_PER_SECOND
    if mantissa * factor < 10**15:
        assert to_ticks(factor * period_s) == factor * to_ticks(period_s)
        assert to_ticks((factor * period_s) / factor) == to_ticks(period_s)


@given(st.integers(0, 10**20))
@settings(derandomize=True)
def test_seconds_are_the_nearest_float(ticks):
    assert to_seconds(ticks) == float(Fraction(ticks, TICKS_PER_SECOND))


@given(st.integers(0, 10**15 - 1))
@settings(derandomize=True)
def test_ticks_of_seconds_come_back(ticks):
    assert to_ticks(to_seconds(ticks)) == ticks


def test_sources_without_common_multiple_are_refused_when_long(compiled):
    text = UNTIMED.replace("PERIOD", "0.9999999999 ms")
    with pytest.raises(PatchError, match=r"period of .*make it, the record interval"):
        build_timeline(compiled(text))


UNTIMED = """
title: A wave beside rows that it never meets
machine: ideal
analog:
  w: {square: 1, period: PERIOD, full_scale: 1}
  x: {integrate: {w: 1}, initial: 0, full_scale: 1}
run: {until: 5000 s, every: 1 ms}
"""

SELDOM = {  # period, compute, every, until, ADCs
    "less than a period": (1000, 300, 997, 400_000, [(0, 0), (10, 100)]),
    "several periods": (997, 2500, 1000, 400_000, [(0, 100)]),
    "no time at all": (1009, 0, 499, 400_000, []),
    "late samples": (1000, 1000, 701, 400_000, [(3000, 5), (0, 0)]),
}


@pytest.mark.parametrize("given", SELDOM.values(), ids=SELDOM)
def test_a_program_whose_rows_seldom_meet_it_is_laid_out_in_stretches(machine, monkeypatch, given):
    *times, adcs = given
    timing = Timing(*times)
    monkeypatch.setattr("hybrid.timeline.MOST_INTERVALS", 100)
    monkeypatch.setattr("hybrid.timeline._kept", KeptBySize(10**6, lambda timeline: 1))
    timeline = build_timeline(rewired(machine, timing, adcs=adcs, steps=[1234, 222_222]))
    assert timeline.later is not None
    assert (timeline.rows, timeline.cycles) == (
        timing.until // timing.every + 1,
        timing.until // timing.period,
    )
    events = list(timeline)
    assert sum(kind == Happening.REST for _, kind, _ in events) > 10  # one a stretch
    found = [event for event in events if event[1] != Happening.REST]
    assert found == brute_force(timing, adcs, 1, [1234, 222_222])


def test_that_clocks_seldom_meet_is_found_out_once(shipped, monkeypatch):
    """A check, the run and what it tells ask again and again; laying out in vain takes long."""
    laid_out, tried = timeline_module._laid_out, []
    monkeypatch.setattr(timeline_module, "MOST_INTERVALS", 200)
    monkeypatch.setattr(timeline_module, "_kept", KeptBySize(10**6, lambda timeline: 1))
    monkeypatch.setattr(timeline_module, "_laid_out", lambda m: (tried.append(m), laid_out(m))[1])
    patch = parse_patch(shipped("pitch_loop", ("until: 10 s", "until: 1 s, every: 0.9997 ms")))
    machine = compile_patch(patch)
    assert timeline_module.seldom_text(machine).startswith(
        "the period 0.001 s and the record interval"
    )
    assert hybrid.run(machine).cycles == 1000
    assert len(tried) == 1


@pytest.mark.parametrize("name", ["ideal", "nominal"])
def test_a_program_in_stretches_plays_the_same_bits(name, shipped, monkeypatch):
    patch = parse_patch(shipped("pitch_loop", ("until: 10 s", "until: 1 s, every: 0.9997 ms")))
    at_once = hybrid.run(patch, machine=name, seed=3)
    monkeypatch.setattr("hybrid.timeline.MOST_INTERVALS", 200)
    monkeypatch.setattr("hybrid.timeline._kept", KeptBySize(10**6, lambda timeline: 1))
    in_stretches = hybrid.run(patch, machine=name, seed=3)
    assert build_timeline(compile_patch(patch), 3).later is not None
    assert in_stretches.record.identical(at_once.record)


FEW_ROWS = {  # period, compute, every, until: from one row to the next there is much to lay out
    "multiple": (1000, 1000, 1_000_000, 3_005_000),
    "short run": (1000, 300, 1_000_000, 1_500_000),
    "no multiple": (997, 2500, 1_000_000, 3_005_000),
}


@pytest.mark.parametrize("given", FEW_ROWS.values(), ids=FEW_ROWS)
def test_few_rows_interrupt_what_repeats(machine, monkeypatch, given):
    # From row to row there are 1,000 cycles that are all alike, 5,000 events.
    monkeypatch.setattr("hybrid.timeline.MOST_FLAT_EVENTS", 3000)
    timing, adcs, steps = Timing(*given), [(0, 100)], [1_234_567]
    timeline = build_timeline(rewired(machine, timing, adcs=adcs, steps=steps))
    assert timeline.rows == timing.until // timing.every + 1
    assert timeline.cycles == timing.until // timing.period
    assert sum(len(segment.events) for segment in timeline.segments) < 200
    assert listed(timeline) == brute_force(timing, adcs, 1, steps)


# --- clocks that come together too seldom ---------------------------------------------------------

UNRELATED = """
title: Two tasks whose clocks come together every 10.007 s
machine: MACHINE
parameters: {k: 14 1/s, k_angle: 7 1/s}
analog:
  rate: {integrate: {M: 1}, initial: 0 rad/s, full_scale: 1 rad/s}
  angle: {integrate: {rate: 1}, initial: 0.1 rad, full_scale: 0.2 rad}
  kick: {square: 0.1 rad/s, period: 0.0973 s, full_scale: 1 rad/s}
interface:
  r: {adc: rate, conversion_time: 0.05 ms}
  a: {adc: angle}
  M: {dac: moment, full_scale: 12 rad/s^2, initial: 0 rad/s^2}
digital:
  tasks:
    fast: {period: 1 ms, phase: 0.1 ms, compute_time: 0.3 ms, program: {moment: -k*(r - demand)}}
    slow: {period: 1.0007 ms, compute_time: 0.7 ms, overrun: OVERRUN, program: {demand: -k_angle*a}}
run: {until: 0.6 s, every: 10 ms}
"""


@pytest.mark.parametrize("overrun", ["skip", "queue", "stop"])
@pytest.mark.parametrize("name", ["ideal", "nominal"])
def test_a_run_is_the_same_to_the_last_bit_however_it_is_laid_out(monkeypatch, name, overrun):
    """At once, and in stretches of 20 clock ticks of which the engine keeps 200 intervals."""
    patch = parse_patch(UNRELATED.replace("MACHINE", name).replace("OVERRUN", overrun))
    at_once = hybrid.run(patch, seed=3)
    kept = KeptBySize(10**6, lambda timeline: 1)
    monkeypatch.setattr("hybrid.timeline.MOST_INTERVALS", 200)
    monkeypatch.setattr("hybrid.timeline._kept", kept)
    timeline = build_timeline(compile_patch(patch), 3)
    assert timeline.later is not None
    lengths = [segment.length for segment in timeline.further()]
    assert len(lengths) > 20 or overrun == "stop"
    assert sum(lengths) == timeline.later.stopped.tick if timeline.later.stopped else timeline.until
    in_stretches = hybrid.run(patch, seed=3)
    assert in_stretches.record.identical(at_once.record)
    assert in_stretches.tasks == at_once.tasks and in_stretches.status == at_once.status
    assert (in_stretches.cycles, in_stretches.overloads) == (at_once.cycles, at_once.overloads)


def test_a_prediction_follows_no_more_results_than_are_on_their_way():
    """1,001 and 1,000 cycles to a stretch: a map of a few figures."""
    text = UNRELATED.replace("MACHINE", "ideal").replace("OVERRUN", "skip")
    machine = compile_patch(parse_patch(text.replace("1.0007 ms", "1.001 ms")))
    loop = _loop(machine)
    assert len(loop.events) > 9000 and sum(loop.sizes) < 20
    found = cycle_maps([machine])[0]
    assert found.ticks == to_ticks(1.001) and found.change.shape[0] < 12


# --- the values at an instant --------------------------------------------------------------------

COUNTER = """
title: A ramp of 1 unit a second, sampled and shown again
machine: ideal
analog:
  one: {step: 1, at: 0 s, full_scale: 16}
  ramp: {integrate: {rate: 1}, initial: 0, full_scale: 128}
  rate: {step: 0, at: 7 s, before: 1, full_scale: 16}
  jump: {step: 5, at: 3 s, before: 2, full_scale: 16}
interface:
  s: {adc: jump}
  r: {adc: ramp}
  e: {adc: echo}
  echo: {dac: w, full_scale: 128, initial: -1}
digital:
  period: 1 s
  compute_time: COMPUTE
  program: {w: r + 1, seen: s, held: e}
run: {until: 10 s}
"""


def test_sample_sees_before_and_record_shows_after(play):
    played = play(COUNTER.replace("COMPUTE", "0 s"))
    t = np.arange(11.0)
    np.testing.assert_array_equal(played["ramp"], np.minimum(t, 7))
    # The record shows x+: at 3 s the new value, at 0 s the source that changes at once.
    np.testing.assert_array_equal(played["jump"], np.where(t < 3, 2, 5))
    np.testing.assert_array_equal(played["one"], np.ones(11))
    np.testing.assert_array_equal(played["rate"], np.where(t < 7, 1, 0))
    # The sample sees x-: at 3 s the old one.
    np.testing.assert_array_equal(played["seen"], np.where(t <= 3, 2, 5))
    # With no compute time the answer to the sample at t is shown at t, but a sample of the DAC taken
    # at t sees what was held until then.
    np.testing.assert_array_equal(played["echo"], np.minimum(t, 7) + 1)
    np.testing.assert_array_equal(played["held"], [-1, *played["echo"][:-1]])


@pytest.mark.parametrize("periods", [0, 1, 2, 7])
def test_answers_come_after_whole_periods(periods, play):
    played = play(COUNTER.replace("COMPUTE", f"{periods} s"))
    expected = [-1] * periods + [min(k, 7) + 1 for k in range(11 - periods)]
    np.testing.assert_array_equal(played["echo"], expected)
    # A word reads 0 until the first result is there.
    np.testing.assert_array_equal(played["w"], [0] * periods + expected[periods:])


def test_answers_come_after_two_periods_and_a_half(play):
    played = play(COUNTER.replace("COMPUTE", "2.5 s").replace("10 s}", "10 s, every: 0.5 s}"))
    t = np.arange(21) / 2
    sampled = np.minimum(np.floor(t - 2.5), 7)
    np.testing.assert_array_equal(played["echo"], np.where(t < 2.5, -1, sampled + 1))


@pytest.mark.parametrize("conversion", ["0.25 s", "0.75 s"])
def test_conversion_time_delays_the_word_not_the_sample(conversion, play):
    text = COUNTER.replace("COMPUTE", "0 s").replace(
        "{adc: ramp}", f"{{adc: ramp, conversion_time: {conversion}}}"
    )
    played = play(text.replace("10 s}", "10 s, every: 0.25 s}"))
    t = np.arange(41) / 4
    done = np.floor(t - float(conversion.split()[0]))
    np.testing.assert_array_equal(played["r"], np.where(done < 0, 0, np.minimum(done, 7)))
    np.testing.assert_array_equal(played["echo"], np.where(done < 0, -1, np.minimum(done, 7) + 1))


@pytest.mark.parametrize("conversion", ["1 s", "1.5 s"])
def test_conversion_longer_than_the_period_is_refused(conversion, compiled):
    # The next sample would overwrite the one still being converted, and the delay would vanish.
    text = COUNTER.replace("COMPUTE", "0 s").replace(
        "{adc: ramp}", f"{{adc: ramp, conversion_time: {conversion}}}"
    )
    with pytest.raises(PatchError, match=r":11: .*conversion_time.*not shorter than the period"):
        compiled(text)


def test_skew_moves_the_sample(play):
    text = COUNTER.replace("COMPUTE", "0 s").replace("{adc: ramp}", "{adc: ramp, channel: 3}")
    played = play(text.replace("compute_time: 0 s", "compute_time: 0 s\n  skew: 0.25 s"))
    t = np.arange(11.0)
    # Sampled at k + 0.75: the word of the row at t is that of the cycle before.
    expected = np.where(t == 0, 0, np.minimum(t - 0.25, 7))
    np.testing.assert_array_equal(played["r"], expected)
    np.testing.assert_array_equal(played["echo"], np.where(t == 0, -1, expected + 1))


def test_neighbouring_and_other_channels_that_coincide(play):
    # a and c sample together, b between them in name and a quarter of a cycle later.
    text = COUNTER.replace("COMPUTE", "0.5 s").replace(
        "  r: {adc: ramp}",
        "  r: {adc: ramp}\n  a: {adc: ramp}\n  b: {adc: ramp, channel: 1}\n  c: {adc: ramp}",
    )
    text = text.replace("compute_time: 0.5 s", "compute_time: 0.5 s\n  skew: 0.25 s")
    text = text.replace("{w: r + 1,", "{w: 4*a + 2*b + c, ")
    played = play(text.replace("10 s}", "10 s, every: 0.25 s}"))
    t = np.arange(41) / 4
    whole, later = np.minimum(np.floor(t), 7), np.minimum(np.floor(t - 0.25) + 0.25, 7)
    np.testing.assert_array_equal(played["a"], whole)
    np.testing.assert_array_equal(played["c"], whole)
    np.testing.assert_array_equal(played["b"], np.where(t < 0.25, 0, later))
    # Computed from 0.25 on, shown 0.5 later.
    cycle = np.floor(t - 0.75)
    answer = 4 * np.minimum(cycle, 7) + 2 * np.minimum(cycle + 0.25, 7) + np.minimum(cycle, 7)
    np.testing.assert_array_equal(played["w"], np.where(t < 0.75, 0, answer))


def test_overloads_count_the_instants_beyond(play):
    # The ramp goes on to 30, each sample held from 0.5 s later on: beyond 16 on either side of an
    # instant counts that instant once, whatever happens at it.
    text = COUNTER.replace("COMPUTE", "0.5 s").replace("at: 7 s, before: 1", "at: 30 s, before: 1")
    text = text.replace("echo: {dac: w, full_scale: 128", "echo: {dac: w, full_scale: 16")
    played = play(text.replace("run: {until: 10 s}", "run: {until: 40 s, every: 0.4 s}"))
    instants = sorted({t for t, *_ in played.player.timeline})

    def shown(half):  # in half seconds, just after
        return -1 if half < 1 else min((half - 1) // 2, 30) + 1

    halves = [t / (TICKS_PER_SECOND / 2) for t in instants]
    beyond = [shown(math.floor(h)) > 16 or shown(math.ceil(h) - 1) > 16 for h in halves]
    found = {overload.signal: overload for overload in played.player.overloads()}["echo"]
    assert found.instants == sum(beyond)
    assert found.time_s == to_seconds(instants[beyond.index(True)]) == 16.5
    assert found.worst_mu == 31 / 16 and found.worst_time_s == 30.5


def test_ties_in_name_order_and_all_before_the_record(play):
    # Two sources change at the instant at which a DAC latches and a row is taken.
    text = COUNTER.replace("COMPUTE", "1 s").replace("at: 7 s", "at: 3 s")
    played = play(text)
    assert (played["rate"][3], played["jump"][3], played["echo"][3]) == (0, 5, 3)
    assert (played["seen"][3], played["ramp"][3]) == (2, 3)


def test_a_program_alone_counts_its_cycles(play):
    text = """
title: A counter
digital:
  period: 1 s
  remember: {n: 0}
  program: {n: previous(n) + 1}
run: {until: 5 s}
"""
    # The first result, 1, is there after one cycle.
    np.testing.assert_array_equal(play(text)["n"], [0, 1, 2, 3, 4, 5])


@pytest.mark.parametrize("every_s", [0.1, 1e-3, 1.3e-3, 1 / 3, 1.234567890123457e-3, 7e3])
def test_rows_are_at_the_nearest_floats(every_s):
    ticks = to_ticks(every_s)
    times_s = row_times_s(5000, ticks)
    assert times_s.tolist() == [to_seconds(k * ticks) for k in range(5000)]


def test_a_window_ends_with_the_row_at_its_end():
    text = """
title: A ramp that is read in parts
machine: ideal
analog:
  one: {constant: 1, full_scale: 1}
  ramp: {integrate: {one: 1 1/s}, initial: 0, full_scale: 2}
run: {until: 1 s, every: 0.1 s}
readouts:
"""
    parts = "".join(f"  r{k}: {{final: ramp, until: {k / 10} s}}\n" for k in range(1, 11))
    parts += "".join(f"  s{k}: {{minimum: ramp, from: 0.{k} s}}\n" for k in range(1, 10))
    readouts = hybrid.run(hybrid.parse_patch(text + parts)).readouts
    for k in range(1, 11):
        assert readouts[f"r{k}"]["time_s"] == k / 10
    for k in range(1, 10):
        assert readouts[f"s{k}"]["time_s"] == float(f"0.{k}")
