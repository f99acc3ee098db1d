"""Data of a small simulated robot with and without an effect, as arrays for a picture.

The model with the effect simulates the same drive twice, with the same random numbers: once with the effect at a
visible size, once without it. Nothing here is drawn by hand, so an effect of a user's own is shown in the same way.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import wrap
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import MAGNITUDES, Effect
from pmcl.models.robot_model import default_model
from pmcl.models.sensor import sensor_of
from pmcl.simulations.aibo import simulate_aibo
from pmcl.simulations.amigobot import AMIGOBOT_BEAMS, AMIGOBOT_ROOM, simulate_amigobot
from pmcl.simulations.effects import Affected
from pmcl.simulations.landmark_field import simulate_landmark_field
from pmcl.simulations.simulate import make_rng, simulate_path

__all__ = ["Demonstration", "Simulated", "demonstrate"]

Float = NDArray[np.float64]

_SEED = 4
# Share of the robots' usual noise that is kept for effects that noise would hide.
_QUIET = 0.02
_USUAL_NOISE = {
    "sigma_forward": 0.01, "sigma_left": 0.005, "sigma_turn": 0.02, "sigma_range": 0.03,
    "sigma_landmark_range": 0.1, "sigma_bearing": 0.02, "sigma_size": 0.05,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated drive.

    Attributes
    ----------
    path : ndarray, shape (T, 3)
        The true path [m, m, rad], map frame.
    columns : mapping of str to ndarray, shape (n,)
        One entry for each step or each reading, e.g. ``"time"`` [s], ``"range error"`` [m].
    points : ndarray, shape (n, 2)
        End points of the readings, seen from the true pose with the mount of the model without the effect [m], map
        frame; empty when an effect changes the motion.
    """

    path: Float
    columns: dict[str, Float]
    points: Float


@dataclass(frozen=True, eq=False)
class Demonstration:
    """The same drive without and with an effect.

    Attributes
    ----------
    effect : Effect
        The instance that is shown, e.g. of one beam.
    values : ndarray, shape (k,)
        Of its parameters.
    log : RobotLog
        The log that offers map, mounts and commands.
    without, affected : Simulated
        The two drives.
    """

    effect: Effect
    values: Float
    log: RobotLog
    without: Simulated
    affected: Simulated


def demonstrate(effect: Effect, *, quiet: bool) -> Demonstration | None:
    """Simulate a drive without and with an effect.

    Parameters
    ----------
    effect : Effect
        Of the catalogue or one's own. An effect of a place is shown at one of the places that the log offers.
    quiet : bool
        Whether to leave out nearly all noise, for effects that shift what is expected; not for effects of the noise.

    Returns
    -------
    Demonstration or None
        None for an effect that states no typical sizes, or that none of the simulated robots can show.
    """
    logs = (_winding_drive(),) if effect.carrier == "motion" else _logs()
    log = next((log for log in logs if effect.applies(log)), None)
    sizes = [size for size in MAGNITUDES if size in effect.typical]
    if log is None or not sizes:
        return None
    instance = _instance(effect, log)
    values = instance.magnitude(sizes[-1])
    simulate = _drive if instance.carrier == "motion" else _sense
    without, affected = (simulate(log, instance, size, quiet) for size in (np.array(instance.null), values))
    return Demonstration(instance, values, log, without, affected)


@functools.cache
def _logs() -> tuple[RobotLog, ...]:
    """Return a sonar robot, a robot with a camera that looks ahead, and one that sees how large landmarks are."""
    return (
        simulate_amigobot(100.0, _SEED),
        simulate_landmark_field(120, _SEED, bearings=True, field_of_view=2.0),
        simulate_aibo(100.0, _SEED),
    )


@functools.cache
def _winding_drive() -> RobotLog:
    """Return a sonar robot that winds through its room, faster and slower, with turns of all sizes to both sides."""
    time = np.arange(81.0)
    odometry = np.zeros((time.size, 3))
    odometry[1:, 0] = 0.09 * (1.0 + 0.9 * np.sin(2.0 * np.pi * time[1:] / 13.0))
    odometry[1:, 2] = 0.12 + 0.4 * np.sin(2.0 * np.pi * time[1:] / 7.0)
    return RobotLog.build(
        time=time,
        odometry=odometry,
        ranges=np.ones((time.size, len(AMIGOBOT_BEAMS))),
        beam_poses=AMIGOBOT_BEAMS,
        max_range=5.0,
        walls=AMIGOBOT_ROOM,
        start_mean=[1.0, 0.6, 0.0],
        start_std=[1e-6, 1e-6, 1e-6],
        where="demonstration of an effect",
    )


