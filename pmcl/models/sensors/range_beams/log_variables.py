"""What range beams are called in a robot log, and what such a log must hold."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.logs.schema import Variable
from pmcl.logs.validation import ONE_TURN, check_readings, fail, positive_number, require_finite

__all__ = ["VARIABLES", "check_ranges"]

VARIABLES = {
    "range": Variable(
        ("time", "beam"), "m", "range readings; NaN not measured, inf or max_range no echo", True, 0.0, True
    ),
    "beam_pose": Variable(("beam", "pose"), "m, m, rad", "where each beam sits on the robot"),
}
"""Variables of range beams, by their names in a log."""


def check_ranges(dataset: xr.Dataset, where: str) -> None:
    """Check range readings and beams of a log; see :meth:`pmcl.models.sensor.Sensor.check`."""
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
        fail(where, f"expected attribute max_range > 0 [m] on 'range', got {got}: set the longest range of the sensor")
    dataset["range"].attrs["max_range"] = max_range
    check_readings(dataset, VARIABLES, where)


def _check_beam_yaws(yaws: NDArray[np.float64], where: str) -> None:
    bad = np.flatnonzero(np.abs(yaws) > ONE_TURN)
    if bad.size:
        k = int(bad[0])
        indices = any(np.array_equal(yaws, np.arange(len(yaws)) + first) for first in (0, 1))
        advice = "these seem to be the beams' numbers; give directions" if indices else "convert degrees to radians"
        fail(where, f"expected beam yaws within one turn (+-2 pi rad), got {yaws[k]:g} for beam {k}: {advice}")
