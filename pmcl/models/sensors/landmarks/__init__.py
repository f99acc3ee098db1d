"""Sightings of known landmarks: distance, bearing and apparent size.

Read in this order: :mod:`~.log_variables` (what a log holds), :mod:`~.sensor` (the model and its parameters),
:mod:`~.table` (what theta becomes), :mod:`~.kernels` (densities of sightings, compiled), :mod:`~.linearisation`
(for the transport move), :mod:`~.simulation` and :mod:`~.scoring` (for the critic).
"""

__all__: list[str] = []
