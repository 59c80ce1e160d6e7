"""The check shots that a DAVE-ML file brings along: its outputs for given inputs, computed and compared.

Stage 6, for `checks`. All shots of a model are the cycles of one small program, which reads the inputs
of each from tables; so they pass the same tape and kernel as the patch does. Numbers are in the units of
the file. http://daveml.org/DTDs/2p0/Ref/checkData_overview.html (DAVE-ML 2.0 reference).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from hybrid.daveml import Model, Variable, limited, needed, number_in
from hybrid.errors import PatchError, Place, counted, did_you_mean, quoted
from hybrid.expressions import Binary, Call, LookUp, Name, Node, Number
from hybrid.patch import Assignment, MachineSettings, Patch, Program, RunSettings, literal
from hybrid.patchfile.program import computing_order
from hybrid.runs import run
from hybrid.s119 import unit_text
from hybrid.tables import CLAMPS, Axis, Floats, Table, limits
from hybrid.units import unit_of
from hybrid.xmltree import Element

CLOCK = "shot"  # no name inside a model, which has a colon


@dataclass(frozen=True, slots=True)
class ShotRow:
    """One output of one shot: what is published and what is found, in `units`; the first may differ by
    `tolerance`."""

    model: str
    shot: str
    output: str
    published: float
    found: float | None  # None: no finite number
    tolerance: float
    units: str
    place: Place

    @property
    def agrees(self) -> bool:
        """Whether what is found is within the published tolerance."""
        return self.found is not None and abs(self.found - self.published) <= self.tolerance


@dataclass(frozen=True, slots=True)
class _Expected:
    """An output of a shot, in the units of its variable; one of the signal's is `factor` of these."""

    variable: Variable
    value: float
    tolerance: float
    units: str
    factor: float
    place: Place


@dataclass(frozen=True, slots=True)
class _Shot:
    name: str
    inputs: dict[str, float]  # by id, in the units of the variable
    outputs: list[_Expected]


def check_shots(patch: Patch) -> tuple[list[ShotRow], list[str]]:
    """Every output of every shot of the models that a patch uses, and what is wrong: shots that do not
    agree, a sentence for each model, and those that cannot be compared."""
    rows: list[ShotRow] = []
    wrong: list[str] = []
    for model in patch.models:
        try:
            found = _compared(model, [_read(model, element) for element in model.shots])
        except PatchError as error:
            wrong.append(f"{error} (check shots of model {model.prefix!r})")
            continue
        rows += found
        missed = [row for row in found if not row.agrees]
        if missed:
            worst = max(missed, key=_used)
            wrong.append(
                f"{worst.place}: model {model.prefix!r} misses {len(missed)} of "
                f"{counted(len(found), 'published value')}, most in shot {quoted(worst.shot)}: "
                f"{_told(worst)}"
            )
    return rows, wrong


def _told(row: ShotRow) -> str:
    found = "no finite number" if row.found is None else f"{row.found:.10g}"
    published = f"{row.published:.10g} +- {row.tolerance:g} {row.units}".rstrip()
    return f"{row.output} is {found}, published is {published}"


def to_dicts(rows: Sequence[ShotRow]) -> list[dict[str, Any]]:
    """The rows as plain data, for JSON."""
    return [{**asdict(row), "place": str(row.place), "agrees": row.agrees} for row in rows]


def columns(
    rows: Sequence[ShotRow],
) -> tuple[tuple[str, ...], list[tuple[str, ...]], list[str]]:
    """Headings and cells of a table of the models, for people; the same in a line for each."""
    cells: list[tuple[str, ...]] = []
    told = []
    for model in dict.fromkeys(row.model for row in rows):
        own = [row for row in rows if row.model == model]
        every, agree = len({row.shot for row in own}), sum(row.agrees for row in own)
        used = max(_used(row) for row in own)
        cells.append(
            (
                model,
                str(every),
                str(len(own)),
                str(agree),
                f"{used:,.0f}" if 1e3 <= used < math.inf else f"{used:.3g}",
            )
        )
        told.append(f"model {model}: {agree} of {len(own)} published values within tolerance")
    headings = ("model", "shots", "values", "within tolerance", "worst in tolerances")
    return headings, cells, told


def _used(row: ShotRow) -> float:
    """How much of the tolerance is used."""
    if row.found is None:
        return math.inf
    off = abs(row.found - row.published)
    if row.tolerance > 0.0:
        return off / row.tolerance
    return math.inf if off else 0.0


# --- reading --------------------------------------------------------------------------------------


def _read(model: Model, element: Element) -> _Shot:
    name = element.attributes.get("name", "").strip()
    inputs = {}
    for signal in _signals(element, "checkInputs"):
        variable, factor, _ = _variable(model, signal, are_inputs=True)
        inputs[variable.id] = number_in(_only(signal, "signalValue")) * factor
    outputs = []
    for signal in _signals(element, "checkOutputs"):
        variable, factor, units = _variable(model, signal, are_inputs=False)
        value, tolerance = (number_in(_only(signal, tag)) for tag in ("signalValue", "tol"))
        outputs.append(_Expected(variable, value, tolerance, units, factor, signal.place))
    for variable in _inputs_of(model, [expected.variable.id for expected in outputs]):
        if variable.id not in inputs and variable.initial is None:
            raise PatchError(
                f"shot {quoted(name)} gives no value of the input {variable.name!r}", element.place
            )
    return _Shot(name, inputs, outputs)


