"""Every mistake of a user: one line with file, line and remedy, exit code 2, nothing written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from bad_patches import KEYS, LOOPS, NAMES, PATCH, SIGNALS, TIMES, UNITS, VALUES, Wrong

import hybrid
from hybrid.cli import main

COMPILING = "hybrid: compiling the kernel, once after installation ...\n"


def complaint(
    capsys: pytest.CaptureFixture[str], folder: Path, *arguments: str, verb: str = "check"
) -> str:
    """The one line that a command gives; checks the exit code and that nothing is written."""
    before = sorted(folder.rglob("*"))
    code = main([verb, *arguments])
    out, err = capsys.readouterr()
    err = err.removeprefix(COMPILING)
    assert code == 2, (code, out, err)
    assert out == ""
    assert err.startswith("hybrid: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert len(err) < 1500
    assert sorted(folder.rglob("*")) == before
    return err.removeprefix("hybrid: ").rstrip("\n")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_patch_itself_is_right(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("loop.yaml").write_text(PATCH)
    hybrid.run("loop.yaml")  # only who compiles has something to say
    assert main(["check", "loop.yaml"]) == 0
    assert capsys.readouterr().err == ""


def _cases() -> list[object]:
    tables = {"key": KEYS, "signal": SIGNALS, "unit": UNITS, "name": NAMES}
    tables |= {"value": VALUES, "time": TIMES, "loop": LOOPS}
    return [pytest.param(w, id=f"{t}: {w.name}") for t, ws in tables.items() for w in ws]


@pytest.mark.parametrize("wrong", _cases())
def test_a_wrong_patch(wrong: Wrong, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("wrong.yaml").write_text(wrong.text, encoding="utf-8")
    message = complaint(capsys, here, "wrong.yaml")
    print(message)
    for part in wrong.says:
        assert part in message
    assert message.startswith(f"wrong.yaml:{wrong.line}: ")


# -- files ------------------------------------------------------------------------------------------

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n"
    for a, b in zip("abcdefghijkl", "bcdefghijklm", strict=True)
)

FILES: dict[str, tuple[bytes | str, int, tuple[str, ...]]] = {
    "empty": ("", 0, ("empty", "title:")),
    "white": ("\n \n\n", 0, ("empty", "title:")),
    "comment": ("# nothing\n", 0, ("empty", "title:")),
    "null": ("~\n", 0, ("empty", "title:")),
    "list": ("- title\n- run\n", 1, ("mapping", "a list")),
    "text": ("# a\ntitle\n", 2, ("mapping", "'title'")),
    "tab": ("title: a\nrun:\n\tuntil: 1 s\n", 3, ("not valid YAML", "spaces", "tabs")),
    "indentation": ("title: a\n  run: b\n", 2, ("not valid YAML", "quotes", "indentation")),
    "colon": ("title: a: b\n", 1, ("not valid YAML", "quotes")),
    "quote": ("title: 'a\nrun: b\n", 2, ("not valid YAML", "line 1", "close the quotes")),
    "brace": ("title: a\nrun: {until: 1 s\n", 2, ("not valid YAML", "{key: value,")),
    "at sign": ("title: @a\n", 1, ("not valid YAML", "quotes")),
    "two documents": ("title: a\n---\ntitle: b\n", 2, ("second document", "remove the ---")),
    "control": ("title: a\nrun: \x07\n", 2, ("U+0007", "UTF-8")),
    "escape": ("title: \x1b[31m\n", 1, ("U+001B", "UTF-8")),
    "nul": ("title: a\nrun: \0\n", 2, ("U+0000", "UTF-8")),
    "non-character": ("title: \ufffe\n", 1, ("U+FFFE", "UTF-8")),
    "anchor": ("title: &a b\n", 1, ("anchors", "write it out")),
    "alias": ("title: a\nrun: *b\n", 2, ("aliases", "parameters:")),
    "anchored key": ("title: a\n&b run: c\n", 2, ("anchors", "write it out")),
    "merge": ("title: a\nrun:\n  <<: *b\n", 3, ("aliases", "write it out")),
    "laughs": ("title: a\n" + LAUGHS, 2, ("anchors", "write it out")),
    "tag": ("title: a\nrun: !!float 3\n", 2, ("tags", "float", "plain value")),
    "object": ("title: !!python/object/apply:os.system [ls]\n", 1, ("tags", "plain value")),
    "tagged key": ("!!str title: a\n", 1, ("tags", "plain value")),
    "nested lists": ("title: a\nrun: " + "[" * 100_000, 2, ("12 levels",)),
    "nested mappings": ("title: a\nrun: " + "{a: " * 100_000, 2, ("12 levels",)),
    "nested blocks": ("title: a\nrun:\n" + "".join(f"{' ' * n}- \n" for n in range(1, 99)), 14, ("12",)),
    "5 MB": ("title: a\n" * 600_000, 0, ("too long", "1000000")),
    "UTF-16": ("title: a\n".encode("utf-16"), 0, ("UTF-16", "UTF-8")),
    "UTF-16, no mark": ("title: a\n".encode("utf-16-le"), 1, ("U+0000", "UTF-8")),
    "Latin-1": ("title: a\nrun: größe\n".encode("latin-1"), 2, ("UTF-8",)),
    "binary": (bytes(range(256)) * 10, 2, ("UTF-8",)),
    "parameters": (
        "title: a\nparameters:\n" + "".join(f"  p{n}: 1\n" for n in range(5001)) + "run: {}\n",
        3, ("5001 entries", "5000"),
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "line", "says"), FILES.values(), ids=FILES)
def test_a_wrong_file(
    content: bytes | str,
    line: int,
    says: tuple[str, ...],
    here: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    raw = content if isinstance(content, bytes) else content.encode("utf-8")
    Path("wrong.yaml").write_bytes(raw)
    message = complaint(capsys, here, "wrong.yaml")
    for part in says:
        assert part in message
    assert message.startswith(f"wrong.yaml:{line}: " if line else "wrong.yaml: ")


NO_FILES = {
    "missing": ("missing.yaml", "No such file"),
    "directory": (".", "Is a directory"),
    "below a file": ("loop.yaml/patch.yaml", "Not a directory"),
    "long name": ("n" * 300, "File name too long"),
    "unreadable": ("/proc/self/mem", "cannot be read"),
    "endless": ("/dev/zero", "at most 1000000 bytes"),
    "NUL": ("a\0b", "no file has such a name"),
    "empty name": ("", "name of the patch is empty"),
    "not shipped": ("pitch_lop", "No such file"),
}


@pytest.mark.parametrize(("name", "says"), NO_FILES.values(), ids=NO_FILES)
def test_no_file(name: str, says: str, here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("loop.yaml").write_text(PATCH)
    assert says in complaint(capsys, here, name, verb="run")


# -- options ----------------------------------------------------------------------------------------

OPTIONS: dict[str, tuple[str, ...]] = {
    # arguments, separated by spaces; what the message says
    "set, no value": ("check --set gain", "NAME=VALUE"),
    "set, empty value": ("check --set gain=", "NAME=VALUE"),
    "set, no name": ("check --set =3", "NAME=VALUE"),
    "set, unknown": ("check --set gian=3", "loop.yaml: ", "no parameter 'gian'", "'gain'"),
    "set, twice": ("check --set gain=3 --set gain=4", "gain is given twice"),
    "set, unit": ("check --set cycle=1_V", "'1 V'", "a time, such as 1 ms"),
    "set, radians for a time": ("check --set cycle=1_rad", "'1 rad'", "a time"),
    "set, unit for a pure number": ("check --set gain=1_ms", "'1 ms'", "pure number"),
    "set, Hz for rad/s": ("check --set omega=2_Hz", "'2 Hz'", "rad/s"),
    "set, name": ("check --set gain=omega", "loop.yaml:6: gain cannot be 'omega': names", "pure"),
    "set, text": ("check --set cycle=abc", "loop.yaml:5: cycle cannot be 'abc': names", "a time"),
    "set, code": (
        "check --set gain=__import__('os')",
        "loop.yaml:6: gain cannot be",
        "pure number",
    ),
    "set, nan": ("check --set cycle=nan", "loop.yaml:5: cycle cannot be 'nan': 'nan' is", "1 ms"),
    "set, inf": ("draw --set cycle=inf", "loop.yaml:5: cycle cannot be 'inf': 'inf' is", "1 ms"),
    "set, infinite": ("check --set gain=1e999", "loop.yaml:6: gain cannot be '1e999'", "too large"),
    "set, volts": (
        "predict --set cycle=1_V",
        "loop.yaml:5: cycle cannot be '1 V': its unit",
        "1 ms",
    ),
    "set, degrees": ("check --set cycle=1°", "loop.yaml:5: cycle cannot be '1°'", "1 ms"),
    "set, hexadecimal": ("check --set cycle=0x10", "'0x10': numbers are decimal", "1 ms"),
    "set, underscore": ("check --set=cycle=1__000", "'1__000': digits are written without _"),
    "set, other digits": ("check --set cycle=１", "'１': digits are 0 to 9", "1 ms"),
    "set, rad/s in Hz": ("check --set omega=2_Hz", "loop.yaml:4: omega cannot be", "2*pi rad/s"),
    "set, zero period": ("check --set cycle=0", "loop.yaml:16: ", "greater than 0"),
    "set, negative period": (
        "check --set cycle=-1_ms",
        "period of digital is cycle = -0.001 s; it must be greater than 0",
    ),
    "set, comma": ("check --set cycle=1,5_ms", "not a comma: 1.5"),
    "set, two slashes": ("check --set omega=10_rad//s", "cannot read the unit 'rad//s'"),
    "set, tiny period": ("check --set cycle=1e-30", "loop.yaml:16: ", "femtosecond"),
    "set, short period": ("check --set cycle=1_fs", "loop.yaml:19: ", "1e+11"),
    "set, overload": ("check --set omega=1e200", "loop.yaml:18: ", "no finite value"),
    "machine": ("check --machine nominel", "'nominel'", "did you mean 'nominal'"),
    "machine, run": ("run --machine perfect", "'perfect'", "ideal, lags, nominal"),
    "serial": ("check --serial -1", "serial is -1", "2^63"),
    "serial, text": ("check --serial x", "--serial", "'x'", "--help"),
    "serial, large": ("check --serial 9223372036854775808", "serial is", "2^63"),
    "seed": ("run --seed -1", "seed is -1", "2^63"),
    "seed, text": ("run --seed x", "--seed", "'x'", "--help"),
    "seed, fraction": ("run --seed 1.5", "--seed", "'1.5'", "--help"),
    "seed, large": ("run --seed 9223372036854775808", "seed is", "2^63"),
    "until, unit": ("run --until 3_V", "--until", "'3 V'", "20 s"),
    "until, zero": ("run --until 0", "--until is 0", "greater than 0"),
    "until, negative": ("run --until=-1", "--until is -1 s", "greater than 0"),
    "until, dash": ("run --until -1s", "--until needs a value", "--until=-"),
    "until, nan": ("run --until nan", "'nan' is not a finite number", "20 s"),
    "until, arithmetic": ("run --until 2*pi/omega", "names are not known here", "20 s"),
    "until, other digits": ("run --until ٣", "--until cannot be '٣': digits are 0 to 9", "20 s"),
    "until, hexadecimal": ("run --until 0x10", "--until cannot be '0x10': numbers are decimal"),
    "xy, nan": ("run --xy rate:angle:nan", "TIME cannot be 'nan'", "20 s"),
    "out, empty": ("run --out ", "--out is empty"),
    "sweep, out empty": ("sweep --over gain=1:2:3 --out ", "--out is empty"),
    "seed, underscore": ("run --seed=1__0", "'1__0'", "--help"),
    "serial, other digits": ("check --serial ٣", "'٣'", "--help"),
    "over, twice": ("sweep --over gain=1:2:3 --over gain=1:2:4", "--over is given twice"),
    "abbreviated": ("check --mach ideal", "--mach", "--help"),
    "until, tiny": ("run --until 1e-30", "--until", "femtosecond"),
    "until, far": ("run --until 1e300", "--until", "1e+15"),
    "until, many cycles": ("run --until 1e10", "1e+13", "1e+11"),
    "until, parameter": ("run --until cycle", "--until", "'cycle'"),
    "until, empty": ("run --until ", "--until", "nothing is given", "20 s"),
    "out, file in the way": ("run --out loop.yaml", "--out loop.yaml is a file, not a folder"),
    "out, below a file": ("run --out loop.yaml/out", "cannot write", "Not a directory"),
    "out, no such place": ("run --out /proc/nonexistent/out", "cannot write"),
    "sweep without over": ("sweep", "--over", "--help"),
    "over, no range": ("sweep --over cycle", "NAME=START:STOP:COUNT"),
    "over, no name": ("sweep --over =1:2:3", "NAME=START:STOP:COUNT[:lin]", ":log"),
    "over, two parts": ("sweep --over cycle=1:2", "START:STOP:COUNT", ":lin", ":log"),
    "over, nan": ("sweep --over cycle=nan:1:3", "loop.yaml:5: cycle cannot be 'nan'", "a time"),
    "over, inf": ("batch --over cycle=1_ms:inf:3", "loop.yaml:5: cycle cannot be 'inf'", "a time"),
    "over, nothing": ("sweep --over cycle=:1:3", "loop.yaml:5: cycle cannot be ''", "a time"),
    "over, count in other digits": ("sweep --over cycle=1_ms:2_ms:３", "COUNT is '３'"),
    "over, five parts": ("sweep --over cycle=1:2:3:log:5", "START:STOP:COUNT"),
    "over, linn": ("sweep --over cycle=1:2:3:linn", ":log"),
    "over, count 0": ("sweep --over cycle=1_ms:2_ms:0", "COUNT is '0'", "1 to 1000000"),
    "over, count negative": ("sweep --over cycle=1_ms:2_ms:-1", "COUNT is '-1'"),
    "over, count fraction": ("sweep --over cycle=1_ms:2_ms:2.5", "COUNT is '2.5'"),
    "over, count large": ("sweep --over cycle=1_ms:2_ms:1000001", "COUNT", "1000000"),
    "over, count endless": (f"sweep --over cycle=1_ms:2_ms:{'9' * 5000}", "COUNT", "1000000"),
    "over, log of zero": ("sweep --over cycle=0:2_ms:3:log", "above 0"),
    "over, log of negative": ("sweep --over cycle=-1:2_ms:3:log", "above 0"),
    "over, unit": ("sweep --over cycle=1_V:2_V:3", "'1 V'", "a time"),
    "over, unknown": ("sweep --over cicle=1:2:3", "'cicle'", "'cycle'"),
    "over, zero period": ("sweep --over cycle=0:1_ms:3", "loop.yaml:16: ", "greater than 0"),
    "over, too wide": ("sweep --over gain=-1e308:1e308:3", "too wide", ":log"),
    "over, also set": ("sweep --over gain=1:2:3 --set gain=3", "both set and swept"),
    "sweep, machine": ("sweep --over gain=1:2:3 --machine x", "'x'", "ideal"),
    "sweep, seed": ("sweep --over gain=1:2:3 --seed -1", "seed is -1"),
    "sweep, jobs 0": ("sweep --over gain=1:2:3 --jobs 0", "jobs is 0", "1 to 1000"),
    "sweep, jobs": ("sweep --over gain=1:2:3 --jobs 100000", "jobs is 100000", "1 to 1000"),
    "sweep, out": ("sweep --over gain=1:2:3 --out a.csv", "a.csv", ".nc"),
    "sweep, out below a file": ("sweep --over gain=1:2:3 --out loop.yaml/a.nc", "cannot write"),
    "predict, 0": ("predict --max-damping-error 0", "above 0"),
    "predict, negative": ("predict --max-damping-error=-1", "above 0"),
    "predict, nan": ("predict --max-damping-error nan", "above 0"),
    "predict, inf": ("predict --max-damping-error inf", "above 0"),
    "predict, text": ("predict --max-damping-error x", "'x'", "such as 0.01", "--help"),
    "predict, underscore": ("predict --max-damping-error=1__0", "'1__0' is no number"),
    "predict, other digits": ("predict --max-damping-error １", "'１' is no number"),
    "predict, hexadecimal": ("predict --max-damping-error 0x1", "'0x1' is no number"),
    "predict, empty": ("predict --max-damping-error ", "'' is no number"),
    "unknown option": ("check --sett gain=3", "--sett", "--help"),
}


@pytest.mark.parametrize("case", OPTIONS.values(), ids=OPTIONS)
def test_a_wrong_option(
    case: tuple[str, ...], here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    verb, *options = (word.replace("_", " ") for word in case[0].split(" "))
    if "__" in case[0]:
        options = case[0].split(" ")[1:]
    Path("loop.yaml").write_text(PATCH)
    message = complaint(capsys, here, "loop.yaml", *options, verb=verb)
    for part in case[1:]:
        assert part in message


COMMANDS = {
    "no verb": ((), "name a verb: run, predict"),
    "unknown verb": (("rnu", "pitch_loop"), "'rnu'"),
    "no patch": (("run",), "PATCH"),
    "no patch, check": (("check",), "PATCH"),
    "two patches": (("run", "a", "b"), "'b' is too much for hybrid run; see hybrid run --help"),
    "option of another verb": (
        ("run", "a", "--jobs", "3"),
        "hybrid run has no option --jobs; it is one of sweep and batch; see hybrid run --help",
    ),
    "option of none": (("check", "a", "--y=3"), "has no option --y; see hybrid check --help"),
    "new line in an option": (("run", "a", "--x\ny"), "--x y"),
    "new line in a name": (("run", "a\nb"), "a b: cannot be read"),
    "escape in a name": (("run", "a\x1bb"), "a b: cannot be read"),
}


@pytest.mark.parametrize(("arguments", "says"), COMMANDS.values(), ids=COMMANDS)
def test_a_wrong_command(
    arguments: tuple[str, ...], says: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(list(arguments)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("hybrid: ")
    assert err.count("\n") == 1
    assert says in err
    assert sorted(here.iterdir()) == []


# -- as a process of its own ------------------------------------------------------------------------

LIMITED = (
    "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (10**9, 10**9)); "
    "from hybrid.cli import main; sys.exit(main(sys.argv[1:]))"
)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("check", "wrong.yaml"), "wrong.yaml:2: "),
        (("check", "laughs.yaml"), "laughs.yaml:2: "),
        (("check", "long.yaml"), "long.yaml:19: "),
        (("run", "/dev/zero"), "/dev/zero: "),
        (("run", "loop.yaml", "--set", "cycle=0"), "loop.yaml:16: "),
        (("run", b"no\xffname.yaml"), "no?name.yaml: "),
        (("sweep", "loop.yaml", "--over", "cycle=0:1:0"), "COUNT"),
    ],
    ids=str,
)
def test_a_process(arguments: tuple[str | bytes, ...], says: str, here: Path) -> None:
    """One line and exit code 2 also from outside, within a gigabyte."""
    Path("loop.yaml").write_text(PATCH)
    Path("wrong.yaml").write_text(PATCH.replace("machine: ideal", "machine: idaal"))
    Path("laughs.yaml").write_text("title: a\n" + LAUGHS)
    text = PATCH.replace("until: 0.1 s", "until: 1e6 s, max_rows: 100000000")
    Path("long.yaml").write_text(text)  # 10^8 rows at a time
    before = sorted(here.rglob("*"))
    command = [sys.executable, "-c", LIMITED, *arguments]
    done = subprocess.run(command, capture_output=True, timeout=600, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stdout == b""
    told = done.stderr.decode().removeprefix(COMPILING)
    assert told.startswith(f"hybrid: {says}")
    assert told.count("\n") == 1
    assert sorted(here.rglob("*")) == before


# -- odd but right ----------------------------------------------------------------------------------

ODD = {
    "one row": ("until: 0.1 s", "until: 0.1 ms"),
    "long interval": ("until: 0.1 s", "until: 0.1 s, every: 1 s"),
    "late step": ("  wind: {sine: 0.1 V, omega: 3 rad/s,", "  wind: {step: 1 V, at: 1e14 s,"),
    "deep pipeline": ("  program:", "  compute_time: 0.2 s\n  program:"),
    "least figures": ("full_scale: 1 V}", "full_scale: 1 V, tau: 1e-15 s, noise: 1}"),
}


@pytest.mark.parametrize("change", ODD.values(), ids=ODD)
def test_odd_but_right(change: tuple[str, str], recwarn: pytest.WarningsRecorder) -> None:
    assert change[0] in PATCH
    patch = hybrid.parse_patch(PATCH.replace(*change))
    for machine in ("ideal", "nominal"):
        assert hybrid.run(patch, machine=machine).status == "complete"
    assert not recwarn.list


@pytest.mark.parametrize("rate", ["1e4", "1e9", "1e14"])
def test_a_patch_that_runs_away(rate: str, recwarn: pytest.WarningsRecorder) -> None:
    """Growth beyond all numbers within one cycle stops the run and is not a warning of numpy's."""
    text = PATCH.replace("{torque: 1}", f"{{torque: 1, rate: {rate}}}")
    patch = hybrid.parse_patch(text.replace("0 rad/s,", "1 rad/s,"))
    for machine in ("ideal", "nominal"):
        run = hybrid.run(patch, machine=machine)
        assert run.status == "stopped"
        assert "unstable" in run.status_note
        try:
            hybrid.predict(patch, machine=machine)
        except hybrid.RunError as error:
            assert "runs away" in str(error)
    assert not recwarn.list


