"""An estimate of the path of a log, for effects that depend on where the robot was and where it looked.

Effects are edits of tables that are made before a filter runs. A formula of the heading or the place is therefore
evaluated along an estimated path, which a first filter finds without the formulas that need it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import FilterError, ModelError
from pmcl.filtering.not_a_number import parameters_told
from pmcl.filtering.particle_filter import draw_paths, make_rng, run_filter
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.formula import path_formulas
from pmcl.models.robot_model import BoundModel, RobotModel
from pmcl.models.sensor import sensor_of
from pmcl.models.tables import Tables

__all__ = ["START_PARTICLES", "plausible_theta", "with_estimated_path", "with_estimates"]

Float = NDArray[np.float64]

START_PARTICLES = 1000
"""Particles of a filter that is run before anything is known about a log."""
# Noise far too small for a log makes a filter lose the robot; these factors on the prior mean are tried in turn.
_START_FACTORS = (1.0, 2.0, 4.0, 0.5)
# Paths drawn backward, whose mean is the estimate.
_PATHS = 20


def plausible_theta(bound: BoundModel, rng: np.random.Generator) -> Float:
    """Return a multiple of the prior mean under which the filter foresees the log best.

    Parameters
    ----------
    bound : BoundModel
        The model, bound to one log.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    ndarray, shape (d,)
        Parameters; only standard deviations are multiplied.

    Raises
    ------
    FilterError
        When the filter loses the robot with each of them.
    """
    best, found = -math.inf, None
    for factor in _START_FACTORS:
        theta = bound.prior_mean()
        scale = np.array([parameter.scales_noise for parameter in bound.parameters], dtype=bool)
        theta = np.where(scale, factor * theta, theta)
        try:
            with parameters_told(bound, theta):
                value = run_filter(bound.tables(theta)[0], bound.lengths[0], START_PARTICLES, rng).log_evidence
        except (FilterError, ModelError):
            continue
        if value > best:
            best, found = value, theta
    if found is None:
        raise FilterError(
            f"{bound.logs[0].where}: the filter loses the robot at once, whatever the noise; "
            "restart with a wider start belief or more particles"
        )
    return found


def with_estimated_path(
    log: RobotLog,
    model: RobotModel,
    theta: Mapping[str, float] | None = None,
    *,
    ahead: bool = False,
    always: bool = False,
    seed: int = 0,
) -> RobotLog:
    """Return a log with an estimate of its path, where the model has formulas that need one.

    Parameters
    ----------
    log : RobotLog
        One that holds an estimate already comes back as it is.
    model : RobotModel
        The formulas that need a path are left out of it for the estimate.
    theta : mapping of str to float, optional
        Values of its parameters; those that are missing are chosen so that the filter foresees the log well.
    ahead : bool
        Whether each pose may depend on earlier rows only, as a localization that is judged by what it foresees must;
        else on all rows.
    always : bool
        Whether the path is estimated also for a model without such formulas, because some may be added.
    seed : int
        All randomness follows from it.

    Returns
    -------
    RobotLog
        The log itself where no formula needs a path. Cost: one to five filters of 1000 particles.

    Raises
    ------
    ModelError, FilterError
        When model and log do not fit each other, or the filter loses the robot.
    """
    needing = path_formulas(model.named_effects)
    if not (needing or always) or log.estimated("path") is not None:
        return log
    # A coefficient of zero needs no path.
    zero = {parameter.name: 0.0 for effect in needing for parameter in effect.parameters}
    priors = {name: prior for name, prior in model.priors.items() if name not in zero}
    bound = replace(model, fixed={**model.fixed, **zero}, priors=priors).bind(log)
    rng = make_rng(np.random.SeedSequence((seed, 23)))
    known = theta or {}
    missing = [name for name in bound.names if name not in known]
    chosen = dict(zip(bound.names, plausible_theta(bound, rng), strict=True)) if missing else {}
    tables = bound.tables(np.array([float(known.get(name, chosen.get(name, 0.0))) for name in bound.names]))[0]
    filtered = run_filter(tables, log.n_steps, START_PARTICLES, rng)
    if ahead:
        # Resampled at every row, particles have equal weights before the readings of a row are taken in.
        path = filtered.particles[:, :3].mean(axis=2)
    else:
        path = draw_paths(tables, filtered, _PATHS, rng)[:, :, :3].mean(axis=0)
    return with_estimates(log, tables, path)


def with_estimates(log: RobotLog, tables: Tables, path: Float) -> RobotLog:
    """Return a log that holds a path, and what its range beams met along it, for formulas to read.

    Parameters
    ----------
    log : RobotLog
        The log; its readings stay as they are.
    tables : Tables
        Coefficients of a model for it: mounts and walls.
    path : ndarray, shape (T, >= 3)
        The path, headings not wrapped [m, m, rad].
    """
    found: dict[str, Any] = {"estimated_path": (("time", "pose"), np.array(path[:, :3]))}
    for table in tables.sensors:
        along = sensor_of(table).along(table, path)
        if along and "beam" in log.dataset.dims:
            found |= {f"estimated_{name}": (("time", "beam"), values) for name, values in along.items()}
            break
    return RobotLog.trusted(log.dataset.assign(found), log.where, log.grid_map)
