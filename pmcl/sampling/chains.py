"""What a calibration run returns: plain arrays, labelled later by :mod:`pmcl.posterior`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["Chains"]

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Chains:
    """Draws of K chains with N draws of d parameters each.

    Attributes
    ----------
    names, units : tuple of str
        Parameter names and their units, length d.
    theta : ndarray, shape (K, N, d)
        Draws of the parameters, after burn-in.
    log_joint : ndarray, shape (K, N)
        Log of the joint density of parameters, trajectory and readings (eq. 16 of the paper) at each draw.
    statistics : mapping of str to ndarray, shape (K, N) or (K, N, d)
        How the sampler moved at each draw; arrays of shape (K, N, d) belong to the parameters one by one.
    trajectories : tuple of ndarray, shape (K, M, T_l, D)
        One array for each log: M thinned trajectories of T_l states. The first three components of a state are
        the pose (x [m], y [m], heading [rad], not wrapped).
    trajectory_draw : ndarray of int, shape (M,)
        Draw index (0 to N-1) that each stored trajectory belongs to.
    warmup_theta : ndarray, shape (K, W, d)
        Draws made during burn-in (W may be 0).
    warmup_log_joint : ndarray, shape (K, W)
        Their log joint densities.
    settings : mapping of str to scalar
        Every setting of the run, with versions, seed and hashes: enough to run it again.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: Float
    log_joint: Float
    statistics: Mapping[str, Float]
    trajectories: tuple[Float, ...]
    trajectory_draw: NDArray[np.int64]
    warmup_theta: Float
    warmup_log_joint: Float
    settings: Mapping[str, str | int | float | bool] = field(default_factory=dict)

    @property
    def n_chains(self) -> int:
        """Number of chains K."""
        return int(self.theta.shape[0])

    @property
    def n_draws(self) -> int:
        """Number of draws per chain N."""
        return int(self.theta.shape[1])
