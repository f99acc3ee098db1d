"""Where is the robot: Monte Carlo localization with theta fixed, or with the whole posterior of theta.

:func:`~pmcl.localization.offline.localize` runs over a log and returns a :class:`~pmcl.localization.track.Track`,
:func:`~pmcl.localization.many.localize_many` runs over it a thousand times for statistics, and
:class:`~pmcl.localization.online.OnlineLocalizer` takes one time step at a time, on a robot.
:mod:`~pmcl.localization.metrics` compares tracks with a reference. Results go to files, reports and comparisons.
"""
