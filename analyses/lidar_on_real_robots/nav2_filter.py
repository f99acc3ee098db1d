"""The particle filter of nav2_amcl, written again from its sources, with other ways to weigh a scan beside its own.

Sources: nav2_amcl of navigation2 (main branch, July 2024): src/sensors/laser, src/motion_model, src/map, src/pf and
amcl_node.cpp.

Kept:

- beam selection, each model by its own rule; readings at the greatest range do not count in a likelihood field;
- points are looked up in the cell whose corner, not whose centre, nav2 takes for its place: half a cell off;
- a reading that ends off the map counts as one at ``laser_likelihood_max_dist``;
- rays of the beam model by Bresenham's line, which unknown cells and the edge of the map end;
- weights as products of doubles, which may underflow; where all are zero, the scan is ignored;
- the differential motion model; resampling after every scan, multinomial, with the number of particles by KLD-sampling
  (bins of 0.5 m and 10 degrees, pf_err 0.05, pf_z 0.99, 500 to 2000 particles).

Left out:

- distances from cell to cell: those here are exact, nav2's can be off by a fraction of a cell;
- clusters: the estimate is the weighted mean of all particles, before resampling. nav2 publishes the mean of the
  heaviest cluster after it; a robot that is tracked has one cluster, and the difference is the noise of resampling;
- random particles (recovery_alpha_slow, recovery_alpha_fast) and beam skipping: off by default.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from scipy import ndimage

BIN_SIZE, BIN_TURN = 0.5, math.radians(10.0)
PF_ERR, PF_Z = 0.05, 0.99
LEAST, MOST = 500, 2000
"""Numbers of nav2's KLD-sampling; all but the bins are parameters, at their defaults."""

CUBES, PRODUCT = 0, 1
"""Ways to combine the beams of a scan: 1 + sum of cubes (likelihood_field, beam), product (likelihood_field_prob)."""


MAX_DIST = 2.0
"""laser_likelihood_max_dist [m]: how far a reading that ends off the map counts as being from any wall."""


class GridOfNav2(NamedTuple):
    """A map as nav2 keeps it: distance [m] of each cell, side of a cell [m], corner [m].

    `free_steps` is how many cells in a row, in whatever direction, the nearest cell that ends a ray is away.
    """

    distance: np.ndarray
    free_steps: np.ndarray
    resolution: float
    x0: float
    y0: float


class Settings(NamedTuple):
    """Parameters in nav2's names, and three that nav2 does not have.

    `exponent` tempers a product. `hit_height` multiplies exp(-d^2 / (2 sigma^2)): nav2's z_hit, or beluga's
    z_hit / (sigma sqrt(2 pi)). `beam` chooses the beam model instead of the likelihood field.
    """

    alphas: tuple[float, float, float, float]
    sigma_hit: float
    z_hit: float
    z_rand: float
    rule: int
    beam: bool = False
    z_short: float = 0.05
    z_max: float = 0.05
    lambda_short: float = 0.1
    laser_max_range: float = 100.0
    max_beams: int = 60
    exponent: float = 1.0
    beluga: bool = False

    @property
    def hit_height(self) -> float:
        return self.z_hit / (self.sigma_hit * math.sqrt(2.0 * math.pi)) if self.beluga else self.z_hit


class Scan(NamedTuple):
    """The beams of one scan that are read: ranges [m], bearings in the robot's frame [rad], and where the laser is."""

    ranges: np.ndarray
    bearings: np.ndarray
    x: float
    y: float
    max_range: float


class Run(NamedTuple):
    """What a filter believed at each of T rows.

    `mean` (T, 3) and `covariance` (T, 3, 3) after the scan, effective sample size `ess` (T,), number of particles `n`
    (T,), whether all weights were zero `ignored` (T,), and the particles before the scan, `predicted` (T, MOST, 3).
    """

    mean: np.ndarray
    covariance: np.ndarray
    ess: np.ndarray
    n: np.ndarray
    ignored: np.ndarray
    predicted: np.ndarray


