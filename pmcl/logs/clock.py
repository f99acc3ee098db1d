"""Stamps of a recorded stream: brought into order, and rid of what a jumping clock wrote."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["in_order"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

# Threads and networks deliver neighbouring messages in the wrong order by far less than this [s]; a clock that is set
# back goes back by more.
_LARGEST_STEP_BACK = 1.0
# The longest pause within one recording [s]. A clock that a time server sets jumps by more, mostly by years.
_LARGEST_STEP_AHEAD = 3600.0
# A pause of so many usual steps is unusual.
_PAUSE = 10.0
# A clock that jumps more often is of no use; then the longest stretch without a jump counts alone.
_MOST_STRETCHES = 2000


def in_order(times: Float) -> tuple[Int, int]:
    """Choose the messages of a stream that follow one clock, and put them in order.

    A stretch that is free of jumps and pauses may be followed by any later one that goes on from there without a jump.
    Of all such chains of stretches, the one with the most messages counts. Of messages with the same stamp the first
    one counts.

    Parameters
    ----------
    times : ndarray, shape (N,)
        Stamps [s] in the order of recording.

    Returns
    -------
    kept : ndarray of int, shape (K,)
        Indices of the messages, in strictly increasing order of their stamps.
    n_jumped : int
        Messages left out because the clock had jumped. Repeated stamps are not counted.
    """
    if not len(times):
        return np.zeros(0, dtype=np.int64), 0
    steps = np.diff(times)
    # A message with a stamp of its own must be a stretch of its own, so a pause ends a stretch, too.
    pause = max(_LARGEST_STEP_BACK, _PAUSE * float(np.median(np.abs(steps)))) if len(steps) else 0.0
    breaks = np.flatnonzero(~((steps >= -_LARGEST_STEP_BACK) & (steps <= pause))) + 1
    stretches = np.split(np.arange(len(times)), breaks)
    kept = [stretches[k] for k in _best_chain(times, stretches)]
    chosen = np.concatenate(kept)
    _, first = np.unique(times[chosen], return_index=True)
    return chosen[first].astype(np.int64), len(times) - len(chosen)


def _best_chain(times: Float, stretches: list[Int]) -> list[int]:
    """Return indices of the stretches that follow each other without a jump and hold the most messages."""
    lengths = np.array([len(stretch) for stretch in stretches])
    if len(stretches) > _MOST_STRETCHES:
        return [int(lengths.argmax())]
    begins = np.array([times[stretch[0]] for stretch in stretches])
    ends = np.array([times[stretch[-1]] for stretch in stretches])
    totals, before = lengths.copy(), np.full(len(stretches), -1)
    for k in range(1, len(stretches)):
        steps = begins[k] - ends[:k]
        follows = np.flatnonzero((steps >= -_LARGEST_STEP_BACK) & (steps <= _LARGEST_STEP_AHEAD))
        if len(follows):
            best = follows[totals[follows].argmax()]
            totals[k], before[k] = totals[best] + lengths[k], best
    chain = [int(totals.argmax())]
    while before[chain[-1]] >= 0:
        chain.append(int(before[chain[-1]]))
    return chain[::-1]
