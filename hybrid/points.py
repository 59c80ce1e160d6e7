"""Many runs of one patch, on all cores: what sweeps and batches are made of.

Stage 7. Runs are independent; each has its own seed, kept in the result, so that any one can be
replayed alone. Where they are interrupted, those that are done are kept.
"""

from __future__ import annotations

import functools
import json
import math
import os
import pickle
import time
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid.alike import run_each
from hybrid.arguments import whole_number
from hybrid.compiler import compile_patch
from hybrid.crew import (
    FORKS,
    HERE,
    MOST_S,
    PROCESSES,
    THREADS,
    Pace,
    can_fork,
    has_cluster,
    in_forks,
    in_processes,
    in_threads,
)
from hybrid.errors import HybridError, RunError, counted
from hybrid.expressions import names, to_text
from hybrid.linearity import brief
from hybrid.machine import Machine
from hybrid.one_thread import one_thread
from hybrid.patch import Patch, Readout
from hybrid.played import Run
from hybrid.prediction import Prediction, predict_each
from hybrid.record import changed_names, patch_hash, signal_units, versions_text
from hybrid.streams import run_seed
from hybrid.together import attempt, passed_on

MOST_POINTS = 1_000_000
# Runs that are played before the others, to see how long they take: the first one loads the engine;
# where they are short, some more together, as the others will be.
PACED, SHORT_S = (1, 1, 12), 10e-3
# Points handed to a worker of a cluster at once.
POINTS_AT_ONCE = 20
MOST_JOBS = 1000

MEASURED = ("omega", "omega_damped", "zeta", "omega_error", "omega_damped_error", "zeta_error")
TIMED = ("final", "maximum", "minimum")  # readouts that give a time with their value

Variable = tuple[tuple[str, ...], Any, dict[str, str]]


@dataclass(frozen=True, slots=True)
class Order:
    """One run to be made: its parameters in SI, serial number (None: the patch's) and seed.

    `lot`: its seed, or the seed and the names of the stream that draws it. To draw those of 300,000 runs
    takes 10 s and more, so each is drawn when its run's turn comes.
    """

    index: int
    parameters: dict[str, float]
    serial: int | None
    lot: int | tuple[int, tuple[str, ...]]

    @property
    def seed(self) -> int:
        """For the noise of this run."""
        if isinstance(self.lot, int):
            return self.lot
        of_all, stream_names = self.lot
        return run_seed(of_all, stream_names, self.index)


@dataclass(frozen=True, slots=True)
class Point:
    """One run: what was measured and, if asked for, predicted, or why not."""

    index: int
    measured: dict[str, dict[str, Any]]
    modes: tuple[dict[str, Any], ...]
    status: str  # as of a run, or 'failed'
    note: str
    overloads: int
    seed: int

    @property
    def has_result(self) -> bool:
        """Whether any of the point's readouts has figures (of a patch without any: it was run)."""
        reasons = [quantities.get("reason") for quantities in self.measured.values()]
        return self.status != "failed" and not (reasons and all(reasons))

    @property
    def remarks(self) -> str:
        """The note, why readouts have no figures, and what is to be said of those they have."""
        told = [(n, q.get(key)) for n, q in self.measured.items() for key in ("reason", "note")]
        reasons = [f"{n}: {text}" for n, text in told if text]
        return "; ".join(dict.fromkeys(text for text in (self.note, *reasons) if text))


@dataclass(frozen=True, slots=True)
class Task:
    """What all runs share; travels to the workers. `predicts`: the modes are asked for, too."""

    patch: Patch
    machine: str | None
    predicts: bool

    def points(
        self, orders: Sequence[Order], progress: Callable[[float], None] | None = None
    ) -> Iterator[Point]:
        """Predict all at once, then run and read out one after the other, each point as if it were
        alone; `progress` may raise KeyboardInterrupt."""
        for point, _ in self.played(orders, progress):
            yield point

    def played(
        self, orders: Sequence[Order], progress: Callable[[float], None] | None = None
    ) -> Iterator[tuple[Point, float]]:
        """The same, and for how many seconds the engine played each."""
        machines = [attempt(self._compiled, order) for order in orders]
        predictions = passed_on(machines, self._predicted)
        ready = list[tuple[Order, Machine, Prediction | RunError | None]]()
        for order, machine, prediction in zip(orders, machines, predictions, strict=True):
            if isinstance(machine, HybridError):
                yield _failed(order, order.seed, machine), 0.0
            elif isinstance(prediction, HybridError) and not isinstance(prediction, RunError):
                yield _failed(order, order.seed, prediction), 0.0
            else:
                ready.append((order, machine, prediction))
        seeds = [order.seed for order, _, _ in ready]
        for number, result in run_each([machine for _, machine, _ in ready], seeds, progress):
            order, _, prediction = ready[number]
            if isinstance(result, HybridError):
                yield _failed(order, seeds[number], result), 0.0
            else:
                yield _point(order, result, prediction), result.played_s

    def _compiled(self, order: Order) -> Machine:
        return compile_patch(self.patch, order.parameters, self.machine, order.serial)

    def _predicted(self, machines: list[Machine]) -> Sequence[Prediction | HybridError | None]:
        return predict_each(machines) if self.predicts else [None] * len(machines)


