"""Densities of motion, start and sensors written again from the tables' docstrings: slow, plain, with scipy.stats."""

from __future__ import annotations

import math

import numpy as np
import shapely
from scipy import stats

from pmcl.models.motions.increments.table import IncrementMotion
from pmcl.models.sensors.landmarks.table import LandmarkSightings
from pmcl.models.sensors.range_beams.table import RangeBeams
from pmcl.models.starts.table import GaussianStart, PoseStart

FAR = 1e4


def wrapped(angle):
    """The same angle in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def increment(before, after):
    """Displacement from one pose to the next in the frame of the first; the turn is not wrapped."""
    c, s = math.cos(before[2]), math.sin(before[2])
    dx, dy = after[0] - before[0], after[1] - before[1]
    return np.array([c * dx + s * dy, c * dy - s * dx, after[2] - before[2]])


def transition(motion: IncrementMotion, t, before, after):
    """log p(after | before)."""
    return float(stats.norm.logpdf(increment(before, after), motion.mean[t], motion.std[t]).sum())


def start(belief, state):
    """Log density of the first state."""
    if isinstance(belief, GaussianStart):
        return float(stats.norm.logpdf(state, belief.mean, belief.std).sum())
    assert isinstance(belief, PoseStart)
    value = belief.log_density
    if np.isinf(belief.std[0]):
        if belief.segments.shape[0]:
            outline = shapely.polygonize(shapely.linestrings(belief.segments.reshape(-1, 2, 2))).geoms[0]
            value += 0.0 if outline.contains(shapely.Point(state[:2])) else -np.inf
        else:
            inside = (belief.low <= state[:2]).all() and (state[:2] <= belief.high).all()
            value += 0.0 if inside else -np.inf
    else:
        value += stats.norm.logpdf(state[:2], belief.mean[:2], belief.std[:2]).sum()
    if np.isinf(belief.std[2]):
        value += 0.0 if -math.pi <= state[2] < math.pi else -np.inf
    else:
        value += stats.norm.logpdf(state[2], belief.mean[2], belief.std[2])
    return float(value)


def place(pose, mount):
    """Pose in the map frame of something mounted on the robot."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return np.array([pose[0] + c * mount[0] - s * mount[1], pose[1] + s * mount[0] + c * mount[1], pose[2] + mount[2]])


def ray_length(beams: RangeBeams, origin):
    """Distance to the nearest wall, inf without one."""
    tip = origin[:2] + FAR * np.array([math.cos(origin[2]), math.sin(origin[2])])
    ray = shapely.LineString([origin[:2], tip])
    walls = np.stack([beams.vertices[beams.wall_start], beams.vertices[beams.wall_stop]], axis=1)
    met = shapely.intersection(ray, shapely.linestrings(walls))
    distances = shapely.distance(met[~shapely.is_empty(met)], shapely.Point(origin[:2]))
    return float(distances.min(initial=np.inf))


def range_readings(beams: RangeBeams, t, pose):
    """Log density of all readings at time t."""
    value = 0.0
    for b in range(beams.reading.shape[1]):
        z = beams.reading[t, b]
        if math.isnan(z):
            continue
        length = ray_length(beams, place(pose, beams.beam_pose[b]))
        # What meets no wall lies far beyond the greatest reading: twice as far stands for it.
        noise = stats.norm(min(beams.scale[b] * length + beams.bias[b], 2.0 * beams.max_range), beams.std[b])
        share = beams.outlier_weight[b]
        if z <= 0.0:
            value += math.log1p(-share) + noise.logcdf(0.0)
        elif z >= beams.max_range:
            value += math.log1p(-share) + noise.logsf(beams.max_range)
        else:
            outlier = math.log(share / beams.max_range) if share > 0.0 else -np.inf
            value += np.logaddexp(math.log1p(-share) + noise.logpdf(z), outlier)
    return float(value)


def landmark_readings(seen: LandmarkSightings, t, pose):
    """Log density of all sightings at time t."""
    value = 0.0
    sensor = place(pose, seen.sensor_pose)
    for k in range(seen.first[t], seen.first[t + 1]):
        j = seen.landmark[k]
        delta = seen.position[j] - sensor[:2]
        distance = float(np.hypot(*delta))
        bearing = math.atan2(delta[1], delta[0]) - sensor[2]
        inlier = outlier = 0.0
        if not math.isnan(seen.range[k]):
            expected = seen.range_scale[j] * distance + seen.range_bias[j]
            inlier += stats.norm.logpdf(seen.range[k], expected, seen.range_std[j])
            outlier -= math.log(seen.max_range)
        if not math.isnan(seen.bearing[k]):
            inlier += stats.norm.logpdf(
                wrapped(seen.bearing[k] - bearing - seen.bearing_bias[j]), 0.0, seen.bearing_std[j]
            )
            outlier -= math.log(2.0 * math.pi)
        if not math.isnan(seen.size[k]):
            ideal = seen.size_constant[j] / distance**2
            inlier += stats.norm.logpdf(seen.size[k], ideal, seen.size_std[j] * ideal)
            outlier -= math.log(seen.size_constant[j])
        share = seen.outlier_weight[j]
        value += inlier if share == 0.0 else np.logaddexp(math.log1p(-share) + inlier, math.log(share) + outlier)
    return float(value)
