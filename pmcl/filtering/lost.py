"""Whether a filter has lost the robot, judged by what it foresaw of each reading."""

from __future__ import annotations

import numpy as np
from scipy import special

from pmcl.filtering.one_step_ahead import Predictions

__all__ = ["lost_at"]

# A lost robot contradicts most channels of a row, row after row; a missing effect of some channels does not.
_WINDOW, _CONTRADICTED = 12, 2.5
# A fit may have bought its way out with noise; then a single row gives the loss away, in which most readings of
# several beams or landmarks are as far off as this. Two landmarks can be that far off when the model misses something.
_ROW_CONTRADICTED, _ROW_CHANNELS = 4.5, 4


def lost_at(made: Predictions, n_steps: int) -> int | None:
    """Return the first row at which a filter has lost the robot, or None.

    It has where, over a dozen rows with readings, most readings of most rows lie beyond 2.5 standard deviations of
    what was foreseen; or in one row of at least four beams or landmarks most readings beyond 4.5.
    """
    middle = 0.5 * (made.low + made.high)
    with np.errstate(invalid="ignore"):
        size = np.abs(special.ndtri(np.clip(middle, 1e-12, 1.0 - 1e-12)))
    known = ~np.isnan(size)
    # Readings come in the order of their rows.
    rows, first = np.unique(made.time[known], return_index=True)
    if rows.size < _WINDOW:
        return None
    typical = np.array([np.median(values) for values in np.split(size[known], first[1:])])
    several = np.array(
        [np.unique(values).size >= _ROW_CHANNELS for values in np.split(made.channel[known], first[1:])]
    )
    windows = np.lib.stride_tricks.sliding_window_view(typical, _WINDOW)
    lost = np.concatenate(
        [
            np.flatnonzero(np.median(windows, axis=1) > _CONTRADICTED),
            np.flatnonzero(several & (typical > _ROW_CONTRADICTED)),
        ]
    )
    return int(rows[lost.min()]) if lost.size else None
