"""Whether a filter has lost the robot, judged by what it foresaw of each reading."""

from __future__ import annotations

import numpy as np
from scipy import special

from pmcl.filtering.one_step_ahead import Predictions

__all__ = ["lost_at"]

# A lost robot contradicts most channels of a row, row after row; a missing effect of some channels does not. Number of
# rows, and standard deviations; chosen by hand on simulated and recorded logs of lost and of sound filters.
_WINDOW, _CONTRADICTED = 12, 2.5
# Where large noise was fitted, a lost robot contradicts less. A single row then shows the loss, when most readings of
# several beams or landmarks are as many standard deviations off as this. A missing effect can put two landmarks that
# far off, but not four. Chosen by hand, as above.
_ROW_CONTRADICTED, _ROW_CHANNELS = 4.5, 4


def lost_at(predictions: Predictions, n_steps: int) -> int | None:
    """Return the first row at which a filter has lost the robot, or None.

    It has lost the robot where, over a dozen rows with readings, most readings of most rows lie beyond 2.5 standard
    deviations of what was foreseen; or where, in one row of at least four beams or landmarks, most readings lie beyond
    4.5. The first row alone shows nothing.

    Parameters
    ----------
    predictions : Predictions
        What the filter foresaw of each reading.
    n_steps : int
        Number of rows of the log.

    Returns
    -------
    int or None
    """
    middle = 0.5 * (predictions.low + predictions.high)
    with np.errstate(invalid="ignore"):
        size = np.abs(special.ndtri(np.clip(middle, 1e-12, 1.0 - 1e-12)))
    known = ~np.isnan(size)
    # Readings come in the order of their rows.
    rows, first = np.unique(predictions.time[known], return_index=True)
    if rows.size < _WINDOW:
        return None
    typical = np.array([np.median(values) for values in np.split(size[known], first[1:])])
    several = np.array(
        [np.unique(values).size >= _ROW_CHANNELS for values in np.split(predictions.channel[known], first[1:])]
    )
    # Few particles of a start belief lie where sharp readings say; whether the filter is lost, later rows show.
    several[0] = False
    windows = np.lib.stride_tricks.sliding_window_view(typical, _WINDOW)
    lost = np.concatenate(
        [
            np.flatnonzero(np.median(windows, axis=1) > _CONTRADICTED),
            np.flatnonzero(several & (typical > _ROW_CONTRADICTED)),
        ]
    )
    return int(rows[lost.min()]) if lost.size else None
