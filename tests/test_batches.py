"""Batches: which runs are made, that each can be replayed, and how drawn errors spread."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import hybrid
from hybrid.charts.ensemble import Across, Spread, ensemble_chart
from hybrid.cli import main
from hybrid.storage import write_dataset

PATCH = """
title: Decay
machine: {preset: lags, tolerance: 1e-4, noise: 1e-3}
parameters: {rate: 1 1/s, cycle: 10 ms, tall: 1 V}
analog:
  x: {integrate: {x: -rate}, initial: tall, full_scale: 1 V}
  y: {sum: {x: 0.5}, full_scale: 1 V}
interface: {s: {adc: x}}
digital: {period: cycle, program: {w: s}}
run: {until: 0.5 s}
readouts:
  end: {final: x}
  half: {final: y}
  mode: {transient: x}
"""
# Nothing but a source and a gain: what is read is the gain.
GAIN = """
title: Gain
machine: {preset: ideal, tolerance: 1e-3}
analog:
  one: {constant: 1 V, full_scale: 2 V, tolerance: 0}
  two: {sum: {one: 2}, full_scale: 2 V}
run: {until: 1 ms, every: 1 ms}
readouts: {out: {final: two}}
"""


@pytest.fixture(scope="module")
def patch() -> hybrid.patch.Patch:
    return hybrid.parse_patch(PATCH, "decay.yaml")


@pytest.fixture(scope="module")
def result(patch) -> hybrid.batches.Batch:
    return hybrid.batch(
        patch, {"rate": [0.5, "1 1/s", 2.0], "cycle": "5 ms"}, serial=[1, 2, 7], seed=3
    )


def test_every_run_can_be_replayed_alone(result, patch) -> None:
    data = result.dataset
    for i, rate in enumerate((0.5, 1.0, 2.0)):
        seed, serial = int(data["seed"][i]), int(data["serial"][i])
        alone = hybrid.run(patch, {"rate": rate, "cycle": 5e-3}, seed=seed, serial=serial)
        assert result.points[i].measured == alone.readouts
        assert data["value_end"].values[i] == alone.readouts["end"]["value"]
    assert data["serial"].values.tolist() == [1, 2, 7]
    assert len(set(data["seed"].values.tolist())) == 3


def test_many_workers_give_the_same_runs(patch) -> None:
    serials = range(60)
    alone, shared = (hybrid.batch(patch, serial=serials, jobs=jobs) for jobs in (1, 2))
    assert alone.points == shared.points
    assert [p.index for p in shared.points] == list(serials)


def test_the_data_say_where_they_come_from(result, patch, tmp_path: Path) -> None:
    write_dataset(result.dataset, tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as stored:
        stored.load()
    assert stored.attrs["patch_hash"] == hybrid.run(patch).record.attrs["patch_hash"]
    assert json.loads(stored.attrs["parameters"]) == {"cycle": "5 ms", "tall": "1 V"}
    assert json.loads(stored.attrs["differ"]) == ["rate"]
    assert stored["rate"].values.tolist() == [0.5, 1.0, 2.0]
    assert stored["rate"].attrs["units"] == "1/s"
    assert stored["value_half"].attrs["units"] == "V"
    assert result.to_pandas().index.names == ["run", "readout"]
    assert "3 of 3 runs" in repr(result)


def test_what_follows_from_a_parameter_that_differs_is_not_shared() -> None:
    """b is 2, 4, 6 where a is 1, 2, 3, and c follows b; d, which is set, follows nothing."""
    names = "parameters: {a: 1, b: 2*a, c: b + 1, d: 3*a, e: 7}\nanalog:"
    follows = hybrid.parse_patch(GAIN.replace("analog:", names))
    found = hybrid.batch(follows, {"a": [1.0, 2.0, 3.0], "d": 5.0})
    for told in (found.to_dict(), found.dataset.attrs):
        shared = {k: told[k] for k in ("parameters", "parameters_si")}
        if isinstance(told["parameters"], str):
            shared = {k: json.loads(text) for k, text in shared.items()}
        assert shared == {"parameters": {"d": "5", "e": "7"}, "parameters_si": {"d": 5, "e": 7}}
    every = hybrid.batch(follows, {"a": 2.0}, runs=2).to_dict()["parameters_si"]
    assert every == {"a": 2.0, "b": 4.0, "c": 5.0, "d": 6.0, "e": 7.0}


def test_tolerances_fill_their_range_evenly() -> None:
    count, limit = 400, 1e-3
    found = hybrid.batch(hybrid.parse_patch(GAIN), serial=range(count))
    errors = np.sort(found.dataset["value_out"].values / 2.0 - 1.0)
    assert np.all(np.abs(errors) <= limit * (1 + 1e-12))
    # Kolmogorov and Smirnov: the largest distance from the line, at a level of 1e-6.
    line = 0.5 + errors / (2 * limit)
    distance = np.max(np.abs(line - (np.arange(count) + 0.5) / count)) + 0.5 / count
    assert distance < math.sqrt(math.log(2 / 1e-6) / (2 * count))
    about = found.summary()["out"]
    assert about["runs"] == count
    assert about["std"] == pytest.approx(2 * limit / math.sqrt(3), rel=0.15)  # 4 sigma of it


def test_a_run_that_cannot_be_made_is_kept_with_its_reason(patch) -> None:
    found = hybrid.batch(patch, {"cycle": [0.01, -1.0, 0.02]})
    assert [p.status for p in found.points] == ["complete", "failed", "complete"]
    assert "cycle" in found.points[1].note or "period" in found.points[1].note
    assert math.isnan(found.dataset["value_end"].values[1])
    assert "1 failed" in repr(found)


REFUSED = {
    "nothing to do": ({}, {}, "how many runs"),
    "lengths": ({"rate": [1.0, 2.0]}, {"serial": [1, 2, 3]}, "rate has 2 values, serial has 3"),
    "runs": ({"rate": [1.0, 2.0]}, {"runs": 3}, "runs is 3"),
    "no runs": ({}, {"runs": 0}, "from 1 to"),
    "half a run": ({}, {"runs": 1.5}, "from 1 to"),
    "empty": ({"rate": []}, {}, "rate has no values"),
    "empty in numpy": ({"rate": np.array([])}, {}, "rate has no values"),
    "no serials": ({}, {"serial": range(0)}, "serial has no values"),
    "list for a mapping": ([1, 2], {}, r"parameters is \[1, 2\]; give a mapping"),
    "empty list for a mapping": ([], {"runs": 2}, "give a mapping"),
    "number for a name": ({3: [1.0]}, {}, "3 is no name"),
    "range": ({"cycle": "1 ms:2 ms:3"}, {}, "cycle is '1 ms:2 ms:3'; a range is for a sweep"),
    "table": ({"rate": np.ones((2, 2))}, {}, "rate is an array of 2 dimensions"),
    "table of serials": (
        {},
        {"serial": np.ones((2, 2), int)},
        "serial is an array of 2 dimensions",
    ),
    "table of lists": ({"rate": [[1.0], [2.0]]}, {}, r"rate cannot be \[1.0\]"),
    "mapping for a value": ({"rate": {1.0: 2.0}}, {"runs": 2}, "rate cannot be {1.0: 2.0}"),
    "endless": ({}, {"serial": itertools.count()}, "serial has too many values"),
    "too many": (
        {},
        {"serial": range(10**12)},
        "serial has too many values; a batch makes 1000000",
    ),
    "progress": ({}, {"runs": 2, "progress": 3}, "progress is 3; give a function"),
    "machines": (
        {},
        {"runs": 2, "machine": ["nominal"]},
        r"machine is \['nominal'\]; give the name",
    ),
    "unknown": ({"rte": [1.0]}, {}, "did you mean 'rate'"),
    "unit": ({"rate": ["1 V"]}, {}, "does not fit"),
    "serial": ({}, {"serial": [1, -2]}, "serial is -2"),
    "one serial": ({}, {"serial": "a"}, "serial is 'a'; it must be a whole number"),
    "one seed": ({}, {"seed": -1}, "seed is -1"),
    "seed": ({}, {"runs": 2, "seed": "x"}, "seed is 'x'"),
    "seeds": ({}, {"seed": [1, 0.5]}, "seed is 0.5"),
    "jobs": ({}, {"runs": 2, "jobs": 0}, "jobs is 0"),
    "machine": ({}, {"runs": 2, "machine": "best"}, "unknown machine"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused(patch, case: str) -> None:
    parameters, options, said = REFUSED[case]
    with pytest.raises(hybrid.HybridError, match=said):
        hybrid.batch(patch, parameters, **options)


def test_whole_numbers_of_numpy_are_taken(patch) -> None:
    assert len(hybrid.batch(patch, runs=np.int64(2), serial=np.int64(1)).points) == 2
    assert len(hybrid.batch(patch, {"rate": np.array([1.0])}, runs=np.array(1)).points) == 1


def test_a_parameter_must_not_hide_a_variable() -> None:
    renamed = hybrid.parse_patch(PATCH.replace("rate: 1", "serial: 1").replace("-rate", "-serial"))
    with pytest.raises(hybrid.RunError, match="rename the parameter"):
        hybrid.batch(renamed, {"serial": [1.0, 2.0]})


# -- the command ------------------------------------------------------------------------------------

RUN = {"run", "parameters_si", "serial", "seed", "readouts", "status", "note", "overloads"}
BATCH = {
    *("patch", "title", "machine", "on", "parameters", "parameters_si"),
    *("status", "status_note", "summary", "groups", "runs"),
}
ABOUT = {"runs", "mean", "std", "minimum", "maximum", "units"}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("decay.yaml").write_text(PATCH)
    return tmp_path


def test_every_combination_is_run(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ranges = ["--over", "rate=1:2:2", "--over", "tall=0.5 V:1 V:2"]
    options = [*ranges, "--serials", "3:4", "--runs", "2", "--seed", "5", "--json"]
    assert main(["batch", "decay.yaml", *options]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found.keys() == BATCH | {"files"}
    stem = "out/decay_seed5_over_rate,tall_serials3-4_runs2_batch"
    assert found["files"] == [f"{stem}.nc", f"{stem}.png"]
    assert all(run.keys() == RUN for run in found["runs"])
    assert all(about.keys() == ABOUT for about in found["summary"].values())
    made = [(*run["parameters_si"].values(), run["serial"]) for run in found["runs"]]
    assert made == [
        row for row in itertools.product((1.0, 2.0), (0.5, 1.0), (3, 4)) for _ in range(2)
    ]
    values = [run["readouts"]["end"]["value"] for run in found["runs"]]
    assert values[0] != values[1]  # noise of its own
    assert found["parameters"] == {"cycle": "10 ms"}


def test_no_batch_overwrites_another_ones_file(folder: Path) -> None:
    """Each differs from the first in one option; another range of the same name is the same file."""
    first = {"--over": "rate=1:2:2", "--serials": "1:2", "--runs": "1"}
    others = ({"--over": "tall=0.5 V:1 V:2"}, {"--serials": "2:3"}, {"--runs": "2"}, {})
    for asked in (*({**first, **other} for other in others), {**first, "--over": "rate=3:4:2"}):
        options = [text for option in asked.items() for text in option]
        assert main(["batch", "decay.yaml", *options, "--no-chart"]) == 0
    assert len(list(Path("out").iterdir())) == len(others)
    assert main(["batch", "decay.yaml", "--runs", "2", "--no-chart"]) == 0
    assert Path("out/decay_runs2_batch.nc").exists()


def test_what_varied_is_told(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two values of each of two parameters, three runs of each pair: 12 runs."""
    ranges = ["--over", "rate=1:2:2", "--over", "cycle=5 ms:10 ms:2"]
    assert main(["batch", "decay.yaml", *ranges, "--runs", "3", "--out", "b.nc"]) == 0
    told = "rate 1 to 2 1/s, 2 values", "cycle 5 to 10 ms, 2 values", "3 runs of each combination"
    assert "over " + ";  ".join(told) in capsys.readouterr().out


