"""The posterior of theta under a linearised model: its mode, and weighted draws of it.

The log evidence of :mod:`~pmcl.filtering.linearised_evidence` plus the log prior is a density of a few dimensions
that takes some tenth of a millisecond to evaluate. Its mode is found by L-BFGS-B in unconstrained parameters. Around
it, draws of a multivariate t are weighted by the density (importance sampling), so that the prior counts with its
whole shape where the log tells nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from pmcl.filtering.linearised_evidence import LinearisedEvidence
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.transforms import Unconstrained

__all__ = ["TRUST", "WeightedDraws", "curvature_at", "equal_draws", "log_posterior", "mode_of", "weighted_draws"]

Float = NDArray[np.float64]

TRUST = 0.7
"""How far unconstrained parameters may move before the readings are linearised again; for a noise, a factor of two.

The shares of gross errors are frozen with a linearisation. Far from where they were computed, a noise near zero would
seem to explain every reading."""

# What a density of zero counts for L-BFGS-B, which knows no infinity [nat].
_IMPOSSIBLE = 1e10
# Step of second differences in unconstrained parameters (for a noise, 5 %): far below a posterior's width, far above
# rounding errors of evidences of 10^4 nat.
_DIFFERENCE = 0.05
# Least precision of the proposal in any direction: a prior's logarithm has a standard deviation of about one.
_LEAST_PRECISION = 0.25
# Draws of each round, degrees of freedom of the t, by how much it is wider, rounds, and the effective draws that are
# enough: with 300 a standard deviation is known to 4 %.
_DRAWS, _FREEDOM, _WIDER, _ROUNDS, _ENOUGH = 1500, 6.0, 1.2, 4, 300.0


def log_posterior(evidence: LinearisedEvidence, transform: Unconstrained) -> Callable[[Float], float]:
    """Return the function u -> log density of unconstrained parameters, up to a constant.

    Parameters
    ----------
    evidence : LinearisedEvidence
        The log evidence as a function of theta.
    transform : Unconstrained
        The map between theta and u.
    """
    bound = evidence.bound

    def density(u: Float) -> float:
        theta, log_jacobian = transform.from_line(u)
        prior = bound.log_prior(theta)
        if not math.isfinite(prior):
            return -math.inf
        with np.errstate(all="ignore"):
            value = evidence(theta) + prior + log_jacobian
        return value if math.isfinite(value) else -math.inf

    return density


def mode_of(density: Callable[[Float], float], start: Float) -> Float:
    """Return the maximum of a log density within :data:`TRUST` of `start` (d,), by L-BFGS-B.

    Parameters
    ----------
    density : callable
        u (d,) to log density.
    start : ndarray, shape (d,)
        Where to begin, and the centre of the box that is searched.
    """

    def cost(u: Float) -> float:
        return -max(density(np.asarray(u)), -_IMPOSSIBLE)

    bounds = [(value - TRUST, value + TRUST) for value in start.tolist()]
    found = optimize.minimize(cost, start.tolist(), method="L-BFGS-B", bounds=bounds, options={"maxiter": 100})
    return np.asarray(found.x if found.fun < cost(start) else start, dtype=np.float64)


def curvature_at(density: Callable[[Float], float], u: Float) -> Float:
    """Return the negative second derivatives of a log density at u (d,), shape (d, d), by differences.

    Parameters
    ----------
    density : callable
        u (d,) to log density.
    u : ndarray, shape (d,)
        Where.
    """
    size = u.size
    steps = _DIFFERENCE * np.eye(size)
    here = density(u)
    matrix = np.empty((size, size))
    for i in range(size):
        matrix[i, i] = 2.0 * here - density(u + steps[i]) - density(u - steps[i])
        for j in range(i):
            both, neither = density(u + steps[i] + steps[j]), density(u - steps[i] - steps[j])
            first, second = density(u + steps[i] - steps[j]), density(u - steps[i] + steps[j])
            matrix[i, j] = matrix[j, i] = 0.25 * (first + second - both - neither)
    return np.where(np.isfinite(matrix), matrix, 0.0) / _DIFFERENCE**2


class WeightedDraws(NamedTuple):
    """Draws of theta with weights.

    Attributes
    ----------
    u, theta : ndarray, shape (N, d)
        Unconstrained parameters, and parameters.
    weight : ndarray, shape (N,)
        Weights; they sum to one.
    """

    u: Float
    theta: Float
    weight: Float

    @property
    def effective_size(self) -> float:
        """Number of unweighted draws that are worth as much."""
        return float(1.0 / np.vdot(self.weight, self.weight))

    def mean(self) -> Float:
        """Return the mean of theta, (d,)."""
        return np.asarray(self.weight @ self.theta)

    def std(self) -> Float:
        """Return the standard deviation of theta, (d,)."""
        return np.asarray(np.sqrt(self.weight @ (self.theta - self.mean()) ** 2))

    def quantile(self, share: float) -> Float:
        """Return a quantile of theta, (d,).

        Parameters
        ----------
        share : float
            Between 0 and 1.
        """
        order = np.argsort(self.theta, axis=0)
        cumulated = np.cumsum(self.weight[order], axis=0)
        place = np.minimum((cumulated < share).sum(axis=0), self.weight.size - 1)
        columns = np.arange(self.theta.shape[1])
        return np.asarray(self.theta[order[place, columns], columns])

    def moments(self) -> tuple[Float, Float]:
        """Return mean (d,) and covariance (d, d) of u."""
        centre = self.weight @ self.u
        offset = self.u - centre
        return np.asarray(centre), np.asarray((self.weight[:, None] * offset).T @ offset)


def equal_draws(theta: Float, transform: Unconstrained) -> WeightedDraws:
    """Return draws of a chain as draws with equal weights.

    Parameters
    ----------
    theta : ndarray, shape (N, d)
        The draws.
    transform : Unconstrained
        The map between theta and u.
    """
    return WeightedDraws(transform.to_line(theta), theta, np.full(len(theta), 1.0 / len(theta)))


def weighted_draws(
    bound: BoundModel, density: Callable[[Float], float], mode: Float, transform: Unconstrained, seed: int
) -> WeightedDraws:
    """Draw from a log density by importance sampling around its mode.

    Parameters
    ----------
    bound : BoundModel
        The model.
    density : callable
        u (d,) to log density.
    mode : ndarray, shape (d,)
        Its maximum.
    transform : Unconstrained
        The map between theta and u.
    seed : int
        The draws follow from it.

    Returns
    -------
    WeightedDraws
        Of the round with most effective draws; proposals of later rounds have the moments of the draws before.
    """
    rng = np.random.default_rng((seed, 71))
    size = bound.dimension
    values, vectors = np.linalg.eigh(curvature_at(density, mode))
    covariance = (vectors / np.maximum(values, _LEAST_PRECISION)) @ vectors.T
    centre, best = mode, None
    for _ in range(_ROUNDS):
        root = np.linalg.cholesky(_WIDER**2 * covariance)
        stretch = np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, _DRAWS))
        z = rng.standard_normal((_DRAWS, size)) * stretch[:, None]
        u = centre + z @ root.T
        log_proposal = -0.5 * (_FREEDOM + size) * np.log1p(np.einsum("nd,nd->n", z, z) / _FREEDOM)
        log_weight = np.array([density(row) for row in u]) - log_proposal
        weight = np.exp(log_weight - log_weight.max())
        draws = WeightedDraws(u, np.array([transform.from_line(row)[0] for row in u]), weight / weight.sum())
        if best is None or draws.effective_size > best.effective_size:
            best = draws
        if best.effective_size >= _ENOUGH:
            break
        centre, covariance = draws.moments()
        # A few heavy draws must not make the next proposal flat.
        covariance = covariance + 1e-6 * np.eye(size) + np.diag(np.diag(covariance)) * (size / draws.effective_size)
    assert best is not None
    return best
