"""Filters whose particles carry parameters: Liu and West's kernel shrinkage, and Storvik's sufficient statistics.

Both go once through the logs. What they return at the end is a cloud of parameters and no chain; several independent
runs take the place of chains, so that R-hat shows how far they are apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import FilterError, ModelError, SamplingError
from pmcl.filtering.kernels import stepwise
from pmcl.filtering.particle_filter import make_rng
from pmcl.filtering.tracker import stack_tables
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables
from pmcl.sampling.chains import Chains
from pmcl.sampling.options import RunOptions, SettingValue
from pmcl.sampling.pool import walker_pool
from pmcl.sampling.stopwatch import Stopwatch
from pmcl.sampling.transforms import Unconstrained

__all__ = ["clouds", "liu_west", "storvik"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Draws of a run that only the clock would end: a cloud has no more different parameters than particles.
_MOST_DRAWS = 4000
# Parameters are drawn again where the effective sample size has fallen below this share of the particles.
_RESAMPLE_BELOW = 0.5
# Places of the grid on which a conditional density of one parameter is inverted, by how many of its standard
# deviations the grid reaches, and from how many residuals on these are known.
_GRID, _GRID_REACH, _KNOWN_FROM = 128, 7.0, 20
# Quantiles of the prior between which a noise is looked for.
_TAIL = 1e-6
# By what factors a noise is varied to read its sufficient statistics off the density, and how exactly a third value
# must then be foretold: if not, its statistics are not a number and a sum of squares.
_FACTORS, _CHECK_FACTOR, _EXACT = (1.25, 1.6), 2.0, 1e-6


def clouds(
    bound: BoundModel, options: RunOptions, settings: Mapping[str, SettingValue], run: Callable[[int, int], Float]
) -> Chains:
    """Return independent runs of a filter as chains.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    options : RunOptions
        Its chains are runs.
    settings : mapping of str to scalar
        Settings of the method.
    run : callable
        (draws, seed) to a cloud of parameters, (draws, d).
    """
    draws = min(options.draws, _MOST_DRAWS)
    seeds = [int(seed) for seed in np.random.SeedSequence(options.seed).generate_state(options.chains)]
    with walker_pool(options.pool, len(seeds)) as pool:
        work: Any = pool.map if pool is not None else map
        found = list(work(partial(run, draws), seeds))
    units = tuple(parameter.unit for parameter in bound.parameters)
    return Chains(bound.names, units, np.array(found), settings={**settings, "draws": draws, **options.attributes})


class _Log(NamedTuple):
    """One log of a bound model."""

    number: int
    rows: int
    where: str


def _logs(bound: BoundModel) -> list[_Log]:
    return [
        _Log(number, rows, log.where) for number, (rows, log) in enumerate(zip(bound.lengths, bound.logs, strict=True))
    ]


def _tables_of(bound: BoundModel, theta: Float, number: int) -> tuple[Tables, Tables]:
    """Return tables of one log at the first of some thetas (n, d), and a stack of those of all."""
    tables = [bound.tables(one)[number] for one in theta]
    return tables[0], stack_tables(tables)


def _normalised(log_weight: Float, log: _Log, row: int) -> Float:
    greatest = float(log_weight.max())
    if not math.isfinite(greatest):
        raise FilterError(
            f"{log.where}: at row {row} every particle has weight zero, whatever its parameters; use more particles, "
            "wider priors, or a model with outliers",
            row=row,
        )
    weight = np.exp(log_weight - greatest)
    return np.asarray(weight / weight.sum())


def _check_time(stopwatch: Stopwatch | None, log: _Log, row: int) -> None:
    check_interrupt()
    if stopwatch is not None and stopwatch.now() >= stopwatch.limit:
        raise SamplingError(
            f"{log.where}: the time was over at row {row} of {log.rows}, and only a filter that has seen all rows has "
            "draws; give more time, or fewer particles"
        )


def _systematic(weight: Float, count: int, rng: np.random.Generator) -> Int:
    places = (rng.random() + np.arange(count)) / count
    return np.minimum(np.searchsorted(np.cumsum(weight), places), weight.size - 1).astype(np.int64)


def _cloud(theta: Float, weight: Float, draws: int, rng: np.random.Generator) -> Float:
    """Return equally weighted draws in random order, so that none depends on its neighbours more than on others."""
    return np.asarray(theta[rng.permutation(_systematic(weight, draws, rng))])


def liu_west(
    bound: BoundModel, particles: int, discount: float, stopwatch: Stopwatch | None, draws: int, seed: int
) -> Float:
    """Filter states and parameters together, with kernel shrinkage.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    particles : int
        Number of particles n.
    discount : float
        Liu and West's delta, 0.95 to 0.99.
    stopwatch : Stopwatch, optional
        The time of the run.
    draws : int
        Draws of the parameters that are returned.
    seed : int
        All randomness follows from it.

    Returns
    -------
    ndarray, shape (draws, d)
        Cost: n tables for each resampling.

    Raises
    ------
    FilterError
        When every particle gets weight zero.
    SamplingError
        When the time is over before the end of the logs.
    """
    rng, transform = make_rng(np.random.SeedSequence((seed, 47))), Unconstrained(bound.parameters)
    shrink = (3.0 * discount - 1.0) / (2.0 * discount)
    u = transform.to_line(np.array([bound.draw_prior(rng) for _ in range(particles)]))
    theta = _theta_of(transform, u)
    log_weight, each = np.zeros(particles), np.arange(particles)
    for log in _logs(bound):
        base, stack = _tables_of(bound, theta, log.number)
        states = stepwise.start_states(base, rng, particles)
        for t in range(log.rows):
            _check_time(stopwatch, log, t)
            if t > 0:
                weight = _normalised(log_weight, log, t - 1)
                if 1.0 / np.vdot(weight, weight) < _RESAMPLE_BELOW * particles:
                    mean = weight @ u
                    deviation = u - mean
                    covariance = (weight[:, None] * deviation).T @ deviation + 1e-12 * np.eye(u.shape[1])
                    parents = _systematic(weight, particles, rng)
                    root = np.linalg.cholesky((1.0 - shrink**2) * covariance)
                    u = mean + shrink * deviation[parents] + rng.standard_normal(u.shape) @ root.T
                    theta, states = _theta_of(transform, u), np.ascontiguousarray(states[:, parents])
                    log_weight = np.zeros(particles)
                    base, stack = _tables_of(bound, theta, log.number)
                before, states = states, stepwise.move_each(base, stack, t, rng, each, states)
            else:
                before = states
            log_weight = log_weight + stepwise.weigh_each(base, stack, t, each, before, states)
        weight = _normalised(log_weight, log, log.rows - 1)
    return _cloud(theta, weight, draws, rng)


def _theta_of(transform: Unconstrained, u: Float) -> Float:
    return np.array([transform.from_line(one)[0] for one in u])


def storvik(bound: BoundModel, particles: int, stopwatch: Stopwatch | None, draws: int, seed: int) -> Float:
    """Filter states and sufficient statistics of the noises together; parameters are drawn from them at every row.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs; all of its parameters must be standard deviations of Gaussian residuals.
    particles : int
        Number of particles n.
    stopwatch : Stopwatch, optional
        The time of the run.
    draws : int
        Draws of the parameters that are returned.
    seed : int
        All randomness follows from it.

    Returns
    -------
    ndarray, shape (draws, d)
        Cost: n tables for each row.

    Raises
    ------
    ModelError
        When the statistics of a parameter are not a number of residuals and their sum of squares.
    FilterError
        When every particle gets weight zero.
    SamplingError
        When the time is over before the end of the logs.
    """
    rng, d = make_rng(np.random.SeedSequence((seed, 53))), bound.dimension
    counts, squares = np.zeros((particles, d)), np.zeros((particles, d))
    each, log_weight = np.arange(particles), np.zeros(particles)
    middle = np.array([float(parameter.prior.median()) for parameter in bound.parameters])
    for log in _logs(bound):
        theta = _conditional_draws(bound, counts, squares, rng)
        base, stack = _tables_of(bound, theta, log.number)
        states = stepwise.start_states(base, rng, particles)
        for t in range(log.rows):
            _check_time(stopwatch, log, t)
            before = states
            if t > 0:
                weight = _normalised(log_weight, log, t - 1)
                if 1.0 / np.vdot(weight, weight) < _RESAMPLE_BELOW * particles:
                    parents = _systematic(weight, particles, rng)
                    before = np.ascontiguousarray(states[:, parents])
                    counts, squares = counts[parents], squares[parents]
                    log_weight = np.zeros(particles)
                theta = _conditional_draws(bound, counts, squares, rng)
                base, stack = _tables_of(bound, theta, log.number)
                states = stepwise.move_each(base, stack, t, rng, each, before)
            log_weight = log_weight + stepwise.weigh_each(base, stack, t, each, before, states)
            new_counts, new_squares = _row_statistics(bound, middle, log, t, before, states)
            counts, squares = counts + new_counts, squares + new_squares
        weight = _normalised(log_weight, log, log.rows - 1)
    return _cloud(_conditional_draws(bound, counts, squares, rng), weight, draws, rng)


def _row_statistics(
    bound: BoundModel, middle: Float, log: _Log, t: int, before: Float, states: Float
) -> tuple[Float, Float]:
    """Return number and sum of squares of the residuals of a row for each particle and parameter, (n, d) each.

    They are read off the density: as a function of one standard deviation s it is -c log s - S / (2 s^2) plus a
    constant, so its values at three s tell c and S, and a fourth one whether that is so.
    """

    def terms(theta: Float) -> Float:
        return np.asarray(stepwise.pair_terms(bound.tables(theta)[log.number], t, before, states, t > 0))

    here = terms(middle)
    counts, squares = np.zeros((here.size, middle.size)), np.zeros((here.size, middle.size))
    for k, parameter in enumerate(bound.parameters):
        values = []
        for factor in (*_FACTORS, _CHECK_FACTOR):
            theta = middle.copy()
            theta[k] *= factor
            values.append(terms(theta) - here)
        design = np.array([(-math.log(f), 0.5 * (1.0 - f**-2) / middle[k] ** 2) for f in _FACTORS])
        found = np.linalg.solve(design, np.array(values[:2]))
        counts[:, k], squares[:, k] = np.rint(found[0]), np.maximum(found[1], 0.0)
        foretold = -math.log(_CHECK_FACTOR) * found[0] + 0.5 * (1.0 - _CHECK_FACTOR**-2) / middle[k] ** 2 * found[1]
        size = 1.0 + np.abs(values[2]) + np.abs(values[0])
        usable = np.isfinite(here)
        wrong = np.abs(foretold - values[2]) > _EXACT * size
        uneven = np.abs(found[0] - counts[:, k]) > 1e-3
        if ((wrong | uneven) & usable).any():
            raise ModelError(
                f"{log.where}: expected standard deviations of Gaussian residuals alone, but at row {t} "
                f"{parameter.name} is something else, which has no sufficient statistics; fix it, or use method "
                "liu-west"
            )
    return counts, squares


def _conditional_draws(bound: BoundModel, counts: Float, squares: Float, rng: np.random.Generator) -> Float:
    """Draw each parameter of each particle given its statistics, (n, d), by inversion on a grid of its logarithm."""
    theta = np.empty_like(counts)
    for k, parameter in enumerate(bound.parameters):
        c, s = counts[:, k, None], squares[:, k, None]
        lowest = float(parameter.prior.ppf(_TAIL))
        if not lowest > 0.0:
            raise ModelError(
                f"expected {parameter.name} to be a standard deviation above zero, but its prior reaches {lowest:g}; "
                "give it another prior, or use method liu-west"
            )
        low, high = math.log(lowest), math.log(float(parameter.prior.isf(_TAIL)))
        with np.errstate(divide="ignore", invalid="ignore"):
            centre, reach = 0.5 * np.log(s / c), _GRID_REACH / np.sqrt(2.0 * c)
        # The prior moves the conditional away from its likelihood by little once there are residuals enough.
        known = (c >= _KNOWN_FROM) & (s > 0.0) & (centre > low) & (centre < high)
        left = np.where(known, np.maximum(centre - reach, low), low)
        right = np.where(known, np.minimum(centre + reach, high), high)
        log_sigma = left + (right - left) * (np.arange(_GRID) + 0.5) / _GRID
        log_density = parameter.prior.logpdf(np.exp(log_sigma)) + (1.0 - c) * log_sigma
        log_density = log_density - 0.5 * s * np.exp(-2.0 * log_sigma)
        cumulated = np.cumsum(np.exp(log_density - log_density.max(axis=1, keepdims=True)), axis=1)
        target = rng.random((len(c), 1)) * cumulated[:, -1:]
        place = np.minimum((cumulated < target).sum(axis=1), _GRID - 1)
        width = (right - left)[:, 0] / _GRID
        theta[:, k] = np.exp(log_sigma[np.arange(len(c)), place] + width * (rng.random(len(c)) - 0.5))
    if not np.isfinite(theta).all():
        raise SamplingError("a conditional density of a noise is not a number; use wider priors")
    return theta
