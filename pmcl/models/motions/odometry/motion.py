"""The odometry models of AMCL as motion models, with the parameters that AMCL has: alpha1 to alpha5."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy import stats

from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.motion import Motion
from pmcl.models.motions.odometry.kernels.residuals import (
    DifferentialResiduals,
    OmniResiduals,
    differential_steps,
    omni_steps,
)
from pmcl.models.motions.odometry.table import DifferentialMotion, OmniMotion
from pmcl.models.parameters import Parameter
from pmcl.models.part import Float, Int, owned

__all__ = ["Differential", "Omni"]


def _prior() -> Any:
    """Return the prior of every alpha, with 95 per cent between 0.0004 and 1.

    nav2's default is 0.2, tunings by hand lie between 0.001 and 1, and a standard deviation of 1 per cent of the
    distance, which good wheels reach, is an alpha3 of 0.0001.
    """
    return stats.lognorm(2.0, scale=0.02)


_ALPHAS = (
    Parameter("alpha1", "1", _prior(), "variance of turns per squared turn", "noise growth"),
    Parameter("alpha2", "rad^2/m^2", _prior(), "variance of turns per squared distance", "noise growth"),
    Parameter("alpha3", "1", _prior(), "variance of distances per squared distance", "noise growth"),
    Parameter("alpha4", "m^2/rad^2", _prior(), "variance of distances per squared turn", "noise growth"),
)
_ALPHA5 = Parameter("alpha5", "1", _prior(), "variance across the direction per squared distance", "noise growth")


@dataclass(frozen=True)
class Differential(Motion):
    """The odometry model of a differential drive: a turn, a straight drive, and a second turn.

    With r1 the direction of the displacement in the robot's frame (0 where it is shorter than 1 cm), T its length and
    r2 the rest of the turn, the noise is Gaussian with the variances

    - of r1: alpha1 r1^2 + alpha2 T^2,
    - of T: alpha3 T^2 + alpha4 (r1^2 + r2^2),
    - of r2: alpha1 r2^2 + alpha2 T^2.

    Squares of angles are those of the angle to the robot's axis, min(abs(r), pi - abs(r)), so that reversing is as
    exact as driving ahead. This is nav2_amcl's ``DifferentialMotionModel``, whose alphas multiply variances, after
    Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 5.4. beluga's model differs in one term: alpha4
    multiplies the square of the whole turn r1 + r2. Small floors are added in squares, so that a robot
    at rest has a density (:mod:`~pmcl.models.motions.odometry.kernels.steps`).
    """

    parameters: tuple[Parameter, ...] = _ALPHAS

    summary: ClassVar[str] = "AMCL's noise of a differential drive: turn, drive, turn"
    aside_by_turning: ClassVar[bool] = True

    def bind(self, log: RobotLog) -> BoundDifferential:
        """Take the log's odometry; raises ModelError when the robot of a whole log never moves."""
        return BoundDifferential(_odometry(log))


@dataclass(frozen=True)
class BoundDifferential:
    """:class:`Differential` with the odometry of one log, `mean` (T, 3)."""

    mean: Float

    def table(self, theta: Float) -> DifferentialMotion:
        """Return the table; theta = (alpha1, alpha2, alpha3, alpha4)."""
        return DifferentialMotion(self.mean, owned(theta))

    def statistics(
        self, table: DifferentialMotion, path: Float, ideal: Any, index: Int, theta: Float
    ) -> DifferentialResiduals:
        """Return the steps themselves: their weights change with theta."""
        return DifferentialResiduals(index, owned(theta), differential_steps(table.mean, np.ascontiguousarray(path)))


@dataclass(frozen=True)
class Omni(Motion):
    """The odometry model of an omnidirectional drive: noise along and across the step, and on the turn.

    With T the length of the odometry's displacement and dth its turn in (-pi, pi], the noise is Gaussian with the
    variances

    - along the displacement: alpha3 T^2 + alpha4 dth^2,
    - across it: alpha5 T^2 + alpha4 dth^2,
    - of the turn: alpha1 dth^2 + alpha2 T^2.

    This is nav2_amcl's ``OmniMotionModel``. beluga's model differs: it folds the turn for reversing, and takes the
    direction of a displacement below 1 cm for the robot's own. Floors as for :class:`Differential`.
    """

    parameters: tuple[Parameter, ...] = (*_ALPHAS, _ALPHA5)

    summary: ClassVar[str] = "AMCL's noise of an omnidirectional drive: along, across, turn"
    moves_sideways: ClassVar[bool] = True

    def bind(self, log: RobotLog) -> BoundOmni:
        """Take the log's odometry; raises ModelError when the robot of a whole log never moves."""
        return BoundOmni(_odometry(log))


@dataclass(frozen=True)
class BoundOmni:
    """:class:`Omni` with the odometry of one log, `mean` (T, 3)."""

    mean: Float

    def table(self, theta: Float) -> OmniMotion:
        """Return the table; theta = (alpha1, alpha2, alpha3, alpha4, alpha5)."""
        return OmniMotion(self.mean, owned(theta))

    def statistics(self, table: OmniMotion, path: Float, ideal: Any, index: Int, theta: Float) -> OmniResiduals:
        """Return the steps themselves: their weights change with theta."""
        return OmniResiduals(index, owned(theta), omni_steps(table.mean, np.ascontiguousarray(path)))


def _odometry(log: RobotLog) -> Float:
    mean = owned(log.odometry)
    if log.is_whole and not mean.any():
        raise ModelError(
            f"{log.where}: noise by alphas needs a robot that moves, but all odometry increments are zero; "
            "use motion = 'increment'"
        )
    return mean
