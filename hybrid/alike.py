"""Many runs for their readouts: those that are alike are played in one go.

Stage 5, for `points`. Each gives what `runs.run` gives of it alone.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hybrid.errors import HybridError
from hybrid.machine import Machine, Pen
from hybrid.played import Run
from hybrid.record import pens_for
from hybrid.runs import Progress, check_windows, finished, run, thinning
from hybrid.timeline import Timeline, build_timeline
from hybrid.together import attempt

if TYPE_CHECKING:
    from hybrid.engine.circuit import Circuit

Result = tuple[int, Run | HybridError]


@dataclass(frozen=True, slots=True)
class _Plan:
    """A run that can be played with others."""

    number: int
    machine: Machine
    circuit: Circuit
    timeline: Timeline
    pens: tuple[Pen, ...]

    @property
    def bytes(self) -> int:
        """What its record takes."""
        return 8 * len(self.pens) * self.timeline.rows


def run_each(
    machines: Sequence[Machine], seeds: Sequence[int], progress: Progress | None = None
) -> Iterator[Result]:
    """Run every machine for its readouts: its number and a Run, or why there is none, in any order.

    Runs that were complete when a KeyboardInterrupt came are given before it is raised.
    """
    kinds = defaultdict[Hashable, list[_Plan]](list)
    alone = set(range(len(machines)))
    if sum(bool(machine.elements) for machine in machines) > 1:
        for number in sorted(alone):
            planned = _planned(number, machines[number])
            if planned:
                kinds[planned[0]].append(planned[1])
    for plans in kinds.values():
        for some in _handfuls(plans):
            for number, result in _run_together(some, seeds, progress):
                alone.discard(number)
                yield number, result
    for number in sorted(alone):
        yield number, _run_alone(machines[number], seeds[number], progress)


def _run_alone(machine: Machine, seed: int, progress: Progress | None) -> Run | HybridError:
    def play(seed: int) -> Run:
        return run(machine, seed=seed, readouts_only=True, progress=progress)

    result = attempt(play, seed)
    if isinstance(result, Run) and result.status == "interrupted":  # half a run says nothing
        raise KeyboardInterrupt
    return result


def _planned(number: int, machine: Machine) -> tuple[Hashable, _Plan] | None:
    """A run and its likeness; None where it is to be played alone, be it for what is wrong with it."""
    from hybrid.engine.series import fits, likeness
    from hybrid.engine.wiring import circuit_of

    try:
        check_windows(machine)
        timeline = build_timeline(machine)
    except HybridError:
        return None
    if not fits(machine, timeline):
        return None
    circuit, pens = circuit_of(machine)[0], pens_for(machine, readouts_only=True)
    like = likeness(machine, circuit, timeline, pens)
    return like, _Plan(number, machine, circuit, timeline, pens)


def _handfuls(plans: list[_Plan]) -> Iterator[list[_Plan]]:
    """Those of one likeness, so many at a time that their records do not take too much."""
    from hybrid.engine.series import MOST_BYTES

    most = max(1, MOST_BYTES // max(plans[0].bytes, 1))
    for first in range(0, len(plans), most):
        if len(plans) - first > 1:
            yield plans[first : first + most]


def _run_together(
    plans: Sequence[_Plan], seeds: Sequence[int], progress: Progress | None
) -> Iterator[Result]:
    from hybrid.engine.series import Series

    first = plans[0]
    keep_every = thinning(first.machine, first.timeline.rows)
    of_each = (
        [p.machine for p in plans],
        [p.circuit for p in plans],
        [seeds[p.number] for p in plans],
    )
    try:
        series = Series(*of_each, first.timeline, first.pens, keep_every)
    except HybridError:  # of one of them, which will say so alone
        return
    began_s, interrupted = time.perf_counter(), False
    try:
        for done in series.play():
            if progress:
                progress(done)
    except KeyboardInterrupt:
        interrupted = True
    played_s = (time.perf_counter() - began_s) / len(plans)
    for at, player in series.players():
        yield plans[at].number, finished(player, first.pens, "nonlinear", played_s)
    if interrupted:
        raise KeyboardInterrupt
