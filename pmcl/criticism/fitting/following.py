"""Whether a filter follows the robot; nothing else may be concluded from a filter that has lost it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.scoring.scores import parameter_scores, parameter_steps
from pmcl.errors import FilterError
from pmcl.filtering.lost import lost_at
from pmcl.filtering.one_step_ahead import Predictions, predict_readings
from pmcl.filtering.particle_filter import draw_paths, make_rng
from pmcl.models.outliers import OUTLIER_WEIGHT
from pmcl.models.robot_model import BoundModel

__all__ = ["gross_at", "lost_at", "particles_that_follow"]

Float = NDArray[np.float64]

# Two filters disagree when their log evidences of a window of so many rows, but for the worst one, differ by more than
# so many nats. Filters of n and 4 n particles that follow the robot agree on a window to within some nats; one that has
# hardly a particle where a step goes far astray may lose a hundred at that row, and is right again at the next. Both
# are chosen by hand.
_DISAGREEMENT, _WINDOW = 60.0, 20
# Where a model allows for gross errors, a lost robot contradicts nothing: all its readings are gross errors. It is lost
# where more than this share of the readings of so many rows are, along so many paths of the filter (chosen by hand).
_GROSS_SHARE, _GROSS_WINDOW, _GROSS_PATHS = 0.6, 12, 5


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
        When the larger filters lose the robot, or follow it to different places; it tells the row.
    """
    log, n_steps, tables = bound.logs[0], bound.lengths[0], bound.tables(theta)[0]

    def followed(k: int, n: int) -> tuple[int | None, Float]:
        """Return the row at which a filter loses the robot, or None, and its log evidence row by row."""
        rng = make_rng(np.random.SeedSequence((seed, k)))
        try:
            predictions = predict_readings(tables, n_steps, n, rng)
        except FilterError as error:
            return error.row or 0, np.full(n_steps, -np.inf)
        lost = lost_at(predictions, n_steps)
        lost = gross_at(bound, theta, predictions, rng) if lost is None else lost
        return lost, predictions.filtered.log_increments

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
        raise FilterError(f"{log.where}: the filter loses the robot at t={log.times[lost_row]:g} s", row=lost_row)
    return 4 * particles, note.format(4 * particles)


def gross_at(bound: BoundModel, theta: Float, predictions: Predictions, rng: np.random.Generator) -> int | None:
    """Return the first row from which on most readings are gross errors, row after row, or None.

    Parameters
    ----------
    bound : BoundModel
        The model bound to one log.
    theta : ndarray, shape (d,)
        Its parameters.
    predictions : Predictions
        A filter pass of the model.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    int or None
        None for a model without free shares of gross errors.

    Notes
    -----
    The log density of a reading changes by d / w when its share w of gross errors grows by d and the reading is one,
    and by -d / (1 - w) when it is none. The change therefore tells how probably it is one.
    """
    owner = {parameter.name: number for number, one in enumerate(bound.model.sensors) for parameter in one.parameters}
    positions = [k for k, name in enumerate(bound.names) if name.endswith(OUTLIER_WEIGHT) and name in owner]
    if not positions:
        return None
    n_steps = bound.lengths[0]
    paths = draw_paths(bound.tables(theta)[0], predictions.filtered, _GROSS_PATHS, rng)
    scores = parameter_scores(bound, theta, np.ascontiguousarray(paths.transpose(0, 2, 1)))
    step = parameter_steps(bound, theta)
    gross, read = np.zeros(n_steps), np.zeros(n_steps)
    for k in positions:
        of_sensor = predictions.sensor == owner[bound.names[k]]
        seen = np.unique(np.stack([predictions.time[of_sensor], predictions.channel[of_sensor]]), axis=1)
        count = np.bincount(seen[0], minlength=n_steps)
        if_gross, if_not = step[k] / theta[k], step[k] / (1.0 - theta[k])
        gross += (scores[k] + count * if_not) / (if_gross + if_not)
        read += count
    rows = np.flatnonzero(read)
    if rows.size < _GROSS_WINDOW:
        return None
    windows = (np.lib.stride_tricks.sliding_window_view(values[rows], _GROSS_WINDOW) for values in (gross, read))
    share = np.divide(*(window.sum(axis=1) for window in windows))
    lost = np.flatnonzero(share > _GROSS_SHARE)
    return int(rows[lost[0]]) if lost.size else None


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
    if large.size < _WINDOW:
        return None
    with np.errstate(invalid="ignore"):
        windows = np.lib.stride_tricks.sliding_window_view(large - small, _WINDOW)
        total = windows.sum(axis=1)
        apart = total - windows.max(axis=1)
        if both_ways:
            apart = np.maximum(apart, windows.min(axis=1) - total)
    worst = int(np.argmax(apart))
    return None if apart[worst] < _DISAGREEMENT else worst
