"""From logs to a posterior in one call."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Any

from pmcl import defaults
from pmcl.errors import ModelError, SamplingError
from pmcl.filtering.ahead import compile_for_calibration
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.logs.robot_log import RobotLog
from pmcl.models.model_text import model_text
from pmcl.models.robot_model import BoundModel, RobotModel, default_model
from pmcl.posterior.compat import Posterior
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.predictive_check import checked
from pmcl.preflight.check import checked_logs, require_rows
from pmcl.sampling.run import run_ensemble, run_particle_gibbs
from pmcl.sampling.stages import Plan

__all__ = ["calibrate"]


def calibrate(
    logs: RobotLog | Sequence[RobotLog],
    model: RobotModel | None = None,
    *,
    method: str = "particle-gibbs",
    kernel: str = "conditional",
    particles: int | None = None,
    draws: int = defaults.DRAWS,
    chains: int = defaults.CHAINS,
    metropolis_steps: int = defaults.METROPOLIS_STEPS,
    data_rate: int | None = None,
    transport: bool | None = None,
    burn_in_particles: int = defaults.BURN_IN_PARTICLES,
    sweeps_per_draw: int = defaults.SWEEPS_PER_DRAW,
    trajectories: int = 100,
    seed: int = 0,
    pool: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool = False,
    check: bool = True,
) -> Posterior:
    """Draw from the posterior of a robot's noise parameters, given what it logged.

    Parameters
    ----------
    logs : RobotLog or sequence of RobotLog
        One or several logs of the same robot: one theta, one trajectory for each.
    model : RobotModel, optional
        The default model of the first log when left out (:func:`pmcl.models.robot_model.default_model`).
    method : {"particle-gibbs", "ensemble"}
        Table 1 of the paper; or emcee's StretchMove on the pseudo-marginal target, for comparison.
    kernel : {"conditional", "smoothing"}
        How trajectories are drawn. ``conditional`` gives the exact posterior with any number of particles: calibrate
        physics with it and few particles. ``smoothing`` is the paper's: at finite n its target knows the error of a
        filter with n particles; tune a deployed filter of n particles with it, at that n.
    particles : int, optional
        Particles n; 25 for conditional, 500 for smoothing, 200 for the ensemble when left out.
    draws, chains : int
        Draws per chain after burn-in, number of chains (walkers; the ensemble takes at least 2 d + 2).
    metropolis_steps : int
        Rounds of one-dimensional updates per trajectory update (the paper's m).
    data_rate : int, optional
        Rows of the log that each sweep of burn-in includes (the paper's r); a fiftieth of the log when left out.
    transport : bool, optional
        Whether to use the Gaussian transport move; on for conditional, off for smoothing when left out.
    burn_in_particles : int
        Particles while data is being included.
    sweeps_per_draw : int
        Sweeps between stored draws.
    trajectories : int
        Trajectories per chain that are kept.
    seed : int
        The result is a function of it, whatever the pool.
    pool : object with a `map` method, optional
        Runs the chains of each step: threads on all cores when left out; processes, MPI or Dask pools work too.
    checkpoint : path, optional
        HDF5 file to which each draw is written.
    resume : bool
        Continue the checkpoint; the result is identical to that of an uninterrupted run.
    progress : bool
        Show progress bars.
    check : bool
        Whether to end with a check of the calibrated model on its own logs, which takes seconds, and to keep what it
        foresaw; without it the verdict only tells of convergence.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree
        Depending on the version of ArviZ: groups as in the file format. Whether the chains have converged, and whether
        the model fits the logs, says :func:`pmcl.posterior.diagnostics.verdict`.

    Raises
    ------
    PmclError
        When logs, model and settings do not fit each other, or no chain can start.

    References
    ----------
    Kaboli, Bowling, Musilek, Bayesian Calibration for Monte Carlo Localization, AAAI 2006.
    """
    logs = (logs,) if isinstance(logs, RobotLog) else tuple(logs)
    _check_sizes(draws=draws, chains=chains, sweeps_per_draw=sweeps_per_draw, burn_in_particles=burn_in_particles)
    for log in logs:
        require_rows(log)
    if model is None and logs:
        model = default_model(logs[0])
    model = model or RobotModel()
    logs = tuple(with_estimated_path(log, model, seed=seed) for log in logs)
    bound = model.bind(logs)
    if bound.dimension == 0:
        raise SamplingError("expected at least one free parameter, but the model fixes all of them; free one")
    compile_for_calibration(bound.tables(bound.prior_mean())[0])
    shared: dict[str, Any] = {
        "pool": pool,
        "checkpoint": os.fspath(checkpoint) if checkpoint is not None else None,
        "resume": resume,
        "progress": progress,
        # Plausible mistakes in the logs are warned of before sampling, and stay with the result.
        "settings": {"model": _model_text(bound), "preflight": checked_logs(bound.logs, model)},
    }
    if method == "particle-gibbs":
        if kernel not in ("conditional", "smoothing"):
            raise SamplingError(f"expected kernel 'conditional' or 'smoothing', but got '{kernel}'")
        moves = transport if transport is not None else kernel == "conditional"
        plan = Plan(
            kernel=kernel,
            particles=particles if particles is not None else defaults.CALIBRATION_PARTICLES[kernel],
            metropolis_steps=metropolis_steps,
            transport_moves=Plan.transport_moves if moves else 0,
            burn_in_particles=burn_in_particles,
            data_rate=data_rate if data_rate is not None else math.ceil(max(bound.lengths) / defaults.DATA_RATE_PARTS),
            draws=draws,
            sweeps_per_draw=sweeps_per_draw,
            trajectories=trajectories,
        )
        result = run_particle_gibbs(bound, plan, chains, seed, **shared)
    elif method == "ensemble":
        result = run_ensemble(
            bound,
            particles=particles if particles is not None else defaults.CALIBRATION_PARTICLES["ensemble"],
            n_walkers=max(chains, 2 * bound.dimension + 2),
            draws=draws,
            burn_in=max(100, draws // 2),
            seed=seed,
            trajectories=trajectories,
            **shared,
        )
    else:
        raise SamplingError(f"expected method 'particle-gibbs' or 'ensemble', but got '{method}'")
    data = to_arviz(result, bound.parameters, bound.logs)
    return checked(data, bound, seed) if check else data


def _model_text(bound: BoundModel) -> str:
    """Return the model as a model file, so that a posterior can be used without one; empty for a user's own parts."""
    try:
        return model_text(bound.model, bound.logs[0])
    except ModelError:
        return ""


def _check_sizes(**sizes: int) -> None:
    for name, value in sizes.items():
        if value < 1:
            raise SamplingError(f"expected {name} of at least 1, but got {value}")
