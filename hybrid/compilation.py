"""What is said before what takes long: engines that are compiled, once, and noise that is played in very
short windows. Stage 8.

Every function is kept on disk as soon as it is compiled, so a run after an interrupted one goes on from
there.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from hybrid.terminal import say

if TYPE_CHECKING:
    from hybrid.machine import Machine

# Modules of the engine whose functions every circuit needs.
CIRCUIT_MODULES = frozenset(
    [
        "corners",
        "handover",
        "interplay",
        "lengths",
        "nodes",
        "overloads",
        "relaxation",
        "sweep",
        "switching",
    ]
)
# Which of them only some circuits need.
NOT_FOR_ALL = frozenset({"play_limited_circuit"})
# Rows of a run that is over within seconds, be every interval prepared by itself.
MANY_INTERVALS = 100_000
TAKES = "a few minutes, more where the machine is busy"


class _Said(logging.Handler):
    """What the package logs, on standard error."""

    def emit(self, record: logging.LogRecord) -> None:
        say(record.getMessage())


def say_if_compiling(machine: Machine, engine: str) -> None:
    """The first run after installation takes a while; say why, now and when it is on its way."""
    from hybrid.engine import kernel

    logger = logging.getLogger("hybrid")
    if not logger.handlers:
        logger.addHandler(_Said())
        logger.setLevel(logging.INFO)
        logger.propagate = False

    limited = len(machine.tape.length_of) > 0
    if not kernel.is_compiled(kernel.play):
        say("compiling the kernel, once after installation ...")
    elif engine == "exact" and _computes_anew(machine):
        programs = "with word lengths" if limited else "of more than products and sums"
        say(f"compiling the kernel for programs {programs}, once after installation ...")
    if engine == "nonlinear":
        _say_of_circuits(machine, limited)


def say_if_slow(machine: Machine, engine: str) -> None:
    """A run may take far longer than anybody would wait; say why before it begins."""
    if engine == "nonlinear":
        from hybrid.loudness import short_windows

        if told := short_windows(machine):
            say(told)
    elif machine.timing.until > MANY_INTERVALS * machine.timing.every:
        from hybrid.timeline import seldom_text

        if told := seldom_text(machine):
            say(told)


def _computes_anew(machine: Machine) -> bool:
    """Whether what plays programs such as this one's is still to be compiled."""
    from hybrid.engine import kernel
    from hybrid.engine.linear import player_of
    from hybrid.engine.preparation import deck_of

    return not kernel.is_compiled(player_of(deck_of(machine.tape)[0]))


def _say_of_circuits(machine: Machine, limited: bool) -> None:
    from hybrid.engine import kernel
    from hybrid.engine.interplay import play_circuits, play_limited_circuit

    noisy = any(element.noise > 0.0 for _, element in machine.elements)
    play = play_limited_circuit if limited else play_circuits
    if kernel.is_compiled(play, "Noise(" if noisy else "none"):
        return
    kept, of_all = functions_kept()
    what = "the nonlinear engine"
    if 0 < kept < of_all:
        say(f"compiling the rest of {what}, {kept} of its {of_all} functions are kept: {TAKES} ...")
        return
    if kept:  # the engine is there, but not for this kind of run
        kinds = ("noise",) * noisy + ("limited word lengths",) * limited
        what += f" for {' and '.join(kinds)}" if kinds else ""
    say(f"compiling {what}, once after installation: {TAKES} ...")


def functions_kept() -> tuple[int, int]:
    """How many of the functions that every circuit needs are compiled and kept; how many it needs."""
    from hybrid.engine import interplay, kernel

    needed = {
        f"{name}.{made.py_func.__name__}"
        for name in CIRCUIT_MODULES
        for made in vars(sys.modules[f"{interplay.__package__}.{name}"]).values()
        if _is_kept_alone(made, f"{interplay.__package__}.{name}")
    }
    # An index is called MODULE.FUNCTION-LINE.pyVERSION.nbi.
    kept = {
        path.name.rpartition("-")[0] for path in Path(kernel.play._cache.cache_path).glob("*.nbi")
    }
    return len(kept & needed), len(needed)


def _is_kept_alone(made: object, module: str) -> bool:
    """Whether this is a compiled function of the module that is not part of its callers."""
    own = getattr(made, "py_func", None)
    if own is None or own.__module__ != module or own.__name__ in NOT_FOR_ALL:
        return False
    return getattr(made, "targetoptions", {}).get("inline") != "always"
