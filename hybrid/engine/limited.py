"""Programs of limited word length, beside the kernel, which comes back for each of their cycles.

Stage 4. Rounding every operation takes as long to compile as all the rest together, so it is done when
the first such program is played.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hybrid.engine import helper_functions, kernel
from hybrid.engine.arrays import Deck, Score, State
from hybrid.engine.compiling import compiled
from hybrid.engine.kernel import Moment, note_overload
from hybrid.engine.rounding import BITS, OVERFLOW, STEP, STOP, code_of, run_rounded, within


@compiled
def play_limited(*given: Any) -> int:
    """`kernel.play` for programs of limited word length."""
    score, deck, state = given[0], given[3], given[5]
    while True:
        outcome = kernel.play(*given)
        if outcome != kernel.COMPUTES:
            return int(outcome)
        if compute(score, deck, state):
            return int(kernel.OVERFLOWED)


@compiled
def compute(score: Score, deck: Deck, state: State) -> bool:
    """Compute the cycle that the kernel has come to; whether a word overflowed that is to stop the run.

    Values noted are in full scales of the word.
    """
    cues, count = score.cues, state.counts
    cue, last = cues[count[kernel.CUE]], cues[cues.shape[0] - 1].instant
    now = Moment(count[kernel.REPEAT], cue.instant, last)
    clock, program = state.outside.shape[0] - 1, np.int64(cue.which)
    state.outside[clock, helper_functions.REPEAT] = now.repeat
    state.outside[clock, helper_functions.INSTANT] = now.instant
    count[kernel.COMPUTED] = 1
    k, end = np.int64(deck.programs[program].code), np.int64(deck.programs[program + 1].code)
    code, length_of, lengths, owner = deck.code[:end], deck.length_of, deck.lengths, deck.owner
    r, row, stop = state.registers, state.overload.shape[0] - deck.words.shape[0], False
    while True:
        k = run_rounded(
            code,
            length_of,
            lengths,
            r,
            k,
            deck.figures,
            deck.axes,
            deck.tables,
            state.outside,
            state.places,
            state.intervals,
        )
        if k == end:
            return stop
        length, target = lengths[length_of[k]], code[k, 1]
        full_scale = math.ldexp(length[STEP], int(length[BITS]) - 1)
        note_overload(state, row + owner[k], r[target] / full_scale, now)
        stop |= length[OVERFLOW] == STOP
        r[target] = within(code_of(r[target], length), length) * length[STEP]
        k += 1
