"""Drives that might tell more about a robot.

A drive is simulated in short pieces. Each begins at a place that the log has visited, so that the drive stays where the
robot can go on this map, and is driven open loop, so that motion noise is that of the model. Which readings a row would
have is taken from the row of the log with the nearest pose; what they would read is drawn by the sensor's own
simulation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import wrap
from pmcl.logs.robot_log import RobotLog
from pmcl.models.robot_model import RobotModel
from pmcl.models.sensor import sensor_of
from pmcl.simulations.simulate import simulate_path

__all__ = ["Drive", "drives_for", "moves_sideways", "simulated_pieces"]

Float = NDArray[np.float64]

# Pieces of a simulated drive, and rows of each: few enough that motion noise does not carry the robot far from the
# places of the log, and together enough that the curvature is known to a tenth.
_PIECES, _ROWS = 12, 16
# Speeds of a robot that the log shows standing still, or never turning [m/s], [rad/s].
_SPEED, _TURN_RATE = 0.2, 0.3
# Greatest turn of one row [rad], beyond which a robot would be seen to turn the other way.
_MOST_TURN = 1.0
# Rows of a curve to one side, before one to the other.
_WEAVE = 4
# Below this, odometry of a row is standing still [m] or [rad].
_STILL = 1e-3
# A straight line may leave the places of the log by this share of their extent.
_NEAR = 0.08
# Odometry to the side, as a share of that ahead, from which on a robot is taken to be able to move sideways.
_SIDEWAYS = 0.1
# How many places of the log are looked at.
_PLACES = 60
# Belief about the pose at which a piece begins [m, m, rad], that of a robot that is followed.
_START_STD = (0.05, 0.05, 0.05)
# Poses are as near in a turn of this angle as in a tenth of the extent of the log's places [rad].
_NEAR_TURN = 0.5


@dataclass(frozen=True, eq=False)
class Drive:
    """Something to drive.

    Attributes
    ----------
    name : str
        What a person is told to do, as in "turn in place, both ways".
    starts : ndarray, shape (K, 3)
        Where the pieces begin [m, m, rad].
    commands : ndarray, shape (K, L, 3)
        Odometry of each row, forward, left and turn [m, m, rad]; row 0 of each piece is not used.
    moves : bool
        Whether the robot moves at all. A model may give noise to a robot that stands still, but what it does then
        says little about how it drives.
    """

    name: str
    starts: Float
    commands: Float
    moves: bool = True


class _Piece(RobotLog):
    """A piece of a drive; a motion model must not ask it to move, as it may a whole log."""

    is_whole: ClassVar[bool] = False


class _Line(NamedTuple):
    start: Float
    length: float


def drives_for(log: RobotLog, path: Float, *, sideways: bool) -> tuple[Drive, ...]:
    """Return drives that a robot could make where a log has been.

    Parameters
    ----------
    log : RobotLog
        The log; its speeds are those of the drives.
    path : ndarray, shape (T, >= 3)
        An estimate of its path, headings not wrapped [m, m, rad].
    sideways : bool
        Whether the robot can move across its heading.

    Returns
    -------
    tuple of Drive
    """
    step, turn = _speeds(log)
    line = _longest_line(path, step)
    rows = np.linspace(0, max(len(path) - _ROWS - 1, 0), _PIECES).astype(int)
    places = path[np.linspace(0, len(path) - 1, _PIECES).astype(int), :3]
    forth = _there_and_back(max(int(line.length / step), 1))
    # Each piece begins on the line where the one before it should have ended.
    gone = step * np.concatenate([[0.0], np.cumsum(forth)])[: forth.size : _ROWS - 1]
    on_line = line.start + gone[:, None] * np.array([np.cos(line.start[2]), np.sin(line.start[2]), 0.0])
    back = _by_piece(forth)
    both = _by_piece(_there_and_back(_ROWS - 1))
    weave = _by_piece(_there_and_back(_WEAVE, _WEAVE // 2))
    nothing = np.zeros((_PIECES, _ROWS))
    again = [np.array(log.odometry[row : row + _ROWS]) for row in rows]
    drives = [
        Drive("stand still", places, _commands(nothing, nothing, nothing), moves=False),
        Drive("turn in place, both ways", places, _commands(nothing, nothing, turn * both)),
        Drive("drive straight, forward and back", on_line, _commands(step * back, nothing, nothing)),
        Drive("drive in curves to both sides", on_line, _commands(step * back, nothing, 0.5 * turn * weave)),
    ]
    if len(path) > _ROWS:
        drives.append(Drive("drive as in this log", path[rows, :3], np.array(again)))
    if sideways:
        across = on_line - np.array([0.0, 0.0, 0.5 * np.pi])
        drives.append(Drive("drive sideways, both ways", across, _commands(nothing, step * back, nothing)))
    return tuple(drives)


def moves_sideways(log: RobotLog, model: RobotModel) -> bool:
    """Return whether a robot can move across its heading, by its motion model or its odometry.

    Parameters
    ----------
    log : RobotLog
        The log.
    model : RobotModel
        Its model.
    """
    ahead, aside, _ = np.sqrt(np.mean(np.square(log.odometry[1:]), axis=0))
    return bool(getattr(model.motion, "moves_sideways", False)) or bool(aside > _SIDEWAYS * ahead)


def _commands(forward: Float, left: Float, turn: Float) -> Float:
    return np.stack([forward, left, turn], axis=-1)


def _speeds(log: RobotLog) -> tuple[float, float]:
    """Return step [m] and turn [rad] of a row: what the log's robot does where it moves or turns fast."""
    period = float(np.median(np.diff(log.times)))
    distance, turn = np.hypot(*log.odometry[1:, :2].T), np.abs(log.odometry[1:, 2])
    step = np.quantile(distance[distance > _STILL], 0.75) if (distance > _STILL).any() else _SPEED * period
    fast = np.quantile(turn[turn > _STILL], 0.75) if (turn > _STILL).any() else 0.0
    return float(step), float(min(max(fast, _TURN_RATE * period), _MOST_TURN))


