"""Mistakes that the numbers of a log show by themselves, without its map and without a filter.

:func:`implausible` costs milliseconds. What only readings and map together can show is the business of
:mod:`pmcl.preflight`.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.arrays import LogArrays
from pmcl.logs.finding import Finding
from pmcl.logs.sensor_variables import ReadingSeries
from pmcl.registry import sensor_variables

__all__ = ["implausible", "without_map"]

Float = NDArray[np.float64]
Bool = NDArray[np.bool_]

# Indoor robots, for which Monte Carlo localization on such maps is meant, drive at up to 2 m/s [m/s].
_FASTEST = 5.0
# Odometry is integrated over a step as if its turn were small [rad].
_LARGEST_TURN = 1.0
# Single rows may hold a glitch of the clock; a wrong unit shows in all rows.
_SHARE_OF_ROWS = 0.02
# A robot whose fastest tenth of moves is below both [m/s, rad/s] while its rows are further apart than this [s] has its
# times in a smaller unit: rows of a slow robot that is rarely recorded are far apart in space as well.
_SLOWEST, _SLOWEST_TURN, _LONG_PERIOD = 1e-3, 1e-3, 5.0
# Readings that repeat bit for bit over so many rows, which by chance happens so rarely in a log ...
_STUCK_ROWS, _CHANCE = 10, 1e-6
# ... while the robot turned [rad] and drove [m] so far in all. A rounded reading stays the same along a wall; a robot
# that turns by a radian as well sees another distance or bearing.
_STUCK_TURN, _STUCK_DISTANCE = 1.0, 0.5
# Rows are repeated when that happens so many times as often as by rounding.
_TIMES_CHANCE = 10.0


def implausible(log: LogArrays) -> tuple[Finding, ...]:
    """Return what the numbers of a log show by themselves.

    Parameters
    ----------
    log : LogArrays
        A validated log.

    Returns
    -------
    tuple of Finding
        All of level "implausible"; empty for a sound log.
    """
    if log.n_steps < 2:
        return ()
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        general = [finding for check in (_times, _speed, _turns, _stuck, _stale) for finding in check(log)]
        of_sensors = [finding for sensor in sensor_variables().values() for finding in sensor.implausible(log)]
    return (*general, *of_sensors)


def without_map(log: LogArrays) -> tuple[Finding, ...]:
    """Return findings when range readings have no walls, or scans no grid map, and no map is named beside the log."""
    found = []
    if "map" not in log.dataset.attrs:
        if log.ranges is not None and log.walls is None:
            text = "range readings have no map: give the walls before the log is used"
            found.append(Finding("no-walls", "implausible", False, text))
        if log.lidars and log.grid_map is None:
            text = "scans have no map: give a grid map beside the log when it is used"
            found.append(Finding("no-grid-map", "implausible", False, text))
    return tuple(found)


def _moves(log: LogArrays) -> tuple[Float, Float, Float]:
    """Return distance [m], size of turn [rad] and duration [s] of each step, (T - 1,)."""
    step = log.odometry[1:]
    return np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2]), np.diff(log.times)


def _times(log: LogArrays) -> Iterator[Finding]:
    distance, turn, period = _moves(log)
    moving = (distance > 0.0) | (turn > 0.0)
    if not moving.any():
        return
    fast = float(np.quantile(distance[moving] / period[moving], 0.9))
    fast_turn = float(np.quantile(turn[moving] / period[moving], 0.9))
    median = float(np.median(period))
    if fast > _SLOWEST or fast_turn > _SLOWEST_TURN or median < _LONG_PERIOD:
        return
    units = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
    factor = next((f for f in units if max(fast, fast_turn) * f > _SLOWEST_TURN), 1e9)
    yield Finding(
        f"times-in-{units[factor]}",
        "implausible",
        True,
        f"rows are {median:.3g} s apart and the robot drives at {fast:.2g} m/s and {fast_turn:.2g} rad/s at most: "
        f"times seem to be in {units[factor]}; divide them by {factor:.0e}",
    )


def _speed(log: LogArrays) -> Iterator[Finding]:
    distance, _, period = _moves(log)
    speed = distance / period
    if np.mean(speed > _FASTEST) > _SHARE_OF_ROWS:
        row = int(np.argmax(speed)) + 1
        yield Finding(
            "fast",
            "implausible",
            False,
            f"odometry says {speed[row - 1]:.3g} m/s in row {row}, and more than {_FASTEST:g} m/s in "
            f"{np.mean(speed > _FASTEST):.0%} of the rows: check the units of odometry and time, and that odometry "
            "holds the displacement since the row before",
        )


def _turns(log: LogArrays) -> Iterator[Finding]:
    _, turn, _ = _moves(log)
    if np.mean(turn > _LARGEST_TURN) > _SHARE_OF_ROWS:
        row = int(np.argmax(turn)) + 1
        yield Finding(
            "large-turns",
            "implausible",
            False,
            f"odometry says a turn of {turn[row - 1]:.3g} rad in row {row}, and more than {_LARGEST_TURN:g} rad in "
            f"{np.mean(turn > _LARGEST_TURN):.0%} of the rows: check that turns are in radians and hold the change "
            "since the row before, or take rows more often",
        )


def _series(log: LogArrays) -> Iterator[ReadingSeries]:
    """Yield the readings of each channel of each sensor."""
    for sensor in sensor_variables().values():
        yield from sensor.series(log)


def _stuck(log: LogArrays) -> Iterator[Finding]:
    distance, turn, _ = _moves(log)
    travelled = np.append(0.0, np.cumsum(distance))
    turned = np.append(0.0, np.cumsum(turn))
    for name, values in _series(log):
        rows = np.flatnonzero(~np.isnan(values))
        if rows.size < _STUCK_ROWS:
            continue
        breaks = np.flatnonzero(np.diff(values[rows]) != 0.0) + 1
        runs = np.split(rows, breaks)
        run = max(runs, key=len)
        if len(run) < _STUCK_ROWS or not _beyond_chance(runs, len(run)):
            continue
        far = travelled[run[-1]] - travelled[run[0]], turned[run[-1]] - turned[run[0]]
        if far[0] > _STUCK_DISTANCE and far[1] > _STUCK_TURN:
            yield Finding(
                "stuck-sensor",
                "implausible",
                True,
                f"{name} reads {values[run[0]]:.6g} in {len(run)} readings on end, rows {run[0]} to "
                f"{run[-1]}, while the robot drives {far[0]:.2g} m and turns {far[1]:.2g} rad: remove what a stuck "
                "sensor wrote (NaN: not measured)",
            )
            return


def _beyond_chance(runs: list[NDArray[np.int64]], longest: int) -> bool:
    """Tell whether a run of equal readings is longer than coarse rounding makes them.

    Outside the longest run, neighbours are equal with a probability p, estimated with Jeffreys' prior. Among n readings
    a run of length L then begins with a probability of n p^(L - 1) at most.
    """
    n = sum(map(len, runs))
    pairs = n - longest
    equal = pairs - (len(runs) - 1)
    p = (equal + 0.5) / (pairs + 1.0)
    return bool(np.log(n) + (longest - 1) * np.log(p) < np.log(_CHANCE))


def _stale(log: LogArrays) -> Iterator[Finding]:
    """Whole rows of readings that are repeated bit for bit while the robot moves."""
    channels = [values for _, values in _series(log)]
    if not channels:
        return
    table = np.stack(channels, axis=1)
    known = ~np.isnan(table)
    distance, turn, _ = _moves(log)
    moving = (distance > 0.0) | (turn > 0.0)
    both = known[1:] & known[:-1]
    comparable = moving & (both.sum(axis=1) >= 2)
    same = comparable & ((table[1:] == table[:-1]) | (~known[1:] & ~known[:-1])).all(axis=1)
    n_same, n_rows = int(same.sum()), int(comparable.sum())
    # Rounded readings come twice by chance: as often, each by itself, as in rows that are not repeated as a whole.
    others = both & (comparable & ~same)[:, None]
    share = ((others & (table[1:] == table[:-1])).sum() + 0.5) / (others.sum() + 1.0)
    by_chance = float(np.sum(share ** both[comparable].sum(axis=1)))
    if n_same > 0.05 * n_rows and n_same > _TIMES_CHANCE * (by_chance + 0.5):
        row = int(np.flatnonzero(same)[0]) + 1
        yield Finding(
            "stale-readings",
            "implausible",
            True,
            f"{n_same} of {n_rows} rows repeat all readings of the row before while the robot moves, first row {row}: "
            "write NaN where nothing new was measured",
        )
