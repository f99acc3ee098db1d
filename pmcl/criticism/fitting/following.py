"""Whether a filter follows the robot; nothing else may be concluded from a filter that has lost it."""

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

# Two filters disagree when their log evidences of a window of so many rows differ by more than so many nats. Filters
# of n and 4 n particles that follow the robot agree on a window to within some nats. Both are chosen by hand.
_DISAGREEMENT, _WINDOW = 60.0, 20


def particles_that_follow(
    bound: BoundModel, theta: Float, particles: int, seed: int, *, patient: bool = False
) -> tuple[int, str]:
    """Check that a filter follows the robot, by a second one with four times the particles and another seed.

    If the two disagree, two filters of twice the particles may agree with the second one. If these do not, a third
    filter as large as the second must agree with it.

    Parameters
    ----------
    bound : BoundModel
        The model bound to one log.
    theta : ndarray, shape (d,)
        Its parameters.
    particles : int
        Particles of the first filter.
    seed : int
        Determines all random numbers.
    patient : bool
        Whether, after all that fails, one filter of four times its particles may confirm the second one.

    Returns
    -------
    particles : int
        The number to use: the given one, or two or four times as many if only these follow.
    note : str
        What was changed and why; empty when nothing was.

    Raises
    ------
    FilterError
        When the larger filters lose the robot, or follow it to different places.
    """
    log, n_steps, tables = bound.logs[0], bound.lengths[0], bound.tables(theta)[0]

    def followed(k: int, n: int) -> tuple[int | None, Float]:
        """Return the row at which a filter loses the robot, or None, and its log evidence row by row."""
        try:
            predictions = predict_readings(tables, n_steps, n, make_rng(np.random.SeedSequence((seed, k))))
        except FilterError:
            return 0, np.full(n_steps, -np.inf)
        return lost_at(predictions, n_steps), predictions.filtered.log_increments

    lost_row, large = followed(1, 4 * particles)

    def agrees(k: int, n: int) -> bool:
        lost, small = followed(k, n)
        return lost is None and _disagree_at(small, large) is None

    note = f"{particles} particles lose the robot for a while; {{}} are used"
    if lost_row is None:
        if agrees(0, particles):
            return particles, ""
        if all(agrees(k, 2 * particles) for k in (3, 4)):
            return 2 * particles, note.format(2 * particles)
        lost_row, other = followed(2, 4 * particles)
        lost_row = _disagree_at(large, other, both_ways=True) if lost_row is None else lost_row
        if lost_row is not None and patient:
            lost_largest, largest = followed(5, 16 * particles)
            lost_row = None if lost_largest is None and _disagree_at(large, largest) is None else lost_row
    if lost_row is not None:
        raise FilterError(f"{log.where}: the filter loses the robot at t={log.times[lost_row]:g} s; {_advice(bound)}")
    return 4 * particles, note.format(4 * particles)


def _advice(bound: BoundModel) -> str:
    """Return what to do about a lost robot.

    The advice was tried on a recorded drive that the default model loses after 330 of 891 s (UTIAS MRCLAM 7, robot 3,
    three seeds). Gross errors in the model, or only the part before the loss, let the filter follow each time. Four and
    eight times the particles, a start belief of 1 m, noise that grows with motion, and samples twice or half as often
    never did.
    """
    shorter = "criticize the part of the log before that time"
    if all(getattr(sensor, "outliers", True) for sensor in bound.model.sensors):
        return shorter
    return (
        "allow for gross errors among the readings (pass the model file that 'pmcl calibrate LOG --outliers "
        f"--print-model' prints with --model; in Python default_model(log, outliers=True)), or {shorter}"
    )


def _disagree_at(small: Float, large: Float, both_ways: bool = False) -> int | None:
    """Return the first row of the window in which two filters disagree most.

    Parameters
    ----------
    small, large : ndarray, shape (T,)
        Log evidence of each row [nat] under the two filters.
    both_ways : bool
        Whether the small filter's evidence may also be too high.

    Returns
    -------
    int or None
        None when they agree everywhere.
    """
    with np.errstate(invalid="ignore"):
        window = np.convolve(large - small, np.ones(_WINDOW), mode="valid")
    window = np.abs(window) if both_ways else window
    worst = int(np.argmax(window)) if window.size else 0
    return None if window.size == 0 or window[worst] < _DISAGREEMENT else worst
