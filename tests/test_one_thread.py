"""While runs are played BLAS has one thread, and as many as before afterwards."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from hybrid import points, runs
from hybrid.one_thread import one_thread


def threads() -> set[int]:
    np.linalg.inv(np.eye(2))
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


@pytest.fixture(autouse=True)
def several():
    with threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("this BLAS has no threads")
        yield


def test_one_within_and_as_many_as_before_without():
    with one_thread:
        assert threads() == {1}
        with one_thread:
            assert threads() == {1}
        assert threads() == {1}
    assert threads() == {2}


def test_an_error_ends_it():
    with pytest.raises(ZeroDivisionError), one_thread:
        raise ZeroDivisionError
    assert threads() == {2}


@pytest.mark.parametrize("function", [runs.run, points.play_all])
def test_runs_alone_and_together_are_within(function):
    assert function.__wrapped__ is not None and function is not function.__wrapped__
    seen = []

    def progress(_: float) -> None:
        seen.append(threads())

    if function is runs.run:
        runs.run("pitch_loop", progress=progress)
    else:
        from hybrid.batches import batch

        batch("van_der_pol", runs=2, jobs=1, progress=progress)
    assert seen and all(found == {1} for found in seen)
    assert threads() == {2}
