"""AMCL's odometry models written again from their definitions: slow, plain, with scipy; floors are arguments."""

from __future__ import annotations

import math

import numpy as np
from oracles.densities import wrapped
from scipy import integrate, stats

# Standard deviations that pmcl adds in squares: of the drive [m], of the heading [rad], and of the direction [rad] of a
# drive of no length, which falls with the square of the distance and is halved at 1 cm.
FLOORS = (1e-3, 1e-3, 0.1)
NO_FLOORS = (0.0, 0.0, 0.0)


# Full turns that are summed over.
FULL_TURNS = np.arange(-4, 5)


def normal(error, std):
    """Density of a Gaussian error."""
    return np.exp(-0.5 * (error / std) ** 2) / (std * math.sqrt(2.0 * math.pi))


def folded(angle):
    """The smaller of the angles to the robot's front and to its back."""
    return min(abs(wrapped(angle)), abs(wrapped(angle - math.pi)))


def differential_noise(mean, alpha, floors=FLOORS):
    """First turn, distance, second turn, and the standard deviations of their noise; the last is of the direction."""
    forward, left, turn = mean
    distance = math.hypot(forward, left)
    first = math.atan2(left, forward) if distance >= 0.01 else 0.0
    second = turn - first
    a, b = folded(first), folded(second)
    variances = np.array([
        alpha[0] * a**2 + alpha[1] * distance**2,
        alpha[2] * distance**2 + alpha[3] * (a**2 + b**2) + floors[0] ** 2,
        alpha[0] * b**2 + alpha[1] * distance**2 + floors[1] ** 2,
    ])  # fmt: skip
    return first, distance, second, np.array([*np.sqrt(variances), floors[2] / (1.0 + (distance / 0.01) ** 2)])


def differential_draws(mean, alpha, pose, n, rng, floors=FLOORS):
    """Poses (n, 3) after one step, drawn turn by turn."""
    first, distance, second, std = differential_noise(mean, alpha, floors)
    noise = rng.standard_normal((4, n)) * std[:, None]
    r1, t, r2 = first - noise[0], distance - noise[1], second - noise[2]
    direction = pose[2] + r1 + noise[3]
    return np.column_stack([pose[0] + t * np.cos(direction), pose[1] + t * np.sin(direction), pose[2] + r1 + r2])


def differential_density(mean, alpha, before, after, floors=FLOORS):
    """Density of a step: for each first turn that leads there, those of the three noises, over the distance."""
    first, distance, second, std = differential_noise(mean, alpha, floors)
    dx, dy, turned = np.subtract(after, before)
    length, direction = math.hypot(dx, dy), math.atan2(dy, dx) - before[2]

    def given(aside):
        total = 0.0
        for drive, reached in ((length, direction), (-length, direction + math.pi)):
            # A second turn makes good whatever full turns the first one has too many.
            r1 = first + wrapped(reached - aside - first) + 2.0 * math.pi * FULL_TURNS
            total += normal(drive - distance, std[1]) * np.sum(
                normal(r1 - first, std[0]) * normal(turned - r1 - second, std[2])
            )
        return total * normal(aside, std[3])

    def without_first_noise():
        total = 0.0
        for drive, reached in ((length, direction), (-length, direction + math.pi)):
            aside = wrapped(reached - first) + 2.0 * math.pi * FULL_TURNS
            total += normal(drive - distance, std[1]) * np.sum(normal(aside, std[3]))
        return total * normal(turned - first - second, std[2])

    if std[0] == 0.0:
        return without_first_noise() / length
    edge = 15.0 * std[3]
    peaks = [wrapped(reached - first) for reached in (direction, direction + math.pi)]
    places = [peak + side * std[0] for peak in peaks for side in (-3.0, 0.0, 3.0)]
    inside = sorted({0.0, *(place for place in places if abs(place) < edge)})
    value, _ = integrate.quad(given, -edge, edge, epsabs=0.0, epsrel=1e-8, limit=400, points=inside)
    return value / length


def omni_noise(mean, alpha, floors=FLOORS):
    """Standard deviations along and across the step, and of the turn."""
    square, turn = mean[0] ** 2 + mean[1] ** 2, wrapped(mean[2]) ** 2
    return np.sqrt([
        alpha[2] * square + alpha[3] * turn + floors[0] ** 2,
        alpha[4] * square + alpha[3] * turn + floors[0] ** 2,
        alpha[0] * turn + alpha[1] * square + floors[1] ** 2,
    ])  # fmt: skip


def omni_density(mean, alpha, before, after, floors=FLOORS):
    """Density of a step of an omnidirectional drive."""
    bearing = before[2] + math.atan2(mean[1], mean[0])
    dx, dy, turned = np.subtract(after, before)
    along = dx * math.cos(bearing) + dy * math.sin(bearing)
    strafe = dx * math.sin(bearing) - dy * math.cos(bearing)
    std = omni_noise(mean, alpha, floors)
    return float(np.prod(stats.norm.pdf([along, strafe, turned], [math.hypot(mean[0], mean[1]), 0.0, mean[2]], std)))
