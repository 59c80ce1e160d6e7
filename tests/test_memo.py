"""Results kept by what they were made of."""

import pytest

from hybrid.memo import MOST_KEPT, KeptByUse


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
