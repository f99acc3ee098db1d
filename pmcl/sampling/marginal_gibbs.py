"""Marginal particle Gibbs: conditional SMC for a path that belongs to the present theta or to a proposed one.

Particle Gibbs draws the path given theta and theta given the path, and hardly moves where each determines the other.
Here a theta' is proposed first, and the path is redrawn from the mixture of both,

    sum over k of c[k] p(path, readings | theta[k]),   c[k] = prior of theta[k] times proposal of the other one from it,

by conditional SMC; then theta is drawn out of the two given the new path. The three steps leave the posterior
invariant with any number of particles. Each particle carries the log odds of theta' given its own past, moves by the
mixture of both motions with these odds, and is weighed by the ratio of the mixture with the new readings to that
without. Trajectories are drawn backward in the same mixture.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import ModelError
from pmcl.filtering.kernels.stepwise import move_each, pair_terms, start_states
from pmcl.filtering.particle_filter import log_joint, make_rng
from pmcl.filtering.tracker import stack_tables
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.models.tables import Tables
from pmcl.sampling.near_mode import NearMode
from pmcl.sampling.path_walk import PathStarter, path_dtype
from pmcl.sampling.random_walk import WalkKit
from pmcl.sampling.sweep import included
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.walker_move import WalkerMove

__all__ = ["marginal_gibbs_kit", "redraw_from_mixture"]

Float = NDArray[np.float64]

# Burn-in aims at this share of moves to the proposed theta; drawn by its odds, it is at most a half.
_MOVED = 0.2
_FIELDS = ("log_joint", "acceptance_rate", "path_update_rate")


class _Redrawn(NamedTuple):
    """A path of the mixture.

    Attributes
    ----------
    path : ndarray, shape (T, D)
        The path.
    log_odds : float
        Log odds of the second theta given it.
    """

    path: Float
    log_odds: float


def redraw_from_mixture(
    pair: tuple[Tables, Tables], path: Float, log_odds: float, particles: int, rng: np.random.Generator
) -> _Redrawn:
    """Redraw a path by conditional SMC with backward sampling in the mixture of two parameters.

    Parameters
    ----------
    pair : tuple of two Tables
        The model under both; their starts must be the same.
    path : ndarray, shape (T, D)
        The present path.
    log_odds : float
        Log of the ratio of the second parameter's weight to the first one's before this log is seen.
    particles : int
        Number of particles n.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    _Redrawn
        Cost: O(T n).
    """
    n_steps, size = path.shape
    moving = tuple(tables._replace(sensors=()) for tables in pair)
    stack = stack_tables(pair)
    states, odds = np.empty((n_steps, size, particles)), np.empty((n_steps, particles))
    log_weights: list[Float] = []
    for t in range(n_steps):
        if t == 0:
            current = start_states(pair[0], rng, particles)
            before, motion, prior = current, np.zeros((2, particles)), np.full(particles, log_odds)
        else:
            weights = np.exp(log_weights[-1])
            parents = rng.choice(particles, size=particles, p=weights / weights.sum())
            parents[0] = 0
            before, prior = np.ascontiguousarray(states[t - 1][:, parents]), odds[t - 1][parents]
            which = (rng.random(particles) < _share(prior)).astype(np.int64)
            current = move_each(pair[0], stack, t, rng, which, before)
        current[:, 0] = path[t]
        if t > 0:
            motion = np.array([pair_terms(tables, t, before, current, True) for tables in moving])
        readings = np.array([pair_terms(tables, t, before, current, False) for tables in pair])
        log_shares = np.array([_log_share(-prior), _log_share(prior)])
        with np.errstate(invalid="ignore"):
            weight = np.logaddexp.reduce(log_shares + motion + readings, axis=0)
            weight = weight - np.logaddexp.reduce(log_shares + motion, axis=0)
            change = (motion[1] + readings[1]) - (motion[0] + readings[0])
        # A particle that is impossible under both has weight zero and any odds.
        odds[t] = prior + np.where(np.isnan(change), 0.0, change)
        weight = np.where(np.isnan(weight), -math.inf, weight)
        log_weights.append(weight - weight.max())
        states[t] = current
    new, later = np.empty_like(path), 0.0
    for t in range(n_steps - 1, -1, -1):
        weight = log_weights[t]
        if t < n_steps - 1:
            after = np.ascontiguousarray(np.repeat(new[t + 1][:, None], particles, axis=1))
            onward = np.array([pair_terms(tables, t + 1, states[t], after, True) for tables in pair])
            weight = weight + np.logaddexp(
                _log_share(-odds[t]) + onward[0], _log_share(odds[t]) + onward[1] + later
            )
        chances = np.exp(weight - weight.max())
        chosen = int(rng.choice(particles, p=chances / chances.sum()))
        new[t] = states[t][:, chosen]
        if t < n_steps - 1:
            later += float(onward[1, chosen] - onward[0, chosen])
    return _Redrawn(new, float(odds[0, chosen]) + later)


def _share(log_odds: Float) -> Float:
    return np.asarray(np.exp(_log_share(log_odds)))


def _log_share(log_odds: Float) -> Float:
    """Return the log of the probability that belongs to some log odds."""
    return np.asarray(-np.logaddexp(0.0, -log_odds))


class _MarginalMove(WalkerMove):
    """One sweep of marginal particle Gibbs for every walker."""

    def __init__(self, bound: BoundModel, particles: int, root: Float, gain: float) -> None:
        self.bound, self.particles, self.root, self.gain = bound, particles, root, gain
        self.transform = Unconstrained(bound.parameters)

    def update(self, walker: tuple[int, Any, Any, int]) -> tuple[Any, float, Any]:
        """Return (theta, log_prob, blob) of one walker after a sweep, given (number, theta, blob, seed)."""
        _, theta, old, seed = walker
        check_interrupt()
        rng, bound, blob = make_rng(np.random.SeedSequence(seed)), self.bound, old.copy()
        u = self.transform.to_line(theta)
        u_new = u + math.exp(blob["log_scale"]) * (self.root @ rng.standard_normal(u.size))
        other, jacobian_new = self.transform.from_line(u_new)
        try:
            bound.check(other)
            possible = bound.log_prior(other) > -math.inf
        except ModelError:
            possible = False
        moved = 0.0
        if possible:
            log_odds = bound.log_prior(other) + jacobian_new
            log_odds -= bound.log_prior(theta) + self.transform.from_line(u)[1]
            path = blob["path"].copy()
            paths = included(bound, path, max(bound.lengths))
            pairs = list(zip(bound.tables(theta), bound.tables(other), strict=True))
            ratios = [
                log_joint(pair[1], np.ascontiguousarray(part)) - log_joint(pair[0], np.ascontiguousarray(part))
                for pair, part in zip(pairs, paths, strict=True)
            ]
            for number, (pair, part) in enumerate(zip(pairs, paths, strict=True)):
                # What the other logs say about the two is fixed while this log's path is redrawn.
                rest = log_odds + math.fsum(ratios) - ratios[number]
                redrawn = redraw_from_mixture(pair, np.ascontiguousarray(part), rest, self.particles, rng)
                part[:] = redrawn.path
                ratios[number] = redrawn.log_odds - rest
            blob["path_update_rate"] = float(np.mean(np.any(path != blob["path"], axis=1)))
            blob["path"] = path
            share = float(_share(np.asarray(log_odds + math.fsum(ratios))))
            if rng.random() < share:
                theta, moved = other, 1.0
            tables = bound.tables(theta)
            blob["log_joint"] = bound.log_prior(theta) + math.fsum(
                log_joint(table, np.ascontiguousarray(part)) for table, part in zip(tables, paths, strict=True)
            )
            blob["log_scale"] += self.gain * (share - _MOVED)
        else:
            blob["log_scale"] -= self.gain * _MOVED
        blob["acceptance_rate"] = moved
        return np.array(theta), float(blob["log_joint"]), blob


def _equal(table: Any, other: Any) -> bool:
    if isinstance(table, tuple):
        return all(_equal(a, b) for a, b in zip(table, other, strict=True))
    return np.array_equal(table, other)


def marginal_gibbs_kit(bound: BoundModel, near: NearMode, particles: int) -> WalkKit:
    """Return how chains of marginal particle Gibbs start and move.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    near : NearMode
        Near where the chains start.
    particles : int
        Number of particles.

    Raises
    ------
    ModelError
        When the belief about the start depends on the parameters.
    """
    transform = Unconstrained(bound.parameters)
    moved = transform.from_line(near.centre + 0.1)[0]
    for log, first, second in zip(
        bound.logs, bound.tables(transform.from_line(near.centre)[0]), bound.tables(moved), strict=True
    ):
        if not _equal(first.start, second.start):
            raise ModelError(
                f"{log.where}: expected a start belief that does not depend on the parameters, but this model's does; "
                "use method particle-gibbs"
            )
    dtype = path_dtype(bound, _FIELDS)
    return WalkKit(
        PathStarter(bound, near, dtype),
        lambda root, gain: _MarginalMove(bound, particles, root, gain),
        dtype,
        _FIELDS[1:],
    )
