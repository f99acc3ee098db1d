"""Full kernels of :class:`~pmcl.models.sensors.landmarks.table.LandmarkSightings`, for tables with extras.

:mod:`~.sightlines` finds where landmarks lie, :mod:`~.channels` has the readings of a sighting, :mod:`~.identities`
what a sighting may be of, :mod:`~.sightings` its density given that; :mod:`~.rows` names the scratch space. Here the
identities are mixed.
"""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.contract import (
    has_reading,
    linear_information,
    looks_back,
    path_reading_logpdf,
    reading_logpdf,
    scratch_rows,
)
from pmcl.engine.linear_readings import BEARING, RANGE, add_information
from pmcl.engine.scalars import wrap_angle
from pmcl.engine.vector_math import IMPOSSIBLE, any_nonzero, exp_into, log_into, mix_into
from pmcl.models.sensors.landmarks.kernels.channels import NEAREST, correlation_of, last_sighting, reading_of
from pmcl.models.sensors.landmarks.kernels.identities import identity_weight, log_gross_density, may_be_misread
from pmcl.models.sensors.landmarks.kernels.rows import (
    BEFORE,
    DRAFT,
    OTHERS,
    POSE_BEFORE,
    POSE_NOW,
    ROWS,
    TARGET,
    WEIGHT,
)
from pmcl.models.sensors.landmarks.kernels.sightings import (
    add_memories,
    add_memory,
    add_sighting,
    sightings_into,
)
from pmcl.models.sensors.landmarks.kernels.sightlines import place_sensor
from pmcl.models.sensors.landmarks.table import LandmarkExtras, LandmarkSightings


@scratch_rows.register(LandmarkSightings, LandmarkExtras)
def _scratch_rows(table):
    return ROWS


@kernel
def _errors_last(sensor):
    return any_nonzero(sensor.extras.range_correlation) or any_nonzero(sensor.extras.bearing_correlation)


@looks_back.register(LandmarkSightings, LandmarkExtras)
def _looks_back(sensor):
    return any_nonzero(sensor.extras.lag) or _errors_last(sensor)


@has_reading.register(LandmarkSightings, LandmarkExtras)
def _has_reading(sensor, t):
    return sensor.first[t + 1] > sensor.first[t]


@kernel
def _log(x):
    return math.log(x) if x > 0.0 else -math.inf


@kernel
def _mix_other_landmarks(sensor, k, n, scratch, target):
    """Mix in that sighting k may be of any other landmark."""
    named, others, draft = sensor.landmark[k], scratch[OTHERS], scratch[DRAFT]
    # The others join one by one; each weight is its share of what is mixed so far.
    total = identity_weight(sensor, named, named)
    for j in range(sensor.position.shape[0]):
        if j == named:
            continue
        for i in range(n):
            others[i] = 0.0
        add_sighting(sensor, k, j, n, scratch, others)
        weight = identity_weight(sensor, named, j)
        share = weight / (total + weight)
        mix_into(target, others, math.log(share), _log(1.0 - share), draft)
        total += weight


@kernel
def _mix_gross_error(sensor, k, n, scratch, target):
    """Mix in that sighting k may be a gross error."""
    named, others = sensor.landmark[k], scratch[OTHERS]
    weight, log_density = sensor.outlier_weight[named], log_gross_density(sensor, k, named)
    for i in range(n):
        others[i] = log_density
    mix_into(target, others, math.log(weight), _log(1.0 - weight), scratch[DRAFT])


@reading_logpdf.register(LandmarkSightings, LandmarkExtras)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    n, placed_before = logp.size, False
    place_sensor(sensor, sensor.extras.lag[t:], 0, n, previous, current, scratch)
    for k in range(sensor.first[t], sensor.first[t + 1]):
        j = sensor.landmark[k]
        last = last_sighting(sensor, t, j)
        if last >= 0 and not placed_before:
            place_sensor(sensor, sensor.extras.lag[t:], 0, n, previous, previous, scratch[BEFORE:])
            placed_before = True
        misread, gross = may_be_misread(sensor, j), sensor.outlier_weight[j] > 0.0
        target = scratch[TARGET] if misread or gross else logp
        if misread or gross:
            for i in range(n):
                target[i] = 0.0
        add_sighting(sensor, k, j, n, scratch, target)
        if last >= 0:
            add_memory(sensor, k, last, n, scratch, target)
        if misread:
            _mix_other_landmarks(sensor, k, n, scratch, target)
        if gross:
            _mix_gross_error(sensor, k, n, scratch, target)
        if misread or gross:
            for i in range(n):
                logp[i] += target[i]