def grid_of_nav2(grid, *, centred: bool = False) -> GridOfNav2:
    """Take a map; nav2 knows no turned ones. With `centred`, points are looked up in the cell that they lie in."""
    assert grid.origin[2] == 0.0
    distance = np.ascontiguousarray(np.minimum(grid.distance_field, MAX_DIST))
    free = np.pad(grid.cells == grid.FREE, 1)
    steps = ndimage.distance_transform_cdt(free, "chessboard")[1:-1, 1:-1]
    shift = 0.5 * grid.resolution if centred else 0.0
    x0, y0 = grid.origin[0] + shift, grid.origin[1] + shift
    return GridOfNav2(distance, np.ascontiguousarray(steps, dtype=np.int32), grid.resolution, x0, y0)


def scan_of(ranges, angles, pose, max_range: float, settings: Settings) -> Scan:
    """Choose the beams that nav2 reads of a whole scan, and map what has no echo to the greatest range."""
    count, most = ranges.size, settings.max_beams
    field_prob = settings.rule == PRODUCT and not settings.beam
    step = max(math.ceil(count / most), 1) if field_prob else max((count - 1) // (most - 1), 1)
    reach = min(max_range, settings.laser_max_range)
    chosen = np.ascontiguousarray(ranges[::step], dtype=np.float64)
    chosen = np.where(np.isinf(chosen), reach, chosen)
    return Scan(chosen, np.ascontiguousarray(angles[::step]) + pose[2], float(pose[0]), float(pose[1]), reach)


@numba.njit(cache=True, nogil=True)
def cell_of(at, corner, resolution, size):
    """MAP_GXWX of nav2: the map's origin is in its middle, and half a cell is added."""
    return math.floor((at - (corner + (size // 2) * resolution)) / resolution + 0.5) + size // 2


@numba.njit(cache=True, nogil=True)
def range_on_map(grid, x, y, cosine, sine, max_range):
    """map_calc_range of nav2: Bresenham's line up to a cell that is not free, or to the edge.

    After k steps along the longer axis the line is floor((2 k dy + dx) / (2 dx)) across. So it need not be followed
    cell by cell: as many steps are taken at once as no such cell can be nearer.
    """
    rows, columns = grid.distance.shape
    x0, y0 = cell_of(x, grid.x0, grid.resolution, columns), cell_of(y, grid.y0, grid.resolution, rows)
    x1 = cell_of(x + max_range * cosine, grid.x0, grid.resolution, columns)
    y1 = cell_of(y + max_range * sine, grid.y0, grid.resolution, rows)
    steep = abs(y1 - y0) > abs(x1 - x0)
    if steep:
        x0, y0, x1, y1 = y0, x0, y1, x1
    dx, dy = abs(x1 - x0), abs(y1 - y0)
    step_x, step_y = 1 if x0 < x1 else -1, 1 if y0 < y1 else -1
    k = 0
    # nav2 looks one cell beyond the last.
    while k <= dx + 1:
        across = (2 * k * dy + dx) // (2 * dx) if dx else k
        u, v = x0 + step_x * k, y0 + step_y * across
        column, row = (v, u) if steep else (u, v)
        outside = row < 0 or column < 0 or row >= rows or column >= columns
        free_steps = 0 if outside else grid.free_steps[row, column]
        if free_steps == 0:
            return math.sqrt(k * k + across * across) * grid.resolution
        k += free_steps
    return max_range


_fields: dict = {}


def cell_densities(grid: GridOfNav2, settings: Settings, reach: float) -> np.ndarray:
    """Return what a beam that ends in each cell counts, cubed or as a logarithm; the last row is for beams off the map.

    Kept for the next scans of the same laser.
    """
    key = (id(grid.distance), settings, reach)
    if key not in _fields:
        if len(_fields) >= 4:
            _fields.pop(next(iter(_fields)))
        off_map = np.full((1, grid.distance.shape[1]), MAX_DIST)
        distance = np.vstack([grid.distance, off_map])
        p = settings.hit_height * np.exp(-(distance**2) / (2.0 * settings.sigma_hit**2)) + settings.z_rand / reach
        # The grid is kept with it, so that no other one gets its number.
        _fields[key] = (np.log(p) if settings.rule == PRODUCT else p**3, grid)
    return _fields[key][0]


@numba.njit(cache=True, nogil=True)
def add_end_points(grid, density, scan, particles, result):
    """Add the density of the cell in which each beam ends to `result`, particle by particle."""
    rows, columns = grid.distance.shape
    x0, y0 = grid.x0 + (columns // 2) * grid.resolution, grid.y0 + (rows // 2) * grid.resolution
    ahead, aside = np.cos(scan.bearings), np.sin(scan.bearings)
    for i in range(particles.shape[0]):
        x, y, heading = particles[i]
        c, s = math.cos(heading), math.sin(heading)
        x, y = x + c * scan.x - s * scan.y - x0, y + s * scan.x + c * scan.y - y0
        total = 0.0
        for k in range(scan.ranges.size):
            z = scan.ranges[k]
            # Written so that what was not measured does not count either.
            if z < scan.max_range:
                # MAP_GXWX of nav2: its origin is in the middle of the map, and half a cell is added.
                column = math.floor((x + z * (c * ahead[k] - s * aside[k])) / grid.resolution + 0.5) + columns // 2
                row = math.floor((y + z * (s * ahead[k] + c * aside[k])) / grid.resolution + 0.5) + rows // 2
                inside = row >= 0 and column >= 0 and row < rows and column < columns
                total += density[row, column] if inside else density[rows, 0]
        result[i] += total


@numba.njit(cache=True, nogil=True)
def add_cubes_of_beams(grid, scan, particles, sigma, height, z_short, z_max, z_rand, rate, result):
    """Add the cubes of nav2's beam model to `result`, particle by particle."""
    ahead, aside = np.cos(scan.bearings), np.sin(scan.bearings)
    for i in range(particles.shape[0]):
        x, y, heading = particles[i]
        c, s = math.cos(heading), math.sin(heading)
        x, y = x + c * scan.x - s * scan.y, y + s * scan.x + c * scan.y
        for k in range(scan.ranges.size):
            z = scan.ranges[k]
            if math.isnan(z):
                continue
            cosine, sine = c * ahead[k] - s * aside[k], s * ahead[k] + c * aside[k]
            d = z - range_on_map(grid, x, y, cosine, sine, scan.max_range)
            p = height * math.exp(-d * d / (2.0 * sigma * sigma))
            if d < 0.0:
                p += z_short * rate * math.exp(-rate * z)
            if z == scan.max_range:
                p += z_max
            if z < scan.max_range:
                p += z_rand / scan.max_range
            result[i] += p * p * p


def weigh(grid: GridOfNav2, scan: Scan, particles, settings: Settings) -> np.ndarray:
    """Return the log of what each particle's weight is multiplied by, shape (n,)."""
    result = np.zeros(len(particles))
    if settings.beam:
        add_cubes_of_beams(
            grid, scan, particles, settings.sigma_hit, settings.hit_height, settings.z_short, settings.z_max,
            settings.z_rand, settings.lambda_short, result,
        )  # fmt: skip
    else:
        add_end_points(grid, cell_densities(grid, settings, scan.max_range), scan, particles, result)
    return settings.exponent * result if settings.rule == PRODUCT else np.log1p(result)


@numba.njit(cache=True, nogil=True)
def wrapped(angle):
    return math.atan2(math.sin(angle), math.cos(angle))


@numba.njit(cache=True, nogil=True)
def move(particles, increment, a1, a2, a3, a4, rng):
    """Move particles (n, 3) by nav2's DifferentialMotionModel; `increment` is in the robot's frame before the step."""
    forward, left, turn = increment
    way = math.hypot(forward, left)
    first = 0.0 if way < 0.01 else math.atan2(left, forward)
    second = wrapped(turn - first)
    r1 = min(abs(wrapped(first)), abs(wrapped(first - math.pi)))
    r2 = min(abs(wrapped(second)), abs(wrapped(second - math.pi)))
    sd1 = math.sqrt(a1 * r1 * r1 + a2 * way * way)
    sd_way = math.sqrt(a3 * way * way + a4 * r1 * r1 + a4 * r2 * r2)
    sd2 = math.sqrt(a1 * r2 * r2 + a2 * way * way)
    for i in range(particles.shape[0]):
        turned = wrapped(first - sd1 * rng.standard_normal())
        went = way - sd_way * rng.standard_normal()
        particles[i, 0] += went * math.cos(particles[i, 2] + turned)
        particles[i, 1] += went * math.sin(particles[i, 2] + turned)
        particles[i, 2] += turned + wrapped(second - sd2 * rng.standard_normal())


@numba.njit(cache=True, nogil=True)
def resample(particles, weights, least, most, rng):
    """Draw particles until KLD-sampling has enough; return them, at most `most`."""
    total = np.cumsum(weights)
    drawn = np.empty((most, 3))
    bins = np.empty((most, 3), np.int64)
    n, k = 0, 0
    while n < most:
        parent = np.searchsorted(total, rng.random() * total[-1], side="right")
        drawn[n] = particles[min(parent, particles.shape[0] - 1)]
        x, y = math.floor(drawn[n, 0] / BIN_SIZE), math.floor(drawn[n, 1] / BIN_SIZE)
        turned = math.floor(drawn[n, 2] / BIN_TURN)
        n += 1
        known = False
        for j in range(k):
            if bins[j, 0] == x and bins[j, 1] == y and bins[j, 2] == turned:
                known = True
                break
        if not known:
            bins[k, 0], bins[k, 1], bins[k, 2] = x, y, turned
            k += 1
        if n > kld_limit(k, least, most):
            break
    return drawn[:n].copy()


@numba.njit(cache=True, nogil=True)
def kld_limit(k, least, most):
    """pf_resample_limit of nav2: for one bin, the greatest number."""
    if k <= 1:
        return most
    b = 2.0 / (9.0 * (k - 1))
    x = 1.0 - b + math.sqrt(b) * PF_Z
    return min(max(math.ceil((k - 1) / (2.0 * PF_ERR) * x**3), least), most)


def moments(particles, weights):
    """Return mean pose and covariance of weighted particles; headings on the circle."""
    mean = weights @ particles
    mean[2] = math.atan2(weights @ np.sin(particles[:, 2]), weights @ np.cos(particles[:, 2]))
    off = particles - mean
    off[:, 2] = np.arctan2(np.sin(off[:, 2]), np.cos(off[:, 2]))
    return mean, (off * weights[:, None]).T @ off


def run_filter(
    log, grid: GridOfNav2, settings: Settings, seed, *, start_mean, start_std, particles=(LEAST, MOST)
) -> Run:
    """Localize a log whose scans are whole, as nav2 does.

    Parameters
    ----------
    log : RobotLog
        With whole scans: nav2 chooses the beams.
    grid : GridOfNav2
        The map.
    settings : Settings
        The parameters.
    seed : int or sequence of int
        Of all random numbers.
    start_mean, start_std : array_like, shape (3,)
        Gaussian belief about the first pose [m, m, rad].
    particles : tuple of int
        Least and greatest number of particles.

    Returns
    -------
    Run
    """
    rng = np.random.default_rng(seed)
    least, most = particles
    n_steps = log.n_steps
    run = Run(
        np.empty((n_steps, 3)), np.empty((n_steps, 3, 3)), np.empty(n_steps), np.empty(n_steps, dtype=np.int64),
        np.zeros(n_steps, dtype=bool), np.full((n_steps, most, 3), np.nan),
    )  # fmt: skip
    cloud = start_mean + np.asarray(start_std) * rng.standard_normal((most, 3))
    for t in range(n_steps):
        if t:
            move(cloud, log.odometry[t], *settings.alphas, rng)
        run.predicted[t, : len(cloud)] = cloud
        weights = np.full(len(cloud), 1.0 / len(cloud))
        for laser in log.lidars.values():
            if np.isnan(laser.ranges[t]).all():
                continue
            scan = scan_of(laser.ranges[t], laser.angles, laser.pose, laser.max_range, settings)
            # As doubles: a product may underflow.
            weights = weights * np.exp(weigh(grid, scan, cloud, settings))
            total = weights.sum()
            run.ignored[t] |= total <= 0.0
            weights = weights / total if total > 0.0 else np.full(len(cloud), 1.0 / len(cloud))
        run.mean[t], run.covariance[t] = moments(cloud, weights)
        run.ess[t], run.n[t] = 1.0 / (weights**2).sum(), len(cloud)
        cloud = resample(cloud, weights, least, most, rng)
    return run
