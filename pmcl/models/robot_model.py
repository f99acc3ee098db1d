"""A robot model: start, motion and sensors together, and the same bound to logs."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pmcl.checks import check_flag, check_number, check_type
from pmcl.errors import LogError, ModelError
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect, named_apart
from pmcl.models.motions.increments.motion import IncrementNoise
from pmcl.models.motions.joined.seams import seams_of
from pmcl.models.motions.joined.table import joined_tables, parts_of_joined
from pmcl.models.motions.odometry.motion import Differential
from pmcl.models.parameters import Parameter, PriorTable, log_prior_function, prior_support, prior_table
from pmcl.models.part import BoundPart, Float, Int, Part
from pmcl.models.sensor import sensors as registered_sensors
from pmcl.models.starts.belief import StartBelief
from pmcl.models.tables import Tables, uniform

__all__ = ["BoundModel", "RobotModel", "default_model", "log_sequence"]


@dataclass(frozen=True)
class RobotModel:
    """What is believed about a robot, before any log.

    Attributes
    ----------
    motion : Part
        E.g. :class:`~pmcl.models.motions.increments.motion.IncrementNoise`.
    sensors : tuple of Part
        E.g. :class:`~pmcl.models.sensors.range_beams.sensor.RangeNoise`; readings of different sensors are independent
        given the path.
    start : Part
        Belief about the first state.
    priors : mapping of str to scipy.stats frozen distribution
        Replaces default priors, by parameter name.
    fixed : mapping of str to float
        Parameters that are known; they are not inferred.
    effects : tuple of Effect
        What plain parts leave out (:mod:`pmcl.models.effects`); their edits are applied in order, and their parameters
        join the others. Parameters of an effect that occurs several times are told apart by its place.

    Raises
    ------
    ModelError
        When `priors` or `fixed` name no parameter of the model, or two parts share a parameter name.
    """

    motion: Part = field(default_factory=IncrementNoise)
    sensors: tuple[Part, ...] = ()
    start: Part = field(default_factory=StartBelief)
    priors: Mapping[str, object] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        """Check types and names."""
        self._check_types()
        names = [parameter.name for owner in self.owners for parameter in owner.parameters]
        if len(set(names)) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ModelError(
                f"parameter names must differ between the parts of a model, but {twice} occur twice; rename one"
            )
        for what, given in (("priors", self.priors), ("fixed", self.fixed)):
            unknown = sorted(set(given) - set(names))
            if unknown:
                raise ModelError(f"{what} names {unknown}, but the model's parameters are {names}; correct the name")
        self._check_fixed()

    def _check_types(self) -> None:
        advice = "see pmcl.models for the built-in ones"
        check_type("motion", self.motion, Part, error=ModelError, advice=advice)
        check_type("start", self.start, Part, error=ModelError, advice=advice)
        for name, members, kind in (("sensors", self.sensors, Part), ("effects", self.effects, Effect)):
            check_type(name, members, (tuple, list), error=ModelError, advice="write a tuple, also around one")
            for member in members:
                check_type(f"each of {name}", member, kind, error=ModelError, advice=advice)
        for name, given in (("priors", self.priors), ("fixed", self.fixed)):
            check_type(name, given, Mapping, error=ModelError, advice="write a dict with parameter names as keys")
        for name, value in self.fixed.items():
            check_number(f"the fixed value of {name}", value, error=ModelError)

    def _check_fixed(self) -> None:
        for owner in self.owners:
            for parameter in owner.parameters:
                if parameter.name not in self.fixed:
                    continue
                value = float(self.fixed[parameter.name])
                if parameter.role == "noise" and value == 0.0:
                    raise ModelError(
                        f"{parameter.name} is fixed at 0: without noise in some direction a transition has no "
                        "density and no trajectory can be drawn backward; fix it at a small positive value, e.g. 0.001"
                    )
                low, high = prior_support(parameter.prior)
                if not low <= value <= high:
                    raise ModelError(
                        f"{parameter.name} is fixed at {value:g}, outside [{low:g}, {high:g}]; choose a value inside"
                    )

    @property
    def parts(self) -> tuple[Part, ...]:
        """Start, motion and sensors, in the order of their parameters."""
        return (self.start, self.motion, *self.sensors)

    @property
    def named_effects(self) -> tuple[Effect, ...]:
        """The effects with the parameter names that they have in this model."""
        return named_apart(self.effects)

    @property
    def owners(self) -> tuple[Part | Effect, ...]:
        """Everything that has parameters, in their order: the parts, then the effects."""
        return (*self.parts, *self.named_effects)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters to infer, with the priors in force."""
        return tuple(
            replace(p, prior=self.priors.get(p.name, p.prior))
            for owner in self.owners
            for p in owner.parameters
            if p.name not in self.fixed
        )

    def bind(self, logs: RobotLog | Sequence[RobotLog]) -> BoundModel:
        """Prepare for one or several logs of the same robot (one theta, one trajectory for each log).

        Raises
        ------
        ModelError, LogError, MapError
            When a log lacks what the model needs.
        """
        return BoundModel(self, log_sequence(logs))


