"""Where is the robot: Monte Carlo localization with theta fixed, or with the whole posterior of theta.

:func:`~pmcl.localization.offline.localize` runs over a log and returns a :class:`~pmcl.localization.track.Track`,
:func:`~pmcl.localization.many.localize_many` runs over it a thousand times for statistics, and
:class:`~pmcl.localization.online.OnlineLocalizer` takes one time step at a time, on a robot.
:mod:`~pmcl.localization.metrics` compares tracks with a reference. Results go to files, reports and comparisons.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.localization.beginning import with_found_start
    from pmcl.localization.many import localize_many
    from pmcl.localization.metrics import pose_errors, relative_errors, relative_errors_by_distance
    from pmcl.localization.offline import localize
    from pmcl.localization.online import OnlineLocalizer, PoseEstimate
    from pmcl.localization.options import FilterOptions
    from pmcl.localization.track import Track

__all__ = [
    "FilterOptions",
    "OnlineLocalizer",
    "PoseEstimate",
    "Track",
    "localize",
    "localize_many",
    "pose_errors",
    "relative_errors",
    "relative_errors_by_distance",
    "with_found_start",
]

_HOMES = {
    "FilterOptions": "pmcl.localization.options",
    "OnlineLocalizer": "pmcl.localization.online",
    "PoseEstimate": "pmcl.localization.online",
    "Track": "pmcl.localization.track",
    "localize": "pmcl.localization.offline",
    "localize_many": "pmcl.localization.many",
    "pose_errors": "pmcl.localization.metrics",
    "relative_errors": "pmcl.localization.metrics",
    "relative_errors_by_distance": "pmcl.localization.metrics",
    "with_found_start": "pmcl.localization.beginning",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
