"""sweep(patch, ...): measured and predicted modes for each value of one parameter.

Stage 7. Points are independent; each has its own seed, kept in the result, so that any point can be
replayed alone. An interrupted sweep keeps the points that are done.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hybrid.arguments import (
    Parameters,
    Source,
    check_parameter,
    machine_of,
    parameter_of,
    parameters_of,
    patch_of,
    preset_of,
    serial_of,
    whole_number,
)
from hybrid.compiler import compile_patch
from hybrid.errors import HybridError, RunError, quoted, shown
from hybrid.expressions import names
from hybrid.interrupts import deaf_children
from hybrid.machine import Machine
from hybrid.patch import Patch, Readout
from hybrid.prediction import predict_machine
from hybrid.record import (
    exact_parameters,
    machine_facts,
    parameter_texts,
    patch_hash,
    signal_units,
    versions_text,
)
from hybrid.runs import check_seed, run
from hybrid.streams import stream

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MOST_POINTS = 1_000_000
# Points handed to a worker at once: enough to hide the hand-over, few enough to share evenly.
POINTS_PER_BATCH = 20
# Cycles (or rows) that a batch holds at most: a second's work or so.
STEPS_PER_BATCH = 2_000_000
# Below this many points starting workers takes longer than the work.
FEWEST_FOR_WORKERS = 40
MOST_JOBS = 1000

MEASURED = ("omega", "omega_damped", "zeta", "omega_error", "omega_damped_error", "zeta_error")
TIMED = ("final", "maximum", "minimum")  # readouts that give a time with their value
PREDICTED = ("omega", "omega_damped", "zeta", "omega_ideal", "zeta_ideal")
CLOSED = ("omega", "zeta")
# Names in the result of a sweep, which the swept parameter joins.
VARIABLES = frozenset(
    {"readout", "mode", "status", "note", "overloads", "seed"}
    | {f"measured_{quantity}" for quantity in MEASURED}
    | {q if q.endswith("_ideal") else f"predicted_{q}" for q in PREDICTED}
    | {f"closed_form_{quantity}" for quantity in CLOSED}
)


@dataclass(frozen=True, slots=True)
class Point:
    """One value of the swept parameter: what was measured and predicted, or why not."""

    index: int
    measured: dict[str, dict[str, Any]]
    modes: tuple[dict[str, Any], ...]
    status: str
    note: str
    overloads: int
    seed: int

    @property
    def has_result(self) -> bool:
        """Whether any of the point's readouts has figures (of a patch without any: it was run)."""
        reasons = [quantities.get("reason") for quantities in self.measured.values()]
        return self.status != "failed" and not (reasons and all(reasons))

    @property
    def remarks(self) -> str:
        """The note, and why readouts have no figures."""
        reasons = [f"{n}: {q['reason']}" for n, q in self.measured.items() if q.get("reason")]
        return "; ".join(dict.fromkeys(text for text in (self.note, *reasons) if text))


@dataclass(frozen=True, eq=False)
class Sweep:
    """Points by value; `dataset` is an xarray.Dataset over (value, readout, mode).

    `first` is the machine of the first value: its preset, serial number and units are those of all.
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
    def parameters(self) -> dict[str, str]:
        """The parameters that all points share, as texts; those that follow the swept one are not."""
        follow = {self.parameter}
        for name in self.patch.parameter_order:
            if (
                name not in self.first.overrides
                and names(self.patch.parameters[name].value.expr) & follow
            ):
                follow.add(name)
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
        """One row a value, readout and mode."""
        return self.dataset.to_dataframe()

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data; values in SI."""
        facts = machine_facts(self.first)
        shared = {key: facts[key] for key in ("patch", "title", "machine", "serial")}
        return {
            **shared,
            "parameters": self.parameters,
            "parameters_si": self.parameters_si,
            "over": self.parameter,
            "seed": self.seed,
            "status": self.status,
            "points": [
                {
                    "value": float(self.values[p.index]),
                    "readouts": p.measured,
                    "modes": p.modes,
                    "status": p.status,
                    "note": p.remarks,
                    "overloads": p.overloads,
                    "seed": p.seed,
                }
                for p in self.points
            ],
        }

    def __repr__(self) -> str:
        counts = {
            "without a result": sum(not p.has_result for p in self.points),
            "failed": sum(p.status == "failed" for p in self.points),
            "stopped early": sum(p.status == "stopped" for p in self.points),
            "with overloads": sum(p.overloads > 0 for p in self.points),
        }
        told = "".join(f"{n} {what}, " for what, n in counts.items() if n or "result" in what)
        return (
            f"<Sweep {self.patch.title!r} over {self.parameter} on {self.machine!r}: "
            f"{len(self.points)} of {len(self.values)} points, {told}{self.status}>"
        )


