"""What single errors make of rates, without laying the patch out again for each of them."""

from dataclasses import replace

import numpy as np
import pytest

import hybrid
from hybrid.charts.diagram import draw
from hybrid.charts.layered import order
from hybrid.circuits import build_circuit
from hybrid.compiler import compile_patch
from hybrid.influence import changes_of_rates
from hybrid.layout import AnalogLayout, build_analog
from hybrid.ratetest import static_check

LINEAR = """
title: Every kind of row in a balance
machine: {preset: nominal, tolerance: 0, noise: 0}
analog:
  one: {constant: 0.5 V, full_scale: 1 V}
  wave: {sine: 0.3 V, omega: 20, phase: 1, full_scale: 1 V}
  late: {delay: {x: 0.7}, time: 3 ms, order: 3, full_scale: 1 V}
  loop: {sum: {one: 0.4, loop: 0.3, y: -0.2, held: 0.6}, full_scale: 1 V}
  slow: {lag: {loop: 0.9}, time_constant: 5 ms, full_scale: 1 V}
  free: {coefficient: {slow: 1.5}, tau: 0, full_scale: 1 V}
  x: {integrate: {free: 3 1/s, wave: -2 1/s}, initial: 0.4 V, leak: 7 1/s, full_scale: 2 V}
  y: {integrate: {x: 5 1/s, late: 1 1/s, loop: 2 1/s}, initial: -0.3 V, full_scale: 1 V}
interface:
  held: {dac: word, bits: 12, full_scale: 1 V, initial: 0.25 V}
digital: {period: 1 ms, program: {word: 0.25}}
run: {until: 10 ms}
"""
CORNERS = LINEAR.replace("run:", "run:", 1).replace(
    "interface:",
    """  side: {compare: {x: 1, one: -0.2}, high: 1, low: -1, full_scale: 1}
  bent: {limit: loop, low: -0.5 V, high: 0.9 V, full_scale: 1 V}
  area: {multiply: [bent, slow], gain: 1 1/V, full_scale: 1 V}
  root: {square_root: area, full_scale: 1 V^0.5, unit: V^0.5}
  z: {integrate: {area: 4 1/s, bent: 1 1/s}, initial: one, low: -0.8 V, high: 0.8 V, full_scale: 1 V}
interface:""",
)


def laid_out_again(machine, stages):
    """The machine with other errors, the whole patch laid out."""
    if machine.elements:
        analog, _, elements = build_circuit(machine.patch, machine.parameters, stages)
        return replace(machine, stages=stages, analog=analog, elements=elements)
    analog, _ = build_analog(machine.patch, machine.parameters, stages)
    return replace(machine, stages=stages, analog=analog)


@pytest.mark.parametrize("text", [LINEAR, CORNERS], ids=["linear", "corners"])
def test_errors_change_rates_as_a_patch_laid_out_with_them(text):
    """For errors of per cents, which act on products and loops beyond first order: both are exact, so
    they differ by rounding, some 1e-16 of rates of about 10 through sums of some tens of terms; on a
    circuit loops settle to 1e-15 in passes that each leave 0.3, magnified by gains below 10."""
    machine = compile_patch(hybrid.parse_patch(text))
    names = sorted(c.name for c in machine.patch.components if c.kind == "integrate")
    stages = dict(machine.stages)
    errors = [(n, replace(s, gain=s.gain + 0.03)) for n, s in stages.items()]
    errors += [(n, replace(s, offset=s.offset + 0.02)) for n, s in stages.items()]
    before = static_check(machine)[1]
    moved = 0
    for (name, stage), change in zip(errors, changes_of_rates(machine, names, errors), strict=True):
        after = static_check(laid_out_again(machine, {**stages, name: stage}))[1]
        expected = np.array([after[n] - before[n] for n in names])
        np.testing.assert_allclose(change, expected, rtol=0, atol=1e-13, err_msg=name)
        moved += bool(np.any(expected))
    assert moved > len(stages)  # `side` and `root` move nothing, the rest by gain and offset


def chain(parts, corners):
    """So many sums in a row between an integrator and itself."""
    rows = [f"  s_{i}: {{sum: {{s_{i - 1}: 1}}, full_scale: 1}}" for i in range(1, parts)]
    first = f"  s_0: {{integrate: {{s_{parts - 1}: -1}}, initial: 0.5, full_scale: 1}}"
    more = "  c: {absolute: s_0, full_scale: 1}\n" if corners else ""
    lines = "\n".join([first, *rows])
    head, run = f"title: Chain {parts}\nmachine: nominal\nanalog:", "{until: 10 ms, every: 1 ms}"
    return f"{head}\n{lines}\n{more}run: {run}\n"


@pytest.mark.parametrize("corners", [False, True])
def test_a_large_patch_is_laid_out_as_often_as_a_small_one(monkeypatch, corners):
    counts = []
    original = AnalogLayout.__init__

    def counting(self, *args):
        counts[-1] += 1
        original(self, *args)

    monkeypatch.setattr(AnalogLayout, "__init__", counting)
    for parts in (5, 40):
        counts.append(0)
        hybrid.check(hybrid.parse_patch(chain(parts, corners)), trial=False)
    assert counts[0] == counts[1]


def test_a_picture_is_finished_when_no_effort_is_left(monkeypatch):
    """The order that the first sweeps have found is drawn as well."""
    patch = hybrid.parse_patch(LINEAR)
    most, spent = draw(patch), []
    monkeypatch.setattr(order, "EFFORT", 0)
    original = order.pair_costs
    monkeypatch.setattr(order, "pair_costs", lambda space: spent.append(space) or original(space))
    least = draw(patch)
    assert least.count("<path") == most.count("<path") > 0
