"""Range beams against a map of walls: sonars, or a few rays of a laser.

Read in this order: :mod:`~.log_variables` (what a log holds), :mod:`~.sensor` (the model and its parameters),
:mod:`~.table` (what theta becomes), :mod:`~.kernels` (densities of readings, compiled), :mod:`~.linearisation`
(for the transport move), :mod:`~.simulation`, :mod:`~.along_path` and :mod:`~.scoring` (for the critic).
"""

# Whoever uses the table needs its compiled functions, which register themselves.
from pmcl.models.sensors.range_beams.kernels import full as _full  # noqa: F401
from pmcl.models.sensors.range_beams.kernels import plain as _plain  # noqa: F401

__all__: list[str] = []
