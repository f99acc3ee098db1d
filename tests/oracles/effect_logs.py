"""Logs that can show the effects of the catalogue, and densities of whole paths under edited tables."""

from __future__ import annotations

from functools import cache

import numpy as np

from pmcl.filtering.kernels import smc
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.catalogue import CATALOGUE
from pmcl.models.effects.effect import Effect
from pmcl.models.robot_model import RobotModel, default_model
from pmcl.models.tables import Tables
from pmcl.simulations.aibo import simulate_aibo
from pmcl.simulations.amigobot import simulate_amigobot
from pmcl.simulations.landmark_field import simulate_landmark_field

SONAR = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}
FIELD = {"sigma_landmark_range": 0.2, "sigma_bearing": 0.05}


@cache
def sonar_log(n_steps: int = 80) -> RobotLog:
    return simulate_amigobot(float(n_steps), 11, SONAR)


@cache
def field_log(n_steps: int = 80) -> RobotLog:
    return simulate_landmark_field(n_steps, 12, FIELD, bearings=True)


@cache
def camera_log(n_steps: int = 80) -> RobotLog:
    """Landmarks seen by a camera that looks ahead."""
    return simulate_landmark_field(n_steps, 13, FIELD, bearings=True, field_of_view=2.0)


@cache
def aibo_log(n_steps: int = 80) -> RobotLog:
    return simulate_aibo(float(n_steps), 14, {"sigma_size": 0.1})


LOGS = (sonar_log, field_log, camera_log, aibo_log)


def log_for(effect: Effect, n_steps: int = 80) -> RobotLog:
    """A log that can show an effect: sonars where they can, else landmarks."""
    return next(log for log in (make(n_steps) for make in LOGS) if effect.applies(log))


def instance(effect: Effect, log: RobotLog, which: int = 1) -> Effect:
    """One instance of an effect, not the first where there are several; a place that the robot often comes by."""
    made = effect.instances(log)
    if "place" in made[0].where:
        distance = [np.hypot(*(log.true_poses[:, :2] - one.where["place"]).T) for one in made]
        return made[int(np.argmin([np.quantile(values, 0.2) for values in distance]))]
    return made[min(which, len(made) - 1)]


def model_with(log: RobotLog, *effects: Effect, **changes) -> RobotModel:
    return RobotModel(sensors=default_model(log).sensors, effects=effects, **changes)


def true_values(log: RobotLog) -> np.ndarray:
    """The parameters that the log was simulated with."""
    return np.array(list(log.true_theta.values()))


def base_tables(log: RobotLog) -> Tables:
    return default_model(log).bind(log).tables(true_values(log))[0]


def row_densities(tables: Tables, path: np.ndarray) -> np.ndarray:
    """Log density of each row of a path (T, 3) and its readings."""
    return np.array(smc.joint_terms(tables, np.ascontiguousarray(path))[1])


def simulated(effect, values, seed, n_steps=500):
    """A log with the effect in it, from a robot that can show it."""
    given = {"effects": [(effect, values)], "hide_effects": True}
    log = log_for(effect)
    if log.ranges is not None:
        return simulate_amigobot(float(n_steps), seed, SONAR, **given)
    if log.landmark_size is not None:
        return simulate_aibo(float(n_steps), seed, {"sigma_size": 0.1}, **given)
    view = np.inf if effect.applies(field_log()) else 2.0
    return simulate_landmark_field(n_steps, seed, FIELD, bearings=True, field_of_view=view, **given)


def path_of(log):
    """The true path, as the kernels want it: headings do not jump by a whole turn."""
    path = np.array(log.true_poses)
    path[:, 2] = np.unwrap(path[:, 2])
    return path


NAMES = [effect.name for effect in CATALOGUE]
BY_NAME = {effect.name: effect for effect in CATALOGUE}
