"""What a batch is asked to run: an order for each run, of lists that must be of one length. Stage 7."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from hybrid.arguments import check_parameter, parameter_of, serial_of, whole_number
from hybrid.errors import RunError, counted, shown
from hybrid.patch import Patch
from hybrid.points import MOST_POINTS, Order
from hybrid.runs import check_seed

Varied = Mapping[str, float | str | Iterable[float | str]]
EACH = "one value, or a list with one for each run"


def orders_of(
    patch: Patch,
    parameters: Varied,
    runs: int | None,
    serial: int | Iterable[int | None] | None,
    seed: int | Iterable[int],
) -> tuple[tuple[Order, ...], tuple[str, ...]]:
    """What to run, and the names of the parameters that differ. Raises PatchError and RunError."""
    columns = _columns(patch, parameters)
    serials, seeds = _column("serial", serial), _column("seed", seed)
    # One for all, or a mistake.
    whole_serial = serial_of(serial) if serials is None else None  # type: ignore[arg-type]
    lot = (check_seed(seed), ("batch",)) if seeds is None else 0  # type: ignore[arg-type]
    listed = [*columns.items(), ("serial", serials), ("seed", seeds)]
    count = _count(runs, [(name, len(column)) for name, column in listed if column is not None])

    # What is the same in all runs is read once.
    given: Mapping[str, Any] = parameters
    shared = {
        name: parameter_of(patch, name, given[name])
        for name, column in columns.items()
        if column is None
    }

    def order(index: int) -> Order:
        values = {
            name: shared[name] if column is None else parameter_of(patch, name, column[index])
            for name, column in columns.items()
        }
        own_serial = whole_serial if serials is None else serial_of(serials[index])
        return Order(index, values, own_serial, lot if seeds is None else check_seed(seeds[index]))

    differ = tuple(name for name, column in columns.items() if column is not None)
    return tuple(order(i) for i in range(count)), differ


def _columns(patch: Patch, parameters: Varied) -> dict[str, list[Any] | None]:
    """Of each parameter a value for each run, or None where there is one for all."""
    if not isinstance(parameters, Mapping):
        due = "give a mapping, {'cycle': ['1 ms', '2 ms']}"
        raise RunError(f"parameters is {shown(parameters)}; {due}")
    for name, values in parameters.items():
        check_parameter(patch, name)
        if isinstance(values, str) and ":" in values:
            raise RunError(
                f"{name} is {shown(values)}; a range is for a sweep, a batch takes {EACH}"
            )
    return {name: _column(name, values) for name, values in parameters.items()}


def _column(name: str, values: Any) -> list[Any] | None:
    """A value for each run, or None where there is one for all."""
    dimensions, whole = getattr(values, "ndim", 1), isinstance(values, str | bytes | Mapping)
    if whole or not dimensions or not isinstance(values, Iterable):
        return None
    if dimensions > 1:
        raise RunError(f"{name} is an array of {dimensions} dimensions; give {EACH}")
    column = list(itertools.islice(values, MOST_POINTS + 1))
    if not column:
        raise RunError(f"{name} has no values; give {EACH}")
    if len(column) > MOST_POINTS:
        raise RunError(f"{name} has too many values; a batch makes {MOST_POINTS} runs at most")
    return column


def _count(runs: int | None, lengths: Sequence[tuple[str, int]]) -> int:
    """How many runs the lists, or else `runs`, ask for."""
    asked = set() if runs is None else {whole_number("runs", runs, 1, MOST_POINTS)}
    found = {n for _, n in lengths} | asked
    if not found:
        raise RunError("nothing says how many runs to make: give runs, or a list of values")
    if len(found) > 1:
        parts = [f"{name} has {counted(n, 'value')}" for name, n in lengths]
        parts += [f"runs is {runs}"] if runs is not None else []
        raise RunError(f"lists of a batch must be of one length: {', '.join(parts)}")
    return found.pop()
