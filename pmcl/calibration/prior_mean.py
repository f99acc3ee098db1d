"""The prior mean: what any method should beat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pmcl.calibration.method import CalibrationMethod

if TYPE_CHECKING:
    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import PointEstimate
    from pmcl.sampling.options import RunOptions

__all__ = ["PriorMean"]


@dataclass(frozen=True)
class PriorMean(CalibrationMethod):
    """The mean of the prior, with the prior's standard deviations as standard errors; it reads no log."""

    name: ClassVar[str] = "prior"
    description: ClassVar[str] = "the mean of the prior, without any log"

    def run(self, bound: BoundModel, options: RunOptions) -> PointEstimate:
        """Return the prior mean, see :meth:`CalibrationMethod.run`."""
        import numpy as np

        from pmcl.sampling.chains import PointEstimate

        units = tuple(parameter.unit for parameter in bound.parameters)
        spread = np.array([float(parameter.prior.std()) for parameter in bound.parameters])
        settings = {**self.record(options), **options.attributes}
        # A prior may have no finite standard deviation.
        return PointEstimate(
            bound.names, units, bound.prior_mean(), spread if np.isfinite(spread).all() else None, settings=settings
        )
