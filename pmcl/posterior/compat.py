"""Access to ArviZ, whichever generation is installed; no other module imports it.

ArviZ 0.2x keeps a posterior in its own ``InferenceData``, ArviZ 1.x in an :class:`xarray.DataTree`. Both are a set of
named groups, each an :class:`xarray.Dataset`, plus attributes. Everything else in pmcl sees only groups.
ArviZ takes seconds to import, so it is imported when it is first needed, never with this module.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import os
import tempfile
import warnings
from collections.abc import Mapping
from os import PathLike
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.errors import PosteriorError
from pmcl.hdf5 import MOST_BYTES, UnsafeFileError, stored_arrays

__all__ = [
    "Posterior",
    "assemble",
    "attributes",
    "bulk_ess",
    "extended",
    "find_group",
    "group_names",
    "load_netcdf",
    "mcse_of_mean",
    "mean_ess",
    "r_hat",
    "save_netcdf",
    "size_of",
    "tail_ess",
]

Posterior: TypeAlias = Any
"""``arviz.InferenceData`` under ArviZ 0.2x, ``xarray.DataTree`` under ArviZ 1.x."""

Float = NDArray[np.float64]

# Names the user's cache folder on Linux.
_CACHE = "XDG_CACHE_HOME"
# Quantiles of the tail effective sample size: the ends of the 90 % interval that pmcl reports.
_TAILS = (0.05, 0.95)


def _arviz() -> Any:
    # Untyped on purpose: only one of the generations has annotations, and these do not fit the other.
    with warnings.catch_warnings():
        # What ArviZ announces when it is imported would be an error under -W error.
        warnings.simplefilter("ignore")
        try:
            return importlib.import_module("arviz")
        except OSError:
            return _arviz_without_home()


def _arviz_without_home() -> Any:
    """Import an ArviZ that writes into the user's cache folder, where there is none that can be written."""
    before = os.environ.get(_CACHE)
    try:
        with tempfile.TemporaryDirectory() as folder:
            os.environ[_CACHE] = folder
            return importlib.import_module("arviz")
    except OSError as error:
        raise PosteriorError(
            f"expected a place where ArviZ can write when it is imported, got {error}: let HOME or {_CACHE} name a "
            "folder that can be written"
        ) from error
    finally:
        if before is None:
            os.environ.pop(_CACHE, None)
        else:
            os.environ[_CACHE] = before


def _uses_datatree() -> bool:
    # Not hasattr(arviz, "InferenceData"): ArviZ 1.x answers that name too, with a warning and another class.
    return int(importlib.metadata.version("arviz").split(".")[0]) >= 1


def assemble(groups: Mapping[str, xr.Dataset], attrs: Mapping[str, Any]) -> Posterior:
    """Return a posterior of the installed ArviZ generation that holds some groups.

    Parameters
    ----------
    groups : mapping of str to xarray.Dataset
        Group name to its content.
    attrs : mapping of str to scalar
        Attributes of the whole posterior.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree
    """
    if _uses_datatree():
        root = xr.Dataset(attrs=dict(attrs))
        return xr.DataTree.from_dict({"/": root, **groups})
    return _arviz().InferenceData(attrs=dict(attrs), **groups)


def extended(data: Posterior, groups: Mapping[str, xr.Dataset], attrs: Mapping[str, Any]) -> Posterior:
    """Add groups and attributes to a posterior; `data` stays as it is.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    groups : mapping of str to xarray.Dataset
        Further groups, which take the place of those of the same name.
    attrs : mapping of str to scalar
        Further attributes of the whole and of the group ``posterior``, which repeats them.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree
    """
    together = {name: find_group(data, name) for name in group_names(data)} | dict(groups)
    together["posterior"] = together["posterior"].assign_attrs(attrs)
    return assemble(together, {**attributes(data), **attrs})


def group_names(data: Posterior) -> tuple[str, ...]:
    """Names of the groups that a posterior holds.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    tuple of str

    Raises
    ------
    PosteriorError
        If `data` is neither of the two.
    """
    # The type decides, not the version: a DataTree is understood beside ArviZ 0.2x as well.
    if isinstance(data, xr.DataTree):
        return tuple(data.children)
    if hasattr(data, "groups") and hasattr(data, "attrs"):
        return tuple(data.groups())
    raise PosteriorError(
        f"expected an ArviZ posterior (InferenceData or DataTree), got {type(data).__name__}: "
        "make one with pmcl.posterior.convert.to_arviz or read_posterior"
    )


