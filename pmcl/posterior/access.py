"""Access to a posterior for the rest of pmcl: plain arrays and numbers from labelled groups.

Parameters are the variables of the group ``posterior`` with dimensions (chain, draw) and nothing else, so posteriors
that other programs wrote through ArviZ can be read too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.errors import PosteriorError
from pmcl.models.sensor import sensors
from pmcl.posterior.compat import Posterior, find_group

__all__ = [
    "LogContents",
    "log_contents",
    "log_joint",
    "log_suffixes",
    "parameter_draws",
    "parameter_names",
    "parameter_units",
    "require_numbers",
    "theta_draws",
    "trajectory_draws",
    "true_theta",
]

Float = NDArray[np.float64]

# Far beyond all parameters in SI units; a double still tells numbers of this size apart well enough for pictures.
_GREATEST = 1.0e12


class LogContents(NamedTuple):
    """How much a log held.

    Attributes
    ----------
    times : ndarray, shape (T,)
        Times of its rows [s].
    readings : int
        Ranges and sightings; distance, bearing and size of one sighting count once.
    """

    times: Float
    readings: int


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


def require_numbers(data: Posterior) -> None:
    """Check that all draws of all parameters are finite numbers of possible size.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Raises
    ------
    PosteriorError
        If there are no draws, or with the first one that is no such number.
    """
    for name in parameter_names(data):
        draws = find_group(data, "posterior")[name].values
        if draws.dtype.kind not in "iufb":
            raise PosteriorError(f"expected draws of {name} as numbers, got {draws.dtype}: run 'pmcl calibrate' again")
        bad = np.argwhere(~(np.abs(draws.astype(np.float64)) <= _GREATEST))
        if len(bad):
            chain, draw = (int(k) for k in bad[0])
            raise PosteriorError(
                f"expected draws of {name} within {_GREATEST:g}, got {draws[chain, draw]:g} in draw {draw} of chain "
                f"{chain}: run 'pmcl calibrate' again"
            )


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
    ndarray of shape (K, N), or None when the posterior does not hold it
    """
    statistics = find_group(data, "sample_stats")
    if "lp" not in statistics:
        return None
    return np.asarray(statistics["lp"].values, dtype=np.float64)


def true_theta(data: Posterior) -> dict[str, float]:
    """Return the true parameters of a simulated log.

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
    """Return the suffixes of the logs' variables: ``("",)`` for one log, ``("_0", "_1", ...)`` for several.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    tuple of str
        Empty when the posterior holds no trajectories.
    """
    return _endings(_trajectories(data), "trajectory")


def _endings(group: xr.Dataset, variable: str) -> tuple[str, ...]:
    names = [str(name) for name in group.data_vars]
    # By number, since "_10" comes before "_2" in the alphabet.
    endings = {name.removeprefix(variable) for name in names if name.startswith(variable)}
    numbered = sorted(int(ending[1:]) for ending in endings if ending[:1] == "_" and ending[1:].isdecimal())
    return (*([""] if "" in endings else []), *(f"_{number}" for number in numbered))


def log_contents(data: Posterior) -> tuple[LogContents, ...]:
    """Return the times and the number of readings of each log that the posterior was inferred from.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    tuple of LogContents
        Empty for a posterior of another program.
    """
    observed, constant = find_group(data, "observed_data"), find_group(data, "constant_data")
    # Files of older versions hold odometry, and readings over time and channel, in the group observed_data.
    given = next((group for group in (constant, observed) if any(map(_is_odometry, group.data_vars))), None)
    if given is None:
        return ()
    contents = []
    for suffix in _endings(given, "odometry"):
        places: set[tuple[str, float, object]] = set()
        for sensor_name, sensor in sensors().items():
            held = [str(name).removesuffix(suffix) for name in observed.data_vars]
            for kind in sensor.readings(held):
                if (name := f"{kind}{suffix}") in observed:
                    channel = sensor.declared([kind])[kind].dims[1:]
                    # Kinds of one sensor that are read at the same place, such as distance and bearing, count once.
                    measured = _measured_places(observed[name], kind, channel, suffix)
                    places |= {(sensor_name, *place) for place in measured}
        times = np.asarray(given[f"time{suffix}"].values, dtype=np.float64)
        contents.append(LogContents(times, len(places)))
    return tuple(contents)


def _is_odometry(name: object) -> bool:
    return str(name).startswith("odometry")


def _measured_places(
    readings: xr.DataArray, kind: str, channel: tuple[str, ...], suffix: str
) -> list[tuple[float, object]]:
    """Return time and channel of each reading that was measured; `channel` names the dimensions beside time."""
    if readings.ndim == 2:
        row, column = np.nonzero(~np.isnan(readings.values))
        return list(zip(readings[readings.dims[0]].values[row].tolist(), column.tolist(), strict=True))
    places = (readings[f"{kind}_{name}{suffix}"].values.tolist() for name in ("time", *channel))
    return list(zip(*places, strict=True))


def trajectory_draws(data: Posterior, log: int = 0) -> xr.DataArray:
    """Return the stored trajectories of one log.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    log : int
        Position of the log, from 0.

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
    """Return the group of trajectories; files of older versions hold them in the group ``posterior``."""
    found = find_group(data, "trajectories")
    return found if found.data_vars else find_group(data, "posterior")
