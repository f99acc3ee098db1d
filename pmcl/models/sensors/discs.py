"""How far a ray runs to a disc, such as something that stands on the floor and is on no map."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.compile import kernel

__all__ = ["disc_length", "disc_lengths"]

Float = NDArray[np.float64]


@kernel
def disc_length(away_x: float, away_y: float, dx: float, dy: float, radius: float) -> float:
    """Return how far a ray runs to a disc; inf where it passes by, or begins inside.

    Parameters
    ----------
    away_x, away_y : float
        From the ray's origin to the centre.
    dx, dy : float
        Unit direction of the ray.
    radius : float
        Of the disc, in the same unit as the others.
    """
    along = away_x * dx + away_y * dy
    aside = away_x * dy - away_y * dx
    inner = radius * radius - aside * aside
    length = along - math.sqrt(max(inner, 0.0))
    return length if (inner > 0.0) & (length > 0.0) else np.inf


def disc_lengths(away_x: Float, away_y: Float, dx: Float, dy: Float, radius: float) -> Float:
    """Do the same as :func:`disc_length` for arrays, which are broadcast against each other."""
    along = away_x * dx + away_y * dy
    inner = radius**2 - (away_x * dy - away_y * dx) ** 2
    length = along - np.sqrt(np.maximum(inner, 0.0))
    return np.where((inner > 0.0) & (length > 0.0), length, np.inf)
