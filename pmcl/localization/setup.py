"""From a log, a model and a posterior to a filter that is ready to run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.checks import check_memory, check_type, check_whole
from pmcl.errors import FilterError, LogError, ModelError
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.filtering.tracker import Tracker
from pmcl.localization.options import FilterOptions
from pmcl.localization.parameters import choose_theta
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.formula import path_formulas
from pmcl.models.robot_model import BoundModel, RobotModel, default_model
from pmcl.models.sensor import sensor_of
from pmcl.models.starts.belief import StartBelief
from pmcl.models.starts.table import GaussianStart, PoseStart, WiderStart
from pmcl.models.tables import Tables
from pmcl.posterior.compat import Posterior
from pmcl.posterior.estimates import posterior_mean

__all__ = ["Prepared", "anywhere", "independent_readings", "prepare"]

Float = NDArray[np.float64]

# A filter keeps some fifty numbers for each particle: states, weights, scratch space.
_BYTES_PER_PARTICLE = 400.0


@dataclass(frozen=True)
class Prepared:
    """A filter and what it was made from.

    Attributes
    ----------
    bound : BoundModel
        The model bound to the log.
    theta : ndarray, shape (K, d)
        Values of the parameters that the filter works with.
    tracker : Tracker
        The filter.
    counts : ndarray, shape (T,)
        How many independent readings those of each row are worth.
    options : FilterOptions
        How it works.
    """

    bound: BoundModel
    theta: Float
    tracker: Tracker
    counts: Float
    options: FilterOptions

    @property
    def log(self) -> RobotLog:
        """The log."""
        return self.bound.logs[0]


def prepare(
    log: RobotLog,
    model: RobotModel | None,
    posterior: Posterior | None,
    method: str,
    theta: Mapping[str, float] | None,
    particles: int,
    options: FilterOptions | None,
) -> Prepared:
    """Make the filter for one log.

    Parameters
    ----------
    log, model, posterior, method, theta, particles, options
        As for :func:`pmcl.localization.offline.localize`.

    Returns
    -------
    Prepared

    Raises
    ------
    PmclError
        As :func:`pmcl.localization.offline.localize` does.
    """
    check_type("log", log, RobotLog, error=LogError, advice="read one with pmcl.read_log")
    if model is not None:
        check_type("model", model, RobotModel, error=ModelError, advice="leave it out for the default model")
    options = FilterOptions() if options is None else options
    check_type("options", options, FilterOptions, error=FilterError, advice="make them with FilterOptions(...)")
    particles = check_whole("particles", particles, 2, error=FilterError, advice="25 to 1000 are usual")
    if theta is not None:
        check_type("theta", theta, Mapping, error=ModelError, advice="write a dict with parameter names as keys")
    model = model or default_model(log)
    bound = model.bind(_with_path(log, model, posterior, theta))
    values, picks = choose_theta(bound, posterior, method, theta, options)
    tables = [bound.tables(value)[0] for value in values]
    start = tables[0].start
    unknown_start = anywhere(log, start) if options.recover else None
    greatest = options.most_particles(particles, start, unknown_start)
    check_memory("the particles", _BYTES_PER_PARTICLE * greatest, error=FilterError, advice="use fewer")
    tracker = Tracker(tables, unknown_start, options.for_kernel(particles, len(values), picks, start, unknown_start))
    return Prepared(bound, values, tracker, independent_readings(tables[0], log.n_steps), options)


def independent_readings(tables: Tables, n_steps: int) -> Float:
    """Return how many independent readings those of each row are worth, of all sensors together.

    Parameters
    ----------
    tables : Tables
        The tables of one theta.
    n_steps : int
        Rows that count, from the first on.

    Returns
    -------
    ndarray, shape (n_steps,)
    """
    total = np.zeros(n_steps)
    for sensor in tables.sensors:
        total += sensor_of(sensor).independent_readings(sensor, n_steps)
    return total


def _with_path(
    log: RobotLog, model: RobotModel, posterior: Posterior | None, theta: Mapping[str, float] | None
) -> RobotLog:
    """Return the log with the path that formulas of the model need, each pose foreseen from earlier rows."""
    needing = path_formulas(model.effects)
    if needing and not log.is_whole:
        raise ModelError(
            f"{log.where}: expected effects that need no path, as a robot is followed row by row, but got "
            f"{needing[0].name}; localize a whole log, or leave that effect out"
        )
    known = {} if posterior is None or not needing else posterior_mean(posterior)
    return with_estimated_path(log, model, {**known, **(theta or {})}, ahead=True)


def anywhere(log: RobotLog, start: Any) -> Any:
    """Return the start belief of a robot that may be anywhere on the log's map, with which recovery looks for it.

    Parameters
    ----------
    log : RobotLog
        Its map tells where a robot can be.
    start : NamedTuple
        The model's own start table, whose components beyond the pose are kept.

    Returns
    -------
    NamedTuple
        A start table.

    Raises
    ------
    ModelError
        When there is no map to be anywhere on, or the states are no poses.
    """
    size = start.mean.size if isinstance(start, GaussianStart) else 3
    if not isinstance(start, GaussianStart | PoseStart | WiderStart) or size < 3:
        raise ModelError(
            f"{log.where}: recovery expects a robot whose start is a pose, but got a start of type "
            f"{type(start).__name__} of the model's own; leave recovery out"
        )
    unknown = StartBelief(mean=(0.0, 0.0, 0.0), std=(np.inf, np.inf, np.inf)).bind(log).fixed
    assert isinstance(unknown, PoseStart)
    if isinstance(start, WiderStart):
        return start._replace(pose=unknown)
    return unknown if size == 3 else WiderStart(unknown, start.mean[3:].copy(), start.std[3:].copy())
