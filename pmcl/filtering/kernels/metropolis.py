"""The Metropolis block of eq. 17 on statistics of a trajectory, one dimension at a time."""

from __future__ import annotations

import math

import numpy as np
from numba import types

from pmcl.engine.compile import entry, kernel, overload_for_types
from pmcl.engine.residuals import theta_logpdf

__all__ = ["log_prior", "metropolis_block"]


@kernel
def _depends(theta_index, k):
    found = False
    for position in range(theta_index.size):
        found |= theta_index[position] == k
    return found


@kernel
def log_prior(priors, k, x):
    """Return the log prior density of parameter `k` at `x`; see :class:`~pmcl.models.parameters.PriorTable`."""
    family, a, b = priors.family[k], priors.shape_a[k], priors.shape_b[k]
    y = (x - priors.loc[k]) / priors.scale[k]
    value = priors.constant[k]
    if family == 0:
        return value - 0.5 * y * y
    if y <= 0.0 or ((family == 3 or family == 4) and y >= 1.0):
        return -np.inf
    if family == 1:
        return value + (a - 1.0) * math.log(y) - y
    if family == 2:
        log_y = math.log(y)
        return value - log_y - 0.5 * (log_y / a) ** 2
    if family == 3:
        return value
    if family == 4:
        return value + (a - 1.0) * math.log(y) + (b - 1.0) * math.log1p(-y)
    if family == 5:
        return value - 0.5 * y * y
    if family == 6:
        return value - y
    return value - (a + 1.0) * math.log(y) - 1.0 / y


def _update_terms(parts, position, theta, k, terms, trial):
    """Write the log density of every part that uses theta[k] into `trial`; copy the others from `terms`."""
    for offset, part in enumerate(parts):
        if k < 0 or (part.theta_index == k).any():
            trial[position + offset] = theta_logpdf(part, theta)
        else:
            trial[position + offset] = terms[position + offset]


@overload_for_types(_update_terms)
def _update_terms_compiled(parts, position, theta, k, terms, trial):
    if isinstance(parts, types.BaseTuple) and len(parts) == 0:
        return lambda parts, position, theta, k, terms, trial: None

    def update(parts, position, theta, k, terms, trial):
        if k < 0 or _depends(parts[0].theta_index, k):
            trial[position] = theta_logpdf(parts[0], theta)
        else:
            trial[position] = terms[position]
        _update_terms(parts[1:], position + 1, theta, k, terms, trial)

    return update


@kernel
def _sum(terms):
    value = 0.0
    for i in range(terms.size):
        value += terms[i]
    return value


@kernel
def _change(trial, terms):
    value = 0.0
    for i in range(trial.size):
        value += trial[i] - terms[i]
    return value


@entry
def metropolis_block(rng, theta, log_step, n_rounds, gain, target, priors, parts, accepted):
    """Update `theta` (d,) in place by `n_rounds` rounds of one-dimensional Gaussian proposals (eq. 17).

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of randomness.
    theta, log_step : ndarray, shape (d,)
        Parameters, and logs of the proposals' standard deviations.
    n_rounds : int
        The paper's m.
    gain, target : float
        During burn-in each proposal moves log_step by ``gain * (accepted - target)`` (Robbins and Monro); afterwards
        gain is 0.
    priors : PriorTable
        The priors.
    parts : tuple of statistics
        Residuals of the current trajectory.
    accepted : ndarray, shape (d,)
        Receives the share of accepted proposals of each dimension.

    Returns
    -------
    bool
        False when a density is not a number; `theta` is then the point at which it is not.
    """
    terms, trial = np.zeros(len(parts)), np.zeros(len(parts))
    _update_terms(parts, 0, theta, -1, terms, terms)
    for k in range(theta.size):
        accepted[k] = 0.0
    if math.isnan(_sum(terms)):
        return False
    for _ in range(n_rounds):
        for k in range(theta.size):
            old = theta[k]
            theta[k] = old + math.exp(log_step[k]) * rng.standard_normal()
            log_ratio = log_prior(priors, k, theta[k]) - log_prior(priors, k, old)
            if log_ratio > -np.inf:
                _update_terms(parts, 0, theta, k, terms, trial)
                if math.isnan(_sum(trial)):
                    return False
                log_ratio += _change(trial, terms)
            yes = math.log(rng.random()) < log_ratio
            if yes:
                for i in range(terms.size):
                    terms[i] = trial[i]
                accepted[k] += 1.0 / n_rounds
            else:
                theta[k] = old
            log_step[k] += gain * ((1.0 if yes else 0.0) - target)
    return True
