"""What the robots of a fleet have in common, and which of them stands out in what."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.errors import SamplingError
from pmcl.fleet.densities import Line, robot_density
from pmcl.fleet.population import Population, population_of
from pmcl.models.parameters import Parameter

__all__ = ["LEVEL", "Comparison", "Member", "compare_robots", "holm"]

Float = NDArray[np.float64]

LEVEL = 0.05
"""Share of fleets without an odd robot in which some robot is said to stand out, at most."""


class Member(NamedTuple):
    """One parameter of one robot, by itself and among the others.

    Attributes
    ----------
    robot, parameter : str
        Their names.
    mean, sd : float
        Posterior mean and standard deviation from its own log, in the parameter's unit.
    fleet_mean, fleet_sd : float
        The same given the logs of all robots.
    p_value : float
        Of the conflict with what the others foresee (:meth:`pmcl.fleet.population.Population.conflict`).
    adjusted_p_value : float
        The same, corrected for all robots and all parameters (:func:`holm`).
    odd_probability : float
        Posterior probability that it is an odd one in this parameter.
    deviation : float
        How it lies to the typical robot: the ratio where the parameter is above 0, else the difference.
    stands_out : bool
        Whether the corrected p-value is at most :data:`LEVEL`.
    """

    robot: str
    parameter: str
    mean: float
    sd: float
    fleet_mean: float
    fleet_sd: float
    p_value: float
    adjusted_p_value: float
    odd_probability: float
    deviation: float
    stands_out: bool


class Comparison(NamedTuple):
    """A fleet compared.

    Attributes
    ----------
    populations : mapping of str to Population
        Mean and spread of each parameter that at least two robots share.
    members : tuple of Member
        Each of these parameters of each robot that has it.
    """

    populations: Mapping[str, Population]
    members: tuple[Member, ...]

    @property
    def standing_out(self) -> tuple[Member, ...]:
        """What stands out, the least probable first."""
        return tuple(sorted((m for m in self.members if m.stands_out), key=lambda m: m.adjusted_p_value))


def compare_robots(
    draws: Mapping[str, Mapping[str, Float]], parameters: Mapping[str, Sequence[Parameter]]
) -> Comparison:
    """Pool the parameters of robots that were calibrated one by one.

    Parameters
    ----------
    draws : mapping of str to mapping of str to ndarray, shape (S,)
        For each robot: draws of its parameters.
    parameters : mapping of str to sequence of Parameter
        For each robot: its parameters, with the priors that it was calibrated with.

    Returns
    -------
    Comparison

    Raises
    ------
    SamplingError
        When there are fewer than two robots, or two robots have different priors for the same parameter: pooling would
        mix what logs say with what was believed before.
    """
    if len(draws) < 2:
        raise SamplingError(f"expected at least two robots to compare, but got {len(draws)}; add logs of others")
    shared: dict[str, Parameter] = {}
    owners: dict[str, list[str]] = {}
    for robot in draws:
        for parameter in parameters[robot]:
            known = shared.setdefault(parameter.name, parameter)
            if _described(known) != _described(parameter):
                raise SamplingError(
                    f"expected one prior of {parameter.name} for all robots, but {owners[parameter.name][0]} and "
                    f"{robot} have different ones; calibrate them with one model file"
                )
            owners.setdefault(parameter.name, []).append(robot)
    populations: dict[str, Population] = {}
    found: list[tuple[str, str, int, float, bool]] = []
    for name, robots in owners.items():
        if len(robots) < 2:
            continue
        line = Line(shared[name])
        populations[name] = population_of([robot_density(draws[robot][name], line) for robot in robots], line)
        found += [(robot, name, i, *populations[name].conflict(i)) for i, robot in enumerate(robots)]
    adjusted = holm([p_value for *_, p_value, _ in found])
    members = [
        _member(robot, name, i, p_value, float(corrected), draws[robot][name], populations[name])
        for (robot, name, i, p_value, _), corrected in zip(found, adjusted, strict=True)
    ]
    return Comparison(populations, tuple(members))


def holm(p_values: Sequence[float]) -> Float:
    """Correct p-values for their number (Holm, Scandinavian Journal of Statistics 6(2), 1979).

    Parameters
    ----------
    p_values : sequence of float, length m
        Of any dependence.

    Returns
    -------
    ndarray, shape (m,)
        Where none of the m hypotheses is false, the least of them is at most alpha with probability alpha or less.
    """
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p)
    corrected = np.maximum.accumulate(np.minimum(1.0, p[order] * np.arange(p.size, 0, -1)))
    result = np.empty_like(p)
    result[order] = corrected
    return result


def _member(
    robot: str, name: str, i: int, p_value: float, corrected: float, draws: Float, population: Population
) -> Member:
    mean = float(draws.mean())
    typical = float(population.mean_quantiles((0.5,))[0])
    return Member(
        robot,
        name,
        mean,
        float(draws.std()),
        *population.robot_with_fleet(i),
        p_value,
        corrected,
        population.odd_probability(i),
        mean / typical if population.line.ratio else mean - typical,
        corrected <= LEVEL,
    )


def _described(parameter: Parameter) -> tuple[object, ...]:
    prior = parameter.prior
    numbers = tuple(float(prior.ppf(q)) for q in (0.05, 0.5, 0.95))
    return parameter.unit, getattr(getattr(prior, "dist", None), "name", ""), numbers
