"""The command from outside: JSON keys, exit codes, interruptions, closed and full outputs."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import hybrid
from hybrid.cli import VERBS, main
from hybrid.engine import kernel
from hybrid.terminal import print_json

# Nothing here takes so long, even where others have the processor.
HANGS_S = 600

PATCH = """
title: Loop
machine: nominal
parameters: {omega: 10 rad/s, cycle: 1 ms, tall: 0.1 rad}
analog:
  rate: {integrate: {torque: 1}, initial: 0 rad/s, full_scale: 10 rad/s}
  angle: {integrate: {rate: 1}, initial: tall, full_scale: 1 rad}
interface:
  sample: {adc: angle, bits: 14}
  torque: {dac: word, bits: 14, full_scale: 100 rad/s^2, initial: 0 rad/s^2}
digital:
  period: cycle
  program: {word: -omega**2 * sample}
run: {until: 2 s}
readouts:
  mode: {transient: angle}
  top: {maximum: rate}
"""

ANALOG = """
title: Lag
machine: ideal
analog: {x: {integrate: {x: -1}, initial: 1 V, full_scale: 1 V}}
run: {until: 1 s, every: 0.1 s}
"""


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("loop.yaml").write_text(PATCH)
    Path("analog.yaml").write_text(ANALOG)
    return tmp_path


def answer(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> Any:
    """The one JSON object that a command prints."""
    assert main([*arguments, "--json"]) == code
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    return json.loads(out)


# -- keys of the JSON answers, each as README.md documents it ---------------------------------------

ABOUT = {"patch", "title", "machine", "serial", "cycle_s", "time_scale", "parameters"}
ABOUT |= {"parameters_si", "on"}
RUN = {"seed", "cycles", "operations", "status", "status_note", "readouts", "overloads", "files"}
RUN |= {
    "until_s",
    "every_s",
    "engine",
    "engine_error",
    "coarse_by",
    "outside",
    "prediction",
    "prediction_note",
    "tasks",
}
MODE = {"omega", "omega_damped", "zeta", "omega_ideal", "zeta_ideal", "closed_form"}
CLOSED = {"equation", "omega", "omega_damped", "zeta", "note"}
ERRORS = {"omega_error", "omega_damped_error", "zeta_error"}
TRANSIENT = {"omega", "omega_damped", "zeta", "amplitude", "offset", "reason", "units", "note"}
TRANSIENT |= {"kind", "signal"}
OVERLOAD = {"signal", "time_s", "value", "worst_value", "worst_time_s", "instants", "units"}
OVERLOAD |= {"full_scale", "duration_s"}
SWEEP = (ABOUT - {"cycle_s", "time_scale"}) | {"over", "seed", "status", "points", "files"}
SWEEP |= {"status_note"}
POINT = {"value", "readouts", "modes", "status", "note", "overloads", "seed"}
BATCH = (ABOUT - {"cycle_s", "time_scale", "serial"}) | {
    "status",
    "summary",
    "groups",
    "runs",
    "files",
}
BATCH |= {"status_note"}
SUMMARY = {"runs", "mean", "std", "minimum", "maximum", "units"}
ONE_RUN = {"run", "parameters_si", "serial", "seed", "readouts", "status", "note", "overloads"}
CHECK = ABOUT | {
    "trial",
    "scaling",
    "rate_test",
    "delays",
    "parts",
    "potentiometers",
    "converters",
    "loops",
    "loops_found",
    "loops_in_program",
    "loops_complete",
    "tasks",
    "prediction",
    "events",
    "warnings",
    "shots",
    "words",
}
ROWS = {
    "scaling": {"signal", "kind", "full_scale", "units", "value", "value_mu", "rate_mu"}
    | {"largest", "used", "proposed", "remark"},
    "rate_test": {
        "integrator",
        "rate_mu",
        "first_mu",
        "gain_error",
        "drift_mu",
        "expected_mu",
        "shown_mu",
        "allowed_mu",
        "remark",
    },
    "parts": {"part", "count"},
    "potentiometers": {"component", "input", "coefficient_mu", "setting", "gain", "inverted"},
    "converters": {"converter", "kind", "converts", "bits", "range", "step", "units", "remark"},
    "loops": {"path", "lag_s", "sampled"},
    "tasks": {"task", "period_s", "place", "operations", "compute_s", "utilisation"}
    | {"cycles", "overruns", "waiting", "worst_response_s", "when", "samples", "sends"},
}
TRIAL = {"played_s", "of_s", "status", "note", "interval_s"}
LISTED = {"name", "title", "file"}
ANSWERS = {
    "run": ABOUT | RUN,
    "predict": ABOUT | {"modes", "notes", "max_damping_error", "max_cycle_s"},
    "sweep": SWEEP,
    "batch": BATCH,
    "check": CHECK,
    "draw": {"patch", "title", "files"},
    "list": {"patches"},
}


def test_the_answer_of_run(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(
        capsys, "run", "loop.yaml", "--seed", "5", "--serial", "3", "--set", "tall=0.9 rad"
    )
    assert found.keys() == ABOUT | RUN
    assert (found["machine"], found["serial"], found["seed"]) == ("nominal", 3, 5)
    assert (found["cycle_s"], found["cycles"], found["status"]) == (0.001, 2000, "complete")
    assert found["parameters"] == {"omega": "10 rad/s", "cycle": "1 ms", "tall": "0.9 rad"}
    assert found["readouts"]["mode"].keys() == TRANSIENT | ERRORS
    assert found["readouts"]["top"].keys() == {"value", "time_s", "kind", "signal", "units", "note"}
    assert [found["readouts"]["top"][key] for key in ("kind", "signal")] == ["maximum", "rate"]
    assert found["readouts"]["top"]["units"] == "rad/s"
    assert all(o.keys() == OVERLOAD for o in found["overloads"])
    assert "rate" in {o["signal"] for o in found["overloads"]}
    assert [m.keys() for m in found["prediction"]] == [MODE]
    assert found["prediction"][0]["closed_form"].keys() == CLOSED
    assert found["prediction_note"] == ""
    assert [row.keys() for row in found["tasks"]] == [ROWS["tasks"]]
    stem = "out/loop_tall=0.9rad_serial3_seed5"  # no file of another run is overwritten
    assert found["files"] == [f"{stem}.nc", f"{stem}.png"]
    assert all(Path(file).stat().st_size for file in found["files"])


def test_the_answer_of_run_without_a_digital_machine(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, "run", "analog.yaml", "--no-chart")
    assert found.keys() == ABOUT | RUN
    assert (found["cycle_s"], found["cycles"], found["files"]) == (None, 0, ["out/analog.nc"])


def test_the_answer_of_run_without_a_prediction(capsys: pytest.CaptureFixture[str]) -> None:
    Path("loop.yaml").write_text(PATCH.replace("* sample", "* sin(sample)"))
    found = answer(capsys, "run", "loop.yaml", "--no-chart", "--until", "0.1 s")
    assert found["prediction"] is None
    assert found["prediction_note"].startswith("no prediction: loop.yaml:13: word 'word'")
    assert found["cycles"] == 100


def test_the_answer_of_predict(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, "predict", "loop.yaml", "--set", "cycle=2 ms", "--machine", "ideal")
    assert found.keys() == ABOUT | {"modes", "notes"}
    assert (found["machine"], found["cycle_s"]) == ("ideal", 0.002)
    assert found["parameters"]["cycle"] == "2 ms"
    assert [m.keys() for m in found["modes"]] == [MODE]
    found = answer(capsys, "predict", "loop.yaml", "--max-damping-error", "0.01")
    assert found.keys() == ANSWERS["predict"]
    assert 0.001 < found["max_cycle_s"] < 0.0014


def test_the_answer_of_sweep(capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--over", "cycle=1 ms:2 ms:2", "--seed", "4", "--jobs", "1", "--out", "x/a.nc")
    found = answer(capsys, "sweep", "loop.yaml", *options)
    assert found.keys() == SWEEP
    assert found["parameters"] == {"omega": "10 rad/s", "tall": "0.1 rad"}
    assert (found["over"], found["seed"], found["serial"]) == ("cycle", 4, 1)
    assert [p["value"] for p in found["points"]] == [0.001, 0.002]
    for point in found["points"]:
        assert point.keys() == POINT
        assert point["readouts"]["mode"].keys() == TRANSIENT | ERRORS
        assert point["modes"][0].keys() == MODE
    assert found["files"] == ["x/a.nc", "x/a.png", "x/a_readouts.png"]
    assert all(Path(file).stat().st_size for file in found["files"])
    with xr.open_dataset("x/a.nc") as data:
        assert data["value_top"].attrs["units"] == "rad/s"


def test_without_a_verb_the_verbs_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    verbs = "run, predict, sweep, batch, check, draw, list, schema"
    assert capsys.readouterr().err == f"hybrid: name a verb: {verbs}; see hybrid --help\n"
    assert set(verbs.split(", ")) == set(VERBS)


def test_the_answer_of_batch(capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--runs", "2", "--over", "cycle=1 ms:2 ms:2", "--jobs", "1", "--out", "x/b.nc")
    found = answer(capsys, "batch", "loop.yaml", *options)
    assert found.keys() == BATCH
    assert found["parameters"] == {"omega": "10 rad/s", "tall": "0.1 rad"}
    assert found["status"] == "complete"
    assert {"mode omega", "mode zeta", "top"} <= found["summary"].keys()
    assert all(figure.keys() == SUMMARY for figure in found["summary"].values())
    assert [run["run"] for run in found["runs"]] == [0, 1, 2, 3]
    for run in found["runs"]:
        assert run.keys() == ONE_RUN
        assert run["parameters_si"].keys() == {"cycle"}
        assert run["readouts"]["mode"].keys() == TRANSIENT | ERRORS
    assert found["files"] == ["x/b.nc", "x/b.png"]
    assert all(Path(file).stat().st_size for file in found["files"])


def test_the_answer_of_draw(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, "draw", "loop.yaml")
    assert found == {"patch": "loop.yaml", "title": "Loop", "files": ["loop.svg"]}
    assert Path("loop.svg").stat().st_size


def test_the_answer_of_check(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, "check", "loop.yaml")
    assert found.keys() == CHECK
    for table, keys in ROWS.items():
        assert found[table], table
        assert all(row.keys() == keys for row in found[table]), table
    assert found["trial"].keys() == TRIAL
    assert found["converters"][0]["remark"] == "quantises and clips"


def test_the_answer_of_list(capsys: pytest.CaptureFixture[str]) -> None:
    found = answer(capsys, "list")
    assert found.keys() == {"patches"}
    assert [p["name"] for p in found["patches"]] == list(hybrid.shipped_patches())
    for patch in found["patches"]:
        assert patch.keys() == LISTED
        assert hybrid.read_patch(patch["file"]).title == patch["title"]


def section_of_the_readme(start: str, end: str) -> str:
    text = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
    return text[text.index(start) : text.index(end)]


def documented(section: str, pattern: str) -> dict[str, set[str]]:
    """What the first column of the section's tables has for each verb that the second one names."""
    found: dict[str, set[str]] = {verb: set() for verb in VERBS}
    for line in section.splitlines():
        cells = line.strip("| ").split(" | ")
        if not line.startswith("| `") or len(cells) < 3:
            continue
        verbs = set(cells[1].split(", "))
        if cells[1].startswith("all"):
            verbs = set(VERBS) - set(re.findall("but `([a-z]+)`", cells[1]))
        if "with a PATCH" in cells[1]:
            verbs -= {"list", "schema"}
        for verb in verbs & VERBS.keys():
            found[verb] |= set(re.findall(pattern, cells[0]))
    return found


