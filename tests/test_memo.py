"""Results kept by what they were made of."""

import numpy as np
import pytest

import hybrid
from hybrid import circuits, compiler
from hybrid.compiler import compile_patch
from hybrid.memo import MOST_KEPT, KeptByObject, KeptBySize, KeptByUse, KeptLast


def test_a_result_is_kept_while_what_it_was_made_of_stays():
    made = []

    @KeptByUse
    def product(scope, name):
        made.append(scope[name] * (scope["y"] if scope[name] > 0 else 1.0))
        return made[-1]

    first = {"x": 2.0, "y": 3.0, "z": 4.0}
    assert product(first, "x") == 6.0
    assert product({**first, "z": 5.0}, "x") == 6.0
    assert len(made) == 1
    assert product({**first, "y": 5.0}, "x") == 10.0
    assert product({**first, "x": -2.0}, "x") == -2.0  # y is not asked for
    assert product({"x": -2.0, "y": 7.0}, "x") == -2.0
    assert len(made) == 3
    assert product(first, "z") == 12.0
    assert len(made) == 4


def test_nothing_is_kept_of_a_failure_or_for_ever():
    calls = []

    @KeptByUse
    def inverse(scope, which):
        calls.append(which)
        return 1.0 / scope["x"]

    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            inverse({"x": 0.0}, 0)
    for which in range(MOST_KEPT + 1):
        inverse({"x": 2.0}, which)
    before = len(calls)
    assert inverse({"x": 2.0}, MOST_KEPT) == 0.5
    assert len(calls) == before
    assert inverse({"x": 2.0}, 0) == 0.5
    assert len(calls) == before + 1


@pytest.mark.parametrize(
    "name", ["van_der_pol", "relay_servo", "shooting", "jet_control", "reentry", "tumbling_brick"]
)
def test_elements_kept_from_other_runs_are_those_made_anew(name):
    """A batch changes a few figures at a time; what is kept for the rest must be the same to the bit."""
    patch = hybrid.read_patch(name)
    draw = np.random.default_rng(5)
    known = patch.bind(None)
    for _ in range(8):
        changed = {p: known[p] * (1.0 + 1e-3 * draw.integers(2)) for p in patch.analog_parameters}
        machine = str(draw.choice(["lags", "nominal", "analog_thing"]))
        order = (patch, changed, machine, int(draw.integers(3)), True)
        kept = compile_patch(*order)
        circuits._layout.kept.clear()
        compiler._compiled.cache_clear()
        anew = compile_patch(*order)
        assert repr(kept.elements) == repr(anew.elements)
        assert kept.analog.u0.tobytes() == anew.analog.u0.tobytes()
        assert kept.analog.full_scale.tobytes() == anew.analog.full_scale.tobytes()


def test_what_is_kept_by_size_is_no_larger():
    asked = []

    def squares(keys):
        asked.append(keys)
        return [[key] * key for key in keys]

    kept = KeptBySize(10, len)
    assert kept.of([2, 3, 2, 4], squares) == [[2] * 2, [3] * 3, [2] * 2, [4] * 4]
    assert asked == [[2, 3, 4]]
    assert kept.of([4, 5, 3], squares) == [[4] * 4, [5] * 5, [3] * 3]
    assert asked[1:] == [[5]]  # 2 + 3 + 4 + 5 are too many, and 3 + 4 + 5, too: two stay
    assert list(kept.kept) == [4, 5]
    assert kept.total == 9
    kept.of([60, 70], squares)
    assert list(kept.kept) == [60, 70]  # however large, for a prediction and a run of the same
    kept.of([1], squares)
    assert kept.total == 71
    with pytest.raises(ZeroDivisionError):
        kept.of([8], lambda _: [1 // 0])
    assert list(kept.kept) == [70, 1]


def test_what_was_made_last_may_be_begun_with():
    begun = []

    @KeptLast
    def squares(last, key, count):
        begun.append(last)
        return last if last and len(last) == count else [i * i for i in range(count)]

    first = squares("a", 3)
    assert squares("a", 3) is first
    assert squares("b", 4) == [0, 1, 4, 9]
    assert squares("a", 2) == [0, 1]
    assert begun == [None, first, None, first]
    for i in range(MOST_KEPT):
        squares(i, 1)
    assert len(squares.kept) == MOST_KEPT
    squares("a", 2)
    assert begun[-1] is None


def test_what_is_kept_by_object_is_of_that_object_alone():
    made = []
    kept = KeptByObject(lambda thing: made.append(thing) or len(thing), 2)
    things = [[1], [1], [1, 2]]
    assert [kept(thing) for thing in things] == [1, 1, 2]
    assert len(made) == 3
    assert [kept(thing) for thing in things[1:]] == [1, 2]
    assert len(made) == 3
    assert kept(things[0]) == 1
    assert len(made) == 4
    assert len(kept.kept) == 2
