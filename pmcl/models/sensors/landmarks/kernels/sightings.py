"""The log density of a sighting, were it of a given landmark: of one from many states, or of many along a path."""

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
    last_sighting,
    reading_of,
    residual_and_std,
)
from pmcl.models.sensors.landmarks.kernels.rows import AHEAD, ANGLE, ASIDE, BEFORE, DISTANCE, DRAFT
from pmcl.models.sensors.landmarks.kernels.sightlines import locate, locate_named

__all__ = ["add_memories", "add_memory", "add_sighting", "sightings_into"]


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
def sightings_into(sensor, first, onward, n, scratch, target):
    """Write the log densities of the sightings first ... first + n - 1, a column each, without memory.

    Sighting k counts as one of the landmark `onward` after the one that it names.
    """
    ahead, aside, distance, angle = scratch[AHEAD], scratch[ASIDE], scratch[DISTANCE], scratch[ANGLE]
    spread, count = scratch[DRAFT], sensor.position.shape[0]
    locate_named(sensor, first, onward, n, scratch)
    atan2_into(aside[:n], ahead[:n], angle[:n])
    for i in range(n):
        k = first + i
        j = sensor.landmark[k] + onward
        j -= count if j >= count else 0
        # One logarithm serves all readings of a sighting.
        value, stds = 0.0, 1.0
        for kind in range(3):
            if not math.isnan(reading_of(sensor, kind, k)):
                residual, std = residual_and_std(sensor, kind, k, j, ahead[i], aside[i], distance[i], angle[i])
                r = residual / std
                value -= 0.5 * r * r + HALF_LOG_2PI
                stds *= std
        target[i], spread[i] = value, stds
    log_into(spread[:n], spread[:n])
    for i in range(n):
        target[i] -= spread[i]


@kernel
def add_memories(sensor, first, n, scratch, target):
    """Make the log densities of sightings, just written to `target`, those given the row before."""
    before = scratch[BEFORE:]
    locate_named(sensor, first, 0, n, before)
    atan2_into(before[ASIDE, :n], before[AHEAD, :n], before[ANGLE, :n])
    for i in range(n):
        k = first + i
        j = sensor.landmark[k]
        last = last_sighting(sensor, sensor.time[k], j)
        if last < 0:
            continue
        for kind in range(SIZE):
            if correlation_of(sensor, kind, j) == 0.0 or math.isnan(reading_of(sensor, kind, k)):
                continue
            residual, std = residual_and_std(
                sensor, kind, k, j, scratch[AHEAD, i], scratch[ASIDE, i], scratch[DISTANCE, i], scratch[ANGLE, i]
            )
            given, narrower = given_last(sensor, kind, last, residual, std, before, i)
            alone, related = residual / std, given / narrower
            target[i] += 0.5 * (alone * alone - related * related) - math.log(narrower / std)