def _signals(element: Element, tag: str) -> Iterator[Element]:
    vector = element.first(tag)
    return vector.all("signal") if vector else iter(())


def _only(element: Element, tag: str) -> Element:
    found = element.first(tag)
    if found is None:
        raise PatchError(f"<{element.tag}> has no <{tag}>; add one", element.place)
    return found


def _variable(model: Model, signal: Element, are_inputs: bool) -> tuple[Variable, float, str]:
    """The variable of a signal, by name or id, what a unit of the signal is of its own, and that."""
    named = signal.first("signalName", "signalID", "varID")
    if named is None:
        raise PatchError("<signal> has no <signalName>; add one", signal.place)
    word = named.text.strip()
    fitting = [v for v in model.named.get(word, []) if (v.expr is None) == are_inputs]
    variable = fitting[0] if len(fitting) == 1 else model.variables.get(word)
    if variable is None or (variable.expr is None) != are_inputs:
        what = "input" if are_inputs else "computed variable"
        valid = [v.name for v in model.variables.values() if (v.expr is None) == are_inputs]
        raise PatchError(
            f"no {what} is named {quoted(word)}; {did_you_mean(word, valid)}", named.place
        )
    units = signal.first("signalUnits")
    text = units.text.strip() if units else variable.units
    if text == variable.units:
        return variable, 1.0, text
    one, other = (unit_text(t) if t else "" for t in (text, variable.units))
    if one is not None and other is not None:
        (_, given, first), (_, own, second) = (unit_of(f"1 {t}".strip()) for t in (one, other))
        if first == second:
            return variable, given / own, text
    raise PatchError(
        f"{quoted(word)} is in {quoted(text)}, which is not known to be {quoted(variable.units)}, the "
        "unit of the variable",
        signal.place,
    )


def _inputs_of(model: Model, wanted: Sequence[str]) -> list[Variable]:
    """All inputs that these variables are computed from."""
    ids = needed(model, wanted)
    return [model.variables[id_] for id_ in ids if model.variables[id_].expr is None]


# --- computing ------------------------------------------------------------------------------------


def _compared(model: Model, shots: Sequence[_Shot]) -> list[ShotRow]:
    rows: list[ShotRow] = []
    wanted = list(dict.fromkeys(e.variable.id for shot in shots for e in shot.outputs))
    begun = 0
    while begun < len(shots) and wanted:
        found = _played(model, shots[begun:], wanted)
        for shot, values in zip(shots[begun:], found, strict=False):
            rows += _rows(model, shot, dict(zip(wanted, values.tolist(), strict=True)))
        begun += len(found)
        if begun < len(shots):  # a shot that has no finite numbers ends a run
            rows += _rows(model, shots[begun], {})
            begun += 1
    return rows


def _rows(model: Model, shot: _Shot, found: dict[str, float]) -> list[ShotRow]:
    rows = []
    for due in shot.outputs:
        value = found.get(due.variable.id)
        rows.append(
            ShotRow(
                model.prefix,
                shot.name,
                due.variable.name,
                due.value,
                None if value is None else value / due.factor,
                due.tolerance,
                due.units,
                due.place,
            )
        )
    return rows


def _played(model: Model, shots: Sequence[_Shot], wanted: Sequence[str]) -> Floats:
    """The wanted variables in each shot, (shots, wanted); fewer rows where a run ends early."""
    words = [Assignment(CLOCK, _counted())]
    for id_ in needed(model, wanted):
        variable = model.variables[id_]
        expr = variable.expr or _listed(model, shots, variable)
        words.append(Assignment(model.inside(id_), expr, variable.place, hidden=True))
    shown = [f"out {i}" for i in range(len(wanted))]
    words += [Assignment(n, Name(model.inside(w))) for n, w in zip(shown, wanted, strict=True)]
    record = run(_patch(model, words, len(shots))).record
    return np.column_stack([record[name].values[: len(shots)] for name in shown])


def _counted() -> Node:
    return Binary("+", Call("previous", (Name(CLOCK),)), Number(1.0))


def _listed(model: Model, shots: Sequence[_Shot], variable: Variable) -> Node:
    """An input: its value in each shot, met exactly at a breakpoint, kept within its limits."""
    values = [shot.inputs.get(variable.id, variable.initial or 0.0) for shot in shots]
    points = np.arange(max(len(values), 2), dtype=float)
    axis = Axis(CLOCK, points, (points[0], points[-1]), CLAMPS, CLAMPS)
    held = np.resize(np.array(values), len(points))
    table = Table(f"{model.prefix}:{variable.name}", (axis,), held)
    within = limits(table.name, variable.name, variable.limits)
    return limited(LookUp(table, (Name(CLOCK),)), within)


def _patch(model: Model, words: Sequence[Assignment], cycles: int) -> Patch:
    """A patch that is a program alone; a cycle of 1 s for each shot."""
    by_word = {entry.word: entry for entry in words}
    program = Program(
        literal(1.0),
        literal(0.0),
        None,
        tuple(by_word[word] for word in computing_order(by_word, {})),
        {CLOCK: literal(-1.0)},
    )
    return Patch(
        f"Check shots of {model.prefix}",
        "",
        model.file,
        "",
        MachineSettings("ideal"),
        {},
        (),
        (),
        (),
        program,
        RunSettings(literal(max(cycles - 1.0, 1.0))),
        (),
        (),
    )
