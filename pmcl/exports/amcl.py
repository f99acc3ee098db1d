"""Parameters of AMCL as nav2, beluga and ROS 1 name and mean them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pmcl.errors import PosteriorError
from pmcl.exports.beam_model import beluga_beam_weights, nav2_beam_weights
from pmcl.exports.calibration import Calibration, Laser
from pmcl.exports.likelihood_field import FieldWeights, beluga_weights, nav2_weights
from pmcl.exports.spread import Spread, spread_of
from pmcl.exports.text import Line, described
from pmcl.models.sensors.lidar.table import cell_noise

__all__ = ["CONSUMERS", "Consumer", "amcl_lines"]

# nav2 multiplies the weights of a scan's beams as numbers of double precision; below exp(-708) the product is 0 for
# every particle, and the scan is then ignored.
_LEAST_LOG_WEIGHT = -700.0
# Draws for which the spread of derived weights is computed; each costs a search for the untempered beam (0.5 ms).
_DERIVED_DRAWS = 200
# Greatest distance from an obstacle that counts [m], where the model says nothing else: nav2's default.
_MAX_DISTANCE = 2.0


class Consumer(NamedTuple):
    """How one program names its parameters.

    Attributes
    ----------
    program : str
        For comments.
    path : tuple of str
        Tables of the file that hold the parameters.
    motion_key : str
        Key of the motion model.
    motions : dict of str to str
        Its value by the name of pmcl's motion model.
    alpha, laser : str
        Prefixes of the alphas and of the lidar's parameters.
    max_beams : str
        Key of the number of beams.
    normalised : bool
        Whether a hit has the normal density's factor.
    euclidean : bool
        Whether a scan is used after a Euclidean distance; otherwise after one along x or y.
    """

    program: str
    path: tuple[str, ...]
    motion_key: str
    motions: dict[str, str]
    alpha: str
    laser: str
    max_beams: str
    normalised: bool
    euclidean: bool


_NAV2_MOTIONS = {
    "differential": "nav2_amcl::DifferentialMotionModel",
    "omni": "nav2_amcl::OmniMotionModel",
}

CONSUMERS = {
    "nav2": Consumer(
        "nav2_amcl", ("amcl", "ros__parameters"), "robot_model_type", _NAV2_MOTIONS,
        "alpha", "", "max_beams", False, False,
    ),
    "beluga": Consumer(
        "beluga_amcl", ("amcl", "ros__parameters"), "robot_model_type", _NAV2_MOTIONS,
        "alpha", "", "max_beams", True, True,
    ),
    # The models without "-corrected" pass a variance where a standard deviation is meant.
    "ros1": Consumer(
        "ROS 1 amcl", (), "odom_model_type", {"differential": "diff-corrected", "omni": "omni-corrected"},
        "odom_alpha", "laser_", "laser_max_beams", False, False,
    ),
}  # fmt: skip
"""Programs that take AMCL's parameters, by the name of the format."""


def amcl_lines(calibration: Calibration, consumer: Consumer) -> list[Line]:
    """Return the parameters of a program.

    Parameters
    ----------
    calibration : Calibration
        What the posterior says.
    consumer : Consumer
        The program.

    Returns
    -------
    list of Line

    Raises
    ------
    PosteriorError
        When the posterior holds neither alphas nor a lidar's parameters, or not the range of the lidar.
    """
    motion = _motion_lines(calibration, consumer)
    lidar = _lidar_lines(calibration, consumer)
    if not motion and not lidar:
        raise PosteriorError(
            f"expected a posterior of the motion model differential or omni, or of a lidar, for {consumer.program}, "
            f"but this one has {', '.join(calibration.theta)}; calibrate a log with a grid map, or export to json"
        )
    if not motion:
        motion = [
            Line("", None, f"no alphas: the motion model was '{calibration.motion or 'unknown'}'; calibrate with "
                 'motion = "differential" or "omni"')
        ]  # fmt: skip
    return motion + (lidar or [Line("", None, "nothing of the laser: the model has no lidar")])


def known(calibration: Calibration, name: str) -> Spread | None:
    """Return the spread of a parameter; None where the model fixes it."""
    if name not in calibration.draws:
        return None
    return spread_of(calibration.draws[name], calibration.prior.get(name))


def _line(calibration: Calibration, key: str, name: str) -> Line:
    spread = known(calibration, name)
    comment = "fixed by the model" if spread is None else described(spread, calibration.units.get(name, "1"))
    return Line(key, calibration.theta[name], comment)


