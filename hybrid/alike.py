"""Many runs for their readouts: those that are alike are played in one go.

Stage 5, for `points`. Each gives what `runs.run` gives of it alone.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Hashable, Iterator, Sequence
from typing import TYPE_CHECKING

from hybrid.errors import HybridError
from hybrid.machine import Machine
from hybrid.played import Run
from hybrid.record import pens_for
from hybrid.runs import Progress, check_windows, finished, run, thinning
from hybrid.timeline import build_timeline
from hybrid.together import attempt

if TYPE_CHECKING:
    from hybrid.engine.series import Member

Result = tuple[int, Run | HybridError]


def run_each(
    machines: Sequence[Machine], seeds: Sequence[int], progress: Progress | None = None
) -> Iterator[Result]:
    """Run every machine for its readouts: its number and a Run, or why there is none, in any order.

    Runs that were complete when a KeyboardInterrupt came are given before it is raised.
    """
    alone = set(range(len(machines)))
    if sum(bool(machine.elements) for machine in machines) > 1:
        for numbers, members in _kinds(machines, seeds):
            for at, result in _run_together(members, progress):
                alone.discard(numbers[at])
                yield numbers[at], result
    for number in sorted(alone):
        yield number, _run_alone(machines[number], seeds[number], progress)


def _run_alone(machine: Machine, seed: int, progress: Progress | None) -> Run | HybridError:
    def play(seed: int) -> Run:
        return run(machine, seed=seed, readouts_only=True, progress=progress)

    result = attempt(play, seed)
    if isinstance(result, Run) and result.status == "interrupted":  # half a run says nothing
        raise KeyboardInterrupt
    return result


def _kinds(
    machines: Sequence[Machine], seeds: Sequence[int]
) -> Iterator[tuple[Sequence[int], Sequence[Member]]]:
    """Runs of one likeness, so many that they do not take too much room, and their numbers."""
    from hybrid.engine.series import MOST_BYTES

    kinds: dict[Hashable, list[tuple[int, Member]]] = defaultdict(list)
    for number, (machine, seed) in enumerate(zip(machines, seeds, strict=True)):
        member = _member_for(machine, seed)
        if member:
            kinds[member.likeness].append((number, member))
    for kind in kinds.values():
        most = max(1, MOST_BYTES // kind[0][1].bytes)
        for first in range(0, len(kind), most):
            some = kind[first : first + most]
            yield [number for number, _ in some], [member for _, member in some]


def _member_for(machine: Machine, seed: int) -> Member | None:
    """What a run is played by; None where it is to be played alone, be it for what is wrong with it."""
    from hybrid.engine.preparation import coupling_of, deck_of
    from hybrid.engine.series import Member, fits
    from hybrid.engine.wiring import circuit_of

    try:
        check_windows(machine)
        timeline = build_timeline(machine)
    except HybridError:
        return None
    if not fits(machine, timeline):
        return None
    circuit, pens = circuit_of(machine)[0], pens_for(machine, readouts_only=True)
    coupling, (_, registers) = coupling_of(machine), deck_of(machine.tape)
    return Member(machine, circuit, coupling, registers, timeline, pens, seed)


def _run_together(members: Sequence[Member], progress: Progress | None) -> Iterator[Result]:
    """Run those that can be played together, by their places among the members."""
    from hybrid.engine.series import Series

    series = None
    skipped = 0
    while series is None and len(members) - skipped > 1:
        first = members[skipped]
        keep_every = thinning(first.machine, first.timeline.rows)
        try:
            series = Series(members[skipped:], keep_every)
        except HybridError:  # of the first one, which will say so alone
            skipped += 1
    if series is None:
        return
    began_s, interrupted = time.perf_counter(), False
    try:
        for done in series.play():
            if progress:
                progress(done)
    except KeyboardInterrupt:
        interrupted = True
    played_s = (time.perf_counter() - began_s) / len(series.members)
    for at, player in series.players():
        result = finished(player, first.pens, "nonlinear", played_s)
        if result.status == "interrupted":  # while it was read out: those before and after are kept
            interrupted = True
        else:
            yield skipped + at, result
    if interrupted:
        raise KeyboardInterrupt
