"""What each beam meets along a path: for formulas, and for residuals of readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.models.sensor import ReadingIndex
from pmcl.models.sensors.range_beams.linearisation import beam_lengths
from pmcl.models.sensors.range_beams.table import OPEN_RAY, RangeBeams

__all__ = ["along", "covariates"]

Float = NDArray[np.float64]


def along(table: RangeBeams, path: Float) -> dict[str, Float]:
    """Return what the terms of formulas may know of each beam at each row, (T, B), along a path (T, >= 3).

    ``distance`` [m], ``incidence`` and ``world_direction`` [rad], see :data:`pmcl.models.effects.terms.OF_BEAMS`.
    """
    return {
        "distance": np.minimum(beam_lengths(table, path), table.max_range),
        "incidence": incidence(table, path),
        "world_direction": path[:, 2, None] + table.beam_pose[:, 2],
    }


def incidence(table: RangeBeams, path: Float) -> Float:
    """Return the angle between each beam and the normal of the wall it meets [rad], (T, B), 0 to pi / 2.

    A beam turned by a small angle grows by its length times the tangent of the incidence, whichever wall it meets.
    """
    small = 1e-4
    turned = [
        beam_lengths(table._replace(beam_pose=table.beam_pose + np.array([0.0, 0.0, sign * small])), path)
        for sign in (1.0, -1.0)
    ]
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = np.abs(turned[0] - turned[1]) / (small * (turned[0] + turned[1]))
    return np.where(np.isfinite(slope), np.arctan(slope), 0.0)


def covariates(table: RangeBeams, path: Float, index: ReadingIndex) -> dict[str, Float]:
    """Return distance, direction and incidence of readings; see :meth:`pmcl.models.sensor.Sensor.covariates`."""
    time, beam = index.time, index.channel
    return {
        "distance": np.minimum(beam_lengths(table, path), OPEN_RAY * table.max_range)[time, beam],
        "direction": path[time, 2] + table.beam_pose[beam, 2],
        "incidence": incidence(table, path)[time, beam],
    }
