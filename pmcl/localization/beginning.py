"""Where a robot began whose first pose was unknown: all of its readings tell, once they have told where it ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmcl import defaults
from pmcl.errors import FilterError
from pmcl.geometry import inverse
from pmcl.localization.offline import localize
from pmcl.localization.options import FilterOptions
from pmcl.localization.track import Track
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.starts.belief import StartBelief
from pmcl.posterior.compat import Posterior

__all__ = ["with_found_start"]

Float = NDArray[np.float64]

# A place is known when its standard deviations are at most these [m], [rad]: half the width of a corridor.
_KNOWN_PLACE, _KNOWN_HEADING = 1.0, 0.3
# The found belief is this many times as wide as what the readings say, since whoever uses it reads the same readings
# again; and at least as wide as a start that a person states.
_WIDER, _LEAST_STD = 2.0, (0.1, 0.1, 0.1)


def with_found_start(
    log: RobotLog,
    track: Track,
    model: RobotModel | None = None,
    posterior: Posterior | None = None,
    method: str = "mean",
    *,
    theta: Mapping[str, float] | None = None,
    particles: int = defaults.LOCALIZATION_PARTICLES,
    seed: int = 0,
) -> RobotLog:
    """Return a log with the belief about its first pose that a whole track gives, so that it can be calibrated.

    A filter that begins anywhere on a map knows where the robot is after some rows, not where it began. So a second
    filter runs over the log backwards, to the first row, from the last one at which the track knows the place.

    Parameters
    ----------
    log : RobotLog
        The log that was localized.
    track : Track
        What :func:`pmcl.localization.offline.localize` returned for it.
    model, posterior, method, theta, particles, seed
        As for :func:`pmcl.localization.offline.localize`.

    Returns
    -------
    RobotLog
        The same log with another ``start_mean`` and ``start_std``: twice as wide as what the readings say, as a
        calibration reads them again, and at least 0.1 m and 0.1 rad.

    Raises
    ------
    FilterError
        When the track never knows the place within 1 m and 0.3 rad, or the backward filter loses the robot.
    """
    std = np.sqrt(np.diagonal(track.pose_cov, axis1=1, axis2=2))
    known = np.flatnonzero((std[:, :2].max(axis=1) <= _KNOWN_PLACE) & (std[:, 2] <= _KNOWN_HEADING))
    if not known.size:
        x, y, heading = std[-1]
        raise FilterError(
            f"{log.where}: expected a track that gets to a known place, to look from there for where the robot began, "
            f"but it ends with standard deviations of {x:.2g} m, {y:.2g} m and {heading:.2g} rad; use more particles, "
            "recovery, or a longer log"
        )
    last = int(known[-1])
    model = replace(default_model(log) if model is None else model, start=StartBelief())
    backward = localize(
        _backwards(log, last, track.pose_mean[last], np.maximum(std[last], _LEAST_STD)), model, posterior, method,
        theta=theta, particles=particles, seed=seed, options=FilterOptions(),
    )  # fmt: skip
    found = np.maximum(_WIDER * np.sqrt(np.diagonal(backward.pose_cov[-1])), _LEAST_STD)
    return log.select(0, log.n_steps, start_mean=backward.pose_mean[-1], start_std=found)


def _backwards(log: RobotLog, last: int, start_mean: Float, start_std: Float) -> RobotLog:
    """Return the log of a robot that drives the same way back from a row, and reads the same at the same places."""
    dataset = log.without_truth().dataset.isel(time=slice(last, None, -1))
    steps = np.zeros((last + 1, 3))
    steps[1:] = inverse(log.odometry[last:0:-1])
    times = log.times[last] - log.times[last::-1]
    odometry = dataset["odometry"].copy(data=steps)
    dataset = dataset.assign(odometry=odometry).assign_coords(time=("time", times, dataset["time"].attrs))
    whole = RobotLog.trusted(dataset, f"{log.where} backwards", log.grid_map)
    return whole.select(0, last + 1, start_mean=start_mean, start_std=start_std)
