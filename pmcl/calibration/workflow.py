"""From logs to a posterior in one call, by any method."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

from pmcl import defaults
from pmcl.calibration.method import CalibrationMethod
from pmcl.calibration.methods import as_method
from pmcl.checks import check_flag, check_path, check_seed, check_type, check_whole
from pmcl.errors import ConversionError, ModelError, SamplingError
from pmcl.filtering.ahead import compile_for_calibration
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.logs.robot_log import RobotLog
from pmcl.models.model_text import model_text
from pmcl.models.robot_model import BoundModel, RobotModel, default_model, log_sequence
from pmcl.posterior.compat import Posterior
from pmcl.posterior.convert import to_arviz
from pmcl.posterior.predictive_check import checked
from pmcl.posterior.rehearsal import rehearse
from pmcl.preflight.check import checked_logs, require_rows
from pmcl.sampling.chains import Chains, PointEstimate
from pmcl.sampling.options import Progress, RunOptions

__all__ = ["calibrate"]


def calibrate(
    logs: RobotLog | Sequence[RobotLog],
    model: RobotModel | None = None,
    *,
    method: CalibrationMethod | str = "particle-gibbs",
    draws: int = defaults.DRAWS,
    chains: int = defaults.CHAINS,
    trajectories: int = defaults.TRAJECTORIES,
    seed: int = 0,
    pool: Any = None,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: Progress = False,
    check: bool = True,
) -> Posterior:
    """Draw from the posterior of a robot's noise parameters, given what it logged.

    Parameters
    ----------
    logs : RobotLog or sequence of RobotLog
        One or several logs of the same robot: one theta, one trajectory for each.
    model : RobotModel, optional
        The default model of the first log when left out (:func:`pmcl.models.robot_model.default_model`).
    method : CalibrationMethod or str
        The method with its settings, such as ``ParticleGibbs(kernel="smoothing", particles=500)``, or the name of one
        with its defaults, such as ``particle-gibbs`` or ``em`` (:mod:`pmcl.calibration` lists them).
    draws, chains : int
        Draws per chain after burn-in, number of chains. The ensemble takes more chains when it needs more.
    trajectories : int
        Trajectories per chain that are kept; fewer, but at least two, where those of all chains would have more than
        ten million states.
    seed : int
        The result is a function of it, whatever the pool.
    pool : object with a `map` method, optional
        Runs the chains of each step: threads on all cores when left out. Any executor of :mod:`concurrent.futures`, a
        pool of processes or MPI, or a ``dask.distributed`` client. Each step sends the model and its logs to other
        processes; to use a cluster well, run whole logs there (:func:`pmcl.fleet.workflow.calibrate_fleet`).
    checkpoint : path, optional
        HDF5 file to which the run is written every few seconds, and when an error or Ctrl-C ends it. It stays when
        the run is done.
    resume : bool
        Continue the checkpoint, if it is there; the result is identical to that of an uninterrupted run.
    progress : bool or callable
        Show progress bars; or a function that is called after each step of the chains with the name of the stage, its
        steps so far, and all its steps.
    check : bool
        Whether to end with a check of the calibrated model on its own logs, which takes seconds, and to keep its
        predictions; without it the verdict is about convergence only.

    Returns
    -------
    arviz.InferenceData or xarray.DataTree
        Depending on the version of ArviZ: groups as in the file format. Whether the chains have converged, and whether
        the model fits the logs, says :func:`pmcl.posterior.diagnostics.verdict`.

    Raises
    ------
    PmclError
        When logs, model and settings do not fit each other, no chain can start, or a posterior could not be written
        (which is tried before sampling). A ConversionError holds draws of which no posterior could be made.
    KeyboardInterrupt
        After the current sweep when Ctrl-C was pressed, at once when it was pressed twice. With a checkpoint nothing
        is lost: the same call with `resume` goes on.

    References
    ----------
    Kaboli, Bowling, Musilek, Bayesian Calibration for Monte Carlo Localization, AAAI 2006.
    """
    logs = log_sequence(logs)
    method = as_method(method)
    options = _options(draws, chains, trajectories, seed, pool, checkpoint, resume, progress)
    check = check_flag("check", check, error=SamplingError)
    if model is not None:
        check_type("model", model, RobotModel, error=ModelError, advice="leave it out for the default model")
    for log in logs:
        require_rows(log)
    model = default_model(logs[0]) if model is None else model
    logs = tuple(with_estimated_path(log, model, seed=options.seed) for log in logs)
    bound = model.bind(logs)
    if bound.dimension == 0:
        raise SamplingError("expected at least one free parameter, but the model fixes all of them; free one")
    room = defaults.TRAJECTORY_STATES // (options.chains * sum(bound.lengths))
    options = dataclasses.replace(options, trajectories=min(options.trajectories, max(2, room)))
    compile_for_calibration(bound.tables(bound.prior_mean())[0])
    # Plausible mistakes in the logs are warned of before sampling, and stay with the result.
    attributes = {"model": _model_text(bound), "preflight": checked_logs(bound.logs, model)}
    options = dataclasses.replace(options, attributes=attributes)
    rehearse(bound.parameters, bound.logs, attributes, options.checkpoint)
    result = method.run(bound, options)
    try:
        data = to_arviz(result, bound.parameters, bound.logs)
        return checked(data, bound, options.seed) if check else data
    except Exception as error:  # whatever it is, it must not cost the draws
        raise _unconverted(error, result, options.checkpoint) from error


def _unconverted(error: Exception, result: Chains | PointEstimate, checkpoint: str | None) -> ConversionError:
    kept = "they are in the attribute 'chains' of this error"
    if checkpoint is not None and os.path.exists(checkpoint):
        kept = (
            f"they are in {checkpoint}: mend this, then the same call with resume, or the same command with --resume, "
            "makes the posterior without sampling again"
        )
    return ConversionError(
        f"expected to make a posterior of the draws, got {type(error).__name__}: {error}; nothing is lost, {kept}",
        result,
    )


def _options(
    draws: int,
    chains: int,
    trajectories: int,
    seed: int,
    pool: Any,
    checkpoint: str | os.PathLike[str] | None,
    resume: bool,
    progress: Progress,
) -> RunOptions:
    """Check the arguments of :func:`calibrate` that are the same for all methods."""
    for name, number in (("draws", draws), ("chains", chains), ("trajectories", trajectories)):
        check_whole(name, number, 1, error=SamplingError)
    check_flag("resume", resume, error=SamplingError)
    if not callable(progress) or isinstance(progress, type):
        check_flag("progress", progress, error=SamplingError)
    if pool is not None and not callable(getattr(pool, "map", None)):
        raise SamplingError(f"expected pool with a method map, but got {type(pool).__name__}; leave it out for threads")
    if checkpoint is not None:
        check_path("checkpoint", checkpoint, error=SamplingError)
    return RunOptions(
        draws=draws,
        chains=chains,
        seed=check_seed(seed, error=SamplingError),
        trajectories=trajectories,
        pool=pool,
        checkpoint=os.fspath(checkpoint) if checkpoint is not None else None,
        resume=resume,
        progress=progress,
    )


def _model_text(bound: BoundModel) -> str:
    """Return the model as a model file, so that a posterior can be used without one; empty for a user's own parts."""
    try:
        return model_text(bound.model, bound.logs[0])
    except ModelError:
        return ""
