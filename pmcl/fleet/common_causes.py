"""What the critic finds in most robots of a fleet: a cause that lies in their make, not in one of them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from scipy import stats

from pmcl.criticism.findings.json_text import FORMAT
from pmcl.errors import CriticismError

__all__ = ["Cause", "Findings", "causes", "read_findings"]

# A cause is common to a fleet when more than this share of the robots have it, and that by chance, when none of them
# lacks anything, in no more than one of so many fleets.
_MOST, _CHANCE = 0.5, 0.01
# A criticism is some 100 kB.
_LONGEST_FILE = 50_000_000


class Findings(NamedTuple):
    """What the critic said about one robot.

    Attributes
    ----------
    sentence : str
        Its verdict.
    effects : tuple of mapping
        Accepted effects, as in the JSON file.
    level : float
        Rate of false alarms that it was asked for.
    """

    sentence: str
    effects: tuple[Mapping[str, Any], ...]
    level: float


class Cause(NamedTuple):
    """An effect, and the robots that have it.

    Attributes
    ----------
    name, summary : str
        As in the catalogue of effects.
    robots : tuple of str
        Robots in which the critic found it.
    possible : tuple of str
        Robots in which it found another effect that it could not tell from this one.
    criticised : int
        Number of robots that it has looked at.
    at_least : float
        With probability 95 %, at least this share of all such robots has it, if robots that may have it do not.
    p_value : float
        At most this share of fleets without any missing effect shows one effect in so many robots.
    parameters : mapping of str to tuple
        Of each parameter: unit, and least, mean and greatest value over the robots that have it.
    common : bool
        Whether most robots have it, beyond chance.
    """

    name: str
    summary: str
    robots: tuple[str, ...]
    possible: tuple[str, ...]
    criticised: int
    at_least: float
    p_value: float
    parameters: Mapping[str, tuple[str, float, float, float]]
    common: bool

    @property
    def sentence(self) -> str:
        """The cause in words."""
        who = f"all {self.criticised}" if len(self.robots) == self.criticised else f"{len(self.robots)} of "
        who += "" if len(self.robots) == self.criticised else f"{self.criticised}"
        return f"{who} robots: {self.name}. {self.summary}"


def read_findings(path: Path, fingerprint: str) -> Findings:
    """Read what the critic said about one robot.

    Parameters
    ----------
    path : Path
        The JSON file of ``pmcl criticize``.
    fingerprint : str
        Of the robot's log.

    Returns
    -------
    Findings

    Raises
    ------
    CriticismError
        When the file cannot be read, is of another format, or about another log.
    """
    try:
        with path.open("rb") as stream:
            content = json.loads(stream.read(_LONGEST_FILE))
        if content["format"] != FORMAT:
            raise KeyError(FORMAT)
        effects = tuple(
            {
                "name": str(effect["name"]),
                "summary": str(effect.get("summary", "")),
                "where": dict(effect["where"]),
                "not_distinguishable_from": [str(name) for name in effect["not_distinguishable_from"]],
                "parameters": {
                    str(name): {"mean": float(value["mean"]), "unit": str(value["unit"])}
                    for name, value in effect["parameters"].items()
                },
            }
            for effect in content["effects"]
        )
        found = Findings(str(content["sentence"]), effects, float(content["settings"]["level"]))
        about = str(content["settings"]["log"])
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise CriticismError(
            f"{path}: expected what 'pmcl criticize --json' writes, but got something else "
            f"({type(error).__name__}: {' '.join(str(error).split())[:100]}); make it again, or remove it"
        ) from None
    if about != fingerprint:
        raise CriticismError(
            f"{path}: expected the criticism of this robot's log, but it is about another log, or the log has changed; "
            "make it again, or remove it"
        )
    return found


def causes(findings: Mapping[str, Findings]) -> tuple[Cause, ...]:
    """Count effects over robots.

    Parameters
    ----------
    findings : mapping of str to Findings
        By robot.

    Returns
    -------
    tuple of Cause
        The most frequent first.
    """
    having: dict[str, dict[str, Mapping[str, Any]]] = {}
    for robot, found in findings.items():
        for effect in found.effects:
            having.setdefault(effect["name"], {})[robot] = effect
    level = max((found.level for found in findings.values()), default=0.0)
    counted = [_cause(name, effects, findings, level) for name, effects in having.items()]
    return tuple(sorted(counted, key=lambda cause: (-len(cause.robots), cause.p_value, cause.name)))


def _cause(
    name: str, effects: Mapping[str, Mapping[str, Any]], findings: Mapping[str, Findings], level: float
) -> Cause:
    n, k = len(findings), len(effects)
    # Alarms of faultless logs are at most this frequent, whatever name they then get.
    p_value = float(stats.binom.sf(k - 1, n, level))
    possible = tuple(
        robot
        for robot, found in findings.items()
        if robot not in effects and any(name in effect["not_distinguishable_from"] for effect in found.effects)
    )
    first = next(iter(effects.values()))
    values = {
        parameter: (entry["unit"], [effect["parameters"][parameter]["mean"] for effect in _with(effects, parameter)])
        for parameter, entry in first["parameters"].items()
    }
    return Cause(
        name,
        first["summary"],
        tuple(effects),
        possible,
        n,
        float(stats.beta.ppf(0.05, k, n - k + 1)),
        p_value,
        {key: (unit, min(means), sum(means) / len(means), max(means)) for key, (unit, means) in values.items()},
        k > _MOST * n and k > 1 and p_value <= _CHANCE,
    )


def _with(effects: Mapping[str, Mapping[str, Any]], parameter: str) -> Sequence[Mapping[str, Any]]:
    return [effect for effect in effects.values() if parameter in effect["parameters"]]
