"""The Gaussian transport move: theta and trajectory change together, exactly.

What limits a Gibbs sampler here is that theta and the path hold each other in place. Around a frozen reference the
model is linear and Gaussian, and its path is x = m(theta) + L(theta) z with z standard normal
(:mod:`pmcl.filtering.kernels.linear`). A move proposes theta' and carries the path along with its z fixed; it is accepted with
p(theta', x', data) |L(theta')| / (p(theta, x, data) |L(theta)|), x' = m(theta') + L(theta') z. This is a deterministic
bijection, so the move leaves the exact, nonlinear posterior unchanged; how good the linearisation is decides only how often it is accepted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.filtering.kernels.linear import factorise, transport_trial
from pmcl.filtering.predict import reading_geometry
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.transforms import Unconstrained

__all__ = ["Transport", "linearised_at", "transport_moves"]

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Transport:
    """A frozen linearisation and proposal.

    Attributes
    ----------
    references : tuple of ndarray, shape (T_l, D)
        Reference trajectory of each log.
    geometries : tuple of tuple
        For each log and sensor: its readings, linearised at the reference.
    root : ndarray, shape (d, d)
        The proposal in unconstrained parameters is u' = u + root @ standard normal.
    """

    references: tuple[Float, ...]
    geometries: tuple[tuple[Any, ...], ...]
    root: Float


def linearised_at(
    bound: BoundModel, theta: Float, references: Sequence[Float], root: Float
) -> Transport | None:
    """Linearise the model at `theta` and one reference trajectory for each log.

    Returns None when some sensor offers no linearisation, or the linearised path has no factorisation: there is
    then no transport move.
    """
    geometries = []
    for tables, reference in zip(bound.tables(theta), references, strict=True):
        made = tuple(reading_geometry(sensor, reference) for sensor in tables.sensors)
        if any(geometry is None for geometry in made):
            return None
        geometries.append(made)
    transport = Transport(tuple(np.ascontiguousarray(r) for r in references), tuple(geometries), np.array(root))
    return transport if _factorisations(bound, theta, transport) is not None else None


def _factorisations(bound: BoundModel, theta: Float, transport: Transport) -> list[Any] | None:
    made = [
        factorise(tables, geometry, reference)
        for tables, geometry, reference in zip(
            bound.tables(theta), transport.geometries, transport.references, strict=True
        )
    ]
    return made if all(math.isfinite(one[0]) for one in made) else None


def transport_moves(
    bound: BoundModel,
    theta: Float,
    paths: Sequence[Float],
    log_joint: float,
    transport: Transport,
    transform: Unconstrained,
    n_moves: int,
    scale: float,
    rng: np.random.Generator,
) -> tuple[Float, list[Float], float, float]:
    """Make `n_moves` transport moves.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    theta : ndarray, shape (d,)
        Current parameters.
    paths : sequence of ndarray, shape (T_l, D)
        Current trajectories over all rows.
    log_joint : float
        log p(theta, trajectories, readings) at the current state.
    transport : Transport
        The linearisation; it must not depend on the current state.
    transform : Unconstrained
        The map to unconstrained parameters.
    n_moves : int
        Number of proposals.
    scale : float
        Factor on the proposal; frozen after burn-in.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    theta, paths, log_joint
        The new state.
    accepted : float
        Share of accepted proposals. Cost: O(T D^3) for each.
    """
    paths = list(paths)
    now = _factorisations(bound, theta, transport)
    if now is None:
        return theta, paths, log_joint, 0.0
    u = transform.to_line(theta)
    _, log_jacobian = transform.from_line(u)
    current = log_joint + log_jacobian - math.fsum(one[0] for one in now)
    steps = scale * (rng.standard_normal((n_moves, theta.size)) @ transport.root.T)
    log_uniform = np.log(rng.random(n_moves))
    accepted = 0
    for step, threshold in zip(steps, log_uniform, strict=True):
        u_new = u + step
        theta_new, log_jacobian = transform.from_line(u_new)
        prior = bound.log_prior(theta_new)
        if not prior > -math.inf:
            continue
        trials = [
            transport_trial(tables, geometry, reference, path, *one[1:4])
            for tables, geometry, reference, path, one in zip(
                bound.tables(theta_new), transport.geometries, transport.references, paths, now, strict=True
            )
        ]
        joint_new = prior + math.fsum(trial[0] for trial in trials)
        value = joint_new + log_jacobian - math.fsum(trial[1] for trial in trials)
        # A comparison with NaN (inf - inf of a failed factorisation) is False: such proposals are refused.
        if threshold < value - current:
            accepted += 1
            theta, u, current, log_joint = theta_new, u_new, value, joint_new
            paths = [trial[5] for trial in trials]
            now = [trial[1:5] for trial in trials]
    return theta, paths, log_joint, accepted / max(n_moves, 1)
