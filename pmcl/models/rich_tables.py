"""Coefficient tables with room for effects: the plain tables of :mod:`pmcl.models.tables` with further fields.

Each further field has a value at which the density is exactly that of the plain table; the ``rich_`` functions start
there. One richer table for each carrier means one compilation for all effects. T is the number of time steps, B of
beams, N of sightings, J of landmarks.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.models.tables import GaussianStart, IncrementMotion, LandmarkSightings, PoseStart, RangeBeams, Tables

__all__ = [
    "RichLandmarks",
    "RichMotion",
    "RichRangeBeams",
    "WanderingMotion",
    "WiderStart",
    "rich_beams",
    "rich_landmarks",
    "rich_motion",
    "ring_neighbours",
    "uniform",
    "wandering_motion",
    "wider_start",
]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


class RichMotion(NamedTuple):
    """Increments in the robot frame that may slip, scatter with heavy tails, and fall short in places.

    Attributes
    ----------
    mean, std : ndarray, shape (T, 3)
        As for :class:`~pmcl.models.tables.IncrementMotion`.
    tail : float
        Inverse degrees of freedom of the noise (Student t with scale `std`, each component by itself); 0 is Gaussian.
    slip_weight, slip_share : float
        With probability `slip_weight` the translation of a step loses `slip_share` of its mean.
    patches : ndarray, shape (K, 4)
        Discs (x, y, radius [m], e): a step that begins in one loses the share e of its mean translation.
    wander, keep : ndarray, shape (T,)
        Only for :class:`WanderingMotion`; else zeros.
    """

    mean: Float
    std: Float
    tail: float
    slip_weight: float
    slip_share: float
    patches: Float
    wander: Float
    keep: Float


class WanderingMotion(NamedTuple):
    """:class:`RichMotion` whose turn rate wanders: the state has a fourth component u, an AR(1) of unit variance.

    turn[t] = mean[t] + wander[t] u[t-1] + noise, u[t] = keep[t] u[t-1] + sqrt(1 - keep[t]^2) normal. Along a path that
    has only the three components of a pose, its density is that with u integrated out.

    Attributes
    ----------
    mean, std, tail, slip_weight, slip_share, patches
        As for :class:`RichMotion`.
    wander : ndarray, shape (T,)
        Turn per unit of u [rad].
    keep : ndarray, shape (T,)
        Correlation of u with its value a step before, below 1.
    """

    mean: Float
    std: Float
    tail: float
    slip_weight: float
    slip_share: float
    patches: Float
    wander: Float
    keep: Float


class WiderStart(NamedTuple):
    """A belief about the first pose, and independent Gaussians about further components of the state.

    Attributes
    ----------
    pose : PoseStart
        Belief about the first three components.
    mean, std : ndarray, shape (D - 3,)
        Belief about the others.
    """

    pose: PoseStart
    mean: Float
    std: Float


class RichRangeBeams(NamedTuple):
    """Range readings that may be biased by the hour, blurred, late, or no echo of the wall at all.

    An echo is Gaussian (or Student t) around ``scale * length + bias + bias_at`` with standard deviation
    ``std * std_factor * (1 + growth * length)`` and is clipped to [0, max_range]; lengths beyond max_range count as
    max_range there. A reading is, in this order: uniform on [0, max_range] with probability `outlier_weight`; else
    max_range with `no_echo_weight`; else too short with `short_weight`; else a detour with `specular_weight`, at large
    incidence; else the echo of an obstacle in the way; else the echo of a neighbouring beam with `talk_weight`; else
    its own echo.

    Attributes
    ----------
    reading, measured, beam_pose, bias, scale, std, outlier_weight, max_range, vertices, wall_start, wall_stop
        As for :class:`~pmcl.models.tables.RangeBeams`.
    bias_at : ndarray, shape (T, B)
        Added to what is expected [m].
    std_factor : ndarray, shape (T,)
        Factor on the standard deviation.
    growth : ndarray, shape (B,)
        Growth of the standard deviation with the length of the ray [1/m].
    tail : float
        Inverse degrees of freedom of the noise; 0 is Gaussian.
    step : float
        Readings are rounded to multiples of this [m]; 0 not at all. Their density is constant over each cell.
    width : ndarray, shape (B,)
        Full angle of the cone whose nearest of five rays is what the beam sees [rad].
    short_weight : ndarray, shape (B,)
        Probability of an echo of something unknown before the wall.
    short_length : float
        Scale of its exponential distribution, which ends at the wall [m].
    no_echo_weight : ndarray, shape (B,)
        Probability that nothing comes back.
    specular_weight : ndarray, shape (B,)
        Probability, at grazing incidence, of an echo by a detour: uniform between the wall and max_range (nothing
        comes back when that is less than a tenth of the range).
    specular_angle : float
        Incidence at which half of that is reached [rad].
    talk_weight : ndarray, shape (B,)
        Probability of a neighbour's echo, either neighbour alike.
    neighbours : ndarray of int, shape (B, 2)
        The neighbouring beams.
    correlation : ndarray, shape (B,)
        Correlation of an echo's residual with that of the same beam in the row before. Unrelated where that was not
        measured, clipped, or off by more than four standard deviations.
    lag : ndarray, shape (T,)
        Readings are those of the pose this share of the last step ago; beyond 1 as if the robot had moved the same way
        before.
    obstacles : ndarray, shape (K, 4)
        Discs (x, y, radius [m], weight): a beam that meets one before the wall echoes from it with that probability.
    """

    reading: Float
    measured: Int
    beam_pose: Float
    bias: Float
    scale: Float
    std: Float
    outlier_weight: Float
    max_range: float
    vertices: Float
    wall_start: Int
    wall_stop: Int
    bias_at: Float
    std_factor: Float
    growth: Float
    tail: float
    step: float
    width: Float
    short_weight: Float
    short_length: float
    no_echo_weight: Float
    specular_weight: Float
    specular_angle: float
    talk_weight: Float
    neighbours: Int
    correlation: Float
    lag: Float
    obstacles: Float


class RichLandmarks(NamedTuple):
    """Sightings that may be late, of the wrong landmark, noisier near or far, or wrong as they were just before.

    Attributes
    ----------
    first, time, landmark, range, bearing, size, position, sensor_pose, range_scale, range_bias, range_std,
    bearing_bias, bearing_std, size_constant, size_std, outlier_weight, max_range
        As for :class:`~pmcl.models.tables.LandmarkSightings`.
    lag : ndarray, shape (T,)
        As for :class:`RichRangeBeams`.
    range_growth : ndarray, shape (J,)
        The standard deviation of a distance d is ``range_std * (1 + range_growth * d)`` [1/m].
    bearing_falloff : ndarray, shape (J,)
        That of a bearing is ``bearing_std * (1 + bearing_falloff / d)`` [m]; below 0.1 m, d counts as 0.1 m.
    depth : float
        Distances are read as ``d * (1 - depth + depth * cos(bearing))``: 1 is the depth along the optical axis.
    misread_weight : ndarray, shape (J,)
        Probability that a sighting said to be of this landmark is of another one, each alike.
    range_correlation, bearing_correlation : ndarray, shape (J,)
        Correlation of the residual of a distance, or bearing, with that of the same landmark in the row before.
        Unrelated where that was not measured, off by more than four standard deviations, or where the sighting now
        is of another landmark or a gross error. Sizes have no memory.
    """

    first: Int
    time: Int
    landmark: Int
    range: Float
    bearing: Float
    size: Float
    position: Float
    sensor_pose: Float
    range_scale: Float
    range_bias: Float
    range_std: Float
    bearing_bias: Float
    bearing_std: Float
    size_constant: Float
    size_std: Float
    outlier_weight: Float
    max_range: float
    lag: Float
    range_growth: Float
    bearing_falloff: Float
    depth: float
    misread_weight: Float
    range_correlation: Float
    bearing_correlation: Float


def rich_motion(motion: IncrementMotion | RichMotion | WanderingMotion) -> RichMotion | WanderingMotion:
    """Return a motion table with room for effects; one that has it already comes back as it is."""
    if not isinstance(motion, IncrementMotion):
        return motion
    rows = np.zeros((2, motion.mean.shape[0]))
    return RichMotion(motion.mean, motion.std, 0.0, 0.0, 0.0, np.empty((0, 4)), rows[0], rows[1])


def wandering_motion(motion: IncrementMotion | RichMotion | WanderingMotion) -> WanderingMotion:
    """Return a motion table with a wandering turn rate, which does not wander yet; see :func:`rich_motion`."""
    rich = rich_motion(motion)
    return rich if isinstance(rich, WanderingMotion) else WanderingMotion(*rich)


def wider_start(
    start: GaussianStart | PoseStart | WiderStart, mean: float, std: float
) -> GaussianStart | PoseStart | WiderStart:
    """Return a start belief for a state of one more component."""
    if isinstance(start, GaussianStart):
        return GaussianStart(np.append(start.mean, mean), np.append(start.std, std))
    if isinstance(start, PoseStart):
        return WiderStart(start, np.array([mean]), np.array([std]))
    return start._replace(mean=np.append(start.mean, mean), std=np.append(start.std, std))


def rich_beams(beams: RangeBeams | RichRangeBeams) -> RichRangeBeams:
    """Return a table of beams with room for effects; one that has it already comes back as it is."""
    if isinstance(beams, RichRangeBeams):
        return beams
    n_steps, n_beams = beams.reading.shape
    nothing = np.zeros((6, n_beams))
    return RichRangeBeams(
        *beams,
        bias_at=np.zeros((n_steps, n_beams)),
        std_factor=np.ones(n_steps),
        growth=nothing[0],
        tail=0.0,
        step=0.0,
        width=nothing[1],
        short_weight=nothing[2],
        short_length=1.0,
        no_echo_weight=nothing[3],
        specular_weight=nothing[4],
        specular_angle=1.0,
        talk_weight=nothing[5],
        neighbours=ring_neighbours(beams.beam_pose),
        correlation=np.zeros(n_beams),
        lag=np.zeros(n_steps),
        obstacles=np.empty((0, 4)),
    )


def ring_neighbours(beam_pose: Float) -> Int:
    """Return the beams to the left and right of each one by direction, (B, 2); a single beam is its own neighbour."""
    # Tables are made for each proposal, and beams hardly ever move.
    return _neighbours_by_direction(tuple(beam_pose[:, 2].tolist())).copy()


@functools.lru_cache(maxsize=64)
def _neighbours_by_direction(directions: tuple[float, ...]) -> Int:
    order = np.argsort(np.mod(directions, 2.0 * np.pi), kind="stable")
    neighbours = np.empty((order.size, 2), dtype=np.int64)
    neighbours[order[:-1], 0], neighbours[order[-1], 0] = order[1:], order[0]
    neighbours[order[1:], 1], neighbours[order[0], 1] = order[:-1], order[-1]
    return neighbours


def rich_landmarks(seen: LandmarkSightings | RichLandmarks) -> RichLandmarks:
    """Return a table of sightings with room for effects; one that has it already comes back as it is."""
    if isinstance(seen, RichLandmarks):
        return seen
    nothing = np.zeros((5, seen.position.shape[0]))
    return RichLandmarks(
        *seen,
        lag=np.zeros(seen.first.size - 1),
        range_growth=nothing[0],
        bearing_falloff=nothing[1],
        depth=0.0,
        misread_weight=nothing[2],
        range_correlation=nothing[3],
        bearing_correlation=nothing[4],
    )


def uniform(tables: Tables) -> Tables:
    """Return tables of which all are rich where a sensor's is; densities stay the same.

    Kernels are compiled for each combination of table types, and this keeps them few. An effect of the motion alone
    leaves sensors as they are, since rich ones cost some three times as much.
    """
    if not any(isinstance(table, (RichRangeBeams, RichLandmarks)) for table in tables.sensors):
        return tables
    motion: NamedTuple = tables.motion
    if isinstance(motion, IncrementMotion):
        motion = rich_motion(motion)
    sensors: list[NamedTuple] = []
    for sensor in tables.sensors:
        if isinstance(sensor, RangeBeams):
            sensors.append(rich_beams(sensor))
        elif isinstance(sensor, LandmarkSightings):
            sensors.append(rich_landmarks(sensor))
        else:
            sensors.append(sensor)
    return Tables(tables.start, motion, tuple(sensors))
