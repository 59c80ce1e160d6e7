"""Compiled functions on disk are forgotten where what they were made of has changed."""

import ast
import os
import shutil
from pathlib import Path

from hybrid.engine import kernel
from hybrid.engine.compiling import kept_in

ENGINE = Path(kernel.__file__).parent
DECORATORS = {"compiled", "allocating", "inlined", "strictly", "strictly_alike"}


def compiled_in(tree):
    """Names that compiled functions use, and those that the module's own constants are made of."""
    for node in tree.body:
        decorated = isinstance(node, ast.FunctionDef) and any(
            isinstance(d, ast.Name) and d.id in DECORATORS for d in node.decorator_list
        )
        if decorated:
            nodes = [n for statement in node.body for n in ast.walk(statement)]
        elif isinstance(node, ast.Assign):
            nodes = list(ast.walk(node.value))
        else:
            continue
        yield from (n.id for n in nodes if isinstance(n, ast.Name))


def test_every_module_whose_constants_are_compiled_in_is_looked_at():
    """By the imports of the engine's modules: a constant is a plain figure in compiled code."""
    wanted = set()
    for path in ENGINE.glob("*.py"):
        tree = ast.parse(path.read_text())
        text = path.read_text()
        if not any(f"@{name}" in text for name in DECORATORS):
            continue
        used = set(compiled_in(tree))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("hybrid."):
                module = node.module.split(".")[1]
                names = {n.asname or n.name for n in node.names}
                if module != "engine" and any(n in used and n.isupper() for n in names):
                    wanted.add(f"{module}.py")
    assert len(wanted) > 4  # or nothing was found to look at
    assert wanted <= set(kernel.SOURCES)
    assert all((ENGINE.parent / name).exists() for name in kernel.SOURCES)


def test_kernels_older_than_a_source_are_removed(tmp_path, monkeypatch):
    """Touching the last of the modules named is enough."""
    folder = tmp_path / "hybrid" / "engine"
    folder.mkdir(parents=True)
    for name in kernel.SOURCES:
        shutil.copy(ENGINE.parent / name, folder.parent / name)
    shutil.copy(kernel.__file__, folder / "kernel.py")
    index = tmp_path / "cache" / "kernel.play-1.nbi"
    index.parent.mkdir()
    index.write_text("")
    monkeypatch.setattr(kernel, "__file__", str(folder / "kernel.py"))
    monkeypatch.setattr(kernel.play._cache, "_cache_path", str(index.parent))
    kernel.forget_stale_kernels()
    assert index.exists()
    later = index.stat().st_mtime + 10
    os.utime(folder.parent / kernel.SOURCES[-1], (later, later))
    kernel.forget_stale_kernels()
    assert not index.exists()


def test_kernels_of_an_installed_package_lie_beside_it(tmp_path):
    """Within it they would outlive it: pip removes what it brought, and the rest hides a checkout."""
    installed = tmp_path / "site-packages" / "hybrid"
    assert kept_in(installed) == tmp_path / "site-packages" / "hybrid-kernels"
    (tmp_path / "checkout").mkdir()
    (tmp_path / "checkout" / "pyproject.toml").touch()
    assert kept_in(tmp_path / "checkout" / "hybrid") is None
    assert kept_in(ENGINE.parent) is None
