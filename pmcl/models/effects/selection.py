"""Effects by name, as people write them on the command line and in model files."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pmcl.errors import ModelError, did_you_mean
from pmcl.logs.robot_log import RobotLog
from pmcl.models.effects.effect import Effect, Where
from pmcl.models.effects.registry import known_effects
from pmcl.models.parameters import prior_support
from pmcl.models.part import Float

__all__ = ["effect_named", "parse_effect"]


def effect_named(name: str, log: RobotLog | None = None, where: Where | None = None) -> Effect:
    """Return the effect of a name: of the catalogue, an installed package, or a file in use.

    Parameters
    ----------
    name : str
        E.g. "beam-bias".
    log : RobotLog, optional
        Needed with `where`.
    where : mapping, optional
        The place of an instance, e.g. ``{"beams": [2]}``.

    Raises
    ------
    ModelError
        When there is no such effect, or the log has no such place.
    """
    known = {effect.name: effect for effect in known_effects()}
    found = known.get(name)
    if found is None:
        advice = did_you_mean(name, known, "'pmcl effects' lists them; --effects FILE.py adds your own")
        raise ModelError(f"expected the name of an effect, but got '{name}'; {advice}")
    return found if not where or log is None else found.at(where, log)


def parse_effect(text: str, log: RobotLog, rng: np.random.Generator) -> tuple[Effect, Float]:
    """Read ``NAME[@PLACE][=VALUE[,VALUE...]]``, e.g. ``beam-bias@2=0.06`` or ``range-bias=large``.

    Parameters
    ----------
    text : str
        Without a place one is drawn from those that the log offers; without a value the effect is "clear". Parameters
        beyond the values given take their clear values, too.
    log : RobotLog
        Offers the places.
    rng : numpy.random.Generator
        Source of randomness.

    Returns
    -------
    effect : Effect
        An instance.
    values : ndarray, shape (k,)
        Of its parameters.

    Raises
    ------
    ModelError
        When the name, the place or a value is not usable, or the log cannot show the effect.
    """
    head, _, value = text.partition("=")
    name, _, place = head.strip().partition("@")
    effect = _placed(effect_named(name), place, text, log, rng)
    if not value.strip():
        return effect, effect.magnitude("clear")
    if value.strip().replace("-", " ") in effect.typical:
        return effect, effect.magnitude(value.strip())
    given = _numbers(value, text, f"a number, {' or '.join(effect.typical)}")
    if len(given) > len(effect.parameters):
        raise ModelError(
            f"effect '{text}': expected at most {len(effect.parameters)} values "
            f"({', '.join(p.name for p in effect.parameters)}), but got {len(given)}; remove some"
        )
    values = effect.magnitude("clear") if effect.typical else np.array(effect.null)
    # Further strengths are zero when not given: 'sensor-offset=0.1' is an offset ahead, and none aside.
    for k in effect.strengths:
        values[k] = effect.null[k]
    values[: len(given)] = given
    check_values(effect, values)
    return effect, values


def check_values(effect: Effect, values: Float) -> None:
    """Check that every value lies within its prior.

    Parameters
    ----------
    effect : Effect
        The effect.
    values : ndarray, shape (k,)
        Of its parameters.

    Raises
    ------
    ModelError
        With the first value outside its prior.
    """
    for parameter, value in zip(effect.parameters, values, strict=True):
        low, high = prior_support(parameter.prior)
        if not low <= value <= high:
            raise ModelError(
                f"effect {effect.name}: expected {parameter.name} within its prior, {low:g} to {high:g}, but got "
                f"{value:g}; choose another"
            )


def _placed(effect: Effect, place: str, text: str, log: RobotLog, rng: np.random.Generator) -> Effect:
    instances = effect.instances(log)
    if not instances:
        raise ModelError(
            f"effect '{text}': expected a log that can show {effect.name}, but {log.where} has no such readings or "
            "motion; choose another effect"
        )
    if not place:
        return instances[int(rng.integers(len(instances)))]
    if effect.places is None:
        raise ModelError(f"effect '{text}': expected no place for {effect.name}, but got '@{place}'; remove it")
    numbers = _numbers(place, text, "numbers for the place")
    kinds: Mapping[str, object] = instances[0].where
    key = next(iter(kinds))
    return effect.at({key: numbers}, log)


def _numbers(value: str, text: str, expected: str) -> list[float]:
    try:
        numbers = [float(part) for part in value.split(",")]
    except ValueError:
        numbers = [np.nan]
    if not np.isfinite(numbers).all():
        raise ModelError(f"effect '{text}': expected {expected}, but got '{value}'; write for example beam-bias@2=0.06")
    return numbers
