"""Evidence of an effect from the draws of a fit that has it, without a filter: the Savage-Dickey density ratio.

A model without an effect is the model with it at strength zero. The Bayes factor of the two is therefore the density of
the strength at zero before the log was seen, over that after it (Dickey 1971, The weighted likelihood ratio, linear
hypotheses on normal location parameters, Annals of Mathematical Statistics 42). A chain gives the latter, and no noise
of particles comes in. It has to be known where the chain hardly comes, so that the ratio serves for effects that are
not far from none: just where noise of particles would decide.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.models.effects.effect import Effect

__all__ = ["NestedEvidence", "nested_evidence"]

Float = NDArray[np.float64]

# Further from no effect than this [standard deviations], the posterior's tail at no effect is not known well enough: it
# is heavier than a normal's, which was 0.8 nats off at 3.3 standard deviations (tests/criticism/test_evidence.py).
_FARTHEST = 3.0
# Draws of a chain for one that is worth as much as an independent one (transport moves make them nearly independent).
_DRAWS_PER_INDEPENDENT = 1.5
# Normal approximations are wrong by so much in any case [nat].
_LEAST_NOISE = 0.2


class NestedEvidence(NamedTuple):
    """Log evidence of an effect over none, from draws.

    Attributes
    ----------
    value : float
        The log evidence [nat].
    noise : float
        Its standard deviation [nat].
    of_weight : bool
        Whether the effect may be the weight of a mixture. A few readings that are impossible without it take the
        density at zero down to nothing, which the draws do not show: the evidence is then far greater than this.
    """

    value: float
    noise: float
    of_weight: bool = False


def nested_evidence(fit: Fit, effect: Effect, free: NDArray[np.bool_]) -> NestedEvidence | None:
    """Return the evidence of a model's newest effect over the same model without it.

    Parameters
    ----------
    fit : Fit
        The fit of the model.
    effect : Effect
        Its newest effect.
    free : ndarray of bool, shape (k,)
        Which of the effect's parameters are fitted; they are the last of the model.

    Returns
    -------
    NestedEvidence or None
        None where the draws cannot tell: far from no effect, without a free strength, and where the prior has no
        density at no effect.
    """
    strengths = [k for k in effect.strengths if free[k]]
    if not strengths:
        return None
    prior = sum(float(effect.parameters[k].prior.logpdf(effect.null[k])) for k in strengths)
    if not np.isfinite(prior):
        return None
    position = np.cumsum(free) - 1 - int(free.sum())
    draws = np.column_stack([fit.draws[:, position[k]] - effect.null[k] for k in strengths])
    if effect.squared:
        posterior = _of_square(draws[:, 0], effect, strengths[0], prior) if len(strengths) == 1 else None
    elif any(effect.one_sided(k) for k in strengths):
        posterior = _log_density_at_bound(np.abs(draws[:, 0])) if len(strengths) == 1 else None
    else:
        posterior = _log_density_at_zero(draws)
    if posterior is None:
        return None
    independent = len(draws) / _DRAWS_PER_INDEPENDENT
    noise = np.hypot(_LEAST_NOISE, posterior.distance**2 / np.sqrt(2.0 * independent))
    of_weight = not effect.squared and any(effect.one_sided(k) for k in strengths)
    return NestedEvidence(prior - posterior.log_density, float(noise), of_weight)


class _AtZero(NamedTuple):
    """Log density of draws at zero, and how far they are from it [standard deviations]."""

    log_density: float
    distance: float


def _log_density_at_zero(draws: Float) -> _AtZero | None:
    """Return the density at zero of a normal with the moments of some draws, (N, k); None if that is far away."""
    mean, covariance = draws.mean(axis=0), np.atleast_2d(np.cov(draws.T))
    sign, log_determinant = np.linalg.slogdet(2.0 * np.pi * covariance)
    if sign <= 0.0:
        return None
    squared = float(mean @ np.linalg.solve(covariance, mean))
    if squared > _FARTHEST**2:
        return None
    return _AtZero(-0.5 * (squared + float(log_determinant)), float(np.sqrt(squared)))


def _of_square(draws: Float, effect: Effect, strength: int, log_prior: float) -> _AtZero | None:
    """Return the density at zero of draws (N,) of a strength that enters through its square; None if that is far away.

    The likelihood is about a normal of the square v, and flat in the strength s itself near zero. With weights
    w = 2 s / prior(s), the draws are those of a prior that is flat in v. The density of s at zero is then prior(0)
    times the density of v at zero, times the mean of w.
    """
    size = np.abs(draws)
    weight = 2.0 * size / np.exp(effect.parameters[strength].prior.logpdf(effect.null[strength] + draws))
    if not weight.sum() > 0.0 or not np.isfinite(weight).all():
        return None
    of_square = _log_density_at_bound(size**2, weight)
    if of_square is None:
        return None
    return of_square._replace(log_density=log_prior + of_square.log_density + float(np.log(weight.mean())))


def _log_density_at_bound(draws: Float, weight: Float | None = None) -> _AtZero | None:
    """Return the density at zero of a normal, cut at zero, with the moments of some draws, (N,); None if far away."""
    mean = float(np.average(draws, weights=weight))
    std = float(np.sqrt(np.average((draws - mean) ** 2, weights=weight) * draws.size / (draws.size - 1)))
    if not std > 0.0 or mean > _FARTHEST * std:
        return None

    def ratio(a: float) -> float:
        """Mean over standard deviation of a normal with mean a and standard deviation one, cut at zero."""
        slope = _slope(a)
        return float((a + slope) / np.sqrt(1.0 - a * slope - slope**2))

    lowest = -20.0  # nearly an exponential distribution
    a = lowest if mean / std <= ratio(lowest) else optimize.brentq(lambda a: ratio(a) - mean / std, lowest, 6.0)
    scale = mean / (a + _slope(a))
    return _AtZero(float(np.log(_slope(a) / scale)), max(float(a), 0.0))


def _slope(a: float) -> float:
    """Return the density of a standard normal at a, over its distribution function."""
    return float(np.exp(-0.5 * a * a - 0.5 * np.log(2.0 * np.pi) - special.log_ndtr(a)))
