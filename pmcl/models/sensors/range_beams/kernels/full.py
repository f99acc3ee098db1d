"""Kernels of :class:`~pmcl.engine.tables.RichRangeBeams`: range readings with everything that may befall them.

A filter evaluates one reading at many states, a path many readings at one state each. Both are columns here: column i
belongs to row ``first + stride * i`` of the readings, with stride 0 in a filter and 1 along a path, so that one
implementation serves both.
"""

from __future__ import annotations

import math

import numpy as np

from pmcl.engine.compile import entry, kernel
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
from pmcl.engine.linear_readings import add_information
from pmcl.engine.student import (
    interval_probability,
    log_upper_tail,
    student_constant,
    student_logpdf,
    upper_tail,
)
from pmcl.engine.vector_math import (
    any_nonzero,
    atan2_into,
    exp_into,
    log_into,
    sincos_into,
    upper_tail_into,
)
from pmcl.models.sensors.range_beams.kernels.plain import CASTING_ROWS, cast_along, cast_one_beam, one_origin
from pmcl.models.sensors.range_beams.kernels.rays import hit_cosines
from pmcl.models.sensors.range_beams.table import RangeBeams, RangeExtras

_HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
# A ray that meets nothing has length inf; this many times the longest reading stands for it.
_FAR = 2.0
# Work rows of this module after those of casting and those for the walls.
_CASTING = CASTING_ROWS
_POSE, _OTHER_RAY, _Z, _EXPECTED, _STD, _CENTRE, _WIDTH, _ECHO, _KEEP, _REST, _DRAFT, _SUM, _BEFORE, _OWN = (
    0, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 17,
)  # fmt: skip
# How far off, in standard deviations, an echo may have been and still say something about the next one.
_RELATED = 4.0
# Width of the step from no reflection to full specular reflection [rad].
_EDGE = 0.1
# Shortest room in which something may stand before the wall [m]; share of the range that a detour needs.
_LEAST_ROOM, _LEAST_DETOUR = 0.01, 0.1
_TINY = 1e-290


@scratch_rows.register(RangeBeams, RangeExtras)
def _scratch_rows(table):
    return _CASTING + table.wall_start.size + _OWN + 3 * table.reading.shape[1]


@looks_back.register(RangeBeams, RangeExtras)
def _looks_back(sensor):
    return any_nonzero(sensor.extras.lag) or any_nonzero(sensor.extras.correlation)


@has_reading.register(RangeBeams, RangeExtras)
def _has_reading(sensor, t):
    return sensor.measured[t] > 0


@kernel
def _cast_beam(sensor, beam, pose, moved, scratch, own, inverse, cosine):
    """Write 1 / length into `inverse` (n,), nearest ray of the cone, and the cosine of incidence of its middle one."""
    dx, dy, best, x, y, sine, cosine_heading, moment = (
        scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5], scratch[6], scratch[8],
    )  # fmt: skip
    cast_one_beam(sensor, beam, pose, sine, cosine_heading, moved, scratch)
    for i in range(inverse.size):
        inverse[i] = best[i]
    if sensor.extras.specular_weight[beam] != 0.0:
        hit_cosines(sensor.vertices, sensor.wall_start, sensor.wall_stop, x, y, dx, dy, moment, best, cosine)
    if sensor.extras.width[beam] == 0.0:
        return
    other, shared = own[_OTHER_RAY], one_origin(sensor.beam_pose)
    for ray in range(5):
        if ray == 2:
            continue
        angle = sensor.beam_pose[beam, 2] + 0.25 * (ray - 2) * sensor.extras.width[beam]
        cast_along(sensor, angle, shared, sine, cosine_heading, scratch, other)
        for i in range(inverse.size):
            inverse[i] = max(inverse[i], other[i])


