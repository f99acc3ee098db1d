"""The results of calibration methods: plain arrays, which :mod:`pmcl.posterior` labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmcl.sampling.options import SettingValue

__all__ = ["Chains", "PointEstimate"]

Float = NDArray[np.float64]


def _no_draws() -> NDArray[np.int64]:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class Chains:
    """Draws of K chains with N draws of d parameters each.

    Attributes
    ----------
    names, units : tuple of str
        Parameter names and their units, length d.
    theta : ndarray, shape (K, N, d)
        Draws of the parameters, after burn-in.
    log_joint : ndarray, shape (K, N), optional
        Log of the joint density of parameters, trajectory and readings (eq. 16 of the paper) at each draw; None when
        the method does not evaluate it.
    statistics : mapping of str to ndarray, shape (K, N) or (K, N, d)
        How the sampler moved at each draw; arrays of shape (K, N, d) belong to the parameters one by one.
    trajectories : tuple of ndarray, shape (K, M, T_l, D)
        One array for each log: M thinned trajectories of T_l states. The first three components of a state are
        the pose (x [m], y [m], heading [rad], not wrapped). Empty when the method draws no trajectories.
    trajectory_draw : ndarray of int, shape (M,)
        Draw index (0 to N-1) that each stored trajectory belongs to.
    warmup_theta : ndarray, shape (K, W, d), optional
        Draws made during burn-in (W may be 0).
    warmup_log_joint : ndarray, shape (K, W), optional
        Their log joint densities.
    settings : mapping of str to scalar
        Every setting of the run, with versions, seed and hashes: enough to run it again.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: Float
    log_joint: Float | None = None
    statistics: Mapping[str, Float] = field(default_factory=dict)
    trajectories: tuple[Float, ...] = ()
    trajectory_draw: NDArray[np.int64] = field(default_factory=_no_draws)
    warmup_theta: Float | None = None
    warmup_log_joint: Float | None = None
    settings: Mapping[str, SettingValue] = field(default_factory=dict)

    @property
    def n_chains(self) -> int:
        """Number of chains K."""
        return int(self.theta.shape[0])

    @property
    def n_draws(self) -> int:
        """Number of draws per chain N."""
        return int(self.theta.shape[1])


@dataclass(frozen=True)
class PointEstimate:
    """The result of a method that finds one value of the parameters, and at best how sure it is.

    Attributes
    ----------
    names, units : tuple of str
        Parameter names and their units, length d.
    theta : ndarray, shape (d,)
        The estimate.
    standard_error : ndarray, shape (d,), optional
        Standard error of each parameter, in its unit; None when the method gives none.
    settings : mapping of str to scalar
        Every setting of the run.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    theta: Float
    standard_error: Float | None = None
    settings: Mapping[str, SettingValue] = field(default_factory=dict)

    def as_chains(self) -> Chains:
        """Return one chain with the estimate as its only draw; standard errors are a statistic of that draw."""
        statistics = {} if self.standard_error is None else {"standard_error": self.standard_error[None, None, :]}
        settings: dict[str, SettingValue] = {**self.settings, "chains": 1, "draws": 1, "point_estimate": True}
        return Chains(self.names, self.units, self.theta[None, None, :], statistics=statistics, settings=settings)
