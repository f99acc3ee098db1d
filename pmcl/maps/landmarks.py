"""Landmark maps: points that a robot recognises one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_type
from pmcl.errors import MapError
from pmcl.maps.arrays import coordinates

__all__ = ["LandmarkMap"]


@dataclass(frozen=True, eq=False)
class LandmarkMap:
    """Known positions of landmarks that are told apart by their names.

    Attributes
    ----------
    positions : ndarray, shape (J, 2)
        Where each landmark stands (x, y) [m], world frame; read-only.
    names : tuple of str
        One name for each landmark; "0", "1", ... when none are given.

    Raises
    ------
    MapError
        When there is no landmark, a coordinate is not a finite number, the shape is wrong, or the names do not
        fit: too many, too few, or one twice.
    """

    positions: NDArray[np.float64]
    names: Sequence[str] = ()

    def __post_init__(self) -> None:
        positions = coordinates(self.positions, "landmarks", "(J, 2): landmark, xy", (2,))
        advice = "write one text for each landmark"
        check_type("landmark names", self.names, (list, tuple, np.ndarray), error=MapError, advice=advice)
        if isinstance(self.names, np.ndarray) and self.names.ndim == 0:
            raise MapError(f"expected landmark names as a list, but got one value; {advice}")
        names = tuple(str(name) for name in self.names) or tuple(str(j) for j in range(len(positions)))
        if len(names) != len(positions):
            raise MapError(f"expected {len(positions)} landmark names, got {len(names)}: name every landmark once")
        if len(set(names)) != len(names):
            twice = next(name for k, name in enumerate(names) if name in names[:k])
            raise MapError(f"expected distinct landmark names, got {twice!r} more than once: rename one of them")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "names", names)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Bounding box (xmin, xmax, ymin, ymax) of the landmarks [m]."""
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        return float(low[0]), float(high[0]), float(low[1]), float(high[1])
