"""From the messages of a bag to streams: scans, odometry, transforms and reference poses, in one pass."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.amcl_rows import thinned
from pmcl.logs.bags.messages import Bag
from pmcl.logs.bags.topics import SCAN, TF
from pmcl.logs.bags.transforms import TransformTree
from pmcl.logs.lidar_recording import require_few_readings
from pmcl.logs.validation import fail

__all__ = ["SCAN_STAMPS", "Scans", "Streams", "read_streams"]

Float = NDArray[np.float64]

SCAN_STAMPS = ("first", "last")
"""Which ray of a sweep the stamp of a scan belongs to."""

_NANO = 1_000_000_000


class Shape(NamedTuple):
    """What the scans of one laser have in common: number of rays, first angle and step [rad]."""

    n_rays: int
    angle_min: float
    angle_increment: float


@dataclass
class Scans:
    """The scans of one topic; of each, only the rays that are kept.

    Attributes
    ----------
    frame : str
        Frame of the laser.
    min_range, max_range : float
        Limits of its readings [m], from the first message.
    times : array of float
        When each scan began [s].
    exact : dict of Shape to Shape
        From rounded shapes to the first one of each that was read.
    """

    topic: str
    frame: str
    min_range: float
    max_range: float
    times: array[float] = field(default_factory=lambda: array("d"))
    exact: dict[Shape, Shape] = field(default_factory=dict)
    _ranges: list[NDArray[np.float32]] = field(default_factory=list)
    _shapes: list[Shape] = field(default_factory=list)

    def add(self, time: float, shape: Shape, ranges: NDArray[np.float32]) -> None:
        """Add a scan: when it began [s], its shape, and the ranges that are kept [m]."""
        self.times.append(time)
        self._shapes.append(shape)
        self._ranges.append(ranges)

    def of_usual_shape(self, max_beams: int | None, where: str) -> tuple[Float, NDArray[np.float32], Float, int]:
        """Return times, ranges and angles of the scans that have the usual number of rays and angles.

        Parameters
        ----------
        max_beams : int or None
            As the scans were read.
        where : str
            File, for messages.

        Returns
        -------
        times : ndarray, shape (N,)
            When each scan began [s].
        ranges : ndarray, shape (N, R)
            Ranges as the driver wrote them [m].
        angles : ndarray, shape (R,)
            Angle of each ray in the laser's frame [rad].
        n_others : int
            How many scans have another shape, and are left out.

        Raises
        ------
        LogError
            When all scans differ, or the usual scan has no rays, no angles, or no limits.
        """
        most, n_usual = Counter(self._shapes).most_common(1)[0]
        if n_usual < 2 < len(self._shapes):
            fail(
                where,
                f"expected scans in {self.topic} with the same number of rays and angles, got {len(self._shapes)} "
                f"scans that all differ, such as {self._shapes[0].n_rays} and {self._shapes[1].n_rays} rays: choose "
                "another topic with --scan",
            )
        usual = self.exact[most]
        angles: Float = usual.angle_min + usual.angle_increment * np.arange(usual.n_rays, dtype=np.float64)
        if usual.n_rays < 2 or not np.isfinite(angles).all() or usual.angle_increment == 0.0:
            fail(
                where,
                f"expected scans of at least two rays with angles in {self.topic}, got {usual.n_rays} rays from "
                f"{usual.angle_min:g} rad in steps of {usual.angle_increment:g} rad: choose another topic with --scan",
            )
        if not (0.0 <= self.min_range < self.max_range < np.inf):
            fail(
                where,
                f"expected 0 <= range_min < range_max < inf [m] in {self.topic}, got {self.min_range:g} and "
                f"{self.max_range:g}: correct the driver's settings",
            )
        kept = [k for k, shape in enumerate(self._shapes) if shape == most]
        return (
            np.frombuffer(self.times, dtype=np.float64)[kept],
            np.stack([self._ranges[k] for k in kept]),
            angles[thinned(usual.n_rays, max_beams)],
            len(self._shapes) - len(kept),
        )


@dataclass
class Streams:
    """What was read of a bag.

    Attributes
    ----------
    scans : dict of str to Scans
        By topic.
    tree : TransformTree
        Transforms of ``/tf`` and ``/tf_static``.
    odometry, truth : TransformTree
        Poses of the topics of odometry and reference, as transforms from their frame to the robot's.
    origin : int
        Time zero of all streams on the recording's clock [ns].
    """

    scans: dict[str, Scans] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)
    odometry: TransformTree = field(default_factory=TransformTree)
    truth: TransformTree = field(default_factory=TransformTree)
    origin: int | None = None

    def seconds(self, header: Any, recorded: int) -> float:
        """Return the stamp of a message [s] since time zero; when it was recorded if its stamp is zero."""
        stamp = header.stamp.sec * _NANO + header.stamp.nanosec or recorded
        if self.origin is None:
            self.origin = stamp
        # Whole nanoseconds until here: seconds since 1970 in floating point are no better than 0.2 microseconds.
        return (stamp - self.origin) * 1e-9


def read_streams(
    bag: Bag,
    scans: Collection[str],
    odometry: str | None,
    truth: str | None,
    *,
    max_beams: int | None,
    scan_stamp: str,
) -> Streams:
    """Read the streams of a bag, message by message; topics that are not needed are not decoded.

    Parameters
    ----------
    bag : Bag
        An open bag.
    scans : collection of str
        Topics of the lasers.
    odometry, truth : str or None
        Topics of odometry and reference poses.
    max_beams : int or None
        Rays to keep of each scan; None for all.
    scan_stamp : {"first", "last"}
        Which ray of a sweep its stamp belongs to. The time of a scan here is always that of its first ray.

    Returns
    -------
    Streams

    Raises
    ------
    LogError
        When the bag is damaged, or holds more readings than fit into memory.
    """
    streams = Streams()
    n_readings = 0
    transforms = [name for name, topic in bag.topics.items() if topic.type == TF]
    poses = {name: tree for name, tree in ((odometry, streams.odometry), (truth, streams.truth)) if name is not None}
    for topic, recorded, message in bag.messages({*scans, *transforms, *poses}):
        kind = bag.topics[topic].type
        if kind == TF:
            for each in message.transforms:
                time = streams.seconds(each.header, recorded)
                _add(streams.tree, each.header.frame_id, each.child_frame_id, time, each.transform)
        elif kind == SCAN:
            n_readings += _add_scan(streams, topic, message, recorded, max_beams, scan_stamp, bag.where)
            require_few_readings(n_readings, bag.where)
        else:
            pose = getattr(message, "pose", None) or message.transform
            child = getattr(message, "child_frame_id", "")
            time = streams.seconds(message.header, recorded)
            # Messages with covariance hold the pose one level deeper.
            _add(poses[topic], message.header.frame_id, child, time, getattr(pose, "pose", pose))
    return streams


def _add(tree: TransformTree, parent: str, child: str, time: float, value: Any) -> None:
    place = value.translation if hasattr(value, "translation") else value.position
    turn = value.rotation if hasattr(value, "rotation") else value.orientation
    numbers = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
    # ROS 1 knew frames with and without a slash in front, for the same.
    tree.add(parent.lstrip("/"), child.lstrip("/"), time, numbers)


def _add_scan(
    streams: Streams, topic: str, message: Any, recorded: int, max_beams: int | None, scan_stamp: str, where: str
) -> int:
    """Add a scan, and return how many readings of it are kept."""
    known = streams.scans.get(topic)
    if known is None:
        frame = message.header.frame_id.lstrip("/")
        known = streams.scans[topic] = Scans(topic, frame, float(message.range_min), float(message.range_max))
    n_rays = len(message.ranges)
    time = streams.seconds(message.header, recorded)
    if scan_stamp == "last":
        sweep = float(message.time_increment) * (n_rays - 1) or float(message.scan_time)
        if not 0.0 < sweep < 10.0:
            fail(
                where,
                f"expected the duration of a sweep in {topic} for stamps at the last ray, got time_increment = "
                f"{message.time_increment:g} s and scan_time = {message.scan_time:g} s: stamps can only be taken as "
                "those of the first ray",
            )
        time -= sweep
    # Some drivers compute the angles anew for each scan, with rounding in single precision.
    shape = Shape(n_rays, round(float(message.angle_min), 5), round(float(message.angle_increment), 7))
    known.exact.setdefault(shape, Shape(n_rays, float(message.angle_min), float(message.angle_increment)))
    kept = message.ranges[thinned(n_rays, max_beams)] if n_rays else message.ranges
    ranges = np.array(kept, dtype=np.float32)
    known.add(time, shape, ranges)
    return len(ranges)
