"""batch(patch, ...): many runs of one patch that differ in parameters, serial numbers or seeds.

Stage 7. For tolerances of a make of machines, ensembles under noise, and grids over several parameters.
Any run can be replayed alone from what the data set says of it; an interrupted batch keeps the runs
that are done.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.arguments import (
    Source,
    check_progress,
    machine_of,
    patch_of,
    preset_of,
)
from hybrid.errors import counted
from hybrid.machine import Machine
from hybrid.orders import Varied, orders_of
from hybrid.patch import Parameter, Patch
from hybrid.points import (
    MEASURED,
    Order,
    Point,
    Task,
    check_jobs,
    check_names,
    counts_text,
    done_text,
    measured_variables,
    origin,
    play_all,
    scalar_names,
    transients,
)
from hybrid.record import following, machine_facts

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

# Names in the result of a batch, which the parameters that differ join.
VARIABLES = frozenset(
    {"run", "readout", "status", "note", "overloads", "seed", "serial"}
    | {f"measured_{quantity}" for quantity in MEASURED}
)

MOST_TOLD = 12  # combinations that a batch tells of itself


@dataclass(frozen=True, eq=False)
class Batch:
    """Runs in the order asked for; `dataset` is an xarray.Dataset over (run, readout).

    `first` is the machine of the first run. `differ`: parameters that are not the same in all runs.
    """

    patch: Patch
    orders: tuple[Order, ...]
    points: tuple[Point, ...]  # those done, in order of index
    first: Machine
    differ: tuple[str, ...]
    status: str  # 'complete' or 'interrupted'

    @property
    def machine(self) -> str:
        """Name of the preset."""
        return self.first.preset

    @property
    def status_note(self) -> str:
        """How many of the runs are done, where it was interrupted."""
        return done_text(self.status, len(self.points), len(self.orders), "run")

    def serial_of(self, run: Point | Order) -> int:
        """Serial number of the machine that a run was made on."""
        serial = self.orders[run.index].serial
        return self.first.serial if serial is None else serial

    @cached_property
    def dataset(self) -> xr.Dataset:
        """Every run's parameters (NAME in its unit, NAME_si in SI to the last bit), seed and readouts.

        NaN where there is no answer.
        """
        import xarray as xr

        variables: dict[str, Any] = measured_variables(self.points, self.first, "run")
        serials = np.array([self.serial_of(p) for p in self.points], dtype=np.int64)
        variables["serial"] = (("run",), serials, {})
        for name in self.differ:
            parameter, exact = self.patch.parameters[name], self._values_of(name)
            variables[name] = (("run",), exact / parameter.factor, {"units": parameter.unit})
            variables[in_si(name)] = (("run",), exact, {"units": _si_unit(parameter)})
        readouts = np.array(transients(self.patch), dtype=object)
        runs = np.array([p.index for p in self.points], dtype=np.int64)
        facts = {
            "status": self.status,
            "status_note": self.status_note,
            "parameters": json.dumps(self._shared("parameters")),
        }
        facts["parameters_si"] = json.dumps(self._shared("parameters_si"))
        facts["differ"] = json.dumps(self.differ)
        return xr.Dataset(
            variables,
            {"run": runs, "readout": readouts},
            {**origin(self.first, self.differ), **facts},
        )

    def _values_of(self, name: str) -> np.ndarray:
        """A parameter that differs, of the runs that are done: (n,), in SI to the last bit."""
        return np.array([self.orders[p.index].parameters[name] for p in self.points], dtype=float)

    def _shared(self, key: str) -> dict[str, Any]:
        """The parameters that all runs share, as texts or as numbers; those that follow from one that
        differs are not."""
        follow = following(self.first, self.differ)
        given = machine_facts(self.first)[key]
        return {name: value for name, value in given.items() if name not in follow}

    @property
    def varied(self) -> list[str]:
        """What the runs differ in: ['cycle 1 to 5 ms, 3 values', '2 runs of each combination']."""
        told = []
        for name in self.differ:
            parameter = self.patch.parameters[name]
            given = {order.parameters[name] / parameter.factor for order in self.orders}
            span = " to ".join(f"{value:.6g}" for value in sorted({min(given), max(given)}))
            told.append(
                f"{name} {span} {parameter.unit}".rstrip() + f", {counted(len(given), 'value')}"
            )
        serials = {self.serial_of(order) for order in self.orders}
        if len(serials) > 1:
            stages = self.first.stages.values()
            drawn = any(s.tolerance or s.offset_limit or s.leak_limit for s in stages)
            alike = "" if drawn else f", all alike: {self.machine!r} has no tolerances"
            told.append(f"serial {min(serials)} to {max(serials)}{alike}")
        made = [(*(o.parameters[name] for name in self.differ), o.serial) for o in self.orders]
        each = set(Counter(made).values())
        if len(set(made)) > 1 and max(each) > 1:
            most = " to ".join(str(count) for count in sorted({min(each), max(each)}))
            told.append(f"{most} runs of each combination")
        return told

    def to_pandas(self) -> pd.DataFrame:
        """One row a run and transient (a run alone, where the patch has none); parameters in SI."""
        exact = {name: ("run", self._values_of(name)) for name in self.differ}
        data = self.dataset.drop_vars(map(in_si, self.differ)).assign(exact)
        return (data if data.sizes["readout"] else data.drop_dims("readout")).to_dataframe()

    def figures(self) -> dict[str, tuple[np.ndarray, str]]:
        """What each run was asked: name to (runs,) and unit; of a transient omega and zeta."""
        data, found = self.dataset, {}
        for j, name in enumerate(data["readout"].values.tolist()):
            for quantity, unit in (("omega", "rad/s"), ("zeta", "")):
                found[f"{name} {quantity}"] = (data[f"measured_{quantity}"].values[:, j], unit)
        for readout in self.patch.readouts:
            for variable in scalar_names(readout)[:1]:
                found[readout.name] = (data[variable].values, data[variable].attrs["units"])
        return found

    def summary(self) -> dict[str, dict[str, Any]]:
        """Of each figure: runs that have it, mean, standard deviation, least and largest, units."""
        return self._summary_of(np.ones(len(self.points), dtype=bool))

    def groups(self) -> list[tuple[dict[str, float], dict[str, dict[str, Any]]]]:
        """The parameters that differ (SI) and the summary of each combination of them.

        Empty where only one combination was run, or none more than once.
        """
        made = [tuple(self.orders[p.index].parameters[n] for n in self.differ) for p in self.points]
        counts = Counter(made)
        if len(counts) < 2 or max(counts.values()) < 2:
            return []
        found = []
        for values in counts:
            theirs = np.array([each == values for each in made])
            found.append((dict(zip(self.differ, values, strict=True)), self._summary_of(theirs)))
        return found

    def combination_text(self, parameters: Mapping[str, float]) -> str:
        """Such as 'cycle 2 ms, gain 3', of parameters in SI."""
        known = self.patch.parameters
        told = (
            f"{n} {v / known[n].factor:.6g} {known[n].unit}".rstrip() for n, v in parameters.items()
        )
        return ", ".join(told)

    def _summary_of(self, which: np.ndarray) -> dict[str, dict[str, Any]]:
        found: dict[str, dict[str, Any]] = {}
        for name, (values, units) in self.figures().items():
            known = values[which & np.isfinite(values)]
            one, many = len(known) > 0, len(known) > 1
            found[name] = {
                "runs": len(known),
                "mean": float(np.mean(known)) if one else None,
                "std": float(np.std(known, ddof=1)) if many else None,
                "minimum": float(known.min()) if one else None,
                "maximum": float(known.max()) if one else None,
                "units": units,
            }
        return found

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data; parameters in SI."""
        facts = machine_facts(self.first)
        return {
            **{key: facts[key] for key in ("patch", "title", "machine", "on")},
            "parameters": self._shared("parameters"),
            "parameters_si": self._shared("parameters_si"),
            "status": self.status,
            "status_note": self.status_note,
            "summary": self.summary(),
            "groups": [{"parameters_si": p, "summary": about} for p, about in self.groups()],
            "runs": [
                {
                    "run": p.index,
                    "parameters_si": {n: self.orders[p.index].parameters[n] for n in self.differ},
                    "serial": self.serial_of(p),
                    "seed": p.seed,
                    "readouts": p.measured,
                    "status": p.status,
                    "note": p.remarks,
                    "overloads": p.overloads,
                }
                for p in self.points
            ],
        }

    def __repr__(self) -> str:
        lines = [
            f"<Batch {self.patch.title!r} on {self.machine!r}: {len(self.points)} of "
            f"{counted(len(self.orders), 'run')}, {counts_text(self.points)}, {self.status}>"
        ]
        told = [("", self.summary())]
        if groups := self.groups():  # a mean over different parameters says nothing
            told = [(f"{self.combination_text(p)}: ", summary) for p, summary in groups]
        for begins, summary in told[:MOST_TOLD]:
            for name, about in summary.items():
                if about["runs"]:
                    spread = f" +- {about['std']:.3g}" if about["std"] is not None else ""
                    figure = f"{about['mean']:.9g}{spread} {about['units']}"
                    lines.append(f"  {begins}{name}: {figure}".rstrip())
        if len(told) > MOST_TOLD:
            lines.append(f"  and {counted(len(told) - MOST_TOLD, 'more combination')}")
        return "\n".join(lines)


