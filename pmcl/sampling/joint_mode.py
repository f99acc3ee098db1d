"""The joint mode of path and noise: least squares for the path, closed-form covariances for the noise, in turns."""

# A covariance has its closed form in each turn, as in Khosoussi and Shames: the mean square residual of each Gaussian
# noise (likeliest_along). The paper's covariances are diagonal here, since a model of pmcl has no parameters for the
# rest. gtsam would find the path alone. Its wheel of version 4.3.0 installs and optimises beside numpy 2.4, but it
# weighs 34 MB, brings pytest with it, and needs factors of its own for each sensor, whose slopes pmcl has already: no
# gain.

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import SamplingError
from pmcl.filtering.estimated_path import plausible_theta
from pmcl.filtering.particle_filter import make_rng
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.near_mode import improved_paths, smoothed_means
from pmcl.sampling.point_estimates import likeliest_along, line_hessian, mean_log_joint, standard_errors
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.sampling.transforms import Unconstrained

__all__ = ["joint_mode"]

Float = NDArray[np.float64]

# Noise is kept between these quantiles of its prior: the joint density of path and noise has no bound where a noise
# goes to zero and the path follows what it belongs to exactly.
_LOWEST, _HIGHEST = 0.005, 0.995
# The turns end when no parameter changes by more than this share.
_SETTLED = 1e-4


def joint_mode(
    bound: BoundModel, *, iterations: int, seed: int, stopwatch: Stopwatch
) -> tuple[Float, Float | None, list[str], tuple[Float, ...]]:
    """Maximise the density of path and readings over path and parameters.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    iterations : int
        Turns, at most.
    seed : int
        Of the filter from whose path the first turn starts.
    stopwatch : Stopwatch
        May end the turns.

    Returns
    -------
    theta, standard_error : ndarray, shape (d,)
        Errors are those of a known path; None where there are none.
    held : list of str
        Parameters that ended at the limit of what is allowed.
    paths : tuple of ndarray, shape (T_l, D)
        The paths.

    Raises
    ------
    SamplingError
        When the readings have no probability along the path.
    """
    rng, transform = make_rng(np.random.SeedSequence((seed, 67))), Unconstrained(bound.parameters)
    limits = np.array([parameter.prior.ppf([_LOWEST, _HIGHEST]) for parameter in bound.parameters], dtype=float)
    theta = np.clip(plausible_theta(bound, rng), *limits.T)
    paths = smoothed_means(bound, theta, rng)
    for _ in range(iterations):
        check_interrupt()
        paths = improved_paths(bound, theta, paths)
        new = np.clip(likeliest_along(bound, theta, transform, [path[None] for path in paths]), *limits.T)
        settled = np.allclose(new, theta, rtol=_SETTLED, atol=0.0)
        theta = new
        if settled or stopwatch.now() >= 0.9 * stopwatch.limit:
            break
    stacked = [path[None] for path in paths]
    if not math.isfinite(mean_log_joint(bound, theta, stacked)):
        raise SamplingError("the readings have no probability along the path; use a model with outliers")
    u = transform.to_line(theta)
    information = -line_hessian(lambda value: mean_log_joint(bound, transform.from_line(value)[0], stacked), u)
    held = [name for name, value, limit in zip(bound.names, theta, limits, strict=True) if value in limit]
    return theta, standard_errors(transform, u, information), held, paths
