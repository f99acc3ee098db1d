"""emcee backends that keep every draw of theta but not every trajectory.

A trajectory of 2000 poses takes 48 kB; stored at each step of each chain it would fill memory and disk, and nobody
looks at thousands of them. These backends keep each k-th trajectory and always the last one, which a resumed run needs.
"""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np
from emcee.backends import Backend, HDFBackend
from emcee.state import State
from numpy.typing import NDArray

__all__ = ["CheckpointBackend", "MemoryBackend", "StageBackend"]

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


def _stripped(state: State) -> State:
    return State(
        state.coords, log_prob=state.log_prob, blobs=_without_path(state.blobs), random_state=state.random_state
    )


class MemoryBackend(Backend):  # type: ignore[misc]
    """A chain in memory that keeps the trajectory of every `every`-th step and the last one."""

    def __init__(self, every: int = 1) -> None:
        self.every = every
        self._kept: list[Float] = []
        self._last: Float | None = None
        super().__init__()

    def grow(self, ngrow: int, blobs: Any) -> None:
        """Make room for more steps."""
        super().grow(ngrow, _without_path(blobs))

    def save_step(self, state: State, accepted: Any) -> None:
        """Store one step."""
        if self.iteration % self.every == 0:
            self._kept.append(np.array(state.blobs["path"]))
        self._last = np.array(state.blobs["path"])
        super().save_step(_stripped(state), accepted)

    def get_last_sample(self) -> State:
        """Return the last step, complete."""
        state = super().get_last_sample()
        assert self._last is not None
        state.blobs = _with_path(state.blobs, self._last)
        return state

    def kept_paths(self) -> Float:
        """Return the stored trajectories (M, K, sum of T_l, D); step ``every * i`` has number i."""
        return np.array(self._kept)


class CheckpointBackend(HDFBackend):  # type: ignore[misc]
    """The same in a group of an HDF5 file: emcee's own layout, and two datasets for trajectories beside it."""

    def __init__(self, filename: str, name: str, every: int = 1) -> None:
        self.every = every
        super().__init__(filename, name=name)

    def grow(self, ngrow: int, blobs: Any) -> None:
        """Make room for more steps."""
        super().grow(ngrow, _without_path(blobs))
        shape = blobs["path"].shape
        with self.open("a") as file:
            group = file[self.name]
            if "kept_path" not in group:
                group.create_dataset("kept_path", (0, *shape), maxshape=(None, *shape), dtype=float)
                group.create_dataset("last_path", (2, *shape), dtype=float)
            group["kept_path"].resize(-(-group["chain"].shape[0] // self.every), axis=0)

    def save_step(self, state: State, accepted: Any) -> None:
        """Store one step. emcee's step counter is written last: what it does not count, a killed run did not do."""
        iteration = self.iteration
        with self.open("a") as file:
            group = file[self.name]
            group["last_path"][iteration % 2] = state.blobs["path"]
            if iteration % self.every == 0:
                group["kept_path"][iteration // self.every] = state.blobs["path"]
        super().save_step(_stripped(state), accepted)

    def get_last_sample(self) -> State:
        """Return the last step, complete."""
        state = super().get_last_sample()
        with self.open() as file:
            path = file[self.name]["last_path"][(self.iteration - 1) % 2]
        state.blobs = _with_path(state.blobs, path)
        return state

    def kept_paths(self) -> Float:
        """Return the stored trajectories (M, K, sum of T_l, D); step ``every * i`` has number i."""
        with self.open() as file:
            stored: h5py.Dataset = file[self.name]["kept_path"]
            return np.array(stored[: -(-self.iteration // self.every)])


StageBackend = MemoryBackend | CheckpointBackend