def _there_and_back(rows: int, before: int = 0) -> Float:
    """Return the sign of each row of a drive that changes it every so many rows, `before` of which are over."""
    count = np.arange(_PIECES * (_ROWS - 1)) + before
    return np.where(count // rows % 2 == 0, 1.0, -1.0)


def _by_piece(signs: Float) -> Float:
    """Return the signs of the rows of each piece, (K, L); row 0 of a piece is not used."""
    return np.pad(signs.reshape(_PIECES, _ROWS - 1), ((0, 0), (1, 0)))


def _longest_line(path: Float, step: float) -> _Line:
    """Return the longest straight line near places of the log; it begins at one of them and leads to another."""
    places = path[np.linspace(0, len(path) - 1, min(_PLACES, len(path))).astype(int), :2]
    extent = float(np.hypot(*np.ptp(path[:, :2], axis=0)))
    share = np.linspace(0.1, 0.9, 9)[:, None]
    best = _Line(np.array(path[0, :3]), 0.0)
    for i, begin in enumerate(places):
        for end in places[:i]:
            length = float(np.hypot(*(end - begin)))
            if length <= best.length:
                continue
            inside = begin + share * (end - begin)
            away = np.hypot(*(inside[:, None] - path[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
            if away.max() <= _NEAR * extent:
                heading = float(np.arctan2(end[1] - begin[1], end[0] - begin[0]))
                best = _Line(np.array([*begin, heading]), length)
    return best if best.length >= step else _Line(best.start, 5.0 * step)


def simulated_pieces(
    drive: Drive,
    log: RobotLog,
    path: Float,
    model: RobotModel,
    theta: Float,
    rng: np.random.Generator,
    start_std: tuple[float, float, float] | None = None,
    times: int = 1,
) -> tuple[list[RobotLog], list[Float]]:
    """Simulate a drive, once or several times.

    Parameters
    ----------
    drive : Drive
        What would be driven.
    log : RobotLog
        A log of the robot: map, mounts, and which readings there are where.
    path : ndarray, shape (T, >= 3)
        An estimate of its path.
    model : RobotModel
        The model.
    theta : ndarray, shape (d,)
        Parameters at which the drive is simulated.
    rng : numpy.random.Generator
        Source of randomness.
    start_std : tuple of float, optional
        What the pieces say of how well their start is known [m, m, rad]. When left out they say what is true, and as
        much as the filter of a robot that is followed knows: such a filter has no bias.
    times : int
        How often.

    Returns
    -------
    logs : list of RobotLog
        The pieces in which something is read, each of as many rows as the drive's commands; all pieces of the first
        time, then those of the next.
    paths : list of ndarray, shape (L, D)
        Their true paths.
    """
    planned = []
    for start, command in zip(drive.starts, drive.commands, strict=True):
        piece = _piece(log, path, start, command)
        if piece.n_readings > 0:
            tables = model.bind(piece).tables(theta)[0]
            if start_std is not None:
                stated = piece.dataset["start_std"].copy(data=np.array(start_std))
                piece = _Piece.trusted(piece.dataset.assign(start_std=stated), piece.where, piece.grid_map)
            planned.append((piece, tables))
    logs, paths = [], []
    for _ in range(times):
        for piece, tables in planned:
            true_path = simulate_path(tables.motion, tables.start, rng)
            dataset = piece.dataset.copy(deep=True)
            for table in tables.sensors:
                sensor = sensor_of(table)
                sensor.store(sensor.simulate(table, true_path, rng), dataset)
            logs.append(_Piece.trusted(dataset, piece.where, piece.grid_map))
            paths.append(true_path)
    return logs, paths


def _piece(log: RobotLog, path: Float, start: Float, command: Float) -> RobotLog:
    """Return a log with the commands of a piece, whose rows have the readings of the log's nearest rows."""
    nominal = np.empty((len(command), 3))
    nominal[0] = start
    for t in range(1, len(command)):
        c, s = np.cos(nominal[t - 1, 2]), np.sin(nominal[t - 1, 2])
        forward, left, turn = command[t]
        nominal[t] = nominal[t - 1] + np.array([c * forward - s * left, s * forward + c * left, turn])
    extent = max(0.1 * float(np.hypot(*np.ptp(path[:, :2], axis=0))), 1e-6)
    away = np.hypot(*(nominal[:, None, :2] - path[None, :, :2]).transpose(2, 0, 1)) / extent
    turned = np.abs(wrap(nominal[:, None, 2] - path[None, :, 2])) / _NEAR_TURN
    nearest = np.argmin(away**2 + turned**2, axis=1)
    period = float(np.median(np.diff(log.times)))
    part = log.without_truth().dataset.isel(time=nearest).copy(deep=True)
    increments = np.array(command)
    increments[0] = 0.0
    part = part.assign_coords(time=("time", period * np.arange(len(command)), part["time"].attrs)).assign(
        odometry=part["odometry"].variable.copy(data=increments),
        start_mean=part["start_mean"].variable.copy(data=np.array(start[:3])),
        start_std=part["start_std"].variable.copy(data=np.minimum(log.start_std, _START_STD)),
    )
    return _Piece.trusted(part, f"{log.where} (planned)", log.grid_map)
