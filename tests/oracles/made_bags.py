"""Bags that tests write: messages by hand, in each of the formats that ROS has had."""

from __future__ import annotations

import math

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KINDS = ("ros1", "sqlite3", "mcap")
TF = "tf2_msgs/msg/TFMessage"


def yaw(angle):
    """Quaternion x, y, z, w of a turn about the z axis."""
    return 0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)


class MadeBag:
    """Messages in the order in which they were recorded; times in nanoseconds."""

    def __init__(self):
        self._messages = []  # topic, type, time of recording, function from a message factory to a message

    def _add(self, topic, kind, recorded, make):
        self._messages.append((topic, kind, recorded, make))

    def scan(self, topic, stamp, ranges, *, frame="laser", first=-1.0, step=0.1, limits=(0.1, 20.0), sweep=0.0,
             recorded=None):  # fmt: skip
        def make(new):
            n = len(ranges)
            return new("sensor_msgs/msg/LaserScan", header=new.header(stamp, frame), angle_min=first,
                       angle_max=first + step * (n - 1), angle_increment=step,
                       time_increment=sweep / max(n - 1, 1), scan_time=0.1, range_min=limits[0], range_max=limits[1],
                       ranges=np.array(ranges, np.float32), intensities=np.zeros(0, np.float32))  # fmt: skip

        self._add(topic, "sensor_msgs/msg/LaserScan", recorded or stamp, make)

    def odometry(self, topic, stamp, pose, *, frames=("odom", "base_link"), recorded=None):
        def make(new):
            zero = new("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
            twist = new("geometry_msgs/msg/Twist", linear=zero, angular=zero)
            return new("nav_msgs/msg/Odometry", header=new.header(stamp, frames[0]), child_frame_id=frames[1],
                       pose=new("geometry_msgs/msg/PoseWithCovariance", pose=new.pose(pose), covariance=np.zeros(36)),
                       twist=new("geometry_msgs/msg/TwistWithCovariance", twist=twist,
                                 covariance=np.zeros(36)))  # fmt: skip

        self._add(topic, "nav_msgs/msg/Odometry", recorded or stamp, make)

    def pose(self, topic, stamp, pose, *, frame="world"):
        def make(new):
            return new("geometry_msgs/msg/PoseStamped", header=new.header(stamp, frame), pose=new.pose(pose))

        self._add(topic, "geometry_msgs/msg/PoseStamped", stamp, make)

    def transform(self, topic, stamp, parent, child, shift, quaternion=(0.0, 0.0, 0.0, 1.0), *, recorded=None):
        def make(new):
            x, y, z = map(float, shift)
            a, b, c, d = map(float, quaternion)
            transform = new("geometry_msgs/msg/Transform", translation=new("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                            rotation=new("geometry_msgs/msg/Quaternion", x=a, y=b, z=c, w=d))  # fmt: skip
            stamped = new("geometry_msgs/msg/TransformStamped", header=new.header(stamp, parent),
                          child_frame_id=child, transform=transform)  # fmt: skip
            return new(TF, transforms=[stamped])

        self._add(topic, TF, recorded or stamp, make)

    def padding(self, topic, stamp, n_bytes):
        """A message of zeros, which compression makes small."""

        def make(new):
            layout = new("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
            return new("std_msgs/msg/UInt8MultiArray", layout=layout, data=np.zeros(n_bytes, np.uint8))

        self._add(topic, "std_msgs/msg/UInt8MultiArray", stamp, make)

    def write(self, path, kind, compression=None):
        """Write the bag: a file for ROS 1, else a folder; return its path.

        `compression` is "bz2" or "lz4" for ROS 1, "chunk" for MCAP, "message" or "file" for both kinds of ROS 2.
        """
        if kind == "ros1":
            path = path.with_suffix(".bag")
        factory = _Factory(kind == "ros1")
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer1(path) if kind == "ros1" else Writer2(path, version=9, storage_plugin=plugin)
        types = factory.types
        if compression and kind == "ros1":
            writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        elif compression:
            mode = "storage" if compression == "chunk" else compression
            writer.set_compression(CompressionMode[mode.upper()], CompressionFormat.ZSTD)
        with writer:
            connections = {}
            for topic, of_type, recorded, make in self._messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, of_type, typestore=types)
                message = make(factory)
                serialize = types.serialize_ros1 if kind == "ros1" else types.serialize_cdr
                raw = serialize(message, of_type)
                writer.write(connections[topic], recorded, raw)
        return path


class _Factory:
    """Makes messages of the types of one generation of ROS."""

    def __init__(self, is_ros1):
        self.is_ros1 = is_ros1
        self.types = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
        if is_ros1:
            self.types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))

    def __call__(self, kind, **fields):
        return self.types.types[kind](**fields)

    def header(self, stamp, frame):
        time = self("builtin_interfaces/msg/Time", sec=int(stamp // 10**9), nanosec=int(stamp % 10**9))
        return self("std_msgs/msg/Header", stamp=time, frame_id=frame, **({"seq": 0} if self.is_ros1 else {}))

    def pose(self, pose):
        a, b, c, d = yaw(pose[2])
        return self("geometry_msgs/msg/Pose",
                    position=self("geometry_msgs/msg/Point", x=float(pose[0]), y=float(pose[1]), z=0.0),
                    orientation=self("geometry_msgs/msg/Quaternion", x=a, y=b, z=c, w=d))  # fmt: skip