def test_a_title_is_not_a_formula(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    title = r"title: 'a $x^$ \frac{ %s {0} [bold] [/x] 中文'"
    Path("odd.yaml").write_text(PATCH.replace("title: Loop", title), encoding="utf-8")
    assert main(["run", "odd.yaml"]) == 0
    out, err = capsys.readouterr()
    assert err in ("", COMPILING)
    assert r"a $x^$ \frac{ %s {0} [bold] [/x]" in out
    assert sorted(path.name for path in Path("out").iterdir()) == ["odd.nc", "odd.png"]


def test_a_range_may_run_downwards(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("loop.yaml").write_text(PATCH)
    options = ["--over", "cycle=2 ms:1 ms:2", "--no-chart", "--out", "a/b.nc"]
    assert main(["sweep", "loop.yaml", *options]) == 0
    assert capsys.readouterr().err in ("", COMPILING)
    assert Path("a/b.nc").exists()


def test_letters_that_the_terminal_lacks(here: Path) -> None:
    Path("odd.yaml").write_text(PATCH.replace("title: Loop", "title: ω"), encoding="utf-8")
    command = [sys.executable, "-m", "hybrid.cli", "check", "odd.yaml"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, capture_output=True, timeout=600, check=False, env=environment)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.startswith(b"? on machine ideal")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk(here: Path) -> None:
    with Path("/dev/full").open("wb") as full:
        command = [sys.executable, "-m", "hybrid.cli", "schema"]
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, timeout=600, check=False
        )
    assert done.returncode == 2
    assert done.stderr == b"hybrid: cannot write the answer: No space left on device\n"