def _motion_lines(calibration: Calibration, consumer: Consumer) -> list[Line]:
    if calibration.motion not in consumer.motions:
        return []
    lines = [Line(consumer.motion_key, consumer.motions[calibration.motion])]
    for number in range(1, 6):
        name = f"alpha{number}"
        if name in calibration.theta:
            lines.append(_line(calibration, f"{consumer.alpha}{number}", name))
    return lines + _update_lines(calibration, consumer)


def _update_lines(calibration: Calibration, consumer: Consumer) -> list[Line]:
    """Return after which motion scans are used: alphas belong to steps of that size."""
    found = calibration.updates
    if "update_min_d" not in found or "update_min_a" not in found:
        return [
            Line(
                "", None, "update_min_d, update_min_a: not known of this log. Alphas belong to the size of its steps:"
            ),
            Line("", None, "convert with the --update-min-d and --update-min-a that the filter will use"),
        ]
    rule = str(found.get("update_rule", ""))
    other = "nav2" if consumer.euclidean else "euclidean"
    comment = "[m] as in the log: the alphas belong to it"
    if rule == other:
        comment += f"; rows were chosen by the rule '{rule}', {consumer.program} has another: small differences"
    return [
        Line("update_min_d", float(found["update_min_d"]), comment),
        Line("update_min_a", float(found["update_min_a"]), "[rad] as in the log: the alphas belong to it"),
    ]


def _laser(calibration: Calibration) -> Laser:
    usable = [laser for laser in calibration.lasers if math.isfinite(laser.max_range)]
    if not usable:
        raise PosteriorError(
            "expected the greatest range of the lidar in the posterior's group 'observed_data' (attribute max_range of "
            "'scan'), but got none; give the posterior that 'pmcl calibrate' wrote, or export to json"
        )
    return usable[0]


def _lidar_lines(calibration: Calibration, consumer: Consumer) -> list[Line]:
    settings = calibration.lidar
    if settings is None or "sigma_hit" not in calibration.theta:
        return []
    laser = _laser(calibration)
    field = settings.get("model", "likelihood-field") != "beam"
    lines = _field_lines(calibration, consumer, laser) if field else _beam_lines(calibration, consumer, laser)
    if len({other.max_range for other in calibration.lasers}) > 1:
        lines.append(Line("", None, "the lasers have different ranges; these weights are for the first one"))
    return [
        *lines,
        Line("laser_min_range", laser.min_range, "[m] as in the log"),
        Line("laser_max_range", laser.max_range, "[m] as in the log; the weight of random readings belongs to it"),
        Line(consumer.max_beams, max(laser.beams, 2), "as in the log" if laser.beams >= 2 else "two at least"),
    ]


def _number(settings: dict[str, Any], key: str, otherwise: float) -> float:
    value = settings.get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else otherwise


