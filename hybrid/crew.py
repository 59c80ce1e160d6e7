"""Many runs at a time: in this process alone, in threads or copies of it, or in processes of their own.

Stage 7, for `points`. Copies (forks, on Linux) share the machine code, the patch and all that is known
of it, and are there at once; where other threads are about, as in a notebook, they would not be sound.
Threads share as much, and the engines let go of Python's lock while they play; but whatever else belongs
to a run is done by one thread at a time. Processes of their own take seconds to start. What is quickest
depends on the runs, so some of them are timed first. The results do not depend on it.
"""

from __future__ import annotations

import gc
import multiprocessing
import pickle
import signal
import sys
import threading
import warnings
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
# To take a turn takes a microsecond; who has not given it back by then was ended in the middle of it.
LOST_S = 10.0
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
        spread = orders if jobs == 1 else [o for i in range(SPREAD) for o in orders[i::SPREAD]]
        found, at = list[Sequence[Order]](), 0
        while at < len(spread):
            left = len(spread) - at
            share = -(-left // (2 * jobs)) if jobs > 1 else left
            size = min(max(share, least), most)
            found.append(spread[at : at + size])
            at += size
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
    yields now and then. Raises what a run raises, and RunError where a copy has been ended by somebody
    else. When it is closed early the copies are ended, and with them the handfuls under way; when this
    process is killed they end after theirs.
    """
    turns, copies = _Turns(len(handfuls)), _Copies()
    listening = threading.Thread(target=copies.hear, args=(done,), daemon=True)
    try:
        copies.start(min(jobs, len(handfuls)) - 1, partial(_serve, play, handfuls, turns))
        listening.start()
        while not copies.failures and (turn := turns.take()) is not None:
            for result in play(handfuls[turn]):
                done.append(result)
            yield
        while listening.is_alive():
            listening.join(LOOK_S)
            yield
    finally:
        copies.end()
        if listening.ident:  # it was started, and hears that they are gone
            listening.join()
    if copies.failures:
        raise copies.failures[0]


class _Turns:
    """Whose turn it is, in memory that copies of this process share."""

    def __init__(self, count: int) -> None:
        self.count, self.next = count, multiprocessing.get_context("fork").Value("q", 0)

    def take(self) -> int | None:
        """The number of a handful that nobody else has; None where there are no more."""
        if not self.next.get_lock().acquire(timeout=LOST_S):
            raise _ended()  # within this very step
        try:
            turn, self.next.value = int(self.next.value), self.next.value + 1
        finally:
            self.next.get_lock().release()
        return turn if turn < self.count else None


class _Copies:
    """Copies of this process, each at the end of a line to it."""

    def __init__(self) -> None:
        self.crew: dict[Connection, BaseProcess] = {}
        self.failures: list[BaseException] = []

    def start(self, how_many: int, serve: Callable[..., None]) -> None:
        """Start copies that do `serve(line, ends of lines that are not theirs)`."""
        context = multiprocessing.get_context("fork")
        with deaf_children(), warnings.catch_warnings():
            # That threads do not live on in the copies; those of numpy are made anew.
            warnings.simplefilter("ignore", DeprecationWarning)
            for _ in range(how_many):
                here, there = context.Pipe(duplex=False)
                copied = (*self.crew, here)
                self.crew[here] = context.Process(target=serve, args=(there, copied), daemon=True)
                self.crew[here].start()
                there.close()

    def hear(self, done: list[Any]) -> None:
        """Append results as they come, until no copy has more, or one fails."""
        speaking = set(self.crew)
        while speaking and not self.failures:
            for pipe in wait(list(speaking)):
                assert isinstance(pipe, Connection)
                try:
                    found = pipe.recv()
                except (EOFError, OSError):
                    found = _ended()
                except Exception as failure:  # it cannot be read
                    found = failure
                if isinstance(found, BaseException):
                    self.failures.append(found)
                elif found is None:
                    speaking.discard(pipe)
                else:
                    done.extend(found)

    def end(self) -> None:
        """End all copies, which most have done by themselves."""
        for process in self.crew.values():
            process.terminate()
        for process in self.crew.values():
            process.join()


def _serve(
    play: Callable[[Any], Any],
    handfuls: Sequence[Any],
    turns: _Turns,
    pipe: Connection,
    copied: Sequence[Connection],
) -> None:
    """In a copy: play handfuls while there are any and somebody hears of it.

    `copied`: the ends of the lines, this one's and those of earlier copies, which must be open in the
    main process alone, so that its end is heard here.
    """
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # the main process decides
    gc.freeze()  # else the memory of all that there is would be copied to be looked through
    for end in copied:
        end.close()
    answer: Any = ()
    with suppress(OSError):  # the main process was killed
        while answer is not None and not isinstance(answer, BaseException):
            try:
                turn = turns.take()
                answer = None if turn is None else list(play(handfuls[turn]))
            except BaseException as failure:  # raised again where the crew was asked for
                answer = failure
            pipe.send_bytes(_packed(answer))


def _packed(answer: Any) -> bytes:
    """An answer as it is sent; of one that cannot be sent, or read again, what it was."""
    try:
        packed = pickle.dumps(answer)
        if isinstance(answer, BaseException):
            pickle.loads(packed)
    except Exception as failure:
        cause = answer if isinstance(answer, BaseException) else failure
        told = f"{type(cause).__name__}: {cause}"
        packed = pickle.dumps(RunError(f"a run in a copy of this process went wrong: {told}"))
    return packed


def _ended() -> RunError:
    return RunError("a process that played runs has been ended by the system")


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
