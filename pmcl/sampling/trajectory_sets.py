"""Metropolis on theta with a set of trajectories: its acceptance ratio is an average over all of them.

For any two parameters the ratio of evidences is an expectation over trajectories,

    p(z | theta') / p(z | theta) = E[ p(x, z | theta') / p(x, z | theta) ],   x ~ p(x | z, theta),

which a set of M drawn trajectories estimates. A Metropolis step that takes the estimate for the ratio itself does not
leave the posterior invariant. Andrieu, Yildirim, Doucet and Chopin (2020) show what does: half of the steps must
average in the other direction.

With theta~ between theta and theta', the trajectory x of the chain, and trajectories u[1..M] of one conditional SMC
pass at theta~ that keeps x, let

    r(x, u) = [p(theta') p(u, z | theta') / p(u, z | theta~)] / [p(theta) p(x, z | theta) / p(x, z | theta~)].

- Forward: one of the set is chosen with odds r(x, u[m]); (theta', chosen) is accepted with min(1, mean of r(x, u)).
- Backward: u[1] is the candidate. The others and x are the set that a forward step from (theta', u[1]) would have
  drawn; (theta', u[1]) is accepted with min(1, 1 / mean of the ratios of that step).

x and u are exchangeable under p(x | z, theta~), so each kind is the other one's reverse.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from pmcl.errors import ModelError
from pmcl.filtering.particle_filter import draw_set, log_joint, make_rng, update_path
from pmcl.interrupts import check_interrupt
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.near_mode import NearMode
from pmcl.sampling.path_walk import PathStarter, path_dtype
from pmcl.sampling.random_walk import WalkKit
from pmcl.sampling.sweep import included
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.walker_move import WalkerMove

__all__ = ["Exchanged", "exchange", "trajectory_set_kit"]

Float = NDArray[np.float64]

# Burn-in aims at this share of accepted proposals: between the best for an exact density in several dimensions (0.234)
# and that for a very noisy one (0.07).
_ACCEPTANCE = 0.2
_FIELDS = ("log_joint", "acceptance_rate", "path_update_rate")


class Exchanged(NamedTuple):
    """A proposal of theta and a trajectory.

    Attributes
    ----------
    log_ratio : float
        Log of the acceptance ratio; -inf for what is impossible.
    path : ndarray, shape (sum of T_l, D)
        The proposed trajectories of all logs.
    """

    log_ratio: float
    path: Float


def exchange(
    bound: BoundModel,
    thetas: tuple[Float, Float, Float],
    path: Float,
    log_prior_ratio: float,
    set_size: int,
    particles: int,
    rng: np.random.Generator,
    *,
    forward: bool,
) -> Exchanged:
    """Propose a trajectory for a new theta, with an acceptance ratio that is averaged over a set of trajectories.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    thetas : tuple of three ndarray, shape (d,)
        The present theta, one between, which must not change when the others change places, and the proposed one.
    path : ndarray, shape (sum of T_l, D)
        The chain's trajectories of all logs, one after the other.
    log_prior_ratio : float
        Log of prior times proposal density of the new theta over those of the present one.
    set_size : int
        Trajectories M of the set.
    particles : int
        Particles of the conditional SMC pass.
    rng : numpy.random.Generator
        Source of randomness.
    forward : bool
        Which of the two kinds of steps of this module.

    Returns
    -------
    Exchanged
        Cost: one conditional SMC pass and 3 M + 3 densities of a trajectory for each log.
    """
    now, between, new = (bound.tables(theta) for theta in thetas)
    old = included(bound, path, max(bound.lengths))
    candidates = np.empty((set_size, *path.shape))
    # Logs of p(x, z | .) / p(x, z | theta~) at theta' and at theta, first of the chain's x, then of the set.
    to_new, to_now = np.zeros(set_size + 1), np.zeros(set_size + 1)
    for number, part in enumerate(old):
        drawn = draw_set(between[number], part, set_size, particles, rng)
        if drawn is None:
            return Exchanged(-math.inf, path)
        for m in range(set_size):
            included(bound, candidates[m], max(bound.lengths))[number][:] = drawn[m]
        for m, each in enumerate((part, *drawn)):
            each = np.ascontiguousarray(each)
            middle = log_joint(between[number], each)
            to_new[m] += log_joint(new[number], each) - middle
            to_now[m] += log_joint(now[number], each) - middle
    if forward:
        log_r = log_prior_ratio + to_new[1:] - to_now[0]
        log_mean = float(logsumexp(log_r)) - math.log(set_size)
        if not math.isfinite(log_mean):
            return Exchanged(-math.inf, path)
        chances = np.exp(log_r - log_r.max())
        return Exchanged(log_mean, candidates[int(rng.choice(set_size, p=chances / chances.sum()))])
    # From (theta', u[1]) the forward step's set would be x and the others.
    others = np.r_[0, np.arange(2, set_size + 1)]
    log_r = -log_prior_ratio + to_now[others] - to_new[1]
    log_mean = float(logsumexp(log_r)) - math.log(set_size)
    return Exchanged(-log_mean if math.isfinite(log_mean) else -math.inf, candidates[0])


class _SetMove(WalkerMove):
    """One sweep for every walker: conditional SMC for the trajectory at theta, then a proposal of theta with a set."""

    def __init__(self, bound: BoundModel, set_size: int, particles: int, root: Float, gain: float) -> None:
        self.bound, self.set_size, self.particles, self.root, self.gain = bound, set_size, particles, root, gain
        self.transform = Unconstrained(bound.parameters)

    def update(self, walker: tuple[int, Any, Any, int]) -> tuple[Any, float, Any]:
        """Return (theta, log_prob, blob) of one walker after a sweep, given (number, theta, blob, seed)."""
        _, theta, old, seed = walker
        check_interrupt()
        rng, bound, blob = make_rng(np.random.SeedSequence(seed)), self.bound, old.copy()
        path, rows = blob["path"].copy(), max(bound.lengths)
        for tables, part in zip(bound.tables(theta), included(bound, path, rows), strict=True):
            update_path(tables, part, len(part), self.particles, rng, "conditional")
        u = self.transform.to_line(theta)
        step = math.exp(blob["log_scale"]) * (self.root @ rng.standard_normal(u.size))
        middle = self.transform.from_line(u + 0.5 * step)[0]
        other, jacobian_new = self.transform.from_line(u + step)
        forward, log_uniform, log_ratio = bool(rng.random() < 0.5), math.log(rng.random()), -math.inf
        if self._possible(middle) and self._possible(other):
            log_prior_ratio = bound.log_prior(other) + jacobian_new
            log_prior_ratio -= bound.log_prior(theta) + self.transform.from_line(u)[1]
            thetas = (theta, middle, other)
            found = exchange(
                bound, thetas, path, log_prior_ratio, self.set_size, self.particles, rng, forward=forward
            )
            log_ratio = found.log_ratio
            if log_uniform < log_ratio:
                theta, path = other, found.path
        blob["acceptance_rate"] = float(log_uniform < log_ratio)
        blob["path_update_rate"] = float(np.mean(np.any(path != old["path"], axis=1)))
        blob["path"] = path
        blob["log_joint"] = bound.log_prior(theta) + math.fsum(
            log_joint(tables, np.ascontiguousarray(part))
            for tables, part in zip(bound.tables(theta), included(bound, path, rows), strict=True)
        )
        blob["log_scale"] += self.gain * (math.exp(min(log_ratio, 0.0)) - _ACCEPTANCE)
        return np.array(theta), float(blob["log_joint"]), blob

    def _possible(self, theta: Float) -> bool:
        try:
            self.bound.check(theta)
        except ModelError:
            return False
        return self.bound.log_prior(theta) > -math.inf


def trajectory_set_kit(bound: BoundModel, near: NearMode, set_size: int, particles: int) -> WalkKit:
    """Return how chains with sets of trajectories start and move.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    near : NearMode
        Near where the chains start.
    set_size : int
        Trajectories of a set.
    particles : int
        Particles of each conditional SMC pass.

    Returns
    -------
    WalkKit
    """
    dtype = path_dtype(bound, _FIELDS)
    return WalkKit(
        PathStarter(bound, near, dtype),
        lambda root, gain: _SetMove(bound, set_size, particles, root, gain),
        dtype,
        _FIELDS[1:],
    )
