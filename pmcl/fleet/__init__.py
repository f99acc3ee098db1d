"""Many robots at once: calibrated here or on a cluster, and then compared.

Each robot is calibrated by itself, by :func:`pmcl.calibration.workflow.calibrate`, and has a posterior file of its own;
where that is done changes nothing in it. Read :mod:`~pmcl.fleet.workflow` first. A robot's calibration is a job
(:mod:`~pmcl.fleet.robot_run`) that carries its log and model along, as the critic's work is
(:mod:`~pmcl.fleet.critic_run`), and a place runs jobs: threads, processes, or any pool of the user
(:mod:`~pmcl.fleet.places`), or a Dask cluster (:mod:`~pmcl.fleet.cluster`). :mod:`~pmcl.fleet.folder` knows what is
done already.

Then the robots are compared (:mod:`~pmcl.fleet.summary`): :mod:`~pmcl.fleet.densities` tells what each log says apart
from its prior, :mod:`~pmcl.fleet.population` finds mean and spread of each parameter over the robots,
:mod:`~pmcl.fleet.comparison` which robot stands out, and :mod:`~pmcl.fleet.common_causes` what the critic found in most
of them. :mod:`~pmcl.fleet.result` is what :mod:`pmcl.reports.fleet_report` shows. The command is ``pmcl fleet``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.fleet.cluster import ClusterPlace
    from pmcl.fleet.comparison import Comparison, compare_robots
    from pmcl.fleet.places import ProcessPlace
    from pmcl.fleet.result import FleetResult
    from pmcl.fleet.summary import summarize_fleet
    from pmcl.fleet.workflow import FleetRun, calibrate_fleet

__all__ = [
    "ClusterPlace",
    "Comparison",
    "FleetResult",
    "FleetRun",
    "ProcessPlace",
    "calibrate_fleet",
    "compare_robots",
    "summarize_fleet",
]

_HOMES = {
    "ClusterPlace": "pmcl.fleet.cluster",
    "Comparison": "pmcl.fleet.comparison",
    "FleetResult": "pmcl.fleet.result",
    "FleetRun": "pmcl.fleet.workflow",
    "ProcessPlace": "pmcl.fleet.places",
    "calibrate_fleet": "pmcl.fleet.workflow",
    "compare_robots": "pmcl.fleet.comparison",
    "summarize_fleet": "pmcl.fleet.summary",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
