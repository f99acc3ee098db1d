"""What candidates promise before they are fitted, from the log under the current model.

A score promises much for a small effect and says little about a large one. A lower bound of the evidence, from
trajectories drawn without the effect, promises much for a large effect, and nothing for one to which the trajectories
would have to give way. The greater of the two counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmcl.criticism.fitting.quick_fit import Fit
from pmcl.criticism.fitting.starting_point import gain_of_motion
from pmcl.criticism.judging.alarms import Judgement
from pmcl.criticism.naming.probability import evidence_of_scores
from pmcl.criticism.scoring.lower_bounds import LowerBound, lower_bounds
from pmcl.criticism.scoring.scores import Direction, instance_key
from pmcl.errors import DensityError, PmclError
from pmcl.models.effects.effect import Effect

__all__ = ["Promises", "bounds_of", "promises", "with_bounds"]

Float = NDArray[np.float64]


class Promises(NamedTuple):
    """What each of K directions promises.

    Attributes
    ----------
    evidence : ndarray, shape (K,)
        The log evidence over nothing [nat].
    z : ndarray, shape (K,)
        Standardised scores; their signs tell on which side an effect is.
    starts_at : tuple of ndarray or None, length K
        The effect's values (k,) at which a fit starts; None where it starts near the null.
    """

    evidence: Float
    z: Float
    starts_at: tuple[Float | None, ...]


def promises(directions: Sequence[Direction], judgement: Judgement, bounds: Sequence[LowerBound]) -> Promises:
    """Return what candidates promise by their scores and by lower bounds of their evidence.

    Parameters
    ----------
    directions : sequence of Direction
        The K directions.
    judgement : Judgement
        Tests of the log with their scores.
    bounds : sequence of LowerBound
        The K bounds.
    """
    # Deviations from what simulated logs have, also of one-sided candidates: their scores are those of a finite step,
    # whose curvature is the same in all logs.
    deviation = judgement.z * judgement.score_std
    return with_bounds(evidence_of_scores(directions, deviation, judgement.score_std), judgement.z, bounds)


def with_bounds(evidence: Float, z: Float, bounds: Sequence[LowerBound]) -> Promises:
    """Return promises of which the lower bound counts where it is greater.

    Parameters
    ----------
    evidence : ndarray, shape (K,)
        What scores promise [nat].
    z : ndarray, shape (K,)
        Standardised scores.
    bounds : sequence of LowerBound
        The K bounds.
    """
    of_bounds = np.array([bound.evidence for bound in bounds]).reshape(evidence.shape)
    # Where nothing is gained along the trajectories, their values say nothing about the effect.
    starts = tuple(bound.values if bound.evidence > 0.0 else None for bound in bounds)
    return Promises(np.maximum(evidence, of_bounds), z, starts)


def bounds_of(directions: Sequence[Direction], fit: Fit, columns: Float) -> list[LowerBound]:
    """Return lower bounds of the evidence of each direction's effect.

    Parameters
    ----------
    directions : sequence of Direction
        The K directions.
    fit : Fit
        The current model, fitted.
    columns : ndarray, shape (M, D, T)
        Trajectories of it, drawn given all readings.
    """
    effects = {instance_key(direction.effect): direction.effect for direction in directions}
    bounds = dict(zip(effects, lower_bounds(fit.tables, fit.bound.logs[0], columns, effects.values()), strict=True))
    for key, effect in effects.items():
        if effect.carries is not None and effect.rigid:
            gain = _gain_of_motion(fit, effect)
            if gain > bounds[key].evidence:
                bounds[key] = LowerBound(gain, bounds[key].values)
    return [bounds[instance_key(direction.effect)] for direction in directions]


def _gain_of_motion(fit: Fit, effect: Effect) -> float:
    model = fit.bound.model
    try:
        return gain_of_motion(replace(model, effects=(*model.effects, effect)).bind(fit.bound.logs), fit, effect)
    except DensityError:
        raise
    except PmclError:
        return -np.inf
