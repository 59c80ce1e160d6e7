"""The patches that ship with Hybrid, by name. Stage 0."""

from __future__ import annotations

import os
from pathlib import Path

# Inside the package once installed, beside it in the repository (and an editable installation).
_FOLDERS = (Path(__file__).parent / "patches", Path(__file__).parent.parent / "patches")


def shipped_folder() -> Path:
    """The folder of the patches that ship; sub-patches stand in `parts` below it."""
    return next((f for f in _FOLDERS if f.is_dir()), _FOLDERS[0])


def shipped_patches() -> dict[str, Path]:
    """Name -> file of every patch that ships."""
    return {path.stem: path for path in sorted(shipped_folder().glob("*.yaml"))}


def find_patch(name: str) -> Path:
    """The file `name`, or the shipped patch of that name where there is no such file."""
    path = Path(name)
    # os.path answers False for a name that no file can have; Path raises.
    if not os.path.exists(path) and path.parent == Path() and path.stem == name:
        return shipped_patches().get(name, path)
    return path
