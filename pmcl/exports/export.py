"""Writing a posterior as a file for another program."""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Callable
from typing import Any

import numpy as np

from pmcl.checks import check_choice
from pmcl.errors import PosteriorError
from pmcl.exports.amcl import CONSUMERS, amcl_lines, known
from pmcl.exports.calibration import Calibration, calibration_of
from pmcl.exports.mounts import MOUNT_EFFECTS, corrected_mount
from pmcl.exports.spread import spread_of
from pmcl.exports.text import Line, described, yaml_text
from pmcl.exports.wheels import WHEEL_EFFECTS, wheel_multipliers
from pmcl.posterior.compat import Posterior

__all__ = ["FORMATS", "export_text"]

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def export_text(
    data: Posterior, format: str = "nav2", *, estimate: str = "mean", wheel_separation: float | None = None
) -> str:
    """Write a posterior in the names, units and meaning of another program.

    Parameters
    ----------
    data : arviz.InferenceData or xarray.DataTree
        What :func:`pmcl.calibrate` returned, or was read from a file.
    format : {"nav2", "beluga", "ros1", "ros2_controllers", "static-transforms", "json"}
        ``nav2``, ``beluga`` and ``ros1``: parameters of AMCL. ``ros2_controllers``: wheel multipliers of a differential
        drive. ``static-transforms``: commands that publish where the lasers sit. ``json``: everything, for programs.
    estimate : {"mean", "map"}
        Posterior mean, or the draw of the greatest joint density.
    wheel_separation : float, optional
        With which the log's odometry was computed [m]; needed where driving straight is driving an arc.

    Returns
    -------
    str
        The file's text. Each line of a YAML file has the spread of its value as a comment, and says so where the log
        cannot tell the parameter.

    Raises
    ------
    PosteriorError
        When the format or the estimate is unknown, or the posterior holds nothing that the format can say.
    """
    check_choice("format", format, FORMATS, error=PosteriorError)
    calibration = calibration_of(data, estimate)
    return FORMATS[format](calibration, wheel_separation)


def _heading(calibration: Calibration, what: str) -> list[str]:
    made = f"{what}, by pmcl {importlib.metadata.version('pmcl')}"
    which = {"mean": "posterior mean", "map": "draw of the greatest joint density"}[calibration.method]
    return [made, f"values: {which}; comments: posterior mean +- standard deviation",
            *(f"CAREFUL: {remark}" for remark in calibration.remarks)]  # fmt: skip


def _amcl(name: str) -> Callable[[Calibration, float | None], str]:
    def write(calibration: Calibration, separation: float | None) -> str:
        consumer = CONSUMERS[name]
        heading = _heading(calibration, f"{consumer.program} parameters")
        return yaml_text(consumer.path, amcl_lines(calibration, consumer), heading)

    return write


def _wheels(calibration: Calibration, separation: float | None) -> str:
    found, spreads = _multipliers(calibration, separation)
    lines = [Line(key, float(found[key]), described(spreads[key])) for key in found]
    heading = _heading(calibration, "wheels of diff_drive_controller (ros2_controllers)")
    heading.append("relative to the wheels that the log was recorded with: multiply the multipliers that were in use")
    return yaml_text(("diff_drive_controller", "ros__parameters"), lines, heading)


def _multipliers(calibration: Calibration, separation: float | None) -> tuple[dict[str, float], dict[str, Any]]:
    effects = [effect for effect in calibration.effects if effect in WHEEL_EFFECTS]
    if not effects:
        raise PosteriorError(
            f"expected a model with an effect of the wheels ({', '.join(WHEEL_EFFECTS)}), but got one with "
            f"{', '.join(calibration.effects) or 'no effects'}; let 'pmcl criticize --posterior' look for them"
        )
    value = wheel_multipliers(effects, calibration.theta, separation)
    draws = wheel_multipliers(effects, {**calibration.theta, **calibration.draws}, separation)
    keys = {
        "left_wheel_radius_multiplier": "left",
        "right_wheel_radius_multiplier": "right",
        "wheel_separation_multiplier": "separation",
    }
    spreads = {key: spread_of(np.atleast_1d(np.asarray(getattr(draws, name)))) for key, name in keys.items()}
    return {key: float(getattr(value, name)) for key, name in keys.items()}, spreads


