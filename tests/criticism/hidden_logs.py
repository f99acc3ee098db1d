"""Logs of the simulated Amigobot in which effects are hidden, and a small run of the critic."""

from __future__ import annotations

from pmcl.criticism.workflow import criticize
from pmcl.logs.robot_log import RobotLog
from pmcl.simulations.amigobot import simulate_amigobot

# mypy: disable-error-code="no-untyped-def"

NOISE = {"sigma_forward": 0.03, "sigma_left": 0.02, "sigma_turn": 0.04, "sigma_range": 0.05}


def hidden(text: str, rows: float = 300.0, seed: int = 4) -> RobotLog:
    return simulate_amigobot(rows, seed, NOISE, effects=(text,) if text else (), hide_effects=True)


def small(log: RobotLog, **settings):
    return criticize(log, **{"simulations": 20, "joint": False, "seed": 1, "rounds": 2, **settings})
