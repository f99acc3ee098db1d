"""A small log with every variable of the format."""

from __future__ import annotations

import numpy as np
import pytest

from pmcl.logs.robot_log import RobotLog
from pmcl.maps.landmarks import LandmarkMap
from pmcl.maps.walls import WallMap


@pytest.fixture
def arrays() -> dict[str, object]:
    """Keyword arguments of RobotLog.build: T = 4 samples, B = 3 beams, J = 2 landmarks."""
    nan, inf = np.nan, np.inf
    return {
        "time": np.array([0.0, 0.5, 1.0, 1.7]),
        "odometry": np.array([[nan, nan, nan], [0.1, 0.0, 0.2], [0.1, -0.01, 0.0], [0.0, 0.0, -0.3]]),
        "ranges": np.array([[1.0, nan, inf], [0.0, 2.0, 3.0], [nan, nan, nan], [1.0, 4.0, 1.0 / 3.0]]),
        "beam_poses": np.array([[0.1, 0.0, 0.0], [0.0, 0.1, 1.5], [0.0, -0.1, -1.5]]),
        "max_range": 4.0,
        "landmark_range": np.array([[1.0, nan], [nan, nan], [nan, 2.0], [nan, nan]]),
        "landmark_bearing": np.array([[0.1, nan], [nan, -3.0], [nan, 2.0], [nan, nan]]),
        "landmark_size": np.array([[nan, nan], [nan, nan], [nan, 250.0], [nan, nan]]),
        "size_at_one_metre": 900.0,
        "landmark_time_offset": np.array([[0.01, nan], [nan, 0.0], [nan, -0.2], [nan, nan]]),
        "landmark_sensor_pose": np.array([0.2, 0.0, 0.0]),
        "landmarks": LandmarkMap([[0.5, 0.5], [2.5, 1.0]], ("red", "blue")),
        "walls": WallMap.from_polygon([[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 2.0]]),
        "start_mean": np.array([1.0, 1.0, 0.0]),
        "start_std": np.array([0.1, 0.1, inf]),
        "true_poses": np.array([[1.0, 1.0, 0.0], [1.1, 1.0, 0.2], [nan, nan, nan], [1.2, 1.0, -0.1]]),
        "true_theta": {"sigma_range": 0.1},
        "robot": "amigobot",
        "source": "by hand",
        "seed": 7,
    }


@pytest.fixture
def log(arrays) -> RobotLog:
    return RobotLog.build(**arrays)
