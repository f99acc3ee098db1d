"""A robot with a lidar in a furnished room on a grid map: a simple case for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_seed, check_type, check_whole
from pmcl.errors import ModelError
from pmcl.logs.arrays import LidarScans
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.occupancy_grid import OccupancyGrid
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.parameters import Parameter
from pmcl.models.sensors.lidar.sensor import Lidar
from pmcl.simulations.driving import WaypointDriver, drive
from pmcl.simulations.effects import Affected, Given, affected_by
from pmcl.simulations.simulate import draw_theta, make_rng

__all__ = ["lidar_room_map", "simulate_lidar_room"]

Float = NDArray[np.float64]

# An uneven loop between the furniture, in both senses of turning [m].
_WAYPOINTS = np.array(
    [(9.0, 2.0), (13.0, 3.0), (13.5, 9.5), (10.0, 10.0), (7.5, 6.5), (3.0, 9.5), (2.0, 5.0), (4.0, 2.2)]
)
# Furniture: x from, x to, y from, y to [m].
_FURNITURE = (
    (5.0, 6.5, 3.8, 4.4), (9.5, 11.5, 4.6, 5.4), (4.2, 5.0, 7.0, 7.6), (0.0, 0.8, 7.0, 9.0), (7.0, 9.0, 11.3, 12.0),
)  # fmt: skip
_START = np.array([3.0, 2.0, 0.0])
_START_STD = np.array([0.1, 0.1, 0.05])
_USUAL = {
    "sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.03, "sigma_hit": 0.08, "z_short": 0.05, "z_max": 0.02,
    "z_rand": 0.05, "lambda_short": 0.5,
}  # fmt: skip


def lidar_room_map(resolution: float = 0.05) -> OccupancyGrid:
    """Return the map of a room of 16 m x 12 m with furniture, a slanted wall and two pillars.

    Parameters
    ----------
    resolution : float
        Side of a cell [m].

    Returns
    -------
    OccupancyGrid
        The map frame has its origin in the lower left corner of the room; the map goes on for 1 m behind its walls,
        which are one cell thick.
    """
    width, height = round(18.0 / resolution), round(14.0 / resolution)
    x, y = np.meshgrid((np.arange(width) + 0.5) * resolution - 1.0, (np.arange(height) + 0.5) * resolution - 1.0)
    # Outlines, one cell wide, as maps made from scans have them.
    outlines = [_outline(x, y, (0.0, 16.0, 0.0, 12.0), resolution)]
    outlines += [_outline(x, y, box, resolution) for box in _FURNITURE]
    for centre in (11.5, 7.5), (6.5, 9.8):
        outlines.append(np.abs(np.hypot(x - centre[0], y - centre[1]) - 0.25) < 0.75 * resolution)
    slanted = np.abs(0.6 * (x - 16.0) + 0.8 * (y - 7.0)) < 0.75 * resolution
    outlines.append(slanted & (x > 14.5) & (y > 6.0) & (y < 9.0))
    occupied = np.any(outlines, axis=0)
    origin = (-1.0, -1.0, 0.0)
    return OccupancyGrid(occupied.astype(np.uint8), resolution, origin, source="pmcl.simulations.lidar_room")


def _outline(x: Float, y: Float, box: tuple[float, float, float, float], resolution: float) -> NDArray[np.bool_]:
    """Return which cells, with centres at x and y, lie around a box (x from, x to, y from, y to), in one row."""
    left, right, low, high = box
    outer, inner = ((x > left - a) & (x < right + a) & (y > low - a) & (y < high + a) for a in (resolution, 0.0))
    return np.asarray(outer & ~inner)


def simulate_lidar_room(
    n_steps: int = 150,
    seed: int = 0,
    theta: Mapping[str, float] | None = None,
    *,
    sensor: Lidar | None = None,
    n_rays: int = 60,
    max_range: float = 10.0,
    pose: Sequence[float] = (0.2, 0.0, 0.0),
    field_of_view: float = 1.5 * np.pi,
    resolution: float = 0.05,
    effects: Sequence[Given] = (),
    hide_effects: bool = False,
) -> RobotLog:
    """Simulate a robot that drives a loop in a furnished room and scans it.

    Parameters
    ----------
    n_steps : int
        Rows T, one per second; steps of at most 0.3 m and 0.4 rad.
    seed : int
        Determines all random numbers.
    theta : mapping of str to float, optional
        Replaces some of the true values sigma_forward 0.03 m, sigma_left 0.02 m, sigma_turn 0.03 rad, sigma_hit 0.08 m,
        z_rand 0.05 and, for the beam model, z_short 0.05, z_max 0.02, lambda_short 0.5 / m.
    sensor : Lidar, optional
        The model that scans are drawn from, each beam by itself; the usual one when left out.
    n_rays : int
        Rays of a scan.
    max_range : float
        Longest range [m].
    pose : sequence of float
        Where the laser sits on the robot [m, m, rad].
    field_of_view : float
        Angle from the first ray to the last [rad].
    resolution : float
        Side of a cell of the map [m].
    effects, hide_effects
        As for :func:`pmcl.simulations.landmark_field.simulate_landmark_field`.

    Returns
    -------
    RobotLog
        With the grid map, ``true_pose``, ``true_theta`` and the seed; the start is known within 0.1 m and 0.05 rad and
        drawn from that belief.

    Raises
    ------
    ModelError
        When sizes or names are not usable, or an effect cannot be simulated.
    """
    n_steps = check_whole("n_steps", n_steps, 2, error=ModelError)
    n_rays = check_whole("n_rays", n_rays, 1, error=ModelError)
    seed = check_seed(seed, error=ModelError)
    motion = IncrementNoise()
    sensor = Lidar() if sensor is None else sensor
    check_type("sensor", sensor, Lidar, error=ModelError, advice="write pmcl.models.Lidar(...)")
    rng = make_rng(seed)
    parameters: tuple[Parameter, ...] = (*motion.parameters, *sensor.parameters)
    truth = draw_theta(parameters, {**{p.name: _USUAL[p.name] for p in parameters}, **(theta or {})}, rng)
    start = _START + _START_STD * rng.standard_normal(3)
    path, command = drive(start, _driver(), [truth[p.name] for p in motion.parameters], n_steps, rng)
    grid = lidar_room_map(resolution)
    angles = np.linspace(-0.5 * field_of_view, 0.5 * field_of_view, n_rays)

    def logged(ranges: np.ndarray, affected: Affected | None = None) -> RobotLog:
        shown = affected is not None and not hide_effects
        return RobotLog.build(
            time=np.arange(n_steps, dtype=float),
            odometry=command,
            lidars={"": LidarScans(ranges, angles, 0.0, max_range, np.asarray(pose, dtype=float))},
            grid_map=grid,
            start_mean=_START,
            start_std=_START_STD,
            true_poses=path,
            true_theta=affected.true_theta if affected and shown else truth,
            attributes={"effects": affected.described()} if affected and shown and effects else None,
            robot="robot with a lidar (simulated)",
            source=f"pmcl.simulations.lidar_room, seed {seed}",
            seed=seed,
            where="simulate_lidar_room",
            warn=False,  # an unfinished log may look like a mistake
        )

    empty = logged(np.ones((n_steps, n_rays)))
    affected = affected_by(effects, empty, seed, motion, sensor, truth)
    if affected.moves_differently:
        path, command = affected.drive(empty, start, _driver(), rng)
        empty = logged(np.ones((n_steps, n_rays)))
    table: Any = affected.tables(empty).sensors[0]
    drawn = Lidar.simulate(table, path, rng)
    ranges = np.full((n_steps, n_rays), np.nan)
    ranges[:, drawn.ray] = drawn.reading
    return logged(ranges, affected)


def _driver() -> WaypointDriver:
    return WaypointDriver(_WAYPOINTS, step=0.3, turn=0.4, reached=0.5, aim=0.8)
