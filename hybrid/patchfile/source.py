"""The text of a patch file, with what is said where it cannot be had."""

from __future__ import annotations

import codecs
from pathlib import Path

from hybrid.errors import PatchError, Place, did_you_mean, one_line
from hybrid.shipped import shipped_patches
from hybrid.yamltree import LARGEST_FILE

LONGEST_NAME = 300


def name_of(path: Path) -> str:
    """The name of a file as it can be printed and recorded; old file systems allow any bytes."""
    return str(path).encode("utf-8", "replace").decode("utf-8")


def short(name: str) -> str:
    """A name cut where it is too long for a message: somebody handed over the text of a patch."""
    name = one_line(name)
    return name if len(name) <= LONGEST_NAME else name[: LONGEST_NAME - 3] + "..."


def read_text(path: Path, place: Place, advice: str = "") -> str:
    """The text of the file `path`.

    place: where the mistake is, if it cannot be read; advice: what to give instead of a missing file
    (default: the name of a patch that ships).
    """
    try:
        with path.open("rb") as file:
            # One more than allowed and no further: a device may have no end.
            content = file.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        advice = advice or _what_ships(path)
        raise PatchError(f"cannot be read: No such file{advice}", place) from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise PatchError(f"cannot be read: {reason}; give a patch file", place) from None
    except ValueError:
        raise PatchError(
            "cannot be read: no file has such a name; give a patch file", place
        ) from None
    if len(content) > LARGEST_FILE:
        raise PatchError(f"the file is too long; a patch has at most {LARGEST_FILE} bytes", place)
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise PatchError("the file is in UTF-16; save it as UTF-8", place)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise PatchError(
            "not a text in UTF-8; a patch is a YAML file in UTF-8", Place(name_of(path), line)
        ) from None


def _what_ships(path: Path) -> str:
    """What a file that is not there may have meant."""
    if path.parent == Path() and path.suffix in ("", ".yaml"):
        return f", and no patch of that name ships; {did_you_mean(path.stem, shipped_patches())}"
    return "; give a patch file, or the name of a patch that ships"
