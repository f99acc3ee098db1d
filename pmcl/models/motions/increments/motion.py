"""Motion models: how far the robot really moved, given what its odometry says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.residuals import GaussianSums
from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.motion import Motion
from pmcl.models.motions.increments.kernels.residuals import GrowingResiduals
from pmcl.models.motions.increments.table import IncrementMotion
from pmcl.models.parameters import Parameter, gamma_prior
from pmcl.models.part import Float, Int, owned

__all__ = ["GrowingIncrementNoise", "IncrementNoise", "increment_residuals"]

_BASE = (
    Parameter("sigma_forward", "m", gamma_prior(0.05), "noise of one increment along the heading", "noise"),
    Parameter("sigma_left", "m", gamma_prior(0.03), "noise of one increment across the heading", "noise"),
    Parameter("sigma_turn", "rad", gamma_prior(0.05), "noise of one increment's turn", "noise"),
)
_GROWTH = tuple(
    Parameter(name, unit, gamma_prior(0.1), f"{what} in the increment", "noise growth")
    for name, unit, what in (
        ("sigma_forward_per_metre", "1", "forward noise per metre travelled"),
        ("sigma_turn_per_radian", "1", "turn noise per radian turned"),
        ("sigma_turn_per_metre", "rad/m", "turn noise per metre travelled"),
    )
)


def increment_residuals(mean: Float, path: NDArray[np.float64]) -> Float:
    """Return true minus expected increments along a path.

    Parameters
    ----------
    mean : ndarray, shape (>= T, 3)
        Expected (forward, left, turn) [m, m, rad]; row 0 is not used.
    path : ndarray, shape (T, >= 3)
        Poses; headings are not wrapped.

    Returns
    -------
    ndarray, shape (T - 1, 3)
        Residuals in the robot frame at the previous sample. Turns are compared unwrapped: see
        :mod:`pmcl.models.tables`.
    """
    step = path[1:, :3] - path[:-1, :3]
    c, s = np.cos(path[:-1, 2]), np.sin(path[:-1, 2])
    out = np.empty_like(step)
    out[:, 0] = c * step[:, 0] + s * step[:, 1]
    out[:, 1] = c * step[:, 1] - s * step[:, 0]
    out[:, 2] = step[:, 2]
    return out - mean[1 : path.shape[0]]


@dataclass(frozen=True)
class IncrementNoise(Motion):
    """The paper's motion model: zero-mean Gaussian noise on forward, left and turn of every increment."""

    parameters: tuple[Parameter, ...] = _BASE

    summary: ClassVar[str] = "the noise of each odometry increment has constant standard deviations"

    def bind(self, log: RobotLog) -> BoundIncrementNoise:
        """Take the log's odometry as the mean of each increment."""
        return BoundIncrementNoise(owned(log.odometry))


@dataclass(frozen=True)
class BoundIncrementNoise:
    """:class:`IncrementNoise` with the odometry of one log, `mean` (T, 3)."""

    mean: Float

    def table(self, theta: Float) -> IncrementMotion:
        """Return the table; theta = (sigma_forward [m], sigma_left [m], sigma_turn [rad])."""
        std = np.empty_like(self.mean)
        std[:] = theta
        return IncrementMotion(self.mean, std)

    def statistics(self, table: IncrementMotion, path: Float, ideal: Any, index: Int, theta: Float) -> GaussianSums:
        """Return the sums of squares of forward, left and turn residuals."""
        residual = increment_residuals(table.mean, path)
        count = np.full(3, float(residual.shape[0]))
        return GaussianSums(index, owned(theta), count, np.einsum("ij,ij->j", residual, residual))


@dataclass(frozen=True)
class GrowingIncrementNoise(Motion):
    """Noise whose standard deviations grow with the size of the increment.

    Variances add: var_forward = sigma_forward^2 + (sigma_forward_per_metre d)^2,
    var_turn = sigma_turn^2 + (sigma_turn_per_radian |turn|)^2 + (sigma_turn_per_metre d)^2, with d the distance of
    the odometry increment (compare alpha1 to alpha4 in Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 5.4).
    """

    parameters: tuple[Parameter, ...] = (*_BASE, *_GROWTH)

    summary: ClassVar[str] = "they grow with the distance and the turn of the increment"

    def bind(self, log: RobotLog) -> BoundGrowingIncrementNoise:
        """Take mean, distance and turn of each increment from the log's odometry."""
        mean = owned(log.odometry)
        if log.is_whole and not (np.hypot(mean[:, 0], mean[:, 1]).any() or mean[:, 2].any()):
            raise ModelError(
                f"{log.where}: noise that grows needs a robot that moves, but all odometry increments are zero; "
                "use motion = 'increment'"
            )
        return BoundGrowingIncrementNoise(mean, np.hypot(mean[:, 0], mean[:, 1]), np.abs(mean[:, 2]))


@dataclass(frozen=True)
class BoundGrowingIncrementNoise:
    """:class:`GrowingIncrementNoise` with `mean` (T, 3), `distance` (T,) [m] and `turn` (T,) [rad] of one log."""

    mean: Float
    distance: Float
    turn: Float

    def table(self, theta: Float) -> IncrementMotion:
        """Return the table; theta in the order of the class's parameters."""
        forward, left, turn, forward_per_metre, turn_per_radian, turn_per_metre = theta
        std = np.empty_like(self.mean)
        std[:, 0] = np.sqrt(forward**2 + (forward_per_metre * self.distance) ** 2)
        std[:, 1] = left
        std[:, 2] = np.sqrt(turn**2 + (turn_per_radian * self.turn) ** 2 + (turn_per_metre * self.distance) ** 2)
        return IncrementMotion(self.mean, std)

    def statistics(self, table: IncrementMotion, path: Float, ideal: Any, index: Int, theta: Float) -> GrowingResiduals:
        """Return the residuals themselves: their weights change with theta."""
        residual = increment_residuals(table.mean, path)
        rows = slice(1, path.shape[0])
        return GrowingResiduals(index, owned(theta), residual, owned(self.distance[rows]), owned(self.turn[rows]))