def batch(
    patch: Source,
    parameters: Varied | None = None,
    *,
    runs: int | None = None,
    machine: str | None = None,
    serial: int | Iterable[int | None] | None = None,
    seed: int | Iterable[int] = 0,
    jobs: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Batch:
    """Run the patch many times.

    Args: patch: a patch, or the file or shipped name of one; parameters: each one value for all runs
    (an SI number or a text with a unit) or one value for each; serial: which machine of the make, or
    one for each run; seed: of each run, or one that gives every run noise of its own; runs: how many,
    where nothing else says so; machine: preset name; jobs: runs at a time (default: one a core);
    progress: called with the fraction done. Lists must be of one length. A run that cannot be made or
    measured is kept with its reason. Raises PatchError or RunError where the first run could not be
    made at all, and for lists that do not fit.
    """
    check_progress(progress)
    patch = patch_of(patch)
    orders, differ = orders_of(patch, {} if parameters is None else parameters, runs, serial, seed)
    first = check_batch(patch, orders, differ, machine, jobs)
    task = Task(patch, preset_of(machine), predicts=False)
    points, status = play_all(task, orders, jobs, progress)
    return Batch(patch, orders, points, first, differ, status)


def check_batch(
    patch: Patch,
    orders: Sequence[Order],
    differ: Sequence[str],
    machine: str | None = None,
    jobs: int | None = None,
) -> Machine:
    """Raise PatchError or RunError for what would stop the first run; gives its machine."""
    check_names(patch, (*differ, *map(in_si, differ)), VARIABLES, "differ")
    check_names(patch, differ, {in_si(name) for name in differ}, "differ")
    check_jobs(jobs)
    return machine_of(patch, orders[0].parameters, machine, orders[0].serial)


def in_si(name: str) -> str:
    """The variable that holds a parameter's SI values: 'cycle_si' of 'cycle'."""
    return f"{name}_si"


def _si_unit(parameter: Parameter) -> str:
    """Unit of a parameter's SI values, as it was written where that is one of SI."""
    if parameter.factor == 1.0:
        return parameter.unit
    return "" if parameter.dimension.is_pure else str(parameter.dimension)
