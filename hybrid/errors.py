"""Mistakes a user can make, said in one line with the place and what would be valid.

Stage 0: imports nothing of the project. The command line turns every `HybridError` into one line
and exit code 2; nothing else may reach a user as a traceback.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

LONGEST_QUOTE = 60


@dataclass(frozen=True, slots=True)
class Place:
    """Where in a patch file something stands: file name and line (1-based, 0 when unknown).

    What stands in a sub-patch stands also where that is used, as the part of some name.
    """

    file: str = ""
    line: int = 0
    part: str = ""
    used: Place | None = None

    def __str__(self) -> str:
        plain = f"{self.file}:{self.line}" if self.file and self.line else self.file
        return f"{plain} (part {self.part} of {self.used})" if self.used else plain

    @property
    def brief(self) -> str:
        """The same for a remark, without folders: 'entry.yaml:42 (part alone of line 64)'."""
        name = Path(self.file).name
        plain = f"{name}:{self.line}" if name and self.line else name
        if not self.used:
            return plain
        same = self.used.file == self.file and not self.used.used
        where = f"line {self.used.line}" if same else self.used.brief
        return f"{plain} (part {self.part} of {where})"


NOWHERE = Place()


class HybridError(Exception):
    """Base of every error that is the user's to mend; its text is one line."""


class PatchError(HybridError):
    """A patch is wrong: `place: what is wrong; what would be valid`."""

    def __init__(self, message: str, place: Place = NOWHERE) -> None:
        """Args: message (one line), place (shown before it where known)."""
        self.message = message
        self.place = place
        super().__init__(f"{place}: {message}" if str(place) else message)


class RunError(HybridError):
    """A valid patch cannot be run or measured as asked."""


def did_you_mean(name: str, valid: Iterable[str]) -> str:
    """Say what would have been valid: the nearest names first, else at most twelve; long ones cut."""
    known = sorted({_cut(one) for one in valid})
    near = difflib.get_close_matches(_cut(name), known, n=3, cutoff=0.6)
    if near:
        return "did you mean " + " or ".join(repr(n) for n in near) + "?"
    if not known:
        return "there are none to choose from"
    shown = ", ".join(map(one_line, known[:12])) + (", ..." if len(known) > 12 else "")
    return f"valid: {shown}"


def known_as(name: str) -> str:
    """A word as its user knows it: what arithmetic calls `wing:lift`, in the units of a model's file, is
    read as `wing.lift`."""
    return name.replace(":", ".")


def one_line(text: str) -> str:
    """Text in one line that can be printed, whatever a file name brings into it."""
    return "".join(letter if letter.isprintable() else " " for letter in text)


def counted(number: int, what: str) -> str:
    """A number of things: "1 cycle", "2 cycles"."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def shown(value: object) -> str:
    """Whatever was handed over instead, for a one-line message: cut where long."""
    if isinstance(value, str):
        return quoted(value)
    return _cut(one_line(" ".join(repr(value).split())))


def quoted(text: str) -> str:
    """Text of a user's for a one-line message: quoted, control characters escaped, cut where long."""
    return repr(_cut(text))


def _cut(text: str) -> str:
    """No more of a text than a message can hold."""
    return text if len(text) <= LONGEST_QUOTE else text[: LONGEST_QUOTE - 3] + "..."
