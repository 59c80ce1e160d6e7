"""Programs of limited word length, beside the kernel, which comes back for each of their cycles.

Stage 4. Rounding every operation takes as long to compile as all the rest together, so it is done when
the first such program is played.
"""

from __future__ import annotations

import math
from typing import Any

from hybrid.engine import helper_functions, kernel
from hybrid.engine.compiling import compiled
from hybrid.engine.kernel import Deck, Score, State, note_overload
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
    cues, count, notes, values = score.cues, state.counts, state.overload, state.beyond
    at, repeat, last = count[kernel.CUE], count[kernel.REPEAT], cues[cues.shape[0] - 1, 2]
    program, instant, words = cues[at, 1], cues[at, 2], deck.words.shape[0]
    clock = state.outside.shape[0] - 1
    state.outside[clock, helper_functions.REPEAT] = repeat
    state.outside[clock, helper_functions.INSTANT] = instant
    count[kernel.COMPUTED] = 1
    k, end = deck.starts[program, 0], deck.starts[program + 1, 0]
    code, length_of, lengths, owner = deck.code[:end], deck.length_of, deck.lengths, deck.owner
    r, row, stop = state.registers, notes.shape[0] - words, False
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
        note_overload(notes, values, row + owner[k], r[target] / full_scale, repeat, instant, last)
        stop |= length[OVERFLOW] == STOP
        r[target] = within(code_of(r[target], length), length) * length[STEP]
        k += 1
