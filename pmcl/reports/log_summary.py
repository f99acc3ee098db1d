"""What a page says of the logs that a posterior was inferred from."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from pmcl.posterior.compat import Posterior, find_group
from pmcl.posterior.log_groups import suffixes_for

__all__ = ["LogSummary", "log_summaries"]

# Channels of one reading: distance and bearing of one sighting count once.
_READINGS = (("range",), ("landmark_range", "landmark_bearing", "landmark_size"))


class LogSummary(NamedTuple):
    """One log in words.

    Attributes
    ----------
    robot : str
        Name of the robot; empty when the log does not tell.
    described : str
        Source, length and number of readings.
    has_truth : bool
        Whether the log holds a reference path.
    """

    robot: str
    described: str
    has_truth: bool


def log_summaries(data: Posterior) -> tuple[LogSummary, ...]:
    """Describe the logs of a posterior.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree

    Returns
    -------
    tuple of LogSummary
        Empty for a posterior of another program.
    """
    observed, constant = find_group(data, "observed_data"), find_group(data, "constant_data")
    numbered = [name for name in observed.data_vars if str(name).startswith("odometry_")]
    if not numbered and "odometry" not in observed:
        return ()
    summaries = []
    for suffix in suffixes_for(max(len(numbered), 1)):
        times = np.asarray(observed[f"time{suffix}"].values, dtype=np.float64)
        readings = sum(_count_readings(observed, channels, suffix) for channels in _READINGS)
        names = (observed.attrs.get(f"log{suffix}", ""), observed.attrs.get(f"source{suffix}", ""))
        length = f"{times.size} rows over {times[-1] - times[0]:.0f} s, {readings} readings"
        described = "; ".join(str(part) for part in (*names, length) if part)
        robot = str(observed.attrs.get(f"robot{suffix}", ""))
        summaries.append(LogSummary(robot, described, f"true_pose{suffix}" in constant))
    return tuple(summaries)


def _count_readings(observed: xr.Dataset, channels: tuple[str, ...], suffix: str) -> int:
    names = [f"{name}{suffix}" for name in channels if f"{name}{suffix}" in observed]
    if not names:
        return 0
    return int(np.logical_or.reduce([~np.isnan(observed[name].values) for name in names]).sum())
