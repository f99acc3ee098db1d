"""NUTS on theta and the whole path: the independent judge of the other methods."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from pmcl.calibration.method import CalibrationMethod
from pmcl.calibration.settings import setting

if TYPE_CHECKING:
    from typing import Self

    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import Chains
    from pmcl.sampling.options import RunOptions

__all__ = ["NoUTurn"]


@dataclass(frozen=True)
class NoUTurn(CalibrationMethod):
    """NumPyro's no-U-turn sampler on theta and all states of the path together: the exact posterior, without particles.

    It shares no density, no particle and no random number with the other methods: start, motion and readings are
    written anew for JAX, which differentiates them. So it serves smooth models only, that is landmarks without effects,
    whose motion has constant noise; walls have edges, at which a gradient says nothing. A path is hundreds of
    correlated numbers. They are standardised by a fixed linear map, the factor of the linearised model's path at a
    theta near the mode; in the usual non-centred form, where the noise of each step is scaled by theta, a draw needs a
    thousand leapfrog steps. How good the map is decides only how many a draw takes.

    NumPyro is an optional dependency: ``pip install 'pmcl[nuts]'``. Chains run one after the other at each draw; there
    is no checkpoint.

    Attributes
    ----------
    warm_up : int
        Draws in which step size and mass matrix are adapted.
    target : float
        Mean acceptance probability that the step size aims at.

    References
    ----------
    Hoffman, Gelman, The no-U-turn sampler, JMLR 15, 2014.
    Phan, Pradhan, Jankowiak, Composable effects for flexible and accelerated probabilistic programming in NumPyro,
    arXiv 1912.11554, 2019.
    """

    name: ClassVar[str] = "nuts"
    description: ClassVar[str] = "NumPyro's NUTS on theta and the whole path, for landmarks (pip install 'pmcl[nuts]')"

    warm_up: int = setting(300, "Draws before the first, in which NUTS adapts its step size.", least=20)
    target: float = setting(
        0.8, "Mean acceptance probability of NUTS.", kind=float, least=0.5, most=0.99, advice="0.8 is usual"
    )

    def shortest(self) -> Self:
        """Return a run with a short warm-up."""
        return replace(self, warm_up=20)

    def run(self, bound: BoundModel, options: RunOptions) -> Chains:
        """Run the chains, see :meth:`CalibrationMethod.run`."""
        from pmcl.sampling.near_mode import near_mode
        from pmcl.sampling.no_u_turn import require_smooth, run_no_u_turn
        from pmcl.sampling.session import check_run_memory

        require_smooth(bound)
        check_run_memory(bound, options.chains, 2, options)
        near = near_mode(bound, options.seed)
        return run_no_u_turn(bound, near, self.warm_up, self.target, options, self.record(options))
