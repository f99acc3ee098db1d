"""Compiled densities of sightings of landmarks.

:mod:`~.plain` serves tables without extras and needs nothing else. For tables with extras read :mod:`~.channels` (the
readings of a sighting, each with its density, distribution function and draw), :mod:`~.identities` (what a sighting may
be of), :mod:`~.sightlines` and :mod:`~.sightings` (the density of a sighting of a given landmark), then :mod:`~.full`
(their mixture) and :mod:`~.single_readings` (reading by reading, for the critic); :mod:`~.rows` names the scratch
space. :mod:`~.residuals` is for the Metropolis update of the noises.
"""
