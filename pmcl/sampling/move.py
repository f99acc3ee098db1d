"""Particle Gibbs as an emcee move: every walker is a chain of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pmcl.checks import check_type
from pmcl.errors import SamplingError
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.state import blob_dtype, from_blob, into_blob, state_dimension
from pmcl.sampling.sweep import SweepSettings, step
from pmcl.sampling.transforms import Unconstrained
from pmcl.sampling.transport import Transport
from pmcl.sampling.walker_move import WalkerMove

__all__ = ["ParticleGibbsMove"]


class ParticleGibbsMove(WalkerMove):
    """Table 1 of Kaboli, Bowling, Musilek (2006) for every walker of an emcee ensemble.

    The trajectory and the tuning of a walker travel in its blob.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    kernel, particles, metropolis_steps, transport_moves, sweeps, data_rate, gain
        See :class:`~pmcl.sampling.sweep.SweepSettings`.
    transports : sequence of Transport or None, optional
        A frozen linearisation for each walker; without it there are no transport moves.

    Raises
    ------
    SamplingError
        When a setting is not usable.

    Notes
    -----
    A sweep is one move: emcee chooses at random among several moves, which would break the order of Gibbs blocks.
    Start the sampler from a State with log_prob and blobs, see :func:`pmcl.sampling.sweep.start_chain`.
    """

    def __init__(
        self,
        bound: BoundModel,
        *,
        transports: Sequence[Transport | None] | None = None,
        **settings: Any,
    ) -> None:
        check_type("bound", bound, BoundModel, error=SamplingError, advice="make it with RobotModel(...).bind(log)")
        self.bound = bound
        self.settings = SweepSettings(**settings)
        self.transports = transports
        self.transform = Unconstrained(bound.parameters)
        self.dtype = blob_dtype(bound, state_dimension(bound))

    def update(self, walker: tuple[int, Any, Any, int]) -> tuple[Any, float, Any]:
        """Return (theta, log_prob, blob) of one walker after one step, given (number, theta, blob, seed)."""
        number, theta, blob, seed = walker
        transport = self.transports[number] if self.transports is not None else None
        state, info = step(self.bound, self.settings, transport, self.transform, from_blob(theta, blob), seed)
        return state.theta, state.log_joint, into_blob(state, info, self.dtype)
