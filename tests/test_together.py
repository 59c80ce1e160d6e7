"""What is computed for many machines at once is what each gives alone, to the last bit."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

import hybrid
from hybrid.compiler import compile_patch
from hybrid.coupling import exact_modes_of_each, modes_of_each
from hybrid.crew import Pace
from hybrid.eigenvalues import _solved, eigenvalues
from hybrid.engine import propagator as propagation
from hybrid.engine.propagator import exponential_minus_one
from hybrid.errors import HybridError, PatchError, RunError
from hybrid.linearity import NotLinear
from hybrid.machine import Machine
from hybrid.memo import KeptBySize
from hybrid.patch import Patch
from hybrid.together import STACKED, attempt, in_stacks, only, passed_on

# A loop whose machines may differ in more than figures: one lag or the other is 0, or what the program
# remembers is not read, rows fall in with the cycle or not, results are on their way; a program that
# divides by 0, a mode that runs away in a cycle.
PATCH = """
title: Mixed
parameters: {rate: 10 rad/s, cycle: 1 ms, compute: 0.5 ms, tau: 1 us, k: 1, growth: 0 1/s, hold: 0,
  late: 0 s, row: 5 ms}
analog:
  v: {integrate: {pull: rate, v: growth}, initial: 0, full_scale: 1, tau: tau, noise: 0}
  x: {integrate: {v: rate}, initial: 0.1, full_scale: 1, tau: late, noise: 0}
