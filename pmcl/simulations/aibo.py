"""The paper's second robot: a Sony AIBO on a small field with a coloured landmark at each corner."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pmcl import defaults
from pmcl.geometry import wrap
from pmcl.logs.robot_log import RobotLog
from pmcl.maps.landmarks import LandmarkMap
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.simulations.driving import WaypointDriver, drive
from pmcl.simulations.effects import Affected, Given, affected_by, check_given
from pmcl.simulations.sightings import draw_sightings
from pmcl.simulations.simulate import check_run, draw_theta, make_rng

__all__ = ["AIBO_FIELD_OF_VIEW", "AIBO_LANDMARKS", "AIBO_SIZE_AT_ONE_METRE", "simulate_aibo"]

Float = NDArray[np.float64]

_LENGTH, _WIDTH = 2.7, 1.8
AIBO_LANDMARKS = LandmarkMap(
    np.array([(0.0, 0.0), (_LENGTH, 0.0), (_LENGTH, _WIDTH), (0.0, _WIDTH)]),
    ("pink above yellow", "pink above blue", "blue above pink", "yellow above pink"),
)
"""The landmarks [m], named by their two colours."""

AIBO_FIELD_OF_VIEW = math.radians(57.6)
"""Horizontal angle that the camera sees, half of it to each side of straight ahead [rad]."""

# 176 pixels span the field of view, so something 10 cm wide and 20 cm tall covers 16 by 32 of them at one metre.
AIBO_SIZE_AT_ONE_METRE = 512.0
"""Pixels that a landmark covers at a distance of one metre."""

# Across and around the field, with turns both ways, 0.5 m or more inside its border.
_WAYPOINTS = np.array(
    [(2.1, 0.6), (1.5, 0.9), (2.1, 1.2), (1.2, 1.25), (0.6, 1.2), (1.1, 0.9), (0.6, 0.6), (1.35, 0.55)]
)
_START = np.array([0.6, 0.6, 0.0])
_START_STD = np.array([0.05, 0.05, 0.05])
_PERIOD = 1.0


def simulate_aibo(
    duration: float = defaults.SIMULATION_DURATION,
    seed: int = 0,
    theta: Mapping[str, float] | None = None,
    *,
    effects: Sequence[Given] = (),
    hide_effects: bool = False,
    where: str = "simulate_aibo",
) -> RobotLog:
    """Simulate the paper's AIBO: one step and one picture of its camera per second.

    Parameters
    ----------
    duration : float
        Length of the log [s]; one row per second, at least two. The paper trains on 400 s and 1000 s and tests on
        sixteen minutes (960 s).
    seed : int
        Determines all random numbers.
    theta : mapping of str to float, optional
        True ``sigma_forward`` [m], ``sigma_left`` [m], ``sigma_turn`` [rad], ``sigma_bearing`` [rad] and ``sigma_size``
        [1]. Those that are left out are drawn from the gamma priors of the default model.
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
        With landmarks, the true path as ``true_pose``, ``true_theta`` and the seed. The start is known within 0.05 m
        and 0.05 rad, and the true start is drawn from that belief.

    Raises
    ------
    ModelError
        When `duration` or `seed` is not usable, `theta` does not fit the priors, or an effect cannot be simulated.

    Notes
    -----
    The field is 2.7 m by 1.8 m. The camera looks ahead and sees the landmarks whose true direction is in its field of
    view of 57.6 degrees; of each the log holds the angle and the number of pixels, both noisy. The ideal number falls
    with the square of the distance, and the noise is on the *ratio* of observed to ideal number, so that it is the same
    share near and far. A number that the noise makes zero or negative is no sighting; with a ``sigma_size`` of 0.2
    that happens to one sighting in three million, with 0.4 to one in 160. Which landmarks are seen depends on
    the pose as well; the model of the paper does not use that.

    The robot is steered from its true pose through waypoints, as in
    :func:`pmcl.simulations.amigobot.simulate_amigobot`.

    References
    ----------
    Kaboli, Bowling, Musilek, Bayesian Calibration for Monte Carlo Localization, AAAI 2006, section "AIBO".
    """
    n_steps = check_run(duration, _PERIOD, seed, where)
    check_given(effects, hide_effects)
    rng = make_rng(seed)
    motion, sensor = IncrementNoise(), LandmarkNoise(range=False, bearing=True, size=True)
    truth = draw_theta((*motion.parameters, *sensor.parameters), theta, rng)
    start = _START + _START_STD * rng.standard_normal(3)
    path, command = drive(start, _driver(), [truth[p.name] for p in motion.parameters], n_steps, rng)

    def logged(readings: Mapping[str, Float], affected: Affected | None = None) -> RobotLog:
        shown = affected is not None and not hide_effects
        return RobotLog.build(
            time=_PERIOD * np.arange(n_steps),
            odometry=command,
            landmarks=AIBO_LANDMARKS,
            landmark_bearing=readings["bearing"],
            landmark_size=readings["size"],
            size_at_one_metre=AIBO_SIZE_AT_ONE_METRE,
            start_mean=_START,
            start_std=_START_STD,
            true_poses=path,
            true_theta=affected.true_theta if affected and shown else truth,
            attributes={"effects": affected.described()} if affected and shown and effects else None,
            robot="AIBO (simulated)",
            source=f"pmcl.simulations.aibo, seed {seed}",
            seed=seed,
            where=where,
            warn=False,  # an unfinished log may look like a mistake
        )

    seen = np.where(_in_view(path), 1.0, np.nan)
    empty = logged({"bearing": seen, "size": seen})
    affected = affected_by(effects, empty, seed, motion, sensor, truth)
    if affected.moves_differently:
        path, command = affected.drive(empty, start, _driver(), rng)
        seen = np.where(_in_view(path), 1.0, np.nan)
        empty = logged({"bearing": seen, "size": seen})
    readings = draw_sightings(affected.tables(empty).sensors[0], empty, path, rng)
    nothing = readings["size"] <= 0.0
    return logged({name: np.where(nothing, np.nan, values) for name, values in readings.items()}, affected)


def _driver() -> WaypointDriver:
    return WaypointDriver(_WAYPOINTS, step=0.15, turn=0.5, reached=0.2)


def _in_view(path: Float) -> NDArray[np.bool_]:
    """Return which landmarks the camera sees from poses (T, 3), as (T, J)."""
    offset = AIBO_LANDMARKS.positions - path[:, None, :2]
    direction = wrap(np.arctan2(offset[..., 1], offset[..., 0]) - path[:, 2, None])
    return np.abs(direction) <= 0.5 * AIBO_FIELD_OF_VIEW