def test_a_frame_has_parameters_in_si(patch) -> None:
    crowd = hybrid.batch(patch, {"cycle": ["5 ms", "10 ms"]})
    assert crowd.varied == ["cycle 5 to 10 ms, 2 values"] and crowd.status_note == ""
    assert crowd.to_pandas()["cycle"].tolist() == [0.005, 0.01]
    assert crowd.dataset["cycle"].values.tolist() == [5.0, 10.0]  # of units ms
    swept = hybrid.sweep(patch, "cycle", ["5 ms", "10 ms"]).to_pandas()
    assert swept.reset_index()["cycle"].unique().tolist() == [0.005, 0.01]


def test_a_run_can_be_replayed_to_the_last_bit_from_its_file(patch, tmp_path: Path) -> None:
    """These periods, one of 40, are other doubles once divided by 1 ms and multiplied by it again."""
    drawn = np.random.default_rng(1).uniform(5e-3, 20e-3, 1000)
    values = drawn[drawn / 1e-3 * 1e-3 != drawn][:4]
    found = hybrid.batch(patch, {"cycle": values, "rate": 0.7}, seed=4)
    frame = found.to_pandas()
    assert frame.xs("mode", level="readout")["cycle"].tolist() == values.tolist()
    assert "cycle_si" not in frame
    write_dataset(found.dataset, tmp_path / "a.nc")
    with xr.open_dataset(tmp_path / "a.nc") as stored:
        stored.load()
    assert stored["cycle_si"].values.tolist() == values.tolist()
    assert [stored[name].attrs["units"] for name in ("cycle", "cycle_si")] == ["ms", "s"]
    own = stored.isel(run=2)
    given = {**json.loads(stored.attrs["parameters_si"]), "cycle": float(own["cycle_si"])}
    again = hybrid.run(patch, given, seed=int(own["seed"]), serial=int(own["serial"]))
    assert again.readouts["end"]["value"] == float(own["value_end"])


