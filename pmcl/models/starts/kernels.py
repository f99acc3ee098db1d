"""Kernels of the beliefs about the first state."""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import kernel
from pmcl.engine.contract import draw_start, linearise_start, scratch_rows, start_logpdf
from pmcl.engine.scalars import HALF_LOG_2PI, TURN
from pmcl.models.starts.table import GaussianStart, PoseStart, WiderStart


@scratch_rows.register(GaussianStart)
def _gaussian_rows(table):
    return 0


@draw_start.register(GaussianStart)
def _draw_gaussian(start, rng, current):
    for d in range(current.shape[0]):
        for i in range(current.shape[1]):
            current[d, i] = start.mean[d] + start.std[d] * rng.standard_normal()


@start_logpdf.register(GaussianStart)
def _gaussian_logpdf(start, current, logp):
    for d in range(current.shape[0]):
        constant = -math.log(start.std[d]) - HALF_LOG_2PI
        for i in range(logp.size):
            z = (current[d, i] - start.mean[d]) / start.std[d]
            logp[i] += constant - 0.5 * z * z


@linearise_start.register(GaussianStart)
def _linearise_gaussian(start, reference, precision, shift):
    for d in range(reference.size):
        weight = start.std[d] ** -2
        precision[d, d] += weight
        shift[d] += weight * (start.mean[d] - reference[d])


@scratch_rows.register(PoseStart)
def _pose_rows(table):
    return 0


@kernel
def inside(segments, x, y):
    """Return whether a point lies inside a closed outline (even-odd rule)."""
    odd = False
    for k in range(segments.shape[0]):
        x1, y1, x2, y2 = segments[k, 0], segments[k, 1], segments[k, 2], segments[k, 3]
        if (y1 > y) != (y2 > y) and x < x1 + (y - y1) * (x2 - x1) / (y2 - y1):
            odd = not odd
    return odd


@kernel
def on_floor(start, x, y):
    """Return whether a position may lie at a point of the map's box: inside the outline and on a free cell."""
    if start.segments.shape[0] > 0 and not inside(start.segments, x, y):
        return False
    rows, columns = start.floor.shape
    if rows == 0:
        return True
    frame = start.floor_frame
    dx, dy = x - frame[0], y - frame[1]
    column = math.floor((frame[2] * dx + frame[3] * dy) / frame[4])
    row = math.floor((frame[2] * dy - frame[3] * dx) / frame[4])
    return 0 <= column < columns and 0 <= row < rows and start.floor[int(row), int(column)] == 1


@draw_start.register(PoseStart)
def _draw_pose(start, rng, current):
    for i in range(current.shape[1]):
        if math.isinf(start.std[0]):
            accepted = False
            while not accepted:
                x = start.low[0] + (start.high[0] - start.low[0]) * rng.random()
                y = start.low[1] + (start.high[1] - start.low[1]) * rng.random()
                accepted = on_floor(start, x, y)
            current[0, i], current[1, i] = x, y
        else:
            current[0, i] = start.mean[0] + start.std[0] * rng.standard_normal()
            current[1, i] = start.mean[1] + start.std[1] * rng.standard_normal()
        if math.isinf(start.std[2]):
            current[2, i] = TURN * rng.random() - math.pi
        else:
            current[2, i] = start.mean[2] + start.std[2] * rng.standard_normal()


@start_logpdf.register(PoseStart)
def _pose_logpdf(start, current, logp):
    for i in range(logp.size):
        value = start.log_density
        x, y, heading = current[0, i], current[1, i], current[2, i]
        if math.isinf(start.std[0]):
            within = start.low[0] <= x <= start.high[0] and start.low[1] <= y <= start.high[1]
            if not (within and on_floor(start, x, y)):
                value = -np.inf
        else:
            for d in range(2):
                z = (current[d, i] - start.mean[d]) / start.std[d]
                value -= 0.5 * z * z + math.log(start.std[d]) + HALF_LOG_2PI
        if math.isinf(start.std[2]):
            if not -math.pi <= heading < math.pi:
                value = -np.inf
        else:
            z = (heading - start.mean[2]) / start.std[2]
            value -= 0.5 * z * z + math.log(start.std[2]) + HALF_LOG_2PI
        logp[i] += value


@linearise_start.register(PoseStart)
def _linearise_pose(start, reference, precision, shift):
    for d in range(3):
        if not math.isinf(start.std[d]):
            weight = start.std[d] ** -2
            precision[d, d] += weight
            shift[d] += weight * (start.mean[d] - reference[d])
        elif d < 2:
            # A flat belief carries no information; the width of the map keeps the matrix invertible.
            precision[d, d] += 12.0 / (start.high[d] - start.low[d]) ** 2
        else:
            precision[d, d] += 3.0 / math.pi**2


@scratch_rows.register(WiderStart)
def _wider_rows(table):
    return scratch_rows(table.pose)


@draw_start.register(WiderStart)
def _draw_wider(start, rng, current):
    draw_start(start.pose, rng, current[:3])
    for d in range(start.mean.size):
        for i in range(current.shape[1]):
            current[3 + d, i] = start.mean[d] + start.std[d] * rng.standard_normal()


@start_logpdf.register(WiderStart)
def _wider_logpdf(start, current, logp):
    start_logpdf(start.pose, current[:3], logp)
    for d in range(min(start.mean.size, current.shape[0] - 3)):
        constant = -math.log(start.std[d]) - HALF_LOG_2PI
        for i in range(logp.size):
            z = (current[3 + d, i] - start.mean[d]) / start.std[d]
            logp[i] += constant - 0.5 * z * z


@linearise_start.register(WiderStart)
def _linearise_wider(start, reference, precision, shift):
    linearise_start(start.pose, reference[:3], precision[:3, :3], shift[:3])
    for d in range(start.mean.size):
        weight = start.std[d] ** -2
        precision[3 + d, 3 + d] += weight
        shift[3 + d] += weight * (start.mean[d] - reference[3 + d])
