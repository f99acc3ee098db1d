"""Single readings of sightings, one after another: their densities and distribution functions given those before.

For tables with extras. The readings of one sighting share what the sighting is of; each reading changes the
probabilities of that for the next one.
"""

from __future__ import annotations

import math

from pmcl.engine.compile import kernel
from pmcl.engine.contract import one_reading, reading_count, reading_slots
from pmcl.engine.linear_readings import BEARING
from pmcl.engine.scalars import HALF_LOG_2PI
from pmcl.engine.vector_math import atan2_into, exp_into, log_into, upper_tail_into
from pmcl.models.sensors.landmarks.kernels.channels import (
    given_last,
    last_sighting,
    reading_of,
    residual_and_std,
)
from pmcl.models.sensors.landmarks.kernels.identities import (
    gross_below,
    gross_density,
    identity_weight,
    may_be_misread,
)
from pmcl.models.sensors.landmarks.kernels.rows import (
    AHEAD,
    ANGLE,
    ASIDE,
    BEFORE,
    BELOW,
    DISTANCE,
    DRAFT,
    OTHERS,
    SHARE,
    TARGET,
)
from pmcl.models.sensors.landmarks.kernels.sightlines import locate, place_sensor
from pmcl.models.sensors.landmarks.table import LandmarkExtras, LandmarkSightings


@reading_count.register(LandmarkSightings, LandmarkExtras)
def _reading_count(sensor, n_steps):
    return 3 * sensor.first[n_steps]


@reading_slots.register(LandmarkSightings, LandmarkExtras)
def _reading_slots(sensor, t):
    return 3 * sensor.first[t], 3 * sensor.first[t + 1]


@kernel
def _certain_reading(sensor, kind, k, last, logp, low, high, scratch):
    """Evaluate a reading that is of its own landmark beyond doubt, given sighting `last` of it."""
    j, before = sensor.landmark[k], scratch[BEFORE:]
    ahead, aside, distance, angle = scratch[AHEAD], scratch[ASIDE], scratch[DISTANCE], scratch[ANGLE]
    deviation, spread, draft = scratch[TARGET], scratch[OTHERS], scratch[DRAFT]
    locate(sensor, j, logp.size, scratch)
    if kind == BEARING:
        atan2_into(aside, ahead, angle)
    for i in range(logp.size):
        residual, std = residual_and_std(sensor, kind, k, j, ahead[i], aside[i], distance[i], angle[i])
        if last >= 0:
            residual, std = given_last(sensor, kind, last, residual, std, before, i)
        deviation[i], spread[i] = -residual / std, std
    upper_tail_into(deviation, low)
    log_into(spread, draft)
    for i in range(logp.size):
        logp[i] = -0.5 * deviation[i] * deviation[i] - draft[i] - HALF_LOG_2PI
        high[i] = low[i]


@one_reading.register(LandmarkSightings, LandmarkExtras)
def _one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    k, kind = slot // 3, slot % 3
    z = reading_of(sensor, kind, k)
    if math.isnan(z):
        return False
    named, n, n_landmarks = sensor.landmark[k], logp.size, sensor.position.shape[0]
    gross = sensor.outlier_weight[named]
    place_sensor(sensor, sensor.extras.lag[t:], 0, logp.size, previous, current, scratch)
    last, states_before = last_sighting(sensor, t, named), scratch[BEFORE:]
    if last >= 0:
        place_sensor(sensor, sensor.extras.lag[t:], 0, logp.size, previous, previous, states_before)
        locate(sensor, named, n, states_before)
        atan2_into(states_before[ASIDE], states_before[AHEAD], states_before[ANGLE])
    if gross == 0.0 and not may_be_misread(sensor, named):
        _certain_reading(sensor, kind, k, last, logp, low, high, scratch)
        return True
    # Sums over what the sighting may be of: of the readings before this one, of those and this one, and of smaller
    # readings here.
    before, now, below = memory[0], memory[1], memory[2]
    deviation, spread, draft, share = scratch[TARGET], scratch[OTHERS], scratch[DRAFT], scratch[SHARE]
    ahead, aside, distance, angle = scratch[AHEAD], scratch[ASIDE], scratch[DISTANCE], scratch[ANGLE]
    for i in range(n):
        before[i], now[i], below[i] = 0.0, 0.0, 0.0
    for j in range(n_landmarks):
        weight = identity_weight(sensor, named, j)
        if weight == 0.0:
            continue
        locate(sensor, j, n, scratch)
        if kind >= BEARING:
            atan2_into(aside, ahead, angle)
        for i in range(n):
            share[i] = (1.0 - gross) * weight
        for channel in range(kind + 1):
            if math.isnan(reading_of(sensor, channel, k)):
                continue
            for i in range(n):
                residual, std = residual_and_std(sensor, channel, k, j, ahead[i], aside[i], distance[i], angle[i])
                if j == named and last >= 0:
                    residual, std = given_last(sensor, channel, last, residual, std, states_before, i)
                if j == named and channel == kind:
                    low[i] = residual
                deviation[i], spread[i] = -residual / std, std
            if channel == kind:
                upper_tail_into(deviation, scratch[BELOW])
                for i in range(n):
                    before[i] += share[i]
                    below[i] += share[i] * scratch[BELOW, i]
            if j == named and channel == kind:
                log_into(spread, draft)
                for i in range(n):
                    logp[i] = -0.5 * deviation[i] * deviation[i] - draft[i] - HALF_LOG_2PI
                    high[i] = scratch[BELOW, i]
            for i in range(n):
                deviation[i] = -0.5 * deviation[i] * deviation[i] - HALF_LOG_2PI
            exp_into(deviation, 0.0, draft)
            for i in range(n):
                share[i] *= draft[i] / spread[i]
        for i in range(n):
            now[i] += share[i]
    of_gross_errors = gross
    for earlier in range(kind):
        if not math.isnan(reading_of(sensor, earlier, k)):
            of_gross_errors *= gross_density(sensor, earlier, named)
    density = gross_density(sensor, kind, named)
    for i in range(n):
        before[i] += of_gross_errors
        now[i] += of_gross_errors * density
        share[i] = now[i] / before[i] if before[i] > 0.0 else 0.0
    log_into(share, draft)
    for i in range(n):
        # Where all densities vanish there is nothing to weigh: the reading is taken to be of its own landmark.
        if draft[i] > -math.inf:
            logp[i] = draft[i]
            high[i] = (below[i] + of_gross_errors * gross_below(kind, z, low[i], density)) / before[i]
        low[i] = high[i]
    return True
