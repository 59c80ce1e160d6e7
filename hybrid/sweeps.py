"""sweep(patch, ...): measured and predicted modes for each value of one parameter.

Stage 7. Points are independent; each has its own seed, kept in the result, so that any point can be
replayed alone. An interrupted sweep keeps the points that are done.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hybrid.arguments import (
    Parameters,
    Source,
    check_parameter,
    check_progress,
    machine_of,
    parameter_of,
    parameters_of,
    patch_of,
    preset_of,
    serial_of,
)
from hybrid.errors import RunError, quoted, shown
from hybrid.following import followed
from hybrid.machine import Machine
from hybrid.patch import Patch
from hybrid.points import (
    MEASURED,
    MOST_POINTS,
    Order,
    Point,
    Task,
    check_jobs,
    check_names,
    counts_text,
    done_text,
    measured_variables,
    number,
    origin,
    play_all,
    transients,
)
from hybrid.record import exact_parameters, following, machine_facts, parameter_texts
from hybrid.runs import check_seed

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

PREDICTED = ("omega", "omega_damped", "zeta", "omega_ideal", "zeta_ideal")
CLOSED = ("omega", "zeta")
# Names in the result of a sweep, which the swept parameter joins.
VARIABLES = frozenset(
    {"readout", "mode", "status", "note", "overloads", "seed"}
    | {f"measured_{quantity}" for quantity in MEASURED}
    | {q if q.endswith("_ideal") else f"predicted_{q}" for q in PREDICTED}
    | {f"closed_form_{quantity}" for quantity in CLOSED}
)


@dataclass(frozen=True, eq=False)
class Sweep:
    """What a sweep gave, for the n values that were done.

    values: all values (values,) of `parameter`, in SI; points: n of them, each with its `index` there.
    dataset: an xarray.Dataset over the swept parameter (n,) in the parameter's unit, `readout` (the
        names of transients) and `mode` (columns that are followed from the lowest value on):
        measured_omega, measured_omega_damped in rad/s, measured_zeta, each with `..._error` (one
        standard deviation), (n, readout); predicted_omega, predicted_omega_damped, omega_ideal,
        closed_form_omega in rad/s, predicted_zeta, zeta_ideal, closed_form_zeta, (n, mode); of other
        readouts value_NAME in the signal's units and time_NAME in s, (n,); status, note, overloads
        (how many) and seed, (n,). NaN where there is no answer.
    modes: n tuples with a dict or None for each `mode` of it.
    status: 'complete' or 'interrupted'; patch, seed: what was played; first: the machine of the first
        value, whose preset, serial number and units are those of all.
    """

    patch: Patch
    parameter: str
    values: npt.NDArray[np.float64]  # SI
    points: tuple[Point, ...]  # those done, in order of value index
    first: Machine
    seed: int
    status: str  # 'complete' or 'interrupted'

    @property
    def machine(self) -> str:
        """Name of the preset."""
        return self.first.preset

    @property
    def status_note(self) -> str:
        """How many of the points are done, where it was interrupted."""
        return done_text(self.status, len(self.points), len(self.values), "point")

    @property
    def parameters(self) -> dict[str, str]:
        """The parameters that all points share, as texts; those that follow the swept one are not."""
        follow = following(self.first, [self.parameter])
        return {k: v for k, v in parameter_texts(self.first).items() if k not in follow}

    @property
    def parameters_si(self) -> dict[str, float]:
        """The same parameters in SI, to the last bit."""
        return exact_parameters(self.first, self.parameters)

    @cached_property
    def dataset(self) -> xr.Dataset:
        """Measured and predicted figures; NaN where there is no answer."""
        return _dataset(self)

    def to_pandas(self) -> pd.DataFrame:
        """One row a value, readout and mode; values in SI."""
        values = self.values[[p.index for p in self.points]]
        return self.dataset.assign_coords({self.parameter: values}).to_dataframe()

    @cached_property
    def modes(self) -> tuple[tuple[Mapping[str, Any] | None, ...], ...]:
        """Predicted modes of each point in columns, each followed from the lowest value on."""
        order = np.argsort(self.values[[p.index for p in self.points]], kind="stable").tolist()
        columns = followed([self.points[i].modes for i in order])
        found = dict(zip(order, columns, strict=True))
        return tuple(tuple(found[i]) for i in range(len(order)))

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data; values in SI."""
        facts = machine_facts(self.first)
        shared = {key: facts[key] for key in ("patch", "title", "machine", "serial", "on")}
        return {
            **shared,
            "parameters": self.parameters,
            "parameters_si": self.parameters_si,
            "over": self.parameter,
            "seed": self.seed,
            "status": self.status,
            "status_note": self.status_note,
            "points": [
                {
                    "value": float(self.values[p.index]),
                    "readouts": p.measured,
                    "modes": [mode for mode in modes if mode],
                    "status": p.status,
                    "note": p.remarks,
                    "overloads": p.overloads,
                    "seed": p.seed,
                }
                for p, modes in zip(self.points, self.modes, strict=True)
            ],
        }

    def __repr__(self) -> str:
        return (
            f"<Sweep {self.patch.title!r} over {self.parameter} on {self.machine!r}: "
            f"{len(self.points)} of {len(self.values)} points, {counts_text(self.points)}, "
            f"{self.status}>"
        )


