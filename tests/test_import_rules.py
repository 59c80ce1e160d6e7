"""The import rules hold, and hold for modules that are yet to come."""

import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

HERE = Path(__file__).parent.parent
LINT = "import sys; from importlinter.cli import lint_imports_command as main; sys.exit(main())"


@pytest.fixture
def linted(tmp_path):
    """What the linter says of a copy of the package with one more module; None: of the copy."""
    shutil.copytree(
        HERE / "hybrid", tmp_path / "hybrid", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copy(HERE / ".importlinter", tmp_path)

    def lint(module=None, text=""):
        if module:
            (tmp_path / "hybrid" / module).write_text(text)
        done = subprocess.run(
            [sys.executable, "-c", LINT, "--no-cache"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
            timeout=600,
        )
        return done.returncode, done.stdout + done.stderr

    return lint


def test_the_rules_are_kept(linted):
    code, told = linted()
    assert code == 0, told


@pytest.mark.parametrize("module", ["fresh.py", "charts/fresh.py"])
def test_a_new_module_is_under_the_rules(linted, module):
    code, told = linted(module, "import numba\nimport pint\nimport simpy\nimport yaml\n")
    assert code == 1
    for rule in ("clockwork knows simpy", "reads YAML", "engine is compiled", "units knows pint"):
        assert f"{rule} BROKEN" in told
    listed = module.startswith("charts")  # its package has its place among the stages
    assert ("lower stages BROKEN" in told) != listed


def test_nothing_but_the_engine_may_load_numba(linted):
    code, told = linted("engine/fresh.py", "import numba\n")
    assert code == 0, told


def test_every_package_is_installed():
    """An installation that is no editable one has in it the packages that are named, and no others."""
    named = tomllib.loads((HERE / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    found = {
        ".".join(file.parent.relative_to(HERE).parts) for file in HERE.glob("hybrid/**/__init__.py")
    }
    assert set(named) == found | {"hybrid.patches"}