def find_group(data: Posterior, name: str) -> xr.Dataset:
    """Return one group of a posterior; an empty one if the posterior does not have it.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    name : str

    Returns
    -------
    xarray.Dataset
    """
    if name not in group_names(data):
        return xr.Dataset()
    found = data[name]
    if isinstance(found, xr.Dataset):
        return found
    dataset: xr.Dataset = found.to_dataset()
    return dataset


def attributes(data: Posterior) -> dict[str, Any]:
    """Attributes of the whole posterior, as stored.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    dict
    """
    group_names(data)
    return dict(data.attrs or {})


def save_netcdf(data: Posterior, path: str | PathLike[str]) -> None:
    """Write a NetCDF file that ``arviz.from_netcdf`` of both ArviZ generations reads.

    Written group by group with xarray, so that the bytes do not depend on the ArviZ installed. Nothing is
    compressed: random draws do not shrink, and trying costs more than the disk saved.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    path : path-like
    """
    xr.Dataset(attrs=attributes(data)).to_netcdf(path, mode="w", engine="h5netcdf")
    for name in group_names(data):
        dataset = find_group(data, name).drop_encoding()
        dataset.to_netcdf(path, mode="a", group=name, engine="h5netcdf")


def size_of(data: Posterior) -> int:
    """Return how large the arrays of all groups are [byte].

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    int
    """
    return sum(int(find_group(data, name).nbytes) for name in group_names(data))


def load_netcdf(path: str | PathLike[str]) -> Posterior:
    """Read a NetCDF file of ArviZ groups into memory and close it.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    arviz.InferenceData or xarray.DataTree

    Raises
    ------
    UnsafeFileError
        If the file points to other files, or declares far more than it holds, see :mod:`pmcl.hdf5`.
    OSError, ValueError
        If the file cannot be read.
    """
    n_bytes = sum(array.n_bytes for array in stored_arrays(path).values())
    if n_bytes > MOST_BYTES:
        raise UnsafeFileError(f"arrays of {n_bytes >> 20} MB, more than {MOST_BYTES >> 20} MB")
    # Loaded at once: a lazy dataset would keep the file open and fail far from here when it is damaged.
    if _uses_datatree():
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            return tree.load()
    arviz = _arviz()
    with arviz.rc_context({"data.load": "eager"}):
        return arviz.from_netcdf(str(path))


def r_hat(draws: Float) -> float:
    """Rank-normalised split R-hat (Vehtari et al., Bayesian Analysis 2021).

    Parameters
    ----------
    draws : ndarray, shape (K, N)
        Draws of one quantity in K chains.

    Returns
    -------
    float
        NaN for fewer than two chains or four draws, and for draws that are all equal.
    """
    if draws.shape[0] < 2 or draws.shape[1] < 4:
        return float("nan")
    return _scalar(_arviz().rhat, draws, method="rank")


def bulk_ess(draws: Float) -> float:
    """Effective number of draws for the centre of the distribution.

    Parameters
    ----------
    draws : ndarray, shape (K, N)

    Returns
    -------
    float
        NaN for fewer than four draws.
    """
    if draws.shape[1] < 4:
        return float("nan")
    return _scalar(_arviz().ess, draws, method="bulk")


def tail_ess(draws: Float) -> float:
    """Effective number of draws for the 5 % and 95 % quantiles, the smaller of the two.

    Parameters
    ----------
    draws : ndarray, shape (K, N)

    Returns
    -------
    float
        NaN for fewer than four draws.
    """
    if draws.shape[1] < 4:
        return float("nan")
    return _scalar(_arviz().ess, draws, method="tail", prob=_TAILS)


def mean_ess(draws: Float) -> float:
    """Effective number of draws for the mean.

    Parameters
    ----------
    draws : ndarray, shape (K, N)

    Returns
    -------
    float
        NaN for fewer than four draws.
    """
    if draws.shape[1] < 4:
        return float("nan")
    return _scalar(_arviz().ess, draws, method="mean")


def mcse_of_mean(draws: Float) -> float:
    """Monte Carlo standard error of the mean of all draws.

    Parameters
    ----------
    draws : ndarray, shape (K, N)

    Returns
    -------
    float
        In the unit of `draws`; NaN for fewer than four draws.
    """
    if draws.shape[1] < 4:
        return float("nan")
    return _scalar(_arviz().mcse, draws, method="mean")


def _scalar(function: Any, draws: Float, **options: Any) -> float:
    with warnings.catch_warnings():
        # Chains that never moved divide zero by zero; the NaN that results is the answer.
        warnings.simplefilter("ignore", RuntimeWarning)
        return float(np.asarray(function(draws, **options)).item())
