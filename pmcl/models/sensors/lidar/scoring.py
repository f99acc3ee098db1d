"""Comparing two tables of scans: only the rays that differ."""

from __future__ import annotations

import numpy as np

from pmcl.engine.tables import channels_that_differ, same_extras, some_channels
from pmcl.models.sensors.lidar.table import LidarTable

__all__ = ["rays_that_differ"]


def rays_that_differ(table: LidarTable, other: LidarTable) -> tuple[LidarTable | None, LidarTable | None]:
    """Keep the rays of two tables that are not the same in both; None where they are all the same.

    See :meth:`pmcl.models.sensor.Sensor.parts_that_differ`.
    """
    first, second = same_extras(table, other)
    differ = channels_that_differ(first, second, "beam")
    if differ is None or differ.all():
        return table, other
    if not differ.any():
        return None, None
    kept = np.flatnonzero(differ)
    return some_channels(first, "beam", kept), some_channels(second, "beam", kept)
