"""How long the next window may be: from what the last one left, and from earlier jumps.

Stage 4. A window's last Legendre coefficient says how much longer the next one may be. Right after a
jump lagged outputs relax as exp(-t / tau), and that layer rules the length until it has died out; how
long the first windows may be then is learned from one jump to the next, apart for held inputs and for
events.
"""

from __future__ import annotations

import math

from hybrid.engine.arrays import Floats
from hybrid.engine.compiling import compiled, inlined
from hybrid.engine.sweep import (
    AGE,
    CRUISE,
    JUMPED,
    KNOWN,
    LEFT,
    NEXT,
    REJECTED,
    RUNG,
    RUNGS,
    WAIT,
    State,
)

# A layer has died out after this many lags: exp(-36) is 2e-16, a chain of lags takes longer.
LAYER_LAGS = 45.0
# A window of so many lags resolves any layer: a polynomial of degree 8 leaves 1e-14 of exp(-t / 4).
RESOLVED_LAGS = 0.25
# What a layer leaves of the series is taken to fall with it, yet to no less than this share.
LEAST_DECAY = 0.2
# The next window aims at this share of what is allowed, and is at most so much longer or shorter.
AIM = 0.1
MOST_GROWTH = 2.0
# What is left may rise from window to window; the next one is taken to leave more by as much again,
# yet by no more than this. Where that is above this share of what is allowed, it is made shorter.
MOST_RISE = 4.0
CALM = 0.5
# From one jump to the next, a window of which nearly nothing is left may be so much longer.
MOST_LEARNED = 8.0
MOST_CUT = 0.1
# Windows to wait before trying again a length at which the loops did not agree.
PATIENCE = 30


@compiled
def begin_short(state: State, jumped: int) -> None:
    """Something jumped: forget the last window, and begin as after the last jump of this kind."""
    state.clock[AGE], state.clock[NEXT], state.clock[LEFT] = 0.0, state.rungs[jumped, 0], 0.0
    state.counts[KNOWN], state.counts[JUMPED], state.counts[RUNG] = 0, jumped, 0


@inlined
def next_length(length_s: float, remaining_s: float) -> float:
    """At most this long, of few different lengths, or all that remains."""
    if length_s >= remaining_s * (1.0 - 1e-9):
        return remaining_s
    share, exponent = math.frexp(length_s)
    return math.ldexp(math.floor(share * 16.0) / 16.0, exponent)


@compiled
def _lasting(age_s: float, taus_s: Floats, length_s: float) -> float:
    """The shortest lag whose layer lasts and shows in a window of this length; 0: there is none."""
    for k in range(taus_s.shape[0]):
        if age_s < LAYER_LAGS * taus_s[k] and length_s > RESOLVED_LAGS * taus_s[k]:
            return float(taus_s[k])
    return 0.0


@compiled
def _change_of_length(share: float, q: int, most: float) -> float:
    """By how much a window may be longer whose last coefficient is this share of what is allowed."""
    if not share * most ** (q + 1) > AIM:
        return most
    return float(max((AIM / share) ** (1.0 / (q + 1)), MOST_CUT))


@compiled
def reject(state: State, taus_s: Floats, length_s: float, share: float, q: int) -> None:
    """Note that a window was too long, by what it left; where loops did not agree, by half.

    Then no window may be longer for a while, unless it is a layer that is to blame.
    """
    clock, counts = state.clock, state.counts
    counts[REJECTED] += 1
    agreed = share < math.inf
    clock[NEXT] = length_s * (_change_of_length(share, q, 1.0) if agreed else 0.5)
    if _lasting(clock[AGE], taus_s, length_s) == 0.0:
        clock[CRUISE] = clock[NEXT]
        counts[WAIT] = 0 if agreed else PATIENCE
    if counts[RUNG] < RUNGS:
        state.rungs[counts[JUMPED], counts[RUNG]] = clock[NEXT]


@inlined
def adapt(state: State, taus_s: Floats, length_s: float, share: float, q: int) -> None:
    """Suggest the length of the next window; soon after a jump, what was learned after earlier ones."""
    clock, counts, rungs = state.clock, state.counts, state.rungs[state.counts[JUMPED]]
    cut_short = length_s < 0.8 * clock[NEXT]  # by an instant, not by what signals do
    left = share / length_s ** (q + 1)
    rise = left / clock[LEFT] if clock[LEFT] > 0.0 else 1.0
    clock[LEFT] = left
    expected = share * min(max(rise, 1.0), MOST_RISE)
    change = _change_of_length(expected, q, MOST_GROWTH)
    tau = _lasting(clock[AGE], taus_s, length_s)
    learned = 0.0
    if not cut_short and counts[RUNG] < RUNGS:
        rungs[counts[RUNG]] = length_s * max(_change_of_length(share, q, MOST_LEARNED), 1.0)
        counts[RUNG] += 1
        learned = rungs[counts[RUNG]] if counts[RUNG] < RUNGS else 0.0
    if tau > 0.0:
        change = _change_of_length(
            share * max(math.exp(-length_s / tau), LEAST_DECAY), q, MOST_GROWTH
        )
    suggested = length_s * change
    if not expected > CALM:  # else the next one would not be resolved, and be played twice
        suggested = max(suggested, min(length_s, clock[NEXT]))
    if learned > 0.0:
        suggested = learned
    if cut_short:
        suggested = max(suggested, clock[NEXT])
    if tau == 0.0:
        if counts[WAIT] > 0:
            counts[WAIT] -= 1
            suggested = min(suggested, clock[CRUISE])
        clock[CRUISE] = suggested
    clock[NEXT] = suggested
