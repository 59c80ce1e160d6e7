"""All that is a run's own in one line of figures, so that many runs lie below each other.

Stage 4. Runs that differ in figures alone share everything else: the arrays that are played are views of
one line, into which the figures of one run after the other are copied.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hybrid.engine import kernel
from hybrid.engine.arrays import CACHE_LINE, Floats, Ints, lined_up

Array = npt.NDArray[Any]

BYTES = 8  # of a figure
# Arrays begin where the processor fetches anew.
AT_ONCE = CACHE_LINE // BYTES


class Lines(NamedTuple):
    """Runs, a line for each; that of the run which is played is copied into `line`."""

    line: Floats  # (figures,)
    lines: Floats  # (runs, figures)
    outcomes: Ints  # (runs,): why each came back, see `kernel`; PAUSED: it can go on
    now: Ints  # (2,): see the constants below

    def part(self, some: slice) -> Lines:
        """Some of the runs, not begun."""
        return Lines(self.line, self.lines[some], self.outcomes[some], np.zeros_like(self.now))


# Indices into Lines.now: the run whose turn it is; whether it is in the line.
RUN, UNDER_WAY = range(2)


class Places:
    """Where arrays of figures, or of whole numbers as long as figures, stand in a line."""

    def __init__(self, arrays: Sequence[Array]) -> None:
        """Make the line, with the arrays' figures in it."""
        self.kinds = [(a.dtype, a.shape, a.nbytes // BYTES) for a in arrays]
        room = [-(-size // AT_ONCE) * AT_ONCE for _, _, size in self.kinds]
        self.offsets = list(itertools.accumulate(room, initial=0))
        self.line = lined_up(self.offsets[-1])
        for view, array in zip(self.alone(), arrays, strict=True):
            view[...] = array
        self.first = self.line.copy()

    def alone(self) -> list[Array]:
        """The arrays in the line itself."""
        return [
            self.line[at : at + size].view(kind).reshape(shape)
            for (kind, shape, size), at in zip(self.kinds, self.offsets, strict=False)
        ]

    def views(self, lines: Floats) -> list[Array]:
        """Each array in all these lines, (runs, ...)."""
        found = []
        for (kind, shape, _), at in zip(self.kinds, self.offsets, strict=False):
            steps = (lines.strides[0], *np.empty(shape, kind).strides)
            found.append(np.ndarray((len(lines), *shape), kind, lines, BYTES * at, steps))
        return found

    def below_each_other(self, runs: int) -> Lines:
        """So many runs, all with the figures that the line had first."""
        return self.lines(np.tile(self.first, (runs, 1)))

    def lines(self, lines: Floats) -> Lines:
        """Runs that have not been played yet, each with a line of its own."""
        outcomes = np.full(len(lines), kernel.PAUSED)
        return Lines(self.line, lines, outcomes, np.zeros(2, dtype=np.int64))
