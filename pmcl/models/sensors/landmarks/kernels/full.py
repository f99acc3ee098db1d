"""Kernels of :class:`~pmcl.engine.tables.RichLandmarks`: sightings late, misread, unevenly noisy, or related."""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.contract import (
    has_reading,
    linear_information,
    looks_back,
    one_reading,
    path_reading_logpdf,
    reading_count,
    reading_logpdf,
    reading_slots,
    scratch_rows,
)
from pmcl.engine.linear_readings import BEARING, RANGE, SIZE, add_information
from pmcl.engine.vector_math import (
    any_nonzero,
    atan2_into,
    exp_into,
    log_into,
    sincos_into,
    upper_tail_into,
)
from pmcl.models.sensors.landmarks.table import LandmarkExtras, LandmarkSightings

_HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
_POSE, _SINE, _COSINE, _AHEAD, _ASIDE, _DISTANCE, _ANGLE, _TARGET, _OTHERS, _DRAFT = 0, 3, 4, 5, 6, 7, 8, 9, 10, 11
# The same rows for the state before, after those of the state now; and the states before along a path.
_BEFORE, _SHIFTED = 12, 19
# How far off, in standard deviations, a reading may have been and still say something about the next one.
_RELATED = 4.0
# Nearer landmarks count as this far for the noise of their bearing [m].
_NEAREST = 0.1


@scratch_rows.register(LandmarkSightings, LandmarkExtras)
def _scratch_rows(table):
    return _SHIFTED + 3


@looks_back.register(LandmarkSightings, LandmarkExtras)
def _looks_back(sensor):
    return any_nonzero(sensor.extras.lag) or any_nonzero(sensor.extras.range_correlation) or any_nonzero(sensor.extras.bearing_correlation)


@has_reading.register(LandmarkSightings, LandmarkExtras)
def _has_reading(sensor, t):
    return sensor.first[t + 1] > sensor.first[t]


@kernel
def _log_outlier(sensor, k, j):
    """Return the log density of a sighting that is a gross error."""
    value = 0.0
    if not math.isnan(sensor.range[k]):
        value -= math.log(sensor.max_range)
    if not math.isnan(sensor.bearing[k]):
        value -= math.log(2.0 * math.pi)
    if not math.isnan(sensor.size[k]):
        value -= math.log(sensor.size_constant[j])
    return value


@kernel
def _place(sensor, first, stride, late, previous, current, scratch):
    """Write the pose at which each column was read, with sine and cosine of the direction that the sensor looks in.

    Column i is row ``first + stride * i``; without `late`, readings are as old as the pose.
    """
    yaw = sensor.sensor_pose[2]
    mount_x, mount_y = sensor.sensor_pose[0], sensor.sensor_pose[1]
    n = current.shape[1]
    for d in range(3):
        for i in range(n):
            lag = sensor.extras.lag[first + stride * i] if late else 0.0
            scratch[_POSE + d, i] = current[d, i] - lag * (current[d, i] - previous[d, i])
    sine, cosine = scratch[_SINE], scratch[_COSINE]
    sincos_into(scratch[_POSE + 2], sine, cosine)
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(n):
        along, across = cosine[i], sine[i]
        scratch[_POSE, i] += mount_x * along - mount_y * across
        scratch[_POSE + 1, i] += mount_x * across + mount_y * along
        cosine[i], sine[i] = along * c - across * s, across * c + along * s


@kernel
def _look(sensor, j, n, scratch):
    """Write distance, and where landmark j lies ahead of the sensor and aside."""
    sine, cosine, ahead, aside = scratch[_SINE], scratch[_COSINE], scratch[_AHEAD], scratch[_ASIDE]
    distance = scratch[_DISTANCE]
    x, y = sensor.position[j, 0], sensor.position[j, 1]
    for i in range(n):
        dx, dy = x - scratch[_POSE, i], y - scratch[_POSE + 1, i]
        ahead[i] = dx * cosine[i] + dy * sine[i]
        aside[i] = dy * cosine[i] - dx * sine[i]
    for i in range(n):
        distance[i] = math.sqrt(ahead[i] * ahead[i] + aside[i] * aside[i])