@dataclass(frozen=True)
class _Slots:
    """Where a part's own parameters come from: theta[index] or, where index is -1, the fixed value."""

    index: Int
    value: Float

    @cached_property
    def some_fixed(self) -> bool:
        return bool((self.index < 0).any())

    @cached_property
    def run(self) -> slice | None:
        """The slice of theta that they are, if they stand there one after the other: it is taken at no cost."""
        if self.some_fixed or not self.index.size or (np.diff(self.index) != 1).any():
            return None
        return slice(int(self.index[0]), int(self.index[-1]) + 1)

    def take(self, theta: Float) -> Float:
        if not theta.size:
            return self.value  # all are fixed
        if self.run is not None:
            return theta[self.run]
        return np.where(self.index >= 0, theta[self.index], self.value) if self.some_fixed else theta[self.index]


class BoundModel:
    """A :class:`RobotModel` bound to logs: theta in, coefficient tables and densities out.

    Attributes
    ----------
    model : RobotModel
        The model.
    logs : tuple of RobotLog
        The logs.
    parameters : tuple of Parameter
        The d free parameters, in the order of theta.
    priors : PriorTable or None
        Their priors as arrays; None when one is of a family that compiled code does not know.
    lengths : tuple of int
        Number of time steps of each log.
    parts : tuple of tuple of BoundPart
        For each log: start, motion, sensors.
    seams : tuple of Seams or None
        For each log: where the robot begins anew, if several logs were joined to it.
    effects : tuple of Effect
        The model's effects, with the parameter names that they have in it.
    slots : tuple
        For each part, then for each effect: where its parameters come from.
    """

    def __init__(self, model: RobotModel, logs: tuple[RobotLog, ...]) -> None:
        self.model = model
        self.logs = logs
        self.parameters = model.parameters
        self.priors: PriorTable | None = prior_table(self.parameters)
        self.lengths = tuple(log.n_steps for log in logs)
        self.parts: tuple[tuple[BoundPart, ...], ...] = tuple(
            tuple(part.bind(log) for part in model.parts) for log in logs
        )
        self.seams = tuple(seams_of(log) for log in logs)
        self.effects = model.named_effects
        self.slots = self._slots()
        for log in logs:
            if log.n_readings == 0:
                raise LogError(f"{log.where}: expected at least one reading, but all are missing (NaN); record some")
        self._log_prior: Callable[[Float], float] = log_prior_function(self.parameters)
        if self.names:
            self.check(self.prior_mean())

    def on_later_rows(self, log: RobotLog) -> BoundModel:
        """Return the same model on other rows of its one log, with its start as it is.

        Nothing is checked again: this serves a robot that binds its model anew at every time step.
        """
        other = object.__new__(BoundModel)
        other.__dict__.update(self.__dict__)
        start = self.parts[0][0]
        other.logs, other.lengths, other.seams = (log,), (log.n_steps,), (None,)
        other.parts = ((start, *(part.bind(log) for part in self.model.parts[1:])),)
        return other

    def __getstate__(self) -> dict[str, object]:
        # The compiled prior is a closure, which pools of processes cannot pickle; it is made again from the parameters.
        return {name: value for name, value in self.__dict__.items() if name != "_log_prior"}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._log_prior = log_prior_function(self.parameters)

    def _slots(self) -> tuple[_Slots, ...]:
        position = {parameter.name: k for k, parameter in enumerate(self.parameters)}
        slots = []
        for owner in self.model.owners:
            own = [parameter.name for parameter in owner.parameters]
            index = np.array([position.get(name, -1) for name in own], dtype=np.int64)
            value = np.array([float(self.model.fixed.get(name, math.nan)) for name in own])
            slots.append(_Slots(index, value))
        return tuple(slots)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def dimension(self) -> int:
        """Number of free parameters d."""
        return len(self.parameters)

    def tables(self, theta: Float) -> tuple[Tables, ...]:
        """Return the coefficient tables of each log for `theta` (d,)."""
        own = [slots.take(theta) for slots in self.slots]
        n_parts = len(self.model.parts)
        of_logs = []
        for log, parts, seams in zip(self.logs, self.parts, self.seams, strict=True):
            start, motion, *sensors = (part.table(values) for part, values in zip(parts, own[:n_parts], strict=True))
            tables = Tables(start, motion, tuple(sensors))
            for effect, values in zip(self.effects, own[n_parts:], strict=True):
                tables = effect.edit(tables, values, log)
            # Kernels are compiled for each combination of table types, of which this keeps only few.
            tables = uniform(tables)
            of_logs.append(tables if seams is None else joined_tables(tables, seams))
        return tuple(of_logs)

    def restricted(self, rows: int) -> BoundModel:
        """Return the same model of no more than the first `rows` rows of each log.

        Tables stay those of whole logs, so that times and shares of a log keep their meaning; what is fitted and
        filtered ends after these rows.
        """
        shorter = copy.copy(self)
        shorter.lengths = tuple(min(rows, length) for length in self.lengths)
        return shorter

    def has_statistics(self, position: int) -> bool:
        """Return whether the statistics that a part offers are still those of its density, effects included.

        They are where effects only move what its table expects; `position` counts as in :attr:`parts`.
        """
        if position == 1 and any(seams is not None for seams in self.seams):
            return False
        touching = [effect for effect in self.effects if (effect.carrier == "motion") == (position == 1)]
        return position == 0 or all(effect.means_only for effect in touching)

    def log_prior(self, theta: Float) -> float:
        """Return the log prior density of `theta`; -inf outside its support."""
        return self._log_prior(theta)

    def prior_mean(self) -> Float:
        """Return the prior mean of theta, (d,); the median where there is no finite mean."""
        priors = [parameter.prior for parameter in self.parameters]
        means = [float(prior.mean()) for prior in priors]
        return np.array([
            mean if math.isfinite(mean) else float(prior.median()) for mean, prior in zip(means, priors, strict=True)
        ])

    def draw_prior(self, rng: np.random.Generator) -> Float:
        """Draw theta from its prior, (d,)."""
        return np.array([float(parameter.prior.rvs(random_state=rng)) for parameter in self.parameters])

    def check(self, theta: Float) -> None:
        """Check that `theta` gives a motion that has a transition density in every direction.

        Raises
        ------
        ModelError
            When some standard deviation of the motion is zero, negative or not a number.
        """
        for log, tables in zip(self.logs, self.tables(theta), strict=True):
            std = getattr(parts_of_joined(tables)[0].motion, "std", None)
            if std is None:
                continue
            bad = np.argwhere(~(np.asarray(std)[1:] > 0.0))
            if bad.size:
                t, component = int(bad[0][0]) + 1, int(bad[0][1:].sum())  # of one component: no second axis
                direction = ("forward", "left", "turn")[component] if component < 3 else f"component {component}"
                raise ModelError(
                    f"{log.where}: the motion model has no noise in direction '{direction}' at row {t} (its standard "
                    f"deviation is {float(std[t].flat[component]):g}), so no trajectory can be drawn backward; "
                    "give it a small positive noise"
                )


