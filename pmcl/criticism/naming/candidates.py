"""Candidates before they are refitted: their order, and which of them look alike."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.fitting.trials import Trial
from pmcl.criticism.naming.promises import Promises
from pmcl.criticism.scoring.scores import Direction, instance_key
from pmcl.models.effects.effect import Effect

__all__ = [
    "RankedEffect", "are_near_twins", "in_order", "of_carrier", "of_sensors", "other_places", "twins_of",
    "untried",
]  # fmt: skip

Float = NDArray[np.float64]

# Of a family with many places so many instances are refitted: two beams may be much alike. One is enough where a fit
# moves the effect to its place.
_INSTANCES = 2


class RankedEffect(NamedTuple):
    """A candidate with its standardised score.

    Attributes
    ----------
    effect : Effect
        The candidate, at one place.
    z : float
        Its standardised score.
    worth_a_fit : bool
        Whether it promises evidence, or its score says little: the path absorbs most of a constant error of the mount
        or of the odometry, so that it shows only in a fit. The path absorbs no error at a single place and no one-sided
        effect, such as the weight of a mixture; without a score these are absent.
    starts_at : ndarray, shape (k,), optional
        The effect's values at which its fit starts; near its null when left out.
    """

    effect: Effect
    z: float
    worth_a_fit: bool = True
    starts_at: Float | None = None


def in_order(directions: Sequence[Direction], promised: Promises) -> list[RankedEffect]:
    """Return candidates, those first that promise most.

    Parameters
    ----------
    directions : sequence of Direction
        All K directions.
    promised : Promises
        What they promise.

    Returns
    -------
    list of RankedEffect
        Of each effect with many places only the best instances.
    """
    kept: dict[str, list[Effect]] = {}
    ranked = []
    for k in np.argsort(-promised.evidence, kind="stable"):
        effect = directions[k].effect
        alike = kept.setdefault(effect.name, [])
        if any(instance_key(effect) == instance_key(other) for other in alike):
            continue
        if len(alike) < (1 if effect.shape else _INSTANCES):
            absorbed = not effect.where and not directions[k].one_sided
            alike.append(effect)
            ranked.append(_ranked(directions, promised, int(k), absorbed))
    return ranked


def _ranked(directions: Sequence[Direction], promised: Promises, k: int, absorbed: bool = False) -> RankedEffect:
    return RankedEffect(
        directions[k].effect, float(promised.z[k]), bool(promised.evidence[k] > 0.0) or absorbed, promised.starts_at[k]
    )


def of_carrier(candidates: Sequence[RankedEffect], carrier: str) -> list[RankedEffect]:
    """Return the candidates of one carrier that have no place.

    Parameters
    ----------
    candidates : sequence of RankedEffect
        Candidates.
    carrier : str
        One of :data:`pmcl.models.effects.effect.CARRIERS`.
    """
    return [one for one in candidates if one.effect.carrier == carrier and not one.effect.where]


def of_sensors(candidates: Sequence[RankedEffect]) -> list[RankedEffect]:
    """Return the candidates that are effects of sensors."""
    return [one for one in candidates if one.effect.carrier not in ("motion", "map")]


def twins_of(effects: Sequence[Effect], candidates: Sequence[RankedEffect]) -> list[RankedEffect]:
    """Return those candidates of which the catalogue says that they look like one of some effects.

    A twin that the path absorbs has hardly a score: a constant error of bearings looks like another heading. Of a twin
    with many places only the first instance is returned.

    Parameters
    ----------
    effects : sequence of Effect
        The effects.
    candidates : sequence of RankedEffect
        The candidates, the likeliest first.
    """
    twins: dict[str, RankedEffect] = {}
    for candidate in candidates:
        if any(are_near_twins(candidate.effect, effect) for effect in effects):
            twins.setdefault(candidate.effect.name, candidate)
    return list(twins.values())


def other_places(
    trials: Sequence[Trial], directions: Sequence[Direction], promised: Promises
) -> list[RankedEffect]:
    """Return other places of those effects that have evidence at one.

    Two beams or walls may be much alike, and a fit moves a patch by some of its size, not through the room. The path
    may absorb a wall that stands elsewhere, so that it promises nothing. It absorbs no one-sided effect.

    Parameters
    ----------
    trials : sequence of Trial
        What was refitted.
    directions : sequence of Direction
        All K directions.
    promised : Promises
        What they promise.
    """
    names = {trial.effect.name for trial in trials if trial.effect is not None and trial.evidence > 0.0}
    places: dict[object, RankedEffect] = {}
    for k in np.argsort(-promised.evidence, kind="stable"):
        effect = directions[k].effect
        seen = promised.evidence[k] > 0.0 or not directions[k].one_sided
        if effect.where and effect.name in names and seen:
            places.setdefault(instance_key(effect), _ranked(directions, promised, int(k)))
    return list(places.values())


def untried(candidates: Sequence[RankedEffect], tried: Collection[object]) -> list[RankedEffect]:
    """Return those candidates that were not refitted yet.

    Parameters
    ----------
    candidates : sequence of RankedEffect
        Candidates.
    tried : collection
        Keys of what was refitted, or could not be (:func:`pmcl.criticism.scoring.scores.instance_key`).
    """
    return [candidate for candidate in candidates if instance_key(candidate.effect) not in tried]


def are_near_twins(effect: Effect, other: Effect) -> bool:
    """Return whether the catalogue knows that two different effects look alike.

    Parameters
    ----------
    effect, other : Effect
        The effects; their places do not matter.
    """
    return effect.name != other.name and (effect.name in other.near_twins or other.name in effect.near_twins)