def parse_range(text: str, number: Callable[[str], float]) -> npt.NDArray[np.float64]:
    """Values of 'START:STOP:COUNT' or 'START:STOP:COUNT:log'; `number` reads one end with its unit."""
    parts = text.split(":")
    if len(parts) not in (3, 4) or (len(parts) == 4 and parts[3] not in ("log", "lin")):
        raise RunError(f"range {quoted(text)} must be START:STOP:COUNT or START:STOP:COUNT:log")
    start, stop = number(parts[0]), number(parts[1])
    if not parts[2].isdecimal() or len(parts[2]) > 9 or not 1 <= int(parts[2]) <= MOST_POINTS:
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
    scalars = {name for r in patch.readouts for name in _scalar_names(r)}
    if over in VARIABLES | scalars:
        raise RunError(
            f"the parameter {over} cannot be swept: the result has a variable of that name; "
            "rename the parameter"
        )
    if jobs is not None:
        whole_number("jobs", jobs, 1, MOST_JOBS)

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
    one text 'START:STOP:COUNT[:log]'; parameters: the others, likewise; machine: preset name; jobs:
    worker processes (default: all cores); progress: called with the fraction done. A point that
    cannot be run or measured is kept with its reason. Raises PatchError or RunError where no point
    could ever work.
    """
    seed, patch = check_seed(seed), patch_of(patch)
    numbers, order = values_of(patch, over, values), parameters_of(patch, parameters)
    first = check_sweep(patch, over, numbers, order, machine, serial, jobs)
    task = _Task(patch, over, order, preset_of(machine), serial_of(serial), seed)
    points, status = [], "complete"
    try:
        for batch in _batches(task, numbers, jobs, _points_per_batch(first)):
            points.extend(batch)
            if progress:
                progress(len(points) / len(numbers))
    except KeyboardInterrupt:
        status = "interrupted"
    points.sort(key=lambda point: point.index)
    return Sweep(patch, over, numbers, tuple(points), first, seed, status)


@dataclass(frozen=True, slots=True)
class _Task:
    """What all points share; travels to the workers."""

    patch: Patch
    over: str
    parameters: dict[str, float]
    machine: str | None
    serial: int | None
    seed: int

    def points(self, batch: list[tuple[int, float]]) -> list[Point]:
        return [self.point(index, value) for index, value in batch]

    def point(self, index: int, value: float) -> Point:
        """Run, read out and predict one value."""
        seed = int(stream(self.seed, "sweep", self.over, str(index)).integers(2**53))
        overrides = {**self.parameters, self.over: value}
        try:
            compiled = compile_patch(self.patch, overrides, self.machine, self.serial)
            modes: tuple[dict[str, Any], ...] = ()
            note = ""
            try:
                modes = tuple(predict_machine(compiled).to_dicts())
            except RunError as error:
                note = f"no prediction: {error}"
            result = run(compiled, seed=seed, readouts_only=True)
            if result.status == "interrupted":  # half a point says nothing; the sweep ends here
                raise KeyboardInterrupt
        except HybridError as error:
            return Point(index, {}, (), "failed", str(error), 0, seed)
        notes = "; ".join(n for n in (note, result.status_note) if n)
        overloads = len(result.overloads)
        return Point(index, result.readouts, modes, result.status, notes, overloads, seed)


def _points_per_batch(first: Machine) -> int:
    """Few where a point takes long: an interrupted sweep loses the batches that are under way."""
    timing = first.timing
    steps = timing.until // min(t for t in (timing.period, timing.every) if t)
    return max(1, min(POINTS_PER_BATCH, STEPS_PER_BATCH // max(steps, 1)))


def _batches(
    task: _Task, values: npt.NDArray[np.float64], jobs: int | None, most: int
) -> Iterator[list[Point]]:
    """Points in batches of at most `most`, from all cores or wherever joblib works (a Dask cluster too).

    Costly values (short cycles) are spread over the batches.
    """
    pairs = list(enumerate(values.tolist()))
    if len(pairs) < FEWEST_FOR_WORKERS or jobs == 1:
        for pair in pairs:
            yield task.points([pair])
        return
    import joblib

    count = -(-len(pairs) // most)
    parallel = joblib.Parallel(n_jobs=jobs or -1, return_as="generator_unordered")
    with deaf_children():
        batches = parallel(joblib.delayed(task.points)(pairs[i::count]) for i in range(count))
    yield from batches


def _dataset(result: Sweep) -> xr.Dataset:
    import xarray as xr

    parameter = result.patch.parameters[result.parameter]
    points = result.points
    readouts = sorted(r.name for r in result.patch.readouts if r.kind == "transient")
    modes = max((len(p.modes) for p in points), default=0)
    shape = (len(points), len(readouts))
    variables: dict[str, Any] = {}
    for quantity in MEASURED:
        table = np.full(shape, np.nan)
        for i, point in enumerate(points):
            for j, name in enumerate(readouts):
                table[i, j] = _number(point.measured.get(name, {}).get(quantity))
        unit = {"units": "" if quantity.startswith("zeta") else "rad/s"}
        variables[f"measured_{quantity}"] = ((result.parameter, "readout"), table, unit)
    for quantity in PREDICTED:
        name = quantity if quantity.endswith("_ideal") else f"predicted_{quantity}"
        variables[name] = _mode_table(result, modes, quantity)
    for quantity in CLOSED:
        variables[f"closed_form_{quantity}"] = _mode_table(result, modes, quantity, closed=True)
    variables |= _scalar_variables(result)
    texts = {"status": [p.status for p in points], "note": [p.remarks for p in points]}
    for fact, lines in texts.items():
        variables[fact] = ((result.parameter,), np.array(lines, dtype=object))
    variables["overloads"] = (
        (result.parameter,),
        np.array([p.overloads for p in points], dtype=int),
    )
    variables["seed"] = ((result.parameter,), np.array([p.seed for p in points], dtype=np.int64))
    values = result.values[[p.index for p in points]] / parameter.factor
    forms = [m["closed_form"]["equation"] for p in points for m in p.modes if m["closed_form"]]
    return xr.Dataset(
        variables,
        {
            result.parameter: ((result.parameter,), values, {"units": parameter.unit}),
            "readout": ("readout", np.array(readouts, dtype=object)),
            "mode": ("mode", np.arange(modes)),
        },
        {
            "title": result.patch.title,
            "patch": result.patch.file,
            "patch_hash": patch_hash(result.patch),
            "machine": result.machine,
            "serial": result.first.serial,
            "parameters": json.dumps(result.parameters),
            "parameters_si": json.dumps(result.parameters_si),
            "versions": versions_text(),
            "seed": result.seed,
            "status": result.status,
            "parameter": result.parameter,
            "closed_form": "Eq. " + forms[0] if forms else "",
        },
    )


def _scalar_names(readout: Readout) -> tuple[str, ...]:
    """Variables in the result of a sweep that a readout other than a transient fills."""
    if readout.kind == "transient":
        return ()
    timed = (f"time_{readout.name}",) if readout.kind in TIMED else ()
    return (f"value_{readout.name}", *timed)


def _scalar_variables(result: Sweep) -> dict[str, Any]:
    """Value, in the unit of its signal, and time of every readout that is no transient."""
    units, found = signal_units(result.first), {}
    for readout in result.patch.readouts:
        for name in _scalar_names(readout):
            quantity, unit = ("time_s", "s") if name.startswith("time_") else ("value", "")
            column = [
                _number(p.measured.get(readout.name, {}).get(quantity)) for p in result.points
            ]
            about = {"units": unit or units[readout.signal][0]}
            about |= {"readout": readout.kind, "signal": readout.signal}
            found[name] = ((result.parameter,), np.array(column, dtype=np.float64), about)
    return found


def _mode_table(
    result: Sweep, modes: int, quantity: str, closed: bool = False
) -> tuple[tuple[str, str], npt.NDArray[np.float64]]:
    table = np.full((len(result.points), modes), np.nan)
    for i, point in enumerate(result.points):
        for j, mode in enumerate(point.modes):
            figures = (mode["closed_form"] or {}) if closed else mode
            table[i, j] = _number(figures.get(quantity))
    return (result.parameter, "mode"), table


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
