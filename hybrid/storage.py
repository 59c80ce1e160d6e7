"""Files of a run or a sweep: NetCDF and whatever else is to appear whole or not at all.

Stage 0. It knows neither patch nor machine, so that the process that writes files is ready early.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.errors import RunError

if TYPE_CHECKING:
    import xarray as xr

# Variables, coordinates and attributes of a record, as xarray.Dataset takes them.
Parts = tuple[dict[str, Any], dict[str, Any], dict[str, Any]]


class NotWritten(RunError):
    """A file that could not be written; `before`: those of the same answer that were."""

    before: tuple[str, ...] = ()


class PlainSignal:
    """Values and attributes of one variable, read like those of an xarray.Dataset."""

    def __init__(self, values: Any, attrs: dict[str, Any]) -> None:
        self.values, self.attrs = values, attrs


class PlainRecord:
    """A record's parts read like an xarray.Dataset, which takes a third of a second to load."""

    def __init__(self, parts: Parts) -> None:
        variables, coordinates, self.attrs = parts
        self.data_vars = {name: PlainSignal(*entry[1:]) for name, entry in variables.items()}
        self.coords = {name: PlainSignal(*entry[1:]) for name, entry in coordinates.items()}

    def __getitem__(self, name: str) -> PlainSignal:
        return self.data_vars[name] if name in self.data_vars else self.coords[name]


def write_parts(parts: Parts, path: Path) -> None:
    """Write a record as NetCDF, just as xarray would but without loading it; whole or not at all.

    Raises NotWritten where it cannot.
    """
    import netCDF4

    variables, coordinates, attributes = parts

    def write(name: str) -> None:
        with netCDF4.Dataset(name, "w") as file:
            rows = coordinates["time"][1]
            file.createDimension("time", len(rows))
            for variable, (_, values, about) in {**coordinates, **variables}.items():
                made = file.createVariable(variable, "f8", ("time",))
                made[:] = values
                made.setncatts(about)
            file.setncatts(attributes)

    write_whole(path, lambda part: _told_of_the_disk(lambda: write(part)))


def write_dataset(dataset: xr.Dataset, path: Path) -> None:
    """Write NetCDF; the file appears whole or not at all. Raises NotWritten where it cannot."""
    write_whole(
        path, lambda part: _told_of_the_disk(lambda: dataset.to_netcdf(part, engine="netcdf4"))
    )


def _told_of_the_disk(write: Callable[[], Any]) -> None:
    """NetCDF's library says no more than that something went wrong: as a rule, there is no room."""
    try:
        write()
    except RuntimeError as error:
        raise OSError(f"{error}; is there room?") from None


def write_whole(path: Path, write: Callable[[str], Any]) -> None:
    """Call `write(name)` for a file beside `path`, then put it in place; raises NotWritten."""
    part = ""
    try:
        handle, part = tempfile.mkstemp(suffix=path.suffix, prefix=".hybrid-", dir=path.parent)
        os.close(handle)
        write(part)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(part, 0o666 & ~umask)
        os.replace(part, path)
    except OSError as error:
        # The file was there just now: without any room left, HDF takes it for forbidden.
        denied = part and isinstance(error, PermissionError)
        why = "not permitted; is there room?" if denied else error.strerror or error
        raise NotWritten(f"cannot write {path}: {why}") from None
    finally:
        if os.path.exists(part):
            os.unlink(part)


def output_folder(name: str | Path) -> Path:
    """Make sure that files can be written to the folder; raises RunError before anything is run."""
    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise RunError(f"cannot write to folder {folder}: {error.strerror or error}") from None
    return folder