interface: {s: {adc: x}, pull: {dac: w, full_scale: 1, initial: 0}}
digital: {period: cycle, compute_time: compute, remember: {w: 0}, program: {w: -s/k - hold*previous(w)}}
run: {until: 1 s, every: row}
readouts: {mode: {transient: x}}
"""
POINTS: list[dict[str, float]] = [
    {},
    {"cycle": 2e-3},
    {"cycle": 7e-3, "compute": 7e-3},
    {"k": 0.0},
    {"tau": 0.0},
    {"tau": 0.0, "late": 1e-6},
    {"hold": 0.2},
    {"rate": 300.0},
    {"growth": 1e6},
    {"compute": 0.0},
    {"compute": 3.5e-3},
    {"cycle": 1.1e-3, "tau": 3e-6, "row": 1.1e-3},
    {"cycle": 0.3e-3, "rate": 0.01},
    {"growth": 5.0},
    {"cycle": 2e-3, "k": 0.0},
    {"cycle": 9e-3, "rate": 30.0},
]


@pytest.fixture
def patch() -> Patch:
    return hybrid.parse_patch(PATCH)


def told(answer: object) -> str:
    """An answer in full, its floats to the last bit; of an error what it says."""
    return f"{type(answer).__name__}: {answer}" if isinstance(answer, HybridError) else repr(answer)


def handfuls(machines: list[Machine], size: int) -> Iterator[list[Machine]]:
    for first in range(0, len(machines), size):
        yield machines[first : first + size]


@pytest.mark.parametrize("preset", ["ideal", "lags", "nominal"])
def test_modes_do_not_depend_on_company(patch, preset, monkeypatch) -> None:
    # As good as nothing is kept, so that each handful computes its own.
    none_kept = KeptBySize[propagation.Stretch, propagation.Propagator](0, lambda _: 1)
    monkeypatch.setattr(propagation, "_kept", none_kept)
    machines = [compile_patch(patch, point, preset) for point in POINTS]
    alone = [told(modes_of_each([machine])[0]) for machine in machines]
    assert sum("divides by 0 in every cycle" in answer for answer in alone) == 2
    assert sum("runs away within one cycle" in answer for answer in alone) == 1
    assert sum("Mode(" in answer for answer in alone) == len(POINTS) - 3
    order = np.random.default_rng(3)
    for size in (2, 3, len(machines)):
        places = order.permutation(len(machines)).tolist()
        mixed = [machines[place] for place in places]
        found = itertools.chain.from_iterable(map(modes_of_each, handfuls(mixed, size)))
        for place, answer in zip(places, found, strict=True):
            assert told(answer) == alone[place]


def test_machines_of_many_kinds_keep_their_places() -> None:
    """Even of different patches: all analog, several tasks, not linear."""
    names = ["pitch_loop", "damped_oscillator", "rate_groups", "van_der_pol", "pitch_loop_lead"]
    machines = [compile_patch(hybrid.read_patch(name)) for name in names]
    found = exact_modes_of_each(machines)
    assert isinstance(found[3], NotLinear)
    for machine, answer in zip(machines, found, strict=True):
        assert told(answer) == told(exact_modes_of_each([machine])[0])


def by_five(_: Pace, orders: Sequence[Any], jobs: int) -> list[Sequence[Any]]:
    return [orders[i : i + 5] for i in range(0, len(orders), 5)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_each_point_of_a_sweep_is_what_it_is_alone(patch, jobs: int, monkeypatch) -> None:
    monkeypatch.setattr(Pace, "handfuls", by_five)
    gains = [1.0, 0.5, 0.0, 2.0, -1.0, 3.0, 0.25, 4.0, 0.0, 1.5, 0.8, 0.9]
    swept = hybrid.sweep(patch, "k", gains, {"row": 0.01}, jobs=jobs)
    assert [point.index for point in swept.points] == list(range(len(gains)))
    for point, k in zip(swept.points, gains, strict=True):
        if k == 0.0:
            assert point.modes == () and "divides by 0 in every cycle" in point.note
        else:
            assert list(point.modes) == hybrid.predict(patch, {"k": k, "row": 0.01}).to_dicts()
            alone = hybrid.run(patch, {"k": k, "row": 0.01}, seed=point.seed)
            assert point.measured == alone.readouts


def test_a_point_that_cannot_be_compiled_is_alone_in_that(patch, monkeypatch) -> None:
    monkeypatch.setattr(Pace, "handfuls", by_five)
    lags_s = [0.0, 1e-6, 1e-7, 1e-16, 2e-6, 1e-5, 1e-16, 3e-6]
    swept = hybrid.sweep(patch, "tau", lags_s, {"cycle": 5e-3}, jobs=1)
    failed = [point.index for point in swept.points if point.status == "failed"]
    assert failed == [3, 6]
    with pytest.raises(PatchError, match="below a femtosecond") as alone:
        hybrid.predict(patch, {"tau": 1e-16})
    assert {swept.points[place].note for place in failed} == {str(alone.value)}
    assert all(point.modes for point in swept.points if point.index not in failed)


def test_eigenvalues_of_a_stack() -> None:
    """s +- i w of [[s, w], [-w, s]], to rounding; not a matter of what stands beside them."""
    draw = np.random.default_rng(8)
    s, w = draw.normal(size=20), 10.0 ** draw.uniform(-3, 6, size=20)
    turns = [np.array([[a, b], [-b, a]]) for a, b in zip(s, w, strict=True)]
    queue = np.diag(np.ones(3), 1)  # one eigenvalue four times, and one vector
    broken = np.full((2, 2), 1e200)
    found = eigenvalues([*turns[:10], queue, broken, np.zeros((0, 0)), *turns[10:]])
    for a, b, values in zip(s, w, found[:10] + found[13:], strict=True):
        assert not isinstance(values, HybridError)
        assert np.max(np.abs(np.sort_complex(values) - [a - 1j * b, a + 1j * b])) < 4e-16 * b
    assert told(found[10]) == told(eigenvalues([queue])[0])
    assert isinstance(found[11], NotLinear)
    assert len(only([found[12]])) == 0


def test_a_matrix_that_cannot_be_solved_leaves_the_others() -> None:
    stack = np.array([np.eye(2), np.zeros((2, 2)), [[2.0, 1.0], [0.0, 4.0]]])
    found = _solved(np.linalg.inv, np.empty((3, 2, 2), dtype=complex), stack)
    assert found[0].tolist() == np.eye(2).tolist()
    assert np.isnan(found[1]).all()
    assert found[2].tolist() == [[0.5, -0.125], [0.0, 0.25]]


def test_exponentials_of_a_stack() -> None:
    draw = np.random.default_rng(5)
    scale = 10.0 ** draw.uniform(-9, 4, size=(4, 6, 1, 1))
    stack = draw.normal(size=(4, 6, 5, 5)) * scale - 3.0 * scale * np.eye(5)
    stack[2, 3] = 0.0
    found = exponential_minus_one(stack)
    for at in np.ndindex(4, 6):
        assert found[at].tobytes() == exponential_minus_one(stack[at]).tobytes()


def test_stacks_are_of_one_kind_and_not_too_large() -> None:
    seen: list[list[int]] = []

    def negated(some: list[int]) -> list[int]:
        seen.append(some)
        return [-item for item in some]

    items = [5, 2, 4, 7, 9, 1]
    found = in_stacks(items, lambda i: i % 2, lambda i: STACKED // (2 if i % 2 else 4), negated)
    assert found == [-item for item in items]
    assert seen == [[5, 7], [9, 1], [2, 4]]
    assert in_stacks([1, 2], lambda _: 0, lambda _: 10 * STACKED, negated) == [-1, -2]
    assert in_stacks([], lambda _: 0, lambda _: 1, negated) == []


def test_errors_stay_in_their_places() -> None:
    def half(number: int) -> float:
        if number % 2:
            raise RunError(f"{number} is odd")
        return number / 2

    found = passed_on([attempt(half, n) for n in (4, 3, 8)], lambda some: [2 * x for x in some])
    assert found[0] == 4 and found[2] == 8
    with pytest.raises(RunError, match="3 is odd"):
        only([found[1]])
    with pytest.raises(ZeroDivisionError):
        attempt(lambda n: n // 0, 1)
