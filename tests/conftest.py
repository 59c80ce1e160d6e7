"""What the tests share: play a patch in one call, and matrix exponentials in decimals.

When all tests are shared among workers, the nonlinear engine is compiled once, before the first test,
and not by each of them; and the files that take longest come first, so that the workers end together.
"""

import math
import os
import subprocess
import sys
from dataclasses import dataclass
from decimal import Decimal, localcontext
from pathlib import Path

import numpy as np
import pytest

from hybrid.compiler import compile_patch
from hybrid.engine.exact import ExactPlayer as Player
from hybrid.machine import Machine
from hybrid.patchfile import parse_patch, read_patch
from hybrid.record import pens_for
from hybrid.scale import to_seconds
from hybrid.timeline import build_timeline

PATCHES = Path(__file__).parent.parent / "patches"
# Published check cases and vehicle models, which are no part of the project.
REFERENCE = Path(os.environ.get("HYBRID_REFERENCE") or PATCHES.parent.parent / "shared/reference")
DIGITS = 120  # forty squarings of a stiff matrix cost at most as many digits
SERIES_TERMS = 60  # 0.1**60 / 60! is far below 10**-DIGITS

# The nonlinear engine is compiled twice, without noise and with it; most functions below it serve both,
# and the linear engine's. So the second process begins with the linear engine, which the first needs
# last: each then finds on disk what the other has compiled. Word lengths have a kernel of their own.
COMPILE = "import sys, hybrid\nfor name in sys.argv[2:]: hybrid.run(name, machine=sys.argv[1])"
COMPILED = (
    ("lags", "van_der_pol", "two_precisions"),
    ("nominal", "pitch_loop", "harmonic_oscillator", "van_der_pol"),
)
COMPILING = pytest.StashKey[list[subprocess.Popen[bytes]]]()
# From a minute down to some ten seconds.
LONGEST = (
    "test_benches.py",
    "test_cli.py",
    "test_noise_in_windows.py",
    "test_crew.py",
    "test_engines.py",
    "test_reentry.py",
    "test_shipped_patches.py",
    "test_relaxation.py",
    "test_bad_input.py",
)


def pytest_sessionstart(session):
    """Begin to compile while the workers start; where tests were named, whoever needs it does."""
    config = session.config
    config.stash[COMPILING] = []
    shared = not hasattr(config, "workerinput") and getattr(config.option, "numprocesses", None)
    if shared and config.args_source == pytest.Config.ArgsSource.TESTPATHS:
        config.stash[COMPILING] = [
            subprocess.Popen([sys.executable, "-c", COMPILE, *names]) for names in COMPILED
        ]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_node_collection_finished(node):
    """No test is handed out before the engine is compiled."""
    for process in node.config.stash[COMPILING]:
        process.wait()


def pytest_sessionfinish(session):
    """Nothing goes on after an interrupt."""
    for process in session.config.stash[COMPILING]:
        process.kill()


def pytest_collection_modifyitems(items):
    """The longest files first, all others as they were."""
    place = {name: i for i, name in enumerate(LONGEST)}
    items.sort(key=lambda item: place.get(item.path.name, len(LONGEST)))


@dataclass(frozen=True)
class Played:
    """A finished run: `played["theta"]` is a column of the record, in the unit it is shown in."""

    machine: Machine
    player: Player

    @property
    def time_s(self):
        every = self.machine.timing.every * self.player.keep_every
        return np.array([to_seconds(k * every) for k in range(len(self.player.record))])

    def __getitem__(self, name):
        columns = [pen.name for pen in pens_for(self.machine)]
        return self.player.record[:, columns.index(name)]


@pytest.fixture(scope="session")
def shipped():
    """Text of a patch of the repository, by name; pairs (old, new) are replaced in it."""

    def text(name, *changes):
        found = (PATCHES / f"{name}.yaml").read_text(encoding="utf-8")
        for old, new in changes:
            assert old in found, f"{name}.yaml no longer holds {old!r}"
            found = found.replace(old, new)
        return found

    return text


@pytest.fixture(scope="session")
def reference():
    """A file among the reference data; skips the test where there are none."""

    def file(name):
        if not REFERENCE.is_dir():
            pytest.skip(f"no reference data in {REFERENCE}; set HYBRID_REFERENCE to their folder")
        return REFERENCE / name

    return file


@pytest.fixture(scope="session")
def compiled():
    """Machine from the text of a patch."""

    def machine(text, parameters=None, preset=None, serial=None):
        return compile_patch(parse_patch(text), parameters, preset, serial)

    return machine


@pytest.fixture(scope="session")
def start():
    """Player of a machine, nothing played yet."""

    def player(machine, seed=0, keep_every=1):
        timeline = build_timeline(machine, seed)
        return Player(machine, timeline, pens_for(machine), seed, keep_every)

    return player


@pytest.fixture(scope="session")
def play(compiled, start):
    """Compile the text of a patch and play it to its end."""

    def played(text, parameters=None, preset=None, *, seed=0, serial=None):
        machine = compiled(text, parameters, preset, serial)
        player = start(machine, seed)
        for _ in player.play():
            pass
        return Played(machine, player)

    return played


@pytest.fixture(scope="session")
def pitch_loop():
    """The shipped patch of Fig. 4, read from its file."""
    return read_patch(PATCHES / "pitch_loop.yaml")


@pytest.fixture(scope="session")
def exact_change():
    """exp(matrix) - I in decimals, rounded once at the end; small matrices only."""

    def change(matrix):
        with localcontext(prec=DIGITS):
            total = _series(matrix)
            return np.array([[float(entry) for entry in row] for row in total])

    return change


def _series(matrix):
    entries = [[Decimal(float(entry)) for entry in row] for row in matrix]
    norm = float(np.max(np.sum(np.abs(matrix), axis=1)))
    halvings = max(0, math.ceil(math.log2(norm)) + 4) if norm > 0 else 0
    small = [[entry / 2**halvings for entry in row] for row in entries]
    term, total = small, small
    for k in range(2, SERIES_TERMS):
        term = [[entry / k for entry in row] for row in _product(term, small)]
        total = _sum(total, term)
    for _ in range(halvings):
        total = _sum(_sum(total, total), _product(total, total))
    return total


def _sum(left, right):
    return [[a + b for a, b in zip(p, q, strict=True)] for p, q in zip(left, right, strict=True)]


def _product(left, right):
    columns = list(zip(*right, strict=True))
    return [[_dot(row, column) for column in columns] for row in left]


def _dot(row, column):
    return sum((a * b for a, b in zip(row, column, strict=True) if a and b), Decimal(0))