@kernel
def _cast_beams(sensor, pose, only, correlated, scratch, own, inverses, cosines):
    """Cast all beams, or those read at row `only` when it is not negative, or those that are correlated in time."""
    sincos_into(pose[2], scratch[5], scratch[6])
    origin_x, origin_y = np.nan, np.nan
    for beam in range(sensor.reading.shape[1]):
        if only >= 0 and math.isnan(sensor.reading[only, beam]):
            continue
        if correlated and sensor.extras.correlation[beam] == 0.0:
            continue
        moved = sensor.beam_pose[beam, 0] != origin_x or sensor.beam_pose[beam, 1] != origin_y
        origin_x, origin_y = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1]
        _cast_beam(sensor, beam, pose, moved, scratch, own, inverses[beam], cosines[beam])


@kernel
def _cell(sensor, z):
    """Return the cell of a rounded reading, cut to where readings may lie."""
    centre = math.floor(z / sensor.extras.step + 0.5) * sensor.extras.step
    return max(centre - 0.5 * sensor.extras.step, 0.0), min(centre + 0.5 * sensor.extras.step, sensor.max_range)


@kernel
def _awkward_echo(sensor, z, centre, std):
    """Return the log density of an echo that is clipped or rounded."""
    tail = sensor.extras.tail
    if z <= 0.0:
        return log_upper_tail(centre / std, tail)
    if z >= sensor.max_range:
        return log_upper_tail((sensor.max_range - centre) / std, tail)
    low, high = _cell(sensor, z)
    return interval_probability((low - centre) / std, (high - centre) / std, tail) - math.log(high - low)


@kernel
def _echo_into(sensor, n, z, centre, std, even, draft, out):
    """Write the log density of echoes around `centre` with scale `std` into ``out[:n]``; NaN where `z` is NaN.

    `even` says that `std` is one number; `draft` is work space.
    """
    tail, constant = sensor.extras.tail, student_constant(sensor.extras.tail)
    if even:
        level = math.log(std[0])
        for i in range(n):
            out[i] = level
    else:
        log_into(std, out)
    if tail > 0.0:
        for i in range(n):
            r = (z[i] - centre[i]) / std[i]
            draft[i] = 1.0 + tail * r * r
        log_into(draft, draft)
        power = 0.5 * (1.0 / tail + 1.0)
        for i in range(n):
            out[i] = constant - power * draft[i] - out[i]
    else:
        for i in range(n):
            r = (z[i] - centre[i]) / std[i]
            out[i] = constant - out[i] - 0.5 * r * r
    # Most rows hold none of these, and a loop that only looks for them is a vector loop.
    awkward = False
    for i in range(n):
        awkward |= (z[i] <= 0.0) | (z[i] >= sensor.max_range)
    if not (awkward or sensor.extras.step > 0.0):
        return
    for i in range(n):
        if z[i] <= 0.0 or z[i] >= sensor.max_range or (sensor.extras.step > 0.0 and z[i] > 0.0):
            out[i] = _awkward_echo(sensor, z[i], centre[i], std[i])


@kernel
def _expect(sensor, beam, first, stride, n, previous_inverse, own, inverse):
    """Fill the rows of what one beam should read, and of what its echo should read given the echo before."""
    z, expected, std, centre, width = own[_Z], own[_EXPECTED], own[_STD], own[_CENTRE], own[_WIDTH]
    far, longest = _FAR * sensor.max_range, sensor.max_range
    scale, bias, base, growth = sensor.scale[beam], sensor.bias[beam], sensor.std[beam], sensor.extras.growth[beam]
    if stride == 0:
        value, shift, spread = sensor.reading[first, beam], bias + sensor.extras.bias_at[first, beam], sensor.extras.std_factor[first]
        for i in range(n):
            length = 1.0 / inverse[i]
            z[i] = value
            expected[i] = min(scale * length + shift, far)
            std[i] = base * spread * (1.0 + growth * min(length, longest))
            centre[i], width[i] = expected[i], std[i]
    else:
        for i in range(n):
            row = first + stride * i
            length = 1.0 / inverse[i]
            z[i] = sensor.reading[row, beam]
            expected[i] = min(scale * length + bias + sensor.extras.bias_at[row, beam], far)
            std[i] = base * sensor.extras.std_factor[row] * (1.0 + growth * min(length, longest))
            centre[i], width[i] = expected[i], std[i]
    correlation = sensor.extras.correlation[beam]
    if correlation == 0.0:
        return
    narrower = math.sqrt(1.0 - correlation * correlation)
    for i in range(n):
        row = first + stride * i - 1
        if row < 0:
            continue
        before, length = sensor.reading[row, beam], 1.0 / previous_inverse[i]
        residual = before - min(scale * length + bias + sensor.extras.bias_at[row, beam], far)
        spread = base * sensor.extras.std_factor[row] * (1.0 + growth * min(length, longest))
        if 0.0 < before < longest and abs(residual) < _RELATED * spread:
            centre[i] += correlation * residual
            width[i] *= narrower


