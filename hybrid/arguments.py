"""What a caller hands to run, predict, sweep and check, turned into what they work on.

Stage 4. Every verb takes the same things in the same forms: a patch, or where to find it; parameters
as SI numbers, or as texts with units. Whatever else is handed over is refused here in one line.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from numbers import Integral, Real
from typing import Any

from hybrid.compiler import LARGEST_SERIAL, compile_patch
from hybrid.errors import PatchError, RunError, did_you_mean, shown
from hybrid.machine import Machine
from hybrid.machines import PRESETS
from hybrid.patch import Patch
from hybrid.patchfile import parse_duration, parse_override, place_of, read_patch

Source = Patch | str | os.PathLike[str]
Parameters = Mapping[str, float | str]


def patch_of(source: Source) -> Patch:
    """The patch itself, or the one in the file (or of the shipped name) `source`."""
    return source if isinstance(source, Patch) else read_patch(source)


def machine_of(
    source: Source | Machine,
    parameters: Parameters | None = None,
    machine: str | None = None,
    serial: int | None = None,
    as_circuit: bool = False,
    until: float | str | None = None,
) -> Machine:
    """The compiled machine; raises PatchError and RunError for whatever cannot be compiled.

    as_circuit: lay out even a linear analog side as a circuit; a compiled machine stays as it is. until:
    the end of the run in place of the patch's.
    """
    if isinstance(source, Machine):
        if parameters or any(given is not None for given in (machine, serial, until)):
            raise RunError(
                "a compiled machine has its parameters, preset, serial number and end of the run; to "
                "change them give the patch"
            )
        return source
    patch = with_until(patch_of(source), until, "until")
    numbers = parameters_of(patch, parameters)
    return compile_patch(patch, numbers, preset_of(machine), serial_of(serial), as_circuit)


def with_until(patch: Patch, until: float | str | None, what: str) -> Patch:
    """The patch with the end of its run at `until`, seconds or a text such as '20 s', where that is
    given.

    what: the name of the option, for messages.
    """
    if until is None:
        return patch
    plain = _plain(until)
    if not isinstance(plain, str):
        number = finite_number(plain)
        if number is None:
            raise RunError(f"{what} is {shown(until)}; give seconds, or a text such as '20 s'")
        plain = f"{number!r} s"
    return replace(patch, run=replace(patch.run, until=parse_duration(plain, what)))


def parameters_of(patch: Patch, parameters: Parameters | None) -> dict[str, float]:
    """Every given parameter as an SI number."""
    if parameters is None:
        return {}
    if not isinstance(parameters, Mapping):
        raise RunError(f"parameters is {shown(parameters)}; give a mapping, {{'cycle': '2 ms'}}")
    return {name: parameter_of(patch, name, value) for name, value in parameters.items()}


def parameter_of(patch: Patch, name: str, value: float | str) -> float:
    """One parameter's SI number from a number in SI or a text with a unit, such as '2 ms'."""
    check_parameter(patch, name)
    plain = _plain(value)
    if isinstance(plain, str):
        return parse_override(patch, name, plain)
    number = finite_number(plain)
    if number is None:
        due = "give a finite number in SI units, or a text with its unit"
        raise PatchError(f"{name} cannot be {shown(value)}; {due}", place_of(patch, name))
    return number


def check_parameter(patch: Patch, name: str) -> None:
    """Raise PatchError where the patch has no such parameter."""
    if not isinstance(name, str):
        raise RunError(f"{shown(name)} is no name of a parameter; names are texts")
    patch.check_settable(name)


def preset_of(machine: str | None) -> str | None:
    """The name of a preset, or None for the patch's own."""
    if machine is None or (isinstance(machine, str) and machine in PRESETS):
        return machine
    if not isinstance(machine, str):
        valid = ", ".join(PRESETS)
        raise RunError(f"machine is {shown(machine)}; give the name of one preset: {valid}")
    raise RunError(f"unknown machine {shown(machine)}; {did_you_mean(machine, PRESETS)}")


def serial_of(serial: int | None) -> int | None:
    """A serial number, or None for the patch's own."""
    if serial is None:
        return None
    return whole_number("serial", serial, 0, LARGEST_SERIAL)


def check_progress(progress: object) -> None:
    """Raise RunError for what cannot be called with the fraction done."""
    if progress is not None and not callable(progress):
        raise RunError(f"progress is {shown(progress)}; give a function of the fraction done")


def whole_number(what: str, value: Any, least: int, most: int) -> int:
    """An integer (Python's or numpy's) within its limits; raises RunError naming `what`."""
    plain = _plain(value)
    whole = isinstance(plain, Integral) and not isinstance(plain, bool)
    if not whole or not least <= int(plain) <= most:
        limit = "2^63 - 1" if most == 2**63 - 1 else str(most)
        raise RunError(
            f"{what} is {shown(value)}; it must be a whole number from {least} to {limit}"
        )
    return int(plain)


def finite_number(value: Any) -> float | None:
    """A float, or None for what is no finite real number."""
    plain = _plain(value)
    if not isinstance(plain, Real) or isinstance(plain, bool):
        return None
    try:
        number = float(plain)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _plain(value: Any) -> Any:
    """A numpy scalar, or an array without dimensions, as the Python value that it holds."""
    return value.item() if getattr(value, "ndim", None) == 0 else value
