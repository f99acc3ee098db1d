"""Checks on a robot log, made once at the border: everything behind trusts what passes here.

Each failure is one line that names the file or call, the variable, the row, and what to do.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import NoReturn

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from pmcl.errors import LogError, MapError
from pmcl.logs.schema import FORMAT, LABELS, Variable, readings, variables
from pmcl.maps.arrays import FARTHEST, as_numbers
from pmcl.maps.walls import WallMap
from pmcl.registry import sensor_variables

__all__ = ["ONE_TURN", "fail", "positive_number", "require_finite", "validated"]

Float = NDArray[np.float64]

# No bearing and no yaw of a beam is larger; half a degree is left for rounding [rad].
ONE_TURN = 2.0 * math.pi + 0.01

# The greatest numbers that have a meaning, by unit. Headings may count turns, but a double of 1e6 rad holds an angle
# to 1e-10 rad only. Times may be in nanoseconds since 1970 by mistake, which is named elsewhere.
_GREATEST = {"m": FARTHEST, "rad": 1.0e6, "s": 1.0e20, "pixel": 1.0e6}


def fail(where: str, message: str) -> NoReturn:
    """Raise a :class:`~pmcl.errors.LogError` of one line that begins with the place.

    Parameters
    ----------
    where : str
        File or call, for messages.
    message : str
        What was expected, what came, and what to do.

    Raises
    ------
    LogError
        Always.
    """
    raise LogError(f"{where}: {message}")


def validated(dataset: xr.Dataset, where: str) -> xr.Dataset:
    """Check a log and bring it into the form that the rest of pmcl relies on.

    Parameters
    ----------
    dataset : xarray.Dataset
        A log in the file format. Dimensions may come in any order, and labelled components (``increment``, ``pose``,
        ``xy``, ``end``) too. Variables outside the format are kept as they are.
    where : str
        File or call, for messages.

    Returns
    -------
    xarray.Dataset
        A deep copy; the variables of the format are float64, read-only, with the format's order of dimensions.

    Raises
    ------
    LogError
        When the log does not follow the format.
    MapError
        When its map is not usable, or the start lies outside it.
    """
    if not isinstance(dataset, xr.Dataset):
        fail(where, f"expected an xarray.Dataset, got {type(dataset).__name__}: read the file with RobotLog.read")
    stated = dataset.attrs.get("format")
    if not isinstance(stated, str) or stated != FORMAT:
        got = "none" if stated is None else f"{stated!r:.60}"
        fail(where, f"expected a robot log with attribute format = {FORMAT!r}, got {got}: convert it with pmcl convert")
    dataset = _canonical(dataset, where)
    _check_time_and_odometry(dataset, where)
    names = readings(dataset)
    if not any(name in dataset for name in names):
        fail(where, f"expected at least one of {', '.join(names)}, got none: add what the sensors measured")
    for sensor in sensor_variables().values():
        _check_readings(dataset, sensor.declared(dataset), where)
        sensor.check(dataset, where)
    walls = _checked_walls(dataset, where)
    _check_start(dataset, walls, where)
    _check_reference(dataset, where)
    return dataset


def _canonical(dataset: xr.Dataset, where: str) -> xr.Dataset:
    dataset = dataset.copy()
    for dim, labels in LABELS.items():
        given = _labels_along(dataset, dim)
        # Another number of components is told below, beside the variable that has them.
        if given is None or given == list(labels) or len(given) != len(labels):
            continue
        if sorted(given) != sorted(labels):
            fail(
                where,
                f"expected the labels {', '.join(labels)} along '{dim}', got {', '.join(given):.80}: correct them, or "
                "leave them out where the components have this order",
            )
        dataset = dataset.isel({dim: [given.index(label) for label in labels]})
    known = variables(dataset)
    for name in ("time", "odometry"):
        if name not in dataset.variables:
            fail(where, f"expected variable '{name}' ({', '.join(known[name].dims)}), got none: add it")
    for name, variable in known.items():
        if name not in dataset.variables:
            continue
        found = dataset[name]
        found = _renamed(found, variable)
        sizes = {dim: len(LABELS[dim]) for dim in variable.dims if dim in LABELS}
        if set(found.dims) != set(variable.dims) or any(found.sizes[dim] != size for dim, size in sizes.items()):
            declared = ", ".join(f"{dim}={sizes[dim]}" if dim in sizes else dim for dim in variable.dims)
            got = ", ".join(f"{dim}={size}" for dim, size in found.sizes.items())
            fail(where, f"expected '{name}' with dimensions ({declared}), got ({got}): rename or reshape it")
        found = found.transpose(*variable.dims)
        try:
            values = as_numbers(found.values)
        except TypeError as problem:
            fail(where, f"expected numbers [{variable.units}] in '{name}', got {problem}: convert them")
        _require_possible(name, variable, values, where)
        values.flags.writeable = False
        dataset[name] = (variable.dims, values, found.attrs)
    present = {dim: list(labels) for dim, labels in LABELS.items() if dim in dataset.dims}
    return dataset.set_coords("time").assign_coords(present)


def _labels_along(dataset: xr.Dataset, dim: str) -> list[str] | None:
    """Return the texts that label a dimension; None where there are none, or plain numbers."""
    if dim not in dataset.coords or dataset[dim].ndim != 1 or dataset[dim].dtype.kind in "iuf":
        return None
    return [str(label) for label in dataset[dim].values]


def _require_possible(name: str, variable: Variable, values: Float, where: str) -> None:
    """Check that no finite number is beyond what its unit makes possible."""
    if variable.may_be_infinite:
        return  # a range of any length means that there was no echo
    greatest = np.array([_GREATEST.get(unit, math.inf) for unit in variable.units.split(", ")])
    with np.errstate(invalid="ignore"):
        beyond = np.isfinite(values) & (np.abs(values) > greatest)
    if name == "odometry":
        beyond[:1] = False  # the displacement into row 0 has no row to come from; the format ignores it
    bad = np.argwhere(beyond)
    if len(bad):
        at = tuple(int(i) for i in bad[0])
        unit = variable.units.split(", ")[at[-1] if len(greatest) > 1 else 0]
        place = ", ".join(f"{'row' if dim == 'time' else dim} {i}" for dim, i in zip(variable.dims, at, strict=True))
        fail(
            where,
            f"expected '{name}' within {_GREATEST[unit]:g} {unit}, got {values[at]:g} in {place}: check the unit, or "
            "correct the number",
        )


def _renamed(found: xr.DataArray, variable: Variable) -> xr.DataArray:
    """Give a variable of a pattern the dimensions of its own: files may call each sensor's rays plainly ``ray``."""
    plain = {dim: own for dim in map(str, found.dims) for own in variable.dims if own.startswith(f"{dim}_")}
    missing = set(variable.dims) - set(found.dims)
    return found.rename({dim: own for dim, own in plain.items() if own in missing and dim not in variable.dims})