@kernel
def _obstacle_lengths(sensor, k, beam, pose, sine, cosine, lengths):
    """Write how far a beam runs from each pose to obstacle `k`; inf where it passes by or the robot stands in it."""
    mount_x, mount_y, yaw = sensor.beam_pose[beam, 0], sensor.beam_pose[beam, 1], sensor.beam_pose[beam, 2]
    x, y, radius = sensor.extras.obstacles[k, 0], sensor.extras.obstacles[k, 1], sensor.extras.obstacles[k, 2]
    c, s = math.cos(yaw), math.sin(yaw)
    for i in range(lengths.size):
        dx, dy = cosine[i] * c - sine[i] * s, sine[i] * c + cosine[i] * s
        away_x = x - (pose[0, i] + mount_x * cosine[i] - mount_y * sine[i])
        away_y = y - (pose[1, i] + mount_x * sine[i] + mount_y * cosine[i])
        along = away_x * dx + away_y * dy
        aside = away_x * dy - away_y * dx
        inner = radius * radius - aside * aside
        length = along - math.sqrt(max(inner, 0.0))
        lengths[i] = length if (inner > 0.0) & (length > 0.0) else np.inf


@kernel
def _reflected(sensor, beam, cosine, out, draft):
    """Write the probability of a detour at each cosine of incidence into `out`."""
    n = out.size
    for i in range(n):
        c = min(cosine[i], 1.0)
        out[i] = math.sqrt(1.0 - c * c)
    atan2_into(out, cosine, draft)
    for i in range(n):
        draft[i] = (sensor.extras.specular_angle - draft[i]) / _EDGE
    exp_into(draft, 0.0, out)
    for i in range(n):
        out[i] = sensor.extras.specular_weight[beam] / (1.0 + out[i])


@kernel
def _detour_density(sensor, z, expected):
    low, longest = max(expected, 0.0), sensor.max_range
    room = longest - low
    inside = 1.0 / room if (low < z) & (z < longest) else 0.0
    beyond = 1.0 if z >= longest else 0.0
    return inside if room > _LEAST_DETOUR * longest else beyond


@kernel
def _short_densities(sensor, stride, z, expected, out, draft):
    """Write the density of echoes from something in the way into `out`, one for each column."""
    n, length = out.size, sensor.extras.short_length
    for i in range(n):
        draft[i] = -max(min(expected[i], sensor.max_range), _LEAST_ROOM) / length
    exp_into(draft, 0.0, out)
    if stride == 0:
        decay = math.exp(-z[0] / length)
        for i in range(n):
            draft[i] = decay
    else:
        for i in range(n):
            draft[i] = -z[i] / length
        exp_into(draft, 0.0, draft)
    for i in range(n):
        room = max(min(expected[i], sensor.max_range), _LEAST_ROOM)
        out[i] = draft[i] / (length * (1.0 - out[i])) if (z[i] > 0.0) & (z[i] < room) else 0.0


@kernel
def _is_mixture(sensor, beam):
    weight = abs(sensor.outlier_weight[beam]) + sensor.extras.no_echo_weight[beam] + sensor.extras.short_weight[beam]
    weight += sensor.extras.specular_weight[beam] + sensor.extras.talk_weight[beam]
    return weight != 0.0


