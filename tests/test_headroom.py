"""Shipped patches are scaled with room above their largest values, whatever machine they are put on."""

from dataclasses import replace
from pathlib import Path

import pytest

import hybrid
from hybrid.expressions import Binary, Number
from hybrid.shipped import shipped_patches

PARTS = sorted((Path(__file__).parent.parent / "patches" / "parts").glob("*.yaml"))
EVERYTHING = {**shipped_patches(), **{f"parts/{path.stem}": path for path in PARTS}}
NEED_DATA = {"parts/f16"}  # of NASA's, which do not ship
ON_PURPOSE = frozenset()  # patches whose header says that they overload; none does
# Of a run: where it begins is where a full scale that just fits is met.
BEGINNING = 0.05


def beginning(name):
    patch = hybrid.read_patch(EVERYTHING[name])
    until = replace(patch.run.until, expr=Binary("*", Number(BEGINNING), patch.run.until.expr))
    return replace(patch, run=replace(patch.run, until=until), readouts=())


@pytest.mark.parametrize("name", sorted(EVERYTHING.keys() - NEED_DATA - ON_PURPOSE))
def test_shipped_patches_have_room_for_tolerance_and_noise(name):
    """0.5 % holds the 0.01 % of tolerance of each of a few parts in a row, and their noise."""
    found = hybrid.check(EVERYTHING[name], machine="lags")
    assert found.trial.status in ("complete", "cut")
    tight = {r.signal: r.used for r in found.scaling if r.kind != "compare" and r.used > 0.995}
    assert tight == {}


@pytest.mark.parametrize("name", sorted(EVERYTHING.keys() - NEED_DATA - ON_PURPOSE))
def test_shipped_patches_begin_without_an_overload_on_the_nominal_machine(name):
    for serial in (1, 2):
        assert hybrid.run(beginning(name), machine="nominal", serial=serial).overloads == ()


def test_rate_groups_are_read_out_on_the_nominal_machine():
    """Its first moment, k_rate k_angle theta(0) = 10 rad/s^2, is within the DAC's range, so that the
    readout has the whole record and finds the mode that is predicted."""
    found = hybrid.run("rate_groups", machine="nominal", seed=3)
    mode = hybrid.predict("rate_groups", machine="nominal").modes[0]
    pitch = found.readouts["pitch_mode"]
    assert found.overloads == () and pitch["note"] == ""
    for figure in ("omega", "zeta"):
        error = abs(pitch[figure] - getattr(mode, figure))
        assert error < 5 * pitch[f"{figure}_error"]  # standard deviations
