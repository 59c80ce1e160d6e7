"""Which machine runs what: what a patch's parts and whoever reads the patch say about it."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from hybrid.errors import NOWHERE, PatchError, Place, did_you_mean, quoted, shown
from hybrid.language import MACHINES

Placement = str | Mapping[str, str] | None


@dataclass(frozen=True, slots=True)
class Told:
    """A part, a signal or a word ("": the whole patch) is to run on a machine."""

    name: str
    machine: str
    place: Place = NOWHERE


def told_from(on: Placement) -> tuple[Told, ...]:
    """What is said outside a patch: "digital", or {"body": "digital"} by name.

    Raises PatchError for anything else.
    """
    if on is None:
        return ()
    given = {"": on} if isinstance(on, str) else on
    if not isinstance(given, Mapping):
        raise PatchError(f"on is {shown(on)}; give a machine, or {{'part': 'digital'}}")
    for name, machine in given.items():
        if not isinstance(name, str) or not isinstance(machine, str) or machine not in MACHINES:
            what = f"on {shown(name)}" if name else "on"
            raise PatchError(f"{what} is {shown(machine)}; valid: {', '.join(MACHINES)}")
    return tuple(Told(name, machine) for name, machine in given.items())


def told_from_texts(texts: Iterable[str]) -> dict[str, str]:
    """The same from "digital" or "body=digital", each name once."""
    found: dict[str, str] = {}
    for text in texts:
        name, equals, machine = (part.strip() for part in text.rpartition("="))
        if machine not in MACHINES or (equals and not name):
            raise PatchError(
                f"--on {quoted(text)} must be analog or digital, or PART=analog or PART=digital"
            )
        if name in found:
            raise PatchError(f"--on {quoted(text)}: {name or 'the whole patch'} is told twice")
        found[name] = machine
    return found


def placed(
    names: Mapping[str, str],
    within: Sequence[Told],
    outside: Sequence[Told],
    parts: Iterable[str],
    file: str | os.PathLike[str],
) -> dict[str, str]:
    """The machine of every signal and word.

    names: with the machine that each is written for; within, outside: what the patch says and what is
    said besides, which goes first. Of what is said in one place the longer name goes first: that of a
    part of a part.
    """
    known = {*(name for name in names if ":" not in name), *parts}  # no inner names of a model
    for told in outside:
        if told.name and told.name not in known:
            hint = did_you_mean(told.name, known)
            raise PatchError(
                f"no part, signal or word {quoted(told.name)}; {hint}", Place(str(file))
            )
    found = dict(names)
    for said in (within, outside):
        for told in sorted(said, key=lambda one: len(one.name)):
            for name in names:
                if not told.name or name == told.name or name.startswith(f"{told.name}."):
                    found[name] = told.machine
    return found
