"""Effects that the catalogue does not hold: what the critic must find as a formula, or call unknown.

Some are among the critic's formulas as they are (``gyro-ramp``, ``compass-range``), of others only something like them
(``jerky-gyro`` and ``sunny-side`` are no sines, ``bent-range`` has its least error at 1.2 m).
"""

import numpy as np
from scipy import stats

from pmcl.models.effects.editing import edit_beams
from pmcl.models.effects.effect import Effect
from pmcl.models.parameters import Parameter
from pmcl.models.sensors.range_beams.linearisation import beam_lengths

__all__ = ["OUTSIDE"]


def _share(log):
    return (log.times - log.times[0]) / (log.times[-1] - log.times[0])


def _motion(edit):
    def change(tables, values, log, where):
        mean, std = tables.motion.mean.copy(), tables.motion.std.copy()
        edit(mean, std, log, values[0])
        return tables._replace(motion=tables.motion._replace(mean=mean, std=std))

    return change


def _range(bias=None, factor=None):
    def change(tables, values, log, where):
        def edit(beams):
            changes = {}
            if bias is not None:
                changes["bias_at"] = beams.bias_at + values[0] * bias(tables.sensors[0], log)
            if factor is not None:
                changes["std_factor"] = beams.std_factor * factor(log)
            return changes

        return edit_beams(tables, edit, "outside")

    return change


def _gyro_ramp(mean, std, log, c):
    mean[:, 2] += c * 0.06 * (2.0 * _share(log) - 1.0)


def _gyro_wave(mean, std, log, c):
    mean[:, 2] += c * 0.06 * np.sin(2.0 * np.pi * log.times / 60.0)


def _slow_turns(mean, std, log, c):
    mean[:, :2] *= 1.0 - c * np.minimum(np.abs(mean[:, 2:]), 0.6)


def _battery(mean, std, log, c):
    mean[:, :2] *= 1.0 - 0.4 * c * _share(log)[:, None]


def _shaky_start(mean, std, log, c):
    std[:, 2] *= 1.0 + 2.0 * c * (_share(log) < 0.3)


def _jerky_gyro(mean, std, log, c):
    mean[:, 2] += c * 0.05 * np.sign(np.sin(2.0 * np.pi * log.times / 170.0))


def _left_turns(mean, std, log, c):
    mean[:, 2] += c * 0.25 * np.maximum(mean[:, 2], 0.0)


def _compass(beams, log):
    return 0.06 * np.cos(log.true_poses[:, 2, None] + beams.beam_pose[:, 2])


def _bent(beams, log):
    return 0.06 * (beam_lengths(beams, np.array(log.true_poses)) - 1.2) ** 2


def _breathing(beams, log):
    return np.broadcast_to(0.08 * np.sin(2.0 * np.pi * log.times / 50.0)[:, None], beams.reading.shape)


def _sunny_side(beams, log):
    direction = log.true_poses[:, 2, None] + beams.beam_pose[:, 2]
    return 0.08 * (np.cos(direction - 1.0) > 0.5)


def _noisy_turns(log):
    return 1.0 + 3.0 * np.abs(log.odometry[:, 2])


def _effect(name, summary, change, carrier):
    parameter = Parameter(name.replace("-", "_"), "1", stats.norm(0.0, 10.0))
    return Effect(name, summary, (parameter,), (0.0,), change, carrier=carrier, typical={"clear": (1.0,)})


OUTSIDE = {
    effect.name: effect
    for effect in (
        _effect("gyro-ramp", "The drift of the heading grows with time.", _motion(_gyro_ramp), "motion"),
        _effect("gyro-wave", "The drift of the heading comes and goes.", _motion(_gyro_wave), "motion"),
        _effect("slow-turns", "The robot gets less far while it turns.", _motion(_slow_turns), "motion"),
        _effect("battery", "The robot gets less and less far.", _motion(_battery), "motion"),
        _effect("shaky-start", "Turns are noisier at first.", _motion(_shaky_start), "motion"),
        _effect("jerky-gyro", "The drift of the heading changes sides now and then.", _motion(_jerky_gyro), "motion"),
        _effect("left-turns", "The robot turns too far to the left only.", _motion(_left_turns), "motion"),
        _effect("compass-range", "Ranges to the east are too long.", _range(_compass), "range"),
        _effect("bent-range", "Ranges are off by a square of the distance.", _range(_bent), "range"),
        _effect("breathing-range", "All ranges swell and shrink slowly.", _range(_breathing), "range"),
        _effect("sunny-side", "Ranges to the sunny side of the room are too long.", _range(_sunny_side), "range"),
        _effect("noisy-turns", "Ranges are noisier while the robot turns.", _range(factor=_noisy_turns), "range"),
    )
}
