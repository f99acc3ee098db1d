"""Maps in figures: grid maps, walls and landmarks, in the frame of the map."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from matplotlib.transforms import Affine2D
from numpy.typing import NDArray

from pmcl.maps.occupancy_grid import UNKNOWN, OccupancyGrid

__all__ = ["MOST_DRAWN", "draw_map"]

Float = NDArray[np.float64]

MOST_DRAWN = 800
"""Cells along the longer side of a drawn grid: as many as the figures have pixels."""

_OCCUPIED_COLOUR, _UNKNOWN_COLOUR = "#333333", "#E4E4E4"
# In the order of the numbers that stand for free, occupied and unknown.
_COLOURS = ListedColormap(["#FFFFFF", _OCCUPIED_COLOUR, _UNKNOWN_COLOUR])


def draw_map(
    axes: Axes, *, walls: Float | None = None, landmarks: Float | None = None, grid: OccupancyGrid | None = None
) -> list[Any]:
    """Draw what a log has as map, and label the axes.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    walls : ndarray, shape (W, 2, 2), optional
        Both ends of each wall [m].
    landmarks : ndarray, shape (J, 2), optional
        Positions [m].
    grid : OccupancyGrid, optional
        Its unknown surroundings are left out.

    Returns
    -------
    list of artist
        Entries for the legend.
    """
    entries: list[Any] = []
    if grid is not None:
        entries += _draw_grid(axes, grid.coarser(MOST_DRAWN))
    if walls is not None:
        lines = LineCollection(list(walls), colors="#444444", linewidths=1.6, label="walls")
        entries.append(axes.add_collection(lines))
    if landmarks is not None:
        entries += axes.plot(*landmarks.T, "^", color="#D55E00", markersize=6, linestyle="", label="landmarks")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    return entries


def _draw_grid(axes: Axes, grid: OccupancyGrid) -> list[Patch]:
    rows, columns = (np.flatnonzero((grid.cells != UNKNOWN).any(axis=axis)) for axis in (1, 0))
    low, high = (columns[0], rows[0]), (columns[-1] + 1, rows[-1] + 1)
    shown = grid.cells[low[1] : high[1], low[0] : high[0]]
    x, y, yaw = grid.origin
    from_cells = Affine2D().scale(grid.resolution).rotate(yaw).translate(x, y)
    axes.imshow(
        shown, cmap=_COLOURS, vmin=0, vmax=2, origin="lower", extent=(low[0], high[0], low[1], high[1]),
        transform=from_cells + axes.transData, interpolation="nearest", zorder=0,
    )  # fmt: skip
    # The image has set limits in cells; the others draw in metres.
    corners = [(u, v) for u in (low[0], high[0]) for v in (low[1], high[1])]
    axes.dataLim.set_points(np.array([[np.inf, np.inf], [-np.inf, -np.inf]]))
    axes.update_datalim(grid.from_cells(np.array(corners)))
    axes.autoscale(True)
    axes.autoscale_view()
    entries = [Patch(facecolor=_OCCUPIED_COLOUR, label="occupied")]
    if (shown == UNKNOWN).any():
        entries.append(Patch(facecolor=_UNKNOWN_COLOUR, label="unknown"))
    return entries
