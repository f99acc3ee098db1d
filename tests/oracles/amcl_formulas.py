"""The formulas of nav2_amcl and of beluga, written again from their sources, for one pose at a time.

Sources: nav2_amcl, src/sensors/laser and src/motion_model; beluga, include/beluga/sensor, motion and views. Distances
are exact here: both programs spread them from cell to cell, which can be off by a fraction of a cell.
"""

from __future__ import annotations

import math

import numpy as np


def nav2_step(rays, max_beams):
    """Every how many rays ``likelihood_field`` and ``beam`` of nav2 read one."""
    return max((rays - 1) // (max_beams - 1), 1)


def nav2_prob_step(rays, max_beams):
    """Every how many rays ``likelihood_field_prob`` of nav2 reads one."""
    return max(math.ceil(rays / max_beams), 1)


def beluga_rays(rays, max_beams):
    """Rays that beluga reads: take_evenly."""
    if max_beams >= rays:
        return list(range(rays))
    if max_beams == 1:
        return [0]
    return [-(-k * (rays - 1) // (max_beams - 1)) for k in range(max_beams)]


def _end_point(pose, mount, reading, angle):
    x, y, heading = pose
    mx, my, turned = mount
    at = (x + mx * math.cos(heading) - my * math.sin(heading), y + mx * math.sin(heading) + my * math.cos(heading))
    direction = heading + turned + angle
    return at[0] + reading * math.cos(direction), at[1] + reading * math.sin(direction)


def nav2_likelihood_field(pose, scan, angles, yaml, distance, *, mount=(0.0, 0.0, 0.0), scan_max=math.inf, prob=True):
    """Log weight of one particle.

    `distance` (x, y) returns how far a point is from the nearest obstacle, None outside the map.
    """
    range_max = min(scan_max, yaml["laser_max_range"]) if yaml["laser_max_range"] > 0.0 else scan_max
    sigma = yaml["sigma_hit"]
    step = (nav2_prob_step if prob else nav2_step)(len(scan), yaml["max_beams"])
    log_product, cubes = 0.0, 1.0
    for i in range(0, len(scan), step):
        reading = range_max if scan[i] <= yaml["laser_min_range"] else scan[i]
        if math.isnan(reading) or reading >= range_max:
            continue
        far = distance(*_end_point(pose, mount, reading, angles[i]))
        limit = yaml["laser_likelihood_max_dist"]
        z = limit if far is None else min(far, limit)
        p = yaml["z_hit"] * math.exp(-(z * z) / (2.0 * sigma * sigma)) + yaml["z_rand"] / range_max
        assert 0.0 <= p <= 1.0  # as nav2 asserts
        log_product += math.log(p)
        cubes += p**3
    return log_product if prob else math.log(cubes)


def beluga_likelihood_field_prob(pose, scan, angles, yaml, distance, *, mount=(0.0, 0.0, 0.0)):
    """Log weight of one particle."""
    sigma, far_away = yaml["sigma_hit"], yaml["laser_max_range"]
    total = 0.0
    for i in beluga_rays(len(scan), yaml["max_beams"]):
        if math.isnan(scan[i]) or not yaml["laser_min_range"] <= scan[i] <= far_away:
            continue
        z = distance(*_end_point(pose, mount, scan[i], angles[i]))
        if z is None:
            total += math.log(1.0 / far_away)
            continue
        z = min(z, yaml["laser_likelihood_max_dist"])
        amplitude = yaml["z_hit"] / (sigma * math.sqrt(2.0 * math.pi))
        total += math.log(amplitude * math.exp(-z * z / (2.0 * sigma * sigma)) + yaml["z_rand"] / far_away)
    return total


def nav2_beam(reading, expected, yaml):
    """Mixture of one reading in nav2's model ``beam``."""
    z = reading - expected
    p = yaml["z_hit"] * math.exp(-(z * z) / (2.0 * yaml["sigma_hit"] ** 2))
    if z < 0.0:
        p += yaml["z_short"] * yaml["lambda_short"] * math.exp(-yaml["lambda_short"] * reading)
    if reading == yaml["laser_max_range"]:
        p += yaml["z_max"]
    if reading < yaml["laser_max_range"]:
        p += yaml["z_rand"] / yaml["laser_max_range"]
    return p


def beluga_beam(reading, expected, yaml):
    """Mixture of one reading in beluga's model ``beam``."""
    sigma, far_away, rate = yaml["sigma_hit"], yaml["laser_max_range"], yaml["lambda_short"]
    root = math.sqrt(2.0) * sigma
    eta = 2.0 / (math.erf((far_away - expected) / root) - math.erf(-expected / root))
    d = (reading - expected) / sigma
    p = yaml["z_hit"] * eta * math.exp(-0.5 * d * d) / (math.sqrt(2.0 * math.pi) * sigma)
    if reading < expected:
        p += yaml["z_short"] * rate * math.exp(-rate * reading) / (1.0 - math.exp(-rate * expected))
    return p + (yaml["z_rand"] / far_away if reading < far_away else yaml["z_max"])


def _wrapped(angle):
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def _folded(angle):
    return min(abs(_wrapped(angle)), abs(_wrapped(angle - math.pi)))


def differential_step(increment, alphas):
    """Mean and standard deviation of (first rotation, translation, second rotation), alike in nav2 and beluga.

    `increment` is the odometry's step in the robot's frame before it. The translation's threshold of 0.01 m is both
    programs'; at exactly 0.01 m they differ.
    """
    forward, left, turn = increment
    a1, a2, a3, a4 = alphas[:4]
    way = math.hypot(forward, left)
    first = 0.0 if way < 0.01 else math.atan2(left, forward)
    second = _wrapped(turn - first)
    r1, r2 = _folded(first), _folded(second)
    return (first, way, second), (
        math.sqrt(a1 * r1**2 + a2 * way**2),
        math.sqrt(a3 * way**2 + a4 * (r1**2 + r2**2)),
        math.sqrt(a1 * r2**2 + a2 * way**2),
    )


def omni_step(increment, alphas, *, folds):
    """Mean and standard deviation of (translation, rotation, strafe); beluga folds rotations, nav2 does not."""
    forward, left, turn = increment
    a1, a2, a3, a4, a5 = alphas
    way = math.hypot(forward, left)
    rotated = _folded(turn) if folds else turn
    return (way, turn, 0.0), (
        math.sqrt(a3 * way**2 + a4 * rotated**2),
        math.sqrt(a1 * rotated**2 + a2 * way**2),
        math.sqrt(a4 * rotated**2 + a5 * way**2),
    )


def sample_differential(pose, increment, alphas, rng, n):
    """Draw n poses after a step, shape (n, 3)."""
    mean, sd = differential_step(increment, alphas)
    first, way, second = (m - s * rng.standard_normal(n) for m, s in zip(mean, sd, strict=True))
    x, y, heading = pose
    return np.column_stack([
        x + way * np.cos(heading + first), y + way * np.sin(heading + first), heading + first + second,
    ])  # fmt: skip


def sample_omni(pose, increment, alphas, rng, n, *, folds):
    """Draw n poses after a step, shape (n, 3)."""
    mean, sd = omni_step(increment, alphas, folds=folds)
    way, turned, strafe = (m + s * rng.standard_normal(n) for m, s in zip(mean, sd, strict=True))
    bearing = math.atan2(increment[1], increment[0]) + pose[2]
    c, s = math.cos(bearing), math.sin(bearing)
    return np.column_stack([pose[0] + way * c + strafe * s, pose[1] + way * s - strafe * c, pose[2] + turned])
