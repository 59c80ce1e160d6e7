"""Benches run and hold: each by its own verdict, the notebook by the figures of its conclusion."""

import importlib
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hybrid import theory

BENCHES = Path(__file__).parent.parent / "benches"
NOTEBOOK = BENCHES / "damping_against_T.ipynb"
SCRIPTS = sorted(path for path in BENCHES.glob("*.py") if path.name != "bench.py")
DRAWING = [path for path in SCRIPTS if "draws=True" in path.read_text(encoding="utf-8")]


# -- benches as programs ----------------------------------------------------------------------------


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_bench_passes_and_prints_one_json_object(script, tmp_path):
    pytest.importorskip("control", reason="benches need the extra 'bench'")
    out = ["--out", "chart.png"] if script in DRAWING else []
    command = [sys.executable, str(script), "--quick", "--json", *out]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    facts = json.loads(done.stdout)
    assert facts["bench"] == script.stem
    if "skipped" in facts:
        pytest.skip(facts["skipped"])
    assert facts["quick"] is True
    assert facts["passed"] is True
    tables = [value for value in facts.values() if isinstance(value, list)]
    assert tables and all(tables)
    flags = [
        row[key]
        for table in tables
        for row in table
        for key in ("passed", "agrees", "pass")
        if key in row
    ]
    assert flags and all(flag is True for flag in flags)
    assert [path.name for path in tmp_path.iterdir()] == out[
        1:
    ]  # a bench leaves nothing else behind
    if out:
        width, height = Image.open(tmp_path / "chart.png").size
        assert width > height > 400


@pytest.mark.parametrize("script", DRAWING, ids=lambda path: path.stem)
@pytest.mark.parametrize(
    ("out", "told"),
    [("chart.svg", "must end in .png, not 'chart.svg'"), ("away/chart.png", "no folder 'away'")],
)
def test_a_chart_that_cannot_be_written_is_told_before_anything_is_computed(
    script, out, told, tmp_path, monkeypatch, capsys
):
    monkeypatch.syspath_prepend(str(BENCHES))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [script.name, "--out", out])
    bench = importlib.import_module(script.stem)
    with pytest.raises(SystemExit) as left:
        bench.main()
    printed = capsys.readouterr()
    assert left.value.code == 2 and not printed.out
    assert printed.err.splitlines()[-1].endswith(f"{told}")


def test_every_bench_that_the_readme_draws_with_is_tested():
    readme = (BENCHES.parent / "README.md").read_text(encoding="utf-8")
    drawn = re.findall(r"benches/(\w+)\.py --out (\S+)", readme)
    assert drawn == [(path.stem, f"{path.stem}.png") for path in DRAWING]


# -- goals of the speed bench -----------------------------------------------------------------------


@pytest.fixture
def speed_bench(monkeypatch):
    """The module benches/speed.py."""
    pytest.importorskip("control", reason="benches need the extra 'bench'")
    monkeypatch.syspath_prepend(str(BENCHES))
    return importlib.import_module("speed")


def test_every_goal_is_judged_in_its_row(speed_bench):
    def row(hybrid, goal, over_control=None, goal_over_control=None):
        figures = {"over_control": over_control, "goal_over_control": goal_over_control}
        return {"hybrid": hybrid, "goal": goal, **figures}

    runs = [row(2e7, 1e7, 49.0, 50.0), row(1e6, 3e6), row(1e6, None, 51.0, 50.0)]
    whole = [{"hybrid": 2.0, "goal": 3.0}, {"hybrid": 2.0, "goal": 2.0}]
    goals = speed_bench.judge(runs, whole, quick=False)
    assert (goals.count("yes"), goals.count("no")) == (3, 3)
    assert [r["meets_goal_over_control"] for r in runs] == ["no", "-", "yes"]
    assert [r["meets_goal"] for r in [*runs, *whole]] == ["yes", "no", "-", "yes", "no"]
    assert speed_bench.judge(runs, whole, quick=True) == []
    headings = speed_bench.runs_table(runs).formats
    assert "meets_goal_over_control" in {key for key, _ in headings.values()}