@kernel
def _channel(sensor, kind, k, j, ahead, aside, distance, angle):
    """Return residual and standard deviation of one reading, were it of landmark j; `angle` is the bearing there."""
    if kind == RANGE:
        seen = distance + sensor.extras.depth * (ahead - distance)
        std = sensor.range_std[j] * (1.0 + sensor.extras.range_growth[j] * distance)
        return sensor.range[k] - sensor.range_scale[j] * seen - sensor.range_bias[j], std
    if kind == BEARING:
        residual = sensor.bearing[k] - sensor.bearing_bias[j] - angle
        residual -= 2.0 * math.pi * math.floor(residual / (2.0 * math.pi) + 0.5)
        return residual, sensor.bearing_std[j] * (1.0 + sensor.extras.bearing_falloff[j] / max(distance, _NEAREST))
    ideal = sensor.size_constant[j] / (distance * distance)
    return sensor.size[k] - ideal, sensor.size_std[j] * ideal


@kernel
def _reading_of(sensor, kind, k):
    return sensor.range[k] if kind == RANGE else (sensor.bearing[k] if kind == BEARING else sensor.size[k])


@kernel
def _correlation(sensor, kind, j):
    if kind == SIZE:
        return 0.0
    return sensor.extras.range_correlation[j] if kind == RANGE else sensor.extras.bearing_correlation[j]


@kernel
def _last_sighting(sensor, t, j):
    """Return the sighting of landmark j in the row before t; -1 without one, or where errors of j do not last."""
    found = -1
    if t > 0 and (sensor.extras.range_correlation[j] != 0.0 or sensor.extras.bearing_correlation[j] != 0.0):
        for k in range(sensor.first[t - 1], sensor.first[t]):
            if sensor.landmark[k] == j:
                found = k
    return found


@kernel
def _given_last(sensor, kind, last, residual, std, before, i):
    """Return residual and standard deviation of a reading of its own landmark given sighting `last` of it.

    `before` holds where the landmark lay from the state before, column `i`.
    """
    j = sensor.landmark[last]
    ahead, aside, distance = before[_AHEAD, i], before[_ASIDE, i], before[_DISTANCE, i]
    error, spread = _channel(sensor, kind, last, j, ahead, aside, distance, math.atan2(aside, ahead))
    correlation = _correlation(sensor, kind, j)
    # What was not measured is NaN, and as unrelated as a gross error.
    if not abs(error) < _RELATED * spread:
        return residual, std
    residual -= correlation * error
    if kind == BEARING:
        residual -= 2.0 * math.pi * math.floor(residual / (2.0 * math.pi) + 0.5)
    return residual, std * math.sqrt(1.0 - correlation * correlation)


@kernel
def _add_memory(sensor, k, last, n, scratch, target):
    """Make the log density of sighting k of its landmark, just added to `target`, that given sighting `last` of it."""
    j, before = sensor.landmark[k], scratch[_BEFORE:]
    _look(sensor, j, n, before)
    for kind in range(SIZE):
        correlation = _correlation(sensor, kind, j)
        if correlation == 0.0 or math.isnan(_reading_of(sensor, kind, k)):
            continue
        if math.isnan(_reading_of(sensor, kind, last)):
            continue
        if kind == BEARING:
            atan2_into(before[_ASIDE], before[_AHEAD], before[_ANGLE])
        narrower = math.sqrt(1.0 - correlation * correlation)
        log_narrower = math.log(narrower)
        for i in range(n):
            error, spread = _channel(
                sensor, kind, last, j, before[_AHEAD, i], before[_ASIDE, i], before[_DISTANCE, i], before[_ANGLE, i]
            )
            residual, std = _channel(
                sensor, kind, k, j, scratch[_AHEAD, i], scratch[_ASIDE, i], scratch[_DISTANCE, i], scratch[_ANGLE, i]
            )
            given = residual - correlation * error
            if kind == BEARING:
                given -= 2.0 * math.pi * math.floor(given / (2.0 * math.pi) + 0.5)
            alone, related = residual / std, given / (narrower * std)
            change = 0.5 * (alone * alone - related * related) - log_narrower
            target[i] += change if abs(error) < _RELATED * spread else 0.0


