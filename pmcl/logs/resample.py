"""From a recording with clocks of its own to regular samples.

Velocities hold until the next one comes (zero-order hold) and are integrated exactly on SE(2) between samples; each
reading goes to the sample nearest in time and keeps its time offset; reference poses are interpolated.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import compose, integrate_twist, wrap
from pmcl.logs.schema import MOST_NUMBERS
from pmcl.logs.validation import fail

__all__ = ["Sightings", "hold_and_integrate", "interpolate_poses", "nearest_sample", "regular_times", "sort_sightings"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Odometry alone has three numbers for each sample, and readings come to it.
_MOST_SAMPLES = MOST_NUMBERS // 10
# Clocks of one recording that mean the same instant differ by rounding only, far less than this [s].
_SAME_INSTANT = 1e-6


class Sightings(NamedTuple):
    """Landmark readings laid out by sample.

    Attributes
    ----------
    values : ndarray, shape (T, J, K)
        K quantities of each sighting; NaN where the landmark was not seen.
    time_offset : ndarray, shape (T, J)
        Time of the reading minus time of its sample [s]; NaN where the landmark was not seen.
    n_outside : int
        Readings dropped because no sample is near enough in time.
    n_duplicate : int
        Readings dropped because the same landmark was seen nearer to the sample's time.
    """

    values: Float
    time_offset: Float
    n_outside: int
    n_duplicate: int


def regular_times(first: float, last: float, period: float, where: str = "regular_times") -> Float:
    """Return regular sample times.

    Parameters
    ----------
    first, last : float
        First and greatest time [s].
    period : float
        Time between samples [s].
    where : str
        File or call, for messages.

    Returns
    -------
    ndarray, shape (T,)
        ``first, first + period, ...`` up to `last`; empty when `last` is before `first`.

    Raises
    ------
    LogError
        When there would be more samples than a log may have, or more than times can be told apart.
    """
    with np.errstate(over="ignore"):
        n_periods = (last - first) / period
    if not n_periods < _MOST_SAMPLES or first + period == first:
        fail(
            where,
            f"expected at most {_MOST_SAMPLES} samples, got {n_periods:.3g} periods of {period:g} s from {first:g} s "
            f"to {last:g} s: choose a longer period, and check that times are in seconds",
        )
    # A thousandth of a period forgives rounding in a last time that is meant to be on the grid.
    count = int(np.floor(n_periods + 1e-3)) + 1
    return first + period * np.arange(max(count, 0), dtype=np.float64)


def hold_and_integrate(
    hold_times: Float,
    forward_velocity: Float,
    angular_velocity: Float,
    times: Float,
    left_velocity: Float | None = None,
) -> Float:
    """Integrate piecewise constant velocities between samples, exactly on SE(2).

    Parameters
    ----------
    hold_times : ndarray, shape (N,)
        When each velocity starts to hold [s], not decreasing; it holds until the next one, the last one for ever. Of
        velocities that start at the same time the last one counts.
    forward_velocity, angular_velocity : ndarray, shape (N,)
        Forward [m/s] and turning [rad/s].
    times : ndarray, shape (T,)
        Strictly increasing sample times [s], none before ``hold_times[0]``.
    left_velocity : ndarray, shape (N,), optional
        To the left [m/s], of a robot that drives in all directions.

    Returns
    -------
    ndarray, shape (T, 3)
        Displacement from the previous sample in the robot frame at the previous sample [m, m, rad]; row 0 is zero.
    """
    inner = hold_times[(hold_times > times[0]) & (hold_times < times[-1])]
    knots = np.union1d(times, inner)
    held = np.searchsorted(hold_times, knots[:-1], side="right") - 1
    left = 0.0 if left_velocity is None else left_velocity[held]
    pieces = integrate_twist(forward_velocity[held], angular_velocity[held], np.diff(knots), left)
    # Dead reckoning from sample to sample in one pass: the sum of turns gives every heading, then pieces add up.
    heading = np.concatenate(([0.0], np.cumsum(pieces[:, 2])))
    start = np.zeros((len(pieces), 3))
    start[:, 2] = heading[:-1]
    steps = compose(start, pieces)[:, :2]
    path = np.vstack((np.zeros(2), np.cumsum(steps, axis=0)))
    at = np.searchsorted(knots, times)
    dx, dy = np.diff(path[at], axis=0).T
    sine, cosine = np.sin(heading[at[:-1]]), np.cos(heading[at[:-1]])
    odometry = np.zeros((len(times), 3))
    # The turn stays unwrapped: a robot may turn more than half a revolution within one long period.
    odometry[1:] = np.stack((cosine * dx + sine * dy, cosine * dy - sine * dx, np.diff(heading[at])), axis=-1)
    return odometry


def nearest_sample(reading_times: Float, times: Float, max_offset: float) -> Int:
    """Return the sample nearest in time to each reading.

    Parameters
    ----------
    reading_times : ndarray, shape (R,)
        When each reading was taken [s].
    times : ndarray, shape (T,)
        Strictly increasing sample times [s].
    max_offset : float
        Readings further from every sample belong to none [s].

    Returns
    -------
    ndarray of int, shape (R,)
        Index of a sample; -1 for none.
    """
    right = np.minimum(np.searchsorted(times, reading_times), len(times) - 1)
    left = np.maximum(right - 1, 0)
    index = np.where(reading_times - times[left] <= times[right] - reading_times, left, right)
    near: Int = np.where(np.abs(reading_times - times[index]) <= max_offset + _SAME_INSTANT, index, -1).astype(np.int64)
    return near


def sort_sightings(
    reading_times: Float, landmark: Int, values: Float, times: Float, n_landmarks: int, max_offset: float
) -> Sightings:
    """Give each landmark reading to the sample nearest in time; per sample and landmark the nearest reading stays.

    Parameters
    ----------
    reading_times : ndarray, shape (R,)
        When each reading was taken [s].
    landmark : ndarray of int, shape (R,)
        Which landmark it saw, 0 to `n_landmarks` - 1.
    values : ndarray, shape (R, K)
        What it measured.
    times : ndarray, shape (T,)
        Strictly increasing sample times [s].
    n_landmarks : int
        J.
    max_offset : float
        Readings further from every sample are dropped [s].

    Returns
    -------
    Sightings
    """
    sample = nearest_sample(reading_times, times, max_offset)
    inside = np.flatnonzero(sample >= 0)
    offset = reading_times[inside] - times[sample[inside]]
    cell = sample[inside] * n_landmarks + landmark[inside]
    # Sorted by cell, then by distance in time, then by order in the file: the first of each cell stays.
    order = np.lexsort((np.arange(len(cell)), np.abs(offset), cell))
    kept_cells, first = np.unique(cell[order], return_index=True)
    kept = order[first]
    table = np.full((len(times) * n_landmarks, values.shape[1]), np.nan)
    offsets = np.full(len(times) * n_landmarks, np.nan)
    table[kept_cells], offsets[kept_cells] = values[inside[kept]], offset[kept]
    return Sightings(
        table.reshape(len(times), n_landmarks, -1),
        offsets.reshape(len(times), n_landmarks),
        int(len(reading_times) - len(inside)),
        int(len(inside) - len(kept)),
    )


def interpolate_poses(pose_times: Float, poses: Float, times: Float, max_gap: float) -> Float:
    """Interpolate reference poses linearly, headings along the shorter way round.

    Parameters
    ----------
    pose_times : ndarray, shape (N,)
        Strictly increasing times of the reference [s], N >= 1.
    poses : ndarray, shape (N, 3)
        Reference poses [m, m, rad].
    times : ndarray, shape (T,)
        Sample times [s].
    max_gap : float
        Longest pause of the reference that is bridged [s].

    Returns
    -------
    ndarray, shape (T, 3)
        Poses [m, m, rad], heading in [-pi, pi); NaN outside the reference and inside its longer pauses.
    """
    smooth = np.column_stack((poses[:, :2], np.unwrap(poses[:, 2])))
    result = np.column_stack([np.interp(times, pose_times, column) for column in smooth.T])
    result[:, 2] = wrap(result[:, 2])
    right = np.clip(np.searchsorted(pose_times, times), 0, len(pose_times) - 1)
    left = np.maximum(right - 1, 0)
    on_pose = np.minimum(np.abs(times - pose_times[left]), np.abs(times - pose_times[right])) <= _SAME_INSTANT
    bridged = (
        (times >= pose_times[left]) & (times <= pose_times[right]) & (pose_times[right] - pose_times[left] <= max_gap)
    )
    result[~(on_pose | bridged)] = np.nan
    return result
