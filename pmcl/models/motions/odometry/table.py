"""The coefficient tables of motion by odometry. T is the number of time steps."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.tables import Axes

__all__ = ["DifferentialMotion", "OmniMotion"]

Float = NDArray[np.float64]


class DifferentialMotion(NamedTuple):
    """Motion as a turn, a straight drive and a second turn, each with Gaussian noise.

    The three are derived from the mean inside the kernels, so that an effect which changes the mean changes them too.

    Attributes
    ----------
    mean : ndarray, shape (T, 3)
        What odometry says of each step: forward [m], left [m], turn [rad]; row 0 is not used.
    alpha : ndarray, shape (4,)
        alpha1 [1], alpha2 [rad^2/m^2], alpha3 [1] and alpha4 [m^2/rad^2], which multiply squares of the turns and of
        the drive: see :class:`~pmcl.models.motions.odometry.motion.Differential`.
    """

    mean: Annotated[Float, Axes("time", 3)]
    alpha: Annotated[Float, Axes(4)]


class OmniMotion(NamedTuple):
    """Motion with Gaussian noise along and across the direction of the odometry's step, and on its turn.

    Attributes
    ----------
    mean : ndarray, shape (T, 3)
        What odometry says of each step: forward [m], left [m], turn [rad]; row 0 is not used.
    alpha : ndarray, shape (5,)
        As for :class:`DifferentialMotion`, then alpha5 [1]: see :class:`~pmcl.models.motions.odometry.motion.Omni`.
    """

    mean: Annotated[Float, Axes("time", 3)]
    alpha: Annotated[Float, Axes(5)]
