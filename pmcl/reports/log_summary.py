"""What a page says of the logs that a posterior was inferred from."""

from __future__ import annotations

from typing import NamedTuple

from pmcl.posterior.access import log_contents
from pmcl.posterior.compat import Posterior, find_group
from pmcl.posterior.log_groups import suffixes_for

__all__ = ["LogSummary", "log_summaries"]


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
    contents = log_contents(data)
    summaries = []
    for suffix, held in zip(suffixes_for(len(contents)), contents, strict=True):
        names = (observed.attrs.get(f"log{suffix}", ""), observed.attrs.get(f"source{suffix}", ""))
        length = f"{held.times.size} rows over {held.times[-1] - held.times[0]:.0f} s, {held.readings} readings"
        described = "; ".join(str(part) for part in (*names, length) if part)
        robot = str(observed.attrs.get(f"robot{suffix}", ""))
        summaries.append(LogSummary(robot, described, f"true_pose{suffix}" in constant))
    return tuple(summaries)
