"""Draws of theta, paths and readings from a model, the counterparts of the densities that pmcl infers with.

Noise is never redrawn, clipped or rejected to keep a robot in its room: a simulator that rejects draws has an effect
that no model of the log contains. A robot stays inside because it is steered (:mod:`pmcl.simulations.driving`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_memory, check_number, check_seed, check_type

# The particle filter's module also registers the kernels of the built-in tables with the contract.
from pmcl.engine import contract
from pmcl.errors import ModelError, did_you_mean
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.motions.increments.table import IncrementMotion
from pmcl.models.parameters import Parameter, prior_support
from pmcl.models.tables import has_extras

__all__ = ["check_run", "draw_theta", "make_rng", "simulate_path"]

Float = NDArray[np.float64]

# Some hundred numbers for each row of a simulated log: pose, increment, readings, and copies of them on the way.
_BYTES_PER_ROW = 1000.0


def check_run(duration: float, period: float, seed: int, where: str) -> int:
    """Return how many rows a simulated log has.

    Parameters
    ----------
    duration, period : float
        Length of the log and time between rows [s].
    seed : int
        Seed of the simulation.
    where : str
        The caller, for messages.

    Returns
    -------
    int

    Raises
    ------
    ModelError
        When there are fewer than two rows, more than memory holds, or the seed is not usable.
    """
    duration = check_number(
        "duration", duration, 2.0 * period, unit="s", error=ModelError, advice="give a longer one", where=where
    )
    check_seed(seed, error=ModelError, where=where)
    check_memory(
        f"{where}: a log of {duration:g} s", _BYTES_PER_ROW * duration / period, error=ModelError, advice="shorten it"
    )
    return int(duration / period)


def draw_theta(
    parameters: Sequence[Parameter], given: Mapping[str, float] | None, rng: np.random.Generator
) -> dict[str, float]:
    """Draw true parameters from their priors, except those that are given.

    Parameters
    ----------
    parameters : sequence of Parameter
        Names and priors.
    given : mapping of str to float, optional
        Values of some of them, in their SI units.
    rng : numpy.random.Generator
        Source of randomness. A given parameter takes its draw as well, so that the others do not change.

    Returns
    -------
    dict of str to float
        In the order of `parameters`.

    Raises
    ------
    ModelError
        When a name is not a parameter, or a value is outside the support of its prior.
    """
    theta = {parameter.name: float(parameter.prior.rvs(random_state=rng)) for parameter in parameters}
    given = {} if given is None else given
    check_type("theta", given, Mapping, error=ModelError, advice="write a dict with parameter names as keys")
    known = {parameter.name: parameter for parameter in parameters}
    for name, value in given.items():
        if name not in theta:
            advice = did_you_mean(name, theta, "leave it out")
            raise ModelError(f"theta: expected parameters out of {', '.join(theta)}, but got '{name}'; {advice}")
        check_number(f"theta: {name}", value, error=ModelError)
        low, high = prior_support(known[name].prior)
        if not (low <= value <= high and math.isfinite(value)):
            raise ModelError(
                f"theta: expected {name} within its prior, {low:g} to {high:g}, but got {value:g}; choose another"
            )
        if known[name].role == "noise" and value == 0.0:
            raise ModelError(f"theta: expected {name} > 0, but got 0; choose a small one, such as 0.001")
        theta[name] = float(value)
    return theta


def simulate_path(motion: Any, start: Any, rng: np.random.Generator) -> Float:
    """Draw one path from the start belief and the motion model.

    Parameters
    ----------
    motion : NamedTuple
        A motion table with ``mean`` of T rows, e.g. :class:`~pmcl.models.tables.IncrementMotion`.
    start : NamedTuple
        A start table.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (T, D)
        States, for poses (x, y, heading) [m, m, rad] in the map frame. Headings are not wrapped, as in the kernels.
    """
    n_steps, size = motion.mean.shape[0], int(contract.state_size(motion))
    path = np.empty((n_steps, size))
    first = np.empty((size, 1))
    contract.draw_start(start, rng, first)
    path[0] = first[:, 0]
    if not isinstance(motion, IncrementMotion) or has_extras(motion):
        return _propagated(motion, path, rng)
    increment = motion.mean[1:] + motion.std[1:] * rng.standard_normal((n_steps - 1, 3))
    path[1:, 2] = path[0, 2] + np.cumsum(increment[:, 2])
    c, s = np.cos(path[:-1, 2]), np.sin(path[:-1, 2])
    path[1:, 0] = path[0, 0] + np.cumsum(c * increment[:, 0] - s * increment[:, 1])
    path[1:, 1] = path[0, 1] + np.cumsum(s * increment[:, 0] + c * increment[:, 1])
    return path


def _propagated(motion: Any, path: Float, rng: np.random.Generator) -> Float:
    """Fill a path row by row with the model's own `propagate` in Python, for table types that pmcl does not know."""
    scratch = np.empty((int(contract.scratch_rows(motion)), 1))
    current = np.empty((path.shape[1], 1))
    for t in range(1, path.shape[0]):
        contract.propagate(motion, t, rng, path[t - 1][:, None].copy(), current, scratch)
        path[t] = current[:, 0]
    return path
