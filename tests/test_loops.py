"""The loops that a check tells of: all of few, the shortest of many."""

import itertools
import random

import pytest

import hybrid
from hybrid.cli import main
from hybrid.graph import short_loops
from hybrid.loops import MOST_LISTED, loops_of, loops_text


def test_loops_of_a_graph_come_by_length_and_each_once():
    follows = {"a": ["b", "c"], "b": ["a", "c"], "c": ["a", "c"]}
    found, complete = short_loops(follows, sorted(follows), 10)
    assert complete
    assert found == [("c",), ("a", "b"), ("a", "c"), ("a", "b", "c")]
    assert short_loops(follows, sorted(follows), 2) == (found[:2], False)
    # Through a name that is wanted only: those without it are left out.
    assert short_loops(follows, ["b"], 10)[0] == [("b", "a"), ("b", "c", "a")]


def test_what_never_comes_back_is_not_searched():
    """Behind the loop are 10^12 ways to the end."""
    layers = [[f"x_{i}_{k}" for k in range(10)] for i in range(12)]
    follows = {"a": ["b"], "b": ["a", *layers[0]]}
    for layer, after in zip(layers, [*layers[1:], ["end"]], strict=True):
        follows |= dict.fromkeys(layer, after)
    assert short_loops(follows, sorted(follows), 10) == ([("a", "b")], True)


@pytest.mark.parametrize("seed", range(20))
def test_loops_of_any_graph_are_those_of_all_orders(seed):
    """Every choice and order of names that follow each other in a circle, begun at its first name."""
    rng = random.Random(seed)
    names = "abcdef"
    follows = {n: sorted(t for t in names if rng.random() < 0.3) for n in names}
    expected = {
        order
        for count in range(1, 7)
        for order in itertools.permutations(names, count)
        if order[0] == min(order)
        and all(b in follows[a] for a, b in zip(order, (*order[1:], order[0]), strict=True))
    }
    found, complete = short_loops(follows, names, 10_000)
    assert complete
    assert set(found) == expected and len(found) == len(expected)


def test_few_loops_are_all_told():
    found = hybrid.check("pitch_loop", trial=False).loops
    assert (found.found, found.in_program, found.complete) == (1, 0, True)
    (loop,) = found.listed
    assert loop.sampled and loop.lag_s == 0.0 and "alpha_sample" in loop.path
    assert loops_text(found) == ""


def test_of_many_loops_the_shortest_of_both_kinds_are_told():
    found = hybrid.check("orbiting_cylinder", trial=False).loops
    assert len(found.listed) == MOST_LISTED < found.found
    kinds = [loop.sampled for loop in found.listed]
    assert sum(kinds) == MOST_LISTED // 2
    analog = [len(loop.path) for loop in found.listed if not loop.sampled]
    assert analog == sorted(analog) and analog[0] == 2  # the excess ties each of the four
    assert f"{found.found} loops, of which the shortest are listed" in loops_text(found)
    for loop in found.listed:  # each begins at its first name and passes none twice
        assert loop.path[0] == min(loop.path) and len(set(loop.path)) == len(loop.path)


MODEL = """\
<DAVEfunc>
<variableDef name="x" varID="x" units="nd"><isInput/></variableDef>
<variableDef name="y" varID="y" units="nd">
<calculation><math><apply><times/><cn>2</cn><ci>x</ci></apply></math></calculation><isOutput/>
</variableDef>
</DAVEfunc>
"""
PATCH = """\
title: Through a model
machine: ideal
parameters: {pull: 1 1/s}
models: {m: {file: m.dml, inputs: {x: seen}}}
analog: {level: {integrate: {push: 1}, initial: 0.5, full_scale: 1}}
interface: {seen: {adc: level}, push: {dac: word, full_scale: 4 1/s, initial: 0}}
digital: {period: 10 ms, program: {word: -pull * m.y}}
run: {until: 1 s}
"""


def test_loops_through_a_model_are_found(tmp_path):
    (tmp_path / "m.dml").write_text(MODEL)
    (tmp_path / "m.yaml").write_text(PATCH)
    found = hybrid.check(tmp_path / "m.yaml", trial=False).loops
    (loop,) = found.listed
    assert set(loop.path) == {"level", "seen", "m.x", "m.y", "word", "push"} and loop.sampled


def test_a_check_prints_no_empty_tables(capsys):
    assert main(["check", "cannonball", "--on", "digital", "--no-trial"]) == 0
    out = capsys.readouterr().out
    assert "within the program" in out
    for title in ("Scaling", "Potentiometers", "Parts", "Loops", "Converters", "Rate test"):
        assert title not in out


def test_what_is_zero_has_no_cord():
    found = hybrid.check("tumbling_brick", trial=False)
    assert found.pots and all(row.setting > 0 for row in found.pots)
    assert loops_of(found.machine) == found.loops
