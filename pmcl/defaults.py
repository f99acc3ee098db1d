"""Default settings that both the Python functions and the command line's help state; importing them costs nothing."""

from __future__ import annotations

from typing import Final

__all__ = [
    "BURN_IN_PARTICLES",
    "CALIBRATION_PARTICLES",
    "CHAINS",
    "CRITICISM_PARTICLES",
    "DATA_RATE_PARTS",
    "DRAWS",
    "FALSE_ALARM_LEVEL",
    "LOCALIZATION_DRAWS",
    "LOCALIZATION_DRAWS_PER_READING",
    "LOCALIZATION_PARTICLES",
    "METROPOLIS_STEPS",
    "SIMULATION_DURATION",
    "SWEEPS_PER_DRAW",
]

CALIBRATION_PARTICLES: Final = {"conditional": 25, "smoothing": 500, "ensemble": 200}
"""Particles by kernel of particle Gibbs, and of the ensemble's filter. The conditional kernel is exact with any number;
the others are not, and need many."""

DRAWS: Final = 1000
"""Draws of each chain after burn-in."""

CHAINS: Final = 4
"""Chains that are run and compared with each other."""

METROPOLIS_STEPS: Final = 5
"""Rounds of updates of theta for each trajectory, the paper's m (analyses/effect_of_m_and_r: above 10 no gain)."""

SWEEPS_PER_DRAW: Final = 2
"""Sweeps from one stored draw to the next."""

BURN_IN_PARTICLES: Final = 1000
"""Particles while data is being included: a robot that is lost then stays lost."""

DATA_RATE_PARTS: Final = 50
"""Each sweep of burn-in includes one such part of the longest log, which makes the paper's r."""

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
