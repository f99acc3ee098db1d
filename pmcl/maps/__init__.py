"""What the world around the robot looks like: straight walls and point landmarks.

A map is a frozen, validated description in the world frame [m]; it computes bounds and containment but casts no rays.
A :class:`~pmcl.logs.robot_log.RobotLog` carries a wall or landmark map with its readings, and :mod:`pmcl.models` lays
maps out as plain arrays for the kernels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.maps.landmarks import LandmarkMap
    from pmcl.maps.walls import WallMap

__all__ = [
    "LandmarkMap",
    "WallMap",
]

_HOMES = {
    "LandmarkMap": "pmcl.maps.landmarks",
    "WallMap": "pmcl.maps.walls",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
