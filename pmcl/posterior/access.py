"""How the rest of pmcl reads a posterior: plain arrays and numbers out of labelled groups.

Parameters are the variables of the group ``posterior`` with dimensions (chain, draw) and nothing else, so posteriors
that other programs wrote through ArviZ can be read too.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.errors import PosteriorError
from pmcl.posterior.compat import Posterior, find_group

__all__ = [
    "log_joint",
    "log_suffixes",
    "parameter_draws",
    "parameter_names",
    "parameter_units",
    "theta_draws",
    "trajectory_draws",
    "true_theta",
]

Float = NDArray[np.float64]


def parameter_names(data: Posterior) -> tuple[str, ...]:
    """Names of the parameters, in the order of the file.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    tuple of str, length d

    Raises
    ------
    PosteriorError
        If there are no parameters or no draws.
    """
    posterior = find_group(data, "posterior")
    names = tuple(str(name) for name, variable in posterior.data_vars.items() if variable.dims == ("chain", "draw"))
    if not names:
        raise PosteriorError(
            "expected a group 'posterior' with variables over (chain, draw), got "
            f"{sorted(map(str, posterior.data_vars)) or 'none'}: give the file that 'pmcl calibrate' wrote"
        )
    if posterior.sizes["chain"] == 0 or posterior.sizes["draw"] == 0:
        raise PosteriorError(
            f"expected at least one draw in the posterior, got {posterior.sizes['chain']} chains of "
            f"{posterior.sizes['draw']} draws: run the calibration with more draws"
        )
    return names


def parameter_units(data: Posterior) -> tuple[str, ...]:
    """Units of the parameters, in the order of :func:`parameter_names`; empty where not stated.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    tuple of str, length d
    """
    posterior = find_group(data, "posterior")
    return tuple(str(posterior[name].attrs.get("units", "")) for name in parameter_names(data))


def parameter_draws(data: Posterior, name: str) -> Float:
    """Draws of one parameter.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    name : str

    Returns
    -------
    ndarray, shape (K, N)
        K chains of N draws in the parameter's unit.

    Raises
    ------
    PosteriorError
        If there is no such parameter.
    """
    if name not in parameter_names(data):
        raise PosteriorError(
            f"expected one of the posterior's parameters {', '.join(parameter_names(data))}, got {name!r}: "
            "use one of these names"
        )
    return np.asarray(find_group(data, "posterior")[name].values, dtype=np.float64)


def theta_draws(data: Posterior) -> Float:
    """All draws as one array.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    ndarray, shape (K, N, d)
        The last axis is in the order of :func:`parameter_names`.
    """
    return np.stack([parameter_draws(data, name) for name in parameter_names(data)], axis=-1)


def log_joint(data: Posterior) -> Float | None:
    """Log joint density of parameters, trajectories and readings at each draw (eq. 16).

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    ndarray of shape (K, N), or None when the posterior does not tell
    """
    statistics = find_group(data, "sample_stats")
    if "lp" not in statistics:
        return None
    return np.asarray(statistics["lp"].values, dtype=np.float64)


def true_theta(data: Posterior) -> dict[str, float]:
    """Give the parameters that a simulated log was made with.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    dict of str to float
        Empty for logs of real robots.
    """
    constants = find_group(data, "constant_data")
    return {
        str(name).removeprefix("true_"): float(variable.item())
        for name, variable in constants.data_vars.items()
        if str(name).startswith("true_") and variable.ndim == 0
    }


def log_suffixes(data: Posterior) -> tuple[str, ...]:
    """Give the endings that tell the logs' variables apart: ``("",)`` for one log, ``("_0", "_1", ...)`` for several.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    tuple of str
        Empty when the posterior holds no trajectories.
    """
    names = [str(name) for name in _trajectories(data).data_vars]
    # By number, since "_10" comes before "_2" in the alphabet.
    endings = {name.removeprefix("trajectory") for name in names if name.startswith("trajectory")}
    numbered = sorted(int(ending[1:]) for ending in endings if ending[:1] == "_" and ending[1:].isdecimal())
    return (*([""] if "" in endings else []), *(f"_{number}" for number in numbered))


def trajectory_draws(data: Posterior, log: int = 0) -> xr.DataArray:
    """Give the stored trajectories of one log.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    log : int
        Which log, from 0.

    Returns
    -------
    xarray.DataArray, shape (K, M, T, 3)
        M thinned trajectories of T poses (x [m], y [m], heading [rad], wrapped) for each of K chains.

    Raises
    ------
    PosteriorError
        If the posterior holds no trajectories for this log.
    """
    suffixes = log_suffixes(data)
    if not 0 <= log < len(suffixes):
        raise PosteriorError(
            f"expected the number of a log below {len(suffixes)} (trajectories stored in the posterior), got {log}: "
            "choose another log, or calibrate with trajectories kept"
        )
    return _trajectories(data)[f"trajectory{suffixes[log]}"]


def _trajectories(data: Posterior) -> xr.Dataset:
    """Give the group of trajectories; files of older versions hold them in the group ``posterior``."""
    found = find_group(data, "trajectories")
    return found if found.data_vars else find_group(data, "posterior")
