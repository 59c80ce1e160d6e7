"""Runs of a batch share what does not depend on their figures, and no run depends on those before it."""

import itertools
import random
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from large_patch import large_patch

import hybrid
from hybrid import circuits, compiler, layout, output_stages, streams
from hybrid.compiler import compile_patch
from hybrid.engine import shapes, wiring
from hybrid.engine.wiring import circuit_of

# A relay that follows the edges of a source at once, a store, a converter, a loop through parts whose
# lag may be 0, and one parameter for each way in which the figures of a part are given.
PATCH = """
title: Relay, store and converter
machine: {preset: lags, tolerance: 1e-3, offset_limit: 1e-4, leak_limit: 1 1/s, pot_resolution: dial}
parameters:
  {start: 0.5, tall: 2, slow: 1 us, edge: 1 ms, level: 0.3, dial: 0, word: 1, cycle: 1 ms, least: 0.1}
analog:
  x: {integrate: {y: 1000 1/s}, initial: start, full_scale: tall}
  y: {integrate: {bent: -1000 1/s, step: 10 1/s}, initial: 0, full_scale: 3}
  bent: {sum: {chosen: 1, kept: 0.1, back: level}, full_scale: tall}
  back: {coefficient: {front: 0.1}, full_scale: 2, tau: slow}
  front: {sum: {back: 0.5, x: 0.5}, full_scale: 2, tau: 0}
  clock: {square: 1, period: edge, full_scale: 1}
  chosen: {switch: [x, front], control: clock, full_scale: tall}
  above: {compare: {x: 1}, high: 1, low: 0, hysteresis: 0.01, full_scale: 1}
  kept: {track: y, control: above, initial: 0, full_scale: 3}
  held: {limit: y, low: -least, high: least, full_scale: 3, saturation: 1 + 0.2*level}
interface:
  sample: {adc: x, bits: 12}
  step: {dac: out, bits: 12, initial: 0.1*word, full_scale: word}
digital: {period: cycle, program: {out: word*sample}}
run: {until: 3 ms, every: 1 ms}
record: [x]
readouts: {end: {final: x}}
"""
VALUES = {
    "start": [0.5, 0.6, 3.0, -0.0, 0.0],  # 3 is beyond full scale
    "tall": [2.0, 2.5, -1.0],
    "slow": [1e-6, 2e-6, 0.0],  # without any lag there is a loop
    "edge": [1e-3, 1.1e-3],
    "level": [0.3, 0.4],
    "dial": [0.0, 1e-3, 0.5],  # the last is no dial
    "word": [1.0, 1.5],
    "cycle": [1e-3, 2e-3, 0.0],
    "least": [0.1, 0.2, -0.1],  # limits the wrong way round
}
KEPT = (circuits._layout, compiler._tape, compiler._timing, compiler._converters, shapes.part_of)
CACHES = (
    *(
        compiler._compiled,
        output_stages.stages_of,
        streams._unit_errors,
        streams._run_seeds,
        layout._laid_out,
    ),
    *(wiring._frame, wiring._rows, wiring._wired, shapes._shape_of, shapes._rates_of),
)


def forget() -> None:
    """As a process that has just begun."""
    for kept in (*KEPT, output_stages.make_of):
        kept.kept.clear()
    for cache in CACHES:
        cache.cache_clear()


def facts(patch, overrides, serial):
    """Everything that a run is made of, to the last bit, or what is wrong."""
    compiler._compiled.cache_clear()  # made again, of what is kept
    try:
        machine = compile_patch(patch, overrides, None, serial)
    except hybrid.HybridError as error:
        return str(error)
    circuit, number = circuit_of(machine)
    analog = (machine.analog.u0.tobytes(), machine.analog.full_scale.tobytes())
    values = (np.asarray(value) for value in circuit)
    arrays = [(a.shape, a.dtype.str, a.tobytes()) for a in values]
    made = (machine.parameters, machine.stages, machine.samplers, machine.holders, machine.steps)
    rest = (machine.timing, machine.elements, machine.tape.registers.tobytes())
    return repr((*made, *rest)), analog, list(number), arrays


def orders(count, seed):
    """A few parameters differ from one to the next, and now and then the serial number."""
    draw, overrides, serial, found = random.Random(seed), {}, 1, []
    for _ in range(count):
        name = draw.choice(list(VALUES))
        overrides = {**overrides, name: draw.choice(VALUES[name])}
        if len(overrides) > 3 or draw.random() < 0.3:
            overrides = {name: draw.choice(VALUES[name])}
        serial = draw.choice([serial, serial, draw.randrange(200)])
        found.append((overrides, serial))
    return found


@pytest.fixture(scope="module")
def patch():
    return hybrid.parse_patch(PATCH)


@pytest.fixture(scope="module")
def anew(patch):
    """Orders, and what each is made of where nothing was made before."""
    found = []
    for order in orders(150, 4):
        forget()
        found.append((order, facts(patch, *order)))
    return found


