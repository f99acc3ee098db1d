"""The Kalman family: extended and unscented filters instead of particles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final

from pmcl.calibration.method import CalibrationMethod
from pmcl.calibration.settings import setting

if TYPE_CHECKING:
    from typing import Self

    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import Chains
    from pmcl.sampling.options import RunOptions

__all__ = ["ExtendedKalman", "UnscentedKalman"]

# The share of accepted proposals that is best for a random walk in several dimensions (Roberts, Gelman, Gilks 1997).
_ACCEPTANCE: Final = 0.234


@dataclass(frozen=True)
class ExtendedKalman(CalibrationMethod):
    """Adaptive random-walk Metropolis on the marginal likelihood of an extended Kalman filter.

    The posterior is exact for linear Gaussian models and biased for all others, by as much as beliefs about the state
    are no Gaussians and motion and readings no straight lines: beams that cross the edge of a wall count with their
    density at the prediction, gross errors by the share that they have there. The filter is written on pmcl's own
    linearisations of motion and sensors, because filterpy, the usual library, has had no release since 2018 and would
    take the slopes of every sensor from the caller anyway.

    Attributes
    ----------
    tuning_steps : tuple of int
        Draws of each stage of burn-in.
    proposals_per_draw : int
        Proposals from one stored draw to the next.

    References
    ----------
    Kalman, A new approach to linear filtering and prediction problems, J. Basic Eng. 82, 1960.
    Thrun, Burgard, Fox, Probabilistic Robotics, 2005, section 7.4.
    Särkkä, Bayesian Filtering and Smoothing, 2013, section 12.3.
    """

    name: ClassVar[str] = "ekf"
    description: ClassVar[str] = "Metropolis on an extended Kalman filter's evidence, biased by its linearisation"
    unscented: ClassVar[bool] = False

    tuning_steps: tuple[int, ...] = setting((60, 100, 100), "Draws of each stage of burn-in.", kind=tuple, least=4)
    proposals_per_draw: int = setting(5, "Proposals from one stored draw to the next.", least=1)

    def shortest(self) -> Self:
        """Return a run with short stages."""
        return replace(self, tuning_steps=(4, 4), proposals_per_draw=1)

    def run(self, bound: BoundModel, options: RunOptions) -> Chains:
        """Run the chains, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.kalman import KalmanTarget
        from pmcl.sampling.near_mode import near_mode
        from pmcl.sampling.random_walk import WalkPlan, run_random_walk
        from pmcl.sampling.session import check_run_memory

        check_run_memory(bound, options.chains, 2, options)
        near = near_mode(bound, options.seed)
        target = KalmanTarget(bound, near.references, unscented=self.unscented)
        plan = WalkPlan(self.tuning_steps, self.proposals_per_draw, _ACCEPTANCE)
        return run_random_walk(target, near, plan, options, self.record(options))


@dataclass(frozen=True)
class UnscentedKalman(ExtendedKalman):
    """The same with an unscented Kalman filter.

    Motion is carried through 2 D + 1 sigma points. Readings are regressed over the sigma points of the prediction one
    by one, and what a straight line leaves is added to their noise; that their residuals from the line are correlated
    is neglected. Sensors whose linearisation is of a kind of their own count by it as in the extended filter.

    References
    ----------
    Julier, Uhlmann, Unscented filtering and nonlinear estimation, Proceedings of the IEEE 92, 2004.
    """

    name: ClassVar[str] = "ukf"
    description: ClassVar[str] = "the same with an unscented Kalman filter, biased where beliefs are no Gaussians"
    unscented: ClassVar[bool] = True

    proposals_per_draw: int = setting(1, "Proposals from one stored draw to the next.", least=1)
