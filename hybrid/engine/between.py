"""Linear signals beyond full scale between the instants: since when, how far and how long.

Stage 4. For those few stretches of a run in which that can have happened (`lookout`). Each interval is
an initial value problem with held inputs, whose solution is known: a signal is followed in steps as long
as bounds allow (`ladder`), down to steps in which it is a short Taylor series and is looked at closely.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hybrid.engine.arrays import Floats, Ints
from hybrid.engine.beyond import (
    BEYOND_S,
    FIRST_S,
    FIRST_VALUE,
    FULL_SCALE,
    HALVINGS,
    TIMES,
    WORST_S,
    WORST_VALUE,
)
from hybrid.engine.compiling import compiled
from hybrid.engine.kernel import Moment
from hybrid.machine import Analog

# Terms of a signal's Taylor series over the first rung: (1/8)^13/13! is far below rounding.
SERIES = 13
# How well the worst value is known, of full scale.
WORST_WITHIN = 1e-9


class Rungs(NamedTuple):
    """What is known of an analog side with n states, m inputs and k signals over some intervals."""

    a: Floats  # (n, n)
    forcing: Floats  # (n, n + m): x' = forcing [x; u]
    signals: Floats  # (k, n + m)
    rate: Floats  # (n, n + m): see `Ladder`
    shortest_s: float
    change: Floats  # (rungs, n, n + m)
    apart: Floats  # (rungs, k, n)
    length_s: Floats  # (intervals,)
    whole: Floats  # (intervals, n, n + m): as `change`, over the whole interval
    bound: Floats  # (intervals, k, n): as `apart`


class Desk(NamedTuple):
    """Room to work in."""

    z: Floats  # (n + m,): states and inputs where a step begins
    later: Floats  # (n,): states where it ends
    rho: Floats  # (n,)
    rate: Floats  # (2, n): derivatives of the states
    series: Floats  # (SERIES + 1,): of the signal


def desk_for(analog: Analog) -> Desk:
    """A desk for an analog side."""
    n, m = analog.b.shape
    return Desk(np.zeros(n + m), np.zeros(n), np.zeros(n), np.zeros((2, n)), np.zeros(SERIES + 1))


@compiled
def look(
    rungs: Rungs, desk: Desk, z: Floats, interval: int, now: Moment, seen: Floats, at: Ints
) -> bool:
    """Note in `seen` (k, 6) what goes beyond full scale in an interval; whether anything does.

    z: states and inputs where it begins; now: where it ends. at: (k, 4): repeat and instant where the
    interval ends in which a signal was first beyond, and was worst; times in `seen` are since it began.
    """
    found = False
    _set_out(rungs, desk, z, rungs.whole[interval])
    for s in range(seen.shape[0]):
        near = _distance(rungs.bound[interval, s], desk.rho)
        begins, ends = _signal(rungs, desk.z, s), _later(rungs, desk, s)
        if max(abs(begins), abs(ends)) + near > FULL_SCALE:
            times, worst, length_s = seen[s, TIMES], seen[s, WORST_VALUE], rungs.length_s[interval]
            if not _all_beyond(begins, ends, near, 0.0, length_s, seen[s]):
                _follow(rungs, desk, s, length_s, seen[s])
                _set_out(rungs, desk, z, rungs.whole[interval])
            found |= seen[s, TIMES] > times
            if times == 0.0 and seen[s, TIMES] > 0.0:
                at[s, 0], at[s, 1] = now.repeat, now.instant
            if seen[s, WORST_VALUE] != worst:
                at[s, 2], at[s, 3] = now.repeat, now.instant
    return found


@compiled
def _set_out(rungs: Rungs, desk: Desk, z: Floats, change: Floats) -> None:
    """Where a step that begins at z ends, and what bounds are taken by."""
    n, columns = change.shape
    for j in range(columns):
        desk.z[j] = z[j]
    for i in range(n):
        more, rho = 0.0, 0.0
        for j in range(columns):
            more += change[i, j] * z[j]
            rho += rungs.rate[i, j] * z[j]
        desk.later[i], desk.rho[i] = z[i] + more, abs(rho)


@compiled
def _signal(rungs: Rungs, z: Floats, s: int) -> float:
    total = 0.0
    for j in range(rungs.signals.shape[1]):
        total += rungs.signals[s, j] * z[j]
    return total


@compiled
def _later(rungs: Rungs, desk: Desk, s: int) -> float:
    """The signal where the step ends."""
    n, total = desk.later.shape[0], 0.0
    for j in range(rungs.signals.shape[1]):
        total += rungs.signals[s, j] * (desk.later[j] if j < n else desk.z[j])
    return total


@compiled
def _distance(bound: Floats, rho: Floats) -> float:
    """How far the signal leaves its chord at most."""
    total = 0.0
    for j in range(rho.shape[0]):
        total += bound[j] * rho[j]
    return total


@compiled
def _all_beyond(
    begins: float, ends: float, near: float, t_s: float, length_s: float, seen: Floats
) -> bool:
    """Note a step in which the signal is beyond full scale throughout, if it tells nothing finer."""
    sign = 1.0 if begins > 0.0 else -1.0
    highest = max(sign * begins, sign * ends)
    beyond = min(sign * begins, sign * ends) - near > FULL_SCALE
    fine = near < WORST_WITHIN or highest + near <= abs(seen[WORST_VALUE])
    if beyond and fine:
        _note(sign, t_s, begins, t_s + length_s, ends, seen)
    return beyond and fine


@compiled
def _follow(rungs: Rungs, desk: Desk, s: int, length_s: float, seen: Floats) -> None:
    """Go through an interval in steps of 1, 2, 4, ... of the shortest, as long as they may be."""
    steps = int(length_s / rungs.shortest_s)
    at, rung = 0, rungs.change.shape[0] - 1
    while at < steps:
        while rung > 0 and ((at >> rung) << rung != at or at + (1 << rung) > steps):
            rung -= 1
        t_s, step_s = at * rungs.shortest_s, (1 << rung) * rungs.shortest_s
        _set_out(rungs, desk, desk.z, rungs.change[rung])
        near = _distance(rungs.apart[rung, s], desk.rho)
        begins, ends = _signal(rungs, desk.z, s), _later(rungs, desk, s)
        done = max(abs(begins), abs(ends)) + near <= FULL_SCALE
        done = done or _all_beyond(begins, ends, near, t_s, step_s, seen)
        if not done and rung == 0:
            _look_closely(rungs, desk, s, t_s, step_s, seen)
            done = True
        if done:
            for i in range(desk.later.shape[0]):
                desk.z[i] = desk.later[i]
            at += 1 << rung
            rung = rungs.change.shape[0] - 1
        else:
            rung -= 1
    left_s = length_s - steps * rungs.shortest_s
    if left_s > 0.0:
        _look_closely(rungs, desk, s, steps * rungs.shortest_s, left_s, seen)


@compiled
def _look_closely(
    rungs: Rungs, desk: Desk, s: int, t_s: float, length_s: float, seen: Floats
) -> None:
    """Look at the signal over at most the first rung, parted where it turns."""
    _expand(rungs, desk, s, length_s)
    series = desk.series
    begins, ends = series[0], _read(series, 0, 1.0)
    parts, turn_at, turn = 1, 1.0, ends
    if _read(series, 1, 0.0) * _read(series, 1, 1.0) < 0.0:
        turn_at = _where(series, 1, 0.0, 0.0, 1.0)
        parts, turn = 2, _read(series, 0, turn_at)
    for part in range(parts):
        low_at, low = (0.0, begins) if part == 0 else (turn_at, turn)
        high_at, high = (turn_at, turn) if part == 0 else (1.0, ends)
        for sign in (1.0, -1.0):
            if max(sign * low, sign * high) > FULL_SCALE:
                from_at, first, to_at, last = low_at, low, high_at, high
                if not sign * low > FULL_SCALE:
                    from_at = _where(series, 0, sign * FULL_SCALE, low_at, high_at)
                    first = sign
                if not sign * high > FULL_SCALE:
                    to_at = _where(series, 0, sign * FULL_SCALE, low_at, high_at)
                    last = sign
                _note(sign, t_s + length_s * from_at, first, t_s + length_s * to_at, last, seen)


@compiled
def _expand(rungs: Rungs, desk: Desk, s: int, length_s: float) -> None:
    """The signal as a series in the fraction of a step that begins at desk.z."""
    n, columns = rungs.forcing.shape
    now, following = desk.rate[0], desk.rate[1]
    for i in range(n):
        now[i] = 0.0
        for j in range(columns):
            now[i] += length_s * rungs.forcing[i, j] * desk.z[j]
    desk.series[0] = _signal(rungs, desk.z, s)
    for k in range(1, SERIES + 1):
        desk.series[k] = 0.0
        for i in range(n):
            desk.series[k] += rungs.signals[s, i] * now[i]
        for i in range(n):
            following[i] = 0.0
            for j in range(n):
                following[i] += length_s / (k + 1) * rungs.a[i, j] * now[j]
        now, following = following, now


@compiled
def _read(series: Floats, order: int, at: float) -> float:
    """The signal (order 0) or its slope (1) at a fraction of the step."""
    total = 0.0
    for k in range(series.shape[0] - 1, order - 1, -1):
        total = total * at + (k * series[k] if order == 1 else series[k])
    return total


@compiled
def _where(series: Floats, order: int, figure: float, low: float, high: float) -> float:
    """Where the signal or its slope passes a figure: it is on different sides at either fraction."""
    below = _read(series, order, low) < figure
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if (_read(series, order, middle) < figure) == below:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@compiled
def _note(sign: float, from_s: float, first: float, to_s: float, last: float, seen: Floats) -> None:
    """Add a stretch beyond full scale, with the signal at either end."""
    if seen[TIMES] == 0.0:
        seen[FIRST_S], seen[FIRST_VALUE] = from_s, first
    seen[TIMES] += 1.0
    seen[BEYOND_S] += to_s - from_s
    if sign * first > abs(seen[WORST_VALUE]):
        seen[WORST_VALUE], seen[WORST_S] = first, from_s
    if sign * last > abs(seen[WORST_VALUE]):
        seen[WORST_VALUE], seen[WORST_S] = last, to_s
