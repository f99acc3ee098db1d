"""Scans linearised around a path, for the transport move.

Each usable reading is compared with a straight wall: the line through the occupied cells around the one where the ray
hits (beam model) or around the one nearest to where the reading ends (likelihood field). The distance L along the ray
to that wall has the slopes

    dL/dp = -n / (n . u),    dL/dheading = -n . perp(p_ray - p + L u) / (n . u)

by the robot's position p and heading, with the wall's normal n and the ray's direction u.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.linear_readings import earlier_part, times_of
from pmcl.models.sensors.late_readings import reading_poses
from pmcl.models.sensors.lidar.geometry import lengths_along, ray_origins
from pmcl.models.sensors.lidar.table import BEAM, LidarTable
from pmcl.models.sensors.lidar.walls import walls_of

__all__ = ["LinearScans", "empty_like", "linearise", "moved_linearisation"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Rays that graze a wall more closely (cosine of the incidence) have no useful slope.
_LEAST_COSINE = 0.15
# A reading that ends farther from its wall than this many standard deviations says nothing of where the wall is.
_FARTHEST = 3.5


class LinearScans(NamedTuple):
    """Readings of lidars, linearised around a path.

    Attributes
    ----------
    first : ndarray of int, shape (T + 1,)
        Readings of time t are ``first[t] : first[t + 1]``.
    channel : ndarray of int, shape (M,)
        Ray.
    reading, value : ndarray, shape (M,)
        What was measured, and how far along the ray the wall is at the reference [m].
    jacobian : ndarray, shape (M, D)
        Derivative of `value` by the state.
    weight : ndarray, shape (M,)
        Probability that the reading is a hit, at the reference.
    cosine : ndarray, shape (M,)
        Cosine of the incidence.
    velocity : ndarray, shape (M,)
        Change of `value` over the last step of the reference.
    normal : ndarray, shape (M, 3)
        Unit normal of the wall, and its distance from the map's origin along it [m].
    """

    first: Int
    channel: Int
    reading: Float
    value: Float
    jacobian: Float
    weight: Float
    cosine: Float
    velocity: Float
    normal: Float


def linearise(table: LidarTable, reference: Float) -> LinearScans:
    """Linearise scans around a reference (T, D); see :meth:`pmcl.models.sensor.Sensor.linearise`."""
    n_steps = reference.shape[0]
    reading = table.reading[:n_steps]
    poses = reading_poses(table, reference)
    origins, directions = ray_origins(table, poses)
    length = (reading - table.bias) / table.scale
    usable = reading < table.max_range
    if table.model == BEAM:
        to_wall = lengths_along(table, poses)
        usable &= np.isfinite(to_wall) & (np.abs(length - to_wall) < _FARTHEST * table.std)
    else:
        to_wall = length
    time, ray = np.nonzero(usable)
    start, direction = origins[time, ray], directions[time, ray]
    along = np.column_stack([np.cos(direction), np.sin(direction)])
    normal, offset, straight = walls_of(table).next_to(start + to_wall[time, ray, None] * along)
    cosine = np.einsum("ki,ki->k", normal, along)
    steep = straight & (np.abs(cosine) > _LEAST_COSINE)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_plane = (offset - np.einsum("ki,ki->k", normal, start)) / cosine
    if table.model == BEAM:
        value = to_wall[time, ray]
        residual = length[time, ray] - value
    else:
        value = to_plane
        residual = np.abs(cosine) * (length[time, ray] - value)
    with np.errstate(invalid="ignore"):
        kept = np.flatnonzero(steep & (np.abs(residual) < _FARTHEST * table.std[ray]))
    time, ray, start, along = time[kept], ray[kept], start[kept], along[kept]
    normal, cosine, value, residual = normal[kept], cosine[kept], value[kept], residual[kept]
    jacobian = _slopes(poses, time, start + value[:, None] * along, normal, cosine)
    step = np.diff(reference, axis=0, prepend=reference[:1])[time]
    first = np.searchsorted(time, np.arange(n_steps + 1)).astype(np.int64)
    scans = LinearScans(
        first, ray.astype(np.int64), reading[time, ray], np.ascontiguousarray(value), jacobian,
        _hit_share(table, ray, residual), np.abs(cosine), np.einsum("kd,kd->k", jacobian, step),
        np.column_stack([normal, offset[kept]]),
    )  # fmt: skip
    return scans._replace(value=np.ascontiguousarray(value + earlier_part(table, scans)))


def _slopes(reference: Float, time: Int, point: Float, normal: Float, cosine: Float) -> Float:
    jacobian = np.zeros((time.size, reference.shape[1]))
    arm = point - reference[time, :2]
    turned = np.column_stack([-arm[:, 1], arm[:, 0]])
    jacobian[:, :2] = -normal / cosine[:, None]
    jacobian[:, 2] = -np.einsum("ki,ki->k", normal, turned) / cosine
    return jacobian


def _hit_share(table: LidarTable, ray: Int, residual: Float) -> Float:
    std = table.std[ray]
    hit = table.z_hit * np.exp(-0.5 * (residual / std) ** 2) / (std * np.sqrt(2.0 * np.pi))
    other = table.z_rand / table.max_range[ray] + table.z_short * table.lambda_short
    with np.errstate(invalid="ignore"):
        return np.asarray(hit / (hit + other))


def moved_linearisation(table: LidarTable, made_from: LidarTable, linearisation: Any, reference: Float) -> Any:
    """Return a linearisation for moved lasers; see :meth:`pmcl.models.sensor.Sensor.moved_linearisation`."""
    if table.beam_pose is made_from.beam_pose or np.array_equal(table.beam_pose, made_from.beam_pose):
        return linearisation
    time, poses = times_of(linearisation), reading_poses(made_from, reference)
    origins, directions = ray_origins(table, poses)
    start, direction = origins[time, linearisation.channel], directions[time, linearisation.channel]
    before, direction_before = ray_origins(made_from, poses)
    start_before, direction_before = before[time, linearisation.channel], direction_before[time, linearisation.channel]
    normal = linearisation.normal[:, :2]

    def to_wall(begin: Float, angle: Float) -> Float:
        cosine = np.einsum("ki,ki->k", normal, np.column_stack([np.cos(angle), np.sin(angle)]))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray((linearisation.normal[:, 2] - np.einsum("ki,ki->k", normal, begin)) / cosine)

    # Cells are no planes: what counts is by how much the plane's distance changes.
    change = to_wall(start, direction) - to_wall(start_before, direction_before)
    value = linearisation.value + np.where(np.isfinite(change), change, 0.0)
    return linearisation._replace(value=np.ascontiguousarray(value))


def empty_like(table: LidarTable) -> LinearScans:
    """Return a linearisation without meaning, for which kernels can be compiled."""
    number, index = np.empty(1), np.empty(1, dtype=np.int64)
    return LinearScans(index, index, number, number, np.empty((1, 3)), number, number, number, np.empty((1, 3)))
