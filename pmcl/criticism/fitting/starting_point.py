"""Where the fit of a candidate effect starts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.criticism.scoring.scores import probe_values
from pmcl.filtering.kernels import smc
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import prior_support
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.transforms import Unconstrained

__all__ = ["starting_point"]

Float = NDArray[np.float64]

# A fit starts at this share of the candidate's clear magnitude (chosen by hand).
_START_SHARE = 0.25
# Step of the derivatives of the motion's density, in unconstrained parameters and in units of what its curvature makes
# of a step: far below a posterior's width, far above rounding errors.
_DIFFERENCE, _SHARE_OF_SCALE = 1e-4, 1e-3
# What a density of zero counts for L-BFGS-B, which knows no infinity [nat].
_IMPOSSIBLE = 1e10


def starting_point(
    bound: BoundModel, fit: Fit, effect: Effect, z: float, free: NDArray[np.bool_]
) -> tuple[Float, Float]:
    """Return values of a candidate effect, and a path, at which the fit of the model with it starts.

    Parameters
    ----------
    bound : BoundModel
        The model with the effect as its newest, bound to one log.
    fit : Fit
        The model without it, fitted.
    effect : Effect
        The effect.
    z : float
        Its standardised score; its sign gives the side on which the fit starts.
    free : ndarray of bool, shape (k,)
        Which of its parameters are fitted.

    Returns
    -------
    values : ndarray, shape (k,)
        Near the null, inside the priors; of an effect that carries paths those that suit the motion best.
    path : ndarray, shape (T, D)
        The path of the fit, carried if the effect carries paths.
    """
    values = _near_null(effect, z)
    if effect.carries is None:
        return values, fit.path
    for k in effect.strengths:
        if not (effect.squared or effect.one_sided(k)):
            values[k] = effect.null[k]
    log = bound.logs[0]
    own = slice(fit.theta.size, None)
    transform = Unconstrained(bound.parameters)

    def carried(theta: Float) -> Float:
        assert effect.carries is not None
        values[free] = theta[own]
        return np.ascontiguousarray(effect.carries(fit.path, values, log))

    def cost(u: Float) -> float:
        """Return the negative log density of the carried path's motion, with the priors."""
        theta, log_jacobian = transform.from_line(np.asarray(u))
        prior = bound.log_prior(theta)
        if not math.isfinite(prior):
            return _IMPOSSIBLE
        tables = bound.tables(theta)[0]
        terms = smc.motion_terms(tables.start, tables.motion, np.ascontiguousarray(carried(theta).T[None]))
        density = float(terms.sum()) + prior + log_jacobian
        return -density if math.isfinite(density) else _IMPOSSIBLE

    # Without the effect the path suits the motion well. A centimetre along it is far more than one across, so the steps
    # of the search are as long as the curvature there makes them; in plain steps it stays where it begins.
    start = transform.to_line(np.concatenate([fit.theta, values[free]]))
    steps = np.eye(start.size) * _DIFFERENCE
    bends = np.array([cost(start + step) + cost(start - step) - 2.0 * cost(start) for step in steps])
    scale = 1.0 / np.sqrt(np.clip(bends / _DIFFERENCE**2, 1.0, None))

    def scaled_cost(step: Float) -> float:
        return cost(start + scale * np.asarray(step))

    found = optimize.minimize(scaled_cost, np.zeros_like(start), method="L-BFGS-B", options={"eps": _SHARE_OF_SCALE})
    path = carried(transform.from_line(start + scale * np.asarray(found.x))[0])
    return values, path


def _near_null(effect: Effect, z: float) -> Float:
    """Return values near the null, on the side that the score points to, inside the priors."""
    values = np.array(effect.null, dtype=float)
    for k in effect.strengths:
        one_sided = effect.squared or effect.one_sided(k)
        values[k] = probe_values(effect, _START_SHARE if one_sided else _START_SHARE * float(np.sign(z) or 1.0), k)[k]
    for k, parameter in enumerate(effect.parameters):
        low, high = prior_support(parameter.prior)
        margin = 1e-6 * (high - low) if np.isfinite(high - low) else 1e-6
        values[k] = float(np.clip(values[k], low + margin, high - margin))
    return values