@kernel
def _add_sighting(sensor, k, j, n, scratch, target):
    """Add the log density of sighting k, were it of landmark j, to `target`."""
    ahead, aside, distance, angle, draft = (
        scratch[_AHEAD], scratch[_ASIDE], scratch[_DISTANCE], scratch[_ANGLE], scratch[_DRAFT],
    )  # fmt: skip
    _look(sensor, j, n, scratch)
    if not math.isnan(sensor.range[k]):
        plain = sensor.extras.range_growth[j] == 0.0
        constant = -_HALF_LOG_2PI - (math.log(sensor.range_std[j]) if plain else 0.0)
        if not plain:
            for i in range(n):
                draft[i] = sensor.range_std[j] * (1.0 + sensor.extras.range_growth[j] * distance[i])
            log_into(draft, draft)
        for i in range(n):
            residual, std = _channel(sensor, RANGE, k, j, ahead[i], aside[i], distance[i], 0.0)
            r = residual / std
            target[i] += constant - (0.0 if plain else draft[i]) - 0.5 * r * r
    if not math.isnan(sensor.size[k]):
        log_into(distance, draft)
        constant = -_HALF_LOG_2PI - math.log(sensor.size_std[j] * sensor.size_constant[j])
        for i in range(n):
            residual, std = _channel(sensor, SIZE, k, j, ahead[i], aside[i], distance[i], 0.0)
            r = residual / std
            target[i] += constant + 2.0 * draft[i] - 0.5 * r * r
    if not math.isnan(sensor.bearing[k]):
        atan2_into(aside, ahead, angle)
        plain = sensor.extras.bearing_falloff[j] == 0.0
        constant = -_HALF_LOG_2PI - (math.log(sensor.bearing_std[j]) if plain else 0.0)
        if not plain:
            for i in range(n):
                nearness = sensor.extras.bearing_falloff[j] / max(distance[i], _NEAREST)
                draft[i] = sensor.bearing_std[j] * (1.0 + nearness)
            log_into(draft, draft)
        for i in range(n):
            residual, std = _channel(sensor, BEARING, k, j, ahead[i], aside[i], distance[i], angle[i])
            r = residual / std
            target[i] += constant - (0.0 if plain else draft[i]) - 0.5 * r * r


@kernel
def _mix_into(target, other, log_weight, log_rest, n, draft):
    """Replace `target` by log((1 - w) exp(target) + w exp(other)), given log w and log(1 - w); `other` is lost."""
    for i in range(n):
        kept, added = target[i] + log_rest, other[i] + log_weight
        high = max(kept, added)
        target[i] = high if high > -math.inf else -1e300
        other[i] = min(kept, added) - target[i]
    exp_into(other, 0.0, draft)
    for i in range(n):
        draft[i] += 1.0
    log_into(draft, other)
    for i in range(n):
        target[i] += other[i]


@kernel
def _log(x):
    return math.log(x) if x > 0.0 else -math.inf


@reading_logpdf.register(LandmarkSightings, LandmarkExtras)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    n, n_landmarks = logp.size, sensor.position.shape[0]
    others, draft = scratch[_OTHERS], scratch[_DRAFT]
    _place(sensor, t, 0, True, previous, current, scratch)
    placed_before = False
    for k in range(sensor.first[t], sensor.first[t + 1]):
        j = sensor.landmark[k]
        misread, wild = sensor.extras.misread_weight[j], sensor.outlier_weight[j]
        last = _last_sighting(sensor, t, j)
        if last >= 0 and not placed_before:
            _place(sensor, t, 0, False, previous, previous, scratch[_BEFORE:])
            placed_before = True
        sure = misread == 0.0 and wild == 0.0
        target = logp if sure else scratch[_TARGET]
        if not sure:
            for i in range(n):
                target[i] = 0.0
        _add_sighting(sensor, k, j, n, scratch, target)
        if last >= 0:
            _add_memory(sensor, k, last, n, scratch, target)
        if sure:
            continue
        if misread > 0.0 and n_landmarks > 1:
            # Others join one by one; each weight is its share of what is mixed so far.
            total = 1.0 - misread
            each = misread / (n_landmarks - 1)
            for other in range(n_landmarks):
                if other == j:
                    continue
                for i in range(n):
                    others[i] = 0.0
                _add_sighting(sensor, k, other, n, scratch, others)
                share = each / (total + each)
                _mix_into(target, others, math.log(share), _log(1.0 - share), n, draft)
                total += each
        if wild > 0.0:
            outlier = _log_outlier(sensor, k, j)
            for i in range(n):
                others[i] = outlier
            _mix_into(target, others, math.log(wild), _log(1.0 - wild), n, draft)
        for i in range(n):
            logp[i] += target[i]


@kernel
def _look_once(sensor, j, i, scratch):
    """Return where landmark j lies ahead of the sensor and aside, and its distance, from column `i`."""
    dx, dy = sensor.position[j, 0] - scratch[_POSE, i], sensor.position[j, 1] - scratch[_POSE + 1, i]
    ahead = dx * scratch[_COSINE, i] + dy * scratch[_SINE, i]
    aside = dy * scratch[_COSINE, i] - dx * scratch[_SINE, i]
    return ahead, aside, math.sqrt(ahead * ahead + aside * aside)