def _transforms(calibration: Calibration, separation: float | None) -> str:
    mounts = _mounts(calibration)
    text = [f"# {line}" for line in _heading(calibration, "mounts of the lasers on the robot")]
    text.append("# the log holds no height, roll and pitch: take these from the robot's description")
    for mount in mounts:
        pose, sd = mount["pose"], mount["sd"]
        frame = mount["laser"] or "laser"
        spread = f"+- {sd[0]:.2g} m, {sd[1]:.2g} m, {sd[2]:.2g} rad"
        text.append(f"# {frame}: described at {', '.join(f'{value:.6g}' for value in mount['described'])}; {spread}")
        x, y, yaw = (f"{value:.6f}" for value in pose)
        text.append(
            f"ros2 run tf2_ros static_transform_publisher --x {x} --y {y} --z 0 --roll 0 --pitch 0 --yaw {yaw} "
            f"--frame-id base_link --child-frame-id {frame}"
        )
    return "\n".join(text) + "\n"


def _mounts(calibration: Calibration) -> list[dict[str, Any]]:
    effects = [effect for effect in calibration.effects if effect in MOUNT_EFFECTS]
    if not effects:
        raise PosteriorError(
            f"expected a model with an effect of the mount ({', '.join(MOUNT_EFFECTS)}), but got one with "
            f"{', '.join(calibration.effects) or 'no effects'}; let 'pmcl criticize --posterior' look for them"
        )
    if not calibration.lasers:
        raise PosteriorError(
            "expected a log with a lidar in the posterior, but it has none; export to json for the corrections"
        )
    mounts = []
    for laser in calibration.lasers:
        value = corrected_mount(laser.pose, effects, calibration.theta)
        draws = corrected_mount(laser.pose, effects, {**calibration.theta, **calibration.draws})
        mounts.append({
            "laser": laser.name, "described": list(laser.pose), "pose": [float(part) for part in value],
            "sd": [float(np.std(part)) for part in draws],
        })  # fmt: skip
    return mounts


def _json(calibration: Calibration, separation: float | None) -> str:
    parameters = {}
    for name in calibration.theta:
        entry: dict[str, Any] = {"value": calibration.theta[name], "unit": calibration.units.get(name, "")}
        spread = known(calibration, name)
        if spread is None:
            parameters[name] = entry | {"fixed": True}
            continue
        quantiles = np.quantile(calibration.draws[name], _QUANTILES)
        entry |= {
            "fixed": False,
            "mean": spread.mean,
            "sd": spread.sd,
            "quantiles": {f"{q:g}": float(value) for q, value in zip(_QUANTILES, quantiles, strict=True)},
            "overlap_with_prior": None if np.isnan(spread.overlap) else spread.overlap,
            "log_can_tell": spread.told,
        }
        parameters[name] = entry
    content: dict[str, Any] = {
        "format": "pmcl-export/1",
        "estimate": calibration.method,
        "parameters": parameters,
        "motion": calibration.motion,
        "sensors": calibration.model.get("sensors", {}),
        "effects": list(calibration.effects),
        "updates": {name: _plain(value) for name, value in calibration.updates.items()},
        "lasers": [_finite(laser._asdict()) for laser in calibration.lasers],
        "remarks": list(calibration.remarks),
    }
    arc = "odometry-arc" in calibration.effects and separation is None
    if not arc and any(effect in WHEEL_EFFECTS for effect in calibration.effects):
        content["odometry_multipliers"] = _multipliers(calibration, separation)[0]
    if calibration.lasers and any(effect in MOUNT_EFFECTS for effect in calibration.effects):
        content["mounts"] = _mounts(calibration)
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _finite(laser: dict[str, Any]) -> dict[str, Any]:
    """Replace numbers that JSON does not have."""
    return {key: None if isinstance(value, float) and not np.isfinite(value) else value for key, value in laser.items()}


FORMATS: dict[str, Callable[[Calibration, float | None], str]] = {
    "nav2": _amcl("nav2"),
    "beluga": _amcl("beluga"),
    "ros1": _amcl("ros1"),
    "ros2_controllers": _wheels,
    "static-transforms": _transforms,
    "json": _json,
}
"""What can be written, by the name of the format."""