@kernel
def _meets_obstacle(sensor, beam, inverse, scratch):
    """Return whether any ray of a beam, cast before, meets an obstacle before its wall."""
    met, own = False, scratch[_CASTING + sensor.wall_start.size :]
    lengths = own[_SUM]
    for k in range(sensor.extras.obstacles.shape[0]):
        if sensor.extras.obstacles[k, 3] != 0.0:
            _obstacle_lengths(sensor, k, beam, own[_POSE : _POSE + 3], scratch[5], scratch[6], lengths)
            for i in range(lengths.size):
                met |= lengths[i] * inverse[i] < 1.0
    return met


@kernel
def _other_echo(sensor, beam, first, stride, n, lengths_inverse, own, weight):
    """Mix in an echo from another distance with probability `weight`, everywhere."""
    z, std, keep, rest, centre, out = own[_Z], own[_STD], own[_KEEP], own[_REST], own[_SUM], own[_OTHER_RAY]
    far = _FAR * sensor.max_range
    for i in range(n):
        shift = sensor.bias[beam] + sensor.extras.bias_at[first + stride * i, beam]
        centre[i] = min(sensor.scale[beam] / lengths_inverse[i] + shift, far)
    even = stride == 0 and sensor.extras.growth[beam] == 0.0
    _echo_into(sensor, n, z, centre, std, even, own[_DRAFT], out)
    exp_into(out, 0.0, centre)
    for i in range(n):
        keep[i] *= 1.0 - weight
        rest[i] = (1.0 - weight) * rest[i] + weight * centre[i]


@kernel
def _mix(sensor, beam, first, stride, n, pose, sine, cosine_heading, own, inverses, cosine):
    """Fill `keep` and `rest`: the density of a reading is keep * exp(echo) + rest."""
    z, expected, std, keep, rest = own[_Z], own[_EXPECTED], own[_STD], own[_KEEP], own[_REST]
    longest = sensor.max_range
    for i in range(n):
        keep[i], rest[i] = 1.0, 0.0
    talk = sensor.extras.talk_weight[beam]
    if talk > 0.0:
        # Either neighbour alike: first one with talk / 2, then the other with what remains of it.
        half = 0.5 * talk
        _other_echo(sensor, beam, first, stride, n, inverses[sensor.extras.neighbours[beam, 0]], own, half / (1.0 - half))
        _other_echo(sensor, beam, first, stride, n, inverses[sensor.extras.neighbours[beam, 1]], own, half)
    far = _FAR * longest
    for k in range(sensor.extras.obstacles.shape[0]):
        weight = sensor.extras.obstacles[k, 3]
        if weight == 0.0:
            continue
        lengths = own[_SUM]
        _obstacle_lengths(sensor, k, beam, pose, sine, cosine_heading, lengths)
        for i in range(n):
            if lengths[i] * inverses[beam, i] < 1.0:
                shift = sensor.bias[beam] + sensor.extras.bias_at[first + stride * i, beam]
                centre = min(sensor.scale[beam] * lengths[i] + shift, far)
                density = math.exp(_one_echo(sensor, z[i], centre, std[i]))
                keep[i] *= 1.0 - weight
                rest[i] = (1.0 - weight) * rest[i] + weight * density
    values, draft = own[_SUM], own[_DRAFT]
    if sensor.extras.specular_weight[beam] != 0.0:
        _reflected(sensor, beam, cosine, values, draft)
        for i in range(n):
            weight = values[i]
            keep[i] *= 1.0 - weight
            rest[i] = (1.0 - weight) * rest[i] + weight * _detour_density(sensor, z[i], expected[i])
    short, nothing, wild = sensor.extras.short_weight[beam], sensor.extras.no_echo_weight[beam], sensor.outlier_weight[beam]
    if short != 0.0:
        _short_densities(sensor, stride, z, expected, values, draft)
        for i in range(n):
            keep[i] *= 1.0 - short
            rest[i] = (1.0 - short) * rest[i] + short * values[i]
    for i in range(n):
        rest[i] = (1.0 - nothing) * rest[i] + (nothing if z[i] >= longest else 0.0)
        rest[i] = (1.0 - wild) * rest[i] + (wild / longest if 0.0 < z[i] < longest else 0.0)
        keep[i] *= (1.0 - nothing) * (1.0 - wild)


