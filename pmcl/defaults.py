"""Default settings that both the Python functions and the command line's help state; importing them costs nothing.

The settings of a calibration method, such as the particles of particle Gibbs, are fields of its class in
:mod:`pmcl.calibration`, with their defaults and help.
"""

from __future__ import annotations

from typing import Final

__all__ = [
    "CHAINS",
    "CRITICISM_PARTICLES",
    "DRAWS",
    "FALSE_ALARM_LEVEL",
    "LOCALIZATION_DRAWS",
    "LOCALIZATION_DRAWS_PER_READING",
    "LOCALIZATION_PARTICLES",
    "MAX_BEAMS",
    "SIMULATION_DURATION",
    "TRAJECTORIES",
    "TRAJECTORY_STATES",
    "UPDATE_MIN_A",
    "UPDATE_MIN_D",
    "UPDATE_RULES",
]

DRAWS: Final = 1000
"""Draws of each chain after burn-in."""

CHAINS: Final = 4
"""Chains that are run and compared with each other."""

TRAJECTORIES: Final = 100
"""Trajectories of each chain that are kept; a long log keeps fewer, see :data:`TRAJECTORY_STATES`."""

TRAJECTORY_STATES: Final = 10_000_000
"""States of all kept trajectories together: 240 MB of poses. Four chains keep 100 trajectories each of up to 25 000
rows."""

LOCALIZATION_PARTICLES: Final = 500
"""Particles of a localizing filter."""

LOCALIZATION_DRAWS: Final = 100
"""Draws of the posterior that the method "posterior" works with."""

LOCALIZATION_DRAWS_PER_READING: Final = 10
"""Draws that the readings of each row are averaged over (analyses/draws_per_reading)."""

CRITICISM_PARTICLES: Final = 500
"""Particles of the passes that score effects."""

FALSE_ALARM_LEVEL: Final = 0.05
"""Share of logs without a missing effect for which the critic may raise an alarm."""

SIMULATION_DURATION: Final = 400.0
"""Length of a simulated log [s], that of the paper's shorter experiments."""

UPDATE_MIN_D: Final = 0.25
"""Distance between scans that become rows of a log [m]: the default of ``update_min_d`` in nav2's AMCL."""

UPDATE_MIN_A: Final = 0.2
"""Angle between scans that become rows of a log [rad]: the default of ``update_min_a`` in nav2's AMCL."""

UPDATE_RULES: Final = ("nav2", "euclidean")
"""How the distance between such scans is judged; see :func:`pmcl.logs.amcl_rows.amcl_rows`."""

MAX_BEAMS: Final = 60
"""Rays of each scan that a log keeps: the default of ``max_beams`` in nav2's AMCL."""
