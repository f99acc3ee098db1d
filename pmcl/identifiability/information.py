"""How much a simulated drive would tell about parameters: the curvature of its linearised evidence."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.linearised_evidence import LinearisedEvidence
from pmcl.filtering.particle_filter import make_rng
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import RobotModel
from pmcl.sampling.approximate import curvature_at
from pmcl.sampling.transforms import Unconstrained
from pmcl.simulations.drives import Drive, simulated_pieces

__all__ = ["information_per_row"]

Float = NDArray[np.float64]


def information_per_row(
    drive: Drive, log: RobotLog, path: Float, model: RobotModel, theta: Float, seed: int
) -> Float:
    """Return how much each row of a drive would tell about unconstrained parameters.

    Parameters
    ----------
    drive, log, path, model, theta
        As for :func:`pmcl.simulations.drives.simulated_pieces`.
    seed : int
        All randomness follows from it.

    Returns
    -------
    ndarray, shape (d, d)
        Expected second derivatives of the negative log evidence [nat/row], without the prior, and without directions
        in which it is convex by chance.
    """
    rng = make_rng(np.random.SeedSequence((seed, 37)))
    logs, paths = simulated_pieces(drive, log, path, model, theta, rng)
    if not logs:
        return np.zeros((theta.size, theta.size))
    bound = model.bind(logs)
    transform = Unconstrained(bound.parameters)
    evidence = LinearisedEvidence(bound, theta, paths)
    likelihood = _likelihood(evidence, transform)
    matrix = curvature_at(likelihood, transform.to_line(theta))
    values, vectors = np.linalg.eigh(matrix / (drive.commands.shape[0] * (drive.commands.shape[1] - 1)))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _likelihood(evidence: LinearisedEvidence, transform: Unconstrained) -> Callable[[Float], float]:
    def density(u: Float) -> float:
        with np.errstate(all="ignore"):
            return evidence(transform.from_line(u)[0])

    return density
