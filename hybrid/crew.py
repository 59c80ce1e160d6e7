"""Many runs at a time: in this process alone, in threads or copies of it, or in processes of their own.

Stage 7, for `points`. Copies (forks, on Linux) share the machine code, the patch and all that is known
of it, and are there at once; where other threads are about, as in a notebook, they would not be sound.
Threads share as much, and the engines let go of Python's lock while they play; but whatever else belongs
to a run is done by one thread at a time. Processes of their own take seconds to start. What is quickest
depends on the runs, so two of them are timed first. The results do not depend on it.
"""

from __future__ import annotations

import gc
import itertools
import multiprocessing
import signal
import sys
import threading
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from hybrid.errors import RunError
from hybrid.interrupts import deaf_children

Order = TypeVar("Order")
Result = TypeVar("Result")
# Plays a handful of orders, one after the other; calls what it is given now and then, which raises
# KeyboardInterrupt when all ends.
Play = Callable[[Sequence[Order], Callable[[float], None]], Iterable[Result]]

# To start a process, import Hybrid and load compiled kernels: 1 s to 3 s on the machines we know.
START_S = 2.0
# To copy this one.
FORK_S = 0.02
# A thread that is given Python's lock finds what it needs in the other core's memory.
THREADING = 1.5
# No more work is played at once: a process or copy loses all of it when the crew is interrupted.
MOST_S = 0.5
# And no less: enough to hide the hand-over, and that what its runs share is computed once.
LEAST_S = 5e-3
# Orders side by side are so many handfuls apart, as long as there are as many.
SPREAD = 32
# A copy is asked for so many handfuls before it has played one: it need not wait for the next.
AHEAD = 2
# Threads are asked for the runs they have done so often.
LOOK_S = 0.05

HERE, THREADS, FORKS, PROCESSES = "here", "threads", "forks", "processes"


