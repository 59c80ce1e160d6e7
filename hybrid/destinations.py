"""Where the files of a command go, and what they are called. Stage 8."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from hybrid.errors import RunError
from hybrid.naming import in_name, stem_of
from hybrid.options import serial_range, swept_range

if TYPE_CHECKING:
    from hybrid.patch import Patch


def batch_file(options: argparse.Namespace, patch: Patch) -> Path:
    """Where the data of a batch go: the name tells the swept parameters, serial numbers and runs."""
    asked = []
    if options.over:
        asked.append(f"over_{','.join(swept_range(over)[0] for over in options.over)}")
    if options.serials is not None:
        serials = serial_range(options.serials)
        asked.append(f"serials{serials[0]}-{serials[-1]}")
    if options.runs is not None:
        asked.append(f"runs{options.runs}")
    stem = f"{file_stem(options, patch)}_{in_name('_'.join(asked))}"
    return _data_file(options, f"out/{stem}_batch.nc")


def file_stem(options: argparse.Namespace, patch: Patch) -> str:
    """The name of the files without ending, which tells what the options have changed of the patch."""
    asked = vars(options)
    changed = sorted(entry.replace(" ", "") for entry in options.set)
    changed += [asked["machine"]] if asked.get("machine") else []
    changed += [f"serial{asked['serial']}"] if asked.get("serial") is not None else []
    changed += [f"seed{asked['seed']}"] if asked.get("seed") else []
    changed += [asked["engine"]] if asked.get("engine", "auto") != "auto" else []
    changed += [f"until={asked['until']}"] if asked.get("until") else []
    return stem_of(patch, changed)


def output_name(out: str) -> str:
    """What --out names; the empty text is no place, least of all the folder one is in."""
    if not out.strip():
        raise RunError("--out is empty; name a folder of a run, or a file of a sweep or batch")
    return out


def run_folder(options: argparse.Namespace) -> Path:
    """Where the files of a run go."""
    folder = Path(output_name(options.out))
    if folder.is_file():
        raise RunError(
            f"--out {folder} is a file, not a folder; name the folder of the run's files"
        )
    return folder


def sweep_file(options: argparse.Namespace, patch: Patch, name: str) -> Path:
    """Where the data of a sweep go."""
    return _data_file(options, f"out/{file_stem(options, patch)}_over_{name}.nc")


def _data_file(options: argparse.Namespace, default: str) -> Path:
    out = Path(default if options.out is None else output_name(options.out))
    if out.suffix != ".nc":
        raise RunError(f"--out {out} must be a NetCDF file, ending in .nc")
    return out


def writable(*files: Path) -> None:
    """Raise RunError where the files of a run or sweep cannot be put, before anything is computed."""
    from hybrid.storage import output_folder

    output_folder(files[0].parent)
    for file in files:
        if file.is_dir():
            raise RunError(f"cannot write {file}: a folder of that name is in the way")
