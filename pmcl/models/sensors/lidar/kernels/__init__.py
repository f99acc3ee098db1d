"""Compiled densities of lidar readings.

:mod:`~.casting` casts rays on the grid, :mod:`~.field` looks up where readings end, :mod:`~.beam` has the density of
the beam model. :mod:`~.scans` implements the contract of the engine with them, and :mod:`~.statistics` is for the
Metropolis update of the parameters.
"""