def _check_time_and_odometry(dataset: xr.Dataset, where: str) -> None:
    times = dataset["time"].values
    if times.size == 0:
        fail(where, "expected at least one sample, got an empty log: check the conversion and its time interval")
    bad = np.flatnonzero(~np.isfinite(times))
    if bad.size:
        fail(where, f"expected finite times [s], got time[{bad[0]}] = {times[bad[0]]}: remove that row")
    bad = np.flatnonzero(np.diff(times) <= 0.0) + 1
    if bad.size:
        k = int(bad[0])
        fail(
            where,
            f"expected strictly increasing times, got time[{k}] = {times[k]:.9g} s after time[{k - 1}] = "
            f"{times[k - 1]:.9g} s: sort the rows and remove duplicates",
        )
    # The displacement into row 0 has no row to come from; the format ignores it.
    bad_rows = np.argwhere(~np.isfinite(dataset["odometry"].values[1:]))
    if len(bad_rows):
        row, part = int(bad_rows[0, 0]) + 1, int(bad_rows[0, 1])
        value, name = dataset["odometry"].values[row, part], LABELS["increment"][part]
        fail(
            where,
            f"expected finite odometry, got {name} = {value} in row {row} (time {times[row]:.9g} s): "
            "fill the gap or cut the log there",
        )

def _checked_walls(dataset: xr.Dataset, where: str) -> WallMap | None:
    if "wall" not in dataset:
        return None
    try:
        return WallMap(dataset["wall"].values)
    except MapError as problem:
        raise MapError(f"{where}, 'wall': {problem}") from None


