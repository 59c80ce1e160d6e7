"""The record of a run: an xarray.Dataset in problem units that says where it comes from.

Stage 5. What it is made of; `storage` writes it.
"""

from __future__ import annotations

import functools
import hashlib
import json
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from typing import Any

import numpy as np

from hybrid.expressions import names
from hybrid.machine import Floats, Machine, Pen
from hybrid.modes import MODE_NAMES, MODE_VARIABLE
from hybrid.patch import Patch
from hybrid.scale import to_seconds
from hybrid.stepwise import stepwise_signals
from hybrid.storage import Parts
from hybrid.version import __version__


def pens_for(machine: Machine, readouts_only: bool = False) -> tuple[Pen, ...]:
    """The signals to record: those the patch names, in its order, and those its readouts need."""
    patch = machine.patch
    read = sorted({readout.signal for readout in patch.readouts})
    shown = () if readouts_only else patch.record or patch.signals
    pens = [_pen(machine, name) for name in dict.fromkeys((*shown, *read))]
    if machine.has_modes and not readouts_only:
        pens.append(Pen(MODE_VARIABLE, "mode", len(machine.analog.signals), 1.0))
    return tuple(pens)


def _pen(machine: Machine, name: str) -> Pen:
    analog, patch = machine.analog, machine.patch
    units = signal_units(machine)
    factor = units[name][1]
    if name in analog.signals:
        index = analog.signals.index(name)
        kind = "dac" if any(d.name == name for d in patch.dacs) else "analog"
        return Pen(name, kind, index, float(analog.full_scale[index]) / factor)
    for index, sampler in enumerate(machine.samplers):
        if sampler.name == name:
            return Pen(name, "adc", index, 1.0 / factor)
    return Pen(name, "word", machine.tape.words.index(name), 1.0 / factor)


def signal_units(machine: Machine) -> Mapping[str, tuple[str, float]]:
    """Unit text and SI factor in which each signal is shown."""
    return _units_of(machine.patch)


@functools.lru_cache(maxsize=8)
def _units_of(patch: Patch) -> Mapping[str, tuple[str, float]]:
    shown = {part.name: (part.unit, part.factor) for part in patch.analog_parts}
    shown |= {adc.name: shown[adc.source] for adc in patch.adcs}
    by_word = {dac.word: shown[dac.name] for dac in patch.dacs}
    if patch.program is None:
        return shown
    for entry in patch.program.written:
        unknown = entry.dimension is None or entry.dimension.is_pure
        plain = ("" if unknown else str(entry.dimension), 1.0)
        shown[entry.word] = by_word.get(entry.word, plain)
    return {**shown, **patch.program.units}


def full_scales(machine: Machine) -> dict[str, float]:
    """Full scale of each analog and ADC signal, and of fixed-point words, in the unit it is shown in."""
    units = signal_units(machine)
    scales = dict(zip(machine.analog.signals, machine.analog.full_scale.tolist(), strict=True))
    found = {name: scale / units[name][1] for name, scale in scales.items()}
    for sampler in machine.samplers:
        found[sampler.name] = sampler.range_mu * sampler.to_si / units[sampler.name][1]
    for word, length in machine.tape.fixed.items():
        found[word] = length.full_scale / units[word][1]
    return found


def parameter_texts(machine: Machine) -> dict[str, str]:
    """Every parameter as a reader would write it, such as '1 ms'."""
    texts = {}
    for name, value in _told(machine).items():
        parameter = machine.patch.parameters[name]
        texts[name] = f"{value / parameter.factor:.12g} {parameter.unit}".strip()
    return texts


def exact_parameters(machine: Machine, known: Iterable[str] | None = None) -> dict[str, float]:
    """Every parameter (or those named) in SI, to the last bit: what a replay takes."""
    return {k: v for k, v in _told(machine).items() if known is None or k in known}


def following(machine: Machine, differ: Iterable[str]) -> set[str]:
    """The parameters `differ` and all that follow from them, as b = 2*a does from a unless b was set."""
    found, patch = set(differ), machine.patch
    for name in patch.parameter_order:
        follows = names(patch.parameters[name].value.expr) & found
        if follows and name not in machine.overrides:
            found.add(name)
    return found


def changed_names(machine: Machine) -> list[str]:
    """The parameters that were set from outside, in the order of the others."""
    return [name for name in _told(machine) if name in machine.overrides]


