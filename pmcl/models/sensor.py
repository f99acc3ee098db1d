"""The door of a sensor's room: everything that generic code asks a sensor.

A sensor is one class that derives from :class:`Sensor`, and one table type. The class says what the sensor's readings
are called in a log, which parameters it has, how theta becomes a table, and what the table ideally reads; compiled
functions of the table are registered with :mod:`pmcl.engine.contract`. Generic code (logs, model files, simulation,
localization, the critic, reports) asks the class and knows no sensor by name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from pmcl.errors import ModelError
from pmcl.logs.arrays import LogArrays
from pmcl.logs.sensor_variables import SensorVariables
from pmcl.models.parameters import Parameter
from pmcl.models.part import BoundPart
from pmcl.models.quick import QuickReadings
from pmcl.registry import SENSORS, register, registered

__all__ = ["ReadingIndex", "Sensor", "register_sensor", "sensor_of", "sensors"]

Float = NDArray[np.float64]
Int = NDArray[np.int64]
_Class = TypeVar("_Class", bound="type[Sensor]")


class ReadingIndex(NamedTuple):
    """What each single reading of a sensor is; the kernels call their places slots.

    Attributes
    ----------
    kinds : tuple of str
        Names of the variables in a log that hold the readings, e.g. ``("range",)``.
    kind, channel, time : ndarray of int, shape (N,)
        Position in `kinds`; beam or landmark; row.
    reading : ndarray, shape (N,)
        The reading in its own unit, NaN where nothing was measured.
    """

    kinds: tuple[str, ...]
    kind: Int
    channel: Int
    time: Int
    reading: Float


_of_table: dict[type, type[Sensor]] = {}


class Sensor(SensorVariables, ABC):
    """A sensor model; a class derives from it for each kind of sensor.

    A subclass is a frozen dataclass whose fields are the settings of the model, e.g. whether readings may be gross
    errors. Model files hold these fields: booleans, numbers, and texts out of the field's metadata ``choices``, with
    its metadata ``comment`` beside them.

    Attributes
    ----------
    table_type : type
        The NamedTuple type of its coefficient table.
    variables : mapping of str to Variable
        The variables that it has in a log, by their names in the file.
    summary : str
        What it is, in a few words, for comments and tables.
    """

    table_type: ClassVar[type]
    summary: ClassVar[str] = ""

    def __init_subclass__(cls, **options: Any) -> None:
        """Remember which class the tables of a type belong to; raises ModelError when they belong to another."""
        super().__init_subclass__(**options)
        if "table_type" not in cls.__dict__:
            return
        known = _of_table.setdefault(cls.table_type, cls)
        if known is not cls:
            # A notebook may run the cell that defines a class once more.
            if (known.__module__, known.__qualname__) != (cls.__module__, cls.__qualname__):
                raise ModelError(
                    f"expected tables of type {cls.table_type.__name__} to belong to one class of sensors, but both "
                    f"{known.__module__}.{known.__qualname__} and {cls.__module__}.{cls.__qualname__} have it as their "
                    "table_type; give the second class a table type of its own"
                )
            _of_table[cls.table_type] = cls

    # What a model holds.

    @classmethod
    def default(cls, log: LogArrays, *, outliers: bool = False) -> Self | None:
        """Return the usual model for a log, or None when the log has no readings of this sensor.

        Parameters
        ----------
        log : LogArrays
            The log.
        outliers : bool
            Whether readings may be gross errors, where the sensor's model offers that.

        Returns
        -------
        Sensor or None
        """
        return cls() if any(name in log.dataset for name in cls.readings(log.dataset)) else None

    def usual_settings(self, log: LogArrays) -> dict[str, object]:
        """Return the settings that follow from a log where the model leaves them open (None), for model files.

        Parameters
        ----------
        log : LogArrays
            The log.

        Returns
        -------
        dict of str to object
            Values by the names of the class's fields; by default nothing.
        """
        return {}

    def with_exponent(self, exponent: float) -> Self | None:
        """Return the sensor with another exponent of its readings' densities, which tempers errors that they share.

        Parameters
        ----------
        exponent : float
            In (0, 1].

        Returns
        -------
        Sensor or None
            None when the sensor has no exponent, as by default.
        """
        return None

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The sensor's parameters, in the order in which its table function takes them."""

    @abstractmethod
    def bind(self, log: Any) -> BoundPart:
        """Prepare for one log; raises ModelError when the log lacks what the model needs."""

    # What can be said of a table without its kernels.

    @staticmethod
    def ideal_readings(table: Any, path: Float) -> Any:
        """Return what the sensor would ideally read along a path, before bias, scale and noise.

        Parameters
        ----------
        table : NamedTuple
            A table of the sensor.
        path : ndarray, shape (T, D)
            States; T may be less than the log's.

        Returns
        -------
        Any
            Whatever the sensor's own statistics and simulation use; None when they need nothing.
        """
        return None

    @staticmethod
    def linearise(table: Any, reference: Float) -> Any:
        """Linearise the readings once around a reference trajectory.

        Parameters
        ----------
        table : NamedTuple
            A table of the sensor.
        reference : ndarray, shape (T, D)
            The trajectory.

        Returns
        -------
        NamedTuple or None
            What :func:`pmcl.engine.contract.linear_information` takes; None when the sensor has no linearisation, so
            that no Gaussian transport is possible with it.
        """
        return None

    @staticmethod
    def fitted_linearisation(table: Any, linearisation: Any, reference: Float, paths: Float) -> Any:
        """Return a linearisation that fits the readings along some paths better than that at their mean.

        Parameters
        ----------
        table : NamedTuple
            The table that `linearisation` was made from.
        linearisation : NamedTuple
            From :meth:`linearise`.
        reference : ndarray, shape (T, D)
            The reference trajectory.
        paths : ndarray, shape (N, T, D)
            Paths of the posterior.

        Returns
        -------
        NamedTuple
            `linearisation` itself where a sensor has no better one.
        """
        return linearisation

    @staticmethod
    def moved_linearisation(table: Any, made_from: Any, linearisation: Any, reference: Float) -> Any:
        """Return a linearisation for a table whose mount or map is not that of the table it was made from.

        Parameters
        ----------
        table : NamedTuple
            A table under some theta.
        made_from : NamedTuple
            The table that `linearisation` was made from.
        linearisation : NamedTuple
            From :meth:`linearise`.
        reference : ndarray, shape (T, D)
            The reference trajectory.

        Returns
        -------
        NamedTuple
            `linearisation` itself where nothing has moved; else one with the ideal values that `table` has at the
            reference. Slopes stay. Cost: O(readings) where something has moved.
        """
        return linearisation

    @staticmethod
    def linearisation_like(table: Any) -> Any:
        """Return an empty linearisation of the type that :meth:`linearise` makes of such a table, to compile for."""
        return None

    @classmethod
    def simulate(cls, table: Any, path: Float, rng: np.random.Generator) -> Any:
        """Draw readings along a path; what was not measured stays missing.

        Parameters
        ----------
        table : NamedTuple
            A table; its readings say only what was measured when (NaN: nothing), and are replaced.
        path : ndarray, shape (T, D)
            States for all rows of the table.
        rng : numpy.random.Generator
            Source of randomness.

        Returns
        -------
        NamedTuple
            The table with new readings. Cost: O(readings), plus the map for each.

        Raises
        ------
        ModelError
            When the sensor cannot be simulated.
        """
        raise ModelError(
            f"expected a sensor that can be simulated, but the one of table {_table_name(table)} has no 'simulate'; "
            "write one in its class"
        )

    @classmethod
    def replicate(cls, table: Any, path: Float, rng: np.random.Generator) -> Any:
        """Return the table with readings drawn from it along a path, to compare recorded ones with.

        It differs from :meth:`simulate` where the model knows that the readings of a row share their errors, and does
        not say how: their densities are then tempered (:func:`pmcl.engine.contract.reading_exponent`).

        Parameters
        ----------
        table, path, rng
            As for :meth:`simulate`.

        Returns
        -------
        NamedTuple
            By default what :meth:`simulate` returns.
        """
        return cls.simulate(table, path, rng)

    @classmethod
    def store(cls, table: Any, dataset: xr.Dataset) -> None:
        """Write the readings of a table into a log's dataset, in place.

        Parameters
        ----------
        table : NamedTuple
            A table with the readings, e.g. from :meth:`simulate`.
        dataset : xarray.Dataset
            Of the log that the table was made from; its arrays can be written.

        Raises
        ------
        ModelError
            When the sensor does not say how.
        """
        raise ModelError(
            f"expected a sensor whose readings can be put into a log, but the one of table {_table_name(table)} has no "
            "'store'; write one in its class"
        )

    @staticmethod
    def along(table: Any, path: Float) -> dict[str, Float]:
        """Return what terms of formulas may know of each channel at each row along a path.

        Parameters
        ----------
        table : NamedTuple
            A table of the sensor.
        path : ndarray, shape (T, >= 3)
            The path, headings not wrapped [m, m, rad].

        Returns
        -------
        dict of str to ndarray, shape (T, channels)
            By the names of :data:`pmcl.models.effects.terms.OF_BEAMS`; by default nothing.
        """
        return {}

    @staticmethod
    def covariates(table: Any, path: Float, index: ReadingIndex) -> dict[str, Float]:
        """Return what each of some readings should be along a path, on which its residual may depend.

        Parameters
        ----------
        table : NamedTuple
            A table of the sensor.
        path : ndarray, shape (T, D)
            The path.
        index : ReadingIndex
            The N readings.

        Returns
        -------
        dict of str to ndarray, shape (N,)
            ``distance`` [m], ``direction`` [rad] in the world, ``incidence`` [rad] (0: square on); by default nothing.
        """
        return {}

    @staticmethod
    def parts_that_differ(table: Any, other: Any) -> tuple[Any, Any]:
        """Return two tables without the channels in which they are the same, so that comparing them costs less.

        Parameters
        ----------
        table, other : NamedTuple
            Tables of the sensor, with equal readings.

        Returns
        -------
        tuple of two NamedTuples, or of None and None where they are the same
            By default the tables as they are.
        """
        return table, other

    @staticmethod
    def score_cache(table: Any, columns: Float) -> Any:
        """Return an object that evaluates log densities of edited tables along trajectories faster than the kernels.

        Parameters
        ----------
        table : NamedTuple
            The table that candidates of effects edit.
        columns : ndarray, shape (M, D, T)
            Trajectories.

        Returns
        -------
        object or None
            With a method ``terms(edited table)`` that returns (M, T) log densities, or None for a table that it cannot
            evaluate; by default there is no such object.
        """
        return None

    @staticmethod
    def scoring_calls(table: Any, columns: Float) -> list[tuple[Any, tuple[Any, ...]]]:
        """Return the compiled functions and arguments that the object of :meth:`score_cache` calls, to compile them.

        Parameters
        ----------
        table : NamedTuple
            A table of the sensor.
        columns : ndarray, shape (M, D, T)
            Trajectories.

        Returns
        -------
        list of (function, arguments)
            By default empty.
        """
        return []

    @staticmethod
    def quick_readings(log: LogArrays, usual: Mapping[str, float]) -> QuickReadings | None:
        """Return how a quick filter reads the sensor, so that the preflight can look for mistakes with it.

        Parameters
        ----------
        log : LogArrays
            A validated log.
        usual : mapping of str to float
            Usual values of parameters, the sensor's own among them, by name.

        Returns
        -------
        QuickReadings or None
            None when the log has no readings of the sensor, or no map for them; by default always, so that the
            preflight says nothing of the sensor.
        """
        return None

    @staticmethod
    def index(table: Any, n_steps: int) -> ReadingIndex:
        """Return what each slot of a table is, in the order of its kernel ``reading_slots``.

        By default there is one slot for each row, named after the table.

        Parameters
        ----------
        table : NamedTuple
            A table of the sensor.
        n_steps : int
            Rows of the log that count, from the first on.

        Returns
        -------
        ReadingIndex
        """
        rows = np.arange(n_steps, dtype=np.int64)
        nothing = np.zeros(n_steps, dtype=np.int64)
        return ReadingIndex((_table_name(table),), nothing, nothing, rows, np.full(n_steps, np.nan))


    @classmethod
    def independent_readings(cls, table: Any, n_steps: int) -> Float:
        """Return how many independent readings those of each row are worth.

        Parameters
        ----------
        table : NamedTuple
            A table of the sensor.
        n_steps : int
            Rows of the log that count, from the first on.

        Returns
        -------
        ndarray, shape (n_steps,)
            By default the number of readings that :meth:`index` names and that were measured. A sensor whose densities
            are tempered returns less.
        """
        index = cls.index(table, n_steps)
        measured = ~np.isnan(index.reading)
        return np.bincount(index.time[measured], minlength=n_steps).astype(float)


def _table_name(table: Any) -> str:
    return type(table).__name__


class _Unknown(Sensor):
    """Answers for a table whose type no class of sensors names."""


def sensor_of(table: Any) -> type[Sensor]:
    """Return the class of sensors that a table belongs to.

    Parameters
    ----------
    table : NamedTuple
        A sensor's table.

    Returns
    -------
    type
        For a table type that no class names, one that answers as :class:`Sensor` does by default.
    """
    return _of_table.get(type(table), _Unknown)


def sensors() -> dict[str, type[Sensor]]:
    """Return all registered classes of sensors by the names that model files have for them."""
    return registered(SENSORS)


def register_sensor(name: str) -> Callable[[_Class], _Class]:
    """Register a class of sensors for this process; an installed package uses an entry point instead.

    Parameters
    ----------
    name : str
        Its name in model files, e.g. ``"compass"`` for the table ``[sensors.compass]``.

    Returns
    -------
    callable
        A decorator for the class.

    Raises
    ------
    ModelError
        When the name is taken.
    """

    def decorate(sensor: _Class) -> _Class:
        register(SENSORS, name, sensor)
        return sensor

    return decorate