@kernel
def _one_echo(sensor, z, centre, std):
    if z <= 0.0 or z >= sensor.max_range or sensor.extras.step > 0.0:
        return _awkward_echo(sensor, z, centre, std)
    return student_logpdf((z - centre) / std, sensor.extras.tail, student_constant(sensor.extras.tail)) - math.log(std)


@kernel
def _is_plain(sensor, beam):
    """Return whether echoes off walls are all that a beam reads (but for obstacles), a row with one deviation."""
    uneven = sensor.extras.growth[beam] != 0.0 or sensor.extras.correlation[beam] != 0.0
    return not (uneven or sensor.extras.tail != 0.0 or sensor.extras.step != 0.0 or _is_mixture(sensor, beam))


@kernel
def _add_plain_beam(sensor, beam, t, logp, scratch):
    """Add the log density of an unclipped reading of a plain beam, cast before."""
    inverse = scratch[_CASTING + sensor.wall_start.size + _OWN + beam]
    std, far = sensor.std[beam] * sensor.extras.std_factor[t], _FAR * sensor.max_range
    constant, inverse_std, scale = -math.log(std) - _HALF_LOG_2PI, 1.0 / std, sensor.scale[beam]
    z, shift = sensor.reading[t, beam], sensor.bias[beam] + sensor.extras.bias_at[t, beam]
    for i in range(logp.size):
        r = (z - min(scale / inverse[i] + shift, far)) * inverse_std
        logp[i] += constant - 0.5 * r * r


@kernel
def _add_beam(sensor, beam, first, stride, logp, scratch):
    """Add the log density of one beam's readings, all cast before; columns without a reading are left alone."""
    n = logp.size
    n_beams, begin = sensor.reading.shape[1], _CASTING + sensor.wall_start.size
    own = scratch[begin : begin + _OWN]
    inverses = scratch[begin + _OWN : begin + _OWN + n_beams]
    cosines = scratch[begin + _OWN + n_beams : begin + _OWN + 2 * n_beams]
    previous_inverses = scratch[begin + _OWN + 2 * n_beams : begin + _OWN + 3 * n_beams]
    pose = own[_POSE : _POSE + 3]
    _expect(sensor, beam, first, stride, n, previous_inverses[beam], own, inverses[beam])
    z, echo, keep, rest, mixed, draft = own[_Z], own[_ECHO], own[_KEEP], own[_REST], own[_SUM], own[_DRAFT]
    even = stride == 0 and sensor.extras.growth[beam] == 0.0 and sensor.extras.correlation[beam] == 0.0
    _echo_into(sensor, n, z, own[_CENTRE], own[_WIDTH], even, draft, echo)
    if not (_is_mixture(sensor, beam) or _meets_obstacle(sensor, beam, inverses[beam], scratch)):
        for i in range(n):
            logp[i] += 0.0 if math.isnan(z[i]) else echo[i]
        return
    _mix(sensor, beam, first, stride, n, pose, scratch[5], scratch[6], own, inverses, cosines[beam])
    exp_into(echo, 0.0, mixed)
    ordinary = True
    for i in range(n):
        mixed[i] = keep[i] * mixed[i] + rest[i]
        ordinary &= mixed[i] > _TINY
    log_into(mixed, draft)
    if ordinary:
        for i in range(n):
            logp[i] += draft[i]
        return
    for i in range(n):
        if math.isnan(z[i]):
            continue
        if mixed[i] > _TINY or math.isnan(mixed[i]):
            logp[i] += draft[i]
        elif keep[i] > 0.0:
            # So unlikely that the exponential vanished: on the scale of logarithms it did not.
            logp[i] += echo[i] + math.log(keep[i])
        else:
            logp[i] = -np.inf


