"""What comes to rest: without lags the jumps of a ball add up to a finite time, and the run says so.

The ball falls on a floor that turns its velocity v into -e v. A comparator tells that it is above the
floor; where it is not, the integrator of v is reset to what two parts keep of the velocity before.
"""

import math
import re

import pytest

import hybrid

G, H, SPEED = 9.81, 1.0, 10.0
BALL = """
title: A ball on a hard floor
parameters: {g: 9.81 m/s^2, h: 1 m, e: 0.5, speed: 10}
analog:
  y: {integrate: {v: speed}, initial: h, full_scale: 1 m}
  v: {integrate: {weight: -speed}, initial: rebound, reset_when: hit, full_scale: 5 m/s}
  weight: {constant: g, full_scale: 10 m/s^2, unit: m/s^2}
  free: {compare: {y: 1}, high: 1, full_scale: 1}
  # The store keeps before the velocity jumps, and follows after it has: three levels, one order.
  hit: {compare: {free: -1}, threshold: -0.3, high: 1, full_scale: 1}
  follows: {compare: {free: 1, hit: -1}, threshold: 0.5, high: 1, full_scale: 1}
  impact: {track: v, control: follows, full_scale: 5 m/s}
  rebound: {sum: {impact: -e}, full_scale: 5 m/s}
run: {until: 6/speed, every: 0.002/speed}
record: [y, v]
"""


def end_of_jumps_s(e):
    """First impact after t0 = sqrt(2 h / g), then flights of 2 t0 e^n: t0 (1 + e) / (1 - e) in all."""
    return math.sqrt(2 * H / G) * (1 + e) / (1 - e) / SPEED


def played(e, machine):
    return hybrid.run(hybrid.parse_patch(BALL), {"e": e}, machine=machine)


@pytest.mark.parametrize("e", [0.3, 0.5, 0.8])
def test_jumps_that_add_up_end_the_run_with_their_end(e):
    """The statement's figures against the closed form.

    The jumps are followed until the height, 1 m to a full scale, is below 1e-9, so at least until the
    velocity u = sqrt(2 g 1e-9). An impact is located to 1e-12 of full scale, d = 1e-12 / (10 u) s at
    the worst. What one is off by shifts all later ones, and changes the length of what is left, 2 u e /
    (g (1 - e)), by 2 d e / (1 - e), together d (1 + e) / (1 - e); those before by e less each: sum
    d (1 + e) / (1 - e)^2. The last interval, T = 2 u / g / 10 long, and its share e of the one before
    are off by up to 2 d and 2 d (1 + 1 / e) / T each, the rest T e / (1 - e) by 2 d (e / (1 - e) +
    (1 + e) / e / (1 - e)^2). The note has nine digits.
    """
    result = played(e, "ideal")
    assert result.status == "stopped"
    note = re.fullmatch(
        r"stopped at (\S+) s: free switches either way at ever shorter intervals, "
        r"each (\S+) of the one before, "
        r"so without end by (\S+) s; nothing says what is after that: "
        r"give it hysteresis, or parts a lag",
        result.status_note,
    )
    stopped_s, share, end_s = (float(figure) for figure in note.groups())
    u = e * math.sqrt(2 * G * 1e-9)  # the last flight followed may be lower by e^2
    off_s = 1e-12 / (SPEED * u)
    bound_s = off_s * (1 + e) / (1 - e) ** 2
    bound_s += 2 * off_s * (e / (1 - e) + (1 + e) / e / (1 - e) ** 2) + 0.5e-9 * end_s
    exact_s = end_of_jumps_s(e)
    assert bound_s < 2e-6 * exact_s
    assert end_s == pytest.approx(exact_s, abs=bound_s)
    assert share == pytest.approx(e, abs=2 * off_s * (1 + e) / (2 * u / G / SPEED) + 1e-6)
    # What is left at the stop: from the last height below 1e-9, in which two may have been seen.
    left_s = 2 * math.sqrt(2 * G * 1e-9) / e / G / SPEED / (1 - e)
    assert 0.0 < exact_s - stopped_s < left_s
    # The rows up to there are flights: the tops fall by e^2 from one to the next.
    y = result.record["y"].values
    assert y.min() > -1e-9
    t0 = math.sqrt(2 * H / G)
    for n in (1, 2):
        top_s = (t0 + 2 * t0 * sum(e**k for k in range(1, n)) + t0 * e**n) / SPEED
        seen = y[abs(result.record["time"].values - top_s).argmin()]
        assert seen == pytest.approx(H * e ** (2 * n), abs=0.5 * G * 0.001**2 + 1e-7)


