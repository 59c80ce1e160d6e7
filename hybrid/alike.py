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
    from hybrid.engine.series import Order

Result = tuple[int, Run | HybridError]


def run_each(
    machines: Sequence[Machine], seeds: Sequence[int], progress: Progress | None = None
) -> Iterator[Result]:
    """Run every machine for its readouts: its number and a Run, or why there is none, in any order.

    Runs that were complete when a KeyboardInterrupt came are given before it is raised.
    """
    alone = set(range(len(machines)))
    if sum(bool(machine.elements) for machine in machines) > 1:
        for numbers, orders in _kinds(machines, seeds):
            for at, result in _run_together(orders, progress):
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
) -> Iterator[tuple[Sequence[int], Sequence[Order]]]:
    """Runs of one likeness, so many that they do not take too much room, and their numbers."""
    from hybrid.engine.series import MOST_BYTES

    kinds: dict[Hashable, list[tuple[int, Order]]] = defaultdict(list)
    for number, (machine, seed) in enumerate(zip(machines, seeds, strict=True)):
        order = _order_for(machine, seed)
        if order:
            kinds[order.likeness].append((number, order))
    for kind in kinds.values():
        most = max(1, MOST_BYTES // kind[0][1].bytes)
        for first in range(0, len(kind), most):
            some = kind[first : first + most]
            yield [number for number, _ in some], [order for _, order in some]


def _order_for(machine: Machine, seed: int) -> Order | None:
    """What a run is played by; None where it is to be played alone, be it for what is wrong with it."""
    from hybrid.engine.preparation import coupling_of
    from hybrid.engine.series import Order, fits
    from hybrid.engine.wiring import circuit_of

    try:
        check_windows(machine)
        timeline = build_timeline(machine)
    except HybridError:
        return None
    if not fits(machine, timeline):
        return None
    circuit, pens = circuit_of(machine)[0], pens_for(machine, readouts_only=True)
    return Order(machine, circuit, coupling_of(machine), timeline, pens, seed)


def _run_together(orders: Sequence[Order], progress: Progress | None) -> Iterator[Result]:
    """Run those that can be played together, by their places among the orders."""
    from hybrid.engine.series import Series

    series = None
    skipped = 0
    while series is None and len(orders) - skipped > 1:
        first = orders[skipped]
        keep_every = thinning(first.machine, first.timeline.rows)
        try:
            series = Series(orders[skipped:], keep_every)
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
    played_s = (time.perf_counter() - began_s) / len(series.orders)
    for at, player in series.players():
        result = finished(player, first.pens, "nonlinear", played_s)
        if result.status == "interrupted":  # while it was read out: those before and after are kept
            interrupted = True
        else:
            yield skipped + at, result
    if interrupted:
        raise KeyboardInterrupt