def log_sequence(logs: RobotLog | Sequence[RobotLog]) -> tuple[RobotLog, ...]:
    """Return one or several logs as a tuple.

    Raises
    ------
    LogError
        When there is none, or something else among them.
    """
    if isinstance(logs, RobotLog):
        return (logs,)
    advice = "read one with pmcl.read_log"
    check_type("logs", logs, (RobotLog, list, tuple), error=LogError, advice=advice)
    if not logs:
        raise LogError("expected at least one log, but got none; give a file")
    return tuple(check_type("each of logs", log, RobotLog, error=LogError, advice=advice) for log in logs)


def default_model(log: RobotLog, *, outliers: bool = False) -> RobotModel:
    """Return the model that fits what a log holds: usual motion and sensors, and the log's own start.

    A robot with a lidar has the odometry model of AMCL for a differential drive, whose alphas its filter will want; any
    other, and one that never moves, has the paper's motion.

    Parameters
    ----------
    log : RobotLog
        The log.
    outliers : bool
        Whether readings may be gross errors.

    Raises
    ------
    LogError, ModelError
        When these are of other types.
    """
    check_type("log", log, RobotLog, error=LogError, advice="read one with pmcl.read_log")
    check_flag("outliers", outliers, error=ModelError)
    usual = (sensor.default(log, outliers=outliers) for sensor in registered_sensors().values())
    motion = Differential() if log.lidars and log.odometry[1:].any() else IncrementNoise()
    return RobotModel(motion, tuple(sensor for sensor in usual if sensor is not None))
