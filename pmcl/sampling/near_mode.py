"""Where the posterior of theta lies and how wide it is, roughly and within seconds: starts and first proposals.

The model is linearised along a path, and the mode of that model's posterior is found with its curvature; path and mode
are improved by turns. Numbers that come from here decide how long a method needs, not what it finds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.estimated_path import plausible_theta
from pmcl.filtering.linearised_evidence import LinearisedEvidence, improved
from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter
from pmcl.models.robot_model import BoundModel, RobotModel
from pmcl.sampling.approximate import curvature_at, log_posterior, mode_of
from pmcl.sampling.transforms import Unconstrained

__all__ = ["NearMode", "improved_paths", "mode_around", "near_mode", "smoothed_means"]

Float = NDArray[np.float64]

# Particles of the filters whose smoothed paths are the references, and paths of each that are averaged.
_PARTICLES, _PATHS = 1000, 20
# Path and mode are improved by turns until the mode moves by less than _SETTLED, which is a small part of a posterior's
# standard deviation, or _ROUNDS times. A start whose noise was six times too large needed four (robot 3 of MRCLAM 7). A
# step that does not raise the density is halved so often at most: the shares of gross errors are frozen with a
# linearisation, so that it may promise what is not there.
_ROUNDS, _SETTLED, _HALVINGS = 8, 0.03, 3
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
        The most probable path of each log at a theta near the centre.
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


def improved_paths(bound: BoundModel, theta: Float, paths: Sequence[Float]) -> tuple[Float, ...]:
    """Return the most probable path of each log, (T_l, D), found from other paths.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Parameters.
    paths : sequence of ndarray, shape (T_l, D)
        Where the search for each starts.
    """
    model: RobotModel = bound.model
    # Each log's path is improved by itself.
    singles = [bound] if len(bound.logs) == 1 else [model.bind(log) for log in bound.logs]
    return tuple(
        improved(LinearisedEvidence(single, theta, [path]), theta).references[0]
        for single, path in zip(singles, paths, strict=True)
    )


class _Linearised(NamedTuple):
    """The linearised posterior around the most probable path for some parameters.

    Attributes
    ----------
    u : ndarray, shape (d,)
        The parameters, unconstrained.
    references : tuple of ndarray, shape (T_l, D)
        The paths.
    density : callable
        u (d,) to log density; it means something near these parameters.
    value : float
        The log density at these parameters.
    """

    u: Float
    references: tuple[Float, ...]
    density: Callable[[Float], float]
    value: float


def _linearised(bound: BoundModel, transform: Unconstrained, u: Float, paths: Sequence[Float]) -> _Linearised:
    theta = transform.from_line(u)[0]
    references = improved_paths(bound, theta, paths)
    density = log_posterior(LinearisedEvidence(bound, theta, references), transform)
    return _Linearised(u, references, density, density(u))


def mode_around(bound: BoundModel, theta: Float, paths: Sequence[Float]) -> NearMode | None:
    """Find the mode of the posterior that a path belongs to.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Parameters to start from.
    paths : sequence of ndarray, shape (T_l, D)
        Paths to start from.

    Returns
    -------
    NearMode or None
        None where the model has no linearisation there. Cost: some hundred passes of a Kalman smoother.
    """
    transform = Unconstrained(bound.parameters)
    here = _linearised(bound, transform, transform.to_line(theta), paths)
    if not math.isfinite(here.value):
        return None
    for _ in range(_ROUNDS):
        step = mode_of(here.density, here.u) - here.u
        for halving in range(_HALVINGS):
            there = _linearised(bound, transform, here.u + 0.5**halving * step, here.references)
            if there.value > here.value:
                break
        else:
            break
        moved, here = np.abs(there.u - here.u).max(), there
        if moved < _SETTLED:
            break
    density, u, references = here.density, here.u, here.references
    values, vectors = np.linalg.eigh(curvature_at(density, u))
    values = np.clip(values, _MOST_SPREAD**-2, _LEAST_SPREAD**-2)
    return NearMode(u, (vectors / values) @ vectors.T, references)


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
        Cost: some particle filters and some hundred passes of a Kalman smoother.

    Raises
    ------
    FilterError
        When the filter loses the robot whatever the noise.
    """
    rng = make_rng(np.random.SeedSequence((seed, 23)))
    theta = plausible_theta(bound, rng)
    references = smoothed_means(bound, theta, rng)
    found = mode_around(bound, theta, references)
    if found is not None:
        return found
    centre = Unconstrained(bound.parameters).to_line(theta)
    return NearMode(centre, _USUAL_SPREAD**2 * np.eye(centre.size), references)