@kernel
def _delayed(sensor, first, stride, n, previous, current, pose):
    """Write the pose at which each column was read."""
    for d in range(3):
        for i in range(n):
            pose[d, i] = current[d, i] - sensor.extras.lag[first + stride * i] * (current[d, i] - previous[d, i])


@kernel
def _cast_all(sensor, first, stride, previous, current, scratch):
    """Cast all beams of one row, or of each column's own row, and keep the lengths in `scratch`."""
    n_beams, begin = sensor.reading.shape[1], _CASTING + sensor.wall_start.size
    own = scratch[begin : begin + _OWN]
    inverses = scratch[begin + _OWN : begin + _OWN + n_beams]
    cosines = scratch[begin + _OWN + n_beams : begin + _OWN + 2 * n_beams]
    previous_inverses = scratch[begin + _OWN + 2 * n_beams : begin + _OWN + 3 * n_beams]
    pose = own[_POSE : _POSE + 3]
    row = first if stride == 0 else -1
    if any_nonzero(sensor.extras.correlation):
        _cast_beams(sensor, previous, row, True, scratch, own, previous_inverses, cosines)
    _delayed(sensor, first, stride, current.shape[1], previous, current, pose)
    _cast_beams(sensor, pose, -1 if any_nonzero(sensor.extras.talk_weight) else row, False, scratch, own, inverses, cosines)


@kernel
def _add_readings(sensor, first, stride, previous, current, logp, scratch):
    """Add the log densities of all beams."""
    _cast_all(sensor, first, stride, previous, current, scratch)
    lengths = _CASTING + sensor.wall_start.size + _OWN
    for beam in range(sensor.reading.shape[1]):
        plain = stride == 0 and 0.0 < sensor.reading[first, beam] < sensor.max_range and _is_plain(sensor, beam)
        if plain and not _meets_obstacle(sensor, beam, scratch[lengths + beam], scratch):
            _add_plain_beam(sensor, beam, first, logp, scratch)
        elif stride > 0 or not math.isnan(sensor.reading[first, beam]):
            _add_beam(sensor, beam, first, stride, logp, scratch)


@reading_logpdf.register(RangeBeams, RangeExtras)
def _reading_logpdf(sensor, t, previous, current, logp, scratch):
    _add_readings(sensor, t, 0, previous, current, logp, scratch)


@path_reading_logpdf.register(RangeBeams, RangeExtras)
def _path_reading_logpdf(sensor, n_steps, path, logp, scratch):
    begin = _CASTING + sensor.wall_start.size
    previous = scratch[begin + _BEFORE : begin + _BEFORE + 3]
    for d in range(3):
        previous[d, 0] = path[d, 0]
        for t in range(1, n_steps):
            previous[d, t] = path[d, t - 1]
    _add_readings(sensor, 0, 1, previous, path, logp, scratch)


@reading_count.register(RangeBeams, RangeExtras)
def _reading_count(sensor, n_steps):
    return n_steps * sensor.reading.shape[1]


@reading_slots.register(RangeBeams, RangeExtras)
def _reading_slots(sensor, t):
    return t * sensor.reading.shape[1], (t + 1) * sensor.reading.shape[1]


@kernel
def _echo_below(sensor, z, centre, std):
    """Return the probabilities of an echo that reads less, and less or the same."""
    tail, longest = sensor.extras.tail, sensor.max_range
    if z <= 0.0:
        return 0.0, upper_tail(centre / std, tail)
    if z >= longest:
        return upper_tail((centre - longest) / std, tail), 1.0
    if sensor.extras.step > 0.0:
        low, high = _cell(sensor, z)
        return upper_tail((centre - low) / std, tail), upper_tail((centre - high) / std, tail)
    value = upper_tail((centre - z) / std, tail)
    return value, value


