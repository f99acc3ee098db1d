"""Compiled densities of range readings.

:mod:`~.rays` casts rays against walls, :mod:`~.casting` the rays of one beam for many poses. :mod:`~.plain` serves
tables without extras and needs nothing else. :mod:`~.full` serves tables with extras, some three times slower: read
:mod:`~.components` (what a reading may be, one module each), :mod:`~.mixture` (their sum), :mod:`~.all_rays` and
:mod:`~.rows`. :mod:`~.residuals` is for the Metropolis update of the noises.
"""
