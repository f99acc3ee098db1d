"""Where late readings were taken."""

from __future__ import annotations

from typing import Any

import numpy as np

from pmcl.geometry import late_poses
from pmcl.models.part import Float

__all__ = ["reading_poses"]


def reading_poses(table: Any, reference: Float) -> Float:
    """Return where readings were taken along a reference (T, D): late ones at an earlier pose.

    Parameters
    ----------
    table : NamedTuple
        Table of a sensor.
    reference : ndarray, shape (T, D)
        The reference trajectory.

    Returns
    -------
    ndarray, shape (T, D)
        `reference` itself where the table has no latency. State components beside the pose stay as they are.
    """
    lag = getattr(table.extras, "lag", None)
    if lag is None or not np.any(lag):
        return reference
    return np.ascontiguousarray(np.hstack([late_poses(reference, lag), reference[:, 3:]]))
