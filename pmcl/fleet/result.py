"""The result of a fleet, as data for the page and for other programs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from pmcl.criticism.findings.json_text import json_text
from pmcl.fleet.common_causes import Cause, Findings
from pmcl.fleet.comparison import LEVEL, Comparison
from pmcl.whole_file import replacing

__all__ = ["FORMAT", "FleetResult", "Robot"]

FORMAT = "pmcl-fleet/1"


class Robot(NamedTuple):
    """One robot.

    Attributes
    ----------
    name : str
        Its name.
    posterior : str
        Name of its posterior's file; empty when it has none.
    message : str
        The verdict on its posterior, or why there is none.
    converged, adequate : bool or None
        The two halves of the verdict; None where they are not known.
    findings : Findings or None
        What the critic said, where it was asked.
    """

    name: str
    posterior: str
    message: str
    converged: bool | None = None
    adequate: bool | None = None
    findings: Findings | None = None


class FleetResult(NamedTuple):
    """A fleet.

    Attributes
    ----------
    robots : tuple of Robot
        All of them.
    comparison : Comparison or None
        None when fewer than two have a posterior.
    causes : tuple of Cause
        What the critic found, counted over robots.
    """

    robots: Sequence[Robot]
    comparison: Comparison | None
    causes: Sequence[Cause]

    def sentences(self) -> list[str]:
        """Return what there is to say, most important first."""
        told = [cause.sentence for cause in self.causes if cause.common]
        if self.comparison is not None:
            told += [
                f"{member.robot} stands out in {member.parameter}: {_deviation(member, self.comparison)} "
                f"(p = {member.adjusted_p_value:.2g}, corrected for all robots and parameters)"
                for member in self.comparison.standing_out
            ]
            if not self.comparison.standing_out:
                told.append("no robot stands out")
        return told

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON file."""
        members = self.comparison.members if self.comparison is not None else ()
        populations = self.comparison.populations if self.comparison is not None else {}
        return {
            "format": FORMAT,
            "robots": [
                {
                    "name": robot.name,
                    "posterior": robot.posterior,
                    "verdict": robot.message,
                    "converged": robot.converged,
                    "adequate": robot.adequate,
                    "effects": [dict(effect) for effect in robot.findings.effects] if robot.findings else None,
                    "parameters": {
                        member.parameter: {k: v for k, v in member._asdict().items() if k not in ("robot", "parameter")}
                        for member in members
                        if member.robot == robot.name
                    },
                }
                for robot in self.robots
            ],
            "population": {
                name: {
                    "unit": population.line.parameter.unit,
                    "robots": len(population.robots),
                    "typical": _quantiles(population.mean_quantiles((0.05, 0.5, 0.95))),
                    "spread": _quantiles(population.spread_quantiles((0.05, 0.5, 0.95))),
                    "spread_is": "standard deviation of the logarithm"
                    if population.line.ratio
                    else "standard deviation on the line to which the parameter is transformed",
                    "new_robot": _quantiles(population.new_robot_quantiles((0.05, 0.5, 0.95))),
                }
                for name, population in populations.items()
            },
            "standing_out": [
                {"robot": member.robot, "parameter": member.parameter, "p_value": member.adjusted_p_value}
                for member in (self.comparison.standing_out if self.comparison is not None else ())
            ],
            "common_causes": [cause._asdict() for cause in self.causes],
            "level": LEVEL,
        }

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the JSON file; a failure leaves no partial file.

        Parameters
        ----------
        path : path-like

        Raises
        ------
        PosteriorError
            When the file cannot be written.
        """
        with replacing(path) as temporary:
            temporary.write_text(json_text(self.to_dict()) + "\n", encoding="utf-8")


def _quantiles(values: Any) -> Mapping[str, float]:
    return {"q5": float(values[0]), "median": float(values[1]), "q95": float(values[2])}


def _deviation(member: Any, comparison: Comparison) -> str:
    parameter = comparison.populations[member.parameter].line
    if parameter.ratio:
        return f"{member.deviation:.3g} times the typical value"
    return f"{member.deviation:+.3g} {parameter.parameter.unit} beside the typical value"
