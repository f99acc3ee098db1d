"""What a calibration method is. A new one is a subclass in a module of its own, and its registration."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from pmcl.calibration.settings import settings_of

if TYPE_CHECKING:
    from typing import Self

    from pmcl.models.robot_model import BoundModel
    from pmcl.sampling.chains import Chains, PointEstimate
    from pmcl.sampling.options import RunOptions, SettingValue

__all__ = ["CalibrationMethod", "Variant"]


class Variant(NamedTuple):
    """A short name for a method with some of its settings, as ``pmcl compare`` reads them.

    Attributes
    ----------
    settings : mapping of str to object
        Settings that differ from the method's defaults.
    description : str
        What the method does with them, in a few words.
    """

    settings: Mapping[str, Any]
    description: str


@dataclass(frozen=True)
class CalibrationMethod(abc.ABC):
    """One way to find the parameters of a model from logs. Its dataclass fields are its settings.

    Declare each field with :func:`pmcl.calibration.settings.setting`: it is then checked, has an option on the command
    line and a line in its help. A module of a method should import the libraries it needs inside its functions, so that
    reading the settings costs nothing.

    Attributes
    ----------
    name : str
        The name by which it is registered; class attribute.
    description : str
        What it does, in a few words; class attribute.
    variants : mapping of str to Variant
        Names for it with other settings, for ``pmcl compare``; its own name may be one of them. Class attribute.
    """

    name: ClassVar[str]
    description: ClassVar[str]
    variants: ClassVar[Mapping[str, Variant]] = {}

    def __post_init__(self) -> None:
        """Check the settings; raises SamplingError."""
        for name, declared in settings_of(self).items():
            declared.check(name, getattr(self, name))

    @abc.abstractmethod
    def run(self, bound: BoundModel, options: RunOptions) -> Chains | PointEstimate:
        """Calibrate.

        Parameters
        ----------
        bound : BoundModel
            The model bound to its logs.
        options : RunOptions
            Draws, chains, seed, trajectories, pool, checkpoint, progress and stopwatch. A method that has no use for
            one of them ignores it, but the seed decides all of its randomness. A long run calls
            :func:`pmcl.interrupts.check_interrupt` now and then, and ends at the stopwatch's limit if there is one.

        Returns
        -------
        Chains or PointEstimate
            Draws, with trajectories and a joint density or without; or one estimate, with standard errors or without.
            Their settings hold :meth:`record` and ``options.attributes``.

        Raises
        ------
        PmclError
            When the method cannot be used with this model, or finds nothing.
        """

    def resolved(self, bound: BoundModel, options: RunOptions) -> Self:
        """Return the method with a value for each setting whose default depends on the logs or the run.

        Parameters
        ----------
        bound : BoundModel
            The model bound to its logs.
        options : RunOptions
            How the run is carried out.

        Returns
        -------
        CalibrationMethod
        """
        return self

    def record(self, options: RunOptions) -> dict[str, SettingValue]:
        """Return what the result keeps of the run, and what a checkpoint knows its run by.

        Parameters
        ----------
        options : RunOptions
            How the run is carried out.

        Returns
        -------
        dict of str to scalar
            Name of the method, its settings, and what of the options decides the result.
        """
        settings = {
            field.name: value if isinstance(value, str | int | float | bool) else str(value)
            for field in dataclasses.fields(self)
            for value in [getattr(self, field.name)]
        }
        shared = {name: getattr(options, name) for name in ("chains", "seed", "draws", "trajectories")}
        return {"method": self.name, **shared, **settings}

    def shortest(self) -> Self:
        """Return the method with the least work that still compiles and imports everything it needs."""
        return self

    @property
    def usual_particles(self) -> int | None:
        """Number of particles that it has been given or has by default; None for a method without particles."""
        return getattr(self, "particles", None)
