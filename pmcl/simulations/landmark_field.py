"""A robot among landmarks in a field: a simple case for tests and benchmarks, nearly Gaussian and never ambiguous."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pmcl.errors import ModelError
from pmcl.geometry import wrap
from pmcl.logs.robot_log import RobotLog
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.parameters import Parameter
from pmcl.models.sensors.landmarks.sensor import LandmarkNoise
from pmcl.simulations.driving import WaypointDriver, drive
from pmcl.simulations.effects import Affected, Given, affected_by
from pmcl.simulations.sightings import draw_sightings
from pmcl.simulations.simulate import draw_theta, make_rng

__all__ = ["simulate_landmark_field"]

_SIDE = 20.0
# An uneven loop, 4 m or more inside the border: landmarks are 4 to 20 m away, and the robot turns both ways.
_WAYPOINTS = np.array(
    [(15.0, 5.0), (15.5, 11.0), (11.0, 10.0), (10.0, 15.0), (5.0, 15.5), (4.5, 9.0), (8.0, 7.0), (5.0, 4.5)]
)
_START = np.array([5.0, 5.0, 0.0])
_START_STD = np.array([0.1, 0.1, 0.05])
_USUAL = {
    "sigma_forward": 0.05, "sigma_left": 0.03, "sigma_turn": 0.03,
    "sigma_landmark_range": 0.3, "sigma_bearing": 0.05,
}  # fmt: skip


def simulate_landmark_field(
    n_steps: int = 400,
    seed: int = 0,
    theta: Mapping[str, float] | None = None,
    *,
    n_landmarks: int = 8,
    ranges: bool = True,
    bearings: bool = False,
    reach: float = np.inf,
    field_of_view: float = np.inf,
    effects: Sequence[Given] = (),
    hide_effects: bool = False,
) -> RobotLog:
    """Simulate a robot that drives a loop in a square of 20 m with landmarks along its border.

    Parameters
    ----------
    n_steps : int
        Rows T, one per second; steps of 0.5 m.
    seed : int
        Determines all random numbers.
    theta : mapping of str to float, optional
        Replaces some of the true values sigma_forward 0.05 m, sigma_left 0.03 m, sigma_turn 0.03 rad,
        sigma_landmark_range 0.3 m, sigma_bearing 0.05 rad.
    n_landmarks : int
        Number of landmarks J, evenly along the border.
    ranges, bearings : bool
        Whether the robot reads distances and bearings.
    reach : float
        Landmarks whose true distance is greater are not seen [m].
    field_of_view : float
        Angle, half of it to each side of straight ahead, outside of which landmarks are not seen [rad].
    effects : sequence, optional
        Effects that the default model lacks: texts such as ``"beam-bias@2=0.06"``, ``"range-scale=large"`` (see
        :func:`pmcl.models.effects.selection.parse_effect`), or pairs of an effect and its values.
    hide_effects : bool
        Whether the log does not mention them. Otherwise ``true_theta`` holds their values, and the attribute
        ``effects`` their names and places.

    Returns
    -------
    RobotLog
        With ``true_pose``, ``true_theta`` and the seed; the start is known within 0.1 m and 0.05 rad and drawn from
        that belief.

    Raises
    ------
    ModelError
        When sizes or names are not usable, or an effect cannot be simulated.
    """
    if n_steps < 2 or n_landmarks < 1 or seed < 0 or not (ranges or bearings):
        raise ModelError(
            "expected at least 2 rows, 1 landmark, a seed of at least 0, and ranges or bearings; choose such, not "
            f"n_steps={n_steps}, n_landmarks={n_landmarks}, seed={seed}, ranges={ranges}, bearings={bearings}"
        )
    rng = make_rng(seed)
    motion, sensor = IncrementNoise(), LandmarkNoise(range=ranges, bearing=bearings)
    parameters: tuple[Parameter, ...] = (*motion.parameters, *sensor.parameters)
    usual = {parameter.name: _USUAL[parameter.name] for parameter in parameters}
    truth = draw_theta(parameters, {**usual, **(theta or {})}, rng)
    start = _START + _START_STD * rng.standard_normal(3)
    path, command = drive(start, _driver(), [truth[p.name] for p in motion.parameters], n_steps, rng)
    positions = _border(n_landmarks)

    def logged(readings: dict[str, np.ndarray], affected: Affected | None = None) -> RobotLog:
        shown = affected is not None and not hide_effects
        return RobotLog.build(
            time=np.arange(n_steps, dtype=float),
            odometry=command,
            landmarks=positions,
            start_mean=_START,
            start_std=_START_STD,
            true_poses=path,
            true_theta=affected.true_theta if affected and shown else truth,
            attributes={"effects": affected.described()} if affected and shown and effects else None,
            robot="robot in a landmark field (simulated)",
            source=f"pmcl.simulations.landmark_field, seed {seed}",
            seed=seed,
            where="simulate_landmark_field",
            warn=False,  # an unfinished log may look like a mistake
            landmark_range=readings.get("range"),
            landmark_bearing=readings.get("bearing"),
        )

    used = [name for name, is_read in (("range", ranges), ("bearing", bearings)) if is_read]
    empty = logged(dict.fromkeys(used, _seen(positions, path, reach, field_of_view)))
    affected = affected_by(effects, empty, seed, motion, sensor, truth)
    if affected.moves_differently:
        path, command = affected.drive(empty, start, _driver(), rng)
        empty = logged(dict.fromkeys(used, _seen(positions, path, reach, field_of_view)))
    return logged(draw_sightings(affected.tables(empty).sensors[0], empty, path, rng), affected)


def _driver() -> WaypointDriver:
    return WaypointDriver(_WAYPOINTS, step=0.5, turn=0.6, reached=0.8, aim=0.8)


def _seen(positions: np.ndarray, path: np.ndarray, reach: float, field_of_view: float) -> np.ndarray:
    dx, dy = (positions - path[:, None, :2]).transpose(2, 0, 1)
    aside = np.abs(wrap(np.arctan2(dy, dx) - path[:, 2, None]))
    return np.where((np.hypot(dx, dy) <= reach) & (aside <= 0.5 * field_of_view), 1.0, np.nan)


def _border(count: int) -> np.ndarray:
    """Return `count` points evenly along the border of the square, from its lower left corner counter-clockwise."""
    along = 4.0 * np.arange(count) / count
    corners = _SIDE * np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)])
    side = along.astype(int)
    return np.asarray(corners[side] + (along - side)[:, None] * (corners[side + 1] - corners[side]))