@kernel
def _one_sighting(sensor, k, j, last, i, scratch):
    """Return the log density of sighting k, were it of landmark j, from column `i`, given sighting `last` of j."""
    ahead, aside, distance = _look_once(sensor, j, i, scratch)
    angle = 0.0 if math.isnan(sensor.bearing[k]) else math.atan2(aside, ahead)
    before = scratch[_BEFORE:]
    if last >= 0:
        before[_AHEAD, i], before[_ASIDE, i], before[_DISTANCE, i] = _look_once(sensor, j, i, before)
    value, spread = 0.0, 1.0
    for kind in range(3):
        if math.isnan(_reading_of(sensor, kind, k)):
            continue
        residual, std = _channel(sensor, kind, k, j, ahead, aside, distance, angle)
        if last >= 0:
            residual, std = _given_last(sensor, kind, last, residual, std, before, i)
        value -= 0.5 * (residual / std) ** 2 + _HALF_LOG_2PI
        # One logarithm serves all channels.
        spread *= std
    return value - math.log(spread)


@kernel
def _log_add(one, other):
    high = max(one, other)
    return high + math.log1p(math.exp(min(one, other) - high)) if high > -math.inf else high


@path_reading_logpdf.register(LandmarkSightings, LandmarkExtras)
def _path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    shifted, n_landmarks = scratch[_SHIFTED : _SHIFTED + 3], sensor.position.shape[0]
    for d in range(3):
        for t in range(n_steps):
            shifted[d, t] = path[d, max(t - 1, 0)]
    _place(sensor, 0, 1, True, shifted, path, scratch)
    if any_nonzero(sensor.extras.range_correlation) or any_nonzero(sensor.extras.bearing_correlation):
        _place(sensor, 0, 1, False, shifted, shifted, scratch[_BEFORE:])
    for k in range(sensor.first[n_steps]):
        t, j = sensor.time[k], sensor.landmark[k]
        misread, wild = sensor.extras.misread_weight[j], sensor.outlier_weight[j]
        value = _one_sighting(sensor, k, j, _last_sighting(sensor, t, j), t, scratch)
        if misread > 0.0 and n_landmarks > 1:
            value += _log(1.0 - misread)
            for other in range(n_landmarks):
                if other != j:
                    one = _one_sighting(sensor, k, other, -1, t, scratch)
                    value = _log_add(value, one + math.log(misread / (n_landmarks - 1)))
        if wild > 0.0:
            value = _log_add(value + _log(1.0 - wild), _log_outlier(sensor, k, j) + math.log(wild))
        logp[t] += value


@reading_count.register(LandmarkSightings, LandmarkExtras)
def _reading_count(sensor, n_steps):
    return 3 * sensor.first[n_steps]


@reading_slots.register(LandmarkSightings, LandmarkExtras)
def _reading_slots(sensor, t):
    return 3 * sensor.first[t], 3 * sensor.first[t + 1]


@kernel
def _wild_density(sensor, kind, j):
    if kind == RANGE:
        return 1.0 / sensor.max_range
    return 0.5 / math.pi if kind == BEARING else 1.0 / sensor.size_constant[j]


@kernel
def _sure_reading(sensor, kind, k, last, logp, low, high, scratch):
    """Foresee a reading that is of its own landmark beyond doubt, given sighting `last` of it."""
    j, states_before = sensor.landmark[k], scratch[_BEFORE:]
    ahead, aside, distance, angle = scratch[_AHEAD], scratch[_ASIDE], scratch[_DISTANCE], scratch[_ANGLE]
    deviation, spread, draft = scratch[_TARGET], scratch[_OTHERS], scratch[_DRAFT]
    _look(sensor, j, logp.size, scratch)
    if kind == BEARING:
        atan2_into(aside, ahead, angle)
    for i in range(logp.size):
        residual, std = _channel(sensor, kind, k, j, ahead[i], aside[i], distance[i], angle[i])
        if last >= 0:
            residual, std = _given_last(sensor, kind, last, residual, std, states_before, i)
        deviation[i], spread[i] = -residual / std, std
    upper_tail_into(deviation, low)
    log_into(spread, draft)
    for i in range(logp.size):
        logp[i] = -0.5 * deviation[i] * deviation[i] - draft[i] - _HALF_LOG_2PI
        high[i] = low[i]