@kernel
def _mix_at(target, other, weight, n, draft):
    """Replace `target` by log((1 - w) exp(target) + w exp(other)), with a share w of each column; `other` is lost."""
    for i in range(n):
        high = max(target[i], other[i], IMPOSSIBLE)
        target[i] -= high
        draft[i] = other[i] - high
        other[i] = high
    exp_into(target[:n], 0.0, target[:n])
    exp_into(draft[:n], 0.0, draft[:n])
    for i in range(n):
        draft[i] = (1.0 - weight[i]) * target[i] + weight[i] * draft[i]
    log_into(draft[:n], draft[:n])
    for i in range(n):
        target[i] = other[i] + draft[i]


@kernel
def _mix_misread(sensor, first, n, scratch, target):
    """Mix in that each sighting may be of any other landmark, all alike."""
    others, weight, draft, count = scratch[OTHERS], scratch[WEIGHT], scratch[DRAFT], sensor.position.shape[0]
    mean = scratch[POSE_NOW]  # the states have served
    sightings_into(sensor, first, 1, n, scratch, mean)
    for onward in range(2, count):
        sightings_into(sensor, first, onward, n, scratch, others)
        for i in range(n):
            weight[i] = 1.0 / onward
        _mix_at(mean, others, weight, n, draft)
    for i in range(n):
        weight[i] = sensor.extras.misread_weight[sensor.landmark[first + i]]
    _mix_at(target, mean, weight, n, draft)


@path_reading_logpdf.register(LandmarkSightings, LandmarkExtras)
def _path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    """Add the log densities of all sightings: each has a column, as many at once as there are columns."""
    count, columns = sensor.first[n_steps], scratch.shape[1]
    now, before = scratch[POSE_NOW:], scratch[POSE_BEFORE:]
    target, others, weight, draft = scratch[TARGET], scratch[OTHERS], scratch[WEIGHT], scratch[DRAFT]
    misread = any_nonzero(sensor.extras.misread_weight) and sensor.position.shape[0] > 1
    gross, errors_last = any_nonzero(sensor.outlier_weight), _errors_last(sensor)
    for first in range(0, count, columns):
        n = min(columns, count - first)
        for d in range(3):
            for i in range(n):
                t = sensor.time[first + i]
                now[d, i], before[d, i] = path[d, t], path[d, max(t - 1, 0)]
        for i in range(n):
            draft[i] = sensor.extras.lag[sensor.time[first + i]]
        place_sensor(sensor, draft, 1, n, before, now, scratch)
        sightings_into(sensor, first, 0, n, scratch, target)
        if errors_last:
            place_sensor(sensor, sensor.extras.lag, 0, n, before, before, scratch[BEFORE:])
            add_memories(sensor, first, n, scratch, target)
        if misread:
            _mix_misread(sensor, first, n, scratch, target)
        if gross:
            for i in range(n):
                named = sensor.landmark[first + i]
                weight[i] = sensor.outlier_weight[named]
                others[i] = log_gross_density(sensor, first + i, named)
            _mix_at(target, others, weight, n, draft)
        for i in range(n):
            logp[sensor.time[first + i]] += target[i]


@linear_information.register(LandmarkSightings, LandmarkExtras)
def _linear_information(sensor, linear, t, precision, shift):
    for k in range(linear.first[t], linear.first[t + 1]):
        j, kind, distance = linear.channel[k], linear.kind[k], linear.extras.distance[k]
        expected = linear.value[k] - sensor.extras.lag[t] * linear.extras.velocity[k]
        scale = 1.0
        if kind == RANGE:
            scale = sensor.range_scale[j] * (1.0 + sensor.extras.depth * (linear.extras.depth[k] - 1.0))
            expected = scale * expected + sensor.range_bias[j]
            std = sensor.range_std[j] * (1.0 + sensor.extras.range_growth[j] * distance)
        elif kind == BEARING:
            expected += sensor.bearing_bias[j]
            std = sensor.bearing_std[j] * (1.0 + sensor.extras.bearing_falloff[j] / max(distance, NEAREST))
        else:
            scale = sensor.size_constant[j]
            expected *= scale
            std = sensor.size_std[j] * expected
        residual = linear.reading[k] - expected
        if kind == BEARING:
            residual = wrap_angle(residual)
        weight = linear.weight[k] / (std * std)
        last = last_sighting(sensor, t, j)
        if last >= 0 and not math.isnan(reading_of(sensor, kind, last)):
            # Of a run of related readings each after the first adds this share to what is known of a steady error.
            correlation = correlation_of(sensor, kind, j)
            weight *= (1.0 - correlation) / (1.0 + correlation)
        add_information(linear.jacobian, k, scale, weight, residual, precision, shift)
