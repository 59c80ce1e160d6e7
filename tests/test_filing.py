"""A run's files hold exactly what the run holds, whichever process wrote them."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from multiprocessing import get_all_start_methods
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from hybrid.errors import RunError
from hybrid.filing import PATIENCE_S, Filing, write_files
from hybrid.patchfile import parse_patch
from hybrid.played import Run
from hybrid.runs import run
from hybrid.storage import PlainRecord


@pytest.fixture(scope="module")
def result() -> Run:
    text = """
title: A decay
machine: ideal
analog: {x: {integrate: {x: -1}, initial: 1, full_scale: 1}}
interface: {s: {adc: x, bits: 12}}
digital: {period: 10 ms, program: {twice: 2*s}}
run: {until: 1 s}
"""
    return run(parse_patch(text, "decay.yaml"))


def same(stored: xr.Dataset, result: Run) -> None:
    xr.testing.assert_equal(stored, result.record)
    for name in ("time", *result.record.data_vars):
        for key, value in result.record[name].attrs.items():
            kept = stored[name].attrs[key]
            assert kept == value or (math.isnan(kept) and math.isnan(value))
    assert {k: stored.attrs[k] for k in result.record.attrs} == dict(result.record.attrs)


def test_the_second_process_writes_record_and_chart(result: Run, tmp_path: Path) -> None:
    with Filing(chart=True) as filing:
        filing.write(result.parts(), result.readouts, None, tmp_path / "decay")
        files = filing.written()
    assert [Path(f).name for f in files] == ["decay.nc", "decay.png"]
    with xr.open_dataset(files[0]) as stored:
        same(stored.load(), result)
    assert Path(files[1]).read_bytes().startswith(b"\x89PNG")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["decay.nc", "decay.png"]


def test_a_killed_process_loses_nothing(result: Run, tmp_path: Path) -> None:
    with Filing(chart=False) as filing:
        filing.process.kill()
        filing.process.join()
        filing.write(result.parts(), result.readouts, None, tmp_path / "decay")
        files = filing.written()
    with xr.open_dataset(files[0]) as stored:
        same(stored.load(), result)


@pytest.mark.parametrize("heard", [True, False], ids=["heard", "deaf to SIGTERM"])
def test_leaving_at_once_never_waits(heard: bool) -> None:
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL if heard else signal.SIG_IGN)
    try:
        for wait_s in [0.0, 0.01, 0.03, 0.1] * (5 if heard else 1):
            with Filing(chart=True) as filing:
                time.sleep(wait_s)  # at every stage of its loading
                began = time.monotonic()
            # It would wait for ever; others may have the processor for longer than PATIENCE_S.
            assert time.monotonic() - began < 2.0 * PATIENCE_S + 60.0
            assert not filing.process.is_alive()
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.skipif("fork" not in get_all_start_methods(), reason="needs fork")
def test_a_command_starts_by_a_copy_that_ends_with_it() -> None:
    code = (
        "import os, signal; from hybrid.filing import Filing; filing = Filing(chart=True);"
        "print(type(filing.process).__name__, filing.process.pid, flush=True);"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    begun = [sys.executable, "-c", code]
    told = subprocess.run(begun, stdout=subprocess.PIPE, text=True, timeout=600, check=False).stdout
    # Its end of the output is closed, so it has ended too: only so does `run` come back.
    assert told.startswith("ForkProcess ")


def test_what_cannot_be_written_is_said(result: Run, tmp_path: Path) -> None:
    with pytest.raises((RunError, OSError)):
        write_files(result.parts(), {}, None, tmp_path / "no folder" / "decay", False)


def test_a_plain_record_reads_like_a_dataset(result: Run) -> None:
    plain = PlainRecord(result.parts())
    assert list(plain.data_vars) == list(result.record.data_vars)
    assert np.array_equal(plain["x"].values, result.record["x"].values)
    assert plain["time"].attrs == result.record["time"].attrs


def test_the_command_leaves_drawing_in_three_dimensions_to_others() -> None:
    code = (
        "import sys; from hybrid.loading import load_matplotlib_without_3d as load; load();"
        "import hybrid.charts.strip; assert 'mpl_toolkits.mplot3d' not in sys.modules;"
        "import mpl_toolkits.mplot3d"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_a_run_from_kept_kernels_sets_up_nothing_that_only_compiling_needs() -> None:
    """And what is compiled afterwards, in the same process, still finds all it needs."""
    played = (
        "import sys, hybrid; hybrid.run('pitch_loop', {}, machine='nominal');"
        "print('numba.np.arraymath' in sys.modules);"
    )
    compiles = (
        "import numba, numpy as np; assert numba.njit(lambda x: np.sum(x * x))(np.ones(3)) == 3.0;"
        "print('numba.np.arraymath' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", played], check=True, capture_output=True)  # keeps them
    command = [sys.executable, "-c", played + compiles]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert told.split() == ["False", "True"]
