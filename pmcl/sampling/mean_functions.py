"""Coefficients of mean functions by regression along the most probable path, in turns with the path itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import ModelError, SamplingError
from pmcl.filtering.estimated_path import plausible_theta
from pmcl.filtering.linearised_evidence import LinearisedEvidence, improved
from pmcl.filtering.particle_filter import make_rng
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.near_mode import smoothed_means
from pmcl.sampling.point_estimates import line_hessian, mean_log_joint
from pmcl.sampling.stopwatch import Stopwatch

__all__ = ["MeanCoefficients", "mean_coefficients", "mean_functions"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Differences are taken over this share of a parameter's prior standard deviation.
_STEP = 0.05
# A log density is a quadratic in a coefficient when its second difference over twice the step foretells that over the
# step to this share of it; noise deviates by percents.
_QUADRATIC = 1e-4
# The turns end when no coefficient changes by more than this share of its prior standard deviation.
_SETTLED = 1e-6


class MeanCoefficients(NamedTuple):
    """The end of the alternation.

    Attributes
    ----------
    theta, standard_error : ndarray, shape (d,)
        The estimate; parameters that are no coefficients have their prior mean and standard deviation. Errors are None
        where the information about the coefficients is not positive definite.
    names : tuple of str
        The coefficients.
    turns : int
        Turns of path and regression.
    """

    theta: Float
    standard_error: Float | None
    names: tuple[str, ...]
    turns: int


def mean_coefficients(bound: BoundModel, theta: Float, paths: tuple[Float, ...]) -> Int:
    """Return which parameters are coefficients of mean functions.

    Along a given path the log density is a quadratic in them, and no function of another kind: that is so where
    residuals are Gaussian and linear in a parameter, and for no standard deviation.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Parameters near which it is asked.
    paths : tuple of ndarray, shape (T_l, D)
        Paths near the robot's.

    Returns
    -------
    ndarray of int
    """
    stacked, found = [path[None] for path in paths], []
    for k, parameter in enumerate(bound.parameters):
        step = _STEP * _spread(parameter.prior)
        values = []
        for factor in (-2.0, -1.0, 0.0, 1.0, 2.0):
            moved = theta.copy()
            moved[k] += factor * step
            with np.errstate(all="ignore"):
                possible = math.isfinite(bound.log_prior(moved))
                values.append(mean_log_joint(bound, moved, stacked) if possible else math.nan)
        near, far = values[3] + values[1] - 2.0 * values[2], values[4] + values[0] - 2.0 * values[2]
        odd = (values[4] - values[0]) - 2.0 * (values[3] - values[1])
        # Beside the size of the density its differences have rounding errors.
        rounding = 1e-12 * abs(values[2])
        if near < -rounding and max(abs(far - 4.0 * near), abs(odd)) <= _QUADRATIC * abs(near) + 20.0 * rounding:
            found.append(k)
    return np.array(found, dtype=np.int64)


def _spread(prior: object) -> float:
    spread = float(prior.std())  # type: ignore[attr-defined]
    return spread if math.isfinite(spread) else 1.0


def mean_functions(bound: BoundModel, *, iterations: int, seed: int, stopwatch: Stopwatch) -> MeanCoefficients:
    """Estimate coefficients of mean functions of motion and sensors, with noise held at its prior mean.

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
    MeanCoefficients
        Cost: for each turn, some Gauss-Newton steps on the path and d^2 densities of it.

    Raises
    ------
    ModelError
        When the model has no such coefficient.
    SamplingError
        When the readings have no probability along the path.
    FilterError
        When the first filter loses the robot.
    """
    rng, theta = make_rng(np.random.SeedSequence((seed, 73))), bound.prior_mean()
    paths = smoothed_means(bound, plausible_theta(bound, rng), rng)
    chosen = mean_coefficients(bound, theta, paths)
    if not chosen.size:
        raise ModelError(
            "expected a model with coefficients of a mean function of motion or sensors, in which Gaussian residuals "
            f"are linear, but none of {', '.join(bound.names)} is one; add an effect such as odometry-forward-scale or "
            "landmark-range-bias, leave out outliers, or use another method"
        )
    spread = np.array([_spread(bound.parameters[k].prior) for k in chosen])
    # Each log's path is improved by itself.
    singles = [bound if len(bound.logs) == 1 else bound.model.bind(log) for log in bound.logs]

    def at(shift: Float) -> Float:
        moved = theta.copy()
        moved[chosen] += shift * spread
        return moved

    def turn(shift: Float) -> Float:
        nonlocal paths
        check_interrupt()
        here = at(shift)
        paths = tuple(
            improved(LinearisedEvidence(single, here, [path]), here).references[0]
            for single, path in zip(singles, paths, strict=True)
        )
        stacked = [path[None] for path in paths]

        def density(moved: Float) -> float:
            return mean_log_joint(bound, at(moved), stacked) + bound.log_prior(at(moved))

        return shift + _newton_step(density, shift)

    shift, turns = _accelerated(turn, np.zeros(chosen.size), iterations, stopwatch)
    errors: Float | None = np.array([_spread(parameter.prior) for parameter in bound.parameters])
    evidence = LinearisedEvidence(bound, at(shift), paths)
    information = -line_hessian(lambda moved: evidence(at(moved)) + bound.log_prior(at(moved)), shift, _STEP)
    if errors is not None and np.isfinite(information).all() and np.linalg.eigvalsh(information).min() > 0.0:
        errors[chosen] = spread * np.sqrt(np.diag(np.linalg.inv(information)))
    else:
        errors = None
    return MeanCoefficients(at(shift), errors, tuple(bound.names[k] for k in chosen), turns)


def _newton_step(function: Callable[[Float], float], here: Float) -> Float:
    """Return the step to the maximum of a function that is nearly a quadratic, by differences."""
    hessian = line_hessian(function, here, _STEP)
    unit = _STEP * np.eye(here.size)
    gradient = np.array([function(here + row) - function(here - row) for row in unit]) / (2.0 * _STEP)
    if not (np.isfinite(hessian).all() and np.isfinite(gradient).all()) or np.linalg.eigvalsh(hessian).max() >= 0.0:
        raise SamplingError(
            "the readings have no probability along the path, or not all coefficients are told; use narrower priors"
        )
    return np.asarray(np.linalg.solve(-hessian, gradient))


def _accelerated(
    function: Callable[[Float], Float], start: Float, iterations: int, stopwatch: Stopwatch
) -> tuple[Float, int]:
    """Find a fixed point by Anderson's acceleration with d + 1 earlier points; return it and the turns made.

    A map of d numbers that is linear ends after d + 1 turns, whatever the rate of plain iteration.
    """
    points: list[Float] = []
    images: list[Float] = []
    here, turns = start, 0
    while turns < iterations:
        turns += 1
        points.append(here)
        images.append(function(here))
        points, images = points[-start.size - 2 :], images[-start.size - 2 :]
        residuals = np.array(images) - np.array(points)
        if np.abs(residuals[-1]).max() < _SETTLED or stopwatch.now() >= 0.7 * stopwatch.limit:
            break
        here = images[-1]
        if len(points) > 1:
            # The combination of points, weights of sum one, whose residual is least.
            differences = residuals[:-1] - residuals[-1]
            weight, *_ = np.linalg.lstsq(differences.T, -residuals[-1], rcond=1e-10)
            here = images[-1] + weight @ (np.array(images[:-1]) - images[-1])
    return images[-1], turns
