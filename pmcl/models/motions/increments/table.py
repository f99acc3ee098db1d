"""The coefficient table of motion by noisy increments. T is the number of time steps."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.engine.tables import Axes, NoExtras

__all__ = ["IncrementMotion", "MotionExtras", "WanderingExtras"]

Float = NDArray[np.float64]


class MotionExtras(NamedTuple):
    """Increments in the robot frame that may slip, scatter with heavy tails, and fall short in places.

    Attributes
    ----------
    tail : float
        Inverse degrees of freedom of the noise (Student t with scale `std`, each component by itself); 0 is Gaussian.
    slip_weight, slip_share : float
        With probability `slip_weight` the translation of a step loses `slip_share` of its mean.
    patches : ndarray, shape (K, 4)
        Discs (x, y, radius [m], e): a step that begins in one loses the share e of its mean translation.
    """

    tail: Annotated[float, Axes(neutral=0.0)]
    slip_weight: Annotated[float, Axes(neutral=0.0)]
    slip_share: Annotated[float, Axes(neutral=0.0)]
    patches: Annotated[Float, Axes("patch", 4, neutral=0.0)]


class WanderingExtras(NamedTuple):
    """:class:`MotionExtras` of a motion whose turn rate wanders.

    The state has a fourth component u, a first-order autoregressive process of unit variance.

    turn[t] = mean[t] + wander[t] u[t-1] + noise, u[t] = keep[t] u[t-1] + sqrt(1 - keep[t]^2) normal. Along a path that
    has only the three components of a pose, its density is that with u integrated out.

    Attributes
    ----------
    tail, slip_weight, slip_share, patches
        As for :class:`MotionExtras`.
    wander : ndarray, shape (T,)
        Turn per unit of u [rad].
    keep : ndarray, shape (T,)
        Correlation of u with its value a step before, below 1.
    """

    tail: Annotated[float, Axes(neutral=0.0)]
    slip_weight: Annotated[float, Axes(neutral=0.0)]
    slip_share: Annotated[float, Axes(neutral=0.0)]
    patches: Annotated[Float, Axes("patch", 4, neutral=0.0)]
    wander: Annotated[Float, Axes("time", neutral=0.0)]
    keep: Annotated[Float, Axes("time", neutral=0.0)]


class IncrementMotion(NamedTuple):
    """Motion by noisy increments in the robot frame: x[t] = x[t-1] (+) (mean[t] + std[t] * standard normal).

    Attributes
    ----------
    mean, std : ndarray, shape (T, 3)
        Forward [m], left [m], turn [rad]; row 0 is not used.
    extras : NoExtras, MotionExtras or WanderingExtras
        What only effects use.
    """

    mean: Annotated[Float, Axes("time", 3)]
    std: Annotated[Float, Axes("time", 3)]
    extras: NoExtras | MotionExtras | WanderingExtras = NoExtras()
