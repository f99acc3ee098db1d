"""The residuals against a recorded true path: what no method can beat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pmcl.calibration.method import CalibrationMethod

if TYPE_CHECKING:
    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import PointEstimate
    from pmcl.sampling.options import RunOptions

__all__ = ["TrueResiduals"]


@dataclass(frozen=True)
class TrueResiduals(CalibrationMethod):
    """The parameters that fit the log's true path best: an oracle, because no robot knows its true path.

    Where a noise is Gaussian that is the standard deviation of its residuals. The standard errors are those of a
    known path.
    """

    name: ClassVar[str] = "truth"
    description: ClassVar[str] = "an oracle: residuals against the log's true path, which no other method reads"

    def run(self, bound: BoundModel, options: RunOptions) -> PointEstimate:
        """Return the estimate, see :meth:`CalibrationMethod.run`."""
        import numpy as np

        from pmcl.errors import ModelError
        from pmcl.sampling.chains import PointEstimate
        from pmcl.sampling.point_estimates import likeliest_along, line_hessian, mean_log_joint, standard_errors
        from pmcl.sampling.state import state_dimension
        from pmcl.sampling.transforms import Unconstrained

        paths, size = [], state_dimension(bound)
        for log in bound.logs:
            poses = None if log.true_poses is None else np.array(log.true_poses, dtype=float)
            if poses is None or not np.isfinite(poses).all():
                raise ModelError(
                    f"{log.where}: expected the true pose of every row for the oracle 'truth', but the log has "
                    f"{'none' if poses is None else 'gaps in them'}; choose another method"
                )
            if size > 3:
                raise ModelError(
                    f"{log.where}: the oracle 'truth' knows poses, but a state of this model has {size} components; "
                    "leave out the effect that adds them"
                )
            poses[:, 2] = np.unwrap(poses[:, 2])
            paths.append(np.ascontiguousarray(poses[None, :, :size]))
        transform = Unconstrained(bound.parameters)
        theta = likeliest_along(bound, bound.prior_mean(), transform, paths, exact=True)
        u = transform.to_line(theta)
        information = -line_hessian(lambda value: mean_log_joint(bound, transform.from_line(value)[0], paths), u)
        units = tuple(parameter.unit for parameter in bound.parameters)
        settings = {**self.record(options), "oracle": True, **options.attributes}
        return PointEstimate(
            bound.names, units, theta, standard_errors(transform, u, information), settings=settings
        )
