"""From the folder of a fleet to what its robots have in common and which stands out."""

from __future__ import annotations

from collections.abc import Mapping

from pmcl.fleet.common_causes import Findings, causes
from pmcl.fleet.comparison import compare_robots
from pmcl.fleet.result import FleetResult, Robot
from pmcl.fleet.workflow import FleetRun
from pmcl.posterior.access import parameter_draws
from pmcl.posterior.diagnostics import verdict
from pmcl.posterior.files import read_posterior

__all__ = ["summarize_fleet"]


def summarize_fleet(
    run: FleetRun, findings: Mapping[str, Findings] | None = None, errors: Mapping[str, str] | None = None
) -> FleetResult:
    """Compare the robots of a fleet.

    Parameters
    ----------
    run : FleetRun
        Their posteriors. Those whose chains have not converged are shown, but not compared: what they say may be wrong.
    findings : mapping of str to Findings, optional
        What the critic said about each robot that it has looked at.
    errors : mapping of str to str, optional
        Why it has nothing to say about others; these are told beside the verdict.

    Returns
    -------
    FleetResult

    Raises
    ------
    PosteriorError
        When a posterior's file is damaged.
    SamplingError
        When robots have different priors.
    """
    findings, errors = findings or {}, errors or {}
    robots, draws = {}, {}
    for name, file in run.posteriors.items():
        data = read_posterior(file)
        judged = verdict(data)
        message = judged.message if name not in errors else f"{judged.message} The critic failed: {errors[name]}"
        robots[name] = Robot(name, file.name, message, judged.converged, judged.adequate, findings.get(name))
        if judged.converged:
            draws[name] = {
                parameter.name: parameter_draws(data, parameter.name).ravel() for parameter in run.parameters[name]
            }
    for name, error in run.errors.items():
        robots[name] = Robot(name, "", error, findings=findings.get(name))
    comparison = compare_robots(draws, run.parameters) if len(draws) > 1 else None
    order = [name for name in run.parameters if name in robots]
    return FleetResult([robots[name] for name in order], comparison, causes(findings))
