"""What range beams are called in a robot log, and what such a log must hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.logs.arrays import LogArrays
from pmcl.logs.finding import Finding
from pmcl.logs.schema import Variable
from pmcl.logs.sensor_variables import ReadingSeries, SensorVariables
from pmcl.logs.validation import ONE_TURN, fail, positive_number, require_finite
from pmcl.maps.arrays import FARTHEST

__all__ = ["RangeVariables"]

Float = NDArray[np.float64]

# No room is so much smaller than the reach of the sensor that is used in it.
_REACH_TO_MAP = 50.0

_VARIABLES = {
    "range": Variable(
        ("time", "beam"),
        "m",
        "range readings; NaN not measured, inf or max_range no echo",
        is_reading=True,
        minimum=0.0,
        may_be_infinite=True,
        attributes=("max_range",),
    ),
    "beam_pose": Variable(("beam", "pose"), "m, m, rad", "where each beam sits on the robot"),
}


class RangeVariables(SensorVariables):
    """Range beams in a log."""

    variables: ClassVar[Mapping[str, Variable]] = _VARIABLES

    @classmethod
    def check(cls, dataset: xr.Dataset, where: str) -> None:
        """Check beams and reach; see :meth:`pmcl.logs.sensor_variables.SensorVariables.check`."""
        _check(dataset, where)

    @classmethod
    def settings(cls, log: LogArrays) -> dict[str, Float]:
        """Return the longest range."""
        return {"max_range": np.array(log.max_range)}

    @classmethod
    def series(cls, log: LogArrays) -> Iterator[ReadingSeries]:
        """Return the readings of each beam; zero and no echo, at which sensors clip, are NaN."""
        if log.ranges is not None:
            unclipped = np.where((log.ranges > 0.0) & (log.ranges < log.max_range), log.ranges, np.nan)
            for k, values in enumerate(unclipped.T):
                yield ReadingSeries(f"beam {k}", values)

    @classmethod
    def implausible(cls, log: LogArrays) -> Iterator[Finding]:
        """Return what ranges, reach and beam directions show by themselves."""
        yield from _all_at_max_range(log)
        yield from _reach(log)
        yield from _beam_yaws(log)


def _check(dataset: xr.Dataset, where: str) -> None:
    if "range" not in dataset:
        return
    if "beam_pose" not in dataset:
        fail(where, "expected variable 'beam_pose' (beam, pose) beside 'range', got none: say where each beam sits")
    require_finite(dataset, "beam_pose", where)
    _check_beam_yaws(dataset["beam_pose"].values[:, 2], where)
    # The attribute belongs to the readings; on the file as a whole it says the same.
    stated = dataset["range"].attrs.get("max_range", dataset.attrs.get("max_range"))
    max_range = positive_number(stated)
    if max_range is None:
        got = "none" if stated is None else repr(stated)
        fail(
            where,
            f"expected attribute max_range > 0 [m] on 'range', at most {FARTHEST:g}, got {got}: set the longest range "
            "of the sensor",
        )
    dataset["range"].attrs["max_range"] = max_range


def _check_beam_yaws(yaws: NDArray[np.float64], where: str) -> None:
    bad = np.flatnonzero(np.abs(yaws) > ONE_TURN)
    if bad.size:
        k = int(bad[0])
        indices = any(np.array_equal(yaws, np.arange(len(yaws)) + first) for first in (0, 1))
        advice = "these seem to be the beams' numbers; give directions" if indices else "convert degrees to radians"
        fail(where, f"expected beam yaws within one turn (+-2 pi rad), got {yaws[k]:g} for beam {k}: {advice}")


def _all_at_max_range(log: LogArrays) -> Iterator[Finding]:
    if log.ranges is None:
        return
    measured = ~np.isnan(log.ranges)
    if measured.sum() >= 10 and (log.ranges[measured] >= log.max_range).mean() > 0.98:
        finite = log.ranges[np.isfinite(log.ranges)]
        shortest = f", the shortest {finite.min():.4g}" if finite.size else ""
        yield Finding(
            "all-at-max-range",
            "implausible",
            True,
            f"nearly all {measured.sum()} range readings are at or beyond max_range = {log.max_range:g} m{shortest}: "
            "check the units of readings and max_range",
        )


def _reach(log: LogArrays) -> Iterator[Finding]:
    if log.ranges is None or log.walls is None:
        return
    x_low, x_high, y_low, y_high = log.walls.bounds
    longest = float(np.hypot(x_high - x_low, y_high - y_low))
    if log.max_range > _REACH_TO_MAP * longest:
        yield Finding(
            "max-range-too-long",
            "implausible",
            False,
            f"max_range is {log.max_range:g} m, but the walls are nowhere further apart than {longest:.3g} m: "
            "check that both are in metres",
        )


def _beam_yaws(log: LogArrays) -> Iterator[Finding]:
    if log.beam_poses is None or len(log.beam_poses) < 4:
        return
    yaws = log.beam_poses[:, 2]
    if any(np.array_equal(yaws, np.arange(len(yaws)) + first) for first in (0, 1)):
        yield Finding(
            "beam-yaws-are-indices",
            "implausible",
            True,
            f"the yaws of the {len(yaws)} beams are {yaws[0]:g}, {yaws[1]:g}, ... {yaws[-1]:g} rad: these seem to be "
            "the beams' numbers; give the direction of each beam in radians",
        )
