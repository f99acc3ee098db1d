"""What the world around the robot looks like: straight walls, point landmarks, and occupancy grids.

A map is a frozen, validated description in the world frame [m]; it computes bounds, containment and distances but casts
no rays. A :class:`~pmcl.logs.robot_log.RobotLog` carries a wall or landmark map in its file and a grid map in files of
its own (:mod:`pmcl.maps.map_server`), and :mod:`pmcl.models` lays maps out as plain arrays for the kernels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.maps.landmarks import LandmarkMap
    from pmcl.maps.occupancy_grid import OccupancyGrid
    from pmcl.maps.walls import WallMap

__all__ = [
    "LandmarkMap",
    "OccupancyGrid",
    "WallMap",
]

_HOMES = {
    "LandmarkMap": "pmcl.maps.landmarks",
    "OccupancyGrid": "pmcl.maps.occupancy_grid",
    "WallMap": "pmcl.maps.walls",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
