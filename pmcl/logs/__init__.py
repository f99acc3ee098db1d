"""What a robot logged: odometry, range and landmark readings, and the map they were taken in.

:class:`~pmcl.logs.robot_log.RobotLog` is one validated log, in memory an xarray Dataset and on disk a NetCDF file; the
readers beside it convert bags, texts and published recordings. The streams of a robot of your own become the rows of a
log with the functions of :mod:`~pmcl.logs.odometry`, :mod:`~pmcl.logs.streams` and :mod:`~pmcl.logs.camera`, which this
package exports. Logs go to :mod:`pmcl.models`, which binds them to parameters.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.logs.amcl_rows import amcl_rows
    from pmcl.logs.arrays import LidarScans
    from pmcl.logs.bags.read import read_bag
    from pmcl.logs.barfoot import read_barfoot
    from pmcl.logs.camera import sightings_from_camera
    from pmcl.logs.carmen import read_carmen
    from pmcl.logs.csv_log import read_csv
    from pmcl.logs.mrclam import read_mrclam
    from pmcl.logs.odometry import odometry_from_poses, odometry_from_velocities, poses_at
    from pmcl.logs.robot_log import RobotLog
    from pmcl.logs.schema import Variable
    from pmcl.logs.streams import beam_rows, landmark_rows, row_times
    from pmcl.logs.wean import read_wean

__all__ = [
    "LidarScans",
    "RobotLog",
    "Variable",
    "amcl_rows",
    "beam_rows",
    "landmark_rows",
    "odometry_from_poses",
    "odometry_from_velocities",
    "poses_at",
    "read_bag",
    "read_barfoot",
    "read_carmen",
    "read_csv",
    "read_mrclam",
    "read_wean",
    "row_times",
    "sightings_from_camera",
]

_HOMES = {
    "LidarScans": "pmcl.logs.arrays",
    "RobotLog": "pmcl.logs.robot_log",
    "Variable": "pmcl.logs.schema",
    "amcl_rows": "pmcl.logs.amcl_rows",
    "read_bag": "pmcl.logs.bags.read",
    "read_barfoot": "pmcl.logs.barfoot",
    "read_carmen": "pmcl.logs.carmen",
    "read_csv": "pmcl.logs.csv_log",
    "read_mrclam": "pmcl.logs.mrclam",
    "read_wean": "pmcl.logs.wean",
    "beam_rows": "pmcl.logs.streams",
    "landmark_rows": "pmcl.logs.streams",
    "odometry_from_poses": "pmcl.logs.odometry",
    "odometry_from_velocities": "pmcl.logs.odometry",
    "poses_at": "pmcl.logs.odometry",
    "row_times": "pmcl.logs.streams",
    "sightings_from_camera": "pmcl.logs.camera",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
