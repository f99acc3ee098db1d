"""From the streams of your own robot, each with its own clock, to the rows of a log.

A log has one row for each sample time: the motion since the row before, and the readings that were taken nearest to it.
Each function here and in :mod:`pmcl.logs.odometry` makes one kind of column, with the names that
:meth:`pmcl.RobotLog.build` has for its arguments::

    from pmcl.logs import RobotLog, landmark_rows, odometry_from_velocities, row_times

    times = row_times(0.2, wheel_times)
    log = RobotLog.build(
        time=times,
        odometry=odometry_from_velocities(wheel_times, forward, turn_rate, times),
        **landmark_rows(times, landmarks, seen_times, seen_names, ranges=distances, bearings=bearings),
        landmarks=landmarks,
    )

Recordings of others are converted by the same rules (:mod:`pmcl.logs.resample`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmcl.logs.resample import nearest_sample, regular_times, sort_sightings
from pmcl.logs.stream_checks import clock_of, numbers, require_same_length, vector
from pmcl.logs.validation import fail
from pmcl.maps.landmarks import LandmarkMap

__all__ = ["beam_rows", "landmark_rows", "row_times"]

Float = NDArray[np.float64]


def row_times(period: float, *streams: ArrayLike) -> Float:
    """Return sample times at a regular period, over the time in which all the streams given were recorded.

    Parameters
    ----------
    period : float
        Time between rows [s]; each row costs a step of the particle filter. A reading counts as if it was taken at its
        row. A robot that turns at 0.4 rad/s turns by up to 0.1 rad in the quarter of a second that may lie between when
        rows are half a second apart, and calibration takes that for noise of the bearings. So take the period of the
        readings where they come regularly, and else one in which the robot turns by less than that noise.
    *streams : array_like, shape (N,)
        Times of the streams that every row needs [s]: those of the odometry, not those of readings.

    Returns
    -------
    ndarray, shape (T,)
        Times [s], from the latest first time on, none after the earliest last time.

    Raises
    ------
    LogError
        When the period is not positive, no stream is given, or fewer than two or far too many rows result.
    """
    where = "row_times"
    if not 0.0 < period < np.inf:
        fail(where, f"expected period > 0 [s], got {period}: choose another")
    if not streams:
        fail(where, "expected the times of at least one stream, got none: give those of the odometry")
    clocks = [clock_of(where, f"stream {k}", stream) for k, stream in enumerate(streams)]
    begin, end = max(float(clock[0]) for clock in clocks), min(float(clock[-1]) for clock in clocks)
    times = regular_times(begin, end, period, where)
    if len(times) < 2:
        fail(
            where,
            f"expected at least two rows, got {len(times)} of period {period:g} s from {begin:g} s to {end:g} s: "
            "choose a shorter period, and check that all streams use the same clock in seconds",
        )
    return times


def landmark_rows(
    times: ArrayLike,
    landmarks: LandmarkMap,
    reading_times: ArrayLike,
    names: Sequence[Any] | NDArray[Any],
    *,
    ranges: ArrayLike | None = None,
    bearings: ArrayLike | None = None,
    sizes: ArrayLike | None = None,
    max_offset: float | None = None,
) -> dict[str, Any]:
    """Give each sighting of a landmark to the row nearest in time.

    Where a landmark was seen several times near one row, the sighting nearest in time counts. How far each reading is
    from its row is kept, for models of a sensor that is late.

    Parameters
    ----------
    times : array_like, shape (T,)
        Times of the rows [s].
    landmarks : LandmarkMap
        The map, with J landmarks.
    reading_times : array_like, shape (R,)
        When each sighting was made [s], in any order.
    names : sequence, length R
        Which landmark each sighting saw: its name in the map, e.g. the number of its tag.
    ranges, bearings, sizes : array_like, shape (R,), optional
        What was read: distance [m], bearing in the sensor's frame [rad], apparent size [pixel]; at least one of them.
    max_offset : float, optional
        Sightings further from every row are left out [s]; half of the longest time between rows when left out, which
        keeps all between the first and the last row.

    Returns
    -------
    dict of str to ndarray, shape (T, J)
        ``landmark_range``, ``landmark_bearing`` and ``landmark_size`` as far as given, NaN where a landmark was not
        seen, and ``landmark_time_offset`` [s]; arguments of :meth:`pmcl.RobotLog.build`.

    Raises
    ------
    LogError
        When shapes disagree, something is not finite, or a name is not on the map.
    """
    where = "landmark_rows"
    rows = clock_of(where, "times", times)
    seen = vector(where, "reading_times", reading_times)
    given = {"ranges": ranges, "bearings": bearings, "sizes": sizes}
    read = {name: vector(where, name, value) for name, value in given.items() if value is not None}
    if not read:
        fail(where, "expected ranges, bearings or sizes, got none of them: give what was read")
    labels = [str(name) for name in np.asarray(names).tolist()]
    require_same_length(where, "reading_times", seen, "names", labels)
    for name, value in read.items():
        require_same_length(where, "reading_times", seen, name, value)
    index_of = {name: j for j, name in enumerate(landmarks.names)}
    unknown = [label for label in labels if label not in index_of]
    if unknown:
        fail(
            where,
            f"expected names of landmarks on the map ({', '.join(list(index_of)[:8])}{', ...' * (len(index_of) > 8)}), "
            f"got {unknown[0]!r}: leave sightings of other things out",
        )
    sightings = sort_sightings(
        seen,
        np.array([index_of[label] for label in labels], dtype=np.int64),
        np.column_stack(list(read.values())),
        rows,
        len(index_of),
        _offset(where, max_offset, rows),
    )
    columns = {"ranges": "landmark_range", "bearings": "landmark_bearing", "sizes": "landmark_size"}
    arrays = {columns[name]: np.ascontiguousarray(sightings.values[..., k]) for k, name in enumerate(read)}
    return {**arrays, "landmark_time_offset": sightings.time_offset}


def beam_rows(
    times: ArrayLike, reading_times: ArrayLike, ranges: ArrayLike, *, max_offset: float | None = None
) -> Float:
    """Give each row, beam by beam, the range reading that is nearest in time.

    Parameters
    ----------
    times : array_like, shape (T,)
        Times of the rows [s].
    reading_times : array_like, shape (R,)
        When each set was read [s], in any order.
    ranges : array_like, shape (R, B)
        Range readings of B beams [m], NaN where not measured, inf for no echo. Sonars that fire one after the other
        give one set for each shot, with NaN for the others.
    max_offset : float, optional
        Sets further from every row are left out [s]; half of the longest time between rows when left out.

    Returns
    -------
    ndarray, shape (T, B)
        Argument ``ranges`` of :meth:`pmcl.RobotLog.build`; NaN where no reading was near. No reading serves two rows.

    Raises
    ------
    LogError
        When shapes disagree or times are not finite.
    """
    where = "beam_rows"
    rows, read_at = clock_of(where, "times", times), vector(where, "reading_times", reading_times)
    sets = numbers(where, "ranges", ranges)
    if sets.ndim != 2:
        fail(where, f"expected ranges of shape (R, B): reading time, beam, got {sets.shape}: reshape them")
    require_same_length(where, "reading_times", read_at, "ranges", sets)
    row = nearest_sample(read_at, rows, _offset(where, max_offset, rows))
    inside = np.flatnonzero(row >= 0)
    # The farthest first, so that the nearest is written last.
    order = inside[np.argsort(-np.abs(read_at[inside] - rows[row[inside]]), kind="stable")]
    table = np.full((len(rows), sets.shape[1]), np.nan)
    for beam, readings in enumerate(sets[order].T):
        measured = ~np.isnan(readings)
        table[row[order[measured]], beam] = readings[measured]
    return table


def _offset(where: str, max_offset: float | None, rows: Float) -> float:
    if max_offset is None:
        return 0.5 * float(np.diff(rows).max()) if len(rows) > 1 else 0.0
    if not max_offset >= 0.0:
        fail(where, f"expected max_offset >= 0 [s], got {max_offset}: choose another")
    return float(max_offset)
