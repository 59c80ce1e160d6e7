"""What the files of a patch are called, and how a reader is told what runs on the other machine and what
a readout asks.

Stage 1.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hybrid.patch import Patch

WHOLE = "all"  # what `Patch.on` calls the whole patch
MOST_NAMES = 3
LONGEST = 80  # letters; beyond, the name of a file ends in a hash instead
# A slash between units becomes a hyphen; for all else that some file system refuses a hash is added.
_PER = re.compile(r"(?<=[A-Za-z])/(?=[A-Za-z])")
_REFUSED = re.compile(r"[^A-Za-z0-9._+^%(),=-]")


def stem_of(patch: Patch, changed: Sequence[str] = ()) -> str:
    """The name of a patch's files without ending: its own, what `--on` put where, and what was changed.

    changed: what else differs from the patch as it stands, such as 'cycle=5 ms' and 'seed7'. So no run
    overwrites the files of another one.
    """
    stem = Path(patch.file).stem or "patch"
    if patch.on:
        moved = sorted(patch.on.items())
        told = "_".join(f"{'' if name == WHOLE else name + '_'}{on}" for name, on in moved)
        stem += f"_on_{in_name(told)}"
    return f"{stem}_{in_name('_'.join(changed))}" if changed else stem


def in_name(text: str) -> str:
    """A text as any file system takes it, at most LONGEST letters; other texts give other names."""
    plain = _PER.sub("-", text.replace(" ", ""))
    told = _REFUSED.sub("-", plain)
    if told == plain and len(told) <= LONGEST:
        return told
    import hashlib

    return f"{told[: LONGEST - 9]}_{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def on_text(on: Mapping[str, str]) -> str:
    """'all on digital', 'body on digital, air on analog'; '' where nothing was moved."""
    told = [f"{name} on {machine}" for name, machine in sorted(on.items())]
    if len(told) > MOST_NAMES:
        told = [*told[: MOST_NAMES - 1], f"{len(told) - MOST_NAMES + 1} more elsewhere"]
    return ", ".join(told)


def asked_text(readout: Mapping[str, Any]) -> str:
    """What a readout tells: 'maximum of x', or 'value' where it does not say of what."""
    kind, signal = readout.get("kind"), readout.get("signal")
    if not (kind and signal):
        return "value"
    return f"{'final value' if kind == 'final' else kind} of {signal}"
