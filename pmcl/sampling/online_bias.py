"""Systematic errors of odometry by online maximum likelihood: recursive, window by window."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine import contract
from pmcl.errors import ModelError, SamplingError
from pmcl.filtering.estimated_path import plausible_theta
from pmcl.filtering.kernels.smc import sensor_terms
from pmcl.filtering.particle_filter import make_rng
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.kalman import KalmanTarget
from pmcl.sampling.near_mode import smoothed_means
from pmcl.sampling.transforms import Unconstrained

__all__ = ["OnlineBias", "bias_parameters", "online_bias"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Differences of the log likelihood are taken over this share of a parameter's prior standard deviation.
_STEP = 0.05
# A change of what the motion expects, or of its noise, below this does not count.
_NOTHING = 1e-12


class OnlineBias(NamedTuple):
    """The end of a recursion.

    Attributes
    ----------
    theta, standard_error : ndarray, shape (d,)
        The estimate; parameters that are no biases have their prior mean and standard deviation.
    names : tuple of str
        The biases.
    history : ndarray, shape (windows, biases)
        The biases after each window.
    """

    theta: Float
    standard_error: Float
    names: tuple[str, ...]
    history: Float


def bias_parameters(bound: BoundModel, references: tuple[Float, ...]) -> Int:
    """Return which parameters change what the motion expects, and neither its noise nor any reading.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    references : tuple of ndarray, shape (T_l, D)
        Paths near the robot's.
    """
    theta, transform = bound.prior_mean(), Unconstrained(bound.parameters)
    u, found = transform.to_line(theta), []
    before = _expectations(bound, theta, references)
    for k in range(bound.dimension):
        moved = u.copy()
        moved[k] += 0.1
        after = _expectations(bound, transform.from_line(moved)[0], references)
        changes = [float(np.abs(new - old).max()) for new, old in zip(after, before, strict=True)]
        if changes[0] > _NOTHING and max(changes[1:]) <= _NOTHING:
            found.append(k)
    return np.array(found, dtype=np.int64)


def _expectations(bound: BoundModel, theta: Float, references: tuple[Float, ...]) -> tuple[Float, Float, Float]:
    """Return how far expected steps are from a path, the precision of their noise, and log densities of readings."""
    steps, noises, readings = [], [], []
    for tables, path in zip(bound.tables(theta), references, strict=True):
        size = path.shape[1]
        for t in range(1, len(path)):
            jacobian, offset, precision = np.zeros((size, size)), np.zeros(size), np.zeros((size, size))
            contract.linearise_transition(tables.motion, t, path[t - 1], path[t], jacobian, offset, precision)
            steps.append(offset)
            noises.append(precision.ravel())
        readings += [sensor_terms(table, np.ascontiguousarray(path.T[None]))[0] for table in tables.sensors]
    return np.array(steps), np.array(noises), np.concatenate(readings)


def online_bias(bound: BoundModel, window: int, decay: float, seed: int) -> OnlineBias:
    """Estimate biases recursively.

    After each window of rows the estimate moves by a Newton step on the log likelihood of the window's readings given
    all before them, and the information that it rests on grows by the window's, after the old one has faded.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    window : int
        Rows of a window.
    decay : float
        By what the information of earlier windows is multiplied at each window; 1 forgets nothing.
    seed : int
        Of the filter from whose path the first linearisation is made.

    Returns
    -------
    OnlineBias

    Raises
    ------
    ModelError
        When the model has no bias of the odometry, or the robot may start anywhere.
    SamplingError
        When a filter loses the robot.
    """
    rng = make_rng(np.random.SeedSequence((seed, 59)))
    theta = bound.prior_mean()
    references = smoothed_means(bound, plausible_theta(bound, rng), rng)
    biased = bias_parameters(bound, references)
    if not biased.size:
        raise ModelError(
            "expected a model with a systematic error of its odometry, but none of "
            f"{', '.join(bound.names)} is one; add an effect such as odometry-turn-scale, or use another method"
        )
    transform, target = Unconstrained(bound.parameters), KalmanTarget(bound, references, unscented=False)
    spread = np.array([float(bound.parameters[k].prior.std()) for k in biased])
    u = transform.to_line(theta)

    def increments(offset: Float) -> list[Float]:
        """Return the filter's shares of each row of each log, with the biases moved by some of their spreads."""
        moved = u.copy()
        moved[biased] += offset * spread
        passes = target.passes(transform.from_line(moved)[0])
        if not passes or not all(math.isfinite(each.log_evidence) for each in passes):
            raise SamplingError(
                "the filter loses the robot while the biases are learnt; use wider noise, or method particle-gibbs"
            )
        return [each.increments for each in passes]

    # In units of the prior's standard deviations, so the prior's information is one.
    information, history = np.eye(biased.size), []
    for number, length in enumerate(bound.lengths):
        for begin in range(0, length, window):
            check_interrupt()
            rows = slice(begin, min(begin + window, length))

            def likelihood(offset: Float, number: int = number, rows: slice = rows) -> float:
                return float(increments(offset)[number][rows].sum())

            gradient, hessian = _derivatives(likelihood, biased.size)
            values, vectors = np.linalg.eigh(-hessian)
            information = decay * information + (vectors * np.maximum(values, 0.0)) @ vectors.T
            u[biased] += spread * np.linalg.solve(information, gradient)
            history.append(transform.from_line(u)[0][biased])
    errors = np.array([float(parameter.prior.std()) for parameter in bound.parameters])
    errors[biased] = spread * np.sqrt(np.diag(np.linalg.inv(information)))
    names = tuple(bound.names[k] for k in biased)
    return OnlineBias(transform.from_line(u)[0], errors, names, np.array(history))


def _derivatives(function: Callable[[Float], float], size: int) -> tuple[Float, Float]:
    """Return gradient (d,) and second derivatives (d, d) of a function at zero, by differences."""
    unit = _STEP * np.eye(size)
    here = function(np.zeros(size))
    ahead = np.array([function(step) for step in unit])
    behind = np.array([function(-step) for step in unit])
    hessian = np.diag(ahead + behind - 2.0 * here)
    for i in range(size):
        for j in range(i):
            both = function(unit[i] + unit[j]) + function(-unit[i] - unit[j])
            apart = function(unit[i] - unit[j]) + function(unit[j] - unit[i])
            hessian[i, j] = hessian[j, i] = 0.25 * (both - apart)
    return (ahead - behind) / (2.0 * _STEP), hessian / _STEP**2