def _failed(order: Order, seed: int, error: HybridError) -> Point:
    """A run that could not be made."""
    return Point(order.index, {}, (), "failed", str(error), 0, seed)


def _point(order: Order, result: Run, prediction: Prediction | RunError | None) -> Point:
    """A run that was made."""
    modes, notes = tuple[dict[str, Any], ...](), [result.status_note]
    if isinstance(prediction, RunError):
        notes.insert(0, f"no prediction: {brief(prediction)}")
    elif prediction:
        modes = tuple(prediction.to_dicts())
    note, overloads = "; ".join(filter(None, notes)), len(result.overloads)
    return Point(order.index, result.readouts, modes, result.status, note, overloads, result.seed)


def check_names(patch: Patch, names: Iterable[str], taken: Collection[str], doing: str) -> None:
    """Raise RunError for a parameter with the name of a variable of the data set.

    taken: the variables beside those of the readouts; doing: what a parameter cannot then ("be swept").
    """
    of_readouts = {name for readout in patch.readouts for name in scalar_names(readout)}
    for name in names:
        if name in taken or name in of_readouts:
            raise RunError(
                f"the parameter {name} cannot {doing}: the result has a variable of that name; "
                "rename the parameter"
            )


def check_jobs(jobs: int | None) -> None:
    """Raise RunError for a number of runs at a time that is none."""
    if jobs is not None:
        whole_number("jobs", jobs, 1, MOST_JOBS)