def test_a_row_beside_python_control_has_the_goal_of_fifty_times(speed_bench):
    patch = speed_bench.hybrid.parse_patch(speed_bench.FIVE_ELEMENTS)
    rows = [
        speed_bench.run_row(patch, case, case, 200, None, 100, 1) for case in ("lags", "nominal")
    ]
    assert [r["goal_over_control"] for r in rows] == [50.0, None]


def test_the_command_is_started_as_users_start_it(speed_bench, monkeypatch):
    started = []
    monkeypatch.setattr(speed_bench.subprocess, "run", lambda given, **_: started.append(given))
    speed_bench.command_row(speed_bench.Options(quick=True, json=True))
    assert started[0][:4] == [sys.executable, "-m", "hybrid", "run"]


# -- a bench must be able to fail -------------------------------------------------------------------


@pytest.fixture
def coupling_bench(monkeypatch):
    """The module benches/coupling_predictions.py."""
    monkeypatch.syspath_prepend(str(BENCHES))
    return importlib.import_module("coupling_predictions")


@pytest.fixture
def lead_rows(coupling_bench):
    """Rows of Eq. 2.2 at three values of omega_p T."""
    case = next(c for c in coupling_bench.CASES if c.equation == "2.2")
    return [row for x in (0.01, 0.03, 0.1) for row in coupling_bench.rows_of(case, x)]


def test_bounds_refuse_figures_that_are_off(coupling_bench, lead_rows):
    row = lead_rows[-1]
    assert (row["quantity"], row["x"]) == ("zeta", 0.1)
    assert coupling_bench.within_bounds(row)
    assert not coupling_bench.within_bounds({**row, "measured_error": 2e-9})
    assert not coupling_bench.within_bounds({**row, "exact_error": 1e-10})
    # The next term with the wrong sign, or left out.
    assert not coupling_bench.within_bounds({**row, "beside_next_term": 2 * row["next_term"]})
    assert not coupling_bench.within_bounds({**row, "beside_next_term": row["next_term"]})


def test_the_order_of_the_lead_is_told_from_the_papers(coupling_bench, lead_rows):
    assert all(order["passed"] for order in coupling_bench.damping_orders(lead_rows))
    paper = [
        {**row, **dict.fromkeys(("root", "exact", "measured"), -(row["x"] ** 4))}
        if row["quantity"] == "zeta"
        else row
        for row in lead_rows
    ]
    damping, growth = coupling_bench.damping_orders(paper)
    assert damping["measured"] == pytest.approx(4, abs=1e-9)
    assert not damping["passed"] and not growth["passed"]


def test_attitudes_are_compared_in_every_row(monkeypatch):
    """Turned by 2 deg about x in the middle row alone; the quaternions may have any length and sign."""
    monkeypatch.syspath_prepend(str(BENCHES))
    figures = importlib.import_module("flights.figures")
    half = math.radians(1.0)
    still = {"s": [1.0, 1.0, 1.0], "x": [0.0] * 3, "y": [0.0] * 3, "z": [0.0] * 3}
    turned = {**still, "s": [2.0, -math.cos(half), 1.0], "x": [0.0, -math.sin(half), 0.0]}
    one, other = (
        lambda name, of=of: np.array(of[name.removeprefix("attitude.")]) for of in (still, turned)
    )
    assert figures.apart(one, other, "attitude_deg") == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize(("passed", "code", "word"), [(True, 0, "PASS"), (False, 1, "FAIL")])
