"""Many robots at once: calibrated here or on a cluster, and then compared.

Each robot is calibrated by itself, by :func:`pmcl.calibration.workflow.calibrate`, and has a posterior file of its own;
where that is done changes nothing in it. Read :mod:`~pmcl.fleet.workflow` first. A robot's calibration is a job
(:mod:`~pmcl.fleet.robot_run`) that carries its log and model along, and a place runs jobs: threads, processes, or any
pool of the user (:mod:`~pmcl.fleet.places`), or a Dask cluster (:mod:`~pmcl.fleet.cluster`).
:mod:`~pmcl.fleet.folder` knows what is done already. The command is ``pmcl fleet``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.fleet.cluster import ClusterPlace
    from pmcl.fleet.places import ProcessPlace
    from pmcl.fleet.workflow import FleetRun, calibrate_fleet

__all__ = ["ClusterPlace", "FleetRun", "ProcessPlace", "calibrate_fleet"]

_HOMES = {
    "ClusterPlace": "pmcl.fleet.cluster",
    "FleetRun": "pmcl.fleet.workflow",
    "ProcessPlace": "pmcl.fleet.places",
    "calibrate_fleet": "pmcl.fleet.workflow",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
