"""Range beams against a map of walls: sonars, or a few rays of a laser.

Read in this order: :mod:`~.log_variables` (what a log holds), :mod:`~.sensor` (the model and its parameters),
:mod:`~.table` (what theta becomes), :mod:`~.kernels` (densities of readings, compiled), :mod:`~.linearisation`
(for the transport move), :mod:`~.simulation`, :mod:`~.along_path` and :mod:`~.scoring` (for the critic).
"""

__all__: list[str] = []