def _told(machine: Machine) -> dict[str, float]:
    """Parameters that are declared, and times of tasks that were set; the others follow from these."""
    known = machine.patch.parameters
    told = (n for n in machine.parameters if n in machine.overrides or not known[n].task)
    return {name: machine.parameters[name] for name in told}


def machine_facts(machine: Machine) -> dict[str, Any]:
    """What every answer says first: which patch, on which machine, with which parameters."""
    return {
        "patch": machine.patch.file,
        "title": machine.patch.title,
        "machine": machine.preset,
        "serial": machine.serial,
        "on": dict(machine.patch.on),
        "cycle_s": machine.cycle_s,
        "time_scale": machine.time_scale,
        "parameters": parameter_texts(machine),
        "parameters_si": exact_parameters(machine),
    }


def span_facts(machine: Machine) -> dict[str, float]:
    """End of the run and interval of its rows, before any are left out, as they were played."""
    timing = machine.timing
    return {"until_s": to_seconds(timing.until), "every_s": to_seconds(timing.every)}


def record_parts(
    machine: Machine,
    pens: tuple[Pen, ...],
    time_s: Floats,
    rows: Floats,
    facts: Mapping[str, str | int | float],
    firsts_s: Mapping[str, float],
) -> Parts:
    """Variables, coordinates and attributes of a record, ready for xarray.Dataset(*parts).

    One variable per pen, shape (rows,), in problem units; coordinate `time` in s. `facts` are the
    run's own attributes: seed, cycles, status, status_note, rows_note, overloads, outside,
    readouts. `firsts_s`: when ADCs and words have their first result.
    """
    stepwise = stepwise_signals(machine)
    variables = {
        pen.name: (
            "time",
            rows[:, i] + 0.0,  # no -0.0, which says nothing to a reader
            _about(machine, pen, firsts_s, pen.kind != "analog" or pen.name in stepwise),
        )
        for i, pen in enumerate(pens)
    }
    patch = machine.patch
    attributes = {
        "title": patch.title,
        "patch": patch.file,
        "patch_hash": patch_hash(patch),
        "file_hashes": json.dumps(patch.files),
        "on": json.dumps(dict(patch.on)),
        "machine": machine.preset,
        "serial": machine.serial,
        "cycle_s": machine.cycle_s,
        "time_scale": machine.time_scale,
        "parameters": json.dumps(parameter_texts(machine)),
        "parameters_si": json.dumps(exact_parameters(machine)),
        "changed": json.dumps(changed_names(machine)),
        **span_facts(machine),
        "versions": versions_text(),
        **_operation_text(machine),
        **facts,
    }
    return variables, {"time": ("time", time_s, {"units": "s"})}, attributes


def _about(machine: Machine, pen: Pen, firsts_s: Mapping[str, float], held: bool) -> dict[str, Any]:
    """Attributes of one variable; numbers of the mode are told as the CF conventions tell flags."""
    if pen.kind == "mode":
        numbers, names = np.arange(float(len(MODE_NAMES))), " ".join(MODE_NAMES)
        return {"units": "", "kind": pen.kind, "flag_values": numbers, "flag_meanings": names}
    full_scale = full_scales(machine).get(pen.name, float("nan"))
    first = {"first_result_s": firsts_s[pen.name]} if pen.name in firsts_s else {}
    return {
        "units": signal_units(machine)[pen.name][0],
        "full_scale": full_scale,
        "kind": pen.kind,
        "held": int(held),  # whether it stands still but where it jumps
        **first,
    }


def _operation_text(machine: Machine) -> dict[str, str]:
    """How time sets the machine's mode, where it does."""
    operation = machine.operation
    if operation is None:
        return {}
    lengths = {
        "reset_s": to_seconds(operation.reset),
        "operate_s": to_seconds(operation.operate),
        "hold_s": to_seconds(operation.hold),
        "operations": operation.count,
    }
    return {"operation": json.dumps(lengths)}


def patch_hash(patch: Patch) -> str:
    """SHA-256 of the patch's text."""
    return hashlib.sha256(patch.text.encode()).hexdigest()


def versions_text() -> str:
    """Versions of what computed a result, as JSON."""
    versions = {
        "hybrid": __version__,
        "numpy": np.__version__,
        "numba": version("numba"),  # nothing but the engine loads it
        "python": platform.python_version(),
    }
    return json.dumps(versions)
