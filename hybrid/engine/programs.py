"""Programs with more than products and sums, beside the kernel, which comes back for the rest.

Stage 4. Tables and functions take as long to compile as the kernel itself, so that is done when the
first such program is played.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hybrid.engine import helper_functions, kernel
from hybrid.engine.arrays import Deck, Score, State
from hybrid.engine.bursts import MULTIPLY_ADD, run_bursts
from hybrid.engine.compiling import compiled
from hybrid.engine.lookup import note_missed


@compiled
def play_programs(*given: Any) -> int:
    """`kernel.play` for such programs."""
    while True:
        outcome = kernel.play(*given)
        if outcome != kernel.COMPUTES:
            return int(outcome)
        compute_rest(given[0], given[3], given[5])


@compiled
def compute_rest(score: Score, deck: Deck, state: State) -> None:
    """Compute what the kernel has left of a cycle: all that follows the first products and sums."""
    count = state.counts
    cue, clock = score.cues[count[kernel.CUE]], state.outside.shape[0] - 1
    state.outside[clock, helper_functions.REPEAT] = count[kernel.REPEAT]
    state.outside[clock, helper_functions.INSTANT] = cue.instant
    number = np.uint64(cue.which)
    program, following = deck.programs[number], deck.programs[number + kernel.ONE]
    burst = np.int64(program.code)
    while deck.bursts[burst, 0] == MULTIPLY_ADD:
        burst += 1
    if run_bursts(
        deck.bursts,
        burst,
        np.int64(following.code),
        deck.steps,
        state.registers,
        deck.figures,
        deck.axes,
        deck.tables,
        state.places,
        state.intervals,
        state.outside,
    ):
        asks: Any = np.int64(program.asks)
        last: Any = np.int64(following.asks)
        note_missed(deck.asks, asks, last, state.places, state.intervals, state.outside)
    count[kernel.COMPUTED] = 1
