"""Lidars on a grid map, by a likelihood field or the beam model.

Read in this order: :mod:`~.log_variables` (what a log holds), :mod:`~.sensor` (the model and its parameters),
:mod:`~.table` (what theta becomes), :mod:`~.tempering` (why beams count less than they seem to), :mod:`~.grid_arrays`
and :mod:`~.kernels` (densities of readings, compiled), :mod:`~.walls` and :mod:`~.linearisation` (for the transport
move), :mod:`~.simulation`, :mod:`~.along_path` and :mod:`~.scoring` (for the critic).
"""

__all__: list[str] = []
