"""The interfaces between a robot model and its parts."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pmcl.logs.robot_log import RobotLog
from pmcl.models.parameters import Parameter

__all__ = ["BoundPart", "Part", "owned"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]


@runtime_checkable
class BoundPart(Protocol):
    """A part of a model bound to one log: theta in, coefficient table out."""

    def table(self, theta: Float) -> NamedTuple:
        """Return the coefficient table for the part's own parameters `theta` (k,); called at every proposal."""
        ...

    def statistics(self, table: Any, path: Float, ideal: Any, index: Int, theta: Float) -> NamedTuple | None:
        """Return what the Metropolis block needs to know of a trajectory, or None to let it evaluate the joint density.

        Parameters
        ----------
        table : NamedTuple
            The part's current table.
        path : ndarray, shape (T, D)
            The trajectory; T may be less than the log's, while data is being included.
        ideal : Any
            For a sensor, its :meth:`~pmcl.models.sensor.Sensor.ideal_readings` along the path; None for motion.
        index : ndarray of int, shape (k,)
            Position of each of the part's parameters in theta, -1 for a fixed one.
        theta : ndarray, shape (k,)
            Current values of the part's parameters.

        Returns
        -------
        NamedTuple or None
            Of a type that registers :func:`pmcl.engine.residuals.theta_logpdf`, e.g.
            :class:`~pmcl.engine.residuals.GaussianSums`. A part that derives from this class and leaves the method
            out returns None.
        """
        return None


@runtime_checkable
class Part(Protocol):
    """Motion, a sensor, or a start belief before it has seen a log."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The part's own parameters, in the order in which its table function takes them."""
        ...

    def bind(self, log: RobotLog) -> BoundPart:
        """Prepare for one log; raises ModelError when the log lacks what the part needs."""
        ...


def owned(array: Any) -> Float:
    """Return a writable contiguous float copy: compiled code has one type for these, another for read-only arrays."""
    return np.array(array, dtype=np.float64, order="C")