def test_what_runs_are_made_of_does_not_depend_on_those_before(patch, anew):
    complaints = {told for _, told in anew if isinstance(told, str)}
    for word in (
        "initial value",
        "full_scale",
        "algebraic loop",
        "pot_resolution",
        "period",
        "low",
    ):
        assert any(word in told for told in complaints), word
    assert sum(isinstance(told, tuple) for _, told in anew) > 50
    forget()
    for seed in range(3):
        shuffled = random.Random(seed).sample(anew, len(anew))
        for order, expected in shuffled:
            assert facts(patch, *order) == expected


def test_threads_may_prepare_runs_at_the_same_time(patch, anew):
    forget()
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda entry: facts(patch, *entry[0]), anew * 2))
    assert found == [expected for _, expected in anew] * 2


def shared(one, other):
    """Fields of two circuits that are the same objects."""
    fields = zip(one._fields, one, other, strict=True)
    return {name for name, a, b in fields if a is b and isinstance(a, np.ndarray)}


OWN = {"figures", "gain", "pieces", "initial"}
BY_RATES = {"rows", "signal", "corners", "ranges", "torn", "initial_piece", "outside"}


def test_runs_that_differ_in_their_seeds_share_a_machine(patch):
    one, two = (compile_patch(patch, {"start": start}, None, 3) for start in (0.4, 0.4))
    assert one is two
    assert compile_patch(patch, {"start": 0.4}, None, 4) is not one
    assert compile_patch(patch, {"start": 0.4}, "lags", 3) is not one


def test_circuits_share_all_but_figures(patch):
    machines = [compile_patch(patch, {"start": start}, "lags") for start in (0.5, 0.6, 0.5)]
    (first, number), (second, same), _ = map(circuit_of, machines)
    arrays = {name for name, value in first._asdict().items() if isinstance(value, np.ndarray)}
    assert shared(first, second) == arrays - OWN
    assert {"rows", "signal", "laws", "corners"} < arrays - OWN
    assert number == same
    for name in OWN:
        alone = getattr(first, name)
        assert alone.flags.writeable and alone.flags.c_contiguous and alone.flags.aligned
        before = getattr(second, name).copy()
        alone += 1.0
        np.testing.assert_array_equal(getattr(second, name), before)
        np.testing.assert_array_equal(getattr(circuit_of(machines[1])[0], name), before)
    one, two = (dict(machine.elements) for machine in machines[:2])
    assert [name for name in one if one[name] is not two[name]] == ["x"]


def test_machines_whose_leaks_differ_share_rows(patch):
    """Laws are drawn with the leaks, not which part has which."""
    first, second = (circuit_of(compile_patch(patch, {}, None, serial))[0] for serial in (1, 2))
    assert shared(first, second) >= BY_RATES
    assert not np.array_equal(first.laws, second.laws)
    # Two integrators, each with a leak of its own, and the lag that all parts have.
    assert first.laws.shape == second.laws.shape == (3, 2)


def test_only_what_a_parameter_changes_is_worked_out_again(monkeypatch):
    text = large_patch(60).replace("ref_0: {constant: 0.5,", "ref_0: {constant: level,", 1)
    assert "level" in text
    text = text.replace("\nanalog:", "\nparameters: {level: 0.5, until: 1 s}\nanalog:", 1)
    patch = hybrid.parse_patch(text)
    made = []
    original = circuits._CircuitLayout._elements
    monkeypatch.setattr(
        circuits._CircuitLayout,
        "_elements",
        lambda self, name, *of: made.append(name) or original(self, name, *of),
    )
    compile_patch(patch, {"level": 0.4}, "nominal", 1)
    assert len(made) >= 60
    for change, expected in (({"level": 0.3}, ["ref_0"]), ({"level": 0.3}, [])):
        made.clear()
        compile_patch(patch, change, "nominal", 1)
        assert made == expected


def test_a_batch_tells_what_is_wrong_with_each_of_its_runs(patch):
    starts = [0.5, 3.0, 0.6, 3.0, 0.5]
    found = hybrid.batch(patch, {"start": starts}, jobs=1)
    notes = [point.note for point in found.points]
    assert [point.status for point in found.points] == [
        *("complete", "failed", "complete", "failed", "complete")
    ]
    with pytest.raises(hybrid.PatchError) as refused:
        forget()
        compile_patch(patch, {"start": 3.0})
    assert notes[1] == notes[3] == str(refused.value)
    assert found.points[0].measured == found.points[4].measured


def test_the_zero_of_a_parameter_has_no_sign(patch):
    """Else what is kept for one zero, its equal, would serve for the other."""
    bound = [patch.bind({"start": zero})["start"] for zero in (0.0, -0.0)]
    assert np.copysign(1.0, bound).tolist() == [1.0, 1.0]


@pytest.mark.parametrize("seed", [0, 1, 63, 64, 2**32 - 1, 2**32, 2**53 + 1, 2**63 - 1])
def test_first_words_are_those_of_numpys_generators(seed):
    names = ("x", "a longer name", "")
    for quantity in ("gain", "leak"):
        expected = [
            float(streams.stream(seed, "machine", name, quantity).uniform(-1.0, 1.0))
            for name in names
        ]
        assert streams.unit_errors(seed, names, quantity) == expected
    for run, of in itertools.product((0, 1, 63, 64, 12345), (("batch",), ("sweep", "a"))):
        expected = int(streams.stream(seed, *of, str(run)).integers(2**53))
        assert streams.run_seed(seed, of, run) == expected