@one_reading.register(LandmarkSightings, LandmarkExtras)
def _one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    k, kind = slot // 3, slot % 3
    z = _reading_of(sensor, kind, k)
    if math.isnan(z):
        return False
    named, n, n_landmarks = sensor.landmark[k], logp.size, sensor.position.shape[0]
    misread, wild = sensor.extras.misread_weight[named], sensor.outlier_weight[named]
    _place(sensor, t, 0, True, previous, current, scratch)
    last, states_before = _last_sighting(sensor, t, named), scratch[_BEFORE:]
    if last >= 0:
        _place(sensor, t, 0, False, previous, previous, states_before)
        _look(sensor, named, n, states_before)
    if wild == 0.0 and (misread == 0.0 or n_landmarks == 1):
        _sure_reading(sensor, kind, k, last, logp, low, high, scratch)
        return True
    # What the sighting is of (its landmark, another one, nothing) weighed by the readings of it that came before.
    before, now, below = memory[0], memory[1], memory[2]
    for i in range(n):
        before[i], now[i], below[i] = 0.0, 0.0, 0.0
    for j in range(n_landmarks):
        weight = 1.0 - misread if j == named else (misread / (n_landmarks - 1) if misread > 0.0 else 0.0)
        if n_landmarks == 1:
            weight = 1.0
        if weight == 0.0:
            continue
        _look(sensor, j, n, scratch)
        atan2_into(scratch[_ASIDE], scratch[_AHEAD], scratch[_ANGLE])
        for i in range(n):
            ahead, aside, distance = scratch[_AHEAD, i], scratch[_ASIDE, i], scratch[_DISTANCE, i]
            angle, share = scratch[_ANGLE, i], (1.0 - wild) * weight
            for earlier in range(kind):
                if not math.isnan(_reading_of(sensor, earlier, k)):
                    residual, std = _channel(sensor, earlier, k, j, ahead, aside, distance, angle)
                    if j == named and last >= 0:
                        residual, std = _given_last(sensor, earlier, last, residual, std, states_before, i)
                    share *= math.exp(-0.5 * (residual / std) ** 2 - _HALF_LOG_2PI) / std
            residual, std = _channel(sensor, kind, k, j, ahead, aside, distance, angle)
            if j == named and last >= 0:
                residual, std = _given_last(sensor, kind, last, residual, std, states_before, i)
            before[i] += share
            now[i] += share * math.exp(-0.5 * (residual / std) ** 2 - _HALF_LOG_2PI) / std
            below[i] += share * 0.5 * math.erfc(-residual / std * math.sqrt(0.5))
            if j == named:
                low[i] = residual
                logp[i] = -0.5 * (residual / std) ** 2 - math.log(std) - _HALF_LOG_2PI
                high[i] = 0.5 * math.erfc(-residual / std * math.sqrt(0.5))
    share = wild
    for earlier in range(kind):
        if not math.isnan(_reading_of(sensor, earlier, k)):
            share *= _wild_density(sensor, earlier, named)
    density = _wild_density(sensor, kind, named)
    for i in range(n):
        place = 0.5 + low[i] * density if kind == BEARING else z * density
        total = before[i] + share
        joint = now[i] + share * density
        # Where all densities vanish there is nothing to weigh: the reading is taken to be of its own landmark.
        if joint > 0.0 and total > 0.0:
            logp[i] = math.log(joint / total)
            high[i] = (below[i] + share * min(max(place, 0.0), 1.0)) / total
        low[i] = high[i]
    return True


@linear_information.register(LandmarkSightings, LandmarkExtras)
def _linear_information(sensor, geometry, t, precision, shift):
    jacobian = geometry.jacobian
    for k in range(geometry.first[t], geometry.first[t + 1]):
        j, kind, distance = geometry.channel[k], geometry.kind[k], geometry.distance[k]
        expected = geometry.value[k] - sensor.extras.lag[t] * geometry.velocity[k]
        scale = 1.0
        if kind == RANGE:
            scale = sensor.range_scale[j] * (1.0 + sensor.extras.depth * (geometry.depth[k] - 1.0))
            expected = scale * expected + sensor.range_bias[j]
            std = sensor.range_std[j] * (1.0 + sensor.extras.range_growth[j] * distance)
        elif kind == BEARING:
            expected += sensor.bearing_bias[j]
            std = sensor.bearing_std[j] * (1.0 + sensor.extras.bearing_falloff[j] / max(distance, _NEAREST))
        else:
            scale = sensor.size_constant[j]
            expected *= scale
            std = sensor.size_std[j] * expected
        residual = geometry.reading[k] - expected
        if kind == BEARING:
            residual -= 2.0 * math.pi * math.floor(residual / (2.0 * math.pi) + 0.5)
        weight = geometry.weight[k] / (std * std)
        last = _last_sighting(sensor, t, j)
        if last >= 0 and not math.isnan(_reading_of(sensor, kind, last)):
            # Of a run of related readings each after the first adds this share to what is known of a steady error.
            correlation = _correlation(sensor, kind, j)
            weight *= (1.0 - correlation) / (1.0 + correlation)
        add_information(jacobian, k, scale, weight, residual, precision, shift)
