"""Many runs at a time: which way is chosen, that all ways give the same, and what an interrupt keeps."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import pytest
from joblib.externals.loky import get_reusable_executor

import hybrid
from hybrid.crew import (
    FORKS,
    HERE,
    LEAST_S,
    MOST_S,
    PROCESSES,
    START_S,
    THREADING,
    THREADS,
    Pace,
    can_fork,
    in_forks,
    in_processes,
    in_threads,
)
from hybrid.errors import RunError
from hybrid.interrupts import as_before, hear

Look = Callable[[float], None]

# Noise, drawn errors, a corner, a program: whatever a run may share with another by mistake.
PATCH = """
title: Many
machine: nominal
parameters: {start: 0.5, pull: 1}
analog:
  x: {integrate: {y: 1000}, initial: start, full_scale: 1}
  y: {integrate: {x: -1000*pull, brake: -200}, initial: 0, full_scale: 1}
  brake: {dead_zone: y, low: -0.1, high: 0.1, full_scale: 1}
interface: {s: {adc: x}}
digital: {period: 1 ms, program: {w: s}}
run: {until: 5 ms}
readouts: {last: {final: x}, top: {maximum: y}}
"""


@pytest.mark.parametrize(
    ("run_s", "locked_s", "count", "jobs", "way", "with_copies"),
    [
        (2e-3, 0.3e-3, 1000, 2, THREADS, THREADS),  # 1 s, as in processes once they have begun
        (2e-3, 2e-3, 1000, 2, HERE, FORKS),  # 2 s; in processes 1 s and the start
        (20e-3, 20e-3, 1000, 2, PROCESSES, FORKS),  # 10 s and the start, in place of 20 s
        (20e-3, 5e-3, 1000, 16, PROCESSES, FORKS),  # threads would wait for each other for 5 s
        (20e-3, 1e-4, 1000, 16, THREADS, THREADS),
        (1e-3, 1e-3, 10, 2, HERE, HERE),  # 10 ms
        (1.0, 0.0, 1, 16, HERE, HERE),
        (1.0, 0.0, 100, 1, HERE, HERE),
    ],
)
def test_the_quickest_way_is_taken(
    run_s: float, locked_s: float, count: int, jobs: int, way: str, with_copies: str
) -> None:
    assert 1.0 < START_S < 3.0 and THREADING >= 1.0  # what the figures above go by
    pace = Pace(run_s, locked_s)
    assert pace.way(count, jobs, forks=False) == way
    assert pace.way(count, jobs, forks=True) == with_copies


@pytest.mark.parametrize("run_s", [10.0, 0.1, 1e-3, 1e-6])
@pytest.mark.parametrize("jobs", [1, 2, 7])
def test_handfuls_are_neither_costly_to_lose_nor_uneven(run_s: float, jobs: int) -> None:
    found = Pace(run_s, 0.0).handfuls(range(1000), jobs)
    assert sorted(order for handful in found for order in handful) == list(range(1000))
    sizes = [len(handful) for handful in found]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] * run_s <= max(MOST_S, run_s)
    assert min(sizes[:-1], default=1000) * run_s >= 0.9 * min(LEAST_S, run_s)
    for number, size in enumerate(sizes):  # one begins as another does its last
        fair = -(-sum(sizes[number:]) // (2 * jobs if jobs > 1 else 1))
        assert size <= max(fair, LEAST_S / run_s, 1)


def test_as_many_handfuls_as_there_may_be_runs_are_made_at_once() -> None:
    """One by one; were what is left copied for each, this would not end."""
    assert len(Pace(10.0, 0.0).handfuls(range(10**6), 2)) == 10**6


def test_orders_side_by_side_are_not_played_by_one() -> None:
    found = Pace(1e-3, 0.0).handfuls(range(1000), 2)
    costly = [sum(order < 100 for order in handful) / len(handful) for handful in found[:4]]
    assert all(0.05 < share < 0.15 for share in costly)


@pytest.fixture(params=[HERE, THREADS, FORKS, PROCESSES])
def way(request, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == FORKS and not sys.platform.startswith("linux"):
        pytest.skip("only Linux copies processes soundly")
    if request.param == FORKS and not can_fork():
        get_reusable_executor().shutdown(wait=True)  # which has threads
        if not can_fork():
            pytest.skip("there are other threads about")
    monkeypatch.setattr(Pace, "way", lambda *_: request.param)
    return request.param


def test_every_way_gives_each_run_as_alone(way: str) -> None:
    patch = hybrid.parse_patch(PATCH)
    starts, serials = [0.1 * k for k in range(1, 9)], list(range(8))
    found = hybrid.batch(patch, {"start": starts}, serial=serials, jobs=2)
    assert found.status == "complete"
    assert [p.index for p in found.points] == serials
    for point in found.points:
        i = point.index
        alone = hybrid.run(patch, {"start": starts[i]}, serial=i, seed=point.seed)
        assert point.measured == alone.readouts
    assert len({p.measured["last"]["value"] for p in found.points}) == 8


def test_a_run_that_fails_leaves_the_others_in_peace(way: str) -> None:
    pulls = [1.0, float("1e300"), 2.0, 3.0, 1e300, 0.5]
    found = hybrid.batch(hybrid.parse_patch(PATCH), {"pull": pulls}, jobs=2)
    assert [p.status == "failed" for p in found.points] == [False, True, False, False, True, False]


def test_an_interrupt_keeps_what_is_done(way: str) -> None:
    def progress(done: float) -> None:
        if done > 0.2:
            raise KeyboardInterrupt

    patch = hybrid.parse_patch(PATCH)
    found = hybrid.batch(patch, runs=400, jobs=2, progress=progress)
    assert found.status == "interrupted"
    assert 80 < len(found.points) < 400
    assert all(p.status == "complete" for p in found.points)


@pytest.mark.parametrize("at_once", [1, 2])
def test_threads_end_at_their_next_look(at_once: int) -> None:
    done: list[int] = []
    looks = threading.Event()

    def play(handful: Sequence[int], look: Look) -> Iterator[int]:
        for order in handful:
            while order == 3:  # a run without end
                looks.set()
                time.sleep(1e-3)
                look(0.0)
            yield order

    endless = (range(k, k + at_once) for k in itertools.count(0, at_once))
    playing = in_threads(play, endless, 2, done)
    for _ in playing:
        if looks.is_set() and len(done) > 10:
            break
    playing.close()
    assert 3 not in done
    assert (2 in done) or at_once == 1  # the rest of a handful is kept
    assert threading.active_count() < 20


def threes(count: int) -> list[range]:
    return [range(k, min(k + 3, count)) for k in range(0, count, 3)]


def test_what_goes_wrong_is_raised() -> None:
    def play(handful: Sequence[int], look: Look | None = None) -> list[int]:
        return [1 // (order - 5) for order in handful]

    with pytest.raises(ZeroDivisionError):
        list(in_threads(play, threes(100), 2, []))
    with pytest.raises(ZeroDivisionError):
        list(in_forks(play, threes(100), 2, []))


class Odd(Exception):
    """It can be sent, but not read again."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(one + other)


