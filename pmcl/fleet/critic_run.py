"""The criticism of one robot as a job that can run anywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmcl.criticism.findings.result import Criticism
from pmcl.criticism.workflow import criticize
from pmcl.errors import CriticismError, SamplingError
from pmcl.fleet.common_causes import Findings, read_findings
from pmcl.fleet.places import Job, Place, Tell
from pmcl.fleet.robot_run import Packed, packed
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.carried import carried_effects
from pmcl.models.effects.effect import Effect
from pmcl.models.effects.registry import candidates
from pmcl.models.robot_model import RobotModel
from pmcl.whole_file import write_whole

__all__ = ["CriticRun", "criticize_elsewhere", "criticize_fleet", "findings_file"]


@dataclass(frozen=True)
class CriticRun:
    """One robot's criticism: called, it returns the result, or the text of its JSON file.

    Attributes
    ----------
    name : str
        The robot.
    inputs : Packed
        Log, model (None for the usual one), and candidates (None for the catalogue).
    settings : mapping of str to object
        Further arguments of :func:`pmcl.criticism.workflow.criticize`.
    as_text : bool
        Whether the text is returned.
    """

    name: str
    inputs: Packed
    settings: Mapping[str, Any]
    as_text: bool

    def __call__(self, tell: Tell) -> Criticism | str:
        """Criticize."""
        log, model, effects = self.inputs.unpacked()
        tell(self.name, "the critic begins")
        found = criticize(log, model, effects=effects, **self.settings)
        return found.to_json() if self.as_text else found


def findings_file(folder: Path, name: str) -> Path:
    """Return the file of what the critic said about a robot."""
    return folder / f"{name}.critic.json"


def criticize_elsewhere(
    place: Place,
    log: RobotLog,
    model: RobotModel | None = None,
    effects: Sequence[Effect] | None = None,
    **settings: Any,
) -> Criticism:
    """Run the critic in another place.

    Parameters
    ----------
    place : Place
        Such as a cluster.
    log, model, effects, **settings
        As for :func:`pmcl.criticism.workflow.criticize`.

    Returns
    -------
    Criticism

    Raises
    ------
    CriticismError
        When the critic fails there; the message says why.
    """
    run = CriticRun("log", _packed(log, model, effects), settings, as_text=False)
    (done,) = place.run([Job("log", run)], lambda name, message: None)
    if done.error:
        raise CriticismError(done.error)
    found: Criticism = done.value
    return found


def criticize_fleet(
    logs: Mapping[str, RobotLog],
    folder: Path,
    models: Mapping[str, RobotModel] | None,
    place: Place,
    tell: Tell,
    *,
    run: bool,
    **settings: Any,
) -> tuple[dict[str, Findings], dict[str, str]]:
    """Gather what the critic says about the robots of a fleet.

    Parameters
    ----------
    logs : mapping of str to RobotLog
        The log of each robot.
    folder : Path
        Where ``ROBOT.critic.json`` lies for each robot that the critic has looked at.
    models : mapping of str to RobotModel, optional
        The model of each robot.
    place : Place
        Where the critic works.
    tell : callable
        Is told of progress.
    run : bool
        Whether the critic looks at the robots that it has not seen yet.
    **settings
        Further arguments of :func:`pmcl.criticism.workflow.criticize`.

    Returns
    -------
    findings : dict of str to Findings
        By robot.
    errors : dict of str to str
        Why there are none, where the critic failed.

    Raises
    ------
    CriticismError
        When a file that is there cannot be used.
    """
    errors = {}
    if run:
        threads = max(1, place.slots // len(logs))
        jobs = [
            Job(
                name,
                CriticRun(
                    name, _packed(log, None if models is None else models[name]), {**settings, "workers": threads}, True
                ),
            )
            for name, log in logs.items()
            if not findings_file(folder, name).exists()
        ]
        for done in place.run(jobs, tell):
            if done.error:
                errors[done.name] = done.error
            else:
                write_whole(findings_file(folder, done.name), f"{done.value}\n".encode(), error=SamplingError)
            tell(done.name, "the critic failed" if done.error else "the critic is done")
    files = {name: findings_file(folder, name) for name in logs}
    found = {name: read_findings(files[name], log.fingerprint()) for name, log in logs.items() if files[name].exists()}
    return found, errors


def _packed(log: RobotLog, model: RobotModel | None, effects: Sequence[Effect] | None = None) -> Packed:
    # The catalogue is known everywhere, effects of the user's files are not.
    if effects is None and carried_effects():
        effects = candidates(log)
    return packed(log, model, effects)