@dataclass(frozen=True, slots=True)
class Pace:
    """How long a run takes, and how much of that keeps other threads waiting; in s."""

    run_s: float
    locked_s: float

    def way(self, count: int, jobs: int, forks: bool) -> str:
        """The quickest way to play `count` runs, `jobs` at a time; forks: they would be sound."""
        jobs = min(jobs, count)
        if jobs < 2:
            return HERE
        share_s = count * self.run_s / jobs
        takes_s = {
            HERE: count * self.run_s,
            THREADS: max(share_s, count * self.locked_s * THREADING),
            PROCESSES: share_s + START_S,
        }
        if forks:
            takes_s[FORKS] = share_s + FORK_S
        return min(takes_s, key=lambda way: takes_s[way])

    def handfuls(self, orders: Sequence[Order], jobs: int) -> list[Sequence[Order]]:
        """What is to be played at once, `jobs` such handfuls at a time, the first ones first.

        Large ones first, each a fair share of half of what is left, so that little is lost to hand-overs
        and all end together (guided self-scheduling, Polychronopoulos and Kuck, IEEE Trans. Computers
        C-36, 1987). Costly runs, which often stand side by side, are spread over them.
        """
        most, least = (max(1, int(s / max(self.run_s, 1e-9))) for s in (MOST_S, LEAST_S))
        left = orders if jobs == 1 else [o for i in range(SPREAD) for o in orders[i::SPREAD]]
        found = list[Sequence[Order]]()
        while left:
            share = -(-len(left) // (2 * jobs)) if jobs > 1 else len(left)
            size = min(max(share, least), most)
            found.append(left[:size])
            left = left[size:]
        return found


def in_threads(
    play: Play[Order, Result],
    handfuls: Iterable[Sequence[Order]],
    jobs: int,
    done: list[Result],
) -> Generator[None, None, None]:
    """Play all handfuls of orders in `jobs` threads; yields now and then.

    Each result is appended to `done` as soon as it is there. Raises what a run raises. When it is closed
    early, the runs under way end at their next look.
    """
    todo, lock = iter(handfuls), threading.Lock()
    stop, failures = threading.Event(), list[BaseException]()

    def look(_: float) -> None:
        if stop.is_set():
            raise KeyboardInterrupt

    def taken() -> Sequence[Order] | None:
        with lock:
            return next(todo, None)

    def work() -> None:
        try:
            while (handful := taken()) is not None:
                for result in play(handful, look):
                    done.append(result)
                    if stop.is_set():
                        return
        except KeyboardInterrupt:
            stop.set()
        except BaseException as failure:  # raised again where the crew was asked for
            failures.append(failure)
            stop.set()

    crew = [threading.Thread(target=work, daemon=True) for _ in range(jobs)]
    try:
        for thread in crew:
            thread.start()
        for thread in crew:
            while thread.is_alive():
                thread.join(LOOK_S)
                yield
    finally:
        stop.set()
        for thread in crew:
            thread.join()
    if failures:
        raise failures[0]


def in_forks(
    play: Callable[[Sequence[Order]], Iterable[Result]],
    handfuls: Sequence[Sequence[Order]],
    jobs: int,
    done: list[Result],
) -> Generator[None, None, None]:
    """Play all handfuls of orders in this process and `jobs` - 1 copies of it.

    Results are appended to `done`, those of copies a handful at a time, in the order in which they come;
    yields after each handful. Raises what a run raises, and RunError where a copy has been ended by
    somebody else. When it is closed early the copies are ended, and with them the handfuls under way;
    when this process is killed they end after theirs.
    """
    todo, copies = iter(range(len(handfuls))), _Copies()
    try:
        copies.start(min(jobs, len(handfuls)) - 1, partial(_serve, play, handfuls))
        for pipe in copies.crew:
            copies.ask(pipe, itertools.islice(todo, AHEAD))
        own = next(todo, None)
        while own is not None or copies.asked:
            if own is not None:
                for result in play(handfuls[own]):
                    done.append(result)
                yield
            for pipe, found in copies.answers(waits=own is None):
                done.extend(found)
                copies.ask(pipe, itertools.islice(todo, 1))
                yield
            own = next(todo, None)
    finally:
        copies.end()


class _Copies:
    """Copies of this process, each with a line to it, and how many answers it owes."""

    def __init__(self) -> None:
        self.crew: dict[Connection, BaseProcess] = {}
        self.owed = Counter[Connection]()

    def start(self, how_many: int, serve: Callable[..., None]) -> None:
        """Start copies that do `serve(line, ends of lines that are not theirs)`."""
        context = multiprocessing.get_context("fork")
        with deaf_children(), warnings.catch_warnings():
            # That threads do not live on in the copies; those of numpy are made anew.
            warnings.simplefilter("ignore", DeprecationWarning)
            for _ in range(how_many):
                here, there = context.Pipe()
                copied = (*self.crew, here)
                self.crew[here] = context.Process(target=serve, args=(there, copied), daemon=True)
                self.crew[here].start()
                there.close()

    def ask(self, pipe: Connection, handfuls: Iterable[int]) -> None:
        """Ask a copy for these handfuls."""
        for which in handfuls:
            try:
                pipe.send(which)
            except OSError:
                raise _ended() from None
            self.owed[pipe] += 1

    @property
    def asked(self) -> list[Connection]:
        """Lines to the copies that owe an answer."""
        return [pipe for pipe, count in self.owed.items() if count]

    def answers(self, waits: bool) -> Iterator[tuple[Connection, list[Any]]]:
        """Handfuls of results that are there; `waits`: for one at least."""
        for pipe in wait(self.asked, None if waits else 0.0):
            assert isinstance(pipe, Connection)
            self.owed[pipe] -= 1
            yield pipe, _received(pipe)

    def end(self) -> None:
        """End all copies. The system takes its time to clear up after each: the next crew, or the end of
        this process, sees that they are gone."""
        for pipe, process in self.crew.items():
            process.terminate()
            pipe.close()


def _serve(
    play: Callable[[Any], Any],
    handfuls: Sequence[Any],
    pipe: Connection,
    copied: Sequence[Connection],
) -> None:
    """Play the handfuls that are asked for, in a copy, until it is ended or nobody is left who asks.

    `copied`: the ends of the lines, this one's and those of earlier copies, which must be open in the
    main process alone, so that its end is heard here.
    """
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # else the memory of all that there is would be copied to be looked through
    for end in copied:
        end.close()
    with suppress(EOFError, OSError):  # the main process was killed
        while True:
            which = pipe.recv()
            try:
                answer: Any = list(play(handfuls[which]))
            except BaseException as failure:  # raised again where the crew was asked for
                answer = failure
            pipe.send(answer)


def _ended() -> RunError:
    return RunError("a process that played runs has been ended by the system")


def _received(pipe: Connection) -> list[Any]:
    """A handful of results; raises what went wrong."""
    try:
        found = pipe.recv()
    except (EOFError, OSError):
        raise _ended() from None
    if isinstance(found, BaseException):
        raise found
    return list(found)


def can_fork() -> bool:
    """Whether copies of this process would be sound: another thread may hold a lock for good."""
    return sys.platform == "linux" and threading.active_count() == 1


def in_processes(
    play: Callable[[Any, Sequence[Order]], list[Result]],
    shared: bytes,
    handfuls: Sequence[Sequence[Order]],
    jobs: int | None,
    done: list[Result],
) -> Generator[None, None, None]:
    """Play all handfuls of orders by `play(shared, handful)`, wherever joblib works, a Dask cluster too.

    jobs: at a time, as many as joblib finds right if None. Results are appended to `done` a handful at a
    time, in the order in which they come; yields then. Raises what a run raises. When it is closed
    early the handfuls under way are lost.
    """
    import joblib

    # A handful at a time: joblib would put more together, and one worker would end long after others.
    parallel = joblib.Parallel(n_jobs=jobs or -1, return_as="generator_unordered", batch_size=1)
    with deaf_children():
        answers = parallel(joblib.delayed(play)(shared, handful) for handful in handfuls)
    with _closed_in_peace(answers):
        for found in answers:
            done.extend(found)
            yield


@contextmanager
def _closed_in_peace(handfuls: Generator[Any, None, None]) -> Iterator[None]:
    """Close joblib's generator without its warning that handfuls are lost, as they are meant to be."""
    try:
        yield
    finally:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", category=UserWarning, module=r"joblib\.parallel")
            handfuls.close()


def has_cluster() -> bool:
    """Whether joblib has been told to work elsewhere than in processes of this machine."""
    if "joblib" not in sys.modules:
        return False
    from joblib.parallel import get_active_backend

    return type(get_active_backend()[0]).__name__ != "LokyBackend"
