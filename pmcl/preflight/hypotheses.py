"""What a log would be if a mistake had been made in writing it: each mistake is a change of the log or of its map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import between
from pmcl.logs.arrays import LogArrays

__all__ = ["Hypothesis", "hypotheses_of"]

Float = NDArray[np.float64]

_DEGREE = math.pi / 180.0
# Increments and velocities are told apart where rows are this much closer or further apart than a second. Nearer to
# it a mistake looks like a scale of the odometry, which robots do have.
_PERIOD_FACTOR = 1.8


@dataclass(frozen=True)
class Hypothesis:
    """One way to read a log; the defaults read it as it is.

    Attributes
    ----------
    name : str
        Of the mistake; empty for the log as it is.
    finding, advice : str
        What was written, and what to do, for the message.
    odometry : ndarray, shape (T, 3)
        Increments (forward, left, turn) [m, m, rad].
    says_nothing : bool
        Whether the odometry does not tell how the robot moved; `odometry` is zero then.
    range_factor, max_range_factor : float
        What turns readings of distance, and max_range, into metres.
    bearing_factor : float
        What turns bearings into radians, counter-clockwise.
    bearing_from_map : bool
        Whether bearings are directions on the map.
    map_matrix : ndarray, shape (2, 2)
        A multiple of a rotation or reflection, by which the map is turned into what it should be.
    map_shift : ndarray, shape (2,)
        Added afterwards [m].
    with_start : bool
        Whether the belief about the start is on the wrong map, too, and changes with it.
    beam_poses : ndarray, shape (B, 3), or None
        Where the beams sit [m, m, rad].
    zero_is_nothing : bool
        Whether a beam that reads zero did not measure.
    """

    odometry: Float
    name: str = ""
    finding: str = ""
    advice: str = ""
    says_nothing: bool = False
    range_factor: float = 1.0
    max_range_factor: float = 1.0
    bearing_factor: float = 1.0
    bearing_from_map: bool = False
    map_matrix: Float = field(default_factory=lambda: np.eye(2))
    map_shift: Float = field(default_factory=lambda: np.zeros(2))
    with_start: bool = False
    beam_poses: Float | None = None
    zero_is_nothing: bool = False


def hypotheses_of(log: LogArrays) -> tuple[Hypothesis, ...]:
    """Return the ways to read a log: as it is first, then every mistake that could be seen in it.

    Parameters
    ----------
    log : LogArrays
        A validated log.
    """
    plain = Hypothesis(np.asarray(log.odometry), beam_poses=log.beam_poses)
    return (plain, *_of_odometry(log, plain), *_of_landmarks(log, plain), *_of_beams(log, plain), *_of_map(log, plain))


def _of_odometry(log: LogArrays, plain: Hypothesis) -> Iterator[Hypothesis]:
    odometry = plain.odometry
    if not odometry.any():
        return
    forward, left, turn = odometry.T
    if turn.any():
        yield replace(
            plain,
            name="turns-in-degrees",
            finding="the turns of the odometry seem to be in degrees",
            advice="multiply them by pi / 180",
            odometry=np.stack((forward, left, turn * _DEGREE), axis=1),
        )
        yield replace(
            plain,
            name="turn-sign-flipped",
            finding="the turns of the odometry seem to have the wrong sign",
            advice="count turns counter-clockwise (x forward, y left)",
            odometry=np.stack((forward, left, -turn), axis=1),
        )
        heading = np.append(0.0, np.cumsum(turn)[:-1])
        # The axes are those of the map, or of where the robot was switched on.
        for first in {0.0, float(log.start_mean[2])}:
            c, s = np.cos(first + heading), np.sin(first + heading)
            yield replace(
                plain,
                name="odometry-in-world-frame",
                finding="the odometry seems to hold displacements along fixed axes",
                advice="rotate them into the robot's frame at the row before (pmcl.geometry.between)",
                odometry=np.stack((c * forward + s * left, c * left - s * forward, turn), axis=1),
            )
    period = np.diff(log.times, prepend=log.times[0])
    median = float(np.median(period[1:])) if period.size > 1 else 1.0
    if not 1.0 / _PERIOD_FACTOR < median < _PERIOD_FACTOR:
        yield replace(
            plain,
            name="velocities-as-increments",
            finding=f"the odometry seems to hold velocities, while rows are {median:.3g} s apart",
            advice="multiply them by the time between rows (pmcl.geometry.integrate_twist)",
            odometry=odometry * period[:, None],
        )
    yield replace(
        plain,
        name="poses-as-increments",
        finding="the odometry seems to hold poses since the start",
        advice="give the displacement since the row before (pmcl.geometry.between)",
        odometry=_differences(log),
    )
    names = ("forward", "left", "turn")
    for order in permutations(range(3)):
        if order != (0, 1, 2):
            held = ", ".join(names[order.index(k)] for k in range(3))
            yield replace(
                plain,
                name="odometry-columns-swapped",
                finding=f"the columns of the odometry seem to be {held}",
                advice="give forward, left, turn in this order",
                odometry=np.ascontiguousarray(odometry[:, order]),
            )
    for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2)):
        yield replace(
            plain,
            name=f"odometry-in-{unit}",
            finding=f"the displacements of the odometry seem to be in {unit}",
            advice=f"multiply them by {factor:g}",
            odometry=odometry * (factor, factor, 1.0),
        )
    yield replace(
        plain,
        name="odometry-disagrees",
        finding="the odometry seems to have nothing to do with the motion that the readings show",
        advice="check that odometry and readings are of the same drive, in the same order and on the same clock",
        odometry=np.zeros_like(odometry),
        says_nothing=True,
    )


def _differences(log: LogArrays) -> Float:
    """Return the increments between rows of odometry that are poses; the first known pose is where the robot starts."""
    poses = np.array(log.dataset["odometry"].values)
    if not np.isfinite(poses[0]).all() and len(poses) > 1:
        poses[0] = poses[1]
    increments = np.zeros_like(poses)
    increments[1:] = between(poses[:-1], poses[1:])
    return increments


def _of_landmarks(log: LogArrays, plain: Hypothesis) -> Iterator[Hypothesis]:
    if log.landmark_bearing is not None:
        yield replace(
            plain,
            name="bearings-in-degrees",
            finding="the bearings seem to be in degrees",
            advice="multiply them by pi / 180",
            bearing_factor=_DEGREE,
        )
        yield replace(
            plain,
            name="bearing-sign-flipped",
            finding="the bearings seem to have the wrong sign",
            advice="count bearings counter-clockwise from straight ahead",
            bearing_factor=-1.0,
        )
        yield replace(
            plain,
            name="bearings-in-world-frame",
            finding="the bearings seem to be directions on the map",
            advice="subtract the robot's heading, or take them as the sensor gave them",
            bearing_from_map=True,
        )
    if log.landmark_range is not None:
        for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2)):
            yield replace(
                plain,
                name=f"ranges-in-{unit}",
                finding=f"the distances of landmarks seem to be in {unit}",
                advice=f"multiply them by {factor:g}",
                range_factor=factor,
            )


def _of_beams(log: LogArrays, plain: Hypothesis) -> Iterator[Hypothesis]:
    if log.ranges is None or log.beam_poses is None:
        return
    for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2)):
        what = replace(plain, name=f"ranges-in-{unit}", advice=f"multiply them by {factor:g}", range_factor=factor)
        yield replace(what, finding=f"the range readings seem to be in {unit}")
        yield replace(
            what, finding=f"the range readings and max_range seem to be in {unit}", max_range_factor=factor
        )
    if (log.ranges == 0.0).any():
        yield replace(
            plain,
            name="zero-for-not-measured",
            finding="range readings of 0 seem to mean that nothing was measured",
            advice="write NaN there (or inf where there was no echo)",
            zero_is_nothing=True,
        )
    yaws = log.beam_poses[:, 2]
    for name, finding, advice, changed in (
        ("beam-yaws-in-degrees", "the yaws of the beams seem to be in degrees", "multiply them by pi / 180",
         yaws * _DEGREE),
        ("beam-yaws-are-indices", "the yaws of the beams seem to be their numbers",
         "give the direction of each beam in radians", yaws * (2.0 * math.pi / max(len(yaws), 1))),
        ("beam-yaw-sign-flipped", "the yaws of the beams seem to have the wrong sign",
         "count yaws counter-clockwise from straight ahead", -yaws),
    ):  # fmt: skip
        if yaws.any():
            poses = np.array(log.beam_poses)
            poses[:, 2] = changed
            yield replace(plain, name=name, finding=finding, advice=advice, beam_poses=poses)


def _of_map(log: LogArrays, plain: Hypothesis) -> Iterator[Hypothesis]:
    for way in _changed_maps(log, plain):
        if way.with_start or not _is_same_map(log, way):
            yield way


def _is_same_map(log: LogArrays, way: Hypothesis) -> bool:
    """Tell whether a symmetric map comes out as it went in."""

    def canonical(points: Float) -> Float:
        # Walls are in no order, and neither are their ends; landmarks have their numbers.
        ends = np.round(points, 6) + 0.0
        if ends.ndim == 2:
            return ends
        walls = np.array([sorted(map(tuple, wall)) for wall in ends]).reshape(-1, 4)
        return np.asarray(walls[np.lexsort(walls.T)])

    if log.walls is not None and log.ranges is not None:
        points = log.walls.segments
    else:
        assert log.landmarks is not None
        points = log.landmarks.positions
    return np.array_equal(canonical(points), canonical(points @ way.map_matrix.T + way.map_shift))


def _changed_maps(log: LogArrays, plain: Hypothesis) -> Iterator[Hypothesis]:
    if log.walls is not None and log.ranges is not None:
        x_low, x_high, y_low, y_high = log.walls.bounds
    elif log.landmarks is not None:
        x_low, x_high, y_low, y_high = log.landmarks.bounds
    else:
        return
    placed = bool(np.isfinite(log.start_std).all())
    mirrored = replace(
        plain,
        name="map-mirrored",
        finding="the map seems to be mirrored",
        advice="check its axes (y to the left of x, not downwards as in pictures) and the signs of bearings and turns",
    )
    over_x, over_y = np.diag((1.0, -1.0)), np.diag((-1.0, 1.0))
    yield replace(mirrored, map_matrix=over_x, with_start=True)
    if placed:
        for matrix, shift in (
            (over_x, (0.0, 0.0)),
            (over_x, (0.0, y_low + y_high)),
            (over_y, (0.0, 0.0)),
            (over_y, (x_low + x_high, 0.0)),
        ):
            yield replace(mirrored, map_matrix=matrix, map_shift=np.array(shift))
        swapped = np.array([[0.0, 1.0], [1.0, 0.0]])
        yield replace(mirrored, name="map-axes-swapped", finding="x and y of the map seem to be swapped",
                      advice="give x first", map_matrix=swapped)  # fmt: skip
    for unit, factor in (("millimetres", 1e-3), ("centimetres", 1e-2)):
        shrunk = replace(
            plain,
            name=f"map-in-{unit}",
            finding=f"the map seems to be in {unit}",
            advice=f"multiply it by {factor:g}",
            map_matrix=factor * np.eye(2),
        )
        yield replace(shrunk, with_start=True)
        if placed:
            yield shrunk