def test_verdict_and_exit_code(monkeypatch, capsys, passed, code, word):
    monkeypatch.syspath_prepend(str(BENCHES))
    bench = importlib.import_module("bench")
    table = bench.Table(
        "rows",
        "A title",
        {"x": ("x", ".2f"), "none": ("none", ""), "": ("passed", "")},
        [{"x": 0.5, "none": None, "passed": passed}],
    )
    assert bench.finish("some/name.py", bench.Options(True, False), [table], passed, "why") == code
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.split() == [f"{word}:", "why"]
    assert bench.finish("some/name.py", bench.Options(True, True), [table], passed, "why") == code
    facts = json.loads(capsys.readouterr().out)
    assert facts["passed"] is passed and facts["rows"] == [dict(table.rows[0])]


# -- the notebook -----------------------------------------------------------------------------------


def read_notebook():
    nbformat = pytest.importorskip("nbformat", reason="notebooks need the extra 'bench'")
    return nbformat.read(NOTEBOOK, as_version=4)


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    """The notebook, run again from its source in a fresh kernel."""
    nbclient = pytest.importorskip("nbclient", reason="notebooks need the extra 'bench'")
    pytest.importorskip("ipykernel", reason="notebooks need the extra 'bench'")
    notebook, folder = read_notebook(), tmp_path_factory.mktemp("notebook")
    for cell in code_cells(notebook):
        cell.outputs, cell.execution_count = [], None
    client = nbclient.NotebookClient(
        notebook,
        timeout=600,
        kernel_name="python3",
        coalesce_streams=True,
        resources={"metadata": {"path": str(folder)}},
    )
    client.execute()
    return notebook


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def printed(cell):
    return "".join(o.text for o in cell.outputs if o.output_type == "stream" and o.name == "stdout")


def figure_count(notebook):
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    return sum("image/png" in output.get("data", {}) for output in outputs)


def numbers(line):
    return [float(text) for text in re.findall(r"(?<![\w.])-?\d+\.\d+", line)]


def test_stored_notebook_shows_its_figures_and_nothing_of_a_machine():
    notebook = read_notebook()
    assert NOTEBOOK.stat().st_size < 1_500_000
    assert notebook.metadata.kernelspec.name == "python3"
    assert figure_count(notebook) == 4
    for cell in code_cells(notebook):
        assert cell.execution_count is not None
        for output in cell.outputs:
            assert output.output_type in ("stream", "display_data")
            assert output.get("name", "stdout") == "stdout"
            text = output.get("text", "") + output.get("data", {}).get("text/plain", "")
            assert not re.search(r"(^|\s|['\"(])(/|[A-Z]:\\)\w", text)


def test_executed_again_the_notebook_prints_what_is_stored(executed):
    stored = [printed(cell) for cell in code_cells(read_notebook())]
    assert [printed(cell) for cell in code_cells(executed)] == stored
    assert figure_count(executed) == 4


def test_slopes_in_the_notebook(executed):
    """Slopes of a fit up to W = 0.1 lie between the leading power and the local slope at 0.1.

    zeta = -3/4 W (1 - W^2), -1/2 W^3 (1 + 35/24 W^2), -1/2 W (1 - 0.58 W^2) for five equal lags, and
    |z| - 1 = 1/2 W^4 (1 + 2 W^2); c W^2 changes a slope by 2 c W^2. Half a unit of the last printed
    digit is allowed besides.
    """
    text = next(printed(c) for c in code_cells(executed) if printed(c).startswith("slopes"))
    rows = {line.split(",")[0 if "|z|" in line else 1][:9]: line for line in text.splitlines()[1:]}
    expected = {" Eq. 2.1": (1, -2), " Eq. 2.2": (3, 35 / 12), " Eq. 2.3": (1, -1.16)}
    for key, (order, slope) in {**expected, "|z| - 1": (4, 4.0)}.items():
        measured, exact = numbers(rows[key])[-2:]
        low, high = sorted((order, order + slope * 0.1**2))
        assert low - 5e-4 <= measured <= high + 5e-4
        assert low - 5e-4 <= exact <= high + 5e-4


