"""Particle filters and smoothers over coefficient tables.

A model's tables go in (:meth:`pmcl.models.robot_model.BoundModel.tables`); filtered particles, trajectories drawn
from the smoothing distribution, log evidence and joint densities come out, for :mod:`pmcl.sampling` and localization.
The loops are compiled (:mod:`pmcl.filtering.kernels`); this package is their Python face.
"""
