"""Simulated robots, whose logs have the format of recorded logs and hold the true path and parameters as well.

:mod:`~pmcl.simulations.simulate` draws paths and readings from coefficient tables, the exact counterpart of the
densities in :mod:`pmcl.filtering.kernels`. :mod:`~pmcl.simulations.amigobot` and :mod:`~pmcl.simulations.aibo` are the
paper's robots; :mod:`~pmcl.simulations.landmark_field` and :mod:`~pmcl.simulations.lidar_room` are simple cases for
tests and benchmarks. Their logs can be used like recorded ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pmcl.lazy import lazy_names

if TYPE_CHECKING:
    from pmcl.simulations.aibo import simulate_aibo
    from pmcl.simulations.amigobot import simulate_amigobot
    from pmcl.simulations.landmark_field import simulate_landmark_field
    from pmcl.simulations.lidar_room import simulate_lidar_room

__all__ = [
    "simulate_aibo",
    "simulate_amigobot",
    "simulate_landmark_field",
    "simulate_lidar_room",
]

_HOMES = {
    "simulate_aibo": "pmcl.simulations.aibo",
    "simulate_amigobot": "pmcl.simulations.amigobot",
    "simulate_landmark_field": "pmcl.simulations.landmark_field",
    "simulate_lidar_room": "pmcl.simulations.lidar_room",
}

__getattr__, __dir__ = lazy_names(__name__, _HOMES)
