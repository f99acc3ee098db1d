"""Estimates from the posterior: the mean, the draw of greatest density, random draws, and the mean path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import PosteriorError
from pmcl.geometry import circular_mean, wrap
from pmcl.posterior.access import log_joint, parameter_names, theta_draws, trajectory_draws
from pmcl.posterior.compat import Posterior

__all__ = ["PathSummary", "draws", "map_estimate", "path_summary", "posterior_mean"]

Float = NDArray[np.float64]


class PathSummary(NamedTuple):
    """Summary of the stored trajectories of a log.

    Attributes
    ----------
    times : ndarray, shape (T,)
        Sample times [s].
    mean : ndarray, shape (T, 3)
        Mean poses (x [m], y [m], heading [rad]) in the frame of the map; headings by their circular mean.
    sd : ndarray, shape (T, 3)
        Standard deviations about the mean, m, m, rad.
    """

    times: Float
    mean: Float
    sd: Float


def posterior_mean(data: Posterior) -> dict[str, float]:
    """Posterior mean of each parameter (eq. 18).

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    dict of str to float

    Raises
    ------
    PosteriorError
        If the posterior holds no draws.
    """
    return _named(parameter_names(data), theta_draws(data).mean(axis=(0, 1)))


def map_estimate(data: Posterior) -> dict[str, float]:
    """Parameters of the draw with the greatest joint density of parameters and path (eq. 19).

    Do not quote these numbers as the robot's noise: use the posterior mean and interval. This is no mode of the
    marginal posterior. A density over a whole path is greatest where the path is smoothest, so the noise of the best
    draw is too small and often lies outside the marginal's interval; and the best of some thousand draws differs from
    run to run.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    dict of str to float

    Raises
    ------
    PosteriorError
        If the posterior holds no draws, or not their joint density.
    """
    densities = log_joint(data)
    if densities is None or bool(np.isnan(densities).all()):
        raise PosteriorError(
            "expected the log joint density of each draw as 'lp' in the group 'sample_stats', got none: "
            "use the posterior mean, or a posterior that 'pmcl calibrate' wrote"
        )
    chain, draw = np.unravel_index(int(np.nanargmax(densities)), densities.shape)
    return _named(parameter_names(data), theta_draws(data)[chain, draw])


def draws(data: Posterior, n: int, seed: int) -> list[dict[str, float]]:
    """Take some draws of the parameters, from all chains at random.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    n : int
        Number of draws; no draw is repeated unless there are fewer.
    seed : int
        The same seed gives the same draws.

    Returns
    -------
    list of dict of str to float, length n

    Raises
    ------
    PosteriorError
        If `n` is not positive or the posterior holds no draws.
    """
    if n < 1:
        raise PosteriorError(f"expected to take at least one draw of the posterior, got n={n}: ask for 1 or more")
    names = parameter_names(data)
    flat = theta_draws(data).reshape(-1, len(names))
    chosen = np.random.default_rng(seed).choice(len(flat), size=n, replace=n > len(flat))
    return [_named(names, flat[index]) for index in chosen]


def path_summary(data: Posterior, log: int = 0) -> PathSummary:
    """Mean and spread of the stored trajectories of one log, over all chains.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
    log : int
        Position of the log, from 0.

    Returns
    -------
    PathSummary

    Raises
    ------
    PosteriorError
        If the posterior holds no trajectories for this log.
    """
    stored = trajectory_draws(data, log)
    times = np.asarray(stored[stored.dims[2]].values, dtype=np.float64)
    poses = np.asarray(stored.values, dtype=np.float64).reshape(-1, times.size, 3)
    heading = circular_mean(poses[..., 2].T)
    mean = np.column_stack([poses[..., :2].mean(axis=0), heading])
    turned = wrap(poses[..., 2] - heading)
    sd = np.column_stack([poses[..., :2].std(axis=0), np.sqrt((turned**2).mean(axis=0))])
    return PathSummary(times, mean, sd)


def _named(names: tuple[str, ...], theta: Float) -> dict[str, float]:
    return {name: float(value) for name, value in zip(names, theta, strict=True)}
