"""The explanation that readings have nothing to do with the map: each channel follows a distribution of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pmcl.models.quick import QuickReadings

__all__ = ["evidence_of_no_relation"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

_BINS = 8
# Krichevsky and Trofimov's pseudo-count of each bin.
_PSEUDO_COUNT = 0.5


class _Histogram:
    """What a channel has read so far, as a density: each reading is predicted by those before it alone."""

    def __init__(self, low: float, high: float, width_outside: float = 1.0) -> None:
        self.low, self.width, self.width_outside = low, (high - low) / _BINS, width_outside
        # The last bin is for "no echo", which is no number and has no width, unless those are numbers that differ.
        self.counts = np.full(_BINS + 1, _PSEUDO_COUNT)

    def log_density(self, value: float) -> float:
        """Return the log density of the next reading, and take it in."""
        outside = not value < self.low + _BINS * self.width
        k = _BINS if outside else max(int((value - self.low) / self.width), 0)
        density = self.counts[k] / (self.counts.sum() * (self.width_outside if outside else self.width))
        self.counts[k] += 1.0
        return math.log(density)


def evidence_of_no_relation(readings: Mapping[str, QuickReadings], rows: Int) -> Float:
    """Return how well readings are explained without the map.

    Parameters
    ----------
    readings : mapping of str to QuickReadings
        Of the sensors that the log has.
    rows : ndarray of int, shape (K,)
        The rows that are looked at.

    Returns
    -------
    ndarray, shape (K,)
        Log evidence of each row's readings given those before [nat].
    """
    known: dict[tuple[str, tuple[str, int]], _Histogram] = {}
    out = np.zeros(rows.size)
    for k, row in enumerate(rows.tolist()):
        for sensor, read in readings.items():
            for channel, value, low, high, width_outside in read.channels(row):
                if (sensor, channel) not in known:
                    known[sensor, channel] = _Histogram(low, high if high > low else low + 1.0, width_outside)
                out[k] += known[sensor, channel].log_density(value)
    return out
