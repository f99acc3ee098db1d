"""The Gaussian transport move: theta and trajectory change together, exactly.

A Gibbs sampler mixes slowly here because theta and the path depend strongly on each other. Around a frozen reference
the model is linear and Gaussian, and its path is x = m(theta) + L(theta) z with z standard normal
(:mod:`pmcl.filtering.kernels.linear`). A move proposes theta' and carries the path along with its z fixed; it is
accepted with p(theta', x', data) |L(theta')| / (p(theta, x, data) |L(theta)|), x' = m(theta') + L(theta') z. This is
a deterministic bijection, so the move leaves the exact, nonlinear posterior unchanged; how good the linearisation is
decides only how often it is accepted.

Because the path is nearly Gaussian given theta, such a move is accepted almost as one on the marginal posterior of
theta would be. So there are two kinds of proposals: random walks, which work from anywhere, and independent draws
from a multivariate t fitted during burn-in, which are mostly accepted more often than not and forget the past at once.
How many there are of each, and how often particles draw the path besides, is the
:class:`~pmcl.sampling.schedule.Schedule`.

Before them the path may be redrawn block by block from the linearised model, each block accepted or refused by itself.
Where precise readings make every particle but one unlikely, conditional SMC hardly ever changes the path; the
linearised model knows where it may go.

Where readings may be gross errors, two paths may explain the same log, and neither leads to the other by small steps.
The path is then redrawn around such readings in a way that changes sides (:mod:`pmcl.sampling.doubtful_rows`).

Heavy-tailed motion noise is no Gaussian. Where the tails are heavy, the precision of each step is therefore drawn
first, and the model given the precisions is linearised (:mod:`pmcl.sampling.scale_mixture`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from pmcl.filtering.kernels.linear import refresh_blocks, standardised, transport_trial
from pmcl.filtering.not_a_number import check_density
from pmcl.filtering.particle_filter import log_joint as log_density
from pmcl.models.robot_model import BoundModel
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables
from pmcl.sampling.doubtful_rows import Doubts, doubts_at, redrawn_where_doubtful, shared_doubts
from pmcl.sampling.marginals import Marginals
from pmcl.sampling.scale_mixture import Precisions, heavy_tailed
from pmcl.sampling.schedule import STRETCHED, Schedule
from pmcl.sampling.transforms import Unconstrained

__all__ = ["Proposal", "Transport", "TransportResult", "linearised_at", "sharing_doubts", "transport_moves"]

Float = NDArray[np.float64]

# Degrees of freedom of the independent proposal: tails heavier than a posterior's are what makes it safe. Its scale
# matrix is the covariance of the draws, which are few; its own covariance is a third greater.
_FREEDOM = 8.0
# Where readings are doubtful, a sweep redraws the path around them so many times: with four instead of one, chains of
# Create 3 of MRCLAM give 1.9 times the effective draws for the CPU second.
_DOUBTFUL_REDRAWS = 4
# The two kinds of proposals.
_WALK, _JUMP = 0, 1


@dataclass(frozen=True)
class Proposal:
    """How theta' is proposed, in unconstrained parameters.

    Attributes
    ----------
    root : ndarray, shape (d, d)
        Random walk: u' = u + root @ standard normal.
    centre, spread : ndarray, shape (d,) and (d, d), optional
        Independent proposal: multivariate t around `centre` with scale matrix ``spread @ spread.T``, `spread` lower
        triangular; without it all moves are random walks.
    marginals : Marginals, optional
        Shapes of the parameters: the t is then one of the values that are normal under them.
    """

    root: Float
    centre: Float | None = None
    spread: Float | None = None
    marginals: Marginals | None = None

    @functools.cached_property
    def _whitening(self) -> Float:
        assert self.spread is not None
        return np.asarray(solve_triangular(self.spread, np.eye(self.spread.shape[0]), lower=True))

    def log_density(self, u: Float) -> Float:
        """Return the log density of the independent proposal at u (..., d), up to a constant, (...)."""
        assert self.centre is not None
        slope: Float | float = 0.0
        if self.marginals is not None:
            u, slope = self.marginals.to_normal_with_slope(u)
        z = (u - self.centre) @ self._whitening.T
        return np.asarray(slope - 0.5 * (_FREEDOM + u.shape[-1]) * np.log1p((z * z).sum(axis=-1) / _FREEDOM))

    def independent(self, normal: Float, stretch: Float) -> Float:
        """Return independent proposals, (n, d).

        Parameters
        ----------
        normal : ndarray, shape (n, d)
            Standard normals.
        stretch : ndarray, shape (n,)
            By how much draws of the t are farther from its centre than those of a normal distribution.
        """
        assert self.centre is not None
        assert self.spread is not None
        value = self.centre + stretch[:, None] * (normal @ self.spread.T)
        return value if self.marginals is None else self.marginals.from_normal(value)


_USUAL = Schedule()


class TransportResult(NamedTuple):
    """The state after some transport moves, and how they went.

    Attributes
    ----------
    theta : ndarray, shape (d,)
        Parameters.
    paths : list of ndarray, shape (T_l, D)
        Trajectories.
    log_joint : float
        log p(theta, trajectories, readings); NaN where the linearised path had no factorisation, so that nothing was
        moved.
    walk_acceptance_rate, jump_rate : float
        Shares of accepted random walks and of accepted independent proposals; NaN when none was made.
    redraw_rate : float
        Share of the paths' rows that the block move redrew; NaN when it was not made.
    """

    theta: Float
    paths: list[Float]
    log_joint: float
    walk_acceptance_rate: float
    jump_rate: float
    redraw_rate: float


class _Trial(NamedTuple):
    """One log at a proposed theta, see :func:`pmcl.filtering.kernels.linear.transport_trial`.

    Attributes
    ----------
    log_joint : float
        log p(carried path, readings | proposed theta).
    log_determinant : float
        Sum of the logs of the diagonals of the linearised path's factors at the proposed theta.
    path : ndarray, shape (T, D)
        The path carried along.
    """

    log_joint: float
    log_determinant: float
    path: Float


@dataclass(frozen=True)
class Transport:
    """A frozen linearisation and proposal.

    Attributes
    ----------
    references : tuple of ndarray, shape (T_l, D)
        Reference trajectory of each log.
    geometries : tuple of tuple
        For each log and sensor: its readings, linearised at the reference.
    proposal : Proposal
        How theta' is proposed.
    sensors : tuple of tuple
        For each log: the sensor tables that the geometries were made from.
    schedule : Schedule
        How often which move is made.
    mixture : bool
        Whether the precisions of heavy-tailed motion noise are drawn first (:mod:`pmcl.sampling.scale_mixture`).
    doubts : tuple of Doubts
        For each log: readings that may be gross errors (:mod:`pmcl.sampling.doubtful_rows`).
    """

    references: tuple[Float, ...]
    geometries: tuple[tuple[Any, ...], ...]
    proposal: Proposal
    sensors: tuple[tuple[Any, ...], ...] = ()
    schedule: Schedule = _USUAL
    mixture: bool = False
    doubts: tuple[Doubts, ...] = ()

    def geometries_at(self, all_tables: Sequence[Tables]) -> list[tuple[Any, ...]]:
        """Return the linearised readings under some theta: sensors and maps may have moved with it."""
        if not self.sensors:
            return list(self.geometries)
        return [
            tuple(
                sensor_of(table).moved_linearisation(table, linearised, geometry, reference)
                for table, linearised, geometry in zip(tables.sensors, sensors, geometries, strict=True)
            )
            for tables, sensors, geometries, reference in zip(
                all_tables, self.sensors, self.geometries, self.references, strict=True
            )
        ]


def linearised_at(
    bound: BoundModel,
    theta: Float,
    references: Sequence[Float],
    proposal: Proposal,
    schedule: Schedule = _USUAL,
    paths: Sequence[Float] = (),
) -> Transport | None:
    """Linearise the model at some parameters and one reference trajectory for each log.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Parameters.
    references : sequence of ndarray, shape (T_l, D)
        Reference trajectories.
    proposal : Proposal
        How theta' is proposed.
    schedule : Schedule
        How often which move is made.
    paths : sequence of ndarray, shape (N, T_l, D)
        For each log some draws of its path, to which the linearised readings are fitted.

    Returns
    -------
    Transport or None
        None when some sensor offers no linearisation, or the linearised path has no factorisation: there is then no
        transport move.
    """
    geometries = []
    all_tables = bound.tables(theta)
    for tables, reference in zip(all_tables, references, strict=True):
        log_geometries = tuple(sensor_of(sensor).linearise(sensor, reference) for sensor in tables.sensors)
        if any(geometry is None for geometry in log_geometries):
            return None
        geometries.append(log_geometries)
    mixture = all(heavy_tailed(tables) for tables in all_tables)
    transport = Transport(
        tuple(np.ascontiguousarray(r) for r in references),
        tuple(_fitted(*of_log) for of_log in zip(all_tables, geometries, references, paths, strict=True))
        if paths
        else tuple(geometries),
        proposal,
        tuple(tables.sensors for tables in all_tables),
        schedule,
        mixture,
        tuple(map(functools.partial(doubts_at, heavy_tails=mixture), all_tables, geometries, references)),
    )
    usable = _standardised(all_tables, transport.geometries, transport.references, references) is not None
    return transport if usable else None


def _fitted(tables: Tables, geometries: tuple[Any, ...], reference: Float, paths: Float) -> tuple[Any, ...]:
    """Return the linearised readings of one log, fitted to some paths."""
    return tuple(
        sensor_of(sensor).fitted_linearisation(sensor, geometry, reference, paths)
        for sensor, geometry in zip(tables.sensors, geometries, strict=True)
    )


def sharing_doubts(transports: Sequence[Transport | None]) -> list[Transport | None]:
    """Return the transports of several chains, each with the doubts of all: another chain may rest elsewhere."""
    known = [transport for transport in transports if transport is not None]
    of_logs = [
        shared_doubts([one.doubts[log] for one in known], [one.geometries[log] for one in known])
        for log in range(len(known[0].references) if known else 0)
    ]
    shared = iter(zip(*of_logs, strict=True))
    return [None if transport is None else replace(transport, doubts=next(shared)) for transport in transports]


def _standardised(
    all_tables: Sequence[Tables],
    geometries: Sequence[tuple[Any, ...]],
    references: Sequence[Float],
    paths: Sequence[Float],
) -> tuple[float, list[Float]] | None:
    """Return the log determinant of all logs, and each path's z; None when a linearised path has no factorisation."""
    of_logs = [
        standardised(*of_log) for of_log in zip(all_tables, geometries, references, paths, strict=True)
    ]
    log_determinant = math.fsum(of_log[0] for of_log in of_logs)
    return (log_determinant, [of_log[1] for of_log in of_logs]) if math.isfinite(log_determinant) else None