def _check_start(dataset: xr.Dataset, walls: WallMap | None, where: str) -> None:
    for name in ("start_mean", "start_std"):
        if name not in dataset:
            fail(where, f"expected variable '{name}' (pose=3), got none: add it (start_std = inf: anywhere on the map)")
    mean, std = dataset["start_mean"].values, dataset["start_std"].values
    if not (std >= 0.0).all():
        fail(where, f"expected start_std >= 0 [m, m, rad], got {std.tolist()}: use inf where nothing is known")
    if not np.isfinite(mean[np.isfinite(std)]).all():
        fail(where, f"expected a finite start_mean, got {mean.tolist()}: set start_std to inf where nothing is known")
    if walls is not None and walls.is_closed and np.isfinite(std[:2]).all() and not walls.contains(mean[:2]):
        xmin, xmax, ymin, ymax = walls.bounds
        raise MapError(
            f"{where}: expected start_mean inside the walls (x {xmin:g} to {xmax:g} m, y {ymin:g} to {ymax:g} m), got "
            f"({mean[0]:g}, {mean[1]:g}) m: correct it, or set start_std to inf"
        )


def _check_reference(dataset: xr.Dataset, where: str) -> None:
    if "true_theta" not in dataset.attrs:
        return
    text = dataset.attrs["true_theta"]
    try:
        theta = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        theta = None
    if not isinstance(theta, dict) or not all(isinstance(value, int | float) for value in theta.values()):
        fail(where, f"expected attribute true_theta as JSON object of numbers, got {text!r:.80}: correct or remove it")


def positive_number(stated: ArrayLike | None) -> float | None:
    """Return the one positive number that an attribute states; None for anything else, also for absurdly large ones."""
    try:
        numbers = as_numbers(stated).ravel()
    except TypeError:
        return None
    return float(numbers[0]) if numbers.size == 1 and 0.0 < numbers[0] <= FARTHEST else None


def require_finite(dataset: xr.Dataset, name: str, where: str) -> None:
    """Check that all numbers of a variable are finite.

    Parameters
    ----------
    dataset : xarray.Dataset
        A log that has the variable.
    name : str
        The variable.
    where : str
        File or call, for messages.

    Raises
    ------
    LogError
        With the first number that is not, and its place.
    """
    values = dataset[name].values
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        at = tuple(int(i) for i in bad[0])
        index = ", ".join(str(i) for i in at)
        unit = variables(dataset)[name].units
        fail(where, f"expected finite '{name}' [{unit}], got {values[at]} at [{index}]: correct it")


def _check_readings(dataset: xr.Dataset, declared: Mapping[str, Variable], where: str) -> None:
    """Check a sensor's rows against their declarations: the smallest possible number, and whether inf has a meaning."""
    held = {name: variable for name, variable in declared.items() if name in dataset and "time" in variable.dims}
    for name, variable in held.items():
        if variable.minimum is not None:
            _require_at_least(dataset, name, variable.minimum, variable, where)
    for name, variable in held.items():
        if variable.may_be_infinite:
            continue
        bad = np.argwhere(np.isinf(dataset[name].values))
        if len(bad):
            place, value = _place(dataset, name, bad[0])
            fail(where, f"expected '{name}' finite or NaN (not seen), got {value} in {place}: write NaN there")


def _require_at_least(dataset: xr.Dataset, name: str, least: float, variable: Variable, where: str) -> None:
    bad = np.argwhere(dataset[name].values < least)
    if len(bad):
        place, value = _place(dataset, name, bad[0])
        fail(
            where,
            f"expected '{name}' >= {least:g} [{variable.units}], got {value:g} in {place}: "
            "write NaN where nothing was measured",
        )


def _place(dataset: xr.Dataset, name: str, index: NDArray[np.int64]) -> tuple[str, float]:
    """Return where a reading stands, in words, and the reading."""
    row, *others = (int(i) for i in index)
    words = [f"row {row} (time {dataset['time'].values[row]:.9g} s)"]
    words += [f"{dim} {i}" for dim, i in zip(dataset[name].dims[1:], others, strict=True)]
    return ", ".join(words), float(dataset[name].values[tuple(index)])