def test_with_lags_the_ball_goes_on_at_rest_and_the_run_says_since_when():
    """Five lags of 1 us pass from the floor to the velocity, in which the ball gains no more than w = g
    * 50 us of problem time: it rests within w^2 / 2 g + w 50 us of the floor, and 2 w of no velocity.

    Flights shorter than 16 lags are chatter; of the jumps' time then is left at most 16 us / (1 - e).
    From 90 ms on that takes 13 halvings, and no more than as many again as lags, in which the ball does
    not fall, make the last flights longer; each impact holds it up by 5 lags on the way down and, e
    times as fast, 5 / e on the way up."""
    result = played(0.5, "lags")
    assert result.status == "complete"
    found = re.match(r"free chatters from (\S+) s on", result.status_note)
    left_s, late_s = 16e-6 / (1 - 0.5), 26 * 5e-6 * (1 + 1 / 0.5)
    assert -left_s < float(found.group(1)) - end_of_jumps_s(0.5) < late_s
    w = G * 50e-6
    assert abs(result.record["y"].values[-500:]).max() < w**2 / (2 * G) + w * 50e-6
    assert abs(result.record["v"].values[-500:]).max() < 2 * w


def test_the_shipped_ball_comes_to_rest_on_its_spring():
    """Where the floor gives, there is no end of jumps: it rests at -g / omega_c^2.

    It has left the floor for the last time by t0 (1 + e) / (1 - e), e = 0.854, and what half a period of
    the floor each takes: 5.7 s and some tenths. What is left falls as exp(-5 t / s): by 12 s to 1e-11.
    """
    text = hybrid.shipped.shipped_patches()["bouncing_ball"].read_text(encoding="utf-8")
    text = text.replace(
        "run: {until: 4/speed, every: 0.002/speed}", "run: {until: 1.2, every: 0.01}"
    )
    result = hybrid.run(hybrid.parse_patch(text), machine="ideal")
    assert (result.status, result.status_note) == ("complete", "")
    assert float(result.record["y"][-1]) == pytest.approx(-G / 100**2, abs=1e-8)
    assert abs(float(result.record["v"][-1])) < 1e-7


CHIRP = """
title: A sweep of frequency
machine: ideal
analog:
  faster: {ramp: 2e6, full_scale: 1e5}
  swing: {integrate: {faster: 1}, initial: 0, full_scale: 3000}
  wave: {sin: swing, full_scale: 1}
  high: {compare: {wave: 1}, high: 1, full_scale: 1}
run: {until: 50 ms, every: 1 ms}
"""


def test_intervals_that_only_shrink_end_nothing():
    """sin(1e6 t^2) rises through zero at t = sqrt(2 pi n / 1e6), 397 times in 50 ms and faster each
    time, but does not come to an end."""
    result = hybrid.run(hybrid.parse_patch(CHIRP))
    assert (result.status, result.status_note) == ("complete", "")


RELAY = """
title: A mass with friction that a relay drives to and fro
machine: ideal
analog:
  x: {integrate: {v: SCALE}, initial: 1e-3*SCALE, full_scale: SCALE}
  v: {integrate: {side: -200, v: -200}, initial: 0, full_scale: 2}
  side: {compare: {x: 1}, low: -1, high: 1, full_scale: 1}
run: {until: 250 ms, every: 1 ms}
"""


