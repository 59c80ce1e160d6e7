"""In which order elements are computed: few signals of a loop are read before they are."""

import pytest

from hybrid.elements import INTEGRATE, SUM, Element
from hybrid.engine.order import computing_order


@pytest.mark.parametrize("ring", [2, 3, 7])
def test_a_ring_of_integrators_is_cut_at_one(ring):
    """Each reads the one before, and all but one of them read what has been computed."""
    names = [f"x{i}" for i in range(ring)]
    elements = {
        name: Element(INTEGRATE, {names[i - 1]: 1.0}, figures=(0.0, 0.0))
        for i, name in enumerate(names)
    }
    order, _ = computing_order(elements)
    early = [n for i, n in enumerate(order) if names[names.index(n) - 1] not in order[:i]]
    assert len(early) == 1


def test_no_reader_of_a_cut_signal_sees_the_old_value_in_vain():
    """An oscillator whose x feeds ten products, all of which feed v: only v is read before its time."""
    elements = {
        "x": Element(INTEGRATE, {"v": 1.0}, figures=(0.0, 0.0)),
        **{f"p{i}": Element(SUM, {"x": 1.0}) for i in range(10)},
        "v": Element(INTEGRATE, {f"p{i}": 0.1 for i in range(10)}, figures=(0.0, 0.0)),
    }
    order, _ = computing_order(elements)
    early = {
        read
        for i, name in enumerate(order)
        for read in elements[name].reads()
        if read not in order[:i]
    }
    assert len(early) == 1
