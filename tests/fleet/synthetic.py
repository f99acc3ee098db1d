"""Fleets of which everything is known: draws of exact posteriors, without any log."""

from __future__ import annotations

import numpy as np

from pmcl.fleet.densities import Line
from pmcl.models.parameters import Parameter, gamma_prior

SIGMA = Parameter("sigma_range", "m", gamma_prior(0.1))
LINE = Line(SIGMA)


def measured(rng: np.random.Generator, u, noise: float):
    """What logs say: Gaussian measurements of places u on the line."""
    return np.asarray(u) + noise * rng.normal(size=np.shape(u))


def posterior_draws(rng: np.random.Generator, seen: float, noise: float, line: Line = LINE, draws: int = 1000):
    """Draws of the posterior of one robot, in the parameter's unit, from sums over a fine grid."""
    u = np.linspace(seen - 8 * noise, seen + 8 * noise, 1201)
    log_density = line.log_prior(u) - 0.5 * ((u - seen) / noise) ** 2
    share = np.exp(log_density - log_density.max())
    below = np.cumsum(share / share.sum())
    return line.from_line(np.interp(rng.random(draws), below, u))


def fleet_of(
    rng: np.random.Generator, typical: float, spread: float, noise: float, robots: int = 20, odd: dict | None = None
):
    """Draws of each robot of a fleet, by name; `odd` maps numbers of robots to what their place is shifted by."""
    u = np.log(typical) + spread * rng.normal(size=robots)
    for k, shift in (odd or {}).items():
        u[k] += shift
    return {f"robot{k}": posterior_draws(rng, seen, noise) for k, seen in enumerate(measured(rng, u, noise))}
