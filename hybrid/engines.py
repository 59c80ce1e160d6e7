"""Which engine plays a run: by name, or the one that suits the patch.

Stage 5, for `runs`.
"""

from __future__ import annotations

import math
from typing import Any

from hybrid.circuits import is_linear
from hybrid.coupling import not_linear
from hybrid.engine.exact import ExactPlayer
from hybrid.engine.linear import Player
from hybrid.errors import PatchError, RunError, did_you_mean, shown
from hybrid.machine import Machine
from hybrid.modes import CONTINUE

ENGINES = ("auto", "exact", "nonlinear", "reference")


def check_engine(engine: Any) -> str:
    """The name itself; raises RunError for one that is none."""
    if isinstance(engine, str) and engine in ENGINES:
        return engine
    hint = did_you_mean(engine if isinstance(engine, str) else "", ENGINES)
    raise RunError(f"unknown engine {shown(engine)}; {hint}")


def wants_circuit(engine: str) -> bool:
    """Whether the engine plays even a linear analog side as a circuit."""
    return engine in ("nonlinear", "reference")


def engine_of(machine: Machine, engine: str) -> str:
    """The engine that plays the machine: `exact`, `nonlinear` or `reference`.

    Raises PatchError where the exact engine is asked for and something is not linear, RunError for a
    machine that was compiled for another engine.
    """
    if engine == "auto":
        return "nonlinear" if machine.elements else "exact"
    if engine == "exact" and machine.elements:
        _refuse_modes(machine)
        if is_linear(machine.patch) and not _saturates(machine):
            raise RunError(
                "this machine was compiled for other engines than the exact one; give the patch"
            )
        reason = not_linear(machine)
        what = f"the exact engine plays linear patches only: {reason.message}"
        raise PatchError(what, reason.place)
    if wants_circuit(engine) and not machine.elements:
        raise RunError(
            f"this machine was compiled for the exact engine; give the patch to play it on {engine!r}"
        )
    if engine == "reference" and machine.on_overload != CONTINUE:
        raise PatchError(
            "the reference engine knows no on_overload but continue; take nonlinear",
            machine.patch.run.until.place,
        )
    return engine


def _refuse_modes(machine: Machine) -> None:
    """The exact engine knows OP alone."""
    patch = machine.patch
    switched = [c for c in patch.components if c.is_switched]
    places = [c.place for c in switched] or [patch.run.until.place]
    if patch.leaves_op or switched:
        place = patch.modes.place if patch.modes else places[0]
        who = "the machine leaves OP" if patch.leaves_op else f"{switched[0].name} has its own"
        raise PatchError(
            f"the exact engine plays no modes (IC, HOLD), and {who}; take nonlinear", place
        )


def _saturates(machine: Machine) -> bool:
    return any(stage.saturation < math.inf for stage in machine.stages.values())


def player_of(machine: Machine, engine: str = "auto") -> type[Player]:
    """The player of an engine; those of circuits take long to load."""
    name = engine_of(machine, engine)
    if name == "exact":
        return ExactPlayer
    if name == "nonlinear":
        from hybrid.engine.windows import CircuitPlayer

        return CircuitPlayer
    from hybrid.engine.reference_player import ReferencePlayer

    return ReferencePlayer
