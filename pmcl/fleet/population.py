"""Mean and spread of one parameter over the robots of a fleet, from the posteriors of its robots.

The model: on the line, robot i has u_i ~ N(mu, tau^2), but with probability `oddness` it is an odd one and u_i is from
the prior that it was calibrated with. In stage one each robot was calibrated by itself; stage two needs from it the
likelihood of u_i alone, which is its posterior over its prior (Lunn, Barrett, Sweeting, Thompson, Fully Bayesian
hierarchical modelling in two stages, J. R. Stat. Soc. C 62(4), 2013). With one parameter at a time, mu and tau are two
numbers: instead of a chain, sums over a grid give their posterior without Monte Carlo error. The other parameters keep
the priors that they had.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtr

from pmcl.fleet.densities import Line, RobotDensity

__all__ = ["ODDNESS", "Population", "population_of"]

Float = NDArray[np.float64]

ODDNESS = 0.1
"""Probability that a robot is an odd one, before anything is known (chosen by hand). It keeps an odd robot from
widening the spread, behind which it would hide."""

# Points of the grid over mu and tau: of the coarse ones, of which each is laid to where the one before found the
# posterior, and of the last. What is left out has a log density so far below the greatest [nat].
_COARSE, _ROUNDS, _FINE, _NEGLIGIBLE = (18, 16), 3, (32, 36), 10.0
# Points that together have a smaller share of the probability than this, each of a thousand, count for nothing.
_LEAST_SHARE = 1e-7
# The prior: mu around the mean of a robot's own prior, with so many of its standard deviations; tau half-normal with
# one of them.
_MU_SCALE = 2.0
# Bounds of tau, in standard deviations of the prior.
_LEAST_TAU, _GREATEST_TAU = 1e-3, 5.0
# Places at which distribution functions are tabulated.
_PLACES = 400


@dataclass(frozen=True, eq=False)
class Population:
    """The posterior of mean and spread of a fleet, at G points.

    Attributes
    ----------
    line : Line
        The parameter, and the line on which its robots are compared.
    robots : tuple of RobotDensity
        What each of N robots says.
    mu, tau : ndarray, shape (G,)
        Mean and standard deviation of the robots on the line.
    log_weight : ndarray, shape (G,)
        Log posterior probability of each point.
    log_robot : ndarray, shape (N, G)
        Log of what each robot contributes to it.
    oddness : float
        See :data:`ODDNESS`.
    """

    line: Line
    robots: tuple[RobotDensity, ...]
    mu: Float
    tau: Float
    log_weight: Float
    log_robot: Float
    oddness: float

    def weights(self, without: int | None = None) -> Float:
        """Return the probability of each point, shape (G,); of the other robots alone when one is left out."""
        log_weight = self.log_weight if without is None else self.log_weight - self.log_robot[without]
        weights = np.exp(log_weight - log_weight.max())
        return np.asarray(weights / weights.sum())

    def mean_quantiles(self, probabilities: Sequence[float]) -> Float:
        """Return quantiles of the typical robot's value, in the parameter's unit."""
        return self.line.from_line(_quantiles(self.mu, self.weights(), probabilities))

    def spread_quantiles(self, probabilities: Sequence[float]) -> Float:
        """Return quantiles of the standard deviation between robots, on the line."""
        return np.exp(_quantiles(np.log(self.tau), self.weights(), probabilities))

    def new_robot_quantiles(self, probabilities: Sequence[float]) -> Float:
        """Return quantiles of what a further robot that is not odd will have, in the parameter's unit."""
        weights = self.weights()
        reach = 6.0 * float(self.tau @ weights) + 6.0 * float(np.ptp(self.mu))
        centre = float(self.mu @ weights)
        places = np.linspace(centre - reach, centre + reach, _PLACES)
        below = self.predictive_below(places, weights)
        return self.line.from_line(np.interp(np.asarray(probabilities), below, places))

    def predictive_below(self, places: Float, weights: Float) -> Float:
        """Return the probability that a further robot lies below each place, shape (M,)."""
        some = weights > _LEAST_SHARE
        return np.asarray(weights[some] @ ndtr((places - self.mu[some, None]) / self.tau[some, None]))

    def robot_with_fleet(self, i: int) -> tuple[float, float]:
        """Return mean and standard deviation of one robot's parameter, in its unit, given the logs of all robots."""
        robot, weights = self.robots[i], self.weights()
        some = weights > _LEAST_SHARE
        shares = weights[some] * np.exp(-self.log_robot[i, some])
        regular = (1.0 - self.oddness) * _normal(robot, self.mu[some], self.tau[some]) * robot.likelihood
        density = shares @ regular + self.oddness * shares.sum() * robot.posterior
        density /= density.sum()
        theta = self.line.from_line(robot.nodes)
        mean = float(theta @ density)
        return mean, float(np.sqrt((theta - mean) ** 2 @ density))

    def odd_probability(self, i: int) -> float:
        """Return the posterior probability that one robot is an odd one."""
        return float(self.oddness * (self.weights() @ np.exp(-self.log_robot[i])))

    def conflict(self, i: int) -> tuple[float, bool]:
        """Compare one robot with what the others foresee of it.

        Returns
        -------
        p_value : float
            Two-sided: twice the probability that the value foreseen by the others, and the value that its own log
            shows, lie in the other order than they seem to (Marshall, Spiegelhalter, Identifying outliers in Bayesian
            hierarchical models, Bayesian Analysis 2(2), 2007). Uniform for a robot like the others.
        above : bool
            Whether it lies above them.
        """
        robot = self.robots[i]
        own = robot.likelihood / robot.likelihood.sum()
        below = float(own @ self.predictive_below(robot.nodes, self.weights(without=i)))
        return min(1.0, 2.0 * min(below, 1.0 - below)), below > 0.5


