"""Beliefs about the first state of the robot.

Read in this order: :mod:`~.belief` (the model), :mod:`~.table` (what the kernels see), :mod:`~.kernels` (compiled).
"""

# Whoever uses the table needs its compiled functions, which register themselves.
from pmcl.models.starts import kernels as _kernels  # noqa: F401

__all__: list[str] = []