@kernel
def _echoes_below(sensor, z, centre, std, draft, low, high):
    """Write the probabilities of echoes that read less, and less or the same; `draft` is work space."""
    n, longest = low.size, sensor.max_range
    if sensor.extras.tail > 0.0 or sensor.extras.step > 0.0:
        for i in range(n):
            low[i], high[i] = _echo_below(sensor, z, centre[i], std[i])
        return
    reached = min(max(z, 0.0), longest)
    for i in range(n):
        draft[i] = (centre[i] - reached) / std[i]
    upper_tail_into(draft, low)
    for i in range(n):
        high[i] = 1.0 if z >= longest else low[i]
        low[i] = 0.0 if z <= 0.0 else low[i]


@kernel
def _mix_below(sensor, beam, t, z, low, high, scratch):
    """Mix everything but its own echo into the probabilities that a beam reads less, and less or the same."""
    n, n_beams, begin = low.size, sensor.reading.shape[1], _CASTING + sensor.wall_start.size
    own = scratch[begin : begin + _OWN]
    inverses = scratch[begin + _OWN : begin + _OWN + n_beams]
    cosine, expected, std = scratch[begin + _OWN + n_beams + beam], own[_EXPECTED], own[_STD]
    longest, far = sensor.max_range, _FAR * sensor.max_range
    beyond = z >= longest
    share = min(max(z / longest, 0.0), 1.0)
    shift = sensor.bias[beam] + sensor.extras.bias_at[t, beam]
    talk = sensor.extras.talk_weight[beam]
    if talk > 0.0:
        centre, less, as_much = own[_SUM], own[_KEEP], own[_REST]
        for i in range(n):
            low[i], high[i] = (1.0 - talk) * low[i], (1.0 - talk) * high[i]
        for side in range(2):
            inverse = inverses[sensor.extras.neighbours[beam, side]]
            for i in range(n):
                centre[i] = min(sensor.scale[beam] / inverse[i] + shift, far)
            _echoes_below(sensor, z, centre, std, own[_DRAFT], less, as_much)
            for i in range(n):
                low[i], high[i] = low[i] + 0.5 * talk * less[i], high[i] + 0.5 * talk * as_much[i]
    for k in range(sensor.extras.obstacles.shape[0]):
        weight = sensor.extras.obstacles[k, 3]
        if weight == 0.0:
            continue
        lengths = own[_SUM]
        _obstacle_lengths(sensor, k, beam, own[_POSE : _POSE + 3], scratch[5], scratch[6], lengths)
        for i in range(n):
            if lengths[i] * inverses[beam, i] < 1.0:
                below, upto = _echo_below(sensor, z, min(sensor.scale[beam] * lengths[i] + shift, far), std[i])
                low[i], high[i] = low[i] + weight * (below - low[i]), high[i] + weight * (upto - high[i])
    if sensor.extras.specular_weight[beam] != 0.0:
        weights = own[_SUM]
        _reflected(sensor, beam, cosine, weights, own[_DRAFT])
        for i in range(n):
            weight, begins = weights[i], max(expected[i], 0.0)
            below = min(max((z - begins) / (longest - begins), 0.0), 1.0) if begins < longest else 0.0
            below = 0.0 if longest - begins <= _LEAST_DETOUR * longest else below
            low[i] += weight * (below - low[i])
            high[i] += weight * ((1.0 if beyond else below) - high[i])
    weight = sensor.extras.short_weight[beam]
    if weight != 0.0:
        for i in range(n):
            room = max(min(expected[i], longest), _LEAST_ROOM)
            below = math.expm1(-min(max(z, 0.0), room) / sensor.extras.short_length) / math.expm1(-room / sensor.extras.short_length)
            low[i], high[i] = low[i] + weight * (below - low[i]), high[i] + weight * (below - high[i])
    nothing, wild = sensor.extras.no_echo_weight[beam], sensor.outlier_weight[beam]
    for i in range(n):
        below, upto = (1.0 - nothing) * low[i], (1.0 - nothing) * high[i] + (nothing if beyond else 0.0)
        low[i], high[i] = below + wild * (share - below), upto + wild * (share - upto)


