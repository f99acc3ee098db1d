"""Where the fit of a candidate effect starts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.criticism.scoring.scores import inside_priors, probe_values
from pmcl.filtering.kernels import smc
from pmcl.models.effects.effect import Effect
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.transforms import Unconstrained

__all__ = ["gain_of_motion", "starting_point"]

Float = NDArray[np.float64]

# A fit starts at this share of the candidate's clear magnitude (chosen by hand).
_START_SHARE = 0.25
# Step of the derivatives of the motion's density, in unconstrained parameters and in units of what its curvature makes
# of a step: far below a posterior's width, far above rounding errors.
_DIFFERENCE, _SHARE_OF_SCALE = 1e-4, 1e-3
# What a density of zero counts for L-BFGS-B, which knows no infinity [nat].
_IMPOSSIBLE = 1e10
_ALL = slice(None)


def starting_point(
    bound: BoundModel, fit: Fit, effect: Effect, z: float, free: NDArray[np.bool_], at: Float | None = None
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
    at : ndarray, shape (k,), optional
        Values of the effect at which the fit starts, instead of some near its null.

    Returns
    -------
    values : ndarray, shape (k,)
        Inside the priors; of an effect that carries paths those that suit the motion best.
    path : ndarray, shape (T, D)
        The path of the fit, carried if the effect carries paths.
    """
    values = _near_null(effect, z) if at is None else inside_priors(effect, at)
    if effect.carries is None:
        return values, fit.path
    motion = _CarriedMotion(bound, fit, effect, values, free)
    found = motion.best_from(motion.start)
    return values, motion.carried(motion.theta(found))


def gain_of_motion(bound: BoundModel, fit: Fit, effect: Effect) -> float:
    """Return what the motion gains if an effect moves the drawn path rigidly, and the readings with it [nat].

    Densities of rigidly moved paths can be compared, because a rigid motion keeps volumes: the gain is a lower bound of
    the log evidence of the effect, as in :mod:`pmcl.criticism.scoring.lower_bounds`.

    Parameters
    ----------
    bound : BoundModel
        The model with the effect as its newest, bound to one log.
    fit : Fit
        The model without it, fitted.
    effect : Effect
        The effect; it carries paths rigidly.

    Returns
    -------
    float
        With the parameters that suit the motion best, with and without the effect.
    """
    free = np.ones(len(effect.parameters), dtype=bool)
    null = inside_priors(effect, np.array(effect.null, dtype=float))
    motion = _CarriedMotion(bound, replace(fit, path=fit.drawn_path), effect, null, free)
    without = motion.best_from(motion.start, moved=slice(0, fit.theta.size))
    return motion.cost(without) - motion.cost(motion.best_from(without))


class _CarriedMotion:
    """The density of the motion along a path that an effect carries.

    Attributes
    ----------
    start : ndarray, shape (d,)
        The parameters of the fit and those of the effect near its null, on the real line.
    """

    def __init__(
        self, bound: BoundModel, fit: Fit, effect: Effect, values: Float, free: NDArray[np.bool_]
    ) -> None:
        for k in effect.strengths:
            if not (effect.squared or effect.one_sided(k)):
                values[k] = effect.null[k]
        self._bound, self._path, self._effect, self._values, self._free = bound, fit.path, effect, values, free
        self._own = slice(fit.theta.size, None)
        self._transform = Unconstrained(bound.parameters)
        self.start = np.asarray(self._transform.to_line(np.concatenate([fit.theta, values[free]])))

    def theta(self, u: Float) -> Float:
        """Return parameters from the real line."""
        return np.asarray(self._transform.from_line(u)[0])

    def carried(self, theta: Float) -> Float:
        """Return the path (T, D) that parameters carry; the effect's values become theirs."""
        assert self._effect.carries is not None
        self._values[self._free] = theta[self._own]
        return np.ascontiguousarray(self._effect.carries(self._path, self._values, self._bound.logs[0]))

    def cost(self, u: Float) -> float:
        """Return the negative log density of the carried path's motion, with the priors."""
        theta, log_jacobian = self._transform.from_line(np.asarray(u))
        prior = self._bound.log_prior(theta)
        if not math.isfinite(prior):
            return _IMPOSSIBLE
        tables = self._bound.tables(theta)[0]
        terms = smc.motion_terms(tables.start, tables.motion, np.ascontiguousarray(self.carried(theta).T[None]))
        density = float(terms.sum()) + prior + log_jacobian
        return -density if math.isfinite(density) else _IMPOSSIBLE

    def best_from(self, start: Float, moved: slice = _ALL) -> Float:
        """Return the parameters, on the real line, of the greatest density; only some of them may be moved.

        Without the effect the path suits the motion well. A centimetre along it is far more than one across, so the
        steps of the search are as long as the curvature there makes them; in plain steps it stays where it begins.
        """
        steps = np.eye(start.size)[moved] * _DIFFERENCE
        bends = np.array([self.cost(start + step) + self.cost(start - step) - 2.0 * self.cost(start) for step in steps])
        scale = 1.0 / np.sqrt(np.clip(bends / _DIFFERENCE**2, 1.0, None))

        def moved_by(step: Float) -> Float:
            u = start.copy()
            u[moved] += scale * np.asarray(step)
            return u

        def cost(step: Float) -> float:
            return self.cost(moved_by(step))

        found = optimize.minimize(cost, np.zeros_like(scale), method="L-BFGS-B", options={"eps": _SHARE_OF_SCALE})
        return moved_by(found.x)


def _near_null(effect: Effect, z: float) -> Float:
    """Return values near the null, on the side that the score points to, inside the priors."""
    values = np.array(effect.null, dtype=float)
    for k in effect.strengths:
        one_sided = effect.squared or effect.one_sided(k)
        values[k] = probe_values(effect, _START_SHARE if one_sided else _START_SHARE * float(np.sign(z) or 1.0), k)[k]
    return inside_priors(effect, values)
