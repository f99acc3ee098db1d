"""Motion along several logs that are joined to one: at the first row of each, the robot stands where that log starts.

Read in this order: :mod:`~.table` (what the kernels see), :mod:`~.kernels` (compiled).
"""

# Whoever uses the table needs its compiled functions, which register themselves.
from pmcl.models.motions.joined import kernels as _kernels  # noqa: F401

__all__: list[str] = []
