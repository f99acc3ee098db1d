"""Motion by odometry with the noise that AMCL gives it: differential and omnidirectional drives, alpha1 to alpha5.

Read in this order: :mod:`~.motion` (the models and their parameters), :mod:`~.table` (what theta becomes),
:mod:`~.kernels` (drawing and densities of steps, compiled).
"""

# Whoever uses a table needs its compiled functions, which register themselves.
from pmcl.models.motions.odometry.kernels import differential as _differential  # noqa: F401
from pmcl.models.motions.odometry.kernels import omni as _omni  # noqa: F401

__all__: list[str] = []
