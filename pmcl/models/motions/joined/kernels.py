"""Compiled functions of motion along joined logs: those of its own motion, but at the seams those of a start."""

from __future__ import annotations

from pmcl.engine.compile import generic, kernel
from pmcl.engine.contract import (
    deviation_of_state,
    draw_precision,
    draw_start,
    linearise_start,
    linearise_transition,
    path_transition_logpdf,
    propagate,
    propagate_widely,
    scratch_rows,
    start_logpdf,
    state_of_deviation,
    state_size,
    transition_logpdf,
    widens,
)
from pmcl.models.motions.joined.table import JoinedMotion
from pmcl.models.starts.table import GaussianStart, PoseStart, WiderStart


@kernel
def seam_at(seams, t):
    """Return the number of the seam at row t, or -1."""
    for k in range(seams.row.size):
        if seams.row[k] == t:
            return k
    return -1


@generic
def belief_at(start, seams, k):
    """Return the belief about the first state at seam k, of the type of `start`."""


@belief_at.register(GaussianStart)
def _gaussian_at(start, seams, k):
    return GaussianStart(seams.mean[k], seams.std[k])


@belief_at.register(PoseStart)
def _pose_at(start, seams, k):
    return PoseStart(
        seams.mean[k], seams.std[k], start.low, start.high, start.segments, seams.log_density[k], start.floor,
        start.floor_frame,
    )  # fmt: skip


@belief_at.register(WiderStart)
def _wider_at(start, seams, k):
    own = start.pose
    pose = PoseStart(
        seams.mean[k, :3], seams.std[k, :3], own.low, own.high, own.segments, seams.log_density[k], own.floor,
        own.floor_frame,
    )  # fmt: skip
    return WiderStart(pose, seams.mean[k, 3:], seams.std[k, 3:])


@state_size.register(JoinedMotion)
def _state_size(motion):
    return state_size(motion.motion)


@scratch_rows.register(JoinedMotion)
def _scratch_rows(table):
    return scratch_rows(table.motion)


@propagate.register(JoinedMotion)
def _propagate(motion, t, rng, previous, current, scratch):
    k = seam_at(motion.seams, t)
    if k < 0:
        propagate(motion.motion, t, rng, previous, current, scratch)
    else:
        draw_start(belief_at(motion.seams.start, motion.seams, k), rng, current)


@widens.register(JoinedMotion)
def _widens(motion):
    return widens(motion.motion)


@propagate_widely.register(JoinedMotion)
def _propagate_widely(motion, t, rng, previous, current, log_weights, scratch):
    k = seam_at(motion.seams, t)
    if k < 0:
        propagate_widely(motion.motion, t, rng, previous, current, log_weights, scratch)
    else:
        draw_start(belief_at(motion.seams.start, motion.seams, k), rng, current)


@transition_logpdf.register(JoinedMotion)
def _transition_logpdf(motion, t, previous, current, logp, scratch):
    k = seam_at(motion.seams, t)
    if k < 0:
        transition_logpdf(motion.motion, t, previous, current, logp, scratch)
    else:
        value = scratch[0, :1]
        value[0] = 0.0
        start_logpdf(belief_at(motion.seams.start, motion.seams, k), current.reshape(current.size, 1), value)
        for i in range(logp.size):
            logp[i] += value[0]


@path_transition_logpdf.register(JoinedMotion)
def _path_logpdf(motion, n_steps, path, logp, scratch):
    seams, size = motion.seams, path.shape[0]
    path_transition_logpdf(motion.motion, n_steps, path, logp, scratch)
    # At a seam this was the density of a step that nobody made. Motion is evaluated before readings, so that nothing
    # else is lost with it.
    for k in range(seams.row.size):
        t = seams.row[k]
        if t < n_steps:
            logp[t] = 0.0
            state = scratch[0, :size]
            for d in range(size):
                state[d] = path[d, t]
            start_logpdf(belief_at(seams.start, seams, k), state.reshape(size, 1), logp[t : t + 1])


@draw_precision.register(JoinedMotion)
def _draw_precision(motion, t, before, after, rng, precision):
    if seam_at(motion.seams, t) >= 0:
        return False
    return draw_precision(motion.motion, t, before, after, rng, precision)


@linearise_transition.register(JoinedMotion)
def _linearise(motion, t, before, after, jacobian, offset, precision):
    k = seam_at(motion.seams, t)
    if k < 0:
        linearise_transition(motion.motion, t, before, after, jacobian, offset, precision)
        return
    size = offset.size
    for i in range(size):
        offset[i] = 0.0
        for j in range(size):
            jacobian[i, j] = 0.0
            precision[i, j] = 0.0
    # Beliefs about a start are independent in all components, so that the precision is diagonal.
    linearise_start(belief_at(motion.seams.start, motion.seams, k), after, precision, offset)
    for i in range(size):
        offset[i] /= precision[i, i]


@state_of_deviation.register(JoinedMotion)
def _state(motion, t, reference, after, deviation, out):
    if seam_at(motion.seams, t + 1) < 0:
        state_of_deviation(motion.motion, t, reference, after, deviation, out)
    else:
        for d in range(out.size):
            out[d] = reference[t, d] + deviation[d]


@deviation_of_state.register(JoinedMotion)
def _deviation(motion, t, reference, after, state, deviation):
    if seam_at(motion.seams, t + 1) < 0:
        deviation_of_state(motion.motion, t, reference, after, state, deviation)
    else:
        for d in range(deviation.size):
            deviation[d] = state[d] - reference[t, d]
