"""Groups of a posterior that hold its logs: readings, map, start belief and true parameters.

One log keeps the names of its file. Several logs share one theta but not their times, beams or maps, so their
variables and dimensions are numbered: ``odometry_0(time_0, increment)``, ``odometry_1(time_1, increment)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.checks import file_name
from pmcl.logs.schema import readings, variables
from pmcl.maps.occupancy_grid import OccupancyGrid

__all__ = ["LogLike", "agreed_truth", "log_groups", "over_channels", "reading_kinds", "stored_grid", "suffixes_for"]

# Dimensions that mean the same in every log.
_SHARED_DIMS = frozenset({"increment", "pose", "xy", "end"})
# Cells along the longer side of a grid map in a posterior: more than a figure shows take space only.
_MOST_CELLS = 800


# What stays known of a log: whose it is, and the motion after which AMCL takes a scan, since alphas belong to steps of
# that size.
_KEPT_ATTRIBUTES = frozenset({"robot", "source", "seed", "update_min_d", "update_min_a", "update_rule"})


class LogLike(Protocol):
    """The part of a robot log that the conversion uses; :class:`pmcl.logs.robot_log.RobotLog` has it."""

    @property
    def dataset(self) -> xr.Dataset:
        """The log with the variables of its file format."""

    @property
    def true_theta(self) -> Mapping[str, float] | None:
        """True parameters of a simulated log."""

    def fingerprint(self) -> str:
        """Hash over everything that calibration sees."""


def suffixes_for(n_logs: int) -> tuple[str, ...]:
    """Return the suffixes of the variables of each log.

    Parameters
    ----------
    n_logs : int

    Returns
    -------
    tuple of str, length n_logs
        ``("",)`` for one log, ``("_0", "_1", ...)`` for several.
    """
    return ("",) if n_logs == 1 else tuple(f"_{index}" for index in range(n_logs))


def reading_kinds(dataset: xr.Dataset) -> tuple[str, ...]:
    """Name the variables of a log that hold readings, one value for each time and channel, NaN where none was taken.

    Parameters
    ----------
    dataset : xarray.Dataset
        A log.

    Returns
    -------
    tuple of str
    """
    return tuple(kind for kind in readings(dataset) if kind in dataset)


def over_channels(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """View readings over time, and over channels where there are some, as an array over time and channel.

    Parameters
    ----------
    values : ndarray, shape (T,) or (T, C)
        Contiguous. A compass, for example, has no channels: all its readings are of channel 0.

    Returns
    -------
    ndarray, shape (T, 1) or (T, C)
        A view, through which `values` can be changed.
    """
    return values.reshape(len(values), -1)


def log_groups(logs: Sequence[LogLike]) -> tuple[xr.Dataset, xr.Dataset]:
    """Observed and constant data of the logs.

    Parameters
    ----------
    logs : sequence of logs

    Returns
    -------
    observed : xarray.Dataset
        The readings, which the model has a density for: each kind as one row of the N values that were measured, in the
        order of time and channel, with their times and channels as coordinates. ArviZ compares them with the groups
        ``posterior_predictive`` and ``log_likelihood``, which have the same dimensions and no gaps. A range without
        echo is the greatest range. Attributes name log, robot, source and seed, and the motion after which rows were
        chosen (``update_min_d``, ``update_min_a``, ``update_rule``).
    constant : xarray.Dataset
        Everything given that pmcl knows: odometry, map (a grid map in cells as coarse as figures need), beam poses,
        start belief, the scalars ``true_<name>`` that the logs agree on, and the reference trajectory ``true_pose``,
        which serves scoring and pictures only.
    """
    observed: list[xr.Dataset] = []
    constant: list[xr.Dataset] = []
    for log, suffix in zip(logs, suffixes_for(len(logs)), strict=True):
        dataset = log.dataset.drop_encoding()
        kinds = reading_kinds(dataset)
        # The truth is a JSON text among the attributes of the log; it is kept as numbers below instead.
        attrs = {f"{key}{suffix}": value for key, value in dataset.attrs.items() if key in _KEPT_ATTRIBUTES}
        # Only the name of its file: its folder is private to the user.
        if name := file_name(getattr(log, "where", "")):
            attrs[f"log{suffix}"] = name
        measured = [_measured(dataset[kind], suffix) for kind in kinds]
        observed.append(xr.Dataset({each.name: each for each in measured}, attrs=attrs))
        given = _given(dataset, kinds)
        if (grid := getattr(log, "grid_map", None)) is not None:
            given = given.assign(grid_map=_picture(grid))
        constant.append(_numbered(given, suffix))
    truth = {f"true_{name}": np.float64(value) for name, value in agreed_truth(logs).items()}
    return _merged(observed), _merged(constant).assign(truth)


def _given(dataset: xr.Dataset, kinds: Sequence[str]) -> xr.Dataset:
    """Return the variables of the format that are no readings; what else a log holds may clash with other groups."""
    known = variables(dataset)
    given = dataset[[name for name in dataset.data_vars if name in known and name not in kinds]]
    return given.drop_vars([name for name in given.coords if name not in given.dims])


def _measured(values: xr.DataArray, suffix: str) -> xr.DataArray:
    """Return the readings of one kind that were measured, as one row."""
    row, *columns = np.nonzero(~np.isnan(values.values))
    kind, channels = str(values.name), [str(dim) for dim in values.dims[1:]]
    dims = (f"{kind}_reading{suffix}",)
    measured = np.minimum(values.values[row, *columns], float(values.attrs.get("max_range", np.inf)))
    coords = {f"{kind}_time{suffix}": (dims, values["time"].values[row], {"units": "s", "long_name": "time"})}
    for channel, column in zip(channels, columns, strict=True):
        numbers = values.coords[channel].values if channel in values.coords else np.arange(values.sizes[channel])
        coords[f"{kind}_{channel}{suffix}"] = (dims, numbers[column], {"units": "1", "long_name": channel})
    attrs = {**values.attrs, "units": variables([kind])[kind].units, "long_name": f"measured {kind.replace('_', ' ')}"}
    return xr.DataArray(measured, dims=dims, coords=coords, name=f"{kind}{suffix}", attrs=attrs)


def _picture(grid: OccupancyGrid) -> xr.DataArray:
    """Return a grid map as a small variable: what pages about the posterior draw."""
    small = grid.coarser(_MOST_CELLS)
    attrs = {
        "units": "1", "long_name": "0 free, 1 occupied, 2 unknown", "resolution": small.resolution,
        "map_resolution": grid.resolution,
    }  # fmt: skip
    return xr.DataArray(small.cells, dims=("grid_row", "grid_column"), attrs={**attrs, "origin": list(small.origin)})


def stored_grid(constants: xr.Dataset, suffix: str) -> OccupancyGrid | None:
    """Return the grid map of a log as the group ``constant_data`` of a posterior holds it.

    Parameters
    ----------
    constants : xarray.Dataset
        The group.
    suffix : str
        That of the log, from :func:`suffixes_for`.

    Returns
    -------
    OccupancyGrid or None
        With larger cells than the map has where that is large; None when the log had none.
    """
    if f"grid_map{suffix}" not in constants:
        return None
    stored = constants[f"grid_map{suffix}"]
    x, y, yaw = (float(value) for value in stored.attrs["origin"])
    return OccupancyGrid(stored.values.astype(np.uint8), float(stored.attrs["resolution"]), (x, y, yaw))


def agreed_truth(logs: Sequence[LogLike]) -> dict[str, float]:
    """Return the true parameters of simulated logs.

    Parameters
    ----------
    logs : sequence of logs

    Returns
    -------
    dict of str to float
        A parameter on which two logs differ is left out: the one theta they share then has no true value.
    """
    known: dict[str, set[float]] = {}
    for log in logs:
        for name, value in (log.true_theta or {}).items():
            known.setdefault(name, set()).add(float(value))
    return {name: values.pop() for name, values in known.items() if len(values) == 1}


def _numbered(dataset: xr.Dataset, suffix: str) -> xr.Dataset:
    names = {str(name) for name in (*dataset.variables, *dataset.dims)} - _SHARED_DIMS if suffix else set()
    renamed = dataset.rename({name: f"{name}{suffix}" for name in names})
    renamed.attrs = {}
    return renamed


def _merged(datasets: Sequence[xr.Dataset]) -> xr.Dataset:
    # Names cannot clash after numbering, and the shared dimensions have one meaning: nothing to align.
    return xr.merge(datasets, join="exact", combine_attrs="no_conflicts", compat="equals")
