"""Draws of range readings along a path, without any compiled kernel of their densities.

What each reading may be, and its draw, stand in :mod:`pmcl.models.sensors.range_beams.kernels.components`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmcl.models.sensors.range_beams.kernels.components.detours import draw_detours
from pmcl.models.sensors.range_beams.kernels.components.drawing import beams_along_path
from pmcl.models.sensors.range_beams.kernels.components.neighbours import draw_neighbour_echoes
from pmcl.models.sensors.range_beams.kernels.components.obstacles import draw_obstacle_echoes
from pmcl.models.sensors.range_beams.kernels.components.own_echo import draw_own_echoes
from pmcl.models.sensors.range_beams.kernels.components.short_echoes import draw_short_echoes
from pmcl.models.sensors.range_beams.kernels.components.unrelated import draw_no_echo, draw_outliers
from pmcl.models.sensors.range_beams.linearisation import beam_lengths
from pmcl.models.sensors.range_beams.table import OPEN_RAY, RangeBeams, RangeExtras

__all__ = ["simulate"]

Float = NDArray[np.float64]


def simulate(table: RangeBeams, path: Float, rng: np.random.Generator) -> RangeBeams:
    """Draw readings of beams along a path (T, >= 3); see :meth:`pmcl.models.sensor.Sensor.simulate`."""
    reading = _with_extras(table, path, rng) if isinstance(table.extras, RangeExtras) else _plain(table, path, rng)
    return table._replace(reading=np.where(np.isnan(table.reading), np.nan, reading))


def _plain(table: RangeBeams, path: Float, rng: np.random.Generator) -> Float:
    shape = table.reading.shape
    expected = np.minimum(table.scale * beam_lengths(table, path) + table.bias, OPEN_RAY * table.max_range)
    echo = np.clip(expected + table.std * rng.standard_normal(shape), 0.0, table.max_range)
    is_outlier = rng.random(shape) < table.outlier_weight
    return np.where(is_outlier, table.max_range * rng.random(shape), echo)


def _with_extras(table: RangeBeams, path: Float, rng: np.random.Generator) -> Float:
    beams = beams_along_path(table, path)
    # The order of these draws is part of what a seed means: it must not change.
    detours = draw_detours(table, beams, rng)
    short_echoes = draw_short_echoes(table, beams, rng)
    outliers = draw_outliers(table, rng)
    obstacles = draw_obstacle_echoes(table, beams, rng)
    neighbours = draw_neighbour_echoes(table, beams, rng)
    taken, reading = np.zeros(table.reading.shape, dtype=bool), np.zeros(table.reading.shape)
    # The first alternative that happens takes the reading: the order is that of the definition of RangeExtras.
    for weight, drawn in (outliers, draw_no_echo(table), short_echoes, detours, *obstacles, neighbours):
        takes = ~taken & (rng.random(taken.shape) < weight)
        reading[takes], taken = drawn[takes], taken | takes
    return draw_own_echoes(table, path, beams, reading, taken, rng)
