"""The first question, before anything is concluded from a filter, is whether it has lost the robot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import FilterError
from pmcl.filtering.lost import lost_at
from pmcl.filtering.one_step_ahead import predict_readings
from pmcl.filtering.particle_filter import make_rng
from pmcl.models.robot_model import BoundModel

__all__ = ["lost_at", "particles_that_follow"]

Float = NDArray[np.float64]

# Filters of n and 4 n particles that follow the robot agree on a window to within some nats.
_DISAGREEMENT, _SPAN = 60.0, 20


def particles_that_follow(
    bound: BoundModel, theta: Float, particles: int, seed: int, *, patient: bool = False
) -> tuple[int, str]:
    """Check that a filter follows the robot, by a second one of four times as many particles and another seed.

    Where the two do not agree, two filters of twice as many particles may do; else a third filter, as large as the
    second, must agree with that one.

    Parameters
    ----------
    bound : BoundModel
        The model bound to one log.
    theta : ndarray, shape (d,)
        Its parameters.
    particles : int
        Particles of the first filter.
    seed : int
        All randomness follows from it.
    patient : bool
        Where all that fails, whether the second filter may also be confirmed by one of four times its particles.

    Returns
    -------
    particles : int
        The number to use: that given, or twice or four times as many where only these follow.
    note : str
        What was changed and why; empty when nothing was.

    Raises
    ------
    FilterError
        When the larger filters lose the robot, or find it in different places.
    """
    log, n_steps, tables = bound.logs[0], bound.lengths[0], bound.tables(theta)[0]

    def followed(k: int, n: int) -> tuple[int | None, Float]:
        """Return where a filter loses the robot, if it does, and its log evidence row by row."""
        try:
            made = predict_readings(tables, n_steps, n, make_rng(np.random.SeedSequence((seed, k))))
        except FilterError:
            return 0, np.full(n_steps, -np.inf)
        return lost_at(made, n_steps), made.filtered.log_increments

    lost_again, large = followed(1, 4 * particles)

    def agrees(k: int, n: int) -> bool:
        lost, small = followed(k, n)
        return lost is None and _apart(small, large) is None

    enough = f"{particles} particles lose the robot for a while; {{}} are used"
    if lost_again is None:
        if agrees(0, particles):
            return particles, ""
        if all(agrees(k, 2 * particles) for k in (3, 4)):
            return 2 * particles, enough.format(2 * particles)
        lost_again, other = followed(2, 4 * particles)
        lost_again = _apart(large, other, both_ways=True) if lost_again is None else lost_again
        if lost_again is not None and patient:
            lost_largest, largest = followed(5, 16 * particles)
            lost_again = None if lost_largest is None and _apart(large, largest) is None else lost_again
    if lost_again is not None:
        raise FilterError(f"{log.where}: the filter loses the robot at t={log.times[lost_again]:g} s; {_advice(bound)}")
    return 4 * particles, enough.format(4 * particles)


def _advice(bound: BoundModel) -> str:
    """Return what to do about a lost robot.

    Tried on a recorded drive that the default model loses after 330 of 891 s (UTIAS MRCLAM 7, robot 3, three seeds):
    gross errors in the model, or only the part before the loss, let the filter follow each time. Four and eight times
    the particles, a start belief of 1 m, noise that grows with motion, and samples twice as often or half as often
    never did.
    """
    shorter = "criticize the part of the log before that time"
    if all(getattr(sensor, "outliers", True) for sensor in bound.model.sensors):
        return shorter
    return (
        "allow for gross errors among the readings (pass the model file that 'pmcl calibrate LOG --outliers "
        f"--print-model' prints with --model; in Python default_model(log, outliers=True)), or {shorter}"
    )


def _apart(small: Float, large: Float, both_ways: bool = False) -> int | None:
    """Return the first row of the window in which the evidence of two filters differs most, if it does too much."""
    with np.errstate(invalid="ignore"):
        window = np.convolve(large - small, np.ones(_SPAN), mode="valid")
    window = np.abs(window) if both_ways else window
    worst = int(np.argmax(window)) if window.size else 0
    return None if window.size == 0 or window[worst] < _DISAGREEMENT else worst
