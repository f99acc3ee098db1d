"""What the scans of lidars are called in a robot log, and what such a log must hold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.logs.arrays import LogArrays
from pmcl.logs.finding import Finding
from pmcl.logs.schema import Variable
from pmcl.logs.sensor_variables import ReadingSeries, SensorVariables
from pmcl.logs.validation import fail, positive_number, require_finite
from pmcl.maps.arrays import FARTHEST, as_numbers

__all__ = ["LidarVariables"]

Float = NDArray[np.float64]

# Rays of one laser lie within one turn; a thousandth is left for the rounding of an angle step in single precision.
_ONE_TURN = 2.0 * math.pi * 1.001
# A laser whose rays span less than this has no use; one whose directions are counted in turns does [rad].
_DEGREES = 4.0 * math.pi
# Scans whose usual reading is beyond this many diagonals of the grid are not in metres.
_READING_TO_MAP = 10.0
# Readings that are checked bit for bit for having stuck, of each laser: rays are dependent, and there are hundreds.
_CHECKED_RAYS = 8

_ATTRIBUTES = ("min_range", "max_range", "pose")


def _scan(dim: str) -> Variable:
    return Variable(
        ("time", dim),
        "m",
        "ranges of a lidar; NaN not measured, inf or max_range no echo",
        is_reading=True,
        minimum=0.0,
        may_be_infinite=True,
        attributes=_ATTRIBUTES,
        plural="lidar ranges",
    )


def _scan_angle(dim: str) -> Variable:
    return Variable((dim,), "rad", "angle of each ray in the laser's frame")


class LidarVariables(SensorVariables):
    """Scans of one or several lidars in a log: ``scan`` and ``scan_angle``, or with a name each at the end.

    A laser that is called ``front`` has ``scan_front`` (time, ray_front) and ``scan_angle_front`` (ray_front). No laser
    is called ``angle``, nor begins with ``angle_``.

    A reading at or below `min_range` is kept as it is: lasers write such numbers for what is too near and for errors.
    nav2_amcl takes it as the longest range; the lidar's model decides what it means here.
    """

    variables: ClassVar[Mapping[str, Variable]] = {"scan": _scan("ray"), "scan_angle": _scan_angle("ray")}
    patterns: ClassVar[Mapping[str, Variable]] = {
        "scan_{name}": _scan("ray_{name}"),
        "scan_angle_{name}": _scan_angle("ray_{name}"),
    }

    @classmethod
    def check(cls, dataset: xr.Dataset, where: str) -> None:
        """Check scans, angles and attributes; see :meth:`pmcl.logs.sensor_variables.SensorVariables.check`."""
        held = [name for name in cls.declared(dataset) if name in dataset]
        scans = set(cls.readings(dataset)) & set(held)
        for name in sorted(scans):
            _check_scan(dataset, name, where)
        for name in held:
            partner = name.replace("scan_angle", "scan", 1)
            if name not in scans and partner not in scans:
                fail(where, f"expected variable '{partner}' beside '{name}', got none: add the ranges")

    @classmethod
    def settings(cls, log: LogArrays) -> dict[str, Float]:
        """Return the reach and the mount of each laser."""
        found: dict[str, Float] = {}
        for name, laser in log.lidars.items():
            found[f"lidar {name} reach"] = np.array([laser.min_range, laser.max_range])
            found[f"lidar {name} pose"] = laser.pose
        return found

    @classmethod
    def series(cls, log: LogArrays) -> Iterator[ReadingSeries]:
        """Return the readings of some rays, spread over each laser; those outside its reach are NaN."""
        for name, laser in log.lidars.items():
            rays = np.unique(np.linspace(0, laser.angles.size - 1, _CHECKED_RAYS).astype(np.int64))
            for ray in rays:
                values = laser.ranges[:, ray]
                inside = (values > laser.min_range) & (values < laser.max_range)
                yield ReadingSeries(f"ray {ray} of {_called(name)}", np.where(inside, values, np.nan))

    @classmethod
    def implausible(cls, log: LogArrays) -> Iterator[Finding]:
        """Return what ranges and reach show by themselves, and beside the size of the grid map."""
        for name, laser in log.lidars.items():
            measured = laser.ranges[~np.isnan(laser.ranges)]
            if measured.size < 10:
                continue
            echoes = measured[(measured < laser.max_range) & (measured > laser.min_range)]
            yield from _no_echoes(name, measured, echoes, laser.min_range, laser.max_range)
            yield from _beyond_the_map(name, echoes, log)


def _called(name: str) -> str:
    return f"lidar '{name}'" if name else "the lidar"


def _check_scan(dataset: xr.Dataset, name: str, where: str) -> None:
    label = name.removeprefix("scan")
    angles = f"scan_angle{label}"
    if angles not in dataset:
        fail(where, f"expected variable '{angles}' (ray) beside '{name}', got none: say where each ray points")
    require_finite(dataset, angles, where)
    _check_angles(dataset[angles].values, angles, where)
    attrs = dataset[name].attrs
    attrs["max_range"] = _checked_max_range(attrs, name, where)
    attrs["min_range"] = _checked_min_range(attrs, name, where)
    attrs["pose"] = _checked_pose(attrs, name, where)


def _check_angles(angles: Float, name: str, where: str) -> None:
    span = float(np.ptp(angles))
    if span > _ONE_TURN:
        advice = "convert degrees to radians" if span > _DEGREES else "leave out rays that point the same way again"
        fail(where, f"expected '{name}' within one turn, got {span:g} rad from first to last: {advice}")
    step = np.diff(angles)
    if step.size and not ((step > 0.0).all() or (step < 0.0).all()):
        k = int(np.argmax(np.sign(step) != np.sign(step[0]))) + 1 if step[0] != 0.0 else 1
        fail(
            where,
            f"expected '{name}' strictly increasing or decreasing, got {angles[k]:g} rad after {angles[k - 1]:g} rad "
            f"at ray {k}: unwrap the angles, or sort the rays",
        )


def _checked_max_range(attrs: Mapping[str, object], name: str, where: str) -> float:
    stated = attrs.get("max_range")
    number = positive_number(stated)  # type: ignore[arg-type]
    if number is None:
        got = "none" if stated is None else f"{stated!r:.60}"
        fail(
            where,
            f"expected attribute max_range > 0 [m] on '{name}', at most {FARTHEST:g}, got {got}: set the longest range "
            "of the laser",
        )
    return number


def _checked_min_range(attrs: Mapping[str, object], name: str, where: str) -> float:
    stated, longest = attrs.get("min_range"), float(attrs["max_range"])  # type: ignore[arg-type]
    try:
        numbers = as_numbers(stated).ravel()  # type: ignore[arg-type]
    except TypeError:
        numbers = np.empty(0)
    if numbers.size != 1 or not 0.0 <= numbers[0] < longest:
        got = "none" if stated is None else f"{stated!r:.60}"
        fail(
            where,
            f"expected attribute min_range on '{name}' from 0 to below max_range = {longest:g} m, got {got}: "
            "set the shortest range of the laser",
        )
    return float(numbers[0])


def _checked_pose(attrs: Mapping[str, object], name: str, where: str) -> Float:
    stated = attrs.get("pose")
    try:
        pose = as_numbers(stated).ravel()  # type: ignore[arg-type]
    except TypeError:
        pose = np.empty(0)
    if pose.shape != (3,) or not (np.abs(pose[:2]) <= FARTHEST).all() or not np.isfinite(pose).all():
        got = "none" if stated is None else f"{stated!r:.60}"
        fail(
            where,
            f"expected attribute pose on '{name}' as three finite numbers (x [m], y [m], yaw [rad]), within "
            f"{FARTHEST:g} m, got {got}: say where the laser sits on the robot",
        )
    if abs(pose[2]) > _ONE_TURN:
        fail(where, f"expected the yaw of 'pose' on '{name}' within one turn, got {pose[2]:g} rad: convert degrees")
    pose.flags.writeable = False
    return pose


def _no_echoes(name: str, measured: Float, echoes: Float, low: float, high: float) -> Iterator[Finding]:
    if echoes.size > 0.02 * measured.size:
        return
    beyond = int(np.count_nonzero(measured >= high))
    where = "at or beyond max_range" if 2 * beyond > measured.size else "at or below min_range"
    bound = high if 2 * beyond > measured.size else low
    yield Finding(
        "all-at-max-range" if 2 * beyond > measured.size else "all-at-min-range",
        "implausible",
        True,
        f"nearly all {measured.size} ranges of {_called(name)} are {where} = {bound:g} m: "
        "check the units of ranges and reach",
    )


def _beyond_the_map(name: str, echoes: Float, log: LogArrays) -> Iterator[Finding]:
    if log.grid_map is None or not echoes.size:
        return
    diagonal = math.hypot(*log.grid_map.size)
    usual = float(np.median(echoes))
    if usual > _READING_TO_MAP * diagonal:
        yield Finding(
            "ranges-beyond-map",
            "implausible",
            True,
            f"half of the ranges of {_called(name)} are longer than {usual:.3g} m, but the grid map is only "
            f"{diagonal:.3g} m from corner to corner: check that ranges and the map's resolution are in metres",
        )