@pytest.mark.parametrize("scale", ["1", "1e-9"])
def test_intervals_that_shrink_less_and_less_come_to_no_end(scale):
    """x'' = -F sgn x - d x': an interval T is shorter than the one before by d T^2 / 6 to lowest order,
    so they go as 6 / (d n), and their sum as its logarithm, to no end; whatever the unit of x."""
    result = hybrid.run(hybrid.parse_patch(RELAY.replace("SCALE", scale)))
    assert (result.status, result.status_note) == ("complete", "")


TWISTING = """
title: A mass that a relay and dry friction bring to rest
machine: ideal
analog:
  x: {integrate: {v: 100}, initial: 0.5, full_scale: 1}
  v: {integrate: {side: -300, drag: -100}, initial: 0, full_scale: 5}
  side: {compare: {x: 1}, low: -1, high: 1, full_scale: 1}
  drag: {compare: {v: 1}, low: -1, high: 1, full_scale: 1}
run: {until: 100 ms, every: 1 ms}
"""


@pytest.mark.parametrize(("engine", "seen"), [("nonlinear", 1e-12), ("reference", 2e-11)])
def test_both_engines_say_where_a_mass_comes_to_rest(engine, seen):
    """x'' = -a sgn x - b sgn x': from x0 it is back at 0 after t = sqrt(2 x0 / (a - b)), and stands at
    -q x0 after another q t, q = (a - b) / (a + b); so all ends at t (1 + q) / (1 - sqrt(q)).

    Turns are followed until x swings by less than 1e-9, to 1e-9 q^2 at the least, where it passes 0 at
    V = sqrt(2 (a - b) 1e-9 q^2). A crossing `seen` too late is so by d = seen / V. Of the interval and
    its share r = q of the one before, what is left has the errors 2 d r / (1 - r) and, of that share,
    2 (1 + 1 / r) d / (1 - r)^2, beside d itself. The note has nine digits.
    """
    result = hybrid.run(hybrid.parse_patch(TWISTING), engine=engine)
    note = re.fullmatch(
        r"stopped at (\S+) s: \w+ switches either way at ever shorter intervals, "
        r"each (\S+) of the one before, "
        r"so without end by (\S+) s; nothing says what is after that: .*",
        result.status_note,
    )
    assert note is not None, result.status_note
    stopped_s, share, end_s = (float(figure) for figure in note.groups())
    a, b, x0 = 3e4, 1e4, 0.5
    q = (a - b) / (a + b)
    exact_s = math.sqrt(2 * x0 / (a - b)) * (1 + q) / (1 - math.sqrt(q))
    d = seen / math.sqrt(2 * (a - b) * 1e-9 * q**2)
    bound_s = d * (1 + 2 * q / (1 - q) + 2 * (1 + 1 / q) / (1 - q) ** 2) + 0.5e-9 * exact_s
    assert bound_s < 1e-4 * exact_s
    assert end_s == pytest.approx(exact_s, abs=bound_s)
    assert share == pytest.approx(q, abs=0.01)
    assert 0.0 < exact_s - stopped_s < 1e-3 * exact_s
    assert result.status == "stopped"


SLIDING = """
title: A relay that slides
machine: MACHINE
analog:
  x: {integrate: {u: 1}, initial: 0.05, full_scale: 1}
  u: {compare: {x: -1}, high: 50, low: -50, full_scale: 50}
run: {until: 1.3 ms, every: 0.1 ms}
"""


def test_the_reference_tells_chatter_as_the_nonlinear_engine_does():
    """x is at 0 after 1 ms. On ideal parts that ends the run; with lags the relay changes to and fro."""
    for machine, said in (
        ("ideal", r"stopped at 0\.001 s: u chatters: give it hysteresis, or what it drives a lag"),
        (
            "lags",
            r"u chatters from 0\.001\d* s on, \d+ changes as fast as the lags allow: give it .*",
        ),
    ):
        for engine in ("nonlinear", "reference"):
            patch = hybrid.parse_patch(SLIDING.replace("MACHINE", machine))
            note = hybrid.run(patch, engine=engine).status_note
            assert re.fullmatch(said, note), (machine, engine, note)
