"""The log density of one sighting, were it of a given landmark: in many columns at once, or in one."""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.linear_readings import BEARING, RANGE, SIZE
from pmcl.engine.scalars import HALF_LOG_2PI, wrap_angle
from pmcl.engine.vector_math import atan2_into, log_into
from pmcl.models.sensors.landmarks.kernels.channels import (
    NEAREST,
    RELATED,
    correlation_of,
    given_last,
    reading_of,
    residual_and_std,
)
from pmcl.models.sensors.landmarks.kernels.rows import AHEAD, ANGLE, ASIDE, BEFORE, DISTANCE, DRAFT
from pmcl.models.sensors.landmarks.kernels.sightlines import locate, locate_from

__all__ = ["add_memory", "add_sighting", "sighting_logpdf"]


@kernel
def add_sighting(sensor, k, j, n, scratch, target):
    """Add the log density of sighting k, were it of landmark j, to `target`."""
    ahead, aside, distance, angle, draft = (
        scratch[AHEAD], scratch[ASIDE], scratch[DISTANCE], scratch[ANGLE], scratch[DRAFT],
    )  # fmt: skip
    locate(sensor, j, n, scratch)
    if not math.isnan(sensor.range[k]):
        even = sensor.extras.range_growth[j] == 0.0
        constant = -HALF_LOG_2PI - (math.log(sensor.range_std[j]) if even else 0.0)
        if not even:
            for i in range(n):
                draft[i] = sensor.range_std[j] * (1.0 + sensor.extras.range_growth[j] * distance[i])
            log_into(draft, draft)
        for i in range(n):
            residual, std = residual_and_std(sensor, RANGE, k, j, ahead[i], aside[i], distance[i], 0.0)
            r = residual / std
            target[i] += constant - (0.0 if even else draft[i]) - 0.5 * r * r
    if not math.isnan(sensor.size[k]):
        log_into(distance, draft)
        constant = -HALF_LOG_2PI - math.log(sensor.size_std[j] * sensor.size_constant[j])
        for i in range(n):
            residual, std = residual_and_std(sensor, SIZE, k, j, ahead[i], aside[i], distance[i], 0.0)
            r = residual / std
            target[i] += constant + 2.0 * draft[i] - 0.5 * r * r
    if not math.isnan(sensor.bearing[k]):
        atan2_into(aside, ahead, angle)
        even = sensor.extras.bearing_falloff[j] == 0.0
        constant = -HALF_LOG_2PI - (math.log(sensor.bearing_std[j]) if even else 0.0)
        if not even:
            for i in range(n):
                nearness = sensor.extras.bearing_falloff[j] / max(distance[i], NEAREST)
                draft[i] = sensor.bearing_std[j] * (1.0 + nearness)
            log_into(draft, draft)
        for i in range(n):
            residual, std = residual_and_std(sensor, BEARING, k, j, ahead[i], aside[i], distance[i], angle[i])
            r = residual / std
            target[i] += constant - (0.0 if even else draft[i]) - 0.5 * r * r


@kernel
def add_memory(sensor, k, last, n, scratch, target):
    """Make the log density of sighting k of its landmark, just added to `target`, that given sighting `last` of it."""
    j, before = sensor.landmark[k], scratch[BEFORE:]
    locate(sensor, j, n, before)
    for kind in range(SIZE):
        correlation = correlation_of(sensor, kind, j)
        if correlation == 0.0 or math.isnan(reading_of(sensor, kind, k)):
            continue
        if math.isnan(reading_of(sensor, kind, last)):
            continue
        if kind == BEARING:
            atan2_into(before[ASIDE], before[AHEAD], before[ANGLE])
        narrower = math.sqrt(1.0 - correlation * correlation)
        log_narrower = math.log(narrower)
        for i in range(n):
            error, spread = residual_and_std(
                sensor, kind, last, j, before[AHEAD, i], before[ASIDE, i], before[DISTANCE, i], before[ANGLE, i]
            )
            residual, std = residual_and_std(
                sensor, kind, k, j, scratch[AHEAD, i], scratch[ASIDE, i], scratch[DISTANCE, i], scratch[ANGLE, i]
            )
            given = residual - correlation * error
            if kind == BEARING:
                given = wrap_angle(given)
            alone, related = residual / std, given / (narrower * std)
            change = 0.5 * (alone * alone - related * related) - log_narrower
            target[i] += change if abs(error) < RELATED * spread else 0.0


@kernel
def sighting_logpdf(sensor, k, j, last, i, scratch):
    """Return the log density of sighting k, were it of landmark j, from column `i`, given sighting `last` of j."""
    ahead, aside, distance = locate_from(sensor, j, i, scratch)
    angle = 0.0 if math.isnan(sensor.bearing[k]) else math.atan2(aside, ahead)
    before = scratch[BEFORE:]
    if last >= 0:
        before[AHEAD, i], before[ASIDE, i], before[DISTANCE, i] = locate_from(sensor, j, i, before)
    value, spread = 0.0, 1.0
    for kind in range(3):
        if math.isnan(reading_of(sensor, kind, k)):
            continue
        residual, std = residual_and_std(sensor, kind, k, j, ahead, aside, distance, angle)
        if last >= 0:
            residual, std = given_last(sensor, kind, last, residual, std, before, i)
        value -= 0.5 * (residual / std) ** 2 + HALF_LOG_2PI
        # One logarithm serves all readings of the sighting.
        spread *= std
    return value - math.log(spread)
