"""How a quick filter reads a sensor: the part of a sensor's room that the preflight asks.

A preflight asks whether a log is explained much better by what it would be if somebody had made a mistake in writing
it. For that it runs a small particle filter in numpy, once for each mistake. What a mistake with the readings of a
sensor may be, and what the readings then mean, only the sensor knows:
:meth:`pmcl.models.sensor.Sensor.quick_readings` returns an object that derives from :class:`QuickReadings`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

__all__ = ["GROSS", "ChannelReading", "Misreading", "QuickDensity", "QuickReadings", "ReadAs", "gauss", "mixed", "some"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]

GROSS = 0.05
"""Share of readings that may be anything [1]: it bounds what a single reading can say against an explanation."""

_ROOT_2PI = math.sqrt(2.0 * math.pi)


class Misreading(NamedTuple):
    """A mistake that people make in writing the readings of a sensor.

    Attributes
    ----------
    name : str
        Of the finding, e.g. ``"bearings-in-degrees"``.
    finding, advice : str
        What seems to have been written, and what to do about it, for the message.
    change : Any
        What undoes the mistake; only the sensor's :meth:`QuickReadings.under` looks at it.
    """

    name: str
    finding: str
    advice: str
    change: Any


class ReadAs(NamedTuple):
    """One way to read a log, as a sensor sees it.

    Attributes
    ----------
    map_matrix : ndarray, shape (2, 2)
        A multiple of a rotation or reflection, by which the map is turned into what it should be.
    map_shift : ndarray, shape (2,)
        Added afterwards [m].
    change : Any
        From the sensor's own :class:`Misreading`; None where its readings are what they say.
    """

    map_matrix: Float
    map_shift: Float
    change: Any = None


class ChannelReading(NamedTuple):
    """One reading as a number that has nothing to do with the map.

    Attributes
    ----------
    channel : tuple
        Which distribution it belongs to, e.g. ``("beam", 3)``.
    value : float
        The reading, inf for "no echo".
    low, high : float
        Between which readings of the channel are numbers.
    width_outside : float
        Over how much readings beyond `high` spread; 1 where one number marks them all.
    """

    channel: tuple[str, int]
    value: float
    low: float
    high: float
    width_outside: float = 1.0


class QuickDensity(Protocol):
    """Log densities of a sensor's readings under H ways to read a log."""

    def __call__(self, row: int, way: Int, level: Float, x: Float, y: Float, heading: Float) -> Float:
        """Return the log density of the readings of one row, as numbers in the file's own units.

        Parameters
        ----------
        row : int
            Row of the log.
        way : ndarray of int, shape (G,)
            Which way to read the log each group of particles follows.
        level : ndarray, shape (G,)
            By what each group multiplies the usual noise.
        x, y, heading : ndarray, shape (G, n)
            The particles [m, m, rad].

        Returns
        -------
        ndarray, shape (G, n)
        """
        ...


class QuickReadings(ABC):
    """The readings of one sensor in one log, for a quick filter.

    Attributes
    ----------
    particles_anywhere : int
        Particles that find a robot of which nobody says where it started: many where a reading costs little.
    delays : tuple of float
        How late or early the stamps of the readings may be by mistake [s]; none where a clock is not asked for.
    start_may_be_elsewhere : bool
        Whether readings can tell a robot that starts elsewhere on the map than the log says.
    """

    particles_anywhere: ClassVar[int] = 2000
    delays: ClassVar[tuple[float, ...]] = ()
    start_may_be_elsewhere: ClassVar[bool] = False

    @property
    @abstractmethod
    def rows(self) -> NDArray[np.bool_]:
        """Which rows have readings, (T,)."""

    @abstractmethod
    def under(self, ways: Sequence[ReadAs]) -> QuickDensity:
        """Return the log densities of the readings under some ways to read the log."""

    @abstractmethod
    def channels(self, row: int) -> Iterable[ChannelReading]:
        """Return the readings of a row that count, for the explanation that they have nothing to do with the map.

        They are the readings of which :meth:`under` gives densities, in the same units: the two are compared.
        """

    def mistakes(self) -> Iterable[Misreading]:
        """Return the mistakes that could be seen in the readings; by default none."""
        return ()

    def map_points(self) -> Float | None:
        """Return points (N, 2) [m] whose bounding box holds the map, None for a sensor without one (the default)."""
        return None

    def free_places(self) -> Float | None:
        """Return places (N, 2) [m] where a robot may be, None where it may be anywhere in that box (the default)."""
        return None

    def margin(self) -> float:
        """Return how far outside the box of :meth:`map_points` the robot may be [m]."""
        return 0.0

    def is_same_map(self, matrix: Float, shift: Float) -> bool:
        """Tell whether the map comes out of a similarity as it went in, because it is symmetric; by default not.

        Parameters
        ----------
        matrix : ndarray, shape (2, 2)
            Rotation, reflection or scaling.
        shift : ndarray, shape (2,)
            Translation after it [m].

        Returns
        -------
        bool
        """
        return False


def gauss(residual: Float, std: Float) -> Float:
    """Return the density of a centred normal distribution.

    Parameters
    ----------
    residual, std : ndarray
        Where, and its standard deviation; shapes that broadcast.

    Returns
    -------
    ndarray
    """
    return np.asarray(np.exp(-0.5 * (residual / std) ** 2) / (_ROOT_2PI * std))


def mixed(residual: Float, std: Float, anything: Float | float) -> Float:
    """Return a normal density mixed with that of gross errors, which have the share :data:`GROSS`.

    Parameters
    ----------
    residual, std : ndarray
        As for :func:`gauss`.
    anything : ndarray or float
        Density of a gross error.

    Returns
    -------
    ndarray
    """
    return (1.0 - GROSS) * gauss(residual, std) + GROSS * anything


def some(which: Int, most: int) -> Int:
    """Return at most so many of some channels, evenly spread.

    Parameters
    ----------
    which : ndarray of int, shape (N,)
        The channels.
    most : int
        How many at most.

    Returns
    -------
    ndarray of int
    """
    if which.size <= most:
        return which
    chosen: Int = which[np.linspace(0, which.size - 1, most).round().astype(int)]
    return chosen
