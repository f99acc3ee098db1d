"""The explanation that readings have nothing to do with the map: each channel follows a distribution of its own."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.arrays import LogArrays
from pmcl.preflight.readings import width_beyond
from pmcl.preflight.stretch import Stretch

__all__ = ["evidence_of_no_relation"]

Float = NDArray[np.float64]

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


def evidence_of_no_relation(log: LogArrays, stretch: Stretch) -> Float:
    """Return how well readings are explained without the map.

    Parameters
    ----------
    log : LogArrays
        The log.
    stretch : Stretch
        The K rows that are looked at.

    Returns
    -------
    ndarray, shape (K,)
        Log evidence of each row's readings given those before [nat].
    """
    landmarks = (
        ("range", log.landmark_range, 0.0),
        ("bearing", log.landmark_bearing, -math.pi),
        ("size", log.landmark_size, 0.0),
    )
    bounds = {
        name: (low, math.pi if name == "bearing" else 1.001 * float(np.nanmax(table)))
        for name, table, low in landmarks
        if table is not None and not np.isnan(table).all()
    }
    beyond = width_beyond(log)
    known: dict[tuple[str, int], _Histogram] = {}
    out = np.zeros(stretch.rows.size)
    for k, read in enumerate(stretch.readings):
        columns = (("range", read.range), ("bearing", read.bearing), ("size", read.size))
        readings = [
            (name, int(j), _in_one_turn(value) if name == "bearing" else value)
            for name, values in columns
            for j, value in zip(read.landmark, values.tolist(), strict=True)
            if not math.isnan(value)
        ]
        if log.walls is not None:
            readings += [("beam", int(b), value) for b, value in zip(read.beam, read.length.tolist(), strict=True)]
        for name, number, value in readings:
            if (name, number) not in known:
                low, high = (0.0, log.max_range) if name == "beam" else bounds[name]
                known[name, number] = _Histogram(low, high if high > low else low + 1.0, beyond)
            out[k] += known[name, number].log_density(value)
    return out


def _in_one_turn(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
