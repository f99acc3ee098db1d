"""An emcee move in which every walker is a chain of its own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from emcee.moves import Move
from emcee.state import State

__all__ = ["WalkerMove"]


class WalkerMove(Move, ABC):  # type: ignore[misc]
    """One step for every walker by itself.

    What a walker carries besides theta travels in its blob, and all randomness comes from seeds that emcee's own
    generator gives out, one per walker and step: what happens does not depend on the pool, and an emcee backend holds
    everything that a resumed run needs.
    """

    @abstractmethod
    def update(self, walker: tuple[int, Any, Any, int]) -> tuple[Any, float, Any]:
        """Return (theta, log_prob, blob) of one walker after one step, given (number, theta, blob, seed)."""

    def propose(self, model: Any, state: State) -> tuple[State, Any]:
        """Advance all walkers by one step.

        Parameters
        ----------
        model : emcee.model.Model
            Its `map_fn` runs the walkers, its `random` seeds them.
        state : emcee.State
            With log_prob and blobs.

        Returns
        -------
        state : emcee.State
            The new state.
        accepted : ndarray of bool, shape (K,)
            Whether theta changed.
        """
        n_walkers = state.coords.shape[0]
        seeds = model.random.randint(0, 2**62, size=n_walkers, dtype=np.int64)
        work = [(k, state.coords[k], state.blobs[k], int(seeds[k])) for k in range(n_walkers)]
        results = list(model.map_fn(self.update, work))
        coords = np.array([result[0] for result in results])
        blobs = np.array([result[2] for result in results], dtype=state.blobs.dtype)
        accepted = np.any(coords != state.coords, axis=1)
        log_prob = np.array([result[1] for result in results])
        # emcee itself adds the state of its generator.
        return State(coords, log_prob=log_prob, blobs=blobs), accepted
