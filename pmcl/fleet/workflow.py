"""Calibrate many robots: one posterior for each, wherever the work is done."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pmcl import defaults
from pmcl.calibration.method import CalibrationMethod
from pmcl.calibration.methods import as_method
from pmcl.checks import check_path, check_seed, check_type, check_whole
from pmcl.errors import ModelError, SamplingError
from pmcl.filtering.estimated_path import with_estimated_path
from pmcl.fleet.folder import SharedFolder, check_names, is_finished, only_fleet, posterior_file
from pmcl.fleet.places import Job, Place, Tell, as_place, silent
from pmcl.fleet.robot_run import RobotRun, packed
from pmcl.interrupts import stopping_on_interrupt
from pmcl.logs.robot_log import RobotLog
from pmcl.models.parameters import Parameter
from pmcl.models.robot_model import BoundModel, RobotModel, default_model, log_sequence
from pmcl.preflight.check import require_rows
from pmcl.sampling.checkpoint import fingerprint
from pmcl.sampling.options import RunOptions
from pmcl.whole_file import remove_rests, write_whole

__all__ = ["FleetRun", "calibrate_fleet"]

RobotLogs = RobotLog | Sequence[RobotLog]


@dataclass(frozen=True)
class FleetRun:
    """What a call of :func:`calibrate_fleet` left in its folder.

    Attributes
    ----------
    posteriors : mapping of str to Path
        The posterior's file of each robot that has one, in the order of the logs.
    parameters : mapping of str to sequence of Parameter
        Of every robot, with the priors of its calibration.
    skipped : tuple of str
        Robots whose posterior was there before.
    errors : mapping of str to str
        Why a robot has none, in one line.
    """

    posteriors: Mapping[str, Path]
    parameters: Mapping[str, Sequence[Parameter]]
    skipped: tuple[str, ...] = ()
    errors: Mapping[str, str] = field(default_factory=dict)


@stopping_on_interrupt()
def calibrate_fleet(
    logs: Mapping[str, RobotLogs],
    folder: str | os.PathLike[str],
    model: RobotModel | Mapping[str, RobotModel] | None = None,
    *,
    method: CalibrationMethod | str = "particle-gibbs",
    draws: int = defaults.DRAWS,
    chains: int = defaults.CHAINS,
    trajectories: int = defaults.TRAJECTORIES,
    seed: int = 0,
    pool: Any = None,
    tell: Tell = silent,
) -> FleetRun:
    """Calibrate each robot by itself and write its posterior to a folder.

    Parameters
    ----------
    logs : mapping of str to RobotLog or sequence of RobotLog
        The log of each robot, or several, by the robot's name, which becomes the name of its file.
    folder : path
        Is made when it is not there. Robots whose posterior it holds are skipped, so that the same call goes on after
        an interruption.
    model : RobotModel or mapping of str to RobotModel, optional
        One model for all robots, or one for each; the usual model of its first log when left out.
    method, draws, chains, trajectories
        As for :func:`pmcl.calibration.workflow.calibrate`.
    seed : int
        Of each robot: its posterior is that of :func:`~pmcl.calibration.workflow.calibrate` with this seed, wherever it
        is made.
    pool : object with a `map` method, optional
        Runs the robots: an executor of :mod:`concurrent.futures`, a ``dask.distributed`` client, any other pool, or a
        :class:`~pmcl.fleet.places.Place`; threads when left out. Each log is sent once. When a worker of a cluster, or
        a process of a :class:`~pmcl.fleet.places.ProcessPlace`, is lost, its robots go on from their checkpoints
        elsewhere if the folder can be seen from there, and begin anew if not.
    tell : callable, optional
        Is told the name of a robot and how far it has come.

    Returns
    -------
    FleetRun

    Raises
    ------
    PmclError
        When a log or model cannot be used, or the folder holds a posterior of another run; before anything is
        sampled. What goes wrong later with one robot is told in the result.
    KeyboardInterrupt
        When Ctrl-C was pressed. Nothing that is done is lost: the same call goes on.
    """
    check_path("folder", folder, error=SamplingError)
    for name, number in (("draws", draws), ("chains", chains), ("trajectories", trajectories)):
        check_whole(name, number, 1, error=SamplingError)
    seed = check_seed(seed, error=SamplingError)
    check_type("logs", logs, Mapping, error=SamplingError, advice="write a dict with the names of the robots as keys")
    if not logs:
        raise SamplingError("expected the log of at least one robot, but got none")
    check_names(list(logs))
    method = as_method(method)
    settings = {"method": method, "draws": draws, "chains": chains, "trajectories": trajectories, "seed": seed}
    record = method.record(RunOptions(draws=draws, chains=chains, seed=seed, trajectories=trajectories))
    place = as_place(pool)
    inputs = {name: (log_sequence(of_robot), _model_of(name, model)) for name, of_robot in logs.items()}
    bound = {name: _bound(*of_robot, seed) for name, of_robot in inputs.items()}
    keys = {name: fingerprint(of_robot, record) for name, of_robot in bound.items()}
    with only_fleet(Path(folder)) as shared:
        finished = tuple(name for name in logs if is_finished(Path(folder), name, keys[name]))
        left = {name: of_robot for name, of_robot in inputs.items() if name not in finished}
        jobs = [Job(name, _run(name, left, keys[name], settings, shared, place)) for name in left]
        errors = _calibrated(jobs, Path(folder), place, tell)
    posteriors = {name: posterior_file(Path(folder), name) for name in logs if name not in errors}
    parameters = {name: of_robot.parameters for name, of_robot in bound.items()}
    return FleetRun(posteriors, parameters, finished, {name: errors[name] for name in logs if name in errors})


def _calibrated(jobs: Sequence[Job], folder: Path, place: Place, tell: Tell) -> dict[str, str]:
    """Run jobs and write each posterior as it comes; return what went wrong by robot."""
    errors = {}
    for done in place.run(jobs, tell):
        file = posterior_file(folder, done.name)
        if done.error:
            errors[done.name] = done.error
            tell(done.name, f"failed: {done.error}")
            continue
        remove_rests(file)
        write_whole(file, done.value, error=SamplingError)
        file.with_name(f"{file.name}.checkpoint.h5").unlink(missing_ok=True)
        tell(done.name, "done")
    return errors


def _run(
    name: str,
    inputs: Mapping[str, tuple[Sequence[RobotLog], RobotModel | None]],
    key: str,
    settings: Mapping[str, Any],
    shared: SharedFolder,
    place: Place,
) -> RobotRun:
    cores_each = place.slots // len(inputs) if place.slots > 1 else os.cpu_count() or 1
    threads = max(1, min(cores_each, settings["chains"]))
    return RobotRun(name, packed(*inputs[name]), settings, key, shared, threads)


def _model_of(name: str, model: RobotModel | Mapping[str, RobotModel] | None) -> RobotModel | None:
    found = model.get(name) if isinstance(model, Mapping) else model
    if found is not None:
        check_type(f"the model of {name}", found, RobotModel, error=ModelError, advice="leave it out for the usual one")
    elif isinstance(model, Mapping):
        raise ModelError(f"expected a model for each robot, but there is none for {name}; add it")
    return found


def _bound(logs: Sequence[RobotLog], model: RobotModel | None, seed: int) -> BoundModel:
    """Check that model and logs fit."""
    for log in logs:
        require_rows(log)
    model = default_model(logs[0]) if model is None else model
    return model.bind([with_estimated_path(log, model, seed=seed) for log in logs])