def _instance(effect: Effect, log: RobotLog) -> Effect:
    """Return the effect at one of its places: for a place on the floor the one that the robot comes nearest to."""
    instances = effect.instances(log)
    middle = instances[len(instances) // 2]
    if effect.carrier != "motion" or "place" not in middle.where:
        return middle
    path = _drive(log, middle, np.array(middle.null), True).path[:, :2]

    def mean_distance(instance: Effect) -> float:
        return float(np.hypot(*(path - np.array(instance.where["place"])).T).mean())

    return min(instances, key=mean_distance)


def _model(log: RobotLog, effects: tuple[Effect, ...], values: tuple[Float, ...], quiet: bool) -> Affected:
    model = default_model(log)
    noise = {name: size * (_QUIET if quiet else 1.0) for name, size in _USUAL_NOISE.items()}
    return Affected(effects, values, model.motion, model.sensors[0], noise)


def _drive(log: RobotLog, effect: Effect, values: Float, quiet: bool) -> Simulated:
    """Let the robot move by the commands of the log; nothing steers it back."""
    tables = _model(log, (effect,), (values,), quiet).tables(log)
    path = simulate_path(tables.motion, tables.start, make_rng(_SEED))[:, :3]
    delta, turn = np.diff(path[:, :2], axis=0), np.diff(path[:, 2])
    forward = np.cos(path[:-1, 2]) * delta[:, 0] + np.sin(path[:-1, 2]) * delta[:, 1]
    odometry = log.odometry[1:]
    columns = {
        "time": log.times[1:],
        "step": odometry[:, 0],
        "turn": odometry[:, 2],
        "turn of the robot": turn,
        "forward error": forward - odometry[:, 0],
        "turn error": turn - odometry[:, 2],
    }
    return Simulated(path, columns, np.empty((0, 2)))


def _sense(log: RobotLog, effect: Effect, values: Float, quiet: bool) -> Simulated:
    """Let the robot read its sensor along the true path of the log."""
    path = log.true_poses
    assert path is not None
    table = _model(log, (effect,), (values,), quiet).tables(log).sensors[0]
    described = _model(log, (), (), quiet).tables(log).sensors[0]
    drawn = sensor_of(table).simulate(table, path, make_rng(_SEED))
    return (_beams if log.ranges is not None else _sightings)(log, described, drawn, path)


def _beams(log: RobotLog, described: Any, drawn: Any, path: Float) -> Simulated:
    shape = drawn.reading.shape
    length = sensor_of(described).ideal_readings(described, path)
    time = np.broadcast_to(log.times[:, None], shape)
    beam = np.broadcast_to(np.arange(shape[1], dtype=float), shape)
    columns = {
        "time": time, "beam": beam, "true range": length, "range": drawn.reading,
        "range error": drawn.reading - length,
    }  # fmt: skip
    mount = described.beam_pose
    aside = mount[:, 2] + path[:, 2, None]
    c, s = np.cos(path[:, 2, None]), np.sin(path[:, 2, None])
    x = path[:, 0, None] + c * mount[:, 0] - s * mount[:, 1] + drawn.reading * np.cos(aside)
    y = path[:, 1, None] + s * mount[:, 0] + c * mount[:, 1] + drawn.reading * np.sin(aside)
    flat = {name: np.ravel(values) for name, values in columns.items()}
    return Simulated(path, flat, np.column_stack([x.ravel(), y.ravel()]))


def _sightings(log: RobotLog, described: Any, drawn: Any, path: Float) -> Simulated:
    distance, bearing = sensor_of(described).ideal_readings(described, path).T
    pose = path[drawn.time]
    columns = {
        "time": log.times[drawn.time],
        "landmark": drawn.landmark.astype(float),
        "true distance": distance,
        "true bearing": bearing,
        "distance error": drawn.range - distance,
        "bearing error": wrap(drawn.bearing - bearing),
        "apparent size": drawn.size,
    }
    mount = described.sensor_pose
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    aside = pose[:, 2] + mount[2] + drawn.bearing
    x = pose[:, 0] + c * mount[0] - s * mount[1] + drawn.range * np.cos(aside)
    y = pose[:, 1] + s * mount[0] + c * mount[1] + drawn.range * np.sin(aside)
    return Simulated(path, columns, np.column_stack([x, y]))
