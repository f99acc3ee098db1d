"""What a range reading may be, one module for each component of the mixture.

Each module holds the probability of its component, the density of a reading that is one, its distribution function,
and its draw, side by side. The first three are compiled; the draws are NumPy on whole logs and call none of the
compiled functions, so that simulated readings check the densities.

Read :mod:`~.noise` first (an echo from a known distance), then :mod:`~.own_echo` (the echo that is expected), and then
the other components, in the order in which they are mixed in: :mod:`~.neighbours`, :mod:`~.obstacles`,
:mod:`~.detours`, :mod:`~.short_echoes`, :mod:`~.unrelated` (no echo, and outliers). Each of these offers

* ``mix_*``: mixes its density into the rows OWN_SHARE and OTHERS, for which the density of a reading is
  ``OWN_SHARE * exp(ECHO) + OTHERS``;
* ``mix_*_below``: mixes its distribution function into the probabilities of a smaller, and of a smaller or equal
  reading;
* ``draw_*``: returns the probability and a draw of it for every reading of a log.

:mod:`~.drawing` holds what the draws share. :mod:`pmcl.models.sensors.range_beams.kernels.mixture` and
:mod:`pmcl.models.sensors.range_beams.simulation` put the components together.
"""
