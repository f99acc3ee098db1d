"""How well each way to read a log explains it: a particle filter for all of them at once, with wide and robust noise.

The evidence of a way to read the log is the mean over nine pairs of noise levels of what a bootstrap filter estimates,
so a log that is only noisy has its explanation. Densities are of the numbers as they stand in the file: what reads
them in another unit carries the factor of that unit. The evidences of two ways to read one log can therefore be
compared, and under the right one the ratio of a wrong one to it is a nonnegative martingale over the rows of
expectation one; Ville's inequality bounds how often it ever becomes large.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from pmcl.geometry import compose
from pmcl.logs.arrays import LogArrays
from pmcl.models.quick import QuickDensity, QuickReadings
from pmcl.preflight.hypotheses import Hypothesis

__all__ = ["LEVELS", "Evidence", "evidence_of"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

LEVELS = (0.4, 1.5, 5.0)
"""Noise levels as multiples of the mean of the priors, for motion and for readings; gamma priors of shape 2 have 95 %
between 0.12 and 2.8."""

# How much wider than stated the start may be: robots are placed less exactly than people believe.
_START_FACTOR = 2.0
# Ways to read the log that fall so far behind the best [nat] do not come back within the rows that are left.
_HOPELESS = 40.0
# The same where the start is not known: which particles happen to be near the robot decides the first rows [nat].
_HOPELESS_ANYWHERE = 200.0
# Noise levels that fall so far behind the best one of their way to read the log no longer count in the mean [nat].
_NEGLIGIBLE = 20.0
_ROWS_BETWEEN_CUTS = 5
# A robot that may start anywhere is looked for among so many poses, for one way to read the log and for all together,
# by so many rows.
_CANDIDATES, _CANDIDATES_IN_ALL, _ROWS_TO_FIND = 100_000, 600_000, 4
# A robot whose odometry says nothing moves as far as that odometry claims, but no further in one row [m, rad].
_LONGEST_STEP, _LONGEST_TURN = 1.0, 1.5


class Evidence(NamedTuple):
    """Evidence of each way to read the log.

    Attributes
    ----------
    rows : ndarray, shape (H, K)
        Log evidence of the readings of each row given those before [nat]; NaN from the row on at which a way was
        given up as hopeless.
    levels : ndarray, shape (3, 3)
        Log evidence [nat] of the log as it is, by level of motion noise and of reading noise.
    """

    rows: Float
    levels: Float


class _Groups(NamedTuple):
    """Particles of each pair of way to read the log (of H) and noise levels, (G,) and (G, n)."""

    way: Int
    motion: Int
    sensor: Int
    total: Float
    x: Float
    y: Float
    heading: Float

    def kept(self, keep: NDArray[np.bool_]) -> _Groups:
        way, motion, sensor = (values[keep] for values in self[:3])
        total, x, y, heading = (values[keep] for values in self[3:])
        return _Groups(way, motion, sensor, total, x, y, heading)


def evidence_of(
    log: LogArrays,
    readings: Mapping[str, QuickReadings],
    rows: Int,
    ways: Sequence[Hypothesis],
    motion_noise: Float,
    particles: int,
    seed: int,
) -> Evidence:
    """Filter a stretch of a log under each way to read it.

    Parameters
    ----------
    log : LogArrays
        The log.
    readings : mapping of str to QuickReadings
        Of its sensors, by their registered names.
    rows : ndarray of int, shape (K,)
        Rows of it that are looked at.
    ways : sequence of Hypothesis
        H ways to read it; the first is the log as it is, which is never given up.
    motion_noise : ndarray, shape (3,)
        Usual standard deviations of one increment: forward, left, turn [m, m, rad].
    particles : int
        For each way and pair of noise levels.
    seed : int
        The result is a function of it.

    Returns
    -------
    Evidence

    Notes
    -----
    Costs O(9 H particles) for the first rows, and a small part of it once the hopeless ways are given up.
    """
    rng = np.random.default_rng(seed)
    n_ways, n_rows = len(ways), rows.size
    increments, counts = _increments(ways, rows)
    wander = _wander(ways, rows)
    densities = [read.under([way.for_sensor(name) for way in ways]) for name, read in readings.items()]
    level = np.array(LEVELS)
    groups = _started(log, readings, ways, particles, rng)
    correction = np.zeros_like(groups.x)
    looked_for = not np.isfinite(log.start_std[:2]).all() and any(
        read.free_places() is not None for read in readings.values()
    )
    n_candidates = min(_CANDIDATES, _CANDIDATES_IN_ALL // n_ways)
    for h, way in enumerate(ways):
        if way.start_anywhere or looked_for:
            mine = groups.way == h
            found, correction[mine] = _found(
                readings, way, densities, h, rows, increments[h], n_candidates, particles, rng
            )
            for values, column in zip((groups.x, groups.y, groups.heading), found.T, strict=True):
                values[mine] = column
    placed = np.isfinite(log.start_std).all() and not any(way.start_anywhere for way in ways)
    hopeless = _HOPELESS if placed else _HOPELESS_ANYWHERE
    gained = np.full((n_ways, n_rows), np.nan)
    before = np.zeros(n_ways)
    for k, row in enumerate(rows.tolist()):
        groups = _moved(groups, increments[:, k], counts[k], motion_noise, wander[:, k], rng)
        log_weight = np.zeros_like(groups.x)
        for density in densities:
            log_weight += density(row, groups.way, level[groups.sensor], groups.x, groups.y, groups.heading)
        if k == 0:
            log_weight += correction
        best = log_weight.max(axis=1, keepdims=True)
        weight = np.exp(log_weight - best)
        total = groups.total + best[:, 0] + np.log(weight.mean(axis=1))
        groups = _resampled(groups._replace(total=total), weight, rng)
        alive = np.unique(groups.way)
        now = np.array([logsumexp(total[groups.way == way]) for way in alive]) - 2.0 * math.log(len(LEVELS))
        gained[alive, k] = now - before[alive]
        before[alive] = now
        if k % _ROWS_BETWEEN_CUTS == _ROWS_BETWEEN_CUTS - 1 and n_ways > 1:
            reached = dict(zip(alive.tolist(), now.tolist(), strict=True))
            groups = groups.kept(_worth_going_on(groups, reached, hopeless))
    levels = np.full((len(LEVELS), len(LEVELS)), -np.inf)
    plain = groups.way == 0
    levels[groups.motion[plain], groups.sensor[plain]] = groups.total[plain]
    return Evidence(gained, levels)


def _increments(ways: Sequence[Hypothesis], rows: Int) -> tuple[Float, Int]:
    """Return what each way says of the motion before each chosen row, (H, K, 3), and of how many rows it is, (K,)."""
    out = np.empty((len(ways), rows.size, 3))
    earlier = np.concatenate(([0], rows[:-1]))
    for h, way in enumerate(ways):
        steps = np.array(way.odometry[: rows[-1] + 1])
        steps[0] = 0.0
        heading = np.cumsum(steps[:, 2])
        at = np.concatenate(([0.0], heading[:-1]))
        x = np.cumsum(np.cos(at) * steps[:, 0] - np.sin(at) * steps[:, 1])
        y = np.cumsum(np.sin(at) * steps[:, 0] + np.cos(at) * steps[:, 1])
        dx, dy, turn = x[rows] - x[earlier], y[rows] - y[earlier], heading[rows] - heading[earlier]
        facing = heading[earlier]
        out[h, :, 0] = np.cos(facing) * dx + np.sin(facing) * dy
        out[h, :, 1] = np.cos(facing) * dy - np.sin(facing) * dx
        out[h, :, 2] = turn
    return out, rows - earlier


def _wander(ways: Sequence[Hypothesis], rows: Int) -> Float:
    """Return the noise of motions about which odometry says nothing, (H, K, 3): as large as the motions it claims."""
    count = np.diff(rows, prepend=0)
    plain = ways[0].odometry[1 : rows[-1] + 1]
    out = np.zeros((len(ways), rows.size, 3))
    if not len(plain):
        return out
    step = math.sqrt(float(np.mean(plain[:, 0] ** 2 + plain[:, 1] ** 2)))
    turn = math.sqrt(float(np.mean(plain[:, 2] ** 2)))
    size = np.array([min(step, _LONGEST_STEP), min(step, _LONGEST_STEP), min(turn, _LONGEST_TURN)])
    for h, way in enumerate(ways):
        if way.says_nothing:
            out[h] = np.sqrt(count)[:, None] * size
    return out


def _started(
    log: LogArrays,
    readings: Mapping[str, QuickReadings],
    ways: Sequence[Hypothesis],
    n: int,
    rng: np.random.Generator,
) -> _Groups:
    levels = np.arange(len(LEVELS))
    way, motion, sensor = (axis.ravel() for axis in np.meshgrid(np.arange(len(ways)), levels, levels, indexing="ij"))
    poses = np.empty((len(ways), n, 3))
    known = np.isfinite(log.start_std)
    draw = rng.standard_normal((n, 3))
    anywhere = rng.random((n, 3))
    for h, hypothesis in enumerate(ways):
        here = np.where(known, log.start_mean, 0.0) + np.where(known, _START_FACTOR * log.start_std, 0.0) * draw
        if hypothesis.with_start:
            here = _mapped(hypothesis, here)
        if not known[2]:
            here[:, 2] = 2.0 * np.pi * anywhere[:, 2]
        if not (known[0] and known[1]):
            here[:, :2] = _places(readings, hypothesis, anywhere)
        poses[h] = here
    states = poses[way]
    return _Groups(way, motion, sensor, np.zeros(way.size), *(states[..., k].copy() for k in range(3)))


def _mapped(way: Hypothesis, poses: Float) -> Float:
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ahead = np.stack((c, s), axis=1) @ way.map_matrix.T
    return np.column_stack((poses[:, :2] @ way.map_matrix.T + way.map_shift, np.arctan2(ahead[:, 1], ahead[:, 0])))


def _found(
    readings: Mapping[str, QuickReadings],
    way: Hypothesis,
    densities: Sequence[QuickDensity],
    h: int,
    rows: Int,
    increments: Float,
    n_candidates: int,
    n: int,
    rng: np.random.Generator,
) -> tuple[Float, Float]:
    """Look for a robot anywhere on the map, by the first rows.

    Way number `h` has the `increments` (K, 3). Returns poses (n, 3) and the logs of the weights (n,) that make them
    draws from anywhere on the map (importance sampling): the evidence stays an unbiased estimate.
    """
    places = _places(readings, way, rng.random((n_candidates, 2)))
    poses = np.column_stack((places, 2.0 * np.pi * rng.random(n_candidates)))
    levels = np.array(LEVELS[1:])
    log_density = np.zeros((levels.size, n_candidates))
    now = poses
    for k, row in enumerate(rows[:_ROWS_TO_FIND].tolist()):
        now = compose(now, increments[k]) if k else now
        x, y, heading = (np.broadcast_to(column, log_density.shape) for column in now.T)
        for density in densities:
            log_density += density(row, np.full(levels.size, h), levels, x, y, heading)
    # Little noise finds a robot near a candidate, much noise one that is further from all of them.
    share = np.exp(log_density - logsumexp(log_density, axis=1, keepdims=True)).mean(axis=0)
    cumulative = np.cumsum(share)
    chosen = np.searchsorted(cumulative, (np.arange(n) + rng.random()) / n * cumulative[-1])
    chosen = np.minimum(chosen, n_candidates - 1)
    return poses[chosen], -np.log(n_candidates * share[chosen])


def _places(readings: Mapping[str, QuickReadings], way: Hypothesis, uniform: Float) -> Float:
    """Return where robots may be on the map as a way reads it, (n, 2), by uniform numbers (n, >= 2)."""
    read, points = next((read, points) for read in readings.values() if (points := read.map_points()) is not None)
    places = read.free_places()
    if places is not None:
        chosen = places[(uniform[:, 0] * len(places)).astype(np.int64)]
        return np.asarray(chosen @ way.map_matrix.T + way.map_shift)
    points = points @ way.map_matrix.T + way.map_shift
    low, high = points.min(axis=0) - read.margin(), points.max(axis=0) + read.margin()
    return np.asarray(low + (high - low) * uniform[:, :2])


def _moved(
    groups: _Groups, increment: Float, count: int, typical: Float, wander: Float, rng: np.random.Generator
) -> _Groups:
    """Move all particles by the increments (H, 3) of each way; `count` rows' noise adds up."""
    if count == 0:
        return groups
    way = groups.way
    level = np.array(LEVELS)[groups.motion, None]
    std = np.sqrt(count * (level * typical) ** 2 + wander[way] ** 2)
    noise = rng.standard_normal((3, *groups.x.shape))
    forward, left, turn = (increment[way, k, None] + std[:, k, None] * noise[k] for k in range(3))
    # The noise acts on the way there, too: half of the turn's is in the heading at which a long step is taken.
    facing = groups.heading + (0.5 * std[:, 2, None] * noise[2] if count > 1 else 0.0)
    c, s = np.cos(facing), np.sin(facing)
    return groups._replace(
        x=groups.x + c * forward - s * left, y=groups.y + s * forward + c * left, heading=groups.heading + turn
    )


def _resampled(groups: _Groups, weight: Float, rng: np.random.Generator) -> _Groups:
    """Draw particles by their weights (G, n), systematically within each group."""
    n_groups, n = weight.shape
    cumulative = np.cumsum(weight, axis=1)
    cumulative /= cumulative[:, -1:]
    group = np.arange(n_groups)[:, None]
    asked = (np.arange(n) + rng.random()) / n
    index = np.searchsorted((cumulative + group).ravel(), (asked + group).ravel())
    index = np.minimum(index.reshape(n_groups, n), (group + 1) * n - 1)
    return groups._replace(x=groups.x.ravel()[index], y=groups.y.ravel()[index], heading=groups.heading.ravel()[index])


def _worth_going_on(groups: _Groups, now: dict[int, float], hopeless: float) -> NDArray[np.bool_]:
    """Tell which groups may still matter (G,); all of the log as it is do."""
    leading = max(now.values())
    best = {way: groups.total[groups.way == way].max() for way in now}
    return np.array(
        [
            way == 0 or (now[way] > leading - hopeless and total > best[way] - _NEGLIGIBLE)
            for way, total in zip(groups.way.tolist(), groups.total.tolist(), strict=True)
        ]
    )
