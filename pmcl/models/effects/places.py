"""Places on the floor at which an effect may be: a coarse grid over the map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import stats

from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.part import Float

__all__ = ["at_place", "cell_size", "floor_places", "has_floor"]

# Cells along the longer side of the map (chosen by hand).
_CELLS = 4


def has_floor(log: RobotLog) -> bool:
    """Return whether the log has a map, and with it a floor of known extent."""
    return log.walls is not None or log.landmarks is not None


def _bounds(log: RobotLog) -> tuple[float, float, float, float]:
    if log.walls is not None:
        return log.walls.bounds
    assert log.landmarks is not None
    return log.landmarks.bounds


def cell_size(log: RobotLog) -> float:
    """Return the side of a cell of the grid [m]."""
    x_low, x_high, y_low, y_high = _bounds(log)
    return max(x_high - x_low, y_high - y_low, 1e-3) / _CELLS


def floor_places(log: RobotLog) -> list[Where]:
    """Return the centres of the grid's cells that lie on the floor, as ``{"place": (x, y)}`` [m]."""
    x_low, x_high, y_low, y_high = _bounds(log)
    side = cell_size(log)
    across = [max(1, round((high - low) / side)) for low, high in ((x_low, x_high), (y_low, y_high))]
    x, y = (
        low + (np.arange(n) + 0.5) * (high - low) / n
        for low, high, n in zip((x_low, y_low), (x_high, y_high), across, strict=True)
    )
    centres: Float = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    if log.walls is not None and log.walls.is_closed:
        centres = centres[log.walls.contains(centres)]
    return [{"place": (round(float(x), 4), round(float(y), 4))} for x, y in centres]


def at_place(effect: Effect, log: RobotLog) -> Effect:
    """Return an effect of parameters (strength, x, y, radius) with its disc at the place of the instance.

    The place gives the null of x and y, and the centre of their priors.

    Parameters
    ----------
    effect : Effect
        The instance, whose `where` holds the place.
    log : RobotLog
        The log, whose map gives the grid.
    """
    x, y = (float(value) for value in effect.where["place"])
    side = cell_size(log)
    radius = effect.null[3] * side
    priors = (
        effect.parameters[0].prior,
        stats.norm(loc=x, scale=side),
        stats.norm(loc=y, scale=side),
        stats.gamma(8.0, scale=radius / 8.0),
    )
    parameters = tuple(replace(p, prior=prior) for p, prior in zip(effect.parameters, priors, strict=True))
    typical = {name: (values[0], x, y, radius) for name, values in effect.typical.items()}
    return replace(effect, parameters=parameters, null=(effect.null[0], x, y, radius), typical=typical)