@one_thread
def play_all(
    task: Task,
    orders: Sequence[Order],
    jobs: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[tuple[Point, ...], str]:
    """Make all runs; the points by index, and 'complete' or 'interrupted'.

    jobs: runs at a time (default: as many as there are cores); progress: called with the fraction done.
    """
    points: list[Point] = []
    status = "complete"
    try:
        with closing(_playing(task, orders, jobs, points)) as playing:
            for _ in playing:
                if progress:
                    progress(len(points) / len(orders))
    except KeyboardInterrupt:
        status = "interrupted"
    if status == "complete" and len(points) != len(orders):
        raise RunError(f"{len(orders) - len(points)} of {len(orders)} runs were lost on their way")
    return tuple(sorted(points, key=lambda point: point.index)), status


def _playing(
    task: Task, orders: Sequence[Order], jobs: int | None, points: list[Point]
) -> Generator[None, None, None]:
    """Play all orders the quickest way, the points being added to the list; yields now and then."""
    most = jobs or os.cpu_count() or 1
    pace, timed = Pace(MOST_S / POINTS_AT_ONCE, math.inf), 0  # where none is timed
    # Those in the middle: at either end of a sweep a run may be far longer than most.
    start = (len(orders) - sum(PACED)) // 2 if len(orders) > sum(PACED) else 0
    for count in PACED if not has_cluster() or jobs == 1 else ():
        if timed + count > len(orders) or (count > 1 and pace.run_s > SHORT_S):
            break
        began_s, played_s = time.perf_counter(), 0.0
        for point, its_s in task.played(orders[start + timed : start + timed + count]):
            points.append(point)
            played_s += its_s
        run_s = (time.perf_counter() - began_s) / count
        pace, timed = Pace(run_s, run_s - played_s / count), timed + count
        yield
    rest = [*orders[:start], *orders[start + timed :]]
    way = pace.way(len(rest), most, can_fork()) if timed else PROCESSES
    handfuls = pace.handfuls(rest, 1 if way == HERE else most)
    if way == HERE:
        for handful in handfuls:
            for point in task.points(handful):
                points.append(point)
                yield
    elif way == THREADS:
        yield from in_threads(task.points, handfuls, most, points)
    elif way == FORKS:
        yield from in_forks(task.points, handfuls, most, points)
    elif rest:
        yield from in_processes(_points_of, pickle.dumps(task), handfuls, jobs, points)


def _points_of(packed: bytes, orders: Sequence[Order]) -> list[Point]:
    """The runs of a pickled task, one after the other."""
    return list(_unpacked(packed).points(orders))


# What a worker has learnt of a patch holds for its next handful.
@functools.lru_cache(maxsize=2)
def _unpacked(packed: bytes) -> Task:
    task: Task = pickle.loads(packed)
    return task


def counts_text(points: Sequence[Point]) -> str:
    """'2 without a result, 1 failed': what became of the points, those that are no news left out."""
    counts = {
        "without a result": sum(not p.has_result for p in points),
        "failed": sum(p.status == "failed" for p in points),
        "stopped early": sum(p.status == "stopped" for p in points),
        "with overloads": sum(p.overloads > 0 for p in points),
    }
    return ", ".join(f"{n} {what}" for what, n in counts.items() if n or "result" in what)


def done_text(status: str, done: int, of_all: int, what: str) -> str:
    """'interrupted after 3 of 50 points'; '' where all are done."""
    return "" if status == "complete" else f"{status} after {done} of {counted(of_all, what)}"


# -- the points as variables of a data set ----------------------------------------------------------


def number(value: Any) -> float:
    """A figure, or NaN where there is none."""
    return math.nan if value is None else float(value)


def transients(patch: Patch) -> list[str]:
    """Names of the readouts that have a frequency and a damping ratio."""
    return sorted(r.name for r in patch.readouts if r.kind == "transient")


def measured_variables(points: Sequence[Point], first: Machine, along: str) -> dict[str, Variable]:
    """What was read out and what became of each run, over dimension `along`."""
    readouts = transients(first.patch)
    found: dict[str, Variable] = {}
    for quantity in MEASURED:
        table = np.full((len(points), len(readouts)), np.nan)
        for i, point in enumerate(points):
            for j, name in enumerate(readouts):
                table[i, j] = number(point.measured.get(name, {}).get(quantity))
        unit = {"units": "" if quantity.startswith("zeta") else "rad/s"}
        found[f"measured_{quantity}"] = ((along, "readout"), table, unit)
    found |= _scalar_variables(points, first, along)
    texts = {"status": [p.status for p in points], "note": [p.remarks for p in points]}
    for fact, lines in texts.items():
        found[fact] = ((along,), np.array(lines, dtype=object), {})
    found["overloads"] = ((along,), np.array([p.overloads for p in points], dtype=int), {})
    found["seed"] = ((along,), np.array([p.seed for p in points], dtype=np.int64), {})
    return found


def scalar_names(readout: Readout) -> tuple[str, ...]:
    """Variables that a readout other than a transient fills."""
    if readout.kind == "transient":
        return ()
    timed = (f"time_{readout.name}",) if readout.kind in TIMED else ()
    return (f"value_{readout.name}", *timed)


def _scalar_variables(points: Sequence[Point], first: Machine, along: str) -> dict[str, Variable]:
    """Value, in the unit of its signal, and time of every readout that is no transient."""
    units = signal_units(first)
    found: dict[str, Variable] = {}
    for readout in first.patch.readouts:
        for name in scalar_names(readout):
            quantity, unit = ("time_s", "s") if name.startswith("time_") else ("value", "")
            column = [number(p.measured.get(readout.name, {}).get(quantity)) for p in points]
            about = {"units": unit or units[readout.signal][0]}
            about |= {"readout": readout.kind, "signal": readout.signal}
            about |= {"window": window} if (window := window_text(readout)) else {}
            found[name] = ((along,), np.array(column, dtype=np.float64), about)
    return found


def window_text(readout: Readout) -> str:
    """The part of the record that a readout sees, 'from 2 s until 4*period'; '' where it is all."""
    told = []
    for word, value in (("from", readout.start), ("until", readout.end)):
        if value is not None:
            plain = not names(value.expr)
            told.append(f"{word} {f'{value.number({}):g} s' if plain else to_text(value.expr)}")
    return " ".join(told)


def origin(first: Machine, varied: Collection[str]) -> dict[str, str]:
    """Attributes that say where a data set comes from; varied: parameters that its runs differ in."""
    patch = first.patch
    return {
        "title": patch.title,
        "patch": patch.file,
        "patch_hash": patch_hash(patch),
        "file_hashes": json.dumps(patch.files),
        "on": json.dumps(dict(patch.on)),
        "changed": json.dumps([name for name in changed_names(first) if name not in varied]),
        "machine": first.preset,
        "versions": versions_text(),
    }
