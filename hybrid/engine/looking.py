"""Linear runs that are looked at between the instants, beside the kernel, which waits at every interval.

Stage 4. Compiled when a run first comes near full scale.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid.engine import kernel, limited, programs
from hybrid.engine.arrays import Coupling, Deck, Floats, Ints, Pens, Plant, Score, State
from hybrid.engine.between import Desk, Rungs, look
from hybrid.engine.compiling import compiled
from hybrid.engine.kernel import Moment


@compiled
def play(
    score: Score,
    plant: Plant,
    coupling: Coupling,
    deck: Deck,
    pens: Pens,
    state: State,
    normals: Floats,
    rows: Floats,
    keep_every: int,
    stop_repeat: int,
    stop_cue: int,
    rungs: Rungs,
    desk: Desk,
    seen: Floats,
    at: Ints,
) -> int:
    """`kernel.play`, with a look at every interval before the analog side is advanced over it.

    Where something goes beyond full scale within an interval, and overloads end the run, it ends before.
    """
    waiting = Plant(plant.change[:0], plant.kept, plant.draws, plant.signal, plant.reach)
    cues, counts = score.cues, state.counts
    while True:
        outcome = kernel.play(
            score,
            waiting,
            coupling,
            deck,
            pens,
            state,
            normals,
            rows,
            keep_every,
            stop_repeat,
            stop_cue,
        )
        if outcome != kernel.WAITING:
            return int(outcome)
        cue, repeat = cues[counts[kernel.CUE]], counts[kernel.REPEAT]
        last: Any = np.int64(cues[cues.shape[0] - 1].instant)
        instant: Any = np.int64(cue.instant)
        now = Moment(repeat, instant, last)
        if cue.what == kernel.LOOK:
            outcome = kernel.look(plant, state, now)
        else:
            # Where an interval follows, the kernel leaves out to look at what jumped before.
            outcome = kernel.look(plant, state, Moment(repeat, instant - 1, last))
            if outcome == kernel.PAUSED:
                interval: Any = np.int64(cue.which)
                z = state.v[state.v.shape[0] - plant.change.shape[2] :]
                found = look(rungs, desk, z, interval, now, seen, at)
                if found and counts[kernel.STOPS] != kernel.NEVER:
                    return int(kernel.OVERLOADED)
                outcome = kernel.advance(plant, state, normals, interval, now)
        if outcome != kernel.PAUSED:
            return int(outcome)
        counts[kernel.CUE] += 1
        if counts[kernel.CUE] == cues.shape[0]:
            counts[kernel.CUE] = 0
            counts[kernel.REPEAT] += 1


@compiled
def play_programs(*given: Any) -> int:
    """The same for programs with more than products and sums."""
    while True:
        outcome = play(*given)
        if outcome != kernel.COMPUTES:
            return int(outcome)
        programs.compute_rest(given[0], given[3], given[5])


@compiled
def play_limited(*given: Any) -> int:
    """The same for programs of limited word length."""
    while True:
        outcome = play(*given)
        if outcome != kernel.COMPUTES:
            return int(outcome)
        if limited.compute(given[0], given[3], given[5]):
            return int(kernel.OVERFLOWED)
