"""What methods share that find one theta: the most likely theta along given paths, and standard errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from pmcl.engine.residuals import GaussianSums
from pmcl.filtering.particle_filter import log_joint
from pmcl.filtering.statistics import block_statistics
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.transforms import Unconstrained

__all__ = ["likeliest_along", "line_hessian", "mean_log_joint", "standard_errors"]

Float = NDArray[np.float64]

# Parameters without a formula are searched for this far around where they are, in unconstrained parameters, along at
# most so many paths: an EM step need not be exact to converge (Meng, Rubin, Biometrika 80, 1993).
_REACH, _SEARCH_PATHS = 1.5, 12
# Step of second differences in unconstrained parameters.
_STEP = 0.05
# What an impossible theta counts for the optimiser, which knows no infinity [nat].
_IMPOSSIBLE = 1e10


def mean_log_joint(bound: BoundModel, theta: Float, paths: Sequence[Float]) -> float:
    """Return the mean of log p(paths, readings | theta) over K paths of each log; -inf where one is impossible.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Parameters.
    paths : sequence of ndarray, shape (K, T_l, D)
        Paths of each log.
    """
    value = 0.0
    for tables, of_log in zip(bound.tables(theta), paths, strict=True):
        value += float(np.mean([log_joint(tables, np.ascontiguousarray(path)) for path in of_log]))
    return value


def likeliest_along(
    bound: BoundModel, theta: Float, transform: Unconstrained, paths: Sequence[Float], *, exact: bool = False
) -> Float:
    """Return the theta that maximises the mean log density of paths and readings: the M step of an EM algorithm.

    Standard deviations of Gaussian residuals have a formula: the root of their mean square. The others are searched
    for, with those held.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Where the search begins.
    transform : Unconstrained
        The map to unconstrained parameters.
    paths : sequence of ndarray, shape (K, T_l, D)
        Paths of each log.
    exact : bool
        Whether the search uses all paths and goes on until nothing changes.

    Returns
    -------
    ndarray, shape (d,)
    """
    theta = theta.copy()
    for _ in range(10 if exact else 1):
        before = theta.copy()
        known = _by_formula(bound, theta, paths)
        rest = np.flatnonzero(~known)
        if not rest.size:
            break
        few = list(paths) if exact else [of_log[:_SEARCH_PATHS] for of_log in paths]
        u = transform.to_line(theta)

        def cost(values: Float, u: Float = u, rest: NDArray[np.int64] = rest, few: list[Float] = few) -> float:
            trial = u.copy()
            trial[rest] = values
            with np.errstate(all="ignore"):
                value = mean_log_joint(bound, transform.from_line(trial)[0], few)
            return -value if math.isfinite(value) else _IMPOSSIBLE

        limits = [(value - _REACH, value + _REACH) for value in u[rest].tolist()]
        found = optimize.minimize(cost, u[rest].tolist(), method="L-BFGS-B", bounds=limits, options={"maxiter": 30})
        u[rest] = found.x
        theta = transform.from_line(u)[0]
        if np.allclose(theta, before, rtol=1e-6, atol=0.0):
            break
    return theta


def _by_formula(bound: BoundModel, theta: Float, paths: Sequence[Float]) -> NDArray[np.bool_]:
    """Set those entries of `theta`, in place, that are standard deviations of Gaussian residuals; return which."""
    counts, squares = np.zeros(theta.size), np.zeros(theta.size)
    tables = bound.tables(theta)
    other = np.zeros(theta.size, dtype=bool)
    for of_logs in zip(*paths, strict=True):
        found, covered = block_statistics(bound, theta, tables, of_logs)
        for statistics in found:
            index = statistics.theta_index  # type: ignore[attr-defined]
            entries = covered[index[index >= 0]]
            if not isinstance(statistics, GaussianSums):
                other[entries] = True
                continue
            np.add.at(counts, entries, statistics.counts[index >= 0])
            np.add.at(squares, entries, statistics.squares[index >= 0])
    known = (counts > 0.0) & (squares > 0.0) & ~other
    theta[known] = np.sqrt(squares[known] / counts[known])
    return np.asarray(known)


def line_hessian(function: Callable[[Float], float], u: Float, step: float = _STEP) -> Float:
    """Return the second derivatives of a function at u (d,), shape (d, d), by differences.

    Parameters
    ----------
    function : callable
        u (d,) to a number.
    u : ndarray, shape (d,)
        Where.
    step : float
        Of the differences.
    """
    size, here = u.size, function(u)
    steps, matrix = step * np.eye(size), np.empty((size, size))
    for i in range(size):
        matrix[i, i] = function(u + steps[i]) + function(u - steps[i]) - 2.0 * here
        for j in range(i):
            both = function(u + steps[i] + steps[j]) + function(u - steps[i] - steps[j])
            apart = function(u + steps[i] - steps[j]) + function(u - steps[i] + steps[j])
            matrix[i, j] = matrix[j, i] = 0.25 * (both - apart)
    return np.asarray(matrix / step**2)


def standard_errors(transform: Unconstrained, u: Float, information: Float) -> Float | None:
    """Return standard errors of theta from the Fisher information of the unconstrained parameters.

    Parameters
    ----------
    transform : Unconstrained
        The map to theta.
    u : ndarray, shape (d,)
        The estimate, in unconstrained parameters.
    information : ndarray, shape (d, d)
        Observed information.

    Returns
    -------
    ndarray, shape (d,), or None
        None where the information is not positive definite, so that the log does not tell the parameters.
    """
    if not np.isfinite(information).all() or np.linalg.eigvalsh(information).min() <= 0.0:
        return None
    spread = np.sqrt(np.diag(np.linalg.inv(information)))
    tiny = 1e-5 * np.eye(u.size)
    slope = [
        (transform.from_line(u + tiny[k])[0][k] - transform.from_line(u - tiny[k])[0][k]) / 2e-5 for k in range(u.size)
    ]
    return np.asarray(np.abs(slope) * spread)
