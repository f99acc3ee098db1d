"""What chains share that carry a path with theta and propose theta by an adapted random walk: start and blob."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import FilterError, ModelError
from pmcl.filtering.particle_filter import log_joint, make_rng, update_path
from pmcl.models.robot_model import BoundModel
from pmcl.sampling.near_mode import NearMode
from pmcl.sampling.random_walk import draw_near, no_start
from pmcl.sampling.state import state_dimension
from pmcl.sampling.sweep import included
from pmcl.sampling.transforms import Unconstrained

__all__ = ["PathStarter", "path_dtype"]

Float = NDArray[np.float64]

# Particles of the filter that draws the first path.
_FIRST_PARTICLES = 500


def path_dtype(bound: BoundModel, fields: Sequence[str]) -> np.dtype[Any]:
    """Return the type of a blob with a path of all logs, some numbers, and the log of the proposals' scale.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    fields : sequence of str
        Names of the numbers, ``log_joint`` among them.
    """
    numbers: list[Any] = [(name, np.float64) for name in (*fields, "log_scale")]
    return np.dtype([("path", np.float64, (sum(bound.lengths), state_dimension(bound))), *numbers])


class PathStarter:
    """A picklable function seed -> (theta, log_prob, blob): theta near the mode, and a path drawn for it.

    Parameters
    ----------
    bound : BoundModel
        The model bound to its logs.
    near : NearMode
        Near where the chains start.
    dtype : numpy.dtype
        That of a blob, see :func:`path_dtype`.
    """

    def __init__(self, bound: BoundModel, near: NearMode, dtype: np.dtype[Any]) -> None:
        self.bound, self.near, self.dtype = bound, near, dtype

    def __call__(self, seed: int) -> tuple[Float, float, Any]:
        """Return the state of a chain; raises SamplingError when none is possible."""
        rng, bound = make_rng(np.random.SeedSequence(seed)), self.bound
        for theta in draw_near(self.near, Unconstrained(bound.parameters), rng):
            blob = np.zeros((), dtype=self.dtype)
            path = np.zeros(blob["path"].shape)
            prior = bound.log_prior(theta)
            if not prior > -math.inf:
                continue
            try:
                bound.check(theta)
                tables, paths = bound.tables(theta), included(bound, path, max(bound.lengths))
                done = [
                    update_path(table, part, len(part), _FIRST_PARTICLES, rng, "smoothing").succeeded
                    for table, part in zip(tables, paths, strict=True)
                ]
            except (FilterError, ModelError):
                continue
            if all(done):
                blob["path"] = path
                blob["log_joint"] = prior + math.fsum(
                    log_joint(table, part) for table, part in zip(tables, paths, strict=True)
                )
                return theta, float(blob["log_joint"]), blob
        raise no_start()
