"""Hybrid: an emulated hybrid analog-digital computer.

read_patch(file) -> Patch; run, predict, sweep, batch, check take a Patch, or the file or shipped name of
one, and parameters as SI numbers or texts with units.
Everything is imported when first used, so that the command line starts quickly.
"""

from __future__ import annotations

from hybrid.version import __version__ as __version__

TYPE_CHECKING = False  # typing takes longer to load than all that is here: a Ctrl-C would meet it

if TYPE_CHECKING:
    from typing import Any

    from hybrid.batches import batch as batch
    from hybrid.checks import check as check
    from hybrid.errors import HybridError as HybridError
    from hybrid.errors import PatchError as PatchError
    from hybrid.errors import RunError as RunError
    from hybrid.patchfile import parse_patch as parse_patch
    from hybrid.patchfile import read_patch as read_patch
    from hybrid.prediction import predict as predict
    from hybrid.runs import run as run
    from hybrid.shipped import shipped_patches as shipped_patches
    from hybrid.sweeps import sweep as sweep

_HOMES = {
    "HybridError": "errors",
    "PatchError": "errors",
    "RunError": "errors",
    "batch": "batches",
    "check": "checks",
    "parse_patch": "patchfile",
    "predict": "prediction",
    "read_patch": "patchfile",
    "run": "runs",
    "shipped_patches": "shipped",
    "sweep": "sweeps",
}

__all__ = sorted(_HOMES)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'hybrid' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"hybrid.{_HOMES[name]}"), name)
