"""The findings of a model check, in words that describe which readings disagree with the model and how."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pmcl.logs.robot_log import RobotLog
from pmcl.logs.schema import plural_of, variables
from pmcl.posterior.score_statistics import ScoreSeries, duration_of_errors

__all__ = ["Finding", "kind_label", "lost_finding", "named_finding"]


class Finding(NamedTuple):
    """One way in which readings and model disagree.

    Attributes
    ----------
    name : str
        "lost", or the name of a :class:`~pmcl.posterior.score_statistics.Statistic`.
    log : int
        Position of the log, from 0.
    kind : str
        Variable of the log, e.g. "landmark_range"; empty for "lost".
    channels : tuple of int
        Beams or landmarks of a "channel shift"; empty for all together.
    z : float
        The statistic: standard normal when the model is right, but for a longer tail of "lasting".
    p_value : float
        Probability of any deviation as great as this in any statistic when the model is right.
    seconds : float
        How long errors last, for "lasting" and "lasting together"; time at which the robot is lost, for "lost"; else 0.
    message : str
        The finding in words, without the log's number.
    """

    name: str
    log: int
    kind: str
    channels: tuple[int, ...]
    z: float
    p_value: float
    seconds: float
    message: str


def lost_finding(log: int, time: float) -> Finding:
    """Return the finding that the filter loses the robot.

    Parameters
    ----------
    log : int
        Position of the log, from 0.
    time : float
        Time at which the robot is lost [s].
    """
    return Finding("lost", log, "", (), np.inf, 0.0, time, f"the filter loses the robot at t={time:g} s")


def named_finding(
    name: str,
    series: ScoreSeries,
    channels: tuple[int, ...],
    z: float,
    p_value: float,
    number: int,
    log: RobotLog,
) -> Finding:
    """Put the deviation of a statistic into words.

    Parameters
    ----------
    name : str
        Name of the :class:`~pmcl.posterior.score_statistics.Statistic`.
    series : ScoreSeries
        The readings that deviate.
    channels : tuple of int
        Beams or landmarks that deviate, for a "channel shift".
    z, p_value : float
        Its greatest deviation and p-value.
    number : int
        Position of the log, from 0.
    log : RobotLog
        The log itself.

    Returns
    -------
    Finding
    """
    lasts = name.startswith("lasting") and z > 0.0
    seconds = duration_of_errors(series, name) if lasts else 0.0
    channels = channels if name == "channel shift" else ()
    names = _channel_names(channels, series, log)
    if series.sectors:
        channels = tuple(channel for sector in channels for channel in series.sectors[sector])
    message = _sentence(name, series.kind, z, seconds, names)
    return Finding(name, number, series.kind, channels, z, p_value, seconds, message)


def kind_label(kind: str) -> str:
    """Name a kind of reading in the plural, e.g. "landmark bearings"."""
    return plural_of(kind)


def _channel_names(channels: Sequence[int], series: ScoreSeries, log: RobotLog) -> str:
    """Name beams, sectors of beams or landmarks, landmarks as the log names them."""
    dimension = variables([series.kind])[series.kind].dims[-1]
    if series.sectors:
        sectors = [series.sectors[channel] for channel in channels]
        return f"{dimension}s " + " and ".join(f"{sector[0]} to {sector[-1]}" for sector in sectors)
    known = log.dataset.coords[dimension].values if dimension in log.dataset.coords else None
    names = ", ".join(str(channel if known is None else known[channel]) for channel in channels)
    return f"{dimension}{'s' if len(channels) > 1 else ''} {names}"


def _sentence(name: str, kind: str, z: float, seconds: float, channels: str) -> str:
    label = kind_label(kind)
    if name == "lasting":
        return f"errors of {label} " + (f"last about {_rounded(seconds)} s" if z > 0.0 else "alternate in sign")
    if name == "lasting together":
        what = f"the errors that {label} of one time share"
        return f"{what} last about {_rounded(seconds)} s" if z > 0.0 else f"{what} alternate in sign"
    if name == "spread":
        return f"{label} scatter {'more' if z > 0.0 else 'less'} than the model says"
    if name == "shape":
        return f"the errors of {label} have another distribution than the model says"
    if name == "channel shift":
        return f"{label} of {channels} are off on average"
    return f"{label} are on average {'larger' if z > 0.0 else 'smaller'} than the model says"


def _rounded(seconds: float) -> str:
    return f"{seconds:.0f}" if seconds >= 10.0 else f"{seconds:.2g}"
