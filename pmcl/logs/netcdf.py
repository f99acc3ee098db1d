"""NetCDF files: reading with one-line errors, and writing that never destroys what was there."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from pmcl.errors import LogError
from pmcl.hdf5 import MOST_IN_GROUP, StoredArray, UnsafeFileError, stored_arrays
from pmcl.logs.schema import MOST_NUMBERS
from pmcl.logs.validation import fail
from pmcl.whole_file import replacing

__all__ = ["read_dataset", "write_dataset"]



def read_dataset(path: str | os.PathLike[str]) -> xr.Dataset:
    """Load a NetCDF file into memory and close it. Numbers come as they are: times are not turned into dates.

    Parameters
    ----------
    path : path
        A NetCDF-4 (HDF5) or NetCDF-3 file.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    LogError
        When the file is missing, truncated or no NetCDF file, points to other files, or declares far more than it holds
        or than a log may have.
    """
    where = os.fspath(path)
    if os.path.exists(path) and not os.path.isfile(path):
        # A folder has nothing to read, and a pipe that nobody writes to would be waited for without end.
        fail(where, "expected a NetCDF file, got something that is no file: check the path")
    try:
        with open(path, "rb") as stream:
            classic = stream.read(3) == b"CDF"
    except FileNotFoundError:
        fail(where, "expected a NetCDF file, got no such file: check the path")
    except OSError as problem:
        fail(where, f"expected a readable NetCDF file, got '{problem.strerror}': check the path and its permissions")
    try:
        _require_small(_sizes_in_classic_file(path) if classic else stored_arrays(path), where)
        with xr.open_dataset(
            path, engine="scipy" if classic else "h5netcdf", decode_times=False, decode_timedelta=False
        ) as dataset:
            return dataset.load()
    except (LogError, MemoryError):
        raise
    except UnsafeFileError as problem:
        fail(where, f"expected a NetCDF file with its own data and no more, got {problem}: write it anew without that")
    except Exception as problem:  # HDF5 answers a damaged file with whatever its damaged bytes lead it to
        fail(where, f"expected a NetCDF file, got one that cannot be read ({problem}): write or copy it again")


def _sizes_in_classic_file(path: str | os.PathLike[str]) -> dict[str, StoredArray]:
    from scipy.io import netcdf_file

    # Arrays are parts of the file that are mapped into memory: none is read here.
    with netcdf_file(path, mmap=True) as file:
        found = {f"/{name}": StoredArray(tuple(each.shape), 0) for name, each in file.variables.items()}
        file.variables.clear()  # else they would keep the file open
    if len(found) > MOST_IN_GROUP:
        raise UnsafeFileError(f"{len(found)} variables, more than {MOST_IN_GROUP}")
    return found


def _require_small(stored: Mapping[str, StoredArray], where: str) -> None:
    """Check that all variables together, also those outside the format, are no larger than a log may be."""
    counts = {name: math.prod(array.shape) for name, array in stored.items()}
    if sum(counts.values()) > MOST_NUMBERS:
        name = max(counts, key=lambda each: counts[each])
        shape = " x ".join(map(str, stored[name].shape))
        fail(
            where,
            f"expected at most {MOST_NUMBERS} numbers in a log, got '{name}' of shape {shape}: cut the log into parts, "
            "or leave out what it does not need",
        )


def write_dataset(dataset: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a NetCDF-4 file, all or nothing: a failure leaves an existing file as it was.

    The data go to a new file in the same folder, which then takes the name in one step.

    Parameters
    ----------
    dataset : xarray.Dataset
        What to write. Every number is stored bit for bit.
    path : path
        Target; replaced when it exists.

    Raises
    ------
    LogError
        When the folder does not exist, or the file cannot be written.
    """
    # A symbolic link stays one: its target is what gets replaced.
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        fail(os.fspath(path), "expected a path in an existing folder, got none there: create the folder")
    if target.is_dir():
        fail(os.fspath(path), "expected the path of a file, got a folder: add a file name")
    # Without a fill value NaN is stored as the NaN that it is.
    encoding = {str(name): {"_FillValue": None} for name in dataset.variables if _is_float(dataset[name])}
    try:
        with replacing(path, n_bytes=dataset.nbytes, error=LogError) as part:
            dataset.to_netcdf(part, engine="h5netcdf", encoding=encoding)
    except (TypeError, ValueError) as problem:
        if isinstance(problem, LogError):
            raise
        text = " ".join(str(problem).split())
        raise LogError(
            f"{os.fspath(path)}: expected to write a NetCDF file, got '{text}': check the attributes"
        ) from problem


def _is_float(array: xr.DataArray) -> bool:
    return np.issubdtype(array.dtype, np.floating)
