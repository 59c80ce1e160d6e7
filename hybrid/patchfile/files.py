"""Files that a patch names: where they are, and their text.

A path is relative to the folder of the file that names it. $NAME and ${NAME} stand for a variable of the
environment, ${NAME:-text} for the text where there is no such variable.
"""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path

from hybrid.errors import PatchError, Place, one_line, quoted
from hybrid.xmltree import encoding_of
from hybrid.yamltree import Text

LARGEST_FILE = 50_000_000  # bytes
_VARIABLE = re.compile(
    r"\$(?:([A-Za-z_][A-Za-z0-9_]*)|\{([A-Za-z_][A-Za-z0-9_]*)(?::-([^}$]*))?\})"
)


class Files:
    """The files of one patch, with the hash of every one that was read."""

    def __init__(self) -> None:
        self.hashes: dict[str, str] = {}  # by the path as written

    def read(self, path: Text, what: str) -> tuple[str, str]:
        """Name for messages and text of a file; raises PatchError where it cannot be read."""
        name = self._expanded(path, what)
        file_path = Path(path.place.file).parent / name
        try:
            with file_path.open("rb") as file:
                content = file.read(LARGEST_FILE + 1)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or "no file has such a name"
            variables = [found[0] or found[1] for found in _VARIABLE.findall(path.text)]
            named = f", unless {' and '.join(variables)} says where it is" if variables else ""
            raise PatchError(
                f"{what}: {quoted(name)} cannot be read: {reason}; paths are relative to the "
                f"patch{named}",
                path.place,
            ) from None
        if len(content) > LARGEST_FILE:
            raise PatchError(
                f"{what}: {quoted(name)} has more than {LARGEST_FILE} bytes; that is too much",
                path.place,
            )
        self.hashes[path.text] = hashlib.sha256(content).hexdigest()
        shown = one_line(str(file_path))
        try:
            encoding = encoding_of(content)
        except ValueError as error:
            raise PatchError(str(error), Place(shown, 1)) from None
        if b"\0" in content and encoding != "UTF-16":
            line = content.count(b"\n", 0, content.index(b"\0")) + 1
            raise PatchError("a NUL byte, which no text has; take it out", Place(shown, line))
        try:
            return shown, content.decode(encoding).removeprefix("\ufeff")
        except UnicodeDecodeError as error:
            line = content.count(b"\n", 0, error.start) + 1
            raise PatchError(
                f"not a text in {encoding}; save it as UTF-8", Place(shown, line)
            ) from None

    def _expanded(self, path: Text, what: str) -> str:
        def value(found: re.Match[str]) -> str:
            name, default = found[1] or found[2], found[3]
            text = os.environ.get(name) or default
            if text is None:
                raise PatchError(
                    f"{what}: the environment has no variable {name}; set it, or give the path",
                    path.place,
                )
            return text

        return _VARIABLE.sub(value, path.text)