def transport_moves(
    bound: BoundModel,
    theta: Float,
    all_tables: Sequence[Tables],
    paths: Sequence[Float],
    transport: Transport,
    transform: Unconstrained,
    n_moves: int,
    scale: float,
    rng: np.random.Generator,
) -> TransportResult:
    """Redraw the path block by block if its turn has come, then make transport moves: random walks and jumps.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Current parameters.
    all_tables : sequence of Tables
        Their coefficient tables, one for each log.
    paths : sequence of ndarray, shape (T_l, D)
        Current trajectories over all rows.
    transport : Transport
        The linearisation and proposal; they must not depend on the current state.
    transform : Unconstrained
        The map to unconstrained parameters.
    n_moves : int
        Number of proposals.
    scale : float
        Factor on the random walk; frozen after burn-in.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    TransportResult
        Cost: O(T D^3) for each proposal.
    """
    precisions = Precisions.drawn(all_tables, paths, rng) if transport.mixture else Precisions()
    tables_here, all_tables = all_tables, precisions.given(all_tables)
    geometries, share = transport.geometries_at(all_tables), transport.schedule.redraw_share
    if share == 1.0 or rng.random() < share:
        redrawn, log_joint, redraw_rate = _redrawn(all_tables, geometries, transport, paths, rng)
    else:
        redrawn, redraw_rate = list(paths), math.nan
        log_joint = _log_density(all_tables, paths)
    if any(doubts.rows.size for doubts in transport.doubts):
        redrawn, log_joint = _redrawn_where_doubtful(all_tables, geometries, transport, redrawn, rng)
    start = _standardised(all_tables, geometries, transport.references, redrawn)
    if start is None:
        return TransportResult(theta, list(paths), math.nan, 0.0, math.nan, 0.0)
    paths, (log_determinant, z) = redrawn, start  # moves do not change z
    log_joint += bound.log_prior(theta)
    proposal = transport.proposal
    u = transform.to_line(theta)
    _, log_jacobian = transform.from_line(u)
    current = log_joint + log_jacobian - log_determinant + precisions.log_density(tables_here)
    normal = rng.standard_normal((n_moves, theta.size))
    stretch = np.sqrt(_FREEDOM / rng.chisquare(_FREEDOM, n_moves))
    log_uniform = np.log(rng.random(n_moves))
    walks = rng.random(n_moves) < transport.schedule.walk_share
    if proposal.centre is None:
        walks[:] = True
    follow = rng.random(n_moves) < 0.5 if precisions.logs else np.zeros(n_moves, bool)
    log_here: float | None = None  # the independent proposal's density at u, where it is known
    # Independent proposals do not depend on where the chain is: all of a sweep are made at once.
    if not walks.all():
        jumps = proposal.independent(normal, stretch)
        log_here, *log_jumps = proposal.log_density(np.vstack([u, jumps])).tolist()
    proposed, accepted = [0, 0], [0, 0]
    for move in range(n_moves):
        kind = _WALK if walks[move] else _JUMP
        proposed[kind] += 1
        log_forward = log_back = 0.0
        if kind == _JUMP:
            u_new = jumps[move]
            log_here = float(proposal.log_density(u)) if log_here is None else log_here
            log_forward, log_back = log_jumps[move], log_here
        else:
            u_new = u + scale * (proposal.root @ normal[move])
        theta_new, log_jacobian = transform.from_line(u_new)
        prior = bound.log_prior(theta_new)
        if not prior > -math.inf:
            continue
        tables_new = bound.tables(theta_new)
        precisions_new, log_slope = precisions, 0.0
        if follow[move]:
            precisions_new, log_slope = precisions.following(tables_here, tables_new)
        given_new = precisions_new.given(tables_new)
        trials = [
            _Trial(*transport_trial(*of_log))
            for of_log in zip(given_new, transport.geometries_at(given_new), transport.references, z, strict=True)
        ]
        joint_new = math.fsum(trial.log_joint for trial in trials)
        joint_new = prior + check_density(joint_new, bound, theta_new, [trial.path for trial in trials])
        if not joint_new > -math.inf:  # impossible there, or the linearised path has no factorisation
            continue
        value = joint_new + log_jacobian - math.fsum(trial.log_determinant for trial in trials)
        value += precisions_new.log_density(tables_new)
        if log_uniform[move] < value - current + log_slope + log_back - log_forward:
            accepted[kind] += 1
            theta, u, current, log_joint = theta_new, u_new, value, joint_new
            precisions, tables_here = precisions_new, tables_new
            log_here = log_forward if kind == _JUMP else None
            paths = [trial.path for trial in trials]
    walk_rate, jump_rate = (
        accepted[kind] / proposed[kind] if proposed[kind] else math.nan for kind in (_WALK, _JUMP)
    )
    if precisions.logs:  # they were held fixed, and are now forgotten
        log_joint = bound.log_prior(theta) + _log_density(bound.tables(theta), paths)
    return TransportResult(theta, paths, log_joint, walk_rate, jump_rate, redraw_rate)