def test_rules_of_the_conclusion_hold_in_theory(executed):
    """Every limit printed, put back into the exact roots, gives the error it is printed for."""
    (cell,) = (c for c in code_cells(executed) if "rules" in c.metadata.get("tags", []))
    rows = [line for line in printed(cell).splitlines() if "%" in line]
    assert [numbers(row)[0] / 100 for row in rows] == [0.01, 0.001, 0.0001]
    for row in rows:
        error, plain_zeta, plain_omega, lead_zeta, lead_omega, lags = numbers(row)
        error /= 100
        # Half a unit of the last digit printed, relative to the smallest figure of its column, times
        # the order of the error in omega_p T.
        close = {"rel": 3 * 5e-5 / 0.0131}
        assert -theory.exact_uncompensated(1, plain_zeta).zeta == pytest.approx(error, rel=0.004)
        assert 1 - theory.exact_uncompensated(1, plain_omega).omega == pytest.approx(error, **close)
        assert -theory.exact_lead(1, lead_zeta).zeta == pytest.approx(error, **close)
        assert theory.exact_lead(1, lead_omega).omega - 1 == pytest.approx(error, **close)
        # zeta = -x/2 (1 - 0.58 x^2), and x is 0.02 at most.
        five = theory.exact_all_analog(1, [lags / 5] * 5)
        assert -five.zeta == pytest.approx(error, rel=0.6 * 0.02**2)


def test_the_text_of_the_conclusion_quotes_the_rules():
    """Limits in the text are those of theory, rounded down so that they stay limits."""
    text = read_notebook().cells[-1].source
    quoted = [float(t) for t in re.findall(r"omega_p T \\le (\d\.\d+)\$", text)]
    plain, lead_damping, lead_frequency = quoted
    for limit, digits, error in (
        (plain, 4, lambda w: -theory.exact_uncompensated(1, w).zeta),
        (lead_damping, 3, lambda w: -theory.exact_lead(1, w).zeta),
        (lead_frequency, 3, lambda w: theory.exact_lead(1, w).omega - 1),
    ):
        assert error(limit) <= 0.01 < error(limit + 10**-digits)
    cycles = [int(t) for t in re.findall(r"(\d+)(?: digital)? cycles in\s+each oscillation", text)]
    # From the unrounded limits, so one more or less than from those quoted.
    assert cycles == pytest.approx([2 * math.pi / w for w in quoted], abs=1.5)
    assert "first without lead, third with it" in text
    (floor,) = (float(t) for t in re.findall(r"omega_p T\$ below (\d\.\d+)", text))
    assert floor == pytest.approx((10 * 6e-6) ** (1 / 3), abs=5e-4)


def test_axes_outside_the_bounds_are_told_below_the_table(monkeypatch):
    """Only those that are: at 10 ms axes by themselves take 0.84 g/s, the bounds are 1.27 to 1.60."""
    monkeypatch.syspath_prepend(str(BENCHES))
    jets = importlib.import_module("jet_control")
    rows = [jets.row(0.1, "sampled", 7.55e-3), jets.row(0.01, "sampled", 1.44e-3)]
    rows.append(jets.row(0.1, "comparators", 1.11e-3))
    notes = jets.beside_bounds(rows)
    assert notes.count("g/s at") == 1 and "0.843 g/s at 10 ms" in notes
    assert "outside" not in jets.beside_bounds([rows[0], rows[2]])


def test_a_reader_that_has_read_enough_is_no_mistake():
    """As `head` is: the line is far longer than what a pipe holds."""
    code = (
        "import sys, bench; sys.exit(bench.finish('b.py', bench.Options(True, True), "
        "[bench.Table('rows', '', {}, [{'x': 'y' * 1000}] * 1000)], True, 'done'))"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=BENCHES, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as bench:
        bench.stdout.read(10)
        bench.stdout.close()
        assert bench.stderr.read() == b""
    assert bench.returncode == 0
