"""What the files of a patch are called, and how a reader is told what runs on the other machine.

Stage 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hybrid.patch import Patch

WHOLE = "all"  # what `Patch.on` calls the whole patch
MOST_NAMES = 3
LONGEST = 80  # letters; beyond, the name of a file ends in a hash instead


def stem_of(patch: Patch) -> str:
    """The name of a patch's files without ending: its own, and what `--on` put where.

    So a run with something on the other machine overwrites no file of the run without.
    """
    stem = Path(patch.file).stem or "patch"
    if not patch.on:
        return stem
    told = "_".join(
        f"{'' if name == WHOLE else name + '_'}{on}" for name, on in sorted(patch.on.items())
    )
    if len(told) > LONGEST:
        import hashlib

        told = f"{told[: LONGEST - 9]}_{hashlib.sha256(told.encode()).hexdigest()[:8]}"
    return f"{stem}_on_{told}"


def on_text(on: Mapping[str, str]) -> str:
    """'all on digital', 'body on digital, air on analog'; '' where nothing was moved."""
    told = [f"{name} on {machine}" for name, machine in sorted(on.items())]
    if len(told) > MOST_NAMES:
        told = [*told[: MOST_NAMES - 1], f"{len(told) - MOST_NAMES + 1} more elsewhere"]
    return ", ".join(told)