def parse_range(text: str, number: Callable[[str], float]) -> npt.NDArray[np.float64]:
    """Values of 'START:STOP:COUNT', evenly spaced as with ':lin' behind it, or 'START:STOP:COUNT:log';
    `number` reads one end with its unit."""
    parts = [part.strip() for part in text.split(":")]
    if len(parts) not in (3, 4) or (len(parts) == 4 and parts[3] not in ("log", "lin")):
        raise RunError(
            f"range {quoted(text)} must be START:STOP:COUNT, evenly spaced (:lin behind it says so), or "
            "START:STOP:COUNT:log"
        )
    start, stop = number(parts[0]), number(parts[1])
    plain = parts[2].isascii() and parts[2].isdecimal()
    if not plain or len(parts[2]) > 9 or not 1 <= int(parts[2]) <= MOST_POINTS:
        raise RunError(
            f"COUNT is {quoted(parts[2])}; it must be a whole number from 1 to {MOST_POINTS}"
        )
    count = int(parts[2])
    if parts[-1] != "log":
        if not math.isfinite(stop - start):
            raise RunError(f"range {quoted(text)} is too wide; bring its ends nearer or use :log")
        return np.linspace(start, stop, count)
    if start <= 0 or stop <= 0:
        raise RunError(f"a logarithmic range needs both ends above 0, not {start:g} and {stop:g}")
    values = np.geomspace(start, stop, count)
    values[0], values[-1] = start, (stop if count > 1 else start)
    return values


def check_sweep(
    patch: Patch,
    over: str,
    values: npt.NDArray[np.float64],
    parameters: Mapping[str, float],
    machine: str | None = None,
    serial: int | None = None,
    jobs: int | None = None,
) -> Machine:
    """Raise PatchError or RunError for what would stop every point, or the lowest or highest value.

    Gives the first one's machine. Values in between may still fail: each by itself, when its turn comes.
    """
    check_parameter(patch, over)
    if over in parameters:
        raise RunError(f"{over} is both set and swept; leave out one of them")
    check_names(patch, [over], VARIABLES, "be swept")
    check_jobs(jobs)

    def compiled(value: float) -> Machine:
        return machine_of(patch, {**parameters, over: float(value)}, machine, serial)

    compiled(values.min())  # whichever end comes first, the same one is complained of
    compiled(values.max())
    return compiled(values[0])


