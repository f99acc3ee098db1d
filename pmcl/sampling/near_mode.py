"""Where the posterior of theta lies and how wide it is, roughly and within seconds: starts and first proposals.

The model is linearised along a smoothed path, and the mode of that model's posterior is found with its curvature.
Numbers that come from here decide how long a method needs, not what it finds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import FilterError, ModelError
from pmcl.filtering.estimated_path import plausible_theta
from pmcl.filtering.linearised_evidence import LinearisedEvidence
from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.approximate import curvature_at, log_posterior, mode_of
from pmcl.sampling.transforms import Unconstrained

__all__ = ["NearMode", "near_mode", "smoothed_means"]

Float = NDArray[np.float64]

# Particles of the filters whose smoothed paths are the references, and paths of each that are averaged.
_PARTICLES, _PATHS = 1000, 20
# How often the model is linearised: at a plausible theta, and at the modes found with it.
_ROUNDS = 3
# The standard deviation in any direction, in unconstrained parameters, is taken to lie between these: a curvature that
# is not positive tells nothing, and a prior's logarithm has a standard deviation of about one.
_LEAST_SPREAD, _MOST_SPREAD = 0.005, 1.0
# What it is taken to be where the model cannot be linearised.
_USUAL_SPREAD = 0.2


class NearMode(NamedTuple):
    """A Gaussian near the posterior.

    Attributes
    ----------
    centre : ndarray, shape (d,)
        Its centre, in unconstrained parameters.
    covariance : ndarray, shape (d, d)
        Its covariance.
    references : tuple of ndarray, shape (T_l, D)
        A smoothed path of each log at a theta near the centre.
    """

    centre: Float
    covariance: Float
    references: tuple[Float, ...]


def smoothed_means(bound: BoundModel, theta: Float, rng: np.random.Generator) -> tuple[Float, ...]:
    """Return the mean of some smoothed paths of each log, (T_l, D).

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Parameters.
    rng : numpy.random.Generator
        Source of randomness.

    Raises
    ------
    FilterError
        When the filter loses the robot.
    """
    means = []
    for tables, length in zip(bound.tables(theta), bound.lengths, strict=True):
        filtered = run_filter(tables, length, _PARTICLES, rng)
        means.append(np.ascontiguousarray(draw_paths(tables, filtered, _PATHS, rng).mean(axis=0)))
    return tuple(means)


def near_mode(bound: BoundModel, seed: int) -> NearMode:
    """Find the posterior roughly.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    seed : int
        All randomness follows from it.

    Returns
    -------
    NearMode
        Cost: a dozen particle filters and some hundred passes of a Kalman smoother.

    Raises
    ------
    FilterError
        When the filter loses the robot whatever the noise.
    """
    rng = make_rng(np.random.SeedSequence((seed, 23)))
    transform = Unconstrained(bound.parameters)
    theta = plausible_theta(bound, rng)
    references = smoothed_means(bound, theta, rng)
    density = None
    for _ in range(_ROUNDS):
        found = log_posterior(LinearisedEvidence(bound, theta, references), transform)
        u = transform.to_line(theta)
        if not math.isfinite(found(u)):
            break
        density, mode = found, mode_of(found, u)
        try:
            new = transform.from_line(mode)[0]
            bound.check(new)
            references = smoothed_means(bound, new, rng)
        except (FilterError, ModelError):
            # Noise that fits the linearised model better may be too sharp for so few particles.
            break
        theta = new
    centre = transform.to_line(theta)
    if density is None:
        return NearMode(centre, _USUAL_SPREAD**2 * np.eye(centre.size), references)
    values, vectors = np.linalg.eigh(curvature_at(density, centre))
    values = np.clip(values, _MOST_SPREAD**-2, _LEAST_SPREAD**-2)
    return NearMode(centre, (vectors / values) @ vectors.T, references)
