"""What a calibration is worth on rows that it has not seen: how well a filter with its mean foresees and localizes."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import PmclError
from pmcl.localization.metrics import pose_errors, rmse
from pmcl.localization.offline import localize
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import RobotModel

__all__ = ["HeldOut", "PeakMemory", "held_out_worth", "peak_memory"]

Float = NDArray[np.float64]

# Filters over the whole log, with the same seeds for every method, so that methods differ by their theta alone.
_PASSES, _PARTICLES = 16, 500
# Seconds between two looks at the memory of the process, and bytes of a page of it.
_LOOK = 0.02
_MEGABYTE = 1e6


class HeldOut(NamedTuple):
    """A filter with the mean of a calibration on held-out rows; NaN where it lost the robot.

    Attributes
    ----------
    log_score : float
        Mean log predictive density of a row [nat].
    log_score_error : float
        Standard deviation of that mean over the seeds of the filter [nat].
    position_error : float
        Root mean square error of the position [m]; NaN where the log has no true poses.
    """

    log_score: float
    log_score_error: float
    position_error: float


def held_out_worth(log: RobotLog, model: RobotModel | None, theta: dict[str, float], split: int, seed: int) -> HeldOut:
    """Run filters over a whole log and score its last rows.

    Parameters
    ----------
    log : RobotLog
        The whole log.
    model : RobotModel, optional
        The log's default model when left out.
    theta : dict of str to float
        The parameters.
    split : int
        The first row that counts.
    seed : int
        Of the filters.

    Returns
    -------
    HeldOut
        Cost: some filters of 500 particles.
    """
    scores, squares = [], []
    for number in range(_PASSES):
        try:
            track = localize(log, model, theta=theta, particles=_PARTICLES, seed=seed + number)
        except PmclError:
            return HeldOut(math.nan, math.nan, math.nan)
        scores.append(float(np.mean(track.log_score[split:])))
        if log.true_poses is not None:
            errors = pose_errors(track.dataset["pose_mean"].values[split:], np.array(log.true_poses)[split:])
            squares.append(float(rmse(errors.position)) ** 2)
    position = math.sqrt(np.mean(squares)) if squares else math.nan
    return HeldOut(float(np.mean(scores)), float(np.std(scores, ddof=1) / math.sqrt(_PASSES)), position)


class PeakMemory:
    """By how much the memory of this process grew at most [MB]; NaN where the system does not tell."""

    def __init__(self) -> None:
        self.value = math.nan


@contextmanager
def peak_memory() -> Iterator[PeakMemory]:
    """Look at the resident memory of this process again and again while a method runs."""
    found, done = PeakMemory(), threading.Event()
    before = _resident()

    def look() -> None:
        while not done.wait(_LOOK):
            grown = (_resident() - before) / _MEGABYTE
            found.value = grown if math.isnan(found.value) else max(found.value, grown)

    watcher = threading.Thread(target=look, daemon=True)
    if not math.isnan(before):
        watcher.start()
    try:
        yield found
    finally:
        done.set()
        if watcher.is_alive():
            watcher.join()


def _resident() -> float:
    """Return the resident memory of this process [byte]; NaN on systems without /proc."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
        return float(pages * resource.getpagesize())
    except (OSError, ImportError, ValueError, IndexError):
        return math.nan
