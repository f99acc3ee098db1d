"""A localized log as an MCAP file with ROS 2 messages, which Foxglove and rerun show.

Topics, all in the frame ``map``: ``/map`` (nav_msgs/OccupancyGrid, when the log has a grid map), ``/map_markers``
(visualization_msgs/MarkerArray, walls and landmarks), ``/pose`` (geometry_msgs/PoseWithCovarianceStamped), ``/path``
(nav_msgs/Path, the whole one at the begin), ``/true_path`` where the log has a reference, ``/tf`` (``map`` to
``base_link``) and ``/end_points`` (sensor_msgs/PointCloud2, where the readings of lidars and beams end).
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import PmclError
from pmcl.exports.end_points import end_points
from pmcl.localization.track import Track
from pmcl.logs.robot_log import RobotLog
from pmcl.whole_file import replacing

__all__ = ["require_mcap", "write_mcap"]

Float = NDArray[np.float64]

MAP_FRAME, ROBOT_FRAME = "map", "base_link"
# Values of nav_msgs/OccupancyGrid for cells that are free, occupied and unknown.
_CELL_VALUES = np.array([0, 100, -1], dtype=np.int8)
# Constants of visualization_msgs/Marker and sensor_msgs/PointField.
_LINES, _SPHERES, _ADD, _FLOAT32 = 5, 7, 0, 7
# How thick walls and landmarks are drawn [m].
_THICK = 0.05
_NANOSECONDS = 1_000_000_000


class _Message(NamedTuple):
    topic: str
    kind: str
    time: int
    content: Any


def require_mcap() -> tuple[Any, Any]:
    """Return the modules that write MCAP files and ROS messages.

    Returns
    -------
    writer, typesys : module
        ``mcap.writer`` and ``rosbags.typesys``.

    Raises
    ------
    PmclError
        When one of them is not installed.
    """
    try:
        import mcap.writer
        import rosbags.typesys
    except ImportError as error:
        raise PmclError(
            f"MCAP files: expected the libraries mcap and rosbags, but {error.name} is not installed; "
            "run pip install 'pmcl[ros]'"
        ) from None
    return mcap.writer, rosbags.typesys


def write_mcap(path: str | os.PathLike[str], track: Track, log: RobotLog) -> None:
    """Write a localized log as an MCAP file.

    Parameters
    ----------
    path : path
        Replaced when it exists, all or nothing.
    track : Track
        Where the robot was, a pose (x, y, heading) for each row of the log.
    log : RobotLog
        The log that was localized: its map, readings and reference.

    Raises
    ------
    PmclError
        When a library is missing, or the track is not one of poses of this log.
    PosteriorError
        When the file cannot be written.

    Notes
    -----
    Messages have the times of the log's rows. A log that begins before time 0 is shifted to begin there, since ROS has
    no negative times. End points follow from the mean pose; a reading without echo has none.
    """
    writers, typesys = require_mcap()
    if track.pose_mean.shape != (log.n_steps, 3):
        raise PmclError(
            f"expected a track of {log.n_steps} poses (x, y, heading), one for each row of the log {log.where}, got an "
            f"array of shape {track.pose_mean.shape}; localize this log"
        )
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with replacing(path) as temporary, open(temporary, "wb") as stream:
        writer = writers.Writer(stream)
        writer.start(profile="ros2", library="pmcl")
        channels: dict[str, int] = {}
        for number, message in enumerate(_messages(track, log, store)):
            if message.topic not in channels:
                text, _ = store.generate_msgdef(message.kind, ros_version=2)
                schema = writer.register_schema(message.kind, "ros2msg", text.encode())
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            data = bytes(store.serialize_cdr(message.content, message.kind))
            writer.add_message(channels[message.topic], message.time, data, message.time, number)
        writer.finish()


def _messages(track: Track, log: RobotLog, store: Any) -> Iterator[_Message]:
    """Yield all messages in the order of time, so that a viewer can read the file from front to back."""
    make = _Maker(store.types)
    seconds = log.times - min(float(log.times[0]), 0.0)
    times = [round(second * _NANOSECONDS) for second in seconds.tolist()]
    yield from _maps(log, make, times[0])
    yield _Message("/path", "nav_msgs/msg/Path", times[0], make.path(times, track.pose_mean))
    if log.true_poses is not None:
        known = np.flatnonzero(~np.isnan(log.true_poses).any(axis=1))
        poses = make.path([times[row] for row in known], log.true_poses[known])
        yield _Message("/true_path", "nav_msgs/msg/Path", times[0], poses)
    points = end_points(log, track.pose_mean)
    for row, time in enumerate(times):
        pose, covariance = track.pose_mean[row], track.pose_cov[row]
        yield _Message("/tf", "tf2_msgs/msg/TFMessage", time, make.transform(time, pose))
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        yield _Message("/pose", kind, time, make.pose_with_covariance(time, pose, covariance))
        if points is not None:
            yield _Message("/end_points", "sensor_msgs/msg/PointCloud2", time, make.cloud(time, points[row]))


def _maps(log: RobotLog, make: _Maker, time: int) -> Iterator[_Message]:
    if log.grid_map is not None:
        yield _Message("/map", "nav_msgs/msg/OccupancyGrid", time, make.grid(time, log.grid_map))
    markers = []
    if log.walls is not None:
        markers.append(make.marker(time, "walls", _LINES, np.asarray(log.walls.segments).reshape(-1, 2)))
    if log.landmarks is not None:
        markers.append(make.marker(time, "landmarks", _SPHERES, np.asarray(log.landmarks.positions)))
    if markers:
        array = make.types["visualization_msgs/msg/MarkerArray"](markers=markers)
        yield _Message("/map_markers", "visualization_msgs/msg/MarkerArray", time, array)


class _Maker:
    """Makes ROS 2 messages of the types of a type store; all are in the map frame."""

    def __init__(self, types: Any) -> None:
        self.types = types

    def geometry(self, name: str, **fields: float) -> Any:
        return self.types[f"geometry_msgs/msg/{name}"](**fields)

    def time(self, nanoseconds: int) -> Any:
        seconds, rest = divmod(nanoseconds, _NANOSECONDS)
        return self.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)

    def header(self, time: int) -> Any:
        return self.types["std_msgs/msg/Header"](stamp=self.time(time), frame_id=MAP_FRAME)

    def turn(self, heading: float) -> Any:
        return self.geometry("Quaternion", x=0.0, y=0.0, z=math.sin(0.5 * heading), w=math.cos(0.5 * heading))

    def pose(self, pose: Any) -> Any:
        x, y, heading = (float(value) for value in pose)
        return self.types["geometry_msgs/msg/Pose"](
            position=self.geometry("Point", x=x, y=y, z=0.0), orientation=self.turn(heading)
        )

    def path(self, times: list[int], poses: Float) -> Any:
        stamped = self.types["geometry_msgs/msg/PoseStamped"]
        each = [
            stamped(header=self.header(time), pose=self.pose(pose)) for time, pose in zip(times, poses, strict=True)
        ]
        return self.types["nav_msgs/msg/Path"](header=self.header(times[0] if times else 0), poses=each)

    def pose_with_covariance(self, time: int, pose: Float, covariance: Float) -> Any:
        # Row by row over (x, y, z, roll, pitch, yaw).
        full = np.zeros((6, 6))
        known = np.array([0, 1, 5])
        full[np.ix_(known, known)] = covariance
        inner = self.types["geometry_msgs/msg/PoseWithCovariance"](pose=self.pose(pose), covariance=full.ravel())
        return self.types["geometry_msgs/msg/PoseWithCovarianceStamped"](header=self.header(time), pose=inner)

    def transform(self, time: int, pose: Float) -> Any:
        x, y, heading = (float(value) for value in pose)
        transform = self.types["geometry_msgs/msg/Transform"](
            translation=self.geometry("Vector3", x=x, y=y, z=0.0), rotation=self.turn(heading)
        )
        stamped = self.types["geometry_msgs/msg/TransformStamped"](
            header=self.header(time), child_frame_id=ROBOT_FRAME, transform=transform
        )
        return self.types["tf2_msgs/msg/TFMessage"](transforms=[stamped])

    def grid(self, time: int, grid: Any) -> Any:
        rows, columns = grid.cells.shape
        info = self.types["nav_msgs/msg/MapMetaData"](
            map_load_time=self.time(time), resolution=grid.resolution, width=columns, height=rows,
            origin=self.pose(grid.origin),
        )  # fmt: skip
        data = _CELL_VALUES[grid.cells].ravel()
        return self.types["nav_msgs/msg/OccupancyGrid"](header=self.header(time), info=info, data=data)

    def cloud(self, time: int, points: Float) -> Any:
        """Make a cloud of points (N, 2)."""
        field = self.types["sensor_msgs/msg/PointField"]
        fields = [field(name=name, offset=4 * number, datatype=_FLOAT32, count=1) for number, name in enumerate("xyz")]
        xyz = np.zeros((len(points), 3), dtype="<f4")
        xyz[:, :2] = points
        return self.types["sensor_msgs/msg/PointCloud2"](
            header=self.header(time), height=1, width=len(points), fields=fields, is_bigendian=False, point_step=12,
            row_step=12 * len(points), data=xyz.view(np.uint8).ravel(), is_dense=True,
        )  # fmt: skip

    def marker(self, time: int, name: str, kind: int, points: Float) -> Any:
        colour = self.types["std_msgs/msg/ColorRGBA"](r=0.2, g=0.3, b=0.4, a=1.0)
        places = [self.geometry("Point", x=float(x), y=float(y), z=0.0) for x, y in points]
        nothing = self.types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
        picture = np.zeros(0, dtype=np.uint8)
        fields: dict[str, Any] = {
            "header": self.header(time), "ns": name, "id": 0, "type": kind, "action": _ADD,
            "pose": self.pose((0.0, 0.0, 0.0)), "scale": self.geometry("Vector3", x=_THICK, y=_THICK, z=_THICK),
            "color": colour, "lifetime": nothing, "frame_locked": False, "points": places, "colors": [],
            "texture_resource": "", "uv_coordinates": [], "text": "", "mesh_resource": "",
            "mesh_use_embedded_materials": False, "mesh_file": self.types["visualization_msgs/msg/MeshFile"](
                filename="", data=picture),
            "texture": self.types["sensor_msgs/msg/CompressedImage"](header=self.header(time), format="", data=picture),
        }  # fmt: skip
        return self.types["visualization_msgs/msg/Marker"](**fields)
