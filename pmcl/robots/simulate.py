"""Draws from what a model says: theta, paths and readings, the counterparts of the densities that pmcl infers with.

Noise is never redrawn, clipped or rejected to keep a robot in its room: whatever a simulator throws away is an effect
that no model of the log contains. A robot stays inside because it is steered (:mod:`pmcl.robots.driving`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import singledispatch
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_memory, check_number, check_seed, check_type
from pmcl.errors import ModelError, did_you_mean

# The particle filter's module also registers the kernels of the built-in tables with the contract.
from pmcl.filtering.kernels import contract
from pmcl.filtering.particle_filter import make_rng
from pmcl.filtering.predict import ideal_readings
from pmcl.geometry import wrap
from pmcl.models.parameters import Parameter, prior_support
from pmcl.models.rich_tables import RichLandmarks, RichRangeBeams
from pmcl.models.tables import IncrementMotion, LandmarkSightings, RangeBeams
from pmcl.robots.rich_readings import draw_range_readings, draw_sighting_readings

__all__ = ["check_run", "draw_theta", "make_rng", "simulate_path", "simulate_readings"]

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
    """Draw true parameters from their priors, but for those that are given.

    Parameters
    ----------
    parameters : sequence of Parameter
        Names and priors.
    given : mapping of str to float, optional
        Values of some of them, in their SI units.
    rng : numpy.random.Generator
        Every parameter takes its draw, given or not, so that giving one leaves the others as they were.

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
    for name, value in given.items():
        if name not in theta:
            advice = did_you_mean(name, theta, "leave it out")
            raise ModelError(f"theta: expected parameters out of {', '.join(theta)}, but got '{name}'; {advice}")
        check_number(f"theta: {name}", value, error=ModelError)
        low, high = next(prior_support(parameter.prior) for parameter in parameters if parameter.name == name)
        if not (low <= value <= high and math.isfinite(value)):
            raise ModelError(
                f"theta: expected {name} within its prior, {low:g} to {high:g}, but got {value:g}; choose another"
            )
        if name.startswith("sigma_") and value == 0.0:
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
    if not isinstance(motion, IncrementMotion):
        return _propagated(motion, path, rng)
    increment = motion.mean[1:] + motion.std[1:] * rng.standard_normal((n_steps - 1, 3))
    path[1:, 2] = path[0, 2] + np.cumsum(increment[:, 2])
    c, s = np.cos(path[:-1, 2]), np.sin(path[:-1, 2])
    path[1:, 0] = path[0, 0] + np.cumsum(c * increment[:, 0] - s * increment[:, 1])
    path[1:, 1] = path[0, 1] + np.cumsum(s * increment[:, 0] + c * increment[:, 1])
    return path


def _propagated(motion: Any, path: Float, rng: np.random.Generator) -> Float:
    """Fill a path row by row with the model's own `propagate`, as Python: for table types that pmcl does not know."""
    scratch = np.empty((int(contract.scratch_rows(motion)), 1))
    current = np.empty((path.shape[1], 1))
    for t in range(1, path.shape[0]):
        contract.propagate(motion, t, rng, path[t - 1][:, None].copy(), current, scratch)
        path[t] = current[:, 0]
    return path


@singledispatch
def simulate_readings(table: Any, path: Float, rng: np.random.Generator) -> Any:
    """Draw readings along a path; what was not measured stays missing.

    Parameters
    ----------
    table : NamedTuple
        A sensor table; its readings say only what was measured when (NaN: nothing), and are replaced.
    path : ndarray, shape (T, D)
        States for all rows of the table.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    NamedTuple
        The table with new readings.

    Raises
    ------
    ModelError
        For a table type that has registered no implementation.

    Notes
    -----
    Cost: O(readings), plus the walls for each ray. A type of one's own registers a function with
    ``@simulate_readings.register``.
    """
    raise ModelError(
        f"expected a sensor table that can be simulated, but got {type(table).__name__}; "
        "register a function for it with simulate_readings.register"
    )


@simulate_readings.register
def _(table: RangeBeams, path: Float, rng: np.random.Generator) -> RangeBeams:
    shape = table.reading.shape
    # A ray that meets nothing is infinitely long; the density puts it at twice the longest reading.
    expected = np.minimum(table.scale * ideal_readings(table, path) + table.bias, 2.0 * table.max_range)
    reading = np.clip(expected + table.std * rng.standard_normal(shape), 0.0, table.max_range)
    gross = rng.random(shape) < table.outlier_weight
    reading = np.where(gross, table.max_range * rng.random(shape), reading)
    return table._replace(reading=np.where(np.isnan(table.reading), np.nan, reading))


@simulate_readings.register
def _(table: LandmarkSightings, path: Float, rng: np.random.Generator) -> LandmarkSightings:
    # A bearing is wrapped, while the density is a Gaussian of the wrapped residual: the same but for what a Gaussian
    # has beyond half a turn, 2e-7 at a noise of 0.6 rad.
    which, n = table.landmark, table.landmark.size
    distance, bearing = np.ascontiguousarray(ideal_readings(table, path).T)
    noise = rng.standard_normal((3, n))
    ideal_size = table.size_constant[which] / distance**2
    plain = (
        table.range_scale[which] * distance + table.range_bias[which] + table.range_std[which] * noise[0],
        wrap(bearing + table.bearing_bias[which] + table.bearing_std[which] * noise[1]),
        ideal_size * (1.0 + table.size_std[which] * noise[2]),
    )
    anything = (
        table.max_range * rng.random(n),
        np.pi * (2.0 * rng.random(n) - 1.0),
        table.size_constant[which] * rng.random(n),
    )
    # One coin for the whole sighting: a wrong identity spoils distance, bearing and size together.
    gross = rng.random(n) < table.outlier_weight[which]
    measured = [~np.isnan(values) for values in (table.range, table.bearing, table.size)]
    new = [
        np.where(seen, np.where(gross, wild, sound), np.nan)
        for seen, wild, sound in zip(measured, anything, plain, strict=True)
    ]
    return table._replace(range=new[0], bearing=new[1], size=new[2])


simulate_readings.register(RichRangeBeams, draw_range_readings)
simulate_readings.register(RichLandmarks, draw_sighting_readings)