def _field_lines(calibration: Calibration, consumer: Consumer, laser: Laser) -> list[Line]:
    settings = calibration.lidar or {}
    exponent = _number(settings, "exponent", 1.0)
    translate = beluga_weights if consumer.normalised else nav2_weights

    def weights(sigma_hit: float, z_rand: float) -> FieldWeights:
        # pmcl's sigma_hit leaves out what the map's cells hide, the other programs' contains it.
        noise = math.hypot(sigma_hit, cell_noise(calibration.resolution))
        return translate(1.0 - z_rand, z_rand, noise, laser.max_range, exponent)

    def some(sigma_hit: Any, z_rand: Any) -> list[FieldWeights]:
        pairs = list(np.broadcast(sigma_hit, z_rand))
        return [weights(*pair) for pair in pairs[:: max(1, len(pairs) // _DERIVED_DRAWS)]]

    found = weights(calibration.theta["sigma_hit"], calibration.theta["z_rand"])
    draws = calibration.derived(some, "sigma_hit", "z_rand")
    told = {name: spread for name in ("sigma_hit", "z_rand") if (spread := known(calibration, name)) is not None}
    prefix = consumer.laser
    lines = [
        Line("laser_model_type", "likelihood_field_prob", "the only model that multiplies the beams"),
        Line("do_beamskip", False, "beam skipping is no likelihood") if not consumer.normalised else None,
        *(_of_pmcl(name, spread, calibration) for name, spread in told.items()),
        *_cells(calibration),
        *_tempering(exponent, found.deviation, laser.beams, consumer),
    ]
    for name in ("z_hit", "z_rand", "sigma_hit"):
        spread = spread_of(np.array([getattr(each, name) for each in draws], dtype=float))
        unit = "m" if name == "sigma_hit" else "1"
        lines.append(Line(f"{prefix}{name}", float(getattr(found, name)), described(spread, unit)))
    reach = _number(settings, "max_distance", _MAX_DISTANCE)
    lines.append(Line("laser_likelihood_max_dist", reach, "[m] as in the model"))
    off_map = "1 / laser_max_range, whatever z_rand is" if consumer.normalised else f"as one {reach:g} m from any wall"
    lines.append(
        Line("", None, f"{consumer.program} weighs a reading that ends off the map {off_map}; pmcl goes on measuring "
             f"distances there. Where walls are at the edge of the map's image, add {reach:g} m of unknown cells to it")
    )  # fmt: skip
    if not consumer.normalised and calibration.resolution:
        # MAP_GXWX of nav2 and ROS 1 adds half a cell to a position whose origin is a cell's corner.
        lines.append(
            Line("", None, f"{consumer.program} takes the corner of a cell for its centre: the poses that it finds are "
                 f"{0.5 * calibration.resolution:g} m too small in x and in y")
        )  # fmt: skip
    least = laser.beams * math.log(found.z_rand / laser.max_range) if found.z_rand > 0.0 else 0.0
    if not consumer.normalised and least < _LEAST_LOG_WEIGHT:
        lines.append(
            Line("", None, f"CAREFUL: a product over {laser.beams} beams can underflow to 0; {consumer.program} then "
                 f"ignores the scan. Calibrate with at most {int(laser.beams * _LEAST_LOG_WEIGHT / least)} beams")
        )  # fmt: skip
    return [line for line in lines if line is not None]


def _of_pmcl(name: str, spread: Spread, calibration: Calibration) -> Line:
    return Line("", None, f"posterior of {name}: {described(spread, calibration.units.get(name, '1'))}")


def _cells(calibration: Calibration) -> Sequence[Line]:
    if not calibration.resolution:
        return []
    hidden = cell_noise(calibration.resolution)
    whole = math.hypot(calibration.theta["sigma_hit"], hidden)
    return [
        Line("", None, f"the map's cells of {calibration.resolution:g} m hide another {hidden:.3g} m: together the "
             f"noise of a hit is {whole:.3g} m")
    ]  # fmt: skip


def _tempering(exponent: float, deviation: float, beams: int, consumer: Consumer) -> Sequence[Line]:
    if exponent == 1.0:
        return [Line("", None, "no tempering (exponent 1): the weights are exactly those of the calibration")]
    return [
        Line("", None, f"tempering exponent {exponent:.4g}: neighbouring beams err together, and {beams} of them tell "
             f"as much as {beams * exponent:.3g} independent ones"),
        Line("", None, f"{consumer.program} has no exponent: it is worked into z_hit, z_rand and sigma_hit below, "
             f"to {deviation:.2g} nat for each beam"),
    ]  # fmt: skip


def _beam_lines(calibration: Calibration, consumer: Consumer, laser: Laser) -> list[Line]:
    names = ("z_short", "z_max", "z_rand", "sigma_hit")

    def weights(z_short: Any, z_max: Any, z_rand: Any, sigma_hit: Any) -> Any:
        if consumer.normalised:
            return beluga_beam_weights(z_short, z_max, z_rand)
        return nav2_beam_weights(z_short, z_max, z_rand, sigma_hit)

    found = weights(*(calibration.theta[name] for name in names))
    draws = calibration.derived(weights, *names)
    told = {name: spread for name in names[:3] if (spread := known(calibration, name)) is not None}
    prefix = consumer.laser
    lines = [
        Line("laser_model_type", "beam"),
        Line(
            "",
            None,
            f"NOT EXACT: {consumer.program} adds up the cubes of the beams' densities, which is no likelihood.",
        ),
        Line("", None, "Each beam is as calibrated, but not what a scan is worth, and a tempering exponent is lost."),
        Line("", None, 'For weights that are exact, calibrate with model = "likelihood-field".'),
        *(_of_pmcl(name, spread, calibration) for name, spread in told.items()),
    ]
    for name in ("z_hit", "z_short", "z_max", "z_rand"):
        spread = spread_of(np.atleast_1d(np.asarray(getattr(draws, name), dtype=float)))
        lines.append(Line(f"{prefix}{name}", float(getattr(found, name)), described(spread)))
    lines.append(_line(calibration, f"{prefix}sigma_hit", "sigma_hit"))
    lines.append(_line(calibration, f"{prefix}lambda_short", "lambda_short"))
    return lines
