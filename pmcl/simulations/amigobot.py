"""The paper's first robot: an Amigobot with eight sonars in an L-shaped room."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl import defaults
from pmcl.checks import check_type
from pmcl.errors import ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.arrays import as_numbers
from pmcl.maps.walls import WallMap
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.sensor import sensor_of
from pmcl.models.sensors.range_beams.sensor import RangeNoise
from pmcl.simulations.driving import WaypointDriver, drive
from pmcl.simulations.effects import Affected, Given, affected_by, check_given
from pmcl.simulations.simulate import check_run, draw_theta, make_rng

__all__ = ["AMIGOBOT_BEAMS", "AMIGOBOT_ROOM", "simulate_amigobot"]

# Mount of each sonar as the manufacturer states it: x ahead, y to the left [mm], direction [degree].
_MOUNTS = (
    (76, 100, 90), (125, 75, 41), (150, 30, 15), (150, -30, -15),
    (125, -75, -41), (76, -100, -90), (-140, -58, -145), (-140, 58, 145),
)  # fmt: skip
AMIGOBOT_BEAMS = np.array([(x / 1000.0, y / 1000.0, math.radians(angle)) for x, y, angle in _MOUNTS])
"""Poses of the eight sonars on the robot [m, m, rad], shape (8, 3)."""

AMIGOBOT_ROOM = WallMap.from_polygon([(0.0, 0.0), (3.0, 0.0), (3.0, 2.0), (2.0, 2.0), (2.0, 3.0), (0.0, 3.0)])
"""The room: an L of two arms 2 m wide within a square of 3 m."""

# Through both arms and back, never closer to a wall than 0.8 m.
_WAYPOINTS = np.array(
    [(2.2, 0.8), (1.6, 1.2), (0.8, 1.2), (0.8, 2.2), (1.2, 2.2), (1.2, 1.2), (2.2, 1.2), (1.4, 0.8), (0.8, 0.8)]
)
_START = np.array([0.8, 0.8, 0.0])
_START_STD = np.array([0.05, 0.05, 0.05])
_MAX_RANGE = 5.0
_PERIOD = 1.0


def simulate_amigobot(
    duration: float = defaults.SIMULATION_DURATION,
    seed: int = 0,
    theta: Mapping[str, float] | None = None,
    *,
    room: WallMap | None = None,
    waypoints: ArrayLike | None = None,
    effects: Sequence[Given] = (),
    hide_effects: bool = False,
    where: str = "simulate_amigobot",
) -> RobotLog:
    """Simulate the paper's Amigobot: one step and one reading of all eight sonars per second.

    Parameters
    ----------
    duration : float
        Length of the log [s]; one row per second, at least two.
    seed : int
        Determines all random numbers.
    theta : mapping of str to float, optional
        True ``sigma_forward`` [m], ``sigma_left`` [m], ``sigma_turn`` [rad] and ``sigma_range`` [m]. Those that are
        left out are drawn from the gamma priors of the default model.
    room : WallMap, optional
        Another room than the paper's L; it needs `waypoints` of its own.
    waypoints : array_like, shape (K, 2), optional
        Points of a closed route [m], map frame; in a room of the caller's own the robot starts at the last one, heading
        along the x axis. Keep 0.5 m from walls.
    effects : sequence, optional
        Effects that the default model lacks: texts such as ``"beam-bias@2=0.06"``, ``"range-scale=large"`` (see
        :func:`pmcl.models.effects.selection.parse_effect`), or pairs of an effect and its values.
    hide_effects : bool
        Whether the log does not mention them. Otherwise ``true_theta`` holds their values, and the attribute
        ``effects`` their names and places.
    where : str
        The caller, for messages.

    Returns
    -------
    RobotLog
        With walls, the true path as ``true_pose``, ``true_theta`` and the seed. The start is known within 0.05 m and
        0.05 rad, and the true start is drawn from that belief.

    Raises
    ------
    ModelError
        When `duration` or `seed` is not usable, `theta` does not fit the priors, `waypoints` are missing or no points,
        or an effect cannot be simulated.

    Notes
    -----
    The robot is steered from its true pose through waypoints in the middle of the room; odometry reports the command,
    and the true increment is the command plus noise. Nothing but the steering keeps the robot off the walls: with theta
    from the prior, 3 of 1000 logs of 400 s cross one. Sonars read the length of their ray plus noise, clipped to
    [0, 5] m.

    References
    ----------
    Kaboli, Bowling, Musilek, Bayesian Calibration for Monte Carlo Localization, AAAI 2006, section "Amigobot".
    """
    n_steps = check_run(duration, _PERIOD, seed, where)
    check_given(effects, hide_effects)
    if room is not None:
        check_type("room", room, WallMap, error=ModelError, advice="make one with WallMap.from_polygon")
    rng = make_rng(seed)
    motion, sensor = IncrementNoise(), RangeNoise()
    truth = draw_theta((*motion.parameters, *sensor.parameters), theta, rng)
    walls, points = (room or AMIGOBOT_ROOM), _points(waypoints, room, where)
    expected = _START if room is None else np.array([*points[-1], 0.0])
    start = expected + _START_STD * rng.standard_normal(3)
    path, command = drive(start, _driver(points), [truth[p.name] for p in motion.parameters], n_steps, rng)

    def logged(ranges: np.ndarray, affected: Affected | None = None) -> RobotLog:
        shown = affected is not None and not hide_effects
        return RobotLog.build(
            time=_PERIOD * np.arange(n_steps),
            odometry=command,
            ranges=ranges,
            beam_poses=AMIGOBOT_BEAMS,
            max_range=_MAX_RANGE,
            walls=walls,
            start_mean=expected,
            start_std=_START_STD,
            true_poses=path,
            true_theta=affected.true_theta if affected and shown else truth,
            attributes={"effects": affected.described()} if affected and shown and effects else None,
            robot="Amigobot (simulated)",
            source=f"pmcl.simulations.amigobot, seed {seed}",
            seed=seed,
            where=where,
            warn=False,  # an unfinished log may look like a mistake
        )

    # The model simulates the readings, from a log in which every sonar was read at every row.
    empty = logged(np.zeros((n_steps, len(AMIGOBOT_BEAMS))))
    affected = affected_by(effects, empty, seed, motion, sensor, truth)
    if affected.moves_differently:
        path, command = affected.drive(empty, start, _driver(points), rng)
        empty = logged(np.zeros((n_steps, len(AMIGOBOT_BEAMS))))
    table = affected.tables(empty).sensors[0]
    return logged(sensor_of(table).simulate(table, path, rng).reading, affected)


def _points(waypoints: ArrayLike | None, room: WallMap | None, where: str) -> NDArray[np.float64]:
    if waypoints is None:
        if room is not None:
            raise ModelError(f"{where}: expected waypoints for a room of your own, but got none; say where to drive")
        return _WAYPOINTS
    try:
        points = as_numbers(waypoints)
    except TypeError as problem:
        raise ModelError(f"{where}: expected waypoints as numbers, but got {problem}; list points (x, y)") from None
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2 or not np.isfinite(points).all():
        raise ModelError(
            f"{where}: expected waypoints as at least two points (x, y) in metres, but got an array of shape "
            f"{points.shape}; list finite coordinates"
        )
    return points


def _driver(waypoints: NDArray[np.float64]) -> WaypointDriver:
    return WaypointDriver(waypoints, step=0.15, turn=0.6, reached=0.2)
