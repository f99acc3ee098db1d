"""The storage of a stage: every draw of theta, but only those trajectories that are needed later.

A trajectory of 2000 poses takes 48 kB; stored at each step of each chain it would fill memory and disk. Three things
are needed of them: the last one of each chain, from which the next step is made; their mean over the last steps of a
stage of burn-in, around which the model is linearised; and some of those of the draws, which are part of the result.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from emcee.backends import Backend
from emcee.state import State
from numpy.typing import NDArray

__all__ = ["StageBackend"]

Float = NDArray[np.float64]


def _without_path(blobs: Any) -> Any:
    names = [name for name in blobs.dtype.names if name != "path"]
    plain = np.zeros(blobs.shape, dtype=[(name, blobs.dtype[name]) for name in names])
    for name in names:
        plain[name] = blobs[name]
    return plain


def _with_path(blobs: Any, path: Float) -> Any:
    fields: list[Any] = [("path", float, path.shape[1:])]
    fields += [(name, blobs.dtype[name]) for name in blobs.dtype.names]
    full = np.zeros(blobs.shape, dtype=fields)
    full["path"] = path
    for name in blobs.dtype.names:
        full[name] = blobs[name]
    return full


class StageBackend(Backend):  # type: ignore[misc]
    """An emcee backend in memory for one stage of a run; :mod:`pmcl.sampling.checkpoint` writes it to disk.

    Parameters
    ----------
    steps : int
        How many steps the stage has.
    window : int
        Over how many steps at its end trajectories are averaged; 0: over none.
    keep_every : int
        Every how many steps a trajectory is kept; 0: none is.

    Attributes
    ----------
    window_start : int
        The first step of the window; a stage that will be ended early begins it earlier.
    path_sum : ndarray of shape (K, sum of T_l, D) or None
        Sum of the trajectories of the window so far.
    last_path : ndarray of shape (K, sum of T_l, D) or None
        Trajectories after the last step.
    first_path : ndarray of shape (K, sum of T_l, D) or None
        The first trajectories that were kept.
    kept_offsets : list of ndarray of float32, shape (K, sum of T_l, D)
        The trajectories that were kept, as differences from `first_path`. Single precision leaves errors of a
        ten-millionth of what trajectories differ by, and takes half the space.
    whole : bool
        False when a step was stored only in part, because something broke in meanwhile.
    """

    def __init__(self, steps: int, window: int = 0, keep_every: int = 0) -> None:
        self.steps = steps
        self.window_start = steps - window
        self.keep_every = keep_every
        self.path_sum: Float | None = None
        self.last_path: Float | None = None
        self.first_path: Float | None = None
        self.kept_offsets: list[NDArray[np.float32]] = []
        self.whole = True
        super().__init__()
        self.iteration = 0  # emcee sets it only when the first step comes

    @property
    def complete(self) -> bool:
        """Whether all steps of the stage have been made."""
        return bool(self.iteration >= self.steps)

    def grow(self, ngrow: int, blobs: Any) -> None:
        """Make room for more steps."""
        super().grow(ngrow, _without_path(blobs))

    def save_step(self, state: State, accepted: Any) -> None:
        """Store one step."""
        self.whole = False
        path = np.array(state.blobs["path"])
        if self.keep_every and self.iteration % self.keep_every == 0:
            if self.first_path is None:
                self.first_path = path
            self.kept_offsets.append((path - self.first_path).astype(np.float32))
        if self.iteration >= self.window_start:
            self.path_sum = path.copy() if self.path_sum is None else self.path_sum + path
        self.last_path = path
        plain = State(
            state.coords, log_prob=state.log_prob, blobs=_without_path(state.blobs), random_state=state.random_state
        )
        super().save_step(plain, accepted)
        self.whole = True

    def get_last_sample(self) -> State:
        """Return the last step, complete."""
        state = super().get_last_sample()
        assert self.last_path is not None
        state.blobs = _with_path(state.blobs, self.last_path)
        return state

    def begin_window(self) -> None:
        """Let the window begin now, if it has not begun: the stage will be ended before its last step."""
        self.window_start = min(self.window_start, int(self.iteration))

    @property
    def window(self) -> slice:
        """The steps of the window, at least the last step."""
        return slice(min(self.window_start, int(self.iteration) - 1), None)

    def window_mean(self) -> Float:
        """Return the mean trajectory of each chain over the window, shape (K, sum of T_l, D)."""
        if self.path_sum is None:
            assert self.last_path is not None
            return self.last_path
        return np.asarray(self.path_sum / (self.iteration - self.window_start))

    def window_paths(self) -> Float:
        """Return those of the kept trajectories that lie in the window, (M, K, sum of T_l, D); M may be 0."""
        if self.first_path is None:
            assert self.last_path is not None
            return np.empty((0, *self.last_path.shape))
        steps = self.keep_every * np.arange(len(self.kept_offsets))
        return self.kept_paths()[steps >= self.window.indices(self.iteration)[0]]

    def kept_paths(self) -> Float:
        """Return the trajectories that were kept (M, K, sum of T_l, D); step ``keep_every * i`` has number i."""
        assert self.first_path is not None
        return self.first_path + np.array(self.kept_offsets, dtype=np.float64)
