"""How the critic scores effects of range beams cheaply: only the beams that differ, and each ray cast once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.tables import (
    NoExtras,
    channels_that_differ,
    field_of,
    same_extras,
    some_channels,
    with_extras,
    with_fields,
)
from pmcl.models.sensors.range_beams.kernels.full import rays_along, terms_given_rays
from pmcl.models.sensors.range_beams.table import RangeBeams, extras_of

__all__ = ["RayCache", "beams_that_differ", "scoring_calls"]

Float = NDArray[np.float64]


def beams_that_differ(table: RangeBeams, other: RangeBeams) -> tuple[RangeBeams | None, RangeBeams | None]:
    """Keep the beams of two tables that are not the same in both: an effect of one beam costs no more than one beam.

    None where they are all the same; see :meth:`pmcl.models.sensor.Sensor.parts_that_differ`.
    """
    first, second = same_extras(table, other)
    # Neighbours are named by their number, which changes when beams are left out.
    differ = channels_that_differ(first, second, "beam", ignore=("neighbours",))
    # A beam that may show its neighbour's echo cannot be judged without it.
    if differ is None or any((field_of(each, "talk_weight") > 0.0).any() for each in (first, second)):
        return table, other
    if differ.all():
        return table, other
    if not differ.any():
        return None, None
    kept = np.flatnonzero(differ)
    return _some_beams(first, kept), _some_beams(second, kept)


def _some_beams(beams: RangeBeams, kept: NDArray[np.int64]) -> RangeBeams:
    """Return a table of some beams only; neighbours lose their meaning."""
    beams = some_channels(beams, "beam", kept)
    if isinstance(beams.extras, NoExtras):
        return beams
    fewer: RangeBeams = with_fields(beams, {"neighbours": np.zeros((kept.size, 2), dtype=np.int64)})
    return fewer


class RayCache:
    """The rays of a table of beams along trajectories, cast once for all tables that leave them as they are."""

    def __init__(self, table: RangeBeams, columns: Float) -> None:
        self.columns, self.beams = columns, with_extras(table)
        self.position = {key: k for k, key in enumerate(self._keys(self.beams))}
        self.cast: Float | None = None

    def terms(self, beams: RangeBeams) -> Float | None:
        """Return log densities (M, T) of readings; None when the table has rays of its own."""
        sensor, mine = with_extras(beams), self.beams
        if any(getattr(sensor, name) is not getattr(mine, name) for name in ("vertices", "wall_start", "wall_stop")):
            return None
        if sensor.extras.lag.any() or sensor.extras.specular_weight.any():
            return None
        which = [self.position.get(key, -1) for key in self._keys(sensor)]
        if min(which) < 0:
            return None
        if self.cast is None:
            self.cast = rays_along(with_fields(mine, {"lag": np.zeros_like(mine.extras.lag)}), self.columns)
        return np.asarray(terms_given_rays(sensor, self.columns, self.cast, np.array(which, dtype=np.int64)))

    @staticmethod
    def _keys(beams: RangeBeams) -> list[tuple[float, ...]]:
        widths = extras_of(beams).width.tolist()
        return [(*pose, width) for pose, width in zip(beams.beam_pose.tolist(), widths, strict=True)]


def scoring_calls(table: RangeBeams, columns: Float) -> list[tuple[Any, tuple[Any, ...]]]:
    """Return what :class:`RayCache` calls for tables with extras.

    See :meth:`pmcl.models.sensor.Sensor.scoring_calls`.
    """
    if isinstance(table.extras, NoExtras):
        return []
    return [
        (rays_along, (table, columns)),
        (terms_given_rays, (table, columns, columns, np.empty(1, dtype=np.int64))),
    ]
