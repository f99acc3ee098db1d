"""Motion by noisy increments in the robot frame: constant noise, or noise that grows with the increment.

Read in this order: :mod:`~.motion` (the models and their parameters), :mod:`~.table` (what theta becomes),
:mod:`~.kernels` (drawing and densities of steps, compiled).
"""

# Whoever uses the table needs its compiled functions, which register themselves.
from pmcl.models.motions.increments.kernels import full as _full  # noqa: F401
from pmcl.models.motions.increments.kernels import plain as _plain  # noqa: F401

__all__: list[str] = []
