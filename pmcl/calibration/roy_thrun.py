"""Roy and Thrun: systematic errors of odometry by online maximum likelihood."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from pmcl.calibration.method import CalibrationMethod
from pmcl.calibration.settings import setting

if TYPE_CHECKING:
    from typing import Self

    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import PointEstimate
    from pmcl.sampling.options import RunOptions

__all__ = ["OnlineOdometryBias"]


@dataclass(frozen=True)
class OnlineOdometryBias(CalibrationMethod):
    """The biases of odometry, window by window, with noise held at its prior mean; no posterior.

    The paper matches consecutive scans and lets the likeliest drift and rotation error of each pair fade
    exponentially. Here the likelihood of a window's readings is that of an extended Kalman filter given all earlier
    readings, on a known map; each window moves the estimate by one Newton step, and the information of earlier windows
    fades by `decay`. Without fading, and with a linear model, the result is exactly the most probable bias. The biases
    are those that the model has, such as the effects odometry-forward-scale and odometry-turn-scale; parameters that
    are none keep their prior mean, and the prior's standard deviation as standard error.

    Attributes
    ----------
    window : int
        Rows of a window.
    decay : float
        Factor on the information of earlier windows.

    References
    ----------
    Roy, Thrun, Online self-calibration for mobile robots, ICRA 1999.
    Titterington, Recursive parameter estimation using incomplete data, JRSS B 46, 1984.
    """

    name: ClassVar[str] = "roy-thrun"
    description: ClassVar[str] = "online maximum likelihood of odometry's biases (Roy, Thrun), no posterior"

    window: int = setting(20, "Rows after which an online estimate is updated.", least=1)
    decay: float = setting(
        1.0, "Factor on what earlier windows told; below 1 old windows are forgotten.", kind=float, least=0.1, most=1.0
    )

    def shortest(self) -> Self:
        """Return a run of one window."""
        return replace(self, window=10**6)

    def run(self, bound: BoundModel, options: RunOptions) -> PointEstimate:
        """Go once through the logs, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.chains import PointEstimate
        from pmcl.sampling.online_bias import online_bias

        found = online_bias(bound, self.window, self.decay, options.seed)
        units = tuple(parameter.unit for parameter in bound.parameters)
        settings = {**self.record(options), "estimated": ", ".join(found.names), **options.attributes}
        return PointEstimate(bound.names, units, found.theta, found.standard_error, settings=settings)
