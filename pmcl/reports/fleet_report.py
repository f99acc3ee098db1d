"""An HTML page about a fleet: what its robots share, which stands out, and a section for each robot."""

from __future__ import annotations

import os

from pmcl.fleet.common_causes import Cause
from pmcl.fleet.comparison import LEVEL, Comparison, Member
from pmcl.fleet.population import Population
from pmcl.fleet.result import FleetResult, Robot
from pmcl.reports.fleet_figures import plot_fleet
from pmcl.reports.html import page, picture, write_page
from pmcl.reports.tables import rounded

__all__ = ["write_fleet_report"]

_INTERVAL = (0.05, 0.5, 0.95)


def write_fleet_report(result: FleetResult, path: str | os.PathLike[str]) -> None:
    """Write a self-contained HTML file about a fleet.

    Parameters
    ----------
    result : FleetResult
        From :func:`pmcl.fleet.summary.summarize_fleet`.
    path : path-like
        The file; an older file of that name is replaced only when the new one is complete.

    Raises
    ------
    PosteriorError
        If the file cannot be written.
    """
    comparison = result.comparison
    sound = all(robot.converged and robot.adequate is not False for robot in result.robots)
    remarkable = bool(comparison and comparison.standing_out) or any(cause.common for cause in result.causes)
    text = page(
        "fleet.html.j2",
        title=f"A fleet of {len(result.robots)} robots",
        sentences=result.sentences(),
        box="good" if sound and not remarkable else "unsure",
        population=[_population_row(name, one) for name, one in comparison.populations.items()] if comparison else [],
        pictures=[] if comparison is None else [
            picture(
                plot_fleet(comparison),
                "Each robot beside the others",
                "Points and lines: mean and 90 % interval of a robot's posterior from its own log. Grey: where 90 % of "
                "robots of this make are expected, odd ones aside.",
            )
        ],
        compared=0 if comparison is None else len({member.robot for member in comparison.members}),
        level=f"{LEVEL:.0%}".replace("%", " %"),
        causes=[_cause_row(cause) for cause in result.causes],
        robots=[_section(robot, comparison) for robot in result.robots],
    )  # fmt: skip
    write_page(text, path)


def _population_row(name: str, population: Population) -> tuple[str, ...]:
    low, middle, high = population.mean_quantiles(_INTERVAL)
    spread = population.spread_quantiles(_INTERVAL)
    new = population.new_robot_quantiles(_INTERVAL)
    unit = population.line.parameter.unit
    between = 0.25 * (high - low)
    if population.line.ratio:
        spreads = f"{100 * spread[1]:.2g} % ({100 * spread[0]:.2g} to {100 * spread[2]:.2g})"
    else:
        spreads = f"{spread[1]:.2g} ({spread[0]:.2g} to {spread[2]:.2g})"
    return (
        name,
        "" if unit == "1" else unit,
        f"{rounded(middle, between)} ({rounded(low, between)} to {rounded(high, between)})",
        spreads,
        f"{rounded(new[0], between)} to {rounded(new[2], between)}",
    )


def _cause_row(cause: Cause) -> tuple[str, ...]:
    values = "; ".join(
        f"{name} {least:.3g} to {greatest:.3g}{'' if unit == '1' else ' ' + unit}, mean {mean:.3g}"
        for name, (unit, least, mean, greatest) in cause.parameters.items()
    )
    return (
        cause.name,
        f"{len(cause.robots)} of {cause.criticised}",
        f"{len(cause.possible)}",
        f"{100 * cause.at_least:.0f} %",
        f"{cause.p_value:.2g}",
        values,
        cause.summary,
    )


def _section(robot: Robot, comparison: Comparison | None) -> dict[str, object]:
    members = [member for member in (comparison.members if comparison else ()) if member.robot == robot.name]
    return {
        "name": robot.name,
        "message": robot.message,
        "posterior": robot.posterior,
        "critic": robot.findings.sentence if robot.findings else "",
        "rows": [_member_row(member) for member in members],
        "odd": [member.stands_out for member in members],
    }


def _member_row(member: Member) -> tuple[str, ...]:
    return (
        member.parameter,
        rounded(member.mean, member.sd),
        f"{member.sd:.2g}",
        rounded(member.fleet_mean, member.fleet_sd),
        f"{member.fleet_sd:.2g}",
        f"{member.p_value:.2g}",
        f"{member.adjusted_p_value:.2g}",
    )
