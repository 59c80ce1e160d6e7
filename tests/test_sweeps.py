"""Sweeps from Python: values, what the data set says, how points are counted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import hybrid
from hybrid import points
from hybrid.storage import write_dataset
from hybrid.streams import run_seed, stream

PATCH = """
title: Decay
machine: {preset: ideal, serial: 7}
parameters: {rate: 1 1/s, other: 2*rate, cycle: 10 ms, tall: 1 V}
analog:
  x: {integrate: {x: -rate}, initial: tall, full_scale: 1 V}
interface: {s: {adc: x, bits: 12}}
digital: {period: cycle, program: {w: s}}
run: {until: 1 s}
readouts:
  end: {final: x}
  level: {rms: x}
  mode: {transient: x}
"""
# Its middle value divides by zero, its ends do not.
POLE = PATCH.replace("other: 2*rate", "one: 1.25 1/s, other: one/(rate - one)").replace(
    "  mode: {transient: x}\n", ""
)


@pytest.fixture(scope="module")
def patch() -> hybrid.patch.Patch:
    return hybrid.parse_patch(PATCH, "decay.yaml")


@pytest.fixture(scope="module")
def result(patch) -> hybrid.sweeps.Sweep:
    return hybrid.sweep(patch, "rate", ["0.5 1/s", 1.0, 2], {"cycle": "5 ms"}, seed=3)


def test_every_readout_is_in_the_data(result) -> None:
    data = result.dataset
    assert data["value_end"].values == pytest.approx(np.exp([-0.5, -1.0, -2.0]), rel=1e-12)
    assert data["value_end"].attrs == {"units": "V", "readout": "final", "signal": "x"}
    assert data["time_end"].values.tolist() == [1.0, 1.0, 1.0]
    assert data["time_end"].attrs["units"] == "s"
    rates = np.array([0.5, 1.0, 2.0])
    rms = np.sqrt((1 - np.exp(-2 * rates)) / (2 * rates))
    assert data["value_level"].values == pytest.approx(rms, rel=1e-2)
    assert "time_level" not in data
    assert data["readout"].values.tolist() == ["mode"]


@pytest.mark.parametrize(
    ("window", "told"),
    [
        ("", None),
        (", from: 250 ms", "from 0.25 s"),
        (", until: 10*cycle", "until 10*cycle"),
        (", from: 0.1 s, until: 0.5 s", "from 0.1 s until 0.5 s"),
    ],
)
def test_the_window_of_a_readout_is_in_the_data(window: str, told: str | None) -> None:
    text = PATCH.replace("{final: x}", f"{{final: x{window}}}").replace(
        "  mode: {transient: x}\n", ""
    )
    data = hybrid.sweep(hybrid.parse_patch(text), "rate", [1.0, 2.0], jobs=1).dataset
    assert data["value_end"].attrs.get("window") == data["time_end"].attrs.get("window") == told


def test_the_data_say_where_they_come_from(result, patch, tmp_path: Path) -> None:
    write_dataset(result.dataset, tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as stored:
        about = stored.attrs
    assert about["serial"] == 7
    assert about["patch_hash"] == hybrid.run(patch).record.attrs["patch_hash"]
    assert set(json.loads(about["versions"])) == {"hybrid", "numpy", "numba", "python"}
    # `other` follows the swept parameter, so it is not one figure for all.
    assert json.loads(about["parameters"]) == {"cycle": "5 ms", "tall": "1 V"}
    assert (about["seed"], about["parameter"], about["status"]) == (3, "rate", "complete")


def test_points_without_a_result_are_counted(result, patch) -> None:
    alone = hybrid.parse_patch(PATCH.replace("  end: {final: x}\n  level: {rms: x}\n", ""))
    for each, without in ((result, 0), (hybrid.sweep(alone, "rate", [1, 2, 3]), 3)):
        assert [p.has_result for p in each.points] == [not without] * 3  # a decay does not swing
        assert f"3 of 3 points, {without} without a result" in repr(each)
    assert result.points[0].remarks.startswith("mode: ")
    assert result.dataset["note"].values[0] == result.points[0].remarks
    plain = hybrid.parse_patch(PATCH.replace("  mode: {transient: x}\n", ""))
    assert "3 of 3 points, 0 without" in repr(hybrid.sweep(plain, "rate", [1, 2, 3]))
    over = hybrid.sweep(plain, "rate", [1, -1])
    assert "0 without a result, 1 with overloads, complete" in repr(over)
    failed = hybrid.sweep(hybrid.parse_patch(POLE), "rate", "0.5:2:3")
    assert "3 of 3 points, 1 without a result, 1 failed, complete" in repr(failed)
    assert [p.status for p in failed.points] == ["complete", "failed", "complete"]
    assert "'other'" in failed.points[1].note


@pytest.mark.parametrize("values", [[0.0, 1e-3], [1e-3, 0.0], [1e-3, -1.0, 1e-2], [-1.0, 1e-3]])
def test_an_end_that_cannot_be_compiled_is_refused_wherever_it_stands(patch, values) -> None:
    with pytest.raises(hybrid.HybridError) as caught:
        hybrid.sweep(patch, "cycle", values)
    with pytest.raises(hybrid.HybridError) as alone:
        hybrid.run(patch, {"cycle": min(values)})
    assert str(caught.value) == str(alone.value)


def test_values_in_every_form(patch) -> None:
    for values in ("1:2:3", [1, 1.5, 2], np.array([1, 1.5, 2]), iter(["1 1/s", "1.5", "2"])):
        assert hybrid.sweep(patch, "rate", values).values.tolist() == [1.0, 1.5, 2.0]
    assert hybrid.sweep(patch, "cycle", "1 ms:100 ms:3:log").values == pytest.approx(
        [1e-3, 1e-2, 1e-1]
    )


REFUSED = {
    "no values": (("rate", []), {}, "at least one"),
    "a number": (("rate", 5), {}, "list of numbers"),
    "none": (("rate", None), {}, "list of numbers"),
    "a text": (("rate", "much"), {}, "START:STOP:COUNT"),
    "texts": (("rate", ["much"]), {}, "names are not known"),
    "digits of another script": (("rate", "1:2:\u0663"), {}, "must be a whole number"),
    "nested": (("rate", [[1, 2]]), {}, "finite number"),
    "table": (("rate", np.ones((2, 2))), {}, "list of numbers"),
    "nan": (("rate", [float("nan")]), {}, "finite number"),
    "unit": (("rate", ["1 V"]), {}, "does not fit"),
    "name": ((5, [1]), {}, "names are texts"),
    "unknown": (("rte", [1]), {}, "did you mean 'rate'"),
    "jobs": (("rate", [1]), {"jobs": "x"}, "jobs is 'x'"),
    "jobs 0": (("rate", [1]), {"jobs": 0}, "from 1 to 1000"),
    "jobs fraction": (("rate", [1]), {"jobs": 1.5}, "jobs is 1.5"),
    "set and swept": (("rate", [1]), {"parameters": {"rate": 2}}, "both set and swept"),
}


@pytest.mark.parametrize("case", REFUSED.values(), ids=REFUSED)
def test_what_a_sweep_refuses(patch, case) -> None:
    order, options, says = case
    with pytest.raises(hybrid.HybridError) as caught:
        hybrid.sweep(patch, *order, **options)
    assert says in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_parameter_named_like_a_variable() -> None:
    text = PATCH.replace("tall", "value_end")
    with pytest.raises(hybrid.RunError, match="rename the parameter"):
        hybrid.sweep(hybrid.parse_patch(text), "value_end", [1.0])


def test_a_long_sweep_begins_at_once_and_an_early_interrupt_keeps_what_is_done(
    patch, monkeypatch
) -> None:
    """The seeds of 300,000 points would take longer to draw than the first points to play."""
    drawn = []

    def counted(seed, names, run):
        drawn.append(run)
        return run_seed(seed, names, run)

    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(points, "run_seed", counted)
    result = hybrid.sweep(patch, "rate", "1:2:300000", jobs=1, progress=interrupt)
    assert (result.status, len(result.points), len(drawn)) == ("interrupted", 1, 1)
    (point,) = result.points
    again = hybrid.sweep(patch, "rate", "1:2:300000", jobs=1, progress=interrupt)
    assert again.points[0].seed == point.seed
    own = stream(0, "sweep", "rate", str(point.index)).integers(2**53)
    assert point.seed == own


@pytest.mark.parametrize("values", ["10 ms:1 s:9:log", ["1 s", "300 ms", "100 ms", "30 ms"]])
def test_the_pitch_mode_goes_on_where_another_root_is_nearer_to_the_ideal(values):
    """z (z - 1)^2 + W^2/2 (z + 1) = 0: the pitch mode is the pair that grows, at every W; from W = 2 on
    the root that began at z = 0 is a pair too, and nearer to i omega_p."""
    result = hybrid.sweep("pitch_loop", "cycle", values, machine="ideal", jobs=1)
    data = result.dataset
    for i, period_s in enumerate(data["cycle"].values * 1e-3):
        w = 10.0 * period_s
        s = np.log(np.roots([1.0, -2.0, 1.0 + w * w / 2, w * w / 2]).astype(complex)) / period_s
        (pitch,) = s[(s.real > 0) & (s.imag > 0)]
        assert float(data["predicted_zeta"][i, 0]) == pytest.approx(
            -pitch.real / abs(pitch), abs=1e-9
        )
        assert float(data["omega_ideal"][i, 0]) == 10.0
        told = [m for m in result.to_dict()["points"][i]["modes"] if m["omega_ideal"] == 10.0]
        assert [m["omega"] for m in told] == pytest.approx([abs(pitch)])
    assert data.sizes["mode"] == 2 and np.isnan(data["omega_ideal"][:, 1]).all()
