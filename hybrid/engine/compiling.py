"""How the engine's functions are compiled: one way for all, so that they may call each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

_Function = TypeVar("_Function", bound=Callable[..., Any])


class _Kept(FunctionCache):
    """numba's cache on disk, without what only compiling needs.

    Before it looks, numba's own sets up all that it knows of types and functions, which takes longer
    than everything else that is loaded for a short run. The compiler does so itself, where it has to.
    """

    needs_runtime = False

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The compiled function for these types; None where there is none on disk."""
        if self.needs_runtime:
            rtsys.initialize(context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, context)  # type: ignore[no-untyped-call]


class _KeptAllocating(_Kept):
    """The same for what calls numba's runtime, which makes arrays and counts references to them."""

    needs_runtime = True


PACKAGE = Path(__file__).parent.parent


def kept_in(package: Path) -> Path | None:
    """The folder for what is compiled; None for numba's own choice, the package's __pycache__.

    That does for a checkout. Where the package is installed, pip would leave such files behind when it
    removes or replaces it, and Python would take the folders around them for an empty package.
    """
    if (package.parent / "pyproject.toml").exists():
        return None
    return package.parent / f"{package.name}-kernels"


@contextmanager
def _kept_beside_the_package() -> Iterator[None]:
    """numba asks where to keep a function when its cache is made; who has said so is heard."""
    said: Any = numba.config.CACHE_DIR  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = said or str(kept_in(PACKAGE) or "")  # type: ignore[attr-defined]
    try:
        yield
    finally:
        numba.config.CACHE_DIR = said  # type: ignore[attr-defined]


_COMMON: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_FUSED: dict[str, Any] = {**_COMMON, "fastmath": {"contract"}}


def _njit(function: Any, cache: type[_Kept] = _Kept, **settings: Any) -> Any:
    """numba's njit for a function that is kept on disk."""
    njit: Any = numba.njit  # its types do not know `_nrt`
    made = njit(**settings, _nrt=cache.needs_runtime)(function)
    if hasattr(made, "enable_caching"):  # numba may be told not to compile
        with _kept_beside_the_package():
            made._cache = cache(function)
    return made


def compiled(function: Any) -> Any:
    """Compile at first call, keep on disk, release the interpreter lock, follow IEEE division.

    Such a function allocates nothing and counts no references to arrays: its caller holds them. Counting
    took half the time of circuits, whose functions pass some forty arrays to each other.
    """
    return _njit(function, **_FUSED)


def allocating(function: Any) -> Any:
    """The same for what makes arrays, or takes more than arrays from Python: these need the counts."""
    return _njit(function, _KeptAllocating, **_FUSED)


def inlined(function: Any) -> Any:
    """Compiled into its caller.

    A call copies every array that it hands over, tuples of arrays whole: more than a few operations
    cost, and more than all that a window of a small circuit takes. There is a copy for every caller.
    """
    return _njit(function, **_FUSED, inline="always")


def strictly(function: Any) -> Any:
    """As `compiled`, but with every operation as it is written: none is fused with another.

    To leave `fastmath` out is not enough: numba then takes that of the function which calls this one.
    """
    return _njit(function, **_COMMON, fastmath=False)


def strictly_alike(function: _Function) -> _Function:
    """The same, for what calls it with the types it was written with."""
    made: _Function = strictly(function)
    return made
