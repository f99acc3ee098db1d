"""From logs to a posterior in one call."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Any

from pmcl import defaults
from pmcl.checks import check_choice, check_flag, check_path, check_seed, check_type, check_whole
from pmcl.errors import ModelError, SamplingError
from pmcl.filtering.ahead import compile_for_calibration
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.logs.robot_log import RobotLog
from pmcl.models.model_text import model_text
from pmcl.models.robot_model import BoundModel, RobotModel, default_model, log_sequence
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
        HDF5 file to which the run is written every few seconds, and when an error or Ctrl-C ends it. It stays when
        the run is done.
    resume : bool
        Continue the checkpoint, if it is there; the result is identical to that of an uninterrupted run.
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
    KeyboardInterrupt
        After the current sweep when Ctrl-C was pressed, at once when it was pressed twice. With a checkpoint nothing
        is lost: the same call with `resume` goes on.

    References
    ----------
    Kaboli, Bowling, Musilek, Bayesian Calibration for Monte Carlo Localization, AAAI 2006.
    """
    logs = log_sequence(logs)
    check_choice("method", method, ("particle-gibbs", "ensemble"), error=SamplingError)
    check_choice("kernel", kernel, ("conditional", "smoothing"), error=SamplingError)
    for name, value in (("particles", particles), ("burn_in_particles", burn_in_particles)):
        if value is not None or name != "particles":
            check_whole(name, value, 2, error=SamplingError, advice="25 to 1000 are usual")
    for name, size in (
        ("draws", draws), ("chains", chains), ("metropolis_steps", metropolis_steps),
        ("sweeps_per_draw", sweeps_per_draw), ("trajectories", trajectories),
    ):  # fmt: skip
        check_whole(name, size, 1, error=SamplingError)
    if data_rate is not None:
        check_whole("data_rate", data_rate, 1, error=SamplingError, advice="leave it out for a fiftieth of the log")
    for name, flag in (("transport", transport), ("resume", resume), ("progress", progress), ("check", check)):
        if flag is not None or name != "transport":
            check_flag(name, flag, error=SamplingError)
    if pool is not None and not callable(getattr(pool, "map", None)):
        raise SamplingError(f"expected pool with a method map, but got {type(pool).__name__}; leave it out for threads")
    if checkpoint is not None:
        check_path("checkpoint", checkpoint, error=SamplingError)
    seed = check_seed(seed, error=SamplingError)
    if model is not None:
        check_type("model", model, RobotModel, error=ModelError, advice="leave it out for the default model")
    for log in logs:
        require_rows(log)
    model = default_model(logs[0]) if model is None else model
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
    else:
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
    data = to_arviz(result, bound.parameters, bound.logs)
    return checked(data, bound, seed) if check else data


def _model_text(bound: BoundModel) -> str:
    """Return the model as a model file, so that a posterior can be used without one; empty for a user's own parts."""
    try:
        return model_text(bound.model, bound.logs[0])
    except ModelError:
        return ""
