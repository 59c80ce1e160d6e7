"""Ctrl-C, SIGTERM, and SIGHUP of a terminal that is closed: who hears them, and when.

Stage 0. All raise KeyboardInterrupt while something is computed that can be kept; before, they end
the command at once, and afterwards they must not lose the result. Helping processes never hear them.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import NoReturn

SIGNALS = tuple(
    signal.Signals[name]
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if name in signal.Signals.__members__  # Windows has no terminals that hang up
)


@contextmanager
def as_before() -> Iterator[None]:
    """Whatever is done with the signals meanwhile, afterwards they do what they did before."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler or signal.SIG_DFL)


def hear() -> None:
    """From here on an interrupt ends the computing, and what is done is kept."""
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # a job in the background hears nothing
            signal.signal(number, _raise)


def ignore() -> None:
    """From here on there is a result to write: another Ctrl-C must not lose it."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _raise(*_: object) -> NoReturn:
    raise KeyboardInterrupt


@contextmanager
def deaf_children() -> Iterator[None]:
    """Processes started meanwhile never hear Ctrl-C, which a terminal sends to all of them.

    They inherit that it is ignored, and so load in peace; the main process alone decides.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)


@contextmanager
def held_back(starts_tracker: bool = True) -> Iterator[None]:
    """Ctrl-C waits until the end of this; processes started meanwhile never hear it.

    They inherit that the signal is blocked. Unlike one that is ignored, it is not lost for the main
    process. Where signals cannot be blocked, this is `deaf_children`. starts_tracker: the processes are
    of a kind that multiprocessing keeps a process for.
    """
    on_main = threading.current_thread() is threading.main_thread()
    if not hasattr(signal, "pthread_sigmask") or not on_main:
        with deaf_children():
            yield
        return
    if starts_tracker:  # the first process would, and that lets signals through
        resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