@one_reading.register(RangeBeams, RangeExtras)
def _one_reading(sensor, t, slot, previous, current, logp, low, high, memory, scratch):
    beam = slot - t * sensor.reading.shape[1]
    if beam == 0:
        _cast_all(sensor, t, 0, previous, current, scratch)
    z = sensor.reading[t, beam]
    if math.isnan(z):
        return False
    for i in range(logp.size):
        logp[i] = 0.0
    _add_beam(sensor, beam, t, 0, logp, scratch)
    begin = _CASTING + sensor.wall_start.size
    own = scratch[begin : begin + _OWN]
    _echoes_below(sensor, z, own[_CENTRE], own[_WIDTH], own[_DRAFT], low, high)
    if _is_mixture(sensor, beam) or any_nonzero(sensor.extras.obstacles[:, 3]):
        _mix_below(sensor, beam, t, z, low, high, scratch)
    return True


@linear_information.register(RangeBeams, RangeExtras)
def _linear_information(sensor, geometry, t, precision, shift):
    jacobian = geometry.jacobian
    for k in range(geometry.first[t], geometry.first[t + 1]):
        beam = geometry.channel[k]
        scale, correlation, length = sensor.scale[beam], sensor.extras.correlation[beam], geometry.value[k]
        std = sensor.std[beam] * sensor.extras.std_factor[t] * (1.0 + sensor.extras.growth[beam] * min(length, sensor.max_range))
        # What rounding, heavy tails and a memory add to the scatter.
        variance = std * std * (1.0 + min(2.0 * sensor.extras.tail, 1.0)) + sensor.extras.step * sensor.extras.step / 12.0
        variance *= (1.0 + correlation) / (1.0 - correlation)
        expected = scale * (length - sensor.extras.lag[t] * geometry.velocity[k]) + sensor.bias[beam] + sensor.extras.bias_at[t, beam]
        add_information(
            jacobian, k, scale, geometry.weight[k] / variance, geometry.reading[k] - expected, precision, shift
        )  # fmt: skip


@entry
def rays_along(sensor, columns):
    """Return 1 / length of every beam along trajectories `columns` (M, D, T), as (M, B, T), without any delay."""
    n_paths, n_steps, n_beams = columns.shape[0], columns.shape[2], sensor.reading.shape[1]
    inverses = np.empty((n_paths, n_beams, n_steps))
    scratch = np.empty((scratch_rows(sensor) + 3, n_steps))
    own = scratch[_CASTING + sensor.wall_start.size :]
    cosines = scratch[_CASTING + sensor.wall_start.size + _OWN :]
    for k in range(n_paths):
        _cast_beams(sensor, columns[k, :3], -1, False, scratch, own, inverses[k], cosines)
    return inverses


@entry
def terms_given_rays(sensor, columns, inverses, which):
    """Return the log densities of readings along trajectories `columns` (M, D, T), as (M, T).

    Beam b has the rays ``inverses[:, which[b]]`` of :func:`rays_along`: tables that change neither how beams run nor
    the map, without delay or specular reflections, share their rays.
    """
    n_paths, n_steps, n_beams = columns.shape[0], columns.shape[2], sensor.reading.shape[1]
    logp = np.zeros((n_paths, n_steps))
    scratch = np.empty((scratch_rows(sensor) + 3, n_steps))
    begin = _CASTING + sensor.wall_start.size
    own, rays = scratch[begin:], scratch[begin + _OWN :]
    memory = any_nonzero(sensor.extras.correlation)
    for k in range(n_paths):
        sincos_into(columns[k, 2], scratch[5], scratch[6])
        for d in range(3):
            for t in range(n_steps):
                own[_POSE + d, t] = columns[k, d, t]
        for beam in range(n_beams):
            for t in range(n_steps):
                rays[beam, t] = inverses[k, which[beam], t]
            if memory:
                # The row before is where the trajectory was then; the first row has none, and is not looked at.
                for t in range(n_steps):
                    rays[2 * n_beams + beam, t] = rays[beam, max(t - 1, 0)]
        for beam in range(n_beams):
            _add_beam(sensor, beam, 0, 1, logp[k], scratch)
    return logp
