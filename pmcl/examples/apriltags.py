"""Calibrate a robot from AprilTag detections of a tilted camera and the poses of its odometry.

Detectors give the number of a tag and its position in the camera's frame (`tvec`: right, down, ahead). Run as it is,
this file simulates such detections. Replace `record` by your own messages.
"""

from typing import Any, NamedTuple

import numpy as np

import pmcl
from pmcl.geometry import compose
from pmcl.logs import landmark_rows, odometry_from_poses, row_times, sightings_from_camera

CAMERA = (0.15, -0.05, 0.3)  # where the camera sits on the robot: x ahead [m], y left [m], yaw [rad]
TILT = 0.2  # angle by which it looks down [rad]
HEIGHT = 0.4  # of the tags above the camera [m], only for the simulation
TAGS = pmcl.LandmarkMap(
    np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0], [2.0, -1.0], [5.0, 2.0]]),  # where each tag is: x, y [m]
    names=["0", "1", "2", "3", "17", "21"],
)


class Recording(NamedTuple):
    """What the robot's messages hold; each stream has its own clock."""

    odometry_times: Any  # (N,) [s]
    odometry_poses: Any  # (N, 3): x [m], y [m], heading [rad], in the frame of the odometry
    tag_times: Any  # (R,) [s]: the time stamp of the image, not of the message
    tag_ids: Any  # (R,)
    tvecs: Any  # (R, 3): right, down, ahead [m]


def record(duration: float = 200.0, seed: int = 2) -> Recording:
    """Simulate a robot that drives in circles: odometry 10 times a second, images 4 times a second."""
    rng = np.random.default_rng(seed)
    rows = int(duration * 20)
    step = np.array([0.015, 0.0, 0.012])  # what the odometry reports each 0.05 s
    poses, odometry = [np.array([3.0, 1.0, 0.4])], [np.zeros(3)]
    for _ in range(rows - 1):
        odometry.append(compose(odometry[-1], step))
        poses.append(compose(poses[-1], step + rng.normal(0.0, [0.003, 0.001, 0.004])))
    clock = 0.05 * np.arange(rows)
    tag_times, tag_ids, tvecs = [], [], []
    for row in range(0, rows, 5):
        camera = compose(poses[row], CAMERA)
        for name, position in zip(TAGS.names, TAGS.positions, strict=True):
            distance = np.hypot(*(position - camera[:2]))
            bearing = np.arctan2(*(position - camera[:2])[::-1]) - camera[2]
            if np.cos(bearing) < 0.7 or rng.random() < 0.7:  # out of the picture, or not detected
                continue
            distance, bearing = distance + rng.normal(0.0, 0.06), bearing + rng.normal(0.0, 0.01)
            ahead, right, up = distance * np.cos(bearing), -distance * np.sin(bearing), HEIGHT
            tag_times.append(clock[row])
            tag_ids.append(int(name))
            tilted = ahead * np.sin(TILT) + up * np.cos(TILT), ahead * np.cos(TILT) - up * np.sin(TILT)
            tvecs.append((right, -tilted[0], tilted[1]))
    return Recording(clock[::2], np.array(odometry)[::2], np.array(tag_times), np.array(tag_ids), np.array(tvecs))


def log_of(recording: Recording) -> pmcl.RobotLog:
    """Make a log of a recording: one row each quarter of a second, the time between two images."""
    ranges, bearings = sightings_from_camera(recording.tvecs, tilt=TILT)
    times = row_times(0.25, recording.odometry_times)
    # A detector also reports tags that are not on the map.
    known = np.isin(recording.tag_ids.astype(str), TAGS.names)
    seen_times, tags = recording.tag_times[known], recording.tag_ids[known]
    return pmcl.RobotLog.build(
        time=times,
        odometry=odometry_from_poses(recording.odometry_poses, recording.odometry_times, times),
        **landmark_rows(times, TAGS, seen_times, tags, ranges=ranges[known], bearings=bearings[known]),
        landmarks=TAGS,
        landmark_sensor_pose=CAMERA,
        start_mean=(3.0, 1.0, 0.4),
        start_std=(0.05, 0.05, 0.05),
        robot="robot with a camera",
    )


def main(draws: int = 1000) -> None:
    """Record, calibrate, and say what was found: the camera's noise is 0.06 m and 0.01 rad."""
    data = pmcl.calibrate(log_of(record()), draws=draws)
    for name in ("sigma_forward", "sigma_turn", "sigma_landmark_range", "sigma_bearing"):
        print(f"{name} = {float(data.posterior[name].mean()):.4f} +- {float(data.posterior[name].std()):.4f}")
    print(pmcl.verdict(data).message)


if __name__ == "__main__":
    main()
