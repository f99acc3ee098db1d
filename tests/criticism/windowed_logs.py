"""Simulated logs in which an effect begins or ends: the robot drives on from one model to the other."""

from __future__ import annotations

from functools import partial

import numpy as np

from pmcl.logs.robot_log import RobotLog
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.sensor import sensor_of
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.models.sensors.range_beams.sensor import RangeNoise
from pmcl.simulations import amigobot, landmark_field
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.effects import affected_by
from pmcl.simulations.landmark_field import simulate_landmark_field
from pmcl.simulations.sightings import draw_sightings
from pmcl.simulations.simulate import make_rng

# mypy: disable-error-code="no-untyped-def"

SONAR = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
SIGHTS = {
    "sigma_forward": 0.05, "sigma_left": 0.03, "sigma_turn": 0.03, "sigma_landmark_range": 0.2, "sigma_bearing": 0.04,
}  # fmt: skip


def unwrapped(poses):
    """Return poses (T, 3) with headings that do not jump, as paths have them."""
    return np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])


def windowed(place: str, text: str, begin: int, end: int, rows: int, seed: int) -> RobotLog:
    """Simulate an effect that acts in the rows begin <= t < end, in the "room" of the Amigobot or in the "field".

    The robot has the effect only there: an effect of the motion changes the steps into these rows, one of a sensor
    their readings.
    """
    room = place == "room"
    if room:
        plain = simulate_amigobot(float(rows), seed, SONAR)
        motion, sensor, theta = IncrementNoise(), RangeNoise(), SONAR
        driver = amigobot._driver(amigobot._WAYPOINTS)
    else:
        plain = simulate_landmark_field(rows, seed, SIGHTS, bearings=True, reach=12.0)
        motion, sensor, theta = IncrementNoise(), LandmarkNoise(range=True, bearing=True), SIGHTS
        driver = landmark_field._driver()
    rng = make_rng(np.random.SeedSequence([seed, begin, end]))
    models = [affected_by(given, plain, seed, motion, sensor, theta) for given in ((), (text,))]
    pieces = [(0, begin, 0), (begin, end, 1), (end, rows, 0)]
    path, command = [plain.true_poses[:1]], [np.zeros((1, 3))]
    for first, stop, model in pieces:
        if stop > max(first, 1):
            piece = plain.select(max(first, 1) - 1, stop)
            poses, commands = models[model].drive(piece, path[-1][-1], driver, rng)
            path.append(poses[1:])
            command.append(commands[1:])
    poses, commands = np.concatenate(path), np.concatenate(command)
    times = plain.times
    build = partial(
        RobotLog.build, time=times, odometry=commands, start_mean=plain.start_mean, start_std=plain.start_std,
        true_poses=poses, warn=False,
    )  # fmt: skip
    inside = (np.arange(rows) >= begin) & (np.arange(rows) < end)
    if room:
        given = partial(build, beam_poses=amigobot.AMIGOBOT_BEAMS, max_range=5.0, walls=amigobot.AMIGOBOT_ROOM)
        empty = given(ranges=np.zeros((rows, len(amigobot.AMIGOBOT_BEAMS))))
        tables = [model.tables(empty).sensors[0] for model in models]
        ranges = [sensor_of(table).simulate(table, poses, rng).reading for table in tables]
        return given(ranges=np.where(inside[:, None], ranges[1], ranges[0]))
    positions = plain.landmarks.positions
    seen = landmark_field._seen(positions, poses, 12.0, np.inf)
    given = partial(build, landmarks=positions)
    empty = given(landmark_range=seen, landmark_bearing=seen)
    drawn = [draw_sightings(model.tables(empty).sensors[0], empty, poses, rng) for model in models]
    joined = {name: np.where(inside[:, None], drawn[1][name], drawn[0][name]) for name in drawn[0]}
    return given(landmark_range=joined["range"], landmark_bearing=joined["bearing"])
