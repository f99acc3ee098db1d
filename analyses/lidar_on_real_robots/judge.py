"""How filters are judged: by where the robot was, and by how well each foresaw the next scan.

The weights of nav2's default are no density of a scan, so filters cannot be compared by their own weights. Here all are
asked the same: given the particles before a scan, how likely is that scan? The answer uses one observation model for
all, the beam model (each reading by itself a normalised density), whose five numbers are fitted by maximum likelihood
at the reference poses of the *other* part of the drive. No filter has a say in it.

Readings of one scan are not independent, so two scores are computed. The score of single readings,
sum_b log mean_i p(z_b | x_i), needs no independence: each reading is foreseen by itself. The score of whole scans,
log mean_i prod_b p(z_b | x_i), takes them as independent given the pose.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from scipy.optimize import minimize
from scipy.special import logsumexp, softmax

from pmcl.geometry import wrap
from pmcl.localization.metrics import nees
from pmcl.logs.robot_log import RobotLog
from pmcl.models.sensors.lidar.geometry import end_points_along, lengths_along
from pmcl.models.sensors.lidar.kernels.beam import beam_logpdf, expected_range
from pmcl.models.sensors.lidar.sensor import Lidar

ELLIPSE = 5.991464547107979
"""The 95 % quantile of a chi-square distribution with two degrees of freedom."""
JUDGED_PARTICLES = 250
REFERENCE = 0.01**2 * np.eye(3)
"""Covariance of the reference poses of Jarvis, 1 cm squared: 4 mm are the system's own, the rest is how it was put into
the map's frame. It is added to each filter's covariance: no filter is blamed for what the reference does not know."""
LOST = 0.5
"""A filter whose last estimate is off by more than this [m] has lost the robot."""


@numba.njit(nogil=True)
def log_densities(reading, lengths, max_range, std, z_hit, z_short, z_max, z_rand, rate):
    result = np.zeros(lengths.shape)
    for i in range(lengths.shape[0]):
        for b in range(lengths.shape[1]):
            z = reading[b]
            if not np.isnan(z):
                expected = expected_range(lengths[i, b], 1.0, 0.0, max_range[b])
                result[i, b] = beam_logpdf(z, expected, max_range[b], std, z_hit, z_short, z_max, z_rand, rate)
    return result


class Judge(NamedTuple):
    """The table of the judged log's scans under the beam model, and the five numbers."""

    table: object
    numbers: tuple[float, ...]

    def of_row(self, t: int, particles) -> np.ndarray:
        """Log densities (n, R) of the readings of row t for each particle; 0 for what was not measured."""
        lengths = lengths_along(self.table, particles)
        return log_densities(self.table.reading[t], lengths, self.table.max_range, *self.numbers)

    def scores(self, t: int, particles) -> tuple[float, float]:
        """Scores of single readings, summed, and of the whole scan [nat]."""
        each = self.of_row(t, particles)
        n = np.log(len(particles))
        return float((logsumexp(each, axis=0) - n).sum()), float(logsumexp(each.sum(axis=1)) - n)


def beam_table(log: RobotLog):
    return Lidar(model="beam", max_beams=60).bind(log).base


def fit_judge(other: RobotLog, judged: RobotLog) -> Judge:
    """Fit the five numbers at the reference poses of `other`, for judging filters on `judged`."""
    table = beam_table(other)
    known = np.isfinite(other.true_poses).all(axis=1)
    lengths = lengths_along(table, other.true_poses)

    def numbers(x):
        z_hit, z_short, z_max, z_rand = softmax([0.0, *x[1:4]])
        return np.exp(x[0]), z_hit, z_short, z_max, z_rand, np.exp(x[4])

    def loss(x):
        found = numbers(x)
        total = 0.0
        for t in np.flatnonzero(known):
            total -= log_densities(table.reading[t], lengths[t : t + 1], table.max_range, *found).sum()
        return total

    start = np.array([np.log(0.05), -3.0, -4.0, -3.0, np.log(0.5)])
    best = minimize(loss, start, method="Nelder-Mead", options={"maxiter": 4000, "fatol": 1e-3, "xatol": 1e-3})
    return Judge(beam_table(judged), tuple(float(value) for value in numbers(best.x)))


def share_near_walls(log: RobotLog, near: float = 0.1) -> float:
    """Share of readings with an echo that end within `near` [m] of an occupied cell, at the reference poses."""
    table = Lidar(max_beams=60).bind(log).base
    levels = end_points_along(table, log.true_poses)
    return float(np.mean(table.level_distance[levels[levels >= 0]] < near))


def log_density_of_truth(mean, covariance, truth):
    """Log density of the reference positions under Gaussians with these means and covariances [nat], (T,)."""
    block = covariance[:, :2, :2]
    return -0.5 * nees(mean, covariance, truth) - 0.5 * np.log(np.linalg.det(block)) - np.log(2.0 * np.pi)


def errors(mean, covariance, truth, lost: float = LOST) -> dict[str, float]:
    """Errors of a track, the share of rows whose true position is in the 95 % ellipse, and whether it is lost.

    `covariance` is the filter's and the reference's together.
    """
    off = np.hypot(*(mean - truth)[:, :2].T)
    return {
        "position_rmse": float(np.sqrt(np.nanmean(off**2))),
        "position_worst": float(np.nanmax(off)),
        "heading_rmse": float(np.sqrt(np.nanmean(wrap(mean[:, 2] - truth[:, 2]) ** 2))),
        "coverage_95": float(np.mean(nees(mean, covariance, truth) <= ELLIPSE)),
        "lost": int(off[-1] > lost),
    }


def ellipse_radius(covariance) -> float:
    """Root mean square of the belief's standard deviation along an axis [m]."""
    return float(np.sqrt(np.mean(np.trace(covariance[:, :2, :2], axis1=1, axis2=2) / 2.0)))