def test_what_cannot_be_sent_is_told() -> None:
    here = os.getpid()

    def play(handful: Sequence[int], what: str) -> list[Any]:
        time.sleep(0.01)
        if os.getpid() == here:
            return list(handful)
        if what == "odd":
            raise Odd("not ", "possible")
        return [threading.Lock()]

    with pytest.raises(RunError, match="went wrong: Odd: not possible"):
        list(in_forks(partial(play, what="odd"), threes(100), 2, []))
    with pytest.raises(RunError, match=r"went wrong: TypeError: cannot pickle"):
        list(in_forks(partial(play, what="lock"), threes(100), 2, []))


def test_a_copy_that_is_ended_from_outside_is_told() -> None:
    here = os.getpid()

    def play(handful: Sequence[int]) -> Sequence[int]:
        if os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.01)
        return handful

    with pytest.raises(RunError, match="ended by the system"):
        list(in_forks(play, threes(100), 2, []))


LONG_CREW = """
import sys, time
from hybrid.crew import in_forks

def play(handful):
    time.sleep(0.05)
    return handful

done = []
for _ in in_forks(play, [[k] for k in range(10**6)], 2, done):
    if len(done) > 3:
        print("begun", flush=True)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux copies soundly")
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_copies_do_not_outlive_the_process_that_was_killed(end: signal.Signals) -> None:
    """The copies share its standard output, which is at its end when the last of them is gone."""
    command = [sys.executable, "-c", LONG_CREW]
    with subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True) as parent:
        assert parent.stdout is not None and parent.stdout.readline() == b"begun\n"
        parent.send_signal(end)
        try:
            parent.communicate(timeout=600)  # a handful takes 0.05 s
        finally:
            with suppress(ProcessLookupError):
                os.killpg(parent.pid, signal.SIGKILL)
    assert parent.returncode == -end


def test_an_interrupt_of_processes_does_not_warn() -> None:
    """joblib would, that handfuls are lost."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        playing = in_processes(_slowly, b"", [[k] for k in range(200)], 2, [])
        next(playing)
        playing.close()


def _slowly(shared: bytes, orders: Sequence[int]) -> list[int]:
    time.sleep(0.02)
    return list(orders)


def test_this_process_and_its_copies_play_every_order_once() -> None:
    done: list[tuple[int, int]] = []

    def play(handful: Sequence[int]) -> list[tuple[int, int]]:
        time.sleep(1e-3)
        return [(order**2, os.getpid()) for order in handful]

    list(in_forks(play, threes(101), 3, done))
    assert sorted(square for square, _ in done) == [k**2 for k in range(101)]
    players = {player for _, player in done}
    assert os.getpid() in players and len(players) == 3


def test_nothing_is_copied_beside_other_threads() -> None:
    ends = threading.Event()
    other = threading.Thread(target=ends.wait)
    other.start()
    assert not can_fork()
    ends.set()
    other.join()


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_every_way_to_end_a_command_is_an_interrupt_that_keeps_what_is_done(name: str) -> None:
    if not hasattr(signal, name):
        pytest.skip("this system has no such signal")
    number = getattr(signal, name)
    with as_before():
        signal.signal(number, signal.SIG_DFL)
        hear()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