def test_every_key_is_in_the_readme() -> None:
    assert ANSWERS.keys() == VERBS.keys() - {"schema"}
    section = section_of_the_readme("### JSON", "## In Python")
    found = documented(section, "`([a-z_]+)`")
    for verb, keys in ANSWERS.items():
        assert found[verb] == keys, (verb, sorted(found[verb] ^ keys))
    inner = MODE | CLOSED | ERRORS | TRANSIENT | OVERLOAD | POINT | SUMMARY | ONE_RUN | TRIAL
    inner |= LISTED | {"function", "word", "argument", "times", "action"}
    missing = inner.union(*ROWS.values()) - set(re.findall(r"`([a-z_]+)`", section))
    assert not missing, sorted(missing)


def test_the_readme_prints_what_its_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    text = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
    given, block = re.findall(r"`hybrid (run [^`]+)` prints\n\n```text\n(.*?)```", text, re.DOTALL)[
        0
    ]
    arguments = given.replace("patches/pitch_loop.yaml", "pitch_loop").split()
    assert main([*arguments, "--no-chart"]) == 0
    printed = capsys.readouterr().out
    lines = [line.split() for line in printed.splitlines() if line.strip()]
    for expected in (line.split() for line in block.splitlines()):
        found = next(line for line in lines if line[0] == expected[0])
        assert len(found) == len(expected)
        for said, now in zip(expected, found, strict=True):
            try:
                float(said)
            except ValueError:
                assert said == now
                continue
            # Another library of functions may move the last digit, and ten of it pass for that.
            places = len(said.partition("e")[0].partition(".")[2])
            unit = 10.0 ** -(places - int(said.partition("e")[2] or 0))
            slack = 10 if len(said.strip("-0.")) > 8 else 1
            assert abs(float(said) - float(now)) <= slack * unit, (expected[0], said, now)