def _log_density(all_tables: Sequence[Tables], paths: Sequence[Float]) -> float:
    """Return the log density of all logs' paths and readings."""
    return math.fsum(log_density(tables, path) for tables, path in zip(all_tables, paths, strict=True))


def _redrawn(
    all_tables: Sequence[Tables],
    geometries: Sequence[tuple[Any, ...]],
    transport: Transport,
    paths: Sequence[Float],
    rng: np.random.Generator,
) -> tuple[list[Float], float, float]:
    """Redraw all paths in blocks with boundaries chosen anew; return (paths, their log density, share accepted)."""
    schedule = transport.schedule
    block = schedule.block * (STRETCHED[rng.integers(len(STRETCHED))] if schedule.stretched else 1)
    new, log_density, accepted = [], 0.0, []
    for tables, geometry, reference, old in zip(all_tables, geometries, transport.references, paths, strict=True):
        n_steps = old.shape[0]
        inner = np.arange(1 + rng.integers(block), n_steps, block)
        starts = np.concatenate([[0], inner, [n_steps]]).astype(np.int64)
        path, noise = old.copy(), rng.standard_normal(old.shape)
        value, share = refresh_blocks(
            tables, geometry, reference, path, starts, noise, np.log(rng.random(starts.size - 1))
        )
        new.append(path)
        log_density += value
        accepted.append(share)
    return new, log_density, math.fsum(accepted) / len(accepted)


def _redrawn_where_doubtful(
    all_tables: Sequence[Tables],
    geometries: Sequence[tuple[Any, ...]],
    transport: Transport,
    paths: Sequence[Float],
    rng: np.random.Generator,
) -> tuple[list[Float], float]:
    """Redraw all paths around doubtful rows; return them and their log density."""
    new, log_density = [], 0.0
    for tables, geometry, reference, doubts, old in zip(
        all_tables, geometries, transport.references, transport.doubts, paths, strict=True
    ):
        if doubts.rows.size:
            path, value = redrawn_where_doubtful(
                tables, geometry, reference, doubts, old, _DOUBTFUL_REDRAWS, rng
            )
        else:
            path, value = old, _log_density([tables], [old])
        new.append(path)
        log_density += value
    return new, log_density