def population_of(robots: Sequence[RobotDensity], line: Line, oddness: float = ODDNESS) -> Population:
    """Find the posterior of mean and spread.

    Parameters
    ----------
    robots : sequence of RobotDensity
        At least two.
    line : Line
        Where they are compared.
    oddness : float
        See :data:`ODDNESS`; 0 for a fleet in which every robot is like the others.

    Returns
    -------
    Population
        Cost: O(N G M) for N robots, G points of the grid, and M nodes of a density.
    """
    centres = np.array([robot.nodes @ robot.posterior for robot in robots])
    margin = line.prior_sd
    mu_range = float(centres.min() - margin), float(centres.max() + margin)
    log_tau_range = np.log(_LEAST_TAU * line.prior_sd), np.log(_GREATEST_TAU * line.prior_sd)
    for size in (*[_COARSE] * _ROUNDS, _FINE):
        mu_axis, log_tau_axis = np.linspace(*mu_range, size[0]), np.linspace(*log_tau_range, size[1])
        mu, log_tau = (grid.ravel() for grid in np.meshgrid(mu_axis, log_tau_axis, indexing="ij"))
        tau = np.exp(log_tau)
        log_robot = np.array([_log_term(robot, mu, tau, oddness) for robot in robots])
        log_weight = log_robot.sum(axis=0) + _log_prior(mu, tau, line) + log_tau
        likely = log_weight > log_weight.max() - _NEGLIGIBLE
        mu_range, log_tau_range = _around(mu[likely], mu_axis), _around(log_tau[likely], log_tau_axis)
    total = np.logaddexp.reduce(log_weight)
    return Population(line, tuple(robots), mu, tau, log_weight - total, log_robot, oddness)


def _log_term(robot: RobotDensity, mu: Float, tau: Float, oddness: float) -> Float:
    """Return the log density of a robot's log for each mu and tau, relative to that under its own prior."""
    regular = _normal(robot, mu, tau) @ robot.likelihood
    return np.asarray(np.log((1.0 - oddness) * regular + oddness + np.finfo(float).tiny))


def _normal(robot: RobotDensity, mu: Float, tau: Float) -> Float:
    """Return the density of N(mu, tau^2) at the robot's nodes, shape (G, M); never narrower than the nodes can show."""
    scale = np.hypot(tau, robot.step)[:, None]
    return np.asarray(np.exp(-0.5 * ((robot.nodes - mu[:, None]) / scale) ** 2) / (np.sqrt(2.0 * np.pi) * scale))


def _log_prior(mu: Float, tau: Float, line: Line) -> Float:
    scale = line.prior_sd
    return np.asarray(-0.5 * ((mu - line.prior_mean) / (_MU_SCALE * scale)) ** 2 - 0.5 * (tau / scale) ** 2)


def _around(likely: Float, axis: Float) -> tuple[float, float]:
    step = axis[1] - axis[0]
    return max(float(likely.min() - step), float(axis[0])), min(float(likely.max() + step), float(axis[-1]))


def _quantiles(values: Float, weights: Float, probabilities: Sequence[float]) -> Float:
    """Return quantiles of the marginal of one axis of the grid, each point of which stands for its surroundings."""
    axis, place = np.unique(values, return_inverse=True)
    mass = np.bincount(place, weights)
    edges = np.concatenate([[axis[0]], 0.5 * (axis[1:] + axis[:-1]), [axis[-1]]])
    # The distribution function is smooth between the few edges that it is known at.
    below = PchipInterpolator(edges, np.concatenate([[0.0], np.cumsum(mass)]))
    places = np.linspace(edges[0], edges[-1], _PLACES)
    return np.asarray(np.interp(np.asarray(probabilities), below(places), places))