@pytest.mark.parametrize("verb", VERBS)
def test_every_option_is_in_the_readme(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = documented(section_of_the_readme("## Commands", "### JSON"), "--[a-z-]+")
    assert main([verb, "--help"]) == 0
    options = set(re.findall("--[a-z-]+", capsys.readouterr().out)) - {"--help"}
    assert found[verb] == options, sorted(found[verb] ^ options)


def test_no_minus_zero_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    print_json(value=-0.0, rows=[-0.0, -1.5, float("nan")])
    assert capsys.readouterr().out == '{"value": 0.0, "rows": [0.0, -1.5, null]}\n'


# -- small things -----------------------------------------------------------------------------------


def test_the_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"hybrid {hybrid.__version__}\n"


def test_the_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    for name, file in hybrid.shipped_patches().items():
        assert re.search(rf"^{name} .*{re.escape(str(file))}", out, re.MULTILINE)


def test_the_first_run_says_that_it_compiles(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    monkeypatch.setattr(kernel, "is_compiled", lambda _: False)
    assert main(["run", "loop.yaml", "--no-chart"]) == 0
    assert capsys.readouterr().err == "hybrid: compiling the kernel, once after installation ...\n"
    asked = "from hybrid.engine import kernel; print(kernel.is_compiled())"
    fresh = {**os.environ, "NUMBA_CACHE_DIR": str(here / "cache")}
    command = [sys.executable, "-c", asked]
    done = subprocess.run(command, capture_output=True, timeout=HANGS_S, check=True, env=fresh)
    assert done.stdout == b"False\n"


def test_a_kernel_of_another_source_or_processor_is_none(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    cache = kernel.play._cache
    hybrid.run(hybrid.read_patch("pitch_loop"), readouts_only=True)
    assert kernel.is_compiled()
    files = cache._cache_file
    with monkeypatch.context() as edited:  # the source has changed since
        edited.setattr(files, "_source_stamp", (0.0, 1))
        assert list(Path(cache.cache_path).glob("kernel.play-*.nbi"))
        assert not kernel.is_compiled()
    with monkeypatch.context() as upgraded:
        upgraded.setattr(files, "_version", "0.1")
        assert not kernel.is_compiled()
    with monkeypatch.context() as moved:  # to a processor with other instructions
        moved.setattr(cache, "_index_key", lambda sig, codegen: (sig, "another", ()))
        assert not kernel.is_compiled()
    with monkeypatch.context() as emptied:  # the index is there, the code is not
        emptied.setattr(type(cache), "cache_path", str(tmp_path))
        assert not kernel.is_compiled()
    with monkeypatch.context() as told:  # NUMBA_DISABLE_JIT
        told.setattr(kernel, "play", kernel.play.py_func)
        assert kernel.is_compiled()


def test_a_run_is_replayed_bit_for_bit_from_its_file(
    capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    # Figures with more digits than anybody reads, an end that is not the patch's, a drawn machine.
    texts = {
        "omega": "10.123456789012345 rad/s",
        "cycle": "1.00000000123 ms",
        "tall": "0.03333333333333333 rad",
    }
    given = [part for name, text in texts.items() for part in ("--set", f"{name}={text}")]
    more = ["--seed", "11", "--serial", "4", "--until", "1.2345678901234 s", "--no-chart"]
    printed = answer(capsys, "run", "loop.yaml", *given, *more)
    (name,) = printed["files"]
    with xr.open_dataset(name) as file:
        stored = file.load()
    about = stored.attrs
    parameters = json.loads(about["parameters_si"])
    assert parameters == printed["parameters_si"]
    assert (about["until_s"], about["every_s"]) == (printed["until_s"], printed["every_s"])
    again = [
        "--until",
        f"{float(about['until_s'])!r} s",
        "--seed",
        str(about["seed"]),
        "--no-chart",
    ]
    again += ["--machine", about["machine"], "--serial", str(about["serial"]), "--out", "again"]
    again += [part for name, si in parameters.items() for part in ("--set", f"{name}={si!r}")]
    replayed = answer(capsys, "run", about["patch"], *again)
    assert replayed["readouts"] == printed["readouts"]
    (name,) = replayed["files"]
    with xr.open_dataset(name) as file:
        assert file.equals(stored)
        assert file.attrs == about
    # What a reader is shown is rounded, and would have been another run.
    assert float(printed["parameters"]["omega"].split()[0]) != parameters["omega"]


SHORT = (
    (
        "cycle=20 s",
        0,
        "before the first cycle of 20 s is over and the program's first results reach",
    ),
    ("cycle=2.1 s", 0, "before the first cycle of 2.1 s is over"),
    ("cycle=2 s", 1, ""),
    ("cycle=1 ms", 2000, ""),
)


@pytest.mark.parametrize(("given", "cycles", "says"), SHORT)
def test_a_run_shorter_than_a_cycle_says_so(
    given: str, cycles: int, says: str, capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    found = answer(capsys, "run", "loop.yaml", "--no-chart", "--set", given)
    assert (found["cycles"], found["status"]) == (cycles, "complete")
    assert says in found["status_note"]
    assert bool(says) == bool(found["status_note"])
    assert main(["run", "loop.yaml", "--no-chart", "--set", given]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert ("the run ends at 2 s, before" in printed) == bool(says)
    assert says in printed


def test_a_run_shorter_than_a_pipeline_says_so(here: Path) -> None:
    piped = PATCH.replace("period: cycle", "period: cycle\n  compute_time: 3 s")
    result = hybrid.run(hybrid.parse_patch(piped), {"cycle": 0.5})
    assert result.status_note == (
        "the run ends at 2 s, before the program's first results reach the DACs at 3 s"
    )


@pytest.mark.parametrize(
    "over", ["omega=0:10:3", "omega=10:0:3", "cycle=0.1_ms:-1_ms:5", "cycle=-1_ms:0.1_ms:5"]
)
def test_a_sweep_to_an_impossible_end_writes_nothing(
    over: str, capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    text = PATCH.replace("full_scale: 100 rad/s^2", "full_scale: omega**2, unit: rad/s^2")
    Path("loop.yaml").write_text(text)
    assert main(["sweep", "loop.yaml", "--over", over.replace("_", " ")]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert len(told.err.splitlines()) == 1
    assert not (here / "out").exists()


def test_a_point_that_fails_is_kept_and_changes_the_exit_code(
    capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    pole = PATCH.replace("tall: 0.1 rad", "tall: 0.1 rad, c: 1, d: 1/c")
    Path("loop.yaml").write_text(pole.replace("until: 2 s", "until: 0.1 s"))
    command = ["sweep", "loop.yaml", "--json", "--no-chart", "--over"]
    assert main([*command, "c=-1:1:3"]) == 1
    points = json.loads(capsys.readouterr().out)["points"]
    assert [p["status"] for p in points] == ["complete", "failed", "complete"]
    assert "'d'" in points[1]["note"]
    assert (here / "out" / "loop_over_c.nc").exists()
    # A tenth of a second shows no oscillation: no readout, but nothing has failed.
    assert main([*command, "c=1:2:2"]) == 0
    assert json.loads(capsys.readouterr().out)["points"][0]["readouts"]["mode"]["reason"]


@pytest.mark.parametrize("verb", ["run", "sweep"])
def test_a_folder_in_the_way(verb: str, capsys: pytest.CaptureFixture[str], here: Path) -> None:
    (here / "out" / "loop.nc").mkdir(parents=True)
    more = [] if verb == "run" else ["--over", "cycle=1:2:3", "--out", "out/loop.nc"]
    assert main([verb, "loop.yaml", *more]) == 2
    assert capsys.readouterr().err == (
        "hybrid: cannot write out/loop.nc: a folder of that name is in the way\n"
    )


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_is_read_only(capsys: pytest.CaptureFixture[str], here: Path) -> None:
    (here / "shut").mkdir(mode=0o500)
    assert main(["run", "loop.yaml", "--out", "shut"]) == 2
    assert "Permission denied" in capsys.readouterr().err


# -- as a process of its own ------------------------------------------------------------------------


def command(*arguments: str, module: str = "hybrid") -> list[str]:
    return [sys.executable, "-m", module, *arguments]


def hears_interrupts() -> None:
    """A test started in the background ignores Ctrl-C, and so would its children."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def in_a_terminal(called: list[str], **options: Any) -> subprocess.Popen[str]:
    """The command with all it starts, in a session of its own."""
    return subprocess.Popen(
        called,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
        preexec_fn=hears_interrupts,
        text=True,
        **options,
    )


def interrupt(process: subprocess.Popen[str], after_s: float) -> tuple[int, str, str]:
    """Wait, press Ctrl-C; exit code, output and errors."""
    time.sleep(after_s)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=HANGS_S)
    return process.returncode, out, err


# As `python -m hybrid` does, but the first import of the command's door is told to a pipe.
TELLING = """
import os, runpy, sys

def tell(event, told):
    if event == "import" and told[0] == "hybrid.loading":
        os.write(door, b"!")

door = int(sys.argv[1])
sys.addaudithook(tell)
del sys.argv[1]
runpy.run_module("hybrid", run_name="__main__", alter_sys=True)
"""


# The same once `argv[2]` results are there: chunks of a run, or points of a sweep.
TELLING_OF_RESULTS = """
import os, sys
from hybrid import __main__, points
from hybrid.engine.exact import ExactPlayer as Player

def telling(play, results):
    def told(*given):
        count = 0
        for done in play(*given):
            count = results(given, count)
            if count >= wanted:
                os.write(door, b"!")
            yield done
    return told

door, wanted = int(sys.argv[1]), int(sys.argv[2])
del sys.argv[1:3]
if sys.argv[1] == "run":
    Player.play = telling(Player.play, lambda given, count: count + 1)
else:
    points._playing = telling(points._playing, lambda given, count: len(given[-1]))
sys.exit(__main__.main())
"""


def interrupted(
    arguments: Sequence[str], told: Sequence[str], after_s: float = 0.0
) -> tuple[int, str, str]:
    """Exit code, output and errors of a command that all of a terminal's Ctrl-C reaches.

    It is pressed `after_s` after the command has told that it is so far, however long that takes.
    """
    reading, writing = os.pipe()
    called = [sys.executable, "-c", told[0], str(writing), *told[1:], *arguments]
    with in_a_terminal(called, pass_fds=(writing,)) as process:
        os.close(writing)
        with open(reading, "rb", buffering=0) as door:
            assert door.read(1) == b"!"  # nothing: it has ended before
            return interrupt(process, after_s)


def test_an_interrupted_run_keeps_its_record() -> None:
    arguments = ["run", "loop.yaml", "--until", "1e5 s", "--no-chart", "--json"]
    code, out, err = interrupted(arguments, (TELLING_OF_RESULTS, "2"))
    assert (code, "Traceback" in err) == (130, False), (out, err)
    kept = "out/loop_until=1e5s.nc"
    found = json.loads(out)
    assert found["status"] == "interrupted"
    assert 0 < found["cycles"] < 10**8
    with xr.open_dataset(kept) as record:
        assert record.attrs["status"] == "interrupted"
        assert record.attrs["status_note"].startswith("interrupted at ")
        assert record["angle"].sizes["time"] > 1
        assert float(record["time"][-1]) <= found["cycles"] * 0.001 + 1e-9
    assert [path.name for path in Path("out").iterdir()] == [Path(kept).name]


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_an_interrupted_sweep_keeps_its_points(jobs: str) -> None:
    """Two are played and timed before others are played at the same time."""
    over, count, wanted = "cycle=0.02 ms:0.03 ms:1000", 1000, 3
    options = ["--set", "tall=0.2 rad", "--jobs", jobs, "--no-chart", "--json", "--out", "a.nc"]
    Path("loop.yaml").write_text(PATCH.replace("until: 2 s", "until: 20 s, max_rows: 1000"))
    arguments = ["sweep", "loop.yaml", "--over", over, *options]
    code, out, err = interrupted(arguments, (TELLING_OF_RESULTS, str(wanted)))
    assert (code, "Traceback" in err) == (130, False), (out, err)
    found = json.loads(out)
    assert found["status"] == "interrupted"
    assert wanted <= len(found["points"]) < count
    with xr.open_dataset("a.nc") as data:
        assert data.attrs["status"] == "interrupted"
        assert data.sizes["cycle"] == len(found["points"])
        assert (data["status"] == "complete").all()
    assert not [path for path in Path().iterdir() if path.name.startswith(".hybrid")]


def test_an_interrupt_before_the_first_row_writes_nothing(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, here: Path
) -> None:
    """Ctrl-C as the engine begins: there is no row, so no record of none is filed."""

    def interrupted_at_once(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hybrid.engine.linear.Player.play", interrupted_at_once)
    for options in ((), ("--json",)):
        assert main(["run", "loop.yaml", "--no-chart", *options]) == 130
        told = capsys.readouterr()
        assert told.err == "hybrid: interrupted before there was a result; nothing written\n"
        assert told.out == "" and not list((here / "out").glob("*"))
    result = hybrid.run("loop.yaml")
    assert (result.status, len(result.time_s)) == ("interrupted", 0)


def test_the_door_loads_nothing_that_python_has_not(here: Path) -> None:
    """Until the door hears Ctrl-C, a traceback would answer it: it loads itself only, and `signal`."""
    script = "import os, signal, sys; had = set(sys.modules); import hybrid.__main__; "
    script += "print(*sorted(set(sys.modules) - had))"
    package = {**os.environ, "PYTHONPATH": str(Path(hybrid.__file__).parent.parent)}
    bare = [sys.executable, "-S", "-c", script]  # what an installation adds is not ours
    found = subprocess.run(bare, env=package, capture_output=True, text=True, check=True)
    ours = {"hybrid", "hybrid.__main__", "hybrid.version"}
    assert set(found.stdout.split()) - {"__future__"} == ours


@pytest.mark.parametrize("after_s", [0.0, 0.15, 0.3, 0.7])
def test_an_early_interrupt_is_quiet(after_s: float) -> None:
    code, out, err = interrupted(["run", "loop.yaml", "--until", "1e5 s"], (TELLING,), after_s)
    assert (code, "Traceback" in err) == (130, False), (out, err)


@pytest.mark.parametrize("verb", ["run", "check", "list"])
def test_a_reader_that_leaves(verb: str) -> None:
    arguments = {"run": ["run", "loop.yaml", "--no-chart"], "check": ["check", "loop.yaml"]}
    reading, writing = os.pipe()
    os.close(reading)
    called = command(*arguments.get(verb, [verb]))
    done = subprocess.run(
        called, stdout=writing, stderr=subprocess.PIPE, timeout=HANGS_S, check=False
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("module", ["hybrid", "hybrid.cli"])
def test_a_full_disk(module: str) -> None:
    called = command("run", "loop.yaml", "--no-chart", module=module)
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            called, stdout=full, stderr=subprocess.PIPE, timeout=HANGS_S, check=False
        )
        mute = subprocess.run(
            command("run", "nowhere.yaml"), stderr=full, timeout=HANGS_S, check=False
        )
    assert (done.returncode, mute.returncode) == (2, 2)
    assert done.stderr == b"hybrid: cannot write the answer: No space left on device\n"


@pytest.mark.parametrize(("blocks", "kept"), [(2, []), (140, ["out/short.nc"])])
def test_no_room_for_the_files(blocks: int, kept: list[str]) -> None:
    """Blocks of 512 or 1024 bytes: a record of 50 rows has few of them, its chart more than 100 kB."""
    short = PATCH.replace("until: 2 s}", "until: 0.5 s, every: 10 ms}")
    Path("short.yaml").write_text(short, encoding="utf-8")
    limited = ["sh", "-c", f'ulimit -f {blocks}; exec "$@"', "sh"]
    called = command("run", "short.yaml", "--json")
    done = subprocess.run([*limited, *called], capture_output=True, timeout=HANGS_S, check=False)
    assert done.returncode == 2
    lost = "out/short.png" if kept else "out/short.nc"
    assert done.stderr.decode().startswith(f"hybrid: cannot write {lost}: ")
    assert done.stderr.count(b"\n") == 1
    found = json.loads(done.stdout)
    assert found["files"] == kept and found["readouts"]["mode"]["omega"] > 0
    assert [str(file) for file in Path("out").iterdir()] == kept


@pytest.mark.parametrize("arguments", [["list"], ["check", "loop.yaml"], ["list", "--json"]])
def test_a_closed_output(arguments: list[str]) -> None:
    shell = ["sh", "-c", 'exec "$@" >&-', "sh", *command(*arguments)]
    done = subprocess.run(shell, stderr=subprocess.PIPE, timeout=HANGS_S, check=False)
    assert (done.returncode, done.stderr) == (0, b"")


def test_a_terminal_without_letters() -> None:
    Path("loop.yaml").write_text(PATCH.replace("title: Loop", "title: ω"), encoding="utf-8")
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii"}
    for arguments in (["run", "loop.yaml"], ["run", "ω.yaml"]):
        called = command(*arguments)
        done = subprocess.run(
            called, capture_output=True, timeout=HANGS_S, env=ascii_only, check=False
        )
        assert done.returncode == (0 if "loop.yaml" in arguments else 2), done.stderr
        assert b"Traceback" not in done.stderr
        assert (done.stdout + done.stderr).isascii()
