"""How the engine's functions are compiled: one way for all, so that they may call each other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: Any) -> Any:
    """Compile at first call, keep on disk, release the interpreter lock, follow IEEE division."""
    return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})(function)


def compiled_alike(function: _Function) -> _Function:
    """The same, for what calls it with the types it was written with."""
    made: _Function = compiled(function)
    return made


def inlined(function: Any) -> Any:
    """Compiled into its caller: a call would cost more than these few operations."""
    return numba.njit(
        cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, inline="always"
    )(function)


def strictly(function: Any) -> Any:
    """As `compiled`, but with every operation as it is written: none is fused with another."""
    return numba.njit(cache=True, nogil=True, error_model="numpy")(function)
