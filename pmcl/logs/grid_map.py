"""The grid map of a log: the map_server pair that the log names, or that is given beside it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import xarray as xr

from pmcl.checks import check_type
from pmcl.errors import LogError, MapError
from pmcl.logs.validation import fail
from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = ["check_start_on_map", "map_named_by", "map_to_name"]


def map_named_by(dataset: xr.Dataset, path: str) -> OccupancyGrid | None:
    """Read the map that a log names in its attribute ``map``.

    Parameters
    ----------
    dataset : xarray.Dataset
        The log.
    path : str
        Its file; the attribute is relative to the folder of it.

    Returns
    -------
    OccupancyGrid or None
        None when the log names no map.

    Raises
    ------
    LogError
        When the attribute is no path inside that folder, or there is no such file.
    MapError
        When the map cannot be used.
    """
    stated = dataset.attrs.get("map")
    if stated is None:
        return None
    advice = "give the map with --map MAP.yaml (in Python: read(path, map=...))"
    if not isinstance(stated, str) or not stated or "\0" in stated or Path(stated).is_absolute():
        fail(path, f"expected attribute map as a path relative to the log, got {stated!r:.100}: {advice}")
    folders = {Path(path).parent.resolve(), Path(path).resolve().parent}
    file = Path(path).parent / stated
    if not any(file.resolve().is_relative_to(folder) for folder in folders):
        fail(path, f"expected attribute map as a path in the folder of the log or below, got {stated!r:.100}: {advice}")
    if not file.is_file():
        fail(path, f"expected the map {stated!r:.100} that the log names, got no such file: copy it there, or {advice}")
    return OccupancyGrid.read(file)


def map_to_name(grid: OccupancyGrid, path: str) -> str | None:
    """Return how a log that is written to a path can name its grid map.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    path : str
        The log's file.

    Returns
    -------
    str or None
        The path of the map's YAML file relative to the folder of the log; None when the map was not read from a file
        there or below, or that file holds another map by now.
    """
    source, folder = Path(grid.source), Path(os.path.abspath(path)).parent
    if source.suffix not in (".yaml", ".yml") or not source.is_file():
        return None
    file = Path(os.path.abspath(source))
    # A link in the folder to a map elsewhere is not followed when the log is read.
    if not (file.is_relative_to(folder) and file.resolve().is_relative_to(folder.resolve())):
        return None
    try:
        same = OccupancyGrid.read(file).fingerprint() == grid.fingerprint()
    except MapError:
        same = False
    return file.relative_to(folder).as_posix() if same else None


def check_start_on_map(dataset: xr.Dataset, grid: OccupancyGrid, where: str) -> None:
    """Check that the start belief of a log lies on its grid map.

    Parameters
    ----------
    dataset : xarray.Dataset
        A validated log.
    grid : OccupancyGrid
        Its map.
    where : str
        File or call, for messages.

    Raises
    ------
    MapError
        When the mean of a belief with finite standard deviations is outside the grid.
    """
    check_type("grid_map", grid, OccupancyGrid, error=LogError, advice="read one with OccupancyGrid.read")
    mean, std = dataset["start_mean"].values, dataset["start_std"].values
    if not np.isfinite(std[:2]).all():
        return
    column, row = grid.to_cells(mean[:2])
    rows, columns = grid.cells.shape
    if not (0.0 <= column <= columns and 0.0 <= row <= rows):
        x_low, x_high, y_low, y_high = grid.bounds
        raise MapError(
            f"{where}: expected start_mean on the grid map (x {x_low:g} to {x_high:g} m, y {y_low:g} to {y_high:g} m), "
            f"got ({mean[0]:g}, {mean[1]:g}) m: check that log and map have the same frame, or set start_std to inf"
        )
