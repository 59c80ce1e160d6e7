"""How the engine's functions are compiled: one way for all, so that they may call each other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


_njit: Any = numba.njit  # its types do not know `_nrt`
_COMMON: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
_FUSED: dict[str, Any] = {**_COMMON, "fastmath": {"contract"}}


def compiled(function: Any) -> Any:
    """Compile at first call, keep on disk, release the interpreter lock, follow IEEE division.

    Such a function allocates nothing and counts no references to arrays: its caller holds them. Counting
    took half the time of circuits, whose functions pass some forty arrays to each other.
    """
    return _njit(**_FUSED, _nrt=False)(function)


def allocating(function: Any) -> Any:
    """The same for what makes arrays, or takes more than arrays from Python: these need the counts."""
    return _njit(**_FUSED, _nrt=True)(function)


def inlined(function: Any) -> Any:
    """Compiled into its caller.

    A call copies every array that it hands over, tuples of arrays whole: more than a few operations
    cost, and more than all that a window of a small circuit takes. There is a copy for every caller.
    """
    return _njit(**_FUSED, _nrt=False, inline="always")(function)


def strictly(function: Any) -> Any:
    """As `compiled`, but with every operation as it is written: none is fused with another.

    To leave `fastmath` out is not enough: numba then takes that of the function which calls this one.
    """
    return _njit(**_COMMON, _nrt=False, fastmath=False)(function)


def strictly_alike(function: _Function) -> _Function:
    """The same, for what calls it with the types it was written with."""
    made: _Function = strictly(function)
    return made