def test_a_parameter_must_not_hide_the_si_values_of_another() -> None:
    both = hybrid.parse_patch(PATCH.replace("parameters: {", "parameters: {rate_si: 1, "))
    with pytest.raises(hybrid.RunError, match="parameter rate_si cannot differ"):
        hybrid.batch(both, {"rate": [1.0, 2.0], "rate_si": [1.0, 2.0]})


def test_an_interrupted_batch_says_how_many_runs_are_done(result) -> None:
    cut = replace(result, points=result.points[:1], status="interrupted")
    assert cut.status_note == cut.dataset.attrs["status_note"] == "interrupted after 1 of 3 runs"


def test_the_table_and_the_chart(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["batch", "decay.yaml", "--runs", "3", "--out", "b.nc"]) == 0
    said = capsys.readouterr().out
    assert "3 of 3 runs" in said
    assert "mode omega rad/s" in said  # a decay has none, and the table says of how many runs
    assert Path("b.png").read_bytes().startswith(b"\x89PNG")
    assert main(["batch", "decay.yaml", "--over", "rate=1:2:4", "--out", "c.nc"]) == 0
    assert Path("c.png").exists()


def test_runs_at_two_values_are_summed_up_each_by_themselves(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The gains of two machines stay within 1e-3 of 2 and of 1; the mean of all, 1.5, is nobody's."""
    text = GAIN.replace("analog:", "parameters: {k: 2}\nanalog:").replace("{one: 2}", "{one: k}")
    Path("gain.yaml").write_text(text)
    options = ["--serials", "1:4", "--over", "k=1:2:2", "--out", "g.nc"]
    assert main(["batch", "gain.yaml", *options]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if "out V" in line]
    assert [row[2:5] for row in rows] == [["k", "1", "4"], ["k", "2", "4"]]
    found = hybrid.batch(
        hybrid.parse_patch(text), {"k": [1.0] * 4 + [2.0] * 4}, serial=[1, 2, 3, 4] * 2
    )
    groups = found.groups()
    assert [made for made, _ in groups] == [{"k": 1.0}, {"k": 2.0}]
    values = found.dataset["value_out"].values.reshape(2, 4)
    for (made, summary), own, row in zip(groups, values, rows, strict=True):
        assert summary["out"]["mean"] == np.mean(own) == pytest.approx(made["k"], rel=1e-3)
        assert summary["out"]["std"] == np.std(own, ddof=1) < 1e-3 * made["k"]
        assert float(row[5]) == pytest.approx(np.mean(own), rel=1e-8)
        assert f"k {made['k']:g}: out: {np.mean(own):.9g} +- " in repr(found)
    assert hybrid.batch(hybrid.parse_patch(text), {"k": [1.0, 2.0]}).groups() == []
    assert hybrid.batch(hybrid.parse_patch(text), serial=[1, 2]).groups() == []


def test_the_chart_over_two_values_shows_their_means_and_deviations() -> None:
    """Of 1, 2, 3 and 5, 5: means 2 and 5, standard deviations 1 and 0; at 9 a single run has none."""
    values = np.array([1.0, 2.0, 3.0, 5.0, 5.0, 7.0])
    across = Across("k", np.array([0.0, 0.0, 0.0, 1.0, 1.0, 9.0]), "V")
    figure = ensemble_chart("a", (), [Spread("top", values, "V")], across)
    texts = [text.get_text() for text in figure.texts]
    assert "k 0 V, 3 runs: mean 2, standard deviation 1" in texts
    assert "k 1 V, 2 runs: mean 5, standard deviation 0" in texts
    assert "k 9 V, 1 run: mean 7" in texts
    assert not any("6 runs" in text for text in texts)
    (bars,) = figure.axes[0].containers
    means, _, (lengths,) = bars
    assert means.get_ydata().tolist() == [2.0, 5.0, 7.0]
    assert [path[:, 1].tolist() for path in lengths.get_segments()] == [[1, 3], [5, 5], [7, 7]]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "needs --over, --serials or --runs"),
        (["--serials", "5"], "must be FIRST:LAST"),
        (["--serials", "5:4"], "must not be below FIRST"),
        (
            ["--serials", "1:1000000000000"],
            "asks for 1000000000000 machines; a batch makes 1000000",
        ),
        (["--serials", f"1:{'9' * 5000}"], "must be FIRST:LAST"),
        (["--serials", "1:2", "--serial", "3"], "either --serial or --serials"),
        (["--runs", "0"], "--runs is 0"),
        (["--over", "rate=1:2:2", "--over", "rate=1:2:2"], "swept twice"),
        (["--over", "rate=1:2:2", "--set", "rate=1"], "both set and swept"),
        (["--over", "rate=1:2:1000000", "--runs", "2"], "too many"),
        (["--runs", "2", "--out", "b.csv"], "ending in .nc"),
    ],
)
def test_slips_of_the_pen(
    folder: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    assert main(["batch", "decay.yaml", *options]) == 2
    assert said in capsys.readouterr().err
    assert sorted(p.name for p in folder.iterdir()) == ["decay.yaml"]
