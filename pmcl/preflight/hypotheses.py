"""What a log would be if a mistake had been made in writing it: each mistake is a change of the log or of its map."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.geometry import between, compose
from pmcl.logs.arrays import LogArrays
from pmcl.models.quick import QuickReadings, ReadAs

__all__ = ["Hypothesis", "hypotheses_of", "start_elsewhere"]

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
    misread : tuple of (str, Any), or None
        The sensor whose readings are other than they say, by its registered name, and what undoes that
        (:attr:`pmcl.models.quick.Misreading.change`).
    map_matrix : ndarray, shape (2, 2)
        A multiple of a rotation or reflection, by which the map is turned into what it should be.
    map_shift : ndarray, shape (2,)
        Added afterwards [m].
    with_start : bool
        Whether the belief about the start is on the wrong map, too, and changes with it.
    start_anywhere : bool
        Whether the robot may start anywhere on the map, whatever the log says.
    """

    odometry: Float
    name: str = ""
    finding: str = ""
    advice: str = ""
    says_nothing: bool = False
    misread: tuple[str, Any] | None = None
    map_matrix: Float = field(default_factory=lambda: np.eye(2))
    map_shift: Float = field(default_factory=lambda: np.zeros(2))
    with_start: bool = False
    start_anywhere: bool = False

    def for_sensor(self, name: str) -> ReadAs:
        """Return what a sensor needs to know of this way to read the log."""
        change = self.misread[1] if self.misread is not None and self.misread[0] == name else None
        return ReadAs(self.map_matrix, self.map_shift, change)


def hypotheses_of(log: LogArrays, readings: Mapping[str, QuickReadings]) -> tuple[Hypothesis, ...]:
    """Return the ways to read a log: as it is first, then every mistake that could be seen in it.

    Parameters
    ----------
    log : LogArrays
        A validated log.
    readings : mapping of str to QuickReadings
        Of the sensors that the log has, by their registered names.
    """
    plain = Hypothesis(np.asarray(log.odometry))
    return (
        plain,
        *_of_odometry(log, plain),
        *_of_clocks(log, readings, plain),
        *_of_sensors(readings, plain),
        *_of_map(log, readings, plain),
    )


def start_elsewhere(plain: Hypothesis) -> Hypothesis:
    """Return a way to read the log in which only the belief about the start is wrong."""
    return replace(
        plain,
        name="start-elsewhere",
        finding="the robot seems to start elsewhere on the map than start_mean says",
        advice="check start_mean and start_std, and that the start and the map are in one frame; start_std = inf says "
        "that the start is not known",
        start_anywhere=True,
    )


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


def _of_clocks(log: LogArrays, readings: Mapping[str, QuickReadings], plain: Hypothesis) -> Iterator[Hypothesis]:
    delays = sorted({delay for read in readings.values() for delay in read.delays})
    if not delays or not plain.odometry.any():
        return
    poses = np.zeros_like(plain.odometry)
    for k in range(1, len(poses)):
        poses[k] = compose(poses[k - 1], plain.odometry[k])
    poses[:, 2] = np.cumsum(plain.odometry[:, 2])
    for delay in (*delays, *(-delay for delay in delays)):
        # Where the robot was when a reading was taken that is stamped `delay` later than that; it stood still before.
        taken = np.column_stack([np.interp(log.times - delay, log.times, column) for column in poses.T])
        taken[0] = poses[0]
        odometry = np.zeros_like(poses)
        odometry[1:] = between(taken[:-1], taken[1:])
        late = "late" if delay > 0.0 else "early"
        yield replace(
            plain,
            name="stamps-off",
            finding=f"the stamps of the readings seem to be some {abs(delay):g} s {late} against those of the odometry",
            advice="check that both come from the same clock, and shift one of them",
            odometry=odometry,
        )


def _differences(log: LogArrays) -> Float:
    """Return the increments between rows of odometry that are poses; the first known pose is where the robot starts."""
    poses = np.array(log.dataset["odometry"].values)
    if not np.isfinite(poses[0]).all() and len(poses) > 1:
        poses[0] = poses[1]
    increments = np.zeros_like(poses)
    increments[1:] = between(poses[:-1], poses[1:])
    return increments


def _of_sensors(readings: Mapping[str, QuickReadings], plain: Hypothesis) -> Iterator[Hypothesis]:
    for sensor, read in readings.items():
        for name, finding, advice, change in read.mistakes():
            yield replace(plain, name=name, finding=finding, advice=advice, misread=(sensor, change))


def _of_map(log: LogArrays, readings: Mapping[str, QuickReadings], plain: Hypothesis) -> Iterator[Hypothesis]:
    with_map = [read for read in readings.values() if read.map_points() is not None]
    if not with_map:
        return
    for way in _changed_maps(log, with_map[0], plain):
        if way.with_start or not with_map[0].is_same_map(way.map_matrix, way.map_shift):
            yield way


def _changed_maps(log: LogArrays, read: QuickReadings, plain: Hypothesis) -> Iterator[Hypothesis]:
    points = read.map_points()
    assert points is not None
    (x_low, y_low), (x_high, y_high) = points.min(axis=0), points.max(axis=0)
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
