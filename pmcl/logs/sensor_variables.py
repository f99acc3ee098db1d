"""What a sensor is in a robot log: its variables, how they are checked and counted, and what looks like a mistake.

A sensor's model (:class:`pmcl.models.sensor.Sensor`) derives from this class. Generic code about logs asks it and knows
no sensor by name. It is a class of its own, so that a log can be read without loading any model.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.logs.finding import Finding
from pmcl.logs.schema import Variable, named

if TYPE_CHECKING:
    from pmcl.logs.arrays import LogArrays

__all__ = ["ReadingSeries", "SensorVariables"]

Float = NDArray[np.float64]


class ReadingSeries(NamedTuple):
    """The readings of one channel of a sensor over all rows of a log.

    Attributes
    ----------
    name : str
        What the channel is called in messages, e.g. ``"beam 3"``.
    values : ndarray, shape (T,)
        Its readings; NaN where nothing was measured, and where the sensor clips its readings.
    """

    name: str
    values: Float


class SensorVariables:
    """What one kind of sensor is in a log.

    Attributes
    ----------
    variables : mapping of str to Variable
        The variables that it has in a log, by their names in the file.
    patterns : mapping of str to Variable
        Variables of sensors of which a robot may have several, each with a name, by patterns such as
        ``"scan_{name}"``; see :func:`pmcl.logs.schema.named`.
    """

    variables: ClassVar[Mapping[str, Variable]] = {}
    patterns: ClassVar[Mapping[str, Variable]] = {}

    @classmethod
    def declared(cls, held: Iterable[object] = ()) -> dict[str, Variable]:
        """Return the sensor's variables: those that have a fixed name, and those of `held` that match a pattern.

        Parameters
        ----------
        held : iterable of str
            Names of variables in a log.

        Returns
        -------
        dict of str to Variable
        """
        found = dict(cls.variables)
        if cls.patterns:
            for name in map(str, held):
                variable = None if name in found else named(cls.patterns, name)
                if variable is not None:
                    found[name] = variable
        return found

    @classmethod
    def readings(cls, held: Iterable[object] = ()) -> tuple[str, ...]:
        """Return the names of the variables that hold readings; `held` is that of :meth:`declared`."""
        return tuple(name for name, variable in cls.declared(held).items() if variable.is_reading)

    @classmethod
    def check(cls, dataset: xr.Dataset, where: str) -> None:
        """Check the sensor's variables in a log, beyond what their declarations say.

        Parameters
        ----------
        dataset : xarray.Dataset
            A log; its variables have the declared dimensions, and its readings keep the declared bounds. Attributes
            may be brought into their usual form here.
        where : str
            File or call, for messages.

        Raises
        ------
        LogError, MapError
            When something is missing or impossible.
        """

    @classmethod
    def count(cls, readings: Mapping[str, Float]) -> NDArray[np.int64]:
        """Return how many readings there are in each row.

        Parameters
        ----------
        readings : mapping of str to ndarray, shape (T, ...)
            Those variables of the sensor that hold readings and that the log has.

        Returns
        -------
        ndarray of int, shape (T,)
            By default, each number counts.
        """
        counts = [np.count_nonzero(~np.isnan(values.reshape(len(values), -1)), axis=1) for values in readings.values()]
        return np.asarray(np.sum(counts, axis=0), dtype=np.int64)

    @classmethod
    def settings(cls, log: LogArrays) -> dict[str, Float]:
        """Return what calibration sees of the sensor beside its variables, for the log's fingerprint.

        Parameters
        ----------
        log : LogArrays
            Any log, also one without the sensor.

        Returns
        -------
        dict of str to ndarray
            By name; by default nothing.
        """
        return {}

    @classmethod
    def series(cls, log: LogArrays) -> Iterable[ReadingSeries]:
        """Return the readings of each channel, for checks that look for repeated readings.

        Parameters
        ----------
        log : LogArrays
            The log.

        Returns
        -------
        iterable of ReadingSeries
            By default one for each column of each variable that holds readings.
        """
        for name in cls.readings(log.dataset):
            values = log.variable(name)
            if values is None:
                continue
            columns = values.reshape(len(values), -1).T
            for number, column in enumerate(columns):
                yield ReadingSeries(name if len(columns) == 1 else f"{name} {number}", column)

    @classmethod
    def implausible(cls, log: LogArrays) -> Iterable[Finding]:
        """Return what the sensor's own numbers show by themselves: mistakes in writing the log.

        Parameters
        ----------
        log : LogArrays
            A validated log.

        Returns
        -------
        iterable of Finding
            By default nothing.
        """
        return ()
