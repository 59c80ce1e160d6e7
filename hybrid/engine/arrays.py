"""The arrays that the kernel plays: what is due, the analog side, converters, programs, pens, state.

Stage 4. A row of a table is a struct of few figures, which lie together in memory. Numbers in it are
unsigned: numba then looks for no index that counts from the end.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Numbers = npt.NDArray[np.uint32]
Structs = npt.NDArray[Any]


# Bytes that the processor fetches at once.
CACHE_LINE = 64


def lined_up(*shape: int) -> Floats:
    """Zeros that begin on a cache line: rows of eight then lie in one each, not across two.

    An eighth of the time that circuits took went into rows across two.
    """
    size, at_once = math.prod(shape), CACHE_LINE // 8
    room = np.zeros(size + at_once)
    first = -room.ctypes.data % CACHE_LINE // 8
    return room[first : first + size].reshape(shape)


def _numbered(*names: str) -> list[tuple[str, str]]:
    return [(name, "u4") for name in names]


def _figures(*names: str) -> list[tuple[str, str]]:
    return [(name, "f8") for name in names]


# What to do, to which, and the number of its instant.
CUE = np.dtype(_numbered("what", "which", "instant"))
# `place`: of the signal, in v; clips at +-`range_mu` where `clips`; `step_mu` of 0: nothing is rounded.
ADC = np.dtype(_numbered("place", "register") + _figures("to_si", "range_mu", "step_mu", "clips"))
DAC = np.dtype(_numbered("word", "input") + _figures("to_mu", "step_mu", "clips"))
SOURCE_STEP = np.dtype([("input", "u8"), ("value_mu", "f8")])
# Where the code or bursts of a program begin, its words, memory, words of others, and asks.
PROGRAM = np.dtype(_numbered("code", "words", "memory", "shared", "asks"))
# A value `length` cycles old; until then it is in a ring of registers, see `tape.Memory`.
REMEMBERED = np.dtype(_numbered("keeps", "source", "ring", "length"))
SHARED = np.dtype(_numbered("register", "word"))
# What it draws: 0: of v; 1: of the registers; 2: of the words; times a factor.
PEN = np.dtype(_numbered("source", "index") + _figures("factor"))
# Rows of the ring: of the next results to be, and of the oldest.
SLOTS = np.dtype([("next", "i8"), ("oldest", "i8")])


class Score(NamedTuple):
    """The cues of one segment.

    ADVANCE: the propagator that leads to the next instant; SAMPLE, CONVERT: the ADC, TAKE: both at once;
    START, END: a program; LATCH: the DAC; SOURCE: the step source; RECORD: a row of the record. LOOK
    follows what makes signals jump.
    """

    cues: Structs  # of CUE


class Plant(NamedTuple):
    """Analog side, for v = [padding, k sums, n states, m held inputs, r normal draws].

    Every signal is an entry of v; a sum is a signal without lag, a combination of states and inputs.
    `change` gives the sums (new values) and the states (their changes), in blocks of eight rows that
    lie side by side in memory, as vector instructions take them; the padding fills the first block.
    """

    change: Floats  # (intervals, blocks, n + m + r, 8)
    kept: Floats  # (8 * blocks,): 1 for states, to which changes are added, else 0
    draws: Ints  # (intervals,): normal draws each propagator consumes
    signal: Numbers  # (signals,): place in v
    reach: Floats  # (m, k): what a unit change of each input does to the sums at once


class Coupling(NamedTuple):
    """Converters and step sources; inputs are counted among the m."""

    adcs: Structs  # of ADC
    dacs: Structs  # of DAC
    sources: Structs  # of SOURCE_STEP


class Deck(NamedTuple):
    """The programs, one after the other; the last of `programs` ends them.

    Where words round, `code` is the tape as it was written; where all are doubles, `bursts`, `steps` and
    `asks` are the tight one. The other is empty.
    """

    code: npt.NDArray[np.int32]  # (operations, 4)
    bursts: npt.NDArray[np.int32]  # (bursts, 3), see `TightTape`
    steps: npt.NDArray[np.uint32]  # (steps, 4)
    asks: npt.NDArray[np.int32]  # (asks, 3)
    words: Numbers
    memory: Structs  # of REMEMBERED
    figures: Floats  # of its tables, see `lookup`
    axes: Ints  # (searches, columns)
    tables: Ints  # (tables, columns)
    length_of: npt.NDArray[np.int32]  # (operations,): row of `lengths`; () where all are doubles
    lengths: Floats
    owner: npt.NDArray[np.int32]  # (operations,): the word each helps to compute
    shared: Structs  # of SHARED: words of other programs
    programs: Structs  # (programs + 1,) of PROGRAM


class Pens(NamedTuple):
    """What a row of the record holds."""

    drawn: Structs  # of PEN


class State(NamedTuple):
    """All that changes during a run; owned by the run."""

    v: Floats  # (8 * blocks + m + r,)
    next_v: Floats  # (8 * blocks,)
    sample: Floats  # (adcs,): held by sample and hold
    registers: Floats
    ring: Floats  # (depth, words): results on their way
    slots: Structs  # (programs,) of SLOTS
    words: Floats  # (words,): results that can be read
    counts: Ints  # see the constants of `kernel`
    overload: Ints  # (signals + adcs + dacs + words, 6): see the constants of `kernel`
    beyond: Floats  # (signals + adcs + dacs + words, 2): first and worst value
    most: Floats  # (2, 8 * blocks): of |v| where intervals begin, of |next_v|
    outside: Floats  # (PER_SITE rows for each site of the tape + 1, 6): see `helper_functions`
    places: Floats  # (searches + 4, 4): where arguments of tables lie, see `lookup`
    intervals: Ints  # (searches, 2)
