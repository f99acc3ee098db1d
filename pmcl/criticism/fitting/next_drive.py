"""What to record next where a log cannot tell effects from each other.

For each of some drives of two minutes and each explanation, the drive is simulated under that explanation, and the log
densities of what would be read are compared under all of them. The parameters of each explanation stay those that the
log has given it. The drive that is recommended is the one that tells the most probable explanation most surely from the
others, on average: two of them may be one and the same, as a sensor that is turned and a bias of all bearings are.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import special

from pmcl.criticism.fitting.trials import Trial
from pmcl.errors import DensityError, PmclError
from pmcl.filtering.particle_filter import make_rng, run_filter
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import BoundModel
from pmcl.simulations.drives import Drive, drives_for, moves_sideways, simulated_pieces
from pmcl.streams import stream, stream_seed

__all__ = ["SECONDS", "NextDrive", "chances_of_telling", "next_drive"]

Float = NDArray[np.float64]

SECONDS = 120.0
"""How long the drives are that are compared [s]."""
TOLD = 0.9
"""An explanation is told from another one where, both alike probable before, it has this probability afterwards."""

# A piece of a drive begins at a pose that is known no better than this [m, m, rad], so that a heading which is off by
# as much as a sensor's mount is nothing unusual; its first rows find the pose, and only the others count.
_START_STD, _FINDING = (0.3, 0.3, 0.3), 5
# How often each drive is simulated: its pieces are then some four times as many as two minutes have.
_TIMES = 4


class NextDrive(NamedTuple):
    """The drive that would tell explanations of a log apart.

    Attributes
    ----------
    name : str
        What to drive, e.g. "turn in place, both ways".
    seconds : float
        For how long [s].
    probabilities : tuple of float
        Probabilities that it tells the first explanation from each of the others, whichever of the two is true.
    """

    name: str
    seconds: float
    probabilities: tuple[float, ...]


def next_drive(trials: Sequence[Trial], log: RobotLog, *, particles: int, seed: int) -> NextDrive | None:
    """Return the drive that would tell best the first of some explanations from the others.

    Parameters
    ----------
    trials : sequence of Trial
        Fits of the explanations to the log, at least two, the most probable first.
    log : RobotLog
        The log; drives stay at places that it has visited, at its speeds.
    particles : int
        Particles of each filter pass.
    seed : int
        Determines all random numbers.

    Returns
    -------
    NextDrive or None
        None where no drive can be simulated.

    Notes
    -----
    Pieces of a drive are independent. The log of the ratio of two densities of what a drive reads is nearly normal: its
    mean and variance are those of a piece, times the number of pieces.
    """
    best = trials[0]
    if best.fit.path.shape[1] < 3:  # its state is no pose
        return None
    chances: dict[Drive, tuple[float, ...]] = {}
    for drive in drives_for(log, best.fit.path, sideways=moves_sideways(log, best.model)):
        try:
            chances[drive] = chances_of_telling(drive, trials, log, particles=particles, seed=seed)
        except DensityError:
            raise
        except PmclError:  # a sensor that cannot be simulated, or a filter that loses the robot
            continue
    if not chances:
        return None
    drive = max(chances, key=lambda one: sum(chances[one]))
    return NextDrive(drive.name, SECONDS, chances[drive])


def chances_of_telling(
    drive: Drive, trials: Sequence[Trial], log: RobotLog, *, particles: int, seed: int
) -> tuple[float, ...]:
    """Return the probabilities that :data:`SECONDS` of a drive tell the first explanation from each of the others.

    Of each pair it is the less of two probabilities, for either of them may be the true one.

    Parameters
    ----------
    drive : Drive
        The drive.
    trials, log, particles, seed
        As for :func:`next_drive`.

    Raises
    ------
    PmclError
        When the drive cannot be simulated, or a filter loses the robot.
    """
    first, *others = trials
    return tuple(
        min(
            _chance(drive, truth, wrong, log, particles, stream_seed(seed, "drive that separates", number))
            for truth, wrong in ((first, other), (other, first))
        )
        for number, other in enumerate(others)
    )


def _chance(drive: Drive, truth: Trial, wrong: Trial, log: RobotLog, particles: int, seed: int) -> float:
    """Return the probability that a drive under one explanation tells it from another one."""
    rng = make_rng(stream(seed, "drive"))
    logs, _ = simulated_pieces(drive, log, truth.fit.path, truth.model, truth.fit.theta, rng, _START_STD, _TIMES)
    if len(logs) < 2:
        return 0.0
    right, other = (_densities(each.model.bind(logs), each.fit.theta, particles, seed) for each in (truth, wrong))
    gain = right - other
    period = float(np.median(np.diff(log.times)))
    pieces = SECONDS / period / (drive.commands.shape[1] - _FINDING)
    # The mean of the pieces is not known exactly either.
    std = math.sqrt(pieces * (1.0 + pieces / gain.size)) * float(gain.std(ddof=1))
    above = pieces * float(gain.mean()) - float(special.logit(TOLD))
    return float(special.ndtr(above / std)) if std > 0.0 else float(above > 0.0)


def _densities(bound: BoundModel, theta: Float, particles: int, seed: int) -> Float:
    """Return the log density of the readings of each piece, by filters with common random numbers."""
    return np.array([
        run_filter(tables, length, particles, make_rng(stream(seed, "filter of a piece", k)))
        .log_increments[_FINDING:]
        .sum()
        for k, (tables, length) in enumerate(zip(bound.tables(theta), bound.lengths, strict=True))
    ])  # fmt: skip
