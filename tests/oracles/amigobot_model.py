"""A small wall-range robot: eight beams in an L-shaped room, few steps, and exact draws from its generative model."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pmcl.geometry import compose
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.walls import WallMap
from pmcl.models.robot_model import BoundModel, RobotModel
from pmcl.models.sensors.range_beams.linearisation import beam_lengths
from pmcl.models.sensors.range_beams.sensor import RangeNoise
from pmcl.models.tables import Tables

Float = NDArray[np.float64]

ROOM = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.5], [1.5, 1.5], [1.5, 3.0], [0.0, 3.0]]
BEAMS = np.column_stack(
    [
        0.1 * np.cos(np.arange(8) * math.pi / 4.0),
        0.1 * np.sin(np.arange(8) * math.pi / 4.0),
        np.arange(8) * math.pi / 4.0,
    ]
)
START = (np.array([0.7, 0.6, 0.1]), np.array([0.05, 0.05, 0.1]))
THETA = np.array([0.05, 0.03, 0.06, 0.1])


def tight_model(theta: Float = THETA) -> RobotModel:
    """Priors around `theta`, narrow enough that a chain over parameters and data crosses them in a few sweeps."""
    names = ("sigma_forward", "sigma_left", "sigma_turn", "sigma_range")
    priors = {name: stats.gamma(8.0, scale=mean / 8.0) for name, mean in zip(names, theta, strict=True)}
    return RobotModel(sensors=(RangeNoise(),), priors=priors)


def amigobot_log(n_steps: int, seed: int, n_beams: int = 8, theta: Float = THETA) -> RobotLog:
    """Simulate a drive along the lower arm of the room."""
    rng = np.random.default_rng(seed)
    odometry = np.tile([0.08, 0.0, 0.06], (n_steps, 1))
    empty = _build(odometry, np.full((n_steps, n_beams), 1.0), n_beams)
    tables = RobotModel(sensors=(RangeNoise(),)).bind(empty).tables(theta)[0]
    path = draw_path(tables, n_steps, rng)
    draw_readings(tables, path, rng)
    return _build(odometry, tables.sensors[0].reading, n_beams, path)


def _build(odometry: Float, ranges: Float, n_beams: int, path: Float | None = None) -> RobotLog:
    return RobotLog.build(
        time=0.25 * np.arange(len(odometry)),
        odometry=odometry,
        ranges=ranges,
        beam_poses=BEAMS[:: 8 // n_beams],
        max_range=6.0,
        walls=WallMap.from_polygon(ROOM),
        start_mean=START[0],
        start_std=START[1],
        true_poses=path,
    )


def draw_path(tables: Tables, n_steps: int, rng: np.random.Generator) -> Float:
    """Draw a trajectory (T, 3) from start and motion."""
    path = np.empty((n_steps, 3))
    path[0] = rng.normal(tables.start.mean, tables.start.std)
    for t in range(1, n_steps):
        increment = rng.normal(tables.motion.mean[t], tables.motion.std[t])
        path[t] = compose(path[t - 1], increment)
        path[t, 2] = path[t - 1, 2] + increment[2]
    return path


def draw_readings(tables: Tables, path: Float, rng: np.random.Generator) -> None:
    """Draw all readings along a path, in place: the arrays of a bound model's table are the data it sees."""
    beams = tables.sensors[0]
    expected = np.minimum(beams.scale * beam_lengths(beams, path) + beams.bias, 2.0 * beams.max_range)
    beams.reading[:] = np.clip(rng.normal(expected, beams.std), 0.0, beams.max_range)


def reading_array(bound: BoundModel) -> Float:
    """The array in which a bound model keeps its range readings."""
    return bound.tables(bound.prior_mean())[0].sensors[0].reading
