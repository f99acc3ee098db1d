"""The posterior on disk: one NetCDF file that ArviZ 0.2x and 1.x read alike."""

from __future__ import annotations

import os
from pathlib import Path

from pmcl.checks import check_path
from pmcl.errors import PosteriorError
from pmcl.hdf5 import UnsafeFileError
from pmcl.posterior.access import parameter_names, require_numbers
from pmcl.posterior.compat import Posterior, load_netcdf, save_netcdf, size_of
from pmcl.whole_file import replacing

__all__ = ["read_posterior", "write_posterior"]


def write_posterior(data: Posterior, path: str | os.PathLike[str]) -> None:
    """Write a posterior to a NetCDF file; an older file of that name is replaced only when the new one is complete.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    path : path-like

    Raises
    ------
    PosteriorError
        If there is nothing to write, or the file cannot be written.
    """
    check_path("path", path, error=PosteriorError)
    parameter_names(data)
    with replacing(path, n_bytes=size_of(data)) as temporary:
        save_netcdf(data, temporary)


def read_posterior(path: str | os.PathLike[str]) -> Posterior:
    """Read a posterior into memory.

    Parameters
    ----------
    path : path-like
        A NetCDF file that :func:`write_posterior`, or ArviZ, wrote.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree

    Raises
    ------
    PosteriorError
        If the file is missing, damaged, not NetCDF, not a posterior, holds no draws or draws that are no
        numbers, or points to other files.
    """
    path = Path(check_path("path", path, error=PosteriorError))
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise PosteriorError(
            f"expected the posterior that 'pmcl calibrate' wrote, got {found} at {path}: check the name"
        )
    if path.stat().st_size == 0:
        raise PosteriorError(f"expected a NetCDF posterior, got an empty file at {path}: run 'pmcl calibrate' again")
    try:
        data = load_netcdf(path)
    except UnsafeFileError as error:
        raise PosteriorError(
            f"expected a posterior with its own data and no more, got {error} at {path}: ask for one that "
            "'pmcl calibrate' wrote"
        ) from None
    # The HDF5 stack raises nearly anything on damaged files: KeyError and RuntimeError besides OSError and ValueError.
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PosteriorError(
            f"expected a NetCDF posterior, got a file that is damaged or of another format at {path} ({reason[:120]}): "
            "run 'pmcl calibrate' again"
        ) from error
    try:
        require_numbers(data)
    except PosteriorError as error:
        raise PosteriorError(f"{path}: {error}") from error
    return data