def values_of(
    patch: Patch, over: str, values: str | Iterable[float | str]
) -> npt.NDArray[np.float64]:
    """The values of a sweep in SI, from numbers, texts with units, or one text 'START:STOP:COUNT'."""
    check_parameter(patch, over)
    if isinstance(values, str):
        return parse_range(values, lambda end: parameter_of(patch, over, end))
    if getattr(values, "ndim", 1) != 1 or not isinstance(values, Iterable):
        raise RunError(f"the values of a sweep are a list of numbers, not {shown(values)}")
    found = [parameter_of(patch, over, value) for value in values]
    if not found:
        raise RunError("the values of a sweep are a list of at least one finite number")
    return np.array(found, dtype=np.float64)


def sweep(
    patch: Source,
    over: str,
    values: str | Iterable[float | str],
    parameters: Parameters | None = None,
    *,
    machine: str | None = None,
    seed: int = 0,
    serial: int | None = None,
    jobs: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Sweep:
    """Run and predict the patch for each of `values` of parameter `over`.

    Args: patch: a patch, or the file or shipped name of one; values: SI numbers, texts with units, or
    one text 'START:STOP:COUNT[:log]'; parameters: the others, likewise; machine: preset name; jobs: runs
    at a time (default: one a core); progress: called with the fraction done. Returns a Sweep: its
    `dataset` has measured and predicted figures, (values, readout) and (values, mode), frequencies in
    rad/s. A point that cannot be run or measured is kept with its reason. Raises PatchError or RunError
    where no point could ever work.
    """
    check_progress(progress)
    seed, patch = check_seed(seed), patch_of(patch)
    numbers, given = values_of(patch, over, values), parameters_of(patch, parameters)
    first = check_sweep(patch, over, numbers, given, machine, serial, jobs)
    task = Task(patch, preset_of(machine), predicts=True)
    orders = [
        Order(
            index,
            {**given, over: value},
            serial_of(serial),
            (seed, ("sweep", over)),
        )
        for index, value in enumerate(numbers.tolist())
    ]
    points, status = play_all(task, orders, jobs, progress)
    return Sweep(patch, over, numbers, points, first, seed, status)


def _dataset(result: Sweep) -> xr.Dataset:
    import xarray as xr

    parameter = result.patch.parameters[result.parameter]
    points = result.points
    modes = max(map(len, result.modes), default=0)
    variables: dict[str, Any] = measured_variables(points, result.first, result.parameter)
    for quantity in PREDICTED:
        name = quantity if quantity.endswith("_ideal") else f"predicted_{quantity}"
        variables[name] = _mode_table(result, modes, quantity)
    for quantity in CLOSED:
        variables[f"closed_form_{quantity}"] = _mode_table(result, modes, quantity, closed=True)
    values = result.values[[p.index for p in points]] / parameter.factor
    forms = [m["closed_form"]["equation"] for p in points for m in p.modes if m["closed_form"]]
    return xr.Dataset(
        variables,
        {
            result.parameter: ((result.parameter,), values, {"units": parameter.unit}),
            "readout": ("readout", np.array(transients(result.patch), dtype=object)),
            "mode": ("mode", np.arange(modes)),
        },
        {
            **origin(result.first, [result.parameter]),
            "serial": result.first.serial,
            "parameters": json.dumps(result.parameters),
            "parameters_si": json.dumps(result.parameters_si),
            "seed": result.seed,
            "status": result.status,
            "status_note": result.status_note,
            "parameter": result.parameter,
            "closed_form": "Eq. " + forms[0] if forms else "",
        },
    )


def _mode_table(
    result: Sweep, modes: int, quantity: str, closed: bool = False
) -> tuple[tuple[str, str], npt.NDArray[np.float64]]:
    table = np.full((len(result.points), modes), np.nan)
    for i, columns in enumerate(result.modes):
        for j, mode in enumerate(columns):
            figures = ((mode or {}).get("closed_form") or {}) if closed else (mode or {})
            table[i, j] = number(figures.get(quantity))
    return (result.parameter, "mode"), table
