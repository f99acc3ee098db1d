"""Densities of motion, start and sensors written again from the tables' docstrings: slow, plain, with scipy.stats."""

from __future__ import annotations

import math

import numpy as np
import shapely
from scipy import stats

from pmcl.engine.tables import FieldView
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


def range_readings_with_extras(beams: RangeBeams, t, before, now):
    """Log density of all readings at time t, `before` and `now` being the poses at t - 1 and t."""
    view = FieldView(beams)
    pose = now - view.lag[t] * (now - before)
    value = 0.0
    for b in range(beams.reading.shape[1]):
        if not math.isnan(beams.reading[t, b]):
            value += math.log(_range_density(view, t, b, before, pose))
    return value


def _range_density(view, t, b, before, pose):
    """Density of one reading, or its probability where it is clipped; the components in the order of the docstring."""
    z, longest = view.reading[t, b], view.max_range
    length = _nearest_in_cone(view, b, pose)
    expected, std = _expected(view, t, b, length), _std(view, t, b, length)
    centre, width = expected, std
    last = view.reading[t - 1, b] if t > 0 and view.correlation[b] != 0.0 else math.nan
    if 0.0 < last < longest:
        length_before = _nearest_in_cone(view, b, before)
        error = last - _expected(view, t - 1, b, length_before)
        if abs(error) < 4.0 * _std(view, t - 1, b, length_before):
            centre, width = centre + view.correlation[b] * error, width * math.sqrt(1.0 - view.correlation[b] ** 2)
    density = _echo_density(view, z, centre, width)
    left, right = (_nearest_in_cone(view, k, pose) for k in view.neighbours[b])
    talk = 0.5 * view.talk_weight[b]
    density = (1.0 - 2.0 * talk) * density + sum(
        talk * _echo_density(view, z, _expected(view, t, b, other), std) for other in (left, right)
    )
    origin = place(pose, view.beam_pose[b])
    for x, y, radius, weight in view.obstacles:
        distance = _disc_distance(origin, x, y, radius)
        if distance < length:
            density += weight * (_echo_density(view, z, _expected(view, t, b, distance), std) - density)
    edge = (view.specular_angle - _incidence(view, origin)) / 0.1
    weight = view.specular_weight[b] / (1.0 + math.exp(edge))
    room = longest - max(expected, 0.0)
    detour = stats.uniform(longest - room, room).pdf(z) * (z < longest) if room > 0.1 * longest else float(z >= longest)
    density += weight * (detour - density)
    short = stats.truncexpon(max(min(expected, longest), 0.01) / view.short_length, scale=view.short_length)
    density += view.short_weight[b] * ((short.pdf(z) if 0.0 < z < longest else 0.0) - density)
    density += view.no_echo_weight[b] * (float(z >= longest) - density)
    return density + view.outlier_weight[b] * ((1.0 / longest if 0.0 < z < longest else 0.0) - density)


def _nearest_in_cone(view, b, pose):
    turns = np.linspace(-0.5, 0.5, 5) * view.width[b] if view.width[b] > 0.0 else [0.0]
    return min(ray_length(view, place(pose, view.beam_pose[b] + np.array([0.0, 0.0, turn]))) for turn in turns)


def _expected(view, t, b, length):
    return min(view.scale[b] * length + view.bias[b] + view.bias_at[t, b], 2.0 * view.max_range)


def _std(view, t, b, length):
    return view.std[b] * view.std_factor[t] * (1.0 + view.growth[b] * min(length, view.max_range))


def _echo_density(view, z, centre, std):
    noise = stats.norm(centre, std) if view.tail == 0.0 else stats.t(1.0 / view.tail, centre, std)
    shortest, longest = rounding_ends(view)
    if z <= 0.0 or z < shortest:
        return noise.cdf(shortest)
    if z >= longest:
        return noise.sf(longest)
    if view.step == 0.0:
        return noise.pdf(z)
    low, high = round(z / view.step) * view.step + 0.5 * view.step * np.array([-1.0, 1.0])
    high = min(high, view.max_range)
    return (noise.cdf(high) - noise.cdf(low)) / (high - low)


def rounding_ends(view):
    """Where echoes begin to be printed as something else than 0, and where as the greatest range."""
    if view.step == 0.0:
        return 0.0, view.max_range
    nearest = round(view.max_range / view.step) * view.step
    return 0.5 * view.step, nearest - 0.5 * view.step if nearest > view.max_range - 1e-9 else view.max_range


def _disc_distance(origin, x, y, radius):
    """Distance to a disc along a ray; inf where it passes by, or begins in the disc."""
    centre = shapely.Point(x, y)
    begin, tip = origin[:2], origin[:2] + FAR * np.array([math.cos(origin[2]), math.sin(origin[2])])
    aside = shapely.LineString([begin, tip]).distance(centre)
    away = shapely.Point(begin).distance(centre)
    if aside >= radius or away <= radius:
        return math.inf
    return math.sqrt(away**2 - aside**2) - math.sqrt(radius**2 - aside**2)


def _incidence(view, origin):
    """Angle between a ray and the normal of the wall that it meets first; 0 without one."""
    direction = np.array([math.cos(origin[2]), math.sin(origin[2])])
    ray, found = shapely.LineString([origin[:2], origin[:2] + FAR * direction]), (math.inf, 0.0)
    for start, stop in zip(view.vertices[view.wall_start], view.vertices[view.wall_stop], strict=True):
        met = ray.intersection(shapely.LineString([start, stop]))
        if not met.is_empty:
            wall = (stop - start) / np.hypot(*(stop - start))
            sine = min(abs(float(direction @ wall)), 1.0)
            found = min(found, (met.distance(shapely.Point(origin[:2])), math.asin(sine)))
    return found[1]


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
