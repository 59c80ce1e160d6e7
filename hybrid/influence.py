"""How much the rates of the integrators at t = 0 change with one error of one component at a time.

Stage 6, for the rate test. The patch is laid out once. On a linear analog side an error changes one
row of the balance that all signals are in: the rest follows by the formula of Sherman and Morrison for
the inverse of a matrix of which one row has changed, so all errors together cost about as much as one
balance. On a circuit the figures of a few elements change, and it settles anew.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hybrid.circuits import elements_with
from hybrid.elements import INTEGRATE, Element
from hybrid.layout import AnalogLayout
from hybrid.machine import Floats, Machine, OutputStage

if TYPE_CHECKING:
    from hybrid.engine.circuit import Circuit

# Errors to try: of which component, what its stage becomes, or what is added to its output.
Errors = Sequence[tuple[str, OutputStage | float]]


def changes_of_rates(machine: Machine, names: Sequence[str], errors: Errors) -> Iterator[Floats]:
    """For each error by itself how the rates change, (integrators,), machine units a second.

    Args: names: the integrators; errors: what becomes of an output stage, or machine units that are
    added to an output, of an integrator to what it begins with. What has no finite rate with an error
    changes by nan or infinity.
    """
    return (rates_mu for rates_mu, _ in changes(machine, names, errors))


def changes(
    machine: Machine, names: Sequence[str], errors: Errors
) -> Iterator[tuple[Floats, float]]:
    """The same, and how the output changes whose error it is, in machine units."""
    with np.errstate(all="ignore"):
        yield from (_of_circuit if machine.elements else _of_matrices)(machine, names, errors)


def _of_matrices(
    machine: Machine, names: Sequence[str], errors: Errors
) -> Iterator[tuple[Floats, float]]:
    stages = machine.stages
    layout = AnalogLayout(machine.patch, machine.parameters, stages)
    index = {signal: i for i, signal in enumerate(layout.signals)}
    matrix, right = layout.static_balance()
    inverse = np.linalg.inv(matrix)
    values = inverse @ right
    gains = np.zeros((len(names), len(index)))
    for i, name in enumerate(names):
        for signal, gain in layout.rate_row(name, stages[name])[0].items():
            gains[i, index[signal]] = gain
    through, place = gains @ inverse, {name: i for i, name in enumerate(names)}

    def difference(row: str, name: str, stage: OutputStage) -> tuple[Mapping[int, float], float]:
        """By how much a row of the layout changes with the error: gains by signal, figure."""
        of = layout.static_row if row == "static" else layout.rate_row
        (before, figure), (after, other) = of(name, stages[name]), of(name, stage)
        return {index[s]: after[s] - before[s] for s in before}, other - figure

    for name, stage in errors:
        j = index[name]
        if not isinstance(stage, OutputStage):
            yield through[:, j] * stage, inverse[j, j] * stage
            continue
        row, moved = difference("static", name, stage)
        moved += sum(gain * values[i] for i, gain in row.items())
        moved /= 1.0 - sum(gain * inverse[i, j] for i, gain in row.items())
        change = through[:, j] * moved
        if name in place:
            row, own = difference("rate", name, stage)
            own += sum(gain * (values[i] + inverse[i, j] * moved) for i, gain in row.items())
            change[place[name]] += own
        yield change, inverse[j, j] * moved


def _of_circuit(
    machine: Machine, names: Sequence[str], errors: Errors
) -> Iterator[tuple[Floats, float]]:
    from hybrid.engine import windows  # takes long to load
    from hybrid.engine.sweep import new_state

    side, order = windows.side_of(machine)
    number = {name: i for i, name in enumerate(order)}
    signals = {signal: i for i, signal in enumerate(machine.analog.signals)}
    columns, elements = [signals[name] for name in names], dict(machine.elements)
    made = elements_with(machine.patch, machine.parameters, machine.stages)

    def settled(circuit: Circuit, changed: Mapping[str, Element]) -> tuple[Floats, Floats]:
        fresh = side._replace(circuit=circuit, state=new_state(circuit, windows.NODES))
        values, drives = windows.at_start(fresh, machine.analog.u0)
        leaks = np.zeros(len(names))
        for i, (name, column) in enumerate(zip(names, columns, strict=True)):
            element = changed.get(name) or elements[name]
            if element.kind == INTEGRATE and element.figures[0]:  # its leak is no input
                begins = values[column] if element.second else element.initial
                leaks[i] = element.figures[0] * begins
        return drives[columns] + leaks, values.copy()

    before, outputs = settled(side.circuit, {})
    changed: Mapping[str, Element]
    for name, stage in errors:
        if not isinstance(stage, OutputStage):
            moved, changed = {name: _moved(elements[name], stage)}, {}  # no leak reads the output
        else:
            moved = changed = dict(made(name, stage))
        after, values = settled(_with(side.circuit, number, moved), changed)
        yield after - before, float((values - outputs)[signals[name]])


def _moved(element: Element, by_mu: float) -> Element:
    """The element with this added to its output, or to what it begins with."""
    if element.kind != INTEGRATE:
        return replace(element, offset=element.offset + by_mu)
    begins = element.second_constant + by_mu
    return replace(element, initial=element.initial + by_mu, second_constant=begins)


def _with(circuit: Circuit, number: Mapping[str, int], changed: Mapping[str, Element]) -> Circuit:
    """The circuit with other gains, constants and first values of a few elements."""
    from hybrid.engine.circuit import END, FIRST

    figures, gain, initial = circuit.figures.copy(), circuit.gain.copy(), circuit.initial.copy()
    for name, element in changed.items():
        e = number[name]
        row = (element.constant, element.second_constant, element.gain, element.offset)
        figures[e] = (*row, *element.figures, 0.0, 0.0, 0.0)[:7]
        first, end = circuit.rows[e, FIRST], circuit.rows[e, END]
        gain[first:end] = [*element.first.values(), *element.second.values()]
        initial[e] = element.initial, element.initial_output
    return circuit._replace(figures=figures, gain=gain, initial=initial)
